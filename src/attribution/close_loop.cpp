#include "odmc/attribution/close_loop.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>

#include "odmc/analysis/calibration.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/gust_test.h"
#include "odmc/attribution/online_evidence.h"
#include "odmc/attribution/structure.h"
#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr int kLeastSamples = 50;           // to look for effects in
constexpr double kSlightestGust_m_s = 0.1;  // slighter ones through much drag are a force, no wind
constexpr double kTooLarge = 4.0;           // natural sizes

std::string Where(const std::vector<ChannelStructure>& structure, const ThinnedFlight& flight,
                  const ResidualModel::Wrenches& residual) {
  if (structure.empty()) return "";
  const auto worst = std::min_element(structure.begin(), structure.end(), [](auto& a, auto& b) {
    return std::make_pair(a.whiteness.p, -a.whiteness.structured_share) <
           std::make_pair(b.whiteness.p, -b.whiteness.structured_share);
  });
  const auto c = static_cast<Eigen::Index>(worst - structure.begin());
  std::map<int, std::pair<double, int>> power;
  for (int i = 0; i < flight.size(); ++i) {
    power[flight.block(i)].first += residual(i, c) * residual(i, c);
    ++power[flight.block(i)].second;
  }
  int block = 0;
  double most = 0.0;
  for (const auto& [b, sum] : power) {
    if (sum.first / sum.second > most) {
      most = sum.first / sum.second;
      block = b;
    }
  }
  const auto quantity = std::max_element(worst->dependence.begin(), worst->dependence.end(),
                                         [](auto& a, auto& b) { return a.second < b.second; });
  std::string text =
      worst->name + ", strongest near " + Rounded(worst->whiteness.peak_Hz) + " Hz and in ";
  text += "block " + std::to_string(block) + " (RMS " + Rounded(std::sqrt(most)) + " " +
          worst->unit + ")";
  return text + "; of the quantities it lines up best with " + quantity->first + " (" +
         Rounded(100.0 * quantity->second) + " % of its variance)";
}

/// True if parameters differ from zero together by `sigmas` (Wald's test; the limit
/// grows with their number).
bool IsSignificant(const Eigen::VectorXd& estimate, const Eigen::MatrixXd& covariance,
                   double sigmas) {
  Eigen::MatrixXd C = covariance;
  C.diagonal() *= 1.0 + 1e-9;
  return estimate.dot(C.ldlt().solve(estimate)) >
         sigmas * sigmas + 2.0 * (static_cast<double>(estimate.size()) - 1.0);
}

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
    if (size(c.d_wind) < kMatters * size(d_wind)) continue;
    c.d_wrench = spec.prior_sigma * residual.Derivative(model, values, index);
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

