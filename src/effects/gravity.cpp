#include <algorithm>

#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

/// Direction of gravity in the odometry's world: g_W = -g R_G e3, R_G = Exp((x, y, 0)). Two degrees
/// of freedom, since a turn about e3 changes nothing.            model.md sections 1 and 7
class Gravity final : public Effect {
 public:
  explicit Gravity(const Vehicle& vehicle)
      : Effect(vehicle,
               {"gravity", "Gravity direction", "g_W = -g Exp((x, y, 0)) e3",
                "model.md sections 1, 6.5 and 7; paper Eq. (1)",
                "one with odometry roll and pitch extrinsics while the heading is constant"},
               {{"x", "rad", "turn of the vertical about world x", 0.0, 0.05, 0.05},
                {"y", "rad", "turn of the vertical about world y", 0.0, 0.05, 0.05}}) {}

  bool adds_wrench() const override { return false; }
  bool belongs_to_flight() const override { return true; }
  BodyPropertyRows shaped_rows() const override { return {kRowGravity, 3}; }

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"rotor_tilt", "yaw by 90 degrees or more while flying"},
            {"thrust_lean", "yaw by 90 degrees or more while flying"}};
  }

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {
        "turns of the heading by 90 degrees and more in hover",
        "turns of the heading by 90 degrees and more in hover"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  void DoShape(const ParameterValues& values, BodyProperties* body,
               BodyPropertyJacobian* J) const override {
    const Eigen::Vector3d turn(values[0], values[1], 0.0);
    Eigen::Matrix3d J_r;
    const Eigen::Matrix3d R_G = Exp(turn, &J_r).toRotationMatrix();
    const Eigen::Vector3d nominal_W = body->g_W;
    body->g_W = R_G * nominal_W;
    if (J == nullptr) return;
    J->block<3, 2>(kRowGravity, 0) = -R_G * HatTimes(nominal_W, J_r.leftCols<2>());
  }
};

}  // namespace

std::unique_ptr<Effect> MakeGravity(const Vehicle& vehicle) {
  return std::make_unique<Gravity>(vehicle);
}

}  // namespace odmc
