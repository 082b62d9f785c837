#pragma once

#include "odmc/window/chain.h"
#include "odmc/window/chain_front.h"
#include "odmc/window/chain_past.h"
#include "odmc/window/root_triangle.h"
#include "odmc/window/window.h"

namespace odmc {

/// A front for every keyframe, none eliminated, at its present state, but for the oldest at that of
/// the window's prior, which becomes its message and what is past.
void ReadChain(const Window& window, Chain* chain, ChainPast* past);

/// The same of the prior alone, linearized where the oldest front is.
/// @param oldest null: the window has no keyframe
void ReadChainPrior(const Window& window, ChainFront* oldest, ChainPast* past);

/// The other way round; offsets are put to the present estimate and the anchor's column is folded
/// into them.
void WriteChainPrior(const RootTriangle& past, const ChainFront* oldest, Window* window);

}  // namespace odmc
