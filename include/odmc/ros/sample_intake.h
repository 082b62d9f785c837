#pragma once

#include <array>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "odmc/ros/conversions.h"
#include "odmc/sensing/samples.h"
#include "odmc/sensing/topic_clock.h"
#include "odmc/sensing/twist_frame.h"

namespace odmc {

/// Where a SampleIntake takes rotor speeds from.
struct RotorIntake {
  bool from_commands = false;  ///< the commands tell the rotor speeds
  bool needs_voltage = false;  ///< and says nothing before the first voltage
};

/// Where a SampleIntake stands.
enum class IntakePhase {
  kHolding,  ///< samples wait until their meaning is known
  kFlowing,  ///< samples pass
  kRefused,  ///< the twist fits neither frame: nothing passes any more
};

/// Live counterpart of ReadFlightBag(): finds out what the streams mean before any sample reaches
/// the estimator, and loses none meanwhile. Decides
///  - which of `odometry` and `pose`, and which of `rotor_speeds` and `joint_states` to use: the
///    first of a pair if it shows up within settle_s of the other; neither of the latter two where
///    rotor speeds come from commands,
///  - whether the odometry has velocity and body rates at all (some sources leave zeros),
///  - in which frame the velocity is (twist_frame.h).
/// Standing still says nothing about twist; samples then wait, the newest hold_s seconds of them.
/// Nor does hover: three seconds after the vehicle has begun to move they flow without a velocity,
/// which comes with the samples after those that tell its frame.
/// Also sees the clock step back. Thread-compatible.
class SampleIntake {
 public:
  /// @param twist_frame auto | body | world
  explicit SampleIntake(const std::string& twist_frame, const RotorIntake& rotors = {})
      : stated_frame_(TwistFrameStated(twist_frame).value()), rotors_(rotors) {}

  /// @returns false if the clock stepped back at this sample: what was held is gone, and the chain
  /// of
  ///   states ends here
  bool Push(InputSample input);

  /// True while holding, once everything is known that Release() needs.
  bool decided() const { return decided_; }

  /// Starts the flow with what was held.  @pre decided()
  void Release();

  /// Samples ready for the estimator, in the order of stamps: after a stall of the machine one
  /// topic's backlog comes whole before another's.
  std::vector<Sample> Take();

  IntakePhase phase() const { return phase_; }
  /// What is missing for a decision, for the user; empty where nothing is.
  std::string WaitingFor() const;
  const TwistFrameDecision& twist() const { return detector_.decision(); }
  TwistFrame frame() const { return frame_; }
  bool rms_only() const { return rms_only_; }
  bool uses_pose() const { return use_pose_; }
  bool has_velocity() const { return has_linear_; }
  bool has_rates() const { return has_angular_; }
  const std::string& frame_id() const { return frame_id_; }
  /// Frame of the odometry's sensor; empty where the messages do not say.
  const std::string& sensor_frame_id() const { return sensor_frame_id_; }
  /// Frame of the IMU; nothing if no IMU has been seen.
  const std::optional<std::string>& imu_frame_id() const { return imu_frame_id_; }
  long forgotten() const { return forgotten_; }  ///< held longer than hold_s, standing still
  long stale() const { return stale_; }          ///< from before a clock that stepped back
  long leaps() const { return leaps_; }          ///< samples whose stamps were far ahead of all
  long resets() const { return resets_; }

 private:
  static constexpr int kNumStreams = 7;
  static int StreamOf(const InputSample& input);

  StampVerdict CheckClock(int stream, Stamp stamp);
  bool IsLoneLeap(int stream, Stamp stamp);
  bool IsLoneLate(int stream, Stamp stamp);
  void Observe(const InputSample& input);
  void ObserveOdometry(const OdometryInput& input);
  void Decide();
  bool TwistIsKnown();
  bool HoverTellsNoMore() const;
  bool KnowsFrame() const;
  void FollowTwist(const OdometryInput& input);
  void Forget();
  void Pass(const InputSample& input);

  const TwistFrame stated_frame_;
  const RotorIntake rotors_;
  IntakePhase phase_ = IntakePhase::kHolding;
  bool decided_ = false;
  std::deque<InputSample> held_;
  std::vector<Sample> ready_;

  // What was seen so far.
  std::array<std::optional<Stamp>, kNumStreams> first_, last_, leap_, late_;
  TwistFrameDetector detector_;
  std::optional<OdometrySample> first_odometry_;
  std::string child_frame_id_;
  bool has_nonzero_linear_ = false, has_nonzero_angular_ = false;
  bool saw_linear_ = false, saw_angular_ = false;
  double moved_m_ = 0.0, turned_rad_ = 0.0;
  std::optional<Stamp> moves_since_;

  // What was decided.
  bool use_pose_ = false, use_joints_ = false, rms_only_ = false;
  bool has_linear_ = false, has_angular_ = false;
  TwistFrame frame_ = TwistFrame::kUndecided;
  std::string frame_id_, sensor_frame_id_;
  std::optional<std::string> imu_frame_id_;

  // After the clock stepped back: the middle between old and new time, until the new passed it.
  std::optional<Stamp> middle_;
  int back_stream_ = 0;
  long forgotten_ = 0, stale_ = 0, leaps_ = 0, resets_ = 0;
};

}  // namespace odmc
