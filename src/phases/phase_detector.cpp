#include "odmc/phases/phase_detector.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace odmc {
namespace {

// The model's error in free flight, over the weight, one standard deviation of a block's mean: at
// rest, per m/s and per rad/s. Twice what batch fits of the paper's model leave on recordings of
// seven vehicles from 35 g to 0.95 kg, up to 14 m/s and 25 rad/s; a flight that leaves more widens
// it by itself (error_scale_).
constexpr double kErrorAtRest = 0.02, kErrorPerSpeed = 0.03, kErrorPerRate = 0.02;
constexpr double kContactForce = 0.5;  // sigma of what a contact adds, over the weight
// Errors of neighbouring blocks are alike (a manoeuvre lasts about three), so a block counts for a
// third; a single one is not enough, but for a force of more than eight sigmas (a bounce).
constexpr double kBlockCounts = 1.0 / 3.0, kMostPerBlock = 4.0, kBeyondDoubt_nats = 10.0;
// A block of six sigmas (in flight once in 10^8) was a touch if contact follows soon: a landing
// gear bounces.
constexpr double kBump_nats = 3.0, kBumpKept_s = 0.8;
constexpr double kStillSeen_s = 0.6;  // until stillness is seen, and the block before
constexpr double kStillWeight = 0.5;  // of a block in which the vehicle stands still
constexpr double kFree_nats = 5.0;    // to fly again: odds of 150 to 1
constexpr double kMostFreePerBlock = 2.0;
constexpr double kScaleMemory_s = 10.0, kMostScale = 5.0;
constexpr double kStandVaries = 1.15;  // of thrust, while nothing moves: it does not carry
constexpr double kGainDiffers = 0.05;  // thrust that carries so much better than before
constexpr double kProof_s = 0.5;
constexpr double kKnown_s = 1.0;        // of carried flight, to know the thrust coefficient
constexpr double kClearWander = 3.0;    // times what a stand shows at most
constexpr double kWandered_s = 1.0;     // as good as having moved away
constexpr double kStandsAlone_s = 0.5;  // without rotor speeds; as long again as stillness takes
constexpr double kTurned_rad = 0.1;
constexpr double kCarried_m_s = 0.15;
constexpr double kFallingForce = 0.3, kSupported = 0.5;  // felt, over g
constexpr double kImpact = 3.0;                          // felt, over g: harder than a landing
constexpr double kSteady_s = 1.5;  // a missing force that goes with thrust: another vehicle
constexpr double kSteadySpread = 0.1, kSteadySideways = 0.15;
constexpr double kIdleThrust = 0.25, kOffThrust = 0.004;

double Square(double x) { return x * x; }

}  // namespace

PhaseDetector::PhaseDetector(const PhaseOptions& options, bool learns_changes)
    : options_(options), learns_changes_(learns_changes) {}

PhaseVerdict PhaseDetector::Update(const PhaseEvidence& e) {
  PhaseVerdict verdict;
  if (!first_) first_ = e.stamp;
  if (e.dt <= 0.0) filling_ = PhaseBlock();
  filling_.Add(e);
  record_.ExtendTo(e.stamp);
  if (filling_.duration_s >= kBlock_s) {
    block_ = filling_;
    filling_ = PhaseBlock();
    CloseBlock(&verdict);
  }
  verdict.phase = phase();
  return verdict;
}

void PhaseDetector::CloseBlock(PhaseVerdict* verdict) {
  block_.Close();
  stillness_.Add(block_);
  if (!block_.has_force()) return SeeMotionAlone();
  unforced_still_s_ = 0.0;
  hardest_ = std::max(0.9 * hardest_, block_.felt.norm());
  switch (mode_) {
    case Mode::kStart:
      Start(verdict);
      break;
    case Mode::kWaiting:
      Wait(verdict);
      break;
    case Mode::kProving:
      Prove(verdict);
      break;
    case Mode::kFlying:
      Fly(verdict);
      break;
    case Mode::kGrounded:
      Stand(verdict);
      break;
  }
  record_.Average(block_);
}

/// Without rotor speeds (an ESC that is switched off says nothing, or zero at once) only motion
/// tells: what does not move is not in the air.
void PhaseDetector::SeeMotionAlone() {
  unforced_still_s_ = stillness_.is_still() ? unforced_still_s_ + block_.duration_s : 0.0;
  if (mode_ == Mode::kFlying && unforced_still_s_ >= kStandsAlone_s) {
    GoToGround(block_.to - FromSeconds(unforced_still_s_));
    only_still_ = true;
  }
  if (mode_ == Mode::kGrounded) SetPhase(PhaseOnGround(), block_.to);
}

