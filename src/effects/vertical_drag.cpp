#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Drag of the body along its z axis: f = -c_z |u| u_z e3, u = v_AB_B. Seen from above a multirotor
/// is a plate (arms, battery, guards); from the front it is slender. It acts at the place (p_x,
/// p_y) / c_z in the rotors' plane, seen from the centre of mass. (The moments have coefficients of
/// their own and are no products of c_z, for the reason that rotor_drag has.)
///                                        model.md 12.2, Eq. (M29) along one axis; docs/effects.md,
///                                        Eq. (F4)
class VerticalDrag final : public Effect {
 public:
  explicit VerticalDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"vertical_drag", "Body drag along z",
                "f = -c_z |u| u_z e3, u = v_AB_B, at (p_x, p_y)/c_z from the centre of mass",
                "model.md 12.2, along one axis; Hoerner 1965, ch. 3; docs/effects.md, Eq. (F4)",
                "beside quadratic_drag only the difference of the axes is its own; holds the "
                "download of the rotors' wake on the arms where that varies"},
               {{"c_z", "kg/m", "half air density times drag area seen along z", 0.0,
                 0.1 * vehicle.mass_kg, 0.02 * vehicle.mass_kg, ParameterTransform::kLinear,
                 PhysicalSign::kPositive},
                Place("x", vehicle),
                Place("y", vehicle)}) {}

  /// At the centre of mass, or anywhere: what a flight does not tell costs evidence.
  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    if (FastTrials(vehicle(), flown).empty()) return {};
    return {{{{"p_x", 0.0}, {"p_y", 0.0}}, {}}, {}};
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"quadratic_drag", "fast level flight, and fast climbs and descents"},
            {"axial_inflow", "climbs and descents at several forward speeds"},
            {"drag", "climbs and descents at several forward speeds"}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  /// Prior: a fifth of an arm off the centre of mass.
  static ParameterSpec Place(const std::string& axis, const Vehicle& vehicle) {
    const double natural = 0.2 * vehicle.ArmLength() * 0.02 * vehicle.mass_kg;
    return {"p_" + axis, "kg",          "c_z times the place it acts at, body " + axis,
            0.0,         5.0 * natural, natural};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d& u = state.v_AB_B;
    const double speed = u.norm(), flow = -speed * u.z();
    const Eigen::Vector3d moment(values[2], -values[1], 0.0);  // of a unit force at the place
    wrench->AddForceAtCom(values[0] * flow * e3);
    wrench->AddCouple(flow * moment);
    if (J == nullptr) return;
    Eigen::Vector3d d_flow = -speed * e3;
    if (speed > 0.0) d_flow -= u.z() / speed * u;
    J->AddForceAtCom(kColumnAirVelocity, values[0] * e3 * d_flow.transpose());
    J->AddCouple(kColumnAirVelocity, moment * d_flow.transpose());
    J->AddForceAtComParameter(0, flow * e3);
    J->AddCoupleParameter(1, {0.0, -flow, 0.0});
    J->AddCoupleParameter(2, {flow, 0.0, 0.0});
  }
};

}  // namespace

std::unique_ptr<Effect> MakeVerticalDrag(const Vehicle& vehicle) {
  return std::make_unique<VerticalDrag>(vehicle);
}

}  // namespace odmc
