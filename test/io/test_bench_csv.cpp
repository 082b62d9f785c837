#include <gtest/gtest.h>

#include <cmath>

#include "odmc/io/actuator_yaml.h"
#include "odmc/io/bench_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/bench.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using testing_support::Contains;

class BenchCsvTest : public ::testing::Test {
 protected:
  BenchRun Read(const std::string& text, std::vector<std::string>* used = nullptr) {
    return ReadBenchCsv(Write("bench.csv", text), columns_, used);
  }
  std::string Write(const std::string& name, const std::string& text) {
    return folder_.Write(name, text);
  }
  std::string ErrorOf(const std::string& text) {
    return testing_support::ErrorOf([&] { Read(text); });
  }
  static std::string Rows(int count, const std::string& rest) {
    std::string text;
    for (int i = 0; i < count; ++i) text += std::to_string(0.1 * i) + "," + rest + "\n";
    return text;
  }

  testing_support::TemporaryFolder folder_;
  BenchColumns columns_;
};

TEST_F(BenchCsvTest, ReadsDeclaredColumnsInDeclaredUnits) {
  columns_.command_unit = CommandUnit::kMicroseconds;
  columns_.speed_unit = SpeedUnit::kErpm;
  columns_.pole_pairs = 7;
  columns_.time = "seconds";
  columns_.command = {"esc"};
  columns_.speed = {"e1", "e2"};
  columns_.thrust = "load";
  columns_.thrust_unit_N = 9.80665e-3;
  const BenchRun run = Read("seconds,esc,e1,e2,load,other\n" + Rows(20, "1500,70000,0,250,1"));
  EXPECT_EQ(run.num_motors(), 2);
  EXPECT_DOUBLE_EQ(run.ThrottleOfMotor(1)[3], 0.5);
  EXPECT_NEAR(run.speed_rad_s[0][0], 10000.0 * M_PI / 30.0, 1e-9);
  EXPECT_TRUE(std::isnan(run.speed_rad_s[1][0]));
  EXPECT_EQ(run.zero_speed, 20);
  EXPECT_NEAR(run.thrust_N[0], 2.4516625, 1e-9);
  EXPECT_TRUE(run.voltage_V.empty());
  EXPECT_NEAR(run.t_s[2], 0.2, 1e-9);
}

TEST_F(BenchCsvTest, KnowsTheUsualNames) {
  columns_.command_unit = CommandUnit::kRaw16;
  std::vector<std::string> used;
  const BenchRun run =
      Read("t,pwm1,pwm2,rotor1,rotor2,vbat\n" + Rows(12, "32768,16384,900,500,3.9"), &used);
  EXPECT_EQ(run.throttle.size(), 2u);
  EXPECT_NEAR(run.ThrottleOfMotor(0)[0], 0.5, 1e-4);
  EXPECT_EQ(run.voltage_V.size(), 12u);
  ASSERT_EQ(used.size(), 6u);
  EXPECT_EQ(used[1], "command: pwm1, pwm2");
}

TEST_F(BenchCsvTest, DropsRowsThatStepBackAndCountsThem) {
  const BenchRun run = Read("t,throttle,rotor1\n" + Rows(15, "0.5,900") + "0.2,0.5,900\n9,,900\n");
  EXPECT_EQ(run.size(), 15u);
  EXPECT_EQ(run.dropped, 2);
  EXPECT_EQ(run.rows, 17);
}

TEST_F(BenchCsvTest, WithoutTimesRowsAreReadings) {
  std::string text = "pwm,rotor1,vbat\n";
  for (int i = 0; i < 12; ++i) text += "0.5,900,3.9\n";
  EXPECT_TRUE(Read(text).t_s.empty());
}

