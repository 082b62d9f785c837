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
constexpr double kStillWeight = 0.5;  // of a block in which the vehicle stands still
constexpr double kFree_nats = 5.0;    // to fly again: odds of 150 to 1
constexpr double kMostFreePerBlock = 2.0;
constexpr double kScaleMemory_s = 10.0, kMostScale = 5.0;
// A vehicle in the air moves: over half a second the attitude wanders by more than 1 mrad and the
// position by more than 3 mm in every recording (99 % of stretches of nine vehicles), on the ground
// by less than half of that. White noise of the sensors is allowed for.
constexpr double kStillAngle_rad = 1.0e-3, kStillWay_m = 3.0e-3, kStillNoise = 2.5;
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
constexpr size_t kMostSpans = 1000;

double Square(double x) { return x * x; }

}  // namespace

PhaseDetector::PhaseDetector(const PhaseOptions& options, bool learns_changes)
    : options_(options), learns_changes_(learns_changes) {}

PhaseVerdict PhaseDetector::Update(const PhaseEvidence& e) {
  PhaseVerdict verdict;
  if (!has_stamp_) first_ = e.stamp;
  has_stamp_ = true;
  if (e.dt <= 0.0) filling_ = Block();
  AddToBlock(e);
  if (!spans_.empty()) spans_.back().to = e.stamp;
  if (filling_.duration_s >= kBlock_s) {
    block_ = filling_;
    filling_ = Block();
    CloseBlock(&verdict);
  }
  verdict.phase = phase_;
  return verdict;
}

void PhaseDetector::AddToBlock(const PhaseEvidence& e) {
  Block& b = filling_;
  if (b.samples == 0) b.from = e.stamp - static_cast<Stamp>(1e9 * e.dt);
  b.to = e.stamp;
  ++b.samples;
  b.duration_s += e.dt;
  b.R_WS += e.q_WS.toRotationMatrix();
  b.p_WS += e.p_WS;
  b.speed += e.speed_m_s;
  b.rate += e.rate_rad_s;
  b.attitude_noise = e.attitude_noise_rad;
  b.position_noise = e.position_noise_m;
  b.velocity_noise = e.velocity_noise_m_s;
  b.thrust_sigma = e.thrust_sigma;
  if (!e.has_force) return;
  b.forced_s += e.dt;
  b.felt += e.dt * e.felt_force;
  b.missing += e.dt * e.missing_force;
  b.thrust += e.dt * e.thrust_ratio;
}

void PhaseDetector::CloseBlock(PhaseVerdict* verdict) {
  Block& b = block_;
  const double n = b.samples;
  b.R_WS /= n;
  b.p_WS /= n;
  b.speed /= n;
  b.rate /= n;
  SeeStillness();
  if (b.forced_s < 0.5 * b.duration_s) return SeeMotionAlone();
  unforced_still_s_ = 0.0;
  b.felt /= b.forced_s;
  b.missing /= b.forced_s;
  b.thrust /= b.forced_s;
  hardest_ = std::max(0.9 * hardest_, b.felt.norm());
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
  ExtendSpan();
}

/// Without rotor speeds (an ESC that is switched off says nothing, or zero at once) only motion
/// tells: what does not move is not in the air.
void PhaseDetector::SeeMotionAlone() {
  block_.felt = block_.missing = Eigen::Vector3d::Zero();
  block_.thrust = 0.0;
  unforced_still_s_ = is_still_ ? unforced_still_s_ + block_.duration_s : 0.0;
  if (mode_ == Mode::kFlying && unforced_still_s_ >= kStandsAlone_s) {
    GoToGround(block_.to - FromSeconds(unforced_still_s_));
  }
  if (mode_ == Mode::kGrounded) SetPhase(PhaseOnGround(), block_.to);
}

