#include "odmc/bench/undeclared.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <memory>
#include <stdexcept>

#include "odmc/analysis/model_choice.h"
#include "odmc/attribution/residual.h"
#include "odmc/effects/effects.h"
#include "odmc/math/descent.h"
#include "odmc/math/gaussian.h"
#include "odmc/math/so3.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr double kDuration_s = 24.0;
constexpr double kAbsurd = 3.0;        // natural sizes (prior sigmas) no effect should need
constexpr double kNotExcited = 0.015;  // share below which an effect does not show
constexpr double kLeastShown = 0.7;    // of the planned share
constexpr int kSizings = 8;            // rounds, at most
constexpr double kSized = 0.03;        // change of size (log) that ends them
constexpr int kVehicleStream = 201, kUnknownStream = 203;

/// How strong an effect is: its share of the residual's variance.
struct Level {
  const char* name;
  double share;
};
const Level kLevels[] = {{"strong", 0.8}, {"medium", 0.3}, {"weak", 0.08}};

const std::vector<std::string> kFlown = {"octo", "aggressive", "circle", "vertical", "yaw"};

/// An effect with trajectories that show it, best first.
struct Excited {
  std::string effect;
  std::vector<std::string> trajectories;
};

/// Every effect that test flights are made with.
std::vector<Excited> Catalogue() {
  const Vehicle vehicle = UndeclaredVehicles().front();
  std::vector<Excited> list;
  for (const std::string& name : EffectRegistry::Default().names()) {
    const std::vector<std::string>& declared = vehicle.effects;
    if (std::find(declared.begin(), declared.end(), name) != declared.end()) continue;
    const auto trajectories = EffectRegistry::Default().Make(name, vehicle)->shown_by();
    if (!trajectories.empty()) list.push_back({name, trajectories});
  }
  return list;
}

/// The flights on which an effect acts and does not show, in the order of the plan: a trajectory
/// that leaves it alone.
const std::vector<std::pair<std::string, std::string>> kHidden = {
    {"quadratic_drag", "hover"}, {"rotor_hvt", "vertical"},     {"anisotropic_hvt", "hover"},
    {"hub_moment", "hover"},     {"rotor_gyroscopic", "hover"}, {"products_of_inertia", "hover"},
    {"rotor_drag", "hover"},     {"axial_inflow", "hover"},     {"rotor_delay", "hover"},
    {"pressure_centre", "yaw"},  {"rotor_asymmetry", "hover"},  {"wind", "hover"},
    {"rotor_reaction", "hover"}, {"quadratic_drag", "yaw"},     {"anisotropic_hvt", "vertical"},
};

Vehicle Made(const std::string& name, double mass, const Vector3d& inertia, double x, double y,
             double z, double radius, double k_f, bool plus) {
  Vehicle v;
  v.name = name;
  v.mass_kg = mass;
  v.inertia_kg_m2 = inertia;
  if (plus) {
    const double a = std::hypot(x, y);
    v.rotors = {{{a, 0.0, z}, 1.0, radius},
                {{0.0, -a, z}, -1.0, radius},
                {{-a, 0.0, z}, 1.0, radius},
                {{0.0, a, z}, -1.0, radius}};
  } else {
    v.rotors = {{{x, y, z}, 1.0, radius},
                {{x, -y, z}, -1.0, radius},
                {{-x, -y, z}, 1.0, radius},
                {{-x, y, z}, -1.0, radius}};
  }
  v.effects = DefaultEffects();
  v.parameters["thrust.k_f"] = {k_f, 0.3 * k_f, true};
  v.parameters["rotor_torque.k_m"] = {0.2 * radius * k_f, 0.06 * radius * k_f, false};
  return v;
}

/// The declared vehicle's true parameters: the usual ones, each a little off.
ModelValues TrueValues(const DynamicModel& model, Gaussian* random) {
  ModelValues truth = DefaultTruth(model);
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    if (!p.estimated) continue;
    truth[i] *= 1.0 + std::clamp(0.08 * random->Next(), -0.2, 0.2);
    // What is usually zero is a little off, too.
    if (truth[i] == 0.0) truth[i] = p.spec.prior_sigma / 5.0 * random->Next();
  }
  return truth;
}

