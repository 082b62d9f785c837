// The loop closed on recorded flights.

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/recorded_data.h"

namespace odmc {
namespace test {
namespace {

// What these rotors do at speed resembles several effects of the catalogue. The test does not ask
// which of them are named, but what the extended model predicts.
TEST(MeasuredNeuroBem, HalvesTheErrorOnBlocksHeldOut) {
  const std::string file = RecordedFile("neurobem/test1_first18s.csv");
  if (file.empty()) GTEST_SKIP() << "no recorded data";
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/neurobem.yaml");
  const FlightLog log = ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf);
  CloseLoopOptions options;
  options.ruled_out = {"wind", "gust"};  // the room was closed
  const ClosedLoop loop = CloseLoop(log, vehicle, vehicle, options);
  ASSERT_EQ(loop.verdict, Verdict::kEffect) << CloseLoopTable(loop);
  const auto has = [&loop](const char* name) {
    return std::count(loop.effect_names.begin(), loop.effect_names.end(), name) > 0;
  };
  EXPECT_TRUE(has("hub_moment") || has("anisotropic_hub_moment") || has("pressure_centre") ||
              has("rotor_drag"));  // its couple is a hub moment
  const Eigen::Vector3d force = *loop.after.force_rmse_N, torque = *loop.after.torque_rmse_Nm;
  EXPECT_LT(force.x(), 0.62 * loop.before.force_rmse_N->x()) << CloseLoopTable(loop);
  EXPECT_LT(force.y(), 0.62 * loop.before.force_rmse_N->y());
  EXPECT_LT(force.z(), 0.35 * loop.before.force_rmse_N->z());  // with skewed_inflow
  EXPECT_LT(torque.x(), 0.85 * loop.before.torque_rmse_Nm->x());
  EXPECT_LT(torque.y(), 0.45 * loop.before.torque_rmse_Nm->y());
}

// A few cycles of a figure eight, 6 to 9 s.
TEST(MeasuredCrazyflie, HasAHubMomentOnFlightsOfSeconds) {
  for (const char* name : {"eckart00", "eckart18", "eckart25"}) {
    const std::string file = RecordedFile(std::string("imrc_cf21_brushless/") + name + ".csv");
    if (file.empty()) GTEST_SKIP() << "no recorded data";
    const Vehicle vehicle =
        LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/imrc_cf21_brushless.yaml");
    const FlightLog log = ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf);
    CloseLoopOptions options;
    options.estimator.keyframe_rate_hz = 50.0;
    const ClosedLoop loop = CloseLoop(log, vehicle, vehicle, options);
    ASSERT_EQ(loop.verdict, Verdict::kEffect) << name << "\n" << CloseLoopTable(loop);
    // A lift by the direction of flight may gain more, in force.
    const bool has_moment =
        std::any_of(loop.effects.begin(), loop.effects.end(), [](const AddedEffect& added) {
          return added.effect.name == "hub_moment" || added.effect.name == "anisotropic_hub_moment";
        });
    EXPECT_TRUE(has_moment) << name << "\n" << CloseLoopTable(loop);
    EXPECT_LT(loop.after.torque_rmse_Nm->y(), 0.6 * loop.before.torque_rmse_Nm->y()) << name;
  }
}

ClosedLoop CrazyflieWithThrustHeld(const std::string& file) {
  Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/imrc_cf21_brushless.yaml");
  ParameterSetting& k_f = vehicle.parameters["thrust.k_f"];
  k_f.value = 3.688e-8;  // of eckart00
  k_f.estimated = false;
  const FlightLog log = ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf);
  CloseLoopOptions options;
  options.estimator.keyframe_rate_hz = 50.0;
  return CloseLoop(log, vehicle, vehicle, options);
}

// What is strong must not be refused for the noise that holds what else is missing, and of two
// forms of one moment the wider is enough: beside each other their sigmas are thirty times as
// large.
TEST(MeasuredCrazyflie, HasOneHubMomentWithItsSigma) {
  for (const char* name : {"eckart00", "eckart01", "eckart06"}) {
    const std::string file = RecordedFile(std::string("imrc_cf21_brushless/") + name + ".csv");
    if (file.empty()) GTEST_SKIP() << "no recorded data";
    const ClosedLoop loop = CrazyflieWithThrustHeld(file);
    int moments = 0;
    for (const AddedEffect& added : loop.effects) {
      const bool is_one =
          added.effect.name == "hub_moment" || added.effect.name == "anisotropic_hub_moment";
      if (!is_one) continue;
      ++moments;
      for (const ParameterEstimate& p : added.effect.parameters) {
        EXPECT_LT(loop.parameters.Find(p.full_name)->sigma, 1e-8) << name << " " << p.full_name;
      }
    }
    EXPECT_EQ(moments, 1) << name << "\n" << CloseLoopTable(loop);
  }
}

