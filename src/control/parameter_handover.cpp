#include "odmc/control/parameter_handover.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kNoChange = 0.02;   // a smaller one is not put on trial
constexpr double kBackFaster = 4.0;  // a roll-back moves that much faster
constexpr double kLongestStep_s = 0.1;
constexpr double kArrived = 1e-12;

// The same values in the parameters of another model; what is new there starts at its prior.
ModelValues Translated(const ModelValues& values, const DynamicModel& from,
                       const DynamicModel& to) {
  ModelValues translated = to.InitialValues();
  for (int i = 0; i < to.num_parameters(); ++i) {
    const int k = from.IndexOf(to.parameters()[i].full_name);
    if (k >= 0) translated[i] = values[k];
  }
  return translated;
}

}  // namespace

const char* NameOf(HandoverState state) {
  switch (state) {
    case HandoverState::kNominal:
      return "nominal";
    case HandoverState::kFollowing:
      return "following";
    case HandoverState::kHolding:
      return "holding";
    case HandoverState::kRolledBack:
      return "rolled_back";
  }
  return "";
}

bool HandoverOptions::IsValid(std::string* error) const {
  for (const double positive :
       {handover_max_age_s, handover_max_relative_sigma, handover_stale_s, handover_hold_s,
        handover_change_1_s, handover_judge_s, handover_worse_floor_m}) {
    if (!(positive > 0.0)) return Invalid(error, "every handover_ option must be positive");
  }
  if (!(handover_worse_ratio > 1.0)) return Invalid(error, "handover_worse_ratio must be above 1");
  if (!(handover_max_thrust_ratio > 1.0))
    return Invalid(error, "handover_max_thrust_ratio must be above 1");
  if (!(handover_refuse_s >= 0.0)) return Invalid(error, "handover_refuse_s must not be negative");
  return true;
}

ParameterHandover::ParameterHandover(const HandoverOptions& options, const Vehicle& nominal)
    : options_(options), nominal_(nominal), effects_(nominal.effects) {
  std::string error;
  if (!options_.IsValid(&error)) throw std::invalid_argument(error);
  model_ = std::make_shared<DynamicModel>(nominal_, effects_);
  values_ = start_ = model_->InitialValues();
  goal_ = proven_ = {0, values_, {}};
}

void ParameterHandover::Reset(Stamp now) {
  values_ = start_ = model_->InitialValues();
  goal_ = proven_ = {0, values_, {}};
  progress_ = 1.0;
  trial_since_.reset();
  last_update_.reset();
  newest_offer_.reset();
  refuse_until_.reset();
  errors_.clear();
  if (state_ != HandoverState::kNominal) Enter(HandoverState::kNominal, "reset", now);
}

void ParameterHandover::Enter(HandoverState state, const std::string& reason, Stamp now) {
  events_.push_back({now, state_, state, reason});
  state_ = state;
}

std::vector<HandoverEvent> ParameterHandover::TakeEvents() { return std::exchange(events_, {}); }

// ---- Offers ------------------------------------------------------------------------------------

std::string ParameterHandover::Objection(const ParameterSet& set, const DynamicModel& model,
                                         const ModelValues& values, const Eigen::VectorXd& sigma,
                                         Stamp stamp, Stamp now) const {
  const double age_s = ToSeconds(now - stamp);
  if (age_s > options_.handover_max_age_s || age_s < -options_.handover_max_age_s)
    return Format("is %.2f s old (at most %.2f)", age_s, options_.handover_max_age_s);
  if (goal_.stamp != 0 && stamp <= goal_.stamp) return "is no newer than the one in use";
  if (refuse_until_ && now < *refuse_until_) return "tracking got worse with the last one";
  const std::vector<std::string> sentences = UnphysicalValues(model, values, sigma);
  if (!sentences.empty()) return sentences.front();
  const int k_f = model.IndexOf("thrust.k_f");
  const double ratio = k_f < 0 ? 1.0 : values[k_f] / model.parameters()[k_f].spec.prior_value;
  const double most = options_.handover_max_thrust_ratio;
  if (!(ratio < most && ratio > 1.0 / most))
    return Format("thrust.k_f is %.2f times nominal (limit %.1f)", ratio, most);
  for (const char* name : {"thrust.k_f", "inertia.x", "inertia.y"}) {
    const ParameterEstimate* p = set.Find(name);
    if (p == nullptr || !p->estimated || !p->observable) continue;
    const double share = p->sigma / std::abs(p->value);
    if (!(share <= options_.handover_max_relative_sigma)) {
      return name + Format(" is known to %.0f %% only (limit %.0f %%)", 100.0 * share,
                           100.0 * options_.handover_max_relative_sigma);
    }
  }
  return "";
}

