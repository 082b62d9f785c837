#include "odmc/analysis/follow_flight.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "odmc/analysis/replay.h"
#include "odmc/estimator/estimator.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kBefore_s = 0.1;

/// The model with all but the named parameters held.
DynamicModel Following(const Vehicle& vehicle, const std::vector<std::string>& names) {
  const DynamicModel full(vehicle, vehicle.effects);
  for (const std::string& name : names) {
    const int k = full.IndexOf(name);
    if (k >= 0 && full.parameters()[k].estimated) continue;
    std::vector<std::string> able;
    for (const ModelParameter& p : full.parameters()) {
      if (p.estimated) able.push_back(p.full_name);
    }
    throw std::invalid_argument(
        name + " cannot follow the flight: " +
        (k < 0 ? "the vehicle has no such parameter" : "the parameters hold it") +
        "; those that can are " + Listed(able, "none"));
  }
  Vehicle held = vehicle;
  for (const ModelParameter& p : full.parameters()) {
    const bool follows = std::count(names.begin(), names.end(), p.full_name) > 0;
    held.parameters[p.full_name].estimated = follows;
  }
  return DynamicModel(held, held.effects);
}

/// The names, each once, and those that walk.
std::vector<std::string> WithWalking(const std::vector<std::string>& given, const Vehicle& vehicle,
                                     double walk_rate) {
  std::vector<std::string> all = given, names;
  if (walk_rate > 0.0) {
    const DynamicModel model(vehicle, vehicle.effects);
    const int k_m = model.IndexOf("rotor_torque.k_m");
    all.push_back("thrust.k_f");
    if (k_m >= 0 && model.parameters()[k_m].estimated) all.push_back("rotor_torque.k_m");
  }
  for (const std::string& name : all) {
    if (std::count(names.begin(), names.end(), name) == 0) names.push_back(name);
  }
  return names;
}

}  // namespace

FollowedParameters FollowFlight(const FlightLog& log, const Vehicle& vehicle,
                                const std::vector<std::string>& given,
                                const EstimatorOptions& options) {
  const std::vector<std::string> names = WithWalking(given, vehicle, options.k_f_walk_rate);
  if (names.empty()) return {};
  const DynamicModel model = Following(vehicle, names);
  std::vector<int> index;
  index.reserve(names.size());
  for (const std::string& name : names) index.push_back(model.IndexOf(name));
  Estimator estimator(&model, options, !log.rotor_rms_only);
  const ReplayResult replay = Replay(log, &estimator);
  struct Point {
    double t_s;
    std::vector<double> values;
  };
  std::vector<Point> points;
  for (const HistoryRow& row : replay.history) {
    Point point{row.t_s, {}};
    for (const int k : index) point.values.push_back(row.values[k]);
    points.push_back(std::move(point));
  }
  const double start_s =
      replay.last ? ToSeconds(replay.last->stamp - log.odometry.front().stamp) - replay.last->time_s
                  : 0.0;
  const auto vary = [points, index, start_s](double t_s, ModelValues* values) {
    const auto after = std::upper_bound(points.begin(), points.end(), t_s - start_s - kBefore_s,
                                        [](double t, const Point& p) { return t < p.t_s; });
    if (after == points.begin()) return;
    for (size_t k = 0; k < index.size(); ++k) (*values)[index[k]] = (after - 1)->values[k];
  };
  return {names, vary};
}

}  // namespace odmc
