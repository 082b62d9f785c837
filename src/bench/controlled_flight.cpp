#include "odmc/bench/controlled_flight.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <variant>

#include "odmc/actuator/rotor_source.h"
#include "odmc/math/statistics.h"

namespace odmc {
namespace {

constexpr double kLeftOut_s = 2.0;  // after take-off
constexpr double kSample_s = 0.01;  // between TrackingSamples
constexpr double kStep_s = 1e-3;
constexpr double kOffer_s = 0.2;  // between offers of an accepted estimate
constexpr double kMostTilt_rad = 2.0943951023931953;
constexpr double kMostError_m = 2.0;
constexpr double kClear_m = 0.15;  // above the stand: the ground should be out of reach

double MillisecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
      .count();
}

// The vehicle as the estimator starts from it.
Vehicle Believed(const ControlledFlightSetup& setup) {
  Vehicle vehicle = setup.vehicle;
  if (setup.warm_start) ApplyParameters(*setup.warm_start, &vehicle);
  return vehicle;
}

// The estimator as a node runs it: samples in, accepted estimates out.
class EstimatorInLoop {
 public:
  explicit EstimatorInLoop(const ControlledFlightSetup& setup)
      : model_(Believed(setup), setup.vehicle.effects),
        estimator_(&model_, setup.estimator, true),
        acceptance_(setup.acceptance) {}

  template <typename AnySample>
  void Add(const AnySample& sample) {
    estimator_.Add(sample);
  }

  // An accepted estimate to offer, at most one per kOffer_s.
  std::optional<std::pair<Stamp, ParameterSet>> Run() {
    do {
      const Snapshot* const snapshot = estimator_.Step();
      if (!snapshot) continue;
      acceptance_.Update(model_, *snapshot);
      last_ = *snapshot;
    } while (estimator_.made_progress());
    if (!last_ || !acceptance_.accepted() || !estimator_.airborne()) return std::nullopt;
    if (offered_ && ToSeconds(last_->stamp - *offered_) < kOffer_s) return std::nullopt;
    offered_ = last_->stamp;
    return std::make_pair(last_->stamp, Estimator::ToParameterSet(model_, acceptance_.Usable()));
  }

 private:
  DynamicModel model_;
  Estimator estimator_;
  Acceptance acceptance_;
  std::optional<Snapshot> last_;
  std::optional<Stamp> offered_;
};

// Everybody of one flight.
class Loop {
 public:
  explicit Loop(const ControlledFlightSetup& setup)
      : setup_(setup),
        trajectory_(setup.trajectory),
        world_(*setup.truth_model, setup.truth, setup.world, setup.seed),
        handover_(setup.handover, setup.vehicle),
        controller_(setup.controller, handover_.model()) {
    if ((setup.by_throttle || setup.rotor_speed_from_commands) && !setup.vehicle.actuator)
      throw std::invalid_argument(
          "flying by throttle, and rotor speeds from commands, ask for an "
          "actuator in the vehicle file");
    if (setup.rotor_speed_from_commands)
      source_.emplace(*setup.vehicle.actuator, setup.vehicle.num_rotors(), true);
    if (setup.estimates) estimator_.emplace(setup);
    if (setup.warm_start) handover_.Consider(*setup.warm_start, FromSeconds(kStep_s), 0);
    const double duration_s = setup.trajectory.duration_s;
    path_end_s_ = duration_s > 0.0 ? trajectory_.start_s() + duration_s
                                   : std::numeric_limits<double>::infinity();
  }

  ControlledFlight Fly(double longest_s) {
    const auto start = std::chrono::steady_clock::now();
    const Stamp end = FromSeconds(std::min(trajectory_.end_s(), longest_s));
    const Stamp period = FromSeconds(1.0 / setup_.control_rate_hz);
    for (Stamp next = 0; world_.now() < end && flight_.crash.empty();) {
      world_.Step();
      if (world_.now() < next) continue;
      next += period;
      Control();
    }
    flight_.handover = handover_.TakeEvents();
    flight_.control_ms_p99 = Quantile(control_ms_, 0.99);
    flight_.flown_s = ToSeconds(world_.now());
    flight_.battery_end_V = world_.battery_voltage_V();
    flight_.wall_s = 1e-3 * MillisecondsSince(start);
    return std::move(flight_);
  }

 private:
  void Control() {
    const Stamp now = world_.now();
    const double t_s = ToSeconds(now);
    const FlatReference reference = trajectory_.At(t_s);
    Deliver();
    Estimate(now);
    const auto start = std::chrono::steady_clock::now();
    if (handover_.Update(now, TrackingError(now, reference)))
      controller_.SetModel(handover_.model(), handover_.values());
    const ControlCommand command = controller_.Update(now, reference);
    if (setup_.by_throttle) {
      world_.CommandThrottle(command.throttle);
    } else {
      world_.Command(command.rotor_speed);
    }
    control_ms_.push_back(MillisecondsSince(start));
    Watch(t_s, reference);
  }

