#include <nlohmann/json.hpp>

#include "odmc/bench/experiments.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json ToJson(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

Json ToJson(const VariantFigures& figures) {
  Json json;
  json["rmse_m"] = ToJson(figures.rmse_m);
  json["max_m"] = ToJson(figures.max_m);
  json["spread_m"] = ToJson(figures.spread_m);
  json["seeds"] = figures.seeds;
  json["crashes"] = figures.crashes;
  if (figures.recovery_s >= 0.0) {
    json["recovery_s"] = figures.recovery_s;
    json["recovery_max_s"] = figures.recovery_max_s;
  }
  if (figures.has_torque) json["torque_rmse_Nm"] = ToJson(figures.torque_rmse_Nm);
  json["first_accepted_s"] = figures.first_accepted_s;
  json["control_ms_p99"] = figures.control_ms_p99;
  if (!figures.crash_reports.empty()) json["crash_reports"] = figures.crash_reports;
  return json;
}

}  // namespace

std::string ExperimentReport(const std::vector<Experiment>& experiments) {
  Json report;
  for (const Experiment& experiment : experiments) {
    for (const std::string& variant : experiment.variants) {
      report[experiment.name][variant] = ToJson(experiment.figures.at(variant));
    }
  }
  return report.dump(2) + "\n";
}

std::string ExperimentTable(const std::vector<Experiment>& experiments) {
  std::string table =
      "experiment         variant        RMSE x    y    z [cm]   spread x    y    z [cm]"
      "    max x     y     z [cm]  crashes  torque RMSE y [N m]  recovery [s]\n";
  for (const Experiment& experiment : experiments) {
    for (const std::string& variant : experiment.variants) {
      const VariantFigures& f = experiment.figures.at(variant);
      const Eigen::Vector3d rmse = 100.0 * f.rmse_m, spread = 100.0 * f.spread_m,
                            max = 100.0 * f.max_m;
      table += Format(
          "%-18s %-14s %6.2f %5.2f %5.2f     %6.2f %5.2f %5.2f      %5.1f %5.1f %5.1f"
          "    %3d/%-3d",
          experiment.name.c_str(), variant.c_str(), rmse.x(), rmse.y(), rmse.z(), spread.x(),
          spread.y(), spread.z(), max.x(), max.y(), max.z(), f.crashes, f.seeds);
      table += f.has_torque ? Format("  %19.5f", f.torque_rmse_Nm.y()) : std::string(21, ' ');
      if (f.recovery_s >= 0.0) table += Format("  %12.1f", f.recovery_s);
      table += "\n";
    }
  }
  return table;
}

std::string TrackingCsv(const ControlledFlight& flight) {
  std::string csv =
      "t_s,counts,ref_x_m,ref_y_m,ref_z_m,p_x_m,p_y_m,p_z_m,v_x_m_s,v_y_m_s,v_z_m_s,handover\n";
  for (const TrackingSample& s : flight.samples) {
    csv += Format("%.3f,%d,%.5f,%.5f,%.5f,%.5f,%.5f,%.5f,%.4f,%.4f,%.4f,%s\n", s.t_s, s.counts,
                  s.p_WB_ref.x(), s.p_WB_ref.y(), s.p_WB_ref.z(), s.p_WB.x(), s.p_WB.y(),
                  s.p_WB.z(), s.v_WB.x(), s.v_WB.y(), s.v_WB.z(), NameOf(s.handover));
  }
  return csv;
}

}  // namespace odmc