/// An undeclared effect at a natural size.
struct DrawnEffect {
  std::unique_ptr<Effect> effect;
  Eigen::VectorXd values;  ///< of its parameters
};

DrawnEffect DrawEffect(const std::string& name, const Vehicle& vehicle, Gaussian* random) {
  DrawnEffect drawn;
  drawn.effect = EffectRegistry::Default().Make(name, vehicle);
  drawn.values = drawn.effect->Draw([random] { return random->Next(); });
  return drawn;
}

/// Writes an effect, `scale` times as large as drawn, to the values of `model`.
void SetScaled(const DrawnEffect& drawn, double scale, const DynamicModel& model,
               ModelValues* values) {
  const std::vector<std::string> scaled = drawn.effect->size_parameters();
  const std::vector<ParameterSpec>& specs = drawn.effect->parameters();
  for (size_t i = 0; i < specs.size(); ++i) {
    const bool is_size =
        scaled.empty() || std::find(scaled.begin(), scaled.end(), specs[i].name) != scaled.end();
    const double factor = is_size ? scale : 1.0;
    (*values)[model.IndexOf(drawn.effect->name() + "." + specs[i].name)] =
        factor * drawn.values[static_cast<Eigen::Index>(i)];
  }
}

/// A sum of waves with a first-order spectrum, each axis on its own.
class Wander {
 public:
  explicit Wander(Gaussian* random) {
    for (int i = 0; i < kWaves; ++i) {
      waves_.push_back(random->Next3());
      angles_.push_back(3.0 * random->Next3());
    }
  }

  Vector3d operator()(double t) const {
    Vector3d sum = Vector3d::Zero();
    for (int i = 0; i < kWaves; ++i) {
      const double f = 0.06 * std::pow(1.18, static_cast<double>(i));
      const double weight = std::sqrt(f) / (1.0 + f / 0.3);
      for (int k = 0; k < 3; ++k) {
        sum[k] += weight * waves_[i][k] * std::sin(6.2832 * f * t + angles_[i][k]);
      }
    }
    return sum;
  }

  /// One of its waves' directions.
  Vector3d Direction(int which) const { return waves_[which % kWaves].normalized(); }

 private:
  static constexpr int kWaves = 24;
  std::vector<Vector3d> waves_, angles_;
};

/// A disturbance outside every catalogue, of unit size in units of weight and weight times arm.
Unmodelled DrawUnknown(const Vehicle& vehicle, double scale, int seed) {
  Gaussian random(seed, kUnknownStream);
  const double force = scale * vehicle.mass_kg * vehicle.gravity_m_s2;
  const double torque = force * vehicle.ArmLength();
  const int kind = seed % 6;
  const Vector3d direction = random.Next3().normalized();
  const double phase = random.Next();
  const double frequency = 0.4 + 1.2 * std::min(1.5, std::abs(random.Next()));
  const Wander wander(&random);
  return [=](const FlightState& s) {
    BodyWrench w;
    const double t = s.time_s;
    switch (kind) {
      case 0:  // something on board that shakes
        w.f_B = force * std::sin(6.2832 * frequency * t + phase) * direction;
        break;
      case 1:  // a torque that wanders
        w.tau_Bcm_B = torque * wander(t);
        break;
      case 2: {  // knocks
        const double at = std::fmod(t + 1.3 + phase, 3.7);
        const int which = static_cast<int>((t + 1.3 + phase) / 3.7);
        if (at < 0.8) {
          w.f_B = 3.0 * force * std::sin(3.1416 * at / 0.8) * wander.Direction(which);
        }
        break;
      }
      case 3: {  // jets of air at places in the room
        const Vector3d p = s.p_WB;
        const double size = std::sin(4.0 * p.x() + phase) * std::cos(5.0 * p.y() - phase);
        w.f_B = 2.0 * force * size * (s.R_WB.transpose() * direction);
        break;
      }
      case 4:  // a tether that drags about the body
        w.f_B = force * wander(t).cwiseProduct(Vector3d(1.0, 0.3, 1.5));
        break;
      default:  // a loose part that rattles about the yaw and roll axes
        w.tau_Bcm_B = torque * std::sin(6.2832 * frequency * t + phase) * Vector3d(0.7, 0.0, 0.7) *
                      (std::sin(0.9 * t + phase) > 0.0 ? 1.0 : 0.2);
        break;
    }
    return w;
  };
}

