#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <vector>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/factors/state_factors.h"
#include "odmc/math/ring.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// White noise of a sampled signal from its third differences, which motion hardly enters: a robust
/// scale of the newest samples. Smoothed sources come out small; callers set a floor.
class DifferenceNoise {
 public:
  /// One value a channel; never on the heap.
  using Channels = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxRotors, 1>;

  /// @param in_steps whether readings come in steps, as wide as the noise or wider
  explicit DifferenceNoise(bool in_steps = false) : in_steps_(in_steps) {}

  /// Adds one sample (channels×1); a spacing far from the last one starts a new run of four.
  void Add(double time_s, const Channels& sample);

  /// Standard deviation of one sample, all channels together; 0 before 20 differences are there.
  double Sigma() const;

 private:
  bool in_steps_;
  mutable double sigma_ = 0.0;  // of the last look, refreshed every few samples
  mutable int since_look_ = 1 << 20;
  mutable std::vector<double> all_;  // that look's scratch
  Ring<double> times_;
  Ring<Channels> run_;  // the newest four samples
  Ring<Channels> differences_;
};

/// Noise of the odometry, channel by channel, measured on the stream itself unless configured.
class OdometryNoiseEstimator {
 public:
  /// @param configured values > 0 are taken as they are, 0 means "measure it"
  explicit OdometryNoiseEstimator(const OdometryNoise& configured);
  void Add(const OdometrySample& sample);
  OdometryNoise Noise() const;

 private:
  OdometryNoise configured_;
  DifferenceNoise position_, attitude_, velocity_, rate_;
  Eigen::Quaterniond reference_;
  bool has_reference_ = false;
};

/// Noise of odometry and rotor speeds as it stands at a keyframe: samples wait until their stamp is
/// reached, so what happens to arrive early changes nothing and a live run repeats offline.
class StreamNoise {
 public:
  /// @param configured odometry noise; values > 0 are taken as they are, 0 means "measure it"
  explicit StreamNoise(const OdometryNoise& configured) : odometry_(configured) {}

  void Add(const OdometrySample& sample);
  void Add(const RotorSample& sample);

  /// Takes in what is stamped `stamp` or earlier.
  void AdvanceTo(Stamp stamp);

  /// Forgets what waits; the next samples may start at any stamp.
  void Restart();

  OdometryNoise odometry() const { return odometry_.Noise(); }

  /// Of one rotor's speed [rad/s].
  double rotor_speed() const { return rotors_.Sigma(); }

 private:
  OdometryNoiseEstimator odometry_;
  DifferenceNoise rotors_{true};  // counts of pulses, or of time between them
  Ring<OdometrySample> waiting_odometry_;
  Ring<RotorSample> waiting_rotors_;
};

/// What the model left unexplained over one interval, and how much of it rotor-speed noise puts
/// there.
struct IntervalResidual {
  double dt = 0.0;                                            ///< [s], > 0
  Eigen::Vector3d force_N = Eigen::Vector3d::Zero();          ///< mean over the interval, in B
  Eigen::Vector3d torque_Nm = Eigen::Vector3d::Zero();        ///< the same about Bcm
  Eigen::Vector3d rotor_force_N = Eigen::Vector3d::Zero();    ///< its standard deviation
  Eigen::Vector3d rotor_torque_Nm = Eigen::Vector3d::Zero();  ///< the same
};

/// Size of what the model does not explain, as a density: the RMS over blocks of 0.1 s of the force
/// and torque residual, times the root of the block length. The axes of each keep fixed
/// proportions, and one scale for force and one for torque hold for the whole flight so far (up to
/// a memory of a minute), so that every second of flight weighs the same in the fit: a size that
/// followed the flight closely would let its calm parts decide. Both are at least 1 (model.md
/// section 9's simulated vehicle), and start well above it until the flight has shown its residual.
/// The sizes in use follow in steps: all that was measured is weighed anew at each.
class ProcessNoiseEstimator {
 public:
  /// @param weight_N, arm_m  scale the floor and the start value to the vehicle
  ProcessNoiseEstimator(double weight_N, double arm_m, double floor_scale);

  /// Takes the post-fit residual of one interval.
  void Add(const IntervalResidual& residual, bool with_torque);

  /// Brings the sizes in use to what the flight has shown, if they are far from it.
  /// @returns by how much the information of all forces and torques before is to be scaled then, so
  ///   that they count with the new sizes too
  struct Change {
    double force = 1.0, torque = 1.0;
  };
  std::optional<Change> Step();

  /// Densities in units of the least ones.
  struct Levels {
    double force, torque;
  };
  const Levels& in_use() const { return in_use_; }

  /// Standard deviation of the mean force over `dt` per axis [N], and of the torque [N m].
  Eigen::Vector3d ForceSigma(double dt) const;
  Eigen::Vector3d TorqueSigma(double dt) const;

 private:
  using Vector6d = Eigen::Matrix<double, 6, 1>;

  /// A level, with the start level as far as it still counts.
  double WithStart(double level) const;
  /// By what the flight has shown.
  Levels Seen() const;

  Vector6d floor_;                                 // densities [N sqrt(s)], [N m sqrt(s)]
  double force_level_ = 0.0, torque_level_ = 0.0;  // mean squares seen, in units of the floor
  Levels in_use_;                                  // the same, at least 1
  double seen_s_ = 0.0;                            // flight time behind them
  double flown_s_ = 0.0;                           // the same, without an upper limit
  Vector6d sum_ = Vector6d::Zero(), rotor_variance_ = Vector6d::Zero();
  double block_s_ = 0.0;
};

}  // namespace odmc
