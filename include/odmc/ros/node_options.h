#pragma once

#include <ros/node_handle.h>

#include <string>

#include "odmc/io/options_yaml.h"
#include "odmc/ros/parameter_reader.h"

namespace odmc {

/// Reads a node's own options from its private parameters, and those of what it runs from the YAML
/// file that the former name in `file` and from parameters: these count over the file.
/// @throws std::invalid_argument for a value of another type, and for what is not known
template <typename NodeOptions, typename Options>
void ReadNodeOptions(const ros::NodeHandle& private_node, std::string NodeOptions::*file,
                     NodeOptions* node, Options* options) {
  ParameterReader reader(private_node);
  node->Visit(&reader);
  if (!(node->*file).empty()) LoadOptions(node->*file, options);
  options->Visit(&reader);
  reader.CheckAllRead();
}

}  // namespace odmc
