#include "odmc/attribution/close_loop.h"

#include <algorithm>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <stdexcept>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/parallel.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/gust_case.h"
#include "odmc/attribution/instruments.h"
#include "odmc/attribution/online_evidence.h"
#include "odmc/attribution/online_pass.h"
#include "odmc/attribution/onset.h"
#include "odmc/attribution/sampling_change.h"
#include "odmc/attribution/serial_noise.h"
#include "odmc/attribution/structure.h"
#include "odmc/attribution/unexplained.h"
#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr int kLeastSamples = 50;                                     // to look for effects in
constexpr int kLeastRun = Instruments::kReach + SerialNoise::kOrder;  // before one that counts

std::vector<std::string> NamesOf(const std::vector<RankedEffect>& effects) {
  std::vector<std::string> names;
  names.reserve(effects.size());
  for (const RankedEffect& effect : effects) names.push_back(effect.name);
  return names;
}

bool HasEffect(const std::vector<RankedEffect>& effects, const std::string& name) {
  return std::any_of(effects.begin(), effects.end(),
                     [&](const RankedEffect& e) { return e.name == name; });
}

/// Gusts are wind that comes and goes: not beside itself.
bool CanBlow(const Vehicle& vehicle, const std::vector<RankedEffect>& effects) {
  const bool has =
      std::find(vehicle.effects.begin(), vehicle.effects.end(), "gust") != vehicle.effects.end();
  return !has && !HasEffect(effects, "gust");
}

FlightFigures FlownFlight(const FlightLog& log, const ReplayResult& replay) {
  FlightFigures figures;
  figures.file = log.file;
  figures.duration_s = ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp);
  figures.on_ground_s = replay.counters.on_ground_s;
  figures.keyframes = replay.counters.keyframes;
  figures.dropped =
      log.dropped + replay.stream_counters.not_finite + replay.stream_counters.out_of_order;
  return figures;
}

std::vector<LoopSample> Samples(const std::vector<WrenchError>& before,
                                const std::vector<WrenchError>& after, const BlockSplit& blocks) {
  std::vector<LoopSample> samples;
  const size_t n = std::min(before.size(), after.size());
  samples.reserve(n);
  for (size_t i = 0; i < n; ++i) {
    const WrenchError &b = before[i], &a = after[i];
    LoopSample sample{b.t_s, blocks.IsHeldOut(b.t_s), b.speed_m_s, {}, {}};
    for (int k = 0; k < 3; ++k) {
      sample.before[k] = b.force[k];
      sample.before[k + 3] = b.torque[k];
      sample.after[k] = a.force[k];
      sample.after[k + 3] = a.torque[k];
    }
    samples.push_back(sample);
  }
  return samples;
}

/// Fills in what share of the residual is structured, and how surely. @returns true if some is
bool Summarise(const AttributionOptions& options, ClosedLoop* result) {
  bool structured = false;
  const auto n = static_cast<double>(result->structure.size());
  for (const ChannelStructure& channel : result->structure) {
    const WhitenessResult& whiteness = channel.whiteness;
    if (IsSensorNoise(channel, options)) {
      if (!(whiteness.p < options.whiteness_p)) continue;
      result->warnings.push_back("structure in " + channel.name +
                                 " is noise of the accelerometer, as of vibration: the " +
                                 "motion shows " + Rounded(100.0 * channel.shared->share) + " +- " +
                                 Rounded(100.0 * channel.shared->sigma) + " % of it");
      continue;
    }
    if (IsSlowError(channel, options)) {
      if (!(whiteness.p < options.whiteness_p)) continue;
      result->warnings.push_back(
          "structure in " + channel.name + " is as of " +
          (channel.lean_rad
               ? "an odometry that leans by " + Rounded(*channel.lean_rad) + " rad, slowly"
               : "a thrust that wanders by " + Rounded(100.0 * *channel.thrust_wander) +
                     " % of the weight"));
      continue;
    }
    result->structured_share = std::max(result->structured_share, whiteness.structured_share);
    result->whiteness_p = std::min(result->whiteness_p, n * whiteness.p);
    const bool is_chance = n * whiteness.p >= options.whiteness_p;  // one of n channels
    structured = structured || (IsStructured(channel, options) && !is_chance);
  }
  return structured;
}

constexpr char kGrounded[] = "with it the online estimator takes the flight for contact";

/// A flight's way through the loop: calibrated as declared, attributed, confirmed by the online
/// estimator with what was named, concluded. The steps are called in this order.
class LoopSession {
 public:
  LoopSession(const FlightLog& log, const Vehicle& file_vehicle, const Vehicle& configured,
              const CloseLoopOptions& options, const std::function<void(double)>& progress);

  /// Runs the online estimator with the model as declared. @throws std::invalid_argument
  void Calibrate();
  /// Thins the flight; false, with a warning, where too little of it is left to look at.
  bool HasFlight();
  /// Searches the catalogue for what explains the residual.
  void Attribute();
  /// Adds gusts to the ranking, and to the effects where they make their case.
  void WeighGusts();
  /// Runs the online estimator with the effects, and drops those that it does not bear out.
  void Confirm();
  /// Asks the online estimator for effects of which the regression is no judge.
  void AskOnline();
  /// Runs once more, held near the fit, where the online estimate has left it. The run that
  /// predicts blocks held out better counts.
  void StayNearFit();
  /// Drops the least of the effects as long as the model with them is ruined.
  void DropRuinous();
  /// Adds what the streams may be wrong by to the sigmas, and says which effect hangs on that.
  void WidenForDoubts();
  /// The verdict, and the errors before and after.
  void Conclude();

