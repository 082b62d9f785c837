#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>

#include "odmc/window/chain.h"
#include "odmc/window/chain_alignment.h"
#include "odmc/window/chain_corrections.h"
#include "odmc/window/chain_past.h"
#include "odmc/window/chain_solution.h"
#include "odmc/window/chain_sweep.h"
#include "odmc/window/incremental_options.h"
#include "odmc/window/linearisation_error.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// Solves only what changed, in the style of iSAM2 (Kaess et al. 2012), on a chain of states with a
/// border of shared variables: square-root elimination, oldest state first, biases as they leave,
/// parameters last (docs/window.md). A new keyframe eliminates the one before it; the oldest leaves
/// by dropping its conditional. When parameters have moved, a sweep eliminates the chain anew from
/// its oldest end, a few keyframes per update, beside the chain in use, and takes its place when it
/// has caught up.
///
/// The first alignment and steps that are too long for a linear model solve the window as a whole
/// (ChainAlignment) where that fits into what an update may work; in longer windows, sweeps over
/// several updates align, and such steps are damped. No steady update allocates.
class IncrementalWindowSolver final : public WindowSolver {
 public:
  explicit IncrementalWindowSolver(const IncrementalOptions& options = {});
  ~IncrementalWindowSolver() override;
  IncrementalWindowSolver(const IncrementalWindowSolver&) = delete;
  IncrementalWindowSolver& operator=(const IncrementalWindowSolver&) = delete;

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
  /// The chain is built anew at the next solve: the step changes what every state is told.
  void LetPastVary(int index, const ProcessStep& step, Window* window) override;
  void LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
                   Window* window) override;
  const Eigen::MatrixXd& PastInformation(const Window& window) override;
  void WritePrior(Window* window) override;
  void Release(Window* window) override { HandBack(window); }

 private:
  class Allowance;
  enum class Outcome { kDone, kRefused, kTooLong };  // the last: a step, for a linear model

  bool Follows(const Window& window) const;
  void Forget();
  void Read(const Window& window);
  bool Build(Window* window);
  void EliminateForOnce(const Window& window);
  void RootOfPastAlone(const Window& window);
  void HandBack(Window* window);
  void WritePrior(const RootTriangle& past, Window* window) const;
  SolveReport SolveOnce(Window* window, const SolverOptions& options);
  SolveReport SolveWhole(Window* window, const SolverOptions& options);
  SolveReport Align(Window* window, const SolverOptions& options);

  void AppendFront(const Window& window, std::int64_t id);
  bool CatchUp(Window* window);
  bool RedoMovedRecent(Window* window);
  void MoveParameterPoint(const Window& window);

  void StartSweep(const Window& window);
  int SweepSize() const;
  bool Sweep(Window* window, int budget, bool corrects = true);
  bool TakeOver(Window* window);
  bool SweepAll(Window* window);
  bool IsShort() const;
  bool MayCost(double error, const Window& window) const;

  bool SweepHadTurn() const;
  bool Correct(Window* window, const Allowance& allowance, bool all = false);
  bool SolveRoot(Window* window);
  void BackSubstitute(Window* window, bool everything);
  Outcome Follow(Window* window, const Allowance& allowance);
  Outcome SettleRecent(Window* window);
  bool SweepOn(Window* window, const Allowance& allowance);
  Outcome AdvanceSweepToBudget(Window* window, const Allowance& allowance);
  Outcome Iterate(Window* window, int max_iterations, const Allowance& allowance);
  void AskForAlignment(const Window& window);
  int Work() const;
  bool AlignmentFits(const Window& window) const;
  void Refuse(const ParameterVector& eta, bool followed, Window* window);

  void TellRootsOfPast();

  IncrementalOptions options_;
  bool incremental_ = false;  // false: the past is in the window's prior
  ChainPast past_;
  Chain chain_;
  ChainSweep sweep_;
  LinearisationError error_;
  ChainCorrections corrections_;
  ChainSolution solution_;
  ChainAlignment alignment_;
  Eigen::MatrixXd scale_root_;
  ParameterVector recent_at_;  // where recent fronts were evaluated together
  bool have_root_ = false;
  int max_work_ = 0;           // of the solve at work
  int follow_ups_left_ = 0;    // sweeps that may follow one that aligns, until it has settled
  bool is_to_settle_ = false;  // such a sweep is through, its step not taken yet
  SolveReport report_;         // of the solve at work
};

}  // namespace odmc
