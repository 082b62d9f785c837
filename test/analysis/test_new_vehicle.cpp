#include <gtest/gtest.h>

#include <cmath>

#include "odmc/analysis/flight_inspection.h"
#include "odmc/analysis/new_vehicle.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/error_text.h"
#include "support/rotor_frames.h"

namespace odmc {
namespace test {
namespace {

KnownVehicle Quad(double mass_kg) {
  KnownVehicle known;
  known.name = "quad";
  known.mass_kg = mass_kg;
  return known;
}

/// The nominal vehicle's sensors at its origin; rotors front right cw, front left ccw, ...: the
/// mirror image of the autopilots' drawing.
Vehicle Truth() {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.odometry = SensorMount();
  return vehicle;
}

NewVehicle MadeOf(const KnownVehicle& known, const FlightLog& log) {
  const VehicleFit fit = FitVehicle(log, VehicleBeforeFlight(known));
  return MakeVehicle(known, &fit, "flight.csv");
}

bool Starts(const std::string& text, const std::string& with) { return text.rfind(with, 0) == 0; }
bool Has(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// Everything that is guessed follows the formulas that are written beside it.
TEST(NewVehicle, GuessesFollowTheirFormulas) {
  const NewVehicle made = MakeVehicle(Quad(0.512), nullptr, "");
  const Vehicle& v = made.vehicle;
  EXPECT_NEAR(v.ArmLength(), 0.13 * 0.8, 1e-4);
  EXPECT_NEAR(v.rotors[0].radius_m, 0.8 * v.ArmLength() / std::sqrt(2.0), 1e-4);
  EXPECT_NEAR(v.inertia_kg_m2.x() / (0.22 * 0.512 * v.ArmLength() * v.ArmLength()), 1.0, 1e-3);
  EXPECT_NEAR(v.inertia_kg_m2.z() / (0.85 * 2.0 * v.inertia_kg_m2.x()), 1.0, 1e-3);
  const double k_f = *v.parameters.at("thrust.k_f").value;
  const double hover = std::sqrt(0.512 * 9.81 / 4.0 / k_f);
  EXPECT_NEAR(hover * v.rotors[0].radius_m, 60.0, 0.1);
  EXPECT_NEAR(*v.parameters.at("rotor_torque.k_m").value / (0.2 * v.rotors[0].radius_m * k_f), 1.0,
              1e-3);
  for (const char* key : {"inertia_kg_m2", "odometry", "thrust.k_f", "rotor_torque.k_m"}) {
    EXPECT_TRUE(Starts(made.comments.key.at(key), "guessed: ")) << key;
  }
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "order guessed: "));
  EXPECT_TRUE(Starts(made.comments.key.at("mass_kg"), "asked: "));
}

// Seven vehicles of the package and the data sets lie within what the header says of the formulas.
TEST(NewVehicle, GuessesFitThePackagesVehicles) {
  for (const char* name : {"imrc_cf21_brushless", "imrc_cf21_brushed", "neurobem",
                           "blackbird_clover", "polyu_quad13", "generic"}) {
    const Vehicle real =
        LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/" + name + ".yaml");
    const Vehicle guess = VehicleBeforeFlight(Quad(real.mass_kg));
    EXPECT_NEAR(guess.ArmLength() / real.ArmLength(), 1.0, 0.25) << name;
    for (int i = 0; i < 3; ++i) {
      const double ratio = guess.inertia_kg_m2[i] / real.inertia_kg_m2[i];
      EXPECT_TRUE(ratio > 0.5 && ratio < 2.0) << name << " axis " << i << ": " << ratio;
    }
  }
}

TEST(NewVehicle, AFlightGivesOrderSpinsAndThrust) {
  const Vehicle truth = Truth();
  const NewVehicle made = MadeOf(Quad(truth.mass_kg), Flown(truth, "aggressive", 20.0));
  const std::string text = VehicleText(made.vehicle, made.comments);
  const Vehicle read = ParseVehicle(text, "made.yaml");
  ASSERT_EQ(read.num_rotors(), 4);
  for (size_t j = 0; j < 4; ++j) {
    const Eigen::Vector3d &is = read.rotors[j].p_BP, &was = truth.rotors[j].p_BP;
    EXPECT_GT(is.x() * was.x(), 0.0) << j;
    EXPECT_GT(is.y() * was.y(), 0.0) << j;
    EXPECT_EQ(read.rotors[j].spin, truth.rotors[j].spin) << j;
  }
  EXPECT_NEAR(*read.parameters.at("thrust.k_f").value / *truth.parameters.at("thrust.k_f").value,
              1.0, 0.02);
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "order found: "));
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "Spins found: "));
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "not as the autopilot's drawing"));
  EXPECT_TRUE(Starts(made.comments.key.at("thrust.k_f"), "found: "));
  EXPECT_TRUE(made.advice.empty());
  EXPECT_EQ(made.comments.rotor[0], "front right, motor 1");
  // With its own file, nothing is wrong with the flight.
  const FlightInspection inspection = InspectFlight(Flown(truth, "aggressive", 20.0), read);
  EXPECT_EQ(inspection.inspection.refusal, "");
  for (const Finding& finding : inspection.inspection.findings) {
    EXPECT_NE(finding.check, "rotor_order");
    EXPECT_NE(finding.check, "rotor_spin");
    EXPECT_NE(finding.check, "weight");
  }
}

