// What attribution does with the effects it has found: it fits the model with them, looks again
// about the fit, and takes away what does not hold there.

#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "odmc/attribution/attribution.h"
#include "odmc/attribution/contained_effects.h"
#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

// Motion is in proportion to the inverse of inertia: so far a change of inertia is in proportion.
constexpr double kProportional = 0.1;
constexpr int kRefits = 5;  // at most
constexpr int kInertiaRefits = 2;
constexpr double kDecides = 3.0;  // times clear_odds, a million to one: a valley is none
constexpr size_t kRivals = 3;     // that are fitted, at most

/// A point without some effects.
ModelPoint Without(ModelPoint point, const std::function<bool(const std::string&)>& is_dropped) {
  std::vector<std::string>& effects = point.vehicle.effects;
  effects.erase(std::remove_if(effects.begin(), effects.end(), is_dropped), effects.end());
  const auto erase = [&](auto* by_name) {
    for (auto it = by_name->begin(); it != by_name->end();) {
      const bool gone = is_dropped(it->first.substr(0, it->first.find('.')));
      it = gone ? by_name->erase(it) : std::next(it);
    }
  };
  erase(&point.vehicle.parameters);
  erase(&point.values);
  erase(&point.scatter);
  for (auto& own : point.own) erase(&own);
  return point;
}

/// True for what swings on each flight in its own way: it is not linearized about one start.
bool SwingsByFlight(const std::string& effect, const ModelPoint& point) {
  return std::any_of(point.own.begin(), point.own.end(), [&](const auto& own) {
    return std::any_of(own.begin(), own.end(),
                       [&](const auto& value) { return value.first.rfind(effect + ".", 0) == 0; });
  });
}

/// False where a fit that began in a candidate's valley has ended in another one.
bool StaysIn(const EffectCandidate& candidate, const ModelPoint& fit) {
  return std::all_of(candidate.bounds.begin(), candidate.bounds.end(), [&](const auto& bounded) {
    const auto& [name, bounds] = bounded;
    const auto value = fit.values.find(name);
    if (value == fit.values.end() || bounds.first * bounds.second < 0.0) return true;
    return value->second >= bounds.first && value->second <= bounds.second;
  });
}

VariantSet AllOf(const Evidence& evidence) {
  VariantSet all;
  for (size_t v = 0; v < evidence.variants().size(); ++v) all.insert(static_cast<int>(v));
  return all;
}

}  // namespace

std::vector<ResidualModel::Wrenches> Attribution::Refit(ModelPoint* point) const {
  std::vector<ResidualModel::Wrenches> residuals;
  for (int round = 0; round < kRefits; ++round) {
    Evidence evidence(flights_, *point, jobs_);
    evidence.EstimateNoise();
    const EffectFit posterior = evidence.Solve({});
    residuals = evidence.ResidualsOf({}, posterior);
    double moved = 0.0;
    for (size_t k = 0; k < posterior.columns.size(); ++k) {
      const auto at = static_cast<Eigen::Index>(k);
      moved = std::max(
          moved, std::abs(posterior.coefficients[at]) / std::sqrt(posterior.covariance(at, at)));
    }
    ModelPoint next = evidence.Moved({}, posterior);
    for (const auto& [name, value] : point->values) {
      // Where little is foreseen of torque, the unforeseen rest grows as inertia gets smaller, and
      // the fit runs after it.
      if (round >= kInertiaRefits && name.rfind("inertia.", 0) == 0) next.values[name] = value;
    }
    *point = std::move(next);
    constexpr double kSettled = 0.1;  // sigmas
    if (moved < kSettled) break;
  }
  const DynamicModel model(point->vehicle, point->vehicle.effects);
  for (size_t f = 0; f < residuals.size(); ++f) {
    residuals[f] = flights_[f].residual->AsFelt(std::move(residuals[f]), model,
                                                ValuesOf(model, point->OfFlight(f).values));
  }
  return residuals;
}

