#include <algorithm>

#include "odmc/analysis/report.h"
#include "odmc/analysis/timing_report.h"
#include "odmc/analysis/torque_bands_report.h"
#include "odmc/text/format.h"
#include "odmc/text/table.h"

namespace odmc {
namespace {

void AddAxes(const std::string& name, const std::string& unit, const PredictionFigures::Axes& axes,
             std::vector<TableRow>* rows) {
  TableRow row = {name, unit};
  for (int i = 0; i < 3; ++i) row.push_back(axes ? Rounded((*axes)[i], 4) : "-");
  rows->push_back(row);
}

/// Error of the force, and that without what its measured swing gives away.
void AddForce(const PredictionFigures& f, std::vector<TableRow>* rows) {
  AddAxes("force RMSE", "N", f.force_rmse_N, rows);
  if (f.GivesAway()) AddAxes("  with predicted swing", "N", f.predicted_swing_force_rmse_N, rows);
}

std::string PredictionTable(const PredictionFigures& f) {
  std::vector<TableRow> rows = {{"prediction", "unit", "x", "y", "z"}};
  AddForce(f, &rows);
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
  return AlignColumns(rows, 2) + std::to_string(f.samples) + " samples, " +
         std::to_string(f.left_out_gaps) + " near gaps and " + std::to_string(f.left_out_ground) +
         " on the ground left out\n";
}

std::string LeftOutTable(const LeftOutPrediction& left_out) {
  const PredictionFigures& f = left_out.figures;
  std::vector<TableRow> rows = {
      {"blocks of " + Rounded(left_out.block_s, 4) + " s left out in turn", "unit", "x", "y", "z"}};
  AddForce(f, &rows);
  AddAxes("torque RMSE", "N m", f.torque_rmse_Nm, &rows);
  AddAxes("  rotor torque gain", "", f.rotor_torque_gain, &rows);
  AddAxes("angular acceleration RMSE", "rad/s^2", f.angular_acceleration_rmse_rad_s2, &rows);
  return AlignColumns(rows, 2);
}

std::string FlightLine(const FlightFigures& f) {
  return f.file + ": " + Fixed(f.duration_s, 1) + " s, " + Fixed(f.on_ground_s, 1) +
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

}  // namespace

std::string CalibrationTable(const Calibration& c) {
  std::vector<TableRow> rows = {
      {"parameter", "unit", "state", "observable", "value", "sigma", "converged [s]"}};
  for (size_t i = 0; i < c.parameters.parameters.size(); ++i) {
    const ParameterEstimate& p = c.parameters.parameters[i];
    rows.push_back({p.full_name, p.unit, p.estimated ? "estimated" : "frozen",
                    p.estimated ? (p.observable ? "yes" : "no") : "-", Rounded(p.value, 5),
                    p.estimated ? Rounded(p.sigma, 2) : "-", Fixed(c.convergence_s[i], 2)});
  }
  std::string text = FlightLine(c.flight) + "\n" + AlignColumns(rows, 4);
  for (const std::string& direction : c.replay.last->unobservable) {
    text += "not observable: " + direction + "\n";
  }
  const std::vector<TableRow> timing = {
      {"update, " + std::to_string(c.states_in_window) + " states, " + std::to_string(c.threads) +
           (c.threads == 1 ? " thread" : " threads"),
       "median", "p95", "p99", "max", "updates"},
      TimingRow({"wall [ms]"}, c.wall),
      TimingRow({"CPU [ms]"}, c.cpu),
      TimingRow({"wall, first " + Fixed(kTimingStart_s, 0) + " s of flight [ms]"}, c.wall_start)};
  text += "\n" + PredictionTable(c.prediction.figures);
  text += "\n" + TorqueBandsTable(c.bands, c.nominal_inertia);
  for (const auto& [name, setting] : c.by_bands) text += "taken from bands: " + name + "\n";
  for (const auto& [name, setting] : c.taken_point.point) {
    text += "taken from the force by frequency: " + name + " = " + Rounded(*setting.value) +
            " +- " + Rounded(*setting.sigma) + " m\n";
  }
  if (c.left_out) text += "\n" + LeftOutTable(*c.left_out);
  return text + "\n" + AlignColumns(timing, 1) + WarningLines(c.warnings) +
         TrustLines(c.findings, c.warnings);
}

std::string EvaluationTable(const Evaluation& e) {
  const std::string followed =
      e.followed.empty()
          ? ""
          : Listed(e.followed) + ": learned on this flight, each sample from what was before it\n";
  return FlightLine(e.flight) + followed + "\n" + PredictionTable(e.prediction.figures) + "\n" +
         TorqueBandsTable(e.bands, e.nominal_inertia) + WarningLines(e.warnings) +
         TrustLines(e.findings, e.warnings);
}

}  // namespace odmc
