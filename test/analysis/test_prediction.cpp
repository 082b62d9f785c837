#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/ground_spans.h"
#include "odmc/analysis/prediction.h"
#include "odmc/math/so3.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

/// An exact flight of the nominal vehicle with the sensor at some place.
struct Flight {
  Vehicle vehicle;
  DynamicModel model;
  ModelValues truth;
  FlightLog log;
};

Flight Fly(const SensorMount& odometry, double ground_s = 0.0, bool with_imu = false) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.odometry = odometry;
  DynamicModel model(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(model);
  SimulationOptions options;
  options.trajectory = "aggressive";
  options.duration_s = 8.0;
  options.ground_s = ground_s;
  SimulationNoise noise = SimulationNoise::None();
  noise.imu = with_imu;
  FlightLog log = Simulate(model, truth, options, noise).log;
  return {vehicle, std::move(model), truth, std::move(log)};
}

SensorMount Displaced() {
  SensorMount mount;
  mount.p_BS = Vector3d(0.05, -0.03, 0.08);
  mount.q_BS = Exp(Vector3d(0.1, -0.2, 0.7));
  return mount;
}

/// RMSE as a share of predicting zero, worst axis.
double ForceShare(const PredictionFigures& f) {
  return f.force_rmse_N->cwiseQuotient(*f.zero_force_rmse_N).maxCoeff();
}
double TorqueShare(const PredictionFigures& f) {
  return f.torque_rmse_Nm->cwiseQuotient(*f.zero_torque_rmse_Nm).maxCoeff();
}

void ExpectExact(const PredictionFigures& f) {
  ASSERT_TRUE(f.torque_rmse_Nm.has_value());
  EXPECT_LT(ForceShare(f), 1e-3);
  EXPECT_LT(TorqueShare(f), 2e-3);
  EXPECT_LT((*f.rotor_torque_gain - Vector3d::Ones()).cwiseAbs().maxCoeff(), 1e-3);
  EXPECT_GT(f.force_explained->minCoeff(), 0.9999);
}

TEST(Predict, IsExactAtTheTruth) {
  const Flight flight = Fly({});
  ExpectExact(Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures);
}

TEST(Predict, IsExactWithADisplacedAndTiltedSensor) {
  const Flight flight = Fly(Displaced());
  ExpectExact(Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures);
}

TEST(Predict, TakesEstimatedExtrinsicsIntoThePredictionOnly) {
  const Flight flight = Fly(Displaced());
  // The file knows nothing of the mount; the estimate has it.
  Vehicle file = flight.vehicle;
  file.odometry = SensorMount();
  std::vector<std::string> effects = file.effects;
  effects.push_back("odometry_extrinsics");
  const DynamicModel model(file, effects);
  ModelValues values = model.InitialValues();
  values.head(flight.truth.size()) = flight.truth;
  const Prediction blind = Predict(flight.log, file, model, values, {});
  const int p = model.IndexOf("odometry_extrinsics.px");
  values.segment<3>(p) = Displaced().p_BS;
  values.segment<3>(p + 3) = Log(Displaced().q_BS);
  const Prediction seeing = Predict(flight.log, file, model, values, {});
  EXPECT_LT(ForceShare(seeing.figures), 0.01);
  EXPECT_GT(ForceShare(blind.figures), 0.1);
  for (size_t i = 0; i < seeing.samples.size(); i += 100) {
    EXPECT_EQ(seeing.samples[i].measured_force, blind.samples[i].measured_force);
  }
}