std::string ParameterHandover::Consider(const ParameterSet& set, Stamp stamp, Stamp now) {
  std::shared_ptr<const DynamicModel> model = model_;
  std::string objection;
  ModelValues values;
  try {
    if (set.effects != effects_) model = std::make_shared<DynamicModel>(nominal_, set.effects);
    values = model->InitialValues();
    Eigen::VectorXd sigma = Eigen::VectorXd::Zero(model->num_parameters());
    for (const ParameterEstimate& p : set.parameters) {
      const int i = model->IndexOf(p.full_name);
      if (i < 0) throw std::invalid_argument("has the unknown parameter " + p.full_name);
      values[i] = p.value;
      sigma[i] = p.sigma;
    }
    objection = Objection(set, *model, values, sigma, stamp, now);
  } catch (const std::invalid_argument& e) {
    objection = e.what();
  }
  if (!objection.empty()) {
    ++refused_;
    if (objection != last_refusal_)
      events_.push_back({now, state_, state_, "refused: " + objection});
    last_refusal_ = objection;
    return objection;
  }
  last_refusal_.clear();
  newest_offer_ = now;
  refuse_until_.reset();
  if (model != model_) {
    effects_ = set.effects;
    Adopt(model);
  }
  if (state_ != HandoverState::kFollowing)
    Enter(HandoverState::kFollowing, "an accepted estimate is offered", now);
  const bool is_change = LargestChange(goal_.values, values) > kNoChange;
  if (is_change) {
    if (!trial_since_) proven_ = {goal_.stamp, values_, Baseline()};
    trial_since_ = now;
  }
  GoTo({stamp, values, {}});
  return "";
}

void ParameterHandover::Adopt(std::shared_ptr<const DynamicModel> model) {
  for (ModelValues* values : {&values_, &start_, &goal_.values, &proven_.values}) {
    *values = Translated(*values, *model_, *model);
  }
  model_ = std::move(model);
}

Eigen::VectorXd ParameterHandover::Sizes(const ModelValues& a, const ModelValues& b) const {
  Eigen::VectorXd sizes = a.cwiseAbs().cwiseMax(b.cwiseAbs());
  for (Eigen::Index i = 0; i < sizes.size(); ++i)
    sizes[i] = std::max(sizes[i], model_->parameters()[i].spec.scale);
  return sizes;
}

double ParameterHandover::LargestChange(const ModelValues& from, const ModelValues& to) const {
  return (to - from).cwiseQuotient(Sizes(from, to)).cwiseAbs().maxCoeff();
}

void ParameterHandover::GoTo(const Parameters& goal) {
  goal_ = goal;
  start_ = values_;
  progress_ = LargestChange(start_, goal_.values) > 0.0 ? 0.0 : 1.0;
}

// ---- In flight ---------------------------------------------------------------------------------

bool ParameterHandover::Update(Stamp now, std::optional<double> tracking_error_m) {
  Watch(now, tracking_error_m);
  CheckAge(now);
  Judge(now);
  const bool moved = Move(now);
  last_update_ = now;
  return moved;
}

