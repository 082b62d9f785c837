#include "odmc/analysis/calibration.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/analysis/ground_spans.h"
#include "odmc/analysis/phase_findings.h"
#include "odmc/math/statistics.h"
#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kConvergedShare = 0.05;  // of the final value
constexpr double kLeastFlight_s = 3.0;    // what the window holds before anything may leave it
constexpr double kMostBlocks = 1000.0;    // to leave out in turn
constexpr double kInertiaLow = 0.5, kInertiaHigh = 2.0;
constexpr double kSignSigmas = 3.0;    // one-sided, by chance once in 740 parameters
constexpr double kKnownInertia = 0.1;  // of the value: far below the vehicle file's 40 %
constexpr double kGainLow = 0.85, kGainHigh = 1.15;

double DurationOf(const FlightLog& log) {
  return log.odometry.empty() ? 0.0
                              : ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp);
}

bool IsIn(TimingPart part, double time_s, const ReplayResult& replay) {
  const bool is_start = time_s < replay.first_airborne_s + kTimingStart_s;
  return is_start == (part == TimingPart::kStart);
}

/// "x 0.4, z 1.2" of the axes where `wrong` holds; empty if none.
template <typename Wrong>
std::string Axes(const PredictionFigures::Axes& figure, Wrong wrong) {
  std::vector<std::string> axes;
  for (int i = 0; figure && i < 3; ++i) {
    if (wrong(i)) axes.push_back(std::string(1, "xyz"[i]) + " " + Rounded((*figure)[i]));
  }
  return Listed(axes);
}

void WarnOutside(const PredictionFigures::Axes& figure, double low, double high,
                 const std::string& what, std::vector<std::string>* warnings) {
  const std::string axes =
      Axes(figure, [&](int i) { return (*figure)[i] < low || (*figure)[i] > high; });
  if (axes.empty()) return;
  warnings->push_back(what + " is outside " + Rounded(low) + " to " + Rounded(high) + ": " + axes);
}

void WarnCount(long count, const std::string& one, const std::string& many,
               std::vector<std::string>* warnings) {
  if (count > 0) warnings->push_back(std::to_string(count) + " " + (count == 1 ? one : many));
}

template <typename T>
void Append(const std::vector<T>& more, std::vector<T>* all) {
  all->insert(all->end(), more.begin(), more.end());
}

/// "from 0.1 to 12 s", counted from the first pose.
template <typename Sample>
std::string Span(const std::vector<Sample>& samples, const FlightLog& log) {
  if (samples.empty()) return "none";
  const Stamp zero = log.odometry.front().stamp;
  return "from " + Rounded(ToSeconds(samples.front().stamp - zero)) + " to " +
         Rounded(ToSeconds(samples.back().stamp - zero)) + " s after the first pose";
}

/// Where every pose is a gap after the one before.
void WarnOfSlowOdometry(const FlightLog& log, const ReplayResult& replay,
                        std::vector<std::string>* warnings) {
  const long gaps = replay.counters.gaps;
  if (gaps == 0 || 2 * gaps < replay.counters.keyframes || log.odometry.size() < 3) return;
  std::vector<double> steps_s;
  for (size_t i = 1; i < log.odometry.size(); ++i) {
    steps_s.push_back(ToSeconds(log.odometry[i].stamp - log.odometry[i - 1].stamp));
  }
  warnings->push_back(
      "hardly anything can be learned: between most keyframes there is a gap. "
      "Odometry comes every " +
      Rounded(Median(steps_s)) + " s; compare max_gap_s, and the times of the rotor speeds (" +
      Span(log.rotors, log) + ")");
}

