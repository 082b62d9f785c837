#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Moment of the air on the body: τ = (-(p_x |u| + q_x u_z) u_y, (p_y |u| + q_y u_z) u_x, 0),
/// u = v_AB_B. p is drag off the centre of mass, q the moment of a slender body or plate at an
/// angle to the air (Munk 1924: it grows with the product of the axial and the transverse speed).
///                                                   model.md 12.9; docs/effects.md, Eq. (F5)
class BodyMoment final : public Effect {
 public:
  explicit BodyMoment(const Vehicle& vehicle)
      : Effect(vehicle,
               {"body_moment", "Moment of the air on the body",
                "tau = (-(p_x |u| + q_x u_z) u_y, (p_y |u| + q_y u_z) u_x, 0), u = v_AB_B",
                "model.md 12.9 for quadratic drag; Munk 1924; docs/effects.md, Eq. (F5)",
                "attached flow about the body; beside pressure_centre and hub_moment only what "
                "grows faster than the speed is its own"},
               {Coefficient("p_x", "roll moment per speed and sideways speed", vehicle),
                Coefficient("q_x", "roll moment per axial and sideways speed", vehicle),
                Coefficient("p_y", "pitch moment per speed and forward speed", vehicle),
                Coefficient("q_y", "pitch moment per axial and forward speed", vehicle)}) {}

  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    return FastTrials(vehicle(), flown);
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    const std::string course =
        "the same course at half and at full speed, with climbs and descents";
    return {{"hub_moment", course},
            {"anisotropic_hub_moment", course},
            {"pressure_centre", course},
            {"rotor_interference", course}};
  }
  /// Test flights are too slow for it.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  /// Natural size: the quadratic drag of a multirotor at an arm's length.
  static ParameterSpec Coefficient(const std::string& name, const std::string& description,
                                   const Vehicle& vehicle) {
    const double natural = 0.02 * vehicle.mass_kg * vehicle.ArmLength();
    return {name, "kg", description, 0.0, natural, natural};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d& u = state.v_AB_B;
    const double speed = u.norm();
    const double slope_x = values[0] * speed + values[1] * u.z();
    const double slope_y = values[2] * speed + values[3] * u.z();
    wrench->AddCouple({-slope_x * u.y(), slope_y * u.x(), 0.0});
    if (J == nullptr) return;
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d d_speed =
        speed > 0.0 ? Eigen::Vector3d(u / speed) : Eigen::Vector3d(0, 0, 0);
    Eigen::Matrix3d d_u = Eigen::Matrix3d::Zero();
    d_u.row(0) = -u.y() * (values[0] * d_speed + values[1] * e3);
    d_u.row(1) = u.x() * (values[2] * d_speed + values[3] * e3);
    d_u(0, 1) -= slope_x;
    d_u(1, 0) += slope_y;
    J->AddCouple(kColumnAirVelocity, d_u);
    J->AddCoupleParameter(0, {-speed * u.y(), 0.0, 0.0});
    J->AddCoupleParameter(1, {-u.z() * u.y(), 0.0, 0.0});
    J->AddCoupleParameter(2, {0.0, speed * u.x(), 0.0});
    J->AddCoupleParameter(3, {0.0, u.z() * u.x(), 0.0});
  }
};

}  // namespace

std::unique_ptr<Effect> MakeBodyMoment(const Vehicle& vehicle) {
  return std::make_unique<BodyMoment>(vehicle);
}

}  // namespace odmc
