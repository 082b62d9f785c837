#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "odmc/phases/phase_detector.h"

namespace odmc {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

/// Feeds a detector keyframes at 100 Hz of a vehicle that hovers, stands or is carried.
class PhaseDetectorTest : public testing::Test {
 protected:
  /// What the vehicle does for a while.
  struct Doing {
    double thrust = 1.0;                 // over the weight
    Vector3d missing = {0.0, 0.0, 0.0};  // over the weight, in B
    double speed = 0.0;                  // forward [m/s]
    double wobble = 0.01;                // of the attitude [rad]
    Quaterniond q = Quaterniond::Identity();
    bool has_rotor_speeds = true;
  };

  static Doing Hover() { return Doing(); }
  static Doing Stand(double thrust) { return {thrust, {0.0, 0.0, 1.0 - thrust}, 0.0, 0.0}; }
  static Doing Carried(double thrust, double speed) {
    return {thrust, {0.1, 0.0, 1.0 - thrust}, speed, 0.05};
  }

  /// @returns the verdict that said something, or the last one
  PhaseVerdict Do(const Doing& doing, double duration_s) {
    PhaseVerdict told;
    for (int i = 0; i < static_cast<int>(std::lround(100.0 * duration_s)); ++i) {
      const PhaseVerdict verdict = detector_.Update(Evidence(doing));
      if (verdict.take_back || verdict.start_anew || verdict.has_changed) told = verdict;
      told.phase = verdict.phase;
    }
    return told;
  }

  PhaseEvidence Evidence(const Doing& doing) {
    time_s_ += 0.01;
    p_ += 0.01 * Vector3d(doing.speed, 0.0, 0.0);
    PhaseEvidence e;
    e.stamp = FromSeconds(time_s_);
    e.dt = 0.01;
    e.p_WS = p_ + Noise(0.001);
    const double tilt = doing.wobble * std::sin(5.0 * time_s_);
    e.q_WS = doing.q * AngleAxisd(tilt + 0.0005 * gaussian_(engine_), Vector3d::UnitX());
    e.speed_m_s = doing.speed;
    e.rate_rad_s = 5.0 * doing.wobble;
    e.has_force = doing.has_rotor_speeds;
    e.missing_force = doing.missing + Noise(0.05);
    e.felt_force = Vector3d(0.0, 0.0, doing.thrust) + e.missing_force;
    e.thrust_ratio = doing.thrust;
    e.thrust_sigma = detector_.knows_thrust() ? 0.01 : 0.3;
    e.velocity_noise_m_s = 0.01;
    e.attitude_noise_rad = 0.0005;
    e.position_noise_m = 0.001;
    return e;
  }

  Vector3d Noise(double sigma) {
    return sigma * Vector3d(gaussian_(engine_), gaussian_(engine_), gaussian_(engine_));
  }

  /// In the air, the thrust coefficient known.
  void Fly(double duration_s = 3.0) {
    Doing flying = Hover();
    flying.speed = 1.0;
    Do(flying, duration_s);
    detector_.KnowThrust();
  }