/// The rotor torque gain, where the estimate knows the inertia as that gives it: measured torque is
/// made with the vehicle file's, which may be off.
PredictionFigures::Axes GainByEstimate(const DynamicModel& model, const ModelValues& values,
                                       const Eigen::VectorXd& sigma,
                                       const PredictionFigures& figures) {
  PredictionFigures::Axes gain = figures.rotor_torque_gain;
  if (!gain || !figures.inertia_over_nominal) return gain;
  for (int axis = 0; axis < 3; ++axis) {
    const int k = model.IndexOf(std::string("inertia.") + "xyz"[axis]);
    const bool knows = k >= 0 && sigma[k] > 0.0 && sigma[k] < kKnownInertia * values[k];
    if (knows) (*gain)[axis] *= (*figures.inertia_over_nominal)[axis];
  }
  return gain;
}

void WarnOfReaction(const TorqueBands& bands, std::vector<std::string>* warnings) {
  const std::string warning = ReactionWarning(bands);
  if (!warning.empty()) warnings->push_back(warning);
}

/// Brings the sigmas to what the thirds of the flight show.
void WidenBy(const std::vector<ThirdsDifference>& thirds, Snapshot* snapshot) {
  for (const ThirdsDifference& d : thirds) {
    const double widening = std::max(1.0, d.spread / snapshot->sigma[d.index]);
    snapshot->sigma[d.index] *= widening;
    snapshot->inflation[d.index] *= widening;
    snapshot->covariance.row(d.index) *= widening;
    snapshot->covariance.col(d.index) *= widening;
  }
}

/// What the estimator makes of a flight.
struct Learned {
  ReplayResult replay;
  std::vector<ThirdsDifference> thirds;  ///< by which the sigmas are widened
};

/// @param declared by whose priors it is judged what is observable
Learned Learn(const FlightLog& log, const DynamicModel& model, const DynamicModel& declared,
              const EstimatorOptions& options, const std::function<void(double)>& progress) {
  Estimator estimator(&model, options, !log.rotor_rms_only);
  estimator.JudgeBy(declared);
  Learned learned;
  learned.replay = Replay(log, &estimator, progress);
  if (!learned.replay.last) return learned;
  learned.thirds = estimator.CompareThirds();
  WidenBy(learned.thirds, &*learned.replay.last);
  return learned;
}

TorqueBands BandsOf(const FlightLog& log, const DynamicModel& model, const ReplayResult& replay) {
  const int k_f = model.IndexOf("thrust.k_f");
  return FindTorqueBands(log, model, replay.last->values, k_f >= 0 ? replay.last->sigma[k_f] : 0.0,
                         replay.ground_spans);
}

/// What frequencies know, and the estimate does not.
struct KnownByFrequency {
  std::map<std::string, ParameterSetting> inertia;
  TakenPoint taken;

  bool empty() const { return inertia.empty() && taken.point.empty(); }
};

/// The vehicle and the options with what frequencies know.
std::pair<Vehicle, EstimatorOptions> WithKnown(const KnownByFrequency& known,
                                               const DynamicModel& model,
                                               const EstimatorOptions& options) {
  // The estimator takes all errors for white noise, and would leave the point again.
  constexpr double kHeld = 0.01;  // of the sigma by which it is known
  std::pair<Vehicle, EstimatorOptions> told(model.vehicle(), options);
  told.first.effects.clear();
  for (int i = 0; i < model.num_effects(); ++i) {
    told.first.effects.push_back(model.effect(i).name());
  }
  const auto tell = [&](const std::map<std::string, ParameterSetting>& settings, double share) {
    for (const auto& [name, setting] : settings) {
      told.first.parameters[name].value = setting.value;
      told.first.parameters[name].sigma = share * *setting.sigma;
    }
  };
  tell(known.inertia, 1.0);
  for (const auto& entry : known.inertia) {
    told.second.inertia_is_known[static_cast<size_t>(entry.first.back() - 'x')] = true;
  }
  tell(known.taken.point, kHeld);
  tell(known.taken.held, kHeld);
  return told;
}

