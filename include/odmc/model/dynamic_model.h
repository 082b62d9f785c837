#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "odmc/model/effect.h"

namespace odmc {

/// One parameter of a model: its spec after the vehicle file had its say.
struct ModelParameter {
  std::string full_name;  ///< "thrust.k_f"
  std::string effect;     ///< "thrust"
  ParameterSpec spec;     ///< prior value and sigma as configured
  bool estimated = true;  ///< false: frozen at spec.prior_value
};

/// Force and torque of the model and of one effect, for reports.
struct EffectWrench {
  std::string effect;
  Eigen::Vector3d f_B;        ///< [N]
  Eigen::Vector3d tau_Bcm_B;  ///< [N m]
};

/// Largest number of parameters a whole model may have.
constexpr int kMaxModelParameters = 96;

/// All parameters of a model, physical values in SI, in the order of DynamicModel::parameters().
/// Never allocates.
using ModelValues = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxModelParameters, 1>;

/// Derivative of a wrench about Bcm: rows f_B, tau_Bcm_B (6).
struct ModelWrenchJacobians {
  Eigen::Matrix<double, 6, kNumFlightStateColumns> d_state;
  Eigen::Matrix<double, 6, 3> d_p_BBcm;  ///< with the body frame held
  Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kMaxModelParameters>
      d_values;  ///< 6×num_parameters(), centre of mass held
};

/// Derivative of BodyProperties with respect to all parameters of a model (28×num_parameters()).
using BodyPropertiesJacobian = Eigen::Matrix<double, kNumBodyPropertyRows, Eigen::Dynamic, 0,
                                             kNumBodyPropertyRows, kMaxModelParameters>;

/// The rigid body with its effects: one list, in any order, whose wrenches add up.
/// Immutable after construction, safe to share between threads.
class DynamicModel {
 public:
  /// @param vehicle valid, else std::invalid_argument
  /// @param effects names known to `registry`, each once, else std::invalid_argument
  DynamicModel(const Vehicle& vehicle, const std::vector<std::string>& effects,
               const EffectRegistry& registry = EffectRegistry::Default());

  /// A run of parameters.
  struct ColumnRange {
    int first = 0, count = 0;
  };
  /// The parameters that shape the body: the columns of Properties()' derivative that are not zero.
  const std::vector<ColumnRange>& shaped_columns() const { return shaped_columns_; }

  const Vehicle& vehicle() const { return vehicle_; }
  const std::vector<std::string>& effect_names() const { return effect_names_; }
  const Effect& effect(int i) const { return *effects_[i]; }
  int num_effects() const { return static_cast<int>(effects_.size()); }

  const std::vector<ModelParameter>& parameters() const { return parameters_; }
  int num_parameters() const { return static_cast<int>(parameters_.size()); }
  /// Index of a full name, -1 where the model has no such parameter.
  int IndexOf(std::string_view full_name) const;
  /// Index of the first own parameter of effect `i`.
  int FirstParameterOf(int i) const { return first_[i]; }

  /// The prior values of all parameters.
  ModelValues InitialValues() const;

  /// The body, gravity, air and mounts at `values`, `time_s` after the flight's start (by default
  /// at its end); if `J` is given, it becomes 28×num_parameters().
  BodyProperties Properties(const ModelValues& values, BodyPropertiesJacobian* J = nullptr,
                            double time_s = std::numeric_limits<double>::infinity()) const;

  /// True if the body changes with time or a parameter varies as a process.
  bool varies() const { return varies_; }

  /// True if an effect takes the rates of the rotor speeds.
  bool takes_rotor_rates() const { return takes_rotor_rates_; }

  /// A parameter that varies as a first-order Gauss-Markov process about zero.
  struct ProcessParameter {
    int index;          ///< in parameters()
    int sigma;          ///< index of its standard deviation
    int time_constant;  ///< index of its correlation time [s]
  };
  const std::vector<ProcessParameter>& processes() const { return processes_; }

  /// Force on the body and torque about the centre of mass `p_BBcm`, in B.      model.md Eq. (A)
  void EvaluateWrench(const FlightState& state, const ModelValues& values,
                      const Eigen::Vector3d& p_BBcm, Eigen::Vector3d* f_B,
                      Eigen::Vector3d* tau_Bcm_B, ModelWrenchJacobians* J = nullptr) const;

  /// The same, effect by effect (only those that add a wrench).
  std::vector<EffectWrench> EvaluateEffects(const FlightState& state, const ModelValues& values,
                                            const Eigen::Vector3d& p_BBcm) const;

 private:
  void FindShapedColumns();
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxEffectParameters, 1> ValuesOf(
      int i, const ModelValues& values) const;

  Vehicle vehicle_;
  std::vector<std::string> effect_names_;
  std::vector<std::unique_ptr<Effect>> effects_;
  std::vector<int> first_;
  std::vector<ColumnRange> shaped_columns_;
  std::vector<ProcessParameter> processes_;
  bool takes_rotor_rates_ = false;
  bool varies_ = false;
  std::vector<std::vector<int>> borrowed_index_;  // -1 where the lender is absent
  std::vector<std::vector<double>> borrowed_default_;
  std::vector<ModelParameter> parameters_;
};

}  // namespace odmc
