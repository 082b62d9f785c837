#include <cmath>
#include <nlohmann/json.hpp>

#include "odmc/analysis/inspection_json.h"
#include "odmc/analysis/report.h"
#include "odmc/analysis/torque_bands_report.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json Number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json Number(const std::optional<double>& value) { return value ? Number(*value) : Json(nullptr); }

Json Axes(const PredictionFigures::Axes& value) {
  if (!value) return nullptr;
  return Json::array({Number(value->x()), Number(value->y()), Number(value->z())});
}

/// Text of any bytes: what is not UTF-8 (a file name may be) is replaced.
std::string Dump(const Json& json) {
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

Json FlightJson(const FlightFigures& f) {
  return {{"file", f.file},
          {"duration_s", Number(f.duration_s)},
          {"on_ground_s", Number(f.on_ground_s)},
          {"keyframes", f.keyframes},
          {"dropped", f.dropped}};
}

Json PredictionJson(const PredictionFigures& f) {
  return {{"force_rmse_N", Axes(f.force_rmse_N)},
          {"predicted_swing_force_rmse_N", Axes(f.predicted_swing_force_rmse_N)},
          {"zero_force_rmse_N", Axes(f.zero_force_rmse_N)},
          {"accelerometer_force_rmse_N", Axes(f.accelerometer_force_rmse_N)},
          {"torque_rmse_Nm", Axes(f.torque_rmse_Nm)},
          {"zero_torque_rmse_Nm", Axes(f.zero_torque_rmse_Nm)},
          {"rotor_torque_gain", Axes(f.rotor_torque_gain)},
          {"angular_acceleration_rmse_rad_s2", Axes(f.angular_acceleration_rmse_rad_s2)},
          {"force_explained", Axes(f.force_explained)},
          {"torque_explained", Axes(f.torque_explained)},
          {"inertia_over_nominal", Axes(f.inertia_over_nominal)}};
}

Json TimingJson(const TimingFigures& f, int states, int threads) {
  return {{"median", Number(f.median)}, {"p95", Number(f.p95)}, {"p99", Number(f.p99)},
          {"max", Number(f.max)},       {"updates", f.updates}, {"states_in_window", states},
          {"threads", threads}};
}

Json QuantilesJson(const TimingFigures& f) {
  return {{"median", Number(f.median)},
          {"p95", Number(f.p95)},
          {"p99", Number(f.p99)},
          {"max", Number(f.max)}};
}

Json StagesJson(const BenchmarkRow& row) {
  Json json = Json::object();
  for (size_t i = 0; i < kUpdateStages.size(); ++i) {
    json[kUpdateStages[i].name] = QuantilesJson(row.stages[i]);
  }
  return json;
}

Json WorkJson(const std::optional<IncrementalWork>& work) {
  if (!work) return nullptr;
  return {{"aligned_share", Number(work->aligned_share)},
          {"sweeping_share", Number(work->sweeping_share)},
          {"eliminated_median", Number(work->eliminated_median)}};
}

Json ComparisonJson(const std::optional<SolverComparison>& c) {
  if (!c) return nullptr;
  Json json = {{"compared", c->compared}, {"failed", c->failed}};
  if (c->compared == 0) return json;
  json["largest_parameter_difference_sigma"] = Number(c->largest_parameter_difference);
  json["p95_parameter_difference_sigma"] = Number(c->p95_parameter_difference);
  json["parameter"] = c->parameter;
  json["parameter_at_s"] = Number(c->parameter_at_s);
  json["largest_sigma_difference"] = Number(c->largest_sigma_difference);
  json["p95_sigma_difference"] = Number(c->p95_sigma_difference);
  json["sigma_parameter"] = c->sigma_parameter;
  json["sigma_parameter_at_s"] = Number(c->sigma_parameter_at_s);
  return json;
}

Json PhasesJson(const std::vector<PhaseSpan>& phases, Stamp zero) {
  Json json = Json::array();
  for (const PhaseSpan& p : phases) {
    json.push_back({{"phase", Name(p.phase)},
                    {"from_s", Number(ToSeconds(p.from - zero))},
                    {"to_s", Number(ToSeconds(p.to - zero))},
                    {"teaches", Teaches(p.phase)},
                    {"thrust_over_weight", Number(p.thrust_ratio)},
                    {"missing_force_over_weight", Number(p.missing_force)}});
  }
  return json;
}

Json PredictionCounts(const PredictionFigures& f) {
  return {{"prediction_samples", f.samples},
          {"prediction_near_gaps", f.left_out_gaps},
          {"prediction_on_ground", f.left_out_ground}};
}

}  // namespace

