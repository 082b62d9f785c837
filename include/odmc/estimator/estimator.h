#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/estimator/change_detector.h"
#include "odmc/estimator/consistency.h"
#include "odmc/estimator/gates.h"
#include "odmc/estimator/load_observer.h"
#include "odmc/estimator/noise_estimation.h"
#include "odmc/estimator/options.h"
#include "odmc/estimator/phase_watch.h"
#include "odmc/estimator/regressor_noise.h"
#include "odmc/model/parameter_set.h"
#include "odmc/preintegration/imu_interval.h"
#include "odmc/preintegration/rotor_interval.h"
#include "odmc/preintegration/rotor_rate_smoother.h"
#include "odmc/sensing/synchroniser.h"
#include "odmc/window/window.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// Wall and CPU time of one update [ms], and what they depend on.
struct UpdateTiming {
  double wall_ms = 0.0;
  double cpu_ms = 0.0;
  // Wall time of the stages of an update, in their order; their sum is wall_ms.
  double read_ms = 0.0;         ///< synchronise the streams, look for the ground, preintegrate
  double build_ms = 0.0;        ///< the keyframe and its factors
  double solve_ms = 0.0;        ///< the window
  double snapshot_ms = 0.0;     ///< covariances, residuals
  double marginalize_ms = 0.0;  ///< the oldest keyframe; statistics of its residual
  int states = 0;               ///< in the window
  bool window_full = false;     ///< the window had its length, no less and not much more
  // As in SolveReport.
  int eliminated = 0;
  bool sweeping = false, aligned = false;
};

/// Where the estimate stands after one update.
struct Snapshot {
  Stamp stamp = 0;      ///< of the newest keyframe
  double time_s = 0.0;  ///< since the first keyframe
  bool airborne = false;
  State state;  ///< newest keyframe, sensor frame S
  /// Of its tangent (p, theta, v, w), not inflated; NaN where a direction is not known.
  WindowSolver::StateMatrix state_covariance;
  BodyProperties body;    ///< at the estimate: mounts, centre of mass, gravity
  ModelValues values;     ///< of the model's parameters
  Eigen::VectorXd sigma;  ///< of each, 0 where frozen; inflated for serial correlation
  /// Of each, at least 1: `sigma` over what the window's information alone gives.
  Eigen::VectorXd inflation;
  std::vector<bool> observable;
  std::vector<std::string> unobservable;  ///< directions nobody measured, in words
  Eigen::MatrixXd covariance;             ///< of all parameters, 0 where frozen
  SolveReport solve;
  UpdateTiming timing;
  Eigen::Vector3d residual_force_B = Eigen::Vector3d::Zero();   ///< newest interval [N]
  Eigen::Vector3d residual_torque_B = Eigen::Vector3d::Zero();  ///< newest interval [N m]
  double residual_force_rms_N = 0.0;    ///< running, about a window long, all axes
  double residual_torque_rms_Nm = 0.0;  ///< running, about a window long, all axes
  double battery_voltage_V = 0.0;
};

/// How far an estimate is from that of a batch solve of the same window to convergence.
struct FullSolveDifference {
  double parameters = 0.0;  ///< largest, in standard deviations of the full solve
  double sigmas = 0.0;      ///< largest relative difference of a standard deviation
  std::string worst_parameter, worst_sigma;  ///< full names
};

/// What happened so far, in numbers.
struct EstimatorCounters {
  long keyframes = 0;         ///< that entered the window
  long ground_keyframes = 0;  ///< left out: not in free flight
  long taken_back = 0;        ///< of these, those that had been in the window already
  long starts_anew = 0;       ///< times all that was learned was worth nothing
  long chains = 0;            ///< chains of states: 1 plus the gaps
  long gaps = 0;              ///< holes in a stream, missing rotor speeds
  long jumps = 0;             ///< odometry that moved without velocity
  long changes = 0;           ///< of the vehicle, after which it learned anew
  Stamp last_change = 0;      ///< when the last of these was seen
  long refused_updates = 0;   ///< solves that were not usable
  double on_ground_s = 0.0;  ///< not in free flight
  double airborne_s = 0.0;
};

/// The pipeline in one object: samples go in, snapshots come out. Runs the same offline and live.
/// Thread-compatible: one thread owns it.
class Estimator {
 public:
  /// @param model must outlive the estimator
  /// @throws std::invalid_argument if the options are not valid
  Estimator(const DynamicModel* model, const EstimatorOptions& options, bool with_torque);
  ~Estimator();

  void Add(const OdometrySample& sample);
  void Add(const ImuSample& sample);
  void Add(const RotorSample& sample);
  void Add(const BatterySample& sample);
  void Finish();

