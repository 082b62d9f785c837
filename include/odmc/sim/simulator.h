#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/disturbance.h"
#include "odmc/sim/truth_sample.h"
#include "odmc/sim/world_options.h"

namespace odmc {

/// What to fly.
struct SimulationOptions {
  std::string trajectory = "octo";  ///< as in TrajectoryOptions::name
  double duration_s = 30.0;         ///< of the whole log, time on the ground included [s], > 0
  int seed = 1;                     ///< of all randomness
  double step_s = 0.0005;           ///< longest integration step [s], 2e-5 to 0.001
  double log_rate_hz = 400.0;       ///< of every stream [Hz], 1 to 1000
  double ground_s = 0.0;            ///< time on the ground before take-off [s], >= 0
  double pilot_bandwidth = 1.0;     ///< of TrackingController, 0.5 to 1.5

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("trajectory", &trajectory);
    v->Field("duration_s", &duration_s);
    v->Field("seed", &seed);
    v->Field("step_s", &step_s);
    v->Field("log_rate_hz", &log_rate_hz);
    v->Field("ground_s", &ground_s);
    v->Field("pilot_bandwidth", &pilot_bandwidth);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// What keeps a flight and its recording from being exact. Standard deviations are per axis and
/// sample, white. Defaults: model.md section 9.
struct SimulationNoise {
  double position_m = 0.01;
  double attitude_rad = 0.003;  ///< right perturbation of q_WS, <= 1
  double velocity_m_s = 0.03;
  double rate_rad_s = 0.01;
  double rotor_speed_rad_s = 2.0;
  double force_N = 0.05;                     ///< as WorldOptions::disturbance_force_N
  double torque_Nm = 0.001;                  ///< as WorldOptions::disturbance_torque_Nm
  double feedback_rate_rad_s = 0.01;         ///< on the rates the pilot sees, not on those recorded
  bool imu = false;                          ///< record an IMU at its place in the vehicle
  double gyro_noise_density = 0.0;           ///< [rad/s/√Hz]
  double accelerometer_noise_density = 0.0;  ///< [m/s²/√Hz]
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();           ///< in I [rad/s]
  Eigen::Vector3d accelerometer_bias = Eigen::Vector3d::Zero();  ///< in I [m/s²]
  double rotor_delay_s = 0.0;  ///< rotor samples show the speeds of this long before, 0 to 1 [s]
  double battery_start_V = 16.2;
  double battery_slope_V_s = -0.01;

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("position_m", &position_m);
    v->Field("attitude_rad", &attitude_rad);
    v->Field("velocity_m_s", &velocity_m_s);
    v->Field("rate_rad_s", &rate_rad_s);
    v->Field("rotor_speed_rad_s", &rotor_speed_rad_s);
    v->Field("force_N", &force_N);
    v->Field("torque_Nm", &torque_Nm);
    v->Field("feedback_rate_rad_s", &feedback_rate_rad_s);
    v->Field("imu", &imu);
    v->Field("gyro_noise_density", &gyro_noise_density);
    v->Field("accelerometer_noise_density", &accelerometer_noise_density);
    v->Field("gyro_bias", &gyro_bias);
    v->Field("accelerometer_bias", &accelerometer_bias);
    v->Field("rotor_delay_s", &rotor_delay_s);
    v->Field("battery_start_V", &battery_start_V);
    v->Field("battery_slope_V_s", &battery_slope_V_s);
  }

  /// An exact flight and recording.
  static SimulationNoise None();

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// A recording and the truth beside it, at the same stamps: 0, then whole periods of the log rate.
struct SimulatedFlight {
  FlightLog log;
  std::vector<TruthSample> truth;
};

/// Takes the truth of a flight, sample by sample.
using TruthSink = std::function<void(const TruthSample&)>;

/// The world in which Simulate() flies: its sensors sample together, at the log's rate and without
/// delay, its motors know no limits and its battery empties with time alone.
WorldOptions WorldOf(const SimulationOptions& options, const SimulationNoise& noise);

/// Flies `model` at the values `truth` along a trajectory with a pilot and records what the
/// sensors of its World deliver, at their true places. The same arguments give the same flight, and
/// the noise of one sensor does not change that of another. A vehicle with an actuator is flown by
/// throttles at the voltage of its battery, which are recorded (at every control step, 2.5 ms or
/// less); others have motors with a lag of 25 ms. Parameters that vary (gusts) do so from `truth`
/// on; a suspended load swings.
/// @param truth physical values, model.num_parameters()×1
/// @throws std::invalid_argument for options that are not valid; std::runtime_error if the vehicle
///   can't follow, naming time and trajectory
SimulatedFlight Simulate(const DynamicModel& model, const ModelValues& truth,
                         const SimulationOptions& options, const SimulationNoise& noise = {},
                         const Unmodelled& unmodelled = {});

/// The same flight, of which the truth goes to `truth_sink` and is not kept.
FlightLog SimulateLog(const DynamicModel& model, const ModelValues& truth,
                      const SimulationOptions& options, const SimulationNoise& noise,
                      const Unmodelled& unmodelled, const TruthSink& truth_sink);

}  // namespace odmc
