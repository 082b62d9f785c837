// Where the odometry's recorded point lies, beside errors of the model that are slow.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <cstdio>
#include <utility>

#include "../support/recorded_data.h"
#include "../support/test_vehicle.h"
#include "odmc/analysis/calibration.h"
#include "odmc/analysis/recorded_point.h"
#include "odmc/fleet/flight_factor.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;
using Eigen::VectorXd;

const Vector3d kPoint(-0.020, -0.033, 0.026);

/// A flight recorded at kPoint, which the vehicle file takes for Bo.
struct Recorded {
  FlightLog log;
  Vehicle file;
  DynamicModel model;
  ModelValues truth;  ///< but of the point
};

Vehicle FileVehicle() {
  Vehicle file = NominalVehicle();
  file.odometry = SensorMount();
  file.effects.push_back("odometry_extrinsics");
  for (const char* const axis : {"px", "py", "pz"}) {
    file.parameters[std::string("odometry_extrinsics.") + axis].estimated = true;
  }
  return file;
}

/// What the model lacks of the air: as slow as the flight.
BodyWrench Air(const FlightState& state) {
  BodyWrench wrench;
  const Vector3d& u = state.v_AB_B;
  wrench.f_B = {-0.003 * u.y() * u.y(), -0.004 * u.x() * std::abs(u.y()), 0.004 * u.x() * u.x()};
  return wrench;
}

Recorded Record(int seed, const Unmodelled& unmodelled, double duration_s = 40.0) {
  Vehicle flown = NominalVehicle();
  flown.odometry = SensorMount();
  flown.odometry.p_BS = kPoint;
  const DynamicModel model(flown, flown.effects);
  SimulationOptions options;
  options.trajectory = "aggressive";
  options.duration_s = duration_s;
  options.log_rate_hz = 100.0;
  options.seed = seed;
  const Vehicle file = FileVehicle();
  DynamicModel with_point(file, file.effects);
  ModelValues truth = with_point.InitialValues();
  const ModelValues of_flight = DefaultTruth(model);
  for (int i = 0; i < model.num_parameters(); ++i) {
    truth[with_point.IndexOf(model.parameters()[i].full_name)] = of_flight[i];
  }
  return {Simulate(model, of_flight, options, {}, unmodelled).log, file, std::move(with_point),
          truth};
}

Vector3d Sigma(const RecordedPoint& point) { return point.covariance.diagonal().cwiseSqrt(); }

TEST(RecordedPoint, IsFoundBesideSlowErrorsOfTheModel) {
  for (int seed = 1; seed <= 6; ++seed) {
    const Recorded flight = Record(seed, seed > 2 ? Unmodelled(Air) : Unmodelled());
    const RecordedPoint point =
        FindRecordedPoint(flight.log, flight.file, flight.model, flight.truth, {});
    ASSERT_TRUE(point.p_m) << point.why;
    const Vector3d off = *point.p_m - kPoint, sigma = Sigma(point);
    std::printf("seed %d: off by %5.1f %5.1f %5.1f mm, sigma %4.1f %4.1f %4.1f, %.1f to %.1f Hz\n",
                seed, 1e3 * off.x(), 1e3 * off.y(), 1e3 * off.z(), 1e3 * sigma.x(), 1e3 * sigma.y(),
                1e3 * sigma.z(), point.low_Hz, point.high_Hz);
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_LT(std::abs(off[axis]), 3.5 * sigma[axis]) << seed << " " << axis;
      EXPECT_LT(sigma[axis], 0.005) << seed << " " << axis;
    }
  }
}

TEST(RecordedPoint, IsTakenWhereTheEstimateFollowsThoseErrors) {
  const Recorded flight = Record(7, Air);
  const Calibration result =
      Calibrate(flight.log, flight.log, flight.file, flight.model, OfflineOptions());
  ASSERT_TRUE(result.point.p_m) << result.point.why;
  ASSERT_FALSE(result.taken_point.point.empty());
  for (const auto& [name, setting] : result.taken_point.point) {
    const ParameterEstimate* p = result.parameters.Find(name);
    const double sigma_m = *setting.sigma;
    EXPECT_NEAR(p->value, *setting.value, 0.1 * sigma_m) << name;
    EXPECT_GE(p->sigma, 0.999 * sigma_m) << name;
    EXPECT_TRUE(p->observable) << name;
  }
  // The force shows how far the point is from the centre of gravity.
  const ModelValues& values = result.replay.last->values;
  for (int axis = 0; axis < 3; ++axis) {
    const std::string letter(1, "xyz"[axis]);
    const int p = flight.model.IndexOf("odometry_extrinsics.p" + letter);
    const int c = flight.model.IndexOf("centre_of_gravity." + letter);
    const double off = values[p] - values[c] - (kPoint[axis] - flight.truth[c]);
    EXPECT_LT(std::abs(off), 0.006) << letter;
    EXPECT_GT(result.parameters.covariance(p, p), 0.0);
  }
}

