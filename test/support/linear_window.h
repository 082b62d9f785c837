#pragma once

#include <ceres/cost_function.h>

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "odmc/factors/manifolds.h"
#include "odmc/factors/state_factors.h"
#include "odmc/math/so3.h"
#include "odmc/window/window.h"
#include "support/jacobian_check.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {

/// r = b + sum M_i x_i, with a state's x its (p, Log q, v, w).
class LinearCost final : public ceres::CostFunction {
 public:
  /// @param states how many of the first blocks are states
  LinearCost(Eigen::VectorXd b, std::vector<Eigen::MatrixXd> M, int states)
      : b_(std::move(b)), M_(std::move(M)), states_(states) {
    set_num_residuals(static_cast<int>(b_.size()));
    for (size_t i = 0; i < M_.size(); ++i) {
      mutable_parameter_block_sizes()->push_back(
          static_cast<int>(i) < states ? kStateSize : static_cast<int>(M_[i].cols()));
    }
  }

  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override {
    Eigen::Map<Eigen::VectorXd> r(residual, b_.size());
    r = b_;
    for (size_t i = 0; i < M_.size(); ++i) {
      if (static_cast<int>(i) >= states_) {
        r += M_[i] * Eigen::Map<const Eigen::VectorXd>(blocks[i], M_[i].cols());
        if (jacobians != nullptr) WriteJacobian(M_[i], jacobians[i]);
        continue;
      }
      const State s = State::FromBlock(blocks[i]);
      const Eigen::Vector3d turn = Log(s.q_WS);
      Eigen::VectorXd d(12);
      d << s.p_WS, turn, s.v_WS, s.w_WS_S;
      r += M_[i] * d;
      if (jacobians == nullptr || jacobians[i] == nullptr) continue;
      Eigen::MatrixXd J = M_[i];
      J.middleCols<3>(3) = (M_[i].middleCols<3>(3) * RightJacobianInverse(turn)).eval();
      WriteJacobian(StateManifold::Lift(J, blocks[i]), jacobians[i]);
    }
    return r.allFinite();
  }

 private:
  Eigen::VectorXd b_;
  std::vector<Eigen::MatrixXd> M_;
  int states_;
};

/// Four linear parameters: drag and HVT of the nominal vehicle.
inline DynamicModel FourParameterModel() { return DynamicModel(NominalVehicle(), {"drag", "hvt"}); }

/// How a window of linear factors is made.
struct LinearWindowOptions {
  int keyframes = 6;
  int keyframes_per_bias = 0;         ///< 0: no biases
  int unlinked = -1;                  ///< index of a keyframe that starts a new chain
  bool position_seen = true;          ///< false: only differences of positions enter
  Eigen::VectorXd unseen_parameters;  ///< a direction of eta no factor sees; empty: none
  bool with_rotation = true;          ///< a prior on each rotation, centred where it is
  bool anchored = false;              ///< factors of parameters take the first one's anchor, too
};

/// Adds keyframes with linear factors to `window` (of an n-parameter layout).
class LinearWindowMaker {
 public:
  LinearWindowMaker(Window* window, const LinearWindowOptions& options, unsigned seed)
      : window_(window), options_(options), random_(seed) {
    if (options.anchored) window->SetAnchorEntry(0);
  }

  void Fill() {
    for (int k = 0; k < options_.keyframes; ++k) AddKeyframe();
  }

  void AddKeyframe() {
    const bool with_bias = options_.keyframes_per_bias > 0;
    const bool first = count_ == 0;
    const bool linked = !first && count_ != options_.unlinked;
    std::int64_t walk_from = -1;
    bool new_bias = false;
    if (with_bias && count_ % options_.keyframes_per_bias == 0) {
      new_bias = true;
      walk_from = bias_;
      bias_ = window_->AddBias(random_.NextVector(6, 0.2));
      if (walk_from >= 0) {
        // As in the estimator: it belongs to the last keyframe with the old bias.
        AddLinear(6, {}, {walk_from, bias_}, false);
      }
    }
    State s;
    s.p_WS = random_.Next3();
    s.v_WS = random_.Next3();
    s.w_WS_S = random_.Next3();
    const std::int64_t id =
        window_->AddKeyframe(count_ * 10000000, s, linked, with_bias ? bias_ : -1);
    if (new_bias && walk_from < 0) AddLinear(6, {}, {bias_}, false);
    AddLinear(9, {id}, {}, false);
    if (options_.with_rotation) AddRotationPrior(id);
    if (linked) {
      const std::vector<std::int64_t> biases =
          with_bias ? std::vector<std::int64_t>{window_->keyframe(id - 1).bias}
                    : std::vector<std::int64_t>{};
      AddLinear(9, {id - 1, id}, biases, true);
    }
    ++count_;
  }

