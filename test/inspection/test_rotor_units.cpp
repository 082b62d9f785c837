#include <gtest/gtest.h>

#include <cmath>

#include "odmc/inspection/rotor_units.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr double kRpm = 30.0 / M_PI;

double FileThrust(const Vehicle& vehicle) { return *vehicle.parameters.at("thrust.k_f").value; }

/// A vehicle file whose k_f is as large as its propellers make it, known to 20 %.
Vehicle Known() {
  Vehicle vehicle = test::NominalVehicle();
  const double k_f = 0.1 * std::pow(vehicle.rotors.front().radius_m, 4);
  vehicle.parameters["thrust.k_f"].value = k_f;
  vehicle.parameters["thrust.k_f"].sigma = 0.2 * k_f;
  return vehicle;
}

TEST(RotorUnits, RadiansPerSecondAreRightWhereTheThrustFitsTheFile) {
  const Vehicle vehicle = Known();
  for (const double off : {0.6, 0.8, 1.0, 1.25, 1.6}) {
    EXPECT_FALSE(FindRotorUnit(off * FileThrust(vehicle), vehicle).Refutes()) << off;
  }
}

TEST(RotorUnits, AWrongThrustCoefficientIsNoUnit) {
  for (const double off : {1.0 / 3.0, 3.0}) {
    Vehicle vehicle = Known();
    const double k_f = FileThrust(vehicle);
    vehicle.parameters["thrust.k_f"].value = off * k_f;
    vehicle.parameters["thrust.k_f"].sigma = 0.2 * off * k_f;
    EXPECT_FALSE(FindRotorUnit(k_f, vehicle).Refutes()) << off;
  }
}

TEST(RotorUnits, NamesTheUnit) {
  const Vehicle vehicle = Known();
  const auto named = [&](double factor, const std::string& name) {
    const RotorUnit unit = FindRotorUnit(FileThrust(vehicle) / (factor * factor), vehicle);
    EXPECT_TRUE(unit.Refutes()) << name;
    EXPECT_EQ(unit.best.substr(0, name.size()), name);
  };
  named(kRpm, "rpm");
  named(1e-3 * kRpm, "krpm");
  named(0.5 / M_PI, "turns per second");
  named(7.0 * kRpm, "erpm of 7 pole pairs (14 poles)");
  named(2.0 * kRpm, "erpm of 2 pole pairs");
}

TEST(RotorUnits, PropellersTellWhereTheFilesThrustCoefficientIsNonsense) {
  Vehicle vehicle = Known();
  const double k_f = FileThrust(vehicle);
  vehicle.parameters["thrust.k_f"].value = k_f / 91.19;  // in N/rpm^2
  vehicle.parameters["thrust.k_f"].sigma = 0.2 * k_f / 91.19;
  EXPECT_FALSE(FindRotorUnit(k_f, vehicle).Refutes());
}

TEST(RotorUnits, NothingIsSaidWithoutAThrustCoefficient) {
  Vehicle vehicle = Known();
  const double k_f = FileThrust(vehicle);
  vehicle.parameters.erase("thrust.k_f");
  EXPECT_FALSE(FindRotorUnit(k_f / (kRpm * kRpm), vehicle).Refutes());
}

TEST(RotorUnits, FindingSaysWhatToWrite) {
  const Vehicle vehicle = Known();
  const auto finding = RotorUnitFinding(FileThrust(vehicle) / (kRpm * kRpm), vehicle);
  ASSERT_TRUE(finding);
  EXPECT_EQ(finding->leaves, Trust::kBad);
  EXPECT_NE(finding->mend.find("9.549"), std::string::npos) << finding->mend;
  EXPECT_FALSE(RotorUnitFinding(FileThrust(vehicle), vehicle));
}

TEST(RotorUnits, NothingIsSaidWithoutThrust) {
  EXPECT_FALSE(FindRotorUnit(0.0, Known()).Refutes());
  EXPECT_FALSE(FindRotorUnit(std::nan(""), Known()).Refutes());
}

}  // namespace
}  // namespace odmc
