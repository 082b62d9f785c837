#include "odmc/sim/tracking_controller.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "odmc/math/so3.h"
#include "odmc/trajectory/flatness.h"

namespace odmc {
namespace {

// Gains in accelerations: poles near 3 rad/s (position) and 12 rad/s (attitude).
constexpr double kPosition = 9.0;    // [1/s²]
constexpr double kVelocity = 5.0;    // [1/s]
constexpr double kAttitude = 150.0;  // [1/s²]
constexpr double kRate = 25.0;       // [1/s]
// A speed controller drives each motor past its goal, which makes it this much faster.
constexpr double kMotorLead = 2.5;
// Rotors that speed up push the body at once, before their torque has changed: as much of the rate
// gain times this push as a loop of kMotorLead and the control period bears.
constexpr double kMostReaction = 2.0;
constexpr double kMaxThrustOverHover = 3.5;
constexpr double kMinThrustOverHover = 0.02;
// Keeps the ratio of the air's force to speed finite at rest [m²/s²].
constexpr double kStillAir = 0.1;

}  // namespace

TrackingController::TrackingController(const RigidBody& body, double bandwidth)
    : body_(&body),
      map_(RotorMapAtRest(body.model(), body.values(), body.properties())),
      bandwidth_(bandwidth) {
  // The torque rows are scaled so that the rank does not hang on units.
  const double length = body.model().vehicle().ArmLength();
  const Rows scale(1.0, 1.0 / length, 1.0 / length, 1.0 / (0.1 * length));
  const Eigen::MatrixXd scaled = scale.asDiagonal() * Eigen::MatrixXd(map_);
  inverse_ = scaled.completeOrthogonalDecomposition().pseudoInverse() * scale.asDiagonal();

  const BodyProperties& properties = body.properties();
  const double hover_squared = properties.mass * properties.g_W.norm() / map_.row(0).sum();
  yaw_share_ = YawShare(std::sqrt(hover_squared));
  min_squared_ = kMinThrustOverHover * hover_squared;
  max_squared_ = kMaxThrustOverHover * hover_squared;
}

double TrackingController::YawShare(double hover_speed) const {
  const DynamicModel& model = body_->model();
  const int n = model.vehicle().num_rotors();
  FlightState still;
  still.rotors = RotorState::Steady(RotorVector::Constant(n, hover_speed));
  FlightState turning = still;
  for (int j = 0; j < n; ++j) {
    turning.rotors.acceleration[j] = model.vehicle().rotors[j].spin;
    turning.rotors.speed_squared_rate[j] = 2.0 * hover_speed * model.vehicle().rotors[j].spin;
  }
  Eigen::Vector3d f_B, tau_still, tau_turning;
  const Eigen::Vector3d& p_BBcm = body_->properties().p_BBcm;
  model.EvaluateRateEffects(still, body_->values(), p_BBcm, &f_B, &tau_still);
  model.EvaluateRateEffects(turning, body_->values(), p_BBcm, &f_B, &tau_turning);
  const double at_once = std::abs(tau_turning.z() - tau_still.z());         // [N m s²]
  const double lasting = 2.0 * hover_speed * map_.row(3).cwiseAbs().sum();  // [N m s]
  return lasting > 0.0 ? std::min(1.0, kMostReaction * lasting /
                                           (bandwidth_ * kRate * std::max(at_once, 1e-12)))
                       : 1.0;
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
  goal.a_WB += bandwidth_ * bandwidth_ * kPosition * (reference.p_WB - state.p_WB) +
               bandwidth_ * kVelocity * (reference.v_WB - state.v_WB) - air_W;
  goal.j_WB -= drag * reference.a_WB;
  goal.s_WB -= drag * reference.j_WB;
  const FlatAttitude desired = FlatAttitudeOf(goal, properties.g_W);
  const Eigen::Quaterniond q_BD = state.q_WB.conjugate() * desired.q_WB;
  const double thrust = properties.mass * desired.specific_thrust * q_BD.toRotationMatrix()(2, 2);

  const Eigen::Vector3d& w = state.w_WB_B;
  Eigen::Vector3d attitude_error = Log(q_BD), rate_error = q_BD * desired.w_WB_B - w;
  attitude_error.z() *= yaw_share_ * yaw_share_;  // as damped as before
  rate_error.z() *= yaw_share_;
  const Eigen::Vector3d dw_WB_B =
      bandwidth_ * (bandwidth_ * kAttitude * attitude_error + kRate * rate_error) +
      q_BD * desired.dw_WB_B;
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