  ClosedLoop TakeResult() { return std::move(result_); }

 private:
  /// Progress of a part of the whole.
  std::function<void(double)> Part(double from, double to) const;
  Vehicle VehicleWithEffects(const std::vector<RankedEffect>& effects) const;
  std::optional<OnlinePass> RunWith(const std::vector<RankedEffect>& effects,
                                    const std::function<void(double)>& progress) const;
  /// Runs with the effects and, on processors to spare, with what AskOnline() asks for first.
  void RunAndAskAhead(double to);
  std::vector<ChannelStructure> StructureInUse(const ResidualModel::Wrenches& residual) const;
  /// What effects, and gusts that make their case, leave of the wrench.
  ResidualModel::Wrenches Rest() const;
  /// Share of the structure that stays beside the effects, in the channels in which they act.
  double Unexplained() const;
  struct Functions {
    double nats = 0.0;
    std::string first;  ///< that gains most
  };
  Functions FunctionsInNothing() const;
  /// Warns of channels of which the effects named leave most of the structure.
  void NoteRest();
  RankedEffect* RankedOf(const std::string& name);
  /// An onset within a block held out is placed by the whole flight.
  void PlaceOnsets();
  void NoteRefused();
  /// Warns of effects that an error of one stream would explain as well.
  /// @param changes what each of the doubts makes of the parameters of `model`
  void NoteDoubtful(const std::vector<Eigen::VectorXd>& changes, const DynamicModel& model);
  void DropAll(const std::string& why);
  /// Takes an effect out, with what is known for its sake only.
  void Erase(const std::string& name);
  /// The effects, the one with the least score first.
  std::vector<RankedEffect> LeastFirst() const;
  /// Drops all effects where a flexible disturbance explains more than they do. What predicts
  /// blocks held out so much better is its cause all the same.
  void DropUnexplained();
  /// Errors on blocks held out with all effects but this one.
  PredictionFigures FiguresWithout(const RankedEffect& effect) const;
  /// What the online estimate says against an effect; empty: nothing.
  /// @param published the estimate, with what the fit leaves open in its sigmas
  std::string OnlineObjection(const RankedEffect& effect, const ParameterSet& published,
                              const DynamicModel& model) const;
  bool HasClearSecondScore(const RankedEffect& effect) const;
  /// Drops what is zero within its sigma online, and predicts nothing better.
  void DropIdle();
  bool DropOneIdle();
  /// The online estimate with the effects left; drops them where it never flies with them.
  void RunAgain();
  /// Effects of which the regression is no judge, and that are not named yet.
  std::vector<std::string> EffectsToAskFor() const;
  /// Adds an effect of which the regression is no judge, where the online estimate shows it.
  void AskOnlineFor(const std::string& name);
  /// The case for the last of `with` by the online estimate of a model with all of them.
  RankedEffect LastByEstimate(const std::vector<RankedEffect>& with, const OnlinePass& pass) const;
  /// The same by bands of frequency; nothing where they do not know its parameters, or the online
  /// estimate does not show it at all.
  std::optional<RankedEffect> LastByBands(const std::vector<RankedEffect>& with,
                                          const OnlinePass& pass) const;
  /// Runs once more beside errors of the rotors' time stamps.
  /// @param with effects, the last of which is asked for
  /// @returns the case for it there; nothing where there is no such error to ask for
  std::optional<RankedEffect> BesideRotorTiming(std::vector<RankedEffect> with) const;
  bool IsShown(const RankedEffect& effect) const;
  /// Why the online estimate alone does not show the last of `with`; empty: it does.
  /// @param asked its case there; the spread of the run beside rotor timing is added
  std::string OnlineDoubt(const std::vector<RankedEffect>& with, RankedEffect* asked) const;
  /// Runs once more with what bands of frequency know, where they know something.
  void RunWithBands(OnlinePass* pass);
  TorqueBands BandsOf(const DynamicModel& model, const OnlinePass& pass) const;
  AddedEffect Added(const RankedEffect& ranked, const DynamicModel& model);

  const FlightLog& log_;
  const Vehicle& file_vehicle_;
  const Vehicle vehicle_;  ///< as declared
  CloseLoopOptions options_;
  std::function<void(double)> progress_;
  const DynamicModel declared_;
  OnlinePass before_;
  std::unique_ptr<ThinnedFlight> flight_;
  std::unique_ptr<ResidualModel> residual_;
  ResidualContext context_;
  std::vector<EffectCandidate> candidates_;
  std::unique_ptr<Attribution> attribution_;
  std::optional<GustCase> gusts_;  ///< where they make their case
  bool structured_ = false;
  bool judged_ = false;                ///< some stretch is long enough to tell structure from noise
  std::vector<RankedEffect> effects_;  ///< that are named so far
  std::map<std::string, ParameterSetting> known_;  ///< what else the last run is told
  std::optional<OnlinePass> after_;                ///< of the model with `effects_`
  /// A run with effects, made before it is known whether it is asked for; with `known_`.
  struct RunAhead {
    std::vector<std::string> effects;
    std::optional<OnlinePass> pass;
  };
  std::optional<RunAhead> ahead_;
  ClosedLoop result_;
};

