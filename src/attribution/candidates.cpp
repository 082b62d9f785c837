#include "odmc/attribution/candidates.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>

#include "odmc/attribution/model_point.h"
#include "odmc/model/effect.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr int kSections = 8;  // to 2 % of the bracket

/// Where `score` is best for a positive x in [low, high], by golden section in log(x).
double BestBetween(double low, double high, const std::function<double(double)>& score) {
  const double share = 0.5 * (std::sqrt(5.0) - 1.0);
  double a = std::log(low), b = std::log(high);
  double x1 = b - share * (b - a), x2 = a + share * (b - a);
  double s1 = score(std::exp(x1)), s2 = score(std::exp(x2));
  for (int i = 0; i < kSections; ++i) {
    if (s1 > s2) {
      b = x2;
      x2 = x1;
      s2 = s1;
      x1 = b - share * (b - a);
      s1 = score(std::exp(x1));
    } else {
      a = x1;
      x1 = x2;
      s1 = s2;
      x2 = a + share * (b - a);
      s2 = score(std::exp(x2));
    }
  }
  return std::exp(s1 > s2 ? x1 : x2);
}

bool IsListed(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// True if the model estimates the thrust coefficient.
bool FitsThrust(const Vehicle& vehicle) {
  const DynamicModel model(vehicle, vehicle.effects);
  const int k_f = model.IndexOf("thrust.k_f");
  return k_f >= 0 && model.parameters()[k_f].estimated;
}

/// @pre the flight has samples
FlownRange RangeOf(const FlightMotion& flight, const Vehicle& vehicle) {
  const Eigen::Matrix3d R_SB = vehicle.odometry.q_BS.toRotationMatrix().transpose();
  std::vector<double> heights, speeds, descents;
  for (const FilteredMotion& m : flight.samples) {
    heights.push_back(m.p_WS.z());
    speeds.push_back(m.v_WS.norm());
    descents.push_back(-m.v_WS.dot(m.R_WS * R_SB.col(2)));
  }
  for (std::vector<double>* sorted : {&heights, &speeds, &descents}) {
    std::sort(sorted->begin(), sorted->end());
  }
  // What a few samples show may be an error of theirs; of a long flight, two seconds are enough.
  constexpr double kTail_s = 2.0;
  const double mean_step_s = (flight.samples.back().t_s - flight.samples.front().t_s) /
                             static_cast<double>(flight.samples.size());
  const size_t tail =
      std::min(heights.size() / 20, static_cast<size_t>(kTail_s / std::max(1e-3, mean_step_s)));
  const size_t high = heights.size() - 1 - tail;
  return {flight.samples.front().t_s,
          flight.samples.back().t_s,
          heights.front(),
          heights[high] - heights[tail],
          speeds[high],
          std::max(0.0, descents[high]),
          flight.stood_z_m};
}

/// True if the motion would tell where a sensor sits: a point at a natural distance from the body's
/// origin swings by more than what a good model leaves of the force (2 to 3 % of the weight on
/// recorded flights). On calmer flights its regressors would fit what else is missing.
/// @pre the flight has samples
bool SwingsPoints(const FlightMotion& flight, const Vehicle& vehicle) {
  constexpr double kLeastShare = 0.03;  // of gravity
  constexpr double kNatural = 0.3;      // of the arms' length
  double sum = 0.0;
  for (const FilteredMotion& m : flight.samples) {
    sum += m.w_dot_S.squaredNorm() + std::pow(m.w_S.squaredNorm(), 2);
  }
  const double per_metre_1_s2 = std::sqrt(sum / static_cast<double>(flight.samples.size()));
  return kNatural * vehicle.ArmLength() * per_metre_1_s2 > kLeastShare * vehicle.gravity_m_s2;
}

/// By full names what an effect has by short ones.
std::map<std::string, double> Full(const std::string& effect,
                                   const std::map<std::string, double>& values) {
  std::map<std::string, double> full;
  for (const auto& [name, value] : values) full[effect + "." + name] = value;
  return full;
}

/// A setting where `score` is best, in steps that are halved; not more than half a step of the grid
/// before where it was.
EffectCandidate RefinedByStep(const EffectCandidate& candidate, const SettingRefinement& refinement,
                              const std::function<double(const EffectCandidate&)>& score) {
  const std::string name = candidate.effect + "." + refinement.parameter;
  EffectCandidate best = candidate;
  double most = score(best);
  const double first = candidate.settings.at(name) - 0.5 * refinement.step;
  for (double step = refinement.step / 2.0; step > refinement.least_step; step /= 2.0) {
    EffectCandidate trial = best;
    const double middle = best.settings.at(name);
    for (const double at : {std::max(first, middle - step), middle + step}) {
      trial.settings[name] = at;
      const double value = score(trial);
      if (value <= most) continue;
      most = value;
      best = trial;
    }
  }
  return best;
}

/// A setting where `score` is best within a factor to either side.
EffectCandidate RefinedByRatio(const EffectCandidate& candidate,
                               const SettingRefinement& refinement,
                               const std::function<double(const EffectCandidate&)>& score) {
  const std::string name = candidate.effect + "." + refinement.parameter;
  const bool is_fitted = candidate.fitted.count(name) > 0;
  const double start = (is_fitted ? candidate.start : candidate.settings).at(name);
  EffectCandidate best = candidate, trial = candidate;
  (is_fitted ? best.start : best.settings)[name] =
      BestBetween(start / refinement.ratio, start * refinement.ratio, [&](double value) {
        (is_fitted ? trial.start : trial.settings)[name] = value;
        return score(trial);
      });
  return best;
}

/// The effect a parameter belongs to; null for one of none.
std::unique_ptr<Effect> OwnerOf(const std::string& full_name, const Vehicle& vehicle) {
  const std::string name = full_name.substr(0, full_name.find('.'));
  const EffectRegistry& registry = EffectRegistry::Default();
  return registry.Has(name) ? registry.Make(name, vehicle) : nullptr;
}

bool IsAddedMass(const Effect& effect, const std::string& full_name) {
  return !effect.added_mass_parameter().empty() &&
         full_name == effect.name() + "." + effect.added_mass_parameter();
}

/// What `effect` says of `alternative`.
std::string OwnTellingManoeuvre(const Vehicle& vehicle, const std::string& effect,
                                const std::string& alternative) {
  const EffectRegistry& registry = EffectRegistry::Default();
  if (!registry.Has(effect)) return "";
  for (const DistinguishingManoeuvre& pair :
       registry.Make(effect, vehicle)->distinguishing_manoeuvres()) {
    if (pair.other == alternative) return pair.manoeuvre;
  }
  return "";
}

}  // namespace

