#include <algorithm>
#include <filesystem>
#include <iostream>
#include <map>

#include "flight_arguments.h"
#include "model_arguments.h"
#include "odmc/analysis/report.h"
#include "odmc/fleet/fleet_flight_json.h"
#include "odmc/fleet/joint_calibration.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

namespace odmc {
namespace {

/// What the command line says.
struct Arguments {
  tools::FlightArguments flight;
  tools::ModelArguments model;
  tools::EstimatorArguments estimator;
  std::string vehicle_file, folder;
  double noise_m = 0.0, left_out_s = 0.0;
  int seed = 1, jobs = 1;
  std::vector<std::string> own;
  double false_alarm_rate = JointOptions().false_alarm_rate;
  bool no_report = false, force = false, no_left_out = false, only_factor = false;
};

void CalibrateOne(const Arguments& a, const std::string& file, const Vehicle& file_vehicle,
                  const Vehicle& vehicle) {
  const CalibrateOptions options{a.estimator.Read(), a.left_out_s, a.model.choice.parameters};
  const DynamicModel model(vehicle, vehicle.effects);
  FlightLog recording = a.flight.Read(file, vehicle);
  const StreamInspection inspection = tools::InspectFlight(vehicle, a.force, &recording);
  FlightLog noisy;
  if (a.noise_m > 0.0) {
    noisy = recording;
    AddPositionNoise(a.noise_m, a.seed, &noisy);
  }
  const FlightLog& log = a.noise_m > 0.0 ? noisy : recording;
  tools::MakeFolder(a.folder);
  PredictionFile prediction(tools::In(a.folder, "prediction.csv"), !log.rotor_rms_only);
  tools::ProgressBar bar(log.file);
  Calibration result =
      CalibrateInspected(log, recording, inspection, file_vehicle, model, options, bar.Callback(),
                         [&](const PredictionSample& sample) { prediction.Add(sample); });
  prediction.Close();
  tools::StateOrigin(vehicle, a.noise_m, options.estimator, &result);
  tools::WriteCalibration(result, log, model, a.folder);
  WriteText(FormatFleetFlight(FleetFlightOf(result, model, a.own)),
            tools::In(a.folder, "flight.json"));
  std::cout << CalibrationTable(result);
  if (!a.no_report) tools::RenderReport(a.folder);
}

/// A folder's name for a flight, its file's name; where several have that, with a number.
std::string FolderOf(const FleetFlight& flight, std::map<std::string, int>* taken) {
  const std::string stem = std::filesystem::path(flight.file).stem().string();
  const int before = (*taken)[stem]++;
  return before == 0 ? stem : stem + "_" + std::to_string(before + 1);
}

/// Options and reader of a flight among several.
JointCalibrationOptions OptionsOf(const Arguments& a) {
  JointCalibrationOptions options;
  options.estimator = a.estimator.Read();
  // Every second pose of 100 Hz says as much, in half of the time; what the step costs in accuracy
  // is measured (JointCalibrationOptions::doubted_flights).
  constexpr double kKeyframeRate_hz = 50.0;
  const bool is_given = a.estimator.keyframe_rate_hz > 0.0 ||
                        options.estimator.keyframe_rate_hz != EstimatorOptions().keyframe_rate_hz;
  if (!is_given) options.estimator.keyframe_rate_hz = kKeyframeRate_hz;
  options.own = a.own;
  options.jobs = a.jobs;
  options.joint.false_alarm_rate = a.false_alarm_rate;
  options.predict_left_out = !a.no_left_out;
  return options;
}

FlightSource SourceOf(const Arguments& a, const Vehicle& vehicle) {
  return [&](const std::string& file) {
    InspectedFlight flight;
    flight.log = a.flight.Read(file, vehicle);
    flight.inspection = tools::InspectFlight(vehicle, a.force, &flight.log);
    return flight;
  };
}

void WriteFactor(const Arguments& a, const std::string& file, const Vehicle& file_vehicle,
                 const Vehicle& vehicle) {
  const FleetFlight flight =
      CalibrateFlight(file, SourceOf(a, vehicle), file_vehicle, vehicle, OptionsOf(a));
  if (!flight.failure.empty()) throw std::invalid_argument(flight.failure);
  tools::MakeFolder(a.folder);
  WriteText(FormatFleetFlight(flight), tools::In(a.folder, "flight.json"));
}

void CalibrateSeveral(const Arguments& a, const std::vector<std::string>& names,
                      const Vehicle& file_vehicle, const Vehicle& vehicle) {
  if (a.noise_m > 0.0 || a.left_out_s > 0.0) {
    throw tools::UsageError(
        "--position-noise and --leave-out are for one flight; of several each is left out whole");
  }
  const JointCalibrationOptions options = OptionsOf(a);
  const DynamicModel model(vehicle, vehicle.effects);
  std::vector<std::string> files;
  std::vector<FleetFlight> known;
  for (const std::string& name : names) {
    if (std::filesystem::path(name).extension() != ".json") {
      files.push_back(name);
      continue;
    }
    known.push_back(LoadFleetFlight(name));
    files.push_back(known.back().file);
  }
  const FlightSource source = SourceOf(a, vehicle);
  tools::MakeFolder(a.folder);
  tools::ProgressBar bar(std::to_string(files.size()) + " flights");
  FleetCalibration fleet =
      CalibrateFleet(files, source, file_vehicle, vehicle, options, known, bar.Callback());
  fleet.parameters.provenance =
      tools::Provenance("calibrate", vehicle,
                        {{"flights", std::to_string(fleet.used().size())},
                         {"estimator_options", tools::DescribeChanges(options.estimator)}});
  SaveParameters(fleet.parameters, tools::In(a.folder, "parameters.yaml"));
  WriteText(FleetReport(fleet, model), tools::In(a.folder, "report.json"));
  WriteText(FleetHistoryCsv(fleet), tools::In(a.folder, "flights.csv"));
  std::map<std::string, int> taken;
  for (const FleetFlight& flight : fleet.flights) {
    if (!flight.failure.empty()) continue;
    const std::string folder = tools::In(tools::In(a.folder, "flights"), FolderOf(flight, &taken));
    tools::MakeFolder(folder);
    SaveParameters(flight.factor.estimate, tools::In(folder, "parameters.yaml"));
    WriteText(FormatFleetFlight(flight), tools::In(folder, "flight.json"));
  }
  std::cout << FleetTable(fleet);
  if (!a.no_report) tools::RenderReport(a.folder, "render_fleet");
}

void AddOptionsOfOne(CLI::App* app, Arguments* a) {
  app->add_option("--leave-out", a->left_out_s,
                  "also leaves out every block of this many seconds in turn and predicts it with "
                  "what the estimator learns of the rest, without inertia and recorded point by "
                  "frequency bands, which are of the whole flight (one flight)")
      ->check(tools::Positive());
  app->add_option("--position-noise", a->noise_m,
                  "adds white Gaussian noise to every odometry position the estimator sees, sigma "
                  "per axis [m] (one flight)")
      ->check(tools::NotNegative());
  app->add_option("--seed", a->seed, "of the position noise")
      ->capture_default_str()
      ->check(tools::NotNegative());
}

/// Of several flights, and of what a fleet needs of one.
void AddFleetOptions(CLI::App* app, Arguments* a) {
  tools::AddOwn(app, &a->own);
  tools::AddJobs(app, &a->jobs);
  app->add_option(
         "--false-alarm-rate", a->false_alarm_rate,
         "share of fleets without any in which a step, a trend or an outlier is seen; the same "
         "share of those without in which a recurrent residual is")
      ->check(CLI::Range(1e-9, 0.5))
      ->capture_default_str();
  app->add_flag("--no-left-out", a->no_left_out,
                "do not predict each flight with what all others show");
  app->add_flag("--only-factor", a->only_factor,
                "write nothing but flight.json, what a fleet needs of each flight; one flight");
}

void AddOptions(CLI::App* app, Arguments* a) {
  a->flight.AddSeveralTo(app);
  tools::AddVehicle(app, &a->vehicle_file);
  tools::AddFolder(app, &a->folder, &a->no_report);
  a->model.AddParametersTo(app, "parameters.yaml with effects, start values and priors");
  a->model.AddTo(app);
  a->estimator.AddTo(app);
  AddOptionsOfOne(app, a);
  AddFleetOptions(app, a);
  tools::AddForce(app, &a->force);
}

void CalibrateFlights(Arguments* a) {
  const std::vector<std::string> files = a->flight.Expand();
  const Vehicle file_vehicle = LoadVehicle(a->vehicle_file);
  a->estimator.Read();
  const Vehicle vehicle = a->model.Configure(file_vehicle);
  const std::string refusal = MassBesideThrust(DynamicModel(vehicle, vehicle.effects));
  if (!refusal.empty()) throw tools::UsageError(refusal);
  const bool is_one =
      files.size() == 1 && std::filesystem::path(files.front()).extension() != ".json";
  if (a->only_factor && !is_one) throw tools::UsageError("--only-factor is for one flight");
  if (a->only_factor) {
    WriteFactor(*a, files.front(), file_vehicle, vehicle);
  } else if (is_one) {
    CalibrateOne(*a, files.front(), file_vehicle, vehicle);
  } else {
    CalibrateSeveral(*a, files, file_vehicle, vehicle);
  }
}

}  // namespace
}  // namespace odmc

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Calibrates a quadrotor's dynamic model on recorded flights with the online estimator.\n"
      "Of one flight it writes parameters.yaml, history.csv, prediction.csv, timing.csv,\n"
      "report.json, report.html and flight.json (what a fleet needs of it). Of several it "
      "combines\n"
      "what each says about the vehicle: parameters.yaml with the scatter between flights,\n"
      "report.json, flights.csv, report.html, and flights/NAME/ of each.");
  Arguments a;
  AddOptions(&app, &a);
  return tools::Run(&app, argc, argv, [&] { CalibrateFlights(&a); });
}