LoopSession::LoopSession(const FlightLog& log, const Vehicle& file_vehicle,
                         const Vehicle& configured, const CloseLoopOptions& options,
                         const std::function<void(double)>& progress)
    : log_(log),
      file_vehicle_(file_vehicle),
      vehicle_(WithPriorsOf(file_vehicle, configured)),
      options_(options),
      progress_(progress),
      declared_(vehicle_, vehicle_.effects) {
  if (log.odometry.empty()) return;
  options_.blocks.FitTo(ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp));
}

std::function<void(double)> LoopSession::Part(double from, double to) const {
  return [this, from, to](double share) {
    if (progress_) progress_(from + share * (to - from));
  };
}

Vehicle LoopSession::VehicleWithEffects(const std::vector<RankedEffect>& effects) const {
  return odmc::VehicleWithEffects(vehicle_, attribution_->point(), effects, known_);
}

std::optional<OnlinePass> LoopSession::RunWith(const std::vector<RankedEffect>& effects,
                                               const std::function<void(double)>& progress) const {
  const Vehicle extended = VehicleWithEffects(effects);
  const DynamicModel model(extended, extended.effects);
  return RunOnline(log_, file_vehicle_, model, options_.estimator, options_.blocks, progress);
}

void LoopSession::RunAndAskAhead(double to) {
  std::vector<RankedEffect> with = effects_;
  const std::vector<std::string> asked = EffectsToAskFor();
  const bool ahead = options_.jobs > 1 && !asked.empty();
  if (ahead) with.emplace_back().name = asked.front();
  std::optional<OnlinePass> pass;
  ForEachOf(ahead ? 2 : 1, options_.jobs, [&](int i) {
    if (i == 0) {
      after_ = RunWith(effects_, Part(0.6, to));
    } else {
      pass = RunWith(with, {});
    }
  });
  if (ahead) ahead_ = RunAhead{NamesOf(with), std::move(pass)};
}

void LoopSession::Calibrate() {
  std::optional<OnlinePass> pass = RunOnline(log_, file_vehicle_, declared_, options_.estimator,
                                             options_.blocks, Part(0.0, 0.4));
  if (!pass) throw std::invalid_argument(log_.file + ": never airborne");
  before_ = std::move(*pass);
  result_.declared_parameters = result_.parameters = before_.parameters;
  result_.effect_names = vehicle_.effects;
  result_.before = result_.after = before_.held_out;
  result_.warnings = FlightWarnings(log_, before_.replay);
  const std::string doubt = InertiaDoubt(file_vehicle_);
  if (!doubt.empty()) result_.warnings.push_back(doubt);
  result_.flight = FlownFlight(log_, before_.replay);
  result_.samples = Samples(before_.errors, before_.errors, options_.blocks);
}

bool LoopSession::HasFlight() {
  std::vector<std::pair<Stamp, Stamp>> left_out = NotLookedAt(before_.replay);
  AddGroundTouches(log_, before_.replay.phases, file_vehicle_, &left_out);
  FlightMotion motion = FilterFlight(log_, file_vehicle_.num_rotors(), left_out);
  motion.stood_z_m =
      StandingHeight(log_, before_.replay.phases, file_vehicle_.rotors.front().radius_m);
  flight_ = std::make_unique<ThinnedFlight>(std::move(motion), options_.blocks,
                                            file_vehicle_.odometry.q_BS.toRotationMatrix(),
                                            options_.attribution.most_flight_s);
  int in_use = 0, run = 0, with_past = 0;
  for (int i = 0; i < flight_->size(); ++i) {
    run = flight_->next(i) ? run + 1 : 1;
    if (flight_->held_out(i)) continue;
    ++in_use;
    with_past += run > kLeastRun ? 1 : 0;
  }
  if (in_use >= kLeastSamples && with_past > SerialNoise::kOrder) return true;
  result_.warnings.push_back(
      in_use < kLeastSamples
          ? "too little flight to look for effects: " + std::to_string(in_use) +
                " samples of 40 ms, at least " + std::to_string(kLeastSamples) + " are needed"
          : "too many gaps to look for effects: only " + std::to_string(with_past) +
                " samples have " + Rounded(0.04 * kLeastRun) + " s of flight before them");
  return false;
}

