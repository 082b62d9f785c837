#pragma once

#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/prediction.h"
#include "odmc/attribution/force_blend.h"

namespace odmc {

/// Force and torque channels of a residual wrench.
constexpr int kNumChannels = 6;

/// Cuts a flight into blocks of time, some of them held out: seen neither by choice nor by fit.
struct BlockSplit {
  double block_s = 2.5;
  int hold_out_every = 4;  ///< one block of this many, the last but one; 1 or less: none

  /// Shorter blocks for a flight that is shorter than `hold_out_every` of them, so that one is held
  /// out of its middle.
  void FitTo(double duration_s) {
    if (hold_out_every > 1) block_s = std::min(block_s, duration_s / hold_out_every);
  }

  int BlockAt(double t_s) const { return static_cast<int>(t_s / block_s); }
  double share_in_use() const { return hold_out_every > 1 ? 1.0 - 1.0 / hold_out_every : 1.0; }
  bool IsHeldOut(double t_s) const {
    return hold_out_every > 1 && BlockAt(t_s) % hold_out_every == hold_out_every - 2;
  }
};

/// How a flight is thinned to fewer samples.
enum class Thinning {
  /// Each is the mean over its step. A derivative's noise grows with frequency: what of it lies
  /// above half the new rate averages out. Picked ones where less than kLeastForMeans_s are in use.
  kMean,
  /// Each is one of the recording's. Noise above half the new rate comes back as slow.
  kPick,
};

/// A flight thinned to equally spaced samples near 25 Hz, cut into blocks of time of which some are
/// held out.
class ThinnedFlight {
 public:
  static constexpr double kStep_s = 0.04;
  /// Of a shorter flight SerialNoise does not resolve a spectrum to 1 Hz, and so not how steeply
  /// that of means falls towards zero: their slow noise would seem larger than that of picked
  /// samples.
  static constexpr double kLeastForMeans_s = 20.0;

  /// @param R_BS turns the odometry's axes into the body axes of the vehicle file
  /// @param most_s of a flight longer than this only stretches of that length together are taken,
  /// spread evenly over it; 0: all
  ThinnedFlight(FlightMotion flight, const BlockSplit& blocks,
                const Eigen::Matrix3d& R_BS = Eigen::Matrix3d::Identity(), double most_s = 0.0,
                Thinning thinning = Thinning::kMean);

  int size() const { return static_cast<int>(samples_.size()); }
  /// All of the recording's samples.
  const FlightMotion& motion() const { return flight_; }
  const FilteredMotion& sample(int i) const { return samples_[static_cast<size_t>(i)]; }
  /// Sample of motion() in the middle of sample(i).
  size_t index(int i) const { return index_[i]; }
  /// Attitude, velocity [m/s] and rate [rad/s] of the body axes of the vehicle file.
  Eigen::Matrix3d R_WB(int i) const { return sample(i).R_WS * R_BS_.transpose(); }
  Eigen::Vector3d v_B(int i) const { return R_WB(i).transpose() * sample(i).v_WS; }
  Eigen::Vector3d w_B(int i) const { return R_BS_ * sample(i).w_S; }
  /// True if it follows sample i - 1 at an equal step.
  bool next(int i) const { return next_[i]; }
  int block(int i) const { return blocks_.BlockAt(sample(i).t_s); }
  bool held_out(int i) const { return blocks_.IsHeldOut(sample(i).t_s); }
  double step_s() const { return step_s_; }
  /// True if samples are means (of more than one).
  bool takes_means() const { return takes_means_; }

  /// The same samples moving otherwise.
  /// @param samples one for each of this flight's
  ThinnedFlight Moving(std::vector<FilteredMotion> samples) const;
  /// The same motion with other rotor speeds, those of motion() as they are.
  /// @param rotors one for each sample
  ThinnedFlight WithRotors(const std::vector<RotorState>& rotors) const;

  /// A channel of a residual as runs without gaps.
  /// @param in_use_only true to cut out the blocks held out
  std::vector<std::vector<double>> Runs(const Eigen::VectorXd& channel,
                                        bool in_use_only = false) const;

 private:
  void TakeStretches(double most_s);

  FlightMotion flight_;
  BlockSplit blocks_;
  Eigen::Matrix3d R_BS_;
  double step_s_;
  bool takes_means_ = false;
  std::vector<FilteredMotion> samples_;
  std::vector<size_t> index_;
  std::vector<bool> next_;
};

/// True for parameters of which torque says nothing: the force alone anchors them (the homogeneous
/// trap).
bool IsAnchoredByForce(const std::string& full_name);

/// Residual wrench of a model over a flight, and its derivatives. Channels: force in the body axes
/// of the vehicle file [N], and torque as the file's inertia times what angular acceleration the
/// model misses [N m] (so that no estimate of inertia shrinks it).
class ResidualModel {
 public:
  ResidualModel(const ThinnedFlight* flight, const Vehicle* file_vehicle, bool with_torque);

  using Wrenches = Eigen::Matrix<double, Eigen::Dynamic, kNumChannels>;

