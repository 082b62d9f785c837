#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Angular momentum of the rotors, turned with the body: τ = J_r Σ s Ω (w × e3).
///                                                                  model.md 12.6, Eq. (M34)
class RotorGyroscopic final : public Effect {
 public:
  explicit RotorGyroscopic(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_gyroscopic", "Gyroscopic torque of the rotors",
                "tau = J_r sum(s Omega) (w x e3)", "model.md 12.6",
                "vanishes while the spins balance: needs rates together with a yaw torque"},
               {RotorInertiaSpec(vehicle)}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"rotor_reaction", "yaw acceleration without roll and pitch rates"}};
  }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddRotorMomentum(state, vehicle(), values[0], 0, true, false, wrench, J);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorGyroscopic(const Vehicle& vehicle) {
  return std::make_unique<RotorGyroscopic>(vehicle);
}

}  // namespace odmc