/// Gives what was held the sigma by which it is known. The force shows how far the point is from
/// the centre of gravity: where that was held, too, both may be off by the same.
void WidenHeld(const TakenPoint& taken, const DynamicModel& model, Snapshot* snapshot) {
  const Eigen::VectorXd sigma_held = snapshot->sigma;
  Eigen::MatrixXd& C = snapshot->covariance;
  for (const auto& [name, setting] : taken.point) {
    const int k = model.IndexOf(name);
    const double widening = *setting.sigma / std::sqrt(C(k, k));
    C.row(k) *= widening;
    C.col(k) *= widening;
    const auto held = taken.held.find(std::string("centre_of_gravity.") + name.back());
    if (held == taken.held.end()) continue;
    Eigen::VectorXd shift = Eigen::VectorXd::Zero(C.rows());
    shift[k] = shift[model.IndexOf(held->first)] = *held->second.sigma;
    C += shift * shift.transpose();
  }
  for (const auto* some : {&taken.point, &taken.held}) {
    for (const auto& entry : *some) {
      const int k = model.IndexOf(entry.first);
      const std::string centre = std::string("centre_of_gravity.") + entry.first.back();
      snapshot->sigma[k] = std::sqrt(C(k, k));
      // Of a pair the sum and the difference are known, which no factor of either one tells.
      snapshot->inflation[k] = taken.held.count(centre) > 0
                                   ? 1.0
                                   : snapshot->inflation[k] * snapshot->sigma[k] / sigma_held[k];
    }
  }
}

/// The same flight once more, with what frequencies know better than the estimate: the inertia, and
/// the recorded point.
void LearnWithBands(const FlightLog& log, const DynamicModel& model,
                    const EstimatorOptions& options, const std::function<void(double)>& progress,
                    Learned* learned, Calibration* result) {
  const Snapshot& last = *learned->replay.last;
  KnownByFrequency known;
  if (!log.rotor_rms_only) known.inertia = InertiaByBands(result->bands, model, last.sigma);
  known.taken = TakePoint(result->point, model, last.values, last.sigma);
  if (known.empty()) return;
  const auto [vehicle, told] = WithKnown(known, model, options);
  Learned again = Learn(log, DynamicModel(vehicle, vehicle.effects), model, told, progress);
  if (!again.replay.last) return;
  WidenHeld(known.taken, model, &*again.replay.last);
  *learned = std::move(again);
  result->by_bands = known.inertia;
  result->taken_point = known.taken;
}

/// A result that rests on a few moments of flight, or shows no thrust.
std::vector<Finding> LittleFlight(const ReplayResult& replay, const DynamicModel& model) {
  const int k_f = model.IndexOf("thrust.k_f");
  const bool is_hidden =
      k_f >= 0 && model.parameters()[k_f].estimated && !replay.last->observable[k_f];
  if (replay.counters.airborne_s >= kLeastFlight_s && !is_hidden) return {};
  Finding finding;
  finding.check = "short_flight";
  finding.leaves = Trust::kDoubtful;
  finding.what =
      "the estimate rests on " + Rounded(replay.counters.airborne_s) + " s of free flight";
  if (is_hidden) finding.what += ", which do not show thrust.k_f";
  finding.mend = "a longer flight";
  return {finding};
}

}  // namespace

