#include "odmc/ros/parameter_reader.h"

#include <XmlRpcValue.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <sstream>
#include <stdexcept>

#include "odmc/text/number_text.h"

namespace odmc {
namespace {

using XmlRpc::XmlRpcValue;

constexpr double kMostInList = 1e6;

/// A number however it is spelled; text counts if all of it is a number.
std::optional<double> NumberOf(XmlRpcValue value) {
  switch (value.getType()) {
    case XmlRpcValue::TypeDouble:
      return static_cast<double>(value);
    case XmlRpcValue::TypeInt:
      return static_cast<int>(value);
    case XmlRpcValue::TypeString: {
      double number = 0.0;
      if (ParseNumber(static_cast<std::string>(value), &number)) return number;
      return std::nullopt;
    }
    default:
      return std::nullopt;
  }
}

std::string AsGiven(const XmlRpcValue& value) {
  return value.getType() == XmlRpcValue::TypeString ? "'" + std::string(value) + "'"
                                                    : value.toXml();
}

/// Of a value up to `most` either way.
std::optional<int> WholeNumberOf(const XmlRpcValue& value, double most) {
  const std::optional<double> number = NumberOf(value);
  if (!number || std::floor(*number) != *number || std::abs(*number) > most) return std::nullopt;
  return static_cast<int>(*number);
}

/// A text "[a, b]" or "a, b" as the list it means, anything else as it is: a node's own command
/// line hands lists over as text.
XmlRpcValue AsList(const XmlRpcValue& value) {
  if (value.getType() != XmlRpcValue::TypeString) return value;
  XmlRpcValue list;
  list.setSize(0);
  std::istringstream stream{std::string(value)};
  for (std::string item; std::getline(stream, item, ',');) {
    const size_t first = item.find_first_not_of(" [");
    const size_t last = item.find_last_not_of(" ]");
    if (first == std::string::npos || last == std::string::npos || last < first) continue;
    list[list.size()] = item.substr(first, last - first + 1);
  }
  return list;
}

}  // namespace

void ParameterReader::Fail(const std::string& key, const std::string& what) const {
  throw std::invalid_argument("parameter " + node_.resolveName(key) + " " + what);
}

bool ParameterReader::Get(const std::string& key, XmlRpcValue* raw) {
  known_.push_back(key);
  return node_.getParam(key, *raw);
}

void ParameterReader::Field(const std::string& key, double* value) {
  XmlRpcValue raw;
  if (!Get(key, &raw)) return;
  const std::optional<double> number = NumberOf(raw);
  if (!number || !std::isfinite(*number)) Fail(key, "must be a number, not " + AsGiven(raw));
  *value = *number;
}

void ParameterReader::Field(const std::string& key, int* value) {
  XmlRpcValue raw;
  if (!Get(key, &raw)) return;
  const std::optional<int> number = WholeNumberOf(raw, std::numeric_limits<int>::max());
  if (!number) Fail(key, "must be a whole number, not " + AsGiven(raw));
  *value = *number;
}

void ParameterReader::Field(const std::string& key, bool* value) {
  XmlRpcValue raw;
  if (!Get(key, &raw)) return;
  if (raw.getType() == XmlRpcValue::TypeBoolean) {
    *value = static_cast<bool>(raw);
  } else if (raw.getType() == XmlRpcValue::TypeString &&
             (std::string(raw) == "true" || std::string(raw) == "false")) {
    *value = std::string(raw) == "true";
  } else {
    Fail(key, "must be true or false, not " + AsGiven(raw));
  }
}

void ParameterReader::Field(const std::string& key, std::string* value) {
  XmlRpcValue raw;
  if (!Get(key, &raw)) return;
  if (raw.getType() != XmlRpcValue::TypeString) Fail(key, "must be text, not " + AsGiven(raw));
  *value = std::string(raw);
}

void ParameterReader::Field(const std::string& key, std::vector<std::string>* value) {
  XmlRpcValue raw;
  if (!Get(key, &raw)) return;
  raw = AsList(raw);
  value->clear();
  if (raw.getType() != XmlRpcValue::TypeArray) Fail(key, "must be a list, not " + AsGiven(raw));
  for (int i = 0; i < raw.size(); ++i) {
    if (raw[i].getType() != XmlRpcValue::TypeString) {
      Fail(key, "must be a list of text, not " + AsGiven(raw));
    }
    value->push_back(std::string(raw[i]));
  }
}

void ParameterReader::Field(const std::string& key, std::vector<int>* value) {
  XmlRpcValue raw;
  if (!Get(key, &raw)) return;
  raw = AsList(raw);
  if (raw.getType() != XmlRpcValue::TypeArray) {
    Fail(key, "must be a list of whole numbers, not " + AsGiven(raw));
  }
  value->clear();
  for (int i = 0; i < raw.size(); ++i) {
    const std::optional<int> number = WholeNumberOf(raw[i], kMostInList);
    if (!number) Fail(key, "must be a list of whole numbers, not " + AsGiven(raw[i]));
    value->push_back(*number);
  }
}

void ParameterReader::Field(const std::string& key, Eigen::Vector3d* value) {
  XmlRpcValue raw;
  if (!Get(key, &raw)) return;
  raw = AsList(raw);
  if (raw.getType() != XmlRpcValue::TypeArray || raw.size() != 3) {
    Fail(key, "must be a list of three numbers");
  }
  for (int i = 0; i < 3; ++i) {
    const std::optional<double> number = NumberOf(raw[i]);
    if (!number || !std::isfinite(*number)) Fail(key, "must hold numbers, not " + AsGiven(raw[i]));
    (*value)[i] = *number;
  }
}

void ParameterReader::CheckAllRead() const {
  std::vector<std::string> names;
  if (!node_.getParamNames(names)) return;
  const std::string own = node_.getNamespace() + "/";
  for (const std::string& name : names) {
    if (name.compare(0, own.size(), own) != 0) continue;
    std::string key = name.substr(own.size());
    key = key.substr(0, key.find('/'));
    if (std::find(known_.begin(), known_.end(), key) != known_.end()) continue;
    std::string list;
    for (const std::string& known : known_) list += (list.empty() ? "" : ", ") + known;
    Fail(key, "is not known, a typing mistake? Known are: " + list);
  }
}

}  // namespace odmc
