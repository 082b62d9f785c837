#pragma once

#include "odmc/analysis/torque_bands.h"

namespace odmc {

/// Joins what bands say of one quantity: the mean over all ranges of bands that agree, and whose
/// values do not fall with frequency as answers to disturbances would, by how likely each makes
/// what is seen. Its sigma knows that the range is not known.
void JoinBands(BandedQuantity* quantity);

}  // namespace odmc
