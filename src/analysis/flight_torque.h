#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/torque_spectra.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/phases/flight_phase.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Torque of the rotors' thrust and angular acceleration over a recorded flight.
struct FlightSpectra {
  TorqueSpectra spectra;
  TorqueSpectra::Noise noise;
};

/// @param ground_spans stamps that do not count
/// @param why gets why there are none
std::optional<FlightSpectra> SpectraOfFlight(const FlightLog& log, const DynamicModel& model,
                                             const ModelValues& values,
                                             const StampSpans& ground_spans, std::string* why);

}  // namespace odmc
