#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/rotor_map.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/battery.h"
#include "odmc/sim/disturbance.h"
#include "odmc/sim/ground_contact.h"
#include "odmc/sim/hanging_load.h"
#include "odmc/sim/motor_drive.h"
#include "odmc/sim/rigid_body.h"
#include "odmc/sim/sensor_suite.h"
#include "odmc/sim/truth_sample.h"
#include "odmc/sim/turbulence.h"
#include "odmc/sim/world_options.h"

namespace odmc {

/// A vehicle in its world, in lock-step with whoever flies it: told rotor speeds or, where it has
/// an actuator, throttles, it moves on by one step at a time and gives what its sensors deliver.
/// The same arguments and calls give the same flight, and no sensor's errors hang on another's.
/// Step() asks for no memory as long as samples are taken about once a second. Thread-compatible.
class World {
 public:
  /// @param model the truth; must outlive the world
  /// @param values of its parameters, model.num_parameters()×1
  /// @throws std::invalid_argument for options or values that are not valid, and for a model whose
  ///   rotors do not carry it
  World(const DynamicModel& model, const ModelValues& values, const WorldOptions& options,
        int seed);

  /// Speeds to follow until the next command (n×1, rad/s), within what the motors can: 0 stops a
  /// rotor, others are kept between idling and max_rotor_speed(). A vehicle with an actuator gets
  /// the throttles that hold them at the present voltage.
  /// @throws std::invalid_argument for a wrong size or numbers that are not finite
  void Command(const RotorVector& speed_cmd);

  /// Throttles until the next command (n×1), limited to 0 to 1. Each acts after its motor's delay,
  /// at the battery's voltage of every later instant.
  /// @throws std::invalid_argument for a wrong size, numbers that are not finite and a vehicle
  ///   without an actuator
  void CommandThrottle(const RotorVector& throttle);
  /// Whether the vehicle takes throttles.
  bool has_actuator() const { return drive_.has_value(); }

  /// Moves on by one step.
  void Step();

  /// Puts the vehicle somewhere else, at rest, its rotors steady at `rotor_speed` (n×1, rad/s) and
  /// told to stay so. A load on a cable swings on as it was.
  /// @throws std::invalid_argument for a wrong size or numbers that are not finite
  void Put(const Eigen::Vector3d& p_WB, const Eigen::Quaterniond& q_WB,
           const RotorVector& rotor_speed);

  /// From now on this wrench acts, too, asked once per step at its start.
  void SetUnmodelled(const Unmodelled& wrench);

  Stamp now() const { return now_; }

  /// What is so now, just after whatever steps now. The wrench is about the centre of mass of all
  /// that flies; ground, disturbance, damage and what is unmodelled are external. The command is as
  /// limited; with an actuator it is the speeds that the throttles which act now hold.
  TruthSample Truth() const;

  /// Where the vehicle is and how it moves.
  const RigidBodyState& state() const { return state_; }

  /// What arrived since the last call, in the order of arrival; of one instant, odometry last. The
  /// sensors see an instant when it is asked for, or when it is over.
  std::vector<Sample> TakeSamples() {
    Sense();
    return sensors_.Take();
  }

  bool touches_ground() const { return ground_.touches(); }
  /// At the present voltage; infinite where nothing limits it [rad/s].
  double max_rotor_speed() const;
  double idle_rotor_speed() const { return idle_speed_; }  ///< [rad/s]
  double battery_voltage_V() const { return battery_.voltage_V(); }
  /// Mean wind, gusts and the model's own wind, in W [m/s].
  const Eigen::Vector3d& wind_W() const { return body_.properties().wind_W; }
  double mass() const { return body_.properties().mass; }  ///< payload included [kg]
  /// Payload, shift and wind included.
  const BodyProperties& properties() const { return body_.properties(); }
  const WorldOptions& options() const { return options_; }

  /// Speeds that balance the vehicle as it is now, payload and damage included, at rest in still
  /// air (n×1, rad/s).
  RotorVector HoverSpeeds() const;

  /// Fixes a point mass at `p_B` (from Bo, in B [m]), in place of one that is there already.
  /// @throws std::invalid_argument unless mass > 0 and both are finite
  void AttachPayload(double mass_kg, const Eigen::Vector3d& p_B);
  void DropPayload();
  /// Adds to earlier shifts; the inertia about the centre of mass stays.
  void ShiftCentreOfGravity(const Eigen::Vector3d& by_m);
  /// From now on the rotor gives 1 - share of its thrust and reaction torque.
  /// @param rotor from 0  @param share 0 to 1, else std::invalid_argument for both
  void DamagePropeller(int rotor, double share);
  /// New propellers.
  void Repair();
  /// Adds to earlier jumps.
  void JumpOdometry(const Eigen::Vector3d& by_m);
  void SetWind(const Eigen::Vector3d& mean_W);

 private:
  void CheckCommand(const RotorVector& command, const std::string& what) const;
  void Start();
  void ChangeBody(const BodyChange& change);
  bool HasSchedule() const;
  void RunSchedule(Stamp before);
  void BlowWind();
  double MaxSpeed() const;
  void LimitCommand();
  double PowerOfRotors() const;
  BodyWrench DamageWrench() const;
  BodyWrench External() const;
  void Surround();
  void Sense();

  WorldOptions options_;
  ModelValues values_;
  RigidBody body_;
  RotorMap map_;  // about the present centre of mass
  double full_speed_ = 0.0, idle_speed_ = 0.0;
  double max_speed_ = 0.0;  // to which command_ is limited, without an actuator
  Battery battery_;
  std::optional<MotorDrive> drive_;  // of a vehicle with an actuator
  Turbulence turbulence_;
  Disturbance disturbance_;
  VaryingParameters variation_;
  HangingLoad load_;
  GroundContact ground_;
  SensorSuite sensors_;
  RotorVector lost_;  // share of each rotor's thrust that damage took
  bool is_damaged_ = false;
  Eigen::Vector3d mean_wind_W_;
  bool has_schedule_;
  Unmodelled unmodelled_;

  long steps_ = 0;
  Stamp now_ = 0;
  bool sensed_ = false;               // the present instant
  std::optional<TruthSample> truth_;  // of the present instant, where a sensor asked for it
  RigidBodyState state_;
  RotorVector asked_, command_;  // as told (without an actuator), as limited
  BodyWrench external_;          // at the present state, but for what is unmodelled
};

}  // namespace odmc
