#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "odmc/model/parameter_set.h"

namespace odmc {

/// A candidate's case on a flight.
struct RankedEffect {
  std::string name;
  double score = 0.0;        ///< gain of log evidence, beside the other effects that act [nats]
  double p_value = 1.0;      ///< chance that any candidate gains as much where nothing acts
  double probability = 0.0;  ///< a posteriori that it acts, of the sets that were looked at
  std::map<std::string, double> settings;  ///< frozen parameters it was tried with, full names
  std::vector<ParameterEstimate> parameters;
  Eigen::MatrixXd covariance;             ///< of the estimated ones, initial states left out
  std::vector<std::string> alternatives;  ///< that explain the same on this flight
  std::vector<std::string> remarks;       ///< what is strange about it

  /// nullptr if it has no such parameter
  const ParameterEstimate* Find(const std::string& full_name) const {
    for (const ParameterEstimate& p : parameters) {
      if (p.full_name == full_name) return &p;
    }
    return nullptr;
  }
};

}  // namespace odmc
