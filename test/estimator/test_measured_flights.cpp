// The estimator on recorded flights. Bounds: issue targets, i.e. at most 10 % above a batch
// least-squares fit (NeuroBEM), k_f within 3 % of the data READMEs' fits.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "odmc/analysis/prediction.h"
#include "odmc/analysis/replay.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/recorded_data.h"

namespace odmc {
namespace {

struct Result {
  ReplayResult replay;
  PredictionFigures figures;
  std::optional<DynamicModel> model;

  double Value(const std::string& name) const { return replay.last->values[model->IndexOf(name)]; }
};

Result Calibrate(const std::string& file, const std::string& vehicle_name,
                 const std::string& without = "", double end_s = 0.0, bool free_inertia = false) {
  const std::string folder = std::string(ODMC_SOURCE_DIR) + "/config/vehicles/";
  const Vehicle file_vehicle = LoadVehicle(folder + vehicle_name + ".yaml");
  Vehicle vehicle = file_vehicle;
  auto& effects = vehicle.effects;
  effects.erase(std::remove(effects.begin(), effects.end(), without), effects.end());
  for (const char* axis : {"inertia.x", "inertia.y", "inertia.z"}) {
    if (free_inertia) vehicle.parameters[axis].estimated = true;
  }
  FlightLog log = ReadFlightCsv(file, vehicle.num_rotors(), PoseSource::kEkf);
  CutFlight(0.0, end_s, &log);
  Result result;
  result.model.emplace(vehicle, effects);
  EstimatorOptions options = OfflineOptions();
  Estimator estimator(&*result.model, options, !log.rotor_rms_only);
  result.replay = Replay(log, &estimator);
  if (result.replay.last) {
    result.figures = Predict(log, file_vehicle, *result.model, result.replay.last->values,
                             result.replay.ground_spans)
                         .figures;
  }
  return result;
}

#define RECORDED_OR_SKIP(variable, name)                 \
  const std::string variable = test::RecordedFile(name); \
  if (variable.empty()) GTEST_SKIP() << "no recorded data"

TEST(MeasuredNeuroBem, OnlineEstimateIsWithinTenPercentOfTheBatchFit) {
  RECORDED_OR_SKIP(flight, "neurobem/test1_first18s.csv");
  const Result r = Calibrate(flight, "neurobem");
  ASSERT_TRUE(r.replay.last);
  const Eigen::Vector3d force = *r.figures.force_rmse_N, torque = *r.figures.torque_rmse_Nm;
  EXPECT_LT(force.x(), 1.1 * 0.186);
  EXPECT_LT(force.y(), 1.1 * 0.200);
  EXPECT_LT(force.z(), 1.1 * 0.456);
  EXPECT_LT(torque.x(), 1.1 * 0.018);
  EXPECT_LT(torque.y(), 1.1 * 0.030);
  EXPECT_GT(torque.x(), (*r.figures.zero_torque_rmse_Nm).x());  // the paper's model is worse than 0
  EXPECT_TRUE(r.replay.last->sigma.allFinite());
}

TEST(MeasuredNeuroBem, AblationsOfThePaperShow) {
  RECORDED_OR_SKIP(flight, "neurobem/test1_first18s.csv");
  const Result no_viscous = Calibrate(flight, "neurobem", "viscous_torque");
  EXPECT_LT((*no_viscous.figures.torque_rmse_Nm).x(), 1.1 * 0.072);
  EXPECT_LT((*no_viscous.figures.torque_rmse_Nm).y(), 1.1 * 0.084);
  EXPECT_GT((*no_viscous.figures.torque_rmse_Nm).x(), 3.0 * 0.018);
  const Result no_drag = Calibrate(flight, "neurobem", "drag");
  EXPECT_GT((*no_drag.figures.force_rmse_N).x(), 3.0 * 0.186);
}

TEST(MeasuredNeuroBem, FreeInertiaStaysHonest) {
  RECORDED_OR_SKIP(flight, "neurobem/test1_first18s.csv");
  const Result r = Calibrate(flight, "neurobem", "", 0.0, true);
  ASSERT_TRUE(r.replay.last);
  const double published[] = {2.5e-3, 2.1e-3};
  for (int i = 0; i < 2; ++i) {
    const int k = r.model->IndexOf(i == 0 ? "inertia.x" : "inertia.y");
    EXPECT_NEAR(r.replay.last->values[k], published[i], 0.3 * published[i]);
  }
}

TEST(MeasuredFlights, ThrustCoefficientAgreesWithEveryReadme) {
  struct Flight {
    const char *file, *vehicle;
    double k_f;
    double end_s;
  };
  const Flight flights[] = {
      {"polyu_quad13/flight_2024-02-21_first70.csv", "polyu_quad13", 1.248e-6, 0.0},
      {"imrc_cf21_brushless/eckart00.csv", "imrc_cf21_brushless", 3.70e-8, 0.0},
      {"imrc_cf21_brushed/jana00.csv", "imrc_cf21_brushed", 1.99e-8, 0.0},
      {"blackbird_clover/clover_yawForward_maxSpeed5p0_first70.csv", "blackbird_clover", 1.878e-6,
       10.0},
  };
  for (const Flight& flight : flights) {
    RECORDED_OR_SKIP(file, flight.file);
    const Result r = Calibrate(file, flight.vehicle, "", flight.end_s);
    ASSERT_TRUE(r.replay.last) << flight.file;
    EXPECT_NEAR(r.Value("thrust.k_f"), flight.k_f, 0.03 * flight.k_f) << flight.file;
    EXPECT_TRUE(r.replay.last->values.allFinite()) << flight.file;
  }
}

TEST(MeasuredFlights, BrokenSensorsAndJumpsDoNotBreakTheEstimator) {
  const std::pair<const char*, const char*> flights[] = {
      {"imrc_cf21_brushed_badsensor/jana23.csv", "imrc_cf21_brushed_badsensor"},
      {"imrc_cf21_payload_badsensor/eckart52.csv", "imrc_cf21_payload_badsensor"},
      {"polyu_quad13/flight_2023-10-19_first70.csv", "polyu_quad13_2023"},
  };
  for (const auto& [name, vehicle] : flights) {
    RECORDED_OR_SKIP(file, name);
    const Result r = Calibrate(file, vehicle, "", 10.0);
    for (const HistoryRow& row : r.replay.history) {
      ASSERT_TRUE(row.values.allFinite() && row.sigma.allFinite()) << name;
    }
  }
}

}  // namespace
}  // namespace odmc
