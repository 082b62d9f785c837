#pragma once

#include <Eigen/Core>
#include <functional>

namespace odmc {

/// When Descend() ends, how far it shortens a step, and where it may go.
struct DescentOptions {
  int most_steps = 10;         ///< >= 0
  double shorter = 0.5;        ///< each share of a step over the one before, in (0, 1)
  double shortest = 0.05;      ///< shares of a step that are no longer than this are not tried
  double least_gain = 0.0;     ///< a step that lowers the cost by less is the last
  Eigen::VectorXd least = {};  ///< bounds of x, N×1; empty: none
  Eigen::VectorXd most = {};   ///< the same
};

/// A point and the cost there.
struct CostAt {
  Eigen::VectorXd x;
  double cost = 0.0;
};

/// Minimum of a cost by steps that Newton's or Gauss and Newton's method proposes. Of each step the
/// longest of the shares 1, `shorter`, `shorter`², ... is taken, cut off at the bounds, that lowers
/// the cost; where none does, the descent ends. It is for few unknowns whose step is worth more
/// than a cost; others differ: Attribution::Polish() halves the way back to the best point of an
/// evidence that it linearizes anew each round, of many variants at once, and the segment times of
/// a minimum-snap path follow the plain slope, whose step has no length of its own, by Armijo's
/// rule.
/// @param start N×1, with its cost
/// @param step_from the whole step from a point, N×1
/// @param cost of a point; infinite or NaN where none can be
CostAt Descend(CostAt start, const DescentOptions& options,
               const std::function<Eigen::VectorXd(const CostAt&)>& step_from,
               const std::function<double(const Eigen::VectorXd&)>& cost);

}  // namespace odmc
