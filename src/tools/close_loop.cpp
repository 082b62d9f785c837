#include <iostream>

#include "odmc/analysis/report.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Closes the loop on a recorded flight: calibrates the declared model, traces what it leaves\n"
      "unexplained to a physical effect it lacks, adds that effect, and reports the error before\n"
      "and after on blocks of time that neither the choice nor the fit has seen.\n"
      "Writes report.json, residual.csv, parameters.yaml (of the extended model), report.html.\n"
      "With --parameters a thrust coefficient known to 5 % is held, so that a change of mass "
      "shows.");
  tools::FlightArguments flight;
  tools::ModelArguments model_arguments;
  tools::EstimatorArguments estimator;
  std::string vehicle_file, folder;
  bool no_report = false, force = false;
  CloseLoopOptions options;
  flight.AddTo(&app);
  tools::AddVehicle(&app, &vehicle_file);
  tools::AddFolder(&app, &folder, &no_report);
  model_arguments.AddParametersTo(&app, "parameters.yaml with effects, frozen values and a thrust coefficient; its other sigmas are "
                                   "no priors here: whether its model lacks something is the question");
  model_arguments.AddTo(&app);
  estimator.defaults = tools::AttributionEstimatorOptions();
  estimator.AddTo(&app);
  app.add_option("--block", options.blocks.block_s, "length of a block of time [s]")
      ->capture_default_str()
      ->check(tools::Positive());
  app.add_option("--most-effects", options.attribution.most_effects, "add at most this many effects")
      ->capture_default_str()
      ->check(tools::NotNegative());
  std::vector<std::string> decision;
  app.add_option("--decision", decision, "NAME=VALUE: changes a number of the decision, see below")
      ->take_all()
      ->allow_extra_args(false);
  app.footer(DescribeDecision() + "\n" + app.get_footer());
  tools::AddForce(&app, &force);
  return tools::Run(&app, argc, argv, [&] {
    try {
      for (const std::string& set : decision) SetDecision(set, &options.attribution);
    } catch (const std::invalid_argument& error) {
      throw tools::UsageError(error.what());
    }
    const Vehicle file_vehicle = LoadVehicle(vehicle_file);
    options.estimator = estimator.Read();
    Vehicle vehicle = model_arguments.Configure(file_vehicle);
    if (!model_arguments.parameters_file.empty()) HoldKnownThrust(options.attribution, &vehicle);
    FlightLog log = flight.Read(vehicle);
    const StreamInspection inspection = tools::InspectFlight(vehicle, force, &log);
    tools::MakeFolder(folder);
    tools::ProgressBar bar(log.file);
    ClosedLoop loop = CloseLoop(log, file_vehicle, vehicle, options, bar.Callback());
    AddInspection(inspection, &loop);
    if (model_arguments.choice.parameters) {
      WarnOfOtherMass(*model_arguments.choice.parameters, file_vehicle, &loop.warnings);
    }
    loop.parameters.provenance = tools::Provenance(
        "close_loop", vehicle,
        {{"flight", log.file}, {"estimator_options", tools::DescribeChanges(options.estimator)},
         {"decision", DescribeChanges(options.attribution)}});
    WriteText(CloseLoopReport(loop), tools::In(folder, "report.json"));
    WriteLoopSamples(loop, tools::In(folder, "residual.csv"));
    SaveParameters(loop.parameters, tools::In(folder, "parameters.yaml"));
    std::cout << CloseLoopTable(loop);
    if (!no_report) tools::RenderReport(folder);
  });
}
