#include "odmc/ros/control_messages.h"

#include <cmath>

#include "odmc/ros/conversions.h"
#include "odmc/text/finding.h"
#include "odmc/trajectory/flat_reference.h"

namespace odmc {
namespace {

/// Turn about W z that is left when the shortest tilt of body z is taken off: the twist of the
/// swing-twist decomposition.
double YawOf(const Eigen::Quaterniond& q_WB) { return 2.0 * std::atan2(q_WB.z(), q_WB.w()); }

Stamp FromRos(const ros::Duration& duration) { return static_cast<Stamp>(duration.toNSec()); }

/// One point; nothing if it is not sound.
std::optional<FlatReference> ToPointReference(
    const trajectory_msgs::MultiDOFJointTrajectoryPoint& point) {
  if (point.transforms.empty()) return std::nullopt;
  FlatReference r;
  r.p_WB = ToEigen(point.transforms.front().translation);
  const geometry_msgs::Quaternion& q = point.transforms.front().rotation;
  const Eigen::Quaterniond q_WB(q.w, q.x, q.y, q.z);
  r.yaw = std::remainder(YawOf(q_WB), 2.0 * M_PI);
  if (!point.velocities.empty()) {
    r.v_WB = ToEigen(point.velocities.front().linear);
    r.d_yaw = point.velocities.front().angular.z;
  }
  if (!point.accelerations.empty()) {
    r.a_WB = ToEigen(point.accelerations.front().linear);
    r.dd_yaw = point.accelerations.front().angular.z;
  }
  const bool is_unit = std::abs(q_WB.norm() - 1.0) < 0.05;  // false for NaN, too
  if (!is_unit || !IsFinite(r)) return std::nullopt;
  return r;
}

trajectory_msgs::MultiDOFJointTrajectoryPoint ToPointMessage(const FlatReference& r) {
  trajectory_msgs::MultiDOFJointTrajectoryPoint point;
  point.transforms.resize(1);
  point.velocities.resize(1);
  point.accelerations.resize(1);
  point.transforms[0].translation = ToVector3(r.p_WB);
  point.transforms[0].rotation =
      ToQuaternion(Eigen::Quaterniond(Eigen::AngleAxisd(r.yaw, Eigen::Vector3d::UnitZ())));
  point.velocities[0].linear = ToVector3(r.v_WB);
  point.velocities[0].angular.z = r.d_yaw;
  point.accelerations[0].linear = ToVector3(r.a_WB);
  point.accelerations[0].angular.z = r.dd_yaw;
  return point;
}

}  // namespace

// ---- To the core -------------------------------------------------------------------------------

std::optional<TimedReference> ToReference(const FlatOutput& message) {
  TimedReference point;
  point.stamp = FromRos(message.header.stamp);
  FlatReference& r = point.reference;
  r.p_WB = ToEigen(message.position);
  r.v_WB = ToEigen(message.velocity);
  r.a_WB = ToEigen(message.acceleration);
  r.j_WB = ToEigen(message.jerk);
  r.s_WB = ToEigen(message.snap);
  r.yaw = message.yaw;
  r.d_yaw = message.yaw_rate;
  r.dd_yaw = message.yaw_acceleration;
  r.standing = message.standing;
  if (point.stamp <= 0 || !IsFinite(r)) return std::nullopt;
  return point;
}

std::optional<std::vector<TimedReference>> ToReferences(
    const trajectory_msgs::MultiDOFJointTrajectory& message, Stamp now, std::string* error) {
  const auto fail = [error](const std::string& what) {
    *error = "the trajectory " + what;
    return std::nullopt;
  };
  if (message.points.empty()) return fail("has no points");
  const Stamp start = message.header.stamp.isZero() ? now : FromRos(message.header.stamp);
  std::vector<TimedReference> points;
  for (const auto& m : message.points) {
    std::optional<FlatReference> reference = ToPointReference(m);
    if (!reference) return fail("has a point without a sound transform, or not finite");
    if (message.points.size() > 1 && m.velocities.empty()) {
      return fail("has a point without velocity");
    }
    const Stamp stamp = start + FromRos(m.time_from_start);
    if (!points.empty()) {
      if (stamp <= points.back().stamp) return fail("has points that are not in the order of time");
      const double before = points.back().reference.yaw;
      reference->yaw = before + std::remainder(reference->yaw - before, 2.0 * M_PI);
    }
    points.push_back({stamp, *reference});
  }
  return points;
}

std::string ObjectionTo(const DynamicParameters& message, const std::string& vehicle) {
  if (message.vehicle != vehicle) {
    return "it is of the vehicle '" + message.vehicle + "', not '" + vehicle + "'";
  }
  if (message.trust.empty() || message.trust == Name(Trust::kGood)) return "";
  const std::string reason = message.trust_reasons.empty() ? "" : ": " + message.trust_reasons[0];
  return "its trust is " + message.trust + reason;
}

std::optional<ParameterSet> ToParameterSet(const DynamicParameters& message) {
  if (message.header.stamp.isZero()) return std::nullopt;
  ParameterSet set;
  set.effects = message.effects;
  for (const DynamicParameter& p : message.parameters) {
    if (!std::isfinite(p.value) || !std::isfinite(p.sigma)) return std::nullopt;
    set.parameters.push_back({p.name, p.unit, p.value, p.sigma,
                              p.state == DynamicParameter::ESTIMATED,
                              static_cast<bool>(p.observable)});
  }
  set.provenance["vehicle"] = message.vehicle;
  return set;
}

// ---- From the core -----------------------------------------------------------------------------

FlatOutput ToMessage(const FlatReference& r, Stamp stamp, const std::string& world_frame) {
  FlatOutput m;
  m.header = MakeHeader(stamp, world_frame);
  m.position = ToPoint(r.p_WB);
  m.velocity = ToVector3(r.v_WB);
  m.acceleration = ToVector3(r.a_WB);
  m.jerk = ToVector3(r.j_WB);
  m.snap = ToVector3(r.s_WB);
  m.yaw = r.yaw;
  m.yaw_rate = r.d_yaw;
  m.yaw_acceleration = r.dd_yaw;
  m.standing = r.standing;
  return m;
}

trajectory_msgs::MultiDOFJointTrajectory ToMessage(const std::vector<TimedReference>& points,
                                                   const std::string& world_frame,
                                                   const std::string& body_frame) {
  trajectory_msgs::MultiDOFJointTrajectory m;
  m.joint_names.push_back(body_frame);
  if (points.empty()) return m;
  m.header = MakeHeader(points.front().stamp, world_frame);
  for (const TimedReference& point : points) {
    m.points.push_back(ToPointMessage(point.reference));
    m.points.back().time_from_start.fromNSec(point.stamp - points.front().stamp);
  }
  return m;
}

RotorSpeeds RotorCommand(const ControlCommand& command) {
  return ToMessage(RotorSample{command.stamp, command.rotor_speed});
}

MotorCommands MotorCommand(const ControlCommand& command) {
  return ToMessage(CommandSample{command.stamp, command.throttle});
}

RateThrust RateThrustCommand(const ControlCommand& command, const std::string& body_frame) {
  RateThrust m;
  m.header = MakeHeader(command.stamp, body_frame);
  m.angular_rates = ToVector3(command.w_WB_B_cmd);
  m.collective_thrust_N = command.collective_thrust_N;
  return m;
}

bool IsFinite(const ControlCommand& c) {
  return c.rotor_speed.allFinite() && c.throttle.allFinite() && c.w_WB_B_cmd.allFinite() &&
         std::isfinite(c.collective_thrust_N) && std::isfinite(c.allocation.thrust_change_N) &&
         std::isfinite(c.allocation.roll_pitch_share) && std::isfinite(c.allocation.yaw_share);
}

nav_msgs::Odometry TruthOdometry(const TruthSample& truth, Stamp stamp,
                                 const std::string& world_frame, const std::string& body_frame) {
  return ToMessage(OdometrySample{stamp, truth.p_WB, truth.q_WB, truth.v_WB, truth.w_WB_B},
                   world_frame, body_frame);
}

geometry_msgs::WrenchStamped TruthWrench(const TruthSample& truth, Stamp stamp,
                                         const std::string& body_frame) {
  geometry_msgs::WrenchStamped m;
  m.header = MakeHeader(stamp, body_frame);
  m.wrench.force = ToVector3(truth.f_B);
  m.wrench.torque = ToVector3(truth.tau_Bcm_B);
  return m;
}

DynamicParameters TruthParameters(const DynamicModel& model, const ModelValues& values, Stamp stamp,
                                  const std::string& body_frame) {
  DynamicParameters m;
  m.header = MakeHeader(stamp, body_frame);
  m.vehicle = model.vehicle().name;
  m.effects = model.effect_names();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    m.parameters.push_back(
        ToMessage(ParameterEstimate{p.full_name, p.spec.unit, values[i], 0.0, false, true}));
  }
  m.covariance.assign(m.parameters.size() * m.parameters.size(), 0.0);
  return m;
}

}  // namespace odmc
