#include <gtest/gtest.h>

#include <cmath>

#include "odmc/model/vehicle_units.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

/// A vehicle of another size: lengths by `size`, masses by its third power.
Vehicle Sized(double size) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.mass_kg *= std::pow(size, 3);
  vehicle.inertia_kg_m2 *= std::pow(size, 5);
  for (Rotor& rotor : vehicle.rotors) {
    rotor.p_BP *= size;
    rotor.radius_m *= size;
  }
  return vehicle;
}

void ScaleArms(double factor, Vehicle* vehicle) {
  for (Rotor& rotor : vehicle->rotors) rotor.p_BP *= factor;
}

TEST(VehicleUnits, VehiclesOfAnySizeAreRight) {
  for (const double size : {0.3, 0.5, 1.0, 2.0, 4.0}) {
    const UnitError slip = FindUnitError(Sized(size));
    EXPECT_FALSE(slip.Refutes()) << size << ": " << slip.Sentence();
    EXPECT_GT(slip.file_share, 0.9) << size << ": " << slip.Sentence();
  }
}

TEST(VehicleUnits, GuessesWithinAFactorOfTwoAreNoSlip) {
  for (const double factor : {0.5, 2.0}) {
    Vehicle vehicle = test::NominalVehicle();
    vehicle.inertia_kg_m2 *= factor;
    EXPECT_FALSE(FindUnitError(vehicle).Refutes()) << factor;
    vehicle = test::NominalVehicle();
    vehicle.mass_kg *= factor;
    EXPECT_FALSE(FindUnitError(vehicle).Refutes()) << factor;
  }
}

TEST(VehicleUnits, NamesTheSlip) {
  const auto named = [](const Vehicle& vehicle, const std::string& text) {
    const UnitError slip = FindUnitError(vehicle);
    EXPECT_TRUE(slip.Refutes()) << slip.Sentence();
    EXPECT_GT(slip.best_share, 0.8) << slip.Sentence();
    EXPECT_NE(slip.Sentence().find(text), std::string::npos) << slip.Sentence();
  };
  for (const double size : {0.4, 1.0, 3.0}) {
    Vehicle vehicle = Sized(size);
    ScaleArms(1e3, &vehicle);
    named(vehicle, "rotor positions (position_m) are in mm");
    vehicle = Sized(size);
    ScaleArms(10.0, &vehicle);
    named(vehicle, "10 times too large");
    vehicle = Sized(size);
    vehicle.inertia_kg_m2 *= 1e7;
    named(vehicle, "g cm^2");
    vehicle = Sized(size);
    vehicle.mass_kg *= 1e3;
    named(vehicle, "mass (mass_kg) is in g");
    vehicle = Sized(size);
    for (Rotor& rotor : vehicle.rotors) rotor.radius_m *= 39.37;
    named(vehicle, "inches");
  }
}

}  // namespace
}  // namespace odmc
