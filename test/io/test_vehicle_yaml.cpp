#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <regex>

#include "odmc/io/vehicle_yaml.h"
#include "odmc/model/dynamic_model.h"
#include "support/error_text.h"

namespace odmc {
namespace {

const char kRotors[] =
    "rotors:\n"
    "  - {position_m: [0.09, 0.09, 0.0], spin: cw, radius_m: 0.0635}\n"
    "  - {position_m: [0.09, -0.09, 0.0], spin: ccw, radius_m: 0.0635}\n"
    "  - {position_m: [-0.09, -0.09, 0.0], spin: cw, radius_m: 0.0635}\n"
    "  - {position_m: [-0.09, 0.09, 0.0], spin: ccw, radius_m: 0.0635}\n";
const char kMass[] = "mass_kg: 0.75\n";
const char kInertia[] = "inertia_kg_m2: [0.0025, 0.0021, 0.0043]\n";

Vehicle Parse(const std::string& text) { return ParseVehicle(text, "quad.yaml"); }

/// A sound vehicle with more lines.
Vehicle With(const std::string& lines) {
  return Parse(std::string(kMass) + kInertia + kRotors + lines);
}

Vehicle WithThrust(const std::string& value) {
  return With("parameters: {thrust.k_f: {value: " + value + "}}\n");
}

std::string RotorsWith(const std::string& rotor) {
  std::string rotors = kRotors;
  return rotors.substr(0, rotors.rfind("  - ")) + "  - " + rotor + "\n";
}

Vehicle WithLastRotor(const std::string& rotor) {
  return Parse(std::string(kMass) + kInertia + RotorsWith(rotor));
}

TEST(VehicleYaml, MinimalFileGetsTheDefaults) {
  const Vehicle vehicle = With("");
  EXPECT_EQ(vehicle.name, "quad");
  EXPECT_EQ(vehicle.mass_kg, 0.75);
  EXPECT_EQ(vehicle.gravity_m_s2, 9.81);
  EXPECT_EQ(vehicle.inertia_kg_m2, Eigen::Vector3d(0.0025, 0.0021, 0.0043));
  ASSERT_EQ(vehicle.num_rotors(), 4);
  EXPECT_EQ(vehicle.rotors[1].p_BP, Eigen::Vector3d(0.09, -0.09, 0.0));
  EXPECT_EQ(vehicle.rotors[0].spin, 1.0);
  EXPECT_EQ(vehicle.rotors[1].spin, -1.0);
  EXPECT_FALSE(vehicle.odometry.estimate);
  EXPECT_FALSE(vehicle.imu.has_value());
  const std::vector<std::string> effects = {"thrust",         "rotor_torque", "drag",
                                            "viscous_torque", "hvt",          "centre_of_gravity",
                                            "inertia",        "gravity"};
  EXPECT_EQ(vehicle.effects, effects);
}

TEST(VehicleYaml, EverySettingArrives) {
  const Vehicle vehicle = With(
      "name: mine\n"
      "gravity_m_s2: 9.79\n"
      "odometry: {frame: sensor, p_BS_m: [0.1, 0.0, 0.02], q_BS_xyzw: [0, 0, 0.6, 0.8],\n"
      "           estimate: true}\n"
      "imu: {frame: sensor, p_BS_m: [0.0, 0.01, 0.0]}\n"
      "effects: [thrust, drag]\n"
      "parameters:\n"
      "  thrust.k_f: {value: 1.5e-06, sigma: 3.0e-07, state: frozen}\n"
      "  drag.d_x: {sigma: 0.1}\n");
  EXPECT_EQ(vehicle.name, "mine");
  EXPECT_EQ(vehicle.gravity_m_s2, 9.79);
  EXPECT_TRUE(vehicle.odometry.estimate);
  EXPECT_EQ(vehicle.odometry.p_BS, Eigen::Vector3d(0.1, 0.0, 0.02));
  EXPECT_NEAR(vehicle.odometry.q_BS.z(), 0.6, 1e-15);
  ASSERT_TRUE(vehicle.imu.has_value());
  EXPECT_EQ(vehicle.imu->p_BS.y(), 0.01);
  const std::vector<std::string> effects = {"thrust", "drag", "odometry_extrinsics"};
  EXPECT_EQ(vehicle.effects, effects);
  const ParameterSetting& k_f = vehicle.parameters.at("thrust.k_f");
  EXPECT_EQ(k_f.value, 1.5e-6);
  EXPECT_EQ(k_f.sigma, 3e-7);
  EXPECT_EQ(k_f.estimated, false);
  EXPECT_FALSE(vehicle.parameters.at("drag.d_x").value.has_value());
}

// rosparam and PyYAML load the first four as text and write them back in quotes.
TEST(VehicleYaml, NumbersThatYaml11TakesForTextAreNumbers) {
  EXPECT_EQ(WithThrust("1e-6").parameters.at("thrust.k_f").value, 1e-6);
  EXPECT_EQ(WithThrust("5e-06").parameters.at("thrust.k_f").value, 5e-6);
  EXPECT_EQ(WithThrust("'1e-6'").parameters.at("thrust.k_f").value, 1e-6);
  EXPECT_EQ(WithThrust("\"5e-06\"").parameters.at("thrust.k_f").value, 5e-6);
  EXPECT_EQ(WithThrust("1.0e-6").parameters.at("thrust.k_f").value, 1e-6);
  EXPECT_EQ(With("gravity_m_s2: 0.981e1\n").gravity_m_s2, 9.81);
  EXPECT_EQ(With("gravity_m_s2: +9.81\n").gravity_m_s2, 9.81);
  ODMC_EXPECT_ERROR(WithThrust("1.0e6"), "quad.yaml: parameters.thrust.k_f.value: 1e+06 is impl");
}

TEST(VehicleYaml, UnknownKeysNameTheLikelyOne) {
  ODMC_EXPECT_ERROR(Parse(std::string("mass_g: 750\n") + kInertia + kRotors),
                    "quad.yaml: mass_g: unknown key 'mass_g'; did you mean mass_kg?");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_g_cm2: [1, 2, 3]\n" + kRotors),
                    "unknown key 'inertia_g_cm2'; did you mean inertia_kg_m2?");
  ODMC_EXPECT_ERROR(With("paramters: {}\n"), "did you mean parameters?");
  ODMC_EXPECT_ERROR(With("wheels: 4\n"), "unknown key 'wheels'; known are: name, mass_kg");
  ODMC_EXPECT_ERROR(WithLastRotor("{position_mm: [90, 90, 0], spin: cw, radius_m: 0.06}"),
                    "rotors[3].position_mm: unknown key 'position_mm'; did you mean position_m?");
}

TEST(VehicleYaml, MissingKeysAreNamed) {
  ODMC_EXPECT_ERROR(Parse(std::string(kInertia) + kRotors), "quad.yaml: mass_kg: is missing");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + kRotors), "quad.yaml: inertia_kg_m2: is missing");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + kInertia), "quad.yaml: rotors: is missing");
  ODMC_EXPECT_ERROR(WithLastRotor("{position_m: [-0.09, 0.09, 0], radius_m: 0.06}"),
                    "quad.yaml: rotors[3].spin: is missing");
}

