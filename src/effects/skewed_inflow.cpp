#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Thrust that tells forward from backward and left from right flight: the air meets the rotors
/// along an axis that leans against theirs (rotors above an airframe that is not the same on both
/// sides, wakes of neighbours): f_j = -Ω_j (k_x u_jx + k_y u_jy) e3 at hub j. The first odd term of
/// thrust in the in-plane air speed; blade-element theory of a rotor alone has only even ones.
/// Found on recorded flights, docs/closing_the_loop.md.
class SkewedInflow final : public Effect {
 public:
  explicit SkewedInflow(const Vehicle& vehicle)
      : Effect(vehicle,
               {"skewed_inflow", "Inflow along a leaning axis",
                "f_j = -Omega_j (k_x u_jx + k_y u_jy) e3 at hub j",
                "axial inflow (model.md 12.3, Eq. (M30)) along a leaning axis; "
                "docs/closing_the_loop.md",
                "empirical: the cause of the lean is not modelled"},
               {Axis("k_x", vehicle), Axis("k_y", vehicle)}) {}

  /// Found on recorded flights; on simulated ones its truth would be itself.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  static ParameterSpec Axis(const std::string& name, const Vehicle& vehicle) {
    ParameterSpec spec = HubDampingSpec(
        name, "thrust loss per rotor speed and air speed along body " + name.substr(2), vehicle);
    spec.sign = PhysicalSign::kAny;
    return spec;
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Eigen::Vector3d u = HubAirVelocity(state, rotor);
      const double speed = state.rotors.speed[j];
      Eigen::Matrix3d d_air = Eigen::Matrix3d::Zero();
      d_air.row(2) << -speed * values[0], -speed * values[1], 0.0;
      AddHubForce(rotor, d_air * u, d_air, wrench, J);
      if (J == nullptr) continue;
      for (int i = 0; i < 2; ++i) {
        J->AddForceAtParameter(rotor.p_BP, i, -speed * u[i] * Eigen::Vector3d::UnitZ());
      }
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeSkewedInflow(const Vehicle& vehicle) {
  return std::make_unique<SkewedInflow>(vehicle);
}

}  // namespace odmc