  void Deliver() {
    for (const Sample& sample : world_.TakeSamples()) {
      Keep(sample, &flight_.log);
      std::visit([this](const auto& s) { Deliver(s); }, sample);
    }
  }
  void Deliver(const OdometrySample& sample) {
    controller_.Add(sample);
    if (estimator_) estimator_->Add(sample);
  }
  void Deliver(const ImuSample& sample) {
    controller_.Add(sample);
    if (estimator_ && setup_.vehicle.imu) estimator_->Add(sample);
  }
  void Deliver(const RotorSample& sample) {
    if (!source_) UseSpeeds(sample);
  }
  void Deliver(const CommandSample& sample) {
    if (!source_) return;
    if (const auto speeds = source_->Add(sample)) UseSpeeds(*speeds);
  }
  void UseSpeeds(const RotorSample& sample) {
    controller_.Add(sample);
    if (estimator_) estimator_->Add(sample);
  }
  void Deliver(const BatterySample& sample) {
    controller_.Add(sample);
    if (source_) source_->Add(sample);
    if (estimator_) estimator_->Add(sample);
  }

  void Estimate(Stamp now) {
    if (setup_.estimator_dies_at_s > 0.0 && ToSeconds(now) >= setup_.estimator_dies_at_s)
      estimator_.reset();
    if (!estimator_) return;
    const auto offer = estimator_->Run();
    if (!offer) return;
    if (flight_.first_accepted_s == 0.0) flight_.first_accepted_s = ToSeconds(now);
    flight_.accepted = offer->second;
    handover_.Consider(offer->second, offer->first, now);
  }

  // As the controller sees it; nothing while nothing is tracked.
  std::optional<double> TrackingError(Stamp now, const FlatReference& reference) const {
    if (reference.standing) return std::nullopt;
    const std::optional<BodyState> state = controller_.StateAt(now);
    if (!state) return std::nullopt;
    return (state->p_WB - reference.p_WB).norm();
  }

  void Watch(double t_s, const FlatReference& reference) {
    const TruthSample truth = world_.Truth();
    WatchGround(t_s, reference);
    const Eigen::Vector3d up = truth.q_WB * Eigen::Vector3d::UnitZ();
    const double tilt = std::acos(std::clamp(up.z(), -1.0, 1.0));
    flight_.largest_tilt_rad = std::max(flight_.largest_tilt_rad, tilt);
    const double error = (truth.p_WB - reference.p_WB).norm();
    const std::string at = " after " + std::to_string(t_s) + " s";
    if (!truth.p_WB.allFinite()) flight_.crash = "not a number" + at;
    if (tilt > kMostTilt_rad) flight_.crash = "turned over" + at;
    if (error > kMostError_m && !reference.standing) flight_.crash = "2 m off the reference" + at;
    if (t_s < next_sample_s_) return;
    next_sample_s_ += kSample_s;
    const bool counts =
        flight_.take_off_s > 0.0 && t_s >= flight_.take_off_s + kLeftOut_s && t_s < path_end_s_;
    flight_.samples.push_back(
        {t_s, counts, truth.p_WB, reference.p_WB, truth.v_WB, handover_.state()});
  }

  void WatchGround(double t_s, const FlatReference& reference) {
    const Stamp now = world_.now();
    const bool touches = world_.touches_ground();
    if (touches && (flight_.ground_spans.empty() || !touched_))
      flight_.ground_spans.emplace_back(now, now);
    if (touches) flight_.ground_spans.back().second = now;
    touched_ = touches;
    if (!touches && flight_.take_off_s == 0.0 && !reference.standing) flight_.take_off_s = t_s;
    const bool lands = t_s >= path_end_s_;
    if (touches && flight_.take_off_s > 0.0 && reference.p_WB.z() > kClear_m && !lands)
      flight_.crash = "touched the ground after " + std::to_string(t_s) + " s";
  }

  const ControlledFlightSetup& setup_;
  Trajectory trajectory_;
  World world_;
  ParameterHandover handover_;
  FlatnessController controller_;
  std::optional<RotorSource> source_;  // where speeds come from commands
  std::optional<EstimatorInLoop> estimator_;
  double path_end_s_;
  bool touched_ = false;
  double next_sample_s_ = 0.0;
  std::vector<double> control_ms_;
  ControlledFlight flight_;
};

}  // namespace

ControlledFlight FlyControlled(const ControlledFlightSetup& setup, double longest_s) {
  return Loop(setup).Fly(longest_s);
}

TrackingErrors ErrorsBetween(const ControlledFlight& flight, double from_s, double to_s) {
  TrackingErrors errors;
  int count = 0;
  for (const TrackingSample& sample : flight.samples) {
    if (!sample.counts || sample.t_s < from_s || sample.t_s >= to_s) continue;
    const Eigen::Vector3d error = sample.p_WB - sample.p_WB_ref;
    errors.rmse_m += error.cwiseAbs2();
    errors.max_m = errors.max_m.cwiseMax(error.cwiseAbs());
    ++count;
  }
  if (count > 0) errors.rmse_m = (errors.rmse_m / count).cwiseSqrt();
  return errors;
}

TrackingErrors ErrorsOf(const ControlledFlight& flight) {
  return ErrorsBetween(flight, 0.0, std::numeric_limits<double>::infinity());
}

}  // namespace odmc