std::vector<std::string> FlightWarnings(const FlightLog& log, const ReplayResult& replay) {
  std::vector<std::string> warnings = log.warnings;
  const EstimatorCounters& c = replay.counters;
  const SynchroniserCounters& s = replay.stream_counters;
  WarnCount(s.not_finite, "sample was not finite, or beyond what a sensor reads, and was dropped",
            "samples were not finite, or beyond what a sensor reads, and were dropped", &warnings);
  if (s.glitches > 0) {
    const double t_s = ToSeconds(s.first_glitch - log.odometry.front().stamp);
    WarnCount(
        s.glitches,
        "reading (rotor speed, gyro, accelerometer or body rate) leapt away and came back and "
        "was not used: at " +
            Rounded(t_s) + " s",
        "readings (rotor speed, gyro, accelerometer or body rate) leapt away and came back "
        "and were not used: the first at " +
            Rounded(t_s) + " s",
        &warnings);
  }
  WarnCount(s.rotor_dropouts, "time rotor speeds fell to nothing and came back at once: missing",
            "times rotor speeds fell to nothing and came back at once: missing", &warnings);
  WarnCount(s.out_of_order, "sample stepped back in time and was dropped",
            "samples stepped back in time and were dropped", &warnings);
  WarnCount(s.repeated_pose, "pose repeated the one before and was dropped",
            "poses repeated the one before and were dropped", &warnings);
  WarnCount(c.gaps, "gap in the streams started a new chain of states",
            "gaps in the streams started new chains of states", &warnings);
  WarnCount(c.jumps, "jump of the odometry was taken as a gap",
            "jumps of the odometry were taken as gaps", &warnings);
  WarnCount(c.refused_updates, "update was not usable and was refused",
            "updates were not usable and were refused", &warnings);
  WarnOfSlowOdometry(log, replay, &warnings);
  return warnings;
}

void WarnOfOtherMass(const ParameterSet& parameters, const Vehicle& vehicle,
                     std::vector<std::string>* warnings) {
  const auto fitted = parameters.provenance.find("mass_kg");
  double mass_kg = 0.0;
  if (fitted == parameters.provenance.end() || !ParseNumber(fitted->second, &mass_kg)) return;
  if (std::abs(mass_kg - vehicle.mass_kg) < 1e-6 * vehicle.mass_kg) return;
  warnings->push_back("the parameters belong to a mass of " + Rounded(mass_kg) +
                      " kg, the vehicle file says " + Rounded(vehicle.mass_kg) + " kg");
}

namespace {

void RefuseAllFrozen(const DynamicModel& model) {
  const auto& parameters = model.parameters();
  if (std::none_of(parameters.begin(), parameters.end(),
                   [](const auto& p) { return p.estimated; })) {
    throw std::invalid_argument("every parameter is frozen: there is nothing to estimate");
  }
}

/// Whether rotors that turn push the vehicle up.
bool MakesThrust(const DynamicModel& model) {
  constexpr double kTurning_rad_s = 100.0;
  FlightState hover;
  hover.rotors =
      RotorState::Steady(RotorVector::Constant(model.vehicle().num_rotors(), kTurning_rad_s));
  const ModelValues values = model.InitialValues();
  Eigen::Vector3d f_B, tau_B;
  model.EvaluateWrench(hover, values, model.Properties(values).p_BBcm, &f_B, &tau_B);
  return f_B.z() > 0.0;
}

void RefuseNeverAirborne(const FlightLog& log, const ReplayResult& replay,
                         const DynamicModel& model, const EstimatorOptions& options) {
  if (replay.last) return;
  if (!MakesThrust(model)) {
    throw std::invalid_argument("the model makes no thrust: its effects (" +
                                Listed(model.effect_names()) +
                                ") lack 'thrust'; --effects replaces the vehicle file's list");
  }
  throw std::invalid_argument(
      log.file + ": never airborne: thrust stays below " +
      Rounded(options.phases.landed_thrust_ratio) +
      " of the weight or the vehicle does not rise; check thrust.k_f, mass_kg and the unit of "
      "the rotor speeds");
}

/// What the pass itself says: how long it took, and of which flight.
void DescribePass(const FlightLog& log, const EstimatorOptions& options, Calibration* result) {
  const ReplayResult& replay = result->replay;
  const Snapshot& last = *replay.last;
  const SynchroniserCounters& streams = replay.stream_counters;
  result->flight = {log.file, DurationOf(log), replay.counters.on_ground_s,
                    replay.counters.keyframes,
                    log.dropped + streams.not_finite + streams.out_of_order};
  result->inflation = last.inflation;
  result->convergence_s = Convergence(replay.history, last.observable);
  result->wall = SummariseTiming(replay, &UpdateTiming::wall_ms);
  result->cpu = SummariseTiming(replay, &UpdateTiming::cpu_ms);
  result->wall_start = SummariseTiming(replay, &UpdateTiming::wall_ms, TimingPart::kStart);
  result->states_in_window = StatesInWindow(replay);
  result->threads = options.num_threads;
  result->first_stamp = log.odometry.front().stamp;
  result->start_s = ToSeconds(last.stamp - log.odometry.front().stamp) - last.time_s;
}

/// Warnings and findings, once everything else is known.
void Judge(const FlightLog& log, const DynamicModel& model, const EstimatorOptions& options,
           const Learned& learned, Calibration* result) {
  const ReplayResult& replay = result->replay;
  const Snapshot& last = *replay.last;
  result->warnings = FlightWarnings(log, replay);
  Append(ModelWarnings(model, last.values, last.sigma, result->prediction.figures),
         &result->warnings);
  WarnOfReaction(result->bands, &result->warnings);
  Append(LastLookFindings(model, last.values, learned.thirds), &result->findings);
  Append(LittleFlight(replay, model), &result->findings);
  if (const auto remark = PointRemark(result->point, model, last.values, last.sigma)) {
    result->findings.push_back(*remark);
  }
  Append(PhaseFindings(replay, options.detect_changes, result->first_stamp), &result->findings);
  for (const Finding& finding : result->findings) {
    if (finding.leaves != Trust::kGood) result->warnings.push_back(Sentence(finding));
  }
}

}  // namespace