using ChannelVariance = Eigen::Matrix<double, kNumChannels, 1>;

ChannelVariance VarianceOf(const ResidualModel::Wrenches& y) {
  return (y.colwise().squaredNorm() / y.rows()).transpose();
}

/// The declared model's parameters, fitted to a flight's residual as an estimator would: what the
/// channels weigh comes from the sensors' noise (a flight without noise would weigh the best fitted
/// channel most), and priors hold what the flight does not show. x holds the parameters that are
/// estimated.
class DeclaredFit {
 public:
  DeclaredFit(const ResidualModel* residual, const DynamicModel* model, const ModelValues& start,
              const ChannelVariance& noise)
      : residual_(residual),
        model_(model),
        start_(start),
        prior_(model->InitialValues()),
        weight_(noise.cwiseMax(1e-18).cwiseInverse()) {
    for (int k = 0; k < model->num_parameters(); ++k) {
      if (model->parameters()[k].estimated) free_.push_back(k);
    }
  }

  /// Variance per channel of the residual that the best parameters leave.
  ChannelVariance Variance() const {
    Eigen::VectorXd x(static_cast<Eigen::Index>(free_.size()));
    for (size_t a = 0; a < free_.size(); ++a) x[static_cast<Eigen::Index>(a)] = start_[free_[a]];
    DescentOptions options;
    options.most_steps = 6;
    const CostAt best = Descend(
        {x, Cost(x)}, options, [this](const CostAt& at) { return Step(at.x); },
        [this](const Eigen::VectorXd& at) { return Cost(at); });
    return VarianceOf(residual_->Residual(*model_, ValuesAt(best.x)));
  }

 private:
  const ParameterSpec& SpecOf(Eigen::Index a) const {
    return model_->parameters()[free_[static_cast<size_t>(a)]].spec;
  }

  ModelValues ValuesAt(const Eigen::VectorXd& x) const {
    ModelValues values = start_;
    for (size_t a = 0; a < free_.size(); ++a) values[free_[a]] = x[static_cast<Eigen::Index>(a)];
    return values;
  }

  double Cost(const Eigen::VectorXd& x) const {
    for (Eigen::Index a = 0; a < x.size(); ++a) {
      const bool is_positive = SpecOf(a).transform == ParameterTransform::kLog;
      if (is_positive && x[a] <= 0.0) return std::numeric_limits<double>::infinity();
    }
    const ResidualModel::Wrenches y = residual_->Residual(*model_, ValuesAt(x));
    double sum = (y.colwise().squaredNorm() * weight_)(0);
    for (Eigen::Index a = 0; a < x.size(); ++a) {
      sum += std::pow((x[a] - prior_[free_[a]]) / SpecOf(a).prior_sigma, 2);
    }
    return sum;
  }

  /// Gauss and Newton's.
  Eigen::VectorXd Step(const Eigen::VectorXd& x) const {
    const Eigen::Index n = x.size();
    const ModelValues values = ValuesAt(x);
    const ResidualModel::Wrenches y = residual_->Residual(*model_, values);
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd g = Eigen::VectorXd::Zero(n);
    std::vector<ResidualModel::Wrenches> columns;
    for (const int k : free_) columns.push_back(residual_->Derivative(*model_, values, k));
    for (Eigen::Index a = 0; a < n; ++a) {
      const double information = 1.0 / std::pow(SpecOf(a).prior_sigma, 2);
      g[a] = information * (prior_[free_[a]] - x[a]);
      H(a, a) = information;
      const ResidualModel::Wrenches weighted = columns[a] * weight_.asDiagonal();
      g[a] += weighted.cwiseProduct(y).sum();
      for (Eigen::Index b = 0; b < n; ++b) H(a, b) += weighted.cwiseProduct(columns[b]).sum();
    }
    const Eigen::VectorXd scale = H.diagonal().cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd scaled = scale.asDiagonal() * H * scale.asDiagonal();
    return scale.asDiagonal() * scaled.ldlt().solve(scale.cwiseProduct(g));
  }

