#include <gtest/gtest.h>

#include <cmath>

#include "odmc/estimator/change_detector.h"
#include "odmc/math/gaussian.h"

namespace odmc {
namespace {

constexpr double kWeight_N = 7.36, kStep_s = 0.01;
const Eigen::Vector3d kInertia(2.5e-3, 2.1e-3, 4.3e-3);

// Residuals as gusts leave them: correlated over half a second.
class Residuals {
 public:
  explicit Residuals(int seed) : random_(seed, 1) {}
  Eigen::Vector3d Force(double sigma_N) {
    const double decay = std::exp(-kStep_s / 0.5);
    gust_ = decay * gust_ + std::sqrt(1.0 - decay * decay) * random_.Next3();
    return sigma_N * (gust_ + random_.Next3());
  }

 private:
  Gaussian random_;
  Eigen::Vector3d gust_ = Eigen::Vector3d::Zero();
};

TEST(ChangeDetector, IsSilentInUnsteadyAir) {
  for (int seed = 1; seed <= 20; ++seed) {
    ChangeDetector detector(kWeight_N, kInertia);
    Residuals residuals(seed);
    for (int k = 0; k < 12000; ++k) {
      ASSERT_FALSE(detector.Add(kStep_s, residuals.Force(0.15), 1e-3 * residuals.Force(1.0)))
          << "seed " << seed << " after " << kStep_s * k << " s";
    }
  }
}

// A load of a fifth of the weight: once, and soon.
TEST(ChangeDetector, SeesALoadOnce) {
  ChangeDetector detector(kWeight_N, kInertia);
  Residuals residuals(3);
  const Eigen::Vector3d load(0.0, 0.0, -0.2 * kWeight_N);
  int found = 0;
  double first_s = 0.0;
  for (int k = 0; k < 2000; ++k) {
    // The estimate has taken it up after a second.
    const bool unexplained = k >= 1000 && k < 1100;
    const Eigen::Vector3d force = residuals.Force(0.05) + (unexplained ? load : load * 0.0);
    if (!detector.Add(kStep_s, force, Eigen::Vector3d::Zero())) continue;
    if (++found == 1) first_s = kStep_s * (k - 1000);
  }
  EXPECT_EQ(found, 1);
  EXPECT_GE(first_s, 0.0);
  EXPECT_LT(first_s, 0.3);
}

TEST(ChangeDetector, SeesABrokenPropellerByItsTorque) {
  ChangeDetector detector(kWeight_N, kInertia);
  bool found = false;
  for (int k = 0; k < 1100; ++k) {
    const Eigen::Vector3d torque(0.0, k >= 1000 ? 0.02 : 0.0, 0.0);
    found = detector.Add(kStep_s, Eigen::Vector3d::Zero(), torque) || found;
  }
  EXPECT_TRUE(found);
}

TEST(ChangeDetector, TakesNoSmallChangeForOne) {
  ChangeDetector detector(kWeight_N, kInertia);
  for (int k = 0; k < 3000; ++k) {
    const Eigen::Vector3d force(0.0, 0.0, k >= 1000 ? 0.03 * kWeight_N : 0.0);
    EXPECT_FALSE(detector.Add(kStep_s, force, Eigen::Vector3d::Zero()));
  }
}

}  // namespace
}  // namespace odmc
