#include "odmc/ros/run_node.h"

#include <ros/console.h>
#include <ros/init.h>

#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>

#include "odmc/text/printable_text.h"

namespace odmc {

int RunNode(int argc, char** argv, const NodeHelp& help, const NodeLife& life) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--help") == 0 || std::strcmp(argv[i], "-h") == 0) {
      std::fputs(help.Text().c_str(), stdout);
      return 0;
    }
  }
  ros::init(argc, argv, help.name);
  // As SIGINT: services are stopped by it, and results must be saved.
  std::signal(SIGTERM, [](int) { ros::requestShutdown(); });
  // Outside of `try`: the last handle takes the log with it.
  const ros::NodeHandle node, private_node("~");
  try {
    life(node, private_node);
  } catch (const std::exception& e) {
    const std::string what = Printable(e.what());
    if (ros::ok()) {
      ROS_FATAL("%s", what.c_str());
    } else {
      std::fprintf(stderr, "%s: %s\n", help.name.c_str(), what.c_str());  // the log is gone
    }
    return 1;
  }
  return 0;
}

}  // namespace odmc
