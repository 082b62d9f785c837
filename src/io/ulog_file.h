#pragma once

#include <map>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "decoding_damage.h"
#include "message_columns.h"

namespace odmc {

/// Fields to keep, by topic; an element of an array or of a nested message is "esc[0].esc_rpm".
using WantedFields = std::map<std::string, std::vector<std::string>>;

/// What a PX4 log (ULog) holds of the wanted topics.
struct ULogContent {
  std::map<std::pair<std::string, int>, MessageColumns> topics;  ///< by name and instance
  std::map<std::string, double> parameters;
  std::set<std::string> topic_names;  ///< all that the log has
  DecodingDamage damage;
  double lost_s = 0.0;  ///< that the logger says it could not write [s]

  /// Null where the log has no message of it.
  const MessageColumns* Find(const std::string& topic, int instance = 0) const;
};

/// Decodes a ULog file. Own code, since neither PX4's C++ reader nor pyulog is a Debian package and
/// the format describes itself in a page (docs.px4.io, "ULog File Format").
/// @throws std::invalid_argument "FILE: ..." where it is none, or of a later version
ULogContent DecodeULog(const std::string& file, std::string_view bytes, const WantedFields& wanted);

}  // namespace odmc
