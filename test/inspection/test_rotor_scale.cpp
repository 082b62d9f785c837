#include <gtest/gtest.h>

#include "odmc/inspection/rotor_inspection.h"
#include "odmc/inspection/rotor_scale.h"
#include "support/rotor_frames.h"

namespace odmc {
namespace test {
namespace {

FlightLog Scaled(FlightLog log, int rotor, double factor) {
  for (RotorSample& sample : log.rotors) sample.speed[rotor] *= factor;
  return log;
}

RotorScale ScaleOf(const FlightLog& log, const Vehicle& vehicle) {
  return FindRotorScale(MeasureRotorResponse(CutRotorBlocks(log, vehicle), vehicle), vehicle);
}

TEST(RotorScale, NamesTheRotorAndItsFactor) {
  const Vehicle vehicle = NominalVehicle();
  const FlightLog log = Flown(vehicle, "octo", 30.0);
  for (int rotor = 0; rotor < 4; ++rotor) {
    for (const double factor : {0.5, 0.8, 0.87, 1.15, 1.25}) {
      const RotorScale found = ScaleOf(Scaled(log, rotor, factor), vehicle);
      EXPECT_EQ(found.rotor, rotor) << factor;
      EXPECT_FALSE(found.or_rotor) << factor;
      EXPECT_GT(found.significance, 3.5) << factor;
      EXPECT_NEAR(found.factor, factor, 3.0 * found.sigma + 0.01) << rotor;
      EXPECT_LT(found.sigma, 0.05);
    }
  }
}

// One reading 15 % high makes the sum of squares 8 % too large, and k_f as much too small.
TEST(RotorScale, SaysWhatItDoesToTheThrustCoefficient) {
  const Vehicle vehicle = NominalVehicle();
  const FlightLog log = Scaled(Flown(vehicle, "octo", 30.0), 2, 1.15);
  const RotorScale found = ScaleOf(log, vehicle);
  EXPECT_NEAR(found.k_f_shift, 4.0 / (3.0 + 1.15 * 1.15) - 1.0, 0.02);
  const std::vector<Finding> findings = InspectRotors(log, vehicle).findings;
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].check, "rotor_scale");
  EXPECT_EQ(findings[0].leaves, Trust::kDoubtful);
  EXPECT_EQ(findings[0].what.rfind("rotor3 reads", 0), 0u) << findings[0].what;
  EXPECT_NE(findings[0].what.find("too high"), std::string::npos) << findings[0].what;
}

TEST(RotorScale, CentreOfGravityAndWindAreNoScale) {
  Vehicle vehicle = NominalVehicle();
  vehicle.effects.push_back("wind");
  const DynamicModel model(vehicle, vehicle.effects);
  ModelValues truth = model.InitialValues();
  truth[model.IndexOf("centre_of_gravity.x")] = 0.006;
  truth[model.IndexOf("centre_of_gravity.y")] = -0.005;
  truth[model.IndexOf("wind.w_x")] = 2.0;
  for (const char* trajectory : {"hover", "yaw", "octo", "circle"}) {
    SimulationOptions options;
    options.trajectory = trajectory;
    options.log_rate_hz = 200.0;
    const FlightLog log = Simulate(model, truth, options).log;
    EXPECT_TRUE(InspectRotors(log, NominalVehicle()).findings.empty()) << trajectory;
  }
}

TEST(RotorScale, ADeadSensorIsNamed) {
  const Vehicle vehicle = NominalVehicle();
  const FlightLog log = Scaled(Flown(vehicle, "octo", 20.0), 1, 0.0);
  const std::vector<Finding> findings = InspectRotors(log, vehicle).findings;
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].leaves, Trust::kBad);
  EXPECT_EQ(findings[0].what.rfind("rotor2 reads almost zero", 0), 0u) << findings[0].what;
}

}  // namespace
}  // namespace test
}  // namespace odmc
