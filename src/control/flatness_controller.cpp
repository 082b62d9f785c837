#include "odmc/control/flatness_controller.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/control/flat_inputs.h"
#include "odmc/math/rotation_between.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

constexpr double kFresh_s = 0.05;  // older rates or rotor speeds are not used any more
const Eigen::Vector3d kUp = Eigen::Vector3d::UnitZ();

// Level, with the heading of `q_WB`, along the vertical of `g_W`.
Eigen::Quaterniond Levelled(const Eigen::Quaterniond& q_WB, const Eigen::Vector3d& g_W) {
  const Eigen::Vector3d z_B = q_WB * kUp;
  return RotationBetween(z_B, -g_W) * q_WB;
}

// Body state from a pose and a twist of the sensor's frame.                   model.md section 1
BodyState ToBody(const OdometrySample& sample, const BodyProperties& properties) {
  BodyState state;
  state.stamp = sample.stamp;
  state.q_WB = sample.q_WS * Eigen::Quaterniond(properties.R_BS).conjugate();
  state.p_WB = sample.p_WS - state.q_WB * properties.p_BS;
  if (sample.w_WS_S) state.w_WB_B = properties.R_BS * *sample.w_WS_S;
  const Eigen::Vector3d lever_B = state.w_WB_B.cross(properties.p_BS);
  if (sample.v_WS) state.v_WB = *sample.v_WS - state.q_WB * lever_B;
  return state;
}

}  // namespace

const char* NameOf(ControlMode mode) {
  switch (mode) {
    case ControlMode::kIdle:
      return "idle";
    case ControlMode::kTracking:
      return "tracking";
    case ControlMode::kFailsafe:
      return "failsafe";
  }
  return "";
}

FlatnessController::FlatnessController(const ControllerOptions& options,
                                       std::shared_ptr<const DynamicModel> model)
    : options_(options),
      gains_(GainsFor(options)),
      model_(model, options.compensation),
      dynamics_(std::move(model)),
      predictor_(options.correction_time_s),
      rate_filter_(options.filter_hz),
      torque_filter_(options.filter_hz) {
  std::string error;
  if (!options_.IsValid(&error)) throw std::invalid_argument(error);
  const Vehicle& vehicle = dynamics_->vehicle();
  if (vehicle.actuator && !vehicle.actuator->Fits(vehicle.num_rotors()))
    throw std::invalid_argument("the actuator's motors are not as many as the vehicle's rotors");
  const BodyProperties& properties = model_.properties();
  const double hover = properties.mass * properties.g_W.norm() / model_.rotor_map().row(0).sum();
  const double limit = options_.max_rotor_speed_rad_s;
  max_squared_ = limit > 0.0 ? limit * limit : options_.max_thrust_over_weight * hover;
  min_squared_ = options_.min_thrust_over_weight * hover;
  BuildAllocation();
}

void FlatnessController::BuildAllocation() {
  allocation_.emplace(model_.rotor_map(), dynamics_->vehicle().ArmLength(), min_squared_,
                      max_squared_);
}

void FlatnessController::SetModel(std::shared_ptr<const DynamicModel> model,
                                  const ModelValues& values) {
  if (model != dynamics_) {
    dynamics_ = std::move(model);
    model_ = ControlModel(dynamics_, options_.compensation);
  }
  model_.SetValues(values);
  BuildAllocation();
}

void FlatnessController::Add(const OdometrySample& sample) {
  const BodyState state = ToBody(sample, model_.properties());
  odometry_rates_ = state.w_WB_B;
  if (!predictor_.Correct(state, model_.properties().g_W)) ++jumps_;
}

void FlatnessController::Add(const ImuSample& sample) {
  if (!sample.gyro_I) return;
  imu_ = sample;
  if (!sample.specific_force_I) return;
  // At the IMU to at Bo, along B.
  const BodyProperties& properties = model_.properties();
  InertialSample inertial;
  inertial.stamp = sample.stamp;
  inertial.w_WB_B = properties.R_BI * *sample.gyro_I;
  const Eigen::Vector3d& w = inertial.w_WB_B;
  const Eigen::Vector3d lever_B =
      rate_filter_.derivative().cross(properties.p_BI) + w.cross(w.cross(properties.p_BI));
  inertial.specific_force_B = properties.R_BI * *sample.specific_force_I - lever_B;
  predictor_.Add(inertial);
}

void FlatnessController::Add(const RotorSample& sample) { rotors_ = sample; }

void FlatnessController::Add(const BatterySample& sample) {
  if (std::isfinite(sample.voltage_V) && sample.voltage_V > 0.0) voltage_V_ = sample.voltage_V;
}

bool FlatnessController::HasRates(Stamp now) const {
  return imu_ && ToSeconds(now - imu_->stamp) < kFresh_s;
}

