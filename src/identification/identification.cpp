#include "odmc/identification/identification.h"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>

#include "odmc/actuator/free_run.h"
#include "odmc/math/statistics.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

using Signals = std::vector<MotorSignal>;

constexpr double kCauchy = 2.385;        // 95 % efficient
constexpr double kOutlier_sigmas = 8.0;  // of the robust sigma
constexpr double kBlock_s = 0.5;         // errors farther apart count as independent
constexpr int kBlock_rows = 20;          // the same for readings without time
constexpr double kLeastSigma_rad_s = 0.1;
constexpr double kKnownShare = 0.5;   // of the prior's sigma, at most, is known
constexpr double kKnownSigmas = 2.0;  // from zero

// ---- Parameters of the fit -----------------------------------------------------------------
// Scaled so that each is of order one and hardly moves when another does: gains in units of speed
// at a reference, S1 and S2 as time constant and share of S2 at the reference speed.

enum Index { kRoot, kLinear, kConstant, kLogStart, kLogTau, kShare, kDelay, kNumParameters };
using Vector = Eigen::Matrix<double, kNumParameters, 1>;
using Matrix = Eigen::Matrix<double, kNumParameters, kNumParameters>;

struct Scale {
  double speed = 1.0;    // mean [rad/s]
  double voltage = 1.0;  // mean [V]
  double least = 0.0;    // throttle while it turns
};

Vector PriorMean() {
  Vector mean;
  mean << 1.0, 0.0, 0.0, std::log(0.2), std::log(0.03), 0.4, 0.005;
  return mean;
}
Vector PriorSigma() {
  Vector sigma;
  sigma << 10.0, 5.0, 3.0, 1.2, 0.8, 0.25, 0.02;
  return sigma;
}

Motor MotorFrom(const double* p, const Scale& scale) {
  Motor motor;
  const double rate = std::exp(-p[kLogTau]);  // S1 + 2 S2 speed
  motor.dynamics.S2 = p[kShare] * rate / (2.0 * scale.speed);
  motor.dynamics.S1 = (1.0 - p[kShare]) * rate;
  const double unit = motor.dynamics.DriveFor(scale.speed);
  motor.esc.root = p[kRoot] * unit / scale.voltage;
  motor.esc.linear = p[kLinear] * unit;
  motor.esc.constant = p[kConstant] * unit;
  motor.esc.start = scale.least - std::exp(p[kLogStart]);
  motor.delay_s = p[kDelay];
  return motor;
}

Vector ParametersOf(const Motor& motor, const Scale& scale) {
  const double rate = 1.0 / motor.dynamics.TimeConstant(scale.speed);
  const double unit = motor.dynamics.DriveFor(scale.speed);
  Vector p;
  p[kRoot] = motor.esc.root * scale.voltage / unit;
  p[kLinear] = motor.esc.linear / unit;
  p[kConstant] = motor.esc.constant / unit;
  p[kLogStart] = std::log(std::max(scale.least - motor.esc.start, 1e-6));
  p[kLogTau] = -std::log(rate);
  p[kShare] = 2.0 * motor.dynamics.S2 * scale.speed / rate;
  p[kDelay] = motor.delay_s;
  return p;
}

constexpr std::array<std::pair<double, double>, kNumParameters> kBounds = {
    {{-1e3, 1e3}, {-1e3, 1e3}, {-1e3, 1e3}, {-9.0, 1.5}, {-6.0, -1.0}, {0.0, 0.97}, {-0.02, 0.15}}};

Scale ScaleOf(const Signals& signals) {
  double speed = 0.0, voltage = 0.0, least = std::numeric_limits<double>::infinity();
  long count = 0;
  for (const MotorSignal& signal : signals) {
    for (size_t i = 0; i < signal.throttle.size(); ++i) {
      if (!std::isfinite(signal.speed_rad_s[i])) continue;
      speed += signal.speed_rad_s[i];
      voltage += signal.voltage_V[i];
      least = std::min(least, signal.throttle[i]);
      ++count;
    }
  }
  const double n = static_cast<double>(std::max(count, 1L));
  return {speed / n, voltage / n, least};
}

// ---- Free-run errors -----------------------------------------------------------------------

