#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace odmc {

/// One way to read a stream, and how far it then is from what it should be.
struct Explanation {
  std::string name;          ///< "as it is", "in the body frame"
  Eigen::Matrix3Xd error{};  ///< of every window
};

/// What blocks of windows say about explanations of the same windows.
struct Verdict {
  int best = 0;                ///< index of the explanation with the least error
  double share = 1.0;          ///< its mean square over that of the first, median of the blocks
  double sigmas = 0.0;         ///< of the mean log ratio over blocks, in standard errors
  double error_rms = 0.0;      ///< of the first, median of the blocks
  double best_error_rms = 0.0;
  /// True if the first one is wrong and the best one right: see kMistakeShare and kMistakeSigmas.
  bool mistaken() const;
};

/// A gross mistake leaves most of a signal unexplained, what reads it rightly little: a quarter of
/// the mean square at most. Five standard errors: once in millions of recordings by accident, which
/// leaves room for the many readings that are compared.
constexpr double kMistakeShare = 0.25, kMistakeSigmas = 5.0;

/// Compares explanations (the first: as it is). @param windows_per_block > 0
Verdict Judge(const std::vector<Explanation>& explanations, int windows_per_block);

}  // namespace odmc