TEST(VehicleYaml, WrongTypesAreNamed) {
  ODMC_EXPECT_ERROR(Parse(std::string("mass_kg: heavy\n") + kInertia + kRotors),
                    "quad.yaml: mass_kg: must be a number, not 'heavy'");
  ODMC_EXPECT_ERROR(Parse(std::string("mass_kg: 0.75 kg\n") + kInertia + kRotors),
                    "must be a number, not '0.75 kg'");
  ODMC_EXPECT_ERROR(Parse(std::string("mass_kg:\n") + kInertia + kRotors), "mass_kg: has no value");
  ODMC_EXPECT_ERROR(Parse(std::string("mass_kg: [1]\n") + kInertia + kRotors),
                    "mass_kg: must be a number, not a list");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_kg_m2: 0.01\n" + kRotors),
                    "inertia_kg_m2: must be a list");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_kg_m2: [1, 2]\n" + kRotors),
                    "inertia_kg_m2: must be three numbers");
  ODMC_EXPECT_ERROR(WithLastRotor("{position_m: [-0.09, 0.09, 0], spin: left, radius_m: 0.06}"),
                    "rotors[3].spin: must be one of cw, ccw, not 'left'");
  ODMC_EXPECT_ERROR(With("odometry: {frame: sensor, estimate: perhaps}\n"),
                    "odometry.estimate: must be true or false");
  ODMC_EXPECT_ERROR(With("parameters: {thrust.k_f: 1.0e-06}\n"), "thrust.k_f: must be a map");
  ODMC_EXPECT_ERROR(Parse("- 1\n- 2\n"), "quad.yaml: must hold keys");
  ODMC_EXPECT_ERROR(Parse(""), "quad.yaml: is empty");
  ODMC_EXPECT_ERROR(Parse("mass_kg: [1, 2\n"), "quad.yaml: line ");
}