void LoopSession::Attribute() {
  residual_ = std::make_unique<ResidualModel>(flight_.get(), &file_vehicle_, !log_.rotor_rms_only);
  candidates_ = WithoutEffects(CandidatesFor(vehicle_, flight_->motion()), options_.ruled_out);
  const ModelValues& values = before_.replay.last->values;
  residual_->BlendSensors(declared_, values);
  if (residual_->across_by_motion()) {
    result_.warnings.push_back(
        "across the rotors' axes the force is taken from the motion, which shows all that the "
        "accelerometer feels, with less noise; vibration that it samples too slowly?");
  }
  attribution_ =
      std::make_unique<Attribution>(residual_.get(), ModelPointOf(declared_, values), candidates_,
                                    options_.attribution, std::function<bool()>(), options_.jobs);
  attribution_->Run();
  result_.ranking = attribution_->ranking();
  result_.named_gain = attribution_->gain();
  result_.flexible_gain = attribution_->flexible().nats();
  const ResidualModel::Wrenches& before = attribution_->residual_before();
  context_.again = residual_->ForceByMotion(declared_, values);
  if (const auto halved = WithEverySecondRotorSample(log_, *flight_)) {
    context_.by_sampling = ChangeBySampling(*residual_, *halved, declared_, values);
  }
  const int channels = residual_->num_channels();
  result_.structure = LessStructured(
      StructureByChannel(*flight_, before, channels, context_, file_vehicle_),
      StructureByChannel(
          *flight_, residual_->AsFelt(residual_->Residual(declared_, values), declared_, values),
          channels, context_, file_vehicle_));
  if (!attribution_->ordinary().empty() && attribution_->effects().empty()) {
    result_.structure = LessStructured(
        result_.structure, StructureByChannel(*flight_, attribution_->residual_after(), channels,
                                              context_, file_vehicle_));
  }
  structured_ = Summarise(options_.attribution, &result_);
  const std::vector<std::vector<double>> runs = flight_->Runs(before.col(0));
  judged_ = std::any_of(runs.begin(), runs.end(),
                        [](const auto& run) { return run.size() >= kShortestRun; });
  if (!judged_) {
    result_.warnings.push_back(
        "no stretch without gaps is long enough to tell structure from noise: " +
        Rounded(kShortestRun * flight_->step_s()) + " s are needed");
  }
  if (progress_) progress_(0.6);
  effects_ = attribution_->effects();
  PlaceOnsets();
  for (const RankedEffect& ordinary : attribution_->ordinary()) {
    result_.warnings.push_back(OrdinaryText(vehicle_, ordinary));
  }
  NoteRefused();
}

void LoopSession::PlaceOnsets() {
  const ModelPoint& point = attribution_->point();
  const DynamicModel model(point.vehicle, point.vehicle.effects);
  const ModelValues values = ValuesOf(model, point.values);
  for (RankedEffect& effect : effects_) {
    const std::optional<double> onset_s = OnsetByWholeFlight(effect, *residual_, model, values);
    if (!onset_s) continue;
    const std::string name =
        effect.name + "." +
        EffectRegistry::Default().Make(effect.name, vehicle_)->onset_parameter();
    effect.settings[name] = *onset_s;
    for (ParameterEstimate& p : effect.parameters) {
      if (p.full_name == name) p.value = *onset_s;
    }
  }
}

RankedEffect* LoopSession::RankedOf(const std::string& name) {
  const auto at = std::find_if(result_.ranking.begin(), result_.ranking.end(),
                               [&](const RankedEffect& e) { return e.name == name; });
  return at == result_.ranking.end() ? nullptr : &*at;
}

void LoopSession::NoteRefused() {
  for (const auto& [name, why] : attribution_->refused()) {
    RankedEffect* ranked = RankedOf(name);
    if (HasEffect(effects_, name) || ranked == nullptr) continue;
    ranked->remarks.push_back("not named: it " + why);
  }
}

void LoopSession::WeighGusts() {
  if (std::count(options_.ruled_out.begin(), options_.ruled_out.end(), "gust") > 0) return;
  GustCase gusts = RankGusts(*residual_, attribution_->point(), attribution_->residual_after(),
                             before_.parameters, attribution_->flexible().of_force,
                             options_.attribution, options_.jobs);
  result_.ranking.push_back(gusts.ranked);
  if (IsGusty(gusts, options_.attribution) && CanBlow(vehicle_, effects_)) {
    gusts_ = std::move(gusts);
  }
}

std::vector<ChannelStructure> LoopSession::StructureInUse(
    const ResidualModel::Wrenches& residual) const {
  return StructureByChannel(*flight_, residual, residual_->num_channels(), context_, file_vehicle_,
                            true);
}

ResidualModel::Wrenches LoopSession::Rest() const {
  ResidualModel::Wrenches rest = attribution_->residual_after();
  if (gusts_) rest -= gusts_->foreseen;
  return rest;
}

double LoopSession::Unexplained() const {
  const ResidualModel::Wrenches& before = attribution_->residual_before();
  const ResidualModel::Wrenches rest = Rest();
  std::vector<ChannelStructure> of_before = StructureInUse(before);
  DropErrorsOfFit(result_.structure, options_.attribution, &of_before);
  const double left =
      UnexplainedStructure(before, rest, of_before, StructureInUse(rest), options_.attribution);
  if (gusts_) return left;  // functions of the state would follow them
  // What functions of the state gain beside the effects, of the force or torque on which these act.
  const FlexibleRest& flexible = attribution_->flexible();
  const auto& explained = attribution_->explained();
  const double of_force = std::accumulate(explained.begin(), explained.begin() + 3, 0.0);
  const double of_torque = std::accumulate(explained.begin() + 3, explained.end(), 0.0);
  const double least = options_.attribution.least_structured * (of_force + of_torque);
  const double functions =
      (of_force > least ? flexible.of_force : 0.0) + (of_torque > least ? flexible.of_torque : 0.0);
  const double gained = functions + attribution_->gain();
  return gained > 0.0 ? std::max(left, functions / gained) : left;
}

/// What functions of the state gain where nothing acts. Those of a force would follow slow errors
/// of an attitude or a thrust.
LoopSession::Functions LoopSession::FunctionsInNothing() const {
  const AttributionOptions& options = options_.attribution;
  const FlexibleRest& flexible = attribution_->flexible();
  const bool drifts = std::any_of(
      result_.structure.begin(), result_.structure.end(), [&](const ChannelStructure& channel) {
        return channel.whiteness.p < options.whiteness_p && IsSlowError(channel, options);
      });
  if (drifts) return {flexible.of_torque, flexible.first_of_torque};
  return {flexible.nats(), flexible.first};
}

