#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Horizontal-velocity thrust: f = k_h (u_x² + u_y²) e3 at Bcm, u = v_AB_B. A body-z force (the
/// paper prints an acceleration along world z: model.md section 3).
///                                                    model.md section 2, Eq. (M2); paper Eq. (3)
class Hvt final : public Effect {
 public:
  explicit Hvt(const Vehicle& vehicle)
      : Effect(vehicle,
               {"hvt", "Horizontal-velocity thrust",
                "f = k_h (u_x^2 + u_y^2) e3 at the centre of mass, u = v_AB_B",
                "model.md sections 2 and 3; paper Eq. (3)",
                "grows without bound with speed; rotors saturate above about 10 m/s"},
               {{"k_h", "kg/m", "extra thrust per squared horizontal air speed", 0.0,
                 0.05 * vehicle.mass_kg, 0.01 * vehicle.mass_kg, ParameterTransform::kLinear,
                 PhysicalSign::kPositive}}) {}

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {
        "level flight at several speeds, fast ones among them"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d& u = state.v_AB_B;
    const double speed_squared = u.head<2>().squaredNorm();
    wrench->AddForceAtCom(values[0] * speed_squared * Eigen::Vector3d::UnitZ());
    if (J == nullptr) return;
    Eigen::Matrix3d d_u = Eigen::Matrix3d::Zero();
    d_u.row(2) << 2.0 * values[0] * u.x(), 2.0 * values[0] * u.y(), 0.0;
    J->AddForceAtCom(kColumnAirVelocity, d_u);
    J->AddForceAtComParameter(0, speed_squared * Eigen::Vector3d::UnitZ());
  }
};

}  // namespace

std::unique_ptr<Effect> MakeHvt(const Vehicle& vehicle) { return std::make_unique<Hvt>(vehicle); }

}  // namespace odmc
