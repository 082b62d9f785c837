#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Thrust coefficient that drifts over the flight: f_j = k_f ρ t Ω_j² e3, t from the start of the
/// recording. Air warms, propellers wear, a speed sensor's scale moves.
class ThrustDrift final : public Effect {
 public:
  explicit ThrustDrift(const Vehicle& vehicle)
      : Effect(vehicle,
               {"thrust_drift", "Drifting thrust coefficient",
                "f_j = k_f rate t Omega_j^2 e3 at hub j, t since the recording's start",
                "model.md 12.12 (air density), linear in time",
                "one with a falling mass; extrapolates badly beyond the flight"},
               {{"rate", "1/s", "relative change of k_f per second", 0.0, 0.01, 0.001}},
               {"thrust.k_f"}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"mass_change", "hover at the start and at the end of the flight"}};
  }
  std::vector<std::string> shown_by() const override { return {"octo", "vertical", "circle"}; }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Eigen::Vector3d& p_BP = vehicle().rotors[j].p_BP;
      const Eigen::Vector3d unit =
          state.time_s * state.rotors.speed_squared[j] * Eigen::Vector3d::UnitZ();
      wrench->AddForceAt(p_BP, values[1] * values[0] * unit);
      if (J == nullptr) continue;
      J->AddForceAtParameter(p_BP, 0, values[1] * unit);
      J->AddForceAtParameter(p_BP, 1, values[0] * unit);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeThrustDrift(const Vehicle& vehicle) {
  return std::make_unique<ThrustDrift>(vehicle);
}

}  // namespace odmc