/// An effect of the torque says nothing of what the force shows. Gusts may be all of the force:
/// what of them cannot be foreseen is in the rest.
void LoopSession::NoteRest() {
  const std::vector<ChannelStructure> before = StructureInUse(attribution_->residual_before());
  const std::vector<ChannelStructure> rest = StructureInUse(Rest());
  std::string channels;
  for (size_t c = HasEffect(effects_, "gust") ? 3 : 0; c < rest.size(); ++c) {
    if (!IsStructured(rest[c], options_.attribution)) continue;
    const double left = rest[c].whiteness.nats / before[c].whiteness.nats;
    if (!(left > options_.attribution.most_unexplained)) continue;
    channels += (channels.empty() ? "" : ", ") + rest[c].name;
  }
  if (channels.empty()) return;
  result_.warnings.push_back("most of the structure of " + channels +
                             " stays unexplained beside the effects named");
}

void LoopSession::DropAll(const std::string& why) {
  for (const RankedEffect& effect : effects_) {
    result_.warnings.push_back(effect.name + " gains " + Rounded(effect.score) + " nats, but " +
                               why);
  }
  effects_.clear();
  after_.reset();
  known_.clear();
  gusts_.reset();
}

void LoopSession::DropUnexplained() {
  const double unexplained = Unexplained();
  if (effects_.empty() || unexplained <= options_.attribution.most_unexplained) return;
  gusts_.reset();  // they were looked for beside the effects
  after_ = RunWith(effects_, Part(0.6, 1.0));
  const double ratio = after_ ? RatiosOf(before_.held_out, after_->held_out).least : 1.0;
  if (after_ && ratio <= options_.attribution.telling_ratio) return;
  DropAll(Rounded(100.0 * unexplained) + " % of the structure stays unexplained beside it");
}

PredictionFigures LoopSession::FiguresWithout(const RankedEffect& effect) const {
  std::vector<RankedEffect> others;
  for (const RankedEffect& other : effects_) {
    if (other.name != effect.name) others.push_back(other);
  }
  if (others.empty()) return before_.held_out;
  const std::optional<OnlinePass> without = RunWith(others, Part(0.6, 1.0));
  return without ? without->held_out : before_.held_out;
}

std::string LoopSession::OnlineObjection(const RankedEffect& effect, const ParameterSet& published,
                                         const DynamicModel& model) const {
  if (!SizeDiffersFromZero(effect, published, model, options_.attribution.least_size_sigmas)) {
    return "its size is zero within its standard deviation:" +
           EstimatesText(effect, published, model);
  }
  // What speaks for it is the fit's. Where the estimate contradicts the fit by more than that, or
  // the fit's second score is no clear one, it has to show a size or predict better; and where it
  // contradicts, it must not ruin what it ought to predict.
  const bool contradicts = NatsAgainst(effect, after_->parameters, model) >= effect.score;
  if (HasClearSecondScore(effect) && !contradicts) return "";
  const bool is_there = SizeDiffersFromZero(effect, after_->parameters, model,
                                            options_.attribution.significant_sigmas);
  if (is_there && !contradicts) return "";
  const PredictionFigures without = FiguresWithout(effect);
  const ErrorRatios ratios = RatiosOf(without, after_->held_out, true);
  const bool predicts = ratios.least < options_.attribution.least_ratio &&
                        LogError(after_->held_out) < LogError(without);
  const bool ruins = ratios.largest > 1.0 / options_.attribution.telling_ratio;
  if (!(contradicts && ruins) && (predicts || is_there)) return "";
  return std::string("the online estimate ") +
         (contradicts && ruins
              ? "contradicts that by more, and an axis is predicted twice as badly with it:"
              : "is zero within three sigma, and predicts nothing better:") +
         EstimatesText(effect, after_->parameters, model);
}

bool LoopSession::HasClearSecondScore(const RankedEffect& effect) const {
  return !effect.second_score || *effect.second_score >= options_.attribution.clear_odds;
}

void LoopSession::Erase(const std::string& name) {
  const auto is_it = [&](const RankedEffect& effect) { return effect.name == name; };
  effects_.erase(std::remove_if(effects_.begin(), effects_.end(), is_it), effects_.end());
  after_.reset();
  if (name != "gust" || !gusts_) return;
  for (const auto& entry : gusts_->known) known_.erase(entry.first);
  gusts_.reset();
}

std::vector<RankedEffect> LoopSession::LeastFirst() const {
  std::vector<RankedEffect> effects = effects_;
  std::sort(effects.begin(), effects.end(),
            [](const auto& a, const auto& b) { return a.score < b.score; });
  return effects;
}

bool LoopSession::DropOneIdle() {
  const Vehicle extended = VehicleWithEffects(effects_);
  const DynamicModel model(extended, extended.effects);
  ParameterSet published = after_->parameters;
  for (const RankedEffect& effect : effects_) AddSpread(effect, &published);
  for (const RankedEffect& effect : LeastFirst()) {
    const std::string objection = OnlineObjection(effect, published, model);
    if (objection.empty()) continue;
    result_.warnings.push_back(effect.name + " gains " + Rounded(effect.score) + " nats, but " +
                               objection);
    RankedEffect* ranked = RankedOf(effect.name);
    if (!HasClearSecondScore(effect) && ranked != nullptr) {
      ranked->score = std::min(ranked->score, *effect.second_score);
      ranked->p_value = attribution_->PValue(ranked->score);
    }
    result_.denied.push_back(effect.name);
    Erase(effect.name);
    return true;
  }
  return false;
}