Calibration Calibrate(const FlightLog& log, const FlightLog& recording, const Vehicle& file_vehicle,
                      const DynamicModel& model, const EstimatorOptions& options,
                      const std::function<void(double)>& progress,
                      const PredictionSink& predicted) {
  RefuseAllFrozen(model);
  const auto part = [&](double from, double to) {
    return [&progress, from, to](double share) {
      if (progress) progress(from + share * (to - from));
    };
  };
  Calibration result;
  Learned learned = Learn(log, model, model, options, part(0.0, 0.5));
  RefuseNeverAirborne(log, learned.replay, model, options);
  result.bands = BandsOf(recording, model, learned.replay);
  result.point = FindPointOfKnownMount(recording, file_vehicle, model, learned.replay.last->values,
                                       learned.replay.ground_spans);
  LearnWithBands(log, model, options, part(0.5, 1.0), &learned, &result);
  if (progress) progress(1.0);
  result.replay = std::move(learned.replay);
  const Snapshot& last = *result.replay.last;
  result.parameters = Estimator::ToParameterSet(model, last);
  result.nominal_inertia = file_vehicle.inertia_kg_m2;
  DescribePass(log, options, &result);
  const auto keep = [&](const PredictionSample& s) { result.prediction.samples.push_back(s); };
  result.prediction.figures =
      PredictEach(recording, file_vehicle, model, last.values, result.replay.ground_spans, {},
                  predicted ? predicted : PredictionSink(keep));
  Judge(log, model, options, learned, &result);
  return result;
}

namespace {

template <typename Sample>
void CopySince(Stamp from, const std::vector<Sample>& samples, std::vector<Sample>* part) {
  const auto begin = std::lower_bound(samples.begin(), samples.end(), from,
                                      [](const Sample& s, Stamp t) { return s.stamp < t; });
  part->assign(begin, samples.end());
}

/// What the estimator reads of a flight, from a stamp on.
FlightLog Since(Stamp from, const FlightLog& log) {
  FlightLog part;
  part.file = log.file;
  part.rotor_rms_only = log.rotor_rms_only;
  CopySince(from, log.odometry, &part.odometry);
  CopySince(from, log.imu, &part.imu);
  CopySince(from, log.rotors, &part.rotors);
  CopySince(from, log.battery, &part.battery);
  return part;
}

}  // namespace

