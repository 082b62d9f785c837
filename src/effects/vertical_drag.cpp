#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Drag of the body along its z axis: f = -c_z |u| u_z e3 at Bcm, u = v_AB_B. Seen from above a
/// multirotor is a plate (arms, battery, guards); from the front it is slender.
///                                                   model.md 12.2, along one axis
class VerticalDrag final : public Effect {
 public:
  explicit VerticalDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"vertical_drag", "Body drag along z",
                "f = -c_z |u| u_z e3 at the centre of mass, u = v_AB_B",
                "model.md 12.2, along one axis; Hoerner 1965, ch. 3; docs/effects.md",
                "beside quadratic_drag only the difference of the axes is its own; holds the "
                "download of the rotors' wake on the arms where that varies"},
               {{"c_z", "kg/m", "half air density times drag area seen along z", 0.0,
                 0.1 * vehicle.mass_kg, 0.02 * vehicle.mass_kg, ParameterTransform::kLinear,
                 PhysicalSign::kPositive}}) {}

  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    return FastTrials(vehicle(), flown);
  }
  std::vector<TellingPair> telling_pairs() const override {
    return {{"quadratic_drag", "fast level flight, and fast climbs and descents"},
            {"axial_inflow", "climbs and descents at several forward speeds"},
            {"drag", "climbs and descents at several forward speeds"}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d& u = state.v_AB_B;
    const double speed = u.norm();
    wrench->AddForceAtCom(-values[0] * speed * u.z() * e3);
    if (J == nullptr) return;
    Eigen::Vector3d d_u = speed * e3;
    if (speed > 0.0) d_u += u.z() / speed * u;
    J->AddForceAtCom(kColumnAirVelocity, -values[0] * e3 * d_u.transpose());
    J->AddForceAtComParameter(0, -speed * u.z() * e3);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeVerticalDrag(const Vehicle& vehicle) {
  return std::make_unique<VerticalDrag>(vehicle);
}

}  // namespace odmc