// One after the other: of two that stand in for each other the larger is left.
void LoopSession::DropIdle() {
  while (!effects_.empty() && DropOneIdle()) RunAgain();
}

void LoopSession::DropRuinous() {
  while (!effects_.empty() && Ruins(before_.held_out, after_->held_out, options_.attribution)) {
    const RankedEffect least = LeastFirst().front();
    result_.warnings.push_back(least.name + " gains " + Rounded(least.score) +
                               " nats, but with the effects the model predicts an axis twice as "
                               "badly, and all axes together worse");
    Erase(least.name);
    RunAgain();
  }
}

void LoopSession::RunAgain() {
  if (effects_.empty()) return;
  after_ = RunWith(effects_, Part(0.6, 1.0));
  if (!after_) DropAll(kGrounded);
}

void LoopSession::Confirm() {
  DropUnexplained();
  if (gusts_) {
    effects_.push_back(gusts_->ranked);
    known_ = gusts_->known;
  }
  if (effects_.empty()) return;
  if (!after_) RunAndAskAhead(0.8);
  if (!after_) return DropAll(kGrounded);
  StayNearFit();
  DropIdle();
  DropRuinous();
}

TorqueBands LoopSession::BandsOf(const DynamicModel& model, const OnlinePass& pass) const {
  const ReplayResult& replay = pass.replay;
  const int k_f = model.IndexOf("thrust.k_f");
  return FindTorqueBands(log_, model, replay.last->values, k_f >= 0 ? replay.last->sigma[k_f] : 0.0,
                         replay.ground_spans);
}

void LoopSession::RunWithBands(OnlinePass* pass) {
  const Vehicle extended = VehicleWithEffects(effects_);
  const DynamicModel model(extended, extended.effects);
  const auto by_bands = KnownByBands(BandsOf(model, *pass), model, pass->replay.last->values);
  if (by_bands.empty()) return;
  const std::map<std::string, ParameterSetting> without = known_;
  known_.insert(by_bands.begin(), by_bands.end());
  std::optional<OnlinePass> better = RunWith(effects_, Part(0.6, 1.0));
  if (!better) {
    known_ = without;
    return;
  }
  *pass = std::move(*better);
  // Bands know shares of I_z.
  const ParameterEstimate* inertia = pass->parameters.Find("inertia.z");
  if (inertia == nullptr || !inertia->estimated || !(inertia->value > 0.0)) return;
  for (RankedEffect& effect : effects_) {
    AddScaleSpread(by_bands, inertia->sigma / inertia->value, &effect);
  }
}

RankedEffect LoopSession::LastByEstimate(const std::vector<RankedEffect>& with,
                                         const OnlinePass& pass) const {
  const Vehicle extended = VehicleWithEffects(with);
  const DynamicModel model(extended, extended.effects);
  return RankedByEstimate(with.back().name, pass.parameters, model, EffectsOf(candidates_).size(),
                          options_.attribution.log_prior_odds);
}

std::optional<RankedEffect> LoopSession::LastByBands(const std::vector<RankedEffect>& with,
                                                     const OnlinePass& pass) const {
  const Vehicle extended = VehicleWithEffects(with);
  const DynamicModel model(extended, extended.effects);
  if (!SizeDiffersFromZero(with.back(), pass.parameters, model,
                           options_.attribution.significant_sigmas)) {
    return std::nullopt;
  }
  const auto known = KnownByBands(BandsOf(model, pass), model, pass.replay.last->values);
  return RankedByBands(with.back().name, known, pass.parameters, model,
                       EffectsOf(candidates_).size(), options_.attribution.log_prior_odds);
}

std::optional<RankedEffect> LoopSession::BesideRotorTiming(std::vector<RankedEffect> with) const {
  bool is_beside = false;
  for (const std::string& name : RotorTimingEffects(vehicle_, candidates_)) {
    if (HasEffect(with, name)) continue;
    with.insert(with.end() - 1, RankedEffect())->name = name;
    is_beside = true;
  }
  if (!is_beside) return std::nullopt;
  const std::optional<OnlinePass> pass = RunWith(with, Part(0.6, 1.0));
  if (!pass) return std::nullopt;
  return LastByEstimate(with, *pass);
}

bool LoopSession::IsShown(const RankedEffect& effect) const {
  return effect.p_value < options_.attribution.false_alarm_rate;
}

std::string LoopSession::OnlineDoubt(const std::vector<RankedEffect>& with,
                                     RankedEffect* asked) const {
  if (!IsShown(*asked)) {
    return "the online estimate, which weighs all frequencies, is too uncertain by itself";
  }
  const std::optional<RankedEffect> beside = BesideRotorTiming(with);
  if (!beside) return "";
  if (IsShown(*beside)) {
    AddAlternativeSpread(*beside, asked);
    return "";
  }
  return "rotor speeds stamped late or early do the same; beside that, chance may gain as much "
         "in " +
         Rounded(100.0 * beside->p_value) + " % of such flights";
}

