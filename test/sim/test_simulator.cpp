#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include "odmc/math/so3.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/tracking_controller.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/trajectory/flatness.h"
#include "odmc/trajectory/trajectory.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr double kDegree = 57.29577951308232;

SimulatedFlight Fly(const Vehicle& vehicle, const std::string& trajectory,
                    const SimulationNoise& noise, double duration_s = 30.0, int seed = 1) {
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = trajectory;
  options.duration_s = duration_s;
  options.seed = seed;
  return Simulate(model, DefaultTruth(model), options, noise);
}

// What a flight reached.
struct Figures {
  double top_speed = 0.0, tilt = 0.0, rate = 0.0, tracking_rms = 0.0, tracking_max = 0.0;
  double thrust_over_weight = 0.0;
};

Figures FiguresOf(const SimulatedFlight& flight, const std::string& name, const Vehicle& vehicle) {
  const Trajectory trajectory(name);
  Figures figures;
  double sum = 0.0;
  for (const TruthSample& at : flight.truth) {
    const double error = (at.p_WB - trajectory.At(ToSeconds(at.stamp)).p_WB).norm();
    const double tilt = std::acos(std::min(1.0, at.q_WB.toRotationMatrix()(2, 2)));
    figures.top_speed = std::max(figures.top_speed, at.v_WB.norm());
    figures.tilt = std::max(figures.tilt, tilt * kDegree);
    figures.rate = std::max(figures.rate, at.w_WB_B.norm());
    figures.tracking_max = std::max(figures.tracking_max, error);
    figures.thrust_over_weight =
        std::max(figures.thrust_over_weight, at.f_B.z() / (vehicle.mass_kg * vehicle.gravity_m_s2));
    sum += error * error;
  }
  figures.tracking_rms = std::sqrt(sum / static_cast<double>(flight.truth.size()));
  return figures;
}

void Print(const std::string& vehicle, const std::string& name, const Figures& f) {
  std::printf(
      "%-8s %-10s %5.2f m/s %5.1f deg %5.2f rad/s  T/W %4.2f  tracking rms %6.4f max %6.4f m\n",
      vehicle.c_str(), name.c_str(), f.top_speed, f.tilt, f.rate, f.thrust_over_weight,
      f.tracking_rms, f.tracking_max);
}

class TrajectoryTest : public ::testing::TestWithParam<std::string> {};

TEST_P(TrajectoryTest, GivesTheDerivativesOfItsPosition) {
  for (const double ground_s : {0.0, 1.5}) {
    const Trajectory trajectory(GetParam(), ground_s);
    const double h = 1e-4;
    for (double t = 0.05; t < 9.0; t += 0.173) {
      const FlatReference a = trajectory.At(t - h), b = trajectory.At(t), c = trajectory.At(t + h);
      EXPECT_LT((b.v_WB - (c.p_WB - a.p_WB) / (2 * h)).norm(), 1e-5) << t;
      EXPECT_LT((b.a_WB - (c.v_WB - a.v_WB) / (2 * h)).norm(), 1e-4) << t;
      EXPECT_LT((b.j_WB - (c.a_WB - a.a_WB) / (2 * h)).norm(), 1e-3) << t;
      EXPECT_LT((b.s_WB - (c.j_WB - a.j_WB) / (2 * h)).norm(), 2e-2) << t;
      EXPECT_NEAR(b.d_yaw, (c.yaw - a.yaw) / (2 * h), 1e-5) << t;
      EXPECT_NEAR(b.dd_yaw, (c.d_yaw - a.d_yaw) / (2 * h), 1e-4) << t;
    }
  }
}

TEST_P(TrajectoryTest, StartsAtRestAndStaysOffTheGround) {
  const FlatReference start = Trajectory(GetParam()).At(0.0);
  EXPECT_LT(start.v_WB.norm() + start.a_WB.norm() + start.j_WB.norm() + start.s_WB.norm(), 1e-12);
  EXPECT_LT(std::abs(start.d_yaw) + std::abs(start.dd_yaw), 1e-12);
  for (double t = 0.0; t < 60.0; t += 0.05) {
    EXPECT_GT(Trajectory(GetParam()).At(t).p_WB.z(), 0.5);
  }
}

