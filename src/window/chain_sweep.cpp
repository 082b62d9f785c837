#include "odmc/window/chain_sweep.h"

#include <utility>

namespace odmc {

void ChainSweep::Start(const RootTriangle& from, std::int64_t oldest, const Window& window) {
  active = true;
  wanted = false;
  next = oldest;
  root = from;
  root.AbsorbPriors(window.parameter_centre(), window.parameter_sigma());
  begun_at = window.eta();
}

void ChainSweep::Reweigh(std::function<void(Keyframe*)> weigh) {
  reweighs = true;
  weigh_ = std::move(weigh);
}

void ChainSweep::FinishReweighing(Window* window) const {
  if (!reweighs) return;
  for (Keyframe& keyframe : window->keyframes()) {
    if (keyframe.id >= next) weigh_(&keyframe);
  }
}

bool ChainSweep::EliminateNext(Chain* chain, Window* window) {
  if (reweighs) weigh_(&window->keyframe(next));
  ++chain->eliminated;
  ChainFront& f = chain->front(next);
  ChainFront& after = chain->front(next + 1);
  if (chain->HasMoved(*window, after)) after.MovePoint(*window);
  const bool sound =
      f.Linearise(*window, &after, chain->point, chain->point_version, false, &chain->scratch);
  f.AbsorbOwn(&triangle_, &root, &chain->scratch);
  f.Eliminate(triangle_, &root, &after, &chain->scratch);
  ++next;
  return sound;
}

}  // namespace odmc
