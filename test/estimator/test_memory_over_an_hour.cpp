// Memory does not grow with the flight: one minute of it, flown sixty times.
#include <gtest/gtest.h>
#include <malloc.h>

#include <cstdio>

#include "odmc/estimator/estimator.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/flight_feed.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using testing_support::Drain;
using testing_support::FlightFeed;

constexpr int kMinutes = 60;
constexpr double kKeyframeRate_hz = 25.0;

double HeapInUse_KiB() { return static_cast<double>(mallinfo2().uordblks) / 1024.0; }

void Fly(const FlightLog& log, Stamp later, Estimator* estimator, int* updates) {
  for (FlightFeed feed(log); !feed.AtEnd();) {
    feed.Next([later, estimator](auto sample) {
      sample.stamp += later;
      estimator->Add(sample);
    });
    Drain(estimator, [updates](const Snapshot&) { ++*updates; });
  }
}

TEST(Memory, IsFlatOverAnHourOfFlight) {
  const DynamicModel model(NominalVehicle(), NominalVehicle().effects);
  SimulationOptions simulation;
  simulation.duration_s = 60.0;
  simulation.log_rate_hz = 100.0;
  SimulationNoise noise;
  noise.imu = true;
  const FlightLog log = Simulate(model, DefaultTruth(model), simulation, noise).log;
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = kKeyframeRate_hz;
  Estimator estimator(&model, options, true);
  const Stamp minute = log.odometry.back().stamp - log.odometry.front().stamp + FromSeconds(0.01);
  int updates = 0;
  double after_ten = 0.0;
  for (int i = 0; i < kMinutes; ++i) {
    Fly(log, i * minute, &estimator, &updates);
    if (i == 9) after_ten = HeapInUse_KiB();
  }
  const double in_the_end = HeapInUse_KiB();
  std::printf("%d updates: heap in use %.0f KiB after 10 min, %.0f KiB after %d min\n", updates,
              after_ten, in_the_end, kMinutes);
  EXPECT_GT(updates, 0.9 * kMinutes * 60.0 * kKeyframeRate_hz);
  EXPECT_LT(in_the_end - after_ten, 4.0);
}

}  // namespace
}  // namespace test
}  // namespace odmc
