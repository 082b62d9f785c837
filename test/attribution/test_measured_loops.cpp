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

// One of the effects that predict blocks held out better is a stand-in: leaning rotors make up for a
// torque coefficient that nobody documented. They would have to lean by six degrees, all of them.
TEST(MeasuredNeuroBem, FindsTheHubMomentAndWhatBendsThrustAndDrag) {
  const std::string file = RecordedFile("neurobem/test1_first18s.csv");
  if (file.empty()) GTEST_SKIP() << "no recorded data";
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/neurobem.yaml");
  const FlightLog log = ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf);
  CloseLoopOptions options;
  options.estimator.max_update_time_s = 10.0;  // the same result on a loaded machine
  const ClosedLoop loop = CloseLoop(log, vehicle, vehicle, options);
  ASSERT_EQ(loop.verdict, Verdict::kEffect) << CloseLoopTable(loop);
  EXPECT_EQ(loop.effects.front().effect.name, "anisotropic_hub_moment");
  const auto has = [&loop](const char* name) {
    return std::count(loop.effect_names.begin(), loop.effect_names.end(), name) > 0;
  };
  EXPECT_TRUE(has("rotor_drag") && has("anisotropic_hvt") && has("skewed_inflow"));
  EXPECT_FALSE(has("rotor_tilt"));
  const Eigen::Array3d force = loop.after.force_rmse_N->array() / loop.before.force_rmse_N->array();
  EXPECT_LT(force.x(), 0.65) << CloseLoopTable(loop);
  EXPECT_LT(force.y(), 0.65);
  EXPECT_LT(force.z(), 0.35);
  EXPECT_LT(loop.after.torque_rmse_Nm->y(), 0.4 * loop.before.torque_rmse_Nm->y());
}

}  // namespace
}  // namespace test
}  // namespace odmc
