#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"

namespace odmc {

/// What one flight by itself says about the parameters of the vehicle: the likelihood
/// exp(-|root x - rhs|² / 2), everything that is the flight's own integrated out. Parameters the
/// flight does not show have no information in it, and no prior is left in it: factors of many
/// flights multiply.
struct FlightFactor {
  std::string flight;       ///< its file
  double start_s = 0.0;     ///< first sample, seconds since 1970; 0: its clock does not say
  double duration_s = 0.0;  ///< of the recording
  std::vector<std::string> names, units;     ///< of the n shared parameters
  Eigen::VectorXd prior_value, prior_sigma;  ///< n×1, of the vehicle file
  Eigen::VectorXd value, sigma;              ///< n×1, the flight's own estimate, with that prior
  Eigen::VectorXd linearized_at;             ///< n×1
  Eigen::MatrixXd root;                      ///< n×n, upper triangular
  Eigen::VectorXd rhs;                       ///< n×1
  ParameterSet estimate;                     ///< of all parameters, the flight's own among them

  int size() const { return static_cast<int>(names.size()); }
};

/// Sets the likelihood that makes this posterior of its prior: information
/// covariance⁻¹ - diag(prior_sigma)⁻², centred where it pulls the posterior to, then widened.
/// @param value, covariance of the posterior, n×1 and n×n, not inflated, in units of the parameters
/// @param inflation n×1, at least 1: by how much each parameter is known worse than that
/// @throws std::invalid_argument if the covariance is not positive definite
void SetLikelihood(const Eigen::VectorXd& value, const Eigen::MatrixXd& covariance,
                   const Eigen::VectorXd& inflation, const Eigen::VectorXd& prior_value,
                   const Eigen::VectorXd& prior_sigma, FlightFactor* factor);

/// Lets the flight's estimate be off by an error of this size, of either sign: the covariance of
/// its likelihood grows by the error's square, the centre stays.
/// @param error n×1, in units of the parameters
void AddErrorToFactor(const Eigen::VectorXd& error, FlightFactor* factor);

/// What an estimate says about the vehicle's parameters.
/// @param model with which it was made: its priors are taken out
/// @param inflation by how much each sigma of `estimate` is larger than the window's,
/// num_parameters
///   of the model; see Snapshot::inflation
/// @param own full names or effects that are each flight's own, too
FlightFactor FactorOf(const DynamicModel& model, const ParameterSet& estimate,
                      const Eigen::VectorXd& inflation, const std::vector<std::string>& own = {});

}  // namespace odmc
