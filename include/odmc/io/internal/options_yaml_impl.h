#pragma once

#include <Eigen/Core>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

namespace odmc {
namespace internal {

/// Visitor that fills fields from a YAML file. Hides yaml-cpp from the options' users.
class OptionsYamlReader {
 public:
  explicit OptionsYamlReader(const std::string& file);
  ~OptionsYamlReader();

  void Field(const std::string& key, double* value);
  void Field(const std::string& key, int* value);
  void Field(const std::string& key, bool* value);
  void Field(const std::string& key, std::string* value);
  void Field(const std::string& key, Eigen::Vector3d* value);

  /// Refuses keys that no Field() asked for, mostly typing mistakes.
  void CheckAllRead() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Visitor that prints fields, `key: value` a line, in YAML.
class OptionsYamlPrinter {
 public:
  void Field(const std::string& key, const double* value);
  void Field(const std::string& key, const int* value);
  void Field(const std::string& key, const bool* value);
  void Field(const std::string& key, const std::string* value);
  void Field(const std::string& key, const Eigen::Vector3d* value);

  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

/// True for options that have IsValid().
template <typename Options, typename = void>
struct CanJudgeItself : std::false_type {};
template <typename Options>
struct CanJudgeItself<Options, std::void_t<decltype(std::declval<const Options&>().IsValid(
                                   std::declval<std::string*>()))>> : std::true_type {};

}  // namespace internal

template <typename Options>
void LoadOptions(const std::string& file, Options* options) {
  internal::OptionsYamlReader reader(file);
  options->Visit(&reader);
  reader.CheckAllRead();
  if constexpr (internal::CanJudgeItself<Options>::value) {
    std::string error;
    if (!options->IsValid(&error)) throw std::invalid_argument(file + ": " + error);
  }
}

template <typename Options>
std::string FormatOptions(Options options) {
  internal::OptionsYamlPrinter printer;
  options.Visit(&printer);
  return printer.text();
}

}  // namespace odmc
