#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

/// The air's force acts away from the centre of mass: τ = ρ × F_a(u), with the F_a of drag and hvt.
///                                                                  model.md 12.9, Eq. (M37)
class PressureCentre final : public Effect {
 public:
  explicit PressureCentre(const Vehicle& vehicle)
      : Effect(vehicle,
               {"pressure_centre", "Centre of pressure",
                "tau = rho x F_a, F_a = diag(d) u + k_h (u_x^2 + u_y^2) e3", "model.md 12.9",
                "borrows drag and hvt: without them it does nothing; rho_z is nearly a hub moment"},
               {Axis("x", vehicle), Axis("y", vehicle), Axis("z", vehicle)},
               {"drag.d_x", "drag.d_y", "drag.d_z", "hvt.k_h"}) {}

  std::vector<std::string> shown_by() const override { return {"octo", "aggressive", "circle"}; }

 private:
  static ParameterSpec Axis(const std::string& name, const Vehicle& vehicle) {
    return {name,
            "m",
            "centre of pressure from the centre of gravity, body " + name,
            0.0,
            0.5 * vehicle.ArmLength(),
            0.1 * vehicle.ArmLength()};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d& u = state.v_AB_B;
    const Eigen::Vector3d rho = values.head<3>(), d = values.segment<3>(3);
    const double k_h = values[6], square = u.head<2>().squaredNorm();
    const Eigen::Vector3d force = d.cwiseProduct(u) + k_h * square * Eigen::Vector3d::UnitZ();
    wrench->AddCouple(rho.cross(force));
    if (J == nullptr) return;
    Eigen::Matrix3d d_force = d.asDiagonal();
    d_force.row(2).head<2>() += 2.0 * k_h * u.head<2>().transpose();
    J->AddCouple(kColumnAirVelocity, Hat(rho) * d_force);
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3d unit = Eigen::Vector3d::Unit(i);
      J->AddCoupleParameter(i, unit.cross(force));
      J->AddCoupleParameter(3 + i, u[i] * rho.cross(unit));
    }
    J->AddCoupleParameter(6, square * rho.cross(Eigen::Vector3d::UnitZ()));
  }
};

}  // namespace

std::unique_ptr<Effect> MakePressureCentre(const Vehicle& vehicle) {
  return std::make_unique<PressureCentre>(vehicle);
}

}  // namespace odmc
