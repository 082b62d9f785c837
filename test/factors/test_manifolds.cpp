#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>
#include <memory>

#include "odmc/factors/manifolds.h"
#include "odmc/factors/state.h"
#include "odmc/math/so3.h"
#include "support/jacobian_check.h"

// The identities of ceres/manifold_test_utils.h, which needs gmock.
namespace odmc {
namespace test {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double kTolerance = 1e-9;
constexpr int kNumPoints = 20;

VectorXd Plus(const ceres::Manifold& m, const VectorXd& x, const VectorXd& d) {
  VectorXd y(m.AmbientSize());
  EXPECT_TRUE(m.Plus(x.data(), d.data(), y.data()));
  return y;
}

VectorXd Minus(const ceres::Manifold& m, const VectorXd& y, const VectorXd& x) {
  VectorXd d(m.TangentSize());
  EXPECT_TRUE(m.Minus(y.data(), x.data(), d.data()));
  return d;
}

MatrixXd PlusJacobian(const ceres::Manifold& m, const VectorXd& x) {
  RowMajor J(m.AmbientSize(), m.TangentSize());
  EXPECT_TRUE(m.PlusJacobian(x.data(), J.data()));
  return J;
}

MatrixXd MinusJacobian(const ceres::Manifold& m, const VectorXd& x) {
  RowMajor J(m.TangentSize(), m.AmbientSize());
  EXPECT_TRUE(m.MinusJacobian(x.data(), J.data()));
  return J;
}

VectorXd RandomPoint(const ceres::Manifold& m, Random* random) {
  const Eigen::Quaterniond q = Exp(random->Next3(1.8));
  if (m.AmbientSize() == 4) return q.coeffs();
  VectorXd x = random->NextVector(kStateSize, 5.0);
  x.segment<4>(3) = q.coeffs();
  return x;
}

class Manifolds : public testing::TestWithParam<bool> {
 protected:
  Manifolds() {
    if (GetParam()) {
      manifold_ = std::make_unique<StateManifold>();
    } else {
      manifold_ = std::make_unique<RotationManifold>();
    }
  }