TEST(Predict, TellsWhatTheMeasuredSwingGivesAway) {
  // The recorded point swings about the centre of mass; a model that has no torque knows nothing of
  // that, but for what was measured.
  const Flight flight = Fly(Displaced());
  const auto figures = [&](const ModelValues& values) {
    return Predict(flight.log, flight.vehicle, flight.model, values, {}).figures;
  };
  const PredictionFigures right = figures(flight.truth);
  const double whole = right.zero_force_rmse_N->maxCoeff();
  EXPECT_LT((*right.predicted_swing_force_rmse_N - *right.force_rmse_N).cwiseAbs().maxCoeff(),
            2e-3 * whole);
  ModelValues wrong = flight.truth;
  for (const char* axis : {"x", "y", "z"}) {
    wrong[flight.model.IndexOf(std::string("inertia.") + axis)] *= 2.0;
  }
  const PredictionFigures told = figures(wrong);
  EXPECT_NEAR(told.force_rmse_N->x(), right.force_rmse_N->x(), 1e-9);
  EXPECT_GT(told.predicted_swing_force_rmse_N->x(), 3.0 * told.force_rmse_N->x());
  EXPECT_TRUE(told.GivesAway());
  PredictionFigures same = told;
  same.predicted_swing_force_rmse_N = 1.009 * *told.force_rmse_N;
  EXPECT_FALSE(same.GivesAway());
  same.predicted_swing_force_rmse_N.reset();  // no torque
  EXPECT_FALSE(same.GivesAway());
}

TEST(Predict, SaysHowWellTheAccelerometerIsFollowed) {
  Flight flight = Fly({}, 0.0, true);
  const auto figures = [&](const ModelValues& values) {
    return Predict(flight.log, flight.vehicle, flight.model, values, {}).figures;
  };
  // A bias is no error; what a thrust coefficient 10 % too large adds is a tenth of its swing.
  for (ImuSample& sample : flight.log.imu) *sample.specific_force_I += Vector3d(0.2, -0.1, 0.5);
  const PredictionFigures right = figures(flight.truth);
  ASSERT_TRUE(right.accelerometer_force_rmse_N.has_value());
  EXPECT_LT(right.accelerometer_force_rmse_N->maxCoeff(), 2e-3 * right.zero_force_rmse_N->z());
  ModelValues wrong = flight.truth;
  wrong[flight.model.IndexOf("thrust.k_f")] *= 1.1;
  const double missed = figures(wrong).accelerometer_force_rmse_N->z();
  EXPECT_GT(missed, 0.01 * right.zero_force_rmse_N->z());
  EXPECT_LT(missed, 0.1 * right.zero_force_rmse_N->z());
  // Without an accelerometer there is no figure.
  flight.log.imu.clear();
  EXPECT_FALSE(figures(flight.truth).accelerometer_force_rmse_N.has_value());
}

TEST(Predict, IsWorseWithWrongParameters) {
  const Flight flight = Fly({});
  const auto shares = [&](const char* name, double factor) {
    ModelValues values = flight.truth;
    values[flight.model.IndexOf(name)] *= factor;
    const auto f = Predict(flight.log, flight.vehicle, flight.model, values, {}).figures;
    return std::make_pair(ForceShare(f), TorqueShare(f));
  };
  EXPECT_GT(shares("thrust.k_f", 1.2).first, 0.1);
  EXPECT_GT(shares("drag.d_x", 2.0).first, 0.05);
  EXPECT_GT(shares("centre_of_gravity.x", 0.0).second, 0.1);
  EXPECT_GT(shares("viscous_torque.b_x", 3.0).second, 0.1);
}

TEST(Predict, DoesNotLetTheInertiaMakeItsOwnTorqueFigure) {
  const Flight flight = Fly({});
  ModelValues values = flight.truth;
  values[flight.model.IndexOf("inertia.x")] *= 3.0;
  const auto truth = Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures;
  const auto wrong = Predict(flight.log, flight.vehicle, flight.model, values, {}).figures;
  EXPECT_EQ(truth.torque_rmse_Nm->x(), wrong.torque_rmse_Nm->x());
  EXPECT_EQ(truth.zero_torque_rmse_Nm->x(), wrong.zero_torque_rmse_Nm->x());
  EXPECT_NEAR(wrong.inertia_over_nominal->x(), 3.0, 1e-12);
  EXPECT_GT(wrong.angular_acceleration_rmse_rad_s2->x(),
            10.0 * truth.angular_acceleration_rmse_rad_s2->x());
}

TEST(Predict, FindsTheFactorOnTheRotorTorque) {
  const Flight flight = Fly({});
  Vehicle vehicle = flight.vehicle;
  vehicle.inertia_kg_m2 *= 2.0;  // the file overstates it: measured torque doubles
  ModelValues values = flight.truth;
  const auto f = Predict(flight.log, vehicle, flight.model, values, {}).figures;
  EXPECT_LT(f.inertia_over_nominal->x(), 0.51);
  EXPECT_GT((*f.rotor_torque_gain - Vector3d::Ones()).cwiseAbs().maxCoeff(), 0.05);
}