TEST_P(TrajectoryTest, AsksForRatesThatTurnItsAttitude) {
  const Trajectory trajectory(GetParam());
  const Eigen::Vector3d g_W(0.1, -0.2, -9.8);
  const double h = 1e-4;
  for (double t = 0.05; t < 9.0; t += 0.173) {
    const FlatAttitude a = FlatAttitudeOf(trajectory.At(t - h), g_W);
    const FlatAttitude b = FlatAttitudeOf(trajectory.At(t), g_W);
    const FlatAttitude c = FlatAttitudeOf(trajectory.At(t + h), g_W);
    EXPECT_LT((b.w_WB_B - Log(a.q_WB.conjugate() * c.q_WB) / (2 * h)).norm(), 1e-4) << t;
    EXPECT_LT((b.dw_WB_B - (c.w_WB_B - a.w_WB_B) / (2 * h)).norm(), 1e-2) << t;
  }
}

TEST_P(TrajectoryTest, IsTrackedByLargeAndSmallVehicles) {
  if (GetParam() == "steps") return;  // jumps by a metre: nobody can be there at once
  Vehicle heavy = test::NominalVehicle();
  heavy.name = "2 kg";
  heavy.mass_kg = 2.0;
  heavy.inertia_kg_m2 *= 4.0;
  heavy.parameters.clear();
  for (const Vehicle& vehicle : {test::NominalVehicle(), test::NanoVehicle(), heavy}) {
    const Figures figures = FiguresOf(Fly(vehicle, GetParam(), {}), GetParam(), vehicle);
    Print(vehicle.name, GetParam(), figures);
    EXPECT_LT(figures.tracking_rms, 0.05) << vehicle.name;
    EXPECT_LT(figures.tracking_max, 0.10) << vehicle.name;
    EXPECT_LT(figures.thrust_over_weight, 3.0) << vehicle.name;
  }
}

INSTANTIATE_TEST_SUITE_P(All, TrajectoryTest, ::testing::ValuesIn(Trajectory::Names()),
                         [](const auto& instance) { return instance.param; });

TEST(Trajectory, RefusesNamesItDoesNotKnow) {
  EXPECT_THROW(Trajectory("eight"), std::invalid_argument);
}

// model.md section 8: figure of eight with vertical and yaw motion, 6.1 m/s, 44 deg.
TEST(Simulator, FliesTheOctoOfTheModelDocument) {
  const Vehicle vehicle = test::NominalVehicle();
  const Figures figures = FiguresOf(Fly(vehicle, "octo", SimulationNoise::None()), "octo", vehicle);
  EXPECT_NEAR(figures.top_speed, 6.1, 0.1);
  EXPECT_NEAR(figures.tilt, 44.0, 1.0);
}

// model.md section 8: 8.4 m/s, 69 deg, rates to 2.5 rad/s.
TEST(Simulator, FliesAggressivelyAsTheModelDocument) {
  const Vehicle vehicle = test::NominalVehicle();
  const Figures figures =
      FiguresOf(Fly(vehicle, "aggressive", SimulationNoise::None()), "aggressive", vehicle);
  EXPECT_NEAR(figures.top_speed, 8.4, 0.2);
  EXPECT_NEAR(figures.tilt, 69.0, 1.5);
  EXPECT_GT(figures.rate, 2.5);
}

TEST(Simulator, FliesSixRotorsUnderTiltedGravity) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.rotors.clear();
  for (int j = 0; j < 6; ++j) {
    const double angle = j * 1.0471975511965976;
    const Eigen::Vector3d p_BP(0.14 * std::cos(angle), 0.14 * std::sin(angle), 0.0);
    vehicle.rotors.push_back({p_BP, j % 2 == 0 ? 1.0 : -1.0, 0.05});
  }
  const DynamicModel model(vehicle, vehicle.effects);
  ModelValues truth = DefaultTruth(model);
  truth[model.IndexOf("gravity.x")] = 0.03;
  truth[model.IndexOf("gravity.y")] = -0.02;
  const SimulatedFlight flight = Simulate(model, truth, SimulationOptions());
  EXPECT_LT(FiguresOf(flight, "octo", vehicle).tracking_rms, 0.05);
}

