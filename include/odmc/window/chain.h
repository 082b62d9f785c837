#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "odmc/math/ring.h"
#include "odmc/window/chain_front.h"
#include "odmc/window/incremental_options.h"
#include "odmc/window/marginalization.h"
#include "odmc/window/root_triangle.h"
#include "odmc/window/window.h"

namespace odmc {

/// The chain of fronts in use: every keyframe's, oldest first, eliminated up to the newest, whose
/// triangle and root hold what all say. The newest can be eliminated anew, from checkpoints.
class Chain {
 public:
  /// What is known before a keyframe is eliminated.
  struct Checkpoint {
    std::int64_t id = -1;
    RootTriangle root;  ///< before the keyframe's own factors
  };

  /// @param options must outlive it
  explicit Chain(const IncrementalOptions* options) : options_(options) {
    fronts.Reserve(static_cast<size_t>(options->room_for_keyframes));
  }

  Ring<ChainFront> fronts;
  RowBlock triangle;  ///< of the newest state
  RootTriangle root;  ///< of all, parameters' priors included
  Ring<Checkpoint> checkpoints;
  ParameterVector point;  ///< of linearization, of the parameters, at present
  int point_version = 0;
  int eliminated = 0;  ///< fronts; counts on
  FrontScratch scratch;

  ChainFront& front(std::int64_t id) { return fronts[static_cast<size_t>(id - fronts.front().id)]; }
  std::int64_t oldest() const { return fronts.front().id; }
  std::int64_t newest() const { return fronts.back().id; }
  /// Where the newest few begin.
  std::int64_t OldestRecent() const;

  void Clear();
  /// The oldest front goes with its keyframe.
  void DropOldest();

  /// Parameters are linearized at `eta` from now on.
  void MoveParameterPoint(const ParameterVector& eta) {
    point = eta;
    ++point_version;
  }
  /// True if a state has left its point of linearization.
  bool HasMoved(const Window& window, const ChainFront& front) const;
  /// Moves the points of states that have left theirs, from front `from` on. Their fronts and the
  /// one before must be eliminated anew. @returns the first of them, -1: none
  std::int64_t MovePoints(const Window& window, std::int64_t from);

  /// Eliminates front `id`, the last one so far, given triangle and root; enters the next.
  /// @returns false if a factor cannot be evaluated
  bool Advance(const Window& window, std::int64_t id);
  /// Eliminates the chain anew from front `from` on, which has a checkpoint. @returns the same
  bool Redo(const Window& window, std::int64_t from);
  /// Eliminates all fronts, given the root before them. @returns the same
  bool EliminateAll(const Window& window, const RootTriangle& before);
  /// Makes `before`, the root before front `id`, the only checkpoint.
  void RestartFrom(std::int64_t id, const RootTriangle& before);

  /// What the oldest keyframe's factors say at the present estimate, by their linearizations.
  void ObserveOldest(const Window& window, LeavingFactors* leaving) const;

  using StateMatrix = Eigen::Matrix<double, kStateTangentSize, kStateTangentSize>;
  /// Covariance of the newest state's tangent. @returns false if a direction of it is not known
  bool NewestCovariance(StateMatrix* covariance);

 private:
  const IncrementalOptions* options_;
};

}  // namespace odmc
