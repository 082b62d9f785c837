#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Reaction torque of each rotor on the airframe: τ_j = s_j k_m Ω_j² e3, a couple; s_j = +1 for a
/// rotor turning clockwise seen from above.            model.md section 2, Eq. (M3); paper Eq. (5)
class RotorTorque final : public Effect {
 public:
  explicit RotorTorque(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_torque", "Rotor reaction torque", "tau_j = s_j k_m Omega_j^2 e3",
                "model.md section 2; paper Eq. (5)",
                "k_m and I_z share a scale in gentle flight (model.md section 10), so k_m is "
                "frozen unless freed"},
               {Coefficient(vehicle)}) {}

  /// No candidate: it is the base of every model.
  bool changes_between_flights() const override { return true; }
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override { return {}; }

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {"quick turns of the heading"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  static ParameterSpec Coefficient(const Vehicle& vehicle) {
    // Small propellers have a torque-to-thrust ratio near 0.2 radii.
    const double radius = vehicle.rotors.empty() ? 0.1 : vehicle.rotors.front().radius_m;
    const auto thrust = MakeThrust(vehicle);
    const auto it = vehicle.parameters.find("thrust.k_f");
    const double k_f = it != vehicle.parameters.end() && it->second.value
                           ? *it->second.value
                           : thrust->parameters().front().prior_value;
    const double guess = 0.2 * radius * k_f;
    return {"k_m",       "N m s^2", "torque coefficient of one rotor", guess,
            0.3 * guess, guess,     ParameterTransform::kLog,          PhysicalSign::kPositive,
            true};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    double signed_sum = 0.0;
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      signed_sum += vehicle().rotors[j].spin * state.rotors.speed_squared[j];
    }
    wrench->AddCouple(values[0] * signed_sum * Eigen::Vector3d::UnitZ());
    if (J != nullptr) J->AddCoupleParameter(0, signed_sum * Eigen::Vector3d::UnitZ());
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorTorque(const Vehicle& vehicle) {
  return std::make_unique<RotorTorque>(vehicle);
}

}  // namespace odmc
