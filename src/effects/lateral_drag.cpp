#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Drag of the body in the plane of the rotors, not the same along x and y:
/// f = -|u| (c_x u_x + c_xy u_y, c_xy u_x + c_y u_y, 0), u = v_AB_B, at the centre of mass. A
/// battery across the frame has twice the area one way; with c_xy the axes of that lie askew.
///                                                  model.md 12.2, along two axes; docs/effects.md
class LateralDrag final : public Effect {
 public:
  explicit LateralDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"lateral_drag", "Body drag along x and y",
                "f = -|u| (c_x u_x + c_xy u_y, c_xy u_x + c_y u_y, 0), u = v_AB_B, at the centre "
                "of mass",
                "model.md 12.2, along two axes; Hoerner 1965, ch. 3; docs/effects.md",
                "beside quadratic_drag only the difference of the axes is its own; beside "
                "rotor_drag it needs half and full speed"},
               {Area("c_x", "along x", vehicle, PhysicalSign::kPositive),
                Area("c_y", "along y", vehicle, PhysicalSign::kPositive),
                Area("c_xy", "of the axes lying askew", vehicle, PhysicalSign::kAny)}) {}

  /// Along the axes of the body, or askew.
  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    if (FastTrials(vehicle(), flown).empty()) return {};
    return {{{{"c_xy", 0.0}}, {}}, {}};
  }
  std::vector<TellingPair> telling_pairs() const override {
    return {{"quadratic_drag", "fast flight along body x, and along body y"},
            {"rotor_drag", "the same course at half and at full speed"},
            {"drag", "the same course at half and at full speed"}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  static ParameterSpec Area(const std::string& name, const std::string& what,
                            const Vehicle& vehicle, PhysicalSign sign) {
    return {name,
            "kg/m",
            "half air density times drag area, " + what,
            0.0,
            0.1 * vehicle.mass_kg,
            0.02 * vehicle.mass_kg,
            ParameterTransform::kLinear,
            sign};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d& u = state.v_AB_B;
    const double speed = u.norm();
    Eigen::Matrix3d C = Eigen::Matrix3d::Zero();
    C(0, 0) = values[0];
    C(1, 1) = values[1];
    C(0, 1) = C(1, 0) = values[2];
    wrench->AddForceAtCom(-speed * (C * u));
    if (J == nullptr) return;
    Eigen::Matrix3d d_u = speed * C;
    if (speed > 0.0) d_u += C * u * u.transpose() / speed;
    J->AddForceAtCom(kColumnAirVelocity, -d_u);
    J->AddForceAtComParameter(0, {-speed * u.x(), 0.0, 0.0});
    J->AddForceAtComParameter(1, {0.0, -speed * u.y(), 0.0});
    J->AddForceAtComParameter(2, {-speed * u.y(), -speed * u.x(), 0.0});
  }
};

}  // namespace

std::unique_ptr<Effect> MakeLateralDrag(const Vehicle& vehicle) {
  return std::make_unique<LateralDrag>(vehicle);
}

}  // namespace odmc
