// A steady update does not touch the heap: samples, preintegration, factors, solve, covariance,
// marginalization, blocks of statistics, new biases.
#include <gtest/gtest.h>

#include <cstdio>

#include "odmc/estimator/estimator.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/allocation_counter.h"
#include "support/flight_feed.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using testing_support::Drain;
using testing_support::FlightFeed;

struct Counted {
  int updates = 0, with_allocations = 0;
  long allocations = 0;
};

/// Flies `duration_s` and counts from `from_s` on.
Counted CountUpdates(double duration_s, double from_s, bool imu, double walk_rate) {
  const DynamicModel model(NominalVehicle(), NominalVehicle().effects);
  SimulationOptions simulation;
  simulation.duration_s = duration_s;
  simulation.log_rate_hz = 200.0;
  SimulationNoise noise;
  noise.imu = imu;
  const FlightLog log = Simulate(model, DefaultTruth(model), simulation, noise).log;
  EstimatorOptions options = OfflineOptions();
  options.k_f_walk_rate = walk_rate;
  Estimator estimator(&model, options, true);
  Counted counted;
  for (FlightFeed feed(log); !feed.AtEnd();) {
    const AllocationCounter counter;
    bool updated = false;
    double time_s = 0.0;
    feed.Next(&estimator);
    Drain(&estimator, [&](const Snapshot& snapshot) {
      updated = true;
      time_s = snapshot.time_s;
    });
    if (!updated || time_s < from_s) continue;
    ++counted.updates;
    counted.allocations += counter.count();
    if (counter.count() > 0) ++counted.with_allocations;
  }
  return counted;
}

TEST(UpdateAllocations, AreNoneInASteadyUpdate) {
  struct Case {
    bool imu;
    double walk_rate;
  };
  for (const Case& c : {Case{false, 0.0}, Case{true, 0.0}, Case{true, 2e-3}}) {
    const Counted counted = CountUpdates(14.0, 6.0, c.imu, c.walk_rate);
    std::printf("%d updates, %d with allocations (%ld)\n", counted.updates,
                counted.with_allocations, counted.allocations);
    ASSERT_GT(counted.updates, 700);
    EXPECT_EQ(counted.allocations, 0);
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