// How fast the rotors' share in yaw changes from one control to the next, and back [rad/s].
double YawChatter(double rotor_inertia) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.effects.push_back("rotor_reaction");
  const DynamicModel model(vehicle, vehicle.effects);
  ModelValues truth = DefaultTruth(model);
  truth[model.IndexOf("rotor_reaction.J_r")] = rotor_inertia;
  SimulationOptions options;
  options.log_rate_hz = 500.0;  // one control a sample
  options.duration_s = 8.0;
  const SimulatedFlight flight = Simulate(model, truth, options);
  const auto yaw_speed = [&](size_t k) {
    double sum = 0.0;
    for (int j = 0; j < vehicle.num_rotors(); ++j) {
      sum += vehicle.rotors[j].spin * flight.truth[k].rotor_speed[j];
    }
    return sum;
  };
  double square = 0.0;
  for (size_t k = 2; k < flight.truth.size(); ++k) {
    square += std::pow(yaw_speed(k) - 2.0 * yaw_speed(k - 1) + yaw_speed(k - 2), 2);
  }
  return std::sqrt(square / static_cast<double>(flight.truth.size()));
}

// Heavy rotors push the body faster than their torque turns it: a yaw gain made for light ones
// swings at half the control rate, and sensors that sample at that rate never see it.
TEST(Simulator, TurnsHeavyRotorsGently) { EXPECT_LT(YawChatter(3e-5), 1.5 * YawChatter(0.0)); }

TEST(Simulator, IsTheSameForTheSameSeed) {
  const Vehicle vehicle = test::NominalVehicle();
  const SimulatedFlight a = Fly(vehicle, "octo", {}, 3.0, 7);
  const SimulatedFlight b = Fly(vehicle, "octo", {}, 3.0, 7);
  const SimulatedFlight c = Fly(vehicle, "octo", {}, 3.0, 8);
  EXPECT_EQ(a.log.odometry.back().p_WS, b.log.odometry.back().p_WS);
  EXPECT_EQ(a.log.odometry.back().q_WS.coeffs(), b.log.odometry.back().q_WS.coeffs());
  EXPECT_EQ(a.log.rotors.back().speed, b.log.rotors.back().speed);
  EXPECT_NE(a.log.odometry.back().p_WS, c.log.odometry.back().p_WS);
  EXPECT_NE(a.truth.back().p_WB, c.truth.back().p_WB);
}

TEST(Simulator, KeepsTheFlightWhenASensorChanges) {
  const Vehicle vehicle = test::NominalVehicle();
  SimulationNoise noise;
  const SimulatedFlight a = Fly(vehicle, "octo", noise, 2.0);
  noise.position_m = 0.0;
  noise.imu = true;
  const SimulatedFlight b = Fly(vehicle, "octo", noise, 2.0);
  EXPECT_EQ(a.truth.back().p_WB, b.truth.back().p_WB);
  EXPECT_EQ(a.log.rotors.back().speed, b.log.rotors.back().speed);
  EXPECT_EQ(*a.log.odometry.back().v_WS, *b.log.odometry.back().v_WS);
}

TEST(Simulator, StampsWholePeriodsFromZero) {
  const SimulatedFlight flight = Fly(test::NominalVehicle(), "hover", {}, 1.0);
  ASSERT_EQ(flight.log.odometry.size(), 401u);
  ASSERT_EQ(flight.log.rotors.size(), 401u);
  ASSERT_EQ(flight.log.battery.size(), 401u);
  EXPECT_TRUE(flight.log.imu.empty());
  for (size_t k = 0; k < 401; ++k) {
    EXPECT_EQ(flight.log.odometry[k].stamp, static_cast<Stamp>(k) * 2500000);
    EXPECT_EQ(flight.log.rotors[k].stamp, flight.log.odometry[k].stamp);
    EXPECT_EQ(flight.truth[k].stamp, flight.log.odometry[k].stamp);
  }
}