bool FlatnessController::HasRotors(Stamp now) const {
  return rotors_ && ToSeconds(now - rotors_->stamp) < kFresh_s;
}

Eigen::Vector3d FlatnessController::Rates(Stamp now) const {
  return HasRates(now) ? model_.properties().R_BI * *imu_->gyro_I : odometry_rates_;
}

RotorVector FlatnessController::RotorSpeeds() const {
  if (rotors_) return rotors_->speed;
  return RotorVector::Zero(dynamics_->vehicle().num_rotors());
}

// Without an accelerometer the model itself says how the body accelerates.
void FlatnessController::HoldInertial(Stamp now) {
  if (!HasRotors(now) || (HasRates(now) && imu_->specific_force_I)) return;
  const std::optional<BodyState> state = StateAt(now);
  if (!state) return;
  const Eigen::Vector3d w = Rates(now);
  const BodyWrench air =
      model_.AirWrench(state->p_WB, state->q_WB.toRotationMatrix(), state->v_WB, w, rotors_->speed);
  const double thrust = allocation_->WrenchOf(rotors_->speed.cwiseAbs2())[0];
  predictor_.Add({now, w, (thrust * kUp + air.f_B) / model_.properties().mass});
}

// Both at the same instants, so that both have the same phase.
void FlatnessController::Filter(Stamp now) {
  const double dt = last_update_ ? ToSeconds(now - *last_update_) : 0.0;
  last_update_ = now;
  if (!HasRates(now) || !HasRotors(now) || dt < 0.0) {
    rate_filter_.Reset();
    torque_filter_.Reset();
    return;
  }
  rate_filter_.Add(model_.properties().R_BI * *imu_->gyro_I, dt);
  torque_filter_.Add(allocation_->WrenchOf(rotors_->speed.cwiseAbs2()).tail<3>(), dt);
}

std::optional<BodyState> FlatnessController::StateAt(Stamp now) const {
  return predictor_.At(now, model_.properties().g_W);
}

void FlatnessController::Reset() {
  predictor_.Reset();
  rate_filter_.Reset();
  torque_filter_.Reset();
  imu_.reset();
  rotors_.reset();
  last_update_.reset();
}

Eigen::Vector3d FlatnessController::Limited(const Eigen::Vector3d& specific_thrust_W) const {
  const Eigen::Vector3d up = -model_.properties().g_W.normalized();
  Eigen::Vector3d t = specific_thrust_W;
  const Eigen::Vector3d sideways = t - t.dot(up) * up;
  // Tilts no further than allowed, and never turns over: what is missing is added upwards.
  const double least_up =
      std::max(sideways.norm() / std::tan(options_.max_tilt_rad),
               options_.min_thrust_over_weight * dynamics_->vehicle().gravity_m_s2);
  t += std::max(0.0, least_up - t.dot(up)) * up;
  return t;
}

// The acceleration rotors shall give, and its derivatives.         paper (22), model.md section 11
FlatReference FlatnessController::Goal(const FlatReference& reference,
                                       const BodyState& state) const {
  const BodyProperties& properties = model_.properties();
  const Eigen::Matrix3d R_WB = state.q_WB.toRotationMatrix();
  FlatReference goal = ReferenceWithoutAir(model_, reference);

  Eigen::Vector3d feedback = gains_.position_1_s2.cwiseProduct(reference.p_WB - state.p_WB) +
                             gains_.velocity_1_s.cwiseProduct(reference.v_WB - state.v_WB);
  feedback *= std::min(1.0, options_.max_feedback_m_s2 / std::max(feedback.norm(), 1e-9));

  const BodyWrench air =
      model_.AirWrench(state.p_WB, R_WB, state.v_WB, state.w_WB_B, RotorSpeeds());
  const Eigen::Vector3d& c = properties.p_BBcm;
  const Eigen::Vector3d& w = state.w_WB_B;
  const Eigen::Vector3d lever_B = rate_filter_.derivative().cross(c) + w.cross(w.cross(c));
  goal.a_WB = reference.a_WB + feedback - R_WB * (air.f_B / properties.mass - lever_B);
  goal.a_WB = Limited(goal.a_WB - properties.g_W) + properties.g_W;
  return goal;
}

Eigen::Vector3d FlatnessController::Torque(const Eigen::Vector3d& dw_WB_B, const BodyState& state,
                                           bool incremental) const {
  const BodyProperties& properties = model_.properties();
  const Eigen::Matrix3d& I = properties.I_BBcm_B;
  if (incremental) return torque_filter_.value() + I * (dw_WB_B - rate_filter_.derivative());
  const Eigen::Vector3d& w = state.w_WB_B;
  const BodyWrench air =
      model_.AirWrench(state.p_WB, state.q_WB.toRotationMatrix(), state.v_WB, w, RotorSpeeds());
  return I * dw_WB_B + w.cross(I * w) - air.tau_Bcm_B;
}

