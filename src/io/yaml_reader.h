#pragma once

#include <yaml-cpp/yaml.h>

#include <Eigen/Core>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace odmc {

/// Name of `known` that a user who wrote `word` most likely meant; empty where none is close.
std::string ClosestName(const std::string& word, const std::vector<std::string>& known);

/// One value of a YAML file that knows where it stands. Every reader throws std::invalid_argument
/// "FILE: key.path: what is wrong".
class YamlValue {
 public:
  /// Root of a document, a map. `file` only names the source.
  static YamlValue Parse(const std::string& text, const std::string& file);

  const std::string& path() const { return path_; }
  [[noreturn]] void Fail(const std::string& what) const;

  /// A map's entries in the file's order; a key given twice is an error.
  std::vector<std::pair<std::string, YamlValue>> Entries() const;
  /// A list's items.
  std::vector<YamlValue> Items() const;

  /// Refuses keys other than `known`, naming the one that was probably meant.
  void AllowKeys(const std::vector<std::string>& known) const;
  bool Has(const std::string& key) const { return Find(key).has_value(); }
  std::optional<YamlValue> Find(const std::string& key) const;
  /// An error if the key is missing.
  YamlValue Get(const std::string& key) const;

  /// A finite number. Numbers in quotes count too: YAML 1.1 tools (rosparam, PyYAML) read 1e-6
  /// without a decimal point as text and write it back in quotes.
  double Number() const;
  double PositiveNumber() const;
  int Integer() const;
  bool Bool() const;
  std::string Text() const;
  /// Text that must be one of `words`.
  std::string OneOf(const std::vector<std::string>& words) const;
  std::vector<double> Numbers() const;
  Eigen::Vector3d Vector3() const;

 private:
  YamlValue(YAML::Node node, std::string file, std::string path)
      : node_(std::move(node)), file_(std::move(file)), path_(std::move(path)) {}
  const std::string& Scalar(const std::string& wanted) const;

  YAML::Node node_;
  std::string file_;
  std::string path_;
};

}  // namespace odmc
