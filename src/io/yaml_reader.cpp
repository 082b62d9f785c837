#include "yaml_reader.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

/// Number of letters to insert, delete or replace to get from `a` to `b` (Levenshtein).
size_t EditDistance(const std::string& a, const std::string& b) {
  std::vector<size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), size_t{0});
  for (size_t i = 1; i <= a.size(); ++i) {
    size_t diagonal = row[0];
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t replace = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({replace, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row.back();
}

/// "mass" of "mass_kg": what a key is about, before its unit.
std::string Subject(const std::string& key) { return key.substr(0, key.find('_')); }

}  // namespace

std::string ClosestName(const std::string& word, const std::vector<std::string>& known) {
  std::string best;
  size_t best_distance = std::max<size_t>(2, word.size() / 4) + 1;
  for (const std::string& name : known) {
    const size_t distance = EditDistance(word, name);
    if (distance < best_distance) {
      best_distance = distance;
      best = name;
    }
  }
  if (!best.empty()) return best;
  // Another unit can be far away in letters: inertia_g_cm2 and inertia_kg_m2.
  for (const std::string& name : known) {
    if (Subject(name) == Subject(word)) return name;
  }
  return "";
}

YamlValue YamlValue::Parse(const std::string& text, const std::string& file) {
  try {
    YamlValue root(YAML::Load(text), file, "");
    if (root.node_.IsNull()) root.Fail("is empty");
    if (!root.node_.IsMap()) root.Fail("must hold keys and values");
    return root;
  } catch (const YAML::Exception& e) {
    RefuseFile(file,
               "line " + std::to_string(e.mark.line + 1) + ": is not YAML: " + Printable(e.msg));
  }
}

void YamlValue::Fail(const std::string& what) const {
  RefuseFile(file_, Printable((path_.empty() ? "" : path_ + ": ") + what));
}

std::vector<std::pair<std::string, YamlValue>> YamlValue::Entries() const {
  if (!node_.IsMap()) Fail("must be a map of keys and values");
  std::vector<std::pair<std::string, YamlValue>> entries;
  std::set<std::string> seen;
  for (const auto& entry : node_) {
    if (!entry.first.IsScalar()) Fail("has a key that is not a word");
    const std::string& key = entry.first.Scalar();
    entries.push_back(
        {key, YamlValue(entry.second, file_, path_.empty() ? key : path_ + "." + key)});
    // yaml-cpp keeps both and quietly hands out the first.
    if (!seen.insert(key).second) entries.back().second.Fail("this key is given twice");
  }
  return entries;
}

std::vector<YamlValue> YamlValue::Items() const {
  if (!node_.IsSequence()) Fail("must be a list, as [a, b]");
  std::vector<YamlValue> items;
  for (const auto& item : node_) {
    items.push_back(YamlValue(item, file_, path_ + "[" + std::to_string(items.size()) + "]"));
  }
  return items;
}

void YamlValue::AllowKeys(const std::vector<std::string>& known) const {
  for (const auto& [key, value] : Entries()) {
    if (std::find(known.begin(), known.end(), key) != known.end()) continue;
    const std::string closest = ClosestName(key, known);
    value.Fail("unknown key '" + key + "'; " +
               (closest.empty() ? "known are: " + Listed(known) : "did you mean " + closest + "?"));
  }
}

std::optional<YamlValue> YamlValue::Find(const std::string& key) const {
  for (const auto& [name, value] : Entries()) {
    if (name == key) return value;
  }
  return std::nullopt;
}

YamlValue YamlValue::Get(const std::string& key) const {
  const std::optional<YamlValue> value = Find(key);
  if (!value) YamlValue(node_, file_, path_.empty() ? key : path_ + "." + key).Fail("is missing");
  return *value;
}

const std::string& YamlValue::Scalar(const std::string& wanted) const {
  if (node_.IsNull()) Fail("has no value; must be " + wanted);
  if (!node_.IsScalar()) Fail("must be " + wanted + ", not a list or map");
  return node_.Scalar();
}

double YamlValue::Number() const {
  const std::string& text = Scalar("a number");
  double value = 0.0;
  static const std::set<std::string> kNotFinite = {".nan",  ".NaN",  ".NAN",  ".inf",
                                                   ".Inf",  ".INF",  "+.inf", "-.inf",
                                                   "+.Inf", "-.Inf", "+.INF", "-.INF"};
  const bool readable = ParseNumber(text, &value);
  if (kNotFinite.count(text) > 0 || (readable && !std::isfinite(value))) {
    Fail("must be a finite number, not " + text);
  }
  if (!readable) Fail("must be a number, not '" + text + "'");
  return value;
}

double YamlValue::PositiveNumber() const {
  const double value = Number();
  if (!(value > 0.0)) Fail("must be positive, not " + FormatNumber(value));
  return value;
}

int YamlValue::Integer() const {
  const double value = Number();
  if (value != std::floor(value) || std::abs(value) > 1e9) {
    Fail("must be a whole number, not " + FormatNumber(value));
  }
  return static_cast<int>(value);
}

bool YamlValue::Bool() const {
  const std::string& text = Scalar("true or false");
  bool value = false;
  if (!YAML::convert<bool>::decode(node_, value)) Fail("must be true or false, not '" + text + "'");
  return value;
}

std::string YamlValue::Text() const { return Scalar("text"); }

std::string YamlValue::OneOf(const std::vector<std::string>& words) const {
  const std::string text = Scalar("one of " + Listed(words));
  if (std::find(words.begin(), words.end(), text) == words.end()) {
    Fail("must be one of " + Listed(words) + ", not '" + text + "'");
  }
  return text;
}

std::vector<double> YamlValue::Numbers() const {
  std::vector<double> numbers;
  for (const YamlValue& item : Items()) numbers.push_back(item.Number());
  return numbers;
}

Eigen::Vector3d YamlValue::Vector3() const {
  const std::vector<double> numbers = Numbers();
  if (numbers.size() != 3) {
    Fail("must be three numbers [x, y, z], not " + std::to_string(numbers.size()));
  }
  return Eigen::Vector3d(numbers[0], numbers[1], numbers[2]);
}

}  // namespace odmc