// Model less measured, row by row of all signals; NaN where nothing was measured.
std::vector<double> Errors(const Motor& motor, const Signals& signals) {
  std::vector<double> errors;
  for (const MotorSignal& signal : signals) {
    const std::vector<double> speed = FreeRun(motor, signal);
    for (size_t i = 0; i < speed.size(); ++i) errors.push_back(speed[i] - signal.speed_rad_s[i]);
  }
  return errors;
}

double RobustSigmaOf(const std::vector<double>& errors) {
  std::vector<double> finite;
  for (const double e : errors) {
    if (std::isfinite(e)) finite.push_back(e);
  }
  return std::max(RobustSigma(std::move(finite)), kLeastSigma_rad_s);
}

// Sum of Cauchy losses, in sigmas: what starts are compared by.
double RobustCost(const std::vector<double>& errors) {
  const double sigma = RobustSigmaOf(errors);
  double cost = 0.0;
  for (const double e : errors) {
    if (std::isfinite(e)) cost += std::log1p(std::pow(e / (kCauchy * sigma), 2));
  }
  return cost + static_cast<double>(errors.size()) * std::log(sigma);
}

// What Ceres minimises: weighted errors and the priors.
class FreeRunCost {
 public:
  FreeRunCost(const Signals* signals, const Scale& scale, const Vector& mean, const Vector& sigma,
              std::vector<double> weights)
      : signals_(signals),
        scale_(scale),
        mean_(mean),
        sigma_(sigma),
        weights_(std::move(weights)) {}

  int num_residuals() const { return static_cast<int>(weights_.size()) + kNumParameters; }

  bool operator()(double const* const* parameters, double* residuals) const {
    const double* p = parameters[0];
    const std::vector<double> errors = Errors(MotorFrom(p, scale_), *signals_);
    for (size_t i = 0; i < errors.size(); ++i)
      residuals[i] = weights_[i] > 0.0 ? weights_[i] * errors[i] : 0.0;
    for (int k = 0; k < kNumParameters; ++k)
      residuals[errors.size() + static_cast<size_t>(k)] = (p[k] - mean_[k]) / sigma_[k];
    return true;
  }

 private:
  const Signals* signals_;
  Scale scale_;
  Vector mean_, sigma_;
  std::vector<double> weights_;
};

// By the robust sigma; what is far off weighs less.
std::vector<double> Weights(const std::vector<double>& errors, double sigma) {
  std::vector<double> weights(errors.size(), 0.0);
  for (size_t i = 0; i < errors.size(); ++i) {
    if (std::isfinite(errors[i]))
      weights[i] = 1.0 / (sigma * std::sqrt(1.0 + std::pow(errors[i] / (kCauchy * sigma), 2)));
  }
  return weights;
}

// Errors of the map are slow: each hangs on the one before (correlation r) and counts for the map
// as sqrt((1 - r) / (1 + r)) of an independent one. The map's priors weigh more by the inverse, or
// else they would drown. The dynamics live on quick changes, for which this does not hold.
double MapPriorWeight(const std::vector<double>& errors, double sigma) {
  const auto robust = [sigma](double e) { return std::clamp(e, -3.0 * sigma, 3.0 * sigma); };
  double product = 0.0, square = 0.0;
  for (size_t i = 1; i < errors.size(); ++i) {
    if (!std::isfinite(errors[i]) || !std::isfinite(errors[i - 1])) continue;
    product += robust(errors[i]) * robust(errors[i - 1]);
    square += robust(errors[i]) * robust(errors[i]);
  }
  const double correlation = square > 0.0 ? std::clamp(product / square, 0.0, 0.995) : 0.0;
  return std::sqrt((1.0 + correlation) / (1.0 - correlation));
}

bool IsOfMap(int k) { return k <= kLogStart; }

struct Refined {
  Vector p;
  Matrix covariance;  // errors within a block counted together
};

// Block of each error: errors of a block are not independent.
std::vector<int> BlocksOf(const Signals& signals) {
  std::vector<int> blocks;
  int block = 0;
  for (const MotorSignal& signal : signals) {
    double start = signal.t_s.empty() ? 0.0 : signal.t_s.front();
    for (size_t i = 0; i < signal.throttle.size(); ++i) {
      if (signal.t_s.empty() ? i % kBlock_rows == kBlock_rows - 1
                             : signal.t_s[i] - start > kBlock_s) {
        ++block;
        if (!signal.t_s.empty()) start = signal.t_s[i];
      }
      blocks.push_back(block);
    }
    ++block;
  }
  return blocks;
}

