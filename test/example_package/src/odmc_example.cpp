// Calibrates a recorded flight with the libraries of odmc:  odmc_example FLIGHT VEHICLE.yaml
// [headers]
#include <odmc/analysis/calibration.h>
#include <odmc/estimator/options.h>
#include <odmc/io/flight_reader.h>
#include <odmc/io/vehicle_yaml.h>
#include <odmc/model/dynamic_model.h>
// [end headers]

#include <cstdio>
#include <exception>

namespace {

void Run(const char* flight_file, const char* vehicle_file) {
  // [calibrate]
  const odmc::Vehicle vehicle = odmc::LoadVehicle(vehicle_file);
  const odmc::DynamicModel model(vehicle, vehicle.effects);

  odmc::FlightReadOptions reading;
  reading.num_rotors = static_cast<int>(vehicle.rotors.size());
  const odmc::FlightLog log = odmc::FlightReaders::Core().Read(flight_file, reading);

  const odmc::Calibration found =
      odmc::Calibrate(log, log, vehicle, model, odmc::EstimatorOptions{});
  for (const odmc::ParameterEstimate& parameter : found.parameters.parameters) {
    std::printf("%-24s %12.5g +- %.2g %s%s\n", parameter.full_name.c_str(), parameter.value,
                parameter.sigma, parameter.unit.c_str(),
                parameter.observable ? "" : " (not shown by this flight)");
  }
  // [end calibrate]
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: odmc_example FLIGHT VEHICLE.yaml\n");
    return 2;
  }
  try {
    Run(argv[1], argv[2]);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "error: %s\n", e.what());
    return 1;
  }
  return 0;
}
