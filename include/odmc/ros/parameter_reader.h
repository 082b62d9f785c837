#pragma once

#include <XmlRpcValue.h>
#include <ros/node_handle.h>

#include <Eigen/Core>
#include <string>
#include <vector>

namespace odmc {

/// Visitor that fills the fields of an options struct from a node's private ROS parameters; keys
/// that are not set keep their value. Numbers may come as text: rosparam reads YAML 1.1, where
/// 1e-6 (without a point) is text, and roscpp would silently take the default.
class ParameterReader {
 public:
  /// @param node private handle, ros::NodeHandle("~")
  explicit ParameterReader(const ros::NodeHandle& node) : node_(node) {}

  /// Each throws std::invalid_argument with a sentence that names the parameter.
  void Field(const std::string& key, double* value);
  void Field(const std::string& key, int* value);
  void Field(const std::string& key, bool* value);
  void Field(const std::string& key, std::string* value);
  /// A list of text, or one text with commas between, in brackets or not.
  void Field(const std::string& key, std::vector<std::string>* value);
  /// A list of whole numbers, or one text with commas between, in brackets or not.
  void Field(const std::string& key, std::vector<int>* value);
  /// Three numbers: a list, or one text with commas between, in brackets or not.
  void Field(const std::string& key, Eigen::Vector3d* value);

  /// Refuses parameters in the node's own namespace that no Field() asked for, mostly typing
  /// mistakes.
  /// @throws std::invalid_argument
  void CheckAllRead() const;

 private:
  /// False for a parameter that is not set. Either way its key is known from now on.
  bool Get(const std::string& key, XmlRpc::XmlRpcValue* raw);
  [[noreturn]] void Fail(const std::string& key, const std::string& what) const;

  ros::NodeHandle node_;
  std::vector<std::string> known_;
};

}  // namespace odmc
