#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "odmc/inspection/vehicle_fit.h"
#include "odmc/model/frame_layout.h"
#include "support/rotor_frames.h"

namespace odmc {
namespace test {
namespace {

std::vector<int> Identity(int n) {
  std::vector<int> order(static_cast<size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  return order;
}

/// The vehicle as somebody would guess it who knows its mass and the frame's name.
Vehicle Guessed(const Vehicle& truth, const std::string& frame) {
  Vehicle guess = truth;
  const double half_m = 0.8 * truth.ArmLength() / std::sqrt(2.0);
  guess.rotors = RotorsAt(FrameLayout(frame, Autopilot::kPx4), half_m, half_m, 0.05);
  guess.inertia_kg_m2 = 1.4 * Eigen::Vector3d(1.0, 1.0, 1.7) * truth.inertia_kg_m2.x();
  guess.parameters.clear();
  guess.odometry = SensorMount();
  return guess;
}

/// A vehicle at a frame's places with inertia and coefficients of the nominal one.
Vehicle OfFrame(const std::string& frame, double arm_m) {
  const std::vector<FramePlace> places = FrameLayout(frame, Autopilot::kPx4);
  Vehicle vehicle = RoundVehicle(static_cast<int>(places.size()));
  for (size_t j = 0; j < places.size(); ++j) {
    vehicle.rotors[j] = {arm_m * places[j].direction, places[j].spin, 0.0635};
  }
  vehicle.odometry = SensorMount();
  return vehicle;
}

/// The log with its columns in another order: column j is the old column order[j].
FlightLog WithColumns(FlightLog log, const std::vector<int>& order) {
  for (RotorSample& sample : log.rotors) {
    const RotorVector speed = sample.speed;
    for (size_t j = 0; j < order.size(); ++j) {
      sample.speed[static_cast<Eigen::Index>(j)] = speed[order[j]];
    }
  }
  return log;
}

/// True if each column is told to be at the nominal place nearest to where its rotor is.
bool IsRightOrder(const VehicleFit& fit, const Vehicle& nominal,
                  const std::vector<Rotor>& columns) {
  for (size_t j = 0; j < columns.size(); ++j) {
    const Eigen::Vector2d at = columns[j].p_BP.head<2>().normalized();
    const Rotor& told = nominal.rotors[static_cast<size_t>(fit.order[j])];
    if (told.p_BP.head<2>().normalized().dot(at) < 0.9) return false;
  }
  return true;
}

TEST(VehicleFit, FindsEveryOrderOfAQuad) {
  const Vehicle truth = OfFrame("quad_x", 0.13);
  const FlightLog log = Flown(truth, "aggressive", 20.0);
  const Vehicle nominal = Guessed(truth, "quad_x");
  std::vector<int> order = Identity(4);
  do {
    const VehicleFit fit = FitVehicle(WithColumns(log, order), nominal);
    ASSERT_TRUE(fit.rotors_tested);
    EXPECT_EQ(fit.order, order);
    EXPECT_TRUE(fit.order_choice.is_told);
    EXPECT_GT(fit.order_choice.lead_nats, 5.0);
    EXPECT_TRUE(fit.spin_choice.is_told);
    EXPECT_TRUE(fit.spins_are_usual);
    for (size_t j = 0; j < 4; ++j) {
      EXPECT_EQ(fit.spin[j], truth.rotors[static_cast<size_t>(order[j])].spin);
    }
  } while (std::next_permutation(order.begin(), order.end()));
}

// Propellers "out": the mirror image of the drawing is found, too.
TEST(VehicleFit, FindsMirroredSpins) {
  Vehicle truth = OfFrame("quad_x", 0.13);
  const Vehicle nominal = Guessed(truth, "quad_x");
  for (Rotor& rotor : truth.rotors) rotor.spin = -rotor.spin;
  const VehicleFit fit = FitVehicle(Flown(truth, "aggressive", 20.0), nominal);
  ASSERT_TRUE(fit.rotors_tested);
  EXPECT_TRUE(fit.spin_choice.is_told);
  for (size_t j = 0; j < 4; ++j) EXPECT_EQ(fit.spin[j], truth.rotors[j].spin);
}

TEST(VehicleFit, FindsOrderAndSpinsOfMoreRotors) {
  std::mt19937 random(11);
  for (const char* frame : {"hexa_x", "hexa_plus", "octo_x", "y6"}) {
    const Vehicle truth = OfFrame(frame, 0.2);
    const FlightLog log = Flown(truth, "aggressive", 30.0);
    const Vehicle nominal = Guessed(truth, frame);
    for (int i = 0; i < 4; ++i) {
      std::vector<int> order = Identity(truth.num_rotors());
      std::shuffle(order.begin(), order.end(), random);
      const VehicleFit fit = FitVehicle(WithColumns(log, order), nominal);
      ASSERT_TRUE(fit.rotors_tested) << frame;
      std::vector<Rotor> columns;
      for (const int j : order) columns.push_back(truth.rotors[static_cast<size_t>(j)]);
      EXPECT_TRUE(IsRightOrder(fit, nominal, columns)) << frame;
      EXPECT_GT(fit.order_choice.probability, 0.9) << frame;
      for (size_t j = 0; j < columns.size(); ++j) EXPECT_EQ(fit.spin[j], columns[j].spin) << frame;
      // Coaxial ones included: the upper is the one that turns as the drawing's.
      EXPECT_EQ(fit.order, order) << frame;
    }
  }
}

TEST(VehicleFit, FindsThrustAndInertia) {
  for (const Vehicle& truth : {OfFrame("quad_x", 0.13), NanoVehicle()}) {
    Vehicle nominal = Guessed(truth, "quad_x");
    nominal.rotors =
        RotorsAt(FrameLayout("quad_x", Autopilot::kPx4), truth.rotors[0].p_BP.cwiseAbs().x(),
                 truth.rotors[0].p_BP.cwiseAbs().y(), 0.05);
    const VehicleFit fit = FitVehicle(Flown(truth, "aggressive", 20.0), nominal);
    ASSERT_TRUE(fit.balance && fit.inertia_x && fit.inertia_y);
    EXPECT_NEAR(
        fit.balance->k_f_over_mass * truth.mass_kg / *truth.parameters.at("thrust.k_f").value, 1.0,
        0.02);
    EXPECT_NEAR(fit.inertia_x->value_kg_m2 / truth.inertia_kg_m2.x(), 1.0, 0.1);
    EXPECT_NEAR(fit.inertia_y->value_kg_m2 / truth.inertia_kg_m2.y(), 1.0, 0.1);
  }
}

// The guess of the inertia that the regression is scaled with cancels.
TEST(VehicleFit, InertiaDoesNotDependOnItsGuess) {
  const Vehicle truth = OfFrame("quad_x", 0.13);
  const FlightLog log = Flown(truth, "aggressive", 20.0);
  Vehicle small = Guessed(truth, "quad_x"), large = small;
  small.inertia_kg_m2 *= 0.6;
  large.inertia_kg_m2 *= 1.6;
  const VehicleFit a = FitVehicle(log, small), b = FitVehicle(log, large);
  ASSERT_TRUE(a.inertia_x && b.inertia_x);
  EXPECT_NEAR(a.inertia_x->value_kg_m2 / b.inertia_x->value_kg_m2, 1.0, 0.03);
}

TEST(VehicleFit, TellsPlusFromX) {
  for (const auto& [flown, other] :
       {std::pair("quad_x", "quad_plus"), std::pair("quad_plus", "quad_x")}) {
    const Vehicle truth = OfFrame(flown, 0.13);
    const FlightLog log = Flown(truth, "aggressive", 20.0);
    for (const FrameFit& frame : FitVehicle(log, Guessed(truth, flown)).other_frames) {
      if (frame.frame == other) {
        EXPECT_LT(frame.nats, -5.0) << flown;
      }
    }
    for (const FrameFit& frame : FitVehicle(log, Guessed(truth, other)).other_frames) {
      if (frame.frame == flown) {
        EXPECT_GT(frame.nats, 7.0) << flown;
      }
    }
  }
}

TEST(VehicleFit, ALeaningPoseIsFoundAndTakenOut) {
  const Vehicle truth = OfFrame("quad_x", 0.13);
  FlightLog log = Flown(truth, "octo", 30.0);
  const Eigen::Quaterniond q_BS(Eigen::AngleAxisd(0.16, Eigen::Vector3d::UnitY()));
  for (OdometrySample& pose : log.odometry) {
    pose.q_WS = pose.q_WS * q_BS;
    pose.w_WS_S.reset();
  }
  const VehicleFit fit = FitVehicle(log, Guessed(truth, "quad_x"));
  EXPECT_TRUE(fit.leans);
  ASSERT_TRUE(fit.balance);
  EXPECT_NEAR(fit.balance->lean_rad, 0.16, 0.015);
  EXPECT_TRUE(fit.order_choice.is_told);
  EXPECT_EQ(fit.order, Identity(4));
  EXPECT_FALSE(FitVehicle(Flown(truth, "octo", 30.0), Guessed(truth, "quad_x")).leans);
}

// What a flight does not show is not claimed: hovering tells no spins, a second tells nothing.
TEST(VehicleFit, SaysWhatTheFlightDoesNotTell) {
  const Vehicle truth = OfFrame("quad_x", 0.13);
  const Vehicle nominal = Guessed(truth, "quad_x");
  FlightLog brief = Flown(truth, "hover", 20.0), slow = brief;
  brief.odometry.resize(300);
  EXPECT_FALSE(FitVehicle(brief, nominal).rotors_tested);
  EXPECT_FALSE(FitVehicle(brief, nominal).balance);
  slow.rotors.clear();
  const FlightLog whole = Flown(truth, "hover", 20.0);
  for (size_t i = 0; i < whole.rotors.size(); i += 20) slow.rotors.push_back(whole.rotors[i]);
  EXPECT_FALSE(FitVehicle(slow, nominal).rotors_tested);
  EXPECT_FALSE(FitVehicle(FlightLog(), nominal).rotors_tested);
  SimulationNoise rough;
  rough.rotor_speed_rad_s = 60.0;
  const DynamicModel model(truth, truth.effects);
  SimulationOptions options;
  options.trajectory = "hover";
  options.duration_s = 12.0;
  options.log_rate_hz = 100.0;
  const VehicleFit fit =
      FitVehicle(Simulate(model, model.InitialValues(), options, rough).log, nominal);
  ASSERT_TRUE(fit.rotors_tested);
  EXPECT_FALSE(fit.spin_choice.is_told);
  EXPECT_LT(fit.spin_choice.probability, 0.99);
}

}  // namespace
}  // namespace test
}  // namespace odmc
