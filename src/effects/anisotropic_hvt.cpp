#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Translational lift that differs with the direction of flight: f = (k_hx u_x² + k_hy u_y²) e3 at
/// Bcm. Rotors in line shade each other; rotors abreast do not.       model.md 12.4
class AnisotropicHvt final : public Effect {
 public:
  explicit AnisotropicHvt(const Vehicle& vehicle)
      : Effect(vehicle,
               {"anisotropic_hvt", "Direction-dependent translational lift",
                "f = (k_hx u_x^2 + k_hy u_y^2) e3 at the centre of mass",
                "model.md 12.4, with one coefficient per axis",
                "next to hvt only the difference of the axes is its own"},
               {Axis("k_hx", "x", vehicle), Axis("k_hy", "y", vehicle)}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"hvt", "fast flight along both body axes"}};
  }
  std::vector<std::string> shown_by() const override { return {"octo", "aggressive"}; }

 private:
  static ParameterSpec Axis(const std::string& name, const std::string& axis,
                            const Vehicle& vehicle) {
    ParameterSpec spec =
        LiftSpec(name, "extra thrust per squared air speed along body " + axis, vehicle);
    spec.sign = PhysicalSign::kAny;  // next to hvt the share of one axis may be negative
    return spec;
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d& u = state.v_AB_B;
    const Eigen::Vector2d squares = u.head<2>().cwiseAbs2();
    wrench->AddForceAtCom(values.head<2>().dot(squares) * Eigen::Vector3d::UnitZ());
    if (J == nullptr) return;
    Eigen::Matrix3d d_u = Eigen::Matrix3d::Zero();
    d_u.row(2).head<2>() = 2.0 * values.head<2>().cwiseProduct(u.head<2>()).transpose();
    J->AddForceAtCom(kColumnAirVelocity, d_u);
    for (int i = 0; i < 2; ++i) {
      J->AddForceAtComParameter(i, squares[i] * Eigen::Vector3d::UnitZ());
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeAnisotropicHvt(const Vehicle& vehicle) {
  return std::make_unique<AnisotropicHvt>(vehicle);
}

}  // namespace odmc