  const ResidualModel* residual_;
  const DynamicModel* model_;
  ModelValues start_, prior_;
  ChannelVariance weight_;
  std::vector<int> free_;
};

/// Samples of the recording, as they are: shares of variance are those up to the filter's
/// bandwidth.
ThinnedFlight Thinned(const FlightLog& log, const Vehicle& vehicle) {
  return ThinnedFlight(FilterFlight(log, vehicle.num_rotors(), {}), {2.5, 1},
                       Eigen::Matrix3d::Identity(), 0.0, Thinning::kPick);
}

ChannelVariance FittedVariance(const FlightLog& log, const Vehicle& vehicle,
                               const DynamicModel& model, const ModelValues& start,
                               const ChannelVariance& noise) {
  const ThinnedFlight flight = Thinned(log, vehicle);
  const ResidualModel residual(&flight, &vehicle, true);
  return DeclaredFit(&residual, &model, start, noise).Variance();
}

}  // namespace

std::vector<Vehicle> UndeclaredVehicles() {
  return {
      Made("five_inch", 0.75, {2.5e-3, 2.1e-3, 4.3e-3}, 0.095, 0.11, 0.0, 0.0635, 1.5e-6, false),
      Made("seven_inch", 1.6, {9.0e-3, 1.1e-2, 1.8e-2}, 0.14, 0.12, 0.02, 0.089, 5.5e-6, false),
      Made("three_inch", 0.25, {2.6e-4, 2.4e-4, 4.5e-4}, 0.055, 0.055, 0.01, 0.038, 2.6e-7, false),
      Made("plus", 1.0, {5.5e-3, 5.0e-3, 9.5e-3}, 0.12, 0.12, 0.015, 0.0635, 2.2e-6, true),
  };
}

namespace {

/// Flight `i` of a set, on which nothing undeclared acts.
UndeclaredPlan PlanOf(int seed, int i) {
  UndeclaredPlan plan;
  plan.number = i;
  plan.seed = seed * 1000 + i;
  plan.vehicle = (i + i / 4) % 4;
  plan.trajectory = kFlown[i % kFlown.size()];
  return plan;
}

/// Makes one effect act, on a trajectory.
void ActBy(const std::string& effect, const std::string& trajectory, const Level& level,
           UndeclaredPlan* plan) {
  plan->kind = UndeclaredKind::kOneEffect;
  plan->effects = {effect};
  plan->trajectory = trajectory;
  plan->strength = level.name;
  plan->share = level.share;
}

}  // namespace

std::vector<UndeclaredPlan> PlanUndeclared(int seed, int flights) {
  const int nothing = (flights * 5 + 15) / 16, hidden = (flights * 3 + 31) / 32,
            unknown = (flights + 7) / 8, two = (flights + 15) / 16;
  const std::vector<Excited> catalogue = Catalogue();
  const int num = static_cast<int>(catalogue.size());
  std::vector<UndeclaredPlan> plans;
  for (int i = 0; i < flights; ++i) {
    UndeclaredPlan plan = PlanOf(seed, i);
    if (i < nothing) {
      plans.push_back(plan);
      continue;
    }
    if (i < nothing + hidden) {
      const auto& [effect, trajectory] = kHidden[(i - nothing) % kHidden.size()];
      plan.kind = UndeclaredKind::kNotExcited;
      plan.effects = {effect};
      plan.trajectory = trajectory;
    } else if (i < nothing + hidden + unknown) {
      plan.kind = UndeclaredKind::kUnknown;
      const int k = (i - nothing - hidden) % 2;
      plan.strength = kLevels[k].name;
      plan.share = kLevels[k].share;
    } else if (i < nothing + hidden + unknown + two) {
      const int k = i - nothing - hidden - unknown;
      plan.kind = UndeclaredKind::kTwoEffects;
      const Excited& a = catalogue[(5 * k + seed) % num];
      const Excited& b = catalogue[(5 * k + 7 + seed) % num];
      plan.effects = {a.effect, b.effect};
      plan.trajectory = a.trajectories.front();
      plan.strength = "strong";
      plan.share = 0.8;
    } else {
      const int k = i - nothing - hidden - unknown - two;
      const Excited& a = catalogue[k % num];
      ActBy(a.effect, a.trajectories[(k / num) % a.trajectories.size()], kLevels[(k / num + k) % 3],
            &plan);
    }
    plans.push_back(plan);
  }
  return plans;
}