 private:
  void AddLinear(int rows, const std::vector<std::int64_t>& states,
                 const std::vector<std::int64_t>& biases, bool parameters) {
    std::vector<Eigen::MatrixXd> M;
    for (size_t i = 0; i < states.size(); ++i) {
      Eigen::MatrixXd m = random_.NextMatrix(rows, 12);
      m.middleCols<3>(3).setZero();
      if (!options_.position_seen) {
        if (states.size() == 1) m.leftCols<3>().setZero();
        if (i == 1) m.leftCols<3>() = -M[0].leftCols<3>();
      }
      M.push_back(m);
    }
    for (size_t i = 0; i < biases.size(); ++i) M.push_back(random_.NextMatrix(rows, 6));
    if (parameters) {
      Eigen::MatrixXd m = random_.NextMatrix(rows, window_->layout().num_estimated());
      if (options_.unseen_parameters.size() > 0) {
        const Eigen::VectorXd n = options_.unseen_parameters.normalized();
        m -= (m * n).eval() * n.transpose();
      }
      M.push_back(m);
      if (options_.anchored) M.push_back(random_.NextMatrix(rows, 1, 0.3));
    }
    Add(std::make_unique<LinearCost>(random_.NextVector(rows), M, static_cast<int>(states.size())),
        states, biases, parameters);
  }

  void AddRotationPrior(std::int64_t id) {
    Eigen::MatrixXd M = Eigen::MatrixXd::Zero(3, 12);
    M.middleCols<3>(3) = 2.0 * Eigen::Matrix3d::Identity() + random_.NextMatrix(3, 3, 0.5);
    Add(std::make_unique<LinearCost>(Eigen::VectorXd::Zero(3), std::vector<Eigen::MatrixXd>{M}, 1),
        {id}, {}, false);
  }

  void Add(std::unique_ptr<ceres::CostFunction> cost, const std::vector<std::int64_t>& states,
           const std::vector<std::int64_t>& biases, bool parameters) {
    Factor factor;
    factor.kind = FactorKind::kOther;
    factor.cost = std::move(cost);
    if (!states.empty()) factor.state0 = states[0];
    if (states.size() > 1) factor.state1 = states[1];
    if (!biases.empty()) factor.bias0 = biases[0];
    if (biases.size() > 1) factor.bias1 = biases[1];
    factor.parameters = parameters;
    factor.anchored = parameters && options_.anchored;
    window_->AddFactor(std::move(factor));
  }

  Window* window_;
  LinearWindowOptions options_;
  Random random_;
  int count_ = 0;
  std::int64_t bias_ = -1;
};

/// Normal equations of a whole window at its present estimate: |r + J d|², columns named by what
/// they belong to. Does not hold the parameters' own priors.
struct Normal {
  Eigen::MatrixXd H;
  Eigen::VectorXd g;
};

