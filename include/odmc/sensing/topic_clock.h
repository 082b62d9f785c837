#pragma once

#include "odmc/sensing/samples.h"

namespace odmc {

/// What a message's stamp says about the clock of its topic.
enum class StampVerdict {
  kForward,  ///< newer than what came before, or hardly older
  kLate,     ///< much older: refused
  kBack,     ///< one of many that are: the topic has another clock now
};

/// Tells a late message from a clock that stepped back: late ones come singly, after a step all are
/// old. A message counts as old 0.5 s behind the newest stamp, and old ones that go on for 0.5 s
/// of arrival times as a step.
class TopicClock {
 public:
  /// @param arrival when the message came, by the receiver's clock
  StampVerdict See(Stamp stamp, Stamp arrival);
  /// Newest stamp that was not refused; 0: none yet.
  Stamp newest() const { return newest_; }

 private:
  Stamp newest_ = 0, old_since_ = 0;
};

}  // namespace odmc