TEST(Simulator, AddsNoiseOfTheStatedSize) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.odometry.p_BS.setZero();
  const SimulationNoise noise;
  const SimulatedFlight flight = Fly(vehicle, "octo", noise, 20.0);
  Eigen::Vector3d p(0, 0, 0), q = p, v = p, w = p;
  double rotor = 0.0, lag = 0.0;
  Eigen::Vector3d last = p;
  const double n = static_cast<double>(flight.truth.size());
  for (size_t k = 0; k < flight.truth.size(); ++k) {
    const TruthSample& truth = flight.truth[k];
    const OdometrySample& seen = flight.log.odometry[k];
    const Eigen::Vector3d d_p = seen.p_WS - truth.p_WB;
    p += d_p.cwiseAbs2() / n;
    q += Log(truth.q_WB.conjugate() * seen.q_WS).cwiseAbs2() / n;
    v += (*seen.v_WS - truth.v_WB).cwiseAbs2() / n;
    w += (*seen.w_WS_S - truth.w_WB_B).cwiseAbs2() / n;
    rotor += (flight.log.rotors[k].speed - truth.rotor_speed).squaredNorm() / (4.0 * n);
    lag += d_p.dot(last) / (3.0 * n);
    last = d_p;
  }
  for (int i = 0; i < 3; ++i) {
    EXPECT_NEAR(std::sqrt(p[i]), noise.position_m, 0.03 * noise.position_m);
    EXPECT_NEAR(std::sqrt(q[i]), noise.attitude_rad, 0.03 * noise.attitude_rad);
    EXPECT_NEAR(std::sqrt(v[i]), noise.velocity_m_s, 0.03 * noise.velocity_m_s);
    EXPECT_NEAR(std::sqrt(w[i]), noise.rate_rad_s, 0.03 * noise.rate_rad_s);
  }
  EXPECT_NEAR(std::sqrt(rotor), noise.rotor_speed_rad_s, 0.03 * noise.rotor_speed_rad_s);
  EXPECT_LT(std::abs(lag), 0.03 * noise.position_m * noise.position_m) << "white";
}

// The disturbance is held over 10 ms and scales with weight and arm.
TEST(Simulator, DisturbsInProportionToTheVehicle) {
  for (const Vehicle& vehicle : {test::NominalVehicle(), test::NanoVehicle()}) {
    const SimulatedFlight flight = Fly(vehicle, "hover", {}, 20.0);
    const double weight = vehicle.mass_kg / 0.75;
    double force = 0.0, torque = 0.0;
    int count = 0;
    for (size_t k = 0; k + 3 < flight.truth.size(); k += 4, ++count) {
      force += flight.truth[k].external_f_B.squaredNorm() / 3.0;
      torque += flight.truth[k].external_tau_Bcm_B.squaredNorm() / 3.0;
      EXPECT_EQ(flight.truth[k].external_f_B, flight.truth[k + 3].external_f_B);
    }
    EXPECT_NEAR(std::sqrt(force / count), 0.05 * weight, 0.003 * weight);
    const double torque_scale = 0.001 * weight * vehicle.ArmLength() / 0.14534;
    EXPECT_NEAR(std::sqrt(torque / count), torque_scale, 0.06 * torque_scale);
  }
}