// A centre of pressure that is found first stands for a lift that is found later; asymmetric rotors
// gain nine nats and lose fifty on the block held out.
TEST(MeasuredCrazyflie, DropsWhatIsNothingBesideTheRest) {
  const std::vector<std::pair<std::string, std::string>> wrong = {{"eckart09", "pressure_centre"},
                                                                  {"eckart16", "rotor_asymmetry"}};
  for (const auto& [name, effect] : wrong) {
    const std::string file = RecordedFile("imrc_cf21_brushless/" + name + ".csv");
    if (file.empty()) GTEST_SKIP() << "no recorded data";
    const ClosedLoop loop = CrazyflieWithThrustHeld(file);
    EXPECT_EQ(std::count(loop.effect_names.begin(), loop.effect_names.end(), effect), 0)
        << name << "\n"
        << CloseLoopTable(loop);
    EXPECT_LT((*loop.after.force_rmse_N)[2], 1.5 * (*loop.before.force_rmse_N)[2]) << name;
  }
}

bool Warns(const ClosedLoop& loop, const std::string& of) {
  return std::any_of(loop.warnings.begin(), loop.warnings.end(), [&](const std::string& warning) {
    return warning.find(of) != std::string::npos;
  });
}

// With k_f held a wind and a lift that is even in the air speed have a second valley: 3.8 m/s from
// behind in a closed room. A fit from afar gains by it, and an online estimate goes into it; either
// has to be found out.
TEST(MeasuredCrazyflie, NamesNoWindOfASecondValley) {
  const std::string file = RecordedFile("imrc_cf21_brushless/eckart13.csv");
  if (file.empty()) GTEST_SKIP() << "no recorded data";
  const ClosedLoop loop = CrazyflieWithThrustHeld(file);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_LT((*loop.after.force_rmse_N)[axis], 2.0 * (*loop.before.force_rmse_N)[axis])
        << CloseLoopTable(loop);
  }
  EXPECT_EQ(std::count(loop.effect_names.begin(), loop.effect_names.end(), "wind"), 0)
      << CloseLoopTable(loop);
  const auto wind = std::find_if(loop.ranking.begin(), loop.ranking.end(),
                                 [](const RankedEffect& ranked) { return ranked.name == "wind"; });
  ASSERT_NE(wind, loop.ranking.end());
  const bool gains_nothing = wind->p_value > AttributionOptions().false_alarm_rate;
  EXPECT_TRUE(gains_nothing || !wind->remarks.empty() || Warns(loop, "wind gains"))
      << CloseLoopTable(loop);
}

// Thrown and caught: all that shows the rotors' inertia are the seconds after the throw. The
// estimate, which weighs all frequencies, is too uncertain for a name by itself; bands of frequency
// are not.
TEST(MeasuredIndiflight, HasRotorsWithAnInertiaOfTheirOwn) {
  const std::string vehicle_file = RecordedFile("indiflight/vehicle.yaml");
  for (const char* const name : {"LOG00230", "LOG00260"}) {
    const std::string file = RecordedFile(std::string("indiflight/") + name + ".csv");
    if (file.empty()) GTEST_SKIP() << "no recorded data";
    const Vehicle vehicle = LoadVehicle(vehicle_file);
    const ClosedLoop loop = CloseLoop(ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf),
                                      vehicle, vehicle, {});
    const auto reaction =
        std::find_if(loop.effects.begin(), loop.effects.end(),
                     [](const AddedEffect& e) { return e.effect.name == "rotor_reaction"; });
    ASSERT_NE(reaction, loop.effects.end()) << name << CloseLoopTable(loop);
    const ParameterEstimate* J_r = reaction->effect.Find("rotor_reaction.J_r");
    ASSERT_NE(J_r, nullptr);
    constexpr double kDocumented = 8.7e-7;  // kg m^2, the source's own, to 2 %
    EXPECT_NEAR(J_r->value, kDocumented, 3.0 * J_r->sigma) << name;
    EXPECT_LT(J_r->sigma, 0.6 * kDocumented) << name;
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