Evidence Attribution::EvidenceAtFit(const ModelPoint& fitted, const Vehicle& vehicle,
                                    std::vector<EffectCandidate> added) const {
  ModelPoint point = fitted;
  point.vehicle = vehicle;
  const InertiaBounds bounds = InertiaBoundsOf(vehicle);
  for (int i = 0; i < 3; ++i) {
    const std::string axis = std::string("inertia.") + "xyz"[i];
    const auto found = fitted.values.find(axis);
    if (found == fitted.values.end()) continue;
    const double value = std::clamp(found->second, bounds.least[i], bounds.most[i]);
    ParameterSetting& setting = point.vehicle.parameters[axis];
    setting.value = value;
    setting.sigma = std::min(setting.sigma.value_or(value), kProportional * value);
  }
  Evidence evidence(flights_, point, jobs_);
  for (EffectCandidate& candidate : added) {
    for (const std::string& name : candidate.fitted) {
      candidate.settings[name] = fitted.values.at(name);
    }
    candidate.fitted.clear();
    for (const auto& [name, value] : fitted.values) {
      const bool is_own = name.rfind(candidate.effect + ".", 0) == 0;
      if (is_own && candidate.settings.count(name) == 0) candidate.start[name] = value;
    }
    evidence.Add(candidate);
  }
  evidence.EstimateNoise();
  return evidence;
}

double Attribution::HeldOutScore(const Evidence& evidence, const VariantSet& set, int variant) {
  VariantSet others = set;
  others.erase(variant);
  return evidence.HeldOutGain(set, others);
}

bool Attribution::IsHollow(double score, double other) const {
  // The noise holds what else is missing, and what is weak drowns in it: a coefficient of which
  // nothing is known loses a few nats to its prior. Then the other evidence decides.
  const bool may_drown = score > -options_.clear_odds;
  return score < 0.0 && !(may_drown && other > options_.clear_odds);
}

void Attribution::Refuse(const std::string& effect, double score, const std::string& why) {
  refused_[effect] = why;
  for (RankedEffect& ranked : ranking_) {
    if (ranked.name != effect || ranked.score < score) continue;
    ranked.score = score;
    ranked.p_value = PValue(score);
  }
  SortByScore(&ranking_);
}

bool Attribution::IsHollowCandidate(const EffectCandidate& candidate) const {
  return hollow_.count(candidate.effect) > 0 || hollow_.count(ValleyNameOf(candidate)) > 0;
}

// What two effects do alike, each does for nothing beside the other: the weakest goes, and the next
// round looks at the other again.
bool Attribution::RejectByRescoring(const Evidence& evidence, const VariantSet& set,
                                    const ModelPoint& fitted) {
  std::vector<EffectCandidate> added;
  std::map<std::string, double> first_scores;
  std::map<std::string, std::string> valleys;
  for (const int v : set) {
    added.push_back(evidence.variants()[v].candidate);
    VariantSet others = set;
    others.erase(v);
    first_scores[added.back().effect] = ScoreOf(evidence, set, others);
    valleys[added.back().effect] = ValleyNameOf(added.back());
  }
  const Evidence at_fit = EvidenceAtFit(fitted, point_.vehicle, added);
  const VariantSet all = AllOf(at_fit);
  std::string weakest, why;
  double least = 0.0;
  for (const int v : all) {
    const std::string& effect = at_fit.variants()[v].candidate.effect;
    if (SwingsByFlight(effect, fitted)) continue;
    VariantSet others = all;
    others.erase(v);
    const double score = ScoreOf(at_fit, all, others);
    second_scores_[effect] = score;
    const double held_out = HeldOutScore(at_fit, all, v);
    second_totals_[effect] = score + held_out;
    // p(all) = p(in use) p(held out | in use): what blocks held out say weighs as much.
    const double first = first_scores.at(effect), total = first + held_out;
    const bool is_hollow = IsHollow(score, total);
    if (!is_hollow && total >= 0.0) continue;
    const double stays = is_hollow ? score : total;
    if (!weakest.empty() && stays >= least) continue;
    weakest = effect;
    least = stays;
    why = is_hollow ? "gains " + Rounded(score) + " nats about what the fit with it has found"
                    : "gains " + Rounded(first) + " nats, but loses " + Rounded(-held_out) +
                          " on blocks held out";
  }
  if (weakest.empty()) return false;
  Refuse(weakest, least, why);
  hollow_.insert(valleys.at(weakest));
  return true;
}

Attribution::FittedSet Attribution::FitSet(Evidence* evidence, const VariantSet& set) const {
  FittedSet fitted;
  fitted.set = set;
  fitted.profiles = HoldSettings(evidence, &fitted.set);
  fitted.point = evidence->Moved(fitted.set, evidence->Solve(fitted.set));
  fitted.left = Refit(&fitted.point);
  return fitted;
}

