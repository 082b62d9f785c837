#include "odmc/text/finding.h"

#include <algorithm>

namespace odmc {

const char* Name(Trust trust) {
  switch (trust) {
    case Trust::kGood:
      return "good";
    case Trust::kDoubtful:
      return "doubtful";
    case Trust::kBad:
      return "bad";
  }
  return "";
}

std::string Sentence(const Finding& finding) {
  return finding.mend.empty() ? finding.what : finding.what + "; " + finding.mend;
}

Trust TrustOf(const std::vector<Finding>& findings) {
  Trust trust = Trust::kGood;
  for (const Finding& finding : findings) trust = std::max(trust, finding.leaves);
  return trust;
}

std::vector<std::string> TrustReasons(const std::vector<Finding>& findings) {
  std::vector<std::string> reasons;
  for (const Finding& finding : findings) {
    if (finding.leaves != Trust::kGood) reasons.push_back(Sentence(finding));
  }
  return reasons;
}

}  // namespace odmc
