#include "odmc/attribution/attribution.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <utility>

#include "odmc/analysis/parallel.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr size_t kFittedSettings = 3;  // by either measure, and their refinement
constexpr int kPolishes = 8;           // linearizations of what is not linear, at most
constexpr int kFirstPolishes = 3;      // of what gains nothing
constexpr double kPolished = 0.2;      // sigmas: a smaller step ends them
constexpr int kSurrogates = 300;       // their 30 largest give the tail to 18 %
constexpr size_t kMostFeatures = 10;   // that complete a set
constexpr double kTail = 0.1;          // share of surrogates whose excess gives the tail

std::vector<Instruments> InstrumentsOf(const std::vector<const ResidualModel*>& residuals) {
  std::vector<Instruments> instruments;
  for (const ResidualModel* r : residuals) instruments.emplace_back(r->flight(), r->file_vehicle());
  return instruments;
}

std::vector<FlightWithInstruments> Seen(const std::vector<const ResidualModel*>& residuals,
                                        const std::vector<Instruments>& instruments) {
  std::vector<FlightWithInstruments> seen;
  for (size_t f = 0; f < residuals.size(); ++f) seen.push_back({residuals[f], &instruments[f]});
  return seen;
}

/// What of the parameters' uncertainty comes from settings: their regression on these,
/// Sigma_bt Sigma_tt^-1 Sigma_tb.
/// @param settings among the fit's columns
void BeginSpread(const std::vector<Eigen::Index>& settings, const Evidence& evidence,
                 const EffectFit& fit, RankedEffect* ranked) {
  std::vector<Eigen::Index> others;
  for (size_t k = 0; k < fit.columns.size(); ++k) {
    const Evidence::Column& column = evidence.column(fit.columns[k]);
    const auto at = static_cast<Eigen::Index>(k);
    const bool is_setting = std::count(settings.begin(), settings.end(), at) > 0;
    // Inertia is the file's here, and online the estimator's own.
    if (is_setting || column.effect.empty() || column.effect == "inertia" || column.flight >= 0) {
      continue;
    }
    others.push_back(at);
    ranked->spread_of.push_back(column.name);
  }
  const auto n = static_cast<Eigen::Index>(others.size());
  ranked->spread = Eigen::MatrixXd::Zero(n, n);
  if (settings.empty()) return;
  const Eigen::MatrixXd cross = fit.covariance(others, settings);
  const Eigen::MatrixXd of_settings = fit.covariance(settings, settings);
  ranked->spread = cross * of_settings.ldlt().solve(cross.transpose());
}

/// Another valley in which a fit may as well lie, with a load of the other sign at the other side.
struct Valley {
  /// Chance that it is the right one, times the square of the way there [sigma].
  double weight = 0.0;
  Eigen::MatrixXd spread;  ///< that chance times the square of the way, of RankedEffect::spread_of
};

/// @param own columns of the effect in `fit`
/// @returns weight 0 for the same valley
Valley ValleyOf(const EffectFit& other, const Evidence& evidence, const EffectFit& fit,
                const std::vector<Eigen::Index>& own, const RankedEffect& ranked) {
  constexpr double kSigmas = 3.0;  // nearer it is the same valley
  const auto change = [&](const std::string& name) {
    const auto value = [&](const EffectFit& of) -> std::optional<double> {
      for (size_t k = 0; k < of.columns.size(); ++k) {
        if (evidence.column(of.columns[k]).name != name) continue;
        return of.coefficients[static_cast<Eigen::Index>(k)];
      }
      return std::nullopt;
    };
    const std::optional<double> there = value(other), here = value(fit);
    return there && here ? *there - *here : 0.0;
  };
  Eigen::VectorXd own_way(static_cast<Eigen::Index>(own.size()));
  for (Eigen::Index k = 0; k < own_way.size(); ++k) {
    const auto at = static_cast<size_t>(own[static_cast<size_t>(k)]);
    own_way[k] = change(evidence.column(fit.columns[at]).name);
  }
  const double distance = own_way.dot(ranked.covariance.ldlt().solve(own_way));
  if (distance < kSigmas * kSigmas) return {};
  Eigen::VectorXd way(ranked.spread.rows());
  for (Eigen::Index k = 0; k < way.size(); ++k) {
    way[k] = change(ranked.spread_of[static_cast<size_t>(k)]);
  }
  const double chance = 1.0 / (1.0 + std::exp(fit.log_evidence - other.log_evidence));
  return {chance * distance, chance * way * way.transpose()};
}

/// Variants that are linear only near where they are linearized.
std::vector<int> Nonlinear(const Evidence& evidence) {
  std::vector<int> variants;
  for (int v = 0; v < static_cast<int>(evidence.variants().size()); ++v) {
    const EffectVariant& variant = evidence.variants()[v];
    if (variant.offset >= 0 || !variant.candidate.start.empty()) variants.push_back(v);
  }
  return variants;
}

