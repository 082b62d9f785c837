#include "odmc/attribution/attribution_options.h"

#include <cmath>
#include <cstdlib>
#include <stdexcept>
#include <type_traits>

#include "odmc/text/format.h"

namespace odmc {

double DecisionNumber::Of(const AttributionOptions& options) const {
  return std::visit([&](auto m) { return static_cast<double>(options.*m); }, member);
}

std::string DecisionNumber::TextOf(const AttributionOptions& options) const {
  return Format("%g", Of(options));
}

const std::vector<DecisionNumber>& DecisionNumbers() {
  using O = AttributionOptions;
  static const std::vector<DecisionNumber> numbers = {
      {"false_alarm_rate", "1", &O::false_alarm_rate, 1e-6, 0.1,
       "convention: chance of naming any effect, where none acts, in one round"},
      {"log_prior_odds", "nats", &O::log_prior_odds, -20.0, 0.0,
       "ln(1/20): one of some 20 candidates acts"},
      {"most_effects", "effects", &O::most_effects, 0.0, 20.0, "judgement: bounds the time"},
      {"most_flight_s", "s", &O::most_flight_s, 30.0, 1e5,
       "judgement: bounds time (ten minutes of flight in about one, on two processors) and memory; "
       "of a longer flight, stretches spread over it"},
      {"least_share", "1", &O::least_share, 0.0, 1.0,
       "judgement: formulas are good to some per cent, the rest of a strong effect can resemble a "
       "weak one"},
      {"regressor_noise", "1", &O::regressor_noise, 0.0, 1.0,
       "judgement: share of a regressor that is noise, at most; less where less of it is "
       "unforeseen"},
      {"clear_odds", "nats", &O::clear_odds, 0.0, 50.0,
       "ln 100: likelihood ratio that chance exceeds once in a hundred times at most"},
      {"form_share", "1", &O::form_share, 0.0, 1.0,
       "judgement: of an effect's gain, what a function that copies its formula may take"},
      {"large_share", "1", &O::large_share, 0.0, 1.0,
       "judgement: an effect with less of the largest gain is looked at again about the larger"},
      {"telling_sigmas", "sigma", &O::telling_sigmas, 0.0, 20.0,
       "normal: a lead of three standard errors is chance once in 740 times (Vuong 1989)"},
      {"even_odds", "nats", &O::even_odds, 0.0, 50.0,
       "ln 20: an alternative's odds are one in twenty or better"},
      {"whiteness_p", "1", &O::whiteness_p, 0.0, 1.0,
       "judgement: real noise is never exactly a + b f^2"},
      {"noise_p", "1", &O::noise_p, 0.0, 1.0,
       "two-sided three sigma: above, noise explains the rest (in flight)"},
      {"least_structured", "1", &O::least_structured, 0.0, 1.0,
       "judgement: a smaller share of the variance changes the RMS by less than 3 %"},
      {"most_unexplained", "1", &O::most_unexplained, 0.0, 1.0,
       "judgement: what explains less than half of the structure is not its cause; a valley of the "
       "same effect that promises less than half is not fitted"},
      {"most_lean_rad", "rad", &O::most_lean_rad, 0.0, 0.2,
       "judgement: roll and pitch of an onboard filter err by a degree, over seconds"},
      {"most_thrust_wander", "1", &O::most_thrust_wander, 0.0, 0.2,
       "judgement: of the weight; 5 mg, an accelerometer's bias over 10 to 20 K (0.25 to 0.5 "
       "mg/K), "
       "and a k_f over the air's temperature (0.3 % per K)"},
      {"telling_ratio", "1", &O::telling_ratio, 0.0, 1.0,
       "judgement: effects that leave most of the structure stay if they halve the error of some "
       "axis on held-out blocks; an axis whose error doubles is ruined (chance does that once in "
       "thirty times: F test of eight errors)"},
      {"least_ratio", "1", &O::least_ratio, 0.0, 1.0,
       "judgement: the figures of two online runs differ by some 3 %"},
      {"gust_price", "nats", &O::gust_price, 0.0, 100.0,
       "judgement: gusts pay for their sizes and correlation time, and for models that are not "
       "exact"},
      {"significant_sigmas", "sigma", &O::significant_sigmas, 0.0, 20.0,
       "normal: noise alone exceeds three sigma once in 370 times"},
      {"least_size_sigmas", "sigma", &O::least_size_sigmas, 0.0, 20.0,
       "judgement: a size that is nearer to zero than its standard deviation is none"},
      {"known_thrust_share", "1", &O::known_thrust_share, 0.0, 1.0,
       "judgement: mass and k_f cannot be told apart, and less than 5 % of mass is not sought"},
      {"opposite_share", "1", &O::opposite_share, 0.0, 0.5,
       "of several flights: an effect with the other sign on one flight in ten is not a property "
       "of the vehicle"},
  };
  return numbers;
}

void SetDecision(const std::string& assignment, AttributionOptions* options) {
  const size_t equals = assignment.find('=');
  const std::string name = assignment.substr(0, equals);
  std::vector<std::string> names;
  for (const DecisionNumber& number : DecisionNumbers()) {
    names.push_back(number.name);
    if (number.name != name || equals == std::string::npos) continue;
    const std::string text = assignment.substr(equals + 1);
    char* end = nullptr;
    const double value = std::strtod(text.c_str(), &end);
    const bool is_int = std::holds_alternative<int AttributionOptions::*>(number.member);
    const bool sound = !text.empty() && *end == '\0' && value >= number.least &&
                       value <= number.most && (!is_int || value == std::floor(value));
    if (!sound) {
      throw std::invalid_argument("--decision " + assignment + ": " + name + " must be " +
                                  (is_int ? "a whole number" : "a number") + " from " +
                                  Format("%g", number.least) + " to " + Format("%g", number.most));
    }
    std::visit(
        [&](auto m) { options->*m = static_cast<std::decay_t<decltype(options->*m)>>(value); },
        number.member);
    return;
  }
  throw std::invalid_argument("--decision " + assignment + ": give NAME=VALUE, NAME one of " +
                              Listed(names));
}

std::string DescribeDecision() {
  std::string text = "Numbers of the decision (--decision NAME=VALUE):\n";
  for (const DecisionNumber& number : DecisionNumbers()) {
    text += Format("  %-18s %9s %-7s %s\n", number.name.c_str(), number.TextOf({}).c_str(),
                   number.unit.c_str(), number.why.c_str());
  }
  return text;
}

std::string DescribeChanges(const AttributionOptions& options) {
  std::vector<std::string> changes;
  for (const DecisionNumber& number : DecisionNumbers()) {
    if (number.Of(options) == number.Of({})) continue;
    changes.push_back(number.name + " " + number.TextOf(options));
  }
  return Listed(changes, "defaults");
}

}  // namespace odmc