std::vector<UndeclaredPlan> PlanNothing(int seed, int flights) {
  std::vector<UndeclaredPlan> plans;
  for (int i = 0; i < flights; ++i) {
    plans.push_back(PlanOf(seed, i));
  }
  return plans;
}

std::vector<UndeclaredPlan> PlanOneEffect(int seed, int flights, const std::string& effect) {
  const std::vector<Excited> catalogue = Catalogue();
  const auto flown = std::find_if(catalogue.begin(), catalogue.end(),
                                  [&](const Excited& e) { return e.effect == effect; });
  if (flown == catalogue.end()) {
    std::vector<std::string> names;
    for (const Excited& e : catalogue) names.push_back(e.effect);
    throw std::invalid_argument("no test flights are made with '" + effect + "', only with " +
                                Listed(names));
  }
  std::vector<UndeclaredPlan> plans;
  const int num = static_cast<int>(flown->trajectories.size());
  for (int i = 0; i < flights; ++i) {
    plans.push_back(PlanOf(seed, i));
    ActBy(effect, flown->trajectories[i % num],
          kLevels[(i + i / num) % static_cast<int>(std::size(kLevels))], &plans.back());
  }
  return plans;
}

std::vector<UndeclaredPlan> PlanUnknown(int seed, int flights) {
  std::vector<UndeclaredPlan> plans;
  for (int i = 0; i < flights; ++i) {
    const Level& level = kLevels[i % 2];
    UndeclaredPlan plan = PlanOf(seed, i);
    plan.kind = UndeclaredKind::kUnknown;
    plan.strength = level.name;
    plan.share = level.share;
    plans.push_back(plan);
  }
  return plans;
}

namespace {

/// What an effect makes of the residual grows with its size to some power, which the sizes flown
/// tell: two, unless the fit bends.
class Sizing {
 public:
  /// Moves a size to where it should make as much of the residual as wanted.
  /// @param ratio what it makes of it now, over what is there without it
  /// @returns the change of its logarithm
  double Resize(double ratio, double wanted, double* scale) {
    if (scale_ > 0.0 && std::abs(std::log(*scale / scale_)) > 1e-3) {
      power_ = std::clamp(std::log(ratio / ratio_) / std::log(*scale / scale_), 0.7, 4.0);
    }
    scale_ = *scale;
    ratio_ = ratio;
    const double factor = std::clamp(std::pow(wanted / ratio, 1.0 / power_), 0.05, 20.0);
    *scale = std::min(kAbsurd, *scale * factor);
    return std::abs(std::log(*scale / scale_));
  }

