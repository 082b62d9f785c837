#include "odmc/ros/displays.h"

#include <algorithm>
#include <cctype>
#include <cmath>

#include "odmc/ros/conversions.h"
#include "odmc/ros/estimate_messages.h"

namespace odmc {
namespace {

using visualization_msgs::Marker;

constexpr double kArmsPerWeight = 20.0;       // a twentieth of the weight is an arm long
constexpr double kArmsPerWeightArm = 1000.0;  // torques are smaller: a 1000th of weight times arm
constexpr double kAhead_s = 0.1;  // velocities are drawn as what they travel in this time
constexpr double kLeastArrow_m = 1e-6;

struct Color {
  float r, g, b, a;
};
constexpr Color kForce = {0.90f, 0.20f, 0.15f, 1.0f}, kTorque = {0.95f, 0.65f, 0.10f, 1.0f},
                kCog = {1.00f, 0.85f, 0.00f, 1.0f}, kVelocity = {0.20f, 0.55f, 0.95f, 1.0f},
                kWind = {0.25f, 0.80f, 0.80f, 1.0f}, kText = {0.95f, 0.95f, 0.95f, 1.0f},
                kArms = {0.60f, 0.60f, 0.60f, 1.0f}, kClockwise = {0.85f, 0.35f, 0.35f, 0.6f},
                kCounterclockwise = {0.35f, 0.60f, 0.85f, 0.6f};

Marker MakeMarker(const std_msgs::Header& header, const char* space, int type, const Color& c) {
  Marker m;
  m.header = header;
  m.ns = space;
  m.type = type;
  m.action = Marker::ADD;
  m.pose.orientation.w = 1.0;
  m.color.r = c.r;
  m.color.g = c.g;
  m.color.b = c.b;
  m.color.a = c.a;
  return m;
}

/// A marker of the same name that was drawn before goes away.
Marker Nothing(Marker m) {
  m.action = Marker::DELETE;
  m.points.clear();
  m.text.clear();
  m.pose = geometry_msgs::Pose();
  m.pose.orientation.w = 1.0;
  return m;
}

/// From `tail`, along `arrow` [m]; `arm` sets how thick it is.
Marker Arrow(Marker m, const Eigen::Vector3d& tail, const Eigen::Vector3d& arrow, double arm) {
  const double length = arrow.norm();
  const Eigen::Vector3d tip = tail + arrow;
  if (!tip.allFinite() || !(length > kLeastArrow_m)) return Nothing(std::move(m));
  m.points = {ToPoint(tail), ToPoint(tip)};
  m.scale.x = 0.08 * arm;
  m.scale.y = 0.20 * arm;
  m.scale.z = std::min(0.30 * arm, 0.5 * length);
  return m;
}

void AddVehicle(const Vehicle& vehicle, const std_msgs::Header& header, double arm,
                std::vector<Marker>* markers) {
  Marker arms = MakeMarker(header, "vehicle", Marker::LINE_LIST, kArms);
  arms.scale.x = 0.05 * arm;
  for (const Rotor& rotor : vehicle.rotors) {
    arms.points.push_back(geometry_msgs::Point());
    arms.points.push_back(ToPoint(rotor.p_BP));
  }
  markers->push_back(arms);
  for (const Rotor& rotor : vehicle.rotors) {
    Marker disc = MakeMarker(header, "vehicle", Marker::CYLINDER,
                             rotor.spin > 0.0 ? kClockwise : kCounterclockwise);
    disc.id = static_cast<int>(&rotor - vehicle.rotors.data()) + 1;
    disc.pose.position = ToPoint(rotor.p_BP);
    disc.scale.x = disc.scale.y = 2.0 * rotor.radius_m;
    disc.scale.z = 0.05 * rotor.radius_m;
    markers->push_back(disc);
  }
}

void AddWrench(const Vehicle& vehicle, const Snapshot& snapshot, const std_msgs::Header& header,
               double arm, std::vector<Marker>* markers) {
  const Eigen::Vector3d& p_BBcm = snapshot.body.p_BBcm;
  const double weight_N = vehicle.mass_kg * vehicle.gravity_m_s2;
  const double m_per_N = kArmsPerWeight * arm / weight_N;
  const double m_per_Nm = kArmsPerWeightArm * arm / (weight_N * arm);
  Marker cog = MakeMarker(header, "centre_of_gravity", Marker::SPHERE, kCog);
  cog.scale.x = cog.scale.y = cog.scale.z = 0.2 * arm;
  if (p_BBcm.allFinite()) {
    cog.pose.position = ToPoint(p_BBcm);
    markers->push_back(cog);
  } else {
    markers->push_back(Nothing(cog));
  }
  markers->push_back(Arrow(MakeMarker(header, "residual_force", Marker::ARROW, kForce), p_BBcm,
                           m_per_N * snapshot.residual_force_B, arm));
  markers->push_back(Arrow(MakeMarker(header, "residual_torque", Marker::ARROW, kTorque), p_BBcm,
                           m_per_Nm * snapshot.residual_torque_B, arm));
}

/// Pose and velocity of the body in the world.
struct PlacedBody {
  geometry_msgs::Pose pose;
  Eigen::Vector3d p_WB, v_WB;
};

PlacedBody MotionOf(const Snapshot& snapshot) {
  const nav_msgs::Odometry m = BodyOdometry(snapshot, "", "");
  const Eigen::Quaterniond q_WB = ToEigen(m.pose.pose.orientation);
  return {m.pose.pose, ToEigen(m.pose.pose.position), q_WB * ToEigen(m.twist.twist.linear)};
}

void AddMotion(const Snapshot& snapshot, const DisplayScene& scene, double arm,
               std::vector<Marker>* markers) {
  const std_msgs::Header header = MakeHeader(snapshot.stamp, scene.world_frame);
  const PlacedBody motion = MotionOf(snapshot);
  const Eigen::Vector3d above = motion.p_WB + Eigen::Vector3d(0.0, 0.0, 1.5 * arm);
  const Eigen::Vector3d wind_m = kAhead_s * snapshot.body.wind_W;
  markers->push_back(Arrow(MakeMarker(header, "velocity", Marker::ARROW, kVelocity), motion.p_WB,
                           kAhead_s * motion.v_WB, arm));
  markers->push_back(
      Arrow(MakeMarker(header, "wind", Marker::ARROW, kWind), above - wind_m, wind_m, arm));
  Marker text = MakeMarker(header, "phase", Marker::TEXT_VIEW_FACING, kText);
  text.text = scene.phase + (scene.verdict.empty() ? "" : ", " + scene.verdict);
  text.scale.z = 0.6 * arm;
  const Eigen::Vector3d over = motion.p_WB + Eigen::Vector3d(0.0, 0.0, 2.5 * arm);
  text.pose.position = ToPoint(over);
  const bool is_shown = over.allFinite() && !text.text.empty();
  markers->push_back(is_shown ? text : Nothing(text));
}

}  // namespace

visualization_msgs::MarkerArray DisplayMarkers(const DynamicModel& model, const Snapshot& snapshot,
                                               const DisplayScene& scene) {
  const Vehicle& vehicle = model.vehicle();
  const double arm = vehicle.ArmLength();
  const std_msgs::Header header = MakeHeader(snapshot.stamp, scene.body_frame);
  visualization_msgs::MarkerArray m;
  AddVehicle(vehicle, header, arm, &m.markers);
  AddWrench(vehicle, snapshot, header, arm, &m.markers);
  AddMotion(snapshot, scene, arm, &m.markers);
  return m;
}

sensor_msgs::JointState PlottedEstimates(const DynamicModel& model, const Snapshot& snapshot,
                                         const std::string& body_frame) {
  sensor_msgs::JointState m;
  m.header = MakeHeader(snapshot.stamp, body_frame);
  for (int i = 0; i < model.num_parameters(); ++i) {
    if (!std::isfinite(snapshot.values[i]) || !std::isfinite(snapshot.sigma[i])) continue;
    m.name.push_back(model.parameters()[i].full_name);
    m.position.push_back(snapshot.values[i]);
    m.velocity.push_back(snapshot.sigma[i]);
    m.effort.push_back(snapshot.observable[static_cast<size_t>(i)] ? 1.0 : 0.0);
  }
  return m;
}

std::string PlotTopic(const std::string& full_name) {
  std::string topic = full_name;
  for (char& c : topic) {
    const bool is_allowed = std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_';
    if (!is_allowed) c = c == '.' ? '/' : '_';
  }
  return topic;
}

void PathTrail::Add(const Snapshot& snapshot) {
  if (!poses_.empty() && snapshot.stamp < poses_.back().first) poses_.clear();
  if (!poses_.empty() && ToSeconds(snapshot.stamp - poses_.back().first) < spacing_s_) return;
  const PlacedBody motion = MotionOf(snapshot);
  if (!motion.p_WB.allFinite() || !ToEigen(motion.pose.orientation).coeffs().allFinite()) return;
  poses_.emplace_back(snapshot.stamp, motion.pose);
  const auto is_old = [&](const auto& entry) {
    return ToSeconds(snapshot.stamp - entry.first) > length_s_;
  };
  poses_.erase(poses_.begin(), std::find_if_not(poses_.begin(), poses_.end(), is_old));
}

nav_msgs::Path PathTrail::Message(const std::string& world_frame) const {
  nav_msgs::Path m;
  m.header = MakeHeader(poses_.empty() ? 0 : poses_.back().first, world_frame);
  m.poses.resize(poses_.size());
  for (size_t i = 0; i < poses_.size(); ++i) {
    m.poses[i].header = MakeHeader(poses_[i].first, world_frame);
    m.poses[i].pose = poses_[i].second;
  }
  return m;
}

}  // namespace odmc
