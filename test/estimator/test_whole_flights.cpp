#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "odmc/analysis/replay.h"
#include "odmc/estimator/thirds_consistency.h"
#include "odmc/math/so3.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kRate_hz = 200.0;

/// A simulated flight with stands and hands before and after it.
class WholeFlight : public testing::Test {
 protected:
  WholeFlight() {
    vehicle_.odometry = {};  // the pose is the body's
    vehicle_.parameters["thrust.k_f"] = {1.3e-6, 4e-7, true};
    SimulationOptions options;
    options.trajectory = "octo";
    options.duration_s = 14.0;
    options.log_rate_hz = kRate_hz;
    const DynamicModel truth_model(vehicle_, vehicle_.effects);
    ModelValues truth = DefaultTruth(truth_model);
    truth[truth_model.IndexOf("thrust.k_f")] = kThrust;
    log_ = Simulate(truth_model, truth, options).log;
    hover_rad_s_ = std::sqrt(vehicle_.mass_kg * vehicle_.gravity_m_s2 / (4.0 * kThrust));
  }

  ReplayResult Learn(const FlightLog& log) const {
    const DynamicModel model(vehicle_, vehicle_.effects);
    Estimator estimator(&model, OfflineOptions(), true);
    return Replay(log, &estimator);
  }

  /// One more sample of pose and rotors, `dt` after the last.
  void Append(const Vector3d& p, const Quaterniond& q, const Vector3d& v, const Vector3d& w,
              double thrust, FlightLog* log) {
    OdometrySample odometry;
    odometry.stamp = log->odometry.back().stamp + FromSeconds(1.0 / kRate_hz);
    odometry.p_WS = p + Noise(0.01);
    odometry.q_WS = q * Exp(Noise(0.003));
    odometry.v_WS = v + Noise(0.03);
    odometry.w_WS_S = w + Noise(0.01);
    RotorSample rotors;
    rotors.stamp = odometry.stamp;
    const double target = std::sqrt(thrust) * hover_rad_s_;
    const double left = std::exp(-1.0 / (kRate_hz * motor_s_));  // of the way there
    rotors.speed = RotorVector::Constant(4, target);
    if (!log->rotors.empty()) rotors.speed += left * (log->rotors.back().speed - rotors.speed);
    for (int j = 0; j < 4; ++j) rotors.speed[j] += 2.0 * gaussian_(engine_);
    rotors.speed = rotors.speed.cwiseMax(0.0);
    log->odometry.push_back(odometry);
    log->rotors.push_back(rotors);
  }

  Vector3d Noise(double sigma) {
    return sigma * Vector3d(gaussian_(engine_), gaussian_(engine_), gaussian_(engine_));
  }

  /// Comes to a stop within 0.3 s, level, and stands there.
  void AppendStand(double thrust, double duration_s, FlightLog* log) {
    const OdometrySample end = log->odometry.back();
    Vector3d p = end.p_WS;
    const int stop = static_cast<int>(0.3 * kRate_hz);
    for (int i = 1; i <= static_cast<int>(duration_s * kRate_hz); ++i) {
      const double left = std::max(0.0, 1.0 - i / static_cast<double>(stop));
      const Vector3d v = left * *end.v_WS;
      p += v / kRate_hz;
      Append(p, end.q_WS.slerp(1.0 - left, Quaterniond::Identity()), v, left * *end.w_WS_S, thrust,
             log);
    }
  }

  /// Carried about at walking pace, leaning.
  void AppendHand(double thrust, double duration_s, FlightLog* log) {
    Vector3d p = log->odometry.back().p_WS;
    for (int i = 1; i <= static_cast<int>(duration_s * kRate_hz); ++i) {
      const double t = i / kRate_hz;
      const Vector3d v(std::min(1.0, t), 0.3 * std::sin(2.0 * t), 0.2 * std::sin(9.0 * t));
      const double lean = 0.2 * std::sin(1.5 * t);
      p += v / kRate_hz;
      Append(p, Quaterniond(Eigen::AngleAxisd(lean, Vector3d::UnitY())), v,
             Vector3d(0.0, 0.3 * std::cos(1.5 * t), 0.0), thrust, log);
    }
  }

  /// The flight, with a stand before it.
  FlightLog AfterStand(double thrust, double duration_s) {
    FlightLog log;
    OdometrySample first = log_.odometry.front();
    first.v_WS = first.w_WS_S = Vector3d::Zero();
    first.q_WS.setIdentity();
    log.odometry.push_back(first);
    log.rotors.push_back({first.stamp, RotorVector::Constant(4, std::sqrt(thrust) * hover_rad_s_)});
    AppendStand(thrust, duration_s, &log);
    const Stamp shift = log.odometry.back().stamp + FromSeconds(1.0 / kRate_hz) - first.stamp;
    for (OdometrySample s : log_.odometry)
      log.odometry.push_back(s), log.odometry.back().stamp += shift;
    for (RotorSample s : log_.rotors) log.rotors.push_back(s), log.rotors.back().stamp += shift;
    return log;
  }