void LoopSession::AskOnlineFor(const std::string& name) {
  std::vector<RankedEffect> with = effects_;
  with.emplace_back().name = name;
  const bool is_known = ahead_ && ahead_->effects == NamesOf(with);
  std::optional<OnlinePass> pass =
      is_known ? std::move(ahead_->pass) : RunWith(with, Part(0.6, 1.0));
  ahead_.reset();
  if (!pass) return;
  RankedEffect& asked = with.back();
  asked = LastByEstimate(with, *pass);
  RankedEffect* ranked = RankedOf(name);
  const std::string objection = OnlineDoubt(with, &asked);
  if (!objection.empty()) {
    const std::optional<RankedEffect> banded = LastByBands(with, *pass);
    if (!banded || !IsShown(*banded)) {
      if (IsShown(asked) && ranked != nullptr) {
        ranked->remarks.push_back("not named: " + objection);
      }
      return;
    }
    asked = *banded;
    asked.remarks.push_back("bands of frequency show it where rotor torque leads; " + objection);
  }
  if (ranked != nullptr) *ranked = asked;
  effects_ = std::move(with);
  RunWithBands(&*pass);
  after_ = std::move(pass);
}

void LoopSession::AskOnline() {
  for (const std::string& name : EffectsToAskFor()) {
    if (static_cast<int>(effects_.size()) < options_.attribution.most_effects) AskOnlineFor(name);
  }
}

std::vector<std::string> LoopSession::EffectsToAskFor() const {
  if (log_.rotor_rms_only) return {};
  std::vector<std::string> names = QuickEffects(vehicle_, candidates_);
  const auto is_named = [this](const std::string& name) { return HasEffect(effects_, name); };
  names.erase(std::remove_if(names.begin(), names.end(), is_named), names.end());
  return names;
}

// The window lets go of what was linearized where the estimate was at the time, and a product, such
// as a mass times its place, may then be on its way to another valley.
void LoopSession::StayNearFit() {
  constexpr double kSigmas = 3.0;  // the flight counts twice, once with a ninth of its weight
  if (!after_) return;
  const Vehicle extended = VehicleWithEffects(effects_);
  const DynamicModel model(extended, extended.effects);
  const auto any = [this](const auto& is) {
    return std::any_of(effects_.begin(), effects_.end(), is);
  };
  const bool contradicts = Ruins(before_.held_out, after_->held_out, options_.attribution) ||
                           any([this](const RankedEffect& effect) {
                             return ContradictsFit(effect, after_->parameters);
                           });
  const bool is_nothing = any([&](const RankedEffect& effect) {
    return !SizeDiffersFromZero(effect, after_->parameters, model,
                                options_.attribution.least_size_sigmas);
  });
  if (!contradicts && !is_nothing) return;
  const std::map<std::string, ParameterSetting> without = known_;
  for (const RankedEffect& effect : effects_) {
    for (const ParameterEstimate& p : effect.parameters) {
      if (!p.estimated || !(p.sigma > 0.0)) continue;
      known_[p.full_name].value = p.value;
      known_[p.full_name].sigma = kSigmas * p.sigma;
    }
  }
  std::optional<OnlinePass> near = RunWith(effects_, Part(0.6, 1.0));
  if (near && TakesPlace(near->held_out, after_->held_out, contradicts, options_.attribution)) {
    after_ = std::move(near);
    ahead_.reset();
  } else {
    known_ = without;
  }
}

AddedEffect LoopSession::Added(const RankedEffect& ranked, const DynamicModel& model) {
  const std::string other = Disagreement(ranked, after_->parameters, model, options_.attribution);
  if (!other.empty()) {
    result_.warnings.push_back(ranked.name + ": the online run disagrees, " + other);
  }
  AddedEffect effect;
  effect.effect = ranked;
  effect.alternatives = ranked.alternatives;
  for (const std::string& name : effect.alternatives) {
    if (!effect.manoeuvre.empty()) break;
    effect.manoeuvre = TellingManoeuvre(vehicle_, ranked.name, name);
  }
  effect.derived = DerivedFigures(vehicle_, ranked.name, after_->parameters);
  for (ParameterEstimate& p : effect.effect.parameters) {
    const ParameterEstimate* online = after_->parameters.Find(p.full_name);
    if (online != nullptr && (online->estimated || !p.estimated)) p = *online;
  }
  return effect;
}

void LoopSession::NoteDoubtful(const std::vector<Eigen::VectorXd>& changes,
                               const DynamicModel& model) {
  if (changes.size() != options_.doubts.size()) return;  // an estimate failed
  for (const RankedEffect& effect : effects_) {
    if (!SizeDiffersFromZero(effect, after_->parameters, model,
                             options_.attribution.significant_sigmas))
      continue;
    std::string errors;
    for (size_t k = 0; k < changes.size(); ++k) {
      if (!SizeMayBeZero(effect, after_->parameters, changes[k], model, options_.attribution))
        continue;
      errors += (errors.empty() ? "" : "; ") + Sentence(options_.doubts[k]);
    }
    if (errors.empty()) continue;
    result_.warnings.push_back(effect.name + " may be an error of the recording (" + errors +
                               "), which the flight does not exclude");
  }
}

// What is left of a delay is that of the recording as it is: other stamps would move it, and be
// no error of it.
void LoopSession::WidenForDoubts() {
  if (options_.doubts.empty()) return;
  OnlinePass& pass = effects_.empty() ? before_ : *after_;
  const Vehicle vehicle = effects_.empty() ? vehicle_ : VehicleWithEffects(effects_);
  const DynamicModel model(vehicle, vehicle.effects);
  const Stamp from = pass.replay.last->stamp - FromSeconds(kLongestDoubt_s);
  std::vector<Eigen::VectorXd> changes =
      ChangesWithout(options_.doubts, log_, from, model, options_.estimator);
  for (const std::string& name : RotorTimingEffects(vehicle_, candidates_)) {
    for (int k = 0; k < model.num_parameters(); ++k) {
      if (model.parameters()[k].effect != name) continue;
      for (Eigen::VectorXd& change : changes) change[k] = 0.0;
    }
  }
  NoteDoubtful(changes, model);
  Widen(changes, &pass.parameters);
  if (effects_.empty()) result_.parameters = before_.parameters;
}

