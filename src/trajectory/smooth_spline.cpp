#include "smooth_spline.h"

#include <Eigen/SparseLU>
#include <algorithm>
#include <cassert>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace odmc {
namespace {

// Factor of s^(power - order) in the derivative of s^power.
double FallingFactorial(int power, int order) {
  double product = 1.0;
  for (int k = 0; k < order; ++k) product *= power - k;
  return product;
}

// Integral over s from 0 to 1 of the products of the derivatives of s^row and s^column.
Eigen::MatrixXd CostMatrix(int degree, int order) {
  Eigen::MatrixXd cost = Eigen::MatrixXd::Zero(degree + 1, degree + 1);
  for (int i = order; i <= degree; ++i) {
    for (int j = order; j <= degree; ++j) {
      cost(i, j) =
          FallingFactorial(i, order) * FallingFactorial(j, order) / (i + j - 2 * order + 1);
    }
  }
  return cost;
}

// The Karush-Kuhn-Tucker system of the spline: [Q Aᵀ; A 0] [c; λ] = [0; b].
class KktSystem {
 public:
  using Knots = std::vector<std::optional<SmoothSpline::Values>>;

  KktSystem(const SplineKind& kind, const std::vector<double>& times_s, const Knots& knots)
      : kind_(kind),
        times_s_(times_s),
        num_segments_(static_cast<int>(times_s.size())),
        num_coefficients_(num_segments_ * (kind.degree + 1)) {
    AddCost();
    for (int i = 0; i < num_segments_; ++i) {
      if (knots[i]) Pin(i, 0.0, *knots[i]);
      if (knots[i + 1]) Pin(i, 1.0, *knots[i + 1]);
    }
    for (int i = 0; i + 1 < num_segments_; ++i) Join(i, knots[i + 1] ? 1 : 0);
    AddRest();
  }

  // Coefficients of all segments, one below the other.
  Eigen::MatrixXd Solve() const {
    const int size = num_coefficients_ + static_cast<int>(values_.size());
    Eigen::SparseMatrix<double> matrix(size, size);
    matrix.setFromTriplets(entries_.begin(), entries_.end());
    Eigen::MatrixXd right = Eigen::MatrixXd::Zero(size, values_.front().size());
    for (size_t k = 0; k < values_.size(); ++k) right.row(num_coefficients_ + k) = values_[k];
    const Eigen::SparseLU<Eigen::SparseMatrix<double>> decomposition(matrix);
    Eigen::MatrixXd solution;
    if (decomposition.info() == Eigen::Success) solution = decomposition.solve(right);
    if (solution.size() == 0 || !solution.allFinite()) {
      throw std::invalid_argument(
          "no path can be computed through the waypoints; are the distances between them too "
          "different?");
    }
    return solution.topRows(num_coefficients_);
  }

 private:
  // In units of the mean segment time, so that long flights and short ones are solved alike.
  void AddCost() {
    const double mean_s = std::accumulate(times_s_.begin(), times_s_.end(), 0.0) / num_segments_;
    const Eigen::MatrixXd unit = CostMatrix(kind_.degree, kind_.cost_order);
    for (int i = 0; i < num_segments_; ++i) {
      const double scale = std::pow(mean_s / times_s_[i], 2 * kind_.cost_order - 1);
      for (int j = kind_.cost_order; j <= kind_.degree; ++j) {
        for (int k = kind_.cost_order; k <= kind_.degree; ++k) {
          entries_.emplace_back(Column(i, j), Column(i, k), scale * unit(j, k));
        }
      }
    }
  }

  void Pin(int segment, double s, const SmoothSpline::Values& value) {
    AddDerivative(segment, s, 0, 1.0);
    values_.push_back(value);
  }

  // Derivatives from order `first` on go through from `segment` to the next.
  void Join(int segment, int first) {
    const double ratio = times_s_[segment] / times_s_[segment + 1];
    for (int order = first; order <= kind_.continuity; ++order) {
      AddDerivative(segment, 1.0, order, 1.0);
      AddDerivative(segment + 1, 0.0, order, -std::pow(ratio, order));
      values_.push_back(Zero());
    }
  }

