#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "odmc/model/vehicle.h"
#include "odmc/text/finding.h"

namespace odmc {

/// One parameter of an estimate, as files and messages show it.
struct ParameterEstimate {
  std::string full_name;  ///< "thrust.k_f"
  std::string unit;       ///< SI
  double value = 0.0;
  double sigma = 0.0;       ///< 0 where frozen
  bool estimated = false;   ///< false: frozen at value
  bool observable = false;  ///< the flight says more about it than its prior did
  /// Standard deviation between flights, where many were seen: the next flight has its own value
  /// so far from `value`.
  double scatter = 0.0;
};

/// A calibrated model: everything that evaluate, nodes and simulator need to rebuild it.
struct ParameterSet {
  std::vector<std::string> effects;
  std::vector<ParameterEstimate> parameters;
  /// Covariance of all `parameters` in their units (n×n), zero rows where frozen. May be empty.
  Eigen::MatrixXd covariance;
  /// Where the values come from: tool, version, flight, vehicle, date, ... in text.
  std::map<std::string, std::string> provenance;

  const ParameterEstimate* Find(const std::string& full_name) const;
};

/// Puts the set's effects and values into `vehicle`: they become the model's effects, start values,
/// centres of the priors and (where positive) the priors' sigmas, with the scatter between flights.
void ApplyParameters(const ParameterSet& set, Vehicle* vehicle);

/// Notes in the provenance how far the values may be relied on: "trust", and "trust_reason", the
/// first of them.
void AddTrust(const std::vector<Finding>& findings, ParameterSet* set);

/// Why a controller must not fly with these values, by their provenance: "its trust is doubtful:
/// REASON"; empty where nothing speaks against them.
std::string ObjectionTo(const ParameterSet& set);

}  // namespace odmc