TEST(Predict, DoesWithoutVelocityAndRates) {
  Flight flight = Fly(Displaced());
  for (OdometrySample& s : flight.log.odometry) {
    s.v_WS.reset();
    s.w_WS_S.reset();
  }
  const auto f = Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures;
  EXPECT_LT(ForceShare(f), 0.03);
  EXPECT_GT(f.samples, 1000);
}

TEST(Predict, LeavesOutSamplesNearGapsAndCountsThem) {
  Flight flight = Fly({});
  const auto whole = Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures;
  auto& odometry = flight.log.odometry;
  odometry.erase(odometry.begin() + 1000, odometry.begin() + 1400);  // one second
  const auto f = Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures;
  EXPECT_EQ(whole.left_out_gaps, 0);
  EXPECT_GT(f.left_out_gaps, 30);
  EXPECT_LT(f.left_out_gaps, 60);
  EXPECT_EQ(f.samples + f.left_out_gaps + 400, whole.samples);
  ExpectExact(f);
}

TEST(Predict, LeavesOutSamplesWithoutRotorSpeeds) {
  Flight flight = Fly({});
  auto& rotors = flight.log.rotors;
  rotors.erase(rotors.begin() + 1000, rotors.begin() + 1400);
  const auto f = Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures;
  EXPECT_GT(f.left_out_gaps, 400);
  ExpectExact(f);
}

TEST(Predict, HasNoTorqueWhereOnlyTheRmsSpeedIsKnown) {
  Flight flight = Fly({});
  flight.log.rotor_rms_only = true;
  for (RotorSample& s : flight.log.rotors) {
    s.speed.setConstant(std::sqrt(s.speed.squaredNorm() / static_cast<double>(s.speed.size())));
  }
  const auto f = Predict(flight.log, flight.vehicle, flight.model, flight.truth, {}).figures;
  EXPECT_LT(ForceShare(f), 0.01);
  EXPECT_FALSE(f.torque_rmse_Nm.has_value());
  EXPECT_FALSE(f.rotor_torque_gain.has_value());
}

TEST(Predict, HasNothingForAnEmptyFlight) {
  const Flight flight = Fly({});
  const Prediction p = Predict({}, flight.vehicle, flight.model, flight.truth, {});
  EXPECT_EQ(p.figures.samples, 0);
  EXPECT_FALSE(p.figures.force_rmse_N.has_value());
}

TEST(FindGroundSpans, FindsTheStandBeforeTakeOff) {
  const Flight flight = Fly({}, 2.0);
  const GroundSpans ground = FindGroundSpans(flight.log, flight.model, flight.truth);
  ASSERT_EQ(ground.spans.size(), 1u);
  EXPECT_EQ(ground.spans[0].first, flight.log.odometry.front().stamp);
  EXPECT_NEAR(ToSeconds(ground.spans[0].second - ground.spans[0].first), 2.5, 0.5);
  EXPECT_GT(ground.on_ground_s, 0.0);
  EXPECT_GT(ground.airborne_keyframes, 450);
  const auto f =
      Predict(flight.log, flight.vehicle, flight.model, flight.truth, ground.spans).figures;
  EXPECT_GT(f.left_out_ground, 500);
  EXPECT_LT(ForceShare(f), 0.05);
}

/// Ten seconds of hover, then ten of fast flight: the second half alone shows the drag.
FlightLog HoverThenFly(const DynamicModel& model, const ModelValues& truth) {
  SimulationOptions options;
  options.duration_s = 10.0;
  options.trajectory = "hover";
  FlightLog log = Simulate(model, truth, options).log;
  options.trajectory = "octo";
  const FlightLog fast = Simulate(model, truth, options).log;
  const Stamp later = FromSeconds(10.01);
  for (OdometrySample sample : fast.odometry) {
    sample.stamp += later;
    log.odometry.push_back(sample);
  }
  for (RotorSample sample : fast.rotors) {
    sample.stamp += later;
    log.rotors.push_back(sample);
  }
  log.imu.clear();
  return log;
}

