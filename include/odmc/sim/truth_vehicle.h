#pragma once

#include "odmc/model/dynamic_model.h"

namespace odmc {

/// True values to simulate a vehicle with when nobody gives any, in the order of
/// DynamicModel::parameters(). What the vehicle file states holds, and so does the prior value of a
/// frozen parameter. For the rest, the nominal vehicle of model.md section 8 is scaled: thrust with
/// weight and squared propeller radius, drag and HVT with mass, damping with inertia, the centre of
/// gravity with the arm. Parameters it has no number for take their prior value.
ModelValues DefaultTruth(const DynamicModel& model);

}  // namespace odmc