TEST(VehicleYaml, NumbersMustBeFiniteAndPositive) {
  for (const char* mass : {"0", "-1.0"}) {
    ODMC_EXPECT_ERROR(Parse(std::string("mass_kg: ") + mass + "\n" + kInertia + kRotors),
                      "quad.yaml: mass_kg: must be positive");
  }
  for (const char* mass : {".nan", "nan", ".inf", "-.inf", "1e400"}) {
    ODMC_EXPECT_ERROR(Parse(std::string("mass_kg: ") + mass + "\n" + kInertia + kRotors),
                      "quad.yaml: mass_kg: must be a finite number");
  }
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_kg_m2: [0.01, 0.0, 0.01]\n" + kRotors),
                    "inertia_kg_m2: must be three positive");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_kg_m2: [0.01, .nan, 0.01]\n" + kRotors),
                    "inertia_kg_m2[1]: must be a finite");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_kg_m2: [0.001, 0.001, 0.005]\n" + kRotors),
                    "triangle");
  ODMC_EXPECT_ERROR(WithThrust("-1.0e-06"), "parameters.thrust.k_f.value: must be positive");
  ODMC_EXPECT_ERROR(With("parameters: {drag.d_x: {value: .nan}}\n"),
                    "parameters.drag.d_x.value: must be a finite number");
  ODMC_EXPECT_ERROR(With("parameters: {drag.d_x: {sigma: 0.0}}\n"), "drag.d_x.sigma: must be posi");
}

TEST(VehicleYaml, ImplausibleSizesSuggestUnits) {
  ODMC_EXPECT_ERROR(Parse(std::string("mass_kg: 750\n") + kInertia + kRotors),
                    "mass_kg: 750 is implausible; is it in kilograms?");
  ODMC_EXPECT_ERROR(Parse(std::string("mass_kg: 0.00075\n") + kInertia + kRotors), "kilograms");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_kg_m2: [25, 21, 43]\n" + kRotors),
                    "inertia_kg_m2: is implausible");
  ODMC_EXPECT_ERROR(WithLastRotor("{position_m: [-90, 90, 0], spin: cw, radius_m: 0.06}"),
                    "rotors[3].position_m: 127.2");
  ODMC_EXPECT_ERROR(WithLastRotor("{position_m: [-0.0001, 0, 0], spin: cw, radius_m: 0.06}"),
                    "less than 1 mm");
  ODMC_EXPECT_ERROR(WithLastRotor("{position_m: [-0.09, 0.09, 0], spin: cw, radius_m: 63.5}"),
                    "radius_m: 63.5 is implausible; is it in metres?");
  ODMC_EXPECT_ERROR(WithThrust("0.5"), "thrust.k_f.value: 0.5 is implausible");
  ODMC_EXPECT_ERROR(WithThrust("1.6e-08"), "N/rpm^2 times 91.19");  // 1.5e-6 in N/rpm²
}

TEST(VehicleYaml, DuplicatesAreRefused) {
  ODMC_EXPECT_ERROR(WithLastRotor("{position_m: [0.09, 0.09, 0.0], spin: cw, radius_m: 0.06}"),
                    "rotors[3].position_m: is the same as that of rotors[0]");
  ODMC_EXPECT_ERROR(With("mass_kg: 0.8\n"), "quad.yaml: mass_kg: this key is given twice");
  ODMC_EXPECT_ERROR(With("parameters:\n  drag.d_x: {value: 0.0, value: 0.1}\n"),
                    "parameters.drag.d_x.value: this key is given twice");
  ODMC_EXPECT_ERROR(With("effects: [thrust, drag, thrust]\n"),
                    "effects[2]: effect 'thrust' is listed twice");
}

TEST(VehicleYaml, UnknownEffectsAndParametersAreRefused) {
  ODMC_EXPECT_ERROR(With("effects: [thrust, darg]\n"),
                    "effects[1]: unknown effect 'darg'; did you mean drag?");
  ODMC_EXPECT_ERROR(With("effects: []\n"), "effects: must list at least one");
  ODMC_EXPECT_ERROR(With("parameters: {thrust.kf: {value: 1.0e-06}}\n"),
                    "unknown key 'thrust.kf'; did you mean thrust.k_f?");
  ODMC_EXPECT_ERROR(With("parameters: {thrust.k_f: {state: free}}\n"),
                    "thrust.k_f.state: must be one of estimated, frozen, not 'free'");
}

