#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Rotors that differ: f_j = k_f (δ_j - mean δ) Ω_j² e3 on top of thrust, as from a damaged
/// propeller. The mean is k_f's own.                                   model.md 12.8
class RotorAsymmetry final : public Effect {
 public:
  explicit RotorAsymmetry(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_asymmetry", "Thrust differs from rotor to rotor",
                "f_j = k_f (delta_j - mean(delta)) Omega_j^2 e3 at hub j", "model.md 12.8",
                "in steady hover one with the centre of gravity; needs manoeuvres"},
               Deltas(vehicle), {"thrust.k_f"}) {}

 private:
  static std::vector<ParameterSpec> Deltas(const Vehicle& vehicle) {
    std::vector<ParameterSpec> specs;
    for (int j = 1; j <= vehicle.num_rotors(); ++j) {
      specs.push_back({"delta_" + std::to_string(j), "1",
                       "relative excess thrust of rotor " + std::to_string(j), 0.0, 0.2, 0.1});
    }
    return specs;
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const int n = vehicle().num_rotors();
    const double k_f = values[n], mean = values.head(n).mean();
    for (int j = 0; j < n; ++j) {
      const Eigen::Vector3d& p_BP = vehicle().rotors[j].p_BP;
      const Eigen::Vector3d square = state.rotors.speed_squared[j] * Eigen::Vector3d::UnitZ();
      wrench->AddForceAt(p_BP, k_f * (values[j] - mean) * square);
      if (J == nullptr) continue;
      for (int i = 0; i < n; ++i) {
        J->AddForceAtParameter(p_BP, i, k_f * ((i == j ? 1.0 : 0.0) - 1.0 / n) * square);
      }
      J->AddForceAtParameter(p_BP, n, (values[j] - mean) * square);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorAsymmetry(const Vehicle& vehicle) {
  return std::make_unique<RotorAsymmetry>(vehicle);
}

}  // namespace odmc
