#include <iostream>

#include "flight_arguments.h"
#include "model_arguments.h"
#include "odmc/analysis/report.h"
#include "odmc/bench/bench_report.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sim/truth_vehicle.h"
#include "tool_support.h"

namespace {

constexpr char kAbout[] =
    "Measures the estimator's update time by solver and window length, on a flight or, without "
    "one, on\n"
    "a simulated octo of the nominal vehicle, and compares estimates with full solves of the same\n"
    "windows. Writes report.json and benchmark.png.";

void AddOptions(CLI::App* app, odmc::BenchmarkOptions* options) {
  app->add_option("--solver", options->solvers, "solvers of the sliding window")
      ->capture_default_str()
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::IsMember({"incremental", "ceres"}).description(""))
      ->type_name("a,b");
  app->add_option("--windows", options->windows_s, "lengths of the sliding window [s]")
      ->capture_default_str()
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(odmc::tools::Positive())
      ->type_name("a,b");
  app->add_option("--full-solve-every", options->full_solve_every,
                  "compare every so many updates with a full solve, in a pass of its own that is "
                  "not timed; 0: none")
      ->capture_default_str()
      ->check(odmc::tools::NotNegative())
      ->type_name("N");
}

/// Options of the estimator that this tool has its own options for.
void RefuseContradictions(const odmc::tools::EstimatorArguments& estimator) {
  for (const std::string& text : estimator.settings) {
    if (text.rfind("solver=", 0) == 0) {
      throw odmc::tools::UsageError("--set " + text + ": state solvers by --solver");
    }
    if (text.rfind("window_s=", 0) == 0) {
      throw odmc::tools::UsageError("--set " + text + ": state windows by --windows");
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(kAbout);
  tools::FlightArguments flight;
  tools::ModelArguments model_arguments;
  tools::EstimatorArguments estimator;
  SimulationOptions simulation;
  BenchmarkOptions options;
  std::string vehicle_file, folder;
  bool no_report = false;
  flight.AddTo(&app, false);
  app.add_option("--vehicle", vehicle_file, "vehicle description, YAML; needed with FLIGHT")
      ->type_name("FILE");
  AddOptions(&app, &options);
  app.add_option("--duration", simulation.duration_s, "of the simulated flight [s]")
      ->check(tools::Positive());
  tools::AddFolder(&app, &folder);
  app.add_flag("--no-report", no_report, "do not draw benchmark.png");
  model_arguments.AddTo(&app);
  estimator.AddTo(&app, false);
  return tools::Run(&app, argc, argv, [&] {
    const bool simulated = flight.file.empty();
    if (!simulated && vehicle_file.empty()) throw tools::UsageError("FLIGHT needs --vehicle");
    RefuseContradictions(estimator);
    const Vehicle vehicle = model_arguments.Configure(
        vehicle_file.empty() ? tools::NominalVehicle() : LoadVehicle(vehicle_file));
    const DynamicModel model(vehicle, vehicle.effects);
    const EstimatorOptions of_estimator = estimator.Read();
    const FlightLog log =
        simulated ? Simulate(model, DefaultTruth(model), simulation).log : flight.Read(vehicle);
    tools::MakeFolder(folder);
    tools::ProgressBar bar("benchmark");
    const auto rows = Benchmark(log, model, of_estimator, options, bar.Callback());
    WriteText(BenchmarkReport(rows, log, vehicle), tools::In(folder, "report.json"));
    std::cout << BenchmarkTable(rows);
    if (!no_report) tools::RenderReport(folder, "render_benchmark");
  });
}
