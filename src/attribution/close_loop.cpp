#include "odmc/attribution/close_loop.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <stdexcept>

#include "odmc/attribution/candidates.h"
#include "odmc/attribution/gust_test.h"

namespace odmc {
namespace {

constexpr int kLeastSamples = 50;        // to look for effects in
constexpr double kBetterOnline = 0.985;  // on some channel, by the online estimator
constexpr double kOvershadows = 5.0;
constexpr double kTie = 3.0;        // nats by which a free force may explain better than gusts
constexpr double kTieShare = 0.01;  // or this share of the gain: they differ little
constexpr double kOneSided = 0.9;   // share of the wind's variance along one line
constexpr double kKnownThrustShare = 0.05;

std::string Text(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

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

/// Derivatives of the predicted wrench by the wind along world x, y, z of an effect.
std::array<ResidualModel::Wrenches, 3> WindDerivatives(const ResidualModel& residual,
                                                       const DynamicModel& model,
                                                       const ModelValues& values,
                                                       const std::string& effect) {
  std::array<ResidualModel::Wrenches, 3> d_wind;
  for (int k = 0; k < 3; ++k) {
    d_wind[k] = residual.Derivative(model, values, model.IndexOf(effect + ".w_" + "xyz"[k]));
  }
  return d_wind;
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
      flight, residual.Residual(model, still), WindDerivatives(residual, model, still, "gust"),
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

/// One pass of the online estimator, blocks held out, with its prediction of everything.
struct Pass {
  ReplayResult replay;
  ParameterSet parameters;
  Prediction prediction;
  PredictionFigures held_out;
};

Pass Run(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
         const EstimatorOptions& options, const CloseLoopOptions& loop,
         const std::function<void(double)>& progress) {
  Pass pass;
  const bool with_torque = !log.rotor_rms_only;
  Estimator estimator(&model, options, with_torque);
  const Stamp first = log.odometry.empty() ? 0 : log.odometry.front().stamp;
  const bool varies = !model.processes().empty();
  if (!varies) {
    estimator.SetHeldOut(
        [=](Stamp stamp) { return loop.blocks.IsHeldOut(ToSeconds(stamp - first)); });
  }
  pass.replay = Replay(log, &estimator, progress);
  if (!pass.replay.last) throw std::invalid_argument(log.file + ": never airborne");
  pass.parameters = Estimator::ToParameterSet(model, *pass.replay.last);
  const ModelValues& values = pass.replay.last->values;
  const ValueVariation vary =
      varies ? GustsOf(log, file_vehicle, model, values, pass.replay.ground_spans, with_torque)
             : ValueVariation();
  pass.prediction = Predict(log, file_vehicle, model, values, pass.replay.ground_spans, vary);
  std::vector<PredictionSample> unseen;
  for (const PredictionSample& s : pass.prediction.samples) {
    if (loop.blocks.IsHeldOut(s.t_s)) unseen.push_back(s);
  }
  pass.held_out = SummarisePrediction(unseen, with_torque, file_vehicle, model, values);
  return pass;
}

int EffectIndex(const DynamicModel& model, const std::string& name) {
  const std::vector<std::string>& names = model.effect_names();
  return static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
}

/// What speaks against an effect in the online estimate; empty if that confirms it: it has a
/// physical sign and size, differs from zero and matters.
std::string Objection(const RankedEffect& effect, const ParameterSet& online,
                      const DynamicModel& model) {
  RankedEffect estimate = effect;
  std::vector<Eigen::Index> own;
  for (ParameterEstimate& p : estimate.parameters) {
    const ParameterEstimate* found = online.Find(p.full_name);
    if (found == nullptr || !found->estimated) continue;
    p = *found;
    // The warm start is no prior: natural sizes are about zero.
    const Effect& catalogue = model.effect(EffectIndex(model, effect.name));
    bool initial_state = false;
    for (const ParameterSpec& spec : catalogue.parameters()) {
      if (effect.name + "." + spec.name != p.full_name) continue;
      initial_state = spec.initial_state;
      if (std::abs(p.value - spec.prior_value) > kTooLarge * spec.prior_sigma) {
        return p.full_name + " = " + Text(p.value) + " is too large";
      }
      const bool wrong = (spec.sign == PhysicalSign::kPositive && p.value < 0.0) ||
                         (spec.sign == PhysicalSign::kNegative && p.value > 0.0);
      if (wrong) return p.full_name + " = " + Text(p.value) + " has an unphysical sign";
    }
    if (!initial_state) own.push_back(found - online.parameters.data());
  }
  const auto n = static_cast<Eigen::Index>(own.size());
  Eigen::VectorXd values(n);
  Eigen::MatrixXd covariance(n, n);
  for (Eigen::Index a = 0; a < n; ++a) {
    values[a] = online.parameters[own[a]].value;
    for (Eigen::Index b = 0; b < n; ++b) covariance(a, b) = online.covariance(own[a], own[b]);
  }
  if (!IsSignificant(values, covariance)) return "does not differ from zero by three sigma";
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

/// True if some channel is better and none is clearly worse.
bool IsBetter(const PredictionFigures& before, const PredictionFigures& after) {
  double sum = 0.0, worst = 0.0, best = 1.0;
  const auto add = [&](const PredictionFigures::Axes& b, const PredictionFigures::Axes& a) {
    if (!a || !b) return;
    for (int i = 0; i < 3; ++i) {
      const double change = (*a)[i] / (*b)[i];
      sum += std::log(change);
      worst = std::max(worst, change);
      best = std::min(best, change);
    }
  };
  add(before.force_rmse_N, after.force_rmse_N);
  // Not the torque, which holds the file's inertia against a model that has found a better one.
  add(before.angular_acceleration_rmse_rad_s2, TellingAcceleration(before, after));
  return sum < 0.0 && !IsClearlyWorse(worst, best) && best < kBetterOnline;
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
  result.before = result.after = before.held_out;
  result.warnings = log.warnings;
  result.flight.file = log.file;
  result.flight.duration_s = ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp);
  result.flight.on_ground_s = replay.counters.on_ground_s;
  result.flight.keyframes = replay.counters.keyframes;
  result.flight.dropped =
      log.dropped + replay.stream_counters.not_finite + replay.stream_counters.out_of_order;

  const auto fill_samples = [&](const Prediction& after) {
    const size_t n = std::min(before.prediction.samples.size(), after.samples.size());
    for (size_t i = 0; i < n; ++i) {
      const PredictionSample &b = before.prediction.samples[i], &a = after.samples[i];
      LoopSample sample{b.t_s, options.blocks.IsHeldOut(b.t_s), b.speed_m_s, {}, {}};
      for (int k = 0; k < 3; ++k) {
        sample.before[k] = b.measured_force[k] - b.predicted_force[k];
        sample.before[k + 3] = b.measured_torque[k] - b.predicted_torque[k];
        sample.after[k] = a.measured_force[k] - a.predicted_force[k];
        sample.after[k + 3] = a.measured_torque[k] - a.predicted_torque[k];
      }
      result.samples.push_back(sample);
    }
  };

  const ThinnedFlight flight(FilterFlight(log, file_vehicle.num_rotors(), replay.ground_spans),
                             options.blocks);
  int in_use = 0;
  for (int i = 0; i < flight.size(); ++i) in_use += flight.held_out(i) ? 0 : 1;
  if (in_use < kLeastSamples) {
    result.warnings.push_back("too little flight to look for effects: " + std::to_string(in_use) +
                              " samples of 40 ms, at least " + std::to_string(kLeastSamples) +
                              " are needed");
    fill_samples(before.prediction);
    return result;
  }
  const ResidualModel residual(&flight, &file_vehicle, with_torque);
  Stage stage;
  stage.vehicle = vehicle;
  for (int i = 0; i < declared.num_parameters(); ++i) {
    const std::string& name = declared.parameters()[i].full_name;
    stage.values[name] = replay.last->values[i];
    // An inertia that the flight does not show would only be made large, to damp what noise of the
    // rotor speeds brings.
    if (declared.parameters()[i].effect == "inertia" && !replay.last->observable[i]) {
      stage.vehicle.parameters[name].value = replay.last->values[i];
      stage.vehicle.parameters[name].estimated = false;
    }
  }

  std::vector<Candidate> candidates = CandidatesFor(vehicle, flight.motion());
  // A mass over the whole flight is one with the thrust coefficient.
  const int k_f = declared.IndexOf("thrust.k_f");
  if (k_f >= 0 && declared.parameters()[k_f].estimated) {
    candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                    [](const Candidate& c) {
                                      const auto from = c.settings.find("mass_change.from");
                                      return from != c.settings.end() && from->second <= 0.0;
                                    }),
                     candidates.end());
  }
  ResidualModel::Wrenches unexplained, first_residual;
  double scores = 0.0;
  std::vector<AddedEffect> added;
  for (int step = 0; step <= options.most_effects; ++step) {
    const Regressor regressor(&residual, &stage);
    const Regressor::Result& base = regressor.base();
    unexplained = base.fit.plain_residual;
    if (step == 0) first_residual = unexplained;
    if (step == options.most_effects) break;
    const std::vector<Tried> tried =
        TryAll(stage, candidates, regressor, base.fit, residual.num_channels());
    if (step == 0) {
      for (const Tried& t : tried) result.ranking.push_back(t.ranked);
    }
    if (progress) progress(0.4 + 0.2 * (step + 1) / options.most_effects);
    const double least =
        step == 0 ? options.least_score
                  : std::max(1.25 * options.least_score, options.least_share_of_first * scores);
    const RankedEffect* best = tried.empty() ? nullptr : &tried.front().ranked;
    if (best != nullptr && (!best->sound || best->score < least)) best = nullptr;
    std::optional<Pair> pair;
    if (step + 2 <= options.most_effects) {
      pair = TryPairs(stage, tried, regressor, base.fit, residual.num_channels(),
                      1.25 * options.least_score);
    }
    if (pair && pair->score < 2.0 * std::max(least, best != nullptr ? best->score : 0.0)) {
      pair.reset();
    }
    if (pair) {
      for (const RankedEffect& ranked : pair->ranked) {
        added.push_back({ranked, {}, ""});
        stage.vehicle = With(stage.vehicle, Candidate{ranked.name, ranked.settings, {}});
      }
      scores += pair->score;
      ++step;
      for (const auto& [name, value] : pair->result.values) stage.values[name] = value;
    } else if (best != nullptr) {
      AddedEffect effect;
      effect.effect = *best;
      const double close = std::max(options.close_score, options.close_share * best->score);
      for (size_t i = 1; i < tried.size(); ++i) {
        const RankedEffect& other = tried[i].ranked;
        if (!other.sound || other.score < best->score - close) continue;
        effect.alternatives.push_back(other.name);
        if (effect.manoeuvre.empty()) effect.manoeuvre = TellingManoeuvre(best->name, other.name);
      }
      added.push_back(effect);
      scores += best->score;
      stage.vehicle = With(stage.vehicle, tried.front().candidate);
      for (const auto& [name, value] : tried.front().result.values) stage.values[name] = value;
    } else {
      break;
    }
  }

  result.structure = Structure(flight, first_residual, residual.num_channels());
  for (const ChannelStructure& channel : result.structure) {
    result.structured_share = std::max(result.structured_share, channel.whiteness.structured_share);
    result.whiteness_p =
        std::min(result.whiteness_p,
                 std::min(1.0, channel.whiteness.p * static_cast<double>(result.structure.size())));
  }
  bool structured = false;
  for (const ChannelStructure& channel : result.structure) {
    structured = structured || (channel.whiteness.p < options.whiteness_p &&
                                channel.whiteness.structured_share > options.least_structured);
  }

  std::vector<AddedEffect> shadows;  // come back if gusts do not hold
  // Gusts vary: no fixed regressor shows them.
  Vehicle airy = stage.vehicle;
  const bool has_wind =
      std::find(airy.effects.begin(), airy.effects.end(), "wind") != airy.effects.end();
  const bool has_gust =
      std::find(airy.effects.begin(), airy.effects.end(), "gust") != airy.effects.end();
  if (!has_gust && structured) {
    if (!has_wind) airy.effects.push_back("wind");
    const DynamicModel model(airy, airy.effects);
    const ModelValues values = ValuesOf(model, stage.values);
    const GustTest gust =
        TestGusts(flight, unexplained, WindDerivatives(residual, model, values, "wind"));
    RankedEffect ranked;
    ranked.name = "gust";
    ranked.score = gust.gain;
    ranked.settings = {{"gust.sigma", std::max(0.1, gust.sigma_m_s)},
                       {"gust.time_constant", std::max(0.1, gust.time_constant_s)}};
    for (const auto& [name, value] : ranked.settings) {
      ranked.parameters.push_back(
          {name, name == "gust.sigma" ? "m/s" : "s", value, 0.0, false, false});
    }
    ranked.sound = gust.over_others > -kTie - kTieShare * gust.gain && gust.sigma_m_s < 8.0 &&
                   gust.one_sidedness < kOneSided;
    if (gust.one_sidedness >= kOneSided) {
      ranked.objection = "it would blow along one line only";
    } else if (!ranked.sound) {
      ranked.objection =
          "a force free of the drag explains it better by " + Text(-gust.over_others) + " nats";
    }
    const double least = std::max(3.0 * options.least_score, 0.5 * scores);
    if (ranked.sound && gust.gain > least) {
      // What was found beside a much larger gust is its shadow.
      if (gust.gain > kOvershadows * scores) shadows.swap(added);
      added.push_back({ranked, {}, ""});
    }
    result.ranking.push_back(ranked);
  }

  if (!added.empty()) {
    const bool with_gust = added.back().effect.name == "gust";
    const bool explains =
        with_gust || ExplainedStructure(result.structure,
                                        Structure(flight, unexplained, residual.num_channels()),
                                        options.whiteness_p) >= options.least_explained;
    if (explains) result.verdict = Verdict::kEffect;
  }
  if (result.verdict != Verdict::kEffect && structured) result.verdict = Verdict::kUnexplained;

  while (result.verdict == Verdict::kEffect && !added.empty()) {
    Vehicle extended = vehicle;
    // Everything starts where the fit (which has not seen the blocks held out) has brought it: what
    // multiplies each other, as wind and drag, has more than one valley.
    for (int i = 0; i < declared.num_parameters(); ++i) {
      const ModelParameter& p = declared.parameters()[i];
      if (!p.estimated || p.effect == "inertia") continue;
      extended.parameters[p.full_name].value = stage.values.at(p.full_name);
      extended.parameters[p.full_name].sigma = p.spec.prior_sigma;
    }
    for (const AddedEffect& effect : added) {
      extended = With(extended, {effect.effect.name, effect.effect.settings});
      for (const ParameterEstimate& p : effect.effect.parameters) {
        if (p.estimated) extended.parameters[p.full_name].value = p.value;  // a warm start
      }
      HoldInitialState(effect.effect, &extended);
    }
    const DynamicModel model(extended, extended.effects);
    const Pass after = Run(log, file_vehicle, model, options.estimator, options, part(0.6, 1.0));
    // What the online estimator does not confirm goes again, last first: it may have been what made
    // the others fade.
    const auto faded = std::find_if(added.rbegin(), added.rend(), [&](const AddedEffect& effect) {
      return effect.effect.name != "gust" &&
             !Objection(effect.effect, after.parameters, model).empty();
    });
    if (faded != added.rend()) {
      result.warnings.push_back(faded->effect.name +
                                " was chosen, but the online estimate does not confirm it: " +
                                Objection(faded->effect, after.parameters, model));
      added.erase(std::next(faded).base());
      continue;
    }
    result.accelerometer_before = HeldOutForce(residual, declared, *replay.last);
    result.accelerometer_after = HeldOutForce(residual, model, *after.replay.last);
    PredictionFigures was = before.held_out, is = after.held_out;
    if (result.accelerometer_before && result.accelerometer_after) {
      was.force_rmse_N = result.accelerometer_before;
      is.force_rmse_N = result.accelerometer_after;
    }
    if (IsBetter(was, is)) {
      result.after = after.held_out;
      result.parameters = after.parameters;
      result.effect_names = extended.effects;
      for (AddedEffect& effect : added) {
        effect.derived = DerivedFigures(vehicle, effect.effect.name, after.parameters);
        for (ParameterEstimate& p : effect.effect.parameters) {
          const ParameterEstimate* online = after.parameters.Find(p.full_name);
          if (online != nullptr) p = *online;
        }
      }
      result.effects = added;
      fill_samples(after.prediction);
      return result;
    }
    result.warnings.push_back(added.back().effect.name +
                              " was chosen, but did not predict blocks held out any better (" +
                              ChangeText(was, is) + ")");
    const bool was_gust = added.back().effect.name == "gust";
    added.pop_back();
    if (was_gust && added.empty()) added.swap(shadows);
  }
  if (result.verdict == Verdict::kEffect) {
    result.verdict = structured ? Verdict::kUnexplained : Verdict::kNone;
  }
  if (result.verdict == Verdict::kUnexplained) {
    result.where = Where(result.structure, flight, first_residual);
  }
  fill_samples(before.prediction);
  return result;
}

}  // namespace odmc
