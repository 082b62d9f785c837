#pragma once

#include <string>
#include <variant>
#include <vector>

namespace odmc {

/// Every number that makes close_loop name, refuse or drop an effect, or choose a verdict.
/// DecisionNumbers() says why each is what it is.
struct AttributionOptions {
  double false_alarm_rate = 0.01;
  double log_prior_odds = -3.0;
  int most_effects = 6;
  double most_flight_s = 150.0;
  double least_share = 0.03;
  double regressor_noise = 0.1;
  double clear_odds = 4.6;
  double form_share = 0.1;
  double large_share = 0.3;
  double telling_sigmas = 3.0;
  double even_odds = 3.0;
  double whiteness_p = 1e-6;
  double noise_p = 3e-3;
  double least_structured = 0.05;
  double most_unexplained = 0.5;
  double most_lean_rad = 0.0175;
  double most_thrust_wander = 0.005;
  double telling_ratio = 0.5;
  double least_ratio = 0.97;
  double gust_price = 16.0;
  double significant_sigmas = 3.0;
  double least_size_sigmas = 1.0;
  double known_thrust_share = 0.05;
  double opposite_share = 0.1;
};

/// One number of AttributionOptions, with the range that makes sense.
struct DecisionNumber {
  std::string name, unit;
  std::variant<double AttributionOptions::*, int AttributionOptions::*> member;
  double least, most;
  std::string why;

  double Of(const AttributionOptions& options) const;
  std::string TextOf(const AttributionOptions& options) const;
};

const std::vector<DecisionNumber>& DecisionNumbers();

/// Sets one number from "NAME=VALUE".
/// @throws std::invalid_argument if there is no such number, or the value is out of its range
void SetDecision(const std::string& assignment, AttributionOptions* options);

/// Every number with its default, unit and derivation, a line each.
std::string DescribeDecision();

/// The numbers that differ from their default, "name value, ..."; else "defaults".
std::string DescribeChanges(const AttributionOptions& options);

}  // namespace odmc
