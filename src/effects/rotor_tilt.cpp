#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Rotor axes that lean: n_j = (α_jx, α_jy, 1), f_j = k_f Ω_j² n_j, couple s_j k_m Ω_j² n_j; only
/// what the lean adds. Modes that other parameters make too are left to the priors.
///                                                                 model.md 12.10, Eq. (M38)
class RotorTilt final : public Effect {
 public:
  explicit RotorTilt(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_tilt", "Tilted rotor axes",
                "f_j = k_f Omega_j^2 (alpha_jx, alpha_jy, 0) at hub j, couple s_j k_m Omega_j^2 "
                "(alpha_jx, alpha_jy, 0)",
                "model.md 12.10",
                "the mean lean is one with the attitude of the odometry frame; what is left is "
                "mostly a yaw torque by thrust"},
               Leans(vehicle), {"thrust.k_f", "rotor_torque.k_m"}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"thrust_lean", "strong differential thrust: rolls and pitches"}};
  }
  std::vector<std::string> shown_by() const override { return {"octo", "vertical", "aggressive"}; }

  /// Axes that lean along their circle: a yaw torque by thrust.
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Eigen::Vector3d& r = vehicle().rotors[j].p_BP;
      const double lean = 0.01 + 0.01 * normal();
      values[2 * j] = -lean * r.y() / r.norm();
      values[2 * j + 1] = lean * r.x() / r.norm();
    }
    return values;
  }

 private:
  static std::vector<ParameterSpec> Leans(const Vehicle& vehicle) {
    std::vector<ParameterSpec> specs;
    for (int j = 1; j <= vehicle.num_rotors(); ++j) {
      for (const char* axis : {"x", "y"}) {
        specs.push_back({"alpha_" + std::to_string(j) + axis, "rad",
                         "lean of rotor " + std::to_string(j) + " towards body " + axis, 0.0, 0.03,
                         0.02});
      }
    }
    return specs;
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Index n = vehicle().num_rotors();
    const double k_f = values[2 * n], k_m = values[2 * n + 1];
    for (Eigen::Index j = 0; j < n; ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const double square = state.rotors.speed_squared[j];
      const Eigen::Vector3d lean(values[2 * j], values[2 * j + 1], 0.0);
      wrench->AddForceAt(rotor.p_BP, k_f * square * lean);
      wrench->AddCouple(rotor.spin * k_m * square * lean);
      if (J == nullptr) continue;
      for (int i = 0; i < 2; ++i) {
        const Eigen::Vector3d unit = square * Eigen::Vector3d::Unit(i);
        J->AddForceAtParameter(rotor.p_BP, 2 * j + i, k_f * unit);
        J->AddCoupleParameter(2 * j + i, rotor.spin * k_m * unit);
      }
      J->AddForceAtParameter(rotor.p_BP, 2 * n, square * lean);
      J->AddCoupleParameter(2 * n + 1, rotor.spin * square * lean);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorTilt(const Vehicle& vehicle) {
  return std::make_unique<RotorTilt>(vehicle);
}

}  // namespace odmc
