#include "odmc/bench/recovery.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include "odmc/analysis/parallel.h"
#include "odmc/analysis/replay.h"
#include "odmc/math/statistics.h"
#include "odmc/sim/truth_vehicle.h"

namespace odmc {
namespace {

/// What one flight came to.
struct Outcome {
  ModelValues values;
  Eigen::VectorXd sigma;
  std::vector<bool> observable;
};

/// Uniform in [-1, 1], the same on every machine.
class Offsets {
 public:
  explicit Offsets(int seed) : generator_(static_cast<std::uint64_t>(seed) * 7919u + 17u) {}
  double Next() { return 2.0 * static_cast<double>(generator_() >> 11) * 0x1.0p-53 - 1.0; }

 private:
  std::mt19937_64 generator_;
};

/// True for coefficients that have a size of their own; places and angles lie about zero.
bool IsAwayFromZero(const ModelParameter& parameter, double truth) {
  return truth != 0.0 && parameter.spec.unit != "m" && parameter.spec.unit != "rad";
}

Outcome FlyAndCalibrate(const DynamicModel& truth_model, const ModelValues& truth,
                        const RecoveryOptions& options, int index) {
  SimulationOptions simulation = options.simulation;
  simulation.seed += index;
  const SimulatedFlight flight = Simulate(truth_model, truth, simulation, options.noise);
  const Vehicle wrong = StartWrong(truth_model, truth, options, simulation.seed);
  const DynamicModel model(wrong, wrong.effects);
  Estimator estimator(&model, options.estimator, true);
  const ReplayResult replay = Replay(flight.log, &estimator);
  if (!replay.last) throw std::runtime_error("the simulated vehicle never flies");
  return {replay.last->values, replay.last->sigma, replay.last->observable};
}

/// @param inside adds 1 for each flight with the truth inside three sigma
ParameterRecovery Compare(const ModelParameter& parameter, int k, double truth,
                          const std::vector<Outcome>& outcomes, long* inside) {
  std::vector<double> errors, over_sigma;
  ParameterRecovery r{parameter.full_name, parameter.spec.unit, truth, 0.0, {}, 0.0, 0.0, 0.0};
  long covered = 0;
  for (const Outcome& o : outcomes) {
    errors.push_back(std::abs(o.values[k] - truth));
    over_sigma.push_back(errors.back() / o.sigma[k]);
    covered += over_sigma.back() <= 3.0;
    r.observable_share += o.observable[k] ? 1.0 : 0.0;
  }
  const auto n = static_cast<double>(outcomes.size());
  r.observable_share /= n;
  r.median_error = Median(errors);
  if (IsAwayFromZero(parameter, truth)) r.median_relative_error = r.median_error / std::abs(truth);
  r.median_error_over_sigma = Median(over_sigma);
  r.coverage_3sigma = static_cast<double>(covered) / n;
  *inside += covered;
  return r;
}

}  // namespace

Vehicle RecoveryVehicle(const Vehicle& vehicle) {
  Vehicle result = vehicle;
  const DynamicModel model(vehicle, vehicle.effects);
  for (const ModelParameter& p : model.parameters()) {
    result.parameters[p.full_name].estimated = p.effect != "rotor_torque" &&
                                               p.effect != "odometry_extrinsics" &&
                                               p.effect != "imu_extrinsics";
  }
  return result;
}

Vehicle StartWrong(const DynamicModel& model, const ModelValues& truth,
                   const RecoveryOptions& options, int seed) {
  Vehicle vehicle = model.vehicle();
  Offsets offsets(seed);
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    const double share =
        p.effect == "inertia" ? options.inertia_start_offset : options.start_offset;
    const double offset = share * offsets.Next();  // drawn for all: the list leaves others alone
    ParameterSetting& setting = vehicle.parameters[p.full_name];
    setting.estimated = p.estimated;
    if (!p.estimated) {
      setting.value = truth[i];
      continue;
    }
    if (!IsAwayFromZero(p, truth[i])) continue;
    setting.value = truth[i] * (1.0 + offset);
    if (p.full_name == "thrust.k_f" && options.start_thrust_factor > 0.0) {
      setting.value = truth[i] * options.start_thrust_factor;
    }
    setting.sigma = std::max(p.spec.prior_sigma, std::abs(*setting.value - truth[i]));
  }
  return vehicle;
}

Recovery Recover(const Vehicle& vehicle, const RecoveryOptions& options,
                 const std::function<void(double)>& progress) {
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(model);
  std::vector<Outcome> outcomes(options.seeds);
  ForEachOf(
      options.seeds, options.jobs,
      [&](int i) { outcomes[i] = FlyAndCalibrate(model, truth, options, i); }, progress);
  Recovery recovery;
  long inside = 0;
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    if (p.estimated) recovery.parameters.push_back(Compare(p, k, truth[k], outcomes, &inside));
  }
  const size_t all = recovery.parameters.size() * outcomes.size();
  if (all > 0) {
    recovery.pooled_coverage_3sigma = static_cast<double>(inside) / static_cast<double>(all);
  }
  return recovery;
}

}  // namespace odmc