  PhaseDetector detector_{PhaseOptions()};
  std::mt19937 engine_{3};
  std::normal_distribution<double> gaussian_;
  double time_s_ = 10.0;
  Vector3d p_ = {0.0, 0.0, 1.0};
};

TEST_F(PhaseDetectorTest, StandsWhereTheRecordingStartsWithoutThrust) {
  EXPECT_EQ(Do(Stand(0.0), 1.0).phase, FlightPhase::kOff);
  EXPECT_EQ(Do(Stand(0.1), 1.0).phase, FlightPhase::kIdling);
  EXPECT_EQ(Do(Stand(0.35), 1.0).phase, FlightPhase::kOnGround);
  EXPECT_FALSE(detector_.has_flown());
}

TEST_F(PhaseDetectorTest, FliesWhereTheRecordingStartsInTheAir) {
  Doing flying = Hover();
  flying.speed = 3.0;
  const PhaseVerdict verdict = Do(flying, 1.0);
  EXPECT_EQ(verdict.phase, FlightPhase::kFlying);
  EXPECT_FALSE(verdict.start_anew);
  EXPECT_TRUE(detector_.has_flown());
}

TEST_F(PhaseDetectorTest, AThrowWithoutThrustIsFlight) {
  Doing thrown{0.0, {0.0, 0.0, 0.0}, 3.0, 0.3};
  EXPECT_EQ(Do(thrown, 0.5).phase, FlightPhase::kFalling);
}

// Whatever thrust a stand at the start has, it is known for one once the vehicle flies.
TEST_F(PhaseDetectorTest, AStandUnderThrustBeforeTheFlightTeachesNothing) {
  for (const double thrust : {0.45, 0.6, 0.8, 0.9}) {
    detector_ = PhaseDetector(PhaseOptions());
    Do(Stand(thrust), 4.0);
    Doing flying = Hover();
    flying.speed = 1.0;
    const PhaseVerdict verdict = Do(flying, 2.0);
    EXPECT_TRUE(verdict.start_anew) << thrust;
    ASSERT_EQ(detector_.spans().size(), 2u) << thrust;
    EXPECT_EQ(detector_.spans()[0].phase, FlightPhase::kOnGround);
    EXPECT_NEAR(ToSeconds(detector_.spans()[0].to - detector_.spans()[0].from), 4.0, 0.2);
    EXPECT_EQ(verdict.phase, FlightPhase::kFlying);
  }
}

TEST_F(PhaseDetectorTest, HoverBeforeTheFlightTeaches) {
  Do(Hover(), 0.8);
  Doing flying = Hover();
  flying.speed = 1.0;
  EXPECT_FALSE(Do(flying, 2.0).start_anew);
  EXPECT_EQ(detector_.spans().size(), 1u);
}

TEST_F(PhaseDetectorTest, ThrustThatGrowsWhileNothingMovesIsNoFlight) {
  Do(Stand(0.6), 1.0);
  EXPECT_TRUE(Do(Stand(0.75), 1.0).start_anew);
  EXPECT_EQ(detector_.phase(), FlightPhase::kOnGround);
}

TEST_F(PhaseDetectorTest, TakesBackWhatALandingTaught) {
  for (const double thrust : {0.0, 0.3, 0.5, 0.8, 0.9}) {
    detector_ = PhaseDetector(PhaseOptions());
    Fly();
    const double landed_s = time_s_;
    const PhaseVerdict verdict = Do(Stand(thrust), 2.0);
    ASSERT_TRUE(verdict.take_back) << thrust;
    // Of a tenth of the weight, the first half second may pass for the model's error.
    const double late_s = thrust > 0.85 ? 0.5 : 0.0;
    EXPECT_LE(ToSeconds(*verdict.take_back), landed_s + late_s + 1e-6) << thrust;
    EXPECT_GT(ToSeconds(*verdict.take_back), landed_s - 0.35) << thrust;
    EXPECT_FALSE(Teaches(verdict.phase)) << thrust;
  }
}

TEST_F(PhaseDetectorTest, SeesItWithinAThirdOfASecond) {
  Fly();
  EXPECT_TRUE(Do(Stand(0.5), 0.4).take_back);
}

// Telemetry that fails for a moment in a hover too still to be told from a stand.
TEST_F(PhaseDetectorTest, FliesOnceRotorSpeedsAreBackAndCarry) {
  PhaseOptions options;
  options.near_ground_m = 0.3;
  detector_ = PhaseDetector(options);
  Fly();
  Doing still = Hover();
  still.wobble = 0.0;
  still.has_rotor_speeds = false;
  EXPECT_FALSE(Teaches(Do(still, 2.0).phase));
  still.has_rotor_speeds = true;
  EXPECT_EQ(Do(still, 1.0).phase, FlightPhase::kFlying);
  EXPECT_FALSE(detector_.IsNearGround(1.0)) << "there was no ground";
}

TEST_F(PhaseDetectorTest, StandsOnceRotorSpeedsAreBackAndIdle) {
  Fly();
  Doing still = Stand(0.0);
  still.wobble = 0.0;
  still.has_rotor_speeds = false;
  Do(still, 2.0);
  for (const double thrust : {0.0, 0.2, 0.6, 0.9, 1.0}) {
    Doing stand = Stand(thrust);
    stand.wobble = 0.0;
    EXPECT_FALSE(Teaches(Do(stand, 1.0).phase)) << thrust;
  }
}

TEST_F(PhaseDetectorTest, TakesOffAgain) {
  Fly();
  Do(Stand(0.5), 2.0);
  Doing flying = Hover();
  flying.speed = 0.5;
  EXPECT_EQ(Do(flying, 0.8).phase, FlightPhase::kFlying);
  EXPECT_EQ(NotInFlight(detector_.spans()).size(), 1u);
}

TEST(NotInFlight, BeginsBeforeALandingIsSeen) {
  const auto span = [](FlightPhase phase, double from_s, double to_s) {
    PhaseSpan s;
    s.phase = phase;
    s.from = FromSeconds(from_s);
    s.to = FromSeconds(to_s);
    return s;
  };
  using P = FlightPhase;
  const StampSpans spans = NotInFlight(
      {span(P::kOff, 0.0, 2.0), span(P::kLiftingOff, 2.0, 3.0), span(P::kFlying, 3.0, 20.0),
       span(P::kInContact, 20.0, 21.0), span(P::kFlying, 21.0, 30.0),
       span(P::kTouchingDown, 30.0, 30.5), span(P::kIdling, 30.5, 31.0),
       span(P::kFlying, 31.0, 31.1), span(P::kTouchingDown, 31.1, 32.0)});
  ASSERT_EQ(spans.size(), 4u);
  EXPECT_EQ(spans[0], std::make_pair(FromSeconds(0.0), FromSeconds(3.0)));
  EXPECT_EQ(spans[1], std::make_pair(FromSeconds(20.0), FromSeconds(21.0)));
  EXPECT_EQ(spans[2], std::make_pair(FromSeconds(29.7), FromSeconds(31.0)));
  EXPECT_EQ(spans[3], std::make_pair(FromSeconds(31.0), FromSeconds(32.0)));  // no further than it
}

TEST_F(PhaseDetectorTest, CarriedByHandIsNoFlight) {
  Fly();
  Do(Stand(0.05), 1.0);
  EXPECT_EQ(Do(Carried(0.05, 1.0), 3.0).phase, FlightPhase::kInHand);
  EXPECT_EQ(Do(Carried(0.0, 0.5), 3.0).phase, FlightPhase::kInHand);
}

TEST_F(PhaseDetectorTest, LyingOnItsBackIsSaidSo) {
  Fly();
  Doing upside = Stand(0.3);
  upside.q = AngleAxisd(M_PI, Vector3d::UnitX());
  upside.missing = {0.0, 0.0, -1.3};
  EXPECT_EQ(Do(upside, 2.0).phase, FlightPhase::kUpsideDown);
}

TEST_F(PhaseDetectorTest, AForceThatGoesOnInFreeFlightIsAnotherVehicle) {
  Fly();
  Doing loaded = Hover();
  loaded.thrust = 1.3;
  loaded.missing = {0.0, 0.0, -0.3};
  loaded.speed = 0.5;
  const PhaseVerdict verdict = Do(loaded, 4.0);
  EXPECT_TRUE(verdict.has_changed);
  EXPECT_TRUE(Teaches(verdict.phase));
  EXPECT_FALSE(detector_.knows_thrust());
}

// A hop, a take-off that tips over: nothing else would ever end what is taken for flight.
TEST_F(PhaseDetectorTest, AStandEndsAFlightTooShortToKnowTheThrust) {
  Do(Stand(0.0), 1.0);
  Doing hop = Hover();
  hop.speed = 1.0;
  ASSERT_TRUE(Teaches(Do(hop, 0.8).phase));
  const PhaseVerdict verdict = Do(Stand(0.1), 10.0);
  EXPECT_TRUE(verdict.start_anew);
  EXPECT_FALSE(Teaches(verdict.phase));
  EXPECT_TRUE(Teaches(Do(hop, 2.0).phase));
}

TEST_F(PhaseDetectorTest, AStandAfterAChangeTakesBackWhatItTaught) {
  Fly();
  detector_.ForgetThrust();
  Doing flying = Hover();
  flying.speed = 0.5;
  Do(flying, 0.5);
  const double touched_s = time_s_;
  const PhaseVerdict verdict = Do(Stand(0.1), 2.0);
  EXPECT_FALSE(verdict.start_anew);
  ASSERT_TRUE(verdict.take_back);
  EXPECT_NEAR(ToSeconds(*verdict.take_back), touched_s, 0.3);
  EXPECT_FALSE(Teaches(verdict.phase));
}

TEST_F(PhaseDetectorTest, ATouchWithoutThrustIsNoChangeOfTheVehicle) {
  detector_ = PhaseDetector(PhaseOptions(), true);
  Fly();
  Doing touching = Carried(0.3, 0.5);
  touching.missing = {0.0, 0.0, 0.3};
  const PhaseVerdict verdict = Do(touching, 1.0);
  EXPECT_FALSE(verdict.has_changed);
  EXPECT_TRUE(verdict.take_back);
}

TEST_F(PhaseDetectorTest, AStandAfterARestartTakesNothingFromBeforeIt) {
  Fly();
  detector_.Restart();
  time_s_ -= 60.0;
  const double from_s = time_s_;
  const PhaseVerdict verdict = Do(Stand(0.0), 1.0);
  EXPECT_FALSE(verdict.start_anew);
  ASSERT_TRUE(verdict.take_back);
  EXPECT_NEAR(ToSeconds(*verdict.take_back), from_s, 0.02);
  EXPECT_TRUE(detector_.knows_thrust());
}

// Gaussian errors of the size the model allows for never raise the alarm in two hours.
TEST_F(PhaseDetectorTest, ErrorsOfTheModelAreNoContact) {
  Fly();
  Doing flying = Hover();
  flying.speed = 2.0;
  for (int i = 0; i < 24000; ++i) {  // new every 0.3 s
    flying.missing = Noise(0.08);
    const PhaseVerdict verdict = Do(flying, 0.3);
    ASSERT_FALSE(verdict.take_back) << time_s_;
  }
  EXPECT_EQ(detector_.spans().size(), 1u);
}

TEST_F(PhaseDetectorTest, IsNearTheGroundItStoodOn) {
  PhaseOptions options;
  options.near_ground_m = 0.3;
  detector_ = PhaseDetector(options);
  EXPECT_FALSE(detector_.IsNearGround(1.0));  // never stood
  Do(Stand(0.0), 1.0);
  EXPECT_TRUE(detector_.IsNearGround(1.2));
  EXPECT_FALSE(detector_.IsNearGround(1.4));
}

TEST_F(PhaseDetectorTest, BelowTheStandIsFlightToo) {
  Do(Stand(0.0), 1.0);
  EXPECT_FALSE(detector_.IsNearGround(0.5));
}

}  // namespace
}  // namespace odmc
