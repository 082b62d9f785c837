#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <stdexcept>
#include <string>
#include <string_view>

#include "odmc/analysis/report.h"

namespace odmc {
namespace {

constexpr int kDigits = 9;

/// A CSV file, cell by cell.
class CsvFile {
 public:
  explicit CsvFile(const std::string& file) : file_(file), out_(file, std::ios::binary) {}

  void Name(const std::string& name) { Cell(name); }
  void Names(const std::string& before, const std::string& letters, const std::string& after) {
    for (const char letter : letters) {
      std::string name = before;
      name += letter;
      name += after;
      Cell(name);
    }
  }
  void Number(double value) {
    if (!std::isfinite(value)) return Cell("");
    char text[40];
    const auto end =
        std::to_chars(text, text + sizeof text, value, std::chars_format::general, kDigits).ptr;
    Cell(std::string_view(text, static_cast<size_t>(end - text)));
  }
  template <typename Derived>
  void Numbers(const Eigen::MatrixBase<Derived>& values) {
    for (Eigen::Index i = 0; i < values.size(); ++i) Number(values[i]);
  }
  void Empty(int count) {
    for (int i = 0; i < count; ++i) Cell("");
  }
  void EndRow() {
    text_ += '\n';
    first_ = true;
    if (text_.size() > kBuffer) Flush();
  }
  void Close() {
    Flush();
    out_.close();
    if (!out_) throw std::runtime_error(file_ + ": cannot be written");
  }

 private:
  static constexpr size_t kBuffer = 1 << 16;

  void Cell(std::string_view text) {
    if (!first_) text_ += ',';
    text_ += text;
    first_ = false;
  }
  void Flush() {
    out_.write(text_.data(), static_cast<std::streamsize>(text_.size()));
    text_.clear();
  }

  std::string file_;
  std::ofstream out_;
  std::string text_;  // rows not written yet
  bool first_ = true;
};

void WriteHistoryRow(double t_s, bool airborne, const ModelValues& values,
                     const Eigen::VectorXd& sigma, CsvFile* csv) {
  csv->Number(t_s);
  csv->Number(airborne ? 1.0 : 0.0);
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    csv->Number(values[i]);
    csv->Number(sigma[i]);
  }
  csv->EndRow();
}

}  // namespace

void WriteHistory(const Calibration& c, const FlightLog& log, const DynamicModel& model,
                  const std::string& file) {
  CsvFile csv(file);
  csv.Name("t_s");
  csv.Name("airborne");
  for (const ModelParameter& p : model.parameters()) {
    csv.Name(p.full_name);
    csv.Name(p.full_name + "_sigma");
  }
  csv.EndRow();
  ModelValues values = model.InitialValues();
  Eigen::VectorXd sigma(model.num_parameters());
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    sigma[i] = p.estimated ? p.spec.prior_sigma : 0.0;
  }
  std::vector<double> ground;
  for (const auto& [first, last] : c.replay.ground_spans) {
    ground.push_back(ToSeconds(first - log.odometry.front().stamp));
    if (last > first) ground.push_back(ToSeconds(last - log.odometry.front().stamp));
  }
  auto next = ground.begin();
  const auto stand_until = [&](double t_s) {
    for (; next != ground.end() && *next < t_s; ++next) {
      WriteHistoryRow(*next, false, values, sigma, &csv);
    }
  };
  for (const HistoryRow& row : c.replay.history) {
    stand_until(c.start_s + row.t_s);
    values = row.values;
    sigma = row.sigma;
    WriteHistoryRow(c.start_s + row.t_s, true, values, sigma, &csv);
  }
  stand_until(c.flight.duration_s + 1.0);
  csv.Close();
}

void WritePhases(const Calibration& c, const std::string& file) {
  CsvFile csv(file);
  for (const char* name : {"t_s", "height_m", "speed_m_s", "thrust_over_weight"}) csv.Name(name);
  csv.Names("missing_force_", "xyz", "_over_weight");
  csv.EndRow();
  for (const PhaseDetector::Seen& seen : c.replay.seen) {
    csv.Number(ToSeconds(seen.stamp - c.first_stamp));
    csv.Number(seen.height_m);
    csv.Number(seen.speed_m_s);
    csv.Number(seen.thrust_ratio);
    for (int i = 0; i < 3; ++i) csv.Number(seen.missing_force[i]);
    csv.EndRow();
  }
  csv.Close();
}

