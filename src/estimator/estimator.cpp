#include "odmc/estimator/estimator.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <limits>
#include <stdexcept>

#include "odmc/factors/imu_factors.h"
#include "odmc/math/so3.h"
#include "odmc/window/incremental_window_solver.h"

namespace odmc {

using Eigen::Vector3d;

namespace {

constexpr double kObservableShare = 0.5;  // of the prior's sigma
constexpr double kNoiseWarmUp_s = 0.3;    // of odometry before the first keyframe
// What leaves the window is linearized for good. Until then, parameters that multiply each other
// (drag and the height of the centre of mass) are guesses, and a guess would stay.
constexpr double kLearning_s = 3.0;        // of flight in which nothing leaves
constexpr int kMostLeaving = 20;           // keyframes an update after it
constexpr double kSettled_s = 1.0;         // age at which an interval's residual is looked at
constexpr double kAlignmentGrowth = 1.2;   // of the window, from one alignment to the next
constexpr double kChangeDelay_s = 0.15;    // age of the intervals that show a change
constexpr double kSigmaAfterChange = 0.3;  // least sigma then, of the prior's
constexpr double kGateEvery_s = 0.1, kGateKept_s = 3.0;  // copies of the gate on inertia
constexpr double kWalkEvery_s = 0.1;                     // of flight that has left the window
constexpr double kMostHeld_s = 2.0;  // that the window grows while contact is suspected

double ThreadCpuSeconds() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// Times one update on both clocks, stage by stage.
class UpdateTimer {
 public:
  UpdateTimer() : stage_(Clock::now()), cpu_(ThreadCpuSeconds()) {}

  /// Ends a stage; the next one begins. @returns its wall time
  double EndStageMs() {
    const Clock::time_point now = Clock::now();
    const double ms = 1e3 * std::chrono::duration<double>(now - stage_).count();
    stage_ = now;
    wall_ms_ += ms;
    return ms;
  }

  /// Runs, between two stages, what does not count.
  void RunUntimed(const std::function<void()>& run) {
    const double cpu = ThreadCpuSeconds();
    run();
    cpu_ += ThreadCpuSeconds() - cpu;
    stage_ = Clock::now();
  }

