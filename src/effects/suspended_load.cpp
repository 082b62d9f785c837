#include <algorithm>
#include <cmath>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

constexpr int kPlace = 3, kFirstSwing = 6;              // of the parameters
constexpr double kShortest_m = 0.08, kLongest_m = 2.6;  // cables to try
constexpr double kLongestOverArm = 20.0;                // or longer, below a large vehicle
constexpr double kLengthRatio = 1.15;                   // from one length to the next
constexpr double kLengthReach = 1.5;                    // how far from there it is fitted
constexpr double kLeastDamping = 0.002, kMostDamping = 0.4;

/// A load on a cable: f = m_L R^T π at ξ, π the cable's pull per unit of load, from a pendulum that
/// the measured motion drives (Pendulum).                     model.md 12.17, Eq. (M44), (M27)
class SuspendedLoad final : public Effect {
 public:
  explicit SuspendedLoad(const Vehicle& vehicle)
      : Effect(vehicle,
               {"suspended_load", "Suspended load",
                "f = m_L R_WB^T pull at xi; pull = (l |dzeta/dt|^2 - zeta.(a + g e3)) zeta, zeta a "
                "pendulum of length l driven by the vehicle's motion",
                "model.md 12.17; Sreenath, Lee and Kumar 2013",
                "taut cable; driven outside the window; first order in the swing at the start"},
               {{"mass",
                 "kg",
                 "mass of the load",
                 0.0,
                 0.5 * vehicle.mass_kg,
                 0.1 * vehicle.mass_kg,
                 ParameterTransform::kLinear,
                 PhysicalSign::kPositive,
                 false,
                 {},
                 {},
                 false,
                 true},
                {"length", "m", "length of the cable, to the load's centre", 0.5, 0.5, 0.5,
                 ParameterTransform::kLog, PhysicalSign::kPositive, true},
                {"damping", "1", "damping ratio of the swing", 0.03, 0.03, 0.03,
                 ParameterTransform::kLog, PhysicalSign::kPositive, true},
                Place("x", vehicle, true),
                Place("y", vehicle, true),
                Place("z", vehicle, false),
                Start("swing_x", "zeta_x"),
                Start("swing_y", "zeta_y"),
                Start("swing_rate_x", "d zeta_x/dt over sqrt(g/l)"),
                Start("swing_rate_y", "d zeta_y/dt over sqrt(g/l)")}) {}

  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override {
    std::vector<EffectTrial> trials;
    const double arm = vehicle().ArmLength();
    const double longest_m = std::max(kLongest_m, kLongestOverArm * arm);
    for (double l = std::max(kShortest_m, arm); l < longest_m; l *= kLengthRatio) {
      for (const double damping : {0.02, 0.1}) {
        trials.push_back({{},
                          {{"mass", 0.05 * vehicle().mass_kg}, {"length", l}, {"damping", damping}},
                          {},
                          {"length", "damping"},
                          {{"length", {l / kLengthReach, l * kLengthReach}},
                           {"damping", {kLeastDamping, kMostDamping}}}});
      }
    }
    return trials;
  }
  std::vector<SettingRefinement> refinements() const override { return {{"length", kLengthRatio}}; }
  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"mass_change", "side steps, so that the load swings"},
            {"wind", "side steps, so that the load swings"}};
  }
  std::string added_mass_parameter() const override { return "mass"; }
  std::vector<DerivedFigure> DerivedFigures(const Eigen::VectorXd& own) const override {
    constexpr double kTurn = 6.283185307179586;
    return {{"swing_frequency", "Hz", std::sqrt(vehicle().gravity_m_s2 / own[1]) / kTurn}};
  }
  std::optional<PendulumParameters> pendulum() const override {
    return PendulumParameters{1, 2, kPlace, kFirstSwing};
  }

  std::vector<std::string> shown_by() const override { return {"octo", "aggressive", "circle"}; }
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    values[0] = 0.1 * vehicle().mass_kg;
    values[1] = 0.3 + 0.5 * std::min(1.0, std::abs(normal()));
    values[2] = 0.02 + 0.03 * std::min(1.0, std::abs(normal()));
    return values;
  }
  std::vector<std::string> size_parameters() const override { return {"mass"}; }

 private:
  static ParameterSpec Place(const std::string& axis, const Vehicle& vehicle, bool frozen) {
    return {axis,
            "m",
            "where the cable is fixed, body " + axis,
            0.0,
            0.2 * vehicle.ArmLength(),
            0.1 * vehicle.ArmLength(),
            ParameterTransform::kLinear,
            PhysicalSign::kAny,
            frozen};
  }

  static ParameterSpec Start(const std::string& name, const std::string& what) {
    constexpr double kNaturalSwing = 0.25;
    ParameterSpec spec;
    spec.name = name;
    spec.unit = "1";
    spec.description = "swing at the recording's start, in W: " + what;
    spec.prior_sigma = spec.scale = kNaturalSwing;
    spec.initial_state = true;
    return spec;
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d p_BP = values.segment<3>(kPlace);
    const Eigen::Matrix3d R_BW = state.R_WB.transpose();
    const Eigen::Vector3d pull_B = R_BW * state.load.For(values.segment<4>(kFirstSwing));
    wrench->AddForceAt(p_BP, values[0] * pull_B);
    if (J == nullptr) return;
    J->AddForceAt(p_BP, kColumnAttitude, values[0] * Hat(pull_B));
    J->AddForceAtParameter(p_BP, 0, pull_B);
    for (int i = 0; i < 3; ++i) {
      J->AddCoupleParameter(kPlace + i, values[0] * Eigen::Vector3d::Unit(i).cross(pull_B));
    }
    for (int i = 0; i < 4; ++i) {
      J->AddForceAtParameter(p_BP, kFirstSwing + i, values[0] * R_BW * state.load.d_swing.col(i));
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeSuspendedLoad(const Vehicle& vehicle) {
  return std::make_unique<SuspendedLoad>(vehicle);
}

}  // namespace odmc
