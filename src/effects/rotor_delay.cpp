#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Rotor speeds that are reported late: the model takes Ω²(t + delay), first order.
///                                                                 model.md 12.16, Eq. (M43)
class RotorDelay final : public Effect {
 public:
  explicit RotorDelay(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_delay", "Late rotor speeds",
                "Omega_j^2 -> Omega_j^2 + delay d(Omega_j^2)/dt in thrust and reaction torque",
                "model.md 12.16",
                "first order: up to about half a keyframe interval; close to vertical drag", true},
               {{"delay", "s", "how late the rotor speeds are reported", 0.0, 0.03, 0.005,
                 ParameterTransform::kLinear, PhysicalSign::kAny}},
               {"thrust.k_f", "rotor_torque.k_m"}) {}

  /// Telemetry and a filter's group delay take some milliseconds of every recording.
  double ordinary_sigma() const override { return 0.0025; }

  /// Speeds are reported late, never early.
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    return Effect::Draw(normal).cwiseAbs();
  }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const double delay = values[0], k_f = values[1], k_m = values[2];
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Eigen::Vector3d rate = state.rotors.speed_squared_rate[j] * Eigen::Vector3d::UnitZ();
      wrench->AddForceAt(rotor.p_BP, delay * k_f * rate);
      wrench->AddCouple(delay * rotor.spin * k_m * rate);
      if (J == nullptr) continue;
      J->AddForceAtParameter(rotor.p_BP, 0, k_f * rate);
      J->AddCoupleParameter(0, rotor.spin * k_m * rate);
      J->AddForceAtParameter(rotor.p_BP, 1, delay * rate);
      J->AddCoupleParameter(2, delay * rotor.spin * rate);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorDelay(const Vehicle& vehicle) {
  return std::make_unique<RotorDelay>(vehicle);
}

}  // namespace odmc
