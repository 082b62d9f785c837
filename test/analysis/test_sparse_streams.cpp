// Telemetry of an ESC at 10 Hz, visual odometry at 20 Hz: what lies between their samples is not
// known. The flight teaches all the same, and sigmas say what it does not.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/inspection/stream_inspection.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

class SparseStreams : public ::testing::Test {
 protected:
  static FlightLog Fly(int seed) {
    const DynamicModel model = Model();
    SimulationOptions options;
    options.trajectory = "aggressive";
    options.duration_s = 30.0;
    options.log_rate_hz = 200.0;
    options.seed = seed;
    return Simulate(model, DefaultTruth(model), options, SimulationNoise()).log;
  }

  static DynamicModel Model() {
    const Vehicle vehicle = NominalVehicle();
    return DynamicModel(vehicle, vehicle.effects);
  }

  template <typename Sample>
  static void KeepOneIn(int n, std::vector<Sample>* samples) {
    std::vector<Sample> kept;
    for (size_t i = 0; i < samples->size(); i += static_cast<size_t>(n)) {
      kept.push_back((*samples)[i]);
    }
    *samples = kept;
  }

  static Calibration CalibrateIt(const FlightLog& log, const StreamInspection& inspection) {
    const DynamicModel model = Model();
    return CalibrateInspected(log, log, inspection, model.vehicle(), model, CalibrateOptions());
  }

  /// Root mean square of the parameters' errors over their sigmas.
  static double ErrorsInSigmas(const ParameterSet& found) {
    const DynamicModel model = Model();
    const ModelValues truth = DefaultTruth(model);
    double sum = 0.0;
    int num = 0;
    for (int k = 0; k < model.num_parameters(); ++k) {
      const ParameterEstimate& p = found.parameters[static_cast<size_t>(k)];
      if (!p.estimated) continue;
      sum += std::pow((p.value - truth[k]) / p.sigma, 2);
      ++num;
    }
    return std::sqrt(sum / num);
  }

  static void ExpectHonest(const FlightLog& log, const std::string& stream, double step_s) {
    const StreamInspection inspection = InspectStreams(log, Model().vehicle());
    const auto is_sparse = [&](const StreamDoubt& doubt) {
      return doubt.stream == stream && std::abs(doubt.sparse_s - step_s) < 1e-6;
    };
    EXPECT_EQ(std::count_if(inspection.doubts.begin(), inspection.doubts.end(), is_sparse), 1);
    const Calibration found = CalibrateIt(log, inspection);
    EXPECT_LT(found.replay.counters.gaps, 5) << stream;
    for (const char* name : {"drag.d_x", "drag.d_y"}) {
      const ParameterEstimate* p = found.parameters.Find(name);
      EXPECT_TRUE(p->observable) << stream << ": " << name;
      EXPECT_LT(p->sigma, 0.05 * std::abs(p->value)) << stream << ": " << name;
    }
    const double honest = ErrorsInSigmas(found.parameters);
    EXPECT_LT(honest, 1.3) << stream;
    StreamInspection blind = inspection;
    blind.doubts.erase(std::remove_if(blind.doubts.begin(), blind.doubts.end(), is_sparse),
                       blind.doubts.end());
    const double without = ErrorsInSigmas(CalibrateIt(log, blind).parameters);
    EXPECT_GT(without, 1.5) << "else there is no need";
    std::printf("%s every %.0f ms: errors are %.2f sigmas RMS, %.2f without the doubt; ",
                stream.c_str(), 1e3 * step_s, honest, without);
    for (const char* name : {"thrust.k_f", "drag.d_x", "inertia.x", "hvt.k_h"}) {
      const ParameterEstimate* p = found.parameters.Find(name);
      std::printf("%s +- %.1f %%; ", name, 100.0 * p->sigma / std::abs(p->value));
    }
    std::printf("\n");
  }
};

TEST_F(SparseStreams, RotorSpeedsAtTenHertz) {
  FlightLog log = Fly(21);
  KeepOneIn(20, &log.rotors);
  ExpectHonest(log, "rotor_speeds", 0.1);
}

TEST_F(SparseStreams, OdometryAtTwentyHertz) {
  FlightLog log = Fly(22);
  KeepOneIn(10, &log.odometry);
  ExpectHonest(log, "odometry", 0.05);
}

TEST_F(SparseStreams, DenseOnesCostNoReplay) {
  for (const StreamDoubt& doubt : InspectStreams(Fly(23), Model().vehicle()).doubts) {
    EXPECT_EQ(doubt.sparse_s, 0.0) << doubt.stream;
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
