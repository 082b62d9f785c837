#include "odmc/window/chain_alignment.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "odmc/window/householder.h"

namespace odmc {
namespace {

constexpr int kState = kStateTangentSize;

// Bounds and rules of the trust region are those of Ceres.
constexpr double kInitialRadius = 1e6;
constexpr double kLeastDecrease = 1e-3;  // as a share of what the linear model promises
constexpr double kLeastDiagonal = 1e-6, kLargestDiagonal = 1e32;
constexpr double kGradientTolerance = 1e-10, kStepTolerance = 1e-8;
constexpr double kLeastRadius = 1e-32, kLargestRadius = 1e16;

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

size_t IndexOfBias(const Window& window, std::int64_t bias) {
  return static_cast<size_t>(bias - window.biases().front().id);
}

}  // namespace

void WindowColumns::SetZero(const Window& window) {
  states.assign(window.keyframes().size(), Eigen::Matrix<double, kState, 1>::Zero());
  biases.assign(window.biases().size(), Eigen::Matrix<double, 6, 1>::Zero());
  parameters.setZero(window.layout().num_estimated());
}

template <typename Function>
double WindowColumns::Sum(const WindowColumns& a, const WindowColumns& b, const Function& f) {
  double sum = 0.0;
  const auto add = [&](const auto& x, const auto& y) {
    for (Eigen::Index i = 0; i < x.size(); ++i) sum += f(x[i], y[i]);
  };
  for (size_t k = 0; k < a.states.size(); ++k) add(a.states[k], b.states[k]);
  for (size_t k = 0; k < a.biases.size(); ++k) add(a.biases[k], b.biases[k]);
  add(a.parameters, b.parameters);
  return sum;
}

// ---- Linearization ------------------------------------------------------------------------------

/// Linearizes every factor at the estimate. @returns the cost; nothing where one cannot be
/// evaluated
std::optional<double> ChainAlignment::Linearise(const Window& window) {
  Ring<ChainFront>& fronts = chain_->fronts;
  chain_->MoveParameterPoint(window.eta());
  for (ChainFront& front : fronts) front.MovePoint(window);
  fronts.front().message.CopyFrom(prior_message_);
  fronts.front().point = prior_point_;
  fronts.front().MovePointWithMessage(window, &chain_->scratch);
  for (size_t i = 0; i < fronts.size(); ++i) {
    const ChainFront* next = i + 1 < fronts.size() ? &fronts[i + 1] : nullptr;
    if (!fronts[i].Linearise(window, next, chain_->point, chain_->point_version, false,
                             &chain_->scratch)) {
      return std::nullopt;
    }
  }
  diagonal_.SetZero(window);
  gradient_.SetZero(window);
  const double cost = SumFactors(window) + SumPast(window) + SumPriors(window);
  if (!std::isfinite(cost)) return std::nullopt;
  return cost;
}

/// What a row of the Jacobian adds to squares and gradient of its columns.
void ChainAlignment::AddRow(const double* row, int count, double residual, double* diagonal,
                            double* gradient) {
  for (int j = 0; j < count; ++j) {
    diagonal[j] += row[j] * row[j];
    gradient[j] += row[j] * residual;
  }
}

double ChainAlignment::SumFactors(const Window& window) {
  constexpr std::array<double, kState> kThere{};  // states are where they are linearized
  double cost = 0.0;
  for (const ChainFront& front : chain_->fronts) {
    const std::vector<Factor>& factors = window.keyframe(front.id).factors;
    for (size_t k = 0; k < factors.size(); ++k) {
      const ChainFront::KeptFactor& kept = front.kept()[k];
      std::array<double, kMostFactorRows> residual;
      front.LinearResidual(window, factors[k], kept, kThere.data(), kThere.data(), residual.data());
      double squares = 0.0;
      for (int i = 0; i < kept.rows; ++i) squares += residual[i] * residual[i];
      double rho[3] = {squares, 1.0, 0.0};
      if (factors[k].loss != nullptr) {
        factors[k].loss->Evaluate(squares / (kept.weight * kept.weight), rho);
      }
      cost += 0.5 * rho[0];
      SumFactor(window, factors[k], front, kept, residual.data());
    }
  }
  return cost;
}

void ChainAlignment::SumFactor(const Window& window, const Factor& factor, const ChainFront& front,
                               const ChainFront::KeptFactor& kept, const double* residual) {
  const RowBlock& block = kept.in_pair ? front.pair : front.own;
  const int border = kept.in_pair ? front.border() : kState;
  const auto at = static_cast<size_t>(front.id - chain_->oldest());
  const auto n = static_cast<int>(gradient_.parameters.size());
  for (int i = 0; i < kept.rows; ++i) {
    const double* row = block.row(kept.row + i);
    const auto add = [&](int from, auto* diagonal, auto* gradient) {
      AddRow(row + from, static_cast<int>(diagonal->size()), residual[i], diagonal->data(),
             gradient->data());
    };
    if (factor.state0 >= 0) add(0, &diagonal_.states[at], &gradient_.states[at]);
    if (factor.state1 >= 0) {
      add(front.pivots(), &diagonal_.states[at + 1], &gradient_.states[at + 1]);
    }
    for (const std::int64_t bias : {factor.bias0, factor.bias1}) {
      if (bias < 0) continue;
      const bool leaves =
          kept.in_pair && front.bias_leaves && bias == window.keyframe(front.id).bias;
      const size_t b = IndexOfBias(window, bias);
      add(leaves ? kState : border + BorderColumns::kBias, &diagonal_.biases[b],
          &gradient_.biases[b]);
    }
    if (factor.parameters && n > 0) {
      add(border + BorderColumns::kParameters, &diagonal_.parameters, &gradient_.parameters);
    }
  }
}

/// What has left the window: the message to the oldest front, and rows of bias and parameters.
double ChainAlignment::SumPast(const Window& window) {
  const BorderColumns& columns = past_->columns();
  const std::int64_t bias = window.keyframes().front().bias;
  double cost = 0.0;
  const auto add_border = [&](const double* row, const double* state) {
    double r = row[columns.rhs()] + row[columns.anchor()] * window.anchor();
    for (int j = 0; j < columns.n; ++j) {
      r += row[BorderColumns::kParameters + j] * window.eta()[j];
    }
    if (bias >= 0) {
      const std::array<double, 6>& x = window.bias(bias).x;
      for (int j = 0; j < 6; ++j) r += row[j] * x[static_cast<size_t>(j)];
      const size_t b = IndexOfBias(window, bias);
      AddRow(row, 6, r, diagonal_.biases[b].data(), gradient_.biases[b].data());
    }
    AddRow(row + BorderColumns::kParameters, columns.n, r, diagonal_.parameters.data(),
           gradient_.parameters.data());
    if (state != nullptr) {
      AddRow(state, kState, r, diagonal_.states[0].data(), gradient_.states[0].data());
    }
    cost += 0.5 * r * r;
  };
  const RowBlock& message = chain_->fronts.front().message;
  for (int i = 0; i < kState; ++i) add_border(message.row(i) + kState, message.row(i));
  for (int i = 0; i < columns.pivots(); ++i) add_border(past_->row(i), nullptr);
  return cost;
}

double ChainAlignment::SumPriors(const Window& window) {
  const Eigen::VectorXd weight = window.parameter_sigma().cwiseAbs2().cwiseInverse();
  const Eigen::VectorXd offset = window.eta() - window.parameter_centre();
  const Eigen::VectorXd pull = weight.cwiseProduct(offset);
  diagonal_.parameters += weight;
  gradient_.parameters += pull;
  return 0.5 * offset.dot(pull);
}

// ---- Elimination --------------------------------------------------------------------------------

/// Marquardt's damping of a column, as information.
double ChainAlignment::Damping(double diagonal) const {
  return std::clamp(diagonal, kLeastDiagonal, kLargestDiagonal) / radius_;
}

/// Holds a front's state, whose triangle the chain has, to where it is.
void ChainAlignment::DampState(const WindowColumns& diagonal, size_t front) {
  const BorderColumns& columns = chain_->root.columns();
  damping_.SetZero(kState, chain_->triangle.stride);
  for (int j = 0; j < kState; ++j) {
    damping_.row(j)[j] = std::sqrt(Damping(diagonal.states[front][j]));
  }
  AbsorbRows(chain_->triangle.data.data(), chain_->triangle.stride, damping_.data.data(),
             damping_.stride, kState, kState, kState + columns.size());
  chain_->root.Absorb(damping_.data.data() + kState, damping_.stride, kState);
}

void ChainAlignment::DampBias(const Window& window, std::int64_t bias) {
  const Eigen::Map<const Eigen::Matrix<double, 6, 1>> x(window.bias(bias).x.data());
  const auto& diagonal = diagonal_.biases[IndexOfBias(window, bias)];
  const auto sigma = diagonal.unaryExpr([this](double d) { return 1.0 / std::sqrt(Damping(d)); });
  chain_->root.AbsorbBiasPrior(x, sigma);
}

/// The chain from its fronts' rows, damped.
void ChainAlignment::Eliminate(const Window& window) {
  Ring<ChainFront>& fronts = chain_->fronts;
  RootTriangle& root = chain_->root;
  root = *past_;
  root.AbsorbPriors(window.parameter_centre(), window.parameter_sigma());
  for (size_t i = 0; i < fronts.size(); ++i) {
    ChainFront& front = fronts[i];
    front.eliminated = false;
    front.AbsorbOwn(&chain_->triangle, &root, &chain_->scratch);
    DampState(diagonal_, i);
    if (i + 1 == fronts.size()) break;
    if (front.bias_leaves) DampBias(window, window.keyframe(front.id).bias);
    front.Eliminate(chain_->triangle, &root, &fronts[i + 1], &chain_->scratch);
  }
  if (window.keyframes().back().bias >= 0) DampBias(window, window.keyframes().back().bias);
  root.AbsorbPriors(window.eta(), diagonal_.parameters.unaryExpr(
                                      [this](double d) { return 1.0 / std::sqrt(Damping(d)); }));
}

// ---- Steps --------------------------------------------------------------------------------------

void ChainAlignment::Save(const Window& window) {
  saved_states_.clear();
  saved_biases_.clear();
  for (const Keyframe& k : window.keyframes()) saved_states_.push_back(k.x);
  for (const Bias& b : window.biases()) saved_biases_.push_back(b.x);
  saved_eta_ = window.eta();
}

void ChainAlignment::Restore(Window* window) const {
  for (size_t i = 0; i < saved_states_.size(); ++i) window->keyframes()[i].x = saved_states_[i];
  for (size_t i = 0; i < saved_biases_.size(); ++i) window->biases()[i].x = saved_biases_[i];
  window->eta() = saved_eta_;
}

double ChainAlignment::SavedNorm() const {
  double squares = saved_eta_.squaredNorm();
  for (const auto& x : saved_states_) {
    squares += Eigen::Map<const Eigen::Matrix<double, kStateSize, 1>>(x.data()).squaredNorm();
  }
  for (const auto& x : saved_biases_) {
    squares += Eigen::Map<const Eigen::Matrix<double, 6, 1>>(x.data()).squaredNorm();
  }
  return std::sqrt(squares);
}

/// The step from where it started to where the window is.
void ChainAlignment::ReadStep(const Window& window) {
  step_.SetZero(window);
  for (size_t i = 0; i < step_.states.size(); ++i) {
    step_.states[i] =
        Eigen::Map<const Eigen::Matrix<double, kState, 1>>(chain_->fronts[i].delta.data());
  }
  for (size_t i = 0; i < step_.biases.size(); ++i) {
    for (size_t j = 0; j < 6; ++j) {
      step_.biases[i][static_cast<int>(j)] = window.biases()[i].x[j] - saved_biases_[i][j];
    }
  }
  step_.parameters = window.eta() - saved_eta_;
}

/// Takes the damped step from the linearized fronts, or goes back to where it started; the trust
/// region follows. @param cost of the window, before and after
ChainAlignment::Step ChainAlignment::TakeStep(double* cost, Window* window) {
  Save(*window);
  Eliminate(*window);
  double promised = 0.0, change = -std::numeric_limits<double>::infinity();
  if (solution_->SolveRootAtAnchor(window)) {
    solution_->BackSubstitute(window, true);
    ReadStep(*window);
    const double length =
        std::sqrt(WindowColumns::Sum(step_, step_, [](double a, double b) { return a * b; }));
    if (length <= kStepTolerance * (SavedNorm() + kStepTolerance)) {
      Restore(window);
      return Step::kTooShort;
    }
    // With (H + D) d = -g, the linear model's cost falls by -g.d / 2 + d.D d / 2.
    promised =
        0.5 * (WindowColumns::Sum(diagonal_, step_,
                                  [this](double h, double d) { return d * d * Damping(h); }) -
               WindowColumns::Sum(gradient_, step_, [](double g, double d) { return g * d; }));
    if (const std::optional<double> after = WindowCost(*window)) change = *cost - *after;
  }
  const double share = change / promised;
  if (!(promised > 0.0 && share > kLeastDecrease)) {
    Restore(window);
    radius_ /= shrink_;
    shrink_ *= 2.0;
    return Step::kRefused;
  }
  *cost -= change;
  radius_ =
      std::min(kLargestRadius, radius_ / std::max(1.0 / 3.0, 1.0 - std::pow(2.0 * share - 1.0, 3)));
  shrink_ = 2.0;
  return Step::kTaken;
}

SolveReport ChainAlignment::Solve(const RootTriangle& past, const SolverOptions& options,
                                  Window* window) {
  const auto start = std::chrono::steady_clock::now();
  const auto has_time = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() <
           options.max_time_s;
  };
  window->MoveAnchor();
  past_ = &past;
  prior_message_.CopyFrom(chain_->fronts.front().message);
  prior_point_ = chain_->fronts.front().point;
  radius_ = kInitialRadius;
  shrink_ = 2.0;
  SolveReport report;
  const auto size = static_cast<int>(chain_->fronts.size());
  report.iterations = 1;  // the start counts as one, as with Ceres
  report.work = size;
  std::optional<double> cost = Linearise(*window);
  if (!cost) {
    report.message = "a factor cannot be evaluated at the present estimate";
    return report;
  }
  report.usable = true;
  report.initial_cost = report.final_cost = *cost;
  bool is_linearised = true;
  for (int i = 0; i < options.max_iterations && radius_ >= kLeastRadius; ++i) {
    if (i > 0 && !has_time()) break;
    if (!is_linearised) {
      report.work += size;
      if (!Linearise(*window)) break;
      is_linearised = true;
    }
    const double steepest = std::sqrt(
        WindowColumns::Sum(gradient_, gradient_, [](double a, double b) { return a * b; }));
    report.converged = steepest <= kGradientTolerance;
    if (report.converged) break;
    ++report.iterations;
    report.work += size;
    const Step step = TakeStep(&*cost, window);
    report.converged = step == Step::kTooShort;
    if (report.converged) break;
    if (step == Step::kRefused) continue;
    const double change = report.final_cost - *cost;
    report.final_cost = *cost;
    report.improved = true;
    is_linearised = false;
    report.converged = change <= options.function_tolerance * (*cost + change);
    if (report.converged) break;
  }
  return report;
}

}  // namespace odmc