void ParameterHandover::Watch(Stamp now, std::optional<double> tracking_error_m) {
  if (!tracking_error_m) {
    errors_.clear();
  } else if (std::isfinite(*tracking_error_m)) {
    errors_.push_back({now, *tracking_error_m * *tracking_error_m});
  }
  while (!errors_.empty() && ToSeconds(now - errors_.front().stamp) > options_.handover_judge_s) {
    errors_.pop_front();
  }
}

double ParameterHandover::tracking_rmse_m() const {
  double sum = 0.0;
  for (const Error& e : errors_) sum += e.squared;
  return errors_.empty() ? 0.0 : std::sqrt(sum / static_cast<double>(errors_.size()));
}

std::optional<double> ParameterHandover::Baseline() const {
  if (errors_.empty()) return std::nullopt;
  const double seen_s = ToSeconds(errors_.back().stamp - errors_.front().stamp);
  if (seen_s < 0.5 * options_.handover_judge_s) return std::nullopt;
  return tracking_rmse_m();
}

void ParameterHandover::CheckAge(Stamp now) {
  if (!newest_offer_) return;
  const double silent_s = ToSeconds(now - *newest_offer_);
  if (state_ == HandoverState::kFollowing && silent_s > options_.handover_stale_s) {
    Enter(HandoverState::kHolding, "the estimator is silent", now);
  }
  if (state_ == HandoverState::kHolding && silent_s > options_.handover_hold_s) {
    trial_since_.reset();
    GoTo({0, model_->InitialValues(), {}});
    Enter(HandoverState::kNominal, "the last estimate is too old", now);
  }
}

// A change is on trial until tracking has been seen for long enough after it.
void ParameterHandover::Judge(Stamp now) {
  if (!trial_since_ || errors_.empty()) return;
  const double tried_s = ToSeconds(now - *trial_since_);
  // After a roll-back the vehicle has first to come back to its path.
  const bool is_back = state_ == HandoverState::kRolledBack;
  if (tried_s < (is_back ? 2.0 : 1.0) * options_.handover_judge_s) return;
  const double rmse_m = tracking_rmse_m();
  const double before_m = proven_.rmse_m.value_or(rmse_m);
  if (rmse_m <= options_.handover_worse_ratio * before_m + options_.handover_worse_floor_m) {
    if (progress_ == 1.0) trial_since_.reset();
    return;
  }
  const std::string reason =
      Format("tracking got worse: %.3f m RMS, %.3f m before the change", rmse_m, before_m);
  refuse_until_ = now + FromSeconds(options_.handover_refuse_s);
  const bool was_nominal = proven_.stamp == 0;
  GoTo(proven_);
  Enter(was_nominal ? HandoverState::kNominal : HandoverState::kRolledBack, reason, now);
  // Next time there is only the vehicle file left.
  proven_ = {0, model_->InitialValues(), proven_.rmse_m};
  trial_since_ = was_nominal ? std::nullopt : std::optional<Stamp>(now);
}

bool ParameterHandover::Move(Stamp now) {
  if (progress_ == 1.0 || !last_update_) return false;
  const double dt = std::clamp(ToSeconds(now - *last_update_), 0.0, kLongestStep_s);
  const bool is_back = state_ == HandoverState::kNominal || state_ == HandoverState::kRolledBack;
  const double rate = options_.handover_change_1_s * (is_back ? kBackFaster : 1.0);
  // Each at its own pace: thrust need not wait for a weak coefficient that has far to go.
  const Eigen::VectorXd most = rate * dt * Sizes(start_, goal_.values);
  values_ += (goal_.values - values_).cwiseMax(-most).cwiseMin(most);
  const double left = LargestChange(values_, goal_.values);
  progress_ = 1.0 - left / std::max(left, LargestChange(start_, goal_.values));
  if (left < kArrived) {
    values_ = goal_.values;
    progress_ = 1.0;
  }
  return true;
}

}  // namespace odmc
