#include <algorithm>
#include <cmath>

#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Wind that comes and goes: the same, with W a first-order Gauss-Markov process of standard
/// deviation `sigma` (`vertical_sigma` along world z) and correlation time `time_constant`.
///                                                                 model.md 12.11, Eq. (M39)
class Gust final : public Effect {
 public:
  explicit Gust(const Vehicle& vehicle)
      : Effect(vehicle,
               {"gust", "Gusts", "v_AB_B = R_WB^T (v_WB - W), dW/dt = -W/T + white noise",
                "model.md 12.11; Dryden's first-order form",
                "the estimate is the wind of the present window; seen only through the drag"},
               {Varying("x", "sigma"),
                Varying("y", "sigma"),
                Varying("z", "vertical_sigma"),
                {"sigma", "m/s", "standard deviation of the gusts along world x and y", 1.0, 1.0,
                 1.0, ParameterTransform::kLog, PhysicalSign::kPositive, true},
                {"time_constant", "s", "correlation time of the gusts", 2.0, 1.4, 2.0,
                 ParameterTransform::kLog, PhysicalSign::kPositive, true},
                {"vertical_sigma", "m/s", "standard deviation of the gusts along world z", 1.0, 1.0,
                 1.0, ParameterTransform::kLog, PhysicalSign::kPositive, true}}) {}

  bool adds_wrench() const override { return false; }
  bool belongs_to_flight() const override { return true; }
  BodyPropertyRows shaped_rows() const override { return {kRowWind, 3}; }

  /// No candidate: no fixed regressor shows what varies; it has a test of its own.
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override { return {}; }

  std::vector<std::string> shown_by() const override { return {"octo", "circle", "vertical"}; }
  Eigen::VectorXd Draw(const NormalNumbers& normal) const override {
    Eigen::VectorXd values = Effect::Draw(normal);
    values.head<3>().setZero();
    values[3] = 1.0;
    values[4] = 1.0 + 1.5 * std::min(1.0, std::abs(normal()));
    values[5] = 1.0;
    return values;
  }
  std::vector<std::string> size_parameters() const override { return {"sigma", "vertical_sigma"}; }

 private:
  static ParameterSpec Varying(const std::string& axis, const std::string& sigma) {
    ParameterSpec spec = WindSpec(axis);
    spec.process_sigma = sigma;
    spec.process_time_constant = "time_constant";
    return spec;
  }

  void DoShape(const ParameterValues& values, BodyProperties* body,
               BodyPropertyJacobian* J) const override {
    body->wind_W += values.head<3>();
    if (J != nullptr) J->block<3, 3>(kRowWind, 0).setIdentity();
  }
};

}  // namespace

std::unique_ptr<Effect> MakeGust(const Vehicle& vehicle) { return std::make_unique<Gust>(vehicle); }

}  // namespace odmc