// A^-1 B A^-1 with B from the sums of each block: right also where errors hang together.
Matrix SandwichCovariance(const ceres::CostFunction& cost, const Vector& p, const Signals& signals,
                          double map_prior) {
  const int rows = cost.num_residuals();
  Eigen::Matrix<double, Eigen::Dynamic, kNumParameters, Eigen::RowMajor> jacobian(rows,
                                                                                  kNumParameters);
  Eigen::VectorXd residuals(rows);
  const double* blocks_in[] = {p.data()};
  double* jacobians[] = {jacobian.data()};
  cost.Evaluate(blocks_in, residuals.data(), jacobians);
  const Matrix A = jacobian.transpose() * jacobian;
  const std::vector<int> block = BlocksOf(signals);
  Matrix B = Matrix::Zero();
  Vector sum = Vector::Zero();
  for (size_t i = 0; i < block.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    sum += jacobian.row(row).transpose() * residuals[row];
    if (i + 1 == block.size() || block[i + 1] != block[i]) {
      B += sum * sum.transpose();
      sum.setZero();
    }
  }
  for (int k = 0; k < kNumParameters; ++k) {  // the prior: its own information
    const auto row = static_cast<Eigen::Index>(block.size()) + k;
    const double weight = IsOfMap(k) ? map_prior * map_prior : 1.0;
    B += weight * jacobian.row(row).transpose() * jacobian.row(row);
  }
  const Matrix inverse = A.completeOrthogonalDecomposition().solve(Matrix::Identity());
  return inverse * B * inverse;
}

Refined Refine(const Signals& signals, const Scale& scale, const Vector& start, const Vector& mean,
               const Vector& sigma, bool dynamics) {
  Refined refined;
  refined.p = start;
  constexpr int kRounds = 3;  // of weights
  for (int round = 0; round < kRounds; ++round) {
    const std::vector<double> errors = Errors(MotorFrom(refined.p.data(), scale), signals);
    const double error_sigma = RobustSigmaOf(errors);
    const double map_prior = MapPriorWeight(errors, error_sigma);
    Vector prior_sigma = sigma;
    for (int k = 0; k < kNumParameters; ++k) {
      if (IsOfMap(k)) prior_sigma[k] /= map_prior;
    }
    auto* functor =
        new FreeRunCost(&signals, scale, mean, prior_sigma, Weights(errors, error_sigma));
    auto cost =
        std::make_unique<ceres::DynamicNumericDiffCostFunction<FreeRunCost, ceres::FORWARD>>(
            functor);
    cost->AddParameterBlock(kNumParameters);
    cost->SetNumResiduals(functor->num_residuals());
    const ceres::CostFunction& function = *cost;
    ceres::Problem problem;
    problem.AddResidualBlock(cost.release(), nullptr, refined.p.data());
    for (int k = 0; k < kNumParameters; ++k) {
      problem.SetParameterLowerBound(refined.p.data(), k, kBounds[k].first);
      problem.SetParameterUpperBound(refined.p.data(), k, kBounds[k].second);
    }
    if (!dynamics) {
      problem.SetManifold(refined.p.data(),
                          new ceres::SubsetManifold(kNumParameters, {kLogTau, kShare, kDelay}));
    }
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
    options.max_num_iterations = 20;
    options.function_tolerance = 1e-6;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (round + 1 == kRounds) {
      refined.covariance = SandwichCovariance(function, refined.p, signals, map_prior);
    }
  }
  return refined;
}

// ---- Starts: variable projection over U_a and the delay -----------------------------------------

// One-step equations by the midpoint rule: linear in root, linear, constant, S1, S2.
class MidpointRule {
 public:
  MidpointRule(const Signals& signals, double least_step_s) {
    for (const MotorSignal& signal : signals) Collect(signal, least_step_s);
  }
  bool empty() const { return steps_.size() < 50; }

