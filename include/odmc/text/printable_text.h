#pragma once

#include <string>
#include <string_view>

namespace odmc {

/// Text that was found in somebody's file or name, fit for a terminal, a report or a log: control
/// characters (escape sequences, line ends), marks that turn the direction of writing, and bytes
/// that are not UTF-8 become `\xNN`; what is longer than `most` bytes is cut there.
std::string Printable(std::string_view text, size_t most = 2000);

}  // namespace odmc
