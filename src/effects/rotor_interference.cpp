#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Front against rear rotors: those behind fly in the downwash of those in front and lose thrust,
/// f_j = k_i k_f Ω_j² (r_j · u_h / a) |u_h| / (v² + |u_h|²) e3 at hub j, u_h the in-plane air
/// velocity of the hub, a the arm length and v = Ω_j sqrt(k_f / (2 ρ A)) the induced velocity of
/// hover. In hover the wakes go straight down and miss the neighbours; forward speed skews them,
/// sin²(skew) = |u_h|² / (v² + |u_h|²) of a wake that moves at v. What the mean rotor loses is the
/// translational lift's to say.                                           docs/effects.md, Eq. (F8)
class RotorInterference final : public Effect {
 public:
  explicit RotorInterference(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_interference", "Front against rear rotors",
                "f_j = k_i k_f Omega_j^2 (r_j . u_h/a) |u_h|/(v^2 + |u_h|^2) e3 at hub j, u_h "
                "in-plane air velocity, a arm length, v induced velocity of hover at Omega_j",
                "model.md 12.4 per rotor; Luo et al. 2015; Russell et al. 2016; docs/effects.md, "
                "Eq. (F8)",
                "level and climbing flight; its torque is nearly a hub moment until it saturates"},
               {{"k_i", "1", "share of thrust a rotor at the front gains, one at the rear loses",
                 0.0, 0.3, 0.1, ParameterTransform::kLinear, PhysicalSign::kPositive}},
               {"thrust.k_f"}) {}

  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    return FastTrials(vehicle(), flown);
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    const std::string course = "the same course at half and at full speed";
    return {
        {"hub_moment", course}, {"anisotropic_hub_moment", course}, {"pressure_centre", course}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const double arm = vehicle().ArmLength();
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      Eigen::Vector3d u = HubAirVelocity(state, rotor);
      u.z() = 0.0;
      const double speed = u.norm();
      if (speed == 0.0) continue;
      const double square = state.rotors.speed_squared[j], k_f = values[1];
      const double inflow = InflowSquaredPerThrust(rotor) * k_f * square;  // squared
      const double sum = inflow + speed * speed;
      const Eigen::Vector3d place(rotor.p_BP.x() / arm, rotor.p_BP.y() / arm, 0.0);
      const double ahead = place.dot(u);
      Eigen::Matrix3d d_air = Eigen::Matrix3d::Zero();
      d_air.row(2) = values[0] * k_f * square / sum *
                     (speed * place + ahead * (1.0 / speed - 2.0 * speed / sum) * u);
      const Eigen::Vector3d unit = square * ahead * speed / sum * Eigen::Vector3d::UnitZ();
      AddHubForce(rotor, values[0] * k_f * unit, d_air, wrench, J);
      if (J == nullptr) continue;
      J->AddForceAtParameter(rotor.p_BP, 0, k_f * unit);
      J->AddForceAtParameter(rotor.p_BP, 1, values[0] * (1.0 - inflow / sum) * unit);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorInterference(const Vehicle& vehicle) {
  return std::make_unique<RotorInterference>(vehicle);
}

}  // namespace odmc