std::vector<Eigen::VectorXd> ChangesWithout(const std::vector<StreamDoubt>& doubts,
                                            const FlightLog& log, Stamp from,
                                            const DynamicModel& model,
                                            const EstimatorOptions& options,
                                            const ModelValues* values,
                                            const std::function<bool()>& give_up) {
  std::vector<Eigen::VectorXd> changes;
  if (doubts.empty() || log.odometry.empty()) return changes;
  const auto values_of = [&](const FlightLog& flight) {
    Estimator estimator(&model, options, !log.rotor_rms_only);
    return Replay(flight, &estimator, {}, give_up).last;
  };
  const FlightLog part = Since(from, log);
  Eigen::VectorXd with;
  if (values != nullptr && from <= log.odometry.front().stamp) {
    with = *values;
  } else if (const auto last = values_of(part)) {
    with = last->values;
  } else {
    return changes;
  }
  for (const StreamDoubt& doubt : doubts) {
    FlightLog undone = part;
    UndoDoubt(doubt, &undone);
    if (const auto last = values_of(undone)) changes.push_back(last->values - with);
  }
  if (give_up && give_up()) changes.clear();
  return changes;
}

Eigen::VectorXd Widen(const std::vector<Eigen::VectorXd>& changes, ParameterSet* set) {
  const auto n = static_cast<Eigen::Index>(set->parameters.size());
  Eigen::VectorXd grown = Eigen::VectorXd::Ones(n);
  for (const Eigen::VectorXd& change : changes) {
    for (Eigen::Index i = 0; i < n; ++i) {
      ParameterEstimate& p = set->parameters[static_cast<size_t>(i)];
      if (!p.estimated || !(p.sigma > 0.0)) continue;
      const double sigma = std::hypot(p.sigma, change[i]);
      grown[i] *= sigma / p.sigma;
      p.sigma = sigma;
    }
    if (set->covariance.rows() == change.size()) set->covariance += change * change.transpose();
  }
  return grown;
}

std::vector<Finding> DoubtRemarks(const std::vector<StreamDoubt>& doubts,
                                  const std::vector<Eigen::VectorXd>& changes,
                                  const ParameterSet& widened) {
  std::vector<Finding> remarks;
  if (changes.size() != doubts.size()) return remarks;  // an estimate failed
  const auto n = static_cast<Eigen::Index>(widened.parameters.size());
  Eigen::VectorXd doubted = Eigen::VectorXd::Zero(n);  // variance
  for (const Eigen::VectorXd& change : changes) doubted += change.cwiseAbs2();
  for (size_t k = 0; k < doubts.size(); ++k) {
    std::vector<std::string> names;
    for (Eigen::Index i = 0; i < n; ++i) {
      const ParameterEstimate& p = widened.parameters[static_cast<size_t>(i)];
      const double variance = p.sigma * p.sigma, own = changes[k][i] * changes[k][i];
      if (!p.estimated || !p.observable || !(variance > 0.0)) continue;
      if (doubted[i] > 0.5 * variance && own >= 0.25 * variance) names.push_back(p.full_name);
    }
    if (names.empty()) continue;
    remarks.push_back({"stream_doubt", Trust::kGood,
                       "the recording does not exclude an error (" + Sentence(doubts[k]) +
                           "), which is a large part of sigma of " + Listed(names)});
  }
  return remarks;
}

void WidenForDoubts(const FlightLog& log, const DynamicModel& model,
                    const EstimatorOptions& options, const std::vector<StreamDoubt>& doubts,
                    Calibration* calibration) {
  const Snapshot& last = *calibration->replay.last;
  const auto [vehicle, told] =
      WithKnown({calibration->by_bands, calibration->taken_point}, model, options);
  const DynamicModel told_model(vehicle, vehicle.effects);
  const Stamp from = last.stamp - FromSeconds(kLongestDoubt_s);
  const std::vector<Eigen::VectorXd> changes =
      ChangesWithout(doubts, log, from, told_model, told, &last.values);
  const Eigen::VectorXd grown = Widen(changes, &calibration->parameters);
  calibration->inflation = calibration->inflation.cwiseProduct(grown);
  for (Finding& remark : DoubtRemarks(doubts, changes, calibration->parameters)) {
    calibration->findings.push_back(std::move(remark));
  }
}