  // Best S1 >= 0, S2 >= 0 and map for this U_a; throttles are those `delay_s` earlier.
  std::optional<Motor> Fit(double start, double delay_s, const Scale& scale) const {
    using Vector5 = Eigen::Matrix<double, 5, 1>;
    Eigen::Matrix<double, 5, 5> A = Eigen::Matrix<double, 5, 5>::Zero();
    Vector5 b = Vector5::Zero();
    for (const Step& step : steps_) {
      const double throttle = ThrottleAt(step, delay_s);
      Vector5 row;
      row << step.voltage / scale.voltage * std::sqrt(std::max(throttle - start, 0.0)), throttle,
          1.0, -step.speed / scale.speed, -std::pow(step.speed / scale.speed, 2);
      A += step.dt * row * row.transpose();  // noise of the quotient falls with the step
      b += step.dt * row * step.rate;
    }
    A.diagonal() *= 1.0 + 1e-9;
    for (const bool with_square : {true, false}) {
      const int n = with_square ? 5 : 4;
      const Eigen::VectorXd x = A.topLeftCorner(n, n).ldlt().solve(b.head(n));
      Motor motor;
      motor.esc = {x[0] / scale.voltage, x[1], x[2], start};
      motor.dynamics = {x[3] / scale.speed, with_square ? x[4] / (scale.speed * scale.speed) : 0.0};
      motor.delay_s = delay_s;
      if (x.allFinite() && motor.dynamics.S1 > 1.0 && motor.dynamics.S2 >= 0.0) return motor;
    }
    return std::nullopt;
  }

 private:
  struct Step {
    const MotorSignal* signal;
    size_t row;     // at its start
    double middle;  // [s]
    double dt, speed, rate, voltage;
  };

  void Collect(const MotorSignal& signal, double least_step_s) {
    for (size_t i = 0; i + 1 < signal.t_s.size();) {
      size_t k = i + 1;
      while (k + 1 < signal.t_s.size() && signal.t_s[k] - signal.t_s[i] < least_step_s) ++k;
      const double dt = signal.t_s[k] - signal.t_s[i];
      const double a = signal.speed_rad_s[i], b = signal.speed_rad_s[k];
      if (std::isfinite(a) && std::isfinite(b) && dt < 0.05) {
        steps_.push_back({&signal, i, 0.5 * (signal.t_s[i] + signal.t_s[k]), dt, 0.5 * (a + b),
                          (b - a) / dt, signal.voltage_V[i]});
      }
      i = k;
    }
  }

  static double ThrottleAt(const Step& step, double delay_s) {
    const std::vector<double>& t = step.signal->t_s;
    const double wanted = step.middle - delay_s;
    size_t row = step.row;
    while (row > 0 && t[row] > wanted) --row;
    while (row + 1 < t.size() && t[row + 1] <= wanted) ++row;
    return step.signal->throttle[row];
  }

  std::vector<Step> steps_;
};

// Steady map by least squares for given dynamics.
Motor SteadyStart(const Signals& signals, const Scale& scale, double start, double tau_s,
                  double share) {
  Vector p = PriorMean();
  p[kLogTau] = std::log(tau_s);
  p[kShare] = share;
  Motor motor = MotorFrom(p.data(), scale);
  Eigen::Matrix3d A = 1e-9 * Eigen::Matrix3d::Identity();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const MotorSignal& signal : signals) {
    for (size_t i = 0; i < signal.throttle.size(); ++i) {
      if (!std::isfinite(signal.speed_rad_s[i])) continue;
      const Eigen::Vector3d row(signal.voltage_V[i] / scale.voltage *
                                    std::sqrt(std::max(signal.throttle[i] - start, 0.0)),
                                signal.throttle[i], 1.0);
      A += row * row.transpose();
      b += row * motor.dynamics.DriveFor(signal.speed_rad_s[i]);
    }
  }
  const Eigen::Vector3d x = A.ldlt().solve(b);
  motor.esc = {x[0] / scale.voltage, x[1], x[2], start};
  return motor;
}

