#include "odmc/inspection/explanations.h"

#include <algorithm>
#include <cmath>

#include "odmc/math/statistics.h"

namespace odmc {
namespace {

constexpr int kLeastBlocks = 5;

/// Mean square of every whole block.
std::vector<double> BlockSquares(const Eigen::Matrix3Xd& error, int windows) {
  std::vector<double> squares;
  for (Eigen::Index i = 0; i + windows <= error.cols(); i += windows) {
    squares.push_back(error.middleCols(i, windows).squaredNorm() / windows);
  }
  return squares;
}

}  // namespace

bool Verdict::mistaken() const {
  return best != 0 && share < kMistakeShare && sigmas > kMistakeSigmas;
}

Verdict Judge(const std::vector<Explanation>& explanations, int windows_per_block) {
  Verdict verdict;
  std::vector<std::vector<double>> squares;
  for (const Explanation& e : explanations) {
    squares.push_back(BlockSquares(e.error, windows_per_block));
  }
  if (squares.empty() || squares.front().size() < kLeastBlocks) return verdict;
  std::vector<double> medians;
  for (const auto& blocks : squares) medians.push_back(Median(blocks));
  verdict.best =
      static_cast<int>(std::min_element(medians.begin(), medians.end()) - medians.begin());
  verdict.error_rms = std::sqrt(medians.front());
  verdict.best_error_rms = std::sqrt(medians[verdict.best]);
  std::vector<double> ratios;
  double mean = 0.0, square = 0.0;
  for (size_t b = 0; b < squares.front().size(); ++b) {
    const double ratio = std::log((squares[0][b] + 1e-30) / (squares[verdict.best][b] + 1e-30));
    ratios.push_back(ratio);
    mean += ratio;
    square += ratio * ratio;
  }
  const auto n = static_cast<double>(ratios.size());
  mean /= n;
  const double variance = std::max(square / n - mean * mean, 1e-12) * n / (n - 1.0);
  verdict.sigmas = mean / std::sqrt(variance / n);
  verdict.share = std::exp(-Median(ratios));
  return verdict;
}

}  // namespace odmc