/// Spread of the newest blocks' means about theirs, beside what white noise would leave.
void PhaseDetector::SeeStillness() {
  recent_[static_cast<size_t>(next_recent_)] = block_;
  next_recent_ = (next_recent_ + 1) % static_cast<int>(recent_.size());
  num_recent_ = std::min(num_recent_ + 1, static_cast<int>(recent_.size()));
  is_still_ = false;
  wander_ = 1.0;
  if (num_recent_ < static_cast<int>(recent_.size())) return;
  Eigen::Matrix3d R = Eigen::Matrix3d::Zero();
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  for (const Block& b : recent_) R += b.R_WS / num_recent_, p += b.p_WS / num_recent_;
  double turn = 0.0, way = 0.0;
  for (const Block& b : recent_) {
    turn += 0.5 * (b.R_WS - R).squaredNorm() / num_recent_;
    way += (b.p_WS - p).squaredNorm() / num_recent_;
  }
  const double share = kStillNoise * std::sqrt(3.0 / std::max(block_.samples, 1));
  wander_ = std::max(std::sqrt(turn) / std::max(kStillAngle_rad, share * block_.attitude_noise),
                     std::sqrt(way) / std::max(kStillWay_m, share * block_.position_noise));
  is_still_ = wander_ < 1.0;
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
  if (!is_still_) return any;
  // The ground carries any share of the weight, upward: uniform from 0 to 1.
  const double up = (block_.R_WS * block_.missing).z();
  const double carried =
      up > 0.0 ? 0.5 * Square(up / sigma) - std::log(1.0 / (std::sqrt(2.0 * M_PI) * sigma)) : -1.0;
  return std::max(any, kStillWeight * carried);
}

void PhaseDetector::Start(PhaseVerdict* verdict) {
  const double felt = block_.felt.norm();
  start_p_WS_ = block_.p_WS;
  start_R_WS_ = block_.R_WS;
  if (felt < kFallingForce || (knows_thrust_ && ContactNats() < 0.0)) {
    TakeOff();
    SetPhase(FlightPhase::kFlying, first_);
  } else if (block_.thrust < options_.landed_thrust_ratio) {
    if (felt < kSupported) return;  // neither carried nor falling: the next block tells
    verdict->start_anew = true;
    GoToGround(first_);
    if (block_.speed > options_.take_off_speed_m_s) Relabel(first_, FlightPhase::kInHand);
  } else {
    mode_ = Mode::kWaiting;
    least_thrust_ = most_thrust_ = block_.thrust;
    SetPhase(FlightPhase::kFlying, first_);
  }
}

bool PhaseDetector::HasMoved() const {
  const double turn = std::sqrt(0.5) * (block_.R_WS - start_R_WS_).norm();
  return block_.speed > options_.take_off_speed_m_s || turn > kTurned_rad ||
         (block_.p_WS - start_p_WS_).norm() > options_.take_off_height_m;
}

// Not moved yet: flight or stand, by what comes.
void PhaseDetector::Wait(PhaseVerdict* verdict) {
  if (block_.thrust < options_.landed_thrust_ratio && block_.felt.norm() > kSupported) {
    verdict->start_anew = true;
    return GoToGround(first_);
  }
  if (wander_ > kClearWander) wandered_s_ += block_.duration_s;
  if (HasMoved() || wandered_s_ > kWandered_s) {
    mode_ = Mode::kProving;
    moved_since_ = block_.from;
    moved_s_ = moved_gain_ = 0.0;
    return Prove(verdict);
  }
  stood_s_ += block_.duration_s;
  stood_thrust_ += block_.duration_s * block_.thrust;
  stood_missing_ += block_.duration_s * block_.missing.norm();
  stood_gain_ += block_.duration_s * (1.0 + block_.missing.z() / std::max(block_.thrust, 1e-3));
  least_thrust_ = std::min(least_thrust_, block_.thrust);
  most_thrust_ = std::max(most_thrust_, block_.thrust);
  if (!is_still_ || most_thrust_ < kStandVaries * least_thrust_) return;
  verdict->start_anew = true;
  GoToGround(first_);
}

