#include "odmc/attribution/gust_case.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

#include "odmc/math/statistics.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kSlightestGust_m_s = 0.1;  // slighter ones through much drag are a force, no wind
constexpr double kTooLarge = 4.0;           // natural sizes
constexpr int kAhead = 3;                   // samples of 40 ms that a prediction has not seen
constexpr int kLeastBlocks = 6;             // of time, to tell a scatter

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

/// What gusts gain over noise once they have paid for what they fit [nats]. A gain goes with the
/// variance that it explains: what is an error of one sensor is none of theirs.
double NetGain(const GustTest& gust, double acting_share, const AttributionOptions& options) {
  return acting_share * gust.gain - options.gust_price;
}

/// Whether gusts beat noise by more than chance does.
bool BeatNoise(const GustTest& gust, double acting_share, const AttributionOptions& options) {
  return std::sqrt(acting_share) * gust.sigma_m_s > kSlightestGust_m_s &&
         NetGain(gust, acting_share, options) > -std::log(options.false_alarm_rate);
}

/// What a rival has to lead by [nats]: how drag makes a force of wind is known but to some share,
/// as the form of any effect is.
double LeadOfRival(const GustTest& gust, const AttributionOptions& options) {
  return options.clear_odds + options.least_share * std::max(0.0, gust.gain);
}

/// Log-likelihood ratio of gusts to knocks, at most: knocks that are sure to look as peaked.
double OverKnocks(const GustTest& gust) { return std::log(gust.peakedness_p); }

/// Of gusts over the best of their rivals [nats].
double OverRivals(const GustTest& gust) {
  return std::min({gust.over_others, gust.over_place, OverKnocks(gust)});
}

/// What speaks against gusts that beat noise; of free forces that explain the same, too.
/// @param again what a second sensor shows of them
std::vector<std::string> RemarksOn(const GustCase& gusts,
                                   const std::optional<SecondSensorShare>& again, bool by_motion,
                                   const AttributionOptions& options) {
  const GustTest& gust = gusts.test;
  if (!BeatNoise(gust, 1.0, options)) return {};
  if (again && !BeatNoise(gust, gusts.acting_share, options)) {
    const std::string shows =
        Rounded(100.0 * again->share) + " +- " + Rounded(100.0 * again->sigma) + " % of it";
    return {by_motion ? "not named: the accelerometer feels " + shows +
                            "; an odometry that leans slowly shows all"
                      : "not named: the motion shows " + shows +
                            "; an accelerometer whose bias wanders shows all"};
  }
  const double net = NetGain(gust, gusts.acting_share, options);
  std::vector<std::string> remarks;
  if (net <= gusts.functions) {
    remarks.push_back("not named: functions of the state gain more, " + Rounded(gusts.functions) +
                      " nats against " + Rounded(net));
  }
  if (gust.over_others <= -LeadOfRival(gust, options)) {
    remarks.push_back("not named: a force that no wind makes explains the same better, by " +
                      Rounded(-gust.over_others) + " nats");
  } else if (gust.over_others < options.clear_odds) {
    remarks.push_back("a force of its own that varies slowly explains the same about as well");
  }
  if (gust.over_place <= -LeadOfRival(gust, options)) {
    remarks.push_back("not named: a force that follows the place explains the same better, by " +
                      Rounded(-gust.over_place) + " nats");
  }
  if (OverKnocks(gust) <= -LeadOfRival(gust, options)) {
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

/// What the sensor that the test does not look at shows of the gusts that are foreseen.
std::optional<SecondSensorShare> SeenByOther(const ResidualModel& residual,
                                             const DynamicModel& model, const ModelValues& values,
                                             const GustCase& gusts,
                                             const std::vector<DragCoefficient>& drag) {
  if (gusts.foreseen.rows() == 0) return std::nullopt;
  Eigen::MatrixX2d again = residual.AcrossByOther(model, values);
  if (again.rows() == 0) return std::nullopt;
  for (Eigen::Index i = 0; i < gusts.test.drag.size(); ++i) {
    again -= gusts.test.drag[i] * drag[static_cast<size_t>(i)].d_wrench.leftCols<2>();
  }
  return ShareInSecondSensor(residual.flight(), gusts.foreseen.leftCols<2>(), again);
}

}  // namespace

// Of the uniform prior's part, mean and evidence are those of a normal density between 0 and 1.
double SecondSensorShare::ActingShare() const {
  const auto density = [](double z) { return std::exp(-0.5 * z * z) / std::sqrt(2.0 * M_PI); };
  const auto below = [](double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); };
  const double none = -share / sigma, all = (1.0 - share) / sigma;
  const double evidence_all = density(all) / sigma;
  const double evidence_some = below(all) - below(none);
  const double first_moment = share * evidence_some + sigma * (density(none) - density(all));
  const double evidence = evidence_all + evidence_some;
  // Far beyond either end all densities vanish.
  if (!(evidence > 1e-300)) return share > 0.5 ? 1.0 : 0.0;
  return std::clamp((evidence_all + first_moment) / evidence, 0.0, 1.0);
}

