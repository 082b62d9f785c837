#pragma once

#include <ros/node_handle.h>

#include <functional>

#include "odmc/ros/node_help.h"

namespace odmc {

/// A node's whole life, called with its public and its private handle: makes the node and spins.
using NodeLife =
    std::function<void(const ros::NodeHandle& node, const ros::NodeHandle& private_node)>;

/// The main() of a node. With --help or -h prints `help` and starts nothing. What `life` throws is
/// logged as a fatal error, in its own words.
/// @param help  its name is the node's, unless the command line remaps it
/// @returns the exit status: 0, or 1 after an error
int RunNode(int argc, char** argv, const NodeHelp& help, const NodeLife& life);

}  // namespace odmc
