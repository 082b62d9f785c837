#include <memory>
#include <optional>

#include "bindings.h"
#include "model_arguments.h"
#include "odmc/analysis/calibration.h"
#include "odmc/analysis/model_choice.h"
#include "odmc/analysis/report.h"
#include "odmc/attribution/attribution_options.h"
#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/attribution/stream_effects.h"
#include "odmc/inspection/recording_inspection.h"
#include "odmc/io/options_yaml.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "tool_support.h"

namespace odmc::python {
namespace {

/// How the estimator is set, as the tools' options of the same names.
struct EstimatorSettings {
  std::string config;
  double keyframe_rate_hz = 0.0, window_s = 0.0;
  int threads = 0;
  std::vector<std::string> set;  ///< "key=value"

  EstimatorOptions Over(const EstimatorOptions& defaults) const {
    tools::EstimatorArguments arguments;
    arguments.defaults = defaults;
    arguments.config_file = config;
    arguments.keyframe_rate_hz = keyframe_rate_hz;
    arguments.window_s = window_s;
    arguments.threads = threads;
    arguments.settings = set;
    return arguments.Read();
  }
};

/// Compares the streams and mends the log; refuses what nothing can be learned from.
StreamInspection Inspect(const Vehicle& vehicle, bool force, FlightLog* log) {
  return InspectOrRefuse(vehicle, force, "force=True", log);
}

/// Prediction as a table with the columns of prediction.csv; without torque nothing that turns.
class PredictionTable {
 public:
  explicit PredictionTable(bool with_torque) : with_torque_(with_torque) {}

  PredictionSink Sink() {
    return [this](const PredictionSample& sample) { Add(sample); };
  }
  const Columns& columns() const { return columns_; }

 private:
  void Add(const PredictionSample& s) {
    if (columns_.names.empty()) NameColumns(s);
    columns_.Add(s.t_s);
    columns_.Add(s.speed_m_s);
    columns_.Add(s.measured_force);
    columns_.Add(s.predicted_force);
    for (const EffectWrench& effect : s.effects) columns_.Add(effect.f_B);
    if (!with_torque_) return;
    columns_.Add(s.measured_torque);
    columns_.Add(s.measured_angular_acceleration);
    columns_.Add(s.predicted_torque);
    columns_.Add(s.predicted_angular_acceleration);
    for (const EffectWrench& effect : s.effects) columns_.Add(effect.tau_Bcm_B);
  }
  void NameColumns(const PredictionSample& s) {
    columns_.names = {"t_s", "speed_m_s"};
    columns_.Name("measured_force_", "xyz", "_N");
    columns_.Name("predicted_force_", "xyz", "_N");
    for (const EffectWrench& effect : s.effects)
      columns_.Name(effect.effect + "_force_", "xyz", "_N");
    if (!with_torque_) return;
    for (const std::string what : {"measured", "predicted"}) {
      columns_.Name(what + "_torque_", "xyz", "_Nm");
      columns_.Name(what + "_angular_acceleration_", "xyz", "_rad_s2");
    }
    for (const EffectWrench& effect : s.effects)
      columns_.Name(effect.effect + "_torque_", "xyz", "_Nm");
  }

