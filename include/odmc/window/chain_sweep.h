#pragma once

#include <cstdint>
#include <functional>

#include "odmc/window/chain.h"
#include "odmc/window/root_triangle.h"
#include "odmc/window/window.h"

namespace odmc {

/// Eliminates the chain's older fronts anew, oldest first, beside the chain in use, into a root of
/// its own; having caught up it takes the chain's place.
class ChainSweep {
 public:
  bool active = false;
  bool wanted = false;         ///< is to start when the update is through
  bool urgent = false;         ///< old factors were touched: at once, as far as time allows
  bool reweighs = false;       ///< it brings weights that the chain in use does not have
  bool has_reweighed = false;  ///< in this solve: what it took up first is out of date
  RootTriangle past;           ///< while it reweighs: as the chain in use has it
  std::int64_t next = 0;       ///< front to eliminate next
  RootTriangle root;
  ParameterVector begun_at;  ///< where parameters were when it began

  void Forget() { active = wanted = urgent = reweighs = false; }
  /// From the past and the priors, at the oldest front.
  void Start(const RootTriangle& from, std::int64_t oldest, const Window& window);
  /// It is to give the factors of every keyframe it takes their new weights.
  void Reweigh(std::function<void(Keyframe*)> weigh);
  /// Weighs at once what it has not taken yet.
  void FinishReweighing(Window* window) const;
  /// Eliminates its next front. @returns false if a factor cannot be evaluated
  bool EliminateNext(Chain* chain, Window* window);

 private:
  std::function<void(Keyframe*)> weigh_;
  RowBlock triangle_;
};

}  // namespace odmc