/// True if a way for an effect to act has a time from which on it does. The best of many times
/// takes more of slow noise with it than its coefficients do: beside what is not there the noise
/// would come out too small.
bool BeginsInFlight(const EffectCandidate& candidate) {
  return std::any_of(
      candidate.refinements.begin(), candidate.refinements.end(), [&](const SettingRefinement& r) {
        const auto at = candidate.settings.find(candidate.effect + "." + r.parameter);
        return r.step > 0.0 && at != candidate.settings.end() && at->second > r.above;
      });
}

/// Of each valley of each effect, all variants but the one of the highest value.
VariantSet AllButBest(const Evidence& evidence, const std::function<double(int)>& value) {
  std::map<std::pair<std::string, std::string>, std::pair<double, int>> best;
  VariantSet others;
  for (int v = 0; v < static_cast<int>(evidence.variants().size()); ++v) {
    const EffectCandidate& candidate = evidence.variants()[v].candidate;
    const std::pair<double, int> own = {value(v), v};
    const auto [known, is_first] =
        best.try_emplace({candidate.effect, ValleyNameOf(candidate)}, own);
    if (is_first) continue;
    others.insert(std::min(own, known->second).second);
    known->second = std::max(own, known->second);
  }
  return others;
}

/// The same by the evidence, what begins in flight and gains nothing, and of what was fitted
/// already what makes the flight less likely where it is linearized: its derivatives there are none
/// of an effect that acts. Not between Evidence::Relinearize() and EstimateNoise().
VariantSet AllButBest(const Evidence& evidence, bool fitted) {
  VariantSet aside = AllButBest(evidence, [&](int v) { return evidence.Solve({v}).log_evidence; });
  const double declared = evidence.Solve({}).log_evidence;
  for (const int v : fitted ? Nonlinear(evidence) : std::vector<int>()) {
    if (!(evidence.LogEvidenceWhereLinearized(v) > declared)) aside.insert(v);
  }
  for (int v = 0; v < static_cast<int>(evidence.variants().size()); ++v) {
    if (BeginsInFlight(evidence.variants()[v].candidate) && !(evidence.GainInNats({v}) > 0.0)) {
      aside.insert(v);
    }
  }
  return aside;
}

/// True if two ways to try an effect differ by signs alone, in valleys of their own.
bool AreMirrored(const EffectCandidate& a, const EffectCandidate& b) {
  if (a.settings != b.settings || a.start.size() != b.start.size()) return false;
  if (ValleyNameOf(a) == ValleyNameOf(b)) return false;
  return std::equal(
      a.start.begin(), a.start.end(), b.start.begin(), [](const auto& one, const auto& other) {
        return one.first == other.first && std::abs(one.second) == std::abs(other.second);
      });
}

/// The mean of two sets of values.
Evidence::VariantValues Halfway(Evidence::VariantValues from, const Evidence::VariantValues& to) {
  for (size_t f = 0; f < from.size(); ++f) {
    for (auto& [name, value] : from[f]) value = 0.5 * (value + to[f].at(name));
  }
  return from;
}

/// Change of a channel of the residual by effects, over its sum of squares.
double ActingShare(Eigen::Index channel, const ResidualModel::Wrenches& before,
                   const ResidualModel::Wrenches& after) {
  const double all = before.col(channel).squaredNorm();
  return all > 0.0 ? (after.col(channel) - before.col(channel)).squaredNorm() / all : 0.0;
}

}  // namespace

bool IsSensorNoise(const ChannelStructure& channel, const AttributionOptions& options) {
  if (!channel.shared) return false;
  const double sigmas = options.significant_sigmas * channel.shared->sigma;
  return channel.shared->share < sigmas &&
         channel.shared->share + sigmas < 1.0 - options.most_unexplained;
}

bool IsLean(const ChannelStructure& channel, const AttributionOptions& options) {
  if (!channel.lean_rad || *channel.lean_rad > options.most_lean_rad) return false;
  const bool is_felt =
      channel.shared && channel.shared->share > options.significant_sigmas * channel.shared->sigma;
  return !is_felt && !(channel.whiteness.quick_p < options.whiteness_p);
}

bool IsThrustWander(const ChannelStructure& channel, const AttributionOptions& options) {
  return channel.thrust_wander && *channel.thrust_wander <= options.most_thrust_wander &&
         !(channel.whiteness.quick_p < options.whiteness_p);
}

bool IsSlowError(const ChannelStructure& channel, const AttributionOptions& options) {
  return IsLean(channel, options) || IsThrustWander(channel, options);
}

bool IsStructured(const ChannelStructure& channel, const AttributionOptions& options) {
  return !IsSensorNoise(channel, options) && !IsSlowError(channel, options) &&
         channel.whiteness.p < options.whiteness_p &&
         channel.whiteness.structured_share > options.least_structured;
}

bool ActsIn(Eigen::Index channel, const ResidualModel::Wrenches& before,
            const ResidualModel::Wrenches& after, const AttributionOptions& options) {
  return ActingShare(channel, before, after) >= options.least_structured;
}