/// A recording at heights [m], ten samples a second, and one phase over all of it.
std::pair<FlightLog, std::vector<PhaseSpan>> At(const std::vector<double>& heights,
                                                FlightPhase phase) {
  FlightLog log;
  for (size_t i = 0; i < heights.size(); ++i) {
    OdometrySample& sample = log.odometry.emplace_back();
    sample.stamp = FromSeconds(0.1 * static_cast<double>(i));
    sample.p_WS = {0.0, 0.0, heights[i]};
  }
  PhaseSpan span;
  span.phase = phase;
  span.to = log.odometry.back().stamp;
  return {log, {span}};
}

TEST(StandingHeight, IsTheHeightAtWhichTheVehicleStands) {
  std::vector<double> heights(20, 0.25);
  heights.back() = 0.9;  // it begins to rise
  const auto [log, phases] = At(heights, FlightPhase::kIdling);
  EXPECT_DOUBLE_EQ(*StandingHeight(log, phases, 0.05), 0.25);
}

TEST(StandingHeight, IsUnknownInFlightForAMomentAndAtTwoHeights) {
  const auto [flying, in_flight] = At(std::vector<double>(20, 0.25), FlightPhase::kFlying);
  EXPECT_FALSE(StandingHeight(flying, in_flight, 0.05));
  const auto [moment, brief] = At(std::vector<double>(4, 0.25), FlightPhase::kOnGround);
  EXPECT_FALSE(StandingHeight(moment, brief, 0.05));
  std::vector<double> two(20, 0.25);
  std::fill(two.begin() + 10, two.end(), 0.75);
  const auto [table, on_table] = At(two, FlightPhase::kOnGround);
  EXPECT_FALSE(StandingHeight(table, on_table, 0.05));
}

/// Stands at 0.25 m for a second, and flies at 1 m for nine.
class GroundTouches : public testing::Test {
 protected:
  GroundTouches() {
    std::tie(log_, phases_) = At(std::vector<double>(100, 1.0), FlightPhase::kFlying);
    for (int i = 0; i < 10; ++i) Height(i) = 0.25;
    phases_.front().from = log_.odometry[10].stamp;
    PhaseSpan stands;
    stands.phase = FlightPhase::kIdling;
    stands.to = log_.odometry[9].stamp;
    phases_.insert(phases_.begin(), stands);
  }

  double& Height(size_t i) { return log_.odometry[i].p_WS.z(); }
  StampSpans LeftOut() const {
    StampSpans left_out;
    AddGroundTouches(log_, phases_, vehicle_, &left_out);
    return left_out;
  }

  const Vehicle vehicle_ = test::NominalVehicle();
  FlightLog log_;
  std::vector<PhaseSpan> phases_;
};

TEST_F(GroundTouches, AreWhereTheVehicleIsAsLowAsItStood) {
  EXPECT_TRUE(LeftOut().empty());
  Height(50) = Height(51) = 0.26;
  const auto left_out = LeftOut();
  ASSERT_EQ(left_out.size(), 1u);
  EXPECT_EQ(left_out[0].first, FromSeconds(4.9));  // a filter window of 0.1 s before and after
  EXPECT_EQ(left_out[0].second, FromSeconds(5.2));
}

TEST_F(GroundTouches, AreHigherForAVehicleThatLeans) {
  const double reach = vehicle_.ArmLength() + vehicle_.odometry.p_BS.norm();
  Height(50) = 0.25 + 0.5 * reach;
  EXPECT_TRUE(LeftOut().empty());
  log_.odometry[50].q_WS = Exp(Vector3d(0.0, 0.6, 0.0)) * vehicle_.odometry.q_BS;
  EXPECT_EQ(LeftOut().size(), 1u);
  // Far below the ground that it stood on is other ground.
  Height(50) = 0.25 - 1.5 * reach;
  EXPECT_TRUE(LeftOut().empty());
}

TEST_F(GroundTouches, AreNoneWhereTheVehicleFliesAtThatHeight) {
  for (size_t i = 40; i < 60; ++i) Height(i) = 0.26;
  EXPECT_TRUE(LeftOut().empty());
  for (size_t i = 42; i < 60; ++i) Height(i) = 1.0;
  EXPECT_EQ(LeftOut().size(), 1u);
}

