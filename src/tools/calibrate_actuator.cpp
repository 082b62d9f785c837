#include <iostream>

#include "flight_arguments.h"
#include "odmc/actuator/rotor_inertia.h"
#include "odmc/analysis/actuator_report.h"
#include "odmc/analysis/report.h"
#include "odmc/identification/flight_actuator.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/io/bench_csv.h"
#include "odmc/math/units.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"
#include "tool_support.h"

namespace {

using namespace odmc;

// How the files are to be read.
struct BenchArguments {
  BenchColumns columns;
  StreamOptions streams;  // of bags
  int num_rotors = 4;     // of logs
  std::string command_unit, speed_unit, thrust_unit = "N";

  void AddTo(CLI::App* app) {
    app->add_option("--command-unit", command_unit,
                    "of commands: us (1000 to 2000), raw16 (0 to 65535), fraction (0 to 1); "
                    "required for CSV files and bags, autopilots' logs have their units")
        ->check(CLI::IsMember({"us", "raw16", "fraction"}));
    app->add_option("--speed-unit", speed_unit,
                    "of rotor speeds: rad_s, rpm, erpm; required for CSV files and bags")
        ->check(CLI::IsMember({"rad_s", "rpm", "erpm"}));
    app->add_option("--pole-pairs", columns.pole_pairs, "of the motors, for erpm and logs")
        ->check(tools::Positive());
    app->add_option("--rotors", num_rotors, "of the vehicle, for logs")
        ->check(CLI::Range(1, kMaxRotors))
        ->capture_default_str();
    tools::AddOrders(app, &streams);
    app->add_option("--time", columns.time, "column of times, s [t]");
    app->add_option("--command", columns.command,
                    "columns of commands: one for all motors, or one each "
                    "[pwm_us, pwm, throttle or command; pwm1_us .., pwm1 ..]")
        ->delimiter(',');
    app->add_option("--speed", columns.speed, "columns of rotor speeds, one per motor [rotor1 ..]")
        ->delimiter(',');
    app->add_option("--voltage", columns.voltage, "column of the battery voltage, V [vbat]");
    app->add_option("--thrust", columns.thrust,
                    "column of the thrust of all motors together [thrust_N, thrust_total_N]");
    app->add_option("--thrust-unit", thrust_unit, "N or g")
        ->capture_default_str()
        ->check(CLI::IsMember({"N", "g"}));
    app->add_option("--torque", columns.torque, "column of the torque, N m [torque_Nm]");
    app->add_flag("--steady-readings", columns.steady_readings,
                  "rows are single steady readings, whatever their times");
  }
  /// Of CSV files and bags.
  BenchColumns Read() const {
    BenchColumns read = columns;
    if (command_unit.empty() || speed_unit.empty()) {
      throw tools::UsageError(
          std::string(command_unit.empty() ? "--command-unit" : "--speed-unit") +
          " is required for CSV files and bags");
    }
    read.command_unit = *CommandUnitNamed(command_unit);
    read.speed_unit = *SpeedUnitNamed(speed_unit);
    if (read.speed_unit == SpeedUnit::kErpm && read.pole_pairs <= 0)
      throw tools::UsageError("--speed-unit erpm needs --pole-pairs");
    if (thrust_unit == "g") read.thrust_unit_N = 1e-3 * kStandardGravity_m_s2;
    return read;
  }
};

// What an autopilot's log or a data set's flight says of its motors.
BenchRun ReadLog(const std::string& file, const FlightReaders& readers,
                 const BenchArguments& arguments) {
  FlightReadOptions read;
  read.num_rotors = arguments.num_rotors;
  read.part = FlightPart::kOnboard;
  if (arguments.columns.pole_pairs > 0) read.pole_pairs = arguments.columns.pole_pairs;
  const FlightLog log = readers.Read(file, read);
  for (const std::string& warning : log.warnings) std::cerr << "warning: " << warning << "\n";
  if (log.rotors.empty()) RefuseFile(file, "no rotor speeds");
  return BenchRunOf(log);
}

// A bench file of any kind.
BenchRun ReadBench(const std::string& file, const BenchArguments& arguments,
                   std::vector<std::string>* used) {
  BagOptions options;
  static_cast<StreamOptions&>(options) = arguments.streams;
  const FlightReaders readers = AllFlightReaders(options);
  const FlightReader* reader = readers.Find(file);
  const std::string ending =
      reader == nullptr || reader->endings.empty() ? "" : reader->endings.front();
  if (reader != nullptr && ending != ".csv" && ending != ".bag") {
    return ReadLog(file, readers, arguments);
  }
  const BenchColumns columns = arguments.Read();
  if (ending != ".bag") return ReadBenchCsv(file, columns, used);
  options.rotor_speed_unit = arguments.speed_unit;
  options.command_unit = arguments.command_unit;
  if (columns.pole_pairs > 0) options.pole_pairs = columns.pole_pairs;
  BenchRun run = BenchRunOf(ReadActuatorBag(file, options));
  run.command_unit = columns.command_unit;
  return run;
}

// Inertia of one rotor, by its value or its geometry.
struct InertiaArguments {
  double inertia_kg_m2 = 0.0, share = 0.2;
  RotorGeometry geometry;