// The first rows of each signal from where it turns, enough to tell starts apart.
Signals Beginnings(const Signals& signals) {
  constexpr size_t kRows = 6000;
  const size_t most = std::max(kRows / signals.size(), size_t{1000});
  Signals short_ones = signals;
  for (MotorSignal& signal : short_ones) {
    const auto turns = std::find_if(signal.speed_rad_s.begin(), signal.speed_rad_s.end(),
                                    [](double s) { return std::isfinite(s); });
    const auto first = static_cast<size_t>(turns - signal.speed_rad_s.begin());
    const size_t last = std::min(first + most, signal.throttle.size());
    for (std::vector<double>* column :
         {&signal.t_s, &signal.throttle, &signal.voltage_V, &signal.speed_rad_s}) {
      if (column->empty()) continue;
      *column = std::vector<double>(column->begin() + static_cast<long>(first),
                                    column->begin() + static_cast<long>(last));
    }
  }
  return short_ones;
}

Motor BestStart(const Signals& all, const Scale& scale, bool dynamics,
                std::vector<Motor> starts = {}) {
  const Signals signals = dynamics ? Beginnings(all) : all;
  for (const double below : {0.02, 0.1, 0.3, 1.0}) {
    const double start = scale.least - below;
    if (!dynamics) {
      starts.push_back(SteadyStart(signals, scale, start, 0.03, 0.4));
      continue;
    }
    for (const double tau_s : {0.015, 0.03, 0.06, 0.12})
      starts.push_back(SteadyStart(signals, scale, start, tau_s, 0.4));
  }
  constexpr double kLeastStep_s = 0.004;
  const MidpointRule rule(signals, kLeastStep_s);
  if (dynamics && !rule.empty()) {
    for (const double below : {0.005, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8}) {
      for (double delay_s = -0.01; delay_s < 0.061; delay_s += 0.005) {
        const auto motor = rule.Fit(scale.least - below, delay_s, scale);
        if (motor) starts.push_back(*motor);
      }
    }
  }
  double least = std::numeric_limits<double>::infinity();
  Motor best = starts.front();
  for (const Motor& motor : starts) {
    const double cost = RobustCost(Errors(motor, signals));
    if (!(cost < least)) continue;
    least = cost;
    best = motor;
  }
  return best;
}

// ---- Report ------------------------------------------------------------------------------------

Vector Clamped(Vector p) {
  for (int k = 0; k < kNumParameters; ++k) {
    const double margin = 1e-6 * (kBounds[k].second - kBounds[k].first);
    p[k] = std::clamp(p[k], kBounds[k].first + margin, kBounds[k].second - margin);
  }
  return p;
}

// Sigma of a function of the parameters.
template <typename Function>
double SigmaOf(const Refined& fit, Function function) {
  Vector gradient;
  for (int k = 0; k < kNumParameters; ++k) {
    const double step = 1e-5 * std::max(std::abs(fit.p[k]), 0.01);
    Vector up = fit.p, down = fit.p;
    up[k] += step;
    down[k] -= step;
    gradient[k] = (function(up) - function(down)) / (2.0 * step);
  }
  return std::sqrt(std::max((gradient.transpose() * fit.covariance * gradient).value(), 0.0));
}

std::vector<ActuatorParameter> ParametersOfFit(const Refined& fit, const Scale& scale,
                                               CommandUnit unit, bool uses_voltage, bool dynamics) {
  const std::string u = NameOf(unit);
  const double per_unit = ThrottlePer(unit);
  const Vector prior = PriorSigma();
  const auto sigma_of = [&](int k) { return std::sqrt(std::max(fit.covariance(k, k), 0.0)); };
  const bool tau_known = dynamics && sigma_of(kLogTau) < kKnownShare * prior[kLogTau];
  const bool share_known = tau_known && sigma_of(kShare) < kKnownShare * prior[kShare];
  const bool start_known = sigma_of(kLogStart) < kKnownShare * prior[kLogStart];
  const auto motor = [&](const Vector& p) { return MotorFrom(p.data(), scale); };

  std::vector<ActuatorParameter> all;
  const auto add = [&](const char* name, const std::string& unit_text, bool known, bool nonzero,
                       auto function) {
    ActuatorParameter parameter = {name, unit_text, std::nullopt};
    const MeasuredValue found = {function(fit.p), SigmaOf(fit, function)};
    const bool away = !nonzero || std::abs(found.value) > kKnownSigmas * found.sigma;
    if (known && away && std::isfinite(found.value) && std::isfinite(found.sigma))
      parameter.found = found;
    all.push_back(parameter);
  };
  add("S_0", "rad/s^2/V/" + u + "^0.5", tau_known && start_known && uses_voltage, true,
      [&](const Vector& p) { return motor(p).esc.root * std::sqrt(per_unit); });
  add("S_1", "1/s", share_known, true, [&](const Vector& p) { return motor(p).dynamics.S1; });
  add("S_2", "1/rad", share_known, true, [&](const Vector& p) { return motor(p).dynamics.S2; });
  add("U_a", u, start_known, false,
      [&](const Vector& p) { return CommandOf(motor(p).esc.start, unit); });
  add("time_constant_s", "s", tau_known, true,
      [&](const Vector& p) { return motor(p).dynamics.TimeConstant(scale.speed); });
  add("delay_s", "s", tau_known && sigma_of(kDelay) < kKnownShare * prior[kDelay], false,
      [&](const Vector& p) { return p[kDelay]; });
  return all;
}

