#pragma once

#include "odmc/window/chain_front.h"
#include "odmc/window/chain_past.h"
#include "odmc/window/root_triangle.h"
#include "odmc/window/window.h"

namespace odmc {

/// The window's prior becomes the message to the oldest front and what is past.
/// @param oldest null: the window has no keyframe
void ReadChainPrior(const Window& window, ChainFront* oldest, ChainPast* past);

/// The other way round; offsets are put to the present estimate and the anchor's column is folded
/// into them.
void WriteChainPrior(const RootTriangle& past, const ChainFront* oldest, Window* window);

}  // namespace odmc
