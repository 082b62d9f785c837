#pragma once

#include <string>
#include <utility>
#include <vector>

#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Drops samples that `is_finite` refuses, and those whose header carries no stamp.
template <typename Sample, typename Test>
void KeepFinite(const std::string& source, std::vector<Sample>* samples, Test is_finite,
                FlightLog* log) {
  RefusedSamples not_finite, no_stamp;
  std::vector<Sample> kept;
  kept.reserve(samples->size());
  for (const Sample& sample : *samples) {
    if (sample.stamp == 0) {
      no_stamp.Add("message " + std::to_string(&sample - samples->data()));
    } else if (!is_finite(sample)) {
      not_finite.Add("message " + std::to_string(&sample - samples->data()));
    } else {
      kept.push_back(sample);
    }
  }
  no_stamp.Report(source, "messages whose header has no stamp", log);
  not_finite.Report(source, "messages that are not finite", log);
  *samples = std::move(kept);
}

}  // namespace odmc
