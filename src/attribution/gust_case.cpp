#include "odmc/attribution/gust_case.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "odmc/model/dynamic_model.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kSlightestGust_m_s = 0.1;  // slighter ones through much drag are a force, no wind
constexpr double kTooLarge = 4.0;           // natural sizes
constexpr int kAhead = 3;                   // samples of 40 ms that a prediction has not seen

/// How the predicted wrench answers the wind of an effect.
WindDerivatives ByWind(const ResidualModel& residual, const DynamicModel& model,
                       const ModelValues& values, const std::string& effect) {
  WindDerivatives d_wind;
  for (int k = 0; k < 3; ++k) {
    d_wind[k] = residual.Derivative(model, values, model.IndexOf(effect + ".w_" + "xyz"[k]));
  }
  return d_wind;
}

/// The coefficients that shape how the wrench answers wind.
std::vector<DragCoefficient> DragOf(const ResidualModel& residual, const DynamicModel& model,
                                    const ModelValues& values, const WindDerivatives& d_wind) {
  constexpr double kDifference = 0.1;  // of a natural size
  constexpr double kMatters = 0.01;    // a natural size changes the answer by this share
  const auto size = [](const WindDerivatives& d) {
    double sum = 0.0;
    for (const ResidualModel::Wrenches& along : d) sum += along.leftCols<3>().squaredNorm();
    return std::sqrt(sum);
  };
  std::vector<DragCoefficient> drag;
  for (size_t i = 0; i < model.parameters().size(); ++i) {
    const ModelParameter& parameter = model.parameters()[i];
    const ParameterSpec& spec = parameter.spec;
    const int index = static_cast<int>(i);
    if (!parameter.estimated || parameter.effect == "wind") continue;
    if (spec.initial_state || spec.prior_sigma <= 0.0) continue;
    ModelValues moved = values;
    moved[index] += kDifference * spec.prior_sigma;
    DragCoefficient c;
    c.index = index;
    c.natural_size = spec.prior_sigma;
    c.d_wind = ByWind(residual, model, moved, "wind");
    for (int k = 0; k < 3; ++k) c.d_wind[k] = (c.d_wind[k] - d_wind[k]) / kDifference;
    c.d_wrench = spec.prior_sigma * residual.Derivative(model, values, index);
    if (c.d_wrench.leftCols<3>().isZero()) continue;
    if (size(c.d_wind) < kMatters * size(d_wind)) {
      c.d_wind.fill(ResidualModel::Wrenches::Zero(residual.flight().size(), kNumChannels));
    }
    const double to_zero = -values[index] / spec.prior_sigma;
    c.least = spec.sign == PhysicalSign::kPositive ? std::min(0.0, to_zero) : -kTooLarge;
    c.most = spec.sign == PhysicalSign::kNegative ? std::max(0.0, to_zero) : kTooLarge;
    drag.push_back(std::move(c));
  }
  return drag;
}

/// Estimated parameters that change the force.
std::vector<std::string> ActingOnForce(const ResidualModel& residual, const DynamicModel& model,
                                       const ModelValues& values) {
  std::vector<std::string> names;
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    if (!p.estimated || p.spec.initial_state || p.effect == "wind") continue;
    if (residual.Derivative(model, values, i).leftCols<3>().isZero()) continue;
    names.push_back(p.full_name);
  }
  return names;
}

/// What the catalogue says of the correlation time.
TimeConstantPrior PriorOf(const Vehicle& vehicle) {
  const std::unique_ptr<Effect> gust = EffectRegistry::Default().Make("gust", vehicle);
  for (const ParameterSpec& spec : gust->parameters()) {
    if (spec.name == "time_constant")
      return {spec.prior_value, spec.prior_sigma / spec.prior_value};
  }
  return {};
}

/// What gusts gain over noise once they have paid for what they fit [nats].
double NetGain(const GustTest& gust, const AttributionOptions& options) {
  return gust.gain - options.gust_price;
}