  /// Processes at most one keyframe. @returns a snapshot, good until the next call, if one was
  /// processed in free flight, or if something that was learned had to be taken back; else null
  const Snapshot* Step();

  /// True if the last Step() consumed a keyframe, airborne or not: there may be more.
  bool made_progress() const { return made_progress_; }

  /// Stamp of the keyframe the last Step() consumed.
  Stamp last_keyframe_stamp() const { return last_ ? last_->stamp : 0; }

  /// Forgets samples and states, keeps what was learned about the parameters (a new flight or a
  /// clock that stepped back).
  void RestartChain();
  /// Back to the priors: all that was learned so far is not of this flight, or not of streams as
  /// they are from now on.
  void StartAnew();

  /// Goes on where an estimator of the same vehicle with another model stands: samples, ground and
  /// noise are taken over, flight time and counters go on; states and parameters start anew.
  /// @param declared the model with the priors by which parameters count as observable (those of
  ///   this estimator's model hold what `before` has learned); same parameters as the model
  /// @pre nothing was added yet
  void CarryOn(const Estimator& before, const DynamicModel& declared);

  /// Stamp from which flight time counts; 0 before the first keyframe.
  Stamp start() const { return first_stamp_.value_or(0); }

  const EstimatorCounters& counters() const { return counters_; }
  const SynchroniserCounters& stream_counters() const { return synchroniser_.counters(); }
  const std::string& waiting_for() const { return synchroniser_.waiting_for(); }
  /// True while the flight teaches: nothing but the air acts on the vehicle.
  bool airborne() const { return phases_.detector().has_begun() && phases_.detector().teaches(); }
  const PhaseDetector& phases() const { return phases_.detector(); }
  const DynamicModel& model() const { return *model_; }
  const EstimatorOptions& options() const { return options_; }
  /// Keyframes for whose stamp this is true teach the estimate nothing: what is judged on them has
  /// not seen them.
  void SetHeldOut(std::function<bool(Stamp)> is_held_out) { is_held_out_ = std::move(is_held_out); }

  /// Solves the window as it stands once more with Ceres, to convergence, and leaves it as it was.
  /// For benchmarks and tests. @returns nothing without states, or where a solve failed
  std::optional<FullSolveDifference> CompareWithFullSolve();

  /// Compares what the thirds of the flight so far say by themselves. @returns the parameters about
  /// which they disagree beyond sampling error (LastLookThreshold()), serial correlation included
  std::vector<ThirdsDifference> LastLook();

  /// Calls `observe` in every update between the solve and the marginalization, untimed.
  void SetObserver(std::function<void()> observe) { observe_ = std::move(observe); }

  const InertiaGate& inertia_gate() const { return inertia_gate_; }
  OdometryNoise odometry_noise() const { return stream_noise_.odometry(); }

  /// The estimate as a parameter set, for files and messages.
  static ParameterSet ToParameterSet(const DynamicModel& model, const Snapshot& snapshot);

 private:
  struct Interval;  // what lies between two keyframes

  void EmptyWindow();
  bool FreeInertia();
  bool InertiaIsFree(int axis) const;
  void FollowLoad(const OdometrySample& sample);
  /// Parameters that vary may have moved by what they do in `dt`.
  void LetVary(double dt);
  bool AlignmentIsDue() const;
  bool FollowPhase(const OdometrySample& sample);
  const Snapshot* TakeBack(Stamp since);
  void CountTime(double dt, bool teaches);
  void TellPhases(Stamp stamp);
  void RestoreGate(Stamp since);
  std::optional<Interval> ReadInterval(const OdometrySample& sample);
  bool IsJump(const OdometrySample& sample, double dt) const;
  State InitialState(const OdometrySample& sample, const Interval* interval) const;
  /// Body rate in S that the gyro reads at `stamp`, its bias taken off; nothing without samples
  /// around it.
  std::optional<Eigen::Vector3d> GyroRate(Stamp stamp) const;
  /// A cost function, from the window's spares where there are any.
  template <typename T, typename... Arguments>
  std::unique_ptr<ceres::CostFunction> MakeCost(FactorKind kind, const Arguments&... arguments);
  std::int64_t CurrentBias(Stamp stamp, bool has_imu);
  void AddKeyframe(const OdometrySample& sample, const std::optional<Interval>& interval);
  void AddIntervalFactors(const Interval& interval, std::int64_t id);
  DynamicsNoise NoiseOf(const Interval& interval) const;
  double RotorSpeedNoise() const;
  void SeeRotorScale(const RotorInterval& rotors);
  /// What an error of scale in modelled rotor speeds does to the coefficients of their squares.
  void AddScaleError(Snapshot* snapshot) const;
  /// Averages the rotors' accelerations of the newest intervals, as far as those after them go.
  void SmoothRotorRates(const Interval& interval, std::int64_t id);
  void TakeSnapshot(const OdometrySample& sample, const SolveReport& report);
  void FillResiduals(Snapshot* snapshot);
  void LookForChange();
  void LearnAnew();
  /// True while the whole flight stays in the window.
  bool IsLearning() const;
  void MarginalizeOld();
  /// Looks at what the newest settled intervals leave unexplained.
  void FollowNoise();
  /// Weighs all that was measured anew where that has grown or shrunk.
  void RescaleNoise();
  /// Gives a keyframe's factors the sizes of what is not modelled.
  void SetModelNoise(const ProcessNoiseEstimator& noise, Keyframe* keyframe);
  Eigen::Vector3d AccelerometerSigma(const Eigen::Vector3d& force_N) const;
  void RefreshConsistency(const Eigen::MatrixXd& covariance);
  void RefreshInflation(const Eigen::MatrixXd& covariance);

