#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace odmc {

/// One way to read a stream, and how far it then is from what it should be.
struct StreamReading {
  std::string name;          ///< "as it is", "in the body frame"
  Eigen::Matrix3Xd error{};  ///< of every window
  bool fitted = false;       ///< has a parameter that was fitted to these windows
};

/// What blocks of windows say about readings of the same windows.
struct BestReading {
  int best = 0;            ///< index of the reading with the least error
  double share = 1.0;      ///< its mean square over that of the first, median of the blocks
  double sigmas = 0.0;     ///< of the mean log ratio over blocks, in standard errors
  double error_rms = 0.0;  ///< of the first, median of the blocks
  double best_error_rms = 0.0;
  /// How far what should be read lies from the first reading towards the best one: 0 is the first,
  /// 1 the best; with the sigma that the scatter of blocks shows.
  double towards = 0.0, towards_sigma = 1e9;
  bool fitted = false;  ///< the best one
  /// True if the first one is wrong and the best one right: see kMistakeShare and kMistakeSigmas,
  /// or kTowardsSpread.
  bool mistaken() const;
};

/// A gross mistake leaves most of a signal unexplained, what reads it rightly little: a quarter of
/// the mean square at most. Five standard errors: once in millions of recordings by accident, which
/// leaves room for the many readings that are compared.
constexpr double kMistakeShare = 0.25, kMistakeSigmas = 5.0;

/// Mistakes too small for that (a velocity in the body frame of a vehicle that hardly tilts) still
/// lie on one line with the right reading: by Bayes' rule, with one recording in a hundred
/// mistaken, so that a right one is called mistaken once in 10 000. What filters and wrong scales
/// pull along that line has this spread: twice the 0.08 RMS of 9400 wrong readings of 58 right
/// recordings of eight vehicles. Signals that are mostly noise pull farther, so half of the mean
/// square must go, too.
constexpr double kTowardsSpread = 0.15, kMistakesAre = 0.01, kFalselyMistaken = 1e-4;
constexpr double kTowardsShare = 0.5;

/// Readings that explain all but as much cannot be told apart: of these, the one that comes first
/// is taken. (Mean square over the least, median of the blocks; log ratio in standard errors.)
constexpr double kAsGoodShare = 1.1, kAsGoodSigmas = 3.0;

/// Compares readings (the first: as it is; then the likeliest first). @param windows_per_block
/// > 0
BestReading CompareReadings(const std::vector<StreamReading>& readings, int windows_per_block);

}  // namespace odmc