  void AddRest() {
    for (int order = 1; order <= kind_.rest_order; ++order) {
      AddDerivative(0, 0.0, order, 1.0);
      values_.push_back(Zero());
      AddDerivative(num_segments_ - 1, 1.0, order, 1.0);
      values_.push_back(Zero());
    }
  }

  // Adds `weight` times a derivative by s to the row of the next value.
  void AddDerivative(int segment, double s, int order, double weight) {
    const int row = num_coefficients_ + static_cast<int>(values_.size());
    for (int power = order; power <= (s == 0.0 ? order : kind_.degree); ++power) {
      const double entry = weight * FallingFactorial(power, order);
      entries_.emplace_back(row, Column(segment, power), entry);
      entries_.emplace_back(Column(segment, power), row, entry);
    }
  }

  int Column(int segment, int power) const { return segment * (kind_.degree + 1) + power; }
  SmoothSpline::Values Zero() const { return SmoothSpline::Values::Zero(values_.front().size()); }

  const SplineKind& kind_;
  const std::vector<double>& times_s_;
  int num_segments_;
  int num_coefficients_;
  std::vector<Eigen::Triplet<double>> entries_;
  std::vector<SmoothSpline::Values> values_;  // b, a row each
};

}  // namespace

SmoothSpline::SmoothSpline(const SplineKind& kind, const std::vector<double>& times_s,
                           const std::vector<std::optional<Values>>& knots)
    : kind_(kind), times_s_(times_s) {
  assert(knots.size() == times_s.size() + 1);
  const Eigen::MatrixXd all = KktSystem(kind, times_s, knots).Solve();
  const int rows = kind.degree + 1;
  for (size_t i = 0; i < times_s.size(); ++i) {
    coefficients_.push_back(all.middleRows(static_cast<int>(i) * rows, rows));
  }
}

double SmoothSpline::duration_s() const {
  return std::accumulate(times_s_.begin(), times_s_.end(), 0.0);
}

SmoothSpline::Values SmoothSpline::Derivative(double time_s, int order) const {
  size_t segment = 0;
  while (segment + 1 < times_s_.size() && time_s > times_s_[segment]) {
    time_s -= times_s_[segment++];
  }
  return SegmentDerivative(segment, std::clamp(time_s / times_s_[segment], 0.0, 1.0), order);
}

SmoothSpline::Values SmoothSpline::SegmentDerivative(size_t segment, double s, int order) const {
  const Eigen::MatrixXd& c = coefficients_[segment];
  Values sum = Values::Zero(c.cols());
  for (int power = kind_.degree; power >= order; --power) {
    sum = s * sum + FallingFactorial(power, order) * c.row(power);
  }
  return sum / std::pow(times_s_[segment], order);
}

double SmoothSpline::Cost() const {
  const Eigen::MatrixXd unit = CostMatrix(kind_.degree, kind_.cost_order);
  double sum = 0.0;
  for (size_t i = 0; i < times_s_.size(); ++i) {
    const Eigen::MatrixXd& c = coefficients_[i];
    sum += c.cwiseProduct(unit * c).sum() / std::pow(times_s_[i], 2 * kind_.cost_order - 1);
  }
  return sum;
}

std::vector<double> SmoothSpline::SnapCostSlopes() const {
  assert(kind_.degree == 7 && kind_.cost_order == 4);
  std::vector<double> slopes;
  for (size_t i = 0; i < times_s_.size(); ++i) {
    const auto x = [this, i](int order) { return SegmentDerivative(i, 0.0, order); };
    slopes.push_back(-x(4).squaredNorm() + 2.0 * x(5).dot(x(3)) - 2.0 * x(6).dot(x(2)) +
                     2.0 * x(7).dot(x(1)));
  }
  return slopes;
}

SmoothSpline SmoothSpline::Stretched(double factor) const {
  SmoothSpline stretched = *this;
  for (double& time_s : stretched.times_s_) time_s *= factor;
  return stretched;
}

}  // namespace odmc
