#pragma once

#include <vector>

#include "odmc/inspection/motion_signals.h"
#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Are velocity, body rates, gyro and accelerometer what the pose's own derivatives are, and does
/// the attitude point the thrust where the vehicle accelerates? Streams that are wrong are named,
/// marked to be dropped in `inspection` and taken out of `signals`; an attitude that is wrong makes
/// a refusal.
void CheckMotion(const Vehicle& vehicle, const std::vector<bool>& flight, MotionSignals* signals,
                 StreamInspection* inspection);

}  // namespace odmc
