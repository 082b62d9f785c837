#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "odmc/math/rotor_vector.h"
#include "odmc/sensing/command_unit.h"

namespace odmc {

/// Stamps are nanoseconds; a double of seconds since 1970 resolves only 0.2 µs.
using Stamp = std::int64_t;

inline double ToSeconds(Stamp stamp) { return 1e-9 * static_cast<double>(stamp); }
inline Stamp FromSeconds(double seconds) {
  return static_cast<Stamp>(seconds * 1e9 + (seconds < 0.0 ? -0.5 : 0.5));
}

/// Pose of the odometry's sensor frame S, with its twist where the source has one.
struct OdometrySample {
  Stamp stamp = 0;
  Eigen::Vector3d p_WS = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Quaterniond q_WS = Eigen::Quaterniond::Identity();
  std::optional<Eigen::Vector3d> v_WS;    ///< in W [m/s]
  std::optional<Eigen::Vector3d> w_WS_S;  ///< in S [rad/s]
};

/// What an IMU at frame I measured.
struct ImuSample {
  Stamp stamp = 0;
  std::optional<Eigen::Vector3d> gyro_I;            ///< with bias [rad/s]
  std::optional<Eigen::Vector3d> specific_force_I;  ///< with bias, +9.8 on z at hover [m/s²]
};

/// Measured rotor speeds, one per rotor in the vehicle file's order, >= 0.
struct RotorSample {
  Stamp stamp = 0;
  RotorVector speed;  ///< [rad/s]
  /// Sigma of each speed that comes from a model instead of the sensor (n×1, 0: from the sensor);
  /// empty: all from the sensor, whose noise shows in the stream [rad/s].
  RotorVector model_sigma{};
};

/// What the flight controller told its ESCs, one per rotor in the vehicle file's order.
struct CommandSample {
  Stamp stamp = 0;
  RotorVector throttle;  ///< 0 to 1
};

/// The battery's voltage at its terminals.
struct BatterySample {
  Stamp stamp = 0;
  double voltage_V = 0.0;
};

/// One sample of any stream.
using Sample = std::variant<OdometrySample, ImuSample, RotorSample, BatterySample, CommandSample>;

/// A whole recorded flight in the core's own conventions, each stream sorted by stamp.
struct FlightLog {
  std::string file;  ///< file name as given, without its folder
  std::vector<OdometrySample> odometry;
  std::vector<ImuSample> imu;
  std::vector<RotorSample> rotors;
  std::vector<BatterySample> battery;
  std::vector<CommandSample> commands;
  CommandUnit command_unit = CommandUnit::kFraction;  ///< in which the commands were recorded
  bool rotor_rms_only = false;  ///< only the root mean square of the speeds is known: every rotor
                                ///< carries it, so the sum of thrusts is right and torques are not
  long dropped = 0;             ///< samples refused while reading (not finite, out of order)
  std::vector<std::string> warnings;  ///< one sentence each, for the user
};

}  // namespace odmc
