#include "odmc/attribution/effect_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

namespace odmc {
namespace {

/// One walk through the sets.
class Search {
 public:
  Search(const Evidence& evidence, double log_odds, int most_effects,
         const std::function<bool()>& give_up)
      : evidence_(evidence),
        log_odds_(log_odds),
        most_effects_(most_effects),
        give_up_(give_up),
        declared_(evidence.Solve({}).log_evidence) {
    if (!std::isfinite(declared_)) {
      throw std::runtime_error(
          "attribution: the likelihood of the residual under the declared model is not finite");
    }
  }

  SearchResult Run() {
    VariantSet best;
    Look(best);
    while (!(give_up_ && give_up_())) {
      VariantSet next = BestOf(Neighbours(best));
      if (next.empty() || seen_.at(next) <= seen_.at(best)) {
        next = BestOf(WithPairs(best));
        if (next.empty() || seen_.at(next) <= seen_.at(best)) break;
      }
      best = std::move(next);
    }
    SearchResult result;
    for (const auto& [set, log_posterior] : seen_) result.visited.push_back({set, log_posterior});
    std::sort(result.visited.begin(), result.visited.end(),
              [](const auto& a, const auto& b) { return a.log_posterior > b.log_posterior; });
    result.best = result.visited.front();
    return result;
  }

 private:
  double Look(const VariantSet& set) {
    const auto it = seen_.find(set);
    if (it != seen_.end()) return it->second;
    const double log_posterior =
        evidence_.Solve(set).log_evidence - declared_ + static_cast<double>(set.size()) * log_odds_;
    return seen_[set] =
               std::isnan(log_posterior) ? -std::numeric_limits<double>::infinity() : log_posterior;
  }

  const std::string& EffectOf(int variant) const {
    return evidence_.variants()[variant].candidate.effect;
  }
  bool HasEffectOf(const VariantSet& set, int variant) const {
    return std::any_of(set.begin(), set.end(),
                       [&](int other) { return EffectOf(other) == EffectOf(variant); });
  }
  int num_variants() const { return static_cast<int>(evidence_.variants().size()); }

  std::vector<VariantSet> Neighbours(const VariantSet& set) const {
    std::vector<VariantSet> neighbours;
    for (const int v : set) {
      VariantSet less = set;
      less.erase(v);
      for (int other = 0; other < num_variants(); ++other) {
        if (other == v || HasEffectOf(less, other)) continue;
        neighbours.push_back(less);
        neighbours.back().insert(other);
      }
      neighbours.push_back(std::move(less));
    }
    if (static_cast<int>(set.size()) >= most_effects_) return neighbours;
    for (int v = 0; v < num_variants(); ++v) {
      if (HasEffectOf(set, v)) continue;
      neighbours.push_back(set);
      neighbours.back().insert(v);
    }
    return neighbours;
  }

  std::vector<VariantSet> WithPairs(const VariantSet& set) const {
    std::vector<VariantSet> pairs;
    if (static_cast<int>(set.size()) + 2 > most_effects_) return pairs;
    for (int a = 0; a < num_variants(); ++a) {
      if (HasEffectOf(set, a)) continue;
      for (int b = a + 1; b < num_variants(); ++b) {
        if (HasEffectOf(set, b) || EffectOf(a) == EffectOf(b)) continue;
        pairs.push_back(set);
        pairs.back().insert({a, b});
      }
    }
    return pairs;
  }

  VariantSet BestOf(const std::vector<VariantSet>& sets) {
    const VariantSet* best = nullptr;
    double most = 0.0;
    for (const VariantSet& set : sets) {
      const double found = Look(set);
      if (best != nullptr && found <= most) continue;
      most = found;
      best = &set;
    }
    return best != nullptr ? *best : VariantSet();
  }

  const Evidence& evidence_;
  const double log_odds_;
  const int most_effects_;
  const std::function<bool()>& give_up_;
  const double declared_;
  std::map<VariantSet, double> seen_;
};

}  // namespace

double SearchResult::ProbabilityOf(const std::string& effect, const Evidence& evidence) const {
  double with = 0.0, all = 0.0;
  for (const ScoredSet& set : visited) {
    const double weight = std::exp(set.log_posterior - best.log_posterior);
    all += weight;
    const bool has = std::any_of(set.variants.begin(), set.variants.end(), [&](int v) {
      return evidence.variants()[v].candidate.effect == effect;
    });
    if (has) with += weight;
  }
  return with / all;
}

SearchResult SearchEffects(const Evidence& evidence, double log_odds, int most_effects,
                           const std::function<bool()>& give_up) {
  return Search(evidence, log_odds, most_effects, give_up).Run();
}

}  // namespace odmc