  static constexpr double kThrust = 1.5e-6;
  Vehicle vehicle_ = NominalVehicle();
  FlightLog log_;
  double hover_rad_s_ = 0.0;
  double motor_s_ = 0.03;  // time constant of the rotors on the ground
  std::mt19937 engine_{5};
  std::normal_distribution<double> gaussian_;
};

/// Every observable parameter of `spoiled` is that of `plain`, in sigmas of the latter.
void ExpectSame(const ReplayResult& plain, const ReplayResult& spoiled, double sigmas) {
  ASSERT_TRUE(plain.last);
  ASSERT_TRUE(spoiled.last);
  for (Eigen::Index k = 0; k < plain.last->values.size(); ++k) {
    if (!plain.last->observable[k]) continue;
    EXPECT_NEAR(spoiled.last->values[k], plain.last->values[k], sigmas * plain.last->sigma[k]) << k;
    EXPECT_TRUE(spoiled.last->observable[k]) << k;
  }
}

TEST_F(WholeFlight, AStandAfterTheFlightIsTakenBack) {
  const ReplayResult plain = Learn(log_);
  for (const double thrust : {0.0, 0.3, 0.5, 0.8}) {
    SCOPED_TRACE(thrust);
    FlightLog log = log_;
    AppendStand(thrust, 1.0, &log);
    const ReplayResult spoiled = Learn(log);
    ExpectSame(plain, spoiled, 0.5);
    EXPECT_GT(spoiled.counters.taken_back, 5);
    EXPECT_FALSE(Teaches(spoiled.phases.back().phase));
  }
}

TEST_F(WholeFlight, AStandBeforeTheFlightIsForgotten) {
  const ReplayResult plain = Learn(log_);
  for (const double thrust : {0.2, 0.5, 0.8}) {
    SCOPED_TRACE(thrust);
    const ReplayResult spoiled = Learn(AfterStand(thrust, 5.0));
    ExpectSame(plain, spoiled, 3.0 * std::sqrt(2.0));  // its keyframes see other noise
    EXPECT_FALSE(Teaches(spoiled.phases.front().phase));
    EXPECT_NEAR(ToSeconds(spoiled.phases.front().to - spoiled.phases.front().from), 5.0, 0.5);
  }
}

TEST_F(WholeFlight, AHandTeachesNothing) {
  const ReplayResult plain = Learn(log_);
  for (const double thrust : {0.0, 0.1}) {
    SCOPED_TRACE(thrust);
    FlightLog log = log_;
    AppendStand(thrust, 1.0, &log);
    AppendHand(thrust, 5.0, &log);
    const ReplayResult spoiled = Learn(log);
    ExpectSame(plain, spoiled, 0.5);
    EXPECT_EQ(spoiled.phases.back().phase, FlightPhase::kInHand);
  }
}

// An ESC that is switched off reads zero at once, as one that fails.
TEST_F(WholeFlight, RotorSpeedsThatEndAtOnceAreAStandToo) {
  const ReplayResult plain = Learn(log_);
  FlightLog log = log_;
  AppendStand(0.3, 1.0, &log);
  motor_s_ = 1e-4;
  AppendStand(0.0, 4.0, &log);
  AppendHand(0.0, 3.0, &log);
  const ReplayResult spoiled = Learn(log);
  ExpectSame(plain, spoiled, 0.5);
  EXPECT_EQ(spoiled.phases.back().phase, FlightPhase::kInHand);
}

TEST_F(WholeFlight, ItFliesOnAfterALanding) {
  FlightLog log = log_;
  AppendStand(0.5, 2.0, &log);
  const FlightLog second = log_;
  const Stamp shift = log.odometry.back().stamp + FromSeconds(0.2) - second.odometry.front().stamp;
  for (OdometrySample s : second.odometry)
    log.odometry.push_back(s), log.odometry.back().stamp += shift;
  for (RotorSample s : second.rotors) log.rotors.push_back(s), log.rotors.back().stamp += shift;
  const ReplayResult spoiled = Learn(log);
  ExpectSame(Learn(log_), spoiled, 2.0);  // the same truth, twice the flight
  EXPECT_GT(spoiled.counters.airborne_s, 26.0);
}

// The thirds of a flight agree where one vehicle flies it, and say so where a rotor-speed sensor
// begins to read a tenth too low.
TEST_F(WholeFlight, TheThirdsTellWhatChangedInBetween) {
  const DynamicModel model(vehicle_, vehicle_.effects);
  const auto findings = [&](const FlightLog& log) {
    Estimator estimator(&model, OfflineOptions(), true);
    const ReplayResult replay = Replay(log, &estimator);
    return LastLookFindings(model, replay.last->values, estimator.CompareThirds());
  };
  EXPECT_EQ(TrustOf(findings(log_)), Trust::kGood);
  FlightLog log = log_;
  for (size_t i = 2 * log.rotors.size() / 3; i < log.rotors.size(); ++i)
    log.rotors[i].speed *= 0.93;
  const std::vector<Finding> found = findings(log);
  EXPECT_EQ(TrustOf(found), Trust::kDoubtful);
  ASSERT_FALSE(found.empty());
  EXPECT_EQ(found.front().check, "last_look");
  EXPECT_NE(found.front().what.find("thrust.k_f"), std::string::npos);
}

}  // namespace
}  // namespace test
}  // namespace odmc
