// Messages of foreign types: definition, a line "%%", serialized message.
#include <string_view>

#include "fuzz/fuzz.h"
#include "odmc/io/message_layout.h"

namespace odmc {
namespace {

void ReadAll(const std::string& definition, const std::uint8_t* message, size_t size) {
  const MessageLayout layout("pkg/Name", definition);
  for (const char* text : {"esc_status[].rpm", "header.stamp", "motor_rpm[2]", "data", "name"}) {
    fuzz::ExpectSentence([&] {
      const FieldPath path = layout.Find(text);
      fuzz::ExpectSentence([&] { layout.Numbers(path, message, size); });
      fuzz::ExpectSentence([&] { layout.Stamps(path, message, size); });
      fuzz::ExpectSentence([&] { layout.Texts(path, message, size); });
    });
  }
}

}  // namespace
}  // namespace odmc

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, size_t size) {
  const std::string_view all(reinterpret_cast<const char*>(data), size);
  const size_t end = all.find("\n%%\n");
  if (end == std::string_view::npos) return 0;
  const std::uint8_t* message = data + end + 4;
  odmc::fuzz::ExpectSentence(
      [&] { odmc::ReadAll(std::string(all.substr(0, end + 1)), message, size - end - 4); });
  return 0;
}