TEST_F(BenchCsvTest, SaysWhatIsWrong) {
  EXPECT_TRUE(Contains(ErrorOf("t,pwm,w\n" + Rows(12, "0.5,900")), "--speed"));
  EXPECT_TRUE(Contains(ErrorOf("t,u,rotor1\n" + Rows(12, "0.5,900")), "--command"));
  EXPECT_TRUE(Contains(ErrorOf("t,pwm,rotor1\n" + Rows(12, "1500,900")), "no command in fraction"));
  EXPECT_TRUE(Contains(ErrorOf("t,pwm,rotor1\n" + Rows(3, "0.5,900")), "only 3 usable rows"));
  EXPECT_TRUE(Contains(ErrorOf("t,pwm,rotor1\n0.0,0.5,abc\n"), "bench.csv:2: column rotor1"));
  EXPECT_TRUE(Contains(ErrorOf("t,pwm,pwm\n0.0,0.5,0.5\n"), "twice"));
  columns_.torque = "Q";
  EXPECT_TRUE(Contains(ErrorOf("t,pwm,rotor1\n" + Rows(12, "0.5,900")), "column Q"));
  columns_.speed_unit = SpeedUnit::kErpm;
  columns_.torque.clear();
  EXPECT_TRUE(Contains(ErrorOf("t,pwm,rotor1\n" + Rows(12, "0.5,900")), "pole pairs"));
}

TEST_F(BenchCsvTest, ActuatorFilesReadBackAndGoIntoVehicles) {
  Actuator actuator;
  actuator.command_unit = CommandUnit::kMicroseconds;
  actuator.motors = {test::TypicalMotor()};
  actuator.sigma_steady_rad_s = 3.5;
  actuator.sigma_response_rad_s = 7.0;
  actuator.k_m = MeasuredValue{2.1e-8, 1e-10};
  SaveActuator(actuator, "made up", folder_.File("motors.yaml"));
  const Actuator read = LoadActuator(folder_.File("motors.yaml"));
  EXPECT_EQ(FormatActuator(read, "made up"), FormatActuator(actuator, "made up"));
  EXPECT_NEAR(read.MotorOf(3).SteadySpeed(0.4, 15.0), actuator.MotorOf(0).SteadySpeed(0.4, 15.0),
              1e-9);

  const std::string vehicle_text =
      "mass_kg: 0.75\ninertia_kg_m2: [0.0025, 0.0025, 0.0043]\nactuator: motors.yaml\nrotors:\n"
      "  - {position_m: [0.09, 0.09, 0.0], spin: cw, radius_m: 0.0635}\n"
      "  - {position_m: [0.09, -0.09, 0.0], spin: ccw, radius_m: 0.0635}\n"
      "  - {position_m: [-0.09, -0.09, 0.0], spin: cw, radius_m: 0.0635}\n"
      "  - {position_m: [-0.09, 0.09, 0.0], spin: ccw, radius_m: 0.0635}\n";
  const Vehicle vehicle = LoadVehicle(Write("quad.yaml", vehicle_text));
  ASSERT_TRUE(vehicle.actuator);
  const ParameterSetting& k_m = vehicle.parameters.at("rotor_torque.k_m");
  EXPECT_DOUBLE_EQ(*k_m.value, 2.1e-8);
  EXPECT_DOUBLE_EQ(*k_m.sigma, 0.02 * 2.1e-8);
  EXPECT_TRUE(*k_m.estimated);
  EXPECT_EQ(vehicle.parameters.count("thrust.k_f"), 0u);
  // What the vehicle file says itself goes first.
  const Vehicle stated = LoadVehicle(
      Write("quad.yaml", vehicle_text + "parameters: {rotor_torque.k_m: {value: 1.5e-08}}\n"));
  EXPECT_DOUBLE_EQ(*stated.parameters.at("rotor_torque.k_m").value, 1.5e-8);
  Write("motors.yaml", "command_unit: volts\n");
  const std::string error =
      testing_support::ErrorOf([&] { LoadVehicle(Write("bad.yaml", vehicle_text)); });
  EXPECT_TRUE(Contains(error, "bad.yaml")) << error;
  EXPECT_TRUE(Contains(error, "command_unit")) << error;
}

}  // namespace
}  // namespace odmc