double UnexplainedStructure(const ResidualModel::Wrenches& before,
                            const ResidualModel::Wrenches& after,
                            const std::vector<ChannelStructure>& of_before,
                            const std::vector<ChannelStructure>& of_after,
                            const AttributionOptions& options) {
  std::vector<double> acting;
  for (size_t c = 0; c < of_before.size(); ++c) {
    acting.push_back(ActingShare(static_cast<Eigen::Index>(c), before, after));
  }
  const double most = acting.empty() ? 0.0 : *std::max_element(acting.begin(), acting.end());
  const double least = std::min(most, options.least_structured);
  double was = 0.0, is = 0.0;
  bool structured = false;
  for (size_t c = 0; c < of_before.size(); ++c) {
    if (!IsStructured(of_before[c], options)) continue;
    structured = true;
    if (!(acting[c] >= least)) continue;
    was += of_before[c].whiteness.nats;
    is += of_after[c].whiteness.nats;
  }
  if (was > 0.0) return is / was;
  return structured && !(most > 0.0) ? 1.0 : 0.0;
}

void DropErrorsOfFit(const std::vector<ChannelStructure>& of_estimate,
                     const AttributionOptions& options, std::vector<ChannelStructure>* of_fit) {
  for (size_t c = 0; c < of_fit->size(); ++c) {
    if (!IsStructured(of_estimate[c], options)) (*of_fit)[c].whiteness.p = 1.0;
  }
}

Attribution::Attribution(const std::vector<const ResidualModel*>& residuals, ModelPoint point,
                         std::vector<EffectCandidate> candidates, const AttributionOptions& options,
                         std::function<bool()> give_up, int jobs)
    : instruments_(InstrumentsOf(residuals)),
      flights_(Seen(residuals, instruments_)),
      features_(flights_),
      point_(std::move(point)),
      candidates_(std::move(candidates)),
      options_(options),
      give_up_(std::move(give_up)),
      jobs_(jobs) {}

std::map<std::string, std::vector<const EffectCandidate*>> Attribution::OpenCandidates(
    const Evidence& evidence) const {
  std::map<std::string, std::vector<const EffectCandidate*>> by_effect;
  for (const EffectCandidate& candidate : candidates_) {
    const std::vector<std::string>& have = evidence.point().vehicle.effects;
    if (std::find(have.begin(), have.end(), candidate.effect) != have.end()) continue;
    if (IsHollowCandidate(candidate)) continue;
    by_effect[candidate.effect].push_back(&candidate);
  }
  return by_effect;
}