inline Normal DenseNormal(const Window& window) {
  const int n = window.layout().num_estimated();
  const int states = 12 * static_cast<int>(window.keyframes().size());
  const int biases = 6 * static_cast<int>(window.biases().size());
  const int size = states + biases + n;
  const auto state_column = [&](std::int64_t id) {
    return 12 * static_cast<int>(id - window.keyframes().front().id);
  };
  const auto bias_column = [&](std::int64_t id) {
    return states + 6 * static_cast<int>(id - window.biases().front().id);
  };
  Normal normal{Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size)};
  // A factor's columns are few beside the window's: only their blocks are summed.
  struct Columns {
    int own, whole, count;
  };
  const auto add = [&](const Eigen::MatrixXd& J, const Eigen::VectorXd& r,
                       const std::vector<Columns>& columns) {
    for (const Columns& a : columns) {
      const Eigen::MatrixXd Jt = J.middleCols(a.own, a.count).transpose();
      normal.g.segment(a.whole, a.count) += Jt * r;
      for (const Columns& b : columns) {
        normal.H.block(a.whole, b.whole, a.count, b.count) += Jt * J.middleCols(b.own, b.count);
      }
    }
  };
  const Prior& prior = window.prior();
  if (prior.b.size() > 0) {
    std::vector<Columns> columns;
    int column = 0;
    if (prior.has_state) {
      columns.push_back({0, 0, 12});
      column = 12;
    }
    if (prior.has_bias) {
      columns.push_back({column, bias_column(window.keyframes().front().bias), 6});
      column += 6;
    }
    columns.push_back({static_cast<int>(prior.A.cols()) - n, size - n, n});
    add(prior.A, PriorResidual(window), columns);
  }
  for (const Keyframe& keyframe : window.keyframes()) {
    for (const Factor& factor : keyframe.factors) {
      LinearFactor linear;
      if (!Linearize(window, factor, false, &linear)) continue;
      std::vector<Columns> columns;
      if (linear.state0 >= 0) columns.push_back({linear.state0, state_column(factor.state0), 12});
      if (linear.state1 >= 0) columns.push_back({linear.state1, state_column(factor.state1), 12});
      if (linear.bias0 >= 0) columns.push_back({linear.bias0, bias_column(factor.bias0), 6});
      if (linear.bias1 >= 0) columns.push_back({linear.bias1, bias_column(factor.bias1), 6});
      if (linear.parameters >= 0) columns.push_back({linear.parameters, size - n, n});
      add(linear.J, linear.r, columns);
    }
  }
  return normal;
}

/// Schur complement on the columns in `keep`, by a pseudo-inverse of the rest.
inline Normal MarginalOf(const Normal& whole, const std::vector<int>& keep) {
  std::vector<bool> kept(whole.g.size(), false);
  for (const int k : keep) kept[k] = true;
  std::vector<int> gone;
  for (int i = 0; i < whole.g.size(); ++i) {
    if (!kept[i]) gone.push_back(i);
  }
  const auto pick = [&](const std::vector<int>& rows, const std::vector<int>& cols) {
    Eigen::MatrixXd part(rows.size(), cols.size());
    for (size_t i = 0; i < rows.size(); ++i) {
      for (size_t j = 0; j < cols.size(); ++j) part(i, j) = whole.H(rows[i], cols[j]);
    }
    return part;
  };
  Eigen::VectorXd g_keep(keep.size()), g_gone(gone.size());
  for (size_t i = 0; i < keep.size(); ++i) g_keep[i] = whole.g[keep[i]];
  for (size_t i = 0; i < gone.size(); ++i) g_gone[i] = whole.g[gone[i]];
  if (gone.empty()) return {pick(keep, keep), g_keep};
  const Eigen::MatrixXd across = pick(keep, gone);
  Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> inside(pick(gone, gone));
  inside.setThreshold(1e-11);
  const Eigen::MatrixXd inverse = inside.pseudoInverse();
  return {pick(keep, keep) - across * inverse * across.transpose(),
          g_keep - across * inverse * g_gone};
}

/// Columns of DenseNormal() that remain once the first `states` keyframes and `biases` biases left.
inline std::vector<int> Remaining(const Window& window, int states, int biases) {
  const int num_states = 12 * static_cast<int>(window.keyframes().size());
  const int num_biases = 6 * static_cast<int>(window.biases().size());
  std::vector<int> keep;
  for (int i = 12 * states; i < num_states; ++i) keep.push_back(i);
  for (int i = 6 * biases; i < num_biases; ++i) keep.push_back(num_states + i);
  for (int i = 0; i < window.layout().num_estimated(); ++i) {
    keep.push_back(num_states + num_biases + i);
  }
  return keep;
}

/// Relative difference of two normal equations, scaled by the first's diagonal.
inline double Difference(const Normal& a, const Normal& b) {
  if (a.H.rows() != b.H.rows()) return 1e300;
  Eigen::VectorXd scale = a.H.diagonal().cwiseMax(1e-12 * a.H.diagonal().maxCoeff());
  scale = scale.cwiseSqrt().cwiseInverse();
  const double H = (scale.asDiagonal() * (a.H - b.H) * scale.asDiagonal()).cwiseAbs().maxCoeff();
  const double g_size = std::max(1.0, (scale.asDiagonal() * a.g).cwiseAbs().maxCoeff());
  return std::max(H, (scale.asDiagonal() * (a.g - b.g)).cwiseAbs().maxCoeff() / g_size);
}

}  // namespace test
}  // namespace odmc
