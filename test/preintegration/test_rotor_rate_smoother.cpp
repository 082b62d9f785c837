#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <random>

#include "odmc/preintegration/rotor_rate_smoother.h"

namespace odmc {
namespace {

constexpr double kStep_s = 0.01;

/// A smoother fed with speeds at interval boundaries, and the newest average of each interval.
class Fed {
 public:
  /// A straight line between boundaries, one sample an interval.
  void AddBoundary(double speed) {
    if (has_last_) AddInterval(0.5 * (last_ + speed), speed, 1);
    last_ = speed;
    has_last_ = true;
  }
  /// @param mean over the interval, of `num_samples` samples
  void AddInterval(double mean, double end, int num_samples) {
    RotorState state;
    state.speed = RotorVector::Constant(4, mean);
    state.speed_squared = RotorVector::Constant(4, mean * mean);
    state.acceleration = RotorVector::Constant(4, (end - last_) / kStep_s);
    state.speed_squared_rate = RotorVector::Constant(4, (end * end - last_ * last_) / kStep_s);
    const int id = count_++;
    smoother_.Add(id, (id + 0.5) * kStep_s, kStep_s, state, num_samples);
    changed_ = 0;
    smoother_.ForChanged([&](std::int64_t which, const RotorRateSmoother::Rates& rates) {
      of[static_cast<int>(which)] = rates;
      ++changed_;
    });
    last_ = end;
    has_last_ = true;
  }
  void Restart() { smoother_.Restart(); }
  int changed() const { return changed_; }

  std::map<int, RotorRateSmoother::Rates> of;

 private:
  RotorRateSmoother smoother_;
  double last_ = 0.0;
  bool has_last_ = false;
  int count_ = 0, changed_ = 0;
};

TEST(RotorRateSmoother, KeepsASteadyAccelerationAndTheMiddleOfAChangingOne) {
  Fed fed;
  for (int i = 0; i <= 80; ++i) {
    const double t = i * kStep_s;
    fed.AddBoundary(500.0 + 30.0 * t + 40.0 * t * t);  // a window that leaned would lag here
  }
  for (int i = 0; i < 80; ++i) {
    const double middle = (i + 0.5) * kStep_s;
    EXPECT_NEAR(fed.of.at(i).acceleration[2], 30.0 + 80.0 * middle, 1e-9) << i;
  }
}

// A mean over the window would take 4 % of the acceleration at 1 Hz and 15 % at 2 Hz: what follows
// the acceleration, such as a delay, would come out as much too large.
TEST(RotorRateSmoother, KeepsWhatManoeuvresDo) {
  for (const auto& [frequency_Hz, missing] : {std::pair{1.0, 0.005}, std::pair{2.0, 0.05}}) {
    const double w = 2.0 * M_PI * frequency_Hz;
    Fed fed;
    for (int i = 0; i <= 200; ++i) fed.AddBoundary(500.0 + 30.0 * std::sin(w * i * kStep_s));
    double product = 0.0, square = 0.0;
    for (int i = 50; i < 150; ++i) {
      const double expected = 30.0 * w * std::cos(w * (i + 0.5) * kStep_s);
      product += fed.of.at(i).acceleration[0] * expected;
      square += expected * expected;
    }
    EXPECT_NEAR(product / square, 1.0, missing) << frequency_Hz << " Hz";
  }
}

TEST(RotorRateSmoother, SaysHowMuchNoiseIsLeft) {
  std::mt19937 engine(3);
  std::normal_distribution<double> noise;
  const double sigma = 2.0;
  double square = 0.0;
  int count = 0;
  Fed fed;
  constexpr int kSamples = 8;
  const double of_mean = sigma / std::sqrt(kSamples);
  for (int i = 0; i < 40000; ++i) {
    fed.AddInterval(500.0 + of_mean * noise(engine), 500.0 + sigma * noise(engine), kSamples);
  }
  for (const auto& [id, rates] : fed.of) {
    if (id < 20 || id > 39900) continue;
    square += rates.acceleration.head<1>().squaredNorm();
    ++count;
  }
  const double expected = sigma * fed.of.at(1000).noise;
  EXPECT_NEAR(std::sqrt(square / count), expected, 0.03 * expected);
  const double single = std::sqrt(2.0) * sigma / kStep_s;
  EXPECT_LT(expected, 0.06 / std::sqrt(kSamples) * single);
  // The newest interval has nobody after it.
  EXPECT_NEAR(fed.of.rbegin()->second.noise, std::sqrt(2.0) / kStep_s, 1e-9);
}

TEST(RotorRateSmoother, ChangesNothingOlderThanHalfAWindowAndNothingAcrossAGap) {
  Fed fed;
  for (int i = 0; i <= 50; ++i) fed.AddBoundary(500.0 + i);
  EXPECT_EQ(fed.changed(), 13);  // 0.125 s and the newest
  fed.Restart();
  fed.AddBoundary(900.0);  // one interval, wherever it starts
  EXPECT_EQ(fed.changed(), 1);
  EXPECT_NEAR(fed.of.at(50).acceleration[0], (900.0 - 550.0) / kStep_s, 1e-6);
}

}  // namespace
}  // namespace odmc
