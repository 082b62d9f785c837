#include "odmc/identification/actuator_calibration.h"

#include <algorithm>
#include <cmath>

#include "odmc/text/format.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

// k_m = S_2 J: all a spin-up says about torque.                           model.md section 11
std::optional<MeasuredValue> TorqueOfInertia(const ActuatorFit& fit,
                                             const std::optional<MeasuredValue>& inertia) {
  if (!inertia) return std::nullopt;
  for (const ActuatorParameter& p : fit.common.parameters) {
    if (p.name != "S_2" || !p.found) continue;
    const double value = p.found->value * inertia->value;
    const double share =
        std::hypot(p.found->sigma / p.found->value, inertia->sigma / inertia->value);
    return MeasuredValue{value, share * value};
  }
  return std::nullopt;
}

FreeRunError Together(const std::vector<MotorFit>& motors) {
  FreeRunError all;
  double steady = 0.0, response = 0.0;
  for (const MotorFit& motor : motors) {
    const FreeRunError& e = motor.error;
    steady += e.steady_rad_s * e.steady_rad_s * static_cast<double>(e.steady);
    response += e.response_rad_s * e.response_rad_s * static_cast<double>(e.response);
    all.steady += e.steady;
    all.response += e.response;
    all.outliers += e.outliers;
    all.speed_range_rad_s += e.speed_range_rad_s / static_cast<double>(motors.size());
    all.mean_speed_rad_s += e.mean_speed_rad_s / static_cast<double>(motors.size());
  }
  const auto rms = [](double squares, long n) {
    return n > 0 ? std::sqrt(squares / static_cast<double>(n)) : 0.0;
  };
  all.steady_rad_s = rms(steady, all.steady);
  all.response_rad_s = rms(response, all.response);
  all.all_rad_s = rms(steady + response, all.steady + all.response);
  return all;
}

std::vector<std::string> Warnings(const std::vector<BenchRun>& runs, const ActuatorCalibration& c) {
  std::vector<std::string> warnings;
  for (const BenchRun& run : runs) {
    if (run.zero_speed > 0) {
      warnings.push_back(run.file + ": left out " + std::to_string(run.zero_speed) +
                         " speeds of 0 in " + std::to_string(run.rows) + " rows");
    }
    if (run.dropped > 0) {
      warnings.push_back(run.file + ": left out " + std::to_string(run.dropped) +
                         " rows that are short, have no command, or step back in time");
    }
  }
  if (!c.fit.has_time)
    warnings.push_back("rows without times are steady readings: dynamics are not identifiable");
  if (!c.fit.uses_voltage)
    warnings.push_back(
        "no battery voltage: the map from command to speed holds for that of the run");
  for (size_t k = 0; c.torque && k < c.torque->offsets.size(); ++k) {
    const MeasuredValue& offset = c.torque->offsets[k];
    if (std::abs(offset.value) <= 2.0 * offset.sigma) continue;
    warnings.push_back(
        runs[k].file +
        Format(": the torque cell has an offset of %.3g +- %.1g N m, which is taken off",
               offset.value, offset.sigma));
  }
  for (const ActuatorParameter& p : c.parameters) {
    if (p.name != "delay_s" || !p.found || p.found->value > -2.0 * p.found->sigma) continue;
    warnings.push_back(
        Format("speeds answer %.1f +- %.1f ms before their command: stamps are off by "
               "at least that",
               -1e3 * p.found->value, 1e3 * p.found->sigma));
  }
  if (c.error.outliers > 0)
    warnings.push_back("left out " + std::to_string(c.error.outliers) + " outliers among " +
                       std::to_string(c.error.steady + c.error.response + c.error.outliers) +
                       " speeds");
  return warnings;
}

}  // namespace

bool HasSpeeds(const BenchRun& run) {
  return std::any_of(run.speed_rad_s.begin(), run.speed_rad_s.end(), [](const auto& speed) {
    return std::any_of(speed.begin(), speed.end(), [](double s) { return std::isfinite(s); });
  });
}

ActuatorCalibration CalibrateActuator(const std::vector<BenchRun>& all_runs,
                                      const std::optional<MeasuredValue>& rotor_inertia_kg_m2) {
  ActuatorCalibration c;
  std::vector<BenchRun> runs;
  for (const BenchRun& run : all_runs) {
    if (HasSpeeds(run)) runs.push_back(run);
  }
  if (runs.empty()) runs = all_runs;  // which is an error
  c.fit = IdentifyActuator(runs);
  c.thrust = FitThrust(runs);
  c.torque = FitTorque(runs);
  c.rotor_inertia_kg_m2 = rotor_inertia_kg_m2;
  ActuatorParameter k_f = {"k_f", "N s^2", std::nullopt}, k_m = {"k_m", "N m s^2", std::nullopt};
  if (c.thrust && c.thrust->coefficient.value > 0.0) k_f.found = c.thrust->coefficient;
  if (c.torque && c.torque->coefficient.value > 0.0) k_m.found = c.torque->coefficient;
  if (!k_m.found) k_m.found = TorqueOfInertia(c.fit, rotor_inertia_kg_m2);
  c.parameters = {k_f, k_m};
  c.parameters.insert(c.parameters.end(), c.fit.common.parameters.begin(),
                      c.fit.common.parameters.end());
  c.error = Together(c.fit.motors);
  c.warnings = Warnings(runs, c);
  if (!k_m.found)
    c.warnings.push_back(
        "k_m = S_2 J needs the rotor's inertia J (--rotor-inertia, or the blade's mass and length) "
        "or "
        "a torque sensor");
  for (const BenchRun& run : all_runs) {
    if (!HasSpeeds(run)) c.warnings.push_back(run.file + ": left out, has no speed above 0");
  }
  return c;
}

Actuator ActuatorOf(const ActuatorCalibration& c) {
  Actuator actuator;
  actuator.command_unit = c.fit.command_unit;
  actuator.uses_voltage = c.fit.uses_voltage;
  actuator.knows_dynamics = c.fit.has_time;
  for (const MotorFit& motor : c.fit.motors) actuator.motors.push_back(motor.motor);
  actuator.sigma_steady_rad_s = c.error.steady_rad_s;
  actuator.sigma_response_rad_s = c.error.response_rad_s;
  for (const ActuatorParameter& p : c.parameters) {
    if (p.name == "k_f") actuator.k_f = p.found;
    if (p.name == "k_m") actuator.k_m = p.found;
  }
  return actuator;
}

std::vector<FreeRunError> EvaluateActuator(const Actuator& actuator, const BenchRun& run) {
  const auto known = static_cast<int>(actuator.motors.size());
  if (known != 1 && known != run.num_motors()) {
    RefuseFile(run.file, "has " + std::to_string(run.num_motors()) + " motors, the fit has " +
                             std::to_string(known));
  }
  if (actuator.uses_voltage && run.voltage_V.empty())
    RefuseFile(run.file, "has no battery voltage, which the fit needs");
  std::vector<FreeRunError> errors;
  for (int j = 0; j < run.num_motors(); ++j) {
    MotorSignal signal = SignalOf(run, j, actuator.uses_voltage);
    if (!actuator.knows_dynamics) signal.t_s.clear();
    errors.push_back(ErrorOfFreeRun(actuator.MotorOf(j), {signal}));
  }
  return errors;
}

}  // namespace odmc
