#pragma once

#include <cstdint>
#include <vector>

#include "odmc/math/ring.h"
#include "odmc/window/chain.h"
#include "odmc/window/chain_sweep.h"
#include "odmc/window/incremental_options.h"
#include "odmc/window/linearisation_error.h"
#include "odmc/window/window.h"

namespace odmc {

/// Fronts that are corrected together (ChainFront::Correct).
struct ChainSegment {
  std::int64_t first = 0;
  ParameterVector at;        ///< parameters when they were evaluated
  double sensitivity = 0.0;  ///< error [sigmas] they make where parameters are a sigma from there
  double expected = 0.0;     ///< error they make now [sigmas]
  std::int64_t turn = 0;     ///< when they were evaluated
};

/// Brings the gradients of older fronts to the present estimate, a segment at a time, and tells all
/// roots what that finds: between sweeps, steps end where the true gradient vanishes.
class ChainCorrections {
 public:
  /// @param options, chain, sweep, error must outlive it
  ChainCorrections(const IncrementalOptions* options, Chain* chain, ChainSweep* sweep,
                   const LinearisationError* error)
      : options_(options), chain_(chain), sweep_(sweep), error_(error) {}

  /// The chain has `num_pivots` shared variables.
  void Reset(int num_pivots) { found_.assign(static_cast<size_t>(num_pivots), 0.0); }
  void Clear() { segments_.clear(); }
  /// The chain has got front `id`.
  void Append(const Window& window, std::int64_t id);
  /// The chain's oldest front is gone.
  void DropOldest();
  /// The sweep has passed all fronts before `next`.
  void NoteSwept(std::int64_t next);

  int corrected = 0;  ///< fronts; counts on

  size_t size() const { return segments_.size(); }
  /// Corrections so far; segments whose turn is later have been done since.
  std::int64_t turn() const { return turn_; }
  /// Errors that segments make because parameters have moved since they were evaluated. @returns
  /// all together [sigmas]
  double ExpectErrors(const Window& window);
  /// Of the segments not done since turn `since`, the one whose turn is next, or the one that needs
  /// it most; null: none.
  ChainSegment* Choose(std::int64_t since, bool in_turn);

  /// Evaluates a segment's older fronts; the roots take what that changes.
  void Correct(const Window& window, ChainSegment* segment);
  /// The same for the fronts before `end` that the sweep is about to take up: the chain in use goes
  /// on with these until the sweep is through.
  void CorrectBeforeSweep(const Window& window, std::int64_t end);
  /// What waits at the oldest front goes on to the next, which is to be the oldest.
  void PassOnFromOldest(const Window& window);

 private:
  void GiveFoundTo(RootTriangle* root);
  double GiveFoundToRoots(const Window& window, std::int64_t end);

  const IncrementalOptions* options_;
  Chain* chain_;
  ChainSweep* sweep_;
  const LinearisationError* error_;
  Ring<ChainSegment> segments_;  // all fronts, oldest first
  std::int64_t turn_ = 0;
  std::vector<double> found_, given_;  // gradients by shared variables
};

}  // namespace odmc
