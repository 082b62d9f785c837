#include "odmc/ros/estimate_session.h"

#include <ros/console.h>

#include <chrono>
#include <exception>
#include <functional>
#include <utility>

#include "odmc/attribution/model_point.h"
#include "odmc/attribution/residual_watch.h"
#include "odmc/model/plausibility.h"
#include "odmc/ros/diagnostic_values.h"
#include "odmc/ros/estimate_messages.h"

namespace odmc {
namespace {

double SteadySeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

EstimateSession::EstimateSession(const EstimatorNodeSetup* setup)
    : setup_(*setup), vehicle_(setup->vehicle), acceptance_(setup->options.acceptance) {
  if (setup_.history) history_watch_.emplace(*setup_.history);
}

// ---- Start and starting anew -------------------------------------------------------------------

void EstimateSession::Start(bool with_torque) {
  model_ = std::make_shared<DynamicModel>(vehicle_, vehicle_.effects);
  estimator_ = std::make_unique<Estimator>(model_.get(), setup_.estimator, with_torque);
  estimator_->SetArrivalClock(SteadySeconds);
  reaction_watch_ = ReactionWatch();
  starts_anew_ = 0;
  HoldOut();
}

void EstimateSession::Reset(bool with_torque) {
  vehicle_.effects = setup_.vehicle.effects;
  vehicle_.parameters = setup_.vehicle.parameters;
  Start(with_torque);
  acceptance_.Reset();
  last_.reset();
  if (history_watch_) history_watch_->Reset();
  unlike_history_.clear();
  trust_.ReadmitStreams();
  trust_.ForgetEstimate();
  added_effects_.clear();
}

void EstimateSession::RestartChain() {
  estimator_->RestartChain();
  acceptance_.Reset();
}

void EstimateSession::Freeze(bool is_frozen) {
  is_frozen_ = is_frozen;
  HoldOut();
}

void EstimateSession::HoldOut() {
  if (!estimator_) return;
  estimator_->SetHeldOut(is_frozen_ ? [](Stamp) { return true; } : std::function<bool(Stamp)>());
}

// What was learned so far came from no flight, or from other streams.
void EstimateSession::Forget(const char* why) {
  starts_anew_ = estimator_->counters().starts_anew;
  if (last_) ROS_WARN("%s: what was learned before is forgotten", why);
  last_.reset();
  if (history_watch_) history_watch_->Reset();
  unlike_history_.clear();
  trust_.ForgetEstimate();
  acceptance_.Reset();
}

// ---- Estimates ---------------------------------------------------------------------------------

const Snapshot* EstimateSession::Step() {
  const Snapshot* const snapshot = estimator_->Step();
  if (estimator_->made_progress() && estimator_->counters().starts_anew != starts_anew_) {
    Forget("the vehicle had stood on the ground");
  }
  return snapshot;
}

void EstimateSession::Take(Snapshot snapshot) {
  trust_.LookBack(last_ ? &last_->values : nullptr, setup_.estimator.detect_changes,
                  estimator_.get());
  trust_.Widen(model_, &snapshot);
  acceptance_.Update(*model_, snapshot, trust_.findings());
  if (history_watch_) {
    unlike_history_ =
        history_watch_->Look(snapshot.time_s, *model_, snapshot.values, snapshot.sigma);
  }
  last_model_ = model_;
  last_ = std::move(snapshot);
}

void EstimateSession::KeepLast() {
  last_->airborne = estimator_->airborne();
  if (last_->airborne) last_->stamp = estimator_->last_keyframe_stamp();
}

// ---- What is found in the background -----------------------------------------------------------

BackgroundAnalysis::StreamsSeen EstimateSession::SeenIn(FlightLog log) const {
  BackgroundAnalysis::StreamsSeen seen{std::move(log), vehicle_, model_, {}, 0.0};
  const int k_f = model_->IndexOf("thrust.k_f");
  if (last_ && last_model_ == model_) {
    seen.values = last_->values;
    if (k_f >= 0) seen.k_f_sigma = last_->sigma[k_f];
  }
  return seen;
}

void EstimateSession::Adopt(BackgroundAnalysis::StreamsFound found) {
  LearnOfReaction(found);
  const bool is_new = trust_.Adopt(std::move(found));
  if (is_new && !is_frozen_) {
    estimator_->StartAnew();
    Forget("the streams are mended from now on");
  }
}

void EstimateSession::LearnOfReaction(const BackgroundAnalysis::StreamsFound& found) {
  if (found.model != model_) return;
  const std::string before = reaction_watch_.sentence();
  reaction_watch_.Add(found.bands);
  const std::string& now = reaction_watch_.sentence();
  if (!now.empty() && before.empty()) ROS_WARN("%s", now.c_str());
}

bool EstimateSession::Extend(const ResidualAnalysis& found, bool with_torque) {
  if (!last_ || found.model != model_ || last_model_ != model_ || is_frozen_) return false;
  const std::string& name = found.candidate->name;
  try {
    const Vehicle extended = VehicleWith(vehicle_, *found.candidate);
    const Vehicle warm =
        WarmStarted(extended, Estimator::ToParameterSet(*last_model_, last_.value()), found);
    auto model = std::make_shared<DynamicModel>(warm, warm.effects);
    auto estimator = std::make_unique<Estimator>(model.get(), setup_.estimator, with_torque);
    estimator->CarryOn(*estimator_, DynamicModel(extended, extended.effects));
    estimator_ = std::move(estimator);
    model_ = std::move(model);
    HoldOut();
    vehicle_.effects = extended.effects;
    vehicle_.parameters = extended.parameters;
  } catch (const std::exception& e) {
    ROS_ERROR("%s was found, but cannot be added: %s", name.c_str(), e.what());
    return false;
  }
  acceptance_.Reset();
  added_effects_ += (added_effects_.empty() ? "" : ", ") + name;
  ROS_WARN("added %s to the model in flight (add_effects): %.3g nats, found %d times in a row",
           name.c_str(), found.candidate->score, found.in_a_row);
  return true;
}

// ---- What others are told ----------------------------------------------------------------------

EstimatePublisher::Context EstimateSession::Context() const {
  return {last_model_.get(), &acceptance_, &trust_.findings(), !progress_.interruption().empty()};
}

std::string EstimateSession::ObjectionToAccepting() const {
  const Snapshot& usable = acceptance_.Usable();
  if (!last_ || usable.values.size() != last_->values.size()) return "nothing is estimated yet";
  return JoinSentences(UnphysicalValues(*last_model_, usable.values, usable.sigma));
}

ParameterSet EstimateSession::ToSave() const {
  ParameterSet set = Estimator::ToParameterSet(*last_model_, *last_);
  set.provenance["vehicle"] = vehicle_.name;
  set.provenance["airborne_s"] = std::to_string(estimator_->counters().airborne_s);
  set.provenance["keyframes"] = std::to_string(estimator_->counters().keyframes);
  set.provenance["newest_stamp_ns"] = std::to_string(last_->stamp);
  if (!added_effects_.empty()) set.provenance["added_in_flight"] = added_effects_;
  set.provenance["accepted"] = acceptance_.accepted() ? "true" : "false";
  AddTrust(trust_.findings(), &set);
  return set;
}

void EstimateSession::LookAtProgress(const std::string& missing) {
  progress_.Look(*estimator_, missing, last_ && !is_frozen_);
}

void EstimateSession::Fill(NodeStatus* s) const {
  if (!s->model) s->model = model_;
  s->interrupted = progress_.interruption();
  s->airborne = estimator_->airborne();
  s->trust = Name(TrustOf(trust_.findings()));
  s->findings.clear();
  for (const Finding& finding : trust_.findings()) {
    s->findings += (s->findings.empty() ? "" : " | ") + Sentence(finding);
  }
  s->rotor_speeds_late_s = trust_.OffsetOf("rotor_speeds");
  s->imu_late_s = trust_.OffsetOf("gyro");
  s->contradicted_k_m = reaction_watch_.sentence();
  s->counters = estimator_->counters();
  s->stream_counters = estimator_->stream_counters();
  s->noise = estimator_->odometry_noise();
  s->accepted = acceptance_.accepted();
  s->not_accepted_because = acceptance_.reasons();
  s->held_back = acceptance_.held_back();
  s->has_estimate = last_.has_value();
  if (last_) FillEstimate(s);
}

void EstimateSession::FillEstimate(NodeStatus* s) const {
  s->unphysical = UnphysicalValues(*last_model_, last_->values, last_->sigma);
  const std::string doubt = ThrustDoubt(*last_model_, last_->values);
  if (!doubt.empty()) s->unphysical.push_back(doubt);
  s->unlike_history = UnlikeHistorySentences();
  s->unobservable = last_->unobservable;
  s->observable = last_->observable;
  s->time_s = last_->time_s;
  s->states_in_window = last_->timing.states;
  s->residual_force_rms_N = last_->residual_force_rms_N;
  s->residual_torque_rms_Nm = last_->residual_torque_rms_Nm;
  s->battery_voltage_V = last_->battery_voltage_V;
}

/// What differs from earlier flights.
std::vector<std::string> EstimateSession::UnlikeHistorySentences() const {
  std::vector<std::string> sentences;
  for (const UnlikeHistory& unlike : unlike_history_) {
    const int k = last_model_->IndexOf(unlike.full_name);
    if (k >= 0) sentences.push_back(unlike.Sentence(last_model_->parameters()[k].spec.unit));
  }
  return sentences;
}

}  // namespace odmc
