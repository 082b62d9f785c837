#include <iostream>

#include "odmc/analysis/report.h"
#include "odmc/bench/experiments.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Flies under the controller in lock-step, estimator in the loop: is control better with\n"
      "the estimate than without? Every seed flies another vehicle, whose true coefficients "
      "nobody\n"
      "on board knows; errors are against truth. Writes report.json, tables, pictures.\n"
      "Names: octo, vshape, cog_shift, payload, wind, damaged_propeller, or all.");
  ExperimentOptions options;
  std::string name, vehicle_file, folder;
  bool no_report = false;
  app.add_option("NAME", name, "the experiment, or all")->required();
  tools::AddDefaultVehicle(&app, &vehicle_file);
  app.add_option("--seeds", options.seeds, "flights per variant")
      ->capture_default_str()
      ->check(tools::Positive());
  app.add_option("--seed", options.first_seed, "of the first flight")->capture_default_str();
  tools::AddJobs(&app, &options.jobs);
  app.add_option("--duration", options.duration_s, "of the path, s")
      ->capture_default_str()
      ->check(CLI::Range(20.0, 600.0));
  app.add_option("--kill-estimator", options.estimator_dies_at_s,
                 "kill the estimator in every flight, so long after its start, s")
      ->check(tools::Positive());
  tools::AddFolder(&app, &folder, &no_report);
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const Vehicle vehicle = LoadVehicle(vehicle_file);
    tools::MakeFolder(folder);
    const std::vector<std::string> names =
        name == "all" ? ExperimentNames() : std::vector<std::string>{name};
    std::vector<Experiment> experiments;
    for (const std::string& n : names) {
      tools::ProgressBar bar(n);
      experiments.push_back(RunExperiment(n, vehicle, options, bar.Callback()));
      for (const auto& [variant, flight] : experiments.back().example) {
        WriteText(TrackingCsv(flight), tools::In(folder, n + "_" + variant + ".csv"));
      }
    }
    WriteText(ExperimentReport(experiments), tools::In(folder, "report.json"));
    const std::string table = ExperimentTable(experiments);
    WriteText(table, tools::In(folder, "table.txt"));
    std::cout << table;
    if (!no_report) tools::RenderReport(folder, "render_experiment");
  });
}
