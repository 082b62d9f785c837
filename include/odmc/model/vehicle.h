#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/math/rotor_vector.h"
#include "odmc/model/motor.h"

namespace odmc {

/// One rotor of the vehicle file.
struct Rotor {
  Eigen::Vector3d p_BP = Eigen::Vector3d::Zero();  ///< hub, from Bo, in B [m]
  double spin = 1.0;      ///< sign of the reaction torque on the airframe along +z of B: +1 for a
                          ///< rotor turning clockwise seen from above, -1 counter-clockwise
  double radius_m = 0.0;  ///< propeller radius [m], > 0
};

/// Where a sensor sits: pose of the sensor's own frame S in the body frame B.
struct SensorMount {
  Eigen::Vector3d p_BS = Eigen::Vector3d::Zero();            ///< from Bo, in B [m]
  Eigen::Quaterniond q_BS = Eigen::Quaterniond::Identity();  ///< takes vectors from S to B
  bool estimate = false;                                     ///< free the 6 extrinsics
  /// Standard deviation of p_BS [m] and of q_BS [rad], each axis, where the mount was measured.
  /// What is not measured is asked about by attribution.
  std::optional<double> p_BS_sigma_m, q_BS_sigma_rad;
};

/// What a vehicle file or a parameter file says about one parameter.
struct ParameterSetting {
  std::optional<double> value;    ///< start value and centre of the prior, in the parameter's unit
  std::optional<double> sigma;    ///< sigma of the prior, in the parameter's unit
  std::optional<bool> estimated;  ///< false: frozen at its value
};

/// A vehicle as its YAML file describes it: what is weighed, measured or known beforehand.
struct Vehicle {
  std::string name = "generic";
  double mass_kg = 1.0;
  double gravity_m_s2 = 9.81;
  Eigen::Vector3d inertia_kg_m2 = Eigen::Vector3d(0.005, 0.005, 0.009);  ///< nominal, about Bcm
  std::vector<Rotor> rotors;
  SensorMount odometry;
  std::optional<SensorMount> imu;
  std::vector<std::string> effects;                    ///< names of the model's effects
  std::map<std::string, ParameterSetting> parameters;  ///< by full name, as "thrust.k_f"
  std::optional<Actuator> actuator;  ///< motors and ESCs, where they are calibrated

  int num_rotors() const { return static_cast<int>(rotors.size()); }

  /// Mean horizontal distance of the hubs from Bo [m]: the length that scales torques.
  double ArmLength() const;

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

}  // namespace odmc
