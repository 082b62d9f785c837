#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "odmc/math/ring.h"
#include "odmc/window/chain_front.h"
#include "odmc/window/root_triangle.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// What an incremental solve leaves as it is, and how much it does at once.
struct IncrementalOptions {
  /// A recent state, and any that a sweep passes, is linearized anew where an entry of its tangent
  /// has moved by more than this from the point where it was: position [m], rotation [rad],
  /// velocity [m/s], rate [rad/s].
  std::array<double, kStateTangentSize> relinearise_state = {0.05,  0.05,  0.05,  5e-4, 5e-4, 5e-4,
                                                             0.005, 0.005, 0.005, 1e-3, 1e-3, 1e-3};
  /// Parameters: of their present sigma; further where old linearizations hardly matter.
  double relinearise_parameters = 0.3;
  /// Those in logarithms, which other parameters' Jacobians are in proportion to: of their value.
  double relinearise_share = 0.015;
  /// Back-substitution stops at a state that changes by less than this share of the thresholds
  /// above (wildfire), and goes through the whole window when parameters have moved by this share
  /// of a sigma, or a bias by this share of 0.05 rad/s or m/s².
  double wildfire = 0.04;
  /// Error that old linearizations may bring to a sigma [relative]. Every sweep shows how much the
  /// distance between two points of linearization mattered; where half a tolerance may be reached
  /// before the next one is through, it goes four times as fast, where 0.8 of one, in windows of up
  /// to 250 keyframes, as fast as the time bound of a solve allows.
  double sigma_tolerance = 0.05;
  /// Newest keyframes that are eliminated anew at once when their points move, >= 1.
  int recent_keyframes = 3;
  /// How often that is done in one update at most, >= 0.
  int recent_passes = 2;
  /// They are eliminated anew as well where a parameter has moved by more than this [sigmas].
  double relinearise_recent = 0.1;
  /// What is eliminated anew keeps its linearization where parameters have moved by less [sigmas].
  double same_point = 0.01;
  /// Older keyframes eliminated anew per update when parameters have moved, >= 2, or this share of
  /// all if that is more, so that a sweep takes no more than 1/share updates.
  int sweep_keyframes = 6;
  double sweep_share = 0.006;
  /// Older keyframes whose gradients are corrected together (ChainFront::Correct), >= 1; such
  /// segments per update in turn, >= 0, and where the others are expected to change a parameter by
  /// more than this [sigmas], as many as the time bound of a solve allows, the worst first.
  int segment_keyframes = 25;
  int corrected_segments = 1;
  double allowed_lag = 0.03;
  /// Older keyframes back-substituted per update, >= 1.
  int back_substituted_keyframes = 50;
  /// A step of a parameter beyond this share of its own prior's sigma asks for the batch solve.
  double largest_step = 0.5;
};

/// Solves only what changed, in the style of iSAM2 (Kaess et al. 2012), on a chain of states with a
/// border of shared variables: square-root elimination, oldest state first, biases as they leave,
/// parameters last (docs/window.md). A new keyframe eliminates the one before it; the oldest leaves
/// by dropping its conditional. When parameters have moved, a sweep eliminates the chain anew from
/// its oldest end, a few keyframes per update, beside the chain in use, and takes its place when it
/// has caught up.
///
/// The first alignment and steps that are too long for a linear model are left to the batch solve.
/// No steady update allocates.
class IncrementalWindowSolver final : public WindowSolver {
 public:
  explicit IncrementalWindowSolver(const IncrementalOptions& options = {});
  ~IncrementalWindowSolver() override;

