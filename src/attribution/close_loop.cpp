#include "odmc/attribution/close_loop.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <optional>
#include <stdexcept>

#include "odmc/analysis/calibration.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/gust_test.h"
#include "odmc/attribution/spectrum.h"
#include "odmc/math/hann.h"
#include "odmc/model/plausibility.h"
#include "odmc/preintegration/rotor_rate_smoother.h"

namespace odmc {
namespace {

constexpr int kMostRuns = 10;            // of the online estimator, with effects
constexpr int kLeastSamples = 50;        // to look for effects in
constexpr double kBetterOnline = 0.985;  // on some channel, by the online estimator
constexpr double kSizeSigmas = 3.0;
constexpr double kOvershadows = 5.0;
constexpr double kTie = 3.0;        // nats by which a free force may explain better than gusts
constexpr double kTieShare = 0.01;  // or this share of the gain: they differ little
constexpr double kStorm_m_s = 8.0;  // nobody flies in
constexpr double kInKnocks = 3.0;   // peakedness of a normal wind along one line
constexpr double kOneSided = 0.9;   // share of the wind's variance along one line
constexpr double kKnownThrustShare = 0.05;
constexpr double kAgreeShare = 1.0 / 3.0;  // of a coefficient: winds and drags bend each other

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
      worst->name + ", strongest near " + Text(worst->whiteness.peak_Hz) + " Hz and in ";
  text +=
      "block " + std::to_string(block) + " (RMS " + Text(std::sqrt(most)) + " " + worst->unit + ")";
  return text + "; of the quantities it lines up best with " + quantity->first + " (" +
         Text(100.0 * quantity->second) + " % of its variance)";
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
  const ThinnedFlight flight(FilterFlight(log, file_vehicle.num_rotors(), ground_spans), {2.5, 1});
  const ResidualModel residual(&flight, &file_vehicle, with_torque);
  ModelValues still = estimate;
  std::array<int, 3> w{};
  for (int k = 0; k < 3; ++k) {
    w[k] = model.IndexOf(std::string("gust.w_") + "xyz"[k]);
    still[w[k]] = 0.0;
  }
  const std::vector<Eigen::Vector3d> wind = PredictGusts(
      flight, residual.Residual(model, still), ByWind(residual, model, still, "gust"),
      estimate[model.IndexOf("gust.sigma")], estimate[model.IndexOf("gust.time_constant")], kAhead);
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

/// What a model misses on blocks held out: as reported, in the filter's band of 10 Hz, and without
/// what is faster than 4 Hz. Effects of rotor accelerations bring the noise of those into a
/// prediction, which is in the first band and hardly in the second.
struct HeldOut {
  PredictionFigures all, slow;

