#include <algorithm>
#include <cmath>
#include <cstdio>

#include "odmc/analysis/report.h"
#include "odmc/analysis/torque_bands_report.h"

namespace odmc {
namespace {

using Row = std::vector<std::string>;

std::string Text(double value, const char* format = "%.4g") {
  if (!std::isfinite(value)) return "-";
  char text[40];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string Text(const std::optional<double>& value, const char* format = "%.4g") {
  return value ? Text(*value, format) : "-";
}

/// Columns aligned: the first `left` to the left, numbers to the right.
std::string Align(const std::vector<Row>& rows, size_t left) {
  std::vector<size_t> widths;
  for (const Row& row : rows) {
    widths.resize(std::max(widths.size(), row.size()));
    for (size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  }
  std::string text;
  for (const Row& row : rows) {
    std::string line;
    for (size_t i = 0; i < row.size(); ++i) {
      const std::string pad(widths[i] - row[i].size(), ' ');
      line += (i > 0 ? "  " : "") + (i < left ? row[i] + pad : pad + row[i]);
    }
    text += line.substr(0, line.find_last_not_of(' ') + 1) + "\n";
  }
  return text;
}

void AddAxes(const std::string& name, const std::string& unit, const PredictionFigures::Axes& axes,
             std::vector<Row>* rows) {
  Row row = {name, unit};
  for (int i = 0; i < 3; ++i) row.push_back(axes ? Text((*axes)[i]) : "-");
  rows->push_back(row);
}

/// True if the measured angular acceleration tells a part of the force that is to be predicted.
bool GivesAway(const PredictionFigures& f) {
  constexpr double kShown = 0.01;  // of the error
  if (!f.force_rmse_N || !f.predicted_swing_force_rmse_N) return false;
  const Eigen::Vector3d more = *f.predicted_swing_force_rmse_N - *f.force_rmse_N;
  return (more.cwiseAbs().array() > kShown * f.force_rmse_N->array()).any();
}

std::string PredictionTable(const PredictionFigures& f) {
  std::vector<Row> rows = {{"prediction", "unit", "x", "y", "z"}};
  AddAxes("force RMSE", "N", f.force_rmse_N, &rows);
  if (GivesAway(f)) AddAxes("  with predicted swing", "N", f.predicted_swing_force_rmse_N, &rows);
  AddAxes("  predicting zero", "N", f.zero_force_rmse_N, &rows);
  AddAxes("  explained", "", f.force_explained, &rows);
  if (f.accelerometer_force_rmse_N) {
    AddAxes("force RMSE by accelerometer", "N", f.accelerometer_force_rmse_N, &rows);
  }
  AddAxes("torque RMSE", "N m", f.torque_rmse_Nm, &rows);
  AddAxes("  predicting zero", "N m", f.zero_torque_rmse_Nm, &rows);
  AddAxes("  explained", "", f.torque_explained, &rows);
  AddAxes("  inertia over nominal", "", f.inertia_over_nominal, &rows);
  AddAxes("  rotor torque gain", "", f.rotor_torque_gain, &rows);
  AddAxes("angular acceleration RMSE", "rad/s^2", f.angular_acceleration_rmse_rad_s2, &rows);
  return Align(rows, 2) + std::to_string(f.samples) + " samples, " +
         std::to_string(f.left_out_gaps) + " near gaps and " + std::to_string(f.left_out_ground) +
         " on the ground left out\n";
}

std::string LeftOutTable(const LeftOut& left_out) {
  const PredictionFigures& f = left_out.figures;
  std::vector<Row> rows = {
      {"blocks of " + Text(left_out.block_s) + " s left out in turn", "unit", "x", "y", "z"}};
  AddAxes("force RMSE", "N", f.force_rmse_N, &rows);
  AddAxes("torque RMSE", "N m", f.torque_rmse_Nm, &rows);
  AddAxes("  rotor torque gain", "", f.rotor_torque_gain, &rows);
  AddAxes("angular acceleration RMSE", "rad/s^2", f.angular_acceleration_rmse_rad_s2, &rows);
  return Align(rows, 2);
}

std::string FlightLine(const FlightFigures& f) {
  return f.file + ": " + Text(f.duration_s, "%.1f") + " s, " + Text(f.on_ground_s, "%.1f") +
         " s on the ground, " + std::to_string(f.keyframes) + " keyframes, " +
         std::to_string(f.dropped) + " samples dropped\n";
}

std::string WarningLines(const std::vector<std::string>& warnings) {
  std::string text = warnings.empty() ? "" : "\n";
  for (const std::string& warning : warnings) text += "warning: " + warning + "\n";
  return text;
}

/// What was found that is no warning, and how far the result may be relied on.
std::string TrustLines(const std::vector<Finding>& findings,
                       const std::vector<std::string>& warnings) {
  std::string text;
  for (const Finding& finding : findings) {
    const std::string sentence = Sentence(finding);
    const bool is_told = std::find(warnings.begin(), warnings.end(), sentence) != warnings.end();
    if (!is_told) text += "note: " + sentence + "\n";
  }
  return text + "\ntrust: " + Name(TrustOf(findings)) + "\n";
}

std::string At(const std::string& parameter, double time_s) {
  return parameter + " at " + Text(time_s, "%.1f") + " s";
}

Row TimingRow(const Row& start, const TimingFigures& f) {
  Row row = start;
  for (const auto& value : {f.median, f.p95, f.p99, f.max}) row.push_back(Text(value, "%.2f"));
  row.push_back(std::to_string(f.updates));
  return row;
}

}  // namespace

std::string CalibrationTable(const Calibration& c) {
  std::vector<Row> rows = {
      {"parameter", "unit", "state", "observable", "value", "sigma", "converged [s]"}};
  for (size_t i = 0; i < c.parameters.parameters.size(); ++i) {
    const ParameterEstimate& p = c.parameters.parameters[i];
    rows.push_back({p.full_name, p.unit, p.estimated ? "estimated" : "frozen",
                    p.estimated ? (p.observable ? "yes" : "no") : "-", Text(p.value, "%.5g"),
                    p.estimated ? Text(p.sigma, "%.2g") : "-", Text(c.convergence_s[i], "%.2f")});
  }
  std::string text = FlightLine(c.flight) + "\n" + Align(rows, 4);
  for (const std::string& direction : c.replay.last->unobservable) {
    text += "not observable: " + direction + "\n";
  }
  const std::vector<Row> timing = {
      {"update, " + std::to_string(c.states_in_window) + " states, " + std::to_string(c.threads) +
           (c.threads == 1 ? " thread" : " threads"),
       "median", "p95", "p99", "max", "updates"},
      TimingRow({"wall [ms]"}, c.wall),
      TimingRow({"CPU [ms]"}, c.cpu)};
  text += "\n" + PredictionTable(c.prediction.figures);
  text += "\n" + TorqueBandsTable(c.bands, c.nominal_inertia);
  if (c.left_out) text += "\n" + LeftOutTable(*c.left_out);
  return text + "\n" + Align(timing, 1) + WarningLines(c.warnings) +
         TrustLines(c.findings, c.warnings);
}

std::string EvaluationTable(const Evaluation& e) {
  return FlightLine(e.flight) + "\n" + PredictionTable(e.prediction.figures) + "\n" +
         TorqueBandsTable(e.bands, e.nominal_inertia) + WarningLines(e.warnings) +
         TrustLines(e.findings, e.warnings);
}

std::string RecoveryTable(const Recovery& recovery) {
  std::vector<Row> rows = {{"parameter", "unit", "truth", "median error", "relative", "error/sigma",
                            "in 3 sigma", "observable"}};
  for (const ParameterRecovery& p : recovery.parameters) {
    rows.push_back(
        {p.full_name, p.unit, Text(p.truth), Text(p.median_error, "%.3g"),
         p.median_relative_error ? Text(100.0 * *p.median_relative_error, "%.2f %%") : "-",
         Text(p.median_error_over_sigma, "%.2f"), Text(p.coverage_3sigma, "%.2f"),
         Text(p.observable_share, "%.2f")});
  }
  return Align(rows, 2) +
         "pooled coverage of 3 sigma: " + Text(recovery.pooled_coverage_3sigma, "%.3f") + "\n";
}

std::string BenchmarkTable(const std::vector<BenchmarkRow>& rows) {
  std::vector<Row> times = {{"solver", "window [s]", "states", "CPU median [ms]", "p95", "p99",
                             "max", "updates", "wall median", "p99", "max", "times real time"}};
  std::vector<Row> stages = {{"median/p99 [ms]", "window [s]"}};
  std::vector<Row> differences = {{"full solves", "window [s]", "compared", "parameters [sigma]",
                                   "p95", "sigmas [%]", "p95", "largest"}};
  for (const UpdateStage& stage : kUpdateStages) stages[0].emplace_back(stage.name);
  for (const BenchmarkRow& row : rows) {
    const std::string window = Text(row.window_s);
    Row time = TimingRow({row.solver, window, std::to_string(row.states_in_window)}, row.cpu);
    for (const auto& ms : {row.wall.median, row.wall.p99, row.wall.max}) {
      time.push_back(Text(ms, "%.2f"));
    }
    time.push_back(Text(row.real_time_factor, "%.1f"));
    times.push_back(time);
    stages.push_back({row.solver, window});
    for (const TimingFigures& f : row.stages) {
      stages.back().push_back(Text(f.median, "%.3f") + "/" + Text(f.p99, "%.3f"));
    }
    if (!row.comparison || row.comparison->compared == 0) continue;
    const SolverComparison& c = *row.comparison;
    differences.push_back(
        {row.solver, window, std::to_string(c.compared),
         Text(c.largest_parameter_difference, "%.3f"), Text(c.p95_parameter_difference, "%.3f"),
         Text(100.0 * c.largest_sigma_difference, "%.2f"),
         Text(100.0 * c.p95_sigma_difference, "%.2f"),
         At(c.parameter, c.parameter_at_s) + ", " + At(c.sigma_parameter, c.sigma_parameter_at_s)});
  }
  std::string text = Align(times, 1) + "\n" + Align(stages, 1);
  if (differences.size() > 1) text += "\n" + Align(differences, 1);
  return text;
}

}  // namespace odmc
