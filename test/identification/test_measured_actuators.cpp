// Recorded benches and flights. The k_f compared with are those of the data's READMEs; the bounds
// are what a calibration should reach.

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

#include "odmc/analysis/replay.h"
#include "odmc/identification/actuator_calibration.h"
#include "odmc/identification/flight_actuator.h"
#include "odmc/io/bench_csv.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/recorded_data.h"

namespace odmc {
namespace {

#define RECORDED_OR_SKIP(variable, name)                 \
  const std::string variable = test::RecordedFile(name); \
  if (variable.empty()) GTEST_SKIP() << "no recorded data"

BenchRun Read(const std::string& file, CommandUnit unit) {
  BenchColumns columns;
  columns.command_unit = unit;
  return ReadBenchCsv(file, columns);
}

double Percent(double part, double whole) { return 100.0 * part / whole; }

const ActuatorParameter& Parameter(const std::vector<ActuatorParameter>& all, const char* name) {
  for (const ActuatorParameter& p : all) {
    if (p.name == name) return p;
  }
  throw std::invalid_argument(name);
}

TEST(MeasuredActuator, PolyuMotorBench) {
  RECORDED_OR_SKIP(file, "polyu_motor_bench/motor_steps_2023-10-06.csv");
  const ActuatorCalibration c =
      CalibrateActuator({Read(file, CommandUnit::kMicroseconds)}, std::nullopt);
  const FreeRunError& e = c.error;
  EXPECT_LT(Percent(e.steady_rad_s, e.speed_range_rad_s), 1.0);
  EXPECT_LT(Percent(e.response_rad_s, e.speed_range_rad_s), 3.0);
  EXPECT_LT(e.response_rad_s, 3.0 * e.steady_rad_s);
  EXPECT_LT(e.steady_rad_s, 3.0 * e.response_rad_s);
  for (const char* name : {"S_0", "S_1", "U_a", "time_constant_s", "delay_s"})
    EXPECT_TRUE(Parameter(c.parameters, name).found) << name;
  EXPECT_EQ(c.fit.step_times_s.size(), 9u);
}

TEST(MeasuredActuator, Aerostack2ThrustStand) {
  RECORDED_OR_SKIP(single, "aerostack2_thrust_stand/single_rotor_steps.csv");
  RECORDED_OR_SKIP(multi, "aerostack2_thrust_stand/multirotor_steps.csv");
  const ActuatorCalibration a =
      CalibrateActuator({Read(single, CommandUnit::kMicroseconds)}, std::nullopt);
  const ActuatorCalibration b =
      CalibrateActuator({Read(multi, CommandUnit::kMicroseconds)}, std::nullopt);
  EXPECT_NEAR(a.thrust->coefficient.value, 9.1e-6, 0.03 * 9.1e-6);
  EXPECT_NEAR(b.thrust->coefficient.value, 9.3e-6, 0.03 * 9.3e-6);
  EXPECT_NEAR(a.torque->coefficient.value / b.torque->coefficient.value, 1.0, 0.04);
  EXPECT_LT(a.torque->offsets.at(0).value, -0.005);
  EXPECT_LT(b.torque->offsets.at(0).value, -0.005);
  EXPECT_GE(a.fit.step_times_s.size(), 10u);  // the stand slews from step to step
}

TEST(MeasuredActuator, ImrcThrustStand) {
  RECORDED_OR_SKIP(stock, "imrc_thruststand/cf21_stock_bitcraze2021_a.csv");
  for (const auto& [name, k_f] :
       std::map<std::string, double>{{"cf21_stock_bitcraze2021_a", 2.02e-8},
                                     {"cf21_eckart1", 2.02e-8},
                                     {"cf21plus_250mah_battery0", 1.43e-8},
                                     {"cf21plus_350mah_battery0", 1.43e-8},
                                     {"cf21bl_guards_feb25_2026", 3.91e-8}}) {
    const ActuatorCalibration c = CalibrateActuator(
        {Read(test::RecordedFile("imrc_thruststand/" + name + ".csv"), CommandUnit::kRaw16)},
        std::nullopt);
    EXPECT_NEAR(c.thrust->coefficient.value, k_f, 0.03 * k_f) << name;
    EXPECT_FALSE(Parameter(c.parameters, "time_constant_s").found) << name;
  }
}

TEST(MeasuredActuator, BlackbirdCommandsToSpeeds) {
  RECORDED_OR_SKIP(first, "blackbird_actuators/ampersand_yawConstant_maxSpeed3p0.csv");
  RECORDED_OR_SKIP(second, "blackbird_actuators/picasso_yawForward_maxSpeed4p0.csv");
  const BenchRun fitted = Read(first, CommandUnit::kMicroseconds);
  const ActuatorCalibration c = CalibrateActuator({fitted}, std::nullopt);
  for (const FreeRunError& e :
       EvaluateActuator(ActuatorOf(c), Read(second, CommandUnit::kMicroseconds)))
    EXPECT_LT(Percent(e.all_rad_s, e.mean_speed_rad_s), 2.5);
  ASSERT_TRUE(c.fit.common.lag_s);
  EXPECT_GE(*c.fit.common.lag_s, 0.020);
  EXPECT_LE(*c.fit.common.lag_s, 0.030);
  const double delay_s = Parameter(c.parameters, "delay_s").found->value;
  const double tau_s = Parameter(c.parameters, "time_constant_s").found->value;
  EXPECT_GT(delay_s, 0.0);
  EXPECT_LT(delay_s, 0.015);
  EXPECT_NEAR(delay_s + tau_s, 0.032, 0.006);
}

// What the estimator makes of one flight's force: k_f and lateral drag.
struct Flown {
  double k_f, d_x, d_y;
};

Flown Calibrated(const std::string& file, const std::string& vehicle_name,
                 const std::optional<Actuator>& actuator, bool from_commands,
                 std::vector<std::string>* warnings = nullptr) {
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/" + vehicle_name + ".yaml");
  FlightLog log = ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf);
  SettleRotors(actuator, vehicle.num_rotors(), from_commands, &log);
  if (warnings != nullptr) *warnings = log.warnings;
  const DynamicModel model(vehicle, vehicle.effects);
  EstimatorOptions options = OfflineOptions();
  Estimator estimator(&model, options, true);
  const ReplayResult replay = Replay(log, &estimator);
  const auto value = [&](const char* name) { return replay.last->values[model.IndexOf(name)]; };
  return {value("thrust.k_f"), value("drag.d_x"), value("drag.d_y")};
}

TEST(MeasuredActuator, CrazyflieFromCommandsAndVoltageOnly) {
  RECORDED_OR_SKIP(first, "imrc_cf21_brushless/eckart00.csv");
  std::vector<BenchRun> runs;
  for (const char* name : {"eckart00", "eckart01", "eckart03"}) {
    runs.push_back(Read(test::RecordedFile(std::string("imrc_cf21_brushless/") + name + ".csv"),
                        CommandUnit::kRaw16));
  }
  const Actuator actuator = ActuatorOf(CalibrateActuator(runs, std::nullopt));
  for (const char* name : {"eckart06", "eckart16", "eckart35"}) {
    const std::string file =
        test::RecordedFile(std::string("imrc_cf21_brushless/") + name + ".csv");
    const Flown sensor = Calibrated(file, "imrc_cf21_brushless", std::nullopt, false);
    const Flown commands = Calibrated(file, "imrc_cf21_brushless", actuator, true);
    EXPECT_NEAR(commands.k_f, sensor.k_f, 0.05 * sensor.k_f) << name;
    EXPECT_NEAR(commands.d_x, sensor.d_x, 0.2 * std::abs(sensor.d_x)) << name;
    EXPECT_NEAR(commands.d_y, sensor.d_y, 0.2 * std::abs(sensor.d_y)) << name;
  }
}

bool Names(const std::vector<std::string>& warnings, const std::string& rotor) {
  for (const std::string& warning : warnings) {
    if (warning.find(rotor + " from") != std::string::npos) return true;
  }
  return false;
}

TEST(MeasuredActuator, BadSensorsAreNamedAndReplaced) {
  RECORDED_OR_SKIP(brushed, "imrc_cf21_brushed_badsensor/jana23.csv");
  RECORDED_OR_SKIP(payload, "imrc_cf21_payload_badsensor/eckart52.csv");
  std::vector<std::string> warnings;
  const Flown dead =
      Calibrated(brushed, "imrc_cf21_brushed_badsensor", std::nullopt, false, &warnings);
  EXPECT_TRUE(Names(warnings, "rotor1"));
  for (const char* other : {"rotor2", "rotor3", "rotor4"}) EXPECT_FALSE(Names(warnings, other));
  EXPECT_NEAR(dead.k_f, 2.00e-8, 0.05 * 2.00e-8);
  const Flown halved =
      Calibrated(payload, "imrc_cf21_payload_badsensor", std::nullopt, false, &warnings);
  EXPECT_TRUE(Names(warnings, "rotor3"));
  EXPECT_FALSE(Names(warnings, "rotor1"));
  EXPECT_NEAR(halved.k_f, 3.78e-8, 0.05 * 3.78e-8);
}

// No sound sensor of any other flight is suspected.
TEST(MeasuredActuator, SoundSensorsAreNotSuspected) {
  RECORDED_OR_SKIP(first, "imrc_cf21_brushless/eckart00.csv");
  namespace fs = std::filesystem;
  int flights = 0;
  for (const char* set : {"imrc_cf21_brushless", "imrc_cf21_brushed", "imrc_cf21_payload"}) {
    for (const auto& entry : fs::directory_iterator(test::RecordedFile(set))) {
      const std::string file = entry.path().string();
      if (entry.path().extension() != ".csv" || file.find("_mocap") != std::string::npos) continue;
      EXPECT_TRUE(SuspectRotors(ReadFlightCsv(file, 4, PoseSource::kEkf)).empty()) << file;
      ++flights;
    }
  }
  EXPECT_GT(flights, 20);
}

}  // namespace
}  // namespace odmc
