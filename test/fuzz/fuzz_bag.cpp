// Structure of bags, followed before the library of ROS reads them (in a child process).
#include "../../src/ros/bag_structure.h"
#include "fuzz/fuzz.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, size_t size) {
  const odmc::fuzz::MemoryFile file(data, size);
  odmc::fuzz::ExpectSentence([&] { odmc::CheckBagStructure(file.name()); });
  return 0;
}
