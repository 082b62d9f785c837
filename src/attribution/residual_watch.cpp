#include "odmc/attribution/residual_watch.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "odmc/attribution/sampling_change.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/plausible.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kEnoughShare = 0.5;  // of the window must be flight
constexpr double kMargin_s = 0.2;     // beside the window, for the filter

/// Drops what is older than `stamp`.
template <typename Sample>
void DropBefore(Stamp stamp, std::vector<Sample>* samples) {
  const auto first = std::find_if(samples->begin(), samples->end(),
                                  [stamp](const Sample& s) { return s.stamp >= stamp; });
  samples->erase(samples->begin(), first);
}

/// A pose that repeats is a source that stalls.
bool Repeats(const OdometrySample& s, const OdometrySample& before) {
  return before.p_WS == s.p_WS && before.q_WS.coeffs() == s.q_WS.coeffs();
}
template <typename Sample>
bool Repeats(const Sample&, const Sample&) {
  return false;
}

/// Keeps a sample that is sound and newer than those kept.
template <typename Sample>
void Append(const Sample& sample, std::vector<Sample>* kept) {
  if (!IsPlausible(sample)) return;
  const bool follows =
      kept->empty() || (sample.stamp > kept->back().stamp && !Repeats(sample, kept->back()));
  if (follows) kept->push_back(sample);
}

bool IsFinite(const ResidualAnalysis& r) {
  bool finite = std::isfinite(r.structured_share) && std::isfinite(r.whiteness_p) &&
                r.force_rmse_N.allFinite() && r.torque_rmse_Nm.allFinite() &&
                std::isfinite(r.explained_share);
  if (!r.candidate) return finite;
  finite = finite && std::isfinite(r.candidate->score);
  for (const ParameterEstimate& p : r.candidate->parameters) {
    finite = finite && std::isfinite(p.value) && std::isfinite(p.sigma);
  }
  return finite;
}

/// Sizes and structure of the residual's channels.
void Summarise(const std::vector<ChannelStructure>& channels, const AttributionOptions& decision,
               ResidualAnalysis* found) {
  for (size_t c = 0; c < channels.size(); ++c) {
    const WhitenessResult& whiteness = channels[c].whiteness;
    (c < 3 ? found->force_rmse_N[c] : found->torque_rmse_Nm[c - 3]) = channels[c].rmse;
    if (IsSensorNoise(channels[c], decision) || IsSlowError(channels[c], decision)) continue;
    if (whiteness.structured_share >= found->structured_share) {
      found->structured_share = whiteness.structured_share;
      found->channel = channels[c].name;
    }
    const auto n = static_cast<double>(channels.size());
    found->whiteness_p = std::min(found->whiteness_p, n * whiteness.p);
    found->structured = found->structured || IsStructured(channels[c], decision);
  }
}

}  // namespace

bool ResidualWatchOptions::IsValid(std::string* error) const {
  if (!(residual_watch_period_s >= 0.0))
    return Invalid(error, "residual_watch_period_s must not be negative");
  if (!(residual_watch_window_s >= 10.0 && residual_watch_window_s <= 120.0)) {
    return Invalid(error, "residual_watch_window_s must be in [10, 120]");
  }
  if (residual_watch_confirmations < 1) {
    return Invalid(error, "residual_watch_confirmations must be at least 1");
  }
  return true;
}

ResidualWatch::ResidualWatch(const Vehicle& file_vehicle, const ResidualWatchOptions& options,
                             bool with_torque)
    : file_vehicle_(file_vehicle), options_(options), with_torque_(with_torque) {
  std::string error;
  if (!options.IsValid(&error)) throw std::invalid_argument(error);
}

// ---- The feeding thread ------------------------------------------------------------------------

Stamp ResidualWatch::StampOf(const Item& item) {
  return std::visit([](const auto& s) { return s.stamp; }, item);
}

void ResidualWatch::Put(Item item) {
  const Stamp stamp = StampOf(item);
  const Stamp oldest = stamp - FromSeconds(options_.residual_watch_window_s + kMargin_s);
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!next_look_) next_look_ = stamp + FromSeconds(options_.residual_watch_period_s);
  inbox_.push_back(std::move(item));
  while (StampOf(inbox_.front()) < oldest) inbox_.pop_front();
}