MotorFit Summarised(const Refined& refined, const Scale& scale, const Signals& signals,
                    CommandUnit unit, bool uses_voltage, bool dynamics) {
  MotorFit fit;
  fit.motor = MotorFrom(refined.p.data(), scale);
  fit.error = ErrorOfFreeRun(fit.motor, signals);
  fit.parameters = ParametersOfFit(refined, scale, unit, uses_voltage, dynamics);
  std::vector<double> lags;
  for (const MotorSignal& signal : signals) {
    if (const auto lag_s = CorrelationLag(signal)) lags.push_back(*lag_s);
  }
  if (!lags.empty()) fit.lag_s = Median(lags);
  return fit;
}

// What motors of one type have in common: their mean, each by its certainty. Motors differ: sigma
// is also that of the mean's scatter. Known where at least half of them show it.
std::vector<ActuatorParameter> Combined(const std::vector<MotorFit>& motors) {
  std::vector<ActuatorParameter> all = motors.front().parameters;
  for (size_t k = 0; k < all.size(); ++k) {
    double weight = 0.0, sum = 0.0, squares = 0.0;
    size_t known = 0;
    for (const MotorFit& motor : motors) {
      const auto& found = motor.parameters[k].found;
      if (!found || !(found->sigma > 0.0)) continue;
      const double w = 1.0 / (found->sigma * found->sigma);
      weight += w;
      sum += w * found->value;
      squares += w * found->value * found->value;
      ++known;
    }
    all[k].found.reset();
    if (2 * known < motors.size() || known == 0) continue;
    const double mean = sum / weight;
    const double scatter = std::max(squares / weight - mean * mean, 0.0);
    const double more = known > 1 ? scatter / static_cast<double>(known - 1) : 0.0;
    all[k].found = MeasuredValue{mean, std::sqrt(std::max(1.0 / weight, more))};
  }
  return all;
}

void Check(const std::vector<BenchRun>& runs) {
  if (runs.empty()) throw std::invalid_argument("no run to identify actuators from");
  for (const BenchRun& run : runs) {
    if (run.num_motors() != runs.front().num_motors()) {
      RefuseFile(run.file, "has " + std::to_string(run.num_motors()) + " motors, " +
                               runs.front().file + " has " +
                               std::to_string(runs.front().num_motors()));
    }
    for (int j = 0; j < run.num_motors(); ++j) {
      const auto& speed = run.speed_rad_s[static_cast<size_t>(j)];
      const long usable =
          std::count_if(speed.begin(), speed.end(), [](double s) { return std::isfinite(s); });
      if (usable < 10) {
        RefuseFile(run.file, "motor " + std::to_string(j + 1) + " has " + std::to_string(usable) +
                                 " usable speeds above 0, too few to fit anything");
      }
    }
  }
}

// Rows that lie apart by more than a free run may leave out say nothing of dynamics.
void CheckSpacing(const BenchRun& run) {
  if (run.t_s.size() < 2) return;
  std::vector<double> steps;
  for (size_t i = 1; i < run.t_s.size(); ++i) steps.push_back(run.t_s[i] - run.t_s[i - 1]);
  const double step_s = Median(std::move(steps));
  if (step_s <= kLongestHole_s) return;
  throw std::invalid_argument(
      run.file + ": rows are " + std::to_string(step_s) +
      " s apart; are times in seconds? If so, the rows are steady readings");
}