LeftOutPrediction PredictLeftOut(const FlightLog& log, const FlightLog& recording,
                                 const Vehicle& file_vehicle, const DynamicModel& model,
                                 const EstimatorOptions& options, double block_s) {
  const double duration_s = DurationOf(log);
  if (!(block_s > 0.0) || duration_s < 2.0 * block_s) {
    RefuseFile(log.file, Rounded(duration_s) + " s are no two blocks of " + Rounded(block_s) +
                             " s to leave out");
  }
  if (duration_s > kMostBlocks * block_s) {
    RefuseFile(log.file, "blocks of " + Rounded(block_s) + " s are more than " +
                             Rounded(kMostBlocks) + " in " + Rounded(duration_s) + " s");
  }
  const bool with_torque = !log.rotor_rms_only;
  const Stamp first = log.odometry.front().stamp;
  const auto block_at = [block_s](double t_s) { return static_cast<int>(t_s / block_s); };
  PredictionSummary unseen;
  ModelValues values;
  for (int block = 0; block <= block_at(duration_s); ++block) {
    Estimator estimator(&model, options, with_torque);
    estimator.SetHeldOut([&](Stamp stamp) { return block_at(ToSeconds(stamp - first)) == block; });
    const ReplayResult replay = Replay(log, &estimator);
    if (!replay.last) {
      RefuseFile(log.file, "never airborne outside the block left out from " +
                               Rounded(block * block_s) + " s on");
    }
    values = replay.last->values;
    PredictEach(recording, file_vehicle, model, values, replay.ground_spans, {},
                [&](const PredictionSample& sample) {
                  if (block_at(sample.t_s) == block) unseen.Add(sample);
                });
  }
  LeftOutPrediction left_out{block_s, unseen.Figures(with_torque, file_vehicle, model, values)};
  left_out.figures.inertia_over_nominal.reset();
  return left_out;
}

Calibration CalibrateInspected(const FlightLog& log, const FlightLog& recording,
                               const StreamInspection& inspection, const Vehicle& file_vehicle,
                               const DynamicModel& model, const CalibrateOptions& options,
                               const std::function<void(double)>& progress,
                               const PredictionSink& predicted) {
  Calibration result =
      Calibrate(log, recording, file_vehicle, model, options.estimator, progress, predicted);
  AddInspection(inspection, &result);
  WidenForDoubts(log, model, options.estimator, inspection.doubts, &result);
  if (options.leave_out_s > 0.0) {
    result.left_out =
        PredictLeftOut(log, recording, file_vehicle, model, options.estimator, options.leave_out_s);
  }
  if (options.start) WarnOfOtherMass(*options.start, file_vehicle, &result.warnings);
  return result;
}

Evaluation Evaluate(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
                    const ParameterSet& parameters, const PredictionSink& predicted,
                    const FollowedParameters& followed) {
  const ModelValues values = model.InitialValues();
  Eigen::VectorXd sigma = Eigen::VectorXd::Zero(model.num_parameters());
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ParameterEstimate* p = parameters.Find(model.parameters()[i].full_name);
    if (p != nullptr) sigma[i] = p->sigma;
  }
  const GroundSpans ground = FindGroundSpans(log, model, values);
  Evaluation result;
  result.followed = followed.names;
  result.flight = {log.file, DurationOf(log), ground.on_ground_s, ground.airborne_keyframes,
                   log.dropped};
  const auto keep = [&](const PredictionSample& s) { result.prediction.samples.push_back(s); };
  result.prediction.figures =
      PredictEach(log, file_vehicle, model, values, ground.spans, followed.vary,
                  predicted ? predicted : PredictionSink(keep));
  const int k_f = model.IndexOf("thrust.k_f");
  result.nominal_inertia = file_vehicle.inertia_kg_m2;
  result.bands = FindTorqueBands(log, model, values, k_f >= 0 ? sigma[k_f] : 0.0, ground.spans);
  result.warnings = log.warnings;
  WarnOfReaction(result.bands, &result.warnings);
  WarnOfOtherMass(parameters, file_vehicle, &result.warnings);
  if (result.prediction.figures.samples == 0) {
    result.warnings.push_back(
        "no sample could be predicted: the vehicle never flies, or no stretch of 0.1 s is whole");
  }
  Append(ModelWarnings(model, values, sigma, result.prediction.figures), &result.warnings);
  return result;
}

