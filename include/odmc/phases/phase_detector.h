#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "odmc/phases/flight_phase.h"
#include "odmc/phases/phase_block.h"
#include "odmc/phases/phase_record.h"

namespace odmc {

/// Thresholds of PhaseDetector that a user may know better.
struct PhaseOptions {
  double take_off_height_m = 0.10;   ///< way from the stand that counts as flying
  double take_off_speed_m_s = 0.5;   ///< speed that counts as flying, with thrust
  double landed_thrust_ratio = 0.4;  ///< least thrust over weight that can carry, whatever k_f
  /// Height above the last stand below which flight teaches nothing; 0: it always does.
  double near_ground_m = 0.0;

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("take_off_height_m", &take_off_height_m);
    v->Field("take_off_speed_m_s", &take_off_speed_m_s);
    v->Field("landed_thrust_ratio", &landed_thrust_ratio);
    v->Field("near_ground_m", &near_ground_m);
  }
};

/// What to do about the newest interval.
struct PhaseVerdict {
  FlightPhase phase = FlightPhase::kFlying;
  std::optional<Stamp> take_back;  ///< what was learned from here on is to be taken back
  bool start_anew = false;         ///< all that was learned is
  bool has_changed = false;        ///< the vehicle flies on, but it is another one
};

/// Tells the phases of a flight, online and causally, from the force that the model cannot give,
/// motion, attitude and thrust.
///
/// The thrust coefficient is what tells flight from ground: standing at half thrust, something else
/// carries half of the weight. So there are two cases:
///
/// *The coefficient is known* (KnowThrust()). Means of the missing force over
/// blocks of 0.1 s are compared under two hypotheses, free flight (a Gaussian of the model's error,
/// thrust_sigma and the sensors' noise) and contact (any force up to about the weight; for a
/// vehicle that stands still, an upward one). Their log-likelihood ratio accumulates (Page's
/// CUSUM); beyond kAlarm_nats the vehicle is in contact, from where the sum left zero. It flies
/// again once the opposite sum has grown and it does not stand still. Without rotor speeds, a
/// vehicle that stands still is taken to be on the ground; if they come back and carry it, it
/// flies.
///
/// *It is not known* (start of a recording). A vehicle that has not moved yet may stand. It is
/// taken to fly if its thrust may carry it, until it has moved: if thrust then carries much better
/// than before, it stood, and what was learned is worth nothing (`start_anew`). Thrust that changes
/// while nothing moves says so earlier.
///
/// Thread-compatible; no update allocates but one that begins a new phase.
class PhaseDetector {
 public:
  /// @param learns_changes a vehicle that moves and suddenly lacks force is reported as changed at
  ///   once, instead of being watched first
  explicit PhaseDetector(const PhaseOptions& options, bool learns_changes = false);

  PhaseVerdict Update(const PhaseEvidence& evidence);

  /// The present phase.
  FlightPhase phase() const { return record_.phase(); }
  bool teaches() const { return Teaches(phase()); }
  /// False in the first tenth of a second, in which anything may be the case.
  bool has_begun() const { return mode_ != Mode::kStart; }
  /// True while contact is not proved and not ruled out: what is young may have to be taken back.
  bool suspects() const { return mode_ == Mode::kFlying && (contact_nats_ > 1.0 || bump_); }
  /// True once flight has shown the thrust coefficient; before, missing_force means little.
  bool knows_thrust() const { return knows_thrust_; }
  /// While it is not known: how much better the rotors carry than the model says, by a plain mean
  /// over a second or more of flight; empty before.
  std::optional<double> ThrustGain() const;
  /// True once the vehicle was seen to move by its own thrust.
  bool has_flown() const { return has_flown_; }
  /// True where the height `z` (in W) may still be, or again be, in touch with the ground.
  bool IsNearGround(double z) const;

  /// The vehicle was changed, or is another one: what is known of its thrust no longer holds.
  void ForgetThrust();
  /// The thrust coefficient by which evidence is made from now on can be relied on.
  void KnowThrust() { knows_thrust_ = knew_thrust_ = true; }
  /// A clock that stepped back, another recording: everything but the spans and what is known of
  /// the thrust is forgotten. A stand then takes back what came after, not what came before.
  void Restart();

  /// The flight so far, oldest first; times where a phase is too short to matter are in their
  /// neighbours. The oldest go when there are more than 1000.
  const std::vector<PhaseSpan>& spans() const { return record_.spans(); }

