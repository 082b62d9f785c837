#include <iostream>

#include "odmc/analysis/report.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sim/truth_vehicle.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Measures the estimator's update time over window lengths, on a flight or, without one, on "
      "a\n"
      "simulated octo of the nominal vehicle. Writes report.json.");
  tools::FlightArguments flight;
  tools::ModelArguments model_arguments;
  tools::EstimatorArguments estimator;
  SimulationOptions simulation;
  std::vector<double> windows_s = {0.5, 1.0, 2.0, 5.0};
  std::string vehicle_file, folder;
  flight.AddTo(&app, false);
  app.add_option("--vehicle", vehicle_file, "vehicle description, YAML; needed with FLIGHT")
      ->type_name("FILE");
  app.add_option("--windows", windows_s, "lengths of the sliding window [s]")
      ->capture_default_str()
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::PositiveNumber)
      ->type_name("a,b");
  app.add_option("--duration", simulation.duration_s, "of the simulated flight [s]")
      ->check(CLI::PositiveNumber);
  tools::AddFolder(&app, &folder);
  model_arguments.AddTo(&app);
  estimator.AddTo(&app, false);
  return tools::Run(&app, argc, argv, [&] {
    const bool simulated = flight.file.empty();
    if (!simulated && vehicle_file.empty()) throw tools::UsageError("FLIGHT needs --vehicle");
    const EstimatorOptions options = estimator.Read();
    const Vehicle vehicle = model_arguments.Configure(
        vehicle_file.empty() ? tools::NominalVehicle() : LoadVehicle(vehicle_file));
    const DynamicModel model(vehicle, vehicle.effects);
    const FlightLog log = simulated ? Simulate(model, DefaultTruth(model), simulation).log
                                    : flight.Read(vehicle);
    tools::MakeFolder(folder);
    tools::ProgressBar bar("benchmark");
    const auto rows = Benchmark(log, model, options, windows_s, bar.Callback());
    WriteText(BenchmarkReport(rows, log, vehicle), tools::In(folder, "report.json"));
    std::cout << BenchmarkTable(rows);
  });
}
