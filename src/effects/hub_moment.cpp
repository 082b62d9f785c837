#include <algorithm>

#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Moments at the hubs from flapping and from the advancing blade's lift:
/// τ = k_beta Σ Ω (u_h × e3) + k_rho Σ s Ω u_h, u_h the horizontal part of v_AB_B.
///                                                           model.md 12.5, Eq. (M32), (M33)
class HubMoment final : public Effect {
 public:
  explicit HubMoment(const Vehicle& vehicle)
      : Effect(vehicle,
               {"hub_moment", "Hub moment in forward flight",
                "tau = k_beta sum(Omega) (u_h x e3) + k_rho sum(s Omega) u_h, u_h horizontal part "
                "of v_AB_B",
                "model.md 12.5; Hoffmann et al. 2007; Pounds et al. 2010",
                "k_beta is nearly the lever arm of drag (pressure_centre); k_rho cancels for equal "
                "rotor speeds and is frozen unless freed"},
               {Coefficient("k_beta", "pitch-up moment per rotor speed and air speed", vehicle),
                Coefficient("k_rho", "rolling moment of each rotor", vehicle)}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"pressure_centre", "fast flight at different rotor speeds (climbing turns)"},
            {"rotor_drag", "fast flight at different rotor speeds (climbing turns)"}};
  }
  std::vector<std::string> shown_by() const override { return {"octo", "circle", "aggressive"}; }

 private:
  static ParameterSpec Coefficient(const std::string& name, const std::string& description,
                                   const Vehicle& vehicle) {
    // The drag of the rotors at a height of a fifth of the arm.
    const double sum = std::max(1, vehicle.num_rotors()) * HoverSpeed(vehicle);
    const double natural = 0.3 * vehicle.mass_kg / sum * 0.2 * vehicle.ArmLength();
    const bool rolling = name == "k_rho";
    return {name,
            "N s^2",
            description,
            0.0,
            10.0 * natural,
            natural,
            ParameterTransform::kLinear,
            rolling ? PhysicalSign::kPositive : PhysicalSign::kAny,
            rolling};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    double sum = 0.0, signed_sum = 0.0;
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      sum += state.rotors.speed[j];
      signed_sum += vehicle().rotors[j].spin * state.rotors.speed[j];
    }
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d u_h(state.v_AB_B.x(), state.v_AB_B.y(), 0.0);
    const Eigen::Vector3d pitching = sum * u_h.cross(e3), rolling = signed_sum * u_h;
    wrench->AddCouple(values[0] * pitching + values[1] * rolling);
    if (J == nullptr) return;
    const Eigen::Vector3d horizontal(1.0, 1.0, 0.0);
    Eigen::Matrix3d d_u = -values[0] * sum * Hat(e3);
    d_u += values[1] * signed_sum * horizontal.asDiagonal().toDenseMatrix();
    J->AddCouple(kColumnAirVelocity, d_u * horizontal.asDiagonal());
    J->AddCoupleParameter(0, pitching);
    J->AddCoupleParameter(1, rolling);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeHubMoment(const Vehicle& vehicle) {
  return std::make_unique<HubMoment>(vehicle);
}

}  // namespace odmc
