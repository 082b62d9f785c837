#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "odmc/attribution/evidence.h"

namespace odmc {

/// A set of variants with its evidence.
struct ScoredSet {
  VariantSet variants;
  double log_posterior =
      0.0;  ///< gain over the declared model and prior odds of its effects [nats]
};

/// Sets of effects about the most probable one.
struct SearchResult {
  ScoredSet best;
  std::vector<ScoredSet> visited;  ///< every set that was looked at, best first

  /// Probability that an effect acts, of the sets that were looked at.
  double ProbabilityOf(const std::string& effect, const Evidence& evidence) const;
};

/// Looks for the most probable set of effects: adds, drops, exchanges one, and adds pairs, which
/// alone can show what only helps together, until nothing is better.
/// @param log_odds a priori that one given effect acts, against that it does not
/// @param most_effects in a set
/// @param give_up asked now and then; once true, what was found so far comes back
/// @throws std::runtime_error where the declared model's own evidence is not finite
SearchResult SearchEffects(const Evidence& evidence, double log_odds, int most_effects,
                           const std::function<bool()>& give_up = {});

}  // namespace odmc