  const DynamicModel* model_;
  EstimatorOptions options_;
  bool with_torque_;
  DynamicsForm form_;
  ParameterLayout layout_;
  Synchroniser synchroniser_;
  PhaseWatch phases_;
  struct {
    double dt = 0.0;                      // since the keyframe before, 0: none
    std::optional<RotorInterval> rotors;  // since then
    bool is_gap = false, is_jump = false;
    std::optional<Stamp> take_back;
  } step_;  // the newest keyframe, before it is used
  InertiaGate inertia_gate_;
  Ring<std::pair<Stamp, InertiaGate::Statistics>> gate_before_;  // one a tenth of a second
  LoadObserver load_;
  LoadPull load_pull_;  // over the newest interval
  std::function<bool(Stamp)> is_held_out_;
  std::function<void()> observe_;
  StreamNoise stream_noise_;
  double rotor_scale_sigma_ = 0.0;  // of rotor speeds, mean over the flight, 0: none modelled
  RotorRateSmoother rotor_rates_;
  ProcessNoiseEstimator process_noise_;
  std::int64_t noise_seen_ = -1;  // newest keyframe whose interval it was given
  struct NoiseStep {
    ProcessNoiseEstimator before;
    std::int64_t newest = -1;   // keyframe before it
    std::int64_t reached = -1;  // newest of those that has the new sizes by now
  };
  std::optional<NoiseStep> noise_step_;  // the last one
  ChangeDetector change_detector_;
  Stamp change_seen_ = 0;  // start of the newest interval it was given
  Window window_;
  std::unique_ptr<WindowSolver> solver_;
  std::unique_ptr<ceres::LossFunction> loss_;
  std::vector<int> walking_;     // entries of eta that walk together
  double walk_owed_s_ = 0.0;     // of flight that has left the window since they last did
  Eigen::MatrixXd before_walk_;  // information of the past
  Consistency consistency_;
  RegressorNoise regressor_noise_;
  Eigen::VectorXd consistency_inflation_, noise_inflation_, inflation_;  // the last: both
  Eigen::VectorXd prior_sigma_eta_;  // by which parameters count as observable
  Eigen::VectorXd sigma_eta_;        // of the last update, not inflated
  Eigen::VectorXd force_information_, torque_information_;  // what has informed each parameter
  std::vector<std::string> unobservable_;
  struct {
    Eigen::MatrixXd in_priors;  // covariance in units of the priors' sigmas
    Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen;
  } directions_;
  Snapshot snapshot_;  // the newest, filled in place
  Eigen::MatrixXd covariance_;
  LeavingFactors leaving_;
  double residual_force_power_ = 0.0, residual_torque_power_ = 0.0;  // running mean squares
  EstimatorCounters counters_;
  std::optional<OdometrySample> last_;  // newest keyframe's odometry
  std::optional<OdometrySample> before_last_;
  bool last_in_window_ = false;
  double learned_s_ = 0.0;  // flown since the parameters were last new
  bool was_learning_ = false;
  bool estimates_inertia_ = false;  // about any axis
  std::optional<Stamp> first_stamp_;
  std::optional<Stamp> bias_since_;
  std::array<bool, 3> inertia_was_free_ = {false, false, false};
  std::vector<Factor> pending_;  // of a bias whose first keyframe is about to come
  Stamp noise_ready_ = 0;
  bool made_progress_ = false;
  double aligned_states_ = 0.0;         // in the window at the last alignment
  bool needs_more_iterations_ = false;  // the last solve took no step
};

}  // namespace odmc