void CheckThatCommandChanges(const Signals& signals, const std::string& file) {
  double least = std::numeric_limits<double>::infinity(), most = -least;
  for (const MotorSignal& signal : signals) {
    for (size_t i = 0; i < signal.throttle.size(); ++i) {
      if (!std::isfinite(signal.speed_rad_s[i])) continue;
      least = std::min(least, signal.throttle[i]);
      most = std::max(most, signal.throttle[i]);
    }
  }
  if (!(most - least > 1e-3))
    throw std::invalid_argument(
        file + ": the command hardly changes while the motor turns (throttle " +
        std::to_string(least) + " to " + std::to_string(most) + "); is its unit right?");
}

}  // namespace

FreeRunError ErrorOfFreeRun(const Motor& motor, const Signals& signals) {
  FreeRunError error;
  double least = std::numeric_limits<double>::infinity(), most = 0.0, sum = 0.0;
  long speeds = 0;
  for (const MotorSignal& signal : signals) {
    for (const double speed : signal.speed_rad_s) {
      if (!std::isfinite(speed)) continue;
      least = std::min(least, speed);
      most = std::max(most, speed);
      sum += speed;
      ++speeds;
    }
  }
  if (speeds == 0) return error;
  error.speed_range_rad_s = most - least;
  error.mean_speed_rad_s = sum / static_cast<double>(speeds);
  std::vector<double> steady, response;
  for (const MotorSignal& signal : signals) {
    std::vector<double> held;
    const std::vector<double> speed = FreeRun(motor, signal, &held);
    for (size_t i = 0; i < speed.size(); ++i) {
      const double e = speed[i] - signal.speed_rad_s[i];
      if (!std::isfinite(e)) continue;
      const bool is_steady = std::abs(held[i] - speed[i]) <= kSteadyShare * error.speed_range_rad_s;
      (is_steady ? steady : response).push_back(e);
    }
  }
  // By the phase's own sigma: a response that the model misses is no outlier.
  double all = 0.0;
  const auto rms = [&](const std::vector<double>& errors, long* count) {
    const double limit = kOutlier_sigmas * RobustSigmaOf(errors);
    double squares = 0.0;
    for (const double e : errors) {
      if (std::abs(e) > limit) {
        ++error.outliers;
      } else {
        squares += e * e;
        ++*count;
      }
    }
    all += squares;
    return *count > 0 ? std::sqrt(squares / static_cast<double>(*count)) : 0.0;
  };
  error.steady_rad_s = rms(steady, &error.steady);
  error.response_rad_s = rms(response, &error.response);
  const long counted = error.steady + error.response;
  error.all_rad_s = counted > 0 ? std::sqrt(all / static_cast<double>(counted)) : 0.0;
  return error;
}

std::vector<double> StepTimes(const MotorSignal& signal) {
  constexpr double kStepShare = 0.01, kHold_s = 0.3, kLeastHeld = 0.5;
  if (signal.t_s.size() < 2) return {};
  const auto [least, most] = std::minmax_element(signal.throttle.begin(), signal.throttle.end());
  const double step = kStepShare * (*most - *least);
  // A staircase holds each step, whether it jumps to the next one or slews; in flight none is held.
  std::vector<double> times;
  double held_s = 0.0;
  size_t first = 0;  // of the rows that stay where they are
  for (size_t i = 1; i <= signal.t_s.size(); ++i) {
    const bool ends = i == signal.t_s.size();
    if (!ends && std::abs(signal.throttle[i] - signal.throttle[first]) <= step) continue;
    const double stay_s = signal.t_s[ends ? i - 1 : i] - signal.t_s[first];
    if (stay_s >= kHold_s) {
      held_s += stay_s;
      if (!ends) times.push_back(signal.t_s[i]);
    }
    first = i;
  }
  if (held_s < kLeastHeld * (signal.t_s.back() - signal.t_s.front())) times.clear();
  return times;
}