TEST(VehicleYaml, BodyFrameFixesTheMount) {
  EXPECT_EQ(With("odometry: {frame: body, estimate: false}\n").odometry.p_BS.norm(), 0.0);
  EXPECT_EQ(With("odometry: {frame: body, p_BS_sigma_m: 0.002}\n").odometry.p_BS_sigma_m, 0.002);
  ODMC_EXPECT_ERROR(With("odometry: {frame: body, p_BS_sigma_m: 2}\n"), "is it in metres");
  ODMC_EXPECT_ERROR(With("imu: {frame: body, q_BS_sigma_rad: 10}\n"), "is it in radians");
  ODMC_EXPECT_ERROR(With("odometry: {frame: body, p_BS_m: [0, 0, 0.1]}\n"),
                    "odometry.p_BS_m: needs frame: sensor");
  ODMC_EXPECT_ERROR(With("imu: {frame: body, q_BS_xyzw: [0, 0, 0, 1]}\n"),
                    "imu.q_BS_xyzw: needs frame: sensor");
  ODMC_EXPECT_ERROR(With("odometry: {frame: body, estimate: true}\n"),
                    "odometry.estimate: true needs frame: sensor");
  ODMC_EXPECT_ERROR(With("parameters: {odometry_extrinsics.px: {state: estimated}}\n"),
                    "odometry_extrinsics.px.state: estimated needs odometry");
  ODMC_EXPECT_ERROR(With("odometry: {frame: sensor, q_BS_xyzw: [0, 0, 0, 2]}\n"),
                    "odometry.q_BS_xyzw: has norm 2");
}

TEST(VehicleYaml, ActuatorMustBeARegularFile) {
  ODMC_EXPECT_ERROR(With("actuator: /dev/zero\n"), "actuator: /dev/zero: is no regular file");
  ODMC_EXPECT_ERROR(With("actuator: /tmp\n"), "actuator: /tmp: is a folder");
}

TEST(VehicleYaml, SettingsThatNoVehicleHasAreRefused) {
  ODMC_EXPECT_ERROR(WithThrust("1.0e+300"), "parameters.thrust.k_f.value: 1e+300 is implausible");
  ODMC_EXPECT_ERROR(With("parameters: {drag.d_x: {value: 1.0e+300}}\n"),
                    "parameters.drag.d_x.value: 1e+300 N s/m is implausible");
  ODMC_EXPECT_ERROR(With("parameters: {drag.d_x: {sigma: 1.0e-300}}\n"),
                    "parameters.drag.d_x.sigma: 1e-300 N s/m is implausible");
  ODMC_EXPECT_ERROR(Parse(std::string(kMass) + "inertia_kg_m2: [2.5, 2.1, 4.3]\n" + kRotors),
                    "inertia_kg_m2 is implausible");
}

TEST(VehicleYaml, MissingFileIsNamed) {
  ODMC_EXPECT_ERROR(LoadVehicle("/no/such.yaml"), "/no/such.yaml: cannot be opened");
}

std::vector<std::string> ShippedVehicles() {
  std::vector<std::string> files;
  const std::string folder = std::string(ODMC_SOURCE_DIR) + "/config/vehicles";
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    files.push_back(entry.path().string());
  }
  std::sort(files.begin(), files.end());
  return files;
}

TEST(VehicleYaml, EveryShippedVehicleLoadsAndMakesAModel) {
  const std::vector<std::string> files = ShippedVehicles();
  EXPECT_GE(files.size(), 10u);
  for (const std::string& file : files) {
    SCOPED_TRACE(file);
    const Vehicle vehicle = LoadVehicle(file);
    EXPECT_EQ(vehicle.name, std::filesystem::path(file).stem().string());
    const DynamicModel model(vehicle, vehicle.effects);
    EXPECT_GE(model.IndexOf("thrust.k_f"), 0);
  }
}

// What PyYAML and rosparam would load as text: an exponent without a point before it or without its
// sign.
TEST(VehicleYaml, ShippedNumbersAreFloatsForYaml11) {
  const std::regex trap("(^|[^0-9.])([0-9]+[eE][-+]?[0-9]+|[0-9]*\\.[0-9]*[eE][0-9]+)");
  for (const char* number : {" 1e-6", "[5e-06", " 1.0e6", " 1e+20"}) {
    EXPECT_TRUE(std::regex_search(number, trap)) << number;
  }
  for (const char* number : {" 1.0e-06", "[16.57e-06,", " 1.0e+20", " 0.0025"}) {
    EXPECT_FALSE(std::regex_search(number, trap)) << number;
  }
  for (const std::string& file : ShippedVehicles()) {
    std::ifstream in(file);
    for (std::string line; std::getline(in, line);) {
      EXPECT_FALSE(std::regex_search(line.substr(0, line.find('#')), trap)) << file << ": " << line;
    }
  }
}

// The thrust axis that the data's README states becomes the body's z.
TEST(VehicleYaml, PolyuMountMakesTheThrustAxisUpright) {
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/polyu_quad13.yaml");
  const Eigen::Vector3d axis_S = Eigen::Vector3d(0.161, 0.042, 0.986).normalized();
  EXPECT_LT((vehicle.odometry.q_BS * axis_S - Eigen::Vector3d::UnitZ()).norm(), 1e-5);
  EXPECT_TRUE(vehicle.odometry.estimate);
}

}  // namespace
}  // namespace odmc
