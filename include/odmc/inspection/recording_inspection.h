#pragma once

#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Everything that is looked at before anything is estimated, of a recording or of a node's buffer:
/// stamps (EvenOutStamps), streams against each other and the vehicle file (InspectStreams), then
/// rotor speeds against the motion (InspectRotors). The log is mended on the way.
/// @returns its `refusal` is the first thing that leaves no trust
StreamInspection InspectRecording(const Vehicle& vehicle, FlightLog* log);

}  // namespace odmc