void FlatnessController::Track(const FlatReference& goal, const BodyState& state,
                               ControlCommand* command) const {
  const BodyProperties& properties = model_.properties();
  const FlatAttitude desired = FlatAttitudeOf(goal, properties.g_W);
  const Eigen::Quaterniond q_BD = state.q_WB.conjugate() * desired.q_WB;
  const double along_z = std::max(0.0, q_BD.toRotationMatrix()(2, 2));

  command->q_WB_cmd = desired.q_WB;
  command->collective_thrust_N = properties.mass * desired.specific_thrust * along_z;
  command->w_WB_B_cmd =
      gains_.attitude_1_s.cwiseProduct(Log(q_BD)) + q_BD * desired.w_WB_B;  // paper (23)
  const Eigen::Vector3d dw_WB_B =
      gains_.rate_1_s.cwiseProduct(command->w_WB_B_cmd - state.w_WB_B) + q_BD * desired.dw_WB_B;

  Eigen::Vector4d wrench;
  wrench << command->collective_thrust_N, Torque(dw_WB_B, state, command->indi);
  command->rotor_speed = allocation_->SquaredSpeeds(wrench, &command->allocation).cwiseSqrt();
}

void FlatnessController::Sink(const BodyState& state, ControlCommand* command) const {
  const BodyProperties& properties = model_.properties();
  FlatReference level;
  level.a_WB = options_.failsafe_sink_share * properties.g_W;
  const Eigen::Vector3d ahead = Levelled(state.q_WB, properties.g_W) * Eigen::Vector3d::UnitX();
  level.yaw = std::atan2(ahead.y(), ahead.x());
  Track(level, state, command);
}

RotorVector FlatnessController::Driven(const RotorVector& goal, Stamp now) const {
  if (!HasRotors(now)) return goal;
  const RotorVector driven = rotors_->speed + options_.motor_lead * (goal - rotors_->speed);
  return driven.cwiseMax(std::sqrt(min_squared_)).cwiseMin(std::sqrt(max_squared_));
}

// The goal itself, not Driven(): the lead is in the acceleration asked for.
RotorVector FlatnessController::Throttle(const RotorVector& goal, Stamp now) const {
  const std::optional<Actuator>& actuator = dynamics_->vehicle().actuator;
  if (!actuator) return {};
  const double voltage =
      actuator->MapVoltage(voltage_V_.value_or(options_.nominal_battery_voltage_V));
  const double lead_1_s = options_.motor_lead / options_.motor_time_constant_s;
  const bool approaches = actuator->knows_dynamics && HasRotors(now);
  const RotorVector speed = approaches ? rotors_->speed : Driven(goal, now);
  RotorVector throttle(goal.size());
  for (int j = 0; j < goal.size(); ++j) {
    const Motor& motor = actuator->MotorOf(j);
    const double acceleration = approaches ? lead_1_s * (goal[j] - speed[j]) : 0.0;
    const double drive = std::clamp(motor.dynamics.DriveFor(speed[j], acceleration),
                                    motor.dynamics.DriveFor(std::sqrt(min_squared_)),
                                    motor.dynamics.DriveFor(std::sqrt(max_squared_)));
    throttle[j] = std::clamp(motor.esc.ThrottleFor(drive, voltage), 0.0, 1.0);
  }
  return throttle;
}

ControlCommand FlatnessController::Update(Stamp now,
                                          const std::optional<FlatReference>& reference) {
  Filter(now);
  HoldInertial(now);
  ControlCommand command;
  command.stamp = now;
  command.rotor_speed =
      RotorVector::Constant(dynamics_->vehicle().num_rotors(), std::sqrt(min_squared_));
  command.throttle = Throttle(command.rotor_speed, now);
  std::optional<BodyState> state = StateAt(now);
  if (!state || !reference || reference->standing) return command;

  state->w_WB_B = Rates(now);
  command.indi = options_.indi && HasRates(now) && HasRotors(now);
  const double age_s = ToSeconds(now - predictor_.newest_odometry());
  command.mode =
      age_s > options_.max_odometry_age_s ? ControlMode::kFailsafe : ControlMode::kTracking;
  if (command.mode == ControlMode::kFailsafe) {
    Sink(*state, &command);
  } else {
    Track(Goal(*reference, *state), *state, &command);
  }
  command.throttle = Throttle(command.rotor_speed, now);
  command.rotor_speed = Driven(command.rotor_speed, now);
  return command;
}

}  // namespace odmc
