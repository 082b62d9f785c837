#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "odmc/math/so3.h"
#include "support/jacobian_check.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kPi = 3.14159265358979323846;

/// Rotation vectors over all sizes: zero, tiny, on both sides of the series' bound, generic, near
/// pi.
std::vector<Vector3d> Turns() {
  Random random(1);
  std::vector<Vector3d> turns = {Vector3d::Zero()};
  for (const double angle : {1e-12, 1e-8, 1e-6, 0.99e-4, 1.01e-4, 1e-3, 0.01, 0.1, 0.7, 1.5, 2.5,
                             3.0, kPi - 1e-3, kPi - 1e-6}) {
    for (int i = 0; i < 3; ++i) turns.push_back(angle * random.Next3().normalized());
  }
  return turns;
}

Matrix3d MatrixExp(const Vector3d& a) {
  // Power series of the matrix exponential.
  Matrix3d sum = Matrix3d::Identity(), term = Matrix3d::Identity();
  for (int k = 1; k < 60; ++k) {
    term = (term * Hat(a) / k).eval();
    sum += term;
  }
  return sum;
}

TEST(So3, HatIsTheCrossProduct) {
  Random random(2);
  const Vector3d a = random.Next3(), b = random.Next3();
  EXPECT_LT((Hat(a) * b - a.cross(b)).norm(), 1e-15);
  EXPECT_EQ(Hat(a).transpose(), -Hat(a));
}

TEST(So3, ExpIsTheMatrixExponential) {
  for (const Vector3d& a : Turns()) {
    EXPECT_LT((Exp(a).toRotationMatrix() - MatrixExp(a)).norm(), 1e-13) << a.norm();
    EXPECT_NEAR(Exp(a).norm(), 1.0, 1e-14);
  }
}

TEST(So3, LogUndoesExp) {
  for (const Vector3d& a : Turns()) {
    EXPECT_LT((Log(Exp(a)) - a).norm(), 1e-13 * std::max(1e-3, a.norm())) << a.norm();
  }
}

TEST(So3, LogIsTheShortWayWhateverTheQuaternionsSign) {
  for (const Vector3d& a : Turns()) {
    Eigen::Quaterniond q = Exp(a);
    q.coeffs() *= -1.0;
    EXPECT_LT((Log(q) - a).norm(), 1e-12) << a.norm();
  }
  const Vector3d beyond(0.0, 0.0, kPi + 0.3);
  EXPECT_LT((Log(Exp(beyond)) - Vector3d(0.0, 0.0, -kPi + 0.3)).norm(), 1e-13);
}

TEST(So3, HalfATurnKeepsItsAngle) {
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(Log(Exp(kPi * Vector3d::Unit(axis))).norm(), kPi, 1e-12);
  }
}

TEST(So3, RightJacobianIsTheDerivativeOfExp) {
  constexpr double kStep = 1e-6;
  for (const Vector3d& a : Turns()) {
    const Matrix3d J = RightJacobian(a);
    for (int i = 0; i < 3; ++i) {
      const Vector3d d = kStep * Vector3d::Unit(i);
      const Vector3d slope =
          (Log(Exp(a).conjugate() * Exp(a + d)) - Log(Exp(a).conjugate() * Exp(a - d))) /
          (2.0 * kStep);
      EXPECT_LT((slope - J.col(i)).norm(), 1e-8) << a.norm();
    }
  }
}

TEST(So3, RightJacobianInverseIsTheInverse) {
  for (const Vector3d& a : Turns()) {
    EXPECT_LT((RightJacobian(a) * RightJacobianInverse(a) - Matrix3d::Identity()).norm(), 1e-10)
        << a.norm();
  }
}

TEST(So3, SeriesAndClosedFormMeetWithoutAStep) {
  Random random(4);
  const Vector3d direction = random.Next3().normalized();
  const Vector3d below = 0.999999e-4 * direction, above = 1.000001e-4 * direction;
  EXPECT_LT((RightJacobian(above) - RightJacobian(below)).norm(), 1e-9);
  EXPECT_LT((RightJacobianInverse(above) - RightJacobianInverse(below)).norm(), 1e-9);
}

TEST(So3, LeftJacobianIsTheTransposeOfTheRight) {
  for (const Vector3d& a : Turns()) {
    EXPECT_LT((LeftJacobian(a) - RightJacobian(a).transpose()).norm(), 1e-12);
    EXPECT_LT((LeftJacobianInverse(a) - RightJacobianInverse(a).transpose()).norm(), 1e-9);
    EXPECT_LT((LeftJacobian(a) - Exp(a).toRotationMatrix() * RightJacobian(a)).norm(), 1e-9);
  }
}

// model.md section 13, test 8.
TEST(So3, WeightsOfTheMidpointAttitudeAddUpToIdentity) {
  for (const Vector3d& a : Turns()) {
    const Matrix3d A0 = 0.5 * LeftJacobian(0.5 * a) * LeftJacobianInverse(a);
    const Matrix3d A1 = 0.5 * RightJacobian(0.5 * a) * RightJacobianInverse(a);
    EXPECT_LT((A0 + A1 - Matrix3d::Identity()).norm(), 1e-11) << a.norm();
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