TEST(PredictLeftOut, PredictsABlockWithWhatTheOthersShow) {
  const Vehicle vehicle = test::NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  EstimatorOptions options = OfflineOptions();
  const FlightLog log = HoverThenFly(model, DefaultTruth(model));
  const Calibration seen = Calibrate(log, log, vehicle, model, options);
  const LeftOutPrediction halves = PredictLeftOut(log, log, vehicle, model, options, 10.0);
  const LeftOutPrediction blocks = PredictLeftOut(log, log, vehicle, model, options, 2.5);
  const double all = seen.prediction.figures.force_rmse_N->head<2>().norm();
  EXPECT_GT(halves.figures.force_rmse_N->head<2>().norm(), 2.0 * all);  // no drag was seen
  EXPECT_LT(blocks.figures.force_rmse_N->head<2>().norm(), 1.1 * all);
  EXPECT_GT(blocks.figures.samples, 0.95 * seen.prediction.figures.samples);
  EXPECT_FALSE(blocks.figures.inertia_over_nominal);
  EXPECT_THROW(PredictLeftOut(log, log, vehicle, model, options, 15.0), std::invalid_argument);
}

int NumFelt(const FlightMotion& flight) {
  return static_cast<int>(
      std::count_if(flight.samples.begin(), flight.samples.end(),
                    [](const FilteredMotion& s) { return s.specific_force_I.has_value(); }));
}

TEST(FilterFlight, LeavesOutWhatAnAccelerometerOfTheWholeFlightMisses) {
  Flight flight = Fly({}, 0.0, true);
  const FlightMotion whole = FilterFlight(flight.log, 4, {});
  ASSERT_EQ(NumFelt(whole), static_cast<int>(whole.samples.size()));
  ASSERT_EQ(whole.left_out_gaps, 0);
  auto& imu = flight.log.imu;
  const auto third = static_cast<std::ptrdiff_t>(imu.size() / 3);
  const auto missing = static_cast<std::ptrdiff_t>(imu.size() / 40);
  imu.erase(imu.begin() + third, imu.begin() + third + missing);  // 0.2 s
  const FlightMotion gap = FilterFlight(flight.log, 4, {});
  EXPECT_EQ(NumFelt(gap), static_cast<int>(gap.samples.size()));
  EXPECT_GT(gap.left_out_gaps, 40);
  EXPECT_LT(gap.left_out_gaps, 200);
  EXPECT_EQ(gap.samples.size() + static_cast<size_t>(gap.left_out_gaps), whole.samples.size());
  EXPECT_EQ(std::count_if(gap.samples.begin() + 1, gap.samples.end(),
                          [](const FilteredMotion& s) { return !s.follows; }),
            1);
  // One that is there for a while is no reason to leave out the flight.
  imu.erase(imu.begin() + third, imu.end());
  const FlightMotion most = FilterFlight(flight.log, 4, {});
  EXPECT_EQ(most.samples.size(), whole.samples.size());
}

// Where a rotor is braked from full speed the polynomial through the square of its speed may pass
// through zero; what is divided by that is not its acceleration.
TEST(FilterFlight, RotorAccelerationOfASteepFallIsThatOfTheSpeed) {
  Flight flight = Fly({});
  constexpr double kSlowest_rad_s = 60.0, kRate_rad_s2 = -4e4, kAt_s = 4.0;
  const double first_s = ToSeconds(flight.log.rotors.front().stamp);
  for (RotorSample& sample : flight.log.rotors) {
    const double since_s = ToSeconds(sample.stamp) - first_s - kAt_s;
    if (since_s < 0.0) continue;
    for (double& speed : sample.speed) {
      speed = std::max(kSlowest_rad_s, 2000.0 + kRate_rad_s2 * since_s);
    }
  }
  double fastest = 0.0;
  for (const FilteredMotion& motion : FilterFlight(flight.log, 4, {}).samples) {
    if (std::abs(motion.t_s - kAt_s) > 0.5) continue;
    fastest = std::max(fastest, motion.rotors.acceleration.cwiseAbs().maxCoeff());
  }
  EXPECT_GT(fastest, -0.5 * kRate_rad_s2);
  EXPECT_LT(fastest, -1.5 * kRate_rad_s2);
}

}  // namespace
}  // namespace odmc
