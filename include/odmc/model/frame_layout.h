#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "odmc/model/vehicle.h"

namespace odmc {

/// Whose numbers the motors of a frame have.
enum class Autopilot { kPx4, kArduPilot, kBetaflight };

/// "px4", "ardupilot", "betaflight".
const char* Name(Autopilot autopilot);

/// Where a motor of a frame sits, and which way it turns.
struct FramePlace {
  std::string name;           ///< "front left", "rear, lower"
  Eigen::Vector3d direction;  ///< of the hub from the origin, in B: horizontally a unit vector; z
                              ///< of coaxial pairs is a tenth above or below
  double spin = 1.0;          ///< as Rotor::spin: +1 clockwise seen from above
};

/// Names of all frames: quad_x, quad_plus, hexa_x, hexa_plus, octo_x, octo_plus, y6.
const std::vector<std::string>& FrameNames();

/// Those of them that have this many rotors.
std::vector<std::string> FramesOf(int num_rotors);

/// A frame's places, in the order of the autopilot's motor numbers.
///
/// Sources: PX4, airframe reference (docs.px4.io, "Airframes Reference") and the geometries it is
/// drawn from, src/lib/mixer/MultirotorMixer/geometries/{quad_x, quad_plus, hex_x, hex_plus,
/// hex_cox, octa_x, octa_plus}.toml. ArduPilot, AP_MotorsMatrix::setup_motors()
/// (libraries/AP_Motors/AP_MotorsMatrix.cpp; ardupilot.org, "Connect ESCs and Motors"): frame types
/// plus and X; for y6 its default, Y6A (Y6B has PX4's numbers). Betaflight, mixer_init.c
/// (src/main/flight; betaflight.com, "Mixer"): QUADX, QUADP, HEX6X, HEX6, OCTOFLATX, OCTOFLATP, Y6;
/// spins with yaw_motors_reversed off ("props in").
///
/// PX4 and ArduPilot number quads, hexas and octos alike. Their angles and those here are clockwise
/// from the front, y of B is to the left.
/// @throws std::invalid_argument naming the frames there are
std::vector<FramePlace> FrameLayout(const std::string& frame, Autopilot autopilot);

/// Rotors at a frame's places. @param half_x_m, half_y_m the largest |x| and |y| of a hub [m], > 0
/// (of coaxial pairs, the mean of both scales z). Spins as the layout's.
std::vector<Rotor> RotorsAt(const std::vector<FramePlace>& places, double half_x_m, double half_y_m,
                            double radius_m);

/// Every pattern of spins that a vehicle with these rotors is built with, as bits (bit j set:
/// rotor j has spin +1): the rotors' own and its mirror image; of coaxial pairs, both ways round.
std::vector<unsigned> UsualSpins(const std::vector<Rotor>& rotors);

/// True if two hubs are above each other: levers do not tell them apart.
bool IsCoaxial(const Rotor& a, const Rotor& b);

}  // namespace odmc
