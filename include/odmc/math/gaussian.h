#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <random>

namespace odmc {

/// Normal numbers that are the same on every machine (std::normal_distribution is not). Each use of
/// randomness takes its own `stream`, so that switching one off leaves the others as they were.
class Gaussian {
 public:
  Gaussian(int seed, int stream);

  /// One number of zero mean and standard deviation 1.
  double Next();
  /// Three of them (3×1).
  Eigen::Vector3d Next3();

 private:
  double Uniform();  // in (0, 1]

  std::mt19937_64 generator_;
  double spare_ = 0.0;
  bool has_spare_ = false;
};

}  // namespace odmc