// The inertia's place between guess and motion: both count, by their sigmas.
TEST(NewVehicle, InertiaLiesBetweenGuessAndMotion) {
  const Vehicle truth = Truth();
  KnownVehicle known = Quad(truth.mass_kg);
  known.half_m = Eigen::Vector2d(0.095, 0.11);
  const FlightLog log = Flown(truth, "aggressive", 20.0);
  const VehicleFit fit = FitVehicle(log, VehicleBeforeFlight(known));
  ASSERT_TRUE(fit.inertia_x.has_value());
  const double guess = VehicleBeforeFlight(known).inertia_kg_m2.x();
  const double is = MakeVehicle(known, &fit, "f").vehicle.inertia_kg_m2.x();
  EXPECT_NEAR(is / std::sqrt(guess * fit.inertia_x->value_kg_m2), 1.0, 1e-3);
}

TEST(NewVehicle, WhatIsAskedForStays) {
  const Vehicle truth = Truth();
  KnownVehicle known = Quad(truth.mass_kg);
  known.arm_m = 0.2;
  known.radius_m = 0.1;
  known.inertia_kg_m2 = Eigen::Vector3d(0.01, 0.011, 0.02);
  known.places = {2, 1, 4, 3};
  known.spins = {1.0, 1.0, -1.0, -1.0};
  const NewVehicle made = MadeOf(known, Flown(truth, "aggressive", 20.0));
  EXPECT_NEAR(made.vehicle.ArmLength(), 0.2, 1e-4);
  EXPECT_EQ(made.vehicle.rotors[0].radius_m, 0.1);
  EXPECT_EQ(made.vehicle.inertia_kg_m2, *known.inertia_kg_m2);
  EXPECT_LT(made.vehicle.rotors[0].p_BP.x(), 0.0);  // motor 2 of PX4's quad_x: rear left
  EXPECT_GT(made.vehicle.rotors[0].p_BP.y(), 0.0);
  for (size_t j = 0; j < 4; ++j) EXPECT_EQ(made.vehicle.rotors[j].spin, known.spins[j]);
  EXPECT_TRUE(Starts(made.comments.key.at("inertia_kg_m2"), "asked: "));
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "order asked: "));
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "Spins asked: "));
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "Places asked: "));
  ASSERT_FALSE(made.advice.empty());  // the flight contradicts the order
  EXPECT_TRUE(Has(made.advice[0], "the flight says that readings are those of motors"));
}

TEST(NewVehicle, TheAutopilotsNumbersStandWhereNothingIsKnown) {
  KnownVehicle known = Quad(0.5);
  known.autopilot = Autopilot::kBetaflight;
  known.autopilot_asked = true;
  const VehicleFit nothing;
  const NewVehicle made = MakeVehicle(known, &nothing, "f");
  EXPECT_EQ(made.comments.rotor[0], "rear right, motor 1");
  EXPECT_EQ(made.vehicle.rotors[0].spin, 1.0);
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "order asked: "));
  ASSERT_EQ(made.advice.size(), 2u);
  EXPECT_TRUE(Has(made.advice[0], "order and spins"));
  EXPECT_TRUE(Has(made.advice[1], "k_f"));
}

// Orders that the flight leaves open: the autopilot's where it is possible, else the likeliest.
TEST(NewVehicle, OpenOrdersAreGuessedAndSaid) {
  KnownVehicle known = Quad(0.5);
  VehicleFit fit;
  fit.rotors_tested = true;
  fit.order = {1, 0, 2, 3};
  fit.spin = {-1.0, -1.0, 1.0, 1.0};
  fit.order_choice = {false, 0.6, 1.0};
  fit.nominal_order_probability = 0.2;
  NewVehicle made = MakeVehicle(known, &fit, "f");
  EXPECT_EQ(made.order, (std::vector<int>{0, 1, 2, 3}));
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "order guessed: "));
  EXPECT_TRUE(Has(made.advice[0], "fly brisk rolls and pitches"));
  fit.nominal_order_probability = 0.01;
  made = MakeVehicle(known, &fit, "f");
  EXPECT_EQ(made.order, fit.order);
  EXPECT_TRUE(Has(made.comments.key.at("rotors"), "order guessed: "));
}

TEST(NewVehicle, ALeaningPoseGetsAMount) {
  const Vehicle truth = Truth();
  FlightLog log = Flown(truth, "octo", 30.0);
  const Eigen::Quaterniond q_BS(Eigen::AngleAxisd(0.16, Eigen::Vector3d::UnitY()));
  for (OdometrySample& pose : log.odometry) {
    pose.q_WS = pose.q_WS * q_BS;
    pose.w_WS_S.reset();
  }
  const NewVehicle made = MadeOf(Quad(truth.mass_kg), log);
  EXPECT_LT(made.vehicle.odometry.q_BS.angularDistance(q_BS), 0.02);
  EXPECT_TRUE(made.vehicle.odometry.estimate);
  EXPECT_TRUE(Starts(made.comments.key.at("odometry"), "found: the pose's frame leans"));
}