  double WallMs() const { return wall_ms_; }  // of the stages that have ended
  double CpuMs() const { return 1e3 * (ThreadCpuSeconds() - cpu_); }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point stage_;
  double wall_ms_ = 0.0, cpu_;
};

OdometryNoise Configured(const EstimatorOptions& options) {
  return {options.position_noise_m, options.attitude_noise_rad, options.velocity_noise_m_s,
          options.rate_noise_rad_s};
}

/// Newest keyframes whose factors change after they were added: averages of rotor accelerations
/// take in later intervals (RotorRateSmoother).
int FreshKeyframes(const DynamicModel& model, const EstimatorOptions& options) {
  if (!model.takes_rotor_rates()) return 0;
  return static_cast<int>(std::ceil(0.5 * kRotorRatesWindow_s * options.keyframe_rate_hz));
}

std::unique_ptr<WindowSolver> MakeSolver(const EstimatorOptions& options,
                                         const DynamicModel& model) {
  const int fresh = FreshKeyframes(model, options);
  if (options.solver == "ceres") return std::make_unique<CeresWindowSolver>(3 + fresh);
  // Parameters that vary change what the past says of the oldest state at every update, and with it
  // the whole chain: nothing is left to keep.
  if (options.solver == "elimination" || !model.processes().empty()) {
    return std::make_unique<EliminationWindowSolver>(3 + fresh);
  }
  IncrementalOptions incremental;
  incremental.recent_keyframes += fresh;
  // Form E ties positions to the force twice integrated, a hundred times tighter than odometry.
  if (options.dynamics_form == "euler") {
    for (double& threshold : incremental.relinearise_state) threshold *= 0.05;
  }
  return std::make_unique<IncrementalWindowSolver>(incremental);
}

Vector3d PriorInertia(const DynamicModel& model) {
  Vector3d inertia = model.vehicle().inertia_kg_m2;
  for (int i = 0; i < 3; ++i) {
    const int k = model.IndexOf(std::string("inertia.") + "xyz"[i]);
    if (k >= 0) inertia[i] = model.parameters()[k].spec.prior_value;
  }
  return inertia;
}

Eigen::VectorXd PriorSigmas(const ParameterLayout& layout) {
  Eigen::VectorXd sigma(layout.num_estimated());
  for (int i = 0; i < sigma.size(); ++i) sigma[i] = layout.PriorSigma(i);
  return sigma;
}

/// "0.8 imu.pz - 0.6 centre_of_gravity.z": the entries that make up most of a direction.
std::string Words(const DynamicModel& model, const ParameterLayout& layout,
                  const Eigen::VectorXd& direction) {
  std::string text;
  for (int i = 0; i < direction.size(); ++i) {
    if (std::abs(direction[i]) < 0.3) continue;
    const bool minus = direction[i] < 0.0;
    text += text.empty() ? (minus ? "-" : "") : (minus ? " - " : " + ");
    text += model.parameters()[layout.model_index(i)].full_name;
  }
  return text;
}

}  // namespace

/// Everything measured between the last keyframe and a new one.
struct Estimator::Interval {
  double dt = 0.0;
  RotorInterval rotors;
  std::optional<ImuInterval> imu;
};

bool EstimatorOptions::IsValid(std::string* error) const {
  const auto fail = [error](const std::string& what) {
    if (error != nullptr) *error = what;
    return false;
  };
  if (!(window_s > 0.0 && window_s <= 60.0)) return fail("window_s must be in (0, 60]");
  if (!(keyframe_rate_hz >= 5.0 && keyframe_rate_hz <= 1000.0)) {
    return fail("keyframe_rate_hz must be in [5, 1000]");
  }
  if (window_s * keyframe_rate_hz < 3.0) return fail("window_s must hold at least 3 keyframes");
  if (dynamics_form != "midpoint" && dynamics_form != "euler") {
    return fail("dynamics_form must be midpoint or euler");
  }
  if (solver != "incremental" && solver != "elimination" && solver != "ceres") {
    return fail("solver must be incremental, elimination or ceres");
  }
  const auto is_positive = [](double x) { return x > 0.0 && std::isfinite(x); };
  const auto is_not_negative = [](double x) { return x >= 0.0 && std::isfinite(x); };
  struct Named {
    const char* name;
    double value;
  };
  for (const Named& option : {Named{"max_gap_s", max_gap_s}, Named{"patience_s", patience_s},
                              Named{"max_update_time_s", max_update_time_s},
                              Named{"process_noise_floor", process_noise_floor},
                              Named{"kinematic_position_m", kinematic_position_m},
                              Named{"kinematic_rotation_rad", kinematic_rotation_rad},
                              Named{"gyro_noise_rad_s", gyro_noise_rad_s},
                              Named{"accelerometer_noise_m_s2", accelerometer_noise_m_s2},
                              Named{"bias_interval_s", bias_interval_s},
                              Named{"gyro_bias_sigma_rad_s", gyro_bias_sigma_rad_s},
                              Named{"accelerometer_bias_sigma_m_s2", accelerometer_bias_sigma_m_s2},
                              Named{"gyro_bias_walk", gyro_bias_walk},
                              Named{"accelerometer_bias_walk", accelerometer_bias_walk}}) {
    if (!is_positive(option.value)) return fail(std::string(option.name) + " must be positive");
  }
  for (const Named& option :
       {Named{"huber_width", huber_width}, Named{"position_noise_m", position_noise_m},
        Named{"attitude_noise_rad", attitude_noise_rad},
        Named{"velocity_noise_m_s", velocity_noise_m_s},
        Named{"rate_noise_rad_s", rate_noise_rad_s},
        Named{"rotor_speed_noise_rad_s", rotor_speed_noise_rad_s},
        Named{"function_tolerance", function_tolerance}, Named{"k_f_walk_rate", k_f_walk_rate},
        Named{"take_off_height_m", phases.take_off_height_m},
        Named{"take_off_speed_m_s", phases.take_off_speed_m_s},
        Named{"landed_thrust_ratio", phases.landed_thrust_ratio},
        Named{"near_ground_m", phases.near_ground_m}}) {
    if (!is_not_negative(option.value)) {
      return fail(std::string(option.name) + " must be a number and not negative");
    }
  }
  if (!(inertia_gate_r_squared >= 0.0 && inertia_gate_r_squared <= 1.0)) {
    return fail("inertia_gate_r_squared must be in [0, 1]");
  }
  if (phases.landed_thrust_ratio >= 1.0) return fail("landed_thrust_ratio must be below 1");
  if (max_iterations < 1) return fail("max_iterations must be at least 1");
  if (num_threads < 1) return fail("num_threads must be at least 1");
  return true;
}

Estimator::Estimator(const DynamicModel* model, const EstimatorOptions& options, bool with_torque)
    : model_(model),
      options_(options),
      with_torque_(with_torque),
      form_(options.dynamics_form == "euler" ? DynamicsForm::kEuler : DynamicsForm::kMidpoint),
      layout_(*model, model->InitialValues()),
      synchroniser_(options.keyframe_rate_hz, options.patience_s),
      phases_(model, options.phases, options.detect_changes),
      inertia_gate_(model->vehicle(), options.inertia_gate_r_squared),
      load_(*model, true),
      stream_noise_(Configured(options)),
      process_noise_(model->vehicle().mass_kg * model->vehicle().gravity_m_s2,
                     model->vehicle().ArmLength(), options.process_noise_floor),
      change_detector_(model->vehicle().mass_kg * model->vehicle().gravity_m_s2,
                       model->vehicle().inertia_kg_m2),
      window_(&layout_),
      solver_(MakeSolver(options, *model)),
      consistency_(layout_.num_estimated()),
      regressor_noise_(layout_.num_estimated()),
      consistency_inflation_(Eigen::VectorXd::Ones(layout_.num_estimated())),
      noise_inflation_(consistency_inflation_),
      inflation_(consistency_inflation_),
      prior_sigma_eta_(PriorSigmas(layout_)),
      sigma_eta_(prior_sigma_eta_),
      force_information_(Eigen::VectorXd::Zero(layout_.num_estimated())),
      torque_information_(Eigen::VectorXd::Zero(layout_.num_estimated())) {
  std::string error;
  if (!options.IsValid(&error)) throw std::invalid_argument(error);
  const int k_f = model->IndexOf("thrust.k_f");
  if (with_torque && k_f >= 0) window_.SetAnchorEntry(layout_.EntryOf(k_f));
  for (const char* axis : {"inertia.x", "inertia.y", "inertia.z"}) {
    const int k = model->IndexOf(axis);
    estimates_inertia_ = estimates_inertia_ || (k >= 0 && model->parameters()[k].estimated);
  }
  if (options.k_f_walk_rate > 0.0) {
    for (const char* name : {"thrust.k_f", "rotor_torque.k_m"}) {
      const int k = model->IndexOf(name);
      if (k >= 0 && layout_.EntryOf(k) >= 0) walking_.push_back(layout_.EntryOf(k));
    }
    consistency_.SetWalking(walking_);
  }
  if (options.huber_width > 0.0) {
    loss_ = std::make_unique<ceres::HuberLoss>(options.huber_width);
  }
}

Estimator::~Estimator() = default;

void Estimator::Add(const OdometrySample& sample) {
  if (synchroniser_.Add(sample)) stream_noise_.Add(sample);
  if (noise_ready_ == 0) noise_ready_ = sample.stamp + FromSeconds(kNoiseWarmUp_s);
}

void Estimator::Add(const ImuSample& sample) { synchroniser_.Add(sample); }

void Estimator::Add(const RotorSample& sample) {
  synchroniser_.Add(sample);
  stream_noise_.Add(sample);
}

void Estimator::Add(const BatterySample& sample) { synchroniser_.Add(sample); }

void Estimator::Finish() {
  synchroniser_.Finish();
  noise_ready_ = std::min(noise_ready_, synchroniser_.newest_odometry());
}

void Estimator::RestartChain() {
  synchroniser_.Clear();
  stream_noise_.Restart();
  phases_.Restart();
  inertia_gate_.Break();
  load_.Reset();
  last_.reset();
  before_last_.reset();
  last_in_window_ = false;
  EmptyWindow();
  bias_since_.reset();
  noise_ready_ = 0;
}

/// All states leave; what they said stays known.
void Estimator::EmptyWindow() {
  while (!window_.keyframes().empty()) solver_->MarginalizeOldest(&window_, sigma_eta_, nullptr);
  window_.biases().clear();
}

void Estimator::CarryOn(const Estimator& before, const DynamicModel& declared) {
  prior_sigma_eta_ = PriorSigmas(ParameterLayout(declared, declared.InitialValues()));
  synchroniser_ = before.synchroniser_;
  rotor_scale_sigma_ = before.rotor_scale_sigma_;
  phases_.CarryOn(before.phases_);
  inertia_gate_ = before.inertia_gate_;
  inertia_gate_.Break();
  stream_noise_ = before.stream_noise_;
  process_noise_ = before.process_noise_;
  residual_force_power_ = before.residual_force_power_;
  residual_torque_power_ = before.residual_torque_power_;
  counters_ = before.counters_;
  last_ = before.last_;
  before_last_ = before.before_last_;
  first_stamp_ = before.first_stamp_;
  noise_ready_ = before.noise_ready_;
}

const Snapshot* Estimator::Step() {
  made_progress_ = false;
  // The first keyframe waits until the noise of the streams is known.
  if (!last_ && !synchroniser_.HasReached(noise_ready_)) return nullptr;
  UpdateTimer timer;
  const std::optional<OdometrySample> sample = synchroniser_.NextKeyframe();
  if (!sample) return nullptr;
  made_progress_ = true;
  if (!first_stamp_) first_stamp_ = sample->stamp;
  stream_noise_.AdvanceTo(std::max(sample->stamp, noise_ready_));

  const bool airborne = FollowPhase(*sample);
  const Snapshot* snapshot = nullptr;
  FollowLoad(*sample);
  const bool is_held_out = is_held_out_ && is_held_out_(sample->stamp);
  if (airborne && (is_held_out || phases_.detector().IsNearGround(sample->p_WS.z()))) {
    last_in_window_ = false;
    inertia_gate_.Break();
    change_detector_.Break();
  } else if (airborne) {
    UpdateTiming timing;
    const std::optional<Interval> interval = ReadInterval(*sample);
    timing.read_ms = timer.EndStageMs();
    AddKeyframe(*sample, interval);
    SolverOptions solver_options;
    // One step an update follows the flight; the first second and a refused step need more, and so
    // does Form E, whose position rows are far stiffer, while parameters still move.
    const bool settling =
        counters_.airborne_s < 1.0 || (IsLearning() && form_ == DynamicsForm::kEuler);
    const int least = settling ? 4 : (needs_more_iterations_ ? 6 : 1);
    solver_options.max_iterations = std::max(least, options_.max_iterations);
    // Once more before the first keyframes leave.
    const bool has_learned = was_learning_ && !IsLearning();
    was_learning_ = IsLearning();
    const bool has_freed = FreeInertia();
    solver_options.align = needs_more_iterations_ || has_learned ||
                           ((settling || IsLearning()) && (has_freed || AlignmentIsDue()));
    solver_options.max_time_s = (settling ? 10.0 : 1.0) * options_.max_update_time_s;
    solver_options.function_tolerance = options_.function_tolerance;
    solver_options.num_threads = options_.num_threads;
    timing.build_ms = timer.EndStageMs();
    const SolveReport report = solver_->Solve(&window_, solver_options);
    timing.solve_ms = timer.EndStageMs();
    if (!report.usable) ++counters_.refused_updates;
    if (solver_options.align || report.aligned) {
      aligned_states_ = static_cast<double>(window_.keyframes().size());
    }
    needs_more_iterations_ = !report.improved && !report.converged;
    TakeSnapshot(*sample, report);
    snapshot = &snapshot_;
    timing.snapshot_ms = timer.EndStageMs();
    if (observe_) timer.RunUntimed(observe_);
    const double span =
        ToSeconds(window_.keyframes().back().stamp - window_.keyframes().front().stamp);
    timing.window_full = span >= options_.window_s - 2.5 / options_.keyframe_rate_hz &&
                         span < options_.window_s + kMostLeaving / options_.keyframe_rate_hz;
    timing.states = static_cast<int>(window_.keyframes().size());
    timing.eliminated = report.eliminated;
    timing.sweeping = report.sweeping;
    timing.aligned = report.aligned;
    FollowNoise();
    if (!report.reweighing) {  // what leaves has one weight
      MarginalizeOld();
      RescaleNoise();
    }
    if (options_.detect_changes) LookForChange();
    timing.marginalize_ms = timer.EndStageMs();
    timing.wall_ms = timer.WallMs();
    timing.cpu_ms = timer.CpuMs();
    snapshot_.timing = timing;
    TellPhases(sample->stamp);
  } else {
    ++counters_.ground_keyframes;
    last_in_window_ = false;
    inertia_gate_.Break();
    change_detector_.Break();
    if (step_.take_back) snapshot = TakeBack(*step_.take_back);
  }
  before_last_ = last_;
  last_ = sample;
  synchroniser_.Trim(sample->stamp);
  return snapshot;
}

/// While the flight settles, whenever the window has grown by a share; the last time when all is
/// learned.
bool Estimator::AlignmentIsDue() const {
  if (IsLearning() && kAlignmentGrowth * learned_s_ > kLearning_s) return false;
  const auto states = static_cast<double>(window_.keyframes().size());
  return states >= kAlignmentGrowth * aligned_states_ || states < aligned_states_;
}

void Estimator::FollowLoad(const OdometrySample& sample) {
  // Differences of one and the same velocity, so that its noise does not add up.
  if (!last_ || !sample.v_WS || !last_->v_WS) return;
  const double dt = ToSeconds(sample.stamp - last_->stamp);
  load_pull_ = load_.Advance(*last_->v_WS, *sample.v_WS, dt, window_.values());
}

/// Once the gate has opened, what was added before must not hold on to the start value.
/// @returns whether it has opened or closed anywhere
bool Estimator::FreeInertia() {
  if (!with_torque_ || !estimates_inertia_) return false;
  std::array<bool, 3> is_free;
  for (int i = 0; i < 3; ++i) is_free[i] = InertiaIsFree(i);
  if (is_free == inertia_was_free_) return false;
  inertia_was_free_ = is_free;
  for (Keyframe& keyframe : window_.keyframes()) {
    for (Factor& factor : keyframe.factors) {
      if (factor.kind != FactorKind::kDynamics) continue;
      for (int i = 0; i < 3; ++i) {
        if (is_free[i]) static_cast<DynamicsFactor&>(*factor.cost).FreeInertia(i);
      }
      window_.Touch(&factor);
    }
  }
  return true;
}

std::optional<FullSolveDifference> Estimator::CompareWithFullSolve() {
  const int n = layout_.num_estimated();
  Eigen::MatrixXd ours, full;
  if (window_.keyframes().empty() || !solver_->ParameterCovariance(window_, sigma_eta_, &ours)) {
    return std::nullopt;
  }
  const ParameterVector eta = window_.eta();
  const Ring<Bias> biases = window_.biases();
  const Prior prior = window_.prior();
  std::vector<std::array<double, kStateSize>> states, points;
  std::vector<bool> in_prior;
  for (const Keyframe& k : window_.keyframes()) {
    states.push_back(k.x);
    points.push_back(k.x_lin);
    in_prior.push_back(k.in_prior);
  }

  solver_->WritePrior(&window_);
  std::vector<Keyframe*> reweighed;
  if (snapshot_.solve.reweighing) {  // the problem it solves has the old weights
    for (Keyframe& keyframe : window_.keyframes()) {
      if (keyframe.id <= noise_step_->reached) reweighed.push_back(&keyframe);
    }
    for (Keyframe* keyframe : reweighed) SetModelNoise(noise_step_->before, keyframe);
  }
  SolverOptions options;
  options.max_iterations = 30;
  options.max_time_s = 60.0;
  options.function_tolerance = 1e-12;
  CeresWindowSolver reference;
  const double anchor = window_.anchor();
  bool solved = true;
  for (int pass = 0; pass < 2; ++pass) {  // the anchor follows the solution
    solved = solved && reference.Solve(&window_, options).usable;
  }
  solved = solved && reference.ParameterCovariance(window_, Eigen::VectorXd::Zero(n), &full);
  std::optional<FullSolveDifference> difference;
  if (solved) {
    difference.emplace();
    for (int i = 0; i < n; ++i) {
      const double sigma = std::sqrt(full(i, i));
      const double moved = std::abs(eta[i] - window_.eta()[i]) / sigma;
      const double wider = std::abs(std::sqrt(ours(i, i)) / sigma - 1.0);
      const std::string& name = model_->parameters()[layout_.model_index(i)].full_name;
      if (moved > difference->parameters) {
        difference->parameters = moved;
        difference->worst_parameter = name;
      }
      if (wider > difference->sigmas) {
        difference->sigmas = wider;
        difference->worst_sigma = name;
      }
    }
  }

  for (Keyframe* keyframe : reweighed) SetModelNoise(process_noise_, keyframe);
  window_.eta() = eta;
  window_.biases() = biases;
  window_.prior() = prior;
  for (size_t i = 0; i < states.size(); ++i) {
    window_.keyframes()[i].x = states[i];
    window_.keyframes()[i].x_lin = points[i];
    window_.keyframes()[i].in_prior = in_prior[i];
  }
  window_.anchor() = anchor;
  return difference;
}

bool Estimator::InertiaIsFree(int axis) const {
  return options_.inertia_gate_r_squared <= 0.0 || inertia_gate_.IsOpen(axis);
}

/// Reads the streams up to `sample` and asks what phase the flight is in.
/// @returns whether the newest interval may teach
bool Estimator::FollowPhase(const OdometrySample& sample) {
  step_.dt = last_ ? ToSeconds(sample.stamp - last_->stamp) : 0.0;
  step_.rotors.reset();
  step_.take_back.reset();
  // Keyframes may be meant to be farther apart than a gap is long.
  step_.is_gap = step_.dt > std::max(options_.max_gap_s, 1.5 / options_.keyframe_rate_hz);
  step_.is_jump = last_ && !step_.is_gap && IsJump(sample, step_.dt);
  if (last_ && !step_.is_gap) {
    step_.rotors =
        ReduceRotors(synchroniser_.rotors(), last_->stamp, sample.stamp, options_.max_gap_s);
  }
  const bool is_first = !last_ || step_.is_gap || step_.is_jump;
  const PhaseVerdict verdict =
      phases_.Update(sample, step_.rotors, stream_noise_.odometry(), is_first);
  const bool teaches = Teaches(verdict.phase);
  if (verdict.start_anew) StartAnew();
  step_.take_back = verdict.take_back;
  if (verdict.has_changed) {
    counters_.last_change = sample.stamp;
    if (options_.detect_changes) {
      LearnAnew();
    } else {
      ++counters_.changes;
    }
  }
  CountTime(step_.dt, teaches);
  return teaches;
}

void Estimator::CountTime(double dt, bool teaches) {
  if (!teaches) {
    counters_.on_ground_s += dt;
  } else if (dt < 1.0) {  // not over a hole in the recording
    counters_.airborne_s += dt;
    learned_s_ += dt;
  }
}

/// Takes what was learned from `since` on back: these keyframes leave as if they had never been.
/// @returns the estimate without them, null if there is none
const Snapshot* Estimator::TakeBack(Stamp since) {
  const auto& keyframes = window_.keyframes();
  if (keyframes.size() < 3 || keyframes.back().stamp <= since) return nullptr;
  std::int64_t first = keyframes.back().id;
  while (first > keyframes.front().id + 2 && window_.keyframe(first - 1).stamp > since) --first;
  const long dropped = static_cast<long>(keyframes.back().id - first) + 1;
  const double dropped_s =
      ToSeconds(keyframes.back().stamp - window_.keyframe(first - 1).stamp);
  solver_->Release(&window_);
  window_.DropNewestKeyframes(first);
  pending_.clear();
  if (window_.biases().empty()) bias_since_.reset();
  rotor_rates_.Restart();
  noise_seen_ = std::min(noise_seen_, keyframes.back().id);
  noise_step_.reset();
  change_seen_ = std::min(change_seen_, keyframes.back().stamp);
  RestoreGate(since);
  counters_.taken_back += dropped;
  counters_.keyframes -= dropped;
  counters_.ground_keyframes += dropped;
  counters_.airborne_s -= dropped_s;
  counters_.on_ground_s += dropped_s;
  learned_s_ = std::max(0.0, learned_s_ - dropped_s);

  SolverOptions options;
  options.max_iterations = 10;
  options.align = true;
  options.max_time_s = 10.0 * options_.max_update_time_s;
  options.function_tolerance = options_.function_tolerance;
  options.num_threads = options_.num_threads;
  const SolveReport report = solver_->Solve(&window_, options);
  aligned_states_ = static_cast<double>(keyframes.size());
  OdometrySample sample;
  sample.stamp = keyframes.back().stamp;
  TakeSnapshot(sample, report);
  snapshot_.airborne = false;
  snapshot_.timing = UpdateTiming();
  return &snapshot_;
}

void Estimator::StartAnew() {
  if (window_.keyframes().empty() && counters_.keyframes == 0) return;
  const int n = layout_.num_estimated();
  const int anchor_entry = window_.anchor_entry();
  window_ = Window(&layout_);
  window_.SetAnchorEntry(anchor_entry);
  solver_ = MakeSolver(options_, *model_);
  consistency_ = Consistency(n);
  consistency_.SetWalking(walking_);
  walk_owed_s_ = 0.0;
  regressor_noise_ = RegressorNoise(n);
  consistency_inflation_ = noise_inflation_ = inflation_ = Eigen::VectorXd::Ones(n);
  sigma_eta_ = PriorSigmas(layout_);
  force_information_.setZero();
  torque_information_.setZero();
  unobservable_.clear();
  const Vehicle& vehicle = model_->vehicle();
  const double weight_N = vehicle.mass_kg * vehicle.gravity_m_s2;
  process_noise_ =
      ProcessNoiseEstimator(weight_N, vehicle.ArmLength(), options_.process_noise_floor);
  change_detector_ = ChangeDetector(weight_N, vehicle.inertia_kg_m2);
  inertia_gate_.Restore({});
  gate_before_.clear();
  inertia_was_free_ = {false, false, false};
  noise_seen_ = -1;
  noise_step_.reset();
  change_seen_ = 0;
  rotor_rates_.Restart();
  rotor_scale_sigma_ = 0.0;
  pending_.clear();
  bias_since_.reset();
  residual_force_power_ = residual_torque_power_ = 0.0;
  aligned_states_ = 0.0;
  was_learning_ = needs_more_iterations_ = last_in_window_ = false;
  phases_.Forget();
  ++counters_.starts_anew;
  counters_.ground_keyframes += counters_.keyframes;
  counters_.keyframes = counters_.gaps = counters_.jumps = counters_.chains = 0;
  counters_.on_ground_s += counters_.airborne_s;
  counters_.airborne_s = learned_s_ = 0.0;
}

std::vector<ThirdsDifference> Estimator::LastLook() {
  std::vector<ThirdsDifference> differences;
  const std::vector<ThirdOfFlight> thirds = consistency_.Thirds(window_.eta(), prior_sigma_eta_);
  if (thirds.size() < 3) return differences;
  const int n = layout_.num_estimated();
  const double threshold = LastLookThreshold(n);
  for (int i = 0; i < n; ++i) {
    if (std::find(walking_.begin(), walking_.end(), i) != walking_.end()) continue;
    const double inflation = inflation_[i] * inflation_[i];
    double weights = 0.0, mean = 0.0, chi_squared = 0.0;
    bool is_seen = true;
    for (const ThirdOfFlight& third : thirds) {
      const double variance = inflation * third.variance[i];
      is_seen = is_seen && variance > 0.0 &&
                std::sqrt(variance) < kObservableShare * prior_sigma_eta_[i];
      weights += 1.0 / variance;
      mean += third.step[i] / variance;
    }
    if (!is_seen) continue;
    mean /= weights;
    for (const ThirdOfFlight& third : thirds) {
      const double off = third.step[i] - mean;
      chi_squared += off * off / (inflation * third.variance[i]);
    }
    if (!(chi_squared > threshold)) continue;
    ThirdsDifference difference;
    difference.index = layout_.model_index(i);
    difference.chi_squared = chi_squared;
    for (size_t t = 0; t < 3; ++t) {
      ParameterVector eta = window_.eta();
      eta[i] += thirds[t].step[i];
      difference.values[t] = layout_.Decode(eta.data())[difference.index];
    }
    const Eigen::Map<const Eigen::Vector3d> values(difference.values.data());
    difference.spread = std::sqrt((values.array() - values.mean()).square().sum() / 6.0);
    differences.push_back(difference);
  }
  return differences;
}

/// What contact is judged by: the estimate, and the gate on inertia as it was.
void Estimator::TellPhases(Stamp stamp) {
  const int k_f = model_->IndexOf("thrust.k_f");
  const double thrust_sigma =
      k_f >= 0 ? snapshot_.sigma[k_f] / std::abs(snapshot_.values[k_f]) : 0.0;
  phases_.Learn(stamp, snapshot_.values, thrust_sigma);
  if (!with_torque_) return;
  if (!gate_before_.empty() && ToSeconds(stamp - gate_before_.back().first) < kGateEvery_s) return;
  gate_before_.push_back({stamp, inertia_gate_.statistics()});
  while (ToSeconds(stamp - gate_before_.front().first) > kGateKept_s) gate_before_.pop_front();
}

void Estimator::RestoreGate(Stamp since) {
  while (!gate_before_.empty() && gate_before_.back().first > since) {
    inertia_gate_.Restore(gate_before_.back().second);
    gate_before_.pop_back();
  }
}

std::optional<Estimator::Interval> Estimator::ReadInterval(const OdometrySample& sample) {
  if (!last_ || !last_in_window_) return std::nullopt;
  if (step_.is_gap || !step_.rotors) {
    ++counters_.gaps;
    return std::nullopt;
  }
  if (step_.is_jump) {
    ++counters_.jumps;
    return std::nullopt;
  }
  Interval interval;
  interval.dt = step_.dt;
  interval.rotors = *step_.rotors;
  if (!synchroniser_.imu().empty()) {
    Vector3d bias = Vector3d::Zero();
    if (!window_.biases().empty()) {
      bias = Eigen::Map<const Vector3d>(window_.biases().back().x.data());
    }
    interval.imu =
        PreintegrateImu(synchroniser_.imu(), last_->stamp, sample.stamp, bias, options_.max_gap_s);
  }
  return interval;
}

/// A pose that moves without velocity is a relabelled marker or a loop closure, not flight.
bool Estimator::IsJump(const OdometrySample& sample, double dt) const {
  const OdometryNoise noise = stream_noise_.odometry();
  if (sample.v_WS && last_->v_WS) {
    const Vector3d step = sample.p_WS - last_->p_WS - 0.5 * dt * (*sample.v_WS + *last_->v_WS);
    return step.norm() > 0.01 + 8.0 * noise.position_m + dt * (0.5 + 8.0 * noise.velocity_m_s);
  }
  if (!before_last_) return false;
  const double dt0 = ToSeconds(last_->stamp - before_last_->stamp);
  if (!(dt0 > 0.0) || dt0 > options_.max_gap_s) return false;
  // Without velocities: what no vehicle can accelerate, 40 m/s² and 300 rad/s².
  const double wider = dt * std::max(dt, dt0);
  const double share = dt / dt0;
  const Vector3d step = sample.p_WS - last_->p_WS - share * (last_->p_WS - before_last_->p_WS);
  const Vector3d turn = Log(last_->q_WS.conjugate() * sample.q_WS) -
                        share * Log(before_last_->q_WS.conjugate() * last_->q_WS);
  return step.norm() > 0.002 + 8.0 * noise.position_m * (1.0 + share) + 40.0 * wider ||
         turn.norm() > 0.01 + 8.0 * noise.attitude_rad * (1.0 + share) + 300.0 * wider;
}

template <typename T, typename... Arguments>
std::unique_ptr<ceres::CostFunction> Estimator::MakeCost(FactorKind kind,
                                                         const Arguments&... arguments) {
  std::unique_ptr<ceres::CostFunction> spare = window_.TakeSpare(kind);
  if (spare == nullptr) return std::make_unique<T>(arguments...);
  static_cast<T&>(*spare).Set(arguments...);
  return spare;
}

State Estimator::InitialState(const OdometrySample& sample, const Interval* interval) const {
  State state;
  state.p_WS = sample.p_WS;
  state.q_WS = sample.q_WS;
  const State before =
      interval != nullptr ? State::FromBlock(window_.keyframes().back().x.data()) : State();
  if (sample.v_WS) {
    state.v_WS = *sample.v_WS;
  } else if (interval != nullptr) {
    state.v_WS = (sample.p_WS - last_->p_WS) / interval->dt;
  }
  // Turns between noisy poses are a poor rate, and that of the interval's middle.
  if (sample.w_WS_S) {
    state.w_WS_S = *sample.w_WS_S;
  } else if (const std::optional<Vector3d> rate = GyroRate(sample.stamp)) {
    state.w_WS_S = *rate;
  } else if (interval != nullptr) {
    state.w_WS_S = Log(before.q_WS.conjugate() * sample.q_WS) / interval->dt;
  }
  return state;
}

std::optional<Vector3d> Estimator::GyroRate(Stamp stamp) const {
  const Ring<ImuSample>& imu = synchroniser_.imu();
  const auto after = std::upper_bound(imu.begin(), imu.end(), stamp,
                                      [](Stamp s, const ImuSample& m) { return s < m.stamp; });
  if (after == imu.begin()) return std::nullopt;
  const ImuSample& a = *(after - 1);
  if (!a.gyro_I) return std::nullopt;
  Vector3d gyro_I = *a.gyro_I;
  if (a.stamp != stamp) {
    if (after == imu.end() || !after->gyro_I) return std::nullopt;
    const double span_s = ToSeconds(after->stamp - a.stamp);
    if (span_s > options_.max_gap_s) return std::nullopt;
    gyro_I += ToSeconds(stamp - a.stamp) / span_s * (*after->gyro_I - *a.gyro_I);
  }
  if (!window_.biases().empty()) {
    gyro_I -= Eigen::Map<const Vector3d>(window_.biases().back().x.data());
  }
  const BodyProperties body = model_->Properties(window_.values());
  return body.R_BS.transpose() * (body.R_BI * gyro_I);
}

std::int64_t Estimator::CurrentBias(Stamp stamp, bool has_imu) {
  if (!has_imu) return -1;
  const bool due = !bias_since_ || ToSeconds(stamp - *bias_since_) >= options_.bias_interval_s;
  if (!due && !window_.biases().empty()) return window_.biases().back().id;
  Eigen::Matrix<double, 6, 1> initial = Eigen::Matrix<double, 6, 1>::Zero();
  const bool first = window_.biases().empty();
  if (!first)
    initial = Eigen::Map<const Eigen::Matrix<double, 6, 1>>(window_.biases().back().x.data());
  const std::int64_t id = window_.AddBias(initial);
  Eigen::Matrix<double, 6, 1> sigma;
  if (first) {
    sigma << Vector3d::Constant(options_.gyro_bias_sigma_rad_s),
        Vector3d::Constant(options_.accelerometer_bias_sigma_m_s2);
    Factor factor;
    factor.kind = FactorKind::kBiasPrior;
    factor.cost = std::make_unique<BlockPriorFactor>(initial, sigma);
    factor.bias0 = id;
    pending_.push_back(std::move(factor));
  } else {
    const double root_s = std::sqrt(options_.bias_interval_s);
    sigma << Vector3d::Constant(options_.gyro_bias_walk * root_s),
        Vector3d::Constant(options_.accelerometer_bias_walk * root_s);
    Factor factor;
    factor.kind = FactorKind::kBiasWalk;
    factor.cost = MakeCost<BiasWalkFactor>(FactorKind::kBiasWalk, sigma);
    factor.bias0 = id - 1;
    factor.bias1 = id;
    // Belongs to the last keyframe with the old bias, which leaves together with it.
    window_.AddFactor(std::move(factor));
  }
  bias_since_ = stamp;
  return id;
}

void Estimator::AddKeyframe(const OdometrySample& sample, const std::optional<Interval>& interval) {
  const bool has_imu = !synchroniser_.imu().empty();
  const std::int64_t bias = CurrentBias(sample.stamp, has_imu);
  const State initial = InitialState(sample, interval ? &*interval : nullptr);
  const std::int64_t id = window_.AddKeyframe(sample.stamp, initial, interval.has_value(), bias);
  for (Factor& factor : pending_) window_.AddFactor(std::move(factor));
  pending_.clear();
  ++counters_.keyframes;
  if (!interval) {
    ++counters_.chains;
    inertia_gate_.Break();
    rotor_rates_.Restart();
  }
  last_in_window_ = true;

  const bool with_gyro = interval && interval->imu && interval->imu->has_gyro;
  Factor odometry;
  odometry.kind = FactorKind::kOdometry;
  odometry.cost =
      MakeCost<OdometryFactor>(FactorKind::kOdometry, sample, stream_noise_.odometry(), !with_gyro);
  odometry.state0 = id;
  window_.AddFactor(std::move(odometry));
  if (!interval) return;
  SeeRotorScale(interval->rotors);
  AddIntervalFactors(*interval, id);
  SmoothRotorRates(*interval, id);
}

double Estimator::RotorSpeedNoise() const {
  return options_.rotor_speed_noise_rad_s > 0.0 ? options_.rotor_speed_noise_rad_s
                                                : stream_noise_.rotor_speed();
}

DynamicsNoise Estimator::NoiseOf(const Interval& interval) const {
  const Vehicle& vehicle = model_->vehicle();
  DynamicsNoise noise;
  noise.force_N = process_noise_.ForceSigma(interval.dt);
  noise.torque_Nm = process_noise_.TorqueSigma(interval.dt);
  noise.nominal_inertia = model_->Properties(window_.values()).I_BBcm_B.diagonal();
  const double sigma_speed = RotorSpeedNoise();
  // d(k_f Ω²) = 2 k_f Ω dΩ, averaged over the samples of the interval.       model.md section 5
  const ModelValues values = window_.values();
  const int k_f = model_->IndexOf("thrust.k_f"), k_m = model_->IndexOf("rotor_torque.k_m");
  const double per_sample =
      sigma_speed / std::sqrt(static_cast<double>(interval.rotors.num_samples));
  double force_variance = 0.0;
  Vector3d torque_variance = Vector3d::Zero();
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    // A model's error lasts longer than an interval: more samples do not make it smaller.
    const double sigma = std::hypot(per_sample, interval.rotors.model_sigma[j]);
    const double slope = 2.0 * interval.rotors.mean.speed[j] * sigma;
    const double force = k_f >= 0 ? values[k_f] * slope : 0.0;
    const double couple = k_m >= 0 ? values[k_m] * slope : 0.0;
    force_variance += force * force;
    const Vector3d& p_BP = vehicle.rotors[j].p_BP;
    torque_variance +=
        Vector3d(p_BP.y() * force, p_BP.x() * force, couple).array().square().matrix();
  }
  noise.rotor_force_N = std::sqrt(force_variance);
  noise.rotor_torque_Nm = torque_variance.cwiseSqrt();
  noise.rotor_rate_rad_s2 = std::sqrt(2.0) * sigma_speed / interval.dt;  // of both ends
  return noise;
}

