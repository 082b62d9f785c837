#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

namespace odmc {

/// Which piecewise polynomials to choose from, and by what.
struct SplineKind {
  int degree;      ///< of each segment
  int cost_order;  ///< the integral of this derivative squared is least
  int rest_order;  ///< derivatives 1 to this one vanish at both ends
  int continuity;  ///< derivatives up to this one are continuous between segments
};

/// A function of time with one or more columns through values at knots, of least cost among the
/// piecewise polynomials of its kind.
class SmoothSpline {
 public:
  using Values = Eigen::RowVectorXd;

  /// @param times_s of the N segments, > 0
  /// @param knots values at the N + 1 knots, free where absent; at least one is there
  SmoothSpline(const SplineKind& kind, const std::vector<double>& times_s,
               const std::vector<std::optional<Values>>& knots);

  /// Derivative of the given order at a time that is held within the spline's [s].
  Values Derivative(double time_s, int order) const;

  double duration_s() const;
  const std::vector<double>& times_s() const { return times_s_; }

  /// Integral of the squared derivative of order `cost_order`, summed over columns.
  double Cost() const;

  /// Derivative of the least cost by each segment's time, the other times held. It is minus the
  /// Hamiltonian of the segment, as for every problem of optimal control without explicit time:
  ///   H = -(x⁽⁴⁾)² + 2 x⁽⁵⁾ j - 2 x⁽⁶⁾ a + 2 x⁽⁷⁾ v,
  /// constant along a segment and taken at its start.
  /// @pre a kind of minimum snap: degree 7, cost_order 4
  std::vector<double> SnapCostSlopes() const;

  /// The same shape flown `factor` times as long; it stays of least cost.
  SmoothSpline Stretched(double factor) const;

 private:
  Values SegmentDerivative(size_t segment, double s, int order) const;

  SplineKind kind_;
  std::vector<double> times_s_;
  // Coefficients of 1, s, s², ... with s from 0 to 1 along each segment, (degree + 1)×columns.
  std::vector<Eigen::MatrixXd> coefficients_;
};

}  // namespace odmc
