#include "odmc/ros/conversions.h"

#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace odmc {
namespace {

constexpr Stamp kSecond = 1000000000;
constexpr double kMissing = -1.0;  // as a first variance

Eigen::Vector3d ToEigen(const geometry_msgs::Vector3& v) { return {v.x, v.y, v.z}; }
Eigen::Vector3d ToEigen(const geometry_msgs::Point& p) { return {p.x, p.y, p.z}; }

geometry_msgs::Vector3 ToVector3(const Eigen::Vector3d& v) {
  geometry_msgs::Vector3 m;
  m.x = v.x();
  m.y = v.y();
  m.z = v.z();
  return m;
}

geometry_msgs::Quaternion ToQuaternion(const Eigen::Quaterniond& q) {
  geometry_msgs::Quaternion m;
  m.x = q.x();
  m.y = q.y();
  m.z = q.z();
  m.w = q.w();
  return m;
}

std_msgs::Header MakeHeader(Stamp stamp, const std::string& frame) {
  std_msgs::Header header;
  header.stamp = ToRos(stamp);
  header.frame_id = frame;
  return header;
}

/// Pose with its stamp; nothing if it is not sound.
std::optional<OdometryInput> PoseInput(const std_msgs::Header& header,
                                       const geometry_msgs::Pose& pose) {
  OdometryInput input;
  input.sample.stamp = FromRos(header.stamp);
  input.sample.p_WS = ToEigen(pose.position);
  const geometry_msgs::Quaternion& q = pose.orientation;
  input.sample.q_WS = Eigen::Quaterniond(q.w, q.x, q.y, q.z);
  input.frame_id = header.frame_id;
  const double norm = input.sample.q_WS.norm();
  const bool is_unit = std::abs(norm - 1.0) < 0.05;  // false for NaN, too
  if (input.sample.stamp <= 0 || !input.sample.p_WS.allFinite() || !is_unit) return std::nullopt;
  input.sample.q_WS.normalize();
  return input;
}

/// The message has single precision; its shortest decimals give back what was measured.
double FromFloat(float value) {
  std::array<char, 32> text;
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
  double result = value;
  std::from_chars(text.data(), end, result);
  return result;
}

std::optional<RotorInput> SpeedInput(const std_msgs::Header& header,
                                     const std::vector<double>& speeds, int num_rotors,
                                     double scale) {
  if (static_cast<int>(speeds.size()) != num_rotors) return std::nullopt;
  RotorInput input;
  input.sample.stamp = FromRos(header.stamp);
  input.sample.speed =
      scale * Eigen::Map<const Eigen::VectorXd>(speeds.data(), num_rotors).cwiseAbs();
  if (input.sample.stamp <= 0 || !input.sample.speed.allFinite()) return std::nullopt;
  return input;
}

DynamicParameter ToMessage(const ParameterEstimate& p) {
  DynamicParameter m;
  m.name = p.full_name;
  m.value = p.value;
  m.sigma = p.sigma;
  m.unit = p.unit;
  m.state = p.estimated ? DynamicParameter::ESTIMATED : DynamicParameter::FROZEN;
  m.observable = p.observable;
  return m;
}

}  // namespace

Stamp FromRos(const ros::Time& time) {
  return static_cast<Stamp>(time.sec) * kSecond + static_cast<Stamp>(time.nsec);
}

ros::Time ToRos(Stamp stamp) {
  if (stamp < 0 || stamp / kSecond > std::numeric_limits<std::uint32_t>::max()) {
    throw std::invalid_argument("a stamp of " + std::to_string(ToSeconds(stamp)) +
                                " s does not fit a ROS message");
  }
  return ros::Time(static_cast<std::uint32_t>(stamp / kSecond),
                   static_cast<std::uint32_t>(stamp % kSecond));
}

// ---- Messages to samples -----------------------------------------------------------------------

