#include "odmc/sim/world.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "odmc/math/rotation_between.h"

namespace odmc {
namespace {

constexpr double kMotorEfficiency = 0.6;
constexpr double kLeastAirspeed_m_s = 1.0;  // keeps turbulence alive in still air

WorldOptions Checked(const WorldOptions& options, const DynamicModel& model) {
  std::string error;
  if (!options.IsValid(&error)) throw std::invalid_argument(error);
  if (options.damage_rotor > model.vehicle().num_rotors()) {
    throw std::invalid_argument("damage_rotor must be 1 to " +
                                std::to_string(model.vehicle().num_rotors()));
  }
  return options;
}

const ModelValues& Checked(const ModelValues& values, const DynamicModel& model) {
  if (values.size() == model.num_parameters() && values.allFinite()) return values;
  throw std::invalid_argument("the true values must be one finite number per model parameter");
}

void CheckFinite(const Eigen::Vector3d& vector, const std::string& what) {
  if (!vector.allFinite()) throw std::invalid_argument(what + " must be finite");
}

// Squared speed at which all rotors together carry the vehicle [rad²/s²].
double HoverSquared(const RotorMap& map, const BodyProperties& body) {
  const double thrust = map.row(0).sum();
  if (thrust > 0.0) return body.mass * body.g_W.norm() / thrust;
  throw std::invalid_argument("the rotors of the true model do not push up");
}

// The same axes as the mean wind's level part, z up; those of W where there is none.
Eigen::Matrix3d WindAxes(const Eigen::Vector3d& wind_W) {
  const double speed = wind_W.head<2>().norm();
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
  if (speed > 0.0) {
    const Eigen::Vector2d along = wind_W.head<2>() / speed;
    axes.topLeftCorner<2, 2>() << along.x(), -along.y(), along.y(), along.x();
  }
  return axes;
}

// Motors of the vehicle's actuator, or those of the options.
MotorLag MotorsOf(const Vehicle& vehicle, const WorldOptions& options) {
  if (vehicle.actuator) return MotorLag::Of(*vehicle.actuator, vehicle.num_rotors());
  return {options.motor_time_constant_s, options.motor_S1, options.motor_S2};
}

std::optional<MotorDrive> DriveOf(const Vehicle& vehicle) {
  if (!vehicle.actuator) return std::nullopt;
  return MotorDrive(*vehicle.actuator, vehicle.num_rotors());
}

// Speed a motor settles at on a voltage: S0 v = S1 Omega + S2 Omega².      model.md section 11
double SteadySpeed(const WorldOptions& options, double voltage_V) {
  const double s1 = options.motor_S1, s2 = options.motor_S2;
  const double drive = options.motor_S0 * voltage_V;
  return 2.0 * drive / (s1 + std::sqrt(s1 * s1 + 4.0 * s2 * drive));
}

}  // namespace

World::World(const DynamicModel& model, const ModelValues& values, const WorldOptions& options,
             int seed)
    : options_(Checked(options, model)),
      values_(Checked(values, model)),
      body_(model, values_, MotorsOf(model.vehicle(), options)),
      map_(RotorMapAtRest(model, values_, body_.properties())),
      battery_(options.battery_full_V, options.battery_empty_V, options.battery_capacity_As,
               options.battery_resistance_ohm, options.battery_slope_V_s),
      drive_(DriveOf(model.vehicle())),
      turbulence_(options.gust_m_s, options.gust_length_m, seed),
      disturbance_(model.vehicle(), options.disturbance_force_N, options.disturbance_torque_Nm,
                   seed),
      variation_(model, values_, seed),
      load_(model, values_),
      ground_(model.vehicle(), body_.properties(),
              {options.leg_height_m, options.ground_static_sink_m, options.ground_damping_ratio,
               options.ground_friction}),
      sensors_(options_, seed),
      lost_(RotorVector::Zero(model.vehicle().num_rotors())),
      mean_wind_W_(options.wind_m_s),
      has_schedule_(HasSchedule()) {
  const double hover_squared = HoverSquared(map_, body_.properties());
  full_speed_ = std::sqrt(options_.max_thrust_over_weight * hover_squared);
  idle_speed_ = options_.idle_speed_share * std::sqrt(hover_squared);
  Start();
}

// Standing, or hovering with body z against gravity.
void World::Start() {
  BlowWind();
  if (options_.start_height_m > 0.0) {
    const Eigen::Quaterniond q_WB =
        RotationBetween(Eigen::Vector3d::UnitZ(), -body_.properties().g_W);
    Put({0.0, 0.0, options_.start_height_m}, q_WB, HoverSpeeds());
  } else {
    Put(Eigen::Vector3d::Zero(), Eigen::Quaterniond::Identity(), RotorVector::Zero(lost_.size()));
  }
}

void World::Put(const Eigen::Vector3d& p_WB, const Eigen::Quaterniond& q_WB,
                const RotorVector& rotor_speed) {
  CheckCommand(rotor_speed, "speed");
  CheckFinite(p_WB, "the place of the vehicle");
  CheckFinite(q_WB.vec(), "the attitude of the vehicle");
  const Eigen::Vector3d load_pull_W = state_.load_pull_W;
  state_ = RigidBodyState();
  state_.p_WB = p_WB;
  state_.q_WB = q_WB;
  state_.rotor_speed = asked_ = rotor_speed;
  state_.load_pull_W = load_pull_W;
  if (drive_) drive_->Start(drive_->ThrottleFor(asked_, battery_.voltage_V()));
  LimitCommand();
  ground_.LetGo();
  Surround();
}

RotorVector World::HoverSpeeds() const {
  const BodyProperties& body = body_.properties();
  const RotorVector left = RotorVector::Ones(lost_.size()) - lost_;
  Eigen::MatrixXd map = map_ * left.asDiagonal();
  // Rows of one size, so that the rank does not hang on units.
  const Eigen::Vector4d scale = map.rowwise().norm().cwiseMax(1e-300).cwiseInverse();
  const Eigen::Vector4d lift(body.mass * body.g_W.norm(), 0.0, 0.0, 0.0);
  map = scale.asDiagonal() * map;
  const RotorVector squared = map.completeOrthogonalDecomposition().solve(scale.cwiseProduct(lift));
  return squared.cwiseMax(0.0).cwiseSqrt();
}

void World::CheckCommand(const RotorVector& command, const std::string& what) const {
  if (command.size() == lost_.size() && command.allFinite()) return;
  throw std::invalid_argument("a command must be one finite " + what + " for each of " +
                              std::to_string(lost_.size()) + " rotors");
}

void World::Command(const RotorVector& speed_cmd) {
  CheckCommand(speed_cmd, "speed");
  asked_ = speed_cmd;
  if (drive_) {
    RotorVector speed = asked_.cwiseMax(idle_speed_);
    for (int j = 0; j < speed.size(); ++j) {
      if (asked_[j] <= 0.0) speed[j] = 0.0;
    }
    CommandThrottle(drive_->ThrottleFor(speed, battery_.voltage_V()));
  }
  LimitCommand();
}

void World::CommandThrottle(const RotorVector& throttle) {
  CheckCommand(throttle, "throttle");
  if (!drive_) throw std::invalid_argument("the vehicle has no actuator to take throttles");
  drive_->Command(ToSeconds(now_), throttle);
  sensors_.CommandCame();
  LimitCommand();
}

// What limits rotors without an actuator.
double World::MaxSpeed() const {
  const double voltage_V = battery_.voltage_V();
  double max_speed = std::numeric_limits<double>::infinity();
  if (options_.max_thrust_over_weight > 0.0) {
    const double full_V = options_.battery_full_V;
    max_speed = full_V > 0.0 ? full_speed_ * voltage_V / full_V : 0.0;
  }
  if (options_.motor_S0 > 0.0 && options_.motor_S2 > 0.0)
    max_speed = std::min(max_speed, SteadySpeed(options_, voltage_V));
  return max_speed;
}

double World::max_rotor_speed() const {
  return drive_ ? drive_->MaxSpeed(battery_.voltage_V()) : max_speed_;
}

void World::LimitCommand() {
  truth_.reset();
  if (drive_) {
    command_ = drive_->SteadySpeeds(battery_.voltage_V());
    return;
  }
  max_speed_ = MaxSpeed();
  command_ = asked_.cwiseMax(idle_speed_).cwiseMin(max_speed_);
  for (int j = 0; j < asked_.size(); ++j) {
    if (asked_[j] <= 0.0) command_[j] = 0.0;
  }
}

void World::Step() {
  Sense();
  const double time_s = ToSeconds(now_), step_s = options_.step_s;
  if (drive_) sensors_.SenseCommands(now_, drive_->throttle());
  const BodyWrench external = External();
  load_.Swing(body_, time_s, command_, external, step_s, &state_);
  const auto move = [&](double at_s, const RotorVector& speed_cmd, double piece_s) {
    state_ = body_.Step(at_s, state_, speed_cmd, external, piece_s);
  };
  if (drive_) {
    drive_->Advance(time_s, step_s, battery_.voltage_V(), move);
  } else {
    move(time_s, command_, step_s);
  }
  const Stamp before = now_;
  now_ = FromSeconds(static_cast<double>(++steps_) * step_s);
  sensed_ = false;
  battery_.Draw(PowerOfRotors(), ToSeconds(now_), step_s);
  if (options_.gust_m_s > 0.0) {
    const double airspeed = (mean_wind_W_ - state_.v_WB).norm();
    turbulence_.Advance(std::max(airspeed, kLeastAirspeed_m_s), step_s);
    BlowWind();
  }
  if (has_schedule_) RunSchedule(before);
  Surround();
}

void World::SetUnmodelled(const Unmodelled& wrench) {
  truth_.reset();
  unmodelled_ = wrench;
}

// What battery and air bring about at the present state.
void World::Surround() {
  truth_.reset();
  const double time_s = ToSeconds(now_);
  variation_.Apply(time_s, &body_);
  if (drive_ || MaxSpeed() != max_speed_) LimitCommand();
  external_ = disturbance_.At(time_s);
  if (options_.ground) external_ = ground_.Push(state_, body_.properties().p_BBcm) + external_;
  if (is_damaged_) external_ = external_ + DamageWrench();
}

// On top of what the model makes. What is unmodelled may hang on the newest command.
BodyWrench World::External() const {
  if (!unmodelled_) return external_;
  return external_ + unmodelled_(body_.FlightStateOf(ToSeconds(now_), state_, command_));
}

void World::BlowWind() {
  body_.SetExtraWind(mean_wind_W_ + WindAxes(mean_wind_W_) * turbulence_.velocity());
}

// Electrical power that the reaction torques at these speeds ask for [W].
double World::PowerOfRotors() const {
  double power = 0.0;
  for (int j = 0; j < lost_.size(); ++j) {
    const double speed = state_.rotor_speed[j];
    power += (1.0 - lost_[j]) * std::abs(map_(3, j)) * speed * speed * speed;
  }
  return power / kMotorEfficiency;
}

// Takes back what damaged propellers do not give.
BodyWrench World::DamageWrench() const {
  const RotorVector lost_squared = lost_.cwiseProduct(state_.rotor_speed.cwiseAbs2());
  const Eigen::Vector4d rows = map_ * lost_squared;
  return {{0.0, 0.0, -rows[0]}, -rows.tail<3>()};
}

void World::Sense() {
  if (sensed_) return;
  sensed_ = true;
  sensors_.Sense(now_, state_, body_.properties(), battery_.voltage_V(), [this] {
    truth_ = Truth();
    return *truth_;
  });
}

TruthSample World::Truth() const {
  if (truth_) return *truth_;
  TruthSample truth = TruthOf(body_, now_, state_, command_, External());
  truth.on_ground = touches_ground();
  return truth;
}

bool World::HasSchedule() const {
  const WorldOptions& o = options_;
  return o.payload_attach_at_s + o.payload_drop_at_s + o.cog_shift_at_s + o.damage_at_s +
             o.jump_at_s >
         0.0;
}

void World::RunSchedule(Stamp before) {
  const auto is_due = [&](double time_s) {
    const Stamp stamp = FromSeconds(time_s);
    return stamp > before && stamp <= now_;
  };
  const WorldOptions& o = options_;
  if (is_due(o.payload_attach_at_s)) AttachPayload(o.payload_kg, o.payload_p_B_m);
  if (is_due(o.payload_drop_at_s)) DropPayload();
  if (is_due(o.cog_shift_at_s)) ShiftCentreOfGravity(o.cog_shift_m);
  if (is_due(o.damage_at_s)) DamagePropeller(o.damage_rotor - 1, o.damage_share);
  if (is_due(o.jump_at_s)) JumpOdometry(o.jump_m);
}

void World::ChangeBody(const BodyChange& change) {
  body_.Change(change);
  map_ = RotorMapAtRest(body_.model(), values_, body_.properties());
  Surround();
}

void World::AttachPayload(double mass_kg, const Eigen::Vector3d& p_B) {
  if (!(mass_kg > 0.0) || !std::isfinite(mass_kg)) {
    throw std::invalid_argument("a payload must have a positive mass");
  }
  CheckFinite(p_B, "the place of a payload");
  BodyChange change = body_.change();
  change.payload_kg = mass_kg;
  change.payload_p_B = p_B;
  ChangeBody(change);
}

void World::DropPayload() {
  BodyChange change = body_.change();
  change.payload_kg = 0.0;
  ChangeBody(change);
}

void World::ShiftCentreOfGravity(const Eigen::Vector3d& by_m) {
  CheckFinite(by_m, "a shift of the centre of gravity");
  BodyChange change = body_.change();
  change.cog_shift_B += by_m;
  ChangeBody(change);
}

void World::DamagePropeller(int rotor, double share) {
  if (rotor < 0 || rotor >= lost_.size()) {
    throw std::invalid_argument("there is no rotor " + std::to_string(rotor));
  }
  if (!(share >= 0.0 && share <= 1.0)) {
    throw std::invalid_argument("the share a propeller loses must be 0 to 1");
  }
  lost_[rotor] = share;
  is_damaged_ = true;
  Surround();
}

void World::Repair() {
  lost_.setZero();
  is_damaged_ = false;
  Surround();
}

void World::JumpOdometry(const Eigen::Vector3d& by_m) {
  CheckFinite(by_m, "a jump of the odometry");
  sensors_.Jump(by_m);
}

void World::SetWind(const Eigen::Vector3d& mean_W) {
  CheckFinite(mean_W, "the wind");
  mean_wind_W_ = mean_W;
  BlowWind();
  Surround();
}

}  // namespace odmc