void ResidualWatch::SetAirborne(Stamp keyframe, bool airborne) {
  Put(Keyframe{keyframe, airborne});
  const std::lock_guard<std::mutex> lock(mutex_);
  airborne_ = airborne;
}

void ResidualWatch::SetEstimate(std::shared_ptr<const DynamicModel> model,
                                const ModelValues& values, Stamp start) {
  const std::lock_guard<std::mutex> lock(mutex_);
  newest_estimate_ = Estimate{std::move(model), values, start};
}

void ResidualWatch::Clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  inbox_.clear();
  next_look_.reset();
  cleared_ = true;
}

// ---- The looking thread ------------------------------------------------------------------------

std::optional<ResidualWatch::Estimate> ResidualWatch::TakeIn() {
  std::deque<Item> items;
  std::optional<Estimate> estimate;
  bool cleared = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const bool due = options_.residual_watch_period_s > 0.0 && next_look_ && !inbox_.empty() &&
                     StampOf(inbox_.back()) >= *next_look_;
    if (!due || !airborne_ || !newest_estimate_) return std::nullopt;
    next_look_ = StampOf(inbox_.back()) + FromSeconds(options_.residual_watch_period_s);
    items.swap(inbox_);
    std::swap(cleared, cleared_);
    estimate = newest_estimate_;
  }
  if (cleared) {
    log_ = FlightLog();
    ground_spans_.clear();
    last_keyframe_.reset();
    last_candidate_.clear();
  }
  for (const Item& item : items) {
    if (const auto* odometry = std::get_if<OdometrySample>(&item)) {
      Append(*odometry, &log_.odometry);
    } else if (const auto* imu = std::get_if<ImuSample>(&item)) {
      Append(*imu, &log_.imu);
    } else if (const auto* rotors = std::get_if<RotorSample>(&item)) {
      Append(*rotors, &log_.rotors);
    } else {
      Keep(std::get<Keyframe>(item));
    }
  }
  if (!log_.odometry.empty()) {
    ForgetBefore(log_.odometry.back().stamp -
                 FromSeconds(options_.residual_watch_window_s + kMargin_s));
  }
  return estimate;
}

void ResidualWatch::Keep(const Keyframe& keyframe) {
  if (!keyframe.airborne) {
    const bool stands = last_keyframe_ && !last_keyframe_->airborne && !ground_spans_.empty();
    if (!stands) ground_spans_.emplace_back(keyframe.stamp, keyframe.stamp);
    ground_spans_.back().second = keyframe.stamp;
  }
  last_keyframe_ = keyframe;
}

void ResidualWatch::ForgetBefore(Stamp stamp) {
  DropBefore(stamp, &log_.odometry);
  DropBefore(stamp, &log_.imu);
  DropBefore(stamp, &log_.rotors);
  ground_spans_.erase(std::remove_if(ground_spans_.begin(), ground_spans_.end(),
                                     [stamp](const auto& span) { return span.second < stamp; }),
                      ground_spans_.end());
}

size_t ResidualWatch::size() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return inbox_.size() + log_.odometry.size() + log_.imu.size() + log_.rotors.size();
}

FlightLog ResidualWatch::MendedLog() const {
  FlightLog mended = log_;
  MendFlight(&mended);
  return mended;
}

double ResidualWatch::OffsetTo(Stamp start) const {
  return log_.odometry.empty() ? 0.0 : ToSeconds(log_.odometry.front().stamp - start);
}

ThinnedFlight ResidualWatch::Flight(const FlightLog& mended, Stamp start) const {
  auto spans = ground_spans_;
  // Nothing is known yet of what came after the last keyframe.
  const Stamp known = last_keyframe_ ? last_keyframe_->stamp : 0;
  spans.emplace_back(known + 1, std::numeric_limits<Stamp>::max());
  FlightMotion motion = FilterFlight(mended, file_vehicle_.num_rotors(), spans);
  const double offset_s = OffsetTo(start);
  for (FilteredMotion& sample : motion.samples) sample.t_s += offset_s;
  BlockSplit blocks;
  blocks.hold_out_every = 0;
  return ThinnedFlight(std::move(motion), blocks, file_vehicle_.odometry.q_BS.toRotationMatrix());
}

