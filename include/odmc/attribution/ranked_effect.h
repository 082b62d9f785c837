#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/model/parameter_set.h"

namespace odmc {

/// What one flight of several says of an effect.
struct FlightEvidence {
  double nats = 0.0;  ///< gain of its log-likelihood by the effect, all others known [nats]
  std::vector<ParameterEstimate> parameters;  ///< as this flight alone has them
};

/// A candidate's case on a flight, or on several of one vehicle.
struct RankedEffect {
  std::string name;
  double score = 0.0;  ///< gain of log evidence, beside the other effects that act [nats]
  /// The same about what the fit with it has found; empty where it was not scored again.
  std::optional<double> second_score = {};
  double p_value = 1.0;      ///< chance that any candidate gains as much where nothing acts
  double probability = 0.0;  ///< a posteriori that it acts, of the sets that were looked at
  std::map<std::string, double> settings;  ///< its frozen parameters, full names
  std::vector<std::string> freed;          ///< parameters it frees that the model has frozen
  std::vector<ParameterEstimate> parameters;
  Eigen::MatrixXd covariance;  ///< of the estimated ones; initial states and settings left out
  /// What of the parameters' uncertainty an online estimate does not see, which holds fitted
  /// settings, and knows one valley: covariance of these parameters of the whole model (full
  /// names).
  std::vector<std::string> spread_of = {};
  Eigen::MatrixXd spread = {};
  std::vector<std::string> alternatives;  ///< that explain the same on this flight
  /// Of each of them: probability a posteriori that it acts in this one's place, if one of all
  /// does.
  std::vector<double> alternative_shares = {};
  std::vector<std::string> remarks;            ///< what is strange about it
  std::vector<FlightEvidence> by_flight = {};  ///< of several flights, in their order
  bool is_unphysical = false;  ///< a coefficient has a sign that it can't have, beyond two sigma

  /// nullptr if it has no such parameter
  const ParameterEstimate* Find(const std::string& full_name) const {
    for (const ParameterEstimate& p : parameters) {
      if (p.full_name == full_name) return &p;
    }
    return nullptr;
  }
};

/// Best first.
inline void SortByScore(std::vector<RankedEffect>* effects) {
  std::sort(effects->begin(), effects->end(),
            [](const RankedEffect& a, const RankedEffect& b) { return a.score > b.score; });
}

}  // namespace odmc
