#include "odmc/analysis/ground_spans.h"

#include <algorithm>

#include "odmc/estimator/noise_estimation.h"
#include "odmc/sensing/synchroniser.h"

namespace odmc {
namespace {

constexpr double kPatience_s = 0.3;     // as the estimator waits for a silent stream
constexpr double kLongestStep_s = 1.0;  // a longer hole counts neither as ground nor as flight

/// Collective thrust over weight of the model at rest in the air.
class ThrustRatio {
 public:
  ThrustRatio(const FlightLog& log, const DynamicModel& model, const ModelValues& values)
      : log_(log), model_(model), values_(values) {}

  /// At the first rotor sample not before `stamp`, the last one after the stream's end.
  double At(Stamp stamp) {
    while (next_ + 1 < log_.rotors.size() && log_.rotors[next_].stamp < stamp) ++next_;
    FlightState hover;
    hover.rotors = RotorState::Steady(log_.rotors[next_].speed);
    Eigen::Vector3d force, torque;
    model_.EvaluateWrench(hover, values_, Eigen::Vector3d::Zero(), &force, &torque);
    return force.z() / (model_.vehicle().mass_kg * model_.vehicle().gravity_m_s2);
  }

 private:
  const FlightLog& log_;
  const DynamicModel& model_;
  const ModelValues& values_;
  size_t next_ = 0;
};

double SpeedOf(const OdometrySample& sample, const std::optional<OdometrySample>& last,
               double noise_m) {
  if (sample.v_WS) return sample.v_WS->norm();
  if (!last) return 0.0;
  const double dt = ToSeconds(sample.stamp - last->stamp);
  return std::max(0.0, (sample.p_WS - last->p_WS).norm() / dt - 2.0 * noise_m / dt);
}

}  // namespace

GroundSpans FindGroundSpans(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, const GroundGateOptions& options,
                            double keyframe_rate_hz) {
  GroundSpans result;
  if (log.rotors.empty()) return result;
  Synchroniser synchroniser(keyframe_rate_hz, kPatience_s);
  OdometryNoiseEstimator noise({0.0, 0.0, 0.0, 0.0});
  GroundGate gate(options);
  ThrustRatio thrust(log, model, values);
  std::optional<OdometrySample> last;
  bool standing = false;
  synchroniser.Finish();  // every stream is at hand: wait for none
  for (const OdometrySample& odometry : log.odometry) {
    noise.Add(odometry);
    synchroniser.Add(odometry);
    while (const std::optional<OdometrySample> sample = synchroniser.NextKeyframe()) {
      const double speed_m_s = SpeedOf(*sample, last, noise.Noise().position_m);
      const double dt = last ? ToSeconds(sample->stamp - last->stamp) : 0.0;
      const bool airborne =
          gate.Update(sample->stamp, sample->p_WS, speed_m_s, thrust.At(sample->stamp));
      last = sample;
      if (airborne) {
        ++result.airborne_keyframes;
        standing = false;
        continue;
      }
      if (dt < kLongestStep_s) result.on_ground_s += dt;
      if (!standing) result.spans.emplace_back(sample->stamp, sample->stamp);
      result.spans.back().second = sample->stamp;
      standing = true;
    }
  }
  return result;
}

}  // namespace odmc
