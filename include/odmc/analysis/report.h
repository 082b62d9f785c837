#pragma once

#include <memory>
#include <string>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/sim/truth_sample.h"

namespace odmc {

/// \file
/// What the tools found, as report.json, CSV files and text tables. What can't be had is null or an
/// empty cell, never NaN.

// ---- report.json -------------------------------------------------------------------------------

std::string CalibrationReport(const Calibration& calibration, const DynamicModel& model);
std::string EvaluationReport(const Evaluation& evaluation, const DynamicModel& model);

// ---- Tables for a terminal ---------------------------------------------------------------------

std::string CalibrationTable(const Calibration& calibration);
std::string EvaluationTable(const Evaluation& evaluation);

// ---- CSV files; all throw std::runtime_error if the file cannot be written ---------------------

class CsvFile;

/// Rows that are written as they come; the first one makes the file. One that is never closed is
/// removed: it is not whole.
class PredictionFile {
 public:
  /// Columns t_s, speed_m_s, measured_ and predicted_ force_x_N.., torque_x_Nm..,
  /// angular_acceleration_x_rad_s2.., EFFECT_force_x_N.., EFFECT_torque_x_Nm.. (about Bcm, axes of
  /// the model's body frame).
  /// @param with_torque false leaves torques and angular accelerations empty
  PredictionFile(const std::string& file, bool with_torque);
  ~PredictionFile();

  void Add(const PredictionSample& sample);
  void Close();

 private:
  void WriteHeader(const std::vector<EffectWrench>& effects);

  std::string file_;
  bool with_torque_;
  std::unique_ptr<CsvFile> csv_;
};

/// The same for the simulator's truth: t, on_ground, p, q, v (W), w, dw (B), speeds and commands of
/// the rotors, force, torque, and the share of both that the model does not make.
class TruthFile {
 public:
  explicit TruthFile(const std::string& file);
  ~TruthFile();

  void Add(const TruthSample& sample);
  void Close();

 private:
  void WriteHeader(Eigen::Index rotors);

  std::string file_;
  std::unique_ptr<CsvFile> csv_;
};

/// t_s, airborne, NAME and NAME_sigma of every parameter after each update; two rows per stand on
/// the ground hold what was known.
void WriteHistory(const Calibration& calibration, const FlightLog& log, const DynamicModel& model,
                  const std::string& file);

/// t_s, height_m, speed_m_s, thrust_over_weight, missing_force_x_over_weight.. ten times a second:
/// what the phases of the flight were told from.
void WritePhases(const Calibration& calibration, const std::string& file);

/// t_s, wall_ms, cpu_ms, states of every update.
void WriteTiming(const Calibration& calibration, const std::string& file);

/// Writes a text to a file.
void WriteText(const std::string& text, const std::string& file);

}  // namespace odmc
