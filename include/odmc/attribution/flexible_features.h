#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "odmc/attribution/instruments.h"
#include "odmc/attribution/residual.h"

namespace odmc {

/// A flight that evidence is taken from; both outlive that.
struct SeenFlight {
  const ResidualModel* residual;
  const Instruments* instruments;
};

/// What a force or torque might follow that nobody has a name for: the vehicle's state, place and
/// time, and all products of two of them. A catalogue effect that such a function explains away is
/// a stand-in for something else (double selection; Belloni, Chernozhukov and Hansen, Review of
/// Economic Studies 2014).
struct FlexibleFeatures {
  std::vector<std::string> names;
  /// By flight: samples × features, as its instruments see them; of unit size over all flights.
  std::vector<Eigen::MatrixXd> foreseen;

  explicit FlexibleFeatures(const std::vector<SeenFlight>& flights);
};

}  // namespace odmc
