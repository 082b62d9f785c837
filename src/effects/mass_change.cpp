#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <utility>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

constexpr double kStep_s = 1.0;       // from one time to try to the next
constexpr double kShortest_s = 0.05;  // of its refinement
constexpr double kLeast = 1e-3;       // of the vehicle's mass, on either side of none
constexpr double kMostLost = 0.9;     // of it; with none left there is no motion to speak of
constexpr double kOff = 0.03;         // of the arms' length, above and below: where a fit begins
constexpr double kFar = 3.0;          // the same: ten sigmas of its place
constexpr double kEdge_s = 2.0;       // no change is looked for closer to start and end

/// A load m_L at ξ from the instant `from` on: mass, centre of mass and inertia of both together.
/// With s = ξ - c and the reduced mass μ = m m_L/(m + m_L): c' = c + m_L/(m + m_L) s,
/// I' = I + μ (|s|² 1 - s sᵀ).                                           model.md 12.15, Eq. (M42)
class MassChange final : public Effect {
 public:
  explicit MassChange(const Vehicle& vehicle)
      : Effect(vehicle,
               {"mass_change", "Change of mass",
                "m' = m + m_L, c' = c + m_L/m' s, I' = I + m m_L/m' (|s|^2 1 - s s^T), s = xi - c, "
                "from t = from on",
                "model.md 12.15",
                "needs a known k_f, or a change in flight; never free the whole flight's mass "
                "together with k_f"},
               {{"mass", "kg", "added mass, negative for a loss", 0.0, 0.5 * vehicle.mass_kg,
                 0.1 * vehicle.mass_kg},
                Place("x", vehicle),
                Place("y", vehicle),
                Place("z", vehicle),
                {"from", "s", "when it is added, since the recording's start", 0.0, 1.0, 1.0,
                 ParameterTransform::kLinear, PhysicalSign::kAny, true}},
               {"centre_of_gravity.x", "centre_of_gravity.y", "centre_of_gravity.z"}) {}

  bool adds_wrench() const override { return false; }
  BodyPropertyRows shaped_rows() const override { return {kRowMass, kRowGravity}; }
  std::string onset_parameter() const override { return "from"; }
  bool depends_on_time() const override { return true; }

  std::vector<EffectTrial> Trials(const FlownRange& flown, bool fits_thrust) const override {
    std::vector<EffectTrial> trials;
    // Its moment alone does not tell more mass here from less mass there, nor its inertia above
    // from below: four valleys, and no step leads from one to another.
    const auto try_from = [&](double t) {
      const double some = 0.05 * vehicle().mass_kg, least = kLeast * vehicle().mass_kg;
      const double most = vehicle().mass_kg, lost = kMostLost * vehicle().mass_kg;
      const double off = kOff * vehicle().ArmLength(), far = kFar * vehicle().ArmLength();
      for (const double z : {-off, off}) {
        const std::pair<double, double> side = z < 0.0 ? std::pair(-far, 0.0) : std::pair(0.0, far);
        const auto start = [&](double mass) {
          return std::map<std::string, double>{{"mass", mass}, {"z", z}};
        };
        trials.push_back(
            {{{"from", t}}, start(some), {}, {}, {{"mass", {least, most}}, {"z", side}}});
        trials.push_back(
            {{{"from", t}}, start(-some), {}, {}, {{"mass", {-lost, -least}}, {"z", side}}});
      }
    };
    // Over the whole flight a mass is one with the thrust coefficient.
    if (!fits_thrust) try_from(0.0);
    for (double t = flown.start_s + kEdge_s; t < flown.end_s - kEdge_s; t += kStep_s) try_from(t);
    return trials;
  }
  std::vector<SettingRefinement> refinements() const override {
    return {{"from", 0.0, kStep_s, kShortest_s, 0.0}};
  }
  std::string added_mass_parameter() const override { return "mass"; }

  std::vector<std::string> shown_by() const override { return {"octo", "vertical", "circle"}; }
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    values[0] = (normal() > 0.0 ? 0.1 : -0.08) * vehicle().mass_kg;
    values[4] = 8.0 + 4.0 * std::min(1.0, std::abs(normal()));
    values[3] = -0.1 * vehicle().ArmLength();
    return values;
  }
  std::vector<std::string> size_parameters() const override { return {"mass"}; }

 private:
  static ParameterSpec Place(const std::string& axis, const Vehicle& vehicle) {
    return {axis,
            "m",
            "place of the added mass, body " + axis,
            0.0,
            0.3 * vehicle.ArmLength(),
            0.1 * vehicle.ArmLength()};
  }

  void DoShapeAt(double time_s, const ParameterValues& values, BodyProperties* body,
                 BodyPropertyJacobian* J) const override {
    if (time_s < values[4]) return;
    const double m = vehicle().mass_kg, added = values[0];
    const double total = m + added;
    const Eigen::Vector3d s = values.segment<3>(1) - values.segment<3>(5);
    const double share = added / total, reduced = m * share;
    const Eigen::Matrix3d spread =
        s.squaredNorm() * Eigen::Matrix3d::Identity() - s * s.transpose();
    body->mass += added;
    body->p_BBcm += share * s;
    body->I_BBcm_B += reduced * spread;
    if (J == nullptr) return;
    const auto rows = [](const Eigen::Matrix3d& a) {
      Eigen::Matrix<double, 6, 1> r;
      r << a(0, 0), a(1, 1), a(2, 2), a(0, 1), a(0, 2), a(1, 2);
      return r;
    };
    const double d_share = m / (total * total);
    (*J)(kRowMass, 0) = 1.0;
    J->block<3, 1>(kRowCom, 0) = d_share * s;
    J->block<6, 1>(kRowInertia, 0) = m * d_share * rows(spread);
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3d ds = Eigen::Vector3d::Unit(i);
      const Eigen::Matrix3d d_spread =
          2.0 * s[i] * Eigen::Matrix3d::Identity() - ds * s.transpose() - s * ds.transpose();
      for (const auto& [column, sign] : {std::pair<int, double>{1 + i, 1.0}, {5 + i, -1.0}}) {
        J->block<3, 1>(kRowCom, column) = sign * share * ds;
        J->block<6, 1>(kRowInertia, column) = sign * reduced * rows(d_spread);
      }
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeMassChange(const Vehicle& vehicle) {
  return std::make_unique<MassChange>(vehicle);
}

}  // namespace odmc
