#pragma once

#include <map>
#include <string>
#include <vector>

#include "odmc/inspection/stream_inspection.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Mends the streams of a running node, sample by sample, as one inspection after the other says:
/// takes offsets off the stamps of rotor speeds and IMU, drops columns that are wrong. The stamps
/// of velocity and rates are the poses'; their offsets are told and left, and rotor speeds are then
/// brought to the time that the rates show. Thread-compatible.
class OnlineStreamCorrector {
 public:
  /// Takes over what an inspection of the streams as they come says. An offset replaces the last
  /// one only where the two differ by more than 5 ms and three sigma.
  /// @returns true if samples are mended otherwise from now on: what was learned is of others
  bool Adopt(const StreamInspection& inspection);

  /// Columns that were dropped are used again, until an inspection says otherwise.
  void Readmit() { dropped_ = Dropped(); }

  /// What the last inspection found, in words that say what was done about it.
  const std::vector<Finding>& findings() const { return findings_; }

  /// Late of a stream's stamps, as it is taken off [s].
  double OffsetOf(const std::string& stream) const;

  void Mend(OdometrySample* sample) const;
  void Mend(ImuSample* sample) const;
  void Mend(RotorSample* sample) const;
  void Mend(BatterySample*) const {}
  void Mend(CommandSample*) const {}

 private:
  struct Dropped {
    bool velocity = false, rates = false, gyro = false, accelerometer = false;
  };
  /// @param left_s late of the reference of this offset, which stays
  bool TakeOff(const TimeOffset& offset, double left_s);

  std::map<std::string, double> offset_s_;
  Dropped dropped_;
  std::vector<Finding> findings_;
};

}  // namespace odmc
