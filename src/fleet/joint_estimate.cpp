#include "odmc/fleet/joint_estimate.h"

#include <algorithm>
#include <cmath>

#include "odmc/analysis/widening.h"
#include "odmc/fleet/scalar_history.h"

namespace odmc {
namespace {

using Eigen::Index;

constexpr int kMostRounds = 5;

/// Of a value that every flight has its own of, for the flight after `count` of them: of few
/// flights the spread is not known well, nor is the mean.
double SigmaOfNext(double count, double variance, double noise) {
  if (count < 2.0) return std::sqrt(variance + noise);
  const double spread = variance * count / (count - 1.0);
  return Widening(count - 1.0) * std::sqrt((spread + noise) * (1.0 + 1.0 / count));
}

/// A finding with the parameter it is about.
struct Found {
  int parameter = 0;
  HistoryFinding finding;
};

ScalarHistory HistoryOf(int parameter, const std::vector<FlightFactor>& factors,
                        const FleetModel& model, const RandomEffects& fit,
                        const std::vector<double>& times) {
  ScalarHistory history;
  history.time = times;
  const std::vector<FlightDeparture> departures = DeparturesOf(parameter, factors, model, fit);
  const Index n = factors.front().size();
  for (size_t i = 0; i < factors.size(); ++i) {
    double value = departures[i].value;
    for (size_t c = 0; c < model.changes.size(); ++c) {
      if (model.changes[c].parameter != parameter) continue;
      value += model.changes[c].by[i] * fit.beta[n + static_cast<Index>(c)];
    }
    history.value.push_back(value);
    history.sigma.push_back(departures[i].sigma);
  }
  return history;
}

FleetModel ModelOf(const std::vector<Found>& all, const ScalarHistory& axis, int flights) {
  FleetModel model;
  for (const Found& found : all) {
    if (found.finding.kind == HistoryFinding::Kind::kOutlier) {
      model.outliers.emplace_back(found.finding.flight, found.parameter);
      continue;
    }
    FleetModel::Change change;
    change.parameter = found.parameter;
    for (int i = 0; i < flights; ++i) change.by.push_back(EffectOf(found.finding, axis, i));
    model.changes.push_back(std::move(change));
  }
  return model;
}

bool Same(const FleetModel& a, const FleetModel& b) {
  return a.outliers == b.outliers &&
         std::equal(a.changes.begin(), a.changes.end(), b.changes.begin(), b.changes.end(),
                    [](const auto& x, const auto& y) {
                      return x.parameter == y.parameter && x.by == y.by;
                    });
}

/// The share of the false-alarm rate that each parameter has: half of it for those often changed,
/// half for the rest.
std::vector<double> SharesOf(const std::vector<std::string>& names,
                             const std::vector<std::string>& often_changed) {
  const auto is_often = [&](const std::string& name) {
    return std::count(often_changed.begin(), often_changed.end(), name) > 0;
  };
  const auto n = static_cast<double>(names.size());
  const auto often = static_cast<double>(std::count_if(names.begin(), names.end(), is_often));
  std::vector<double> shares;
  for (const std::string& name : names) {
    const bool all_alike = often == 0.0 || often == n;
    shares.push_back(all_alike ? 1.0 / n : 0.5 / (is_often(name) ? often : n - often));
  }
  return shares;
}

/// The vehicle after the last change: value, covariance, sigmas.
void SetToday(const std::vector<FlightFactor>& factors, JointEstimate* joint) {
  const Index n = factors.front().size(), q = joint->fit.beta.size();
  Eigen::MatrixXd today = Eigen::MatrixXd::Zero(n, q);
  today.leftCols(n).setIdentity();
  Eigen::VectorXd freedom = joint->fit.degrees_of_freedom.head(n);
  for (size_t c = 0; c < joint->model.changes.size(); ++c) {
    const FleetModel::Change& change = joint->model.changes[c];
    today(change.parameter, n + static_cast<Index>(c)) = change.by.back();
    freedom[change.parameter] = std::min(freedom[change.parameter],
                                         joint->fit.degrees_of_freedom[n + static_cast<Index>(c)]);
  }
  joint->value = today * joint->fit.beta;
  joint->covariance = today * joint->fit.covariance * today.transpose();
  Eigen::VectorXd widening(n);
  for (Index k = 0; k < n; ++k) widening[k] = Widening(freedom[k]);
  joint->covariance = widening.asDiagonal() * joint->covariance * widening.asDiagonal();
  joint->sigma = joint->covariance.diagonal().cwiseSqrt();
  joint->new_flight_sigma =
      (joint->sigma.cwiseAbs2() + joint->fit.scatter.cwiseProduct(widening).cwiseAbs2())
          .cwiseSqrt();
}

}  // namespace

JointEstimate EstimateJointly(const std::vector<FlightFactor>& factors,
                              const JointOptions& options) {
  const int n = factors.front().size(), flights = static_cast<int>(factors.size());
  std::vector<double> times = options.times;
  if (times.size() != factors.size()) {
    times.clear();
    for (int i = 0; i < flights; ++i) times.push_back(i);
  }
  JointEstimate joint;
  joint.fit = FitRandomEffects(factors, joint.model);
  const std::vector<double> shares = SharesOf(factors.front().names, options.often_changed);
  std::vector<Found> all;
  ScalarHistory axis;
  axis.time = times;
  for (int round = 0; round < kMostRounds && flights > 3; ++round) {
    std::vector<Found> now;
    for (int k = 0; k < n; ++k) {
      const ScalarHistory history = HistoryOf(k, factors, joint.model, joint.fit, times);
      const HistoryFit fit =
          ExamineHistory(history, options.false_alarm_rate * shares[static_cast<size_t>(k)]);
      for (const HistoryFinding& finding : fit.findings) now.push_back({k, finding});
    }
    FleetModel model = ModelOf(now, axis, flights);
    all = std::move(now);
    if (Same(model, joint.model)) break;
    joint.model = std::move(model);
    joint.fit = FitRandomEffects(factors, joint.model);
  }
  for (const Found& found : all) {
    const HistoryFinding& f = found.finding;
    const double p =
        std::min(1.0, std::exp(f.log_p) / shares[static_cast<size_t>(found.parameter)]);
    if (f.kind == HistoryFinding::Kind::kOutlier) {
      joint.outliers.push_back({f.flight, found.parameter, f.size, f.sigma, p});
    } else {
      joint.changes.push_back({f.kind == HistoryFinding::Kind::kStep ? VehicleChange::Kind::kStep
                                                                     : VehicleChange::Kind::kTrend,
                               found.parameter, f.flight, f.size, f.sigma, p});
    }
  }
  SetToday(factors, &joint);
  return joint;
}

ParameterSet ToParameterSet(const JointEstimate& joint, const std::vector<FlightFactor>& factors,
                            const DynamicModel& model) {
  const FlightFactor& first = factors.front();
  ParameterSet set;
  set.effects = first.estimate.effects;
  set.parameters = first.estimate.parameters;
  const auto total = static_cast<Index>(set.parameters.size());
  set.covariance = Eigen::MatrixXd::Zero(total, total);
  std::vector<Index> at;
  for (const std::string& name : first.names) {
    at.push_back(set.Find(name) - set.parameters.data());
  }
  for (size_t k = 0; k < at.size(); ++k) {
    const auto i = static_cast<Index>(k);
    ParameterEstimate& p = set.parameters[static_cast<size_t>(at[k])];
    p.value = joint.value[i];
    p.sigma = joint.sigma[i];
    p.scatter = std::sqrt(
        std::max(0.0, std::pow(joint.new_flight_sigma[i], 2) - std::pow(joint.sigma[i], 2)));
    p.observable = joint.sigma[i] < 0.5 * first.prior_sigma[i];
    for (size_t l = 0; l < at.size(); ++l) {
      set.covariance(at[k], at[l]) = joint.covariance(i, static_cast<Index>(l));
    }
  }
  for (size_t j = 0; j < set.parameters.size(); ++j) {
    ParameterEstimate& p = set.parameters[j];
    if (!p.estimated || std::count(at.begin(), at.end(), static_cast<Index>(j)) > 0) continue;
    // The flights' own: the next one has another.
    double sum = 0.0, squares = 0.0, noise = 0.0, count = 0.0;
    for (const FlightFactor& f : factors) {
      const ParameterEstimate* own = f.estimate.Find(p.full_name);
      if (own == nullptr) continue;
      sum += own->value;
      squares += own->value * own->value;
      noise += own->sigma * own->sigma;
      count += 1.0;
    }
    const double mean = sum / count;
    const double variance = std::max(0.0, squares / count - mean * mean);
    const double sigma = SigmaOfNext(count, variance, noise / count);
    // The vehicle's prior is of any flight's value. What few flights scatter about says less.
    const ParameterSpec& prior =
        model.parameters()[static_cast<size_t>(model.IndexOf(p.full_name))].spec;
    const double weight = 1.0 / (1.0 + std::pow(sigma / prior.prior_sigma, 2));
    p.value = weight * mean + (1.0 - weight) * prior.prior_value;
    p.sigma = std::sqrt(weight) * sigma;
    p.scatter = 0.0;
    const auto i = static_cast<Index>(j);
    set.covariance(i, i) = p.sigma * p.sigma;
  }
  return set;
}

}  // namespace odmc