// Where the point's height and the centre of gravity's are known worse than their difference, the
// fleet must not lose that.
TEST(RecordedPoint, GoesIntoTheFleetAsAPairWithTheCentreOfGravity) {
  const Recorded flight = Record(7, Air);
  const Calibration result =
      Calibrate(flight.log, flight.log, flight.file, flight.model, OfflineOptions());
  ASSERT_EQ(result.taken_point.held.count("centre_of_gravity.z"), 1u);
  const FlightFactor factor = FactorOf(flight.model, result.parameters, result.inflation, {});
  Eigen::MatrixXd H = factor.root.transpose() * factor.root;
  H.diagonal() += factor.prior_sigma.cwiseAbs2().cwiseInverse();
  Eigen::VectorXd difference = Eigen::VectorXd::Zero(factor.size());
  for (Eigen::Index k = 0; k < factor.size(); ++k) {
    const std::string& name = factor.names[static_cast<size_t>(k)];
    if (name == "odometry_extrinsics.pz") difference[k] = 1.0;
    if (name == "centre_of_gravity.z") difference[k] = -1.0;
  }
  const double sigma = std::sqrt(difference.dot(H.ldlt().solve(difference)));
  EXPECT_LT(sigma, 2.0 * Sigma(result.point).z());
  EXPECT_GT(sigma, 0.5 * Sigma(result.point).z());
}

TEST(RecordedPoint, IsTakenWhereItIsShown) {
  Recorded flight = Record(8, {});
  const ModelValues& values = flight.truth;
  const Eigen::VectorXd sigma = Eigen::VectorXd::Constant(values.size(), 1e-4);
  RecordedPoint point = FindRecordedPoint(flight.log, flight.file, flight.model, values, {});
  ASSERT_TRUE(point.p_m) << point.why;
  EXPECT_EQ(TakePoint(point, flight.model, values, sigma).point.size(), 3u);
  EXPECT_TRUE(TakePoint(point, flight.model, values, sigma).held.empty());
  EXPECT_EQ(TakePoint(point, flight.model, values, 1e3 * sigma).held.size(), 3u);
  point.covariance(1, 1) = 1.0;
  const TakenPoint taken = TakePoint(point, flight.model, values, sigma);
  EXPECT_EQ(taken.point.count("odometry_extrinsics.py"), 0u);
  EXPECT_EQ(taken.point.size(), 2u);
  point.p_m.reset();
  EXPECT_TRUE(TakePoint(point, flight.model, values, sigma).point.empty());
}

// The motion capture's origin of one vehicle, on three flights of 6.5 to 14.3 m/s.
TEST(MeasuredRecordedPoint, IsOneOnThreeFlights) {
  const std::string vehicle_file = RecordedFile("neurobem_fast/vehicle.yaml");
  if (vehicle_file.empty()) GTEST_SKIP() << "no recorded data";
  Vehicle vehicle = LoadVehicle(vehicle_file);
  vehicle.effects = {"thrust",        "rotor_torque", "viscous_torque",      "centre_of_gravity",
                     "inertia",       "gravity",      "odometry_extrinsics", "rotor_drag",
                     "vertical_drag", "hvt",          "directional_lift"};
  for (const char* const axis : {"px", "py", "pz"}) {
    vehicle.parameters[std::string("odometry_extrinsics.") + axis].estimated = true;
  }
  const DynamicModel model(vehicle, vehicle.effects);
  std::vector<RecordedPoint> points;
  for (const char* const name : {"figure8_1", "melon_1", "racetrack_2"}) {
    const FlightLog log = ReadFlightCsv(RecordedFile(std::string("neurobem_fast/") + name + ".csv"),
                                        vehicle.num_rotors(), PoseSource::kEkf);
    points.push_back(FindRecordedPoint(log, vehicle, model, model.InitialValues(), {}));
    const RecordedPoint& point = points.back();
    ASSERT_TRUE(point.p_m) << name << ": " << point.why;
    const Vector3d cm = 100.0 * *point.p_m, sigma = 100.0 * Sigma(point);
    std::printf("%-11s %5.2f %5.2f %5.2f cm, sigma %4.2f %4.2f %4.2f, %.1f to %.1f Hz\n", name,
                cm.x(), cm.y(), cm.z(), sigma.x(), sigma.y(), sigma.z(), point.low_Hz,
                point.high_Hz);
    EXPECT_LT(std::abs(cm.x() + 2.0), 1.5) << name;
    EXPECT_LT(std::abs(cm.y() + 3.3), 1.5) << name;
    EXPECT_LT(std::abs(cm.z() - 2.6), 1.5) << name;
    EXPECT_LT(sigma.maxCoeff(), 2.0) << name;
  }
  for (size_t i = 0; i < points.size(); ++i) {
    for (size_t k = 0; k < i; ++k) {
      const Vector3d d = *points[i].p_m - *points[k].p_m;
      const Eigen::Matrix3d C = points[i].covariance + points[k].covariance;
      EXPECT_LT(d.dot(C.ldlt().solve(d)), 16.3) << i << " " << k;  // chance: once in a thousand
    }
  }
}

