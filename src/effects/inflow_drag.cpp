#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// In-plane force of the rotors that the axial flow adds: f = -c u_z (u_x, u_y, 0) at Bcm. A
/// blade's lift leans back by the inflow angle, so the advancing side drags more the more air comes
/// from above: rotor drag grows in climb and falls in descent. The product of axial and in-plane
/// air speed in the H-force of blade-element theory, ρ A σa θ λ μ / 4.
///                                                   model.md 12.1; docs/effects.md, Eq. (F1)
class InflowDrag final : public Effect {
 public:
  explicit InflowDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"inflow_drag", "Rotor drag with axial inflow",
                "f = -c u_z (u_x, u_y, 0) at the centre of mass, u = v_AB_B",
                "model.md 12.1 to the next order; Leishman 2006, ch. 3; docs/effects.md, Eq. (F1)",
                "beside rotor_drag or drag; above a tenth of the tip speed; not in the vortex ring "
                "state"},
               {Coefficient(vehicle)}) {}

  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    return FastTrials(vehicle(), flown);
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"rotor_drag", "fast climbs and descents"},
            {"quadratic_drag", "fast climbs and descents"}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  /// σa θ λ μ / 4 with σa = 0.9 and θ = 0.45 at half radius, of which induced velocity, which gives
  /// way to the axial flow, takes half.
  static ParameterSpec Coefficient(const Vehicle& vehicle) {
    const double natural = 0.05 * kAirDensity * DiscArea(vehicle);
    return {"c",
            "kg/m",
            "in-plane drag per axial and in-plane air speed",
            0.0,
            natural,
            natural,
            ParameterTransform::kLinear,
            PhysicalSign::kPositive};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d& u = state.v_AB_B;
    const Eigen::Vector3d unit(-u.z() * u.x(), -u.z() * u.y(), 0.0);
    wrench->AddForceAtCom(values[0] * unit);
    if (J == nullptr) return;
    Eigen::Matrix3d d_u;
    d_u << -u.z(), 0.0, -u.x(), 0.0, -u.z(), -u.y(), 0.0, 0.0, 0.0;
    J->AddForceAtCom(kColumnAirVelocity, values[0] * d_u);
    J->AddForceAtComParameter(0, unit);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeInflowDrag(const Vehicle& vehicle) {
  return std::make_unique<InflowDrag>(vehicle);
}

}  // namespace odmc