// Moved: did thrust carry as well before?
void PhaseDetector::Prove(PhaseVerdict* verdict) {
  if (block_.thrust > 0.5 * options_.landed_thrust_ratio) {
    moved_s_ += block_.duration_s;
    moved_gain_ += block_.duration_s * (1.0 + block_.missing.z() / block_.thrust);
  }
  if (ToSeconds(block_.to - moved_since_) < kProof_s - 0.5 * kBlock_s && stood_s_ > 0.0) return;
  const bool stood = stood_s_ >= 3.0 * kBlock_s && moved_s_ > 0.0 &&
                     stood_gain_ / stood_s_ > (1.0 + kGainDiffers) * moved_gain_ / moved_s_;
  TakeOff();
  if (!stood) return SetPhase(PhaseInAir(), block_.to);
  verdict->start_anew = true;
  Relabel(first_, FlightPhase::kOnGround);
  spans_.back().thrust_ratio = stood_thrust_ / stood_s_;
  spans_.back().missing_force = stood_missing_ / stood_s_;
  stood_ = true;
  ground_height_ = start_p_WS_.z();
  SetPhase(PhaseInAir(), moved_since_);
}

void PhaseDetector::TakeOff() {
  mode_ = Mode::kFlying;
  contact_nats_ = 0.0;
  has_flown_ = true;
  hardest_ = 0.0;
}

void PhaseDetector::Fly(PhaseVerdict* verdict) {
  SetPhase(PhaseInAir(), block_.to);
  if (!knows_thrust_) return SeeGain();
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
  if (learns_changes_ && !is_still_ && !(stood_ && block_.p_WS.z() < ground_height_ + 0.3)) {
    verdict->has_changed = true;
    return ForgetThrust();
  }
  const Stamp since = bump_ ? std::min(*bump_, suspected_since_) : suspected_since_;
  verdict->take_back = since - static_cast<Stamp>(1e9 * kBlock_s);
  GoToGround(*verdict->take_back);
}

/// Mean of what carries over what the model's thrust carries.
void PhaseDetector::SeeGain() {
  if (block_.felt.z() < kSupported || is_still_) return;
  carried_s_ += block_.duration_s;
  model_carries_ += block_.duration_s * block_.thrust;
  carries_ += block_.duration_s * (block_.thrust + block_.missing.z());
}

std::optional<double> PhaseDetector::ThrustGain() const {
  if (carried_s_ < kKnown_s || !(model_carries_ > 0.0)) return std::nullopt;
  return carries_ / model_carries_;
}

void PhaseDetector::GoToGround(Stamp since) {
  mode_ = Mode::kGrounded;
  contact_nats_ = free_nats_ = 0.0;
  bump_.reset();
  steady_s_ = steady_sum_ = steady_squares_ = sideways_sum_ = 0.0;
  start_p_WS_ = block_.p_WS;
  start_R_WS_ = block_.R_WS;
  Relabel(since, PhaseOnGround());
}

/// True once a force goes on missing in proportion to thrust, in a vehicle that moves freely.
bool PhaseDetector::HasChanged() {
  if (is_still_ || block_.thrust < options_.landed_thrust_ratio) {
    steady_s_ = steady_sum_ = steady_squares_ = sideways_sum_ = 0.0;
    return false;
  }
  const double gain = block_.missing.z() / block_.thrust;
  steady_s_ += block_.duration_s;
  steady_sum_ += block_.duration_s * gain;
  steady_squares_ += block_.duration_s * gain * gain;
  sideways_sum_ += block_.duration_s * block_.missing.head<2>().norm();
  if (steady_s_ < kSteady_s) return false;
  const double mean = steady_sum_ / steady_s_;
  const double spread = std::sqrt(std::max(0.0, steady_squares_ / steady_s_ - mean * mean));
  const double sideways = sideways_sum_ / steady_s_;
  steady_s_ = steady_sum_ = steady_squares_ = sideways_sum_ = 0.0;
  return spread < kSteadySpread && sideways < kSteadySideways &&
         (block_.p_WS - start_p_WS_).norm() > options_.take_off_height_m;
}

