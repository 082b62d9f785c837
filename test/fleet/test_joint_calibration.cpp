#include <gtest/gtest.h>

#include <cmath>
#include <optional>

#include "odmc/fleet/joint_calibration.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"

namespace odmc {
namespace {

/// A flight as `simulate --log-rate 100` makes it; its file name is its seed.
InspectedFlight FlyLemniscate(const DynamicModel& model, const std::string& seed) {
  SimulationOptions options;
  options.trajectory = "lemniscate";
  options.seed = std::stoi(seed);
  options.duration_s = 20.0;
  options.log_rate_hz = 100.0;
  InspectedFlight flight;
  flight.log = Simulate(model, DefaultTruth(model), options, SimulationNoise()).log;
  flight.log.file = seed;
  return flight;
}

std::optional<ModelValues> ValuesOf(const FlightLog& log, const DynamicModel& model,
                                    const EstimatorOptions& options) {
  Estimator estimator(&model, options, true);
  const ReplayResult replay = Replay(log, &estimator);
  if (!replay.last) return std::nullopt;
  return replay.last->values;
}

// The pilot answers noise of the rates within 2.5 ms. What the rotors do between two readings is
// rougher than the line through these, and on a calm flight all of inertia rests on it: -14 % and
// -7 % in every flight, so that averages do not help.
TEST(JointCalibration, SigmaHoldsWhatRotorsDoBetweenTheirReadings) {
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/generic.yaml");
  const DynamicModel model(vehicle, vehicle.effects);
  JointCalibrationOptions options;
  options.estimator.keyframe_rate_hz = 50.0;
  options.predict_left_out = false;
  const std::vector<std::string> seeds = {"1", "2", "3"};
  const FleetCalibration fleet = CalibrateFleet(
      seeds, [&](const std::string& seed) { return FlyLemniscate(model, seed); }, vehicle, vehicle,
      options);
  ASSERT_EQ(fleet.used().size(), seeds.size());
  Eigen::VectorXd squares = Eigen::VectorXd::Zero(model.num_parameters());
  for (const std::string& seed : seeds) {
    FlightLog log = FlyLemniscate(model, seed).log;
    const auto all = ValuesOf(log, model, options.estimator);
    std::vector<RotorSample> half;
    for (size_t i = 0; i < log.rotors.size(); i += 2) half.push_back(log.rotors[i]);
    log.rotors = half;
    const auto fewer = ValuesOf(log, model, options.estimator);
    ASSERT_TRUE(all && fewer);
    squares += (*fewer - *all).cwiseAbs2() / static_cast<double>(seeds.size());
  }
  for (const char* name : {"inertia.x", "inertia.y", "viscous_torque.b_y"}) {
    const double change = std::sqrt(squares[model.IndexOf(name)]);
    const ParameterEstimate* p = fleet.parameters.Find(name);
    ASSERT_NE(p, nullptr);
    EXPECT_GE(p->sigma, change) << name;
    EXPECT_LT(p->sigma, 0.5 * std::abs(p->value)) << name << " is known all the same";
  }
}

}  // namespace
}  // namespace odmc
