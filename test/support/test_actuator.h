#pragma once

#include "odmc/io/actuator_yaml.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {

/// The made-up actuator of the template vehicle.
inline Actuator GenericActuator() {
  return LoadActuator(ODMC_SOURCE_DIR "/config/actuators/generic.yaml");
}

/// What drives the motors is that much stronger than `actuator` says.
inline Actuator WithGain(Actuator actuator, double gain) {
  for (Motor& motor : actuator.motors) {
    motor.esc.root *= gain;
    motor.esc.linear *= gain;
    motor.esc.constant *= gain;
  }
  return actuator;
}

/// NominalVehicle() with it.
inline Vehicle VehicleWithActuator() {
  Vehicle vehicle = NominalVehicle();
  vehicle.actuator = GenericActuator();
  return vehicle;
}

}  // namespace test
}  // namespace odmc
