#pragma once

#include "odmc/sensing/samples.h"

namespace odmc {

/// True if a stamp lies further behind the newest of its clock than late messages do (0.5 s): an
/// error, or a clock that started again.
bool IsStepBack(Stamp newest, Stamp stamp);

/// What a message's stamp says about the clock of its topic.
enum class StampVerdict {
  kForward,  ///< newer than what came before, or hardly older
  kRefused,  ///< of another time than its neighbours
  kBack,     ///< a clock that stepped back: what comes now is of the new time
};

/// Tells a late message from a clock that stepped back: late ones come singly, after a step all are
/// old. A message counts as old as IsStepBack() says, and old ones that go on for 0.5 s of arrival
/// times as a step.
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
