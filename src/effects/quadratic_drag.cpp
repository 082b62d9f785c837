#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Drag of the body by the square of air speed: f = -c_q |u| u at Bcm.  model.md 12.2, Eq. (M29)
class QuadraticDrag final : public Effect {
 public:
  explicit QuadraticDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"quadratic_drag", "Quadratic body drag", "f = -c_q |u| u at the centre of mass",
                "model.md 12.2", "close to linear drag below 8 m/s (correlation 0.8 to 0.97)"},
               {{"c_q", "kg/m", "half air density times drag area", 0.0, 0.1 * vehicle.mass_kg,
                 0.02 * vehicle.mass_kg, ParameterTransform::kLinear, PhysicalSign::kPositive}}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"drag", "the same course at half and at full speed"}};
  }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d& u = state.v_AB_B;
    const double speed = u.norm();
    wrench->AddForceAtCom(-values[0] * speed * u);
    if (J == nullptr) return;
    Eigen::Matrix3d d_u = speed * Eigen::Matrix3d::Identity();
    if (speed > 0.0) d_u += u * u.transpose() / speed;
    J->AddForceAtCom(kColumnAirVelocity, -values[0] * d_u);
    J->AddForceAtComParameter(0, -speed * u);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeQuadraticDrag(const Vehicle& vehicle) {
  return std::make_unique<QuadraticDrag>(vehicle);
}

}  // namespace odmc