void Estimator::AddIntervalFactors(const Interval& interval, std::int64_t id) {
  const auto add = [&](FactorKind kind, std::unique_ptr<ceres::CostFunction> cost, bool two_states,
                       bool bias, bool parameters) {
    Factor factor;
    factor.kind = kind;
    factor.cost = std::move(cost);
    factor.state0 = two_states ? id - 1 : id;
    factor.state1 = two_states ? id : -1;
    factor.bias0 = bias ? window_.keyframe(id - 1).bias : -1;
    factor.parameters = parameters;
    if (kind == FactorKind::kDynamics || kind == FactorKind::kAccelerometer) {
      factor.loss = loss_.get();
    }
    factor.anchored = kind == FactorKind::kDynamics && window_.anchor_entry() >= 0;
    window_.AddFactor(std::move(factor));
  };
  const bool with_gyro = interval.imu && interval.imu->has_gyro;
  const bool has_bias = window_.keyframe(id - 1).bias >= 0;
  add(FactorKind::kKinematic,
      MakeCost<KinematicFactor>(FactorKind::kKinematic, interval.dt, form_,
                                options_.kinematic_position_m, options_.kinematic_rotation_rad,
                                !(with_gyro && has_bias)),
      true, false, false);

  DynamicsMeasurement measurement;
  measurement.dt = interval.dt;
  measurement.load = load_pull_;
  measurement.time_s = ToSeconds(window_.keyframe(id).stamp - *first_stamp_) - 0.5 * interval.dt;
  measurement.rotors = form_ == DynamicsForm::kEuler ? interval.rotors.start : interval.rotors.mean;
  measurement.form = form_;
  measurement.fixed_inertia = PriorInertia(*model_);
  if (window_.anchor_entry() >= 0) measurement.anchor_index = model_->IndexOf("thrust.k_f");
  const State& s0 = State::FromBlock(window_.keyframe(id - 1).x.data());
  const State& s1 = State::FromBlock(window_.keyframe(id).x.data());
  const Eigen::Matrix3d R_BS = model_->Properties(window_.values()).R_BS;
  if (with_torque_) {
    inertia_gate_.Add(interval.dt, R_BS * s0.w_WS_S, R_BS * s1.w_WS_S,
                      interval.rotors.mean.speed_squared);
    for (int i = 0; i < 3; ++i) measurement.inertia_fixed[i] = !InertiaIsFree(i);
  }
  const DynamicsNoise noise = NoiseOf(interval);
  add(FactorKind::kDynamics,
      MakeCost<DynamicsFactor>(FactorKind::kDynamics, measurement, noise, with_torque_, model_,
                               &layout_),
      true, false, true);
  if (!interval.imu || !has_bias) return;

  ImuNoise imu_noise;
  imu_noise.gyro_rad_s = options_.gyro_noise_rad_s;
  imu_noise.specific_force_m_s2 = options_.accelerometer_noise_m_s2;
  imu_noise.preintegration_rad =
      std::hypot(options_.gyro_noise_rad_s * interval.dt /
                     std::sqrt(static_cast<double>(interval.imu->num_samples)),
                 0.2 * options_.kinematic_rotation_rad);
  if (with_gyro) {
    add(FactorKind::kGyroPreintegration,
        MakeCost<GyroPreintegrationFactor>(FactorKind::kGyroPreintegration, *interval.imu,
                                           imu_noise, model_, &layout_),
        true, true, true);
    Factor gyro;
    gyro.kind = FactorKind::kGyro;
    gyro.cost = MakeCost<GyroFactor>(FactorKind::kGyro, interval.imu->gyro_at_end, imu_noise,
                                     model_, &layout_);
    gyro.state0 = id;
    gyro.bias0 = window_.keyframe(id).bias;
    gyro.parameters = true;
    window_.AddFactor(std::move(gyro));
  }
  if (interval.imu->has_accelerometer) {
    add(FactorKind::kAccelerometer,
        MakeCost<AccelerometerFactor>(FactorKind::kAccelerometer, measurement,
                                      interval.imu->mean_specific_force,
                                      AccelerometerSigma(noise.force_N), model_, &layout_),
        true, true, true);
  }
}