std::vector<Attribution::ScreenedWay> Attribution::MostPromising(
    const std::vector<const EffectCandidate*>& settings, const Evidence& evidence) const {
  std::vector<Evidence::GainBound> promises(settings.size());
  ForEachOf(static_cast<int>(settings.size()), jobs_, [&](int i) {
    promises[static_cast<size_t>(i)] = evidence.GainBoundOf(*settings[static_cast<size_t>(i)]);
  });
  std::set<size_t> chosen;
  const auto choose = [&](double Evidence::GainBound::*by) {
    std::vector<size_t> order(promises.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::sort(order.begin(), order.end(),
              [&](size_t a, size_t b) { return promises[a].*by > promises[b].*by; });
    chosen.insert(order.begin(), order.begin() + std::min(order.size(), kFittedSettings));
  };
  choose(&Evidence::GainBound::serial);
  choose(&Evidence::GainBound::white);
  const auto most = static_cast<size_t>(
      std::max_element(promises.begin(), promises.end(),
                       [](const auto& a, const auto& b) { return a.white < b.white; }) -
      promises.begin());
  std::set<size_t> refined = {most};
  // What is linear says little of a size's sign: the fit has to.
  for (size_t i = 0; i < settings.size(); ++i) {
    const auto mirrors = [&](size_t other) { return AreMirrored(*settings[other], *settings[i]); };
    if (mirrors(most)) refined.insert(i);
    if (std::any_of(chosen.begin(), chosen.end(), mirrors)) chosen.insert(i);
  }
  std::set<std::map<std::string, double>> held;
  for (const EffectCandidate* c : settings) held.insert(c->settings);
  const double log_prior = -std::log(static_cast<double>(held.size()));
  std::vector<ScreenedWay> ways;
  ways.reserve(chosen.size() + refined.size());
  for (const size_t i : chosen) ways.push_back({*settings[i], log_prior, promises[i]});
  for (const size_t i : refined) {
    const EffectCandidate moved = WithRefinedSettings(
        *settings[i], [&](const auto& other) { return evidence.GainBoundOf(other).white; });
    if (moved.settings == settings[i]->settings && moved.start == settings[i]->start) continue;
    ways.push_back({moved, log_prior, evidence.GainBoundOf(moved)});
  }
  return ways;
}

void Attribution::Screen(Evidence* evidence) const {
  const auto by_effect = OpenCandidates(*evidence);
  std::vector<EffectCandidate> single;
  for (const auto& entry : by_effect) {
    if (entry.second.size() == 1) single.push_back(*entry.second.front());
  }
  evidence->AddAll(single);
  evidence->EstimateNoise();
  std::vector<ScreenedWay> ways;
  for (const auto& entry : by_effect) {
    if (entry.second.size() < 2 || GivesUp()) continue;
    const std::vector<ScreenedWay> of_effect = MostPromising(entry.second, *evidence);
    ways.insert(ways.end(), of_effect.begin(), of_effect.end());
  }
  std::vector<EffectCandidate> chosen;
  chosen.reserve(ways.size());
  for (const ScreenedWay& way : ways) chosen.push_back(way.candidate);
  const std::vector<int> added = evidence->AddAll(chosen);
  std::map<int, double> promise;
  VariantSet unseen;
  for (size_t k = 0; k < ways.size(); ++k) {
    if (added[k] < 0) continue;
    evidence->SetLogPrior(added[k], ways[k].log_prior);
    promise[added[k]] = ways[k].promise.white;
    const bool is_seen = ways[k].promise.serial > options_.clear_odds - ways[k].log_prior;
    if (!is_seen && BeginsInFlight(ways[k].candidate)) unseen.insert(added[k]);
  }
  VariantSet aside = AllButBest(*evidence, [&](int v) { return promise[v]; });
  aside.insert(unseen.begin(), unseen.end());
  evidence->SetAside(aside);
  evidence->EstimateNoise();
}

void Attribution::Polish(Evidence* evidence) const {
  struct Best {
    Evidence::VariantValues at;
    double gain = 0.0;
  };
  std::map<int, Best> best, highest;
  for (int round = 0; round < kPolishes && !GivesUp(); ++round) {
    std::map<int, Evidence::VariantValues> steps;
    const double declared = evidence->Solve({}).log_evidence;
    for (const int v : Nonlinear(*evidence)) {
      const EffectFit fit = evidence->Solve({v});
      const double claimed = fit.log_evidence - declared;
      if (round >= kFirstPolishes && claimed <= 0.0) continue;
      const double gain = evidence->LogEvidenceWhereLinearized(v) - declared;
      if (round > 0 && gain < best[v].gain && gain < claimed) {
        steps[v] = Halfway(evidence->LinearizedAt(v), best[v].at);
        continue;
      }
      best[v] = {evidence->LinearizedAt(v), gain};
      if (round == 0 || gain > highest[v].gain) highest[v] = best[v];
      const bool moves = round == 0 || evidence->StepInSigmas(v, fit) > kPolished;
      if (moves) steps[v] = evidence->FoundBy(fit, v);
    }
    if (steps.empty()) break;
    const VariantSet others = AllButBest(*evidence, round > 0);
    evidence->Relinearize(steps);
    evidence->SetAside(others);
    evidence->EstimateNoise();
  }
  // The last step was not looked at, and the noise has changed since: both places once more.
  std::map<int, Evidence::VariantValues> last, back;
  std::map<int, double> gains;
  for (const auto& [v, known] : highest) {
    gains[v] = evidence->LogEvidenceWhereLinearized(v);
    if (gains[v] - evidence->Solve({}).log_evidence >= known.gain - options_.even_odds) continue;
    last[v] = evidence->LinearizedAt(v);
    back[v] = known.at;
  }
  if (!back.empty()) {
    const VariantSet others = AllButBest(*evidence, true);
    evidence->Relinearize(back);
    std::map<int, Evidence::VariantValues> stay;
    for (const auto& [v, at] : last) {
      if (evidence->LogEvidenceWhereLinearized(v) < gains[v]) stay[v] = at;
    }
    if (!stay.empty()) evidence->Relinearize(stay);
    evidence->SetAside(others);
    evidence->EstimateNoise();
  }
  for (const int v : Nonlinear(*evidence)) evidence->CountWhatIsBorneOut(v);
}

double Attribution::NullGain(double share) const {
  const auto n = static_cast<double>(null_gains_.size());
  const auto at = static_cast<size_t>(std::ceil((1.0 - kTail) * n)) - 1;
  if (share >= kTail) {
    const auto k = static_cast<size_t>(std::ceil((1.0 - share) * n));
    return null_gains_[std::min(null_gains_.size() - 1, k > 0 ? k - 1 : 0)];
  }
  // Squared normal variables over two: an exponential tail of mean one, or more where the noise
  // has a heavier one.
  double excess = 0.0, count = 0.0;
  for (size_t k = at + 1; k < null_gains_.size(); ++k, count += 1.0) {
    excess += null_gains_[k] - null_gains_[at];
  }
  return null_gains_[at] + std::max(1.0, excess / std::max(1.0, count)) * std::log(kTail / share);
}

double Attribution::PValue(double gain) const {
  const double markov = static_cast<double>(EffectsOf(candidates_).size()) * std::exp(-gain);
  return std::min(1.0, std::max(SurrogatePValue(gain), markov));
}

double Attribution::SurrogatePValue(double gain) const {
  // What the flight does not show gains the same from all surrogates: ties, but for rounding.
  constexpr double kTie = 1e-9;  // nats
  gain -= kTie;
  const double from = NullGain(kTail);
  const double mean = (NullGain(0.01 * kTail) - from) / std::log(100.0);
  if (gain > from) return kTail * std::exp(-(gain - from) / mean);
  const auto above = std::lower_bound(null_gains_.begin(), null_gains_.end(), gain);
  return std::max(kTail, static_cast<double>(null_gains_.end() - above) /
                             static_cast<double>(null_gains_.size()));
}

void Attribution::AddOtherValleys(const Evidence& evidence, int variant, const VariantSet& set,
                                  const std::vector<Eigen::Index>& own,
                                  RankedEffect* ranked) const {
  const EffectFit posterior = evidence.Solve(set);
  VariantSet without = set;
  without.erase(variant);
  const std::string own_valley = ValleyNameOf(evidence.variants()[variant].candidate);
  Valley most;  // many starts end in one: the largest counts, not each
  for (int other = 0; other < static_cast<int>(evidence.variants().size()); ++other) {
    const EffectCandidate& candidate = evidence.variants()[other].candidate;
    if (other == variant || candidate.effect != ranked->name) continue;
    const std::string valley_name = ValleyNameOf(candidate);
    if (refuted_.count(valley_name) > 0 && valley_name != own_valley) continue;
    VariantSet instead = without;
    instead.insert(other);
    Valley valley = ValleyOf(evidence.Solve(instead), evidence, posterior, own, *ranked);
    if (valley.weight > most.weight) most = std::move(valley);
  }
  if (most.weight > 0.0) ranked->spread += most.spread;
}

RankedEffect Attribution::Describe(const Evidence& evidence, int variant,
                                   const VariantSet& set) const {
  RankedEffect ranked;
  const EffectVariant& v = evidence.variants()[variant];
  ranked.name = v.candidate.effect;
  ranked.settings = v.candidate.settings;
  ranked.freed = v.candidate.freed;
  VariantSet without = set;
  without.erase(variant);
  const EffectFit posterior = evidence.Solve(set);
  ranked.score = ScoreOf(evidence, set, without);
  ranked.p_value = PValue(ranked.score);
  const Vehicle extended = VehicleWith(evidence.point().vehicle, v.candidate);
  const DynamicModel model(extended, extended.effects);
  std::vector<Eigen::Index> own, fitted;
  for (size_t k = 0; k < posterior.columns.size(); ++k) {
    const Evidence::Column& column = evidence.column(posterior.columns[k]);
    if (column.effect != ranked.name || column.flight >= 0) continue;
    const auto at = static_cast<Eigen::Index>(k);
    const bool is_setting = v.candidate.fitted.count(column.name) > 0;
    const double value = is_setting ? column.linearized_at : posterior.coefficients[at];
    const double sigma = std::sqrt(std::max(0.0, posterior.covariance(at, at)));
    const ParameterSpec& spec = model.parameters()[model.IndexOf(column.name)].spec;
    ranked.parameters.push_back(
        {column.name, spec.unit, value, sigma, true, sigma < 0.5 * spec.prior_sigma});
    if (is_setting) {
      ranked.settings[column.name] = value;
      fitted.push_back(at);
    } else if (!column.initial_state) {
      own.push_back(at);
    }
    if (HasWrongSign(spec.sign, value, 2.0 * sigma)) {
      ranked.is_unphysical = true;
      ranked.remarks.push_back(column.name + " = " + Rounded(value) + " has an unphysical sign");
    } else if (std::abs(value - spec.prior_value) > 4.0 * spec.prior_sigma) {
      ranked.remarks.push_back(column.name + " = " + Rounded(value) + " is strangely large");
    }
  }
  if (v.linearization_penalty > options_.clear_odds) {
    ranked.remarks.push_back("a linear fit claims " + Rounded(v.linearization_penalty) +
                             " nats more, which the model does not bear out");
  }
  for (const auto& [name, value] : v.candidate.settings) {
    const int k = model.IndexOf(name);
    ranked.parameters.push_back({name, model.parameters()[k].spec.unit, value, 0.0, false, false});
  }
  ranked.covariance = posterior.covariance(own, own);
  BeginSpread(fitted, evidence, posterior, &ranked);
  AddOtherValleys(evidence, variant, set, own, &ranked);
  return ranked;
}

std::vector<FlightEvidence> Attribution::ByFlight(const Evidence& evidence, int variant,
                                                  const VariantSet& set) const {
  VariantSet without = set;
  without.erase(variant);
  const std::string& name = evidence.variants()[variant].candidate.effect;
  const Vehicle extended =
      VehicleWith(evidence.point().vehicle, evidence.variants()[variant].candidate);
  const DynamicModel model(extended, extended.effects);
  std::vector<FlightEvidence> by_flight;
  for (const double nats : evidence.GainByFlight(set, without)) {
    const int flight = static_cast<int>(by_flight.size());
    FlightEvidence says;
    says.nats = nats;
    const EffectFit fit = evidence.SolveOfFlight(flight, set);
    for (size_t k = 0; k < fit.columns.size(); ++k) {
      const Evidence::Column& column = evidence.column(fit.columns[k]);
      if (column.effect != name || (column.flight >= 0 && column.flight != flight)) continue;
      const auto at = static_cast<Eigen::Index>(k);
      const double sigma = std::sqrt(std::max(0.0, fit.covariance(at, at)));
      says.parameters.push_back(
          {column.name, model.parameters()[model.IndexOf(column.name)].spec.unit,
           fit.coefficients[at], sigma, true, sigma < 0.5 * column.prior_sigma});
    }
    by_flight.push_back(std::move(says));
  }
  return by_flight;
}

void Attribution::Rank(const Evidence& evidence) {
  std::map<std::string, RankedEffect> best;
  for (int v = 0; v < static_cast<int>(evidence.variants().size()); ++v) {
    RankedEffect ranked = Describe(evidence, v, {v});
    const auto it = best.find(ranked.name);
    if (it == best.end() || it->second.score < ranked.score) best[ranked.name] = ranked;
  }
  for (auto& entry : best) ranking_.push_back(std::move(entry.second));
  SortByScore(&ranking_);
}

double Attribution::ScoreOf(const Evidence& evidence, const VariantSet& set,
                            const VariantSet& without) const {
  const EffectFit with = evidence.Solve(set), other = evidence.Solve(without);
  // Parts of the flight are predicted as well by parameters that nobody believes in: what the
  // effect makes of these believable counts, too. (What it strains is in the gain already.)
  const double relief = std::max(0.0, evidence.BeliefIn(with) - evidence.BeliefIn(other));
  const double predictive = evidence.PredictiveGain(set, without) + relief;
  const double gain = std::min(with.log_evidence - other.log_evidence, predictive);
  const Evidence::Unforeseen unforeseen = evidence.UnforeseenChange(set, without);
  const double noise = std::min(
      unforeseen.nats, std::pow(options_.regressor_noise, 2) * evidence.GivenUp(with, other));
  return gain - unforeseen.kept_share * noise;
}

double Attribution::ShadowOf(const std::array<double, kNumChannels>& energy,
                             const std::array<double, kNumChannels>& others) const {
  double all = 0.0, shadow = 0.0;
  for (int c = 0; c < kNumChannels; ++c) {
    all += energy[c];
    shadow += energy[c] * others[c];
  }
  return all > 0.0 ? options_.least_share * shadow / all : 0.0;
}

VariantSet Attribution::Completed(Evidence* evidence, const VariantSet& set, size_t most,
                                  FlexibleRest* rest,
                                  const Evidence::FlexibleChoice& choice) const {
  VariantSet all = set;
  *rest = FlexibleRest();
  for (size_t k = 0; k < most; ++k) {
    const Evidence::FlexibleGain best = evidence->BestFlexible(all, features_, choice);
    if (best.nats < options_.clear_odds) break;
    const bool of_torque = best.channel && *best.channel >= 3;
    (of_torque ? rest->of_torque : rest->of_force) += best.nats;
    if (rest->first.empty()) rest->first = best.Text(features_);
    if (of_torque && rest->first_of_torque.empty()) rest->first_of_torque = best.Text(features_);
    all.insert(evidence->AddFlexible(best, features_));
  }
  return all;
}

FlexibleRest Attribution::Rivals(Evidence* evidence, const VariantSet& set, int effect,
                                 size_t most) const {
  const std::vector<Eigen::VectorXd> does = evidence->DoneBy(effect, evidence->Solve(set));
  VariantSet without = set;
  without.erase(effect);
  FlexibleRest best;
  // The one that gains most at first need not begin the best few.
  for (const bool with_world : {true, false}) {
    FlexibleRest rest;
    Completed(evidence, without, most, &rest, {with_world, &does});
    if (rest.nats() > best.nats()) best = std::move(rest);
  }
  return best;
}

std::string Attribution::NamesOf(const Evidence& evidence, const VariantSet& set) {
  std::vector<std::string> names;
  for (const int v : set) names.push_back(evidence.variants()[v].candidate.effect);
  return Listed(names);
}

void Attribution::NoteThePlace(const Evidence& evidence) {
  if (flexible_.nats() > 0.0) return;
  const double nats = evidence.GainOfThePlace({});
  if (nats < options_.clear_odds) return;
  flexible_.of_force = nats;
  flexible_.first = "a force that follows the place";
}

VariantSet Attribution::Confirmed(const Evidence& with, VariantSet set) {
  Evidence evidence = with;
  while (true) {
    // What no effect explains, as far as a flexible function does.
    const VariantSet all = Completed(&evidence, set, kMostFeatures, &flexible_);
    if (set.empty()) {
      NoteThePlace(evidence);
      break;
    }
    const EffectFit fit = evidence.Solve(set);
    std::optional<int> weakest;
    double least = 0.0;
    std::string why;
    for (const int v : set) {
      VariantSet without = set;
      without.erase(v);
      const double score = ScoreOf(evidence, set, without);
      size_t coefficients = 0;
      for (const int k : evidence.variants()[v].columns) {
        coefficients += evidence.column(k).initial_state ? 0 : 1;
      }
      const FlexibleRest instead =
          Rivals(&evidence, set, v, all.size() - set.size() + coefficients);
      std::array<double, kNumChannels> others = explained();
      for (const int other : set) {
        if (other == v) continue;
        const auto energy = evidence.EnergyOf(other, fit);
        for (int c = 0; c < kNumChannels; ++c) others[c] += energy[c];
      }
      const double gain = evidence.Solve(set).log_evidence - evidence.Solve(without).log_evidence;
      const double margin = (1.0 + options_.form_share) * gain + flexible_.nats() - instead.nats() -
                            options_.clear_odds;
      const double shadow = ShadowOf(evidence.EnergyOf(v, fit), others);
      std::string objection;
      if (PValue(score) >= options_.false_alarm_rate) {
        objection =
            "chance may gain as much in " + Rounded(100.0 * PValue(score)) + " % of such flights";
      } else if (margin <= 0.0) {
        objection = "a function of the state (" + instead.first + ") explains the same by " +
                    Rounded(instead.nats()) + " nats, against " + Rounded(gain + flexible_.nats());
      } else if (score <= shadow) {
        objection = "a slightly wrong formula of the other effects would leave " + Rounded(shadow);
      }
      if (objection.empty() || (weakest && margin >= least)) continue;
      weakest = v;
      least = margin;
      why = "gains " + Rounded(score) + " nats" +
            (without.empty() ? "" : " beside " + NamesOf(evidence, without)) + ", but " + objection;
    }
    if (!weakest) break;
    refused_[evidence.variants()[*weakest].candidate.effect] = why;
    set.erase(*weakest);
  }
  return set;
}

std::vector<int> Attribution::BestAlone(const Evidence& evidence) const {
  constexpr size_t kTried = 3;
  std::map<std::string, std::pair<double, int>> best;
  for (int v = 0; v < static_cast<int>(evidence.variants().size()); ++v) {
    const double gain = evidence.GainInNats({v});
    const auto it = best.emplace(evidence.variants()[v].candidate.effect, std::pair(gain, v)).first;
    if (gain > it->second.first) it->second = {gain, v};
  }
  std::vector<std::pair<double, int>> order;
  for (const auto& entry : best) order.emplace_back(-entry.second.first, entry.second.second);
  std::sort(order.begin(), order.end());
  std::vector<int> variants;
  for (size_t k = 0; k < std::min(kTried, order.size()); ++k) {
    if (PValue(-order[k].first) < options_.false_alarm_rate) variants.push_back(order[k].second);
  }
  return variants;
}

void Attribution::FindAlternatives(const Evidence& evidence, const VariantSet& set, int variant,
                                   RankedEffect* ranked) const {
  VariantSet without = set;
  without.erase(variant);
  const double best = evidence.GainInNats(set), base = evidence.GainInNats(without);
  std::map<std::string, double> close;
  for (int v = 0; v < static_cast<int>(evidence.variants().size()); ++v) {
    const std::string& name = evidence.variants()[v].candidate.effect;
    if (name == ranked->name) continue;
    if (std::any_of(without.begin(), without.end(), [&](int other) {
          return evidence.variants()[other].candidate.effect == name;
        })) {
      continue;
    }
    VariantSet other = without;
    other.insert(v);
    const double gain = evidence.GainInNats(other);
    if (PValue(gain - base) > options_.false_alarm_rate) continue;
    const Evidence::Lead lead = evidence.LeadOf(set, other);
    if (best - gain > options_.even_odds && lead.nats > options_.telling_sigmas * lead.sigma) {
      continue;
    }
    const auto it = close.find(name);
    if (it == close.end() || it->second < gain) close[name] = gain;
  }
  std::vector<std::pair<double, std::string>> order;
  for (const auto& [name, gain] : close) order.emplace_back(-gain, name);
  std::sort(order.begin(), order.end());
  const double most = order.empty() ? best : std::max(best, -order.front().first);
  double sum = std::exp(best - most);
  for (const auto& entry : order) sum += std::exp(-entry.first - most);
  for (const auto& [negative_gain, name] : order) {
    ranked->alternatives.push_back(name);
    ranked->alternative_shares.push_back(std::exp(-negative_gain - most) / sum);
  }
}

VariantSet Attribution::Largest(const Evidence& evidence, const VariantSet& confirmed) const {
  double most = 0.0;
  std::map<int, double> gains;
  for (const int v : confirmed) {
    VariantSet without = confirmed;
    without.erase(v);
    gains[v] = evidence.GainInNats(confirmed) - evidence.GainInNats(without);
    most = std::max(most, gains[v]);
  }
  VariantSet set = confirmed;
  for (const auto& [v, gain] : gains) {
    if (gain < options_.large_share * most) set.erase(v);
  }
  // One that was confirmed beside what has just left may be nothing without it.
  for (const int v : VariantSet(set)) {
    VariantSet without = set;
    without.erase(v);
    if (PValue(ScoreOf(evidence, set, without)) >= options_.false_alarm_rate) set.erase(v);
  }
  return set.empty() ? confirmed : set;
}

VariantSet Attribution::WithoutStrangers(const Evidence& evidence, VariantSet set) const {
  for (const int v : VariantSet(set)) {
    RankedEffect ranked = Describe(evidence, v, set);
    if (!ranked.is_unphysical) continue;
    FindAlternatives(evidence, set, v, &ranked);
    VariantSet without = set;
    without.erase(v);
    std::optional<int> other;
    double most = 0.0;
    for (int a = 0; a < static_cast<int>(evidence.variants().size()); ++a) {
      const std::string& name = evidence.variants()[a].candidate.effect;
      if (std::count(ranked.alternatives.begin(), ranked.alternatives.end(), name) == 0) continue;
      VariantSet with = without;
      with.insert(a);
      const double gain = evidence.GainInNats(with);
      if (Describe(evidence, a, with).is_unphysical || (other && gain <= most)) continue;
      other = a;
      most = gain;
    }
    if (!other) continue;
    set = without;
    set.insert(*other);
  }
  return set;
}

std::map<int, SettingProfile> Attribution::HoldSettings(Evidence* evidence, VariantSet* set) {
  std::map<int, SettingProfile> profiles;
  for (const int v : VariantSet(*set)) {
    std::optional<SettingProfile> profile = SettingProfile::Of(*evidence, v, *set);
    if (!profile) continue;
    const int held = evidence->Add(profile->Held());
    if (held < 0) continue;
    evidence->SetLogPrior(held, profile->log_occam());
    evidence->EstimateNoise();
    set->erase(v);
    set->insert(held);
    profiles.emplace(held, std::move(*profile));
  }
  return profiles;
}

std::array<double, kNumChannels> Attribution::explained() const {
  std::array<double, kNumChannels> all{};
  for (const auto& [effect, energy] : energy_) {
    for (int c = 0; c < kNumChannels; ++c) all[c] += energy[c];
  }
  return all;
}

void Attribution::PutOrdinaryAside() {
  const auto first = std::stable_partition(
      effects_.begin(), effects_.end(),
      [this](const RankedEffect& effect) { return !IsOrdinary(point_.vehicle, effect); });
  ordinary_.assign(first, effects_.end());
  effects_.erase(first, effects_.end());
}

VariantSet Attribution::MostConfirmed(const Evidence& evidence, const VariantSet& found) {
  VariantSet set = Confirmed(evidence, found);
  // Members of a set may hide each other's case: one alone may say more.
  for (const int v : BestAlone(evidence)) {
    if (set.count(v) > 0) break;
    const VariantSet alone = Confirmed(evidence, {v});
    if (!alone.empty() && evidence.GainInNats(alone) > evidence.GainInNats(set)) set = alone;
    if (!set.empty()) break;
  }
  return set;
}

void Attribution::Search() {
  before_ = Refit(&point_);
  after_ = before_;
  const ModelPoint declared = point_;
  while (static_cast<int>(effects_.size()) < options_.most_effects) {
    Evidence evidence(flights_, point_, jobs_);
    Screen(&evidence);
    Polish(&evidence);
    if (GivesUp() || evidence.variants().empty()) return;
    null_gains_ = evidence.SurrogateGains({}, kSurrogates, 1);
    if (ranking_.empty()) Rank(evidence);
    const SearchResult found =
        SearchEffects(evidence, options_.log_prior_odds,
                      options_.most_effects - static_cast<int>(effects_.size()), give_up_);
    VariantSet set = MostConfirmed(evidence, found.best.variants);
    if (set.empty()) return;
    set = WithoutStrangers(evidence, Largest(evidence, set));
    const VariantSet found_first = set;
    FittedSet fitted = FitSet(&evidence, set);
    if (RejectByRescoring(evidence, fitted.set, fitted.point)) continue;
    if (const std::optional<VariantSet> rival = BetterRival(evidence, found_first)) {
      fitted = FitSet(&evidence, *rival);
      if (RejectByRescoring(evidence, fitted.set, fitted.point)) continue;
    }
    set = fitted.set;
    const std::map<int, SettingProfile>& profiles = fitted.profiles;
    const EffectFit fit = evidence.Solve(set);
    std::vector<RankedEffect> added;
    for (const int v : set) {
      added.push_back(Describe(evidence, v, set));
      if (profiles.count(v) > 0) profiles.at(v).AddTo(&added.back());
      added.back().probability = found.ProbabilityOf(added.back().name, evidence);
      const auto second = second_scores_.find(added.back().name);
      if (second != second_scores_.end()) added.back().second_score = second->second;
      FindAlternatives(evidence, set, v, &added.back());
      if (evidence.num_flights() > 1) added.back().by_flight = ByFlight(evidence, v, set);
    }
    gain_ += evidence.GainInNats(set);
    held_out_gain_ += evidence.HeldOutGain(set);
    for (const int v : set) {
      energy_[evidence.variants()[v].candidate.effect] = evidence.EnergyOf(v, fit);
    }
    SortByScore(&added);
    point_ = std::move(fitted.point);
    after_ = std::move(fitted.left);
    std::move(added.begin(), added.end(), std::back_inserter(effects_));
    for (RankedEffect& effect : effects_) UpdateValues(&effect);
    for (const int v : set) {
      const EffectCandidate& candidate = evidence.variants()[v].candidate;
      named_[candidate.effect] = candidate;
    }
    DropContained(added.size());
    // What was found beside an effect that stood for another may stand for the rest of it.
    if (DropSuperseded(added.size())) StartAgain(declared);
  }
}

}  // namespace odmc
