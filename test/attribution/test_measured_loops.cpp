// The loop closed on recorded flights.

#include <gtest/gtest.h>

#include <algorithm>

#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/recorded_data.h"

namespace odmc {
namespace test {
namespace {

// Several effects of the catalogue stand in for what its rotors do at speed: which of them are named
// is no fact, what the extended model predicts is.
TEST(MeasuredNeuroBem, HalvesTheErrorOnBlocksHeldOut) {
  const std::string file = RecordedFile("neurobem/test1_first18s.csv");
  if (file.empty()) GTEST_SKIP() << "no recorded data";
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/neurobem.yaml");
  const FlightLog log = ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf);
  CloseLoopOptions options;
  options.estimator.max_update_time_s = 10.0;  // the same result on a loaded machine
  const ClosedLoop loop = CloseLoop(log, vehicle, vehicle, options);
  ASSERT_EQ(loop.verdict, Verdict::kEffect) << CloseLoopTable(loop);
  const auto has = [&loop](const char* name) {
    return std::count(loop.effect_names.begin(), loop.effect_names.end(), name) > 0;
  };
  EXPECT_TRUE(has("hub_moment") || has("anisotropic_hub_moment") || has("pressure_centre"));
  const Eigen::Vector3d force = *loop.after.force_rmse_N, torque = *loop.after.torque_rmse_Nm;
  EXPECT_LT(force.x(), 0.172) << CloseLoopTable(loop);
  EXPECT_LT(force.y(), 0.143);
  EXPECT_LT(force.z(), 0.162);
  EXPECT_LT(torque.x(), 0.0178);
  EXPECT_LT(torque.y(), 0.0123);
}

}  // namespace
}  // namespace test
}  // namespace odmc
