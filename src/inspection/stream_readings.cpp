#include "odmc/inspection/stream_readings.h"

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

/// Of two readings' mean squares, block by block.
struct LogRatio {
  double median = 0.0;
  double sigmas = 0.0;  ///< of the mean, in standard errors
};

LogRatio Ratio(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> ratios;
  double mean = 0.0, square = 0.0;
  for (size_t i = 0; i < a.size(); ++i) {
    const double ratio = std::log((a[i] + 1e-30) / (b[i] + 1e-30));
    ratios.push_back(ratio);
    mean += ratio;
    square += ratio * ratio;
  }
  const auto n = static_cast<double>(ratios.size());
  mean /= n;
  const double variance = std::max(square / n - mean * mean, 1e-12) * n / (n - 1.0);
  return {Median(ratios), mean / std::sqrt(variance / n)};
}

/// How far the truth lies from `first` towards `best`, and its sigma by blocks of windows.
void Towards(const Eigen::Matrix3Xd& first, const Eigen::Matrix3Xd& best, int windows,
             BestReading* verdict) {
  std::vector<double> along, square;
  double sum = 0.0, weight = 0.0;
  for (Eigen::Index i = 0; i + windows <= first.cols(); i += windows) {
    const Eigen::Matrix3Xd error = first.middleCols(i, windows);
    const Eigen::Matrix3Xd apart = best.middleCols(i, windows) - error;
    along.push_back(-error.cwiseProduct(apart).sum());
    square.push_back(apart.squaredNorm());
    sum += along.back();
    weight += square.back();
  }
  if (!(weight > 0.0)) return;
  verdict->towards = sum / weight;
  double scatter = 0.0;  // of neighbouring blocks together: what is off lasts for a second
  for (size_t b = 0; b + 1 < along.size(); b += 2) {
    const double off = along[b] + along[b + 1] - verdict->towards * (square[b] + square[b + 1]);
    scatter += off * off;
  }
  verdict->towards_sigma = std::sqrt(scatter) / weight;
}

}  // namespace

bool BestReading::mistaken() const {
  if (best == 0) return false;
  if (share < kMistakeShare && sigmas > kMistakeSigmas) return true;
  if (fitted || share > kTowardsShare) return false;
  const double variance = towards_sigma * towards_sigma + kTowardsSpread * kTowardsSpread;
  const double nats = (2.0 * towards - 1.0) / (2.0 * variance);
  return nats > std::log((1.0 - kMistakesAre) / (kMistakesAre * kFalselyMistaken));
}

BestReading CompareReadings(const std::vector<StreamReading>& readings, int windows_per_block) {
  BestReading verdict;
  std::vector<std::vector<double>> squares;
  for (const StreamReading& e : readings) {
    squares.push_back(BlockSquares(e.error, windows_per_block));
  }
  if (squares.empty() || squares.front().size() < kLeastBlocks) return verdict;
  std::vector<double> medians;
  for (const auto& blocks : squares) medians.push_back(Median(blocks));
  const auto least = std::min_element(medians.begin(), medians.end());
  const std::vector<double>& best_squares = squares[static_cast<size_t>(least - medians.begin())];
  while (medians[static_cast<size_t>(verdict.best)] > kAsGoodShare * *least ||
         Ratio(squares[static_cast<size_t>(verdict.best)], best_squares).sigmas > kAsGoodSigmas) {
    ++verdict.best;
  }
  verdict.fitted = readings[static_cast<size_t>(verdict.best)].fitted;
  Towards(readings.front().error, readings[static_cast<size_t>(verdict.best)].error,
          windows_per_block, &verdict);
  verdict.error_rms = std::sqrt(medians.front());
  verdict.best_error_rms = std::sqrt(medians[verdict.best]);
  const LogRatio ratio = Ratio(squares.front(), squares[static_cast<size_t>(verdict.best)]);
  verdict.sigmas = ratio.sigmas;
  verdict.share = std::exp(-ratio.median);
  return verdict;
}

}  // namespace odmc