  SolveReport Solve(Window* window, const SolverOptions& options) override;
  bool ParameterCovariance(const Window& window, const Eigen::VectorXd& sigma,
                           Eigen::MatrixXd* covariance) override;
  bool StateCovariance(const Window& window, StateMatrix* covariance) override;
  bool MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                         LeavingFactors* leaving) override;
  const Eigen::MatrixXd& ScalePast(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                   Window* window) override;
  const Eigen::MatrixXd& Reweigh(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                 std::function<void(Keyframe*)> weigh, Window* window) override;
  /// Falls back to the batch solve: the step changes what every state says.
  void LetPastVary(int index, const ProcessStep& step, Window* window) override;
  void LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
                   Window* window) override;
  const Eigen::MatrixXd& PastInformation(const Window& window) override;
  void WritePrior(Window* window) override;
  void Release(Window* window) override {
    HandBack(window);
    batch_.Forget();
  }

 private:
  struct Checkpoint {
    std::int64_t id = -1;
    RootTriangle root;  // before the keyframe's own factors
  };

  /// Fronts that are corrected together.
  struct Segment {
    std::int64_t first = 0;
    ParameterVector at;     // parameters when they were evaluated
    double bend = 0.0;      // error [sigmas] they make where parameters are a sigma from there
    double expected = 0.0;  // error they make now [sigmas]
    std::int64_t turn = 0;  // when they were evaluated
  };

  bool Follows(const Window& window) const;
  void Forget();
  void ReadPrior(const Window& window);
  void WritePrior(const RootTriangle& past, Window* window) const;
  bool Build(Window* window);
  void HandBack(Window* window);
  SolveReport Align(Window* window, const SolverOptions& options);
  ChainFront& front(std::int64_t id) {
    return fronts_[static_cast<size_t>(id - fronts_.front().id)];
  }

  void AppendFront(const Window& window, std::int64_t id);
  bool Advance(const Window& window, std::int64_t id);
  bool Redo(const Window& window, std::int64_t from);
  bool RedoMovedRecent(Window* window);
  void StartSweep(const Window& window);
  int SweepSize() const;
  void FinishReweighing(Window* window);
  bool Sweep(Window* window, int budget, bool corrects = true);
  bool SweepOne(Window* window);
  bool SweepAll(Window* window);
  void CorrectSegment(const Window& window, Segment* segment);
  void CorrectBeforeSweep(const Window& window, std::int64_t end);
  void GiveFoundTo(RootTriangle* root);
  double GiveFoundToRoots(const Window& window, std::int64_t end);
  double Distance(const Window& window, const ParameterVector& at) const;
  double ExpectErrors(const Window& window);
  template <typename InTime>
  bool Correct(Window* window, const InTime& in_time, bool all = false);
  struct Solution {
    Eigen::VectorXd eta, sigma;
  };
  bool SolutionOf(const Window& window, Solution* solution);
  bool CatchUp(Window* window);
  std::int64_t MovePoints(const Window& window, std::int64_t from);
  std::int64_t OldestRecent() const;
  void MoveParameterPoint(const Window& window);

  bool SolveRoot(Window* window);
  void BackSubstitute(Window* window, bool everything);
  double BackSubstitute(std::int64_t id, Window* window);
  void StoreState(ChainFront* front, Window* window);
  bool HasMoved(const Window& window, const ChainFront& front) const;
  bool ParametersMoved(const Window& window, const ParameterVector& from, double sigmas,
                       double share) const;
  bool MayCost(double error, const Window& window) const;
  void LearnCurvature();
  void Observe(const Window& window, const ChainFront& front, LeavingFactors* leaving) const;
  template <typename Change>
  void ChangePast(const Change& change);
  void ApplyPending();

  IncrementalOptions options_;
  EliminationWindowSolver batch_;  // until aligned, and for the alignment
  bool incremental_ = false;
  Ring<ChainFront> fronts_;
  RowBlock triangle_;         // of the newest state
  RootTriangle root_, past_;  // of the chain in use, parameters' priors included; of what left
  Ring<Checkpoint> checkpoints_;
  struct {
    bool active = false, wanted = false;
    bool urgent = false;         // old factors were touched: at once, as far as time allows
    bool reweighs = false;       // it brings weights that the chain in use does not have
    bool has_reweighed = false;  // in this solve: what it took up first is out of date
    std::function<void(Keyframe*)> weigh;
    RootTriangle past;      // as the chain in use has it
    std::int64_t next = 0;  // front to eliminate next
    RootTriangle root;
    ParameterVector begun_at;  // where parameters were when it began
  } sweep_;
  std::int64_t turn_ = 0;
  Ring<Segment> segments_;             // all fronts, oldest first
  std::vector<double> found_, given_;  // by corrections, of shared variables
  ParameterVector point_;              // of linearization, at present
  int point_version_ = 0;
  ParameterVector recent_at_;  // where recent fronts were evaluated together
  ParameterVector in_use_at_;  // where the chain in use was linearized; the sweep brings it on
  Solution before_, after_;    // a sweep took the chain's place
  double curvature_ = 0.0;     // tolerances at one sigma between two points
  bool have_root_ = false;
  std::vector<double> shared_, propagated_;  // solution of the border; at the last full pass
  std::vector<double> border_;               // its candidate
  std::vector<double> substituted_;          // solution of the front at hand
  Eigen::VectorXd sigma_;                    // of the parameters, last known
  Eigen::MatrixXd pending_;                  // change of the past the roots do not know yet
  bool has_pending_ = false;
  RootTriangle::Workspace workspace_;
  Eigen::MatrixXd normal_, covariance_, scale_root_, past_information_;
  std::int64_t pass_ = -1;  // back-substitution goes on here, -1: done
  FrontScratch scratch_;
  RowBlock sweep_triangle_;
  SolveReport report_;  // of the solve at work
};

}  // namespace odmc
