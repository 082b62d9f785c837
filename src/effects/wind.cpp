#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Constant wind: v_AB_B = R^T (v - W) in every effect that looks at the air.
///                                                                 model.md 12.11, Eq. (M39)
class Wind final : public Effect {
 public:
  explicit Wind(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"wind", "Constant wind", "v_AB_B = R_WB^T (v_WB - W), W constant",
             "model.md 12.11; Shastry and Paley 2021",
             "one with a tilt of gravity unless drag depends on attitude or speed; indoors zero"},
            {WindSpec("x"), WindSpec("y"), WindSpec("z")}) {}

  bool adds_wrench() const override { return false; }
  bool belongs_to_flight() const override { return true; }
  BodyPropertyRows shaped_rows() const override { return {kRowWind, 3}; }

  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override {
    // Air speed enters some effects squared: wind has more than one valley.
    std::vector<EffectTrial> trials(1);
    for (const double w : {-4.0, 4.0}) {
      trials.push_back({{}, {{"w_x", w}}});
      trials.push_back({{}, {{"w_y", w}}});
    }
    return trials;
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"gravity", "yaw by 90 degrees or more while flying"},
            {"rotor_tilt", "yaw by 90 degrees or more while flying"},
            {"thrust_lean", "yaw by 90 degrees or more while flying"}};
  }

  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    values[2] *= 0.1;
    return values;
  }

 private:
  void DoShape(const ParameterValues& values, BodyProperties* body,
               BodyPropertyJacobian* J) const override {
    body->wind_W += values.head<3>();
    if (J != nullptr) J->block<3, 3>(kRowWind, 0).setIdentity();
  }
};

}  // namespace

std::unique_ptr<Effect> MakeWind(const Vehicle& vehicle) { return std::make_unique<Wind>(vehicle); }

}  // namespace odmc
