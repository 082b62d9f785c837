// A live run repeats offline: when samples arrive says nothing, only their stamps do.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <variant>
#include <vector>

#include "odmc/analysis/replay.h"
#include "odmc/estimator/estimator.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/flight_feed.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

struct Arrival {
  double time_s;
  std::variant<OdometrySample, ImuSample, RotorSample> sample;
};

/// The delay of one stream: a constant and a part that changes from burst to burst.
struct Delay {
  double mean_s, burst_s;
};

/// Samples of one stream stay in order, as on any connection.
template <typename Sample>
void Deliver(const std::vector<Sample>& samples, const Delay& delay, std::mt19937* random,
             std::vector<Arrival>* arrivals) {
  std::uniform_real_distribution<double> burst(0.0, delay.burst_s);
  double newest_s = 0.0;
  for (const Sample& sample : samples) {
    newest_s = std::max(newest_s, ToSeconds(sample.stamp) + delay.mean_s + burst(*random));
    arrivals->push_back({newest_s, sample});
  }
}

class Arrivals : public ::testing::Test {
 protected:
  Arrivals() : model_(NominalVehicle(), NominalVehicle().effects) {
    SimulationOptions simulation;
    simulation.duration_s = 12.0;
    simulation.log_rate_hz = 200.0;
    SimulationNoise noise;
    noise.imu = true;
    log_ = Simulate(model_, DefaultTruth(model_), simulation, noise).log;
    options_.keyframe_rate_hz = 50.0;
  }

  std::vector<Eigen::VectorXd> Fly(const Delay& odometry, const Delay& imu, const Delay& rotors) {
    std::mt19937 random(7);
    std::vector<Arrival> arrivals;
    Deliver(log_.odometry, odometry, &random, &arrivals);
    Deliver(log_.imu, imu, &random, &arrivals);
    Deliver(log_.rotors, rotors, &random, &arrivals);
    std::stable_sort(arrivals.begin(), arrivals.end(),
                     [](const Arrival& a, const Arrival& b) { return a.time_s < b.time_s; });
    Estimator estimator(&model_, options_, true);
    std::vector<Eigen::VectorXd> estimates;
    const auto keep = [&](const Snapshot& snapshot) { estimates.push_back(snapshot.values); };
    for (const Arrival& arrival : arrivals) {
      std::visit([&](const auto& sample) { estimator.Add(sample); }, arrival.sample);
      testing_support::Drain(&estimator, keep);
    }
    estimator.Finish();
    testing_support::Drain(&estimator, keep);
    return estimates;
  }

  void ExpectAsReplayed(const std::vector<Eigen::VectorXd>& live) {
    Estimator estimator(&model_, options_, true);
    const ReplayResult replay = Replay(log_, &estimator);
    ASSERT_GT(replay.history.size(), 400u);
    ASSERT_EQ(live.size(), replay.history.size());
    for (size_t i = 0; i < live.size(); ++i) {
      ASSERT_EQ(live[i], replay.history[i].values) << "update " << i;
    }
  }

  DynamicModel model_;
  FlightLog log_;
  EstimatorOptions options_ = OfflineOptions();
};

TEST_F(Arrivals, AsStampedIsTheReplay) {
  ExpectAsReplayed(Fly({0.0, 0.0}, {0.0, 0.0}, {0.0, 0.0}));
}

TEST_F(Arrivals, LateOdometryChangesNothing) {
  ExpectAsReplayed(Fly({0.08, 0.02}, {0.001, 0.002}, {0.003, 0.004}));
}

TEST_F(Arrivals, LateRotorSpeedsChangeNothing) {
  ExpectAsReplayed(Fly({0.005, 0.003}, {0.001, 0.002}, {0.15, 0.05}));
}

TEST_F(Arrivals, LateImuChangesNothing) {
  ExpectAsReplayed(Fly({0.005, 0.02}, {0.1, 0.05}, {0.003, 0.02}));
}

}  // namespace
}  // namespace test
}  // namespace odmc
