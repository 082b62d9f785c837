#pragma once

#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>

#include <chrono>
#include <functional>
#include <optional>
#include <string>

#include "odmc/model/vehicle.h"

namespace odmc {

/// Asks tf where sensors sit about which the vehicle file says nothing.
class MountLookup {
 public:
  explicit MountLookup(std::string body_frame) : body_frame_(std::move(body_frame)) {}

  /// Completes the vehicle's mounts. @param odometry, imu frames that tf is to be asked for; empty:
  ///   not. A mount that tf does not know after two seconds is taken to be at the body's origin,
  ///   and `warn` told.
  /// @returns false as long as it is worth waiting
  bool Complete(const std::optional<std::string>& odometry, const std::optional<std::string>& imu,
                const std::function<void(const std::string&)>& warn, Vehicle* vehicle);

  const tf2_ros::Buffer& buffer() const { return buffer_; }

 private:
  using Clock = std::chrono::steady_clock;
  std::optional<SensorMount> Ask(const std::string& sensor_frame) const;

  const std::string body_frame_;
  tf2_ros::Buffer buffer_;
  tf2_ros::TransformListener listener_{buffer_};
  std::optional<Clock::time_point> waiting_since_;
};

}  // namespace odmc
