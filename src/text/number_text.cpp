#include "odmc/text/number_text.h"

#include <array>
#include <charconv>
#include <cstdlib>

namespace odmc {
namespace {

std::string_view Trim(std::string_view text) {
  const auto is_blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

}  // namespace

bool ParseNumber(std::string_view text, double* value) {
  text = Trim(text);
  // from_chars knows no plus sign; "+-1" stays an error.
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
  const char* const end = text.data() + text.size();
  const auto result = std::from_chars(text.data(), end, *value);
  if (result.ptr != end || text.empty()) return false;
  if (result.ec == std::errc::result_out_of_range) {
    *value = std::strtod(std::string(text).c_str(), nullptr);  // 0 or infinity, with its sign
    return true;
  }
  return result.ec == std::errc();
}

std::string FormatNumber(double value) {
  std::array<char, 32> buffer;
  const auto result = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value);
  return std::string(buffer.data(), result.ptr);
}

std::string FormatYamlNumber(double value) {
  std::string text = FormatNumber(value);
  if (text.find_first_of(".n") != std::string::npos) return text;  // a point, or nan and inf
  const size_t exponent = text.find('e');
  text.insert(exponent == std::string::npos ? text.size() : exponent, ".0");
  return text;
}

}  // namespace odmc
