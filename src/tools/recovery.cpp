#include <iostream>

#include "model_arguments.h"
#include "odmc/analysis/report.h"
#include "odmc/bench/bench_report.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Simulates flights and calibrates each from a wrong start: does the truth come back?\n"
      "Coefficients start off by up to 30 % (inertia 50 %); all parameters are free but the rotor\n"
      "torque and the extrinsics. Writes report.json, report.html.");
  tools::ModelArguments model_arguments;
  tools::EstimatorArguments estimator;
  RecoveryOptions options;
  std::string vehicle_file, folder, noise = "default";
  bool no_report = false;
  tools::AddVehicle(&app, &vehicle_file);
  tools::AddTrajectory(&app, &options.simulation);
  app.add_option("--seeds", options.seeds, "number of flights")
      ->required()
      ->check(tools::Positive());
  tools::AddJobs(&app, &options.jobs);
  tools::AddFolder(&app, &folder, &no_report);
  app.add_option("--seed", options.simulation.seed, "of the first flight")->capture_default_str();
  app.add_option("--noise", noise, "none, default (model.md section 9), or a YAML file")
      ->capture_default_str();
  app.add_option("--start-thrust-factor", options.start_thrust_factor,
                 "k_f starts at this times the truth")
      ->check(tools::Positive());
  model_arguments.AddTo(&app);
  estimator.AddTo(&app);
  return tools::Run(&app, argc, argv, [&] {
    options.estimator = estimator.Read();
    options.noise = tools::ReadNoise(noise);
    const std::vector<std::string> freeze = model_arguments.choice.freeze;
    const std::vector<std::string> free = model_arguments.choice.free;
    const Vehicle configured =
        RecoveryVehicle(model_arguments.Configure(LoadVehicle(vehicle_file)));
    const Vehicle vehicle = Configure(configured, {{}, configured.effects, {}, free, freeze});
    tools::MakeFolder(folder);
    tools::ProgressBar bar("recovery");
    const Recovery recovery = Recover(vehicle, options, bar.Callback());
    WriteText(RecoveryReport(recovery, options, vehicle), tools::In(folder, "report.json"));
    std::cout << RecoveryTable(recovery);
    if (!no_report) tools::RenderReport(folder);
  });
}
