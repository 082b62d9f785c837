#pragma once

#include <optional>
#include <vector>

#include "odmc/math/ring.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Readings that fell out for a while.
struct RotorDropout {
  Stamp first = 0, last = 0;  ///< missing readings
  long readings = 0;          ///< how many
  unsigned rotors = 0;        ///< bit j: rotor j read (almost) nothing
};

/// Finds rotor speeds that fall to (almost) nothing faster than any brake stops a rotor. They are
/// no speeds but missing readings, until the speed is back from one reading to the next. A motor
/// that really stops spools down, and spools up again: its readings are kept. Thread-compatible.
class RotorDropoutWatch {
 public:
  /// Looks at the newest reading of `stream` and takes missing ones away from its end (two when a
  /// dropout begins: one low reading may be a glitch). @returns a dropout that has just ended
  std::optional<RotorDropout> Sift(Ring<RotorSample>* stream);

  /// True while readings are missing.
  bool missing() const { return dropout_.has_value(); }

  /// Forgets everything.
  void Clear() { dropout_.reset(); }

 private:
  bool Begins(const Ring<RotorSample>& stream);
  std::optional<RotorDropout> Continue(Ring<RotorSample>* stream);

  std::optional<RotorDropout> dropout_;
  RotorSample before_;  // the last good reading
  int between_ = 0;     // readings in a row that are neither gone nor back
};

/// Takes the dropouts out of a whole stream. Those of a single rotor that is gone in more than 30 %
/// of the stream are left in: its sensor is dead, which others say and mend.
/// @returns what was taken out
std::vector<RotorDropout> TakeDropouts(std::vector<RotorSample>* stream);

}  // namespace odmc
