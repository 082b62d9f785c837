#include <gtest/gtest.h>

#include <cmath>

#include "odmc/inspection/stream_doubt.h"

namespace odmc {
namespace {

/// The same by numbers: the measurement under either hypothesis, on a grid of errors.
RareError ByNumbers(double value, double sigma, double prior, double size) {
  const auto gauss = [](double x, double s) {
    return std::exp(-0.5 * x * x / (s * s)) / (s * std::sqrt(2.0 * M_PI));
  };
  const double step = 1e-3 * size;
  double all = 0.0, mean = 0.0, square = 0.0;
  for (double e = -8.0 * size; e < 8.0 * size; e += step) {
    const double p = step * gauss(e, size) * gauss(value - e, sigma);
    all += p;
    mean += p * e;
    square += p * e * e;
  }
  mean /= all;
  const double there = prior * all, not_there = (1.0 - prior) * gauss(value, sigma);
  return {there / (there + not_there), mean, std::sqrt(square / all - mean * mean)};
}

TEST(RareErrorPosterior, IsBayesRule) {
  for (const double value : {-0.03, 0.0, 0.004, 0.012, 0.05}) {
    for (const double sigma : {0.001, 0.005, 0.02}) {
      const RareError expected = ByNumbers(value, sigma, 0.1, 0.02);
      const RareError found = RareErrorPosterior(value, sigma, 0.1, 0.02);
      EXPECT_NEAR(found.probability, expected.probability, 1e-6) << value << " " << sigma;
      EXPECT_NEAR(found.mean, expected.mean, 1e-6);
      EXPECT_NEAR(found.sigma, expected.sigma, 1e-6);
    }
  }
}

TEST(RareErrorPosterior, NothingMeasuredLeavesThePrior) {
  const RareError error = RareErrorPosterior(0.0, 1e6, 0.1, 0.02);
  EXPECT_NEAR(error.probability, 0.1, 1e-6);
  EXPECT_NEAR(error.rms(), std::sqrt(0.1) * 0.02, 1e-6);
  EXPECT_NEAR(RareErrorPosterior(1.0, 1e-6, 0.1, 0.02).probability, 1.0, 1e-12);  // and is finite
}

TEST(UndoDoubt, TakesTheErrorOutAgain) {
  FlightLog log;
  for (int i = 0; i < 20; ++i) {
    RotorSample rotors;
    rotors.stamp = FromSeconds(0.01 * i);
    rotors.speed = RotorVector::Constant(4, 500.0);
    log.rotors.push_back(rotors);
    OdometrySample odometry;
    odometry.stamp = rotors.stamp;
    odometry.v_WS = Eigen::Vector3d(1.0, 2.0, 3.0);
    log.odometry.push_back(odometry);
  }
  UndoDoubt({"rotor_speeds", 0.02}, &log);
  EXPECT_EQ(log.rotors[0].stamp, FromSeconds(-0.02));
  UndoDoubt({"rotor_speeds", 0.0, 1.25, 2}, &log);
  EXPECT_DOUBLE_EQ(log.rotors[5].speed[2], 400.0);
  EXPECT_DOUBLE_EQ(log.rotors[5].speed[1], 500.0);
  UndoDoubt({"velocity", 0.0, 2.0}, &log);
  EXPECT_DOUBLE_EQ(log.odometry[7].v_WS->y(), 1.0);
}

TEST(UndoDoubt, LeavesOutEverySecondSampleOfASparseStream) {
  FlightLog log;
  for (int i = 0; i < 5; ++i) {
    log.rotors.push_back({FromSeconds(0.1 * i), RotorVector::Constant(4, 500.0)});
    log.odometry.emplace_back();
  }
  StreamDoubt doubt;
  doubt.stream = "rotor_speeds";
  doubt.sparse_s = 0.1;
  UndoDoubt(doubt, &log);
  ASSERT_EQ(log.rotors.size(), 3u);
  EXPECT_EQ(log.rotors[2].stamp, FromSeconds(0.4));
  EXPECT_EQ(log.odometry.size(), 5u);
  EXPECT_EQ(Sentence(doubt), "rotor_speeds: one sample in 100 ms, nothing known between");
}

TEST(StreamDoubt, SaysWhatWouldBeWrong) {
  EXPECT_EQ(Sentence({"rotor_speeds", 0.015}), "rotor_speeds: 15 ms late");
  EXPECT_EQ(Sentence({"gyro", -0.004}), "gyro: 4 ms early");
  EXPECT_EQ(Sentence({"velocity", 0.0, 0.96}), "velocity: 4 % too small");
  EXPECT_EQ(Sentence({"rotor_speeds", 0.0, 1.03, 2}), "speed of rotor 3: 3 % too large");
}

}  // namespace
}  // namespace odmc
