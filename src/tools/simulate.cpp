#include <filesystem>
#include <iostream>

#include "model_arguments.h"
#include "odmc/analysis/report.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/model/plausibility.h"
#include "odmc/ros/flight_bag.h"
#include "odmc/sim/truth_vehicle.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Simulates a flight of the model, flown by a pilot, with motor lag and sensors.\n"
      "Where the vehicle file has an actuator, throttles fly it and are recorded.\n"
      "Writes FILE, and beside it NAME_truth.yaml (parameters) and NAME_truth.csv (states).");
  tools::ModelArguments model_arguments;
  SimulationOptions options;
  std::string vehicle_file, file, noise = "default";
  tools::AddVehicle(&app, &vehicle_file);
  tools::AddTrajectory(&app, &options);
  app.add_option("--out", file, "flight to write, .bag or .csv")->required()->type_name("FILE");
  app.add_option("--seed", options.seed, "of all randomness")->required();
  model_arguments.AddParametersTo(&app, "true parameters; default: scaled to the vehicle's size");
  model_arguments.AddTo(&app);
  app.add_option("--noise", noise, "none, default (model.md section 9), or a YAML file")
      ->type_name("none|default|FILE")
      ->capture_default_str();
  app.add_option("--ground-s", options.ground_s, "time on the ground before take-off [s]")
      ->check(tools::NotNegative());
  app.add_option("--log-rate", options.log_rate_hz, "of every stream [Hz]")
      ->check(CLI::Range(1.0, 1000.0));
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const std::filesystem::path path(file);
    const bool bag = path.extension() == ".bag";
    if (!bag && path.extension() != ".csv")
      throw tools::UsageError("--out must end in .bag or .csv");
    const Vehicle vehicle = model_arguments.Configure(LoadVehicle(vehicle_file));
    const DynamicModel model(vehicle, vehicle.effects);
    const ModelValues truth = DefaultTruth(model);
    const std::string doubt = InertiaDoubt(vehicle);
    if (!doubt.empty()) std::cerr << "warning: " << doubt << "\n";
    const std::string stem = (path.parent_path() / path.stem()).string();
    if (path.has_parent_path()) tools::MakeFolder(path.parent_path().string());
    TruthFile truth_file(stem + "_truth.csv");
    const FlightLog log = SimulateLog(model, truth, options, tools::ReadNoise(noise), {},
                                      [&](const TruthSample& sample) { truth_file.Add(sample); });
    truth_file.Close();
    bag ? WriteFlightBag(log, file) : WriteFlightCsv(log, file);
    ParameterSet set = ExactParameters(model, truth);
    set.provenance = tools::Provenance(
        "simulate", vehicle,
        {{"trajectory", options.trajectory}, {"seed", std::to_string(options.seed)}});
    SaveParameters(set, stem + "_truth.yaml");
  });
}
