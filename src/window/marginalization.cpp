#include "odmc/window/marginalization.h"

#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "odmc/factors/dynamics_factor.h"

namespace odmc {
namespace {

/// Writes a linear factor's rows into the joint system from `row` on, with differences counted from
/// the linearization points: residual(x_lin) = r(x) - J (x ⊖ x_lin).
void Stack(const Window& window, const Factor& factor, const LinearFactor& linear,
           const FrontColumns& c, int row, LinearSystem* system) {
  PlaceRows(factor, linear, c, row, &system->A);
  auto b = system->b.segment(row, linear.r.size());
  b = linear.r;
  const auto state = [&](std::int64_t id, int from) {
    if (id < 0 || !window.keyframe(id).in_prior) return;
    const Keyframe& k = window.keyframe(id);
    Eigen::Matrix<double, kStateTangentSize, 1> offset;
    StateManifold().Minus(k.x.data(), k.x_lin.data(), offset.data());
    b -= linear.J.middleCols<kStateTangentSize>(from) * offset;
  };
  const auto bias = [&](std::int64_t id, int from) {
    if (id < 0 || !window.bias(id).in_prior) return;
    const Bias& of = window.bias(id);
    for (int i = 0; i < 6; ++i) b -= linear.J.col(from + i) * (of.x[i] - of.x_lin[i]);
  };
  state(factor.state0, linear.state0);
  state(factor.state1, linear.state1);
  bias(factor.bias0, linear.bias0);
  bias(factor.bias1, linear.bias1);
  if (linear.parameters < 0) return;
  const Eigen::VectorXd moved = window.eta() - window.prior().eta_lin;
  b -= linear.J.middleCols(linear.parameters, moved.size()) * moved;
}

/// Moves the prior's linearization point of the parameters: the same affine function elsewhere.
void MoveParameterPoint(Window* window, const Eigen::VectorXd& threshold) {
  Prior& prior = window->prior();
  const Eigen::VectorXd moved = window->eta() - prior.eta_lin;
  if ((moved.array().abs() <= threshold.array()).all()) return;
  prior.b += prior.A.rightCols(moved.size()) * moved;
  prior.eta_lin = window->eta();
}

void Observe(const Window& window, const Factor& factor, LeavingFactors* leaving) {
  LinearFactor linear;
  if (!factor.parameters || !Linearize(window, factor, false, &linear)) return;
  leaving->score += linear.J.rightCols(leaving->score.size()).transpose() * linear.r;
  const auto* const dynamics = factor.As<DynamicsFactor>();
  if (dynamics == nullptr) return;
  const auto squares = linear.J.rightCols(leaving->score.size()).cwiseAbs2().eval();
  const int torque_rows = dynamics->with_torque() ? 3 : 0;
  leaving->torque_information = squares.bottomRows(torque_rows).colwise().sum();
  leaving->force_information = squares.topRows(squares.rows() - torque_rows).colwise().sum();
}

}  // namespace

FrontColumns::FrontColumns(const Window& window, std::int64_t keyframe)
    : id(keyframe), bias(window.keyframe(keyframe).bias) {
  const bool has_next = keyframe < window.keyframes().back().id;
  const std::int64_t next_bias = has_next ? window.keyframe(keyframe + 1).bias : -1;
  int column = kStateTangentSize;
  if (bias >= 0 && bias != next_bias) {
    leaving_bias = column;
    column += 6;
  }
  num_eliminated = column;
  if (has_next) {
    next_state = column;
    column += kStateTangentSize;
  }
  if (next_bias >= 0) {
    kept_bias = column;
    column += 6;
  }
  parameters = column;
  total = column + window.layout().num_estimated();
}

void PlaceRows(const Factor& factor, const LinearFactor& linear, const FrontColumns& columns,
               int row, Eigen::MatrixXd* A) {
  const Eigen::Index rows = linear.J.rows();
  const auto put = [&](int from, int to, int size) {
    if (from >= 0) A->block(row, to, rows, size) += linear.J.middleCols(from, size);
  };
  put(linear.state0, columns.StateColumn(factor.state0), kStateTangentSize);
  put(linear.state1, columns.StateColumn(factor.state1), kStateTangentSize);
  put(linear.bias0, columns.BiasColumn(factor.bias0), 6);
  put(linear.bias1, columns.BiasColumn(factor.bias1), 6);
  put(linear.parameters, columns.parameters, columns.total - columns.parameters);
}

LinearSystem Eliminate(const LinearSystem& system, double tolerance) {
  const int e = system.num_eliminated;
  const int n = static_cast<int>(system.A.cols()) - e;
  LinearSystem result;
  if (system.A.rows() == 0) {
    result.A.resize(0, n);
    result.b.resize(0);
    return result;
  }
  if (e == 0) return {system.A, system.b, 0};  // Eigen's QR can't take a matrix without columns
  // Rotate the eliminated columns into a triangle; rows below its rank know only the remaining
  // ones.
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> eliminated(system.A.leftCols(e));
  eliminated.setThreshold(tolerance);
  const int rank = static_cast<int>(eliminated.rank());
  Eigen::MatrixXd rest(system.A.rows(), n + 1);
  rest << system.A.rightCols(n), system.b;
  rest.applyOnTheLeft(eliminated.householderQ().adjoint());
  const int rows = static_cast<int>(rest.rows()) - rank;
  if (rows == 0) {
    result.A.resize(0, n);
    result.b.resize(0);
    return result;
  }

  // Compress them to as many rows as they have information.
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> remaining(rest.bottomLeftCorner(rows, n));
  remaining.setThreshold(tolerance);
  const int kept = static_cast<int>(remaining.rank());
  Eigen::VectorXd right = rest.bottomRightCorner(rows, 1);
  right.applyOnTheLeft(remaining.householderQ().adjoint());
  const Eigen::MatrixXd R =
      remaining.matrixR().topRows(kept).template triangularView<Eigen::Upper>();
  result.A = R * remaining.colsPermutation().transpose();
  result.b = right.head(kept);
  return result;
}

namespace {

/// Turns the prior's rows so that the last ones are about the parameters alone.
/// @returns the first of these
Eigen::Index SplitOffParameters(Eigen::Index num_parameters, Prior* prior) {
  const auto others = prior->A.cols() - num_parameters;  // of the state and the bias
  if (others == 0) return 0;
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(prior->A.leftCols(others));
  prior->A.applyOnTheLeft(qr.householderQ().adjoint());
  prior->b.applyOnTheLeft(qr.householderQ().adjoint());
  prior->A.bottomLeftCorner(prior->b.size() - qr.rank(), others).setZero();
  return qr.rank();
}

}  // namespace

Eigen::MatrixXd RescalePrior(const Eigen::Ref<const Eigen::VectorXd>& scale, Window* window) {
  Prior& prior = window->prior();
  const auto n = scale.size();
  const auto rows = prior.b.size();
  if (rows == 0) return Eigen::MatrixXd(scale.cwiseSqrt().asDiagonal());
  const Eigen::Index rank = SplitOffParameters(n, &prior);
  const Eigen::MatrixXd alone = prior.A.bottomRightCorner(rows - rank, n);
  if (alone.rows() == 0) return Eigen::MatrixXd(scale.cwiseSqrt().asDiagonal());
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(alone, Eigen::ComputeThinU | Eigen::ComputeFullV);
  Eigen::VectorXd root;
  DirectionScales(svd.matrixV(), scale, &root);
  const Eigen::MatrixXd& U = svd.matrixU();
  const Eigen::VectorXd more = (root.head(U.cols()).array() - 1.0).matrix();
  const auto stretch = [&](auto block) {
    block += (U * more.asDiagonal() * (U.transpose() * block)).eval();
  };
  stretch(prior.A.bottomRightCorner(rows - rank, n));
  stretch(prior.b.tail(rows - rank));
  return svd.matrixV() * root.asDiagonal() * svd.matrixV().transpose();
}

void DirectionScales(const Eigen::MatrixXd& directions,
                     const Eigen::Ref<const Eigen::VectorXd>& scale, Eigen::VectorXd* roots) {
  roots->resize(directions.cols());
  for (Eigen::Index i = 0; i < directions.cols(); ++i) {
    double sum = 0.0;
    for (Eigen::Index j = 0; j < scale.size(); ++j) {
      sum += directions(j, i) * directions(j, i) * std::log(scale[j]);
    }
    (*roots)[i] = std::exp(0.5 * sum);
  }
}

std::optional<double> FadingGain(double square, double variance) {
  if (!(square * variance > 0.0)) return std::nullopt;
  return (1.0 - 1.0 / std::sqrt(1.0 + variance * square)) / square;
}

namespace {

/// Lets rows [A b] fade, see FadingGain(). @param v what they have along the direction
template <typename Rows, typename Right>
void Fade(const Eigen::VectorXd& v, double variance, Rows&& A, Right&& b) {
  const std::optional<double> gain = FadingGain(v.squaredNorm(), variance);
  if (!gain) return;
  A -= *gain * v * (v.transpose() * A).eval();
  b -= *gain * v.dot(b) * v;
}

}  // namespace

void LetPriorVary(int index, const ProcessStep& step, Prior* prior) {
  if (prior->b.size() == 0) return;
  // What it says about x as what it says about decay x, about the same point.
  const Eigen::Index column = prior->state_columns() + prior->bias_columns() + index;
  const Eigen::VectorXd v = prior->A.col(column) / step.decay;
  prior->A.col(column) = v;
  prior->b += (1.0 - step.decay) * prior->eta_lin[index] * v;
  Fade(v, step.variance, prior->A, prior->b);
}

void LetPriorWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
                  Window* window) {
  Prior& prior = window->prior();
  const auto n = direction.size();
  const auto rows = prior.b.size();
  if (rows == 0) return;
  const Eigen::Index first = SplitOffParameters(n, &prior);
  auto A = prior.A.bottomRightCorner(rows - first, n);
  const Eigen::VectorXd v = A * direction;
  Fade(v, variance, A, prior.b.tail(rows - first));
}