std::optional<OdometryInput> ToInput(const nav_msgs::Odometry& message) {
  std::optional<OdometryInput> input = PoseInput(message.header, message.pose.pose);
  if (!input) return std::nullopt;
  input->child_frame_id = message.child_frame_id;
  if (message.twist.covariance[0] != kMissing) input->linear = ToEigen(message.twist.twist.linear);
  if (message.twist.covariance[21] != kMissing) {
    input->sample.w_WS_S = ToEigen(message.twist.twist.angular);
  }
  if (input->linear && !input->linear->allFinite()) return std::nullopt;
  if (input->sample.w_WS_S && !input->sample.w_WS_S->allFinite()) return std::nullopt;
  return input;
}

std::optional<OdometryInput> ToInput(const geometry_msgs::PoseStamped& message) {
  std::optional<OdometryInput> input = PoseInput(message.header, message.pose);
  if (input) input->is_pose = true;
  return input;
}

std::optional<ImuInput> ToInput(const sensor_msgs::Imu& message) {
  ImuInput input;
  input.sample.stamp = FromRos(message.header.stamp);
  input.frame_id = message.header.frame_id;
  if (message.angular_velocity_covariance[0] != kMissing) {
    input.sample.gyro_I = ToEigen(message.angular_velocity);
    if (!input.sample.gyro_I->allFinite()) return std::nullopt;
  }
  if (message.linear_acceleration_covariance[0] != kMissing) {
    input.sample.specific_force_I = ToEigen(message.linear_acceleration);
    if (!input.sample.specific_force_I->allFinite()) return std::nullopt;
  }
  const bool has_any = input.sample.gyro_I || input.sample.specific_force_I;
  if (input.sample.stamp <= 0 || !has_any) return std::nullopt;
  return input;
}

std::optional<BatterySample> ToInput(const sensor_msgs::BatteryState& message) {
  const BatterySample sample{FromRos(message.header.stamp), FromFloat(message.voltage)};
  if (sample.stamp <= 0 || !std::isfinite(sample.voltage_V)) return std::nullopt;
  return sample;
}

std::optional<RotorInput> ToInput(const RotorSpeeds& message, int num_rotors) {
  std::optional<RotorInput> input =
      SpeedInput(message.header, message.angular_velocity_rad_s, num_rotors, 1.0);
  if (input) input->rms_only = message.rms_only;
  return input;
}

std::optional<RotorInput> ToInput(const sensor_msgs::JointState& message, int num_rotors,
                                  double scale) {
  std::optional<RotorInput> input = SpeedInput(message.header, message.velocity, num_rotors, scale);
  if (input) input->from_joints = true;
  return input;
}

double RotorSpeedScale(const std::string& unit, int pole_pairs) {
  const double rpm = M_PI / 30.0;
  if (unit == "rad_s") return 1.0;
  if (unit == "rpm") return rpm;
  if (unit != "erpm") {
    throw std::invalid_argument("rotor_speed_unit must be rad_s, rpm or erpm, not '" + unit + "'");
  }
  if (pole_pairs < 1) {
    throw std::invalid_argument("pole_pairs must be at least 1, not " + std::to_string(pole_pairs));
  }
  return rpm / pole_pairs;
}

// ---- Snapshots to messages ---------------------------------------------------------------------

bool IsFinite(const Snapshot& s) {
  return s.values.allFinite() && s.sigma.allFinite() && s.covariance.allFinite() &&
         s.state.p_WS.allFinite() && s.state.q_WS.coeffs().allFinite() &&
         s.state.v_WS.allFinite() && s.state.w_WS_S.allFinite() && s.body.p_BS.allFinite() &&
         s.body.R_BS.allFinite() && s.body.p_BI.allFinite() && s.body.R_BI.allFinite() &&
         s.residual_force_B.allFinite() && s.residual_torque_B.allFinite() &&
         std::isfinite(s.residual_force_rms_N) && std::isfinite(s.residual_torque_rms_Nm) &&
         std::isfinite(s.battery_voltage_V);
}

