#include "odmc/ros/sample_messages.h"

#include <limits>
#include <vector>

#include "odmc/ros/message_values.h"

namespace odmc {
namespace {

constexpr double kMissing = -1.0;  // as a first variance
constexpr char kBodyFrame[] = "base_link";

std::vector<double> ToVector(const RotorVector& v) { return {v.data(), v.data() + v.size()}; }

}  // namespace

nav_msgs::Odometry ToMessage(const OdometrySample& sample, const std::string& world_frame,
                             const std::string& sensor_frame) {
  nav_msgs::Odometry m;
  m.header = MakeHeader(sample.stamp, world_frame);
  m.child_frame_id = sensor_frame;
  m.pose.pose.position = ToPoint(sample.p_WS);
  m.pose.pose.orientation = ToQuaternion(sample.q_WS);
  if (sample.v_WS) {
    m.twist.twist.linear = ToVector3(sample.q_WS.conjugate() * *sample.v_WS);
  } else {
    m.twist.covariance[0] = kMissing;
  }
  if (sample.w_WS_S) {
    m.twist.twist.angular = ToVector3(*sample.w_WS_S);
  } else {
    m.twist.covariance[21] = kMissing;
  }
  return m;
}

sensor_msgs::Imu ToMessage(const ImuSample& sample, const std::string& imu_frame) {
  sensor_msgs::Imu m;
  m.header = MakeHeader(sample.stamp, imu_frame);
  m.orientation.w = 1.0;
  m.orientation_covariance[0] = kMissing;
  if (sample.gyro_I) {
    m.angular_velocity = ToVector3(*sample.gyro_I);
  } else {
    m.angular_velocity_covariance[0] = kMissing;
  }
  if (sample.specific_force_I) {
    m.linear_acceleration = ToVector3(*sample.specific_force_I);
  } else {
    m.linear_acceleration_covariance[0] = kMissing;
  }
  return m;
}

RotorSpeeds ToMessage(const RotorSample& sample, bool rms_only) {
  RotorSpeeds m;
  m.header = MakeHeader(sample.stamp, kBodyFrame);
  m.angular_velocity_rad_s = ToVector(sample.speed);
  m.rms_only = rms_only;
  return m;
}

MotorCommands ToMessage(const CommandSample& sample) {
  MotorCommands m;
  m.header = MakeHeader(sample.stamp, kBodyFrame);
  m.throttle = ToVector(sample.throttle);
  return m;
}

sensor_msgs::BatteryState ToMessage(const BatterySample& sample) {
  constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();
  sensor_msgs::BatteryState m;
  m.header = MakeHeader(sample.stamp, kBodyFrame);
  m.voltage = static_cast<float>(sample.voltage_V);
  m.current = m.charge = m.capacity = m.design_capacity = m.percentage = kUnknown;
  m.present = true;
  return m;
}

}  // namespace odmc
