#pragma once

#include <ceres/cost_function.h>
#include <ceres/jet.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "odmc/factors/manifolds.h"
#include "support/autodiff_twin.h"

namespace odmc {
namespace test {

/// Numbers that are the same on every run and machine.
class Random {
 public:
  explicit Random(unsigned seed) : generator_(seed) {}
  /// Uniform in [-size, size).
  double Next(double size = 1.0) {
    return size * (2.0 * static_cast<double>(generator_() >> 11) * 0x1.0p-53 - 1.0);
  }
  Eigen::Vector3d Next3(double size = 1.0) {
    const double x = Next(size), y = Next(size), z = Next(size);
    return {x, y, z};
  }
  Eigen::VectorXd NextVector(int n, double size = 1.0) {
    Eigen::VectorXd v(n);
    for (int i = 0; i < n; ++i) v[i] = Next(size);
    return v;
  }
  Eigen::MatrixXd NextMatrix(int rows, int cols, double size = 1.0) {
    Eigen::MatrixXd m(rows, cols);
    for (int j = 0; j < cols; ++j) m.col(j) = NextVector(rows, size);
    return m;
  }
  /// Sum of twelve uniforms: near enough to normal, unit standard deviation.
  double Normal() {
    double sum = 0.0;
    for (int i = 0; i < 12; ++i) sum += Next(0.5);
    return sum;
  }

 private:
  std::mt19937_64 generator_;
};

constexpr int kJetSize = 64;
using Jet = ceres::Jet<double, kJetSize>;

/// The variables a residual touches, in the order of the cost function's blocks.
struct BlockValues {
  std::vector<State> states;
  std::vector<Eigen::VectorXd> biases;
  Eigen::VectorXd eta;  ///< empty: no such block
};

/// The same as jets, seeded in tangent space.
struct BlockJets {
  std::vector<twin::Motion<Jet>> x;
  std::vector<twin::VX<Jet>> bias;
  twin::VX<Jet> eta;
};

using TwinFunction = std::function<twin::VX<Jet>(const BlockJets&)>;

inline std::vector<int> TangentSizes(const BlockValues& at) {
  std::vector<int> sizes(at.states.size(), 12);
  for (const auto& b : at.biases) sizes.push_back(static_cast<int>(b.size()));
  if (at.eta.size() > 0) sizes.push_back(static_cast<int>(at.eta.size()));
  return sizes;
}

inline BlockJets Seed(const BlockValues& at) {
  BlockJets jets;
  int next = 0;
  const auto vector = [&next](const auto& value) {
    twin::VX<Jet> out(value.size());
    for (int i = 0; i < value.size(); ++i) out[i] = Jet(value[i], next++);
    return out;
  };
  const Eigen::Vector3d zero = Eigen::Vector3d::Zero();
  for (const State& s : at.states) {
    twin::Motion<Jet> x;
    x.p = vector(s.p_WS);
    const twin::V3<Jet> turn = vector(zero);
    x.q = s.q_WS.cast<Jet>() * twin::Exp<Jet>(turn);
    x.v = vector(s.v_WS);
    x.omega = vector(s.w_WS_S);
    jets.x.push_back(x);
  }
  for (const auto& b : at.biases) jets.bias.push_back(vector(b));
  jets.eta = vector(at.eta);
  return jets;
}

/// Result of one comparison: the largest relative difference, and where.
struct JacobianDifference {
  double residual = 0.0;  ///< relative to the residual's size, at least 1
  double jacobian = 0.0;
  std::string where;
};

/// Compares residual and every Jacobian block of `cost` with the automatic derivatives of `twin` in
/// tangent space (ambient Jacobian times Plus Jacobian). Rows are compared in groups of three (one
/// quantity, one unit each), columns in groups of three for states and biases, one by one for
/// parameters. A group far smaller than its block counts against 1e-4 of the block, so that zeros
/// that come out as 1e-17 pass.
inline JacobianDifference CompareWithTwin(const ceres::CostFunction& cost, const BlockValues& at,
                                          const TwinFunction& twin_residual) {
  JacobianDifference result;
  const int rows = cost.num_residuals();
  std::vector<std::vector<double>> storage;
  for (const State& s : at.states) {
    storage.emplace_back(kStateSize);
    s.ToBlock(storage.back().data());
  }
  for (const auto& b : at.biases) storage.emplace_back(b.data(), b.data() + b.size());
  if (at.eta.size() > 0) storage.emplace_back(at.eta.data(), at.eta.data() + at.eta.size());
  const auto fail = [&result](const std::string& why) {
    result.jacobian = result.residual = std::numeric_limits<double>::infinity();
    result.where = why;
    return result;
  };
  const auto& sizes = cost.parameter_block_sizes();
  if (sizes.size() != storage.size()) return fail("number of blocks");
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  std::vector<const double*> blocks;
  std::vector<RowMajor> ambient;
  for (size_t i = 0; i < storage.size(); ++i) {
    if (static_cast<int>(storage[i].size()) != sizes[i]) return fail("size of a block");
    blocks.push_back(storage[i].data());
    ambient.push_back(RowMajor::Constant(rows, sizes[i], std::nan("")));
  }
  std::vector<double*> jacobians;
  for (RowMajor& J : ambient) jacobians.push_back(J.data());
  Eigen::VectorXd r(rows), again(rows);
  if (!cost.Evaluate(blocks.data(), r.data(), jacobians.data())) return fail("not evaluated");
  if (!cost.Evaluate(blocks.data(), again.data(), nullptr) || again != r) {
    return fail("residual without Jacobians differs");
  }

  const twin::VX<Jet> expected = twin_residual(Seed(at));
  if (expected.size() != rows) return fail("number of residuals");
  const std::vector<int> tangent = TangentSizes(at);
  double error = 0.0, size = 1.0;
  for (int i = 0; i < rows; ++i) {
    error = std::max(error, std::abs(expected[i].a - r[i]));
    size = std::max(size, std::abs(r[i]));
  }
  result.residual = error / size;

  int column = 0;
  for (size_t i = 0; i < blocks.size(); ++i) {
    Eigen::MatrixXd J = ambient[i];
    const bool is_state = i < at.states.size();
    const bool is_eta = i >= at.states.size() + at.biases.size();
    if (is_state) {
      RowMajor plus(kStateSize, kStateTangentSize);
      StateManifold().PlusJacobian(blocks[i], plus.data());
      J = (ambient[i] * plus).eval();
    }
    Eigen::MatrixXd J_twin(rows, tangent[i]);
    for (int a = 0; a < rows; ++a) {
      for (int b = 0; b < tangent[i]; ++b) J_twin(a, b) = expected[a].v[column + b];
    }
    for (int row = 0; row < rows; row += 3) {
      const int height = std::min(3, rows - row);
      const double block_norm = J_twin.middleRows(row, height).norm();
      const int step = is_eta ? 1 : 3;
      for (int c = 0; c < tangent[i]; c += step) {
        const int width = std::min(step, tangent[i] - c);
        const auto a = J.block(row, c, height, width);
        const auto b = J_twin.block(row, c, height, width);
        const double scale = std::max({b.norm(), 1e-4 * block_norm, 1e-12});
        const double difference = (a - b).norm() / scale;
        if (difference <= result.jacobian) continue;  // false for NaN: it is kept
        result.jacobian = difference;
        result.where = "block " + std::to_string(i) + ", rows from " + std::to_string(row) +
                       ", column " + std::to_string(c);
        if (std::isnan(difference)) return fail("NaN in " + result.where);
      }
    }
    column += tangent[i];
  }
  return result;
}

}  // namespace test
}  // namespace odmc