TEST(Simulator, TruthObeysNewtonAndEuler) {
  const SimulatedFlight flight = Fly(test::NominalVehicle(), "aggressive", {}, 6.0);
  const Eigen::Vector3d p_BBcm(0.010, -0.006, 0.015);
  const double h = 0.0025;
  double force = 0.0, torque = 0.0;
  int count = 0;
  for (size_t k = 1; k + 1 < flight.truth.size(); ++k) {
    // Inside a period of the disturbance, away from its step.
    if (k % 4 == 0) continue;
    const TruthSample &a = flight.truth[k - 1], &b = flight.truth[k], &c = flight.truth[k + 1];
    const auto v_Bcm = [&](const TruthSample& s) {
      return Eigen::Vector3d(s.v_WB + s.q_WB * s.w_WB_B.cross(p_BBcm));
    };
    if ((k + 1) % 4 == 0) continue;
    const Eigen::Vector3d a_Bcm = (v_Bcm(c) - v_Bcm(a)) / (2 * h) + Eigen::Vector3d(0, 0, 9.81);
    const Eigen::Vector3d dw = (c.w_WB_B - a.w_WB_B) / (2 * h);
    const Eigen::Vector3d Iw = Eigen::Vector3d(2.5e-3, 2.1e-3, 4.3e-3).cwiseProduct(b.w_WB_B);
    const Eigen::Vector3d tau =
        Eigen::Vector3d(2.5e-3, 2.1e-3, 4.3e-3).cwiseProduct(dw) + b.w_WB_B.cross(Iw);
    force += (b.q_WB.conjugate() * (0.75 * a_Bcm) - b.f_B).squaredNorm();
    torque += (tau - b.tau_Bcm_B).squaredNorm();
    ++count;
  }
  EXPECT_LT(std::sqrt(force / count), 0.03);
  EXPECT_LT(std::sqrt(torque / count), 0.001);
}

TEST(Simulator, SeesTheSensorFrameMove) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.odometry.q_BS = Exp({0.2, -0.4, 1.0});
  const SimulatedFlight flight = Fly(vehicle, "aggressive", SimulationNoise::None(), 6.0);
  const auto& odometry = flight.log.odometry;
  const double h = 0.0025;
  for (size_t k = 1; k + 1 < odometry.size(); k += 37) {
    const Eigen::Vector3d v = (odometry[k + 1].p_WS - odometry[k - 1].p_WS) / (2 * h);
    EXPECT_LT((v - *odometry[k].v_WS).norm(), 1e-3);
    const Eigen::Vector3d w =
        Log(odometry[k - 1].q_WS.conjugate() * odometry[k + 1].q_WS) / (2 * h);
    EXPECT_LT((w - *odometry[k].w_WS_S).norm(), 1e-2);
  }
}

TEST(Simulator, ImuFeelsThrustAtItsPlace) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.imu = vehicle.odometry;
  vehicle.imu->q_BS = Exp({0.1, 0.2, -0.3});
  SimulationNoise noise = SimulationNoise::None();
  noise.imu = true;
  noise.accelerometer_bias = {0.1, 0.2, 0.3};
  noise.gyro_bias = {0.01, 0.02, 0.03};
  const SimulatedFlight flight = Fly(vehicle, "aggressive", noise, 5.0);
  ASSERT_EQ(flight.log.imu.size(), flight.log.odometry.size());
  const auto& odometry = flight.log.odometry;
  const double h = 0.0025;
  double sum = 0.0;
  int count = 0;
  for (size_t k = 1; k + 1 < odometry.size(); ++k, ++count) {
    const Eigen::Vector3d a = (*odometry[k + 1].v_WS - *odometry[k - 1].v_WS) / (2 * h);
    const Eigen::Quaterniond q_WI = flight.truth[k].q_WB * vehicle.imu->q_BS;
    const Eigen::Vector3d expected =
        q_WI.conjugate() * (a + Eigen::Vector3d(0, 0, 9.81)) + noise.accelerometer_bias;
    sum += (*flight.log.imu[k].specific_force_I - expected).squaredNorm();
    const Eigen::Vector3d gyro = vehicle.imu->q_BS.conjugate() * flight.truth[k].w_WB_B;
    EXPECT_LT((*flight.log.imu[k].gyro_I - gyro - noise.gyro_bias).norm(), 1e-9);
  }
  EXPECT_LT(std::sqrt(sum / count), 0.03);
}

