#pragma once

#include <functional>
#include <optional>

#include "odmc/attribution/close_loop.h"
#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Adds what the streams of the recording say about each other, as AddInspection() of other results
/// does. An offset that is an effect of the catalogue (rotor speeds stamped wrongly: `rotor_delay`)
/// and was taken off the recording, with a finding, is named among the effects: the residual does
/// not show it any more. Its score is the offset's likelihood against that of right stamps, with
/// the usual size of an offset as prior; what attribution found of it beside that is added. It is
/// held to what holds for other effects: the rate of false alarms, their number, what is ruled out,
/// and what is ordinary (IsOrdinary()), of which a warning is all.
/// A warning says where samples are so far apart that what lies between may be what was found.
/// @param options, vehicle as given to CloseLoop()
void AddInspection(const StreamInspection& inspection, const CloseLoopOptions& options,
                   const Vehicle& vehicle, ClosedLoop* loop);

/// True if inspection shifted a stream's stamps, with a finding, and an effect that the loop named
/// shifts them to where they were: the model as a whole finds no offset, within three of its
/// sigmas, or one that any recording has (IsOrdinary()).
bool TakesBack(const ClosedLoop& loop, const StreamInspection& inspection, const Vehicle& vehicle);

/// Puts such stamps back.
/// @param inspection afterwards without what it said of these stamps; what the model leaves open of
///   them is a doubt
/// @returns a sentence for each, or nothing
std::string PutBack(const ClosedLoop& loop, const Vehicle& vehicle, StreamInspection* inspection,
                    FlightLog* log);

/// CloseLoop() on a flight whose streams were compared: what may be wrong with them counts in the
/// sigmas (SI units, frames of the vehicle file), what was found in findings and effects. Where
/// TakesBack() says so, the flight is looked at again with these stamps as they were.
/// @param log mended by the inspection
/// @param options without doubts: those are the inspection's
/// @param start what the vehicle's values were taken from: a warning where that is another mass's
/// @throws std::invalid_argument as CloseLoop()
ClosedLoop CloseLoopInspected(const FlightLog& log, const StreamInspection& inspection,
                              const Vehicle& file_vehicle, const Vehicle& vehicle,
                              CloseLoopOptions options,
                              const std::optional<ParameterSet>& start = std::nullopt,
                              const std::function<void(double)>& progress = {});

}  // namespace odmc