  void AddTo(CLI::App* app) {
    app->add_option("--rotor-inertia", inertia_kg_m2,
                    "of propeller and bell about the axis, kg m^2: gives k_m = S_2 J without a "
                    "torque sensor")
        ->check(tools::Positive());
    app->add_option("--rotor-inertia-sigma", share, "its uncertainty, share of the value")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 1.0));
    app->add_option("--blades", geometry.blades, "of the propeller; in place of --rotor-inertia")
        ->capture_default_str()
        ->check(tools::Positive());
    app->add_option("--blade-mass", geometry.blade_mass_kg, "of one blade, kg")
        ->check(tools::Positive());
    app->add_option("--blade-length", geometry.blade_length_m, "axis to tip, m")
        ->check(tools::Positive());
    app->add_option("--bell-mass", geometry.bell_mass_kg, "turning part of the motor, kg")
        ->check(tools::NotNegative());
    app->add_option("--bell-radius", geometry.bell_radius_m, "its outer radius, m")
        ->check(tools::NotNegative());
  }
  std::optional<MeasuredValue> Read() const {
    const bool drawn = geometry.blade_mass_kg > 0.0 || geometry.blade_length_m > 0.0;
    if (drawn && inertia_kg_m2 > 0.0)
      throw tools::UsageError("give --rotor-inertia or the blade's mass and length, not both");
    if (drawn && !(geometry.blade_mass_kg > 0.0 && geometry.blade_length_m > 0.0))
      throw tools::UsageError("--blade-mass and --blade-length go together");
    const double inertia = drawn ? RotorInertia(geometry) : inertia_kg_m2;
    if (!(inertia > 0.0)) return std::nullopt;
    return MeasuredValue{inertia, share * inertia};
  }
};

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Calibrates motors and ESCs from bench runs, thrust stands or flight logs: commands, "
      "battery\n"
      "voltage and rotor speeds, thrust and torque where a stand measured them. Several files and\n"
      "several motors at once. Writes actuator.yaml (a vehicle file includes it), report.json,\n"
      "free_run.csv, report.html.");
  BenchArguments bench;
  InertiaArguments inertia;
  std::vector<std::string> files, evaluate;
  std::string folder;
  bool no_report = false;
  app.add_option(
         "FILE", files,
         "CSV files, bags (odmc/MotorCommands) or autopilots' logs (.ulg, .bin, .bbl, .bfl) of the "
         "same motors")
      ->required()
      ->check(CLI::ExistingPath);
  bench.AddTo(&app);
  inertia.AddTo(&app);
  app.add_option("--evaluate", evaluate, "files the fit does not see: their free-run error")
      ->check(CLI::ExistingPath);
  tools::AddFolder(&app, &folder, &no_report);
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const std::optional<MeasuredValue> rotor_inertia = inertia.Read();
    std::vector<BenchRun> runs;
    std::vector<std::string> used;
    for (const std::string& file : files) {
      used.clear();
      runs.push_back(ReadBench(file, bench, &used));
    }
    for (const std::string& line : used) std::cout << line << "\n";
    const ActuatorCalibration calibration = CalibrateActuator(runs, rotor_inertia);
    const Actuator actuator = ActuatorOf(calibration);
    std::vector<ActuatorEvaluation> evaluations;
    for (const std::string& file : evaluate) {
      const BenchRun run = ReadBench(file, bench, nullptr);
      evaluations.push_back({run.file, EvaluateActuator(actuator, run)});
    }
    tools::MakeFolder(folder);
    std::vector<std::string> names;
    for (const BenchRun& run : runs) names.push_back(run.file);
    SaveActuator(actuator,
                 "calibrate_actuator " + std::string(ODMC_VERSION) + " from " + Listed(names),
                 tools::In(folder, "actuator.yaml"));
    WriteText(ActuatorReport(calibration, runs, evaluations), tools::In(folder, "report.json"));
    WriteFreeRuns(calibration, runs, tools::In(folder, "free_run.csv"));
    std::cout << ActuatorTable(calibration, evaluations);
    if (!no_report) tools::RenderReport(folder, "render_actuator");
  });
}
