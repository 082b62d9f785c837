#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/text/finding.h"

namespace odmc {

/// What one third of a flight asks of every estimated parameter by itself, in eta, the others as
/// the whole flight has them: one Gauss-Newton step from the estimate with that third's information
/// and the prior. (With all of them free a third would slide along what it does not tell apart.)
struct ThirdOfFlight {
  Eigen::VectorXd step;      ///< from the present estimate (n×1)
  Eigen::VectorXd variance;  ///< of each entry, white residuals of the assumed size (n×1)
  double length_s = 0.0;
};

/// A parameter about which the thirds of a flight disagree.
struct ThirdsDifference {
  int index = -1;  ///< in DynamicModel::parameters()
  std::array<double, 3> values{};
  double chi_squared = 0.0;  ///< of the three about their mean, 2 degrees of freedom
  double spread = 0.0;       ///< standard error of their mean by their own scatter
};

/// Where a chi-squared of 2 degrees of freedom is reached by chance once in so many flights, with
/// `parameters` of them looked at (Bonferroni): 1 in 100.
double LastLookThreshold(int parameters);

/// What disagrees beyond sampling error costs trust where it would matter to whoever uses the
/// value: a thrust coefficient whose thirds lie further apart than kThrustApart of it, a drag
/// coefficient whose thirds lie further apart than its own size. The rest only widens sigma.
std::vector<Finding> LastLookFindings(const DynamicModel& model, const ModelValues& values,
                                      const std::vector<ThirdsDifference>& differences);

/// A contact or a fault in one third moves the whole by a third of what it moves that third:
/// k_f of the whole by kThrustApart / 3, which is a controller's usual margin of 3 %.
constexpr double kThrustApart = 0.1;

}  // namespace odmc
