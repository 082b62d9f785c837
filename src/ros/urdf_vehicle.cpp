#include "odmc/ros/urdf_vehicle.h"

#include <urdf_model/model.h>
#include <urdf_parser/urdf_parser.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <regex>
#include <vector>

#include "odmc/io/vehicle_yaml.h"
#include "odmc/io/yaml_text.h"
#include "odmc/text/number_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr char kSource[] = "robot_description";

[[noreturn]] void Fail(const std::string& what) { RefuseFile(kSource, what); }

Isometry3d ToEigen(const urdf::Pose& pose) {
  Isometry3d result = Isometry3d::Identity();
  result.translation() = Vector3d(pose.position.x, pose.position.y, pose.position.z);
  Eigen::Quaterniond q;
  pose.rotation.getQuaternion(q.x(), q.y(), q.z(), q.w());
  result.linear() = q.normalized().toRotationMatrix();
  return result;
}

/// Pose of every link in the root link, joints at zero.
using LinkPoses = std::map<std::string, Isometry3d>;

void AddPoses(const urdf::Link& link, const Isometry3d& X_BL, LinkPoses* poses) {
  (*poses)[link.name] = X_BL;
  for (const auto& joint : link.child_joints) {
    const auto child = std::find_if(
        link.child_links.begin(), link.child_links.end(),
        [&](const auto& candidate) { return candidate->name == joint->child_link_name; });
    if (child == link.child_links.end()) continue;
    AddPoses(**child, X_BL * ToEigen(joint->parent_to_joint_origin_transform), poses);
  }
}

// ---- Mass --------------------------------------------------------------------------------------

struct MassProperties {
  double mass = 0.0;
  Vector3d p_BBcm = Vector3d::Zero();
  Matrix3d I_BBcm_B = Matrix3d::Zero();
};

Matrix3d InertiaOf(const urdf::Inertial& inertial) {
  Matrix3d inertia;
  inertia << inertial.ixx, inertial.ixy, inertial.ixz,  //
      inertial.ixy, inertial.iyy, inertial.iyz,         //
      inertial.ixz, inertial.iyz, inertial.izz;
  return inertia;
}

/// Inertia of a point mass about the origin it is `p` away from.
Matrix3d PointInertia(double mass, const Vector3d& p) {
  return mass * (p.squaredNorm() * Matrix3d::Identity() - p * p.transpose());
}

MassProperties SumOfLinks(const urdf::ModelInterface& model, const LinkPoses& poses) {
  MassProperties sum;
  for (const auto& [name, link] : model.links_) {
    if (!link->inertial) continue;
    const Isometry3d X_BC = poses.at(name) * ToEigen(link->inertial->origin);
    const double mass = link->inertial->mass;
    sum.mass += mass;
    sum.p_BBcm += mass * X_BC.translation();
    sum.I_BBcm_B += X_BC.linear() * InertiaOf(*link->inertial) * X_BC.linear().transpose() +
                    PointInertia(mass, X_BC.translation());
  }
  if (!(sum.mass > 0.0)) Fail("no link has a mass");
  sum.p_BBcm /= sum.mass;
  sum.I_BBcm_B -= PointInertia(sum.mass, sum.p_BBcm);
  return sum;
}

// ---- Rotors ------------------------------------------------------------------------------------

/// Largest horizontal half size of a shape; 0 where it has none that can be read off.
double RadiusOf(const urdf::GeometrySharedPtr& geometry) {
  if (!geometry) return 0.0;
  if (geometry->type == urdf::Geometry::CYLINDER) {
    return static_cast<const urdf::Cylinder&>(*geometry).radius;
  }
  if (geometry->type == urdf::Geometry::SPHERE) {
    return static_cast<const urdf::Sphere&>(*geometry).radius;
  }
  if (geometry->type == urdf::Geometry::BOX) {
    const urdf::Vector3& size = static_cast<const urdf::Box&>(*geometry).dim;
    return 0.5 * std::max(size.x, size.y);
  }
  return 0.0;
}

double RadiusOf(const urdf::Link& link) {
  double radius = 0.0;
  for (const auto& visual : link.visual_array) {
    radius = std::max(radius, RadiusOf(visual->geometry));
  }
  for (const auto& collision : link.collision_array) {
    radius = std::max(radius, RadiusOf(collision->geometry));
  }
  return radius;
}