double Attribution::SecondTotal(Evidence evidence, const VariantSet& set, const std::string& effect,
                                ModelPoint* fit) const {
  const FittedSet fitted = FitSet(&evidence, set);
  std::vector<EffectCandidate> added;
  for (const int v : fitted.set) added.push_back(evidence.variants()[v].candidate);
  *fit = fitted.point;
  const Evidence at_fit = EvidenceAtFit(fitted.point, point_.vehicle, added);
  const VariantSet all = AllOf(at_fit);
  for (const int v : all) {
    if (at_fit.variants()[v].candidate.effect != effect) continue;
    VariantSet others = all;
    others.erase(v);
    return ScoreOf(at_fit, all, others) + HeldOutScore(at_fit, all, v);
  }
  return -std::numeric_limits<double>::infinity();
}

std::vector<Attribution::Rival> Attribution::RivalsOf(const Evidence& evidence,
                                                      const VariantSet& set, int variant) const {
  const double gain = evidence.GainInNats(set);
  const EffectCandidate& own = evidence.variants()[variant].candidate;
  VariantSet others = set;
  others.erase(variant);
  std::map<std::string, Rival> best;
  for (int other = 0; other < static_cast<int>(evidence.variants().size()); ++other) {
    const EffectCandidate& candidate = evidence.variants()[other].candidate;
    const bool is_in = std::any_of(others.begin(), others.end(), [&](int in) {
      return evidence.variants()[in].candidate.effect == candidate.effect;
    });
    const std::string valley = ValleyNameOf(candidate);
    if (is_in || valley == ValleyNameOf(own)) continue;
    Rival rival{candidate.effect, valley, other, others, 0.0};
    rival.set.insert(other);
    rival.behind = gain - evidence.GainInNats(rival.set);
    const double most =
        candidate.effect == own.effect ? options_.most_unexplained * gain : options_.even_odds;
    const auto known = best.find(valley);
    if (rival.behind > most || (known != best.end() && known->second.behind <= rival.behind)) {
      continue;
    }
    best[valley] = std::move(rival);
  }
  std::vector<Rival> rivals;
  rivals.reserve(best.size());
  for (auto& entry : best) rivals.push_back(std::move(entry.second));
  std::sort(rivals.begin(), rivals.end(),
            [](const Rival& a, const Rival& b) { return a.behind < b.behind; });
  if (rivals.size() > kRivals) rivals.resize(kRivals);
  return rivals;
}

bool Attribution::IsConfirmed(const Evidence& evidence, const VariantSet& set) {
  const FlexibleRest flexible = flexible_;
  const std::map<std::string, std::string> refused = refused_;
  const bool is_confirmed = Confirmed(evidence, set) == set;
  flexible_ = flexible;
  refused_ = refused;
  return is_confirmed;
}

std::optional<VariantSet> Attribution::BetterRival(const Evidence& evidence,
                                                   const VariantSet& set) {
  for (const int v : set) {
    const EffectCandidate& own = evidence.variants()[v].candidate;
    const auto second = second_totals_.find(own.effect);
    if (second == second_totals_.end()) continue;
    for (const Rival& rival : RivalsOf(evidence, set, v)) {
      const bool is_same = rival.effect == own.effect;
      if (!is_same && !IsConfirmed(evidence, rival.set)) continue;
      ModelPoint fit;
      const double held = SecondTotal(evidence, rival.set, rival.effect, &fit);
      if (is_same && !StaysIn(evidence.variants()[rival.variant].candidate, fit)) continue;
      // What is merely less likely stays in the sigmas.
      const double decides = kDecides * options_.clear_odds;
      if (is_same && held + decides < second->second) refuted_.insert(rival.valley);
      if (held <= second->second + options_.even_odds) continue;
      if (is_same && second->second + decides < held) refuted_.insert(ValleyNameOf(own));
      if (!is_same) {
        refused_[own.effect] = "promises as much as " + rival.effect +
                               ", of which its fit bears out " + Rounded(held) +
                               " nats, and that with it " + Rounded(second->second);
      }
      return rival.set;
    }
  }
  return std::nullopt;
}

