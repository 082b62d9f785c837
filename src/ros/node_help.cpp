#include "odmc/ros/node_help.h"

#include <sstream>

#include "odmc/text/number_text.h"

namespace odmc {
namespace {

constexpr size_t kWidth = 100;
constexpr size_t kColumn = 34;  // where types and defaults begin

template <typename Items, typename TextOf>
std::string ListText(const Items& items, const TextOf& text_of) {
  std::string text;
  for (const auto& item : items) text += (text.empty() ? "" : ", ") + text_of(item);
  return text;
}

std::string Padded(const std::string& name) {
  std::string line = "  " + name;
  line.append(line.size() + 2 < kColumn ? kColumn - line.size() : 2, ' ');
  return line;
}

/// Words from the column on, broken before the width.
std::string Wrapped(std::string line, const std::string& text) {
  std::string done;
  std::istringstream words(text);
  bool begins = true;
  for (std::string word; words >> word; begins = false) {
    if (!begins && line.size() + 1 + word.size() > kWidth) {
      done += line + "\n";
      line.assign(kColumn, ' ');
      begins = true;
    }
    line += (begins ? "" : " ") + word;
  }
  return done + line + "\n";
}

std::string EntriesText(const std::string& title, const std::vector<NodeEntry>& entries) {
  std::string text = "\n" + title + ":\n";
  for (const NodeEntry& entry : entries) {
    const std::string types = ListText(entry.types, [](const std::string& type) { return type; });
    const std::string remark = entry.remark.empty() ? "" : "; " + entry.remark;
    text += Wrapped(Padded(entry.name), types + remark);
  }
  return text;
}

std::string ParametersText(const std::string& title, const std::vector<NodeParameter>& list) {
  std::string text = "\n" + title + ":\n";
  for (const NodeParameter& p : list) text += Padded(p.key) + p.value + "\n";
  return text;
}

}  // namespace

void ParameterList::Field(const std::string& key, const double* value) {
  parameters_.push_back({key, FormatNumber(*value)});
}

void ParameterList::Field(const std::string& key, const int* value) {
  parameters_.push_back({key, std::to_string(*value)});
}

void ParameterList::Field(const std::string& key, const bool* value) {
  parameters_.push_back({key, *value ? "true" : "false"});
}

void ParameterList::Field(const std::string& key, const std::string* value) {
  parameters_.push_back({key, value->empty() ? "''" : *value});
}

void ParameterList::Field(const std::string& key, const std::vector<std::string>* value) {
  const std::string items = ListText(*value, [](const std::string& item) { return item; });
  parameters_.push_back({key, "[" + items + "]"});
}

void ParameterList::Field(const std::string& key, const std::vector<int>* value) {
  const std::string items = ListText(*value, [](int item) { return std::to_string(item); });
  parameters_.push_back({key, "[" + items + "]"});
}

void ParameterList::Field(const std::string& key, const Eigen::Vector3d* value) {
  const std::vector<double> numbers(value->data(), value->data() + value->size());
  parameters_.push_back({key, "[" + ListText(numbers, FormatNumber) + "]"});
}

std::string NodeHelp::Text() const {
  std::string text = name + ": " + purpose + "\n\n";
  for (const std::string& command : commands) text += "  " + command + "\n";
  text += EntriesText("Subscribes", subscribes) + EntriesText("Publishes", publishes) +
          EntriesText("Services", services);
  text += ParametersText("Parameters, private (_KEY:=VALUE), with defaults", parameters);
  text += ParametersText("Parameters that may also stand in the file `" + config_parameter +
                             "`, with defaults (" + config_example + " documents them)",
                         config);
  return text;
}

}  // namespace odmc
