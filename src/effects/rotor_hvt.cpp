#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Translational lift of each rotor by its own air speed: f_j = ¼ k_h (u_jx² + u_jy²) e3 at hub j.
///                                                                  model.md 12.4, Eq. (M31)
class RotorHvt final : public Effect {
 public:
  explicit RotorHvt(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_hvt", "Translational lift per rotor",
                "f_j = k_h/4 (u_jx^2 + u_jy^2) e3 at hub j",
                "model.md 12.4; Gill and D'Andrea 2017; Svacha et al. 2017",
                "one with hvt but for the torque that yaw rates make; grows without bound"},
               {LiftSpec("k_h", "extra thrust per squared horizontal air speed, all rotors",
                         vehicle)}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"hvt", "fast yaw while flying fast"},
            {"anisotropic_hvt", "fast flight along both body axes"}};
  }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddHubLift(state, vehicle(), values[0], 0, wrench, J);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorHvt(const Vehicle& vehicle) {
  return std::make_unique<RotorHvt>(vehicle);
}

}  // namespace odmc
