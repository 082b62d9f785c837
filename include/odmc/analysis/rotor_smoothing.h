#pragma once

#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// How rotor speeds move and are measured: z = Ω + noise, dΩ = a dt + white noise, da = white noise.
struct RotorSpeedNoise {
  double measurement_rad_s = 0.0;  ///< sigma of a sample
  double walk = 0.0;               ///< variance of Ω per second, over the measurement's [1/s]
  double trend = 0.0;              ///< variance of dΩ/dt per second, over the measurement's [1/s³]
};

/// The noise that makes samples most likely (all rotors alike), from their own innovations.
/// @param samples in the order of time; holes of more than 0.1 s cut them into runs
RotorSpeedNoise FitRotorSpeedNoise(const std::vector<RotorSample>& samples);

/// What the speeds were, given all samples: a Kalman smoother (Rauch, Tung, Striebel 1965) with the
/// noise fitted to them. A regression on measured speeds, or worse on their differences, comes out
/// too small by the share of noise in them (errors in variables); on expected speeds it is unbiased
/// (regression calibration: Carroll et al., Measurement Error in Nonlinear Models, ch. 4).
std::vector<RotorSample> SmoothRotorSpeeds(const std::vector<RotorSample>& samples);

}  // namespace odmc