  /// Means over the newest whole block, for pictures.
  struct Seen {
    Stamp stamp = 0;  ///< of its end; 0: none yet
    double height_m = 0.0, speed_m_s = 0.0, thrust_ratio = 0.0;
    Eigen::Vector3d missing_force = Eigen::Vector3d::Zero();  ///< over the weight, in B
  };
  Seen seen() const {
    return {block_.to, block_.p_WS.z(), block_.speed, block_.thrust, block_.missing};
  }

  static constexpr double kBlock_s = 0.1;
  static constexpr double kAlarm_nats = 12.0;

 private:
  enum class Mode { kStart, kWaiting, kProving, kFlying, kGrounded };
  /// Before the first motion: how thrust carried, while it may have been the ground that did.
  struct FirstStand {
    double duration_s = 0.0;
    double thrust_sum = 0.0, missing_sum = 0.0, gain_sum = 0.0;  // times [s]
    double least_thrust = 0.0, most_thrust = 0.0;
    double wandered_s = 0.0;

    void Add(const PhaseBlock& block);
    double gain() const { return gain_sum / duration_s; }
  };
  /// After it: the same, of a vehicle that flies.
  struct FirstFlight {
    Stamp since = 0;
    double duration_s = 0.0, gain_sum = 0.0;
    double gain() const { return gain_sum / duration_s; }
  };
  /// While the thrust coefficient is unknown: flight in which the rotors carry, what they do, and
  /// the model's.
  struct CarriedFlight {
    double duration_s = 0.0, carries = 0.0, model_carries = 0.0;
  };
  /// In contact, while moving: mean and spread of the missing force over thrust.
  struct SteadyForce {
    double duration_s = 0.0, gain_sum = 0.0, gain_squares = 0.0, sideways_sum = 0.0;

    void Add(const PhaseBlock& block);
    bool IsInProportionToThrust() const;
  };
  /// The ground, where the vehicle was last seen to stand.
  struct Ground {
    bool was_seen = false;
    double height_m = 0.0;
  };
  /// Where the present stand, or contact, began.
  struct Place {
    Eigen::Vector3d p_WS = Eigen::Vector3d::Zero();
    Eigen::Matrix3d R_WS = Eigen::Matrix3d::Identity();
  };

  void CloseBlock(PhaseVerdict* verdict);
  void SeeMotionAlone();
  double ModelError() const;
  double ForceSigma() const;
  double ContactNats() const;
  void Start(PhaseVerdict* verdict);
  void Wait(PhaseVerdict* verdict);
  void Prove(PhaseVerdict* verdict);
  void Fly(PhaseVerdict* verdict);
  void HasStood(PhaseVerdict* verdict) const;
  bool IsCarriedByOther() const;
  void LandUnproved(PhaseVerdict* verdict);
  void SeeGain();
  void Stand(PhaseVerdict* verdict);
  void TakeOff();
  void GoToGround(Stamp since);
  bool HasMoved() const;
  bool HasChanged();
  FlightPhase PhaseOnGround() const;
  FlightPhase PhaseInAir();
  bool IsCarried() const;
  double WayFromStart() const;
  double TurnFromStart() const;
  void StartHere();
  void SetPhase(FlightPhase phase, Stamp since) { record_.SetPhase(phase, since, block_.to); }
  void Relabel(FlightPhase phase, Stamp since) { record_.Relabel(phase, since, block_.to); }

  PhaseOptions options_;
  bool learns_changes_;
  Mode mode_ = Mode::kStart;
  bool knows_thrust_ = false, has_flown_ = false;
  bool knew_thrust_ = false;    // once, perhaps of the vehicle as it was
  bool goes_on_ = false;        // after a restart: not all that was learned is from here
  PhaseBlock filling_, block_;  // the one being filled, the last whole one
  Stillness stillness_;
  PhaseRecord record_;
  std::optional<Stamp> first_;
  Place start_;
  Ground ground_;
  FirstStand first_stand_;
  FirstFlight first_flight_;
  CarriedFlight carried_;
  SteadyForce steady_;
  double contact_nats_ = 0.0, free_nats_ = 0.0;
  Stamp suspected_since_ = 0;
  std::optional<Stamp> bump_;      // begin of the last block that may have been a touch
  double error_scale_ = 1.0;       // of the flight's own residual, over ModelError()'s
  double hardest_ = 0.0;           // force felt around the last contact, over g
  double unforced_still_s_ = 0.0;  // still, and no rotor speeds
  bool only_still_ = false;        // on the ground for no other reason so far
  bool is_light_ = false;          // the last block hardly felt a force
};

}  // namespace odmc
