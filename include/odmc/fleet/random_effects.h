#pragma once

#include <Eigen/Core>
#include <vector>

#include "odmc/fleet/flight_factor.h"

namespace odmc {

/// How the vehicle's parameters are modelled over its flights, in order: x_i = D_i beta + u_i, with
/// u_i normal about zero, independent between flights and parameters, of standard deviation
/// `scatter`. The first n of beta are the parameters; what follows changes one of them.
struct FleetModel {
  /// One change of a parameter over the flights: the column of D_i that it adds.
  struct Change {
    int parameter = 0;
    std::vector<double> by;  ///< of each flight: 0 before a step and 1 from it on, ...
  };
  std::vector<Change> changes;
  /// Flights whose parameter is their own: it says nothing about the vehicle's. (flight, parameter)
  std::vector<std::pair<int, int>> outliers;
};

/// A FleetModel fitted to its flights.
struct RandomEffects {
  Eigen::VectorXd beta;           ///< (n + changes)×1
  Eigen::MatrixXd covariance;     ///< of beta, the scatter taken as known
  Eigen::VectorXd scatter;        ///< n×1, standard deviation between flights
  Eigen::VectorXd scatter_sigma;  ///< n×1, of that; infinite where no two flights show it
  /// (n + changes)×1, degrees of freedom of a sigma of beta: few where a scatter that few flights
  /// show makes it up (Satterthwaite, Biometrics Bulletin 2, 1946).
  Eigen::VectorXd degrees_of_freedom;
  std::vector<Eigen::VectorXd> of_flight;  ///< x_i given all flights, n×1
  std::vector<Eigen::VectorXd> own;        ///< of_flight minus D_i beta
  double log_likelihood = 0.0;             ///< restricted
  int iterations = 0;
};

/// Restricted maximum likelihood of the scatter times its prior (a half of the parameter's prior
/// sigma is exceeded once in a hundred), and of beta with it. Exact for linear problems: without
/// scatter the result is that of all flights in one least-squares problem.
/// The updates of the scatter's variances are of MM type and never make the likelihood worse
/// (Zhou, Hu, Zhou and Lange: MM algorithms for variance components models, JCGS 28, 2019).
/// @param factors at least one, all with the same names; the priors of the first one hold
/// @param known_scatter where given, n×1: taken as it is, nothing is fitted
/// @throws std::invalid_argument if names differ, naming the flight
RandomEffects FitRandomEffects(const std::vector<FlightFactor>& factors, const FleetModel& model,
                               const Eigen::VectorXd* known_scatter = nullptr);

/// What all flights but one predict of that one, for each: D_i beta with beta of the others, at
/// the fit's scatter. n×1 each.
std::vector<Eigen::VectorXd> ExpectedOfLeftOut(const std::vector<FlightFactor>& factors,
                                               const FleetModel& model, const RandomEffects& fit);

/// What the flights say about one parameter apart, the others where all of them have it: value
/// minus D_i beta, and its sigma from what the flight itself cannot show (its noise, the scatter of
/// the other parameters); an infinite sigma where it shows nothing.
struct FlightDeparture {
  double value = 0.0, sigma = 0.0;
};
std::vector<FlightDeparture> DeparturesOf(int parameter, const std::vector<FlightFactor>& factors,
                                          const FleetModel& model, const RandomEffects& fit);

}  // namespace odmc
