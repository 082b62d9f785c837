#pragma once

#include <ros/node_handle.h>
#include <ros/publisher.h>

#include <string>
#include <thread>

#include "odmc/ros/guarded.h"
#include "odmc/ros/input_queue.h"
#include "odmc/ros/live_image.h"
#include "odmc/ros/node_status.h"

namespace odmc {

/// What the estimator thread tells the others.
struct SharedStatus {
  NodeStatus status;
  LiveHistory history;
};

/// A thread that publishes diagnostics and the live image once in a while.
class NodeReporter {
 public:
  /// @param always_draw the image, also while nobody listens
  /// @param shared, queue outlive this; the queue tells when to stop
  NodeReporter(ros::NodeHandle node, std::string vehicle, bool always_draw,
               Guarded<SharedStatus>* shared, InputQueue* queue);
  ~NodeReporter() { Join(); }
  void Join();

 private:
  void Run();
  void PublishDiagnostics(const InputQueue::Look& now, const InputQueue::Look& before,
                          double seconds);
  void PublishLiveImage();

  const std::string vehicle_;
  const bool always_draw_;
  Guarded<SharedStatus>* const shared_;
  InputQueue* const queue_;
  ros::Publisher diagnostics_, image_;
  std::thread thread_;  // started last
};

}  // namespace odmc
