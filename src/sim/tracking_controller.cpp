#include "odmc/sim/tracking_controller.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "odmc/math/so3.h"

namespace odmc {
namespace {

// Gains in accelerations: closed-loop poles near 3 rad/s (position) and 12 rad/s (attitude).
constexpr double kPosition = 9.0;    // [1/s²]
constexpr double kVelocity = 5.0;    // [1/s]
constexpr double kAttitude = 150.0;  // [1/s²]
constexpr double kRate = 25.0;       // [1/s]
// A speed controller drives each motor past its goal, which makes it this much faster.
constexpr double kMotorLead = 2.5;
constexpr double kMaxThrustOverHover = 3.5;
constexpr double kMinThrustOverHover = 0.02;
// Keeps the ratio of the air's force to speed finite at rest [m²/s²].
constexpr double kStillAir = 0.1;

// A vector of W with two derivatives by time.
struct Moving {
  Eigen::Vector3d x, d, dd;
};

Moving Normalised(const Moving& u) {
  const double n = u.x.norm();
  Moving e;
  e.x = u.x / n;
  const double d_n = e.x.dot(u.d);
  e.d = (u.d - d_n * e.x) / n;
  const double dd_n = e.x.dot(u.dd) + e.d.dot(u.d);
  e.dd = (u.dd - 2.0 * d_n * e.d - dd_n * e.x) / n;
  return e;
}

Moving Cross(const Moving& a, const Moving& b) {
  return {a.x.cross(b.x), a.d.cross(b.x) + a.x.cross(b.d),
          a.dd.cross(b.x) + 2.0 * a.d.cross(b.d) + a.x.cross(b.dd)};
}

Moving Heading(const FlatReference& reference) {
  const Eigen::Vector3d h(std::cos(reference.yaw), std::sin(reference.yaw), 0.0);
  const Eigen::Vector3d n(-h.y(), h.x(), 0.0);
  return {h, reference.d_yaw * n, reference.dd_yaw * n - reference.d_yaw * reference.d_yaw * h};
}

// Body x of an attitude that is turned by the yaw of heading `h` and then tilted to body z along
// `z` the shortest way: x = h - s (z + e3), s = h·z / (1 + z·e3).
Moving Tilted(const Moving& h, const Moving& z) {
  const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
  const double d = 1.0 + z.x.z(), d_d = z.d.z(), dd_d = z.dd.z();
  const double s = h.x.dot(z.x) / d;
  const double d_s = (h.d.dot(z.x) + h.x.dot(z.d) - s * d_d) / d;
  const double dd_s =
      (h.dd.dot(z.x) + 2.0 * h.d.dot(z.d) + h.x.dot(z.dd) - 2.0 * d_s * d_d - s * dd_d) / d;
  return {h.x - s * (z.x + e3), h.d - d_s * (z.x + e3) - s * z.d,
          h.dd - dd_s * (z.x + e3) - 2.0 * d_s * z.d - s * z.dd};
}

// Rows f_z, tau_x, tau_y, tau_z of the model at rest in still air, high above the ground.
Eigen::Vector4d WrenchAtRest(const RigidBody& body, const RotorVector& squared_speed) {
  RigidBodyState state;
  state.p_WB.z() = 1000.0;
  state.v_WB = body.properties().wind_W;
  state.rotor_speed = squared_speed.cwiseSqrt();
  const BodyWrench wrench = body.WrenchOf(body.FlightStateOf(0.0, state, state.rotor_speed));
  Eigen::Vector4d rows;
  rows << wrench.f_B.z(), wrench.tau_Bcm_B;
  return rows;
}

// What each rotor's squared speed adds to these rows (4×n).
Eigen::MatrixXd RotorMap(const RigidBody& body) {
  constexpr double kProbe = 1e6;  // (rad/s)²
  const int num_rotors = body.model().vehicle().num_rotors();
  const Eigen::Vector4d still = WrenchAtRest(body, RotorVector::Zero(num_rotors));
  Eigen::MatrixXd map(4, num_rotors);
  for (int j = 0; j < num_rotors; ++j) {
    RotorVector squared = RotorVector::Zero(num_rotors);
    squared[j] = kProbe;
    map.col(j) = (WrenchAtRest(body, squared) - still) / kProbe;
  }
  return map;
}

}  // namespace

FlatAttitude FlatAttitudeOf(const FlatReference& reference, const Eigen::Vector3d& g_W) {
  const Moving thrust = {reference.a_WB - g_W, reference.j_WB, reference.s_WB};
  const Moving z = Normalised(thrust);
  const Moving x = Tilted(Heading(reference), z);
  const Moving y = Cross(z, x);

  FlatAttitude flat;
  Eigen::Matrix3d R_WB;
  R_WB << x.x, y.x, z.x;
  flat.q_WB = Eigen::Quaterniond(R_WB);
  // From dR/dt = R [w]×: w = (z·dy, x·dz, y·dx).
  flat.w_WB_B << z.x.dot(y.d), x.x.dot(z.d), y.x.dot(x.d);
  flat.dw_WB_B << z.d.dot(y.d) + z.x.dot(y.dd), x.d.dot(z.d) + x.x.dot(z.dd),
      y.d.dot(x.d) + y.x.dot(x.dd);
  flat.specific_thrust = thrust.x.norm();
  return flat;
}

TrackingController::TrackingController(const RigidBody& body) : body_(&body), map_(RotorMap(body)) {
  // The torque rows are scaled so that the rank does not hang on units.
  const double length = body.model().vehicle().ArmLength();
  const Rows scale(1.0, 1.0 / length, 1.0 / length, 1.0 / (0.1 * length));
  const Eigen::MatrixXd scaled = scale.asDiagonal() * Eigen::MatrixXd(map_);
  inverse_ = scaled.completeOrthogonalDecomposition().pseudoInverse() * scale.asDiagonal();

  const BodyProperties& properties = body.properties();
  const double hover_squared = properties.mass * properties.g_W.norm() / map_.row(0).sum();
  min_squared_ = kMinThrustOverHover * hover_squared;
  max_squared_ = kMaxThrustOverHover * hover_squared;
}

RotorVector TrackingController::HoverSpeeds() const {
  const BodyProperties& properties = body_->properties();
  const Rows wrench(properties.mass * properties.g_W.norm(), 0.0, 0.0, 0.0);
  return Allocate(wrench).cwiseSqrt();
}

BodyWrench TrackingController::AirWrench(double time_s, const RigidBodyState& state) const {
  FlightState flight = body_->FlightStateOf(time_s, state, state.rotor_speed);
  flight.rotors = RotorState::Steady(state.rotor_speed);
  BodyWrench wrench = body_->WrenchOf(flight);
  const Rows rotors = map_ * flight.rotors.speed_squared;
  wrench.f_B.z() -= rotors[0];
  wrench.tau_Bcm_B -= rotors.tail<3>();
  return wrench;
}

TrackingController::Rows TrackingController::DesiredRotorWrench(const RigidBodyState& state,
                                                                const FlatReference& reference,
                                                                const BodyWrench& air) const {
  const BodyProperties& properties = body_->properties();
  const Eigen::Matrix3d R_WB = state.q_WB.toRotationMatrix();

  // Thrust that gives Bo the acceleration asked for, whatever the air does.  model.md section 11
  const Eigen::Vector3d air_W = R_WB * air.f_B / properties.mass;
  const double drag = air_W.dot(state.v_WB) / (state.v_WB.squaredNorm() + kStillAir);
  FlatReference goal = reference;
  goal.a_WB +=
      kPosition * (reference.p_WB - state.p_WB) + kVelocity * (reference.v_WB - state.v_WB) - air_W;
  goal.j_WB -= drag * reference.a_WB;
  goal.s_WB -= drag * reference.j_WB;
  const FlatAttitude desired = FlatAttitudeOf(goal, properties.g_W);
  const Eigen::Quaterniond q_BD = state.q_WB.conjugate() * desired.q_WB;
  const double thrust = properties.mass * desired.specific_thrust * q_BD.toRotationMatrix()(2, 2);

  const Eigen::Vector3d& w = state.w_WB_B;
  const Eigen::Vector3d dw_WB_B =
      kAttitude * Log(q_BD) + kRate * (q_BD * desired.w_WB_B - w) + q_BD * desired.dw_WB_B;
  const Eigen::Vector3d tau_Bcm_B =
      properties.I_BBcm_B * dw_WB_B + w.cross(properties.I_BBcm_B * w) - air.tau_Bcm_B;
  Rows rows;
  rows << thrust, tau_Bcm_B;
  return rows;
}

RotorVector TrackingController::Allocate(const Rows& wrench) const {
  Rows without_yaw = wrench;
  without_yaw[3] = 0.0;
  const RotorVector base = inverse_ * without_yaw;
  const RotorVector yaw = inverse_.col(3) * wrench[3];
  double share = 1.0;
  for (int j = 0; j < base.size(); ++j) {
    const double room = yaw[j] > 0.0 ? max_squared_ - base[j] : base[j] - min_squared_;
    if (std::abs(yaw[j]) > room) share = std::min(share, std::max(0.0, room) / std::abs(yaw[j]));
  }
  return (base + share * yaw).cwiseMax(min_squared_).cwiseMin(max_squared_);
}

RotorVector TrackingController::Command(double time_s, const RigidBodyState& state,
                                        const FlatReference& reference) const {
  const BodyWrench air = AirWrench(time_s, state);
  const RotorVector goal = Allocate(DesiredRotorWrench(state, reference, air)).cwiseSqrt();
  const RotorVector driven = state.rotor_speed + kMotorLead * (goal - state.rotor_speed);
  return driven.cwiseMax(std::sqrt(min_squared_)).cwiseMin(std::sqrt(max_squared_));
}

}  // namespace odmc
