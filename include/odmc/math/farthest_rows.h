#pragma once

#include <Eigen/Core>
#include <limits>
#include <vector>

namespace odmc {

/// Rows of a matrix that cover the others: the first row, then each time the one farthest from all
/// chosen before (Gonzalez 1985).
struct FarthestRows {
  std::vector<Eigen::Index> rows;
  double extent = 0.0;  ///< largest distance from the first row

  /// @param at points × coordinates; none if there is no point
  /// @param most rows to choose
  /// @param least_distance over the extent, of a row to those before
  FarthestRows(const Eigen::MatrixXd& at, size_t most, double least_distance) {
    if (at.rows() == 0) return;
    Eigen::VectorXd distance =
        Eigen::VectorXd::Constant(at.rows(), std::numeric_limits<double>::infinity());
    Eigen::Index farthest = 0;
    do {
      rows.push_back(farthest);
      distance = distance.cwiseMin((at.rowwise() - at.row(farthest)).rowwise().norm());
      const double reach = distance.maxCoeff(&farthest);
      if (rows.size() == 1) extent = reach;
      if (!(reach > least_distance * extent)) return;
    } while (rows.size() < most);
  }
};

}  // namespace odmc
