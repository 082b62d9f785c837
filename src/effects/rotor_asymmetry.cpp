#include <cmath>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Rotors that differ, as from a damaged propeller: thrust f_j = k_f (δ_j - mean δ) Ω_j² e3 and
/// reaction torque s_j k_m (δ_j - mean δ) Ω_j² e3 on top of the others'. A blade that lifts less
/// drags less: both go with its area and its speed. The mean is k_f's own.
///                                      model.md 12.8, Eq. (M36) with ε_j = δ_j, less their mean
class RotorAsymmetry final : public Effect {
 public:
  explicit RotorAsymmetry(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"rotor_asymmetry", "Thrust and torque differ from rotor to rotor",
             "f_j = k_f (delta_j - mean(delta)) Omega_j^2 e3 at hub j, couple s_j k_m "
             "(delta_j - mean(delta)) Omega_j^2 e3",
             "model.md 12.8", "in steady hover one with the centre of gravity; needs manoeuvres"},
            Deltas(vehicle), {"thrust.k_f", "rotor_torque.k_m"}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"centre_of_gravity", "strong differential thrust: rolls and pitches"},
            {"rotor_tilt", "strong differential thrust: rolls and pitches"}};
  }

  /// One damaged rotor.
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    const int n = vehicle().num_rotors();
    const int damaged = static_cast<int>(std::abs(normal()) * 7.0) % n;
    values.setZero();
    values[damaged] = -0.1;
    return values;
  }

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
    const double k_f = values[n], k_m = values[n + 1], mean = values.head(n).mean();
    for (int j = 0; j < n; ++j) {
      const Eigen::Vector3d& p_BP = vehicle().rotors[j].p_BP;
      const double spin = vehicle().rotors[j].spin;
      const Eigen::Vector3d square = state.rotors.speed_squared[j] * Eigen::Vector3d::UnitZ();
      wrench->AddForceAt(p_BP, k_f * (values[j] - mean) * square);
      wrench->AddCouple(spin * k_m * (values[j] - mean) * square);
      if (J == nullptr) continue;
      for (int i = 0; i < n; ++i) {
        const double share = (i == j ? 1.0 : 0.0) - 1.0 / n;
        J->AddForceAtParameter(p_BP, i, k_f * share * square);
        J->AddCoupleParameter(i, spin * k_m * share * square);
      }
      J->AddForceAtParameter(p_BP, n, (values[j] - mean) * square);
      J->AddCoupleParameter(n + 1, spin * (values[j] - mean) * square);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorAsymmetry(const Vehicle& vehicle) {
  return std::make_unique<RotorAsymmetry>(vehicle);
}

}  // namespace odmc