/// Whether gusts beat noise by more than chance does.
bool BeatNoise(const GustTest& gust, const AttributionOptions& options) {
  return gust.sigma_m_s > kSlightestGust_m_s &&
         NetGain(gust, options) > -std::log(options.false_alarm_rate);
}

/// What speaks against gusts that beat noise; of free forces that explain the same, too.
std::vector<std::string> RemarksOn(const GustTest& gust, double functions,
                                   const AttributionOptions& options) {
  if (!BeatNoise(gust, options)) return {};
  std::vector<std::string> remarks;
  if (NetGain(gust, options) <= functions) {
    remarks.push_back("not named: functions of the state gain more, " + Rounded(functions) +
                      " nats against " + Rounded(NetGain(gust, options)));
  }
  if (gust.over_others <= -options.clear_odds) {
    remarks.push_back("not named: a force that no wind makes explains the same better, by " +
                      Rounded(-gust.over_others) + " nats");
  } else if (gust.over_others < options.clear_odds) {
    remarks.push_back("a force of its own that varies slowly explains the same about as well");
  }
  if (gust.over_field <= options.clear_odds) {
    remarks.push_back("not named: a force that follows the place explains the same " +
                      (gust.over_field > -options.clear_odds
                           ? std::string("about as well")
                           : "better, by " + Rounded(-gust.over_field) + " nats"));
  }
  if (gust.peakedness_p <= options.false_alarm_rate) {
    remarks.push_back("not named: it comes in knocks, which gusts do at a chance of " +
                      Rounded(gust.peakedness_p));
  }
  return remarks;
}

/// What gusts do to the wrench, as foreseen by the samples before.
ResidualModel::Wrenches ForeseenWrench(const ThinnedFlight& flight, const GustTest& gust,
                                       ResidualModel::Wrenches left, WindDerivatives d_wind,
                                       const std::vector<DragCoefficient>& drag) {
  for (Eigen::Index i = 0; i < gust.drag.size(); ++i) {
    const DragCoefficient& c = drag[static_cast<size_t>(i)];
    left -= gust.drag[i] * c.d_wrench;
    for (size_t k = 0; k < 3; ++k) d_wind[k] += gust.drag[i] * c.d_wind[k];
  }
  const std::vector<Eigen::Vector3d> wind =
      PredictGusts(flight, left, d_wind,
                   {gust.sigma_m_s, gust.sigma_m_s, std::max(0.01, gust.vertical_sigma_m_s)},
                   std::max(0.1, gust.time_constant_s), kAhead);
  ResidualModel::Wrenches wrench = ResidualModel::Wrenches::Zero(flight.size(), kNumChannels);
  for (int i = 0; i < flight.size(); ++i) {
    for (size_t k = 0; k < 3; ++k) {
      wrench.row(i) +=
          wind[static_cast<size_t>(i)][static_cast<Eigen::Index>(k)] * d_wind[k].row(i);
    }
  }
  return wrench;
}

}  // namespace