/// Gusts as a Kalman filter predicts them, each from before the sample's own filter window. (The
/// estimator's window takes a parameter for constant over its length and lags by half of that.)
ValueVariation GustsOf(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
                       const ModelValues& estimate,
                       const std::vector<std::pair<Stamp, Stamp>>& ground_spans, bool with_torque) {
  constexpr int kAhead = 3;  // samples of 40 ms
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

/// What a prediction misses at one sample: of force and torque, in the vehicle file's body axes.
struct Miss {
  double t_s, speed_m_s;
  Eigen::Vector3d force, torque;
};

/// One pass of the online estimator, blocks held out, with what it misses of everything.
struct Pass {
  ReplayResult replay;  ///< without its history and timing
  ParameterSet parameters;
  std::vector<Miss> misses;
  PredictionFigures held_out;  ///< on blocks held out
};

/// @returns nothing if the vehicle never flies as the model has it
std::optional<Pass> Run(const FlightLog& log, const Vehicle& file_vehicle,
                        const DynamicModel& model, const EstimatorOptions& options,
                        const CloseLoopOptions& loop, const std::function<void(double)>& progress) {
  Pass pass;
  const bool with_torque = !log.rotor_rms_only;
  Estimator estimator(&model, options, with_torque);
  const Stamp first = log.odometry.empty() ? 0 : log.odometry.front().stamp;
  estimator.SetHeldOut(
      [=](Stamp stamp) { return loop.blocks.IsHeldOut(ToSeconds(stamp - first)); });
  pass.replay = Replay(log, &estimator, progress);
  pass.replay.history = {};
  pass.replay.timing = {};
  if (!pass.replay.last) return std::nullopt;
  pass.parameters = Estimator::ToParameterSet(model, *pass.replay.last);
  const ModelValues& values = pass.replay.last->values;
  const ValueVariation vary =
      !model.processes().empty()
          ? GustsOf(log, file_vehicle, model, values, pass.replay.ground_spans, with_torque)
          : ValueVariation();
  std::vector<PredictionSample> unseen;
  PredictEach(log, file_vehicle, model, values, pass.replay.ground_spans, vary,
              [&](const PredictionSample& s) {
                pass.misses.push_back({s.t_s, s.speed_m_s, s.measured_force - s.predicted_force,
                                       s.measured_torque - s.predicted_torque});
                if (!loop.blocks.IsHeldOut(s.t_s)) return;
                unseen.push_back(s);
                unseen.back().effects = {};
              });
  pass.held_out = SummarisePrediction(unseen, with_torque, file_vehicle, model, values);
  return pass;
}

/// Indices in an online estimate of an effect's estimated parameters, initial states left out.
std::vector<Eigen::Index> EstimatesOf(const RankedEffect& effect, const ParameterSet& online,
                                      const DynamicModel& model) {
  std::vector<Eigen::Index> own;
  for (const ParameterEstimate& p : effect.parameters) {
    const ParameterEstimate* found = online.Find(p.full_name);
    if (found == nullptr || !found->estimated) continue;
    if (model.parameters()[model.IndexOf(p.full_name)].spec.initial_state) continue;
    own.push_back(found - online.parameters.data());
  }
  return own;
}

/// The case for gusts, and the values of the drag that goes with them.
struct Gusts {
  RankedEffect ranked;
  GustTest test;
  std::map<std::string, ParameterSetting> known;  // what it is known of others, by full name
};

/// The case for gusts behind what a model leaves; they vary, so that no fixed regressor shows them.
/// @param declared the online estimate without effects added
Gusts RankGusts(const ResidualModel& residual, const Stage& stage,
                const ResidualModel::Wrenches& left, const ParameterSet& declared) {
  Vehicle airy = stage.vehicle;
  const bool has_wind =
      std::find(airy.effects.begin(), airy.effects.end(), "wind") != airy.effects.end();
  if (!has_wind) airy.effects.push_back("wind");
  const DynamicModel model(airy, airy.effects);
  const ModelValues values = ValuesOf(model, stage.values);
  const WindDerivatives d_wind = ByWind(residual, model, values, "wind");
  const std::vector<DragCoefficient> drag = DragOf(residual, model, values, d_wind);
  Gusts gusts;
  gusts.test = TestGusts(residual.flight(), left, d_wind, drag);
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
  RankedEffect& ranked = gusts.ranked;
  ranked.name = "gust";
  ranked.score = gust.gain;
  ranked.settings = {{"gust.sigma", std::max(kSlightestGust_m_s, gust.sigma_m_s)},
                     {"gust.vertical_sigma", std::max(0.01, gust.vertical_sigma_m_s)},
                     {"gust.time_constant", std::max(0.1, gust.time_constant_s)}};
  for (const auto& [name, value] : ranked.settings) {
    ranked.parameters.push_back(
        {name, name == "gust.time_constant" ? "s" : "m/s", value, 0.0, false, false});
  }
  return gusts;
}

/// True if a slow disturbance of the force is the wind's doing rather than any other's.
bool IsGusty(const Gusts& gusts, const AttributionOptions& options) {
  return gusts.test.sigma_m_s > kSlightestGust_m_s &&
         gusts.test.gain > -std::log(options.false_alarm_rate) + options.gust_price &&
         gusts.test.over_others > -std::log(options.false_alarm_rate);
}

bool HasEffect(const std::vector<RankedEffect>& effects, const std::string& name) {
  return std::any_of(effects.begin(), effects.end(),
                     [&](const RankedEffect& e) { return e.name == name; });
}

/// Gusts are wind that comes and goes: not beside itself.
bool CanBlow(const Vehicle& vehicle, const std::vector<RankedEffect>& effects) {
  const bool has =
      std::find(vehicle.effects.begin(), vehicle.effects.end(), "gust") != vehicle.effects.end();
  return !has && !HasEffect(effects, "gust");
}

/// Smallest ratio of errors, after over before, of any axis.
/// @param felt true if the force that an accelerometer feels counts, too (a velocity's derivative
/// may be mostly noise)
double LeastRatio(const PredictionFigures& before, const PredictionFigures& after,
                  bool felt = false) {
  double least = 1.0;
  for (const auto axes : {&PredictionFigures::force_rmse_N, &PredictionFigures::torque_rmse_Nm,
                          &PredictionFigures::accelerometer_force_rmse_N}) {
    if (axes == &PredictionFigures::accelerometer_force_rmse_N && !felt) continue;
    if (!(before.*axes) || !(after.*axes)) continue;
    for (int k = 0; k < 3; ++k) {
      least = std::min(least, (*(after.*axes))[k] / std::max(1e-300, (*(before.*axes))[k]));
    }
  }
  return least;
}

/// True if the online estimate of an effect differs from zero, or says nothing of it.
bool IsThere(const RankedEffect& effect, const ParameterSet& online, const DynamicModel& model,
             const AttributionOptions& options) {
  std::vector<Eigen::Index> own = EstimatesOf(effect, online, model);
  own.erase(std::remove_if(own.begin(), own.end(),
                           [&](Eigen::Index i) {
                             const auto& p = online.parameters[static_cast<size_t>(i)];
                             return !TellsSize(model.vehicle(), p.full_name);
                           }),
            own.end());
  if (own.empty()) return true;
  Eigen::VectorXd estimate(static_cast<Eigen::Index>(own.size()));
  for (size_t k = 0; k < own.size(); ++k) {
    estimate[static_cast<Eigen::Index>(k)] = online.parameters[static_cast<size_t>(own[k])].value;
  }
  return IsSignificant(estimate, online.covariance(own, own), options.significant_sigmas);
}

/// What the online run says of an effect, " name = value +- sigma, ...".
std::string Estimates(const RankedEffect& effect, const ParameterSet& online,
                      const DynamicModel& model) {
  std::string text;
  for (const Eigen::Index i : EstimatesOf(effect, online, model)) {
    const ParameterEstimate& p = online.parameters[static_cast<size_t>(i)];
    text += (text.empty() ? " " : ", ") + p.full_name + " = " + Rounded(p.value) + " +- " +
            Rounded(p.sigma);
  }
  return text;
}

/// How much an online estimate that is zero within its sigma speaks against what the regression
/// found [nats].
double NatsAgainst(const RankedEffect& effect, const ParameterSet& online,
                   const DynamicModel& model) {
  const std::vector<Eigen::Index> own = EstimatesOf(effect, online, model);
  const auto n = static_cast<Eigen::Index>(own.size());
  if (n == 0 || effect.covariance.rows() != n) return std::numeric_limits<double>::infinity();
  Eigen::VectorXd difference(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const ParameterEstimate& p =
        online.parameters[static_cast<size_t>(own[static_cast<size_t>(k)])];
    difference[k] = p.value - effect.Find(p.full_name)->value;
  }
  Eigen::MatrixXd C = online.covariance(own, own) + effect.covariance;
  C.diagonal() *= 1.0 + 1e-9;
  return 0.5 * difference.dot(C.ldlt().solve(difference));
}

FlightFigures FlownFlight(const FlightLog& log, const ReplayResult& replay) {
  FlightFigures figures;
  figures.file = log.file;
  figures.duration_s = ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp);
  figures.on_ground_s = replay.counters.on_ground_s;
  figures.keyframes = replay.counters.keyframes;
  figures.dropped =
      log.dropped + replay.stream_counters.not_finite + replay.stream_counters.out_of_order;
  return figures;
}

