#pragma once

#include <string>
#include <vector>

#include "odmc/inspection/stream_doubt.h"
#include "odmc/inspection/time_offsets.h"
#include "odmc/text/finding.h"

namespace odmc {

/// What the streams of a recording say about each other, and what should be done about it.
struct StreamInspection {
  std::vector<Finding> findings;
  std::vector<TimeOffset> offsets;  ///< compensated_s: what MendStreams() takes off the stamps
  std::vector<StreamDoubt> doubts;  ///< what may be wrong besides, and what mending leaves
  bool drop_velocity = false;       ///< these columns are wrong beyond mending
  bool drop_rates = false;
  bool drop_gyro = false;
  bool drop_accelerometer = false;
  std::string refusal;  ///< why nothing sensible can be learned, with what would mend it; or empty
};

/// Compares the streams of a recording, or of a node's buffer, with each other and with the vehicle
/// file. Takes about 0.2 s for a minute at 500 Hz; of longer recordings kLongestLook_s are looked
/// at. Ground, hand and crash are left out, see FindFlight(). Says nothing where a flight is too
/// short or too calm to tell.
StreamInspection InspectStreams(const FlightLog& log, const Vehicle& vehicle);

/// "rotor speeds are stamped 20.0 ms late": check "rotor_speeds_offset".
/// @param taken_off what was done about it
Finding OffsetFinding(const TimeOffset& offset, bool taken_off);

/// Does to the log what the inspection says: takes the offsets off, drops broken columns. Rotor
/// speeds and IMU get other stamps; velocity and rates, whose stamps are the poses', are
/// interpolated by cubics, and poses that then lack them are dropped.
void MendStreams(const StreamInspection& inspection, FlightLog* log);

/// Takes an offset off the stamps of a stream. @param late_s > 0: the stamps are too late
/// @param stream as in TimeOffset; gyro and accelerometer share their stamps
void ShiftStream(const std::string& stream, double late_s, FlightLog* log);
void ShiftRotors(double late_s, FlightLog* log);
void ShiftImu(double late_s, FlightLog* log);
void ShiftVelocity(double late_s, FlightLog* log);
void ShiftRates(double late_s, FlightLog* log);

}  // namespace odmc
