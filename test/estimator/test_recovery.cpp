// Simulated flights of known truth: does it come back, within its sigma, from wrong starts, and
// from whatever sensors there are?

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "odmc/actuator/free_run.h"
#include "odmc/analysis/replay.h"
#include "odmc/bench/recovery.h"
#include "odmc/bench/undeclared.h"
#include "odmc/bench/undeclared_recording.h"
#include "odmc/identification/flight_actuator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_actuator.h"

namespace odmc {
namespace {

struct Flight {
  std::optional<DynamicModel> model;
  ModelValues truth;
  FlightLog log;
};

Flight Fly(const Vehicle& vehicle, double duration_s, SimulationNoise noise = {},
           double ground_s = 0.0) {
  Flight flight;
  flight.model.emplace(vehicle, vehicle.effects);
  flight.truth = DefaultTruth(*flight.model);
  SimulationOptions options;
  options.duration_s = duration_s;
  options.ground_s = ground_s;
  flight.log = Simulate(*flight.model, flight.truth, options, noise).log;
  return flight;
}

ReplayResult Estimate(const Flight& flight, const EstimatorOptions& options = OfflineOptions()) {
  Estimator estimator(&*flight.model, options, true);
  return Replay(flight.log, &estimator);
}

void ExpectNear(const Flight& flight, const ReplayResult& result, const std::string& name,
                double relative) {
  const int k = flight.model->IndexOf(name);
  ASSERT_TRUE(result.last);
  EXPECT_NEAR(result.last->values[k], flight.truth[k], relative * std::abs(flight.truth[k]))
      << name;
}

Vehicle FreeVehicle() { return RecoveryVehicle(test::NominalVehicle()); }

TEST(Recovery, TruthComesBackFromWrongStartsInThreeFlights) {
  RecoveryOptions options;
  options.simulation.duration_s = 20.0;
  options.seeds = 3;
  options.jobs = 2;
  const Recovery recovery = Recover(FreeVehicle(), options);
  EXPECT_GE(recovery.pooled_coverage_3sigma, 0.95);
  const std::map<std::string, double> relative = {
      {"thrust.k_f", 0.005}, {"inertia.x", 0.08}, {"inertia.y", 0.08}, {"inertia.z", 0.05},
      {"drag.d_x", 0.05},    {"drag.d_y", 0.05},  {"drag.d_z", 0.05},  {"hvt.k_h", 0.15}};
  const std::map<std::string, double> absolute = {{"centre_of_gravity.x", 5e-4},
                                                  {"centre_of_gravity.y", 5e-4},
                                                  {"gravity.x", 0.2 * M_PI / 180.0},
                                                  {"gravity.y", 0.2 * M_PI / 180.0}};
  int checked = 0;
  for (const ParameterRecovery& p : recovery.parameters) {
    if (relative.count(p.full_name) > 0) {
      ASSERT_TRUE(p.median_relative_error) << p.full_name;
      EXPECT_LT(*p.median_relative_error, relative.at(p.full_name)) << p.full_name;
      ++checked;
    }
    if (absolute.count(p.full_name) > 0) {
      EXPECT_LT(p.median_error, absolute.at(p.full_name)) << p.full_name;
      ++checked;
    }
  }
  EXPECT_EQ(checked, 12);
}

// Before regressors' noise was known of, pooled coverage was 0.78 in hover, 0.90 in yaw, and a
// circle's inertia came out 12 sigma off.
TEST(Recovery, SigmasHoldWhereAFlightShowsLittle) {
  for (const std::string trajectory : {"hover", "yaw", "circle"}) {
    RecoveryOptions options;
    options.simulation.trajectory = trajectory;
    options.simulation.duration_s = 20.0;
    options.estimator = OfflineOptions();
    options.seeds = 3;
    options.jobs = 2;
    const Recovery recovery = Recover(FreeVehicle(), options);
    EXPECT_GE(recovery.pooled_coverage_3sigma, 0.95) << trajectory;
    for (const ParameterRecovery& p : recovery.parameters) {
      EXPECT_LT(p.median_error_over_sigma, 2.5) << trajectory << ", " << p.full_name;
      if (trajectory == "hover" && p.full_name.find("drag") == 0) {
        EXPECT_EQ(p.observable_share, 0.0) << p.full_name;
      }
      if (trajectory == "yaw" && p.full_name == "viscous_torque.b_z") {
        EXPECT_EQ(p.observable_share, 1.0);
        EXPECT_LT(*p.median_relative_error, 0.05);
      }
    }
  }
}

// Motion capture beside an IMU. With body rates from differences of the noisy attitudes, inertia
// was not learned at all, or its sigma was ten times as large.
TEST(Recovery, InertiaIsLearnedFromPosesWithoutTwistBesideAGyro) {
  Flight flight;
  Vehicle vehicle = FreeVehicle();
  vehicle.imu = vehicle.odometry;
  flight.model.emplace(vehicle, vehicle.effects);
  flight.truth = DefaultTruth(*flight.model);
  SimulationOptions simulation;
  simulation.trajectory = "aggressive";
  simulation.duration_s = 20.0;
  SimulationNoise noise;
  noise.imu = true;
  flight.log = Simulate(*flight.model, flight.truth, simulation, noise).log;
  for (OdometrySample& sample : flight.log.odometry) {
    sample.v_WS.reset();
    sample.w_WS_S.reset();
  }
  const ReplayResult result = Estimate(flight);
  ASSERT_TRUE(result.last);
  for (const char* name : {"inertia.x", "inertia.y", "inertia.z"}) {
    const int k = flight.model->IndexOf(name);
    const double error = result.last->values[k] - flight.truth[k];
    EXPECT_LT(result.last->sigma[k], 0.03 * flight.truth[k]) << name;
    EXPECT_LT(std::abs(error), 3.5 * result.last->sigma[k]) << name;
  }
}

TEST(Recovery, StartOfTheThrustCoefficientDoesNotMatter) {
  for (const double factor : {0.5, 2.0}) {
    RecoveryOptions options;
    options.simulation.duration_s = 6.0;
    options.estimator = OfflineOptions();
    options.seeds = 1;
    options.start_thrust_factor = factor;
    for (const ParameterRecovery& p : Recover(FreeVehicle(), options).parameters) {
      if (p.full_name != "thrust.k_f") continue;
      EXPECT_LT(*p.median_relative_error, 0.005) << factor;
    }
  }
}

/// Where the gates open and the window first fills, at a keyframe rate that is not the default.
TEST(Recovery, NoFlightDivergesAtFewKeyframes) {
  for (int seed = 1; seed <= 6; ++seed) {
    Flight flight;
    const Vehicle vehicle = FreeVehicle();
    flight.model.emplace(vehicle, vehicle.effects);
    flight.truth = DefaultTruth(*flight.model);
    SimulationOptions simulation;
    simulation.trajectory = "aggressive";
    simulation.duration_s = 8.0;
    simulation.seed = seed;
    flight.log = Simulate(*flight.model, flight.truth, simulation, {}).log;
    EstimatorOptions options = OfflineOptions();
    options.keyframe_rate_hz = 40.0;
    const ReplayResult result = Estimate(flight, options);
    SCOPED_TRACE(seed);
    for (const char* name : {"thrust.k_f", "inertia.x", "inertia.y", "inertia.z"}) {
      ExpectNear(flight, result, name, 0.03);
    }
  }
}

TEST(Estimator, UsesAnImuWhereverItSits) {
  Vehicle vehicle = FreeVehicle();
  SensorMount imu;
  imu.p_BS = {0.04, -0.03, 0.02};
  imu.q_BS = Eigen::Quaterniond(Eigen::AngleAxisd(0.5 * M_PI, Eigen::Vector3d::UnitZ()));
  vehicle.imu = imu;
  SimulationNoise noise;
  noise.imu = true;
  noise.gyro_noise_density = 5e-4;
  noise.accelerometer_noise_density = 5e-3;
  noise.gyro_bias = {0.02, -0.01, 0.015};
  noise.accelerometer_bias = {0.1, -0.05, 0.08};
  Flight flight = Fly(vehicle, 15.0, noise);
  for (OdometrySample& sample : flight.log.odometry) sample.w_WS_S.reset();
  const ReplayResult result = Estimate(flight);
  ExpectNear(flight, result, "thrust.k_f", 0.01);
  ExpectNear(flight, result, "inertia.x", 0.08);
  ExpectNear(flight, result, "inertia.y", 0.08);
  ExpectNear(flight, result, "drag.d_x", 0.05);
}

TEST(Estimator, WorksFromPosesAlone) {
  SimulationNoise noise;
  noise.position_m = 5e-4;
  noise.attitude_rad = 1e-3;
  Flight flight = Fly(FreeVehicle(), 15.0, noise);
  for (OdometrySample& sample : flight.log.odometry) {
    sample.w_WS_S.reset();
    sample.v_WS.reset();
  }
  const ReplayResult result = Estimate(flight);
  ExpectNear(flight, result, "thrust.k_f", 0.01);
  ExpectNear(flight, result, "drag.d_x", 0.08);
}

TEST(Estimator, LearnsNothingOnTheGroundAndCountsTheTime) {
  Flight flight = Fly(FreeVehicle(), 6.0, {}, 3.0);
  flight.log.odometry.erase(
      std::remove_if(flight.log.odometry.begin(), flight.log.odometry.end(),
                     [](const OdometrySample& s) { return ToSeconds(s.stamp) > 2.5; }),
      flight.log.odometry.end());
  const ReplayResult result = Estimate(flight);
  EXPECT_FALSE(result.last) << "an update while standing";
  EXPECT_GT(result.counters.on_ground_s, 2.0);
}

TEST(Estimator, SurvivesGapsAndNumbersThatAreNotFinite) {
  Flight flight = Fly(FreeVehicle(), 12.0);
  auto& odometry = flight.log.odometry;
  odometry.erase(odometry.begin() + 2000, odometry.begin() + 2300);
  odometry[1000].p_WS.x() = std::numeric_limits<double>::quiet_NaN();
  flight.log.rotors[1500].speed[2] = std::numeric_limits<double>::infinity();
  auto& rotors = flight.log.rotors;
  rotors.erase(rotors.begin() + 3000, rotors.begin() + 3100);
  const ReplayResult result = Estimate(flight);
  EXPECT_GE(result.counters.gaps, 2);
  EXPECT_EQ(result.stream_counters.not_finite, 2);
  ExpectNear(flight, result, "thrust.k_f", 0.005);
  for (const HistoryRow& row : result.history) {
    ASSERT_TRUE(row.values.allFinite() && row.sigma.allFinite());
  }
}

TEST(Estimator, OneBadReadingOfASensorChangesNothing) {
  Flight flight = Fly(FreeVehicle(), 12.0);
  const ReplayResult sound = Estimate(flight);
  flight.log.rotors[2100].speed[1] = 9000.0;
  flight.log.rotors[2500].speed[0] = 0.0;
  const ReplayResult glitched = Estimate(flight);
  EXPECT_EQ(glitched.stream_counters.glitches, 2);
  const Eigen::VectorXd moved = glitched.last->values - sound.last->values;
  for (int i = 0; i < moved.size(); ++i) {
    if (!flight.model->parameters()[i].estimated) continue;
    EXPECT_LT(std::abs(moved[i]), 0.1 * sound.last->sigma[i])
        << flight.model->parameters()[i].full_name;
  }
  // Without one pose the keyframes after it fall on others: as far off as noise goes.
  flight.log.odometry[2300].w_WS_S->x() += 40.0;
  const ReplayResult other = Estimate(flight);
  EXPECT_EQ(other.stream_counters.glitches, 3);
  ExpectNear(flight, other, "inertia.x", 0.03);
}

// A relabelled marker, a reset heading: the position goes on as if nothing had been.
TEST(Estimator, AnAttitudeThatJumpsBreaksTheChain) {
  for (const bool with_rates : {true, false}) {
    Flight flight = Fly(FreeVehicle(), 12.0);
    auto& odometry = flight.log.odometry;
    if (!with_rates) {
      for (OdometrySample& sample : odometry) sample.w_WS_S.reset();
    }
    ASSERT_EQ(Estimate(flight).counters.jumps, 0);
    const Eigen::Quaterniond turn(Eigen::AngleAxisd(0.35, Eigen::Vector3d::UnitZ()));
    const size_t at = odometry.size() / 2;
    for (size_t i = at; i < odometry.size(); ++i) odometry[i].q_WS = turn * odometry[i].q_WS;
    // Without rates the interval after it looks like one, too.
    EXPECT_EQ(Estimate(flight).counters.jumps, with_rates ? 1 : 2);
  }
}

TEST(Estimator, AHeldPoseIsOneMeasurement) {
  Flight flight = Fly(FreeVehicle(), 12.0);
  auto& odometry = flight.log.odometry;
  std::vector<OdometrySample> once;
  for (size_t i = 0; i < odometry.size(); ++i) {
    const Stamp stamp = odometry[i].stamp;
    if (i % 4 == 0) once.push_back(odometry[i]);
    odometry[i] = odometry[i / 4 * 4];
    odometry[i].stamp = stamp;
  }
  const ReplayResult held = Estimate(flight);
  odometry = once;
  const ReplayResult alone = Estimate(flight);
  EXPECT_EQ(held.counters.jumps, alone.counters.jumps);
  EXPECT_GT(held.stream_counters.repeated_pose, 2 * static_cast<long>(once.size()));
  const Eigen::VectorXd moved = held.last->values - alone.last->values;
  for (int i = 0; i < moved.size(); ++i) {
    if (!flight.model->parameters()[i].estimated) continue;
    EXPECT_LT(std::abs(moved[i]), 0.5 * alone.last->sigma[i])
        << flight.model->parameters()[i].full_name;
  }
}

TEST(Estimator, KeyframesMayBeFartherApartThanAGapIsLong) {
  Flight flight = Fly(FreeVehicle(), 12.0);
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = 10.0;
  const ReplayResult result = Estimate(flight, options);
  EXPECT_EQ(result.counters.gaps, 0);
  ExpectNear(flight, result, "thrust.k_f", 0.01);
}

TEST(EstimatorOptions, NamesWhatIsOutOfRange) {
  const auto refused = [](const std::function<void(EstimatorOptions*)>& change) {
    EstimatorOptions options;
    change(&options);
    std::string error;
    return options.IsValid(&error) ? "valid" : error;
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(refused([](EstimatorOptions*) {}), "valid");
  EXPECT_EQ(refused([&](EstimatorOptions* o) { o->position_noise_m = nan; }),
            "position_noise_m must be a number and not negative");
  EXPECT_EQ(refused([](EstimatorOptions* o) { o->velocity_noise_m_s = -1.0; }),
            "velocity_noise_m_s must be a number and not negative");
  EXPECT_EQ(refused([](EstimatorOptions* o) { o->inertia_gate_r_squared = 2.0; }),
            "inertia_gate_r_squared must be in [0, 1]");
  EXPECT_EQ(refused([](EstimatorOptions* o) { o->max_gap_s = 0.0; }), "max_gap_s must be positive");
  EXPECT_EQ(refused([&](EstimatorOptions* o) { o->phases.near_ground_m = nan; }),
            "near_ground_m must be a number and not negative");
  EXPECT_EQ(refused([](EstimatorOptions* o) { o->phases.landed_thrust_ratio = 100.0; }),
            "landed_thrust_ratio must be below 1");
}

TEST(Estimator, EulerFormIsCloseButWorseInDrag) {
  const Flight flight = Fly(FreeVehicle(), 10.0);
  EstimatorOptions euler = OfflineOptions();
  euler.dynamics_form = "euler";
  const ReplayResult midpoint = Estimate(flight), other = Estimate(flight, euler);
  ExpectNear(flight, other, "thrust.k_f", 0.01);
  const int d_x = flight.model->IndexOf("drag.d_x");
  const double truth = flight.truth[d_x];
  EXPECT_LT(std::abs(midpoint.last->values[d_x] - truth),
            std::abs(other.last->values[d_x] - truth));
}

// ---- Actuators: what `simulate` records is what `calibrate --rotor-speed-from commands` takes
// ----

TEST(ActuatorFlight, RecordsCommandsThatExplainTheSpeeds) {
  const Vehicle vehicle = test::VehicleWithActuator();
  for (const double ground_s : {0.0, 2.0}) {
    const Flight flight = Fly(vehicle, 10.0, SimulationNoise::None(), ground_s);
    EXPECT_LT(flight.log.battery.back().voltage_V, flight.log.battery.front().voltage_V - 0.05);
    ASSERT_EQ(flight.log.commands.size(), flight.log.rotors.size());
    SpeedPredictor rotor(vehicle.actuator->motors.front());
    double largest = 0.0, top = 0.0;
    for (size_t i = 0; i < flight.log.rotors.size(); ++i) {
      const double t_s = ToSeconds(flight.log.commands[i].stamp);
      rotor.Command(t_s, flight.log.commands[i].throttle[2], flight.log.battery[i].voltage_V);
      const double measured = flight.log.rotors[i].speed[2];
      if (i == 0) rotor.StartAt(t_s, measured);
      largest =
          std::max(largest, std::abs(rotor.At(ToSeconds(flight.log.rotors[i].stamp)) - measured));
      top = std::max(top, measured);
    }
    EXPECT_LT(largest, 0.1);  // a command's voltage is held, the world's goes on
    EXPECT_GT(top, 1100.0);
  }
  EXPECT_TRUE(Fly(test::NominalVehicle(), 1.0).log.commands.empty());
}

// No bench: an ordinary flight tells time constant, delay and what voltage does.
TEST(ActuatorFlight, ItsLogGivesTheActuatorBack) {
  const Vehicle vehicle = test::VehicleWithActuator();
  const Motor& truth = vehicle.actuator->motors.front();
  const ActuatorFit fit = IdentifyActuator({BenchRunOf(Fly(vehicle, 20.0).log)});
  ASSERT_EQ(fit.motors.size(), 4u);
  const double speed = fit.common.error.mean_speed_rad_s;
  for (const MotorFit& motor : fit.motors) {
    EXPECT_NEAR(motor.motor.delay_s, truth.delay_s, 5e-4);
    EXPECT_NEAR(motor.motor.dynamics.TimeConstant(speed) / truth.dynamics.TimeConstant(speed), 1.0,
                0.03);
    for (const double voltage : {15.0, 16.0}) {
      EXPECT_NEAR(motor.motor.SteadySpeed(0.4, voltage) / truth.SteadySpeed(0.4, voltage), 1.0,
                  0.02);
    }
  }
}

TEST(ActuatorFlight, ThrustCoefficientComesBackFromCommands) {
  const Vehicle vehicle = test::VehicleWithActuator();
  const Flight flight = Fly(vehicle, 25.0);
  const int k_f = flight.model->IndexOf("thrust.k_f");
  const double from_sensors = Estimate(flight).last->values[k_f];
  for (const double gain : {0.99, 1.01}) {
    Flight seen;
    seen.model.emplace(vehicle, vehicle.effects);
    seen.log = flight.log;
    SettleRotors(test::WithGain(*vehicle.actuator, gain), 4, true, &seen.log);
    const ReplayResult replay = Estimate(seen);
    const double from_commands = replay.last->values[k_f], sigma = replay.last->sigma[k_f];
    EXPECT_NEAR(from_commands / from_sensors, 1.0, 0.03) << gain;
    // A wrong scale is in the sigma, which says so without having seen a sensor.
    EXPECT_LT(std::abs(from_commands - from_sensors), 3.0 * sigma) << gain;
    EXPECT_LT(sigma, 0.05 * from_commands);
  }
}

// Drag times the height of the centre of mass is what torque shows of either. In a window of a
// second the early keyframes left with guesses of both, and the estimate went from beside the truth
// to a valley with the hub drag's sign turned around.
TEST(Recovery, KeepsOutOfTheValleyBesideTheTruth) {
  UndeclaredPlan plan;
  plan.number = 152;
  plan.kind = UndeclaredKind::kOneEffect;
  plan.effects = {"rotor_drag"};
  plan.strength = "strong";
  plan.share = 0.8;
  plan.vehicle = 2;
  plan.trajectory = "octo";
  plan.seed = 121152;
  const UndeclaredFlight flight = MakeUndeclared(plan);
  Vehicle vehicle = flight.declared;
  vehicle.effects.push_back("rotor_drag");
  const std::map<std::string, double> start = {{"thrust.k_f", 2.81757e-07},
                                               {"drag.d_x", -0.0950},
                                               {"drag.d_y", -0.0851},
                                               {"drag.d_z", -0.0694},
                                               {"viscous_torque.b_x", -3.14e-4},
                                               {"viscous_torque.b_y", -3.40e-4},
                                               {"viscous_torque.b_z", -1.30e-4},
                                               {"hvt.k_h", 0.00200689},
                                               {"centre_of_gravity.x", 0.00588599},
                                               {"centre_of_gravity.y", -0.00293113},
                                               {"centre_of_gravity.z", 0.00734855},
                                               {"gravity.x", 0.00605693},
                                               {"gravity.y", 0.00452253},
                                               {"rotor_drag.k_d", 5.0e-6}};
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = 50.0;
  for (const double scale : {0.9, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1}) {
    for (const auto& [name, value] : start) vehicle.parameters[name].value = scale * value;
    const DynamicModel model(vehicle, vehicle.effects);
    Estimator estimator(&model, options, true);
    const Snapshot last = *Replay(flight.log, &estimator).last;
    for (const char* name : {"rotor_drag.k_d", "drag.d_x", "drag.d_y", "centre_of_gravity.z"}) {
      const int k = model.IndexOf(name);
      const double error = last.values[k] - flight.truth.Find(name)->value;
      EXPECT_LT(std::abs(error), 4.0 * last.sigma[k])
          << name << " = " << last.values[k] << ", " << scale;
    }
  }
}

// What drags in the plane through the centre of mass has no moment, so that nothing says how high
// the centre of mass is; from a start without it the estimate must not stay there.
TEST(Recovery, RotorDragWithoutMomentIsFoundFromNothing) {
  for (const int seed : {1, 2, 3}) {
    Vehicle vehicle = UndeclaredVehicles()[static_cast<size_t>(seed)];
    vehicle.effects.emplace_back("rotor_drag");
    const RecordingConditions conditions =
        DrawRecording(RecordingModel::kIndependent, seed, vehicle);
    vehicle.odometry = conditions.odometry;
    const DynamicModel model(vehicle, vehicle.effects);
    ModelValues truth = DefaultTruth(model);
    const int k_d = model.IndexOf("rotor_drag.k_d");
    truth[k_d] = model.parameters()[k_d].spec.prior_sigma;
    truth[model.IndexOf("rotor_drag.k_c")] = truth[model.IndexOf("rotor_drag.k_y")] = 0.0;
    truth[model.IndexOf("centre_of_gravity.z")] = -0.05 * vehicle.ArmLength();
    SimulationOptions options;
    options.duration_s = 45.0;
    options.seed = seed;
    options.log_rate_hz = conditions.log_rate_hz;
    SimulationNoise noise = conditions.noise;
    noise.imu = false;
    FlightLog log = Simulate(model, truth, options, noise).log;
    Degrade(conditions, seed, &log);
    EstimatorOptions patient = OfflineOptions();
    patient.keyframe_rate_hz = 50.0;
    Estimator estimator(&model, patient, true);
    const Snapshot last = *Replay(log, &estimator).last;
    for (const char* name : {"rotor_drag.k_d", "rotor_drag.k_c", "rotor_drag.k_y", "drag.d_x"}) {
      const int k = model.IndexOf(name);
      EXPECT_LT(std::abs(last.values[k] - truth[k]), 4.0 * last.sigma[k])
          << seed << ": " << name << " = " << last.values[k] << ", truth " << truth[k];
    }
  }
}

}  // namespace
}  // namespace odmc