std::vector<LoopSample> Samples(const std::vector<Miss>& before, const std::vector<Miss>& after,
                                const BlockSplit& blocks) {
  std::vector<LoopSample> samples;
  const size_t n = std::min(before.size(), after.size());
  samples.reserve(n);
  for (size_t i = 0; i < n; ++i) {
    const Miss &b = before[i], &a = after[i];
    LoopSample sample{b.t_s, blocks.IsHeldOut(b.t_s), b.speed_m_s, {}, {}};
    for (int k = 0; k < 3; ++k) {
      sample.before[k] = b.force[k];
      sample.before[k + 3] = b.torque[k];
      sample.after[k] = a.force[k];
      sample.after[k + 3] = a.torque[k];
    }
    samples.push_back(sample);
  }
  return samples;
}

/// Fills in what share of the residual is structured, and how surely. @returns true if some is
bool Summarise(const AttributionOptions& options, ClosedLoop* result) {
  bool structured = false;
  const auto n = static_cast<double>(result->structure.size());
  for (const ChannelStructure& channel : result->structure) {
    const Whiteness& whiteness = channel.whiteness;
    result->structured_share = std::max(result->structured_share, whiteness.structured_share);
    result->whiteness_p = std::min(result->whiteness_p, n * whiteness.p);
    structured = structured || IsStructured(channel, options);
  }
  return structured;
}

}  // namespace

