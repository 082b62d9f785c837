#include <iostream>

#include "odmc/analysis/report.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Calibrates a quadrotor's dynamic model on a recorded flight with the online estimator.\n"
      "Writes parameters.yaml, history.csv, prediction.csv, timing.csv, report.json, report.html.");
  tools::FlightArguments flight;
  tools::ModelArguments model_arguments;
  tools::EstimatorArguments estimator;
  std::string vehicle_file, folder;
  double noise_m = 0.0, left_out_s = 0.0;
  int seed = 1;
  bool no_report = false, force = false;
  flight.AddTo(&app);
  tools::AddVehicle(&app, &vehicle_file);
  tools::AddFolder(&app, &folder, &no_report);
  model_arguments.AddParametersTo(&app, "parameters.yaml with effects, start values and priors");
  model_arguments.AddTo(&app);
  estimator.AddTo(&app);
  app.add_option("--leave-out", left_out_s,
                 "also leaves out every block of this many seconds in turn and predicts it with "
                 "what the rest of the flight shows")
      ->check(tools::Positive());
  app.add_option("--position-noise", noise_m,
                 "adds white Gaussian noise to every odometry position the estimator sees, sigma "
                 "per axis [m]")
      ->check(tools::NotNegative());
  app.add_option("--seed", seed, "of the position noise")
      ->capture_default_str()
      ->check(tools::NotNegative());
  tools::AddForce(&app, &force);
  return tools::Run(&app, argc, argv, [&] {
    const Vehicle file_vehicle = LoadVehicle(vehicle_file);
    const EstimatorOptions options = estimator.Read();
    const Vehicle vehicle = model_arguments.Configure(file_vehicle);
    const DynamicModel model(vehicle, vehicle.effects);
    const auto is_estimated = [&model](const char* name) {
      const int i = model.IndexOf(name);
      return i >= 0 && model.parameters()[i].estimated;
    };
    if (is_estimated("mass_change.mass") && is_estimated("thrust.k_f")) {
      throw tools::UsageError(
          "mass_change.mass and thrust.k_f cannot both be estimated, a flight shows their ratio: "
          "--freeze thrust.k_f or mass_change.mass");
    }
    FlightLog recording = flight.Read(vehicle);
    const StreamInspection inspection = tools::InspectFlight(vehicle, force, &recording);
    FlightLog noisy;
    if (noise_m > 0.0) {
      noisy = recording;
      AddPositionNoise(noise_m, seed, &noisy);
    }
    const FlightLog& log = noise_m > 0.0 ? noisy : recording;
    tools::MakeFolder(folder);
    PredictionFile prediction(tools::In(folder, "prediction.csv"), !log.rotor_rms_only);
    tools::ProgressBar bar(log.file);
    Calibration result =
        Calibrate(log, recording, file_vehicle, model, options, bar.Callback(),
                  [&](const PredictionSample& sample) { prediction.Add(sample); });
    prediction.Close();
    AddInspection(inspection, &result);
    WidenForDoubts(log, model, options, inspection.doubts, &result);
    if (left_out_s > 0.0) {
      result.left_out = PredictLeftOut(log, recording, file_vehicle, model, options, left_out_s);
    }
    if (model_arguments.choice.parameters) {
      WarnOfOtherMass(*model_arguments.choice.parameters, file_vehicle, &result.warnings);
    }
    result.parameters.provenance =
        tools::Provenance("calibrate", vehicle,
                          {{"flight", log.file},
                           {"position_noise_m", std::to_string(noise_m)},
                           {"estimator_options", tools::DescribeChanges(options)}});
    AddTrust(result.findings, &result.parameters);
    tools::WriteCalibration(result, log, model, folder);
    std::cout << CalibrationTable(result);
    if (!no_report) tools::RenderReport(folder);
  });
}