  std::unique_ptr<ceres::Manifold> manifold_;
  Random random_{11};
};

TEST_P(Manifolds, PlusOfZeroStaysInPlace) {
  for (int i = 0; i < kNumPoints; ++i) {
    const VectorXd x = RandomPoint(*manifold_, &random_);
    const VectorXd zero = VectorXd::Zero(manifold_->TangentSize());
    EXPECT_LT((Plus(*manifold_, x, zero) - x).norm(), 1e-14 * x.norm());
  }
}

TEST_P(Manifolds, MinusOfAPointFromItselfIsZero) {
  for (int i = 0; i < kNumPoints; ++i) {
    const VectorXd x = RandomPoint(*manifold_, &random_);
    EXPECT_LT(Minus(*manifold_, x, x).norm(), 1e-14);
  }
}

TEST_P(Manifolds, MinusUndoesPlus) {
  for (int i = 0; i < kNumPoints; ++i) {
    const VectorXd x = RandomPoint(*manifold_, &random_);
    const double size = i % 3 == 0 ? 1e-6 : 1.5;
    const VectorXd d = random_.NextVector(manifold_->TangentSize(), size);
    EXPECT_LT((Minus(*manifold_, Plus(*manifold_, x, d), x) - d).norm(), kTolerance * size);
  }
}

TEST_P(Manifolds, PlusUndoesMinus) {
  for (int i = 0; i < kNumPoints; ++i) {
    const VectorXd x = RandomPoint(*manifold_, &random_), y = RandomPoint(*manifold_, &random_);
    VectorXd back = Plus(*manifold_, x, Minus(*manifold_, y, x));
    const int q = manifold_->AmbientSize() == 4 ? 0 : 3;
    if (back.segment<4>(q).dot(y.segment<4>(q)) < 0.0) back.segment<4>(q) *= -1.0;
    EXPECT_LT((back - y).norm(), kTolerance);
  }
}

TEST_P(Manifolds, PlusJacobianIsTheDerivativeOfPlus) {
  constexpr double kStep = 1e-6;
  for (int i = 0; i < kNumPoints; ++i) {
    const VectorXd x = RandomPoint(*manifold_, &random_);
    const MatrixXd J = PlusJacobian(*manifold_, x);
    for (int k = 0; k < manifold_->TangentSize(); ++k) {
      const VectorXd d = kStep * VectorXd::Unit(manifold_->TangentSize(), k);
      const VectorXd slope = (Plus(*manifold_, x, d) - Plus(*manifold_, x, -d)) / (2.0 * kStep);
      EXPECT_LT((slope - J.col(k)).norm(), 1e-8) << "column " << k;
    }
  }
}

TEST_P(Manifolds, MinusJacobianIsTheDerivativeOfMinusAlongTheManifold) {
  constexpr double kStep = 1e-6;
  for (int i = 0; i < kNumPoints; ++i) {
    const VectorXd x = RandomPoint(*manifold_, &random_);
    const MatrixXd J = MinusJacobian(*manifold_, x) * PlusJacobian(*manifold_, x);
    for (int k = 0; k < manifold_->TangentSize(); ++k) {
      const VectorXd d = kStep * VectorXd::Unit(manifold_->TangentSize(), k);
      const VectorXd slope = (Minus(*manifold_, Plus(*manifold_, x, d), x) -
                              Minus(*manifold_, Plus(*manifold_, x, -d), x)) /
                             (2.0 * kStep);
      EXPECT_LT((slope - J.col(k)).norm(), 1e-8) << "column " << k;
    }
  }
}

TEST_P(Manifolds, MinusJacobianTimesPlusJacobianIsIdentity) {
  for (int i = 0; i < kNumPoints; ++i) {
    const VectorXd x = RandomPoint(*manifold_, &random_);
    const MatrixXd product = MinusJacobian(*manifold_, x) * PlusJacobian(*manifold_, x);
    const int n = manifold_->TangentSize();
    EXPECT_LT((product - MatrixXd::Identity(n, n)).norm(), kTolerance);
  }
}

TEST_P(Manifolds, RightMultiplyByPlusJacobianIsTheProduct) {
  const VectorXd x = RandomPoint(*manifold_, &random_);
  const RowMajor A = random_.NextMatrix(3, manifold_->AmbientSize());
  RowMajor B(3, manifold_->TangentSize());
  ASSERT_TRUE(manifold_->RightMultiplyByPlusJacobian(x.data(), 3, A.data(), B.data()));
  EXPECT_LT((B - A * PlusJacobian(*manifold_, x)).norm(), kTolerance);
}

INSTANTIATE_TEST_SUITE_P(Both, Manifolds, testing::Bool(), [](const auto& which) {
  return std::string(which.param ? "State" : "Rotation");
});

TEST(RotationManifold, TurnsOnTheRightByTheFullAngle) {
  Random random(5);
  const RotationManifold manifold;
  for (int i = 0; i < kNumPoints; ++i) {
    const Eigen::Quaterniond q = Exp(random.Next3());
    const Eigen::Vector3d theta = random.Next3();
    const VectorXd y = Plus(manifold, q.coeffs(), theta);
    const Eigen::Matrix3d expected =
        q.toRotationMatrix() * Eigen::AngleAxisd(theta.norm(), theta.normalized()).matrix();
    const Eigen::Quaterniond turned(y[3], y[0], y[1], y[2]);
    EXPECT_LT((turned.toRotationMatrix() - expected).norm(), 1e-12);
    EXPECT_NEAR(y.norm(), 1.0, 1e-14);
  }
}

TEST(StateManifold, LiftTimesPlusJacobianGivesBackTheMinimalJacobian) {
  Random random(6);
  const StateManifold manifold;
  const VectorXd x = RandomPoint(manifold, &random);
  const Eigen::Matrix<double, 6, 12> minimal = random.NextMatrix(6, 12);
  const MatrixXd product = StateManifold::Lift(minimal, x.data()) * PlusJacobian(manifold, x);
  EXPECT_LT((product - minimal).norm(), 1e-12);
}

TEST(State, BlockKeepsEveryNumberInItsPlace) {
  Random random(8);
  State s;
  s.p_WS = random.Next3();
  s.q_WS = Exp(random.Next3());
  s.v_WS = random.Next3();
  s.w_WS_S = random.Next3();
  std::array<double, kStateSize> block;
  s.ToBlock(block.data());
  EXPECT_EQ(block[3], s.q_WS.x());
  EXPECT_EQ(block[6], s.q_WS.w());
  const State t = State::FromBlock(block.data());
  EXPECT_EQ(t.p_WS, s.p_WS);
  EXPECT_EQ(t.q_WS.coeffs(), s.q_WS.coeffs());
  EXPECT_EQ(t.v_WS, s.v_WS);
  EXPECT_EQ(t.w_WS_S, s.w_WS_S);
}

}  // namespace
}  // namespace test
}  // namespace odmc
