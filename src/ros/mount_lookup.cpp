#include "odmc/ros/mount_lookup.h"

#include <geometry_msgs/TransformStamped.h>

namespace odmc {
namespace {

constexpr std::chrono::seconds kPatience(2);

}  // namespace

bool MountLookup::Complete(const std::optional<std::string>& odometry,
                           const std::optional<std::string>& imu,
                           const std::function<void(const std::string&)>& warn, Vehicle* vehicle) {
  const Clock::time_point now = Clock::now();
  if (!waiting_since_) waiting_since_ = now;
  const bool patient = now - *waiting_since_ < kPatience;
  std::optional<SensorMount> of_odometry, of_imu;
  if (odometry) of_odometry = Ask(*odometry);
  if (imu) of_imu = Ask(*imu);
  if (patient && ((odometry && !of_odometry) || (imu && !of_imu))) return false;
  const auto unknown = [&](const std::string& frame) {
    return "tf has no transform from " + body_frame_ + " to " + frame +
           " and the vehicle file says nothing: took ";
  };
  if (of_odometry) {
    of_odometry->estimate = vehicle->odometry.estimate;
    vehicle->odometry = *of_odometry;
  } else if (odometry) {
    warn(unknown(*odometry) + "the odometry's pose for the body's");
  }
  if (of_imu) {
    vehicle->imu = of_imu;
  } else if (imu) {
    warn(unknown(*imu) + "the IMU to be along the body at its origin");
  }
  return true;
}

std::optional<SensorMount> MountLookup::Ask(const std::string& sensor_frame) const {
  SensorMount mount;
  if (sensor_frame == body_frame_ || sensor_frame.empty()) return mount;
  try {
    const geometry_msgs::TransformStamped m =
        buffer_.lookupTransform(body_frame_, sensor_frame, ros::Time(0));
    const auto& p = m.transform.translation;
    const auto& q = m.transform.rotation;
    mount.p_BS = Eigen::Vector3d(p.x, p.y, p.z);
    mount.q_BS = Eigen::Quaterniond(q.w, q.x, q.y, q.z).normalized();
    return mount;
  } catch (const tf2::TransformException&) {
    return std::nullopt;
  }
}

}  // namespace odmc
