#include "odmc/analysis/rotor_smoothing.h"

#include <Eigen/Core>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <limits>

namespace odmc {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;

constexpr double kHole_s = 0.1;
constexpr double kDecades = 14.0;  // ratios of noise lie within so many of one
constexpr size_t kEnough = 20;     // samples, to fit anything

/// Mean and covariance (over the measurement's variance) of (Ω, dΩ/dt).
struct Belief {
  Vector2d mean;
  Matrix2d covariance;
};

Belief Start(double speed) {
  Belief belief;
  belief.mean << speed, 0.0;
  belief.covariance << 1.0, 0.0, 0.0, 1e6;
  return belief;
}

Matrix2d Transition(double dt) {
  Matrix2d F;
  F << 1.0, dt, 0.0, 1.0;
  return F;
}

Belief Predict(const Belief& from, const RotorSpeedNoise& noise, double dt) {
  const Matrix2d F = Transition(dt);
  Matrix2d Q;
  Q << noise.walk * dt + noise.trend * dt * dt * dt / 3.0, noise.trend * dt * dt / 2.0,
      noise.trend * dt * dt / 2.0, noise.trend * dt;
  return {F * from.mean, F * from.covariance * F.transpose() + Q};
}

/// @returns the innovation and its variance
std::array<double, 2> Update(double speed, Belief* belief) {
  const double innovation = speed - belief->mean[0], variance = belief->covariance(0, 0) + 1.0;
  const Vector2d gain = belief->covariance.col(0) / variance;
  belief->mean += gain * innovation;
  belief->covariance -= gain * belief->covariance.row(0).eval();
  return {innovation, variance};
}

double Gap(const std::vector<RotorSample>& samples, size_t i) {
  return ToSeconds(samples[i].stamp - samples[i - 1].stamp);
}

/// Minus the log-likelihood; the measurement's variance is the one that maximises it.
double Unlikelihood(const std::vector<RotorSample>& samples, RotorSpeedNoise* noise) {
  double squares = 0.0, logs = 0.0, count = 0.0;
  for (Eigen::Index j = 0; j < samples.front().speed.size(); ++j) {
    Belief belief = Start(samples.front().speed[j]);
    size_t in_run = 0;
    for (size_t i = 1; i < samples.size(); ++i) {
      const double dt = Gap(samples, i), speed = samples[i].speed[j];
      if (dt > kHole_s) {
        belief = Start(speed);
        in_run = 0;
        continue;
      }
      belief = Predict(belief, *noise, dt);
      const auto [innovation, variance] = Update(speed, &belief);
      if (++in_run < 3) continue;  // the start knows nothing
      squares += innovation * innovation / variance;
      logs += std::log(variance);
      count += 1.0;
    }
  }
  if (count < 1.0) return 0.0;
  const double measurement = std::max(squares / count, 1e-12);
  noise->measurement_rad_s = std::sqrt(measurement);
  return 0.5 * (logs + count * std::log(measurement));
}

}  // namespace

RotorSpeedNoise FitRotorSpeedNoise(const std::vector<RotorSample>& samples) {
  RotorSpeedNoise best;
  best.walk = 1e2;
  best.trend = 1e5;
  if (samples.size() < kEnough) return best;
  double lowest = Unlikelihood(samples, &best);
  for (double decades = 2.0; decades > 0.2; decades *= 0.5) {
    bool improved = true;
    while (improved) {
      improved = false;
      for (double RotorSpeedNoise::*ratio : {&RotorSpeedNoise::walk, &RotorSpeedNoise::trend}) {
        for (const double sign : {1.0, -1.0}) {
          RotorSpeedNoise other = best;
          other.*ratio *= std::pow(10.0, sign * decades);
          if (std::abs(std::log10(other.*ratio)) > kDecades) continue;
          const double unlikelihood = Unlikelihood(samples, &other);
          if (unlikelihood > lowest - 0.5) continue;
          lowest = unlikelihood;
          best = other;
          improved = true;
        }
      }
    }
  }
  return best;
}

std::vector<RotorSample> SmoothRotorSpeeds(const std::vector<RotorSample>& samples) {
  if (samples.size() < kEnough) return samples;
  const RotorSpeedNoise noise = FitRotorSpeedNoise(samples);
  std::vector<RotorSample> smooth = samples;
  std::vector<Belief> predicted(samples.size()), filtered(samples.size());
  for (Eigen::Index j = 0; j < samples.front().speed.size(); ++j) {
    for (size_t i = 0; i < samples.size(); ++i) {
      const bool starts = i == 0 || Gap(samples, i) > kHole_s;
      if (starts) {
        filtered[i] = predicted[i] = Start(samples[i].speed[j]);
        continue;
      }
      predicted[i] = filtered[i] = Predict(filtered[i - 1], noise, Gap(samples, i));
      Update(samples[i].speed[j], &filtered[i]);
    }
    Vector2d mean = filtered.back().mean;
    smooth.back().speed[j] = mean[0];
    for (size_t i = samples.size() - 1; i-- > 0;) {
      const double dt = Gap(samples, i + 1);
      if (dt > kHole_s) {
        mean = filtered[i].mean;
      } else {
        const Matrix2d gain = filtered[i].covariance * Transition(dt).transpose() *
                              predicted[i + 1].covariance.inverse();
        mean = filtered[i].mean + gain * (mean - predicted[i + 1].mean);
      }
      smooth[i].speed[j] = std::max(0.0, mean[0]);
    }
  }
  return smooth;
}

}  // namespace odmc