TEST(NewVehicle, ADrawingKeepsItsGeometry) {
  KnownVehicle known = Quad(1.5);
  known.drawing = Truth();
  const NewVehicle made = MakeVehicle(known, nullptr, "");
  EXPECT_EQ(made.vehicle.mass_kg, 1.5);
  EXPECT_EQ(made.vehicle.rotors[1].p_BP, Truth().rotors[1].p_BP);
  EXPECT_NEAR(made.vehicle.inertia_kg_m2.x(), 2.0 * Truth().inertia_kg_m2.x(), 1e-9);
  EXPECT_TRUE(Starts(made.comments.key.at("inertia_kg_m2"), "asked: "));
  EXPECT_NO_THROW(ParseVehicle(VehicleText(made.vehicle, made.comments), "a.yaml"));
}

TEST(NewVehicle, NonsenseIsRefused) {
  KnownVehicle known = Quad(1.0);
  known.places = {1, 1, 2, 3};
  ODMC_EXPECT_ERROR(VehicleBeforeFlight(known), "each motor from 1 to 4 once");
  known.places = {1, 2, 3};
  ODMC_EXPECT_ERROR(VehicleBeforeFlight(known), "3 entries, the vehicle 4 rotors");
  known.places.clear();
  known.spins = {1.0};
  ODMC_EXPECT_ERROR(VehicleBeforeFlight(known), "list of spins has 1 entries");
  known.spins.clear();
  known.inertia_kg_m2 = Eigen::Vector3d(1e-3, 1e-3, 1.0);
  ODMC_EXPECT_ERROR(VehicleBeforeFlight(known), "inertia");
}

// ---- inspect without a vehicle -----------------------------------------------------------------

TEST(InspectFlightAlone, SaysWhichRotorsWouldFit) {
  const Vehicle truth = Truth();
  FlightLog log = Flown(truth, "aggressive", 20.0);
  log.file = "flight.csv";
  const FlightInspection inspection = InspectFlightAlone(log, 4);
  ASSERT_TRUE(inspection.rotors.has_value());
  const RotorGuess& rotors = *inspection.rotors;
  EXPECT_EQ(rotors.frame, "quad_x");
  EXPECT_EQ(rotors.places,
            (std::vector<std::string>{"front right", "front left", "rear left", "rear right"}));
  EXPECT_EQ(rotors.spins, (std::vector<std::string>{"cw", "ccw", "cw", "ccw"}));
  EXPECT_TRUE(rotors.places_told);
  EXPECT_TRUE(rotors.spins_told);
  const double hover =
      std::sqrt(truth.mass_kg * 9.81 / 4.0 / *truth.parameters.at("thrust.k_f").value);
  EXPECT_NEAR(rotors.hover_speed_rad_s.value_or(0.0), hover, 0.02 * hover);
  EXPECT_TRUE(inspection.inspection.findings.empty()) << InspectionText(inspection);
  ASSERT_TRUE(inspection.flown.has_value());
  EXPECT_FALSE(inspection.phases.empty());
  const std::string text = InspectionText(inspection), report = InspectionReport(inspection);
  EXPECT_TRUE(Has(text, "no vehicle file")) << text;
  EXPECT_TRUE(Has(text, "places: front right, front left, rear left, rear right (found")) << text;
  EXPECT_TRUE(Has(text, "thrust.k_f               shown\n")) << text;
  EXPECT_TRUE(Has(report, "\"places_told\": true")) << report;
  EXPECT_FALSE(Has(report, "prior_sigma")) << report;  // values scale with a mass nobody knows
}

TEST(InspectFlightAlone, TellsAPlusFrame) {
  Vehicle truth = Truth();
  const std::vector<FramePlace> places = FrameLayout("quad_plus", Autopilot::kPx4);
  for (size_t j = 0; j < 4; ++j)
    truth.rotors[j] = {0.13 * places[j].direction, places[j].spin, 0.0635};
  const FlightInspection inspection = InspectFlightAlone(Flown(truth, "aggressive", 20.0), 4);
  ASSERT_TRUE(inspection.rotors.has_value());
  EXPECT_EQ(inspection.rotors->frame, "quad_plus");
  EXPECT_EQ(inspection.rotors->places,
            (std::vector<std::string>{"right", "left", "front", "rear"}));
}

// A recording that is wrong is wrong without a vehicle file, too.
TEST(InspectFlightAlone, NamesWhatIsWrongWithTheRecording) {
  FlightLog log = Flown(Truth(), "octo", 20.0);
  for (OdometrySample& pose : log.odometry) pose.q_WS = pose.q_WS.conjugate();
  const FlightInspection inspection = InspectFlightAlone(log, 4);
  EXPECT_TRUE(Has(inspection.inspection.refusal, "conjugated")) << InspectionText(inspection);
  ODMC_EXPECT_ERROR(InspectFlightAlone(log, 5), "no frame of 5 rotors");
}

}  // namespace
}  // namespace test
}  // namespace odmc