SimulatedFlight FlyFromTheGround(const SimulationNoise& noise) {
  const Vehicle vehicle = test::NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = "octo";
  options.duration_s = 10.0;
  options.ground_s = 2.0;
  return Simulate(model, DefaultTruth(model), options, noise);
}

TEST(Simulator, StandsThenTakesOff) {
  const SimulatedFlight flight = FlyFromTheGround({});
  EXPECT_TRUE(flight.truth.front().on_ground);
  EXPECT_EQ(flight.truth.front().rotor_speed.norm(), 0.0);
  double released_s = 0.0;
  for (const TruthSample& at : flight.truth) {
    if (at.on_ground) released_s = ToSeconds(at.stamp);
    EXPECT_GT(at.p_WB.z(), -0.02);
  }
  EXPECT_GT(released_s, 1.9);
  EXPECT_LT(released_s, 3.0);
  const Trajectory trajectory("octo", 2.0);
  EXPECT_LT((flight.truth.back().p_WB - trajectory.At(10.0).p_WB).norm(), 0.2);
}

// The ground bears what thrust does not: its springs give back the sink of the vehicle at rest in
// proportion, behind by 2 zeta / omega = 21 ms of a rise of 2.7 mm/s at most.
TEST(Simulator, StandsOnTheFeetOfItsWorld) {
  const double weight = 0.75 * 9.81, sink = WorldOptions().ground_static_sink_m;
  for (const TruthSample& at : FlyFromTheGround(SimulationNoise::None()).truth) {
    if (ToSeconds(at.stamp) >= 2.0) break;
    const double thrust = 1.5e-6 * at.rotor_speed.squaredNorm();
    EXPECT_TRUE(at.on_ground);
    EXPECT_NEAR(at.p_WB.z(), sink * thrust / weight, 6e-5) << ToSeconds(at.stamp);
    EXPECT_LT(at.p_WB.head<2>().norm(), 3e-4);
    EXPECT_NEAR(at.f_B.norm(), weight, 0.01) << ToSeconds(at.stamp);
    EXPECT_NEAR(at.external_f_B.z(), weight - thrust, 0.01) << ToSeconds(at.stamp);
  }
}

// The world knows what the options say, whatever the rate.
TEST(Simulator, MakesAWorldOfItsOptions) {
  SimulationOptions options;
  SimulationNoise noise;
  noise.imu = true;
  std::string error;
  for (const double step_s : {2e-5, 0.0003, 0.0005, 0.001}) {
    options.step_s = step_s;
    for (double rate_hz = 1.0; rate_hz <= 1000.0; rate_hz *= 1.0137) {
      options.log_rate_hz = std::min(rate_hz, 1000.0);
      const WorldOptions world = WorldOf(options, noise);
      ASSERT_TRUE(world.IsValid(&error)) << rate_hz << ": " << error;
      ASSERT_LE(world.step_s, step_s * (1.0 + 1e-9));
    }
  }
  options.log_rate_hz = 400.0;
  EXPECT_FALSE(WorldOf(options, noise).ground);
  options.ground_s = 1.0;
  const WorldOptions world = WorldOf(options, noise);
  EXPECT_TRUE(world.ground);
  EXPECT_EQ(world.imu_rate_hz, 400.0);
  noise.imu = false;
  EXPECT_EQ(WorldOf(options, noise).imu_rate_hz, 0.0);
}

// At a rate whose period is no whole number of steps in nanoseconds, stamps are still whole
// periods.
TEST(Simulator, StampsWholePeriodsAtAnyRate) {
  const Vehicle vehicle = test::NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.duration_s = 20.0;
  options.log_rate_hz = 300.0;
  const SimulatedFlight flight = Simulate(model, DefaultTruth(model), options);
  ASSERT_EQ(flight.truth.size(), 6001u);
  for (size_t k = 0; k < flight.truth.size(); ++k) {
    ASSERT_EQ(flight.truth[k].stamp, static_cast<Stamp>(k) * 3333333);
    ASSERT_EQ(flight.log.odometry[k].stamp, flight.truth[k].stamp);
    ASSERT_EQ(flight.log.rotors[k].stamp, flight.truth[k].stamp);
  }
}