std::optional<ResidualAnalysis> ResidualWatch::Look(const std::function<bool()>& give_up) {
  const std::optional<Estimate> estimate = TakeIn();
  if (!estimate) return std::nullopt;
  const FlightLog mended = MendedLog();
  const ThinnedFlight flight = Flight(mended, estimate->start);
  const double flight_s = flight.size() * flight.step_s();
  if (flight_s < kEnoughShare * options_.residual_watch_window_s) return std::nullopt;
  const std::optional<ThinnedFlight> halved =
      WithEverySecondRotorSample(mended, flight, OffsetTo(estimate->start));
  ResidualAnalysis found = Examine(flight, halved, *estimate, give_up);
  if (!IsFinite(found) || (give_up && give_up())) return std::nullopt;
  found.flight_s = flight_s;
  found.stamp = log_.odometry.back().stamp;
  const std::string name = found.candidate ? found.candidate->name : "";
  const bool again = name == last_candidate_ && last_model_ == found.model;
  in_a_row_ = name.empty() ? 0 : again ? in_a_row_ + 1 : 1;
  last_candidate_ = name;
  last_model_ = found.model;
  found.in_a_row = in_a_row_;
  return found;
}

ResidualAnalysis ResidualWatch::Examine(const ThinnedFlight& flight,
                                        const std::optional<ThinnedFlight>& halved,
                                        const Estimate& estimate,
                                        const std::function<bool()>& give_up) {
  const DynamicModel& model = *estimate.model;
  ResidualModel residual(&flight, &file_vehicle_, with_torque_);
  residual.BlendSensors(model, estimate.values);
  const int channels = residual.num_channels();
  ResidualAnalysis found;
  found.model = estimate.model;
  const Vehicle asked = WithPriorsOf(file_vehicle_, model.vehicle());
  Attribution attribution(&residual,
                          ModelPointOf(DynamicModel(asked, asked.effects), estimate.values),
                          CandidatesFor(asked, flight.motion()), decision_, give_up);
  attribution.Run();
  ResidualContext context;
  context.again = residual.ForceByMotion(model, estimate.values);
  if (halved) context.by_sampling = ChangeBySampling(residual, *halved, model, estimate.values);
  const std::vector<ChannelStructure> before =
      StructureByChannel(flight, attribution.residual_before(), channels, context, file_vehicle_);
  Summarise(LessStructured(before, StructureByChannel(
                                       flight,
                                       residual.AsFelt(residual.Residual(model, estimate.values),
                                                       model, estimate.values),
                                       channels, context, file_vehicle_)),
            decision_, &found);
  const std::vector<RankedEffect>& effects = attribution.effects();
  if (effects.empty()) return found;
  const std::vector<ChannelStructure> after =
      StructureByChannel(flight, attribution.residual_after(), channels, context, file_vehicle_);
  const double unexplained = UnexplainedStructure(
      attribution.residual_before(), attribution.residual_after(), before, after, decision_);
  // As in CloseLoop(): effects that leave most of the structure are not its cause.
  if (unexplained > decision_.most_unexplained) return found;
  found.candidate = effects.front();
  found.alternatives = effects.front().alternatives;
  for (size_t k = 1; k < effects.size(); ++k) found.beside.push_back(effects[k].name);
  found.refitted = attribution.point().values;
  found.explained_share =
      ExplainedStructure(before, after, decision_.whiteness_p, decision_.noise_p);
  return found;
}

// ---- Adding what was found ---------------------------------------------------------------------

Vehicle WarmStarted(const Vehicle& extended, const ParameterSet& present,
                    const ResidualAnalysis& found) {
  Vehicle warm = extended;
  for (const ParameterEstimate& p : present.parameters) {
    ParameterSetting& setting = warm.parameters[p.full_name];
    setting.value = p.value;
    setting.estimated = p.estimated;
    const auto refitted = found.refitted.find(p.full_name);
    const double moved = refitted == found.refitted.end() ? 0.0 : refitted->second - p.value;
    if (p.estimated && p.sigma > 0.0) setting.sigma = std::hypot(p.sigma, moved);
  }
  if (!found.candidate) return warm;
  for (const ParameterEstimate& p : found.candidate->parameters) {
    if (p.estimated) warm.parameters[p.full_name].value = p.value;
  }
  return warm;
}

}  // namespace odmc
