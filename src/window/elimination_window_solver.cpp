#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "odmc/window/front.h"
#include "odmc/window/window_solver.h"

namespace odmc {
namespace {

// Bounds and rules of the trust region are those of Ceres.
constexpr double kInitialRadius = 1e6;
constexpr double kLeastDecrease = 1e-3;  // as a share of what the linear model promises
constexpr double kLeastDiagonal = 1e-6, kLargestDiagonal = 1e32;
constexpr double kGradientTolerance = 1e-10, kStepTolerance = 1e-8;
constexpr double kLeastRadius = 1e-32, kLargestRadius = 1e16;

/// One number or vector per column of the whole window: states (12 each), biases (6 each),
/// parameters.
struct Columns {
  std::vector<Eigen::Matrix<double, kStateTangentSize, 1>> states;
  std::vector<Eigen::Matrix<double, 6, 1>> biases;
  Eigen::VectorXd parameters;

  void SetZero(const Window& window) {
    states.assign(window.keyframes().size(), Eigen::Matrix<double, kStateTangentSize, 1>::Zero());
    biases.assign(window.biases().size(), Eigen::Matrix<double, 6, 1>::Zero());
    parameters.setZero(window.layout().num_estimated());
  }

  /// f(entry of this, entry of other) summed.
  template <typename Function>
  static double Sum(const Columns& a, const Columns& b, const Function& f) {
    double sum = 0.0;
    const auto add = [&](const auto& x, const auto& y) {
      for (Eigen::Index i = 0; i < x.size(); ++i) sum += f(x[i], y[i]);
    };
    for (size_t k = 0; k < a.states.size(); ++k) add(a.states[k], b.states[k]);
    for (size_t k = 0; k < a.biases.size(); ++k) add(a.biases[k], b.biases[k]);
    add(a.parameters, b.parameters);
    return sum;
  }
};

/// Marquardt's damping of one column.
double Damping(double diagonal, double radius) {
  return std::clamp(diagonal, kLeastDiagonal, kLargestDiagonal) / radius;
}

/// Where a step started, to go back to.
struct Point {
  std::vector<std::array<double, kStateSize>> states;
  std::vector<std::array<double, 6>> biases;
  ParameterVector eta;

  void Save(const Window& window) {
    states.clear();
    biases.clear();
    for (const Keyframe& k : window.keyframes()) states.push_back(k.x);
    for (const Bias& b : window.biases()) biases.push_back(b.x);
    eta = window.eta();
  }

  void Restore(Window* window) const {
    for (size_t i = 0; i < states.size(); ++i) window->keyframes()[i].x = states[i];
    for (size_t i = 0; i < biases.size(); ++i) window->biases()[i].x = biases[i];
    window->eta() = eta;
  }

  double SquaredNorm() const {
    double sum = eta.squaredNorm();
    for (const auto& x : states)
      sum += Eigen::Map<const Eigen::VectorXd>(x.data(), 13).squaredNorm();
    for (const auto& x : biases)
      sum += Eigen::Map<const Eigen::VectorXd>(x.data(), 6).squaredNorm();
    return sum;
  }
};

void Move(const Columns& step, Window* window) {
  const StateManifold manifold;
  for (size_t i = 0; i < step.states.size(); ++i) {
    auto& x = window->keyframes()[i].x;
    const auto from = x;
    manifold.Plus(from.data(), step.states[i].data(), x.data());
  }
  for (size_t i = 0; i < step.biases.size(); ++i) {
    for (int j = 0; j < 6; ++j) window->biases()[i].x[j] += step.biases[i][j];
  }
  window->eta() += step.parameters;
}

/// Cost of the window at its present estimate; nothing where a factor cannot be evaluated.
std::optional<double> WindowCost(const Window& window) {
  double cost = 0.0;
  for (const Keyframe& keyframe : window.keyframes()) {
    for (const Factor& factor : keyframe.factors) {
      const std::optional<double> of_factor = CostOf(window, factor);
      if (!of_factor) return std::nullopt;
      cost += *of_factor;
    }
  }
  if (window.prior().b.size() > 0) cost += 0.5 * PriorResidual(window).squaredNorm();
  cost += 0.5 * (window.eta() - window.parameter_centre())
                    .cwiseQuotient(window.parameter_sigma())
                    .squaredNorm();
  if (!std::isfinite(cost)) return std::nullopt;
  return cost;
}

}  // namespace

struct EliminationWindowSolver::Impl {
  struct Front {
    std::optional<FrontColumns> columns;
    Eigen::MatrixXd normal;  // of its own factors
    EliminatedFront eliminated;
  };