double PhaseDetector::ModelError() const {
  return kErrorAtRest + kErrorPerSpeed * block_.speed + kErrorPerRate * block_.rate;
}

/// Of the missing force in free flight.
double PhaseDetector::ForceSigma() const {
  const double noise = std::sqrt(2.0) * block_.velocity_noise / (9.81 * block_.forced_s);
  return std::sqrt(Square(error_scale_ * ModelError()) + Square(noise) +
                   Square(block_.thrust * block_.thrust_sigma));
}

/// Log-likelihood ratio of contact over free flight.
double PhaseDetector::ContactNats() const {
  const double sigma = ForceSigma(), sigma_contact = std::hypot(sigma, kContactForce);
  const double any = kBlockCounts * (0.5 * block_.missing.squaredNorm() *
                                         (1.0 / Square(sigma) - 1.0 / Square(sigma_contact)) -
                                     3.0 * std::log(sigma_contact / sigma));
  if (!stillness_.is_still()) return any;
  // The ground carries any share of the weight, upward: uniform from 0 to 1.
  const double up = (block_.R_WS * block_.missing).z();
  const double carried =
      up > 0.0 ? 0.5 * Square(up / sigma) - std::log(1.0 / (std::sqrt(2.0 * M_PI) * sigma)) : -1.0;
  return std::max(any, kStillWeight * carried);
}

void PhaseDetector::Start(PhaseVerdict* verdict) {
  const double felt = block_.felt.norm();
  StartHere();
  if (felt < kFallingForce || (knows_thrust_ && ContactNats() < 0.0)) {
    TakeOff();
    SetPhase(FlightPhase::kFlying, *first_);
  } else if (block_.thrust < options_.landed_thrust_ratio) {
    if (felt < kSupported) return;  // neither carried nor falling: the next block tells
    HasStood(verdict);
    GoToGround(*first_);
    if (block_.speed > options_.take_off_speed_m_s) Relabel(FlightPhase::kInHand, *first_);
  } else {
    mode_ = Mode::kWaiting;
    first_stand_.least_thrust = first_stand_.most_thrust = block_.thrust;
    SetPhase(FlightPhase::kFlying, *first_);
  }
}

/// What was learned from the start on was learned from a stand.
void PhaseDetector::HasStood(PhaseVerdict* verdict) const {
  if (goes_on_) {
    verdict->take_back = *first_;
  } else {
    verdict->start_anew = true;
  }
}

/// Felt, but not given by thrust that may be.
bool PhaseDetector::IsCarriedByOther() const {
  return block_.thrust < options_.landed_thrust_ratio && block_.felt.norm() > kSupported;
}

void PhaseDetector::StartHere() { start_ = {block_.p_WS, block_.R_WS}; }

double PhaseDetector::WayFromStart() const { return (block_.p_WS - start_.p_WS).norm(); }

double PhaseDetector::TurnFromStart() const {
  return std::sqrt(0.5) * (block_.R_WS - start_.R_WS).norm();
}

bool PhaseDetector::HasMoved() const {
  return block_.speed > options_.take_off_speed_m_s || TurnFromStart() > kTurned_rad ||
         WayFromStart() > options_.take_off_height_m;
}

void PhaseDetector::FirstStand::Add(const PhaseBlock& block) {
  duration_s += block.duration_s;
  thrust_sum += block.duration_s * block.thrust;
  missing_sum += block.duration_s * block.missing.norm();
  gain_sum += block.duration_s * (1.0 + block.missing.z() / std::max(block.thrust, 1e-3));
  least_thrust = std::min(least_thrust, block.thrust);
  most_thrust = std::max(most_thrust, block.thrust);
}

// Not moved yet: flight or stand, by what comes.
void PhaseDetector::Wait(PhaseVerdict* verdict) {
  if (IsCarriedByOther()) {
    HasStood(verdict);
    return GoToGround(*first_);
  }
  if (stillness_.wander() > kClearWander) first_stand_.wandered_s += block_.duration_s;
  if (HasMoved() || first_stand_.wandered_s > kWandered_s) {
    mode_ = Mode::kProving;
    first_flight_ = {block_.from, 0.0, 0.0};
    return Prove(verdict);
  }
  first_stand_.Add(block_);
  if (!stillness_.is_still() ||
      first_stand_.most_thrust < kStandVaries * first_stand_.least_thrust) {
    return;
  }
  HasStood(verdict);
  GoToGround(*first_);
}

