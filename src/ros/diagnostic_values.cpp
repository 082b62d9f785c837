#include "odmc/ros/diagnostic_values.h"

#include <diagnostic_msgs/KeyValue.h>

#include <cstdio>

namespace odmc {

using diagnostic_msgs::DiagnosticStatus;

void PutValue(const std::string& key, const std::string& value, DiagnosticStatus* status) {
  diagnostic_msgs::KeyValue pair;
  pair.key = key;
  pair.value = value;
  status->values.push_back(pair);
}

void PutValue(const std::string& key, const char* value, DiagnosticStatus* status) {
  PutValue(key, std::string(value), status);
}

void PutValue(const std::string& key, double value, DiagnosticStatus* status) {
  char text[40];
  std::snprintf(text, sizeof text, "%.4g", value);
  PutValue(key, std::string(text), status);
}

void PutValue(const std::string& key, long value, DiagnosticStatus* status) {
  PutValue(key, std::to_string(value), status);
}

void PutValue(const std::string& key, bool value, DiagnosticStatus* status) {
  PutValue(key, std::string(value ? "true" : "false"), status);
}

std::string JoinSentences(const std::vector<std::string>& sentences) {
  std::string text;
  for (const std::string& sentence : sentences) text += (text.empty() ? "" : "; ") + sentence;
  return text;
}

}  // namespace odmc
