#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "odmc/control/low_pass.h"
#include "odmc/control/state_predictor.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

const Eigen::Vector3d kGravity_W(0.0, 0.0, -9.81);

// A circle of 2 m at 2 rad/s while turning about the vertical.
BodyState CircleAt(double t) {
  BodyState state;
  state.stamp = FromSeconds(t);
  state.p_WB = {2.0 * std::cos(2.0 * t), 2.0 * std::sin(2.0 * t), 1.0};
  state.v_WB = {-4.0 * std::sin(2.0 * t), 4.0 * std::cos(2.0 * t), 0.0};
  state.q_WB = Exp({0.0, 0.0, 0.7 * t});
  state.w_WB_B = {0.0, 0.0, 0.7};
  return state;
}

InertialSample InertialAt(double t) {
  const Eigen::Vector3d a_WB(-8.0 * std::cos(2.0 * t), -8.0 * std::sin(2.0 * t), 0.0);
  return {FromSeconds(t), {0.0, 0.0, 0.7}, CircleAt(t).q_WB.conjugate() * (a_WB - kGravity_W)};
}

// Flies 3 s with odometry of 100 Hz that is `delay_s` late; largest error of the last second.
double LargestError(double delay_s, double noise_m, double correction_s) {
  StatePredictor predictor(correction_s);
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  double largest = 0.0;
  for (int k = 1; k <= 1500; ++k) {
    const double t = 0.002 * k;
    predictor.Add(InertialAt(t));
    if (k % 5 == 0 && t > delay_s) {
      BodyState measured = CircleAt(t - delay_s);
      measured.p_WB += noise_m * Eigen::Vector3d(normal(random), normal(random), normal(random));
      EXPECT_TRUE(predictor.Correct(measured, kGravity_W));
    }
    const auto state = predictor.At(FromSeconds(t), kGravity_W);
    if (state && t > 2.0) largest = std::max(largest, (state->p_WB - CircleAt(t).p_WB).norm());
  }
  return largest;
}

TEST(StatePredictor, BridgesTheDelayOfOdometry) {
  EXPECT_LT(LargestError(0.0, 0.0, 0.05), 1e-3);
  EXPECT_LT(LargestError(0.1, 0.0, 0.05), 3e-3);  // the vehicle moved 40 cm meanwhile
}

TEST(StatePredictor, AveragesNoise) {
  EXPECT_LT(LargestError(0.02, 0.01, 0.05), 0.5 * LargestError(0.02, 0.01, 0.001));
}

TEST(StatePredictor, GoesStraightOnWithoutInertialSamples) {
  StatePredictor predictor(0.05);
  EXPECT_FALSE(predictor.At(0, kGravity_W));
  predictor.Correct(CircleAt(1.0), kGravity_W);
  const auto state = predictor.At(FromSeconds(1.02), kGravity_W);
  ASSERT_TRUE(state);
  EXPECT_LT((state->p_WB - CircleAt(1.0).p_WB - 0.02 * CircleAt(1.0).v_WB).norm(), 1e-9);
}

TEST(StatePredictor, BelievesAJumpAtOnceAndSaysSo) {
  StatePredictor predictor(0.05);
  for (int k = 0; k < 50; ++k) {
    predictor.Add(InertialAt(0.002 * k));
    predictor.Correct(CircleAt(0.002 * k), kGravity_W);
  }
  BodyState jumped = CircleAt(0.1);
  jumped.p_WB.x() += 1.0;
  EXPECT_FALSE(predictor.Correct(jumped, kGravity_W));
  EXPECT_LT((predictor.At(FromSeconds(0.1), kGravity_W)->p_WB - jumped.p_WB).norm(), 1e-9);
}

TEST(StatePredictor, IgnoresSamplesOutOfOrder) {
  StatePredictor predictor(0.05);
  for (int k = 0; k <= 50; ++k) predictor.Add(InertialAt(0.002 * k));
  predictor.Correct(CircleAt(0.05), kGravity_W);
  const BodyState before = *predictor.At(FromSeconds(0.1), kGravity_W);
  predictor.Add(InertialAt(0.03));
  predictor.Correct(CircleAt(0.02), kGravity_W);
  EXPECT_EQ(before.p_WB, predictor.At(FromSeconds(0.1), kGravity_W)->p_WB);
}

// A sine through the filter: gain 1/√2 and a quarter turn at the cutoff, and the derivative is that
// of the value.
TEST(LowPass, IsASecondOrderButterworthWithItsDerivative) {
  constexpr double kCutoff_hz = 20.0, kStep_s = 0.0005;
  LowPass filter(kCutoff_hz);
  const double w = 2.0 * M_PI * kCutoff_hz;
  double in_phase = 0.0, quadrature = 0.0, last = 0.0, worst = 0.0;
  for (int k = 0; k < 4000; ++k) {
    const double t = kStep_s * k;
    filter.Add({std::sin(w * t), 1.0, 0.0}, kStep_s);
    if (k >= 2000) {
      in_phase += filter.value().x() * std::sin(w * t) / 1000.0;
      quadrature += filter.value().x() * std::cos(w * t) / 1000.0;
      const double rate = (filter.value().x() - last) / kStep_s;
      worst = std::max(worst, std::abs(rate - filter.derivative().x()));
    }
    last = filter.value().x();
  }
  EXPECT_NEAR(in_phase, 0.0, 0.01);
  EXPECT_NEAR(quadrature, -M_SQRT1_2, 0.01);
  EXPECT_LT(worst, 0.05 * w);
  EXPECT_NEAR(filter.value().y(), 1.0, 1e-12);  // a constant passes from the start
}

TEST(LowPass, IsStableForLongSteps) {
  LowPass filter(30.0);
  for (int k = 0; k < 100; ++k) filter.Add({k % 2 == 0 ? 1.0 : -1.0, 0.0, 0.0}, 0.5);
  EXPECT_LT(filter.value().norm(), 2.0);
}

}  // namespace
}  // namespace odmc
