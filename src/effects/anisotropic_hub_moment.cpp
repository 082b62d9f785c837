#include <algorithm>

#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Hub moment of forward flight that differs with the direction: rotors in line meet each other's
/// wake, rotors abreast do not: τ = Σ Ω (k_bx u_y, -k_by u_x, 0).
///                                                         model.md 12.5, Eq. (M32) per axis
class AnisotropicHubMoment final : public Effect {
 public:
  explicit AnisotropicHubMoment(const Vehicle& vehicle)
      : Effect(vehicle,
               {"anisotropic_hub_moment", "Direction-dependent hub moment",
                "tau = sum(Omega) (k_bx u_y, -k_by u_x, 0)",
                "model.md 12.5 with one coefficient per axis; docs/closing_the_loop.md",
                "next to hub_moment only the difference of the axes is its own; holds the rear "
                "rotors' loss in the front rotors' wake"},
               {Axis("k_bx", "about body x", vehicle), Axis("k_by", "about body y", vehicle)}) {}

  /// Found on recorded flights; on simulated ones its truth would be itself.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  static ParameterSpec Axis(const std::string& name, const std::string& about,
                            const Vehicle& vehicle) {
    const double sum = std::max(1, vehicle.num_rotors()) * HoverSpeed(vehicle);
    const double natural = 0.3 * vehicle.mass_kg / sum * 0.2 * vehicle.ArmLength();
    return {name, "N s^2",        "moment per rotor speed and air speed, " + about,
            0.0,  10.0 * natural, natural};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const double sum = state.rotors.speed.sum();
    const Eigen::Vector3d& u = state.v_AB_B;
    wrench->AddCouple(sum * Eigen::Vector3d(values[0] * u.y(), -values[1] * u.x(), 0.0));
    if (J == nullptr) return;
    Eigen::Matrix3d d_u = Eigen::Matrix3d::Zero();
    d_u(0, 1) = sum * values[0];
    d_u(1, 0) = -sum * values[1];
    J->AddCouple(kColumnAirVelocity, d_u);
    J->AddCoupleParameter(0, Eigen::Vector3d(sum * u.y(), 0.0, 0.0));
    J->AddCoupleParameter(1, Eigen::Vector3d(0.0, -sum * u.x(), 0.0));
  }
};

}  // namespace

std::unique_ptr<Effect> MakeAnisotropicHubMoment(const Vehicle& vehicle) {
  return std::make_unique<AnisotropicHubMoment>(vehicle);
}

}  // namespace odmc
