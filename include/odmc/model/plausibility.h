#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"

namespace odmc {

/// Sentences about values that no vehicle can have: not a number, a wrong sign by more than one
/// sigma, an inertia that no body has or far from nominal, a centre of gravity outside the rotors,
/// gravity far off vertical. Estimator and controller both ask.
/// @param values, sigma num_parameters()×1 each; sigma 0 where frozen or unknown
std::vector<std::string> UnphysicalValues(const DynamicModel& model, const ModelValues& values,
                                          const Eigen::VectorXd& sigma);

/// Moments of inertia a body may have [kg m²].
struct InertiaBounds {
  Eigen::Vector3d least, most;
};

/// From the geometry: all mass lies within twice the reach of the rotors, and the motors, 1 % of it
/// at least, are at their places.
InertiaBounds InertiaBoundsOf(const Vehicle& vehicle);

/// What to say of a nominal inertia that breaks the triangle inequality of a rigid body (flat
/// frames come close to it, rounded or guessed numbers beyond); empty where it holds. It is used
/// all the same: Vehicle::IsValid() refuses what is nonsense.
std::string InertiaDoubt(const Vehicle& vehicle);

/// What is wrong with one parameter of a file.
struct SettingDoubt {
  std::string key;       ///< value or sigma; empty where nothing is wrong
  std::string sentence;  ///< "1e+300 is implausible; ..."
};

/// Judges start value and sigma of a prior against what any vehicle of this geometry could have.
/// @param spec the parameter's own, before `setting` had its say
SettingDoubt DoubtOf(const std::string& full_name, const ParameterSpec& spec,
                     const ParameterSetting& setting, const Vehicle& vehicle);

/// What to say of a thrust coefficient that is more than three times, or less than a third of, what
/// it started from: then a unit or the mass is wrong, not the vehicle file by a little. Empty if
/// all is well.
std::string ThrustDoubt(const DynamicModel& model, const ModelValues& values);

}  // namespace odmc