std::vector<std::pair<Stamp, Stamp>> NotLookedAt(const ReplayResult& replay) {
  Stamp contact = 0, flying = 0;
  std::vector<std::pair<Stamp, Stamp>> others;
  for (const PhaseSpan& span : replay.phases) {
    if (span.phase == FlightPhase::kInContact) {
      contact += span.to - span.from;
    } else if (Teaches(span.phase)) {
      flying += span.to - span.from;
    } else {
      others.emplace_back(span.from, span.to);
    }
  }
  return contact > flying ? others : replay.ground_spans;
}

std::string ToString(Verdict verdict) {
  switch (verdict) {
    case Verdict::kEffect:
      return "effect";
    case Verdict::kUnexplained:
      return "unexplained";
    default:
      return "none";
  }
}

std::string Disagreement(const RankedEffect& effect, const ParameterSet& online,
                         const DynamicModel& model, const AttributionOptions& options) {
  const std::vector<Eigen::Index> own = EstimatesOf(effect, online, model);
  const auto n = static_cast<Eigen::Index>(own.size());
  if (n == 0 || effect.covariance.rows() != n) return "";
  Eigen::MatrixXd covariance = online.covariance(own, own) + effect.covariance;
  Eigen::VectorXd difference(n);
  Eigen::Index worst = 0;
  double most = 0.0;
  for (Eigen::Index i = 0; i < n; ++i) {
    const ParameterEstimate& p = online.parameters[own[static_cast<size_t>(i)]];
    const double fitted = effect.Find(p.full_name)->value;
    difference[i] = p.value - fitted;
    const double share = options.agree_share * std::max(std::abs(p.value), std::abs(fitted));
    covariance(i, i) += share * share;
    const double sigmas = std::abs(difference[i]) / std::sqrt(covariance(i, i));
    if (sigmas < most) continue;
    most = sigmas;
    worst = i;
  }
  if (!IsSignificant(difference, covariance, options.significant_sigmas)) return "";
  const ParameterEstimate& p = online.parameters[own[static_cast<size_t>(worst)]];
  return "it finds " + p.full_name + " = " + Rounded(p.value) + ", the fit that chose the effect " +
         Rounded(p.value - difference[worst]);
}