// Moved: did thrust carry as well before?
void PhaseDetector::Prove(PhaseVerdict* verdict) {
  if (block_.thrust > 0.5 * options_.landed_thrust_ratio) {
    first_flight_.duration_s += block_.duration_s;
    first_flight_.gain_sum += block_.duration_s * (1.0 + block_.missing.z() / block_.thrust);
  }
  const double stand_s = first_stand_.duration_s, flight_s = first_flight_.duration_s;
  const bool is_early = ToSeconds(block_.to - first_flight_.since) < kProof_s - 0.5 * kBlock_s;
  if (is_early && stand_s > 0.0) return;
  const bool stood = stand_s >= 3.0 * kBlock_s && flight_s > 0.0 &&
                     first_stand_.gain() > (1.0 + kGainDiffers) * first_flight_.gain();
  TakeOff();
  if (!stood) return SetPhase(PhaseInAir(), block_.to);
  HasStood(verdict);
  Relabel(FlightPhase::kOnGround, *first_);
  record_.SetMeans(first_stand_.thrust_sum / stand_s, first_stand_.missing_sum / stand_s);
  ground_ = {true, start_.p_WS.z()};
  SetPhase(PhaseInAir(), first_flight_.since);
}

void PhaseDetector::TakeOff() {
  mode_ = Mode::kFlying;
  contact_nats_ = 0.0;
  has_flown_ = true;
  hardest_ = 0.0;
}

void PhaseDetector::Fly(PhaseVerdict* verdict) {
  SetPhase(PhaseInAir(), block_.to);
  if (!knows_thrust_) {
    SeeGain();
    if (stillness_.is_still() && IsCarriedByOther()) LandUnproved(verdict);
    return;
  }
  if (contact_nats_ <= 0.0) suspected_since_ = block_.from;
  const double nats = ContactNats();
  if (nats > kBump_nats && !bump_) bump_ = block_.from;
  if (bump_ && ToSeconds(block_.to - *bump_) > kBumpKept_s) bump_.reset();
  contact_nats_ += nats > kBeyondDoubt_nats ? kAlarm_nats : std::min(nats, kMostPerBlock);
  contact_nats_ = std::max(0.0, contact_nats_);
  if (contact_nats_ < 1.0) {
    const double seen = block_.missing.squaredNorm() / (3.0 * Square(ModelError()));
    error_scale_ = std::sqrt(Square(error_scale_) +
                             block_.duration_s / kScaleMemory_s *
                                 (std::min(seen, Square(kMostScale)) - Square(error_scale_)));
    error_scale_ = std::max(error_scale_, 1.0);
  }
  if (contact_nats_ < kAlarm_nats) return;
  if (learns_changes_ && !stillness_.is_still() && !IsCarriedByOther() &&
      !(ground_.was_seen && block_.p_WS.z() < ground_.height_m + 0.3)) {
    verdict->has_changed = true;
    return ForgetThrust();
  }
  const Stamp since = bump_ ? std::min(*bump_, suspected_since_) : suspected_since_;
  verdict->take_back = since - static_cast<Stamp>(1e9 * kBlock_s);
  GoToGround(*verdict->take_back);
}

/// It stands again, after flight too short to know the thrust coefficient.
void PhaseDetector::LandUnproved(PhaseVerdict* verdict) {
  const Stamp since = block_.to - FromSeconds(kStillSeen_s);
  if (knew_thrust_ || goes_on_ || carried_.duration_s >= kKnown_s) {
    verdict->take_back = since;
  } else {
    verdict->start_anew = true;
  }
  carried_ = {};
  GoToGround(since);
}

/// Mean of what carries over what the model's thrust carries.
void PhaseDetector::SeeGain() {
  if (block_.felt.z() < kSupported || stillness_.is_still() || IsCarriedByOther()) return;
  carried_.duration_s += block_.duration_s;
  carried_.model_carries += block_.duration_s * block_.thrust;
  carried_.carries += block_.duration_s * (block_.thrust + block_.missing.z());
}

std::optional<double> PhaseDetector::ThrustGain() const {
  if (carried_.duration_s < kKnown_s || !(carried_.model_carries > 0.0)) return std::nullopt;
  return carried_.carries / carried_.model_carries;
}

void PhaseDetector::GoToGround(Stamp since) {
  mode_ = Mode::kGrounded;
  contact_nats_ = free_nats_ = 0.0;
  only_still_ = false;
  bump_.reset();
  steady_ = {};
  StartHere();
  Relabel(PhaseOnGround(), since);
}

