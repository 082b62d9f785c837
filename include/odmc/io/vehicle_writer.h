#pragma once

#include <map>
#include <string>
#include <vector>

#include "odmc/model/vehicle.h"

namespace odmc {

/// What is said beside the numbers of a vehicle file.
struct VehicleComments {
  std::vector<std::string> head;           ///< at the top, a paragraph each
  std::map<std::string, std::string> key;  ///< before a key: "mass_kg", "rotors", "thrust.k_f"
  std::vector<std::string> rotor;          ///< after the line of each rotor; may be empty
};

/// A vehicle file as LoadVehicle() reads it: name, mass, gravity, inertia, rotors, mounts, effects
/// and the parameters that have settings; the actuator's file is not among them. Numbers are
/// rounded to six digits and have a decimal point, so that YAML 1.1 reads them, too.
std::string VehicleText(const Vehicle& vehicle, const VehicleComments& comments = {});

}  // namespace odmc
