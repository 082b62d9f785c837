#include <algorithm>
#include <cmath>

#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

constexpr double kReach = 4.0;       // rotor radii: nothing is left of it above
constexpr double kDrawnBelow = 1.5;  // rotor radii below the lowest point flown

/// More thrust near the ground: T_j -> T_j (1 + k_ge (R/4h_j)²), h_j the hub's height; held at its
/// value at h = R below that.                                          model.md 12.13, Eq. (M40)
class GroundEffect final : public Effect {
 public:
  explicit GroundEffect(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"ground_effect", "Ground effect",
             "f_j = k_ge k_f Omega_j^2 (R/(4 h_j))^2 e3 at hub j, h_j = height of hub j above z_0",
             "model.md 12.13; Cheeseman and Bennett 1955; Sanchez-Cuevas et al. 2017",
             "hub heights above one radius; nothing is left of it above four radii"},
            {{"k_ge", "1", "size relative to a single rotor's theory", 0.0, 5.0, 1.0,
              ParameterTransform::kLinear, PhysicalSign::kPositive, false, "", "", false, true},
             {"z_0", "m", "height of the ground in the odometry's world", 0.0, 2.0, 0.1,
              ParameterTransform::kLinear, PhysicalSign::kAny, true, "", "", false, false, true}},
            {"thrust.k_f"}) {}

  std::vector<EffectTrial> Trials(const FlownRange& flown, bool) const override {
    const double radius = vehicle().rotors.front().radius_m;
    // At one height the ground's share is one with the thrust coefficient, and ground that may lie
    // anywhere only turns bank into torque: then it must have been seen.
    if (!flown.stood_m && flown.height_range_m < radius) return {};
    // Where the ground lies is fitted, from several places: far from it, the effect has no slope.
    // A vehicle that was seen to stand has shown the ground, up to the height of what it stands on.
    std::vector<double> grounds = {flown.lowest_m - 1.5 * radius, flown.lowest_m - 3.0 * radius};
    if (std::abs(flown.lowest_m) < kReach * radius) grounds.push_back(0.0);
    if (flown.stood_m) grounds = {*flown.stood_m, *flown.stood_m - 2.0 * radius};
    std::vector<EffectTrial> trials;
    for (const double z : grounds) {
      trials.push_back(
          {{}, {{"k_ge", 1.0}, {"z_0", z}}, {}, {"z_0"}, {{"z_0", {z - radius, z + radius}}}});
    }
    return trials;
  }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"hvt", "hover at several heights"}};
  }

  std::vector<std::string> shown_by() const override { return {"vertical", "octo"}; }
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    values[0] = 1.5;
    return values;
  }
  void Place(double lowest_m, Eigen::VectorXd* values) const override {
    (*values)[1] = lowest_m - kDrawnBelow * vehicle().rotors.front().radius_m;
  }
  std::vector<std::string> size_parameters() const override { return {"k_ge"}; }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const double height = state.p_WB.z() + (state.R_WB * rotor.p_BP).z() - values[1];
      const bool held = height < rotor.radius_m;
      const double h = std::max(height, rotor.radius_m);
      const double gain = rotor.radius_m * rotor.radius_m / (16.0 * h * h);
      const double square = state.rotors.speed_squared[j];
      wrench->AddForceAt(rotor.p_BP, values[0] * values[2] * square * gain * e3);
      if (J == nullptr) continue;
      J->AddForceAtParameter(rotor.p_BP, 0, values[2] * square * gain * e3);
      J->AddForceAtParameter(rotor.p_BP, 2, values[0] * square * gain * e3);
      if (held) continue;
      const double d_height = -2.0 * values[0] * values[2] * square * gain / h;
      const Eigen::RowVector3d up = Eigen::RowVector3d::UnitZ();
      J->AddForceAtParameter(rotor.p_BP, 1, -d_height * e3);
      J->AddForceAt(rotor.p_BP, kColumnPosition, d_height * e3 * up);
      J->AddForceAt(rotor.p_BP, kColumnAttitude,
                    -d_height * e3 * (up * state.R_WB * Hat(rotor.p_BP)));
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeGroundEffect(const Vehicle& vehicle) {
  return std::make_unique<GroundEffect>(vehicle);
}

}  // namespace odmc
