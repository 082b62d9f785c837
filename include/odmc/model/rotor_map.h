#pragma once

#include <Eigen/Core>

#include "odmc/model/dynamic_model.h"

namespace odmc {

/// What each rotor's squared speed adds to f_z [N] and tau_x, tau_y, tau_z about Bcm [N m], in B
/// (4×n): the geometry of allocation.
using RotorMap = Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, kMaxRotors>;

/// The map of `model` at rest in still air, high above the ground; taken from the model itself, so
/// that every effect which acts on a steady rotor is in it.
/// @param properties of the body at `values`; its centre of mass is what torques are about
RotorMap RotorMapAtRest(const DynamicModel& model, const ModelValues& values,
                        const BodyProperties& properties);

}  // namespace odmc