bool Attribution::DropSuperseded(size_t newest) {
  bool dropped = false;
  while (effects_.size() > newest) {
    std::vector<EffectCandidate> candidates;
    for (const RankedEffect& effect : effects_) candidates.push_back(named_.at(effect.name));
    const auto is_named = [this](const std::string& effect) { return named_.count(effect) > 0; };
    const Evidence at_fit = EvidenceAtFit(point_, Without(point_, is_named).vehicle, candidates);
    const VariantSet all = AllOf(at_fit);
    std::optional<std::string> weakest;
    double least = 0.0;
    for (const int v : all) {
      const std::string& effect = at_fit.variants()[v].candidate.effect;
      const auto earlier_end = effects_.end() - static_cast<std::ptrdiff_t>(newest);
      const bool is_earlier =
          std::any_of(effects_.begin(), earlier_end,
                      [&](const RankedEffect& ranked) { return ranked.name == effect; });
      if (!is_earlier || SwingsByFlight(effect, point_)) continue;
      VariantSet others = all;
      others.erase(v);
      const double score = ScoreOf(at_fit, all, others);
      if (!IsHollow(score, HeldOutScore(at_fit, all, v)) || (weakest && score >= least)) continue;
      weakest = effect;
      least = score;
    }
    if (!weakest) {
      UpdateSigmas(at_fit, newest);
      return dropped;
    }
    Refuse(*weakest, least, "gains " + Rounded(least) + " nats beside what was found later");
    superseded_.insert(*weakest);
    Drop({*weakest});
    dropped = true;
  }
  return dropped;
}

void Attribution::StartAgain(const ModelPoint& declared) {
  effects_.clear();
  named_.clear();
  energy_.clear();
  second_scores_.clear();
  second_totals_.clear();
  refuted_.clear();
  hollow_ = superseded_;
  gain_ = held_out_gain_ = 0.0;
  point_ = declared;
  after_ = before_;
}

void Attribution::Drop(const std::set<std::string>& names) {
  const auto is_dropped = [&](const std::string& effect) { return names.count(effect) > 0; };
  effects_.erase(std::remove_if(effects_.begin(), effects_.end(),
                                [&](const RankedEffect& e) { return is_dropped(e.name); }),
                 effects_.end());
  for (const std::string& name : names) {
    named_.erase(name);
    energy_.erase(name);
  }
  point_ = Without(point_, is_dropped);
  after_ = Refit(&point_);
  for (RankedEffect& effect : effects_) UpdateValues(&effect);
}

void Attribution::UpdateValues(RankedEffect* effect) const {
  for (ParameterEstimate& p : effect->parameters) {
    const auto it = point_.values.find(p.full_name);
    if (it != point_.values.end()) p.value = it->second;
  }
}

void Attribution::UpdateSigmas(const Evidence& at_fit, size_t newest) {
  const EffectFit fit = at_fit.Solve(AllOf(at_fit));
  for (size_t e = 0; e + newest < effects_.size(); ++e) {
    RankedEffect& effect = effects_[e];
    std::vector<Eigen::Index> own;
    std::vector<double> sigmas;
    for (const ParameterEstimate& p : effect.parameters) {
      for (size_t k = 0; k < fit.columns.size(); ++k) {
        const Evidence::Column& column = at_fit.column(fit.columns[k]);
        if (!p.estimated || column.name != p.full_name || column.flight >= 0) continue;
        own.push_back(static_cast<Eigen::Index>(k));
        sigmas.push_back(std::sqrt(std::max(0.0, fit.covariance(own.back(), own.back()))));
      }
    }
    const auto is_estimated = [](const ParameterEstimate& p) { return p.estimated; };
    const auto estimated =
        std::count_if(effect.parameters.begin(), effect.parameters.end(), is_estimated);
    const auto n = static_cast<std::ptrdiff_t>(own.size());
    if (n != estimated || effect.covariance.rows() != n) continue;
    effect.covariance = fit.covariance(own, own);
    size_t next = 0;
    for (ParameterEstimate& p : effect.parameters) {
      if (p.estimated) p.sigma = sigmas[next++];
    }
  }
}

void Attribution::DropContained(size_t newest) {
  const auto split = static_cast<std::ptrdiff_t>(effects_.size() - newest);
  std::vector<std::string> earlier;
  std::for_each(effects_.begin(), effects_.begin() + split,
                [&](const RankedEffect& effect) { earlier.push_back(effect.name); });
  std::set<std::string> dropped;
  for (size_t k = earlier.size(); k < effects_.size() && !earlier.empty(); ++k) {
    for (const std::string& name : ContainedEffects(flights_, point_, earlier, effects_[k].name)) {
      if (!dropped.insert(name).second) continue;
      const auto it = std::find_if(effects_.begin(), effects_.end(),
                                   [&](const RankedEffect& effect) { return effect.name == name; });
      // Its own score was what it gains beside the other.
      effects_[k].score += it->score;
      std::array<double, kNumChannels>& energy = energy_[effects_[k].name];
      for (int c = 0; c < kNumChannels; ++c) energy[c] += energy_[name][c];
      effects_[k].p_value = std::min(effects_[k].p_value, it->p_value);
    }
  }
  if (dropped.empty()) return;
  Drop(dropped);
}

}  // namespace odmc
