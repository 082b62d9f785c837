#include "odmc/text/format.h"

#include <cmath>
#include <cstdarg>
#include <cstdio>

namespace odmc {

std::string Format(const char* format, ...) {
  std::va_list arguments, again;
  va_start(arguments, format);
  va_copy(again, arguments);
  const int size = std::vsnprintf(nullptr, 0, format, arguments);
  va_end(arguments);
  std::string text(static_cast<size_t>(size), '\0');
  std::vsnprintf(text.data(), text.size() + 1, format, again);
  va_end(again);
  return text;
}

std::string Rounded(const std::optional<double>& value, int digits) {
  return value && std::isfinite(*value) ? Format("%.*g", digits, *value) : "-";
}

std::string Fixed(const std::optional<double>& value, int decimals) {
  return value && std::isfinite(*value) ? Format("%.*f", decimals, *value) : "-";
}

std::string Listed(const std::vector<std::string>& words, const std::string& none) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text.empty() ? none : text;
}

}  // namespace odmc
