#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// All rotor axes lean alike against the body axes the odometry states: f_j = k_f Ω_j² (α_x, α_y,
/// 0) at hub j. A motion-capture body frame is set by hand, an airframe bends: a degree is common,
/// and at hover it is 0.02 of the weight. The force of model.md 12.10, Eq. (M38), with two
/// coefficients instead of two a rotor. Found on recorded flights, docs/closing_the_loop.md.
class ThrustLean final : public Effect {
 public:
  explicit ThrustLean(const Vehicle& vehicle)
      : Effect(vehicle,
               {"thrust_lean", "Thrust along a leaning axis",
                "f_j = k_f Omega_j^2 (alpha_x, alpha_y, 0) at hub j",
                "the mean of model.md 12.10; docs/closing_the_loop.md",
                "one with roll and pitch of odometry_extrinsics; at constant heading with gravity"},
               {Lean("x"), Lean("y")}, {"thrust.k_f"}) {}

  /// Found on recorded flights; on simulated ones its truth would be itself.
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  static ParameterSpec Lean(const std::string& axis) {
    return {"alpha_" + axis, "rad", "lean of all rotors towards body " + axis, 0.0, 0.02, 0.01};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d lean(values[0], values[1], 0.0);
    const double k_f = values[2];
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const double square = state.rotors.speed_squared[j];
      wrench->AddForceAt(rotor.p_BP, k_f * square * lean);
      if (J == nullptr) continue;
      for (int i = 0; i < 2; ++i) {
        J->AddForceAtParameter(rotor.p_BP, i, k_f * square * Eigen::Vector3d::Unit(i));
      }
      J->AddForceAtParameter(rotor.p_BP, 2, square * lean);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeThrustLean(const Vehicle& vehicle) {
  return std::make_unique<ThrustLean>(vehicle);
}

}  // namespace odmc