void HoldKnownThrust(const AttributionOptions& options, Vehicle* vehicle) {
  const auto it = vehicle->parameters.find("thrust.k_f");
  if (it == vehicle->parameters.end() || !it->second.value || !it->second.sigma) return;
  const double limit = options.known_thrust_share * *it->second.value;
  if (*it->second.sigma < limit) it->second.estimated = false;
}

ClosedLoop CloseLoop(const FlightLog& log, const Vehicle& file_vehicle, const Vehicle& configured,
                     const CloseLoopOptions& given, const std::function<void(double)>& progress) {
  const Vehicle vehicle = WithPriorsOf(file_vehicle, configured);
  CloseLoopOptions options = given;
  if (!log.odometry.empty()) {
    options.blocks.FitTo(ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp));
  }
  const auto part = [&](double from, double to) {
    return [&progress, from, to](double share) {
      if (progress) progress(from + share * (to - from));
    };
  };
  ClosedLoop result;
  const bool with_torque = !log.rotor_rms_only;
  const DynamicModel declared(vehicle, vehicle.effects);
  const std::optional<Pass> as_declared =
      Run(log, file_vehicle, declared, options.estimator, options, part(0.0, 0.4));
  if (!as_declared) throw std::invalid_argument(log.file + ": never airborne");
  const Pass& before = *as_declared;
  const ReplayResult& replay = before.replay;
  result.declared_parameters = result.parameters = before.parameters;
  result.effect_names = vehicle.effects;
  result.before = result.after = before.held_out;
  result.warnings = FlightWarnings(log, replay);
  const std::string doubt = InertiaDoubt(file_vehicle);
  if (!doubt.empty()) result.warnings.push_back(doubt);
  result.flight = FlownFlight(log, replay);
  result.samples = Samples(before.misses, before.misses, options.blocks);

  const ThinnedFlight flight(FilterFlight(log, file_vehicle.num_rotors(), NotLookedAt(replay)),
                             options.blocks, file_vehicle.odometry.q_BS.toRotationMatrix(),
                             options.attribution.most_flight_s);
  int in_use = 0;
  for (int i = 0; i < flight.size(); ++i) in_use += flight.held_out(i) ? 0 : 1;
  if (in_use < kLeastSamples) {
    result.warnings.push_back("too little flight to look for effects: " + std::to_string(in_use) +
                              " samples of 40 ms, at least " + std::to_string(kLeastSamples) +
                              " are needed");
    return result;
  }
  const ResidualModel residual(&flight, &file_vehicle, with_torque);
  const std::vector<Candidate> candidates = CandidatesFor(vehicle, flight.motion());
  Attribution attribution(&residual, StageOf(declared, replay.last->values), candidates,
                          options.attribution);
  attribution.Run();
  result.ranking = attribution.ranking();
  result.named_gain = attribution.gain();
  result.flexible_gain = attribution.flexible_gain();
  result.structure = LessStructured(
      Structure(flight, attribution.residual_before(), residual.num_channels()),
      Structure(flight, residual.Residual(declared, replay.last->values), residual.num_channels()));
  const bool structured = Summarise(options.attribution, &result);
  const std::vector<std::vector<double>> runs = flight.Runs(attribution.residual_before().col(0));
  const bool judged = std::any_of(runs.begin(), runs.end(),
                                  [](const auto& run) { return run.size() >= kShortestRun; });
  if (!judged) {
    result.warnings.push_back(
        "no stretch without gaps is long enough to tell structure from noise: " +
        Rounded(kShortestRun * flight.step_s()) + " s are needed");
  }
  if (progress) progress(0.6);

  std::vector<RankedEffect> effects = attribution.effects();
  for (const auto& [name, why] : attribution.refused()) {
    const bool added = std::any_of(effects.begin(), effects.end(),
                                   [&name = name](const auto& e) { return e.name == name; });
    const auto ranked = std::find_if(result.ranking.begin(), result.ranking.end(),
                                     [&name = name](const auto& e) { return e.name == name; });
    if (!added && ranked != result.ranking.end()) ranked->remarks.push_back("not named: it " + why);
  }
  std::map<std::string, ParameterSetting> known;
  const Gusts gusts =
      RankGusts(residual, attribution.stage(), attribution.residual_after(), before.parameters);
  result.ranking.push_back(gusts.ranked);

  bool is_gusty = IsGusty(gusts, options.attribution) && CanBlow(vehicle, effects);
  const auto seen = [&](const ResidualModel::Wrenches& of) {
    return Structure(flight, of, residual.num_channels(), true);
  };
  const double unexplained = UnexplainedStructure(
      attribution.residual_before(), attribution.residual_after(),
      seen(attribution.residual_before()), seen(attribution.residual_after()), options.attribution);
  const auto run_with = [&](const std::vector<RankedEffect>& added, double to) {
    const Vehicle extended = Extended(vehicle, attribution.stage(), added, known);
    const DynamicModel model(extended, extended.effects);
    return Run(log, file_vehicle, model, options.estimator, options, part(0.6, to));
  };
  const auto drop_all = [&](const std::string& why) {
    for (const RankedEffect& effect : effects) {
      result.warnings.push_back(effect.name + " gains " + Rounded(effect.score) + " nats, but " +
                                why);
    }
    effects.clear();
  };
  const std::string grounded = "with it the online estimator takes the flight for contact";
  std::optional<Pass> run;
  // Adds an effect of which the regression is no judge, where the online estimate shows it.
  const auto ask_online = [&](const std::string& name) {
    std::vector<RankedEffect> with = effects;
    with.emplace_back().name = name;
    std::optional<Pass> pass = run_with(with, 1.0);
    if (!pass) return;
    const Vehicle extended = Extended(vehicle, attribution.stage(), with, known);
    const DynamicModel model(extended, extended.effects);
    with.back() = RankedByEstimate(name, pass->parameters, model, EffectsOf(candidates).size());
    const RankedEffect& asked = with.back();
    if (!(asked.p_value < options.attribution.false_alarm_rate)) return;
    const auto ranked = std::find_if(result.ranking.begin(), result.ranking.end(),
                                     [&](const RankedEffect& e) { return e.name == name; });
    if (ranked != result.ranking.end()) *ranked = asked;
    effects = with;
    const ReplayResult& replayed = pass->replay;
    const int k_f = model.IndexOf("thrust.k_f");
    const auto by_bands = KnownByBands(
        FindTorqueBands(log, model, replayed.last->values,
                        k_f >= 0 ? replayed.last->sigma[k_f] : 0.0, replayed.ground_spans),
        model, replayed.last->values);
    if (!by_bands.empty()) {
      const std::map<std::string, ParameterSetting> without = known;
      known.insert(by_bands.begin(), by_bands.end());
      std::optional<Pass> better = run_with(effects, 1.0);
      if (better) {
        pass = std::move(better);
      } else {
        known = without;
      }
    }
    run = std::move(pass);
  };
  if (!effects.empty() && unexplained > options.attribution.most_unexplained) {
    is_gusty = false;  // it was looked for beside them
    // A flexible disturbance explains more of it than they do. What predicts blocks held out so
    // much better is no stand-in all the same.
    run = run_with(effects, 1.0);
    if (!run || LeastRatio(before.held_out, run->held_out) > options.attribution.telling_ratio) {
      drop_all(Rounded(100.0 * unexplained) + " % of the structure stays unexplained beside it");
      run.reset();
    }
  }
  if (is_gusty) {
    effects.push_back(gusts.ranked);
    known = gusts.known;
  }
  if (!effects.empty()) {
    // What is zero within its sigma, and predicts nothing better, is not there.
    if (!run) run = run_with(effects, 0.8);
    if (!run) drop_all(grounded);
  }
  if (!effects.empty()) {
    const Vehicle extended = Extended(vehicle, attribution.stage(), effects, known);
    const DynamicModel model(extended, extended.effects);
    const bool predicts =
        LeastRatio(before.held_out, run->held_out, true) < options.attribution.least_ratio;
    const auto idle = [&](const RankedEffect& effect) {
      if (predicts || IsThere(effect, run->parameters, model, options.attribution)) return false;
      if (NatsAgainst(effect, run->parameters, model) < effect.score) return false;
      result.warnings.push_back(effect.name + " gains " + Rounded(effect.score) +
                                " nats, but the online estimate is zero within its sigma:" +
                                Estimates(effect, run->parameters, model));
      return true;
    };
    const auto end = std::remove_if(effects.begin(), effects.end(), idle);
    if (end != effects.end()) run.reset();
    effects.erase(end, effects.end());
  }
  if (!effects.empty() && !run) {
    run = run_with(effects, 1.0);
    if (!run) drop_all(grounded);
  }
  for (const std::string& name : QuickEffects(vehicle, candidates)) {
    if (with_torque && static_cast<int>(effects.size()) < options.attribution.most_effects &&
        !HasEffect(effects, name)) {
      ask_online(name);
    }
  }
  if (!effects.empty()) {
    const Vehicle extended = Extended(vehicle, attribution.stage(), effects, known);
    const DynamicModel model(extended, extended.effects);
    const Pass& after = *run;
    result.verdict = Verdict::kEffect;
    result.after = after.held_out;
    result.accelerometer_before = before.held_out.accelerometer_force_rmse_N;
    result.accelerometer_after = after.held_out.accelerometer_force_rmse_N;
    result.parameters = after.parameters;
    result.effect_names = extended.effects;
    result.samples = Samples(before.misses, after.misses, options.blocks);
    for (RankedEffect& ranked : effects) {
      const std::string other = Disagreement(ranked, after.parameters, model, options.attribution);
      if (!other.empty())
        result.warnings.push_back(ranked.name + ": the online run disagrees, " + other);
      AddedEffect effect;
      effect.effect = ranked;
      effect.alternatives = ranked.alternatives;
      for (const std::string& name : effect.alternatives) {
        if (!effect.manoeuvre.empty()) break;
        effect.manoeuvre = TellingManoeuvre(vehicle, ranked.name, name);
      }
      effect.derived = DerivedFigures(vehicle, ranked.name, result.parameters);
      for (ParameterEstimate& p : effect.effect.parameters) {
        const ParameterEstimate* online = result.parameters.Find(p.full_name);
        if (online != nullptr) p = *online;
      }
      result.effects.push_back(std::move(effect));
    }
  } else {
    result.accelerometer_before = result.accelerometer_after =
        before.held_out.accelerometer_force_rmse_N;
    if (structured) {
      result.verdict = Verdict::kUnexplained;
      result.where = Where(result.structure, flight, attribution.residual_before());
    }
  }
  const Vehicle final_vehicle =
      effects.empty() ? vehicle : Extended(vehicle, attribution.stage(), effects, known);
  const DynamicModel final_model(final_vehicle, final_vehicle.effects);
  const ReplayResult& final_replay = effects.empty() ? replay : run->replay;
  const int k_f = final_model.IndexOf("thrust.k_f");
  result.nominal_inertia = file_vehicle.inertia_kg_m2;
  result.bands =
      FindTorqueBands(log, final_model, final_replay.last->values,
                      k_f >= 0 ? final_replay.last->sigma[k_f] : 0.0, final_replay.ground_spans);
  const std::string reaction = ReactionWarning(result.bands);
  if (!reaction.empty()) result.warnings.push_back(reaction);
  return result;
}

}  // namespace odmc