std::vector<std::optional<double>> Convergence(const EstimateHistory& history,
                                               const std::vector<bool>& observable) {
  std::vector<std::optional<double>> result(observable.size());
  if (history.empty()) return result;
  const HistoryRow last = history.back();
  const double start_s = history.front().t_s;
  for (const HistoryRow& row : history) {
    for (size_t i = 0; i < observable.size(); ++i) {
      const auto k = static_cast<Eigen::Index>(i);
      const double limit = std::max(kConvergedShare * std::abs(last.values[k]), last.sigma[k]);
      const bool near = std::abs(row.values[k] - last.values[k]) <= limit;
      if (!near) result[i].reset();
      if (near && observable[i] && !result[i]) result[i] = row.t_s - start_s;
    }
  }
  return result;
}

TimingFigures SummariseTiming(const ReplayResult& replay, double UpdateTiming::*clock,
                              TimingPart part) {
  std::vector<double> times;
  for (const auto& update : replay.timing) {
    if (IsIn(part, update.first, replay)) times.push_back(update.second.*clock);
  }
  TimingFigures figures;
  figures.updates = static_cast<long>(times.size());
  if (times.empty()) return figures;
  figures.median = Median(times);
  figures.p95 = Quantile(times, 0.95);
  figures.p99 = Quantile(times, 0.99);
  figures.max = *std::max_element(times.begin(), times.end());
  return figures;
}

int StatesInWindow(const ReplayResult& replay) {
  std::vector<double> states;
  for (const auto& update : replay.timing) {
    if (IsIn(TimingPart::kRest, update.first, replay)) states.push_back(update.second.states);
  }
  return static_cast<int>(std::lround(Median(states)));
}

bool IsSignUnphysical(const ParameterSpec& spec, double value, double sigma) {
  return HasWrongSign(spec.sign, value, kSignSigmas * sigma);
}

std::vector<std::string> ModelWarnings(const DynamicModel& model, const ModelValues& values,
                                       const Eigen::VectorXd& sigma,
                                       const PredictionFigures& figures) {
  std::vector<std::string> warnings;
  for (const std::string& doubt : {InertiaDoubt(model.vehicle()), ThrustDoubt(model, values)}) {
    if (!doubt.empty()) warnings.push_back(doubt);
  }
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    if (IsSignUnphysical(p.spec, values[i], sigma[i])) {
      const bool feeds = p.spec.sign == PhysicalSign::kNegative;
      warnings.push_back(p.full_name + " = " + Rounded(values[i]) + " " + p.spec.unit +
                         " has an unphysical sign" + (feeds ? " (it feeds energy in)" : ""));
    }
  }
  WarnOutside(figures.inertia_over_nominal, kInertiaLow, kInertiaHigh, "inertia over nominal",
              &warnings);
  WarnOutside(GainByEstimate(model, values, sigma, figures), kGainLow, kGainHigh,
              "rotor torque gain", &warnings);
  const auto& torque = figures.torque_rmse_Nm;
  const auto& zero = figures.zero_torque_rmse_Nm;
  const std::string axes = Axes(torque, [&](int i) { return zero && (*torque)[i] > (*zero)[i]; });
  if (!axes.empty()) {
    warnings.push_back("the model's torque is worse than predicting zero: RMSE in N m " + axes +
                       " against " + Axes(zero, [&](int i) { return (*torque)[i] > (*zero)[i]; }));
  }
  return warnings;
}

}  // namespace odmc
