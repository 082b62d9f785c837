#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>

#include "odmc/inspection/join_odometry.h"
#include "odmc/inspection/motion_signals.h"
#include "odmc/inspection/time_offsets.h"
#include "odmc/io/flight_csv.h"
#include "odmc/math/so3.h"
#include "support/error_text.h"
#include "support/recorded_data.h"

namespace odmc {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

/// A motion that does not repeat itself within minutes.
Vector3d RatesAt(double t, int kind) {
  const double k = 1.0 + 0.37 * kind;
  return {std::sin(2.1 * k * t) + 0.7 * std::sin(5.3 * t + kind), 0.8 * std::sin(3.7 * k * t + 1.0),
          0.5 * std::sin(0.9 * t) + 0.6 * std::sin(4.4 * k * t * (1.0 + 0.002 * t))};
}

struct Recording {
  std::vector<ImuSample> imu;
  std::vector<OdometrySample> poses;
};

constexpr Stamp kPoseClock = 1700000000000000000;  // far off the log's, which starts at 5 s
constexpr double kPosesLater_s = 3.217;            // off the steps of the first search

/// The gyro at 500 Hz, in a frame turned against the body's, with bias and noise; poses at
/// `rate_hz` with noise of 1 mrad, on another clock: they are right with `true_offset` added to
/// their stamps.
Recording Record(double duration_s, double rate_hz, int kind_of_poses = 0, unsigned seed = 7) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise;
  const Quaterniond q_SI(Eigen::AngleAxisd(1.2, Vector3d(1.0, 2.0, -1.0).normalized()));
  Recording recording;
  const auto draw = [&]() -> Vector3d { return {noise(random), noise(random), noise(random)}; };
  Quaterniond q = Quaterniond::Identity();
  constexpr double kFine_s = 0.0005;
  const auto steps = static_cast<long>(duration_s / kFine_s);
  long next_pose = 0;
  for (long i = 0; i < steps; ++i) {
    const double t = static_cast<double>(i) * kFine_s;
    if (i % 4 == 0) {
      const Vector3d gyro = q_SI.conjugate() * RatesAt(t, 0);
      recording.imu.push_back({FromSeconds(5.0 + t),
                               Vector3d(gyro + Vector3d(0.02, -0.01, 0.03) + 0.01 * draw()),
                               std::nullopt});
    }
    if (t >= kPosesLater_s && t >= static_cast<double>(next_pose) / rate_hz) {
      OdometrySample s;
      s.stamp = kPoseClock + FromSeconds(t);
      s.p_WS = Vector3d(std::sin(t), t, 0.0);
      s.q_WS = q * Exp(1e-3 * draw());
      recording.poses.push_back(s);
      next_pose = static_cast<long>(t * rate_hz) + 1;
    }
    q = (q * Exp(RatesAt(t + 0.5 * kFine_s, kind_of_poses) * kFine_s)).normalized();
  }
  return recording;
}

const double kTrueOffset_s = 5.0 - ToSeconds(kPoseClock);

TEST(JoinOdometry, OffsetIsFoundWithinItsSigma) {
  double squares = 0.0, count = 0.0;
  for (const double rate_hz : {20.0, 100.0, 240.0}) {
    for (unsigned seed = 1; seed <= 6; ++seed) {
      const Recording r = Record(40.0, rate_hz, 0, seed);
      const ClockOffset found = FindClockOffset(r.imu, r.poses);
      const double error_s = found.offset_s - kTrueOffset_s;
      EXPECT_LT(found.sigma_s, 3e-4) << rate_hz;
      EXPECT_LT(std::abs(error_s), 3e-4) << rate_hz;
      EXPECT_GT(found.explained, 0.9) << rate_hz;
      squares += std::pow(error_s / found.sigma_s, 2);
      ++count;
    }
  }
  // Mean square of 18 errors over sigmas of 7 degrees of freedom each: 1.4, with a standard error
  // of 0.66 (Student's t).
  EXPECT_LT(squares / count, 3.4);
  EXPECT_GT(squares / count, 0.1);
}

TEST(JoinOdometry, PosesOfAnotherFlightAreRefused) {
  const Recording r = Record(40.0, 100.0, 3);
  ODMC_EXPECT_ERROR(FindClockOffset(r.imu, r.poses), "they are not of one flight");
}

