#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace odmc {

/// One line of a node's --help: a topic or service as the node names it, "~" before private ones.
struct NodeEntry {
  std::string name;
  std::vector<std::string> types;  ///< package/Type
  std::string remark;              ///< may be empty
};

/// A private parameter with its default.
struct NodeParameter {
  std::string key, value;
};

/// Visitor that lists the fields of an options struct.
class ParameterList {
 public:
  void Field(const std::string& key, const double* value);
  void Field(const std::string& key, const int* value);
  void Field(const std::string& key, const bool* value);
  void Field(const std::string& key, const std::string* value);
  void Field(const std::string& key, const std::vector<std::string>* value);
  void Field(const std::string& key, const std::vector<int>* value);
  void Field(const std::string& key, const Eigen::Vector3d* value);

  const std::vector<NodeParameter>& parameters() const { return parameters_; }

 private:
  std::vector<NodeParameter> parameters_;
};

/// The fields of default options, which have the Visit() that ParameterReader uses.
template <typename Options>
std::vector<NodeParameter> DefaultsOf() {
  ParameterList list;
  Options().Visit(&list);
  return list.parameters();
}

/// What a node prints with --help. scripts/site makes its page of this text, and
/// test/ros/node_help_test.py compares it with the running node.
struct NodeHelp {
  std::string name, purpose;
  std::vector<std::string> commands;
  std::vector<NodeEntry> subscribes, publishes, services;
  std::vector<NodeParameter> parameters;
  std::string config_parameter;       ///< the parameter that names a file
  std::string config_example;         ///< the file that documents its keys
  std::vector<NodeParameter> config;  ///< keys of the file, each a private parameter, too

  std::string Text() const;
};

}  // namespace odmc