Vector3d Estimator::AccelerometerSigma(const Vector3d& force_N) const {
  const double sensor = options_.accelerometer_noise_m_s2;
  return ((force_N / model_->vehicle().mass_kg).array().square() + sensor * sensor).sqrt();
}

void Estimator::SmoothRotorRates(const Interval& interval, std::int64_t id) {
  if (!model_->takes_rotor_rates()) return;
  const double end_s = ToSeconds(window_.keyframe(id).stamp - *first_stamp_);
  rotor_rates_.Add(id, end_s - 0.5 * interval.dt, interval.dt, interval.rotors.mean,
                   interval.rotors.num_samples);
  rotor_rates_.ForChanged([&](std::int64_t changed, const RotorRateSmoother::Rates& rates) {
    if (changed - 1 < window_.keyframes().front().id) return;  // has left the window
    for (Factor& factor : window_.keyframe(changed - 1).factors) {
      if (factor.kind == FactorKind::kDynamics) {
        static_cast<DynamicsFactor&>(*factor.cost)
            .SetRotorRates(rates.acceleration, rates.speed_squared_rate,
                           rates.noise * RotorSpeedNoise());
        window_.Touch(&factor);
      } else if (factor.kind == FactorKind::kAccelerometer) {
        static_cast<AccelerometerFactor&>(*factor.cost)
            .SetRotorRates(rates.acceleration, rates.speed_squared_rate);
        window_.Touch(&factor);
      }
    }
  });
}