void LoopSession::Conclude() {
  result_.accelerometer_before = result_.accelerometer_after =
      before_.held_out.accelerometer_force_rmse_N;
  const Vehicle final_vehicle = effects_.empty() ? vehicle_ : VehicleWithEffects(effects_);
  const DynamicModel model(final_vehicle, final_vehicle.effects);
  if (!effects_.empty()) {
    result_.verdict = Verdict::kEffect;
    for (const RankedEffect& effect : effects_) AddSpread(effect, &after_->parameters);
    result_.after = after_->held_out;
    result_.accelerometer_after = after_->held_out.accelerometer_force_rmse_N;
    result_.parameters = after_->parameters;
    result_.effect_names = final_vehicle.effects;
    result_.samples = Samples(before_.errors, after_->errors, options_.blocks);
    for (const RankedEffect& ranked : effects_) result_.effects.push_back(Added(ranked, model));
    NoteRest();
  } else if (structured_) {
    result_.verdict = Verdict::kUnexplained;
    result_.where = WhereStructured(result_.structure, *flight_, attribution_->residual_before(),
                                    options_.attribution);
  } else if (const Functions functions = FunctionsInNothing(); judged_ && functions.nats > 0.0) {
    result_.verdict = Verdict::kUnexplained;
    result_.where =
        functions.first + "; functions of the state gain " + Rounded(functions.nats) + " nats";
  } else {
    result_.where = PushInFlight(before_.replay, log_.odometry.front().stamp);
    if (!result_.where.empty()) result_.verdict = Verdict::kUnexplained;
  }
  SortByScore(&result_.ranking);  // gusts, and what the estimator was asked for, came last
  result_.nominal_inertia = file_vehicle_.inertia_kg_m2;
  result_.bands = BandsOf(model, effects_.empty() ? before_ : *after_);
  const std::string reaction = ReactionWarning(result_.bands);
  if (!reaction.empty()) result_.warnings.push_back(reaction);
  const std::string rotors = RotorInertiaWarning(result_.bands);
  if (model.IndexOf("rotor_reaction.J_r") < 0 && !rotors.empty()) {
    result_.warnings.push_back(rotors);
  }
}

}  // namespace

std::vector<std::pair<Stamp, Stamp>> NotLookedAt(const ReplayResult& replay) {
  Stamp contact = 0, flying = 0;
  std::vector<std::pair<Stamp, Stamp>> others;
  for (const PhaseSpan& span : replay.phases) {
    if (span.phase == FlightPhase::kInContact) {
      contact += span.to - span.from;
    } else if (Teaches(span.phase)) {
      flying += span.to - span.from;
    } else {
      others.emplace_back(span.from, span.to);
    }
  }
  return contact > flying ? others : replay.ground_spans;
}

std::string NameOf(Verdict verdict) {
  switch (verdict) {
    case Verdict::kEffect:
      return "effect";
    case Verdict::kUnexplained:
      return "unexplained";
    default:
      return "none";
  }
}

void HoldKnownThrust(const AttributionOptions& options, Vehicle* vehicle) {
  const auto it = vehicle->parameters.find("thrust.k_f");
  if (it == vehicle->parameters.end() || !it->second.value || !it->second.sigma) return;
  const double limit = options.known_thrust_share * *it->second.value;
  if (*it->second.sigma < limit) it->second.estimated = false;
}

namespace {

ClosedLoop LookOnce(const FlightLog& log, const Vehicle& file_vehicle, const Vehicle& configured,
                    const CloseLoopOptions& options, const std::function<void(double)>& progress) {
  LoopSession session(log, file_vehicle, configured, options, progress);
  session.Calibrate();
  const bool has_flight = session.HasFlight();
  if (has_flight) {
    session.Attribute();
    session.WeighGusts();
    session.Confirm();
    session.AskOnline();
    session.StayNearFit();
    session.DropRuinous();
  }
  session.WidenForDoubts();
  if (has_flight) session.Conclude();
  return session.TakeResult();
}

}  // namespace

ClosedLoop BetterLook(ClosedLoop first, ClosedLoop again) {
  if (again.effects.empty() || !(LogError(again.after) < LogError(first.after))) return first;
  again.warnings.push_back("an effect that the fit chose first is denied by the online estimate (" +
                           Listed(first.denied) +
                           "); without it others explain the flight, and predict it better");
  return again;
}

ClosedLoop CloseLoop(const FlightLog& log, const Vehicle& file_vehicle, const Vehicle& configured,
                     const CloseLoopOptions& options, const std::function<void(double)>& progress) {
  ClosedLoop loop = LookOnce(log, file_vehicle, configured, options, progress);
  if (loop.denied.empty()) return loop;
  CloseLoopOptions without = options;
  without.ruled_out.insert(without.ruled_out.end(), loop.denied.begin(), loop.denied.end());
  return BetterLook(std::move(loop), LookOnce(log, file_vehicle, configured, without, {}));
}

}  // namespace odmc
