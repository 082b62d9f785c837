#pragma once

#include <string>

namespace odmc {

/// How the optimiser sees a parameter.
enum class ParameterTransform {
  kLinear,  ///< value = scale * eta
  kLog,     ///< value = scale * exp(eta): stays positive (model.md section 7, Scaling)
};

/// What sign a coefficient must have to make physical sense.
enum class PhysicalSign { kAny, kPositive, kNegative };

/// True if `value` has the wrong sign by more than `tolerance` (>= 0, in its unit).
inline bool HasWrongSign(PhysicalSign sign, double value, double tolerance = 0.0) {
  return (sign == PhysicalSign::kPositive && value < -tolerance) ||
         (sign == PhysicalSign::kNegative && value > tolerance);
}

/// Name, unit and prior of one parameter; the only list that files, messages, plots and
/// documentation read.
struct ParameterSpec {
  std::string name;         ///< short name within its effect, as "k_f"
  std::string unit;         ///< SI unit as text, as "N s^2"
  std::string description;  ///< one line for documentation
  double prior_value = 0.0;
  double prior_sigma = 1.0;  ///< in the parameter's unit (also for kLog)
  double scale = 1.0;        ///< natural size, > 0; for kLog the nominal value
  ParameterTransform transform = ParameterTransform::kLinear;
  PhysicalSign sign = PhysicalSign::kAny;
  bool frozen_by_default = false;
  /// Set for a parameter that varies in flight as a first-order Gauss-Markov process about zero:
  /// names, within the effect, of the parameters that hold its standard deviation and correlation
  /// time [s]. Estimator and simulator let it vary.
  std::string process_sigma = {}, process_time_constant = {};
  /// Set for what moves by itself and starts a recording somehow: its value there says nothing
  /// about the effect's size.
  bool initial_state = false;
  /// Set where nothing in nature has the other sign (a mass), rather than nothing that is known.
  bool certain_sign = false;
  /// Set for a place in the odometry's world, whose origin is anywhere: how far it is from there is
  /// no size of it.
  bool in_world = false;
};

}  // namespace odmc
