#include <algorithm>
#include <iostream>
#include <optional>
#include <thread>

#include "flight_arguments.h"
#include "model_arguments.h"
#include "odmc/analysis/report.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/attribution/stream_effects.h"
#include "odmc/fleet/joint_loop.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/model/effect.h"
#include "tool_support.h"

namespace odmc {
namespace {

struct Arguments {
  tools::FlightArguments flight;
  tools::ModelArguments model;
  tools::EstimatorArguments estimator;
  std::string vehicle_file, folder;
  std::vector<std::string> held_out, own, decision;
  std::optional<int> jobs;
  bool no_report = false, force = false;
  CloseLoopOptions options;
};

void CloseOne(const Arguments& a, const std::string& file, const Vehicle& file_vehicle,
              const Vehicle& vehicle) {
  FlightLog log = a.flight.Read(file, vehicle);
  const StreamInspection inspection = tools::InspectFlight(vehicle, a.force, &log);
  tools::MakeFolder(a.folder);
  tools::ProgressBar bar(log.file);
  CloseLoopOptions options = a.options;
  options.jobs =
      a.jobs.value_or(static_cast<int>(std::max(1U, std::thread::hardware_concurrency())));
  ClosedLoop loop = CloseLoopInspected(log, inspection, file_vehicle, vehicle, options,
                                       a.model.choice.parameters, bar.Callback());
  loop.parameters.provenance = tools::ProvenanceOf(a.options, vehicle, {{"flight", log.file}});
  WriteText(CloseLoopReport(loop, vehicle), tools::In(a.folder, "report.json"));
  WriteLoopSamples(loop, tools::In(a.folder, "residual.csv"));
  SaveParameters(loop.parameters, tools::In(a.folder, "parameters.yaml"));
  std::cout << CloseLoopTable(loop);
  if (!a.no_report) tools::RenderReport(a.folder);
}

void CloseSeveral(const Arguments& a, const std::vector<std::string>& files,
                  const Vehicle& file_vehicle, const Vehicle& vehicle) {
  std::vector<std::string> held_out;
  if (!a.held_out.empty()) {
    tools::FlightArguments others = a.flight;
    others.several = a.held_out;
    held_out = others.Expand();
  }
  std::vector<std::string> learned;
  for (const std::string& file : files) {
    if (std::count(held_out.begin(), held_out.end(), file) == 0) learned.push_back(file);
  }
  if (learned.empty()) throw tools::UsageError("--held-out leaves no flight to learn from");
  const FlightSource source = [&](const std::string& file) {
    InspectedFlight flight;
    flight.log = a.flight.Read(file, vehicle);
    flight.inspection = tools::InspectFlight(vehicle, a.force, &flight.log);
    return flight;
  };
  JointLoopOptions options;
  options.calibration.estimator = a.options.estimator;
  options.calibration.own = a.own;
  options.calibration.jobs = a.jobs.value_or(1);
  options.attribution = a.options.attribution;
  options.ruled_out = a.options.ruled_out;
  tools::MakeFolder(a.folder);
  tools::ProgressBar bar(std::to_string(learned.size()) + " flights");
  JointLoop loop =
      CloseLoopOnSeveral(learned, held_out, source, file_vehicle, vehicle, options, bar.Callback());
  Vehicle extended = vehicle;
  extended.effects = loop.effect_names;
  loop.after.parameters.provenance =
      tools::ProvenanceOf(a.options, extended, {{"flights", std::to_string(loop.flights.size())}});
  WriteText(JointLoopReport(loop, DynamicModel(extended, extended.effects)),
            tools::In(a.folder, "report.json"));
  WriteText(JointLoopCsv(loop), tools::In(a.folder, "effects.csv"));
  WriteText(FleetHistoryCsv(loop.after), tools::In(a.folder, "flights.csv"));
  SaveParameters(loop.after.parameters, tools::In(a.folder, "parameters.yaml"));
  std::cout << JointLoopTable(loop);
  if (!a.no_report) tools::RenderReport(a.folder, "render_fleet");
}

void AddOptions(CLI::App* app, Arguments* a) {
  a->flight.AddSeveralTo(app);
  tools::AddVehicle(app, &a->vehicle_file);
  tools::AddFolder(app, &a->folder, &a->no_report);
  a->model.AddParametersTo(
      app,
      "parameters.yaml with effects, frozen values and a thrust coefficient; its "
      "other sigmas are no priors here: whether its model lacks something is the "
      "question");
  a->model.AddTo(app);
  a->estimator.defaults = tools::AttributionEstimatorOptions();
  a->estimator.AddTo(app);
  app->add_option("--block", a->options.blocks.block_s,
                  "length of a block of time [s] (one flight)")
      ->capture_default_str()
      ->check(tools::Positive());
  app->add_option("--held-out", a->held_out,
                  "flights that nothing is learned from; files, folders and patterns")
      ->allow_extra_args(true)
      ->type_name("FLIGHT");
  tools::AddOwn(app, &a->own);
  app->add_option("--jobs", a->jobs,
                  "flights at a time [1], or threads of one flight [all processors]")
      ->check(tools::Positive());
  app->add_option("--most-effects", a->options.attribution.most_effects,
                  "add at most this many effects")
      ->capture_default_str()
      ->check(tools::NotNegative());
  app->add_option("--rule-out", a->options.ruled_out,
                  "effects that cannot act here, as wind,gust indoors")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("a,b")
      ->check(CLI::IsMember(EffectRegistry::Default().names()).description(""));
  app->add_option("--decision", a->decision,
                  "NAME=VALUE: changes a number of the decision, see below")
      ->take_all()
      ->allow_extra_args(false);
  app->footer(DescribeDecision() + "\n" + app->get_footer());
  tools::AddForce(app, &a->force);
}

void CloseLoopOnFlights(Arguments* a) {
  try {
    for (const std::string& set : a->decision) SetDecision(set, &a->options.attribution);
  } catch (const std::invalid_argument& error) {
    throw tools::UsageError(error.what());
  }
  const std::vector<std::string> files = a->flight.Expand();
  const Vehicle file_vehicle = LoadVehicle(a->vehicle_file);
  a->options.estimator = a->estimator.Read();
  Vehicle vehicle = a->model.Configure(file_vehicle);
  if (!a->model.parameters_file.empty()) HoldKnownThrust(a->options.attribution, &vehicle);
  if (files.size() == 1 && a->held_out.empty()) {
    CloseOne(*a, files.front(), file_vehicle, vehicle);
  } else {
    CloseSeveral(*a, files, file_vehicle, vehicle);
  }
}

}  // namespace
}  // namespace odmc

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Closes the loop on a recorded flight: calibrates the declared model, traces what it leaves\n"
      "unexplained to a physical effect it lacks, adds that effect, and reports the error before\n"
      "and after on blocks of time that the fit has not used.\n"
      "Writes report.json, residual.csv, parameters.yaml (of the extended model), report.html.\n"
      "Of several flights of one vehicle it weighs the evidence of all together: report.json with\n"
      "each flight's coefficients, effects.csv, parameters.yaml of the extended vehicle; errors "
      "are\n"
      "those on each flight left out in turn, or on --held-out flights.\n"
      "With --parameters a thrust coefficient known to 5 % is held, so that a change of mass "
      "shows.");
  Arguments a;
  AddOptions(&app, &a);
  return tools::Run(&app, argc, argv, [&] { CloseLoopOnFlights(&a); });
}
