#include "odmc/control/low_pass.h"

#include <cmath>

namespace odmc {

LowPass::LowPass(double cutoff_hz) : cutoff_rad_s_(2.0 * M_PI * cutoff_hz) {}

void LowPass::Add(const Eigen::Vector3d& input, double dt) {
  if (!started_) {
    started_ = true;
    input_ = value_ = input;
    derivative_.setZero();
  }
  // Trapezoidal rule on (value, derivative), stable for every step:
  //   value' = value + h (derivative + derivative'),  h = dt / 2
  //   derivative' = derivative + h (a + a'),  a = wc² (u - value) - √2 wc derivative
  const double w = cutoff_rad_s_, h = 0.5 * dt;
  const Eigen::Vector3d a = w * w * (input_ - value_) - M_SQRT2 * w * derivative_;
  const Eigen::Vector3d middle = value_ + h * derivative_;
  const Eigen::Vector3d right = derivative_ + h * (a + w * w * (input - middle));
  const double left = 1.0 + h * M_SQRT2 * w + h * h * w * w;
  derivative_ = right / left;
  value_ = middle + h * derivative_;
  input_ = input;
}

}  // namespace odmc