std::optional<SecondSensorShare> ShareInSecondSensor(const ThinnedFlight& flight,
                                                     const Eigen::MatrixX2d& foreseen,
                                                     const Eigen::MatrixX2d& again) {
  if (again.rows() == 0 || foreseen.isZero(0.0)) return std::nullopt;
  const Eigen::MatrixX2d f = foreseen.rowwise() - foreseen.colwise().mean();
  const Eigen::MatrixX2d a = again.rowwise() - again.colwise().mean();
  const double square = f.squaredNorm();
  SecondSensorShare seen;
  seen.share = f.cwiseProduct(a).sum() / square;
  const Eigen::MatrixX2d rest = a - seen.share * f;
  std::map<int, double> blocks;
  for (int i = 0; i < flight.size(); ++i) blocks[flight.block(i)] += f.row(i).dot(rest.row(i));
  const auto n = static_cast<double>(blocks.size());
  if (n < kLeastBlocks) return std::nullopt;
  double scatter = 0.0;
  for (const auto& entry : blocks) scatter += entry.second * entry.second;
  // Few blocks may agree by chance: noise that is the same at all samples is the least there is.
  const double samples = 2.0 * static_cast<double>(flight.size());
  seen.sigma = std::max(std::sqrt(scatter * n / (n - 1.0)) / square,
                        std::sqrt(rest.squaredNorm() / (square * samples)));
  return seen;
}

GustCase RankGusts(const ResidualModel& residual, const ModelPoint& point,
                   const ResidualModel::Wrenches& left, const ParameterSet& declared,
                   double functions, const AttributionOptions& options, int jobs) {
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
  gusts.test = TestGusts(residual.flight(), left, d_wind, drag, PriorOf(point.vehicle), jobs);
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
  if (BeatNoise(gust, 1.0, options)) {
    gusts.foreseen = ForeseenWrench(residual.flight(), gust, left, d_wind, drag);
  }
  const std::optional<SecondSensorShare> again = SeenByOther(residual, model, values, gusts, drag);
  if (again) gusts.acting_share = again->ActingShare();
  RankedEffect& ranked = gusts.ranked;
  ranked.name = "gust";
  ranked.score = gust.gain;
  const double net = NetGain(gust, gusts.acting_share, options);
  ranked.p_value = std::exp(-std::max(0.0, net));
  // Wind is known to act on vehicles, a free force is not.
  const double over_rival = OverRivals(gust) + LeadOfRival(gust, options);
  ranked.probability = 1.0 / (1.0 + std::exp(-net) + std::exp(-over_rival));
  ranked.remarks = RemarksOn(gusts, again, residual.across_by_motion(), options);
  const auto state = [&](const std::string& name, const std::string& unit, double value,
                         double error) {
    ranked.settings[name] = value;
    ranked.parameters.push_back(
        {name, unit, value, value * LogNormalDeviation(error), true, error < 1.0});
  };
  state("gust.sigma", "m/s", std::max(kSlightestGust_m_s, gust.sigma_m_s), gust.sigma_error);
  state("gust.vertical_sigma", "m/s", std::max(0.01, gust.vertical_sigma_m_s),
        gust.vertical_sigma_error);
  state("gust.time_constant", "s", std::max(0.1, gust.time_constant_s), gust.time_constant_error);
  return gusts;
}

bool IsGusty(const GustCase& gusts, const AttributionOptions& options) {
  return BeatNoise(gusts.test, gusts.acting_share, options) &&
         NetGain(gusts.test, gusts.acting_share, options) > gusts.functions &&
         OverRivals(gusts.test) > -LeadOfRival(gusts.test, options);
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