  /// From here on Residual() and Derivative() blend the sensors there are, weighed by their noise
  /// about this model. The torque is blended of the gyro and of the odometry's rates; how the one
  /// is mounted on the other is fitted to the two rates. The force along the rotors' axes (body z)
  /// is blended of what the accelerometer feels and what the motion says. Across them it stays the
  /// accelerometer's: by the motion it has errors of attitude and of gravity's direction in it,
  /// times the weight, which look like wind and leaning rotors. But where the accelerometer is the
  /// noisier one there, as by vibration that it samples too slowly, and the motion shows all that
  /// it feels, the force across the axes is the motion's. Nothing without an IMU.
  void BlendSensors(const DynamicModel& model, const ModelValues& values);
  /// By the weights of another, of the same samples.
  void BlendAs(const ResidualModel& other) {
    blend_ = other.blend_;
    R_SI_ = other.R_SI_;
    across_by_motion_ = other.across_by_motion_;
  }

  /// Weight of the accelerometer, and so of its bias, in a constant force.
  double felt_share_of_constant(int axis) const {
    if (is_blend(axis)) return blend_[static_cast<size_t>(axis)]->felt_weight().back();
    return across_by_motion_ ? 0.0 : 1.0;
  }

  /// Measured minus predicted (N×6).
  Wrenches Residual(const DynamicModel& model, const ModelValues& values) const;
  /// What of a residual of this model is the blend's is made the accelerometer's alone, without its
  /// bias: for comparisons with ForceByMotion(), of which nothing may be in it.
  Wrenches AsFelt(Wrenches residual, const DynamicModel& model, const ModelValues& values) const;

  /// A second measurement of the force's part, where from_accelerometer(): by the motion, mass
  /// times the velocity's derivative, turned by the attitude (N×3) [N]; zero where it is the first.
  /// Else no rows.
  Eigen::MatrixX3d ForceByMotion(const DynamicModel& model, const ModelValues& values) const;

  /// The residual force across the rotors' axes (body x and y) by the sensor whose it is not in
  /// Residual(): the motion or, where across_by_motion(), the accelerometer (N×2) [N]. No rows
  /// where there is one sensor.
  Eigen::MatrixX2d AcrossByOther(const DynamicModel& model, const ModelValues& values) const;

  /// Derivative of the prediction by parameter `index` (N×6), by central differences,
  /// without torque where IsAnchoredByForce().
  Wrenches Derivative(const DynamicModel& model, const ModelValues& values, int index) const;
  /// The same by a forward difference, in half the time.
  /// @param residual Residual() of the same values
  Wrenches Derivative(const DynamicModel& model, const ModelValues& values, int index,
                      const Wrenches& residual) const;

  const ThinnedFlight& flight() const { return *flight_; }
  const Vehicle& file_vehicle() const { return *file_vehicle_; }
  /// True if the force is the accelerometer's (it feels what an onboard filter's velocity smooths
  /// away); false if it is the velocity's derivative.
  bool from_accelerometer() const { return from_accelerometer_; }
  /// True if the force across the rotors' axes is the motion's all the same, see BlendForces().
  bool across_by_motion() const { return across_by_motion_; }
  /// True if the gyro is there at every sample.
  bool from_gyro() const { return from_gyro_; }
  /// R_SI: axes of the IMU in those of the odometry, from the rates of both; where from_gyro().
  Eigen::Matrix3d GyroInOdometry() const;
  /// True if the channel is a blend of two sensors.
  bool is_blend(int channel) const { return blend_[static_cast<size_t>(channel)].has_value(); }
  int num_channels() const { return with_torque_ ? kNumChannels : 3; }

 private:
  /// Measured and predicted at every sample.
  std::vector<PredictionSample> Predict(const DynamicModel& model, const ModelValues& values) const;
  /// Measured minus predicted force by the accelerometer, and by the motion (N×3).
  Eigen::MatrixX3d FeltForce(const std::vector<PredictionSample>& samples) const;
  static Eigen::MatrixX3d MotionForce(const std::vector<PredictionSample>& samples);
  /// Measured minus predicted angular acceleration times the file's inertia, by the odometry and by
  /// the gyro (N×3) [N m].
  Eigen::MatrixX3d MotionTorque(const std::vector<PredictionSample>& samples) const;
  Eigen::MatrixX3d GyroTorque(const std::vector<PredictionSample>& samples) const;
  void BlendForces(const std::vector<PredictionSample>& samples);
  void BlendTorques(const std::vector<PredictionSample>& samples);
  /// @param felt, by_motion measured minus predicted by either sensor
  ForceBlend BlendOf(const Eigen::VectorXd& felt, const Eigen::VectorXd& by_motion) const;
  /// True if the force by the motion is the better one across the rotors' axes.
  bool IsMotionBetter(const Eigen::MatrixX3d& felt, const Eigen::MatrixX3d& by_motion) const;
  /// Residual() with one value moved by `step`.
  Wrenches ResidualAt(const DynamicModel& model, ModelValues values, int index, double step) const;

  const ThinnedFlight* flight_;
  const Vehicle* file_vehicle_;
  static constexpr int kAlongRotors = 2;  // channel

  bool with_torque_, from_accelerometer_, from_gyro_, across_by_motion_ = false;
  std::array<std::optional<ForceBlend>, kNumChannels> blend_;  // channels of two sensors
  Eigen::Matrix3d R_SI_ = Eigen::Matrix3d::Identity();
};

}  // namespace odmc