void PhaseDetector::Stand(PhaseVerdict* verdict) {
  const bool stands_still = is_still_;
  if (stands_still) {
    stood_ = true;
    ground_height_ = block_.p_WS.z();
    start_p_WS_ = block_.p_WS;
    start_R_WS_ = block_.R_WS;
  }
  bool is_free = false;
  if (knows_thrust_) {
    free_nats_ += std::min(-ContactNats(), kMostFreePerBlock);
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
  const double turn = std::sqrt(0.5) * (block_.R_WS - start_R_WS_).norm();
  return block_.speed > kCarried_m_s &&
         (turn > 0.5 * kTurned_rad ||
          (block_.p_WS - start_p_WS_).norm() > 0.5 * options_.take_off_height_m);
}

FlightPhase PhaseDetector::PhaseOnGround() const {
  if (IsCarried()) {
    if (hardest_ > kImpact) return FlightPhase::kCrashed;
    return block_.thrust < options_.landed_thrust_ratio ? FlightPhase::kInHand
                                                        : FlightPhase::kInContact;
  }
  const double up = block_.R_WS(2, 2);
  if (up < -0.5) return FlightPhase::kUpsideDown;
  if (hardest_ > kImpact || phase_ == FlightPhase::kCrashed) return FlightPhase::kCrashed;
  if (!is_still_ && block_.thrust >= options_.landed_thrust_ratio) {
    const bool lands = Teaches(phase_) || phase_ == FlightPhase::kTouchingDown;
    return lands ? FlightPhase::kTouchingDown : FlightPhase::kLiftingOff;
  }
  if (block_.thrust < kOffThrust) return FlightPhase::kOff;
  return block_.thrust < kIdleThrust ? FlightPhase::kIdling : FlightPhase::kOnGround;
}

bool PhaseDetector::IsNearGround(double z) const {
  return options_.near_ground_m > 0.0 && stood_ && z - ground_height_ < options_.near_ground_m;
}

void PhaseDetector::ForgetThrust() {
  knows_thrust_ = false;
  carried_s_ = carries_ = model_carries_ = 0.0;
  contact_nats_ = 0.0;
}

void PhaseDetector::Restart() {
  std::vector<PhaseSpan> spans = std::move(spans_);
  *this = PhaseDetector(options_, learns_changes_);
  spans_ = std::move(spans);
}

// ---- The record -------------------------------------------------------------------------------

void PhaseDetector::SetPhase(FlightPhase phase, Stamp since) {
  if (!spans_.empty() && spans_.back().phase == phase) {
    phase_ = phase;
    return;
  }
  Relabel(since, phase);
}

/// From `since` on the phase is `phase`.
void PhaseDetector::Relabel(Stamp since, FlightPhase phase) {
  phase_ = phase;
  while (!spans_.empty() && spans_.back().from >= since) spans_.pop_back();
  if (!spans_.empty() && spans_.back().phase == phase) {
    spans_.back().to = block_.to;
    return;
  }
  if (!spans_.empty()) spans_.back().to = std::min(spans_.back().to, since);
  if (spans_.size() >= kMostSpans) spans_.erase(spans_.begin());
  spans_.push_back({phase, since, std::max(since, block_.to), 0.0, 0.0});
  span_s_ = 0.0;
}

/// Means over the span, block by block.
void PhaseDetector::ExtendSpan() {
  if (spans_.empty()) return;
  PhaseSpan& span = spans_.back();
  span_s_ += block_.duration_s;
  const double gain = block_.duration_s / span_s_;
  span.missing_force += gain * (block_.missing.norm() - span.missing_force);
  span.thrust_ratio += gain * (block_.thrust - span.thrust_ratio);
}

}  // namespace odmc
