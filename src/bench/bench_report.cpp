#include "odmc/bench/bench_report.h"

#include "odmc/analysis/json.h"
#include "odmc/analysis/timing_report.h"
#include "odmc/text/format.h"
#include "odmc/text/table.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json StagesJson(const BenchmarkRow& row) {
  Json json = Json::object();
  for (size_t i = 0; i < kUpdateStages.size(); ++i) {
    json[kUpdateStages[i].name] = QuantilesJson(row.stages[i]);
  }
  return json;
}

Json WorkJson(const std::optional<IncrementalWork>& work) {
  if (!work) return nullptr;
  return {{"aligned_share", JsonNumber(work->aligned_share)},
          {"sweeping_share", JsonNumber(work->sweeping_share)},
          {"eliminated_median", JsonNumber(work->eliminated_median)}};
}

Json ComparisonJson(const std::optional<SolverComparison>& c) {
  if (!c) return nullptr;
  Json json = {{"compared", c->compared}, {"failed", c->failed}};
  if (c->compared == 0) return json;
  json["largest_parameter_difference_sigma"] = JsonNumber(c->largest_parameter_difference);
  json["p95_parameter_difference_sigma"] = JsonNumber(c->p95_parameter_difference);
  json["parameter"] = c->parameter;
  json["parameter_at_s"] = JsonNumber(c->parameter_at_s);
  json["largest_sigma_difference"] = JsonNumber(c->largest_sigma_difference);
  json["p95_sigma_difference"] = JsonNumber(c->p95_sigma_difference);
  json["sigma_parameter"] = c->sigma_parameter;
  json["sigma_parameter_at_s"] = JsonNumber(c->sigma_parameter_at_s);
  return json;
}

std::string At(const std::string& parameter, double time_s) {
  return parameter + " at " + Fixed(time_s, 1) + " s";
}

}  // namespace

std::string RecoveryReport(const Recovery& recovery, const RecoveryOptions& options,
                           const Vehicle& vehicle) {
  Json parameters = Json::object();
  for (const ParameterRecovery& p : recovery.parameters) {
    parameters[p.full_name] = {{"unit", p.unit},
                               {"truth", JsonNumber(p.truth)},
                               {"median_error", JsonNumber(p.median_error)},
                               {"median_relative_error", JsonNumber(p.median_relative_error)},
                               {"median_error_over_sigma", JsonNumber(p.median_error_over_sigma)},
                               {"coverage_3sigma", JsonNumber(p.coverage_3sigma)},
                               {"observable_share", JsonNumber(p.observable_share)}};
  }
  Json json;
  json["vehicle"] = vehicle.name;
  json["effects"] = vehicle.effects;
  json["recovery"] = {{"trajectory", options.simulation.trajectory},
                      {"seeds", options.seeds},
                      {"duration_s", options.simulation.duration_s},
                      {"pooled_coverage_3sigma", JsonNumber(recovery.pooled_coverage_3sigma)},
                      {"parameters", parameters}};
  if (options.start_thrust_factor > 0.0) {
    json["recovery"]["start_thrust_factor"] = options.start_thrust_factor;
  }
  return JsonText(json);
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
                                 {"start_wall_ms", QuantilesJson(row.wall_start)},
                                 {"start_updates", row.wall_start.updates},
                                 {"stages_wall_ms", StagesJson(row)},
                                 {"real_time_factor", JsonNumber(row.real_time_factor)},
                                 {"incremental", WorkJson(row.work)},
                                 {"comparison", ComparisonJson(row.comparison)}});
  }
  return JsonText(json);
}

std::string RecoveryTable(const Recovery& recovery) {
  std::vector<TableRow> rows = {{"parameter", "unit", "truth", "median error", "relative",
                                 "error/sigma", "in 3 sigma", "observable"}};
  for (const ParameterRecovery& p : recovery.parameters) {
    rows.push_back(
        {p.full_name, p.unit, Rounded(p.truth, 4), Rounded(p.median_error, 3),
         p.median_relative_error ? Fixed(100.0 * *p.median_relative_error, 2) + " %" : "-",
         Fixed(p.median_error_over_sigma, 2), Fixed(p.coverage_3sigma, 2),
         Fixed(p.observable_share, 2)});
  }
  return AlignColumns(rows, 2) +
         "pooled coverage of 3 sigma: " + Fixed(recovery.pooled_coverage_3sigma, 3) + "\n";
}

std::string BenchmarkTable(const std::vector<BenchmarkRow>& rows) {
  std::vector<TableRow> times = {{"solver", "window [s]", "states", "CPU median [ms]", "p95", "p99",
                                  "max", "updates", "wall median", "p99", "max", "start p99",
                                  "start max", "times real time"}};
  std::vector<TableRow> stages = {{"median/p99 [ms]", "window [s]"}};
  std::vector<TableRow> differences = {{"full solves", "window [s]", "compared",
                                        "parameters [sigma]", "p95", "sigmas [%]", "p95",
                                        "largest"}};
  for (const UpdateStage& stage : kUpdateStages) stages[0].emplace_back(stage.name);
  for (const BenchmarkRow& row : rows) {
    const std::string window = Rounded(row.window_s, 4);
    TableRow time = TimingRow({row.solver, window, std::to_string(row.states_in_window)}, row.cpu);
    for (const auto& ms :
         {row.wall.median, row.wall.p99, row.wall.max, row.wall_start.p99, row.wall_start.max}) {
      time.push_back(Fixed(ms, 2));
    }
    time.push_back(Fixed(row.real_time_factor, 1));
    times.push_back(time);
    stages.push_back({row.solver, window});
    for (const TimingFigures& f : row.stages) {
      stages.back().push_back(Fixed(f.median, 3) + "/" + Fixed(f.p99, 3));
    }
    if (!row.comparison || row.comparison->compared == 0) continue;
    const SolverComparison& c = *row.comparison;
    differences.push_back(
        {row.solver, window, std::to_string(c.compared), Fixed(c.largest_parameter_difference, 3),
         Fixed(c.p95_parameter_difference, 3), Fixed(100.0 * c.largest_sigma_difference, 2),
         Fixed(100.0 * c.p95_sigma_difference, 2),
         At(c.parameter, c.parameter_at_s) + ", " + At(c.sigma_parameter, c.sigma_parameter_at_s)});
  }
  std::string text = AlignColumns(times, 1) + "\n" + AlignColumns(stages, 1);
  if (differences.size() > 1) text += "\n" + AlignColumns(differences, 1);
  return text;
}

}  // namespace odmc