namespace {

/// The prior's rows, and room for the rows of the oldest keyframe's factors.
LinearSystem SystemWithPrior(const Window& window, const FrontColumns& c) {
  const Keyframe& oldest = window.keyframes().front();
  const Prior& old = window.prior();
  const int prior_rows = static_cast<int>(old.b.size());
  int rows = prior_rows;
  for (const Factor& factor : oldest.factors) rows += factor.cost->num_residuals();
  LinearSystem system;
  system.A = Eigen::MatrixXd::Zero(rows, c.total);
  system.b = Eigen::VectorXd::Zero(rows);
  system.num_eliminated = c.num_eliminated;
  system.b.head(prior_rows) = old.b;
  if (old.has_state) {
    system.A.topLeftCorner(prior_rows, kStateTangentSize) = old.A.leftCols<kStateTangentSize>();
  }
  if (old.has_bias) {
    system.A.block(0, c.BiasColumn(oldest.bias), prior_rows, 6) =
        old.A.middleCols<6>(old.state_columns());
  }
  const int n = window.layout().num_estimated();
  system.A.block(0, c.parameters, prior_rows, n) = old.A.rightCols(n);
  return system;
}

/// What the oldest keyframe's factors link it to.
struct Links {
  bool next = false, bias = false;
  bool sound = true;  ///< false if a factor was left out
};

Links StackFactors(const Window& window, const FrontColumns& c, LinearSystem* system) {
  Links links;
  int row = static_cast<int>(window.prior().b.size());
  for (const Factor& factor : window.keyframes().front().factors) {
    LinearFactor linear;
    if (!Linearize(window, factor, true, &linear)) {
      links.sound = false;
      continue;
    }
    Stack(window, factor, linear, c, row, system);
    row += static_cast<int>(linear.r.size());
    links.next = links.next || factor.state1 >= 0;
    links.bias = links.bias || factor.bias0 >= 0;
  }
  return links;
}

/// The prior that is left of the system, about the next keyframe and the kept bias where they are
/// linked.
Prior PriorOf(const LinearSystem& remaining, const FrontColumns& c, bool has_next, bool has_bias,
              const Prior& old) {
  const auto n = old.eta_lin.size();
  Prior prior;
  prior.has_state = has_next;
  prior.has_bias = has_bias;
  prior.eta_lin = old.eta_lin;
  prior.b = remaining.b;
  prior.A.resize(remaining.A.rows(), prior.state_columns() + prior.bias_columns() + n);
  if (has_next) prior.A.leftCols<kStateTangentSize>() = remaining.A.leftCols<kStateTangentSize>();
  if (has_bias) {
    const int from = c.next_state >= 0 ? kStateTangentSize : 0;
    prior.A.middleCols<6>(prior.state_columns()) = remaining.A.middleCols<6>(from);
  }
  prior.A.rightCols(n) = remaining.A.rightCols(n);
  return prior;
}

/// Takes the oldest keyframe out of the window, which has the prior instead. What the prior is
/// about keeps its linearization point from now on.
void ReplaceOldest(Prior prior, const FrontColumns& c, Window* window) {
  if (c.leaving_bias >= 0 && !window->biases().empty()) window->biases().pop_front();
  window->DropOldestKeyframe();
  if (prior.has_state) {
    Keyframe& next = window->keyframes().front();
    if (!next.in_prior) next.x_lin = next.x;
    next.in_prior = true;
  }
  if (prior.has_bias) {
    Bias& kept = window->bias(window->keyframes().front().bias);
    if (!kept.in_prior) kept.x_lin = kept.x;
    kept.in_prior = true;
  }
  window->prior() = std::move(prior);
}

}  // namespace

bool MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                       LeavingFactors* leaving) {
  MoveParameterPoint(window, relinearize);
  const Keyframe& oldest = window->keyframes().front();
  const FrontColumns c(*window, oldest.id);
  const Prior& old = window->prior();
  if (leaving != nullptr) {
    leaving->score = Eigen::VectorXd::Zero(window->layout().num_estimated());
    leaving->force_information = leaving->torque_information = leaving->score;
    for (const Factor& factor : oldest.factors) Observe(*window, factor, leaving);
  }
  LinearSystem system = SystemWithPrior(*window, c);
  const Links links = StackFactors(*window, c, &system);
  const bool has_next = c.next_state >= 0 && links.next;
  const bool has_bias = c.kept_bias >= 0 && (links.bias || old.has_bias);
  ReplaceOldest(PriorOf(Eliminate(system), c, has_next, has_bias, old), c, window);
  return links.sound;
}

}  // namespace odmc
