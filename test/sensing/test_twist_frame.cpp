#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <random>

#include "odmc/sensing/twist_frame.h"

namespace odmc {
namespace {

/// Circles with changing heading and a lean, sampled at 100 Hz.
struct Flight {
  double radius_m = 1.0;
  double rate_rad_s = 1.5;
  double yaw_rate_rad_s = 0.4;
  double lean_rad = 0.15;

  Eigen::Vector3d p(double t) const {
    return radius_m * Eigen::Vector3d(std::cos(rate_rad_s * t), std::sin(rate_rad_s * t), 1.0);
  }
  Eigen::Vector3d v(double t) const {
    return radius_m * rate_rad_s *
           Eigen::Vector3d(-std::sin(rate_rad_s * t), std::cos(rate_rad_s * t), 0.0);
  }
  Eigen::Quaterniond q(double t) const {
    return Eigen::AngleAxisd(0.7 + yaw_rate_rad_s * t, Eigen::Vector3d::UnitZ()) *
           Eigen::Quaterniond(Eigen::AngleAxisd(lean_rad, Eigen::Vector3d::UnitX()));
  }
};

enum class Sent { kBody, kWorld, kZero, kNed };

TwistFrameDecision Detect(const Flight& flight, Sent sent, double seconds = 10.0,
                          double position_noise_m = 0.005, double rate_hz = 100.0) {
  std::mt19937 generator(7);
  std::normal_distribution<double> noise(0.0, position_noise_m);
  TwistFrameDetector detector;
  for (double t = 0.0; t < seconds; t += 1.0 / rate_hz) {
    const Eigen::Vector3d v = flight.v(t);
    Eigen::Vector3d twist = v;
    if (sent == Sent::kBody) twist = flight.q(t).conjugate() * v;
    if (sent == Sent::kZero) twist.setZero();
    if (sent == Sent::kNed) twist = Eigen::Vector3d(v.y(), v.x(), -v.z());
    const Eigen::Vector3d p =
        flight.p(t) + Eigen::Vector3d(noise(generator), noise(generator), noise(generator));
    detector.AddSample(FromSeconds(t), p, flight.q(t), twist);
  }
  return detector.decision();
}

TEST(TwistFrameDetector, TellsBodyFromWorld) {
  for (const double rate_hz : {20.0, 100.0, 400.0}) {
    EXPECT_EQ(Detect({}, Sent::kBody, 10.0, 0.005, rate_hz).frame, TwistFrame::kBody);
    EXPECT_EQ(Detect({}, Sent::kWorld, 10.0, 0.005, rate_hz).frame, TwistFrame::kWorld);
  }
}

TEST(TwistFrameDetector, DecidesWithinSecondsOfMotion) {
  const TwistFrameDecision decision = Detect({}, Sent::kWorld, 2.0);
  EXPECT_EQ(decision.frame, TwistFrame::kWorld);
  EXPECT_LT(decision.world_residual_m_s, 0.1);
  EXPECT_GT(decision.body_residual_m_s, 0.5);
}

TEST(TwistFrameDetector, BearsNoisyPositions) {
  EXPECT_EQ(Detect({}, Sent::kBody, 10.0, 0.05).frame, TwistFrame::kBody);
}

TEST(TwistFrameDetector, BearsAJumpOfTheOdometry) {
  for (const Sent sent : {Sent::kBody, Sent::kWorld}) {
    const Flight flight;
    TwistFrameDetector detector;
    for (double t = 0.0; t < 10.0; t += 0.01) {
      const Eigen::Vector3d twist =
          sent == Sent::kBody ? flight.q(t).conjugate() * flight.v(t) : flight.v(t);
      const Eigen::Vector3d p = flight.p(t) + (t < 0.5 ? 0.0 : 3.0) * Eigen::Vector3d::UnitY();
      detector.AddSample(FromSeconds(t), p, flight.q(t), twist);
    }
    const TwistFrame right = sent == Sent::kBody ? TwistFrame::kBody : TwistFrame::kWorld;
    EXPECT_EQ(detector.decision().frame, right) << detector.decision().Describe();
  }
}

TEST(TwistFrameDetector, RefusesWhatFitsNeither) {
  const TwistFrameDecision zero = Detect({}, Sent::kZero);
  EXPECT_EQ(zero.frame, TwistFrame::kNeither);
  EXPECT_EQ(Detect({}, Sent::kNed).frame, TwistFrame::kNeither);
  EXPECT_NEAR(zero.speed_m_s, 1.5, 0.02);
  EXPECT_NE(zero.Describe().find("m/s RMS if it is in the body frame"), std::string::npos);
}

TEST(TwistFrameDetector, StaysUndecidedWithoutMotion) {
  Flight hover;
  hover.radius_m = 0.05;
  EXPECT_EQ(Detect(hover, Sent::kBody).frame, TwistFrame::kUndecided);
}

TEST(TwistFrameDetector, StaysUndecidedWhereBothFramesAreOne) {
  TwistFrameDetector detector;
  for (double t = 0.0; t < 10.0; t += 0.01) {
    detector.AddSample(FromSeconds(t), Eigen::Vector3d(t, 0.0, 1.0), Eigen::Quaterniond::Identity(),
                       Eigen::Vector3d::UnitX());
  }
  EXPECT_EQ(detector.decision().frame, TwistFrame::kUndecided);
}

TEST(TwistFrameDetector, BearsGapsAndBackwardStamps) {
  const Flight flight;
  TwistFrameDetector detector;
  for (int i = 0; i < 1000; ++i) {
    const double t = 0.01 * i + (i > 300 ? 100.0 : 0.0) - (i > 600 ? 100.0 : 0.0);
    detector.AddSample(FromSeconds(t), flight.p(t), flight.q(t), flight.v(t));
  }
  EXPECT_EQ(detector.decision().frame, TwistFrame::kWorld);
}

TEST(ResolveTwistFrame, TheVerdictComesBeforeTheHeader) {
  EXPECT_EQ(ResolveTwistFrame(TwistFrame::kBody, "world", "world"), TwistFrame::kBody);
  EXPECT_EQ(ResolveTwistFrame(TwistFrame::kUndecided, "world", "world"), TwistFrame::kWorld);
  EXPECT_EQ(ResolveTwistFrame(TwistFrame::kUndecided, "world", "base_link"), TwistFrame::kBody);
  EXPECT_EQ(ResolveTwistFrame(TwistFrame::kUndecided, "", ""), TwistFrame::kBody);
  EXPECT_EQ(ResolveTwistFrame(TwistFrame::kNeither, "world", "world"), TwistFrame::kNeither);
}

TEST(TwistFrameStated, KnowsThreeSettings) {
  EXPECT_EQ(TwistFrameStated("auto"), TwistFrame::kUndecided);
  EXPECT_EQ(TwistFrameStated("body"), TwistFrame::kBody);
  EXPECT_EQ(TwistFrameStated("world"), TwistFrame::kWorld);
  EXPECT_EQ(TwistFrameStated("ned"), std::nullopt);
}

}  // namespace
}  // namespace odmc
