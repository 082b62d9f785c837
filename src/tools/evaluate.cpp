#include <iostream>
#include <string>
#include <vector>

#include "flight_arguments.h"
#include "model_arguments.h"
#include "odmc/analysis/report.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Predicts force and torque on a recorded flight with the given parameters. Nothing is "
      "fitted,\n"
      "unless --follow or --k-f-walk-rate asks for it.\n"
      "Writes prediction.csv, report.json, report.html.");
  tools::FlightArguments flight;
  std::string vehicle_file, parameters_file, folder;
  bool no_report = false, force = false;
  double walk_rate = 0.0;
  std::vector<std::string> follow;
  flight.AddTo(&app);
  tools::AddVehicle(&app, &vehicle_file);
  app.add_option("--parameters", parameters_file, "parameters.yaml as calibrate writes it")
      ->required()
      ->type_name("FILE");
  app.add_option(
         "--follow", follow,
         "parameters that are learned on this flight, from the given ones on, as the online "
         "estimator does (centre_of_gravity.x,gravity.x); each sample is predicted by the "
         "estimate of 0.1 s before")
      ->delimiter(',')
      ->type_name("NAMES");
  app.add_option("--k-f-walk-rate", walk_rate,
                 "k_f, and k_m where it was estimated, follow too, as a random walk of this "
                 "relative change [1/sqrt(s)]")
      ->check(tools::NotNegative());
  tools::AddFolder(&app, &folder, &no_report);
  tools::AddForce(&app, &force);
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const Vehicle file_vehicle = LoadVehicle(vehicle_file);
    const ParameterSet parameters = LoadParameters(parameters_file);
    Vehicle vehicle = file_vehicle;
    ApplyParameters(parameters, &vehicle);
    const DynamicModel model(vehicle, vehicle.effects);
    FlightLog log = flight.Read(vehicle);
    const StreamInspection inspection = tools::InspectFlight(vehicle, force, &log);
    tools::MakeFolder(folder);
    PredictionFile prediction(tools::In(folder, "prediction.csv"), !log.rotor_rms_only);
    EstimatorOptions options = tools::AttributionEstimatorOptions();
    options.k_f_walk_rate = walk_rate;
    const FollowedParameters followed = FollowFlight(log, vehicle, follow, options);
    Evaluation result = Evaluate(
        log, file_vehicle, model, parameters,
        [&](const PredictionSample& sample) { prediction.Add(sample); }, followed);
    prediction.Close();
    AddInspection(inspection, &result);
    WriteText(EvaluationReport(result, model), tools::In(folder, "report.json"));
    std::cout << EvaluationTable(result);
    if (!no_report) tools::RenderReport(folder);
  });
}