TEST(Simulator, EmptiesItsBatteryWithTime) {
  SimulationNoise noise;
  noise.battery_start_V = 0.5;
  noise.battery_slope_V_s = -0.1;  // empty after 5 s, and still it flies
  const SimulatedFlight flight = Fly(test::NominalVehicle(), "hover", noise, 8.0);
  for (const BatterySample& sample : flight.log.battery) {
    EXPECT_NEAR(sample.voltage_V, std::max(0.0, 0.5 - 0.1 * ToSeconds(sample.stamp)), 1e-12);
  }
}

TEST(Simulator, DelaysRotorSpeeds) {
  SimulationNoise noise = SimulationNoise::None();
  noise.rotor_delay_s = 0.005;
  const SimulatedFlight flight = Fly(test::NominalVehicle(), "aggressive", noise, 3.0);
  for (size_t k = 2; k < flight.truth.size(); k += 50) {
    EXPECT_LT((flight.log.rotors[k].speed - flight.truth[k - 2].rotor_speed).norm(), 1e-9);
  }
}

TEST(Simulator, RefusesWhatItCannotFly) {
  const Vehicle vehicle = test::NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = "loop";
  EXPECT_THROW(Simulate(model, DefaultTruth(model), options), std::invalid_argument);
  std::string error;
  EXPECT_FALSE(options.IsValid(&error));
  for (const std::string& name : Trajectory::Names()) {
    EXPECT_NE(error.find(name), std::string::npos) << name;
  }
  options.trajectory = "octo";
  options.step_s = 0.01;
  EXPECT_THROW(Simulate(model, DefaultTruth(model), options), std::invalid_argument);
  options.step_s = 0.001;
  SimulationNoise noise;
  noise.position_m = -1.0;
  EXPECT_THROW(Simulate(model, DefaultTruth(model), options, noise), std::invalid_argument);
  ModelValues broken = DefaultTruth(model);
  broken[model.IndexOf("viscous_torque.b_x")] = 10.0;  // feeds energy in
  options.duration_s = 20.0;
  options.trajectory = "aggressive";
  broken[model.IndexOf("inertia.x")] = 1e3;  // no pilot rolls this
  EXPECT_THROW(Simulate(model, broken, options), std::runtime_error);
}

TEST(TruthVehicle, IsTheVehicleOfTheModelDocument) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.parameters.erase("thrust.k_f");
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(model);
  const auto value = [&](const std::string& name) { return truth[model.IndexOf(name)]; };
  EXPECT_NEAR(value("thrust.k_f"), 1.5e-6, 1e-12);
  EXPECT_EQ(value("rotor_torque.k_m"), 2.1e-8);
  EXPECT_NEAR(value("drag.d_x"), -0.30, 1e-12);
  EXPECT_NEAR(value("viscous_torque.b_z"), -1.5e-3, 1e-12);
  EXPECT_NEAR(value("centre_of_gravity.y"), -0.006, 1e-6);
  EXPECT_NEAR(value("hvt.k_h"), 0.007, 1e-12);
  EXPECT_EQ(value("inertia.x"), 2.5e-3);
  EXPECT_EQ(value("gravity.x"), 0.0);
}

TEST(TruthVehicle, ScalesWithTheVehicleAndHeedsItsFile) {
  Vehicle vehicle = test::NanoVehicle();
  vehicle.parameters["drag.d_y"].value = -0.011;
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(model);
  EXPECT_EQ(truth[model.IndexOf("thrust.k_f")], 3.7e-8);
  EXPECT_EQ(truth[model.IndexOf("drag.d_y")], -0.011);
  EXPECT_NEAR(truth[model.IndexOf("drag.d_x")], -0.30 * 0.037 / 0.75, 1e-12);
}

}  // namespace
}  // namespace odmc
