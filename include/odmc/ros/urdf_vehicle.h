#pragma once

#include <string>

#include "odmc/model/vehicle.h"

namespace odmc {

/// Makes a vehicle of a URDF (the parameter robot_description). The convention:
///  - the root link is the body frame B: x forward, y left, z up;
///  - mass, centre of gravity and nominal inertia are those of all links together, joints at zero;
///  - rotors are the joints rotor_N_joint, rotor_N, propeller_N(_joint) or motor_N(_joint), in the
///    order of N, which is that of the measured speeds; hub position is the joint's origin;
///  - a rotor turns positively about its joint's axis: axis 0 0 1 is counter-clockwise seen from
///    above, 0 0 -1 clockwise;
///  - the propeller's radius is the largest horizontal half size of the child link's cylinder,
///  sphere
///    or box (visual or collision);
///  - the link imu_link, if there is one, is the IMU's frame.
/// The model is the default one of vehicle files.
/// @param radius_m used for rotors without a shape; 0: that is an error
/// @throws std::invalid_argument with a sentence for the user
Vehicle VehicleFromUrdf(const std::string& urdf, double radius_m = 0.0);

}  // namespace odmc
