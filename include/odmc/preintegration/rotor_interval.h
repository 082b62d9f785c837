#pragma once

#include <optional>

#include "odmc/math/ring.h"
#include "odmc/model/flight_state.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Rotor speeds of one interval, reduced once when its factor is built.            model.md section
/// 4
struct RotorInterval {
  RotorState mean;          ///< means over the interval, trapezoid rule with interpolated ends
  RotorState start;         ///< values at its start (Form E)
  int num_samples = 0;      ///< raw samples inside, at least 1
  RotorVector model_sigma;  ///< largest of the samples' (n×1, 0: from the sensor) [rad/s]
};

/// Reduces raw samples to [from, to]: averages the square, not the speed. Empty if the samples do
/// not cover the interval or leave a hole longer than `max_hole_s` in it.
std::optional<RotorInterval> ReduceRotors(const Ring<RotorSample>& samples, Stamp from, Stamp to,
                                          double max_hole_s);

}  // namespace odmc
