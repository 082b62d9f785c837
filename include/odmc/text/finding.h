#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace odmc {

/// How far a result may be relied on. Only good results are handed to a controller.
enum class Trust { kGood, kDoubtful, kBad };

/// "good", "doubtful" or "bad".
const char* Name(Trust trust);

/// Something about a recording, a stream or an estimate that its user should know.
struct Finding {
  std::string check;            ///< what was looked at, in snake_case: "velocity_offset"
  Trust leaves = Trust::kGood;  ///< the trust that a result keeps beside it; kGood: a remark
  std::string what;             ///< one sentence, with its figures
  std::string mend = {};        ///< what would mend it, e.g. the line of a file; may be empty
  std::optional<std::pair<double, double>> span_s = {};  ///< when, after the first pose [s]
};

/// "WHAT; MEND".
std::string Sentence(const Finding& finding);

/// The least trust that the findings leave.
Trust TrustOf(const std::vector<Finding>& findings);

/// Sentences of the findings that leave no good trust.
std::vector<std::string> TrustReasons(const std::vector<Finding>& findings);

}  // namespace odmc