// What a plain vehicle file says: the odometry is of the body's origin.
TEST(RecordedPoint, IsAskedForWhereTheModelTakesItToBeKnown) {
  int right = 0;
  for (int seed = 11; seed <= 16; ++seed) {
    const Recorded flight = Record(seed, seed > 13 ? Unmodelled(Air) : Unmodelled());
    for (const bool is_known : {false, true}) {
      Vehicle file = NominalVehicle();
      file.odometry = SensorMount();
      if (is_known) file.odometry.p_BS = kPoint;
      const DynamicModel model(file, file.effects);
      ModelValues values = model.InitialValues();
      for (int k = 0; k < model.num_parameters(); ++k) {
        values[k] = flight.truth[flight.model.IndexOf(model.parameters()[k].full_name)];
      }
      const RecordedPoint point = FindPointOfKnownMount(flight.log, file, model, values, {});
      ASSERT_TRUE(point.p_m) << point.why;
      EXPECT_LT((*point.p_m - kPoint).norm(), 0.01) << seed;
      const VectorXd sigma = VectorXd::Zero(model.num_parameters());
      const auto remark = PointRemark(point, model, values, sigma);
      EXPECT_EQ(remark.has_value(), !is_known) << seed << (remark ? remark->what : "");
      EXPECT_TRUE(TakePoint(point, model, values, sigma).point.empty());
      if (remark) right += remark->leaves == Trust::kGood ? 1 : 0;
      if (remark && seed == 11) std::printf("%s; %s\n", remark->what.c_str(), remark->mend.c_str());
    }
  }
  EXPECT_EQ(right, 6);
}

TEST(RecordedPoint, IsOnTheVehicle) {
  const DynamicModel model(NominalVehicle(), NominalVehicle().effects);
  const ModelValues values = model.InitialValues();
  const VectorXd sigma = VectorXd::Zero(values.size());
  RecordedPoint point;
  point.covariance = 1e-6 * Eigen::Matrix3d::Identity();
  const auto remarks = [&](double z_m) {
    point.p_m = model.Properties(values).p_BS + Vector3d(0.0, 0.0, z_m);
    return PointRemark(point, model, values, sigma).has_value();
  };
  EXPECT_FALSE(remarks(0.004));
  EXPECT_TRUE(remarks(0.006));
  EXPECT_TRUE(remarks(1.1 * model.vehicle().ArmLength()));
  EXPECT_FALSE(remarks(1.3 * model.vehicle().ArmLength()));
}

TEST(RecordedPoint, SaysWhyThereIsNone) {
  const Recorded flight = Record(9, {}, 6.0);
  const RecordedPoint shown =
      FindRecordedPoint(flight.log, flight.file, flight.model, flight.truth, {});
  EXPECT_FALSE(shown.p_m);
  EXPECT_NE(shown.why.find("too little flight"), std::string::npos) << shown.why;
  Vehicle frozen = flight.file;
  frozen.parameters["odometry_extrinsics.py"].estimated = false;
  const DynamicModel model(frozen, frozen.effects);
  const RecordedPoint none =
      FindRecordedPoint(flight.log, frozen, model, model.InitialValues(), {});
  EXPECT_FALSE(none.p_m);
  EXPECT_NE(none.why.find("odometry_extrinsics.py"), std::string::npos) << none.why;
}

}  // namespace
}  // namespace test
}  // namespace odmc