// A model's error is mostly one of scale, the same all flight long and for all modelled rotors.
void Estimator::SeeRotorScale(const RotorInterval& rotors) {
  const double speed = rotors.mean.speed.sum();
  if (!(speed > 0.0)) return;
  const double share = std::min(rotors.model_sigma.sum() / speed, 1.0);
  rotor_scale_sigma_ +=
      (share - rotor_scale_sigma_) / static_cast<double>(std::max(counters_.keyframes, 1L));
}

void Estimator::AddScaleError(Snapshot* snapshot) const {
  if (rotor_scale_sigma_ == 0.0) return;
  ModelValues error = ModelValues::Zero(model_->num_parameters());
  for (const char* name : {"thrust.k_f", "rotor_torque.k_m"}) {
    const int k = model_->IndexOf(name);
    if (k >= 0 && model_->parameters()[k].estimated)
      error[k] = 2.0 * snapshot->values[k] * rotor_scale_sigma_;
  }
  snapshot->covariance.noalias() += error * error.transpose();
  snapshot->sigma = (snapshot->sigma.cwiseAbs2() + error.cwiseAbs2()).cwiseSqrt();
}

void Estimator::TakeSnapshot(const OdometrySample& sample, const SolveReport& report) {
  Snapshot& snapshot = snapshot_;
  snapshot.stamp = sample.stamp;
  snapshot.time_s = ToSeconds(sample.stamp - *first_stamp_);
  snapshot.airborne = airborne();
  snapshot.state = State::FromBlock(window_.keyframes().back().x.data());
  snapshot.values = window_.values();
  snapshot.body = model_->Properties(snapshot.values);
  snapshot.solve = report;
  snapshot.battery_voltage_V = synchroniser_.battery_voltage_V();

  const int n = layout_.num_estimated();
  Eigen::MatrixXd& covariance = covariance_;
  if (solver_->ParameterCovariance(window_, sigma_eta_, &covariance)) {
    sigma_eta_ = covariance.diagonal().cwiseSqrt();
  } else {
    covariance = sigma_eta_.cwiseAbs2().asDiagonal();  // rounding has the better of it: as before
  }
  if (!solver_->StateCovariance(window_, &snapshot.state_covariance)) {
    snapshot.state_covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  if (consistency_.BlockIsFull()) RefreshConsistency(covariance);
  if (regressor_noise_.IsDue(counters_.airborne_s)) {
    regressor_noise_.Look(window_, *model_, process_noise_.in_use(), snapshot.state_covariance,
                          counters_.airborne_s);
    noise_inflation_ = regressor_noise_.Inflation(covariance, prior_sigma_eta_);
    RefreshInflation(covariance);
  }

  const int m = model_->num_parameters();
  snapshot.sigma.setZero(m);
  snapshot.covariance.setZero(m, m);
  snapshot.observable.assign(static_cast<size_t>(m), false);
  const ParameterVector chain = layout_.ChainFactors(snapshot.values);
  for (int i = 0; i < n; ++i) {
    const int k = layout_.model_index(i);
    const double sigma = sigma_eta_[i] * inflation_[i];
    snapshot.sigma[k] = sigma * std::abs(chain[i]);
    snapshot.observable[k] = sigma < kObservableShare * prior_sigma_eta_[i];
    for (int j = 0; j < n; ++j) {
      snapshot.covariance(k, layout_.model_index(j)) =
          covariance(i, j) * inflation_[i] * inflation_[j] * chain[i] * chain[j];
    }
  }
  AddScaleError(&snapshot);
  snapshot.inflation.setOnes(m);
  for (int i = 0; i < n; ++i) {
    const int k = layout_.model_index(i);
    const double plain = sigma_eta_[i] * std::abs(chain[i]);
    if (plain > 0.0) snapshot.inflation[k] = std::max(1.0, snapshot.sigma[k] / plain);
  }
  snapshot.unobservable = unobservable_;
  FillResiduals(&snapshot);
}

void Estimator::RefreshConsistency(const Eigen::MatrixXd& covariance) {
  consistency_.CloseBlock(solver_->PastInformation(window_));
  consistency_inflation_ = consistency_.Inflation(window_.eta(), covariance);
  RefreshInflation(covariance);
}

void Estimator::RefreshInflation(const Eigen::MatrixXd& covariance) {
  const int n = layout_.num_estimated();
  inflation_ = consistency_inflation_.cwiseProduct(noise_inflation_);
  // Of what varies, the flight's scores say nothing about the present value.
  for (const DynamicModel::ProcessParameter& p : model_->processes()) {
    for (int i = 0; i < n; ++i) {
      if (layout_.model_index(i) == p.index) inflation_[i] = 1.0;
    }
  }

  // Directions about which the flight says less than the priors, in units of the priors' sigmas.
  directions_.in_priors = covariance;
  for (int i = 0; i < n; ++i) {
    const double scale = noise_inflation_[i] / prior_sigma_eta_[i];
    directions_.in_priors.row(i) *= scale;
    directions_.in_priors.col(i) *= scale;
  }
  unobservable_.clear();
  if (n == 0) return;
  directions_.eigen.compute(directions_.in_priors, Eigen::EigenvaluesOnly);
  if (directions_.eigen.eigenvalues()[n - 1] <= kObservableShare) return;
  directions_.eigen.compute(directions_.in_priors);
  for (int i = 0; i < n; ++i) {
    if (directions_.eigen.eigenvalues()[i] > kObservableShare) {
      unobservable_.push_back(Words(*model_, layout_, directions_.eigen.eigenvectors().col(i)));
    }
  }
}

void Estimator::FillResiduals(Snapshot* snapshot) {
  const auto& keyframes = window_.keyframes();
  if (keyframes.size() < 2) return;
  for (const Factor& factor : keyframes[keyframes.size() - 2].factors) {
    if (factor.kind != FactorKind::kDynamics) continue;
    const auto& dynamics = static_cast<const DynamicsFactor&>(*factor.cost);
    Eigen::Matrix<double, kNumDynamicsRows, 1> e;
    if (!dynamics.UnwhitenedResidual(window_.Blocks(factor, false).data(), &e)) continue;
    const double dt = dynamics.measurement().dt;
    snapshot->residual_force_B = e.segment<3>(kRowVelocity) / dt;
    if (with_torque_) {
      snapshot->residual_torque_B = snapshot->body.I_BBcm_B * e.segment<3>(kRowAngular) / dt;
    }
    const double gain = std::min(1.0, dt / options_.window_s);
    residual_force_power_ +=
        gain * (snapshot->residual_force_B.squaredNorm() / 3.0 - residual_force_power_);
    residual_torque_power_ +=
        gain * (snapshot->residual_torque_B.squaredNorm() / 3.0 - residual_torque_power_);
  }
  snapshot->residual_force_rms_N = std::sqrt(residual_force_power_);
  snapshot->residual_torque_rms_Nm = std::sqrt(residual_torque_power_);
}

// The newest states still give way to a change; those a little older can't.
void Estimator::LookForChange() {
  const auto& keyframes = window_.keyframes();
  const Stamp until = keyframes.back().stamp - FromSeconds(kChangeDelay_s);
  for (const Keyframe& keyframe : keyframes) {
    if (keyframe.stamp > until) return;
    if (keyframe.stamp <= change_seen_) continue;
    change_seen_ = keyframe.stamp;
    for (const Factor& factor : keyframe.factors) {
      if (factor.kind != FactorKind::kDynamics) continue;
      const auto& dynamics = static_cast<const DynamicsFactor&>(*factor.cost);
      Eigen::Matrix<double, kNumDynamicsRows, 1> e;
      if (!dynamics.UnwhitenedResidual(window_.Blocks(factor, false).data(), &e)) continue;
      const double dt = dynamics.measurement().dt;
      const Eigen::Vector3d torque =
          dynamics.noise().nominal_inertia.cwiseProduct(e.segment<3>(kRowAngular)) / dt;
      if (!change_detector_.Add(dt, e.segment<3>(kRowVelocity) / dt, torque)) continue;
      return LearnAnew();
    }
  }
}

// The chain ends here, so that no state spans the change; what was learned stays as it is, only
// less certain.
void Estimator::LearnAnew() {
  ++counters_.changes;
  phases_.ForgetThrust();
  EmptyWindow();
  learned_s_ = 0.0;
  bias_since_.reset();
  last_in_window_ = false;
  inertia_gate_.Break();
  Eigen::VectorXd scale(sigma_eta_.size());
  for (Eigen::Index i = 0; i < scale.size(); ++i) {
    const double ratio = sigma_eta_[i] / (kSigmaAfterChange * prior_sigma_eta_[i]);
    scale[i] = std::clamp(ratio * ratio, 1e-8, 1.0);
  }
  const Eigen::MatrixXd& root = solver_->ScalePast(scale, &window_);
  consistency_.Rescale(root);
  regressor_noise_.Forget(root);
}

// Parameters that vary are one value a window: a long one could not follow them.
bool Estimator::IsLearning() const {
  return learned_s_ < kLearning_s && model_->processes().empty();
}

void Estimator::MarginalizeOld() {
  auto& keyframes = window_.keyframes();
  double keep_s = IsLearning() ? std::max(kLearning_s, options_.window_s) : options_.window_s;
  if (phases_.detector().suspects()) keep_s += kMostHeld_s;
  const auto is_long = [&] {
    return ToSeconds(keyframes.back().stamp - keyframes.front().stamp) >=
           keep_s - 1.5 / options_.keyframe_rate_hz;
  };
  for (int i = 0; i < kMostLeaving && keyframes.size() > 2 && is_long(); ++i) {
    double dt = 0.0;
    for (const Factor& factor : keyframes.front().factors) {
      if (factor.kind == FactorKind::kDynamics)
        dt = static_cast<const DynamicsFactor&>(*factor.cost).measurement().dt;
    }
    solver_->MarginalizeOldest(&window_, sigma_eta_, &leaving_);
    LetVary(dt > 0.0 ? dt : 1.0 / options_.keyframe_rate_hz);
    if (dt == 0.0) continue;
    consistency_.Add(dt, leaving_.score, window_.eta());
    force_information_ += leaving_.force_information;
    torque_information_ += leaving_.torque_information;
  }
}

void Estimator::LetVary(double dt) {
  if (model_->processes().empty() && walking_.empty()) return;
  const ModelValues values = window_.values();
  const ParameterVector chain = layout_.ChainFactors(values);
  walk_owed_s_ += dt;
  if (!walking_.empty() && walk_owed_s_ >= kWalkEvery_s) {
    ParameterVector relative = ParameterVector::Zero(layout_.num_estimated());
    for (const int i : walking_) relative[i] = values[layout_.model_index(i)] / chain[i];
    const double rate = options_.k_f_walk_rate;
    before_walk_ = solver_->PastInformation(window_);
    solver_->LetPastWalk(relative, rate * rate * walk_owed_s_, &window_);
    consistency_.Walked(before_walk_, solver_->PastInformation(window_));
    walk_owed_s_ = 0.0;
  }
  for (const DynamicModel::ProcessParameter& p : model_->processes()) {
    for (int i = 0; i < layout_.num_estimated(); ++i) {
      if (layout_.model_index(i) != p.index) continue;
      const double sigma = values[p.sigma] / chain[i];
      const double decay = std::exp(-dt / values[p.time_constant]);
      solver_->LetPastVary(i, {decay, (1.0 - decay * decay) * sigma * sigma}, &window_);
    }
  }
}

void Estimator::FollowNoise() {
  const auto& keyframes = window_.keyframes();
  const double settled_s =
      std::min(options_.window_s, kSettled_s) - 1.5 / options_.keyframe_rate_hz;
  const Stamp until = keyframes.back().stamp - FromSeconds(settled_s);
  for (std::int64_t id = std::max(noise_seen_ + 1, keyframes.front().id);
       id < keyframes.back().id && window_.keyframe(id).stamp <= until; ++id) {
    noise_seen_ = id;
    for (const Factor& factor : window_.keyframe(id).factors) {
      if (factor.kind != FactorKind::kDynamics) continue;
      const auto& cost = static_cast<const DynamicsFactor&>(*factor.cost);
      Eigen::Matrix<double, kNumDynamicsRows, 1> e;
      if (!cost.UnwhitenedResidual(window_.Blocks(factor, false).data(), &e)) continue;
      const DynamicsNoise& noise = cost.noise();
      IntervalResidual residual;
      residual.dt = cost.measurement().dt;
      residual.force_N = e.segment<3>(kRowVelocity) / residual.dt;
      residual.torque_Nm =
          noise.nominal_inertia.cwiseProduct(e.segment<3>(kRowAngular)) / residual.dt;
      residual.rotor_force_N.z() = noise.rotor_force_N;
      residual.rotor_torque_Nm = noise.rotor_torque_Nm;
      process_noise_.Add(residual, with_torque_);
    }
  }
}

void Estimator::SetModelNoise(const ProcessNoiseEstimator& noise, Keyframe* keyframe) {
  for (Factor& factor : keyframe->factors) {
    if (factor.kind == FactorKind::kDynamics) {
      auto& dynamics = static_cast<DynamicsFactor&>(*factor.cost);
      const double dt = dynamics.measurement().dt;
      dynamics.SetModelNoise(noise.ForceSigma(dt), noise.TorqueSigma(dt));
    } else if (factor.kind == FactorKind::kAccelerometer) {
      auto& accelerometer = static_cast<AccelerometerFactor&>(*factor.cost);
      accelerometer.SetSigma(AccelerometerSigma(noise.ForceSigma(accelerometer.measurement().dt)));
    }
  }
}

// One size of what is not modelled holds for the window and for what left it.
void Estimator::RescaleNoise() {
  const ProcessNoiseEstimator before = process_noise_;
  const auto change = process_noise_.Step();
  if (!change) return;
  // The past: each parameter by what has informed it, force rows, torque rows, or both.
  force_information_ *= change->force;
  torque_information_ *= change->torque;
  const double log_force = std::log(change->force), log_torque = std::log(change->torque);
  ParameterVector scale(force_information_.size());
  for (int i = 0; i < scale.size(); ++i) {
    const double total = std::max(force_information_[i] + torque_information_[i], 1e-300);
    const double share = force_information_[i] / total;
    scale[i] = std::exp(share * log_force + (1.0 - share) * log_torque);
  }
  const auto weigh = [this](Keyframe* keyframe) {
    SetModelNoise(process_noise_, keyframe);
    for (Factor& factor : keyframe->factors) ++factor.revision;
    if (keyframe->id <= noise_step_->newest)
      noise_step_->reached = std::max(noise_step_->reached, keyframe->id);
  };
  noise_step_ = {before, window_.keyframes().back().id, -1};
  const Eigen::MatrixXd& root = solver_->Reweigh(scale, weigh, &window_);
  consistency_.Rescale(root);
  regressor_noise_.Rescale(root);
}

ParameterSet Estimator::ToParameterSet(const DynamicModel& model, const Snapshot& snapshot) {
  ParameterSet set;
  set.effects = model.effect_names();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    set.parameters.push_back({p.full_name, p.spec.unit, snapshot.values[i], snapshot.sigma[i],
                              p.estimated, static_cast<bool>(snapshot.observable[i])});
  }
  set.covariance = snapshot.covariance;
  return set;
}

}  // namespace odmc
