#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "odmc/attribution/instruments.h"
#include "odmc/attribution/residual.h"

namespace odmc {

/// What a force or torque might follow that nobody has a name for: the vehicle's state, place and
/// time, and all products of two of them. A catalogue effect that such a function explains away is
/// a stand-in for something else (double selection; Belloni, Chernozhukov and Hansen, Review of
/// Economic Studies 2014).
struct FlexibleFeatures {
  std::vector<std::string> names;
  Eigen::MatrixXd foreseen;  ///< samples × features, of unit size, as the instruments see them

  FlexibleFeatures(const ThinnedFlight& flight, const Vehicle& file_vehicle,
                   const Instruments& instruments);
};

}  // namespace odmc