 private:
  double scale_ = 0.0, ratio_ = 0.0, power_ = 2.0;
};

Vehicle WithSensorsOf(const RecordingConditions& recording, Vehicle vehicle) {
  vehicle.odometry = recording.odometry;
  vehicle.imu = recording.imu;
  return vehicle;
}

std::vector<std::string> Joined(std::vector<std::string> effects,
                                const std::vector<std::string>& more) {
  effects.insert(effects.end(), more.begin(), more.end());
  return effects;
}

std::vector<DrawnEffect> DrawEffects(const std::vector<std::string>& names, const Vehicle& vehicle,
                                     Gaussian* random) {
  std::vector<DrawnEffect> drawn;
  for (const std::string& name : names) drawn.push_back(DrawEffect(name, vehicle, random));
  return drawn;
}

SimulationOptions OptionsOf(const UndeclaredPlan& plan, const RecordingConditions& recording) {
  SimulationOptions options;
  options.duration_s = kDuration_s;
  options.log_rate_hz = recording.log_rate_hz;
  options.pilot_bandwidth = recording.pilot_bandwidth;
  options.seed = plan.seed;
  options.trajectory = plan.trajectory;
  return options;
}

/// One flight as planned, whatever that shows: effects are drawn at a natural size, sized, flown.
class PlannedFlight {
 public:
  explicit PlannedFlight(const UndeclaredPlan& plan)
      : plan_(plan),
        random_(plan.seed, kVehicleStream),
        file_vehicle_(UndeclaredVehicles().at(plan.vehicle)),
        recording_(DrawRecording(plan.recording, plan.seed, file_vehicle_)),
        vehicle_(WithSensorsOf(recording_, file_vehicle_)),
        declared_(vehicle_, vehicle_.effects),
        base_(TrueValues(declared_, &random_)),
        options_(OptionsOf(plan, recording_)),
        drawn_(DrawEffects(plan.effects, vehicle_, &random_)),
        model_(vehicle_, Joined(vehicle_.effects, plan.effects)),
        scales_(plan.effects.size(), 1.0) {
    const FlightLog quiet =
        FlyAt(Recorded::kNoisy, std::vector<double>(scales_.size(), 0.0), 0.0).log;
    PlaceEffects(quiet);
    noise_ = NoiseIn(quiet);
    floor_ = Variance(quiet);
  }

  UndeclaredFlight Make() {
    if (IsSized()) SizeEffects();
    if (plan_.kind == UndeclaredKind::kNotExcited) HideEffect();
    UndeclaredFlight flight;
    flight.plan = plan_;
    flight.declared = file_vehicle_;
    flight.recording = recording_;
    flight.log = Fly().log;
    flight.truth = ExactParameters(model_, TruthAt(scales_));
    DeclareSensors(recording_, &flight.declared);
    SayWhatShows(&flight);
    return flight;
  }

 private:
  enum class Recorded { kNoisy, kExact };

  bool IsSized() const { return plan_.share > 0.0; }

  /// True parameters with the effects so many times as large as drawn.
  ModelValues TruthAt(const std::vector<double>& scales) const {
    ModelValues truth = model_.InitialValues();
    for (int i = 0; i < declared_.num_parameters(); ++i) {
      truth[model_.IndexOf(declared_.parameters()[i].full_name)] = base_[i];
    }
    for (size_t e = 0; e < drawn_.size(); ++e) SetScaled(drawn_[e], scales[e], model_, &truth);
    return truth;
  }

  SimulatedFlight FlyAt(Recorded recorded, const std::vector<double>& scales,
                        double unknown_scale) const {
    Unmodelled extra;
    if (plan_.kind == UndeclaredKind::kUnknown && unknown_scale > 0.0) {
      extra = DrawUnknown(vehicle_, unknown_scale, plan_.seed);
    }
    const bool noisy = recorded == Recorded::kNoisy;
    SimulatedFlight flown = Simulate(model_, TruthAt(scales), options_,
                                     noisy ? recording_.noise : SimulationNoise::None(), extra);
    if (noisy) Degrade(recording_, plan_.seed, &flown.log);
    return flown;
  }

  /// At the present sizes. What cannot be flown is made weaker.
  SimulatedFlight Fly() {
    constexpr int kTries = 8;
    for (int attempt = 1;; ++attempt) {
      try {
        return FlyAt(Recorded::kNoisy, scales_, IsSized() ? unknown_scale_ : 0.0);
      } catch (const std::runtime_error&) {
        if (attempt == kTries) throw;
        for (double& scale : scales_) scale *= 0.7;
        unknown_scale_ *= 0.7;
      }
    }
  }

