#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Angular damping: τ = diag(b) w_WB_B, b < 0 when dissipative.
///                                                    model.md section 2, Eq. (M3); paper Eq. (1)
class ViscousTorque final : public Effect {
 public:
  explicit ViscousTorque(const Vehicle& vehicle)
      : Effect(vehicle,
               {"viscous_torque", "Viscous torque", "tau = diag(b) w_WB_B",
                "model.md section 2; paper Eq. (1)",
                "a positive b feeds energy in: it has taken up an effect the model lacks"},
               {Axis(0, vehicle), Axis(1, vehicle), Axis(2, vehicle)}) {}

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {"quick rolls", "quick pitches",
                                                      "quick turns of the heading"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  static ParameterSpec Axis(int axis, const Vehicle& vehicle) {
    const std::string letter(1, "xyz"[axis]);
    const double inertia = vehicle.inertia_kg_m2[axis];
    return {"b_" + letter,
            "N m s",
            "angular damping about body " + letter,
            0.0,
            20.0 * inertia,
            inertia,
            ParameterTransform::kLinear,
            PhysicalSign::kNegative};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d b = values.head<3>();
    wrench->AddCouple(b.cwiseProduct(state.w_WB_B));
    if (J == nullptr) return;
    J->AddCouple(kColumnAngularRate, b.asDiagonal());
    for (int i = 0; i < 3; ++i) {
      J->AddCoupleParameter(i, state.w_WB_B[i] * Eigen::Vector3d::Unit(i));
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeViscousTorque(const Vehicle& vehicle) {
  return std::make_unique<ViscousTorque>(vehicle);
}

}  // namespace odmc