/// Rotor joints in the order of their numbers.
std::vector<urdf::JointConstSharedPtr> RotorJoints(const urdf::ModelInterface& model) {
  static const std::regex pattern("(rotor|propeller|prop|motor)_?([0-9]+)(_joint)?");
  std::map<long, urdf::JointConstSharedPtr> joints;
  for (const auto& [name, joint] : model.joints_) {
    std::smatch match;
    if (!std::regex_match(name, match, pattern)) continue;
    const long number = std::stol(match[2].str().substr(0, 9));
    if (!joints.emplace(number, joint).second) {
      Fail("joints " + joints.at(number)->name + " and " + name + " have the same number");
    }
  }
  if (joints.empty()) Fail("no joint is named rotor_N_joint, so it shows no rotors");
  std::vector<urdf::JointConstSharedPtr> ordered;
  for (const auto& [number, joint] : joints) ordered.push_back(joint);
  return ordered;
}

Rotor RotorOf(const urdf::ModelInterface& model, const urdf::Joint& joint, const LinkPoses& poses,
              double radius_m) {
  const Isometry3d X_BP = poses.at(joint.child_link_name);
  const Vector3d axis_B = X_BP.linear() * Vector3d(joint.axis.x, joint.axis.y, joint.axis.z);
  if (std::abs(axis_B.z()) < 0.9) Fail("the axis of joint " + joint.name + " is not vertical");
  Rotor rotor;
  rotor.p_BP = X_BP.translation();
  rotor.spin = axis_B.z() > 0.0 ? -1.0 : 1.0;
  rotor.radius_m = RadiusOf(*model.getLink(joint.child_link_name));
  if (rotor.radius_m <= 0.0) rotor.radius_m = radius_m;
  if (rotor.radius_m <= 0.0) {
    Fail("link " + joint.child_link_name +
         " has no cylinder, sphere or box that tells the propeller's radius; set rotor_radius_m");
  }
  return rotor;
}

std::vector<Rotor> RotorsOf(const urdf::ModelInterface& model, const LinkPoses& poses,
                            double radius_m) {
  std::vector<Rotor> rotors;
  double spins = 0.0;
  for (const auto& joint : RotorJoints(model)) {
    rotors.push_back(RotorOf(model, *joint, poses, radius_m));
    spins += rotors.back().spin;
  }
  if (rotors.size() > 1 && std::abs(spins) == static_cast<double>(rotors.size())) {
    Fail(
        "all rotor joints turn about the same axis; give those of clockwise rotors the axis "
        "0 0 -1");
  }
  return rotors;
}

// ---- The vehicle file it amounts to ------------------------------------------------------------

std::string CentreText(const Vector3d& p_BBcm) {
  std::string text = "parameters:\n";
  for (int i = 0; i < 3; ++i) {
    text += std::string("  centre_of_gravity.") + "xyz"[i] +
            ": {value: " + FormatYamlNumber(p_BBcm[i]) + "}\n";
  }
  return text;
}

}  // namespace

Vehicle VehicleFromUrdf(const std::string& urdf, double radius_m) {
  const urdf::ModelInterfaceSharedPtr model = urdf::parseURDF(urdf);
  if (!model || !model->getRoot()) Fail("is not a URDF (see the messages above)");
  LinkPoses poses;
  AddPoses(*model->getRoot(), Isometry3d::Identity(), &poses);
  const MassProperties mass = SumOfLinks(*model, poses);

  std::string text = "name: \"" + model->getName() + "\"\nmass_kg: " + FormatYamlNumber(mass.mass) +
                     "\ninertia_kg_m2: " + YamlList(mass.I_BBcm_B.diagonal()) + "\nrotors:\n";
  for (const Rotor& rotor : RotorsOf(*model, poses, radius_m)) {
    text += "  - {position_m: " + YamlList(rotor.p_BP) +
            ", spin: " + (rotor.spin > 0 ? "cw" : "ccw") +
            ", radius_m: " + FormatYamlNumber(rotor.radius_m) + "}\n";
  }
  if (poses.count("imu_link") > 0) {
    const Isometry3d& X_BI = poses.at("imu_link");
    SensorMount imu;
    imu.p_BS = X_BI.translation();
    imu.q_BS = Eigen::Quaterniond(X_BI.linear());
    text += "imu: " + YamlMount(imu) + "\n";
  }
  text += CentreText(mass.p_BBcm);
  return ParseVehicle(text, kSource);  // with its checks and defaults
}

}  // namespace odmc
