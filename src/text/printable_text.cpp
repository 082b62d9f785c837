#include "odmc/text/printable_text.h"

#include <cstdint>

#include "odmc/text/format.h"

namespace odmc {
namespace {

/// Length of the UTF-8 character that `text` begins with and its code point; 0 if it is none.
size_t Decode(std::string_view text, std::uint32_t* code) {
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned char first = byte(0);
  const size_t length = first < 0x80       ? 1
                        : first >> 5 == 6  ? 2
                        : first >> 4 == 14 ? 3
                        : first >> 3 == 30 ? 4
                                           : 0;
  if (length == 0 || length > text.size()) return 0;
  *code = length == 1 ? first : first & (0x7fu >> length);
  for (size_t i = 1; i < length; ++i) {
    if (byte(i) >> 6 != 2) return 0;
    *code = (*code << 6) | (byte(i) & 0x3fu);
  }
  constexpr std::uint32_t kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
  const bool is_surrogate = *code >= 0xd800 && *code < 0xe000;
  return *code < kLeast[length] || *code > 0x10ffff || is_surrogate ? 0 : length;
}

bool IsPrintable(std::uint32_t code) {
  const bool is_control = code < 0x20 || (code >= 0x7f && code < 0xa0);
  const bool turns = code == 0x61c || (code >= 0x200b && code <= 0x200f) ||
                     (code >= 0x2028 && code <= 0x202e) || (code >= 0x2060 && code <= 0x206f) ||
                     code == 0xfeff;
  return !is_control && !turns;
}

}  // namespace

std::string Printable(std::string_view text, size_t most) {
  std::string printable;
  while (!text.empty()) {
    if (printable.size() >= most) return printable + "...";
    std::uint32_t code = 0;
    const size_t length = Decode(text, &code);
    if (length > 0 && IsPrintable(code)) {
      printable += text.substr(0, length);
      text.remove_prefix(length);
      continue;
    }
    for (size_t i = 0; i < (length > 0 ? length : 1); ++i) {
      printable += Format("\\x%02x", static_cast<unsigned char>(text[i]));
    }
    text.remove_prefix(length > 0 ? length : 1);
  }
  return printable;
}

}  // namespace odmc
