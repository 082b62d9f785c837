#include "odmc/analysis/inspection_json.h"
#include "odmc/analysis/json.h"
#include "odmc/analysis/parameters_json.h"
#include "odmc/analysis/report.h"
#include "odmc/analysis/timing_report.h"
#include "odmc/analysis/torque_bands_report.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json FlightJson(const FlightFigures& f) {
  return {{"file", f.file},
          {"duration_s", JsonNumber(f.duration_s)},
          {"on_ground_s", JsonNumber(f.on_ground_s)},
          {"keyframes", f.keyframes},
          {"dropped", f.dropped}};
}

Json PredictionJson(const PredictionFigures& f) {
  return {{"force_rmse_N", JsonAxes(f.force_rmse_N)},
          {"predicted_swing_force_rmse_N", JsonAxes(f.predicted_swing_force_rmse_N)},
          {"zero_force_rmse_N", JsonAxes(f.zero_force_rmse_N)},
          {"accelerometer_force_rmse_N", JsonAxes(f.accelerometer_force_rmse_N)},
          {"torque_rmse_Nm", JsonAxes(f.torque_rmse_Nm)},
          {"zero_torque_rmse_Nm", JsonAxes(f.zero_torque_rmse_Nm)},
          {"rotor_torque_gain", JsonAxes(f.rotor_torque_gain)},
          {"angular_acceleration_rmse_rad_s2", JsonAxes(f.angular_acceleration_rmse_rad_s2)},
          {"force_explained", JsonAxes(f.force_explained)},
          {"torque_explained", JsonAxes(f.torque_explained)},
          {"inertia_over_nominal", JsonAxes(f.inertia_over_nominal)}};
}

Json TimingJson(const TimingFigures& f, int states, int threads) {
  return {{"median", JsonNumber(f.median)},
          {"p95", JsonNumber(f.p95)},
          {"p99", JsonNumber(f.p99)},
          {"max", JsonNumber(f.max)},
          {"updates", f.updates},
          {"states_in_window", states},
          {"threads", threads}};
}

Json PhasesJson(const std::vector<PhaseSpan>& phases, Stamp zero) {
  Json json = Json::array();
  for (const PhaseSpan& p : phases) {
    json.push_back({{"phase", Name(p.phase)},
                    {"from_s", JsonNumber(ToSeconds(p.from - zero))},
                    {"to_s", JsonNumber(ToSeconds(p.to - zero))},
                    {"teaches", Teaches(p.phase)},
                    {"thrust_over_weight", JsonNumber(p.thrust_ratio)},
                    {"missing_force_over_weight", JsonNumber(p.missing_force)}});
  }
  return json;
}

Json PredictionCounts(const PredictionFigures& f) {
  return {{"prediction_samples", f.samples},
          {"prediction_near_gaps", f.left_out_gaps},
          {"prediction_on_ground", f.left_out_ground}};
}

Json RecordedPointJson(const RecordedPoint& point, const TakenPoint& taken) {
  if (!point.p_m) return {{"value_m", nullptr}, {"why", point.why}};
  Json names = Json::array();
  for (const auto& entry : taken.point) names.push_back(entry.first);
  return {{"value_m", JsonAxes(point.p_m)},
          {"sigma_m", JsonAxes(Eigen::Vector3d(point.covariance.diagonal().cwiseSqrt()))},
          {"low_Hz", point.low_Hz},
          {"high_Hz", point.high_Hz},
          {"flight_s", point.flight_s},
          {"taken", names}};
}

}  // namespace

std::string CalibrationReport(const Calibration& c, const DynamicModel& model) {
  Json json;
  json["vehicle"] = model.vehicle().name;
  json["effects"] = model.effect_names();
  json["flight"] = FlightJson(c.flight);
  Json convergence = Json::object();
  for (size_t i = 0; i < c.parameters.parameters.size(); ++i) {
    convergence[c.parameters.parameters[i].full_name] = JsonNumber(c.convergence_s[i]);
  }
  json["parameters"] = ParametersJson(c.parameters.parameters, model);
  json["convergence_s"] = convergence;
  json["prediction"] = PredictionJson(c.prediction.figures);
  json["inertia_by_band"] = TorqueBandsJson(c.bands, c.nominal_inertia);
  json["taken_from_bands"] = Json::array();
  for (const auto& entry : c.by_bands) json["taken_from_bands"].push_back(entry.first);
  json["recorded_point"] = RecordedPointJson(c.point, c.taken_point);
  if (c.left_out) {
    json["prediction_left_out"] = PredictionJson(c.left_out->figures);
    json["prediction_left_out"]["block_s"] = c.left_out->block_s;
  }
  json["timing_ms"] = TimingJson(c.wall, c.states_in_window, c.threads);
  json["timing_cpu_ms"] = TimingJson(c.cpu, c.states_in_window, c.threads);
  json["timing_start_ms"] = QuantilesJson(c.wall_start);
  json["timing_start_ms"]["updates"] = c.wall_start.updates;
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
  return JsonText(json);
}

std::string EvaluationReport(const Evaluation& e, const DynamicModel& model) {
  Json json;
  json["vehicle"] = model.vehicle().name;
  json["effects"] = model.effect_names();
  json["flight"] = FlightJson(e.flight);
  json["followed"] = e.followed;
  json["prediction"] = PredictionJson(e.prediction.figures);
  json["inertia_by_band"] = TorqueBandsJson(e.bands, e.nominal_inertia);
  json["trust"] = Name(TrustOf(e.findings));
  json["trust_reasons"] = TrustReasons(e.findings);
  json["findings"] = FindingsJson(e.findings);
  json["time_offsets"] = TimeOffsetsJson(e.time_offsets);
  json["warnings"] = e.warnings;
  json["left_out"] = PredictionCounts(e.prediction.figures);
  return JsonText(json);
}

}  // namespace odmc