std::string ValleyNameOf(const EffectCandidate& candidate) {
  std::string name = candidate.effect;
  for (const auto& [parameter, bounds] : candidate.bounds) {
    if (candidate.start.count(parameter) == 0) continue;
    const bool is_one_sided = bounds.first * bounds.second >= 0.0;
    const bool has_mirror = candidate.fitted.count(parameter) == 0;
    if (is_one_sided && has_mirror) name += bounds.second > 0.0 ? " +" : " -";
  }
  return name;
}

std::vector<EffectCandidate> CandidatesFor(const Vehicle& vehicle, const FlightMotion& flight) {
  std::vector<EffectCandidate> candidates;
  if (flight.samples.empty()) return candidates;
  const FlownRange flown = RangeOf(flight, vehicle);
  const bool fits_thrust = FitsThrust(vehicle);
  for (const std::string& name : EffectRegistry::Default().names()) {
    if (IsListed(vehicle.effects, name)) continue;
    const std::unique_ptr<Effect> effect = EffectRegistry::Default().Make(name, vehicle);
    for (const EffectTrial& trial : effect->Trials(flown, fits_thrust)) {
      const bool is_place = !effect->adds_wrench() && !trial.freed.empty();
      if (is_place && !SwingsPoints(flight, vehicle)) continue;
      EffectCandidate& candidate = candidates.emplace_back();
      candidate.effect = name;
      candidate.settings = Full(name, trial.settings);
      candidate.start = Full(name, trial.start);
      candidate.refinements = effect->refinements();
      for (const std::string& size : effect->size_parameters()) {
        if (trial.start.count(size) > 0) candidate.size = name + "." + size;
      }
      for (const std::string& freed : trial.freed) {
        candidate.freed.push_back(name + "." + freed);
      }
      for (const std::string& fitted : trial.fitted) candidate.fitted.insert(name + "." + fitted);
      for (const auto& [bounded, bounds] : trial.bounds) {
        candidate.bounds[name + "." + bounded] = bounds;
      }
    }
  }
  return candidates;
}

std::vector<EffectCandidate> CandidatesFor(const Vehicle& vehicle,
                                           const std::vector<const FlightMotion*>& flights) {
  if (flights.size() == 1) return CandidatesFor(vehicle, *flights.front());
  std::vector<EffectCandidate> all;
  for (const FlightMotion* flight : flights) {
    for (EffectCandidate& candidate : CandidatesFor(vehicle, *flight)) {
      const std::unique_ptr<Effect> effect =
          EffectRegistry::Default().Make(candidate.effect, vehicle);
      const std::string onset = candidate.effect + "." + effect->onset_parameter();
      const auto from = candidate.settings.find(onset);
      if (from != candidate.settings.end() && from->second > 0.0) continue;
      const bool known = std::any_of(all.begin(), all.end(), [&](const EffectCandidate& other) {
        return other.effect == candidate.effect && other.settings == candidate.settings &&
               other.start == candidate.start;
      });
      if (!known) all.push_back(std::move(candidate));
    }
  }
  return all;
}

