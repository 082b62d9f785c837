#include "odmc/attribution/rotor_noise.h"

#include <algorithm>
#include <cmath>
#include <random>

namespace odmc {

RotorVector RotorNoise(const std::vector<RotorSample>& rotors) {
  constexpr size_t kSpan = 4;
  constexpr double kNormal = 0.6745;  // median of the absolute value of a unit normal variable
  const double gain = std::sqrt(70.0);  // of fourth differences
  const Eigen::Index n = rotors.empty() ? 0 : rotors.front().speed.size();
  RotorVector sigma = RotorVector::Zero(n);
  if (rotors.size() < 10 * kSpan) return sigma;
  for (Eigen::Index j = 0; j < n; ++j) {
    std::vector<double> size;
    size.reserve(rotors.size());
    for (size_t i = kSpan; i < rotors.size(); ++i) {
      const auto at = [&](size_t back) { return rotors[i - back].speed[j]; };
      size.push_back(std::abs(at(0) - 4.0 * at(1) + 6.0 * at(2) - 4.0 * at(3) + at(4)));
    }
    const auto middle = size.begin() + static_cast<std::ptrdiff_t>(size.size() / 2);
    std::nth_element(size.begin(), middle, size.end());
    sigma[j] = *middle / (kNormal * gain);
  }
  return sigma;
}

FlightLog WithMoreRotorNoise(const FlightLog& log, unsigned draw) {
  FlightLog noisier = log;
  const RotorVector sigma = RotorNoise(log.rotors);
  std::mt19937 random(draw + 1);
  std::normal_distribution<double> normal;
  for (RotorSample& sample : noisier.rotors) {
    for (Eigen::Index j = 0; j < sample.speed.size(); ++j) {
      sample.speed[j] += sigma[j] * normal(random);
    }
  }
  return noisier;
}

}  // namespace odmc
