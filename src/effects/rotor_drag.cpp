#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Induced and flapping drag of each rotor, in its plane: f_j = -k_d Ω_j Π u_j, u_j the air
/// velocity at hub j. Where on the rotor it acts differs from vehicle to vehicle, so its moment has
/// coefficients of its own: with k_c = k_d h it acts at a height h above the centre of mass, and
/// with k_y = k_d its yaw moment is that of forces at the hubs (k_y = 0: at the centre of mass,
/// without yaw damping and without a yaw moment where the rotors on one side turn faster). (They
/// are no products of k_d. What nothing but this effect tells, times what it is, has a valley at
/// zero: with the height of the centre of mass as its arm the online estimate, linearized anew as
/// it moved, ended at k_d = 0 and was sure of it.)
///                                        model.md 12.1, Eq. (M28), with a moment of its own
class RotorDrag final : public Effect {
 public:
  explicit RotorDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_drag", "Rotor drag",
                "f_j = -k_d Omega_j (u_jx, u_jy, 0), u_j = v_AB_B + w x r_j, at a height "
                "k_c / k_d above the centre of mass",
                "model.md 12.1; Martin and Salaun 2010; Kai et al. 2017",
                "one with linear drag while the rotors' speed hardly changes; its couple is a hub "
                "moment"},
               {HubDampingSpec("k_d", "in-plane drag per rotor speed and air speed", vehicle),
                CoupleSpec(vehicle),
                HubDampingSpec("k_y", "k_d as its yaw moment has it", vehicle)}) {}

  /// Through the centre of mass, at a height, or anywhere: what a flight does not tell costs
  /// evidence.
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override {
    return {{{{"k_c", 0.0}, {"k_y", 0.0}}, {}}, {{{"k_y", 0.0}}, {}}, {}};
  }

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"drag", "climbs and high tilt, so that the sum of the rotor speeds varies"},
            {"quadratic_drag", "the same course at half and at full speed"}};
  }

  /// At the hubs or at the centre of mass, about a fifth of an arm above or below that.
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    values[1] = 0.2 * vehicle().ArmLength() * normal() * values[0];
    values[2] = normal() > 0.5 ? 0.0 : values[0];
    return values;
  }

 private:
  /// Prior: a fifth of an arm above or below the centre of mass.
  static ParameterSpec CoupleSpec(const Vehicle& vehicle) {
    const double natural = 0.2 * vehicle.ArmLength() * HubDampingSpec("", "", vehicle).prior_sigma;
    return {"k_c", "N s^2",        "k_d times the height above the centre of mass it acts at",
            0.0,   10.0 * natural, natural};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    const double k_d = values[0], k_c = values[1], k_y = values[2];
    // Per coefficient.
    Eigen::Vector3d force = Eigen::Vector3d::Zero(), couple = force, yaw = force;
    for (const Rotor& rotor : vehicle().rotors) {
      const auto j = static_cast<Eigen::Index>(&rotor - vehicle().rotors.data());
      const Eigen::Matrix3d slope =
          -state.rotors.speed[j] * Eigen::Vector3d(1.0, 1.0, 0.0).asDiagonal();
      const Eigen::Vector3d arm(rotor.p_BP.x(), rotor.p_BP.y(), 0.0);
      const Eigen::Vector3d unit = slope * HubAirVelocity(state, rotor);
      force += unit;
      couple += e3.cross(unit);
      yaw += arm.cross(unit);
      if (J == nullptr) continue;
      const Eigen::Matrix3d d_couple = (k_y * Hat(arm) + k_c * Hat(e3)) * slope;
      J->AddForceAtCom(kColumnAirVelocity, k_d * slope);
      J->AddForceAtCom(kColumnAngularRate, TimesHat(k_d * slope, -rotor.p_BP));
      J->AddCouple(kColumnAirVelocity, d_couple);
      J->AddCouple(kColumnAngularRate, TimesHat(d_couple, -rotor.p_BP));
    }
    wrench->AddForceAtCom(k_d * force);
    wrench->AddCouple(k_c * couple + k_y * yaw);
    if (J == nullptr) return;
    J->AddForceAtComParameter(0, force);
    J->AddCoupleParameter(1, couple);
    J->AddCoupleParameter(2, yaw);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorDrag(const Vehicle& vehicle) {
  return std::make_unique<RotorDrag>(vehicle);
}

}  // namespace odmc
