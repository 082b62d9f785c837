#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Induced and flapping drag of each rotor, in its plane: f_j = -k_d Ω_j Π u_j at hub j. Where on
/// the rotor it acts differs from vehicle to vehicle: the couple -k_c Σ Ω_j e3 × Π u_j lifts it to
/// a height k_c / k_d above the hubs, and s k_d Σ Ω_j r_j × Π u_j, r_j the hub's place in the plane,
/// draws it in from the hubs: with s = 1 it acts on the rotors' axis of symmetry alone, without
/// yaw damping and without a yaw moment where the rotors on one side turn faster.
///                                                                       model.md 12.1
class RotorDrag final : public Effect {
 public:
  explicit RotorDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_drag", "Rotor drag",
                "f_j = -k_d Omega_j (u_jx, u_jy, 0), u_j = v_AB_B + w x r_j, at a height "
                "k_c / k_d above hub j",
                "model.md 12.1; Martin and Salaun 2010; Kai et al. 2017",
                "one with linear drag while the rotors' speed hardly changes; its couple is a hub "
                "moment"},
               {HubDampingSpec("k_d", "in-plane drag per rotor speed and air speed", vehicle),
                CoupleSpec(vehicle),
                {"drawn_in", "1", "share of the hubs' distance that its moment lacks", 0.0, 1.0, 1.0,
                 ParameterTransform::kLinear, PhysicalSign::kAny, true}}) {}

  /// At the hubs, half-way, or on the axis of symmetry.
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override {
    return {{{{"drawn_in", 0.0}}, {}}, {{{"drawn_in", 0.5}}, {}}, {{{"drawn_in", 1.0}}, {}}};
  }

  std::vector<TellingPair> telling_pairs() const override {
    return {{"drag", "climbs and high tilt, so that the sum of the rotor speeds varies"},
            {"quadratic_drag", "the same course at half and at full speed"}};
  }

  /// At the hubs or drawn in, and about a fifth of an arm off the hubs' plane.
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    values[1] = 0.2 * vehicle().ArmLength() * normal() * values[0];
    values[2] = normal() > 0.5 ? 1.0 : 0.0;
    return values;
  }
  std::vector<std::string> size_parameters() const override { return {"k_d", "k_c"}; }

 private:
  /// Prior: a fifth of an arm above or below the hubs.
  static ParameterSpec CoupleSpec(const Vehicle& vehicle) {
    const double natural = 0.2 * vehicle.ArmLength() * HubDampingSpec("", "", vehicle).prior_sigma;
    return {"k_c", "N s^2", "k_d times the height above the hubs it acts at", 0.0, 10.0 * natural,
            natural};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddHubDamping(state, vehicle(), values[0], {1.0, 1.0, 0.0}, 0, wrench, J);
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    Eigen::Vector3d couple = Eigen::Vector3d::Zero(), drawn_in = Eigen::Vector3d::Zero();
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Eigen::Matrix3d slope =
          state.rotors.speed[j] * Eigen::Vector3d(1.0, 1.0, 0.0).asDiagonal();
      const Eigen::Vector3d arm(rotor.p_BP.x(), rotor.p_BP.y(), 0.0);
      const Eigen::Vector3d u = HubAirVelocity(state, rotor);
      couple -= e3.cross(slope * u);  // per k_c
      drawn_in += arm.cross(slope * u);  // per share of k_d
      if (J == nullptr) continue;
      const Eigen::Matrix3d d_air =
          (values[2] * values[0] * Hat(arm) - values[1] * Hat(e3)) * slope;
      J->AddCouple(kColumnAirVelocity, d_air);
      J->AddCouple(kColumnAngularRate, TimesHat(d_air, -rotor.p_BP));
    }
    wrench->AddCouple(values[1] * couple + values[2] * values[0] * drawn_in);
    if (J == nullptr) return;
    J->AddCoupleParameter(0, values[2] * drawn_in);
    J->AddCoupleParameter(1, couple);
    J->AddCoupleParameter(2, values[0] * drawn_in);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorDrag(const Vehicle& vehicle) {
  return std::make_unique<RotorDrag>(vehicle);
}

}  // namespace odmc
