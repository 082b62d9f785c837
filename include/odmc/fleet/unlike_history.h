#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"

namespace odmc {

/// A parameter that today's flight shows elsewhere than the flights before suggest.
struct UnlikeHistory {
  std::string full_name;
  double value = 0.0;           ///< today's
  double expected = 0.0;        ///< of the history
  double expected_sigma = 0.0;  ///< of one flight's value: the history's sigma and scatter
  double p_value = 1.0;         ///< all parameters that were looked at accounted for

  /// "thrust.k_f is 1.57e-06 N s^2, 4.2 % above what earlier flights suggest (1.5e-06 +- 1e-08,
  /// chance in 0.01 %)"
  std::string Sentence(const std::string& unit) const;
};

/// Compares an estimate that had the history as its prior with it. With prior N(x0, s0²) and a
/// posterior sigma s, chance moves the estimate by sqrt(s0² - s²). Parameters that the flight has
/// not shown yet (s above 0.8 s0) are not looked at. The flights' own ones (the direction of
/// gravity) are among them: the history has their spread as sigma.
/// @param history a fleet's parameters.yaml
/// @param values, sigma of `model`'s parameters
/// @param rate of flights of the same vehicle on which something is named all the same
std::vector<UnlikeHistory> CompareWithHistory(const ParameterSet& history,
                                              const DynamicModel& model, const ModelValues& values,
                                              const Eigen::VectorXd& sigma, double rate = 1e-3);

/// Compares again and again in flight. A parameter is named once it has been unlike the history for
/// two seconds on end: in the first second after take-off, and where a model that lacks an effect
/// lets its parameters swing, the estimate passes through values that are nobody's.
class HistoryWatch {
 public:
  static constexpr double kHold_s = 2.0;

  explicit HistoryWatch(ParameterSet history) : history_(std::move(history)) {}

  /// @param time_s of flight; where it steps back all begins anew
  std::vector<UnlikeHistory> Look(double time_s, const DynamicModel& model,
                                  const ModelValues& values, const Eigen::VectorXd& sigma,
                                  double rate = 1e-3);
  void Reset() { since_s_.clear(); }

 private:
  ParameterSet history_;
  double last_s_ = 0.0;
  std::map<std::string, double> since_s_;  // by full name
};

}  // namespace odmc