TEST(JoinOdometry, MotionThatRepeatsItselfIsRefused) {
  Recording r;
  Quaterniond q = Quaterniond::Identity();
  for (int i = 0; i < 6000; ++i) {  // the same turn each 2 s, poses of half of it
    const double t = 0.01 * i;
    const Vector3d w(std::sin(M_PI * t), 0.5 * std::sin(2.0 * M_PI * t), 0.0);
    r.imu.push_back({FromSeconds(t), w, std::nullopt});
    OdometrySample s;
    s.stamp = FromSeconds(t);
    s.q_WS = q;
    if (t > 20.0 && t < 40.0) r.poses.push_back(s);
    q = q * Exp(0.01 * Vector3d(std::sin(M_PI * (t + 0.005)),
                                0.5 * std::sin(2.0 * M_PI * (t + 0.005)), 0.0));
  }
  ODMC_EXPECT_ERROR(FindClockOffset(r.imu, r.poses), "the motion repeats itself");
}

TEST(JoinOdometry, WithoutAGyroOrMotionItSaysSo) {
  Recording r = Record(20.0, 100.0);
  for (ImuSample& s : r.imu) s.gyro_I.reset();
  ODMC_EXPECT_ERROR(FindClockOffset(r.imu, r.poses), "there is no gyro");
  r = Record(4.0, 100.0);
  ODMC_EXPECT_ERROR(FindClockOffset(r.imu, r.poses), "less than 5 s");
}

FlightLog OnboardOf(const Recording& r) {
  FlightLog log;
  log.file = "log";
  log.imu = r.imu;
  for (const ImuSample& s : r.imu) log.rotors.push_back({s.stamp, RotorVector::Constant(4, 500.0)});
  return log;
}

TEST(JoinOdometry, LogGetsThePosesWithinIt) {
  const Recording r = Record(40.0, 100.0);
  FlightLog log = OnboardOf(r), poses;
  poses.file = "poses";
  poses.odometry = r.poses;
  OdometrySample late = r.poses.back();
  late.stamp += FromSeconds(60.0);
  poses.odometry.push_back(late);
  log.odometry.resize(3);  // its own go
  JoinOdometry(poses, std::nullopt, &log);
  EXPECT_EQ(log.odometry.size(), r.poses.size());
  EXPECT_NEAR(ToSeconds(log.odometry.front().stamp), 5.0 + kPosesLater_s, 2e-3);
  EXPECT_EQ(log.odometry.front().p_WS, r.poses.front().p_WS);
  ASSERT_FALSE(log.warnings.empty());
  EXPECT_NE(log.warnings.back().find("sigma"), std::string::npos) << log.warnings.back();
  EXPECT_NE(log.warnings.back().find("in place of the log's own"), std::string::npos);
}

TEST(JoinOdometry, AToldOffsetIsTaken) {
  const Recording r = Record(20.0, 100.0);
  FlightLog log = OnboardOf(r), poses;
  poses.file = "poses";
  poses.odometry = r.poses;
  JoinOdometry(poses, kTrueOffset_s + 0.5, &log);
  EXPECT_NEAR(ToSeconds(log.odometry.front().stamp), 5.5 + kPosesLater_s, 1e-5);
  FlightLog far = OnboardOf(r);
  ODMC_EXPECT_ERROR(JoinOdometry(poses, 0.0, &far), "no pose of poses is within the log");
}

/// A recorded flight split in two: its gyro, and its observer's poses on another clock.
TEST(JoinOdometry, RecordedFlightSplitInTwo) {
  const std::string file = test::RecordedFile("indiflight/LOG00267.csv");
  if (file.empty()) GTEST_SKIP() << "no recorded data";
  const FlightLog whole = ReadFlightCsv(file, 4, PoseSource::kEkf);
  std::vector<OdometrySample> poses = whole.odometry;
  for (OdometrySample& s : poses) s.stamp += 777123456789;
  const ClockOffset found = FindClockOffset(whole.imu, poses);
  // The observer's attitude is some steps of its filter away from the gyro in the recording itself.
  const std::optional<MotionSignals> signals = SignalsOf(whole);
  ASSERT_TRUE(signals);
  const std::vector<bool> all(static_cast<size_t>(signals->position.last_s() / kFlightStep_s) + 1,
                              true);
  const std::optional<TimeOffset> own = GyroOffset(*signals, all);
  ASSERT_TRUE(own);
  const double error_s = found.offset_s + 777.123456789 - own->lag.lag_s;
  EXPECT_LT(std::abs(error_s), 1e-4);
  EXPECT_LT(found.sigma_s, 5e-4);
  std::printf("own lag %.3f ms; offset off it by %.3f ms, sigma %.3f ms\n", 1e3 * own->lag.lag_s,
              1e3 * error_s, 1e3 * found.sigma_s);
}

}  // namespace
}  // namespace odmc
