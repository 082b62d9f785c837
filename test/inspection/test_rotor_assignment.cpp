#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "odmc/inspection/rotor_assignment.h"
#include "odmc/inspection/rotor_inspection.h"
#include "odmc/math/so3.h"
#include "support/rotor_frames.h"

namespace odmc {
namespace test {
namespace {

RotorResponse ResponseTo(const FlightLog& log, const Vehicle& vehicle) {
  return MeasureRotorResponse(CutRotorBlocks(log, vehicle), vehicle);
}

/// True if the order found leads from the spoiled file's places back to the true ones.
bool Mends(const RotorAssignment& found, const Vehicle& spoiled, const Vehicle& truth) {
  for (size_t j = 0; j < truth.rotors.size(); ++j) {
    const auto place = static_cast<size_t>(found.order[j]);
    if (spoiled.rotors[place].p_BP != truth.rotors[j].p_BP) return false;
  }
  return true;
}

bool HasSpins(const RotorAssignment& found, const Vehicle& truth) {
  for (size_t j = 0; j < truth.rotors.size(); ++j) {
    if (found.spin[j] != truth.rotors[j].spin) return false;
  }
  return true;
}

std::vector<int> Identity(int n) {
  std::vector<int> order(static_cast<size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  return order;
}

TEST(RotorAssignment, NamesEveryOrderOfFour) {
  const Vehicle truth = NominalVehicle();
  const RotorResponse response = ResponseTo(Flown(truth, "octo", 20.0), truth);
  std::vector<int> order = Identity(4);
  do {
    const Vehicle spoiled = Reordered(truth, order);
    const RotorAssignment found = TestRotorAssignment(response, spoiled);
    EXPECT_TRUE(Mends(found, spoiled, truth)) << order[0] << order[1] << order[2] << order[3];
    EXPECT_TRUE(found.places.Names());
    EXPECT_EQ(found.places.Refutes(), spoiled.rotors[0].p_BP != truth.rotors[0].p_BP ||
                                          spoiled.rotors[1].p_BP != truth.rotors[1].p_BP ||
                                          spoiled.rotors[2].p_BP != truth.rotors[2].p_BP);
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST(RotorAssignment, NamesEverySpinPatternOfFour) {
  const Vehicle truth = NominalVehicle();
  const RotorResponse response = ResponseTo(Flown(truth, "aggressive", 30.0), truth);
  int refuted = 0;
  for (unsigned pattern = 0; pattern < 16; ++pattern) {
    const Vehicle spoiled = Respun(truth, pattern);
    const RotorAssignment found = TestRotorAssignment(response, spoiled);
    EXPECT_TRUE(HasSpins(found, truth)) << pattern;
    EXPECT_TRUE(found.spins.Names());
    if (found.spins.Refutes()) ++refuted;
  }
  EXPECT_EQ(refuted, 15);  // all but the right one
}

// Six and eight rotors are searched: their orders are too many to try.
TEST(RotorAssignment, NamesOrdersOfSixAndEight) {
  std::mt19937 random(5);
  for (const int n : {6, 8}) {
    const Vehicle truth = RoundVehicle(n);
    const RotorResponse response = ResponseTo(Flown(truth, "octo", 30.0), truth);
    for (int i = 0; i < 40; ++i) {
      std::vector<int> order = Identity(n);
      std::shuffle(order.begin(), order.end(), random);
      if (std::is_sorted(order.begin(), order.end())) continue;
      const Vehicle spoiled = Reordered(truth, order);
      const RotorAssignment found = TestRotorAssignment(response, spoiled);
      EXPECT_TRUE(Mends(found, spoiled, truth)) << n;
      EXPECT_TRUE(found.places.Refutes());
    }
    EXPECT_FALSE(TestRotorAssignment(response, truth).places.Doubts());
    EXPECT_FALSE(TestRotorAssignment(response, truth).spins.Doubts());
  }
}

TEST(RotorAssignment, AccusesNoRightFile) {
  for (const Vehicle& truth : {NominalVehicle(), NanoVehicle(), RoundVehicle(6)}) {
    for (const char* trajectory : {"hover", "yaw", "circle", "vertical", "aggressive"}) {
      EXPECT_TRUE(InspectRotors(Flown(truth, trajectory, 20.0), truth).findings.empty())
          << trajectory;
    }
  }
}

/// A quiet flight whose rotor speeds are read with noise of `share` of the speed in hover.
FlightLog QuietFlight(const Vehicle& truth, const char* trajectory, double share, int seed) {
  const DynamicModel model(truth, truth.effects);
  const double k_f = *truth.parameters.at("thrust.k_f").value;
  const double hover = std::sqrt(truth.mass_kg * truth.gravity_m_s2 / truth.num_rotors() / k_f);
  SimulationOptions options;
  options.trajectory = trajectory;
  options.duration_s = 40.0;
  options.log_rate_hz = 200.0;
  options.seed = seed;
  SimulationNoise noise;
  noise.feedback_rate_rad_s = 0.0;
  noise.force_N = 0.02;
  noise.position_m = 0.003;
  noise.rotor_speed_rad_s = share * hover;
  return Simulate(model, model.InitialValues(), options, noise).log;
}

// Rotor speeds move less than their readings' noise: coefficients shrink with it, and at some lag
// what is left of them looks like another order (a hexarotor in vertical flight was refused).
TEST(RotorAssignment, NoisyReadingsInGentleFlightAccuseNoRightFile) {
  const Vehicle truth = HeavyHexa();
  for (int seed = 1; seed <= 15; ++seed) {
    EXPECT_TRUE(InspectRotors(QuietFlight(truth, "vertical", 0.02, seed), truth).findings.empty())
        << seed;
  }
}

TEST(RotorAssignment, NoisyReadingsInLivelyFlightNameTheOrder) {
  const Vehicle truth = HeavyHexa();
  const FlightLog log = QuietFlight(truth, "octo", 0.01, 1);
  EXPECT_TRUE(InspectRotors(log, truth).findings.empty());
  for (const std::vector<int>& order :
       {std::vector<int>{1, 0, 2, 3, 4, 5}, {0, 1, 3, 2, 4, 5}, {3, 4, 5, 0, 1, 2}}) {
    const Vehicle spoiled = Reordered(truth, order);
    const RotorAssignment found = TestRotorAssignment(ResponseTo(log, spoiled), spoiled);
    EXPECT_TRUE(found.places.Refutes() && found.places.Names());
    EXPECT_TRUE(Mends(found, spoiled, truth)) << order[0];
  }
}

// The level of white noise is found beside the motion, and what it makes of the spectra.
TEST(RotorAssignment, FindsTheNoiseOfTheReadings) {
  const Vehicle truth = HeavyHexa();
  const FlightLog clean = QuietFlight(truth, "octo", 0.0, 1), noisy = [&] {
    FlightLog log = clean;
    std::mt19937 random(4);
    std::normal_distribution<double> noise(0.0, 10.0);
    for (RotorSample& sample : log.rotors) {
      for (int j = 0; j < 6; ++j) sample.speed[j] += noise(random);
    }
    return log;
  }();
  const RotorBlocks a = CutRotorBlocks(clean, truth), b = CutRotorBlocks(noisy, truth);
  ASSERT_EQ(a.blocks.size(), b.blocks.size());
  double added = 0.0, found = 0.0;
  for (size_t s = 0; s < a.blocks.size(); ++s) {
    added += (b.blocks[s].squared - a.blocks[s].squared).squaredNorm();
    found += b.noise.sum();
  }
  EXPECT_NEAR(found / added, 1.0, 0.2);
}

TEST(RotorAssignment, LateStampsAreNoOrder) {
  const Vehicle truth = NominalVehicle();
  for (const double late_s : {-0.1, -0.05, 0.05, 0.1}) {
    FlightLog log = Flown(truth, "octo", 20.0);
    for (RotorSample& sample : log.rotors) sample.stamp += FromSeconds(late_s);
    EXPECT_TRUE(InspectRotors(log, truth).findings.empty()) << late_s;
    const Vehicle spoiled = Reordered(truth, std::vector<int>{1, 0, 2, 3});
    const RotorAssignment found = TestRotorAssignment(ResponseTo(log, spoiled), spoiled);
    EXPECT_TRUE(found.places.Refutes() && Mends(found, spoiled, truth)) << late_s;
  }
}

// A part that rattles about roll and yaw: the controller answers on roll, and its answer goes with
// the turning about yaw as if the rotors on one side all turned one way.
TEST(RotorAssignment, DisturbancesOfTwoAxesAreNoSpins) {
  const Vehicle truth = NominalVehicle();
  const DynamicModel model(truth, truth.effects);
  SimulationOptions options;
  options.trajectory = "yaw";
  options.log_rate_hz = 200.0;
  const double torque = 0.06 * truth.mass_kg * truth.gravity_m_s2 * truth.ArmLength();
  for (const double frequency : {0.9, 1.4, 2.0}) {
    const auto rattle = [=](const FlightState& state) {
      BodyWrench wrench;
      const double size = std::sin(0.9 * state.time_s) > 0.0 ? torque : 0.2 * torque;
      const double wave = std::sin(2.0 * M_PI * frequency * state.time_s);
      wrench.tau_Bcm_B = size * wave * Eigen::Vector3d(1.0, 0.0, 1.0);
      return wrench;
    };
    const FlightLog log = Simulate(model, model.InitialValues(), options, {}, rattle).log;
    EXPECT_TRUE(InspectRotors(log, truth).findings.empty()) << frequency;
  }
}

/// Appends a vehicle in the hand: idling rotors, turned about at will.
void AppendCarried(double duration_s, FlightLog* log) {
  std::mt19937 random(7);
  std::normal_distribution<double> jerk(0.0, 40.0), idle(400.0, 15.0);
  OdometrySample pose = log->odometry.back();
  Eigen::Vector3d w = Eigen::Vector3d::Zero();
  constexpr double kStep_s = 0.005;
  for (int i = 0; i < duration_s / kStep_s; ++i) {
    pose.stamp += FromSeconds(kStep_s);
    w += kStep_s * (Eigen::Vector3d(jerk(random), jerk(random), jerk(random)) - 2.0 * w);
    pose.q_WS = pose.q_WS * Exp(kStep_s * w);
    pose.w_WS_S = w;
    log->odometry.push_back(pose);
    log->rotors.push_back({pose.stamp, RotorVector::NullaryExpr(4, [&] { return idle(random); })});
  }
}

TEST(RotorAssignment, GroundAndHandsAreNoFlight) {
  const Vehicle truth = NominalVehicle();
  FlightLog log = Flown(truth, "octo", 40.0, 3, 15.0);
  AppendCarried(20.0, &log);
  EXPECT_TRUE(InspectRotors(log, truth).findings.empty());
  const Vehicle spoiled = Reordered(truth, std::vector<int>{2, 1, 0, 3});
  const std::vector<Finding> findings = InspectRotors(log, spoiled).findings;
  ASSERT_FALSE(findings.empty());
  EXPECT_EQ(findings[0].check, "rotor_order");
  EXPECT_EQ(findings[0].leaves, Trust::kBad);
  EXPECT_NE(findings[0].what.find("3, 2, 1, 4"), std::string::npos) << findings[0].what;
}

TEST(RotorAssignment, GyroOrPosesAloneAreEnough) {
  const Vehicle truth = NominalVehicle();
  FlightLog poses = Flown(truth, "aggressive", 30.0), gyro = poses;
  for (size_t i = 0; i < poses.odometry.size(); ++i) {
    gyro.imu.push_back({gyro.odometry[i].stamp, gyro.odometry[i].w_WS_S, std::nullopt});
    gyro.odometry[i].w_WS_S.reset();
    gyro.odometry[i].q_WS.setIdentity();  // not looked at
    poses.odometry[i].w_WS_S.reset();
  }
  const Vehicle spoiled = Reordered(truth, std::vector<int>{0, 1, 3, 2});
  for (const FlightLog& log : {poses, gyro}) {
    const RotorAssignment found = TestRotorAssignment(ResponseTo(log, spoiled), spoiled);
    EXPECT_TRUE(found.places.Refutes() && Mends(found, spoiled, truth));
    EXPECT_TRUE(InspectRotors(log, truth).findings.empty());
  }
}

TEST(RotorAssignment, FlightsThatShowNothingAreNotTested) {
  const Vehicle truth = NominalVehicle();
  FlightLog log = Flown(truth, "hover", 20.0);
  FlightLog rms = log, slow = log, brief = log;
  rms.rotor_rms_only = true;
  brief.odometry.resize(300);
  slow.rotors.clear();
  for (size_t i = 0; i < log.rotors.size(); i += 20) slow.rotors.push_back(log.rotors[i]);
  const Vehicle spoiled = Reordered(truth, std::vector<int>{3, 2, 1, 0});
  for (const FlightLog& none : {rms, slow, brief, FlightLog()}) {
    EXPECT_FALSE(TestRotorAssignment(ResponseTo(none, spoiled), spoiled).tested);
    EXPECT_TRUE(InspectRotors(none, spoiled).findings.empty());
  }
}

TEST(RotorAssignment, ATurnedBodyFrameIsNamedBesideTheOrder) {
  const Vehicle truth = RoundVehicle(4);
  const FlightLog log = Flown(truth, "octo", 20.0);
  // Each rotor where the next one is: as if the frame were turned by 90 degrees.
  const std::vector<Finding> findings =
      InspectRotors(log, Reordered(truth, std::vector<int>{1, 2, 3, 0})).findings;
  ASSERT_FALSE(findings.empty());
  EXPECT_NE(findings[0].mend.find("turned by 90 degrees"), std::string::npos) << findings[0].mend;
  const std::vector<Finding> swapped =
      InspectRotors(log, Reordered(truth, std::vector<int>{1, 0, 2, 3})).findings;
  ASSERT_FALSE(swapped.empty());
  EXPECT_EQ(swapped[0].mend.find("turned"), std::string::npos) << swapped[0].mend;
}

// Wrong spins are one thing, an order that takes the spins along is another.
TEST(RotorAssignment, SpinsAreNamedOnTheirOwn) {
  const Vehicle truth = NominalVehicle();
  const FlightLog log = Flown(truth, "aggressive", 30.0);
  const std::vector<Finding> spins = InspectRotors(log, Respun(truth, 0b1010)).findings;
  ASSERT_EQ(spins.size(), 1u);
  EXPECT_EQ(spins[0].check, "rotor_spin");
  EXPECT_NE(spins[0].what.find("cw, ccw, cw, ccw"), std::string::npos) << spins[0].what;
  const std::vector<Finding> order =
      InspectRotors(log, Reordered(truth, std::vector<int>{1, 0, 2, 3})).findings;
  ASSERT_EQ(order.size(), 1u);
  EXPECT_EQ(order[0].check, "rotor_order");
}

}  // namespace
}  // namespace test
}  // namespace odmc
