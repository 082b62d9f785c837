#include "odmc/sim/rigid_body.h"

#include <cmath>

namespace odmc {
namespace {

RigidBodyRate operator+(const RigidBodyRate& a, const RigidBodyRate& b) {
  return {a.d_p_WB + b.d_p_WB, a.d_q_WB + b.d_q_WB, a.d_v_WB + b.d_v_WB, a.d_w_WB_B + b.d_w_WB_B};
}

RigidBodyRate operator*(double k, const RigidBodyRate& a) {
  return {k * a.d_p_WB, k * a.d_q_WB, k * a.d_v_WB, k * a.d_w_WB_B};
}

// Moves along `rate` for `dt`; the rotors are set by the caller. Quaternions stay as they come, so
// that the stages of one step keep their order.
RigidBodyState Along(const RigidBodyState& state, const RigidBodyRate& rate, double dt) {
  RigidBodyState moved;
  moved.p_WB = state.p_WB + dt * rate.d_p_WB;
  moved.q_WB.coeffs() = state.q_WB.coeffs() + dt * rate.d_q_WB;
  moved.v_WB = state.v_WB + dt * rate.d_v_WB;
  moved.w_WB_B = state.w_WB_B + dt * rate.d_w_WB_B;
  moved.load_pull_W = state.load_pull_W;
  return moved;
}

// Parallel axes: inertia of both masses about their common centre.
void AddPointMass(double mass, const Eigen::Vector3d& p_B, BodyProperties* body) {
  const double total = body->mass + mass;
  const Eigen::Vector3d r_B = p_B - body->p_BBcm;
  body->I_BBcm_B += body->mass * mass / total *
                    (r_B.squaredNorm() * Eigen::Matrix3d::Identity() - r_B * r_B.transpose());
  body->p_BBcm += mass / total * r_B;
  body->mass = total;
}

}  // namespace

MotorLag MotorLag::Of(const Actuator& actuator, int num_rotors) {
  MotorLag lag;
  for (int j = 0; j < num_rotors; ++j) lag.motors.push_back(actuator.MotorOf(j).dynamics);
  return lag;
}

RotorVector MotorLag::After(const RotorVector& speed, const RotorVector& speed_cmd,
                            double dt) const {
  if (S2 <= 0.0 && motors.empty())
    return speed_cmd + std::exp(-dt / time_constant_s) * (speed - speed_cmd);
  RotorVector after(speed.size());
  for (int j = 0; j < speed.size(); ++j) {
    const auto [s1, s2] = DynamicsOf(j);
    after[j] = MotorSpeedAfter(speed[j], speed_cmd[j], s1, s2, dt);
  }
  return after;
}

RotorState MotorLag::At(const RotorVector& speed, const RotorVector& speed_cmd) const {
  RotorState state = RotorState::Steady(speed);
  if (S2 > 0.0 || !motors.empty()) {
    for (int j = 0; j < speed.size(); ++j) {
      const auto [s1, s2] = DynamicsOf(j);
      state.acceleration[j] = MotorSpeedRate(speed[j], speed_cmd[j], s1, s2);
    }
  } else {
    state.acceleration = (speed_cmd - speed) / time_constant_s;
  }
  state.speed_squared_rate = 2.0 * speed.cwiseProduct(state.acceleration);
  return state;
}

RigidBody::RigidBody(const DynamicModel& model, const ModelValues& values, const MotorLag& motor)
    : model_(&model), values_(values), motor_(motor) {
  Shape();
}

void RigidBody::Vary(const ModelValues& values, double time_s) {
  values_ = values;
  time_s_ = time_s;
  Shape();
}

void RigidBody::Change(const BodyChange& change) {
  change_ = change;
  Shape();
}

void RigidBody::SetExtraWind(const Eigen::Vector3d& wind_W) {
  extra_wind_W_ = wind_W;
  properties_.wind_W = model_wind_W_ + extra_wind_W_;
}

void RigidBody::Shape() {
  properties_ = model_->Properties(values_, nullptr, time_s_);
  model_wind_W_ = properties_.wind_W;
  properties_.wind_W += extra_wind_W_;
  properties_.p_BBcm += change_.cog_shift_B;
  p_BA_ = properties_.p_BBcm;
  if (change_.payload_kg > 0.0) AddPointMass(change_.payload_kg, change_.payload_p_B, &properties_);
  I_inverse_ = properties_.I_BBcm_B.inverse();
}

FlightState RigidBody::FlightStateOf(double time_s, const RigidBodyState& state,
                                     const RotorVector& speed_cmd) const {
  FlightState flight;
  flight.time_s = time_s;
  flight.R_WB = state.q_WB.normalized().toRotationMatrix();
  flight.p_WB = state.p_WB;
  flight.v_AB_B = flight.R_WB.transpose() * (state.v_WB - properties_.wind_W);
  flight.w_WB_B = state.w_WB_B;
  flight.rotors = motor_.At(state.rotor_speed, speed_cmd);
  flight.load.pull_W = state.load_pull_W;
  return flight;
}

BodyWrench RigidBody::WrenchOf(const FlightState& state) const {
  BodyWrench wrench;
  model_->EvaluateWrench(state, values_, p_BA_, &wrench.f_B, &wrench.tau_Bcm_B);
  if (change_.payload_kg > 0.0) {
    wrench.tau_Bcm_B += (p_BA_ - properties_.p_BBcm).cross(wrench.f_B);
  }
  return wrench;
}

RigidBodyRate RigidBody::RateOf(const RigidBodyState& state, const BodyWrench& wrench) const {
  const Eigen::Vector3d& w = state.w_WB_B;
  const Eigen::Vector3d& p_BBcm = properties_.p_BBcm;
  const Eigen::Matrix3d R_WB = state.q_WB.normalized().toRotationMatrix();

  RigidBodyRate rate;
  rate.d_p_WB = state.v_WB;
  rate.d_q_WB = 0.5 * (state.q_WB * Eigen::Quaterniond(0.0, w.x(), w.y(), w.z())).coeffs();
  rate.d_w_WB_B = I_inverse_ * (wrench.tau_Bcm_B - w.cross(properties_.I_BBcm_B * w));
  const Eigen::Vector3d lever_B = rate.d_w_WB_B.cross(p_BBcm) + w.cross(w.cross(p_BBcm));
  rate.d_v_WB = properties_.g_W + R_WB * (wrench.f_B / properties_.mass - lever_B);
  return rate;
}

RigidBodyState RigidBody::Step(double time_s, const RigidBodyState& state,
                               const RotorVector& speed_cmd, const BodyWrench& external,
                               double step_s) const {
  const auto rate_at = [&](double dt, const RigidBodyState& stage) {
    return RateOf(stage, WrenchOf(FlightStateOf(time_s + dt, stage, speed_cmd)) + external);
  };
  const double half = 0.5 * step_s;
  const RotorVector middle_speed = motor_.After(state.rotor_speed, speed_cmd, half);
  const RotorVector end_speed = motor_.After(state.rotor_speed, speed_cmd, step_s);

  const RigidBodyRate k1 = rate_at(0.0, state);
  RigidBodyState stage = Along(state, k1, half);
  stage.rotor_speed = middle_speed;
  const RigidBodyRate k2 = rate_at(half, stage);
  stage = Along(state, k2, half);
  stage.rotor_speed = middle_speed;
  const RigidBodyRate k3 = rate_at(half, stage);
  stage = Along(state, k3, step_s);
  stage.rotor_speed = end_speed;
  const RigidBodyRate k4 = rate_at(step_s, stage);

  RigidBodyState end = Along(state, k1 + 2.0 * k2 + 2.0 * k3 + k4, step_s / 6.0);
  end.q_WB.normalize();
  end.rotor_speed = end_speed;
  return end;
}

}  // namespace odmc
