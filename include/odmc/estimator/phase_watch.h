#pragma once

#include <optional>

#include "odmc/estimator/noise_estimation.h"
#include "odmc/factors/state.h"
#include "odmc/math/ring.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/phases/phase_detector.h"
#include "odmc/preintegration/rotor_interval.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Looks at a flight keyframe by keyframe and tells its phases: makes a PhaseDetector's evidence
/// from poses, rotor speeds and a model. Thread-compatible.
class PhaseWatch {
 public:
  /// @param model must outlive the watch
  PhaseWatch(const DynamicModel* model, const PhaseOptions& options, bool learns_changes);

  /// @param sample the newest keyframe
  /// @param rotors since the one before; empty across gaps or without rotor speeds
  /// @param is_first the keyframe starts a new chain (the first one, or after a hole)
  PhaseVerdict Update(const OdometrySample& sample, const std::optional<RotorInterval>& rotors,
                      const OdometryNoise& noise, bool is_first);

  /// Tells the present estimate. What is missing is judged by an estimate that is kReferenceAge_s
  /// old and made before any suspicion, so that a contact cannot teach what it is judged by.
  /// @param thrust_sigma of thrust.k_f, relative
  void Learn(Stamp stamp, const ModelValues& values, double thrust_sigma);

  /// The estimate as it is, for a model that does not change: thrust is known from the start.
  void Know(const ModelValues& values, double thrust_sigma);

  /// Another vehicle, or all that was learned is taken back.
  void Forget();
  /// Goes on where the watch of another model of the same vehicle stands.
  void CarryOn(const PhaseWatch& before);
  void ForgetThrust() { detector_.ForgetThrust(); }
  void Restart();

  const PhaseDetector& detector() const { return detector_; }

  static constexpr double kReferenceAge_s = 1.0;

 private:
  struct Reference {
    Stamp stamp = 0;
    ModelValues values;
    double thrust_sigma = 0.0;
  };
  double PriorThrustSigma() const;
  double Disagreement(const ModelValues& values) const;
  State MotionOf(const OdometrySample& sample) const;
  bool HasVelocity(const OdometrySample& sample) const;
  void Keep(const OdometrySample& sample);
  void AddForces(const State& s0, const State& s1, const RotorInterval& rotors,
                 PhaseEvidence* e) const;

  const DynamicModel* model_;
  PhaseDetector detector_;
  Reference reference_;
  Ring<Reference> waiting_;     // not old enough yet, one a tenth of a second
  std::optional<State> last_;   // motion at the keyframe before, if it is known
  Ring<OdometrySample> poses_;  // of the last moments, oldest first
};

}  // namespace odmc