DynamicParameters ToMessage(const DynamicModel& model, const Snapshot& snapshot,
                            const std::string& body_frame) {
  DynamicParameters m;
  m.header = MakeHeader(snapshot.stamp, body_frame);
  m.vehicle = model.vehicle().name;
  const ParameterSet set = Estimator::ToParameterSet(model, snapshot);
  m.effects = set.effects;
  for (const ParameterEstimate& p : set.parameters) m.parameters.push_back(ToMessage(p));
  // Symmetric, so the order of storage does not matter.
  m.covariance.assign(snapshot.covariance.data(),
                      snapshot.covariance.data() + snapshot.covariance.size());
  m.unobservable = snapshot.unobservable;
  m.airborne = snapshot.airborne;
  m.residual_force_N = snapshot.residual_force_rms_N;
  m.residual_torque_Nm = snapshot.residual_torque_rms_Nm;
  m.battery_voltage_V = snapshot.battery_voltage_V;
  m.states_in_window = static_cast<std::uint32_t>(snapshot.timing.states);
  m.update_ms = snapshot.timing.wall_ms;
  return m;
}

UnexplainedResidual ToMessage(const ResidualLook& look, const std::string& body_frame,
                              const std::vector<std::string>& added) {
  UnexplainedResidual m;
  m.header = MakeHeader(look.stamp, body_frame);
  m.flight_s = look.flight_s;
  m.effects = look.model->effect_names();
  for (int i = 0; i < 3; ++i) {
    m.force_rmse_N[i] = look.force_rmse_N[i];
    m.torque_rmse_Nm[i] = look.torque_rmse_Nm[i];
  }
  m.structured_share = look.structured_share;
  m.channel = look.channel;
  m.whiteness_p = look.whiteness_p;
  m.structured = look.structured;
  m.in_a_row = static_cast<std::uint32_t>(look.in_a_row);
  m.added = added;
  if (!look.candidate) return m;
  m.candidate = look.candidate->name;
  m.score = look.candidate->score;
  m.explained_share = look.explained_share;
  for (const ParameterEstimate& p : look.candidate->parameters) {
    m.parameters.push_back(ToMessage(p));
  }
  m.beside = look.beside;
  m.alternatives = look.alternatives;
  return m;
}

nav_msgs::Odometry BodyOdometry(const Snapshot& snapshot, const std::string& world_frame,
                                const std::string& body_frame) {
  const BodyProperties& body = snapshot.body;
  const Eigen::Quaterniond q_SB(body.R_BS.transpose());
  const Eigen::Quaterniond q_WB = (snapshot.state.q_WS * q_SB).normalized();
  const Eigen::Vector3d p_WB = snapshot.state.p_WS - q_WB * body.p_BS;
  const Eigen::Vector3d w_WB_B = body.R_BS * snapshot.state.w_WS_S;
  // Bo moves with So, less what the turning adds over the lever arm p_BS.
  const Eigen::Vector3d v_WS_B = q_WB.conjugate() * snapshot.state.v_WS;
  const Eigen::Vector3d v_WB_B = v_WS_B - w_WB_B.cross(body.p_BS);

  nav_msgs::Odometry m;
  m.header = MakeHeader(snapshot.stamp, world_frame);
  m.child_frame_id = body_frame;
  m.pose.pose.position.x = p_WB.x();
  m.pose.pose.position.y = p_WB.y();
  m.pose.pose.position.z = p_WB.z();
  m.pose.pose.orientation = ToQuaternion(q_WB);
  m.twist.twist.linear = ToVector3(v_WB_B);
  m.twist.twist.angular = ToVector3(w_WB_B);
  return m;
}

geometry_msgs::WrenchStamped ResidualWrench(const Snapshot& snapshot,
                                            const std::string& body_frame) {
  geometry_msgs::WrenchStamped m;
  m.header = MakeHeader(snapshot.stamp, body_frame);
  m.wrench.force = ToVector3(snapshot.residual_force_B);
  m.wrench.torque = ToVector3(snapshot.residual_torque_B);
  return m;
}

geometry_msgs::TransformStamped ToTransform(Stamp stamp, const std::string& parent,
                                            const std::string& child, const Eigen::Vector3d& p,
                                            const Eigen::Matrix3d& R) {
  geometry_msgs::TransformStamped m;
  m.header = MakeHeader(stamp, parent);
  m.child_frame_id = child;
  m.transform.translation = ToVector3(p);
  m.transform.rotation = ToQuaternion(Eigen::Quaterniond(R).normalized());
  return m;
}

}  // namespace odmc
