#pragma once

#include <string>

#include "odmc/attribution/close_loop.h"

namespace odmc {

/// report.json of close_loop.
/// @param vehicle whose loop it is, with whatever effects
std::string CloseLoopReport(const ClosedLoop& loop, const Vehicle& vehicle);

/// The same in short, for a terminal.
std::string CloseLoopTable(const ClosedLoop& loop);

/// t_s, held_out, speed_m_s and the residual before and after, [N] and [N m].
/// @throws std::runtime_error if the file cannot be written
void WriteLoopSamples(const ClosedLoop& loop, const std::string& file);

}  // namespace odmc