GustCase RankGusts(const ResidualModel& residual, const ModelPoint& point,
                   const ResidualModel::Wrenches& left, const ParameterSet& declared,
                   double functions, const AttributionOptions& options) {
  Vehicle airy = point.vehicle;
  const bool has_wind =
      std::find(airy.effects.begin(), airy.effects.end(), "wind") != airy.effects.end();
  if (!has_wind) airy.effects.push_back("wind");
  const DynamicModel model(airy, airy.effects);
  const ModelValues values = ValuesOf(model, point.values);
  const WindDerivatives d_wind = ByWind(residual, model, values, "wind");
  const std::vector<DragCoefficient> drag = DragOf(residual, model, values, d_wind);
  GustCase gusts;
  gusts.functions = functions;
  gusts.test = TestGusts(residual.flight(), left, d_wind, drag, PriorOf(point.vehicle));
  const GustTest& gust = gusts.test;
  // The mean of gusts over a few correlation times is not zero, and looks like all that acts on the
  // force: the estimate without them says more of it.
  for (const std::string& name : ActingOnForce(residual, model, values)) {
    const ParameterEstimate* p = declared.Find(name);
    if (p == nullptr || !p->estimated || !(p->sigma > 0.0)) continue;
    gusts.known[name] = {p->value, p->sigma, {}};
  }
  for (Eigen::Index i = 0; i < gust.drag.size(); ++i) {
    const DragCoefficient& c = drag[i];
    gusts.known[model.parameters()[c.index].full_name] = {
        values[c.index] + gust.drag[i] * c.natural_size, gust.drag_sigma[i] * c.natural_size, {}};
  }
  if (BeatNoise(gust, options)) {
    gusts.foreseen = ForeseenWrench(residual.flight(), gust, left, d_wind, drag);
  }
  RankedEffect& ranked = gusts.ranked;
  ranked.name = "gust";
  ranked.score = gust.gain;
  const double net = NetGain(gust, options);
  ranked.p_value = std::exp(-std::max(0.0, net));
  // Wind is known to act on vehicles, a free force is not; what stands in one place (an updraft, a
  // tether) is, and the two predict very different forces.
  const double over_rival = gust.over_others + options.clear_odds;
  ranked.probability =
      1.0 / (1.0 + std::exp(-net) + std::exp(-over_rival) + std::exp(-gust.over_field));
  ranked.remarks = RemarksOn(gust, functions, options);
  const auto state = [&](const std::string& name, const std::string& unit, double value,
                         double error) {
    ranked.settings[name] = value;
    ranked.parameters.push_back({name, unit, value, error * value, true, error < 1.0});
  };
  state("gust.sigma", "m/s", std::max(kSlightestGust_m_s, gust.sigma_m_s), gust.sigma_error);
  state("gust.vertical_sigma", "m/s", std::max(0.01, gust.vertical_sigma_m_s),
        gust.vertical_sigma_error);
  state("gust.time_constant", "s", std::max(0.1, gust.time_constant_s), gust.time_constant_error);
  return gusts;
}

bool IsGusty(const GustCase& gusts, const AttributionOptions& options) {
  return BeatNoise(gusts.test, options) && NetGain(gusts.test, options) > gusts.functions &&
         gusts.test.over_others > -options.clear_odds &&
         gusts.test.over_field > options.clear_odds &&
         gusts.test.peakedness_p > options.false_alarm_rate;
}

ValueVariation PredictedGusts(const FlightLog& log, const Vehicle& file_vehicle,
                              const DynamicModel& model, const ModelValues& estimate,
                              const std::vector<std::pair<Stamp, Stamp>>& ground_spans,
                              bool with_torque) {
  const ThinnedFlight flight(FilterFlight(log, file_vehicle.num_rotors(), ground_spans), {2.5, 1},
                             file_vehicle.odometry.q_BS.toRotationMatrix());
  const ResidualModel residual(&flight, &file_vehicle, with_torque);
  ModelValues still = estimate;
  std::array<int, 3> w{};
  for (int k = 0; k < 3; ++k) {
    w[k] = model.IndexOf(std::string("gust.w_") + "xyz"[k]);
    still[w[k]] = 0.0;
  }
  const std::vector<Eigen::Vector3d> wind =
      PredictGusts(flight, residual.Residual(model, still), ByWind(residual, model, still, "gust"),
                   {estimate[model.IndexOf("gust.sigma")], estimate[model.IndexOf("gust.sigma")],
                    estimate[model.IndexOf("gust.vertical_sigma")]},
                   estimate[model.IndexOf("gust.time_constant")], kAhead);
  std::vector<double> times;
  times.reserve(static_cast<size_t>(flight.size()));
  for (int i = 0; i < flight.size(); ++i) times.push_back(flight.sample(i).t_s);
  return [wind, times, w](double t_s, ModelValues* values) {
    const auto it = std::upper_bound(times.begin(), times.end(), t_s + 1e-6);
    for (int k = 0; k < 3; ++k) {
      (*values)[w[k]] = it == times.begin() ? 0.0 : wind[it - times.begin() - 1][k];
    }
  };
}

}  // namespace odmc