std::vector<EffectCandidate> WithoutEffects(std::vector<EffectCandidate> candidates,
                                            const std::vector<std::string>& effects) {
  for (const std::string& name : effects) {
    if (EffectRegistry::Default().Has(name)) continue;
    throw std::invalid_argument("effects that are ruled out: '" + name +
                                "' is none; list_effects shows all");
  }
  const auto is_out = [&](const EffectCandidate& c) { return IsListed(effects, c.effect); };
  candidates.erase(std::remove_if(candidates.begin(), candidates.end(), is_out), candidates.end());
  return candidates;
}

bool IsOrdinary(const Vehicle& vehicle, const RankedEffect& ranked) {
  const std::unique_ptr<Effect> effect = EffectRegistry::Default().Make(ranked.name, vehicle);
  const double ordinary = effect->ordinary_sigma();
  if (ordinary == 0.0) return false;
  const ParameterSpec& own = effect->parameters().front();
  const ParameterEstimate* found = ranked.Find(ranked.name + "." + own.name);
  if (found == nullptr) return false;
  const auto log_density = [&](double sigma) {
    const double variance = sigma * sigma + found->sigma * found->sigma;
    return -0.5 * (found->value * found->value / variance + std::log(variance));
  };
  return log_density(ordinary) >= log_density(own.prior_sigma);
}

std::string OrdinaryText(const Vehicle& vehicle, const RankedEffect& ranked) {
  const std::unique_ptr<Effect> effect = EffectRegistry::Default().Make(ranked.name, vehicle);
  const ParameterSpec& own = effect->parameters().front();
  const ParameterEstimate* found = ranked.Find(ranked.name + "." + own.name);
  return ranked.name + "." + own.name + " is " + Rounded(found->value) + " +- " +
         Rounded(found->sigma) + " " + own.unit +
         ", no more than on any recording (one sigma: " + Rounded(effect->ordinary_sigma()) + " " +
         own.unit + "): not named an effect";
}

std::set<std::string> EffectsOf(const std::vector<EffectCandidate>& candidates) {
  std::set<std::string> names;
  for (const EffectCandidate& candidate : candidates) names.insert(candidate.effect);
  return names;
}

EffectCandidate WithRefinedSettings(const EffectCandidate& candidate,
                                    const std::function<double(const EffectCandidate&)>& score) {
  EffectCandidate best = candidate;
  for (const SettingRefinement& refinement : candidate.refinements) {
    const std::string name = candidate.effect + "." + refinement.parameter;
    const auto setting = best.settings.find(name);
    const bool is_held = setting != best.settings.end() && setting->second > refinement.above;
    if (!is_held && best.fitted.count(name) == 0) continue;
    best = refinement.ratio > 0.0 ? RefinedByRatio(best, refinement, score)
                                  : RefinedByStep(best, refinement, score);
  }
  return best;
}

std::vector<ParameterEstimate> DerivedFigures(const Vehicle& vehicle, const std::string& name,
                                              const ParameterSet& online) {
  std::vector<ParameterEstimate> derived;
  const std::unique_ptr<Effect> effect = EffectRegistry::Default().Make(name, vehicle);
  double mass_kg = vehicle.mass_kg;
  for (const ParameterEstimate& p : online.parameters) {
    const std::unique_ptr<Effect> owner = OwnerOf(p.full_name, vehicle);
    if (owner != nullptr && IsAddedMass(*owner, p.full_name)) mass_kg += p.value;
  }
  Eigen::VectorXd own(static_cast<Eigen::Index>(effect->parameters().size()));
  for (size_t i = 0; i < effect->parameters().size(); ++i) {
    const ParameterSpec& spec = effect->parameters()[i];
    const ParameterEstimate* p = online.Find(name + "." + spec.name);
    own[static_cast<Eigen::Index>(i)] = p != nullptr ? p->value : spec.prior_value;
    if (p == nullptr || !IsAddedMass(*effect, p->full_name)) continue;
    derived.push_back(
        {name + ".total_mass", p->unit, mass_kg, p->sigma, p->estimated, p->observable});
  }
  for (const DerivedFigure& figure : effect->DerivedFigures(own)) {
    derived.push_back({name + "." + figure.name, figure.unit, figure.value, 0.0, false, false});
  }
  return derived;
}

bool IsSizeParameter(const Vehicle& vehicle, const std::string& full_name) {
  const size_t dot = full_name.find('.');
  const std::vector<std::string> sizes =
      EffectRegistry::Default().Make(full_name.substr(0, dot), vehicle)->size_parameters();
  return sizes.empty() ||
         std::find(sizes.begin(), sizes.end(), full_name.substr(dot + 1)) != sizes.end();
}

std::string TellingManoeuvre(const Vehicle& vehicle, const std::string& effect,
                             const std::string& alternative) {
  const std::string one = OwnTellingManoeuvre(vehicle, effect, alternative);
  return one.empty() ? OwnTellingManoeuvre(vehicle, alternative, effect) : one;
}

}  // namespace odmc