  /// Puts effects that depend on the height where the flight is.
  void PlaceEffects(const FlightLog& quiet) {
    double lowest_m = std::numeric_limits<double>::max();
    for (const auto& sample : quiet.odometry) lowest_m = std::min(lowest_m, sample.p_WS.z());
    for (DrawnEffect& effect : drawn_) effect.effect->Place(lowest_m, &effect.values);
  }

  /// What the sensors' noise alone makes of the residual.
  ChannelVariance NoiseIn(const FlightLog& quiet) const {
    const ThinnedFlight thinned = Thinned(quiet, vehicle_);
    return VarianceOf(ResidualModel(&thinned, &vehicle_, true).Residual(declared_, base_));
  }

  ChannelVariance Variance(const FlightLog& log) const {
    return FittedVariance(log, vehicle_, declared_, base_, noise_);
  }

  /// What the effects in a flight make of the residual, over what is there without them.
  double RatioIn(const FlightLog& log) const {
    return std::max(Variance(log).cwiseQuotient(floor_).maxCoeff() - 1.0, 1e-3);
  }

  /// Searches the sizes at which the effects make up their share.
  void SizeEffects() {
    std::vector<Sizing> sizings(std::max<size_t>(1, scales_.size()));
    for (int round = 0; round < kSizings; ++round) {
      double change = 0.0;
      if (plan_.kind == UndeclaredKind::kUnknown) {
        const double ratio = RatioIn(Fly().log);
        change = sizings[0].Resize(ratio, plan_.share / (1.0 - plan_.share), &unknown_scale_);
      }
      for (size_t e = 0; e < scales_.size(); ++e) {
        change = std::max(change, SizeEffect(e, &sizings[e]));
      }
      if (change < kSized) break;
    }
  }

  /// One step of that for one effect, flown alone. @returns the change of its logarithm
  double SizeEffect(size_t e, Sizing* sizing) {
    const std::vector<double> all = scales_;
    scales_.assign(all.size(), 0.0);
    scales_[e] = all[e];
    const double ratio = RatioIn(Fly().log);
    const double flown = scales_[e];
    scales_ = all;
    scales_[e] = flown;
    // Of two effects the second makes up half as much.
    const double share = plan_.share * (e == 0 ? 1.0 : 0.5);
    return sizing->Resize(ratio, share / (1.0 - plan_.share), &scales_[e]);
  }

  /// Makes an effect so small that it does not show.
  void HideEffect() {
    const auto shows = [this] {
      const FlightLog still = FlyAt(Recorded::kExact, scales_, 0.0).log;
      return Variance(still).cwiseQuotient(floor_).maxCoeff() > kNotExcited / 2.0;
    };
    for (int attempt = 0; attempt < kSizings && shows(); ++attempt) scales_[0] *= 0.5;
  }

  /// How much of the residual the effects make up, and what a good attribution would answer.
  void SayWhatShows(UndeclaredFlight* flight) const {
    const ChannelVariance total = Variance(flight->log);
    // An effect at its natural size may be far smaller than what two flights differ by.
    const ChannelVariance without =
        IsSized() ? floor_
                  : ChannelVariance(total - Variance(FlyAt(Recorded::kExact, scales_, 0.0).log));
    for (int c = 0; c < kNumChannels; ++c) {
      flight->axis_share.push_back(
          std::clamp(1.0 - without[c] / std::max(total[c], 1e-300), 0.0, 1.0));
    }
    flight->share = *std::max_element(flight->axis_share.begin(), flight->axis_share.end());
    if (plan_.kind == UndeclaredKind::kNothing) flight->share = 0.0;
    if (plan_.kind == UndeclaredKind::kNothing || flight->share < kNotExcited) {
      flight->right_answer = "none";
    } else {
      flight->right_answer = plan_.kind == UndeclaredKind::kUnknown ? "unexplained" : "effect";
    }
  }

