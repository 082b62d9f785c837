#pragma once

#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "odmc/estimator/load_observer.h"
#include "odmc/estimator/noise_estimation.h"
#include "odmc/estimator/options.h"
#include "odmc/estimator/phase_watch.h"
#include "odmc/preintegration/imu_interval.h"
#include "odmc/preintegration/rotor_interval.h"
#include "odmc/sensing/synchroniser.h"
#include "odmc/window/window.h"

namespace odmc {

/// Everything measured between two keyframes.
struct KeyframeInterval {
  double dt = 0.0;  ///< [s]
  RotorInterval rotors;
  std::optional<ImuInterval> imu;
  LoadPull load;
};

/// Samples in, keyframes out: synchronises the streams, measures their noise, tells the phases of
/// the flight, finds gaps and jumps, and reduces what was measured between two keyframes.
/// Thread-compatible.
class FrontEnd {
 public:
  /// Both must outlive the front end.
  FrontEnd(const DynamicModel* model, const EstimatorOptions* options);

  void Add(const OdometrySample& sample);
  void Add(const ImuSample& sample) { synchroniser_.Add(sample); }
  void Add(const RotorSample& sample);
  void Add(const BatterySample& sample) { synchroniser_.Add(sample); }
  /// No sample follows.
  void Finish();
  /// See Synchroniser::SetArrivalClock().
  void SetArrivalClock(std::function<double()> now_s) {
    synchroniser_.SetArrivalClock(std::move(now_s));
  }

  /// Forgets samples (a new flight, or a clock that stepped back).
  void Restart();
  /// Goes on where the front end of another model of the same vehicle stands.
  void CarryOn(const FrontEnd& before);

  /// The next keyframe, once all streams have come so far and their noise is known. It is the
  /// newest until Keep().
  std::optional<OdometrySample> NextKeyframe();

  /// Reads the streams up to the newest keyframe and asks what phase the flight is in.
  PhaseVerdict FollowPhase(const OdometrySample& newest);
  /// Drives the suspended load with the vehicle's motion, by the model's values of `window`.
  void FollowLoad(const OdometrySample& newest, const Window& window);

  /// What was measured since the keyframe before, the gyro's bias taken off as `window` has it.
  /// @returns nothing across a gap or a jump
  std::optional<KeyframeInterval> Read(const OdometrySample& newest, const Window& window) const;
  /// Where the newest keyframe's state starts from.
  /// @param interval since the one before, which is the newest in `window`; null: none
  State InitialState(const OdometrySample& newest, const KeyframeInterval* interval,
                     const Window& window) const;
  /// The newest keyframe becomes the one before.
  void Keep(const OdometrySample& newest);

  /// Keyframes for whose stamp this is true teach the estimate nothing.
  void SetHeldOut(std::function<bool(Stamp)> is_held_out) { is_held_out_ = std::move(is_held_out); }
  /// True if a keyframe in free flight is not to enter the window: held out, or near the ground.
  bool IsLeftOut(const OdometrySample& newest) const;

  /// Says whether the newest keyframe is in the window, so that the next one follows on it.
  void ContinueChain() { is_chained_ = true; }
  void BreakChain() { is_chained_ = false; }
  bool is_chained() const { return last_ && is_chained_; }

  double dt() const { return step_.dt; }  ///< from the keyframe before to the newest [s]; 0: none
  bool is_gap() const { return step_.is_gap || !step_.rotors; }
  bool is_jump() const { return step_.is_jump; }

  Stamp start() const { return first_stamp_.value_or(0); }  ///< first keyframe; 0: none yet
  /// The keyframe before the newest; null: none.
  const OdometrySample* last() const { return last_ ? &*last_ : nullptr; }
  bool has_imu() const { return !synchroniser_.imu().empty(); }
  const Synchroniser& streams() const { return synchroniser_; }
  const StreamNoise& noise() const { return stream_noise_; }
  PhaseWatch& phases() { return phases_; }
  const PhaseDetector& phase_detector() const { return phases_.detector(); }

 private:
  double OdometryHole_s() const {
    return synchroniser_.odometry_pace().Hole_s(options_->max_gap_s);
  }
  bool IsJump(const OdometrySample& newest, double dt) const;
  std::optional<Eigen::Vector3d> GyroRate(Stamp stamp, const Window& window) const;

  const DynamicModel* model_;
  const EstimatorOptions* options_;
  Synchroniser synchroniser_;
  StreamNoise stream_noise_;
  PhaseWatch phases_;
  LoadObserver load_;
  LoadPull load_pull_;  // over the newest interval
  struct Carrier {
    Stamp stamp;
    SensorMotion motion;
  };
  std::optional<Carrier> carrier_;  // of a load, at the newest keyframe
  struct {
    double dt = 0.0;
    std::optional<RotorInterval> rotors;
    bool is_gap = false, is_jump = false;
  } step_;                                            // to the newest keyframe
  std::optional<OdometrySample> last_, before_last_;  // keyframes before the newest
  std::optional<Stamp> first_stamp_;
  Stamp noise_ready_ = 0;
  bool is_chained_ = false;
  std::function<bool(Stamp)> is_held_out_;
};

}  // namespace odmc
