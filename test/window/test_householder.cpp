#include <gtest/gtest.h>

#include <Eigen/Core>
#include <vector>

#include "odmc/window/householder.h"
#include "support/jacobian_check.h"

namespace odmc {
namespace test {
namespace {

using Eigen::MatrixXd;
using Map = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>, 0,
                       Eigen::OuterStride<>>;

/// Rows in the form the kernels take, with guards of zeros behind.
struct Rows {
  Rows(const MatrixXd& m)
      : columns(static_cast<int>(m.cols())),
        stride(PaddedRow(columns)),
        data(static_cast<size_t>(m.rows() * stride), 0.0) {
    view(static_cast<int>(m.rows())) = m;
  }
  Map view(int rows) { return Map(data.data(), rows, columns, Eigen::OuterStride<>(stride)); }
  bool padding_is_zero() const {
    for (size_t i = 0; i < data.size(); ++i) {
      if (static_cast<int>(i) % stride >= columns && data[i] != 0.0) return false;
    }
    return true;
  }
  int columns, stride;
  std::vector<double> data;
};

TEST(AbsorbRows, KeepsTheSumOfSquaresAndLeavesATriangle) {
  for (const int pivots : {1, 6, 12, 33}) {
    for (const int rows : {1, 7, 24, 300}) {
      Random random(static_cast<unsigned>(pivots * 1000 + rows));
      const int columns = pivots + 17;
      const MatrixXd triangle = random.NextMatrix(pivots, columns).triangularView<Eigen::Upper>();
      MatrixXd more = random.NextMatrix(rows, columns);
      more.topLeftCorner(rows / 2, pivots / 2).setZero();  // rows that begin later
      Rows U(triangle), E(more);
      AbsorbRows(U.data.data(), U.stride, E.data.data(), E.stride, rows, pivots, columns);
      const MatrixXd before = triangle.transpose() * triangle + more.transpose() * more;
      const MatrixXd u = U.view(pivots), e = E.view(rows);
      const MatrixXd after = u.transpose() * u + e.transpose() * e;
      EXPECT_LT((after - before).norm(), 1e-12 * before.norm()) << pivots << ", " << rows;
      EXPECT_EQ(e.leftCols(pivots).norm(), 0.0);
      EXPECT_EQ(MatrixXd(u.leftCols(pivots).triangularView<Eigen::StrictlyLower>()).norm(), 0.0);
      EXPECT_TRUE(U.padding_is_zero() && E.padding_is_zero());
    }
  }
}

TEST(AbsorbRows, LeavesPivotsNobodyMeasuredAtZero) {
  Random random(5);
  MatrixXd more = random.NextMatrix(10, 20);
  more.col(3).setZero();
  more.col(5) = 1e-11 * more.col(5);
  Rows U(MatrixXd::Zero(8, 20)), E(more);
  AbsorbRows(U.data.data(), U.stride, E.data.data(), E.stride, 10, 8, 20);
  EXPECT_EQ(U.view(8)(3, 3), 0.0);
  EXPECT_EQ(U.view(8)(5, 5), 0.0);
  EXPECT_GT(std::abs(U.view(8)(4, 4)), kLeastPivot);
}

TEST(Triangularise, TakesAsManyRowsAsThereArePivots) {
  Random random(6);
  MatrixXd rows = random.NextMatrix(15, 30);
  rows.col(2) = rows.col(1);  // one direction less
  Rows E(rows), U(MatrixXd::Ones(12, 30));
  const int taken = Triangularise(E.data.data(), E.stride, 15, 12, 30, U.data.data(), U.stride);
  EXPECT_EQ(taken, 11);
  EXPECT_EQ(U.view(12).row(2).norm(), 0.0);
  const MatrixXd u = U.view(12), rest = E.view(15).bottomRows(15 - taken);
  const MatrixXd after = u.transpose() * u + rest.transpose() * rest;
  EXPECT_LT((after - rows.transpose() * rows).norm(), 1e-12 * rows.squaredNorm());
  EXPECT_EQ(rest.leftCols(12).norm(), 0.0);
}

TEST(Triangularise, FewerRowsThanPivotsAreAllTaken) {
  Random random(7);
  const MatrixXd rows = random.NextMatrix(5, 20);
  Rows E(rows), U(MatrixXd::Ones(12, 20));
  EXPECT_EQ(Triangularise(E.data.data(), E.stride, 5, 12, 20, U.data.data(), U.stride), 5);
  const MatrixXd u = U.view(12);
  EXPECT_LT((u.transpose() * u - rows.transpose() * rows).norm(), 1e-12 * rows.squaredNorm());
}

TEST(ForwardSubstitute, BringsAGradientIntoTheRightHandSide) {
  for (const int pivots : {1, 6, 12, 33}) {
    Random random(static_cast<unsigned>(pivots));
    const int columns = pivots + 14, rhs = columns;
    MatrixXd triangle = random.NextMatrix(pivots, columns + 1);
    triangle.leftCols(pivots) = MatrixXd(triangle.leftCols(pivots).triangularView<Eigen::Upper>());
    triangle.diagonal().array() += 3.0;
    const Eigen::VectorXd gradient = random.NextMatrix(columns, 1);
    const MatrixXd by_pivots = triangle.leftCols(pivots), by_rest = triangle.middleCols(pivots, 14);
    const Eigen::VectorXd y =
        by_pivots.transpose().triangularView<Eigen::Lower>().solve(gradient.head(pivots));
    for (const bool with_rhs : {true, false}) {
      Rows U(triangle);
      std::vector<double> g(static_cast<size_t>(columns + kRowPadding));
      std::copy_n(gradient.data(), columns, g.begin());
      const double norm = ForwardSubstitute(U.data.data(), U.stride, pivots, columns,
                                            with_rhs ? rhs : -1, g.data());
      EXPECT_NEAR(norm, y.norm(), 1e-12 * y.norm());
      const Eigen::VectorXd left = Eigen::Map<Eigen::VectorXd>(g.data(), columns);
      EXPECT_LT(left.head(pivots).norm(), 1e-12);
      EXPECT_LT((left.tail(14) - gradient.tail(14) + by_rest.transpose() * y).norm(), 1e-12);
      MatrixXd after = triangle;
      if (with_rhs) after.col(rhs) += y;
      EXPECT_LT((U.view(pivots) - after).norm(), 1e-12);
      EXPECT_TRUE(U.padding_is_zero());
    }
  }
}

TEST(ForwardSubstitute, LeavesOutWhatIsBeyondTheBoundOrNotMeasured) {
  MatrixXd triangle = MatrixXd::Zero(3, 4);
  triangle.diagonal() << 2.0, 0.0, 0.1;
  Rows U(triangle);
  std::vector<double> g(4 + kRowPadding, 0.0);
  g[0] = g[1] = g[2] = -1.0;
  EXPECT_NEAR(ForwardSubstitute(U.data.data(), U.stride, 3, 3, 3, g.data(), 1.0),
              std::hypot(0.5, 1.0), 1e-15);
  const Eigen::Vector3d b = U.view(3).col(3);
  EXPECT_EQ(b, Eigen::Vector3d(-0.5, 0.0, -1.0));
  EXPECT_EQ(g[1], -1.0);
}

TEST(BackSubstitute, SolvesForThePivotsGivenTheOthers) {
  for (const int pivots : {1, 6, 12, 33}) {
    Random random(static_cast<unsigned>(pivots));
    const int columns = pivots + 15;
    MatrixXd triangle = random.NextMatrix(pivots, columns);
    triangle.leftCols(pivots) = MatrixXd(triangle.leftCols(pivots).triangularView<Eigen::Upper>());
    triangle.diagonal().array() += 3.0;
    if (pivots > 1) triangle.row(1).setZero();
    const Rows U(triangle);
    const Eigen::VectorXd given = random.NextMatrix(15, 1);
    std::vector<double> x(static_cast<size_t>(columns + kRowPadding), 0.0);
    std::fill_n(x.begin(), pivots, 7.0);  // does not matter
    std::copy_n(given.data(), 15, x.begin() + pivots);
    BackSubstitute(U.data.data(), U.stride, pivots, columns, x.data());
    const Eigen::VectorXd solution = Eigen::Map<Eigen::VectorXd>(x.data(), columns);
    EXPECT_LT((triangle * solution).norm(), 1e-12 * triangle.norm());
    EXPECT_EQ(solution.tail(15), given);
    EXPECT_TRUE(pivots == 1 || solution[1] == 0.0);
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
