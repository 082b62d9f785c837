#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"
#include "rotor_air.h"
#include "rotor_wake.h"

namespace odmc {
namespace {

/// Moment of the skewed wake: τ_j = k_f Ω_j² tan(χ/2) v/v_h (l_x u_y, -l_y u_x, 0) / u_h. The
/// inflow of a skewed wake grows towards the rear of the disc by v tan(χ/2) (Coleman 1945, Pitt and
/// Peters 1981), and the thrust acts ahead of the hub: by l tan(χ/2) v/v_h. The moment grows with
/// the skew and fades as the induced velocity v falls from v_h, that of hover, where that of
/// flapping (hub_moment) goes on growing. Blade elements give l = σa/16 · 15π/32 · R V/(2 v_h) (C_P
/// of blade_element), with the blades' tip speed V: 2 cm for a radius R of 6 cm and σa = 0.7.
///                                                                     docs/effects.md, Eq. (F7)
class WakeMoment final : public Effect {
 public:
  explicit WakeMoment(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"wake_moment", "Moment of the skewed wake",
             "tau_j = k_f Omega_j^2 tan(chi/2) v/v_h (l_x u_y, -l_y u_x, 0)/u_h, u_h in-plane air "
             "velocity of hub j, chi skew of its wake, v induced velocity, v_h that of hover",
             "model.md 12.5 by the skew of the wake; Glauert 1926; Coleman et al. 1945; Pitt "
             "and Peters 1981; docs/effects.md, Eq. (F7)",
             "beside hub_moment; one with it while slow. Quasi-steady"},
            {Lever("l_x", "about body x", vehicle), Lever("l_y", "about body y", vehicle)},
            {"thrust.k_f"}) {}

  /// Needs the induced velocity of hover: in level flight at that speed tan(χ/2) v/v_h is 24 % less
  /// than in proportion to the speed; below, the effect is one with hub_moment.
  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    if (flown.speed_m_s > HoverInflow(vehicle())) return {EffectTrial()};
    return {};
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    const std::string course =
        "the same course at half and at full speed, with climbs and descents";
    return {{"hub_moment", course},
            {"anisotropic_hub_moment", course},
            {"pressure_centre", course},
            {"body_moment", course}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  enum Variable : int { kAir = 0, kThrust = 3, kNumVariables = 4 };
  using Number = Dual<kNumVariables>;

  /// Natural size: the thrust of a disc whose lift grows to the front by a tenth of itself.
  static ParameterSpec Lever(const std::string& name, const std::string& about,
                             const Vehicle& vehicle) {
    const double radius = vehicle.rotors.empty() ? 0.1 : vehicle.rotors.front().radius_m;
    return {name,
            "m",
            "how far ahead of the hub the thrust acts over tan(chi/2) v/v_h, moment " + about,
            0.0,
            0.5 * radius,
            0.1 * radius};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Number thrust = Number::Variable(values[2], kThrust) * state.rotors.speed_squared[j];
      if (!(thrust.v > 0.0)) continue;
      const Eigen::Vector3d u = HubAirVelocity(state, rotor);
      const Number x = Number::Variable(u.x(), kAir), y = Number::Variable(u.y(), kAir + 1);
      const Number force = thrust * WakeOf(x * x + y * y, Number::Variable(u.z(), kAir + 2),
                                           thrust * InflowSquaredPerThrust(rotor))
                                        .gradient;
      const Number roll = force * y, pitch = -(force * x);  // per lever
      wrench->AddCouple({values[0] * roll.v, values[1] * pitch.v, 0.0});
      if (J == nullptr) continue;
      Eigen::Matrix3d d_air = Eigen::Matrix3d::Zero();
      d_air.row(0) = values[0] * roll.d.segment<3>(kAir).transpose();
      d_air.row(1) = values[1] * pitch.d.segment<3>(kAir).transpose();
      J->AddCouple(kColumnAirVelocity, d_air);
      J->AddCouple(kColumnAngularRate, TimesHat(d_air, -rotor.p_BP));
      J->AddCoupleParameter(0, {roll.v, 0.0, 0.0});
      J->AddCoupleParameter(1, {0.0, pitch.v, 0.0});
      J->AddCoupleParameter(2, {values[0] * roll.d[kThrust], values[1] * pitch.d[kThrust], 0.0});
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeWakeMoment(const Vehicle& vehicle) {
  return std::make_unique<WakeMoment>(vehicle);
}

}  // namespace odmc
