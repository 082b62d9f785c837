#pragma once

#include <cstdint>
#include <vector>

#include "odmc/window/chain.h"
#include "odmc/window/incremental_options.h"
#include "odmc/window/linearisation_error.h"
#include "odmc/window/window.h"

namespace odmc {

/// The estimate from an eliminated chain: shared variables from its root, states by
/// back-substitution, the newest first and as far as a change reaches (wildfire).
class ChainSolution {
 public:
  /// @param options, chain, error must outlive it
  ChainSolution(const IncrementalOptions* options, Chain* chain, const LinearisationError* error)
      : options_(options), chain_(chain), error_(error) {}

  /// Starts from the window's parameters. @param stride of the chain's roots
  void Reset(const Window& window, int stride);
  void ForgetPass() { pass_ = -1; }

  /// What to do with a step that is too long for a linear model (IncrementalOptions::largest_step).
  enum class LongSteps {
    kRefused,  ///< nothing
    kDamped,   ///< it ends within that distance from where the chain is linearized
  };
  enum class Step { kWhole, kDamped, kRefused };
  /// Shared variables from the chain's root; the window is left as it was where the step is
  /// refused: too long, or not a number.
  Step SolveRoot(LongSteps long_steps, Window* window);

  /// Shared variables from the chain's root, the anchor as it is, however long the step.
  /// @returns false, the window left as it was, if they are not numbers
  bool SolveRootAtAnchor(Window* window);

  /// The chain is linearized anew: until then, what follows a damped step is held as well.
  void Release() { is_held_ = false; }
  /// States from them: the recent ones, and older ones until they hardly change, or all.
  /// @returns true if an older state has left its point of linearization
  bool BackSubstitute(Window* window, bool everything);

  int back_substituted = 0;  ///< fronts; counts on

 private:
  bool SolveBorder(const RootTriangle& root, int anchor_entry, const Window& window);
  void TakeBorder(Window* window);
  bool IsFar(const ParameterVector& from, const Window& window) const;
  bool Damp(const Window& window);
  double BackSubstitute(std::int64_t id, Window* window);
  bool SharedHaveMoved() const;

  const IncrementalOptions* options_;
  Chain* chain_;
  const LinearisationError* error_;
  std::vector<double> shared_, propagated_;  // solution of the border; at the last full pass
  std::vector<double> border_;               // its candidate
  RootTriangle damped_;
  bool is_held_ = false;
  std::vector<double> substituted_;  // solution of the front at hand
  std::int64_t pass_ = -1;           // a full pass goes on here, -1: done
};

}  // namespace odmc
