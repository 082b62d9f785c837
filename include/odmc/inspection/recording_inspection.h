#pragma once

#include <string>

#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Everything that is looked at before anything is estimated, of a recording or of a node's buffer:
/// stamps (EvenOutStamps), streams against each other and the vehicle file (InspectStreams), then
/// rotor speeds against the motion (InspectRotors). The log is mended on the way.
/// @returns its `refusal` is the first thing that leaves no trust
StreamInspection InspectRecording(const Vehicle& vehicle, FlightLog* log);

/// The same for a program that somebody started.
/// @param force goes on where nothing sensible can be learned
/// @param option what sets it, as the refusal shall say: "--force"
/// @throws std::invalid_argument naming the file, the cause and what would mend it
StreamInspection InspectOrRefuse(const Vehicle& vehicle, bool force, const std::string& option,
                                 FlightLog* log);

}  // namespace odmc
