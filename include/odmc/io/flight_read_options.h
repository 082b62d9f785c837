#pragma once

#include <optional>

namespace odmc {

/// Which pose of a flight to use.
enum class PoseSource {
  kEkf,    ///< the main file's pose and twist
  kMocap,  ///< NAME_mocap.csv beside it: pose only
};

/// What of a flight is wanted.
enum class FlightPart {
  kWhole,    ///< poses, and rotor speeds or commands: a file without them is refused
  kOnboard,  ///< all but poses; those it has are read, and none are needed
  kPoses,    ///< poses alone: nothing else is read or needed
};

/// What every reader of flights is told.
struct FlightReadOptions {
  int num_rotors = 4;  ///< of the vehicle
  PoseSource pose = PoseSource::kEkf;
  std::optional<int> pole_pairs;  ///< of the motors, for logs of electrical speeds; else the log's
  FlightPart part = FlightPart::kWhole;
  /// Of a format that does not say whether its accelerometer was measured: read it, where it is
  /// specific force on the data.
  bool accelerometer = false;
  /// Largest difference of the stamps of rotors that were read together [s].
  double rotor_spread_s = 0.01;
};

}  // namespace odmc
