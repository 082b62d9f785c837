#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Drag linear in the air velocity: f = diag(d) v_AB_B at Bcm, d < 0 when dissipative.
///                                                    model.md section 2, Eq. (M2); paper Eq. (1)
class Drag final : public Effect {
 public:
  explicit Drag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"drag", "Linear drag", "f = diag(d) v_AB_B at the centre of mass",
                "model.md section 2; paper Eq. (1)",
                "up to about 10 m/s; above it drag grows with the square of speed"},
               {Axis("d_x", vehicle), Axis("d_y", vehicle), Axis("d_z", vehicle)}) {}

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {"forward and back at several speeds",
                                                      "sideways at several speeds",
                                                      "up and down at several speeds"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  static ParameterSpec Axis(const std::string& name, const Vehicle& vehicle) {
    // Multirotors decelerate at 0.2 to 0.5 m/s² per m/s, whatever their size.
    return {name,
            "N s/m",
            "drag along body " + name.substr(2),
            0.0,
            1.0 * vehicle.mass_kg,
            0.3 * vehicle.mass_kg,
            ParameterTransform::kLinear,
            PhysicalSign::kNegative};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d d = values.head<3>();
    wrench->AddForceAtCom(d.cwiseProduct(state.v_AB_B));
    if (J == nullptr) return;
    J->AddForceAtCom(kColumnAirVelocity, d.asDiagonal());
    for (int i = 0; i < 3; ++i) {
      J->AddForceAtComParameter(i, state.v_AB_B[i] * Eigen::Vector3d::Unit(i));
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeDrag(const Vehicle& vehicle) { return std::make_unique<Drag>(vehicle); }

}  // namespace odmc