  /// Linearizes every factor. @returns the cost; nothing where a factor cannot be evaluated
  std::optional<double> Assemble(const Window& window);
  /// The damped step from the fronts. @returns false if they are not positive
  bool Step(const Window& window, double radius, Columns* step);

  std::vector<Front> fronts;
  Eigen::MatrixXd root;  // of the parameters' own priors
  Columns diagonal, gradient;
  LinearFactor linear;
  Eigen::MatrixXd front, message;
};

std::optional<double> EliminationWindowSolver::Impl::Assemble(const Window& window) {
  const int n = window.layout().num_estimated();
  const auto& keyframes = window.keyframes();
  double cost = 0.0;
  fronts.resize(keyframes.size());
  diagonal.SetZero(window);
  gradient.SetZero(window);
  for (size_t i = 0; i < keyframes.size(); ++i) {
    Front& f = fronts[i];
    const FrontColumns& c = f.columns.emplace(window, keyframes[i].id);
    f.normal.setZero(c.total + 1, c.total + 1);
    for (const Factor& factor : keyframes[i].factors) {
      if (!Linearize(window, factor, false, &linear)) return std::nullopt;
      cost += linear.cost;
      AddToFront(factor, linear, c, &f.normal);
    }
    if (i == 0 && window.prior().b.size() > 0) {
      AddToFront(PriorMessage(window), c, &f.normal);
      cost += 0.5 * PriorResidual(window).squaredNorm();
    }
    const auto add = [&](int from, int size, auto* to_diagonal, auto* to_gradient) {
      if (from < 0) return;
      *to_diagonal += f.normal.diagonal().segment(from, size);
      *to_gradient += f.normal.col(c.total).segment(from, size);
    };
    add(0, kStateTangentSize, &diagonal.states[i], &gradient.states[i]);
    if (c.next_state >= 0) {
      add(c.next_state, kStateTangentSize, &diagonal.states[i + 1], &gradient.states[i + 1]);
    }
    for (const auto& [column, bias] :
         {std::pair(c.leaving_bias, c.bias),
          std::pair(c.kept_bias, c.kept_bias >= 0 ? keyframes[i + 1].bias : -1)}) {
      if (column < 0) continue;
      const auto b = static_cast<size_t>(bias - window.biases().front().id);
      add(column, 6, &diagonal.biases[b], &gradient.biases[b]);
    }
    add(c.parameters, n, &diagonal.parameters, &gradient.parameters);
  }
  const Eigen::VectorXd weight = window.parameter_sigma().cwiseAbs2().cwiseInverse();
  const Eigen::VectorXd offset = window.eta() - window.parameter_centre();
  root.setZero(n + 1, n + 1);
  root.diagonal().head(n) = weight;
  root.col(n).head(n) = weight.cwiseProduct(offset);
  diagonal.parameters += weight;
  gradient.parameters += root.col(n).head(n);
  cost += 0.5 * offset.dot(root.col(n).head(n));
  if (!std::isfinite(cost)) return std::nullopt;
  return cost;
}

bool EliminationWindowSolver::Impl::Step(const Window& window, double radius, Columns* step) {
  const int n = window.layout().num_estimated();
  for (size_t i = 0; i < fronts.size(); ++i) {
    Front& f = fronts[i];
    const FrontColumns& c = *f.columns;
    front = f.normal;
    if (i > 0) AddToFront(message, c, &front);
    for (int j = 0; j < kStateTangentSize; ++j) {
      front(j, j) += Damping(diagonal.states[i][j], radius);
    }
    for (int j = kStateTangentSize; j < c.num_eliminated; ++j) {
      const auto b = static_cast<size_t>(c.bias - window.biases().front().id);
      front(j, j) += Damping(diagonal.biases[b][j - kStateTangentSize], radius);
    }
    if (!EliminateFront(front, c, &f.eliminated, &message)) return false;
  }
  Eigen::MatrixXd last = root;
  if (!fronts.empty()) last += message;
  for (int j = 0; j < n; ++j) last(j, j) += Damping(diagonal.parameters[j], radius);
  const Eigen::LLT<Eigen::MatrixXd, Eigen::Upper> llt(last.topLeftCorner(n, n));
  if (llt.info() != Eigen::Success) return false;
  step->SetZero(window);
  step->parameters = -llt.solve(last.col(n).head(n));

  Eigen::VectorXd of_front;
  for (size_t i = fronts.size(); i-- > 0;) {
    const FrontColumns& c = *fronts[i].columns;
    const Eigen::MatrixXd& W = fronts[i].eliminated.W;
    const int e = c.num_eliminated;
    of_front = W.col(c.total - e);
    of_front.noalias() += W.middleCols(c.parameters - e, n) * step->parameters;
    if (c.next_state >= 0) {
      of_front.noalias() += W.middleCols<kStateTangentSize>(c.next_state - e) * step->states[i + 1];
    }
    if (c.kept_bias >= 0) {
      const auto b =
          static_cast<size_t>(window.keyframe(c.id + 1).bias - window.biases().front().id);
      of_front.noalias() += W.middleCols<6>(c.kept_bias - e) * step->biases[b];
    }
    fronts[i].eliminated.U.triangularView<Eigen::Upper>().solveInPlace(of_front);
    step->states[i] = -of_front.head<kStateTangentSize>();
    if (c.leaving_bias >= 0) {
      const auto b = static_cast<size_t>(c.bias - window.biases().front().id);
      step->biases[b] = -of_front.segment<6>(c.leaving_bias);
    }
  }
  return true;
}

EliminationWindowSolver::EliminationWindowSolver(int fresh)
    : BatchWindowSolver(fresh), impl_(std::make_unique<Impl>()) {}
EliminationWindowSolver::~EliminationWindowSolver() = default;

SolveReport EliminationWindowSolver::Solve(Window* window, const SolverOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const auto elapsed_s = [&start] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  window->MoveAnchor();
  SolveReport report;
  const auto size = static_cast<int>(window->keyframes().size());
  std::optional<double> cost = impl_->Assemble(*window);
  report.work = size;
  report.iterations = 1;  // the start counts as one, as with Ceres
  if (!cost) {
    report.message = "a factor cannot be evaluated at the present estimate";
    return report;
  }
  report.usable = true;
  report.initial_cost = report.final_cost = *cost;
  double radius = kInitialRadius, shrink = 2.0;
  Columns step;
  Point from;
  bool assembled = true;
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    if (iteration > 0 && elapsed_s() >= options.max_time_s) break;
    if (!assembled) {
      report.work += size;
      if (!impl_->Assemble(*window)) break;
      assembled = true;
    }
    const Columns& gradient = impl_->gradient;
    const double steepest =
        std::sqrt(Columns::Sum(gradient, gradient, [](double a, double b) { return a * b; }));
    if (steepest <= kGradientTolerance) {
      report.converged = true;
      break;
    }
    ++report.iterations;
    report.work += size;
    double promised = 0.0, change = -std::numeric_limits<double>::infinity();
    bool moved = false;
    if (impl_->Step(*window, radius, &step)) {
      // With (H + D) d = -g, the linear model's cost falls by -g.d / 2 + d.D d / 2.
      promised = -0.5 * Columns::Sum(gradient, step, [](double g, double d) { return g * d; }) +
                 0.5 * Columns::Sum(impl_->diagonal, step, [radius](double h, double d) {
                   return d * d * Damping(h, radius);
                 });
      const double length =
          std::sqrt(Columns::Sum(step, step, [](double a, double b) { return a * b; }));
      from.Save(*window);
      if (length <= kStepTolerance * (std::sqrt(from.SquaredNorm()) + kStepTolerance)) {
        report.converged = true;
        break;
      }
      Move(step, window);
      moved = true;
      const std::optional<double> after = WindowCost(*window);
      if (after) change = *cost - *after;
    }
    const double share = change / promised;
    if (!(promised > 0.0 && share > kLeastDecrease)) {
      if (moved) from.Restore(window);
      radius /= shrink;
      shrink *= 2.0;
      if (radius < kLeastRadius) break;
      continue;
    }
    cost = *cost - change;
    report.final_cost = *cost;
    report.improved = true;
    assembled = false;
    radius = std::min(kLargestRadius,
                      radius / std::max(1.0 / 3.0, 1.0 - std::pow(2.0 * share - 1.0, 3)));
    shrink = 2.0;
    if (change <= options.function_tolerance * (*cost + change)) {
      report.converged = true;
      break;
    }
  }
  return report;
}

}  // namespace odmc
