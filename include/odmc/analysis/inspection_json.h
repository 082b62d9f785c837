#pragma once

#include <nlohmann/json_fwd.hpp>
#include <vector>

#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Findings as report.json has them: check, leaves, what, mend, from_s, to_s.
nlohmann::ordered_json FindingsJson(const std::vector<Finding>& findings);

/// By stream: value_s, sigma_s, against, compensated. Null where the flight does not show them.
nlohmann::ordered_json TimeOffsetsJson(const std::vector<TimeOffset>& offsets);

}  // namespace odmc