void WritePrediction(const Prediction& prediction, bool with_torque, const std::string& file) {
  CsvFile csv(file);
  csv.Name("t_s");
  csv.Name("speed_m_s");
  for (const std::string what : {"measured", "predicted"}) {
    csv.Names(what + "_force_", "xyz", "_N");
    csv.Names(what + "_torque_", "xyz", "_Nm");
    csv.Names(what + "_angular_acceleration_", "xyz", "_rad_s2");
  }
  if (!prediction.samples.empty()) {
    for (const EffectWrench& effect : prediction.samples.front().effects) {
      csv.Names(effect.effect + "_force_", "xyz", "_N");
      csv.Names(effect.effect + "_torque_", "xyz", "_Nm");
    }
  }
  csv.EndRow();
  const auto rotational = [&](const Eigen::Vector3d& value) {
    with_torque ? csv.Numbers(value) : csv.Empty(3);
  };
  for (const PredictionSample& s : prediction.samples) {
    csv.Number(s.t_s);
    csv.Number(s.speed_m_s);
    csv.Numbers(s.measured_force);
    rotational(s.measured_torque);
    rotational(s.measured_angular_acceleration);
    csv.Numbers(s.predicted_force);
    rotational(s.predicted_torque);
    rotational(s.predicted_angular_acceleration);
    for (const EffectWrench& effect : s.effects) {
      csv.Numbers(effect.f_B);
      rotational(effect.tau_Bcm_B);
    }
    csv.EndRow();
  }
  csv.Close();
}

void WriteTiming(const Calibration& c, const std::string& file) {
  CsvFile csv(file);
  for (const char* name : {"t_s", "wall_ms", "cpu_ms", "states"}) csv.Name(name);
  csv.EndRow();
  for (const auto& [t_s, timing] : c.replay.timing) {
    csv.Number(c.start_s + t_s);
    csv.Number(timing.wall_ms);
    csv.Number(timing.cpu_ms);
    csv.Number(timing.states);
    csv.EndRow();
  }
  csv.Close();
}

void WriteTruth(const SimulatedFlight& flight, const std::string& file) {
  CsvFile csv(file);
  csv.Name("t");
  csv.Name("on_ground");
  csv.Names("p", "xyz", "");
  csv.Names("q", "wxyz", "");
  for (const std::string what : {"v", "w", "dw"}) csv.Names(what, "xyz", "");
  const auto rotors = flight.truth.empty() ? 0 : flight.truth.front().rotor_speed.size();
  for (const std::string what : {"rotor", "rotor_cmd"}) {
    for (Eigen::Index i = 1; i <= rotors; ++i) csv.Name(what + std::to_string(i));
  }
  for (const std::string what : {"f", "tau", "external_f", "external_tau"}) {
    csv.Names(what + "_", "xyz", "");
  }
  csv.EndRow();
  for (const TruthSample& s : flight.truth) {
    csv.Number(ToSeconds(s.stamp));
    csv.Number(s.on_ground ? 1.0 : 0.0);
    csv.Numbers(s.p_WB);
    csv.Numbers(Eigen::Vector4d(s.q_WB.w(), s.q_WB.x(), s.q_WB.y(), s.q_WB.z()));
    csv.Numbers(s.v_WB);
    csv.Numbers(s.w_WB_B);
    csv.Numbers(s.dw_WB_B);
    csv.Numbers(s.rotor_speed);
    csv.Numbers(s.rotor_speed_cmd);
    csv.Numbers(s.f_B);
    csv.Numbers(s.tau_Bcm_B);
    csv.Numbers(s.external_f_B);
    csv.Numbers(s.external_tau_Bcm_B);
    csv.EndRow();
  }
  csv.Close();
}

void WriteText(const std::string& text, const std::string& file) {
  std::ofstream out(file, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw std::runtime_error(file + ": cannot be written");
}

}  // namespace odmc
