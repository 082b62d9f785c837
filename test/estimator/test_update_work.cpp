// No update takes longer than its keyframe's period, from the first one on: in work, which does not
// depend on the machine (SolveReport::work, keyframes eliminated once).
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <string>

#include "odmc/estimator/estimator.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/flight_feed.h"
#include "support/recorded_data.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using testing_support::Drain;
using testing_support::FlightFeed;

constexpr double kEliminationSeconds =
    12e-6;  // of a keyframe with an IMU, on the machine of docs/results.md

/// The flight at a keyframe rate; nothing is stopped by the clock.
void ExpectUpdatesWithinTheirPeriods(const FlightLog& log, const DynamicModel& model,
                                     double keyframe_rate_hz) {
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = keyframe_rate_hz;
  Estimator estimator(&model, options, true);
  const int bound = static_cast<int>(1.0 / (keyframe_rate_hz * kEliminationSeconds));
  int updates = 0, most = 0, longest_window = 0;
  for (FlightFeed feed(log); !feed.AtEnd();) {
    feed.Next(&estimator);
    Drain(&estimator, [&](const Snapshot& snapshot) {
      ++updates;
      most = std::max(most, snapshot.solve.work);
      longest_window = std::max(longest_window, snapshot.timing.states);
      EXPECT_GT(snapshot.solve.work, 0) << snapshot.time_s;
      EXPECT_LE(snapshot.solve.work, bound)
          << snapshot.time_s << " s, " << snapshot.timing.states << " states";
    });
  }
  std::printf("%d updates of up to %d of %d keyframes' work\n", updates, most, bound);
  // All of the start was in the window, and sweeps over all of it were asked for.
  EXPECT_GT(longest_window, 2.9 * keyframe_rate_hz);
  EXPECT_GT(most, bound / 4);
}

class UpdateWork : public testing::TestWithParam<double> {};

TEST_P(UpdateWork, OfAFlightFromWrongStartsIsBoundedFromTheFirstUpdateOn) {
  Vehicle vehicle = NominalVehicle();
  const DynamicModel truth(vehicle, vehicle.effects);
  for (const auto& [name, factor] :
       {std::pair("thrust.k_f", 1.4), std::pair("inertia.x", 0.6), std::pair("inertia.y", 1.6)}) {
    auto& p = vehicle.parameters[name];
    p.value = truth.parameters()[truth.IndexOf(name)].spec.prior_value * factor;
    p.sigma = 0.6 * *p.value;
    p.estimated = true;
  }
  SimulationOptions simulation;
  simulation.trajectory = "aggressive";
  simulation.duration_s = 5.0;
  SimulationNoise noise;
  noise.imu = true;
  const FlightLog log = Simulate(truth, DefaultTruth(truth), simulation, noise).log;
  ExpectUpdatesWithinTheirPeriods(log, DynamicModel(vehicle, vehicle.effects), GetParam());
}

TEST_P(UpdateWork, OfTheNeuroBemFlightIsBoundedFromTheFirstUpdateOn) {
  const std::string flight = RecordedFile("neurobem/test1_first18s.csv");
  if (flight.empty()) GTEST_SKIP() << "no recorded data";
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/neurobem.yaml");
  const FlightLog log = ReadFlightCsv(flight, vehicle.num_rotors(), PoseSource::kEkf);
  ExpectUpdatesWithinTheirPeriods(log, DynamicModel(vehicle, vehicle.effects), GetParam());
}

INSTANTIATE_TEST_SUITE_P(KeyframeRates, UpdateWork, testing::Values(100.0, 400.0),
                         [](const testing::TestParamInfo<double>& rate) {
                           return std::to_string(static_cast<int>(rate.param)) + "Hz";
                         });

}  // namespace
}  // namespace test
}  // namespace odmc
