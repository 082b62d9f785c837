#include "block_scatter.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "odmc/analysis/widening.h"

namespace odmc {
namespace {

/// Of a block, with its noise, what the coefficients leave.
double RestOf(const Regression& block, const Regression::Terms& x) {
  const double rest =
      block.power - 2.0 * x.dot(block.right) + x.dot((block.gram + block.noise) * x);
  return std::max(0.0, rest);
}

}  // namespace

BlockScatter ScatterOf(const Regression& all, const std::vector<Regression>& blocks,
                       double independent, const BlockOverlap& overlap) {
  using Terms = Regression::Terms;
  using Gram = Regression::Gram;
  const Gram inverse = all.gram.inverse();
  const Terms x = inverse * all.right;
  const Eigen::Index size = x.size();
  const double half = 0.5 / independent;  // of complex values, the real part
  BlockScatter scatter;
  scatter.found = scatter.expected = Terms::Zero(size);
  Terms squares = Terms::Zero(size);
  Gram variance = Gram::Zero(size, size);
  std::vector<Gram> variances;
  for (const Regression& block : blocks) {
    variances.push_back(block.share * half * RestOf(block, x) * inverse *
                        (block.gram + block.noise) * inverse);
    variance += variances.back();
    squares += variances.back().diagonal().cwiseAbs2();
  }
  for (size_t b = 0; b < blocks.size(); ++b) {
    const Regression& block = blocks[b];
    const Terms pull = block.share * inverse * (block.right - block.gram * x);
    scatter.found += overlap.variance * pull.cwiseAbs2();
    // Each block has a hand in the coefficients from which it differs.
    const Gram hand = block.share * inverse * block.gram;
    const Gram expected = variances[b] - hand * variances[b] - (hand * variances[b]).transpose() +
                          hand * variance * hand.transpose();
    scatter.expected += expected.diagonal();
  }
  const Terms diagonal = variance.diagonal();
  const Terms effective = diagonal.cwiseAbs2().cwiseQuotient(squares.cwiseMax(1e-300));
  scatter.freedom = (overlap.freedom * effective.array() - 1.0).max(0.0);
  // Noise of the regressors is in the response's rest, too: the two are not independent.
  const Terms shared = inverse * (all.noise * x);
  scatter.variance = diagonal + half * shared.cwiseAbs2();
  const Gram steady = RestOf(all, x) * inverse * (all.gram + all.noise) * inverse;
  scatter.stationary = half * (steady.diagonal() + shared.cwiseAbs2());
  return scatter;
}

void PooledScatter::Add(const BlockScatter& scatter, Eigen::Index i, double scale) {
  stationary_.push_back(scale * scatter.stationary[i]);
  const double freedom = scatter.freedom[i];
  if (!(scatter.expected[i] > 0.0) || !(scatter.stationary[i] > 0.0)) return;
  bursts_ += freedom * scatter.variance[i] / scatter.stationary[i];
  ratio_ += freedom * scatter.found[i] / scatter.expected[i];
  freedom_ += freedom;
}

double PooledScatter::Variance(size_t k, double least) const {
  const double widening = Widening(freedom_);
  return std::max(least, bursts() * stationary_[k]) * std::max(1.0, widening * widening * ratio());
}

}  // namespace odmc
