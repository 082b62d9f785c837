#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory>
#include <optional>
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

/// All parameters of a model, physical values in SI, in the order of DynamicModel::parameters().
/// Never allocates.
using ModelValues = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxModelParameters, 1>;

/// Derivative of BodyProperties with respect to all parameters of a model (28×num_parameters()).
using BodyPropertiesJacobian = Eigen::Matrix<double, kNumBodyPropertyRows, Eigen::Dynamic, 0,
                                             kNumBodyPropertyRows, kMaxModelParameters>;

/// A parameter that the torque takes at a value of its own; the force has the model's.
struct TorqueAnchor {
  int index;  ///< in DynamicModel::parameters()
  double value;
};

/// The rigid body with its effects: one list, in any order, whose wrenches add up.
/// Immutable after construction, safe to share between threads.
class DynamicModel {
 public:
  /// @param vehicle valid, else std::invalid_argument
  /// @param effects names known to `registry`, each once, else std::invalid_argument
  DynamicModel(const Vehicle& vehicle, const std::vector<std::string>& effects,
               const EffectRegistry& registry = EffectRegistry::Default());

  /// True if an effect that adds a wrench takes parameter `k`.
  bool makes_wrench(int k) const { return makes_wrench_[k]; }
  /// Where parameter `k` shapes the body: the rest of its column of Properties()' derivative is
  /// zero, always.
  const BodyPropertyRows& shaped_rows(int k) const { return shaped_rows_[k]; }
  /// True if a parameter shapes the mount of a sensor.
  bool shapes_mounts() const { return shapes_mounts_; }

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
  /// The same; of `J` (28×num_parameters()) it sets only shaped_rows().
  BodyProperties ShapedProperties(const ModelValues& values, double time_s,
                                  BodyPropertiesJacobian* J) const;

  /// True if the body changes with time or a parameter varies as a process.
  bool varies() const { return varies_; }

  /// True if an effect takes the rates of the rotor speeds.
  bool takes_rotor_rates() const { return !rate_effects_.empty(); }

  /// A parameter that varies as a first-order Gauss-Markov process about zero.
  struct ProcessParameter {
    int index;          ///< in parameters()
    int sigma;          ///< index of its standard deviation
    int time_constant;  ///< index of its correlation time [s]
  };
  const std::vector<ProcessParameter>& processes() const { return processes_; }

  /// The pendulum that an effect needs driven, if any: indices in parameters().
  const std::optional<PendulumParameters>& pendulum() const { return pendulum_; }

  /// Force on the body and torque about the centre of mass `p_BBcm`, in B.      model.md Eq. (A)
  /// @param anchor if given, what the torque takes of its own, and does not depend on
  void EvaluateWrench(const FlightState& state, const ModelValues& values,
                      const Eigen::Vector3d& p_BBcm, Eigen::Vector3d* f_B,
                      Eigen::Vector3d* tau_Bcm_B, ModelWrenchJacobians* J = nullptr,
                      const TorqueAnchor* anchor = nullptr) const;

  /// The same of only those effects that take the rates of the rotor speeds.
  void EvaluateRateEffects(const FlightState& state, const ModelValues& values,
                           const Eigen::Vector3d& p_BBcm, Eigen::Vector3d* f_B,
                           Eigen::Vector3d* tau_Bcm_B, ModelWrenchJacobians* J = nullptr,
                           const TorqueAnchor* anchor = nullptr) const;

  /// The same, effect by effect (only those that add a wrench).
  std::vector<EffectWrench> EvaluateEffects(const FlightState& state, const ModelValues& values,
                                            const Eigen::Vector3d& p_BBcm) const;

 private:
  using EffectValues = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxEffectParameters, 1>;

  void FindRows();
  EffectValues ValuesOf(int i, const ModelValues& values) const;
  bool Takes(int i, int parameter) const;
  /// Adds effect `i` at `values`.
  void AddEffect(int i, const FlightState& state, const ModelValues& values, Wrench* wrench,
                 WrenchJacobians* J) const;
  void EvaluateSome(const std::vector<int>& effects, const FlightState& state,
                    const ModelValues& values, const Eigen::Vector3d& p_BBcm, Eigen::Vector3d* f_B,
                    Eigen::Vector3d* tau_Bcm_B, ModelWrenchJacobians* J,
                    const TorqueAnchor* anchor) const;

  Vehicle vehicle_;
  std::vector<std::string> effect_names_;
  std::vector<std::unique_ptr<Effect>> effects_;
  std::vector<int> first_;
  std::vector<int> wrench_effects_, rate_effects_, shaping_effects_;  // by index
  BodyProperties nominal_;
  std::vector<char> makes_wrench_;             // by parameter
  std::vector<BodyPropertyRows> shaped_rows_;  // by parameter
  bool shapes_mounts_ = false, shaping_borrows_ = false;
  std::vector<ProcessParameter> processes_;
  std::optional<PendulumParameters> pendulum_;
  bool varies_ = false;
  // Of each effect: where its values are, own ones first; -1 where the lender is absent, and then
  // the value of the borrowed one.
  std::vector<std::vector<int>> columns_;
  std::vector<std::vector<double>> borrowed_default_;
  std::vector<ModelParameter> parameters_;
};

/// True if a parameter is the flight's, not the vehicle's: the direction of gravity, wind, the
/// state a load starts in.
bool BelongsToFlight(const DynamicModel& model, const ModelParameter& parameter);

}  // namespace odmc