std::optional<double> CorrelationLag(const MotorSignal& signal) {
  constexpr double kGrid_s = 0.002, kFrom_s = -0.02, kTo_s = 0.2, kDifference_s = 0.03;
  constexpr double kCoarsest_s = 0.025;
  const double duration = signal.t_s.empty() ? 0.0 : signal.t_s.back() - signal.t_s.front();
  if (duration > kCoarsest_s * static_cast<double>(signal.t_s.size()) || duration < 1.0)
    return std::nullopt;
  // Both interpolated to one grid; changes over kDifference_s.
  std::vector<double> throttle, speed;
  size_t row = 0;
  for (double t = signal.t_s.front(); t < signal.t_s.back(); t += kGrid_s) {
    while (row + 1 < signal.t_s.size() && signal.t_s[row + 1] <= t) ++row;
    const size_t next = std::min(row + 1, signal.t_s.size() - 1);
    const double dt = signal.t_s[next] - signal.t_s[row];
    const double share = dt > 0.0 ? (t - signal.t_s[row]) / dt : 0.0;
    const auto between = [&](const std::vector<double>& x) {
      return (1.0 - share) * x[row] + share * x[next];
    };
    throttle.push_back(between(signal.throttle));
    speed.push_back(between(signal.speed_rad_s));
  }
  const auto d = static_cast<long>(std::lround(kDifference_s / kGrid_s));
  const auto n = static_cast<long>(throttle.size());
  const auto change = [&](const std::vector<double>& x, long i) {
    return x[static_cast<size_t>(i + d)] - x[static_cast<size_t>(i)];
  };
  const auto correlation = [&](long lag) {
    double xy = 0.0, xx = 0.0, yy = 0.0;
    for (long i = std::max(0L, -lag); i + d < n && i + lag + d < n; ++i) {
      const double x = change(throttle, i), y = change(speed, i + lag);
      if (!std::isfinite(y)) continue;
      xy += x * y;
      xx += x * x;
      yy += y * y;
    }
    return xx > 0.0 && yy > 0.0 ? xy / std::sqrt(xx * yy) : 0.0;
  };
  double best = -1.0, lag_s = 0.0;
  for (long lag = std::lround(kFrom_s / kGrid_s); lag <= std::lround(kTo_s / kGrid_s); ++lag) {
    const double c = correlation(lag);
    if (c <= best) continue;
    best = c;
    lag_s = static_cast<double>(lag) * kGrid_s;
  }
  if (!(best > 0.0)) return std::nullopt;
  return lag_s;
}

ActuatorFit IdentifyActuator(const std::vector<BenchRun>& runs) {
  Check(runs);
  ActuatorFit fit;
  fit.command_unit = runs.front().command_unit;
  fit.uses_voltage = std::all_of(runs.begin(), runs.end(),
                                 [](const BenchRun& run) { return !run.voltage_V.empty(); });
  fit.has_time =
      std::any_of(runs.begin(), runs.end(), [](const BenchRun& run) { return !run.t_s.empty(); });
  for (const BenchRun& run : runs) CheckSpacing(run);
  const int num_motors = runs.front().num_motors();
  Signals all;
  std::vector<Signals> of_motor(static_cast<size_t>(num_motors));
  for (const BenchRun& run : runs) {
    for (int j = 0; j < num_motors; ++j) {
      MotorSignal signal = SignalOf(run, j, fit.uses_voltage);
      of_motor[static_cast<size_t>(j)].push_back(signal);
      all.push_back(std::move(signal));
    }
  }
  CheckThatCommandChanges(all, runs.front().file);
  fit.step_times_s = StepTimes(all.front());

  const Scale scale = ScaleOf(all);
  const Vector start = Clamped(ParametersOf(BestStart(all, scale, fit.has_time), scale));
  const Refined common = Refine(all, scale, start, PriorMean(), PriorSigma(), fit.has_time);
  fit.common = Summarised(common, scale, all, fit.command_unit, fit.uses_voltage, fit.has_time);
  if (num_motors == 1) {
    fit.motors = {fit.common};
    return fit;
  }
  for (const Signals& signals : of_motor) {
    // What one motor does not show is as with the others.
    const Motor own_start = BestStart(signals, scale, fit.has_time, {fit.common.motor});
    const Refined own = Refine(signals, scale, Clamped(ParametersOf(own_start, scale)), common.p,
                               PriorSigma(), fit.has_time);
    fit.motors.push_back(
        Summarised(own, scale, signals, fit.command_unit, fit.uses_voltage, fit.has_time));
  }
  fit.common.parameters = Combined(fit.motors);
  return fit;
}

}  // namespace odmc
