#include <gtest/gtest.h>

#include <filesystem>

#include "odmc/io/vehicle_writer.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

void ExpectSame(const Vehicle& a, const Vehicle& b) {
  EXPECT_EQ(a.name, b.name);
  EXPECT_EQ(a.mass_kg, b.mass_kg);
  EXPECT_EQ(a.gravity_m_s2, b.gravity_m_s2);
  EXPECT_LT((a.inertia_kg_m2 - b.inertia_kg_m2).norm(), 1e-5 * a.inertia_kg_m2.norm());
  ASSERT_EQ(a.rotors.size(), b.rotors.size());
  for (size_t j = 0; j < a.rotors.size(); ++j) {
    EXPECT_LT((a.rotors[j].p_BP - b.rotors[j].p_BP).norm(), 1e-6);
    EXPECT_EQ(a.rotors[j].spin, b.rotors[j].spin);
    EXPECT_NEAR(a.rotors[j].radius_m, b.rotors[j].radius_m, 1e-7);
  }
  EXPECT_EQ(a.effects, b.effects);
  EXPECT_EQ(a.odometry.estimate, b.odometry.estimate);
  EXPECT_LT((a.odometry.p_BS - b.odometry.p_BS).norm(), 1e-6);
  EXPECT_LT(a.odometry.q_BS.angularDistance(b.odometry.q_BS), 1e-5);
  EXPECT_EQ(a.imu.has_value(), b.imu.has_value());
  ASSERT_EQ(a.parameters.size(), b.parameters.size());
  for (const auto& [name, setting] : a.parameters) {
    const ParameterSetting& other = b.parameters.at(name);
    EXPECT_EQ(setting.value.has_value(), other.value.has_value()) << name;
    if (setting.value && other.value) {
      EXPECT_NEAR(*setting.value / *other.value, 1.0, 1e-5) << name;
    }
    EXPECT_EQ(setting.sigma.has_value(), other.sigma.has_value()) << name;
    EXPECT_EQ(setting.estimated, other.estimated) << name;
  }
}

// What is written is what was meant, for every vehicle of the package.
TEST(VehicleWriter, ReadsBackAsWritten) {
  int files = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(std::string(ODMC_SOURCE_DIR) + "/config/vehicles")) {
    const Vehicle vehicle = LoadVehicle(entry.path().string());
    const Vehicle again = ParseVehicle(VehicleText(vehicle), "again.yaml");
    ExpectSame(vehicle, again);
    ++files;
  }
  EXPECT_GT(files, 5);
}

TEST(VehicleWriter, KeepsMountsAndPriors) {
  Vehicle vehicle = NominalVehicle();
  vehicle.imu = SensorMount();
  vehicle.imu->p_BS = {0.01, -0.02, 0.03};
  vehicle.odometry.q_BS = Eigen::Quaterniond(0.98, 0.1, -0.15, 0.05).normalized();
  vehicle.odometry.estimate = true;
  vehicle.effects.push_back("odometry_extrinsics");
  vehicle.parameters["thrust.k_f"].sigma = 3.0e-7;
  vehicle.parameters["rotor_torque.k_m"].estimated = false;
  const Vehicle again = ParseVehicle(VehicleText(vehicle), "again.yaml");
  ExpectSame(vehicle, again);
  EXPECT_LT((again.imu->p_BS - vehicle.imu->p_BS).norm(), 1e-9);
}

// YAML 1.1 (PyYAML, rosparam) takes 1e-06 for text.
TEST(VehicleWriter, NumbersHavePoints) {
  Vehicle vehicle = NominalVehicle();
  vehicle.parameters["thrust.k_f"].value = 1e-6;
  const std::string text = VehicleText(vehicle);
  EXPECT_NE(text.find("value: 1.0e-06"), std::string::npos) << text;
}

TEST(VehicleWriter, CommentsStandBesideTheirEntries) {
  VehicleComments comments;
  comments.head = {"First.", "Second."};
  comments.key["mass_kg"] = "asked: weigh it";
  comments.key["thrust.k_f"] = std::string(300, 'x') + " " + std::string(60, 'y');
  comments.rotor = {"front right", "front left", "rear left", "rear right"};
  const std::string text = VehicleText(NominalVehicle(), comments);
  EXPECT_EQ(text.rfind("# First.\n#\n# Second.\n\nname: ", 0), 0u) << text;
  EXPECT_NE(text.find("# asked: weigh it\nmass_kg: 0.75\n"), std::string::npos) << text;
  EXPECT_NE(text.find("}  # front left\n"), std::string::npos) << text;
  EXPECT_NE(text.find("\n  # " + std::string(60, 'y') + "\n  thrust.k_f: {"), std::string::npos)
      << text;
  ExpectSame(NominalVehicle(), ParseVehicle(text, "a.yaml"));
}

// A name from a file name may have anything in it.
TEST(VehicleWriter, HostileNamesStayNames) {
  Vehicle vehicle = NominalVehicle();
  VehicleComments comments;
  comments.head = {"from a\nmass_kg: 7"};
  for (const char* name : {"a: b # c", "\"quoted\"", "back\\slash", "- list", "null"}) {
    vehicle.name = name;
    const Vehicle again = ParseVehicle(VehicleText(vehicle, comments), "a.yaml");
    EXPECT_EQ(again.name, name);
    EXPECT_EQ(again.mass_kg, vehicle.mass_kg);
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
