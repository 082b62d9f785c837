#include "odmc/attribution/onset.h"

#include <limits>

#include "odmc/model/effect.h"

namespace odmc {

std::optional<double> OnsetByWholeFlight(const RankedEffect& effect, const ResidualModel& residual,
                                         const DynamicModel& model, const ModelValues& values) {
  const auto owner = EffectRegistry::Default().Make(effect.name, model.vehicle());
  const int onset = model.IndexOf(effect.name + "." + owner->onset_parameter());
  if (owner->onset_parameter().empty() || onset < 0 || !(values[onset] > 0.0)) return std::nullopt;
  const ThinnedFlight& flight = residual.flight();
  if (flight.size() < 2) return std::nullopt;
  const auto beginning = [&](double from_s) {
    ModelValues moved = values;
    moved[onset] = from_s;
    return residual.Residual(model, moved);
  };
  const ResidualModel::Wrenches fitted = residual.Residual(model, values);
  const ResidualModel::Wrenches with = beginning(-std::numeric_limits<double>::max());
  const ResidualModel::Wrenches without = beginning(std::numeric_limits<double>::max());
  Eigen::Matrix<double, kNumChannels, 1> weight;
  for (Eigen::Index c = 0; c < kNumChannels; ++c) {
    const double variance = fitted.col(c).squaredNorm() / static_cast<double>(flight.size());
    weight[c] = variance > 0.0 ? 1.0 / variance : 0.0;
  }
  // Sum of squares if it began before sample i, less that if it acted all along.
  double sum = 0.0, least = std::numeric_limits<double>::infinity();
  std::optional<double> best;
  for (int i = 0; i + 1 < flight.size(); ++i) {
    sum += (without.row(i).cwiseAbs2() - with.row(i).cwiseAbs2()).dot(weight.transpose());
    if (!(sum < least)) continue;
    least = sum;
    best = 0.5 * (flight.sample(i).t_s + flight.sample(i + 1).t_s);
  }
  return best;
}

}  // namespace odmc