  const UndeclaredPlan plan_;
  Gaussian random_;
  const Vehicle file_vehicle_;
  const RecordingConditions recording_;
  const Vehicle vehicle_;  ///< with its sensors where they are
  const DynamicModel declared_;
  const ModelValues base_;  ///< true parameters of that model
  const SimulationOptions options_;
  std::vector<DrawnEffect> drawn_;
  const DynamicModel model_;    ///< with the undeclared effects
  std::vector<double> scales_;  ///< of the drawn effects
  double unknown_scale_ = 0.02;
  ChannelVariance noise_;  ///< that the sensors make of the residual
  ChannelVariance floor_;  ///< of the fitted residual without the effects
};

}  // namespace

UndeclaredFlight MakeUndeclared(const UndeclaredPlan& plan) {
  UndeclaredFlight flight = PlannedFlight(plan).Make();
  if (plan.kind != UndeclaredKind::kOneEffect) return flight;
  // Where no sensible size shows as much as planned, on another trajectory it may.
  for (const Excited& excited : Catalogue()) {
    if (plan.effects.front() != excited.effect) continue;
    for (const std::string& trajectory : excited.trajectories) {
      if (flight.share > kLeastShown * plan.share) break;
      UndeclaredPlan other = plan;
      other.trajectory = trajectory;
      UndeclaredFlight flown = PlannedFlight(other).Make();
      if (flown.share > flight.share) flight = std::move(flown);
    }
  }
  // What shows nowhere as much as planned is called what it is.
  for (const Level& level : kLevels) {
    if (level.share >= flight.plan.share) continue;
    if (flight.share < std::sqrt(level.share * flight.plan.share)) {
      flight.plan.strength = level.name;
      flight.plan.share = level.share;
    }
  }
  return flight;
}

namespace {

std::string FormatMount(const SensorMount& mount) {
  const Vector3d& p = mount.p_BS;
  const Eigen::Quaterniond& q = mount.q_BS;
  std::string text = Format(
      "{frame: sensor, p_BS_m: [%.9g, %.9g, %.9g], q_BS_xyzw: [%.12g, %.12g, %.12g, "
      "%.12g], estimate: %s",
      p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w(), mount.estimate ? "true" : "false");
  const auto add = [&text](const char* key, const std::optional<double>& sigma) {
    if (sigma) text += Format(", %s: %.9g", key, *sigma);
  };
  add("p_BS_sigma_m", mount.p_BS_sigma_m);
  add("q_BS_sigma_rad", mount.q_BS_sigma_rad);
  return text + "}";
}

}  // namespace

std::string FormatVehicle(const Vehicle& v) {
  std::string text = "name: " + v.name + "\n";
  text += Format("mass_kg: %.9g\ngravity_m_s2: %.9g\n", v.mass_kg, v.gravity_m_s2);
  text += Format("inertia_kg_m2: [%.9e, %.9e, %.9e]\nrotors:\n", v.inertia_kg_m2.x(),
                 v.inertia_kg_m2.y(), v.inertia_kg_m2.z());
  for (const Rotor& r : v.rotors) {
    text += Format("  - {position_m: [%.9g, %.9g, %.9g], spin: %s, radius_m: %.9g}\n", r.p_BP.x(),
                   r.p_BP.y(), r.p_BP.z(), r.spin > 0.0 ? "cw" : "ccw", r.radius_m);
  }
  const SensorMount body;
  const bool has_mount = v.odometry.p_BS != body.p_BS || v.odometry.estimate ||
                         v.odometry.q_BS.coeffs() != body.q_BS.coeffs();
  text += "odometry: " + (has_mount ? FormatMount(v.odometry) : "{frame: body}") + "\n";
  if (v.imu) text += "imu: " + FormatMount(*v.imu) + "\n";
  text += "effects: [" + Listed(v.effects) + "]\nparameters:\n";
  for (const auto& [name, p] : v.parameters) {
    text +=
        Format("  %s: {value: %.9e, sigma: %.9e, state: %s}\n", name.c_str(), p.value.value_or(0.0),
               p.sigma.value_or(1.0), p.estimated.value_or(true) ? "estimated" : "frozen");
  }
  return text;
}

}  // namespace odmc
