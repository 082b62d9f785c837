#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Translational lift that saturates: f_j = ¼ k_s s_j (u_jx² + u_jy²) e3 at hub j,
/// s_j = 1 / (1 + (|u_j| / (0.4 Ω_j R))²). Lift by the square of the in-plane speed holds while
/// that is small against the blades' own speed; then the retreating blades stall and the wake is
/// gone. 0.4 is the advance ratio about which helicopters meet retreating-blade stall (Leishman
/// 2006, ch. 3); that it fits small propellers was found on recorded flights.
///                                                                     docs/effects.md, Eq. (F2)
class SaturatingLift final : public Effect {
 public:
  explicit SaturatingLift(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"saturating_lift", "Saturating translational lift",
             "f_j = k_s/4 s_j (u_jx^2 + u_jy^2) e3 at hub j, s_j = 1/(1 + (|u_j|/(0.4 Omega_j "
             "R))^2)",
             "model.md 12.4; Leishman 2006, ch. 3; docs/effects.md, Eq. (F2)",
             "in place of hvt, or beside it where hvt takes the loss at the highest speeds; one "
             "with hvt below a tenth of the tip speed"},
            {LiftSpec("k_s", "extra thrust per squared in-plane air speed while slow, all rotors",
                      vehicle)}) {}

  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    return FastTrials(vehicle(), flown);
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"hvt", "the same course at half and at full speed"},
            {"rotor_hvt", "the same course at half and at full speed"},
            {"anisotropic_hvt", "the same course at half and at full speed, along both body axes"}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  static constexpr double kStallRatio = 0.4;

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const double stall = kStallRatio * state.rotors.speed[j] * rotor.radius_m;
      if (stall <= 0.0) continue;  // s_j = 0
      const Eigen::Vector3d u = HubAirVelocity(state, rotor);
      const double share = 1.0 / (1.0 + u.squaredNorm() / (stall * stall));
      const double square = u.head<2>().squaredNorm();
      const Eigen::Vector3d unit = 0.25 * share * square * Eigen::Vector3d::UnitZ();
      const Eigen::Vector3d d_share = -2.0 * share * share / (stall * stall) * u;
      Eigen::Matrix3d d_air = Eigen::Matrix3d::Zero();
      d_air.row(2) =
          0.25 * values[0] * (square * d_share + 2.0 * share * Eigen::Vector3d(u.x(), u.y(), 0.0));
      AddHubForce(rotor, values[0] * unit, d_air, wrench, J);
      if (J != nullptr) J->AddForceAtParameter(rotor.p_BP, 0, unit);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeSaturatingLift(const Vehicle& vehicle) {
  return std::make_unique<SaturatingLift>(vehicle);
}

}  // namespace odmc
