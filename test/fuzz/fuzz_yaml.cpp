// YAML files that users write: vehicles, parameters, actuators, waypoints, options; the first byte
// chooses. What was read and is written again reads as the same.
#include "fuzz/fuzz.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/io/options_yaml.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sim/world_options.h"
#include "odmc/trajectory/waypoints_yaml.h"

namespace odmc {
namespace {

void ParametersReadAsWritten(const std::string& text) {
  const std::string written = FormatParameters(ParseParameters(text, "f"));
  if (FormatParameters(ParseParameters(written, "f")) != written) std::abort();
}

void ActuatorReadsAsWritten(const std::string& text) {
  const std::string written = FormatActuator(ParseActuator(text, "f"), "fuzz");
  if (FormatActuator(ParseActuator(written, "f"), "fuzz") != written) std::abort();
}

void ReadAs(std::uint8_t kind, const std::string& text) {
  fuzz::ExpectSentence([&] {
    switch (kind) {
      case 'p':
        ParametersReadAsWritten(text);
        return;
      case 'a':
        ActuatorReadsAsWritten(text);
        return;
      case 'w':
        ParseWaypoints(text, "f");
        return;
      case 'o': {
        const fuzz::MemoryFile file(reinterpret_cast<const std::uint8_t*>(text.data()),
                                    text.size());
        WorldOptions options;
        LoadOptions(file.name(), &options);
        return;
      }
      default:
        ParseVehicle(text, "f");
    }
  });
}

}  // namespace
}  // namespace odmc

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, size_t size) {
  if (size == 0) return 0;
  odmc::ReadAs(data[0], std::string(reinterpret_cast<const char*>(data) + 1, size - 1));
  return 0;
}
