#include "odmc/attribution/online_pass.h"

#include <algorithm>
#include <cmath>

#include "odmc/attribution/gust_case.h"
#include "odmc/estimator/estimator.h"

namespace odmc {

std::optional<OnlinePass> RunOnline(const FlightLog& log, const Vehicle& file_vehicle,
                                    const DynamicModel& model, const EstimatorOptions& options,
                                    const BlockSplit& blocks,
                                    const std::function<void(double)>& progress) {
  OnlinePass pass;
  const bool with_torque = !log.rotor_rms_only;
  Estimator estimator(&model, options, with_torque);
  const Stamp first = log.odometry.empty() ? 0 : log.odometry.front().stamp;
  estimator.SetHeldOut([=](Stamp stamp) { return blocks.IsHeldOut(ToSeconds(stamp - first)); });
  pass.replay = Replay(log, &estimator, progress);
  pass.replay.history = {};
  pass.replay.timing = {};
  if (!pass.replay.last) return std::nullopt;
  pass.parameters = Estimator::ToParameterSet(model, *pass.replay.last);
  const ModelValues& values = pass.replay.last->values;
  const ValueVariation vary =
      !model.processes().empty()
          ? PredictedGusts(log, file_vehicle, model, values, pass.replay.ground_spans, with_torque)
          : ValueVariation();
  std::vector<PredictionSample> unseen;
  PredictEach(log, file_vehicle, model, values, pass.replay.ground_spans, vary,
              [&](const PredictionSample& s) {
                pass.errors.push_back({s.t_s, s.speed_m_s, s.measured_force - s.predicted_force,
                                       s.measured_torque - s.predicted_torque});
                if (!blocks.IsHeldOut(s.t_s)) return;
                unseen.push_back(s);
                unseen.back().effects = {};
              });
  pass.held_out = SummarisePrediction(unseen, with_torque, file_vehicle, model, values);
  return pass;
}

ErrorRatios RatiosOf(const PredictionFigures& before, const PredictionFigures& after, bool felt) {
  ErrorRatios ratios;
  for (const auto axes : {&PredictionFigures::force_rmse_N, &PredictionFigures::torque_rmse_Nm,
                          &PredictionFigures::accelerometer_force_rmse_N}) {
    if (axes == &PredictionFigures::accelerometer_force_rmse_N && !felt) continue;
    if (!(before.*axes) || !(after.*axes)) continue;
    for (int k = 0; k < 3; ++k) {
      const double ratio = (*(after.*axes))[k] / std::max(1e-300, (*(before.*axes))[k]);
      ratios.least = std::min(ratios.least, ratio);
      ratios.largest = std::max(ratios.largest, ratio);
    }
  }
  return ratios;
}

double LogError(const PredictionFigures& figures) {
  double sum = 0.0;
  int axes = 0;
  for (const auto of :
       {&PredictionFigures::force_rmse_N, &PredictionFigures::angular_acceleration_rmse_rad_s2}) {
    if (!(figures.*of)) continue;
    for (const double error : *(figures.*of)) {
      sum += std::log(std::max(1e-300, error));
      ++axes;
    }
  }
  return sum / std::max(1, axes);
}

bool TakesPlace(const PredictionFigures& near_fit, const PredictionFigures& free, bool contradicts,
                const AttributionOptions& options) {
  const double most = contradicts ? 0.0 : -std::log(options.least_ratio);
  return LogError(near_fit) - LogError(free) < most;
}

bool Ruins(const PredictionFigures& without, const PredictionFigures& with,
           const AttributionOptions& options) {
  return RatiosOf(without, with, true).largest > 1.0 / options.telling_ratio &&
         LogError(with) > LogError(without);
}

}  // namespace odmc
