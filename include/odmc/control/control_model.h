#pragma once

#include <memory>
#include <string>
#include <vector>

#include "odmc/model/body_wrench.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/model/rotor_map.h"

namespace odmc {

/// Which parts of the model a controller makes up for. Thrust, rotor torque, mass and inertia it
/// always uses; what is switched off counts as zero.
struct CompensatedEffects {
  bool drag = true;
  bool hvt = true;
  bool viscous_torque = true;
  bool centre_of_gravity = true;
  bool gravity = true;  ///< its direction
  bool others = true;   ///< every further effect of the model

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("compensate_drag", &drag);
    v->Field("compensate_hvt", &hvt);
    v->Field("compensate_viscous_torque", &viscous_torque);
    v->Field("compensate_centre_of_gravity", &centre_of_gravity);
    v->Field("compensate_gravity", &gravity);
    v->Field("compensate_others", &others);
  }

  static CompensatedEffects None() { return {false, false, false, false, false, false}; }

  /// True if `effect` is to be made up for.
  bool Has(const std::string& effect) const;
};

/// The estimated model as a controller uses it: the same effects as estimator and simulator, with
/// those zeroed that are not to be compensated.
class ControlModel {
 public:
  ControlModel(std::shared_ptr<const DynamicModel> model, const CompensatedEffects& compensation);

  /// Takes other values of the model's parameters (num_parameters()×1).
  void SetValues(const ModelValues& values);

  const DynamicModel& model() const { return *model_; }
  const BodyProperties& properties() const { return properties_; }
  const RotorMap& rotor_map() const { return map_; }

  /// Force and torque about Bcm, in B, that squared rotor speeds do not make by themselves: drag,
  /// lift of the airflow, torques of the air.
  /// @param w_WB_B [rad/s]  @param rotor_speed n×1 [rad/s]
  BodyWrench AirWrench(const Eigen::Vector3d& p_WB, const Eigen::Matrix3d& R_WB,
                       const Eigen::Vector3d& v_WB, const Eigen::Vector3d& w_WB_B,
                       const RotorVector& rotor_speed) const;

 private:
  std::shared_ptr<const DynamicModel> model_;
  std::vector<bool> zeroed_;  // by parameter
  ModelValues values_;        // zeroed ones are 0
  BodyProperties properties_;
  RotorMap map_;
};

}  // namespace odmc
