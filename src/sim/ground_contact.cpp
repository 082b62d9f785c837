#include "odmc/sim/ground_contact.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

// Shares of the weight (n×1) that feet below the rotors bear; none pulls.
Eigen::VectorXd LoadShares(const Vehicle& vehicle, const Eigen::Vector3d& p_BBcm) {
  Eigen::MatrixXd balance(3, vehicle.num_rotors());
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    const Eigen::Vector3d r_B = vehicle.rotors[j].p_BP - p_BBcm;
    balance.col(j) << 1.0, r_B.x(), r_B.y();
  }
  const Eigen::VectorXd shares =
      balance.completeOrthogonalDecomposition().solve(Eigen::Vector3d::UnitX());
  return shares.cwiseMax(0.0);
}

}  // namespace

GroundContact::GroundContact(const Vehicle& vehicle, const BodyProperties& body,
                             const GroundOptions& options)
    : num_points_(2 * vehicle.num_rotors()),
      plane_z_(options.static_sink_m - options.leg_height_m),
      reach_(0.0),
      friction_(options.friction) {
  const int n = vehicle.num_rotors();
  const double gravity = body.g_W.norm();
  stiffness_ = body.mass * gravity / (n * options.static_sink_m);
  damping_ =
      2.0 * options.damping_ratio * body.mass * std::sqrt(gravity / options.static_sink_m) / n;
  const Eigen::VectorXd shares = LoadShares(vehicle, body.p_BBcm);
  for (int j = 0; j < n; ++j) {
    const double sink = shares[j] * n * options.static_sink_m;
    points_[j].p_B << vehicle.rotors[j].p_BP.head<2>(), plane_z_ - sink;
    points_[n + j].p_B = vehicle.rotors[j].p_BP;
  }
  for (int i = 0; i < num_points_; ++i) reach_ = std::max(reach_, points_[i].p_B.norm());
}

Eigen::Vector3d GroundContact::ForceOn(const Eigen::Vector3d& p_W, const Eigen::Vector3d& v_W,
                                       double depth, Point* point) const {
  if (!point->down) point->anchor_W = p_W.head<2>();
  const double normal = std::max(0.0, stiffness_ * depth - damping_ * v_W.z());
  Eigen::Vector2d hold = stiffness_ * (point->anchor_W - p_W.head<2>()) - damping_ * v_W.head<2>();
  const double limit = friction_ * normal, asked = hold.norm();
  if (asked > limit) {
    hold *= limit / asked;
    point->anchor_W = p_W.head<2>() + hold / stiffness_;
  }
  return {hold.x(), hold.y(), normal};
}

BodyWrench GroundContact::Push(const RigidBodyState& state, const Eigen::Vector3d& p_BBcm) {
  BodyWrench wrench;
  if (state.p_WB.z() > plane_z_ + reach_) {
    if (touches_) LetGo();
    return wrench;
  }
  touches_ = false;
  const Eigen::Matrix3d R_WB = state.q_WB.toRotationMatrix();
  for (int i = 0; i < num_points_; ++i) {
    Point& point = points_[i];
    const Eigen::Vector3d p_WP = state.p_WB + R_WB * point.p_B;
    const double depth = plane_z_ - p_WP.z();
    if (depth <= 0.0) {
      point.down = false;
      continue;
    }
    const Eigen::Vector3d v_WP = state.v_WB + R_WB * state.w_WB_B.cross(point.p_B);
    const Eigen::Vector3d f_B = R_WB.transpose() * ForceOn(p_WP, v_WP, depth, &point);
    point.down = touches_ = true;
    wrench.f_B += f_B;
    wrench.tau_Bcm_B += (point.p_B - p_BBcm).cross(f_B);
  }
  return wrench;
}

void GroundContact::LetGo() {
  touches_ = false;
  for (Point& point : points_) point.down = false;
}

}  // namespace odmc
