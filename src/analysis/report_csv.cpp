#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <string_view>

#include "odmc/analysis/report.h"

namespace odmc {

/// A CSV file, cell by cell; removed where it is not closed.
class CsvFile {
 public:
  explicit CsvFile(const std::string& file) : file_(file), out_(file, std::ios::binary) {}
  ~CsvFile() {
    if (closed_ || !out_.is_open()) return;
    out_.close();
    std::error_code ignored;
    std::filesystem::remove(file_, ignored);
  }
  CsvFile(const CsvFile&) = delete;
  CsvFile& operator=(const CsvFile&) = delete;

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
    closed_ = true;
    if (!out_) throw std::runtime_error(file_ + ": cannot be written");
  }

 private:
  static constexpr int kDigits = 9;
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
  bool first_ = true, closed_ = false;
};

namespace {

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
  for (const auto& [first, last] : NotInFlight(c.replay.phases, 0.0)) {
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

PredictionFile::PredictionFile(const std::string& file, bool with_torque)
    : file_(file), with_torque_(with_torque) {}

PredictionFile::~PredictionFile() = default;

void PredictionFile::WriteHeader(const std::vector<EffectWrench>& effects) {
  csv_ = std::make_unique<CsvFile>(file_);
  csv_->Name("t_s");
  csv_->Name("speed_m_s");
  for (const std::string what : {"measured", "predicted"}) {
    csv_->Names(what + "_force_", "xyz", "_N");
    csv_->Names(what + "_torque_", "xyz", "_Nm");
    csv_->Names(what + "_angular_acceleration_", "xyz", "_rad_s2");
  }
  for (const EffectWrench& effect : effects) {
    csv_->Names(effect.effect + "_force_", "xyz", "_N");
    csv_->Names(effect.effect + "_torque_", "xyz", "_Nm");
  }
  csv_->EndRow();
}

void PredictionFile::Add(const PredictionSample& s) {
  if (csv_ == nullptr) WriteHeader(s.effects);
  const auto rotational = [this](const Eigen::Vector3d& value) {
    with_torque_ ? csv_->Numbers(value) : csv_->Empty(3);
  };
  csv_->Number(s.t_s);
  csv_->Number(s.speed_m_s);
  csv_->Numbers(s.measured_force);
  rotational(s.measured_torque);
  rotational(s.measured_angular_acceleration);
  csv_->Numbers(s.predicted_force);
  rotational(s.predicted_torque);
  rotational(s.predicted_angular_acceleration);
  for (const EffectWrench& effect : s.effects) {
    csv_->Numbers(effect.f_B);
    rotational(effect.tau_Bcm_B);
  }
  csv_->EndRow();
}

void PredictionFile::Close() {
  if (csv_ == nullptr) WriteHeader({});
  csv_->Close();
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

TruthFile::TruthFile(const std::string& file) : file_(file) {}

TruthFile::~TruthFile() = default;

void TruthFile::WriteHeader(Eigen::Index rotors) {
  csv_ = std::make_unique<CsvFile>(file_);
  csv_->Name("t");
  csv_->Name("on_ground");
  csv_->Names("p", "xyz", "");
  csv_->Names("q", "wxyz", "");
  for (const std::string what : {"v", "w", "dw"}) csv_->Names(what, "xyz", "");
  for (const std::string what : {"rotor", "rotor_cmd"}) {
    for (Eigen::Index i = 1; i <= rotors; ++i) csv_->Name(what + std::to_string(i));
  }
  for (const std::string what : {"f", "tau", "external_f", "external_tau"}) {
    csv_->Names(what + "_", "xyz", "");
  }
  csv_->EndRow();
}

void TruthFile::Add(const TruthSample& s) {
  if (csv_ == nullptr) WriteHeader(s.rotor_speed.size());
  csv_->Number(ToSeconds(s.stamp));
  csv_->Number(s.on_ground ? 1.0 : 0.0);
  csv_->Numbers(s.p_WB);
  csv_->Numbers(Eigen::Vector4d(s.q_WB.w(), s.q_WB.x(), s.q_WB.y(), s.q_WB.z()));
  csv_->Numbers(s.v_WB);
  csv_->Numbers(s.w_WB_B);
  csv_->Numbers(s.dw_WB_B);
  csv_->Numbers(s.rotor_speed);
  csv_->Numbers(s.rotor_speed_cmd);
  csv_->Numbers(s.f_B);
  csv_->Numbers(s.tau_Bcm_B);
  csv_->Numbers(s.external_f_B);
  csv_->Numbers(s.external_tau_Bcm_B);
  csv_->EndRow();
}

void TruthFile::Close() {
  if (csv_ == nullptr) WriteHeader(0);
  csv_->Close();
}

void WriteText(const std::string& text, const std::string& file) {
  std::ofstream out(file, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw std::runtime_error(file + ": cannot be written");
}

}  // namespace odmc
