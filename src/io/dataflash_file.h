#pragma once

#include <map>
#include <set>
#include <string>
#include <string_view>
#include <utility>

#include "decoding_damage.h"
#include "message_columns.h"

namespace odmc {

/// What an ArduPilot dataflash log holds of the wanted messages, in the units its UNIT, MULT and
/// FMTU messages say: scaled to their base unit (angles stay degrees).
struct DataflashContent {
  std::map<std::pair<std::string, int>, MessageColumns> messages;  ///< by name and instance
  std::map<std::string, double> parameters;
  std::set<std::string> names;  ///< of all messages the log defines
  DecodingDamage damage;

  /// The message's first instance that the log has; null for none.
  const MessageColumns* First(const std::string& name) const;
  const MessageColumns* Find(const std::string& name, int instance) const;
};

/// Decodes a dataflash log. Own code: pymavlink's reader is Python and no Debian package, and the
/// format describes itself.
DataflashContent DecodeDataflash(std::string_view bytes, const std::set<std::string>& wanted);

}  // namespace odmc
