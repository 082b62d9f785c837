#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// Messages whose entries were read at different times, by clocks of their own.

/// Numbers of one message.
struct ForeignReading {
  Stamp stamp = 0;
  std::vector<double> values;  ///< rad/s, throttle 0 to 1, or V; in the order of the rotors
};

/// Brings readings of entries (ESCs that answer one after the other) to one time: the newest that
/// every entry has reached, each on the line between its own two readings around it. Entries may
/// repeat what they said before. An entry silent for more than four of its usual intervals gives
/// nothing meanwhile, as in the readers of logs (OnOneClock()). Thread-compatible.
class EntryAligner {
 public:
  /// @param stamps  one per value; 0: this entry has no reading yet
  /// @returns nothing where no later time is known for all
  std::optional<ForeignReading> Add(const std::vector<double>& values,
                                    const std::vector<Stamp>& stamps);

 private:
  struct Reading {
    Stamp stamp;
    double value;
  };
  using Readings = std::deque<Reading>;

  static std::optional<double> At(const Readings& readings, Stamp stamp);

  std::vector<Readings> entries_;  // newest last
  Stamp last_ = 0;
};

/// Lays a clock that counts since a start of its own (a flight controller's, an ESC's) on that of
/// the messages which bring its stamps: they come late by what the link takes, never early, so the
/// quickest message tells the offset. Crystals are right to 50 parts in a million: the offset may
/// grow by 100 between two quick ones. Thread-compatible.
class OwnClock {
 public:
  /// @param own      newest stamp of the clock in a message
  /// @param message  the message's
  /// @returns what takes a stamp of the clock to that of the messages
  Stamp Follow(Stamp own, Stamp message);

 private:
  std::optional<Stamp> offset_;
  Stamp last_own_ = 0;
  int far_off_ = 0;  // messages in a row that came a second late or more
};

}  // namespace odmc
