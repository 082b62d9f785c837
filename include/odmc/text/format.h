#pragma once

#include <optional>
#include <string>
#include <vector>

namespace odmc {

/// Text as std::printf() would print it; for sentences with numbers in them.
[[gnu::format(printf, 1, 2)]] std::string Format(const char* format, ...);

/// A number with so many digits, for people; "-" where it is not finite or not there.
std::string Rounded(const std::optional<double>& value, int digits = 3);

/// A number with so many decimals, for people; "-" where it is not finite or not there.
std::string Fixed(const std::optional<double>& value, int decimals);

/// Words as "a, b, c"; `none` where there are none.
std::string Listed(const std::vector<std::string>& words, const std::string& none = "");

}  // namespace odmc