  bool with_torque_;
  Columns columns_;
};

/// What a function leaves: its tool's report.json, the table it prints, parameters, columns.
struct Found {
  std::string report, table;
  ParameterSet parameters;
  Columns samples;  ///< prediction, or residuals before and after
  Columns history;  ///< the estimate after each update
};

Columns HistoryOf(const Calibration& calibration, const DynamicModel& model) {
  Columns columns;
  columns.names = {"t_s"};
  for (const ModelParameter& p : model.parameters()) {
    columns.names.push_back(p.full_name);
    columns.names.push_back(p.full_name + "_sigma");
  }
  for (const HistoryRow& row : calibration.replay.history) {
    columns.Add(calibration.start_s + row.t_s);
    for (Eigen::Index i = 0; i < row.values.size(); ++i) {
      columns.Add(row.values[i]);
      columns.Add(row.sigma[i]);
    }
  }
  return columns;
}

/// calibrate on one flight.
Found CalibrateOne(const FlightLog& flight, const Vehicle& file_vehicle, const Vehicle& vehicle,
                   const std::optional<ParameterSet>& start, const EstimatorSettings& settings,
                   double leave_out_s, double position_noise_m, int seed, bool force,
                   const std::function<void(double)>& progress) {
  const CalibrateOptions options{settings.Over(OfflineOptions()), leave_out_s, start};
  const DynamicModel model(vehicle, vehicle.effects);
  const std::string refusal = MassBesideThrust(model);
  if (!refusal.empty()) throw std::invalid_argument(refusal);
  FlightLog recording = flight;
  const StreamInspection inspection = Inspect(vehicle, force, &recording);
  FlightLog log = recording;
  if (position_noise_m > 0.0) AddPositionNoise(position_noise_m, seed, &log);
  PredictionTable prediction(!log.rotor_rms_only);
  Calibration result = CalibrateInspected(log, recording, inspection, file_vehicle, model, options,
                                          progress, prediction.Sink());
  tools::StateOrigin(vehicle, position_noise_m, options.estimator, &result);
  return {CalibrationReport(result, model), CalibrationTable(result), result.parameters,
          prediction.columns(), HistoryOf(result, model)};
}

/// evaluate.
Found EvaluateOne(const FlightLog& flight, const Vehicle& file_vehicle,
                  const ParameterSet& parameters, double k_f_walk_rate,
                  const std::vector<std::string>& follow, bool force) {
  Vehicle vehicle = file_vehicle;
  ApplyParameters(parameters, &vehicle);
  const DynamicModel model(vehicle, vehicle.effects);
  FlightLog log = flight;
  const StreamInspection inspection = Inspect(vehicle, force, &log);
  EstimatorOptions options = tools::AttributionEstimatorOptions();
  options.k_f_walk_rate = k_f_walk_rate;
  const FollowedParameters followed = FollowFlight(log, vehicle, follow, options);
  PredictionTable prediction(!log.rotor_rms_only);
  Evaluation result = Evaluate(log, file_vehicle, model, parameters, prediction.Sink(), followed);
  AddInspection(inspection, &result);
  return {EvaluationReport(result, model),
          EvaluationTable(result),
          parameters,
          prediction.columns(),
          {}};
}

/// Residuals with the columns of residual.csv.
Columns ResidualsOf(const ClosedLoop& loop) {
  Columns columns;
  columns.names = {"t_s", "held_out", "speed_m_s"};
  for (const std::string when : {"before", "after"}) {
    columns.Name(when + "_force_", "xyz", "_N");
    columns.Name(when + "_torque_", "xyz", "_Nm");
  }
  for (const LoopSample& s : loop.samples) {
    columns.Add(s.t_s);
    columns.Add(s.held_out ? 1.0 : 0.0);
    columns.Add(s.speed_m_s);
    for (const auto* values : {&s.before, &s.after}) {
      for (const double value : *values) columns.Add(value);
    }
  }
  return columns;
}

/// close_loop on one flight.
Found CloseOne(const FlightLog& flight, const Vehicle& file_vehicle, const Vehicle& chosen,
               const std::optional<ParameterSet>& start, const EstimatorSettings& settings,
               double block_s, std::optional<int> most_effects,
               const std::vector<std::string>& rule_out, const std::vector<std::string>& decision,
               bool force, const std::function<void(double)>& progress) {
  CloseLoopOptions options;
  options.ruled_out = rule_out;
  options.estimator = settings.Over(tools::AttributionEstimatorOptions());
  if (block_s > 0.0) options.blocks.block_s = block_s;
  if (most_effects) options.attribution.most_effects = *most_effects;
  for (const std::string& set : decision) SetDecision(set, &options.attribution);
  Vehicle vehicle = chosen;
  if (start) HoldKnownThrust(options.attribution, &vehicle);
  FlightLog log = flight;
  const StreamInspection inspection = Inspect(vehicle, force, &log);
  ClosedLoop loop =
      CloseLoopInspected(log, inspection, file_vehicle, vehicle, options, start, progress);
  loop.parameters.provenance = tools::ProvenanceOf(options, vehicle, {{"flight", log.file}});
  return {
      CloseLoopReport(loop, vehicle), CloseLoopTable(loop), loop.parameters, ResidualsOf(loop), {}};
}

/// simulate: the flight and the truth behind it.
std::pair<std::shared_ptr<FlightLog>, ParameterSet> SimulateOne(
    const Vehicle& vehicle, const std::string& trajectory, double duration_s, int seed,
    const std::string& noise, double ground_s, double log_rate_hz) {
  SimulationOptions options;
  options.trajectory = trajectory;
  options.duration_s = duration_s;
  options.seed = seed;
  options.ground_s = ground_s;
  options.log_rate_hz = log_rate_hz;
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(model);
  auto log = std::make_shared<FlightLog>(
      SimulateLog(model, truth, options, tools::ReadNoise(noise), {}, [](const TruthSample&) {}));
  log->file = trajectory;
  ParameterSet set = ExactParameters(model, truth);
  set.provenance = tools::Provenance("simulate", vehicle,
                                     {{"trajectory", trajectory}, {"seed", std::to_string(seed)}});
  return {log, set};
}

}  // namespace

void BindAnalysis(py::module_* m) {
  using Release = py::gil_scoped_release;
  py::class_<EstimatorSettings>(*m, "EstimatorSettings")
      .def(py::init([](const std::string& config, double keyframe_rate_hz, double window_s,
                       int threads, const std::vector<std::string>& set) {
        return EstimatorSettings{config, keyframe_rate_hz, window_s, threads, set};
      }));
  py::class_<Found>(*m, "Found")
      .def_readonly("report", &Found::report)
      .def_readonly("table", &Found::table)
      .def_readonly("parameters", &Found::parameters)
      .def_property_readonly("samples", [](const Found& f) { return f.samples.Arrays(); })
      .def_property_readonly("history", [](const Found& f) { return f.history.Arrays(); });
  m->def(
      "calibrate",
      [](const FlightLog& flight, const Vehicle& file_vehicle, const Vehicle& vehicle,
         const std::optional<ParameterSet>& start, const EstimatorSettings& settings,
         double leave_out_s, double position_noise_m, int seed, bool force,
         const py::object& progress) {
        const auto tell = Progress(progress);
        const Release release;
        return CalibrateOne(flight, file_vehicle, vehicle, start, settings, leave_out_s,
                            position_noise_m, seed, force, tell);
      },
      py::arg("flight"), py::arg("file_vehicle"), py::arg("vehicle"), py::arg("start"),
      py::arg("settings"), py::arg("leave_out_s"), py::arg("position_noise_m"), py::arg("seed"),
      py::arg("force"), py::arg("progress"));
  m->def("evaluate", &EvaluateOne, py::arg("flight"), py::arg("file_vehicle"),
         py::arg("parameters"), py::arg("k_f_walk_rate"), py::arg("follow"), py::arg("force"),
         py::call_guard<Release>());
  m->def(
      "close_loop",
      [](const FlightLog& flight, const Vehicle& file_vehicle, const Vehicle& vehicle,
         const std::optional<ParameterSet>& start, const EstimatorSettings& settings,
         double block_s, std::optional<int> most_effects, const std::vector<std::string>& rule_out,
         const std::vector<std::string>& decision, bool force, const py::object& progress) {
        const auto tell = Progress(progress);
        const Release release;
        return CloseOne(flight, file_vehicle, vehicle, start, settings, block_s, most_effects,
                        rule_out, decision, force, tell);
      },
      py::arg("flight"), py::arg("file_vehicle"), py::arg("vehicle"), py::arg("start"),
      py::arg("settings"), py::arg("block_s"), py::arg("most_effects"), py::arg("rule_out"),
      py::arg("decision"), py::arg("force"), py::arg("progress"));
  m->def("simulate", &SimulateOne, py::arg("vehicle"), py::arg("trajectory"), py::arg("duration_s"),
         py::arg("seed"), py::arg("noise"), py::arg("ground_s"), py::arg("log_rate_hz"),
         py::call_guard<Release>());
  m->def("estimator_options", [] { return FormatOptions(OfflineOptions()); });
}

}  // namespace odmc::python
