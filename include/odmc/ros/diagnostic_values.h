#pragma once

#include <diagnostic_msgs/DiagnosticStatus.h>

#include <string>
#include <vector>

namespace odmc {

/// Each appends a key with its value in text to a diagnostic; numbers with four digits.
void PutValue(const std::string& key, const std::string& value,
              diagnostic_msgs::DiagnosticStatus* status);
void PutValue(const std::string& key, const char* value, diagnostic_msgs::DiagnosticStatus* status);
void PutValue(const std::string& key, double value, diagnostic_msgs::DiagnosticStatus* status);
void PutValue(const std::string& key, long value, diagnostic_msgs::DiagnosticStatus* status);
void PutValue(const std::string& key, bool value, diagnostic_msgs::DiagnosticStatus* status);

/// "first; second".
std::string JoinSentences(const std::vector<std::string>& sentences);

}  // namespace odmc
