#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Thrust of each rotor at its hub: f_j = k_f Ω_j² e3.
///                                                    model.md section 2, Eq. (M2); paper Eq. (4)
class Thrust final : public Effect {
 public:
  explicit Thrust(const Vehicle& vehicle)
      : Effect(vehicle,
               {"thrust", "Rotor thrust", "f_j = k_f Omega_j^2 e3 at hub j",
                "model.md section 2; paper Eq. (4)",
                "still air or low advance ratio; axial inflow and ground effect are effects of "
                "their own"},
               {Coefficient(vehicle)}) {}

  /// No candidate: it is the base of every model.
  bool changes_between_flights() const override { return true; }
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override { return {}; }

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {"hover, then climbs and turns"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  static ParameterSpec Coefficient(const Vehicle& vehicle) {
    // A propeller of radius R hovers at a tip speed near 60 m/s: a start value for files without
    // one. The force equation fixes k_f within a second of flight.
    const double radius = vehicle.rotors.empty() ? 0.1 : vehicle.rotors.front().radius_m;
    const double hover_speed = 60.0 / radius;
    const double guess = vehicle.mass_kg * vehicle.gravity_m_s2 /
                         (std::max(1, vehicle.num_rotors()) * hover_speed * hover_speed);
    return {"k_f", "N s^2", "thrust coefficient of one rotor", guess,
            guess, guess,   ParameterTransform::kLog,          PhysicalSign::kPositive};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Eigen::Vector3d& p_BP = vehicle().rotors[j].p_BP;
      const double speed_squared = state.rotors.speed_squared[j];
      wrench->AddForceAt(p_BP, values[0] * speed_squared * Eigen::Vector3d::UnitZ());
      if (J != nullptr) J->AddForceAtParameter(p_BP, 0, speed_squared * Eigen::Vector3d::UnitZ());
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeThrust(const Vehicle& vehicle) {
  return std::make_unique<Thrust>(vehicle);
}

}  // namespace odmc
