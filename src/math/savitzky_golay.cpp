#include "odmc/math/savitzky_golay.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cassert>
#include <cmath>

namespace odmc {

SavitzkyGolay::SavitzkyGolay(int count) : count_(count) { assert(count >= 5 && count % 2 == 1); }

int SavitzkyGolay::NearestOddCount(double width_s, double step_s) {
  // The odd number nearest to x is 2 round((x - 1) / 2) + 1.
  const double samples = width_s / step_s;
  return std::max(5, 2 * static_cast<int>(std::lround((samples - 1.0) / 2.0)) + 1);
}

LocalPolynomial SavitzkyGolay::At(const std::vector<double>& times_s,
                                  const Eigen::MatrixXd& samples, int centre) const {
  const int half = count_ / 2;
  assert(centre >= half && centre + half < static_cast<int>(times_s.size()));
  const int first = centre - half;
  // Time in units of the half width keeps the normal equations well conditioned.
  const double unit = 0.5 * (times_s[centre + half] - times_s[first]);
  Eigen::Matrix<double, Eigen::Dynamic, kOrder + 1> powers(count_, kOrder + 1);
  for (int i = 0; i < count_; ++i) {
    const double x = (times_s[first + i] - times_s[centre]) / unit;
    powers.row(i) << 1.0, x, x * x, x * x * x;
  }
  const Eigen::Matrix4d normal = powers.transpose() * powers;
  const Eigen::MatrixXd right = powers.transpose() * samples.middleCols(first, count_).transpose();
  const Eigen::MatrixXd coefficients = normal.ldlt().solve(right);
  return {coefficients.row(0).transpose(), coefficients.row(1).transpose() / unit,
          2.0 * coefficients.row(2).transpose() / (unit * unit)};
}

}  // namespace odmc
