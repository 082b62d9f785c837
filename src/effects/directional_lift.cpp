#include "odmc/effects/effects.h"
#include "rotor_air.h"
#include "rotor_wake.h"

namespace odmc {
namespace {

/// Lift by the direction of flight: f_j = k_w k_f Ω_j² cos(2ψ) tan(χ/2) v/v_h e3 at hub j, ψ the
/// direction of the in-plane air velocity from body x, χ the skew of the rotor's wake, v its
/// induced velocity and v_h that of hover. What a rotor's wake does to its neighbours and to the
/// body goes with the gradient of the inflow (Coleman 1945, Pitt and Peters 1981) and turns with
/// the direction: cos(2ψ) is the first harmonic of a vehicle that is one with its mirror images
/// about x and y. The part that is the same in all directions is the translational lift's to say.
///                                                                     docs/effects.md, Eq. (F6)
class DirectionalLift final : public Effect {
 public:
  explicit DirectionalLift(const Vehicle& vehicle)
      : Effect(vehicle,
               {"directional_lift", "Lift by the direction of flight",
                "f_j = k_w k_f Omega_j^2 cos(2 psi) tan(chi/2) v/v_h e3 at hub j, psi direction of "
                "the in-plane air velocity from body x, chi skew of the wake, v induced velocity, "
                "v_h that of hover",
                "model.md 12.4 by the skew of the wake; Glauert 1926; Coleman et al. 1945; Pitt "
                "and Peters 1981; docs/effects.md, Eq. (F6)",
                "beside hvt; nearly anisotropic_hvt over a narrow range of speeds. Quasi-steady; "
                "not in the vortex ring state"},
               {{"k_w", "1", "share of thrust gained along body x and lost along body y, at most",
                 0.0, 0.2, 0.1}},
               {"thrust.k_f"}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    const std::string course = "the same course along both body axes, at half and at full speed";
    return {{"anisotropic_hvt", course}, {"hvt", "fast flight along both body axes"}};
  }
  /// Found on recorded flights; on simulated ones its truth would be itself.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  enum Variable : int { kAir = 0, kThrust = 3, kNumVariables = 4 };
  using Number = Dual<kNumVariables>;

  /// Share of k_f Ω² that the rotor gains for k_w = 1.
  static Number Share(const Eigen::Vector3d& air, const Number& hover_squared) {
    constexpr double kSmooth = 0.25;  // [m²/s²]: the direction fades below 0.5 m/s
    const Number x = Number::Variable(air.x(), kAir), y = Number::Variable(air.y(), kAir + 1);
    const Number square = x * x + y * y;
    const auto wake = WakeOf(square, Number::Variable(air.z(), kAir + 2), hover_squared);
    return (x * x - y * y) / sqrt(square + kSmooth) * wake.gradient;
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    const Number k_f = Number::Variable(values[1], kThrust);
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Number thrust = k_f * state.rotors.speed_squared[j];
      if (!(thrust.v > 0.0)) continue;
      const Number unit =
          thrust * Share(HubAirVelocity(state, rotor), thrust * InflowSquaredPerThrust(rotor));
      const Eigen::Matrix3d d_air = values[0] * e3 * unit.d.segment<3>(kAir).transpose();
      AddHubForce(rotor, values[0] * unit.v * e3, d_air, wrench, J);
      if (J == nullptr) continue;
      J->AddForceAtParameter(rotor.p_BP, 0, unit.v * e3);
      J->AddForceAtParameter(rotor.p_BP, 1, values[0] * unit.d[kThrust] * e3);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeDirectionalLift(const Vehicle& vehicle) {
  return std::make_unique<DirectionalLift>(vehicle);
}

}  // namespace odmc
