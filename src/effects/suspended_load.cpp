#include <algorithm>
#include <cmath>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

constexpr int kPlace = 3, kFirstSwing = 6;              // of the parameters
constexpr double kShortest_m = 0.08, kLongest_m = 2.6;  // cables to try
constexpr double kLengthRatio = 1.15;                   // from one length to the next
constexpr double kLengthReach = 1.5;                    // how far from there it is fitted
constexpr double kLeastDamping = 0.002, kMostDamping = 0.4;

/// A load on a cable: f = T R^T ζ at ξ, ζ the cable's direction, from a pendulum that the measured
/// motion drives (Pendulum). Along its cable the load is carried as mass: with F all other forces,
///
///   T = m_L (l |dζ/dt|² - ζ·(a_P + g e3)),  m (a_Bcm + g e3) = F + T ζ
///
/// and so T = m_L/(m + m_L) (m own - ζ·F), own as in LoadPull. The measured acceleration is not
/// used: its noise is in the force as well.               model.md 12.17, Eqs. (M27), (M46)
class SuspendedLoad final : public Effect {
 public:
  explicit SuspendedLoad(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"suspended_load", "Suspended load",
             "f = T R_WB^T zeta at xi; T = m_L (l |dzeta/dt|^2 - zeta.(a + g e3)), with m (a + g "
             "e3) the sum of all forces; zeta a pendulum of length l driven by the vehicle's "
             "motion",
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
    for (double l = std::max(kShortest_m, arm); l < kLongest_m; l *= kLengthRatio) {
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
  std::vector<TellingPair> telling_pairs() const override {
    return {{"mass_change", "side steps, so that the load swings"},
            {"wind", "side steps, so that the load swings"}};
  }
  std::string added_mass_parameter() const override { return "mass"; }
  std::vector<DerivedFigure> DerivedFigures(const Eigen::VectorXd& own) const override {
    constexpr double kTurn = 6.283185307179586;
    return {{"swing_frequency", "Hz", std::sqrt(vehicle().gravity_m_s2 / own[1]) / kTurn}};
  }
  bool reacts_to_force() const override { return true; }
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
    const LoadPull load = state.load.For(values.segment<4>(kFirstSwing));
    const Eigen::Vector3d cable_B = R_BW * load.cable_W, others_B = wrench->f_B;
    const double mass = vehicle().mass_kg, total = mass + values[0], share = values[0] / total;
    const double pull = mass * load.own_m_s2 - cable_B.dot(others_B);
    if (!(pull > 0.0)) return;  // slack
    const double tension = share * pull;
    wrench->AddForceAt(p_BP, tension * cable_B);
    if (J == nullptr) return;
    J->AddForceAtByForce(p_BP, -share * cable_B * cable_B.transpose());
    // By a change of the cable's direction.
    const Eigen::Matrix3d by_cable =
        tension * Eigen::Matrix3d::Identity() - share * cable_B * others_B.transpose();
    J->AddForceAt(p_BP, kColumnAttitude, by_cable * Hat(cable_B));
    J->AddForceAtParameter(p_BP, 0, mass * pull / (total * total) * cable_B);
    for (int i = 0; i < 3; ++i) {
      J->AddCoupleParameter(kPlace + i, tension * Eigen::Vector3d::Unit(i).cross(cable_B));
    }
    for (int i = 0; i < 4; ++i) {
      const Eigen::Vector4d by_swing = load.d_swing.col(i);
      J->AddForceAtParameter(
          p_BP, kFirstSwing + i,
          by_cable * (R_BW * by_swing.head<3>()) + share * mass * by_swing[3] * cable_B);
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeSuspendedLoad(const Vehicle& vehicle) {
  return std::make_unique<SuspendedLoad>(vehicle);
}

}  // namespace odmc
