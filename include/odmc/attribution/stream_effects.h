#pragma once

#include "odmc/attribution/close_loop.h"
#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Adds what the streams of the recording say about each other, as AddInspection() of other results
/// does. An offset that is an effect of the catalogue (rotor speeds stamped wrongly: `rotor_delay`)
/// and was taken off the recording, with a finding, is named among the effects: the residual does
/// not show it any more. Its score is the offset's likelihood against that of right stamps, with
/// the usual size of an offset as prior; what attribution found of it beside that is added.
void AddInspection(const StreamInspection& inspection, ClosedLoop* loop);

}  // namespace odmc
