#include "odmc/sim/turbulence.h"

#include <algorithm>
#include <cmath>

#include "odmc/sim/random_streams.h"

namespace odmc {
namespace {

const double kRoot3 = std::sqrt(3.0);

// ∫ e^(-2s) s^power ds from 0 to d, as a series: the closed form cancels at small d. d <= 0.5.
double Integral(double d, int power) {
  double sum = 0.0, term = std::pow(d, power + 1);
  for (int k = 0; k < 12; ++k) {
    sum += term / (power + 1 + k);
    term *= -2.0 * d / (k + 1);
  }
  return sum;
}

}  // namespace

Turbulence::Turbulence(double sigma_m_s, double length_m, int seed)
    : sigma_(sigma_m_s), length_(length_m), random_(seed, kTurbulenceStream) {
  along_ = random_.Next();
  // Steady covariance of a SecondOrder: [1/2 1/4; 1/4 1/4].
  for (SecondOrder* state : {&across_, &up_}) {
    const double a = random_.Next(), b = random_.Next();
    *state = {std::sqrt(0.5) * a, std::sqrt(0.125) * (a + b)};
  }
}

void Turbulence::Advance(double airspeed, double dt) {
  const double d = std::min(airspeed * dt / length_, 0.5);
  const double decay = std::exp(-d);
  along_ = decay * along_ + std::sqrt(-std::expm1(-2.0 * d)) * random_.Next();
  // Covariance of what the noise adds, and its square root.
  const double once = Integral(d, 0), both = Integral(d, 1), twice = Integral(d, 2);
  const double root = std::sqrt(once);
  const double rest = std::sqrt(std::max(0.0, twice - both * both / once));
  for (SecondOrder* state : {&across_, &up_}) {
    const double a = random_.Next(), b = random_.Next();
    state->twice = decay * (state->twice + d * state->once) + both / root * a + rest * b;
    state->once = decay * state->once + root * a;
  }
}

Eigen::Vector3d Turbulence::velocity() const {
  const auto output = [](const SecondOrder& s) {
    return kRoot3 * s.once + (1.0 - kRoot3) * s.twice;
  };
  return sigma_ * Eigen::Vector3d(along_, output(across_), output(up_));
}

}  // namespace odmc
