#include <algorithm>
#include <cmath>

#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Thrust lost in slow descent, where a rotor meets its own wake again (vortex ring state):
/// f_j = -k_v k_f Ω_j² h e3 at hub j, h = 4 d² v² / (v² + d² + u_jx² + u_jy²)², d = max(0, -u_jz)
/// the speed of descent along the axis and v = Ω_j sqrt(k_f / (2 ρ A)) the induced velocity of
/// hover. h is 1 at d = v, straight down; it vanishes in hover with its slope (what is linear in
/// u_z is axial_inflow), in fast descent (windmill) and in forward flight, which leaves the wake
/// behind.
///                                                                       docs/effects.md, Eq. (F3)
class VortexRing final : public Effect {
 public:
  explicit VortexRing(const Vehicle& vehicle)
      : Effect(vehicle,
               {"vortex_ring", "Vortex ring state",
                "f_j = -k_v k_f Omega_j^2 h e3 at hub j, h = 4 d^2 v^2/(v^2 + d^2 + u_jx^2 + "
                "u_jy^2)^2, d = max(0, -u_jz), v induced velocity of hover at Omega_j",
                "model.md 12.3 in descent; Leishman 2006, ch. 2; Johnson 2005; docs/effects.md, "
                "Eq. (F3)",
                "the mean loss: thrust in the vortex ring state also fluctuates by as much"},
               {{"k_v", "1", "share of thrust lost straight down at the induced velocity of hover",
                 0.0, 0.5, 0.2, ParameterTransform::kLinear, PhysicalSign::kPositive}},
               {"thrust.k_f"}) {}

  /// Needs descent along the rotors' axes at half the induced velocity of hover: there it takes
  /// 0.64 of what it takes at the most.
  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    if (flown.descent_m_s > 0.5 * HoverInflow(vehicle())) return {EffectTrial()};
    return {};
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"axial_inflow", "straight descents at several speeds, and climbs"},
            {"drag", "straight descents at several speeds, and climbs"},
            {"vertical_drag", "straight descents at several speeds, and climbs"}};
  }
  /// Test flights descend too slowly for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Eigen::Vector3d u = HubAirVelocity(state, rotor);
      const double descent = std::max(0.0, -u.z());
      if (descent == 0.0) continue;
      const double square = descent * descent, speed_squared = state.rotors.speed_squared[j];
      const double k_f = values[1];
      const double inflow = InflowSquaredPerThrust(rotor) * k_f * speed_squared;  // squared
      const double sum = inflow + square + u.head<2>().squaredNorm();
      const double base = -speed_squared * 4.0 * square * inflow / (sum * sum);  // -Ω² h
      Eigen::Matrix3d d_air = Eigen::Matrix3d::Zero();
      d_air.row(2) = values[0] * k_f * base *
                     Eigen::Vector3d(-4.0 * u.x() / sum, -4.0 * u.y() / sum,
                                     -2.0 / descent + 4.0 * descent / sum);
      const Eigen::Vector3d unit = base * Eigen::Vector3d::UnitZ();
      AddHubForce(rotor, values[0] * k_f * unit, d_air, wrench, J);
      if (J == nullptr) continue;
      J->AddForceAtParameter(rotor.p_BP, 0, k_f * unit);
      // v² is proportional to k_f.
      J->AddForceAtParameter(rotor.p_BP, 1, values[0] * (2.0 - 2.0 * inflow / sum) * unit);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeVortexRing(const Vehicle& vehicle) {
  return std::make_unique<VortexRing>(vehicle);
}

}  // namespace odmc
