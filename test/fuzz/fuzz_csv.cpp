// CSV files: flights of our own columns and of NeuroBEM's, and benches; the first byte chooses.
#include "fuzz/fuzz.h"
#include "odmc/io/bench_csv.h"
#include "odmc/io/data_sets.h"
#include "odmc/io/flight_csv.h"

namespace odmc {
namespace {

void ReadAs(std::uint8_t kind, const std::uint8_t* data, size_t size) {
  const FlightReadOptions options;
  switch (kind) {
    case 'n':
      fuzz::ReadFlightBytes(data, size,
                            [&](const std::string& file) { return ReadNeurobem(file, options); });
      return;
    case 'b': {
      const fuzz::MemoryFile file(data, size);
      fuzz::ExpectSentence([&] { ReadBenchCsv(file.name(), BenchColumns{}); });
      return;
    }
    default:
      fuzz::ReadFlightBytes(data, size,
                            [&](const std::string& file) { return ReadFlightCsv(file, options); });
  }
}

}  // namespace
}  // namespace odmc

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, size_t size) {
  if (size > 0) odmc::ReadAs(data[0], data + 1, size - 1);
  return 0;
}