std::string CalibrationReport(const Calibration& c, const DynamicModel& model) {
  Json json;
  json["vehicle"] = model.vehicle().name;
  json["effects"] = model.effect_names();
  json["flight"] = FlightJson(c.flight);
  Json parameters = Json::object(), convergence = Json::object();
  for (size_t i = 0; i < c.parameters.parameters.size(); ++i) {
    const ParameterEstimate& p = c.parameters.parameters[i];
    parameters[p.full_name] = {{"value", Number(p.value)},
                               {"sigma", Number(p.estimated ? p.sigma : 0.0)},
                               {"unit", p.unit},
                               {"state", p.estimated ? "estimated" : "frozen"},
                               {"observable", p.observable}};
    convergence[p.full_name] = Number(c.convergence_s[i]);
  }
  json["parameters"] = parameters;
  json["convergence_s"] = convergence;
  json["prediction"] = PredictionJson(c.prediction.figures);
  json["inertia_by_band"] = TorqueBandsJson(c.bands, c.nominal_inertia);
  if (c.left_out) {
    json["prediction_left_out"] = PredictionJson(c.left_out->figures);
    json["prediction_left_out"]["block_s"] = c.left_out->block_s;
  }
  json["timing_ms"] = TimingJson(c.wall, c.states_in_window, c.threads);
  json["timing_cpu_ms"] = TimingJson(c.cpu, c.states_in_window, c.threads);
  json["phases"] = PhasesJson(c.replay.phases, c.first_stamp);
  json["trust"] = Name(TrustOf(c.findings));
  json["trust_reasons"] = TrustReasons(c.findings);
  json["findings"] = FindingsJson(c.findings);
  json["time_offsets"] = TimeOffsetsJson(c.time_offsets);
  json["warnings"] = c.warnings;
  json["unobservable"] = c.replay.last->unobservable;
  Json left_out = PredictionCounts(c.prediction.figures);
  const EstimatorCounters& counters = c.replay.counters;
  const SynchroniserCounters& streams = c.replay.stream_counters;
  left_out["ground_keyframes"] = counters.ground_keyframes;
  left_out["taken_back"] = counters.taken_back;
  left_out["gaps"] = counters.gaps;
  left_out["jumps"] = counters.jumps;
  left_out["refused_updates"] = counters.refused_updates;
  left_out["not_finite"] = streams.not_finite;
  left_out["glitches"] = streams.glitches;
  left_out["out_of_order"] = streams.out_of_order;
  left_out["repeated_poses"] = streams.repeated_pose;
  left_out["keyframes_without_all_streams"] = streams.uncovered;
  json["left_out"] = left_out;
  return Dump(json);
}

std::string EvaluationReport(const Evaluation& e, const DynamicModel& model) {
  Json json;
  json["vehicle"] = model.vehicle().name;
  json["effects"] = model.effect_names();
  json["flight"] = FlightJson(e.flight);
  json["prediction"] = PredictionJson(e.prediction.figures);
  json["inertia_by_band"] = TorqueBandsJson(e.bands, e.nominal_inertia);
  json["trust"] = Name(TrustOf(e.findings));
  json["trust_reasons"] = TrustReasons(e.findings);
  json["findings"] = FindingsJson(e.findings);
  json["time_offsets"] = TimeOffsetsJson(e.time_offsets);
  json["warnings"] = e.warnings;
  json["left_out"] = PredictionCounts(e.prediction.figures);
  return Dump(json);
}

std::string RecoveryReport(const Recovery& recovery, const RecoveryOptions& options,
                           const Vehicle& vehicle) {
  Json parameters = Json::object();
  for (const ParameterRecovery& p : recovery.parameters) {
    parameters[p.full_name] = {{"unit", p.unit},
                               {"truth", Number(p.truth)},
                               {"median_error", Number(p.median_error)},
                               {"median_relative_error", Number(p.median_relative_error)},
                               {"median_error_over_sigma", Number(p.median_error_over_sigma)},
                               {"coverage_3sigma", Number(p.coverage_3sigma)},
                               {"observable_share", Number(p.observable_share)}};
  }
  Json json;
  json["vehicle"] = vehicle.name;
  json["effects"] = vehicle.effects;
  json["recovery"] = {{"trajectory", options.simulation.trajectory},
                      {"seeds", options.seeds},
                      {"duration_s", options.simulation.duration_s},
                      {"pooled_coverage_3sigma", Number(recovery.pooled_coverage_3sigma)},
                      {"parameters", parameters}};
  if (options.start_thrust_factor > 0.0) {
    json["recovery"]["start_thrust_factor"] = options.start_thrust_factor;
  }
  return Dump(json);
}

std::string BenchmarkReport(const std::vector<BenchmarkRow>& rows, const FlightLog& log,
                            const Vehicle& vehicle) {
  Json json;
  json["vehicle"] = vehicle.name;
  json["flight"] = {{"file", log.file}};
  json["benchmark"] = Json::array();
  for (const BenchmarkRow& row : rows) {
    json["benchmark"].push_back({{"solver", row.solver},
                                 {"window_s", row.window_s},
                                 {"keyframe_rate_hz", row.keyframe_rate_hz},
                                 {"states", row.states_in_window},
                                 {"threads", row.threads},
                                 {"updates", row.wall.updates},
                                 {"wall_ms", QuantilesJson(row.wall)},
                                 {"cpu_ms", QuantilesJson(row.cpu)},
                                 {"stages_wall_ms", StagesJson(row)},
                                 {"real_time_factor", Number(row.real_time_factor)},
                                 {"incremental", WorkJson(row.work)},
                                 {"comparison", ComparisonJson(row.comparison)}});
  }
  return Dump(json);
}

}  // namespace odmc
