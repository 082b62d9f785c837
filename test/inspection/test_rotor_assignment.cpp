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
