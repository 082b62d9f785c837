#include "odmc/ros/estimator_setup.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <filesystem>
#include <stdexcept>

#include "odmc/actuator/rotor_source.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/model/effect.h"
#include "odmc/model/plausibility.h"
#include "odmc/ros/node_options.h"
#include "odmc/ros/urdf_vehicle.h"
#include "odmc/sensing/twist_frame.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

bool FileHasKey(const std::string& file, const std::string& key) {
  return YAML::LoadFile(file)[key].IsDefined();
}

Vehicle ReadVehicle(const EstimatorNodeOptions& options, const ros::NodeHandle& node) {
  if (!options.vehicle_file.empty()) return LoadVehicle(options.vehicle_file);
  std::string urdf, name;
  if (!node.searchParam("robot_description", name) || !node.getParam(name, urdf)) {
    throw std::invalid_argument(
        "no vehicle: set the parameter vehicle_file to a vehicle YAML or give a URDF in "
        "robot_description");
  }
  return VehicleFromUrdf(urdf, options.rotor_radius_m);
}

/// Puts the actuator of the parameter in place of the vehicle file's and sees whether the node can
/// use what there is.
void SettleActuator(const EstimatorNodeOptions& options, Vehicle* vehicle) {
  const std::string& file = options.actuator;
  const bool from_commands = options.rotor_speed_from == "commands";
  std::string source = "the vehicle file's actuator: ";
  try {
    if (!file.empty()) {
      source = "parameter actuator: ";
      vehicle->actuator = LoadActuator(file);
      source += file + ": ";
    }
    // Steady readings can't watch a sensor; what the vehicle file knows beyond that still counts.
    const bool is_used =
        from_commands || !file.empty() || (vehicle->actuator && vehicle->actuator->knows_dynamics);
    if (vehicle->actuator && is_used) {
      RotorSource(*vehicle->actuator, vehicle->num_rotors(), from_commands);
    }
  } catch (const std::invalid_argument& e) {
    throw std::invalid_argument(source + e.what());
  }
  if (from_commands && !vehicle->actuator) {
    throw std::invalid_argument(
        "parameter rotor_speed_from is commands, but the actuator is not known: set the parameter "
        "actuator to an actuator.yaml of calibrate_actuator, or name it in the vehicle file");
  }
}

}  // namespace

bool EstimatorNodeOptions::IsValid(std::string* error) const {
  if (!TwistFrameStated(twist_frame)) {
    return Invalid(error, "twist_frame must be auto, body or world, not '" + twist_frame + "'");
  }
  if (rotor_speed_from != "sensor" && rotor_speed_from != "commands") {
    return Invalid(error,
                   "rotor_speed_from must be sensor or commands, not '" + rotor_speed_from + "'");
  }
  if (on_time_reset != "restart" && on_time_reset != "stop") {
    return Invalid(error, "on_time_reset must be restart or stop, not '" + on_time_reset + "'");
  }
  if (!(publish_rate_hz > 0.0)) return Invalid(error, "publish_rate_hz must be positive");
  if (!(display_rate_hz > 0.0)) return Invalid(error, "display_rate_hz must be positive");
  if (!(path_length_s > 0.0)) return Invalid(error, "path_length_s must be positive");
  if (body_tf != "never" && body_tf != "auto" && body_tf != "always") {
    return Invalid(error, "body_tf must be never, auto or always, not '" + body_tf + "'");
  }
  if (queue_size < 100) return Invalid(error, "queue_size must be at least 100");
  if (rotor_radius_m < 0.0) return Invalid(error, "rotor_radius_m must not be negative");
  if (body_frame.empty()) return Invalid(error, "body_frame must not be empty");
  for (const std::string& effect : add_effects) {
    if (!EffectRegistry::Default().Has(effect)) {
      return Invalid(error, "add_effects: there is no effect '" + effect + "' (see list_effects)");
    }
  }
  return residual_watch.IsValid(error) && acceptance.IsValid(error);
}

EstimatorNodeSetup ReadEstimatorNodeSetup(const ros::NodeHandle& public_node,
                                          const ros::NodeHandle& private_node) {
  EstimatorNodeSetup setup;
  ReadNodeOptions(private_node, &EstimatorNodeOptions::config, &setup.options, &setup.estimator);
  std::string error;
  if (!setup.options.IsValid(&error) || !setup.estimator.IsValid(&error)) {
    throw std::invalid_argument(private_node.getNamespace() + ": " + error);
  }
  setup.vehicle = ReadVehicle(setup.options, public_node);
  setup.options.Check(setup.vehicle.num_rotors());
  const std::string doubt = InertiaDoubt(setup.vehicle);
  if (!doubt.empty()) setup.warnings.push_back(doubt);
  setup.odometry_mount_known =
      !setup.options.vehicle_file.empty() && FileHasKey(setup.options.vehicle_file, "odometry");
  setup.file_parameters = setup.vehicle.parameters;
  if (!setup.options.parameters_file.empty()) {
    const ParameterSet set = LoadParameters(setup.options.parameters_file);
    const auto accepted = set.provenance.find("accepted");
    if (accepted != set.provenance.end() && accepted->second != "true") {
      setup.warnings.push_back(setup.options.parameters_file +
                               ": was not accepted when it was saved; the estimate starts from it");
    }
    ApplyParameters(set, &setup.vehicle);
    const bool is_fleet = std::any_of(set.parameters.begin(), set.parameters.end(),
                                      [](const ParameterEstimate& p) { return p.scatter > 0.0; });
    if (is_fleet) setup.history = set;
    const auto known = setup.vehicle.parameters.find("thrust.k_f");
    if (known != setup.vehicle.parameters.end()) {
      setup.file_parameters.insert_or_assign(known->first, known->second);
    }
  }
  SettleActuator(setup.options, &setup.vehicle);
  if (!setup.options.output_dir.empty()) {
    std::error_code failed;
    std::filesystem::create_directories(setup.options.output_dir, failed);
    if (failed) {
      throw std::invalid_argument("output_dir " + setup.options.output_dir +
                                  " cannot be made: " + failed.message());
    }
  }
  return setup;
}

RotorIntake RotorIntakeOf(const EstimatorNodeSetup& setup) {
  const bool from_commands = setup.options.rotor_speed_from == "commands";
  return {from_commands, from_commands && setup.vehicle.actuator->uses_voltage};
}

}  // namespace odmc
