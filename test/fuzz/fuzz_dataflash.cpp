// ArduPilot logs.
#include "fuzz/fuzz.h"
#include "odmc/io/autopilot_logs.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, size_t size) {
  odmc::fuzz::ReadFlightBytes(data, size, [](const std::string& file) {
    return odmc::ReadDataflash(file, odmc::FlightReadOptions{});
  });
  return 0;
}