  /// By the accelerometer's force instead, where there is one.
  void UseForce(const PredictionFigures::Axes& accelerometer) {
    if (!accelerometer) return;
    all.force_rmse_N = slow.force_rmse_N = accelerometer;
  }
};

/// A prediction's errors as measured values, smoothed by a Hann window within runs without gaps.
std::vector<PredictionSample> SlowErrors(const std::vector<PredictionSample>& samples) {
  constexpr double kGap_s = 0.1;
  std::vector<PredictionSample> slow;
  for (size_t i = 0; i < samples.size(); ++i) {
    PredictionSample sum;
    sum.t_s = samples[i].t_s;
    sum.speed_m_s = samples[i].speed_m_s;
    sum.measured_force = sum.measured_torque = sum.measured_angular_acceleration =
        sum.predicted_force = sum.predicted_torque = sum.predicted_angular_acceleration =
            sum.predicted_specific_force = sum.rotor_torque = Eigen::Vector3d::Zero();
    double weights = 0.0;
    const auto add = [&](const PredictionSample& s) {
      const double weight = Hann((s.t_s - sum.t_s) / kRotorRatesWindow_s);
      if (weight <= 0.0) return false;
      weights += weight;
      sum.measured_force += weight * (s.measured_force - s.predicted_force);
      sum.measured_torque += weight * (s.measured_torque - s.predicted_torque);
      sum.measured_angular_acceleration +=
          weight * (s.measured_angular_acceleration - s.predicted_angular_acceleration);
      return true;
    };
    const auto follows = [&](size_t k) { return samples[k].t_s - samples[k - 1].t_s < kGap_s; };
    add(samples[i]);
    for (size_t k = i; k > 0 && follows(k) && add(samples[k - 1]);) --k;
    for (size_t k = i + 1; k < samples.size() && follows(k) && add(samples[k]);) ++k;
    sum.measured_force /= weights;
    sum.measured_torque /= weights;
    sum.measured_angular_acceleration /= weights;
    slow.push_back(std::move(sum));
  }
  return slow;
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
  HeldOut held_out;
};

Pass Run(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
         const EstimatorOptions& options, const CloseLoopOptions& loop,
         const std::function<void(double)>& progress) {
  Pass pass;
  const bool with_torque = !log.rotor_rms_only;
  Estimator estimator(&model, options, with_torque);
  const Stamp first = log.odometry.empty() ? 0 : log.odometry.front().stamp;
  estimator.SetHeldOut(
      [=](Stamp stamp) { return loop.blocks.IsHeldOut(ToSeconds(stamp - first)); });
  pass.replay = Replay(log, &estimator, progress);
  pass.replay.history = {};
  pass.replay.timing = {};
  if (!pass.replay.last) throw std::invalid_argument(log.file + ": never airborne");
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
  pass.held_out.all = SummarisePrediction(unseen, with_torque, file_vehicle, model, values);
  pass.held_out.slow =
      SummarisePrediction(SlowErrors(unseen), with_torque, file_vehicle, model, values);
  pass.held_out.slow.torque_explained = pass.held_out.all.torque_explained;
  return pass;
}

int EffectIndex(const DynamicModel& model, const std::string& name) {
  const std::vector<std::string>& names = model.effect_names();
  return static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
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

/// What speaks against an effect in the online estimate; empty if that confirms it: it has a
/// physical sign and size, differs from zero (so does its size, where that has a sign: a load of
/// no mass is none wherever it hangs) and matters.
std::string Objection(const RankedEffect& effect, const ParameterSet& online,
                      const DynamicModel& model) {
  // The warm start is no prior: natural sizes are about those of the catalogue.
  const Effect& catalogue = model.effect(EffectIndex(model, effect.name));
  const auto spec_of = [&](const ParameterEstimate& p) -> const ParameterSpec& {
    return *std::find_if(catalogue.parameters().begin(), catalogue.parameters().end(),
                         [&](const auto& s) { return effect.name + "." + s.name == p.full_name; });
  };
  RankedEffect estimate = effect;
  std::string of_no_size;  // a signed coefficient that may be zero, while no other is known not to
  bool has_size = false;
  for (ParameterEstimate& p : estimate.parameters) {
    const ParameterEstimate* found = online.Find(p.full_name);
    if (found == nullptr || !found->estimated) continue;
    p = *found;
    const ParameterSpec& spec = spec_of(p);
    if (std::abs(p.value - spec.prior_value) > kTooLarge * spec.prior_sigma) {
      return p.full_name + " = " + Text(p.value) + " is too large";
    }
    if (HasWrongSign(spec.sign, p.value)) {
      return p.full_name + " = " + Text(p.value) + " has an unphysical sign";
    }
    if (spec.sign == PhysicalSign::kAny) continue;
    has_size = has_size || std::abs(p.value) > kSizeSigmas * p.sigma;
    of_no_size = p.full_name + " = " + Text(p.value) + " +- " + Text(p.sigma) + " may be zero";
  }
  const std::vector<Eigen::Index> own = EstimatesOf(effect, online, model);
  Eigen::VectorXd values(static_cast<Eigen::Index>(own.size()));
  std::vector<double> sizes;
  for (size_t i = 0; i < own.size(); ++i) {
    const ParameterEstimate& p = online.parameters[own[i]];
    values[i] = p.value;
    sizes.push_back((p.value - spec_of(p).prior_value) / spec_of(p).prior_sigma);
  }
  if (AreTooLargeTogether(sizes)) return "its coefficients together are too large";
  if (!IsSignificant(values, online.covariance(own, own)))
    return "does not differ from zero by three sigma";
  if (!has_size && !of_no_size.empty()) return of_no_size;
  return IsNegligible(estimate) ? "is no larger than feedback can feign" : "";
}

/// What moves by itself is started near what the regression found of it, and so is its place. They
/// are no evidence for the effect, and the first second of flight alone would lead the online
/// estimate astray.
void HoldInitialState(const RankedEffect& effect, Vehicle* vehicle) {
  constexpr double kSigmas = 1.0;  // of the regression's
  const DynamicModel model(*vehicle, vehicle->effects);
  const auto spec = [&model](const ParameterEstimate& p) -> const ParameterSpec& {
    return model.parameters()[model.IndexOf(p.full_name)].spec;
  };
  const bool moves = std::any_of(effect.parameters.begin(), effect.parameters.end(),
                                 [&](const ParameterEstimate& p) { return spec(p).initial_state; });
  for (const ParameterEstimate& p : effect.parameters) {
    if (!moves || !p.estimated || spec(p).sign != PhysicalSign::kAny) continue;
    vehicle->parameters[p.full_name].sigma = std::min(kSigmas * p.sigma, spec(p).prior_sigma);
  }
}

/// RMSE of the accelerometer's force on blocks held out; empty without an accelerometer.
PredictionFigures::Axes HeldOutForce(const ResidualModel& residual, const DynamicModel& model,
                                     const Snapshot& last) {
  if (!residual.from_accelerometer()) return std::nullopt;
  const ResidualModel::Wrenches y = residual.Residual(model, last.values);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero(), mean = sum;
  double count = 0.0;
  for (int i = 0; i < residual.flight().size(); ++i) {
    if (!residual.flight().held_out(i)) continue;
    mean += y.row(i).head<3>().transpose();
    sum += y.row(i).head<3>().transpose().cwiseAbs2();
    count += 1.0;
  }
  if (count < 10.0) return std::nullopt;
  mean /= count;  // the accelerometer's bias
  return Eigen::Vector3d((sum / count - mean.cwiseAbs2()).cwiseMax(0.0).cwiseSqrt());
}

/// "force after/before 1.00 1.01 0.98, torque 1.00 0.97 1.02".
std::string ChangeText(const PredictionFigures& before, const PredictionFigures& after) {
  const auto axes = [](const PredictionFigures::Axes& b, const PredictionFigures::Axes& a) {
    std::string text;
    if (!a || !b) return std::string(" unknown");
    for (int i = 0; i < 3; ++i) text += " " + Text((*a)[i] / (*b)[i]);
    return text;
  };
  return "after/before: force" + axes(before.force_rmse_N, after.force_rmse_N) +
         ", angular acceleration" +
         axes(before.angular_acceleration_rmse_rad_s2, after.angular_acceleration_rmse_rad_s2);
}

/// Angular acceleration after a change. Along axes whose torque the declared model predicts worse
/// than nothing does, a larger error says nothing against an effect.
PredictionFigures::Axes TellingAcceleration(const PredictionFigures& before,
                                            const PredictionFigures& after) {
  PredictionFigures::Axes axes = after.angular_acceleration_rmse_rad_s2;
  const PredictionFigures::Axes& was = before.angular_acceleration_rmse_rad_s2;
  if (!axes || !was || !before.torque_explained) return axes;
  for (int i = 0; i < 3; ++i) {
    if ((*before.torque_explained)[i] < 0.0) (*axes)[i] = std::min((*axes)[i], (*was)[i]);
  }
  return axes;
}

/// How the channels' errors change, one with another.
struct Change {
  double sum = 0.0, worst = 0.0, best = 1.0;  ///< of logarithms; ratios

  Change(const PredictionFigures& before, const PredictionFigures& after) {
    Add(before.force_rmse_N, after.force_rmse_N);
    // Not the torque, which holds the file's inertia against a model that has found a better one.
    Add(before.angular_acceleration_rmse_rad_s2, TellingAcceleration(before, after));
  }

  /// True if some channel is better and none is clearly worse.
  bool IsBetter() const {
    return sum < 0.0 && !IsClearlyWorse(worst, best) && best < kBetterOnline;
  }

 private:
  void Add(const PredictionFigures::Axes& before, const PredictionFigures::Axes& after) {
    if (!after || !before) return;
    for (int i = 0; i < 3; ++i) {
      const double change = (*after)[i] / (*before)[i];
      sum += std::log(change);
      worst = std::max(worst, change);
      best = std::min(best, change);
    }
  }
};

/// True if blocks held out are predicted better, or, by effects of rotor accelerations, better
/// without what is fast: that part of their prediction is noise.
bool IsBetter(const HeldOut& before, const HeldOut& after, bool takes_rotor_rates) {
  return Change(before.all, after.all).IsBetter() ||
         (takes_rotor_rates && Change(before.slow, after.slow).IsBetter());
}

/// Effects that were added to the declared model.
struct Choice {
  Stage stage;  // with what was added, and the values of the joint fit
  std::vector<AddedEffect> added;
  double scores = 0.0;
  ResidualModel::Wrenches residual;               // of the plain fit
  std::map<std::string, ParameterSetting> known;  // start and prior of the online run, where known

  bool Has(const std::string& effect) const {
    return std::any_of(added.begin(), added.end(),
                       [&effect](const AddedEffect& a) { return a.effect.name == effect; });
  }
};

/// What the online estimator makes of the choice it confirmed last.
struct Confirmed {
  HeldOut figures;  // by which further effects are judged
  PredictionFigures after;
  PredictionFigures::Axes accelerometer;
  ParameterSet parameters;
  std::vector<std::string> effect_names;
  std::optional<std::vector<Miss>> misses;  // empty for the declared model
};

/// What a choice leaves, and what would be added to it.
struct Step {
  Choice before;  // fitted
  Choice after;   // with one effect more, or a pair; the same as before if nothing earns its place
  std::vector<RankedEffect> ranking;
};

/// Finds the best candidate to add, or the best pair.
Step ChooseNext(const ResidualModel& residual, const Choice& from,
                const std::vector<Candidate>& candidates, const CloseLoopOptions& options) {
  Step step;
  step.before = from;
  const int num_channels = residual.num_channels();
  const Regressor regressor(&residual, &step.before.stage);
  const Stage& stage = step.before.stage;
  const WrenchFit& base = regressor.base().fit;
  step.before.residual = base.plain_residual;
  step.after = step.before;
  const int room = options.most_effects - static_cast<int>(from.added.size());
  const std::vector<Tried> tried = TryAll(stage, candidates, regressor, base, num_channels);
  for (const Tried& t : tried) step.ranking.push_back(t.ranked);
  const double least = options.LeastScore(from.added.empty(), from.scores);
  const RankedEffect* best = tried.empty() || room < 1 ? nullptr : &tried.front().ranked;
  if (best != nullptr && (!best->sound || best->score < least)) best = nullptr;
  std::optional<Pair> pair;
  if (room >= 2) {
    pair = TryPairs(stage, tried, regressor, base, num_channels, options.LeastScore(false, 0.0));
  }
  if (pair && pair->score < 2.0 * std::max(least, best != nullptr ? best->score : 0.0)) {
    pair.reset();
  }
  Choice& after = step.after;
  const auto take = [&after](const Regressor::Result& result, double score) {
    after.scores += score;
    for (const auto& [name, value] : result.values) after.stage.values[name] = value;
    after.residual = result.fit.plain_residual;
  };
  if (pair) {
    for (const RankedEffect& ranked : pair->ranked) {
      after.added.push_back({ranked, {}, "", {}});
      after.stage.vehicle = With(after.stage.vehicle, Candidate{ranked.name, ranked.settings, {}});
    }
    take(pair->result, pair->score);
  } else if (best != nullptr) {
    AddedEffect effect;
    effect.effect = *best;
    effect.alternatives = Alternatives(tried, options);
    for (const std::string& name : effect.alternatives) {
      if (effect.manoeuvre.empty()) effect.manoeuvre = TellingManoeuvre(best->name, name);
    }
    after.added.push_back(effect);
    after.stage.vehicle = With(after.stage.vehicle, tried.front().candidate);
    take(tried.front().result, best->score);
  }
  return step;
}

/// The case for gusts, and the values of the drag that goes with them.
struct Gusts {
  RankedEffect ranked;
  std::map<std::string, ParameterSetting> known;  // what it is known of others, by full name

  Choice AddedTo(Choice choice) const {
    choice.added.push_back({ranked, {}, "", {}});
    choice.scores += ranked.score;
    for (const auto& [name, setting] : known) choice.known[name] = setting;
    return choice;
  }
};

/// The case for gusts behind what a choice leaves; they vary, so that no fixed regressor shows
/// them.
/// @param declared the online estimate without effects added
Gusts RankGusts(const ResidualModel& residual, const Choice& choice, const ParameterSet& declared) {
  Vehicle airy = choice.stage.vehicle;
  const bool has_wind =
      std::find(airy.effects.begin(), airy.effects.end(), "wind") != airy.effects.end();
  if (!has_wind) airy.effects.push_back("wind");
  const DynamicModel model(airy, airy.effects);
  const ModelValues values = ValuesOf(model, choice.stage.values);
  const WindDerivatives d_wind = ByWind(residual, model, values, "wind");
  const std::vector<DragCoefficient> drag = DragOf(residual, model, values, d_wind);
  const GustTest gust = TestGusts(residual.flight(), choice.residual, d_wind, drag);
  Gusts gusts;
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
  ranked.settings = {{"gust.sigma", std::max(0.1, gust.sigma_m_s)},
                     {"gust.time_constant", std::max(0.1, gust.time_constant_s)}};
  for (const auto& [name, value] : ranked.settings) {
    ranked.parameters.push_back(
        {name, name == "gust.sigma" ? "m/s" : "s", value, 0.0, false, false});
  }
  ranked.sound = gust.over_others > -kTie - kTieShare * gust.gain && gust.sigma_m_s < kStorm_m_s &&
                 gust.one_sidedness < kOneSided && gust.peakedness < kInKnocks;
  if (gust.one_sidedness >= kOneSided) {
    ranked.objection = "it would blow along one line only";
  } else if (gust.peakedness >= kInKnocks) {
    ranked.objection = "it would come in knocks";
  } else if (gust.sigma_m_s >= kStorm_m_s) {
    ranked.objection = "it would be a storm";
  } else if (!ranked.sound) {
    ranked.objection =
        "a force free of the drag explains it better by " + Text(-gust.over_others) + " nats";
  }
  return gusts;
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

/// What is not looked at. Contact is left out like the ground, unless it is most of the flight: no
/// hand holds a vehicle that long, and what acts so long is something the model lacks.
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

/// Fills in what share of the residual is structured, and how surely. @returns true if some is
bool Summarise(const CloseLoopOptions& options, ClosedLoop* result) {
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

/// The vehicle with what was added. Everything starts where the fit (which has not seen the blocks
/// held out) has brought it: what multiplies each other, as wind and drag, has more than one
/// valley.
Vehicle Extended(const Vehicle& vehicle, const Choice& choice) {
  Vehicle extended = vehicle;
  const DynamicModel declared(vehicle, vehicle.effects);
  for (const ModelParameter& p : declared.parameters()) {
    if (!p.estimated || p.effect == "inertia") continue;
    extended.parameters[p.full_name].value = choice.stage.values.at(p.full_name);
    extended.parameters[p.full_name].sigma = p.spec.prior_sigma;
  }
  for (const AddedEffect& effect : choice.added) {
    extended = With(extended, {effect.effect.name, effect.effect.settings});
    for (const ParameterEstimate& p : effect.effect.parameters) {
      if (p.estimated) extended.parameters[p.full_name].value = p.value;
    }
    HoldInitialState(effect.effect, &extended);
  }
  for (const auto& [name, setting] : choice.known) {
    ParameterSetting& known = extended.parameters[name];
    known.value = setting.value;
    known.sigma = known.sigma ? std::min(*known.sigma, *setting.sigma) : *setting.sigma;
  }
  return extended;
}

}  // namespace

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

std::vector<std::string> Alternatives(const std::vector<Tried>& tried,
                                      const CloseLoopOptions& options) {
  std::vector<std::string> names;
  const double best = tried.front().ranked.score;
  const double close = std::max(options.close_score, options.close_share * best);
  for (size_t i = 1; i < tried.size(); ++i) {
    const RankedEffect& other = tried[i].ranked;
    const bool close_by = other.sound && other.score >= best - close;
    const Gain over_other = CrossValidatedGain(tried[i].result.fit, tried.front().result.fit);
    const bool is_rival = other.sound && other.score >= options.least_score &&
                          over_other.nats < options.telling_sigmas * over_other.sigma;
    if (close_by || is_rival || IsSpecialCase(tried[i], tried.front())) names.push_back(other.name);
  }
  return names;
}

std::string Disagreement(const RankedEffect& effect, const ParameterSet& online,
                         const DynamicModel& model) {
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
    const double share = kAgreeShare * std::max(std::abs(p.value), std::abs(fitted));
    covariance(i, i) += share * share;
    const double sigmas = std::abs(difference[i]) / std::sqrt(covariance(i, i));
    if (sigmas < most) continue;
    most = sigmas;
    worst = i;
  }
  if (!IsSignificant(difference, covariance)) return "";
  const ParameterEstimate& p = online.parameters[own[static_cast<size_t>(worst)]];
  return "it finds " + p.full_name + " = " + Text(p.value) + ", the fit that chose the effect " +
         Text(p.value - difference[worst]);
}

bool IsStructured(const ChannelStructure& channel, const CloseLoopOptions& options) {
  return channel.whiteness.p < options.whiteness_p &&
         channel.whiteness.structured_share > options.least_structured;
}

void HoldKnownThrust(Vehicle* vehicle) {
  const auto it = vehicle->parameters.find("thrust.k_f");
  if (it == vehicle->parameters.end() || !it->second.value || !it->second.sigma) return;
  if (*it->second.sigma < kKnownThrustShare * *it->second.value) it->second.estimated = false;
}

ClosedLoop CloseLoop(const FlightLog& log, const Vehicle& file_vehicle, const Vehicle& vehicle,
                     const CloseLoopOptions& given, const std::function<void(double)>& progress) {
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
  const Pass before = Run(log, file_vehicle, declared, options.estimator, options, part(0.0, 0.4));
  const ReplayResult& replay = before.replay;
  result.declared_parameters = result.parameters = before.parameters;
  result.effect_names = vehicle.effects;
  result.before = result.after = before.held_out.all;
  result.warnings = FlightWarnings(log, replay);
  const std::string doubt = InertiaDoubt(file_vehicle);
  if (!doubt.empty()) result.warnings.push_back(doubt);
  result.flight = FlownFlight(log, replay);

  const ThinnedFlight flight(FilterFlight(log, file_vehicle.num_rotors(), NotLookedAt(replay)),
                             options.blocks);
  int in_use = 0;
  for (int i = 0; i < flight.size(); ++i) in_use += flight.held_out(i) ? 0 : 1;
  if (in_use < kLeastSamples) {
    result.warnings.push_back("too little flight to look for effects: " + std::to_string(in_use) +
                              " samples of 40 ms, at least " + std::to_string(kLeastSamples) +
                              " are needed");
    result.samples = Samples(before.misses, before.misses, options.blocks);
    return result;
  }
  const ResidualModel residual(&flight, &file_vehicle, with_torque);
  const std::vector<Candidate> candidates = CandidatesFor(vehicle, flight.motion());
  std::map<std::string, size_t> refused;  // by the online estimator, with so many effects accepted
  Choice accepted;
  accepted.stage = StageOf(declared, replay.last->values, replay.last->observable, residual);
  Step step;
  const auto choose = [&](const Choice& from) {
    std::vector<Candidate> left;
    std::copy_if(candidates.begin(), candidates.end(), std::back_inserter(left),
                 [&](const Candidate& c) { return refused.count(c.effect) == 0; });
    step = ChooseNext(residual, from, left, options);
  };
  const auto explains = [&](const Choice& choice) {
    if (choice.added.empty()) return false;
    if (choice.Has("gust")) return true;
    return ExplainedStructure(result.structure,
                              Structure(flight, choice.residual, residual.num_channels()),
                              options.whiteness_p, options.noise_p) >= options.least_explained;
  };
  choose(accepted);
  result.ranking = step.ranking;
  const ResidualModel::Wrenches declared_residual = step.before.residual;
  result.structure = Structure(flight, declared_residual, residual.num_channels());
  const bool structured = Summarise(options, &result);
  const std::vector<std::vector<double>> runs = flight.Runs(declared_residual.col(0));
  const bool judged = std::any_of(runs.begin(), runs.end(),
                                  [](const auto& run) { return run.size() >= kShortestRun; });
  if (!judged) {
    result.warnings.push_back(
        "no stretch without gaps is long enough to tell structure from noise: " +
        Text(kShortestRun * flight.step_s()) + " s are needed");
  }

  // What all that earns its place explains together, before the online estimator has its say.
  const Step first = step;
  Choice promised = first.after;
  while (step.after.added.size() > step.before.added.size()) {
    promised = step.after;
    choose(promised);
  }
  const bool has_gust =
      std::find(vehicle.effects.begin(), vehicle.effects.end(), "gust") != vehicle.effects.end();
  const auto gusts_beside = [&](const Choice& choice) -> std::optional<Gusts> {
    if (has_gust || choice.Has("gust") || !structured || refused.count("gust") > 0) {
      return std::nullopt;
    }
    Gusts gusts = RankGusts(residual, choice, result.declared_parameters);
    if (refused.empty() && choice.added.size() == promised.added.size()) {
      result.ranking.push_back(gusts.ranked);
    }
    const double least = std::max(3.0 * options.least_score, 0.5 * choice.scores);
    if (!gusts.ranked.sound || gusts.ranked.score < least) return std::nullopt;
    return gusts;
  };
  // What was refused beside fewer effects may have its place beside more.
  const auto reconsider = [&] {
    const size_t before_them = refused.size();
    for (auto it = refused.begin(); it != refused.end();) {
      it = it->second < accepted.added.size() ? refused.erase(it) : std::next(it);
    }
    return refused.size() < before_them;
  };
  const std::optional<Gusts> gusty = gusts_beside(promised);
  if (progress) progress(0.6);

  // One after the other: what the online estimator does not confirm is refused.
  Confirmed confirmed{before.held_out,   before.held_out.all, {},
                      before.parameters, vehicle.effects,     std::nullopt};
  result.accelerometer_before = HeldOutForce(residual, declared, *replay.last);
  confirmed.accelerometer = result.accelerometer_before;
  confirmed.figures.UseForce(result.accelerometer_before);
  step = first;
  const bool promising = (explains(promised) || gusty) && result.whiteness_p < options.noise_p;
  if (gusty && gusty->ranked.score > kOvershadows * promised.scores) {
    // What was found beside a much larger gust is its shadow.
    step.after = gusty->AddedTo(accepted);
  }
  const auto try_next = [&] {
    if (step.after.added.size() == accepted.added.size() && reconsider()) choose(accepted);
    Choice trial = step.after;
    if (trial.added.size() == accepted.added.size()) {
      const std::optional<Gusts> gusts = gusts_beside(step.before);
      if (!gusts) return false;
      trial = gusts->AddedTo(step.before);
    }
    const Vehicle extended = Extended(vehicle, trial);
    const DynamicModel model(extended, extended.effects);
    Pass after = Run(log, file_vehicle, model, options.estimator, options, part(0.6, 1.0));
    std::string objection;
    bool takes_rotor_rates = false;
    for (size_t i = accepted.added.size(); i < trial.added.size(); ++i) {
      const Effect& effect = model.effect(EffectIndex(model, trial.added[i].effect.name));
      takes_rotor_rates = takes_rotor_rates || effect.description().from_rotor_rates;
    }
    for (size_t i = 0; i < trial.added.size() && objection.empty(); ++i) {
      const RankedEffect& effect = trial.added[i].effect;
      if (effect.name == "gust") continue;
      objection = Objection(effect, after.parameters, model);
      if (objection.empty() && i >= accepted.added.size()) {
        objection = Disagreement(effect, after.parameters, model);
      }
    }
    HeldOut figures = after.held_out;
    const PredictionFigures::Axes accelerometer = HeldOutForce(residual, model, *after.replay.last);
    figures.UseForce(accelerometer);
    const HeldOut& best = confirmed.figures;
    if (objection.empty() && !IsBetter(best, figures, takes_rotor_rates)) {
      objection = "blocks held out are predicted no better (" + ChangeText(best.all, figures.all) +
                  "; slower than 4 Hz " + ChangeText(best.slow, figures.slow) + ")";
    }
    if (objection.empty()) {
      confirmed = {figures,          after.held_out.all, accelerometer,
                   after.parameters, extended.effects,   std::move(after.misses)};
      accepted = trial;
      choose(accepted);
      return true;
    }
    for (size_t i = accepted.added.size(); i < trial.added.size(); ++i) {
      const std::string& name = trial.added[i].effect.name;
      refused[name] = accepted.added.size();
      result.warnings.push_back(
          name + " was chosen, but the online run does not confirm it: " + objection);
    }
    choose(accepted);
    // A lone effect that is refused has no second: the next best would have no case of its own.
    return !accepted.added.empty() || promised.added.size() > 1 || gusty.has_value();
  };
  for (int run = 0; promising && run < kMostRuns && try_next();) ++run;
  if (explains(accepted)) {
    result.verdict = Verdict::kEffect;
    result.effects = accepted.added;
    result.after = confirmed.after;
    result.accelerometer_after = confirmed.accelerometer;
    result.parameters = confirmed.parameters;
    result.effect_names = confirmed.effect_names;
    for (AddedEffect& effect : result.effects) {
      effect.derived = DerivedFigures(vehicle, effect.effect.name, result.parameters);
      for (ParameterEstimate& p : effect.effect.parameters) {
        const ParameterEstimate* online = result.parameters.Find(p.full_name);
        if (online != nullptr) p = *online;
      }
    }
  } else {
    result.accelerometer_after = result.accelerometer_before;
    if (structured) {
      result.verdict = Verdict::kUnexplained;
      result.where = Where(result.structure, flight, declared_residual);
    }
  }
  const bool is_extended = result.verdict == Verdict::kEffect && confirmed.misses;
  result.samples = Samples(before.misses,
                           is_extended ? *confirmed.misses : before.misses, options.blocks);
  return result;
}

}  // namespace odmc