void PhaseDetector::SteadyForce::Add(const PhaseBlock& block) {
  const double gain = block.missing.z() / block.thrust;
  duration_s += block.duration_s;
  gain_sum += block.duration_s * gain;
  gain_squares += block.duration_s * gain * gain;
  sideways_sum += block.duration_s * block.missing.head<2>().norm();
}

bool PhaseDetector::SteadyForce::IsInProportionToThrust() const {
  const double mean = gain_sum / duration_s;
  const double spread = std::sqrt(std::max(0.0, gain_squares / duration_s - mean * mean));
  return spread < kSteadySpread && sideways_sum / duration_s < kSteadySideways;
}

/// True once a force goes on missing in proportion to thrust, in a vehicle that moves freely.
bool PhaseDetector::HasChanged() {
  if (stillness_.is_still() || block_.thrust < options_.landed_thrust_ratio) {
    steady_ = {};
    return false;
  }
  steady_.Add(block_);
  if (steady_.duration_s < kSteady_s) return false;
  const SteadyForce seen = std::exchange(steady_, {});
  return seen.IsInProportionToThrust() && WayFromStart() > options_.take_off_height_m;
}

void PhaseDetector::Stand(PhaseVerdict* verdict) {
  const double contact_nats = ContactNats();
  only_still_ = only_still_ && knows_thrust_ && contact_nats < 0.0;
  const bool stands_still = stillness_.is_still() && !only_still_;
  if (stands_still) {
    ground_ = {true, block_.p_WS.z()};
    StartHere();
  }
  bool is_free = false;
  if (knows_thrust_) {
    free_nats_ += std::min(-contact_nats, kMostFreePerBlock);
    free_nats_ = std::max(free_nats_, 0.0);
    is_free = free_nats_ > kFree_nats && !stands_still;
  } else {
    const bool carries = block_.thrust >= options_.landed_thrust_ratio;
    is_free = (carries && !stands_still && HasMoved()) || block_.felt.norm() < kFallingForce;
  }
  if (is_free) {
    TakeOff();
    return SetPhase(PhaseInAir(), block_.from);
  }
  if (knows_thrust_ && HasChanged()) {
    verdict->has_changed = true;
    ForgetThrust();
    TakeOff();
    return SetPhase(PhaseInAir(), block_.from);
  }
  SetPhase(PhaseOnGround(), block_.to);
}

/// Falling takes two blocks to believe.
FlightPhase PhaseDetector::PhaseInAir() {
  const bool was_light = std::exchange(is_light_, block_.felt.norm() < kFallingForce);
  return was_light && is_light_ ? FlightPhase::kFalling : FlightPhase::kFlying;
}

/// Moves by a hand or a wheel: farther than a vehicle rocks on its legs.
bool PhaseDetector::IsCarried() const {
  return block_.speed > kCarried_m_s &&
         (TurnFromStart() > 0.5 * kTurned_rad || WayFromStart() > 0.5 * options_.take_off_height_m);
}

FlightPhase PhaseDetector::PhaseOnGround() const {
  if (IsCarried()) {
    if (hardest_ > kImpact) return FlightPhase::kCrashed;
    return block_.thrust < options_.landed_thrust_ratio ? FlightPhase::kInHand
                                                        : FlightPhase::kInContact;
  }
  const double up = block_.R_WS(2, 2);
  if (up < -0.5) return FlightPhase::kUpsideDown;
  if (hardest_ > kImpact || phase() == FlightPhase::kCrashed) return FlightPhase::kCrashed;
  if (!stillness_.is_still() && block_.thrust >= options_.landed_thrust_ratio) {
    const bool lands = Teaches(phase()) || phase() == FlightPhase::kTouchingDown;
    return lands ? FlightPhase::kTouchingDown : FlightPhase::kLiftingOff;
  }
  if (block_.thrust < kOffThrust) return FlightPhase::kOff;
  return block_.thrust < kIdleThrust ? FlightPhase::kIdling : FlightPhase::kOnGround;
}

bool PhaseDetector::IsNearGround(double z) const {
  return options_.near_ground_m > 0.0 && ground_.was_seen &&
         z - ground_.height_m < options_.near_ground_m;
}

void PhaseDetector::ForgetThrust() {
  knows_thrust_ = false;
  carried_ = {};
  contact_nats_ = 0.0;
}

void PhaseDetector::Restart() {
  PhaseRecord record = std::move(record_);
  const bool knows_thrust = knows_thrust_, knew_thrust = knew_thrust_;
  *this = PhaseDetector(options_, learns_changes_);
  knows_thrust_ = knows_thrust;
  knew_thrust_ = knew_thrust;
  goes_on_ = true;
  record_ = std::move(record);
  record_.Restart();
}

}  // namespace odmc
