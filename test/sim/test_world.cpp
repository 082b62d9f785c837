#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <stdexcept>

#include "odmc/actuator/speed_predictor.h"
#include "odmc/math/so3.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/sim/world.h"
#include "support/test_actuator.h"

namespace odmc {
namespace {

// Nothing random, no delay, an endless stiff battery.
WorldOptions Quiet() {
  WorldOptions options;
  options.disturbance_force_N = options.disturbance_torque_Nm = 0.0;
  options.position_noise_m = options.attitude_noise_rad = 0.0;
  options.velocity_noise_m_s = options.rate_noise_rad_s = 0.0;
  options.gyro_noise_density = options.accelerometer_noise_density = 0.0;
  options.rotor_noise_rad_s = options.odometry_delay_s = 0.0;
  options.battery_resistance_ohm = 0.0;
  options.battery_capacity_As = 1e12;
  return options;
}

template <typename T>
std::vector<T> Only(const std::vector<Sample>& samples) {
  std::vector<T> kept;
  for (const Sample& sample : samples) {
    if (const T* wanted = std::get_if<T>(&sample)) kept.push_back(*wanted);
  }
  return kept;
}

// A model with its true values, and worlds of it.
struct Setting {
  explicit Setting(const Vehicle& vehicle = test::NominalVehicle(),
                   const std::vector<std::string>& effects = test::PaperEffects())
      : model(vehicle, effects), values(DefaultTruth(model)) {}

  World In(const WorldOptions& options, int seed = 1) const {
    return World(model, values, options, seed);
  }
  RotorVector All(double speed) const {
    return RotorVector::Constant(model.vehicle().num_rotors(), speed);
  }
  double k_f() const { return values[model.IndexOf("thrust.k_f")]; }
  double k_m() const { return values[model.IndexOf("rotor_torque.k_m")]; }

  DynamicModel model;
  ModelValues values;
};

void RunFor(World* world, double duration_s) {
  const Stamp end = world->now() + FromSeconds(duration_s);
  while (world->now() < end) world->Step();
}

Vehicle HeavyVehicle() {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.name = "2 kg";
  vehicle.mass_kg = 2.0;
  vehicle.inertia_kg_m2 *= 4.0;
  vehicle.parameters.clear();
  return vehicle;
}

Eigen::Vector3d AccelerationOfBcm_W(const World& world) {
  const TruthSample truth = world.Truth();
  return truth.q_WB * truth.f_B / world.mass() + world.properties().g_W;
}

// Of motion and height.
double Energy(const World& world) {
  const TruthSample truth = world.Truth();
  const BodyProperties& body = world.properties();
  const Eigen::Vector3d p_WBcm = truth.p_WB + truth.q_WB * body.p_BBcm;
  const Eigen::Vector3d v_WBcm = truth.v_WB + truth.q_WB * truth.w_WB_B.cross(body.p_BBcm);
  return 0.5 * body.mass * v_WBcm.squaredNorm() - body.mass * body.g_W.dot(p_WBcm) +
         0.5 * truth.w_WB_B.dot(body.I_BBcm_B * truth.w_WB_B);
}

// ---- Ground ----

TEST(World, StandsStill) {
  for (const Vehicle& vehicle : {test::NominalVehicle(), test::NanoVehicle(), HeavyVehicle()}) {
    const Setting setting(vehicle);
    World world = setting.In(Quiet());
    for (int i = 0; i < 2000; ++i) {
      world.Step();
      const TruthSample truth = world.Truth();
      ASSERT_LT(truth.p_WB.norm(), 1e-9) << vehicle.name << " at " << i;
      ASSERT_LT(Log(truth.q_WB).norm(), 1e-9);
      ASSERT_LT(truth.v_WB.norm() + truth.w_WB_B.norm(), 1e-8);
      ASSERT_TRUE(truth.on_ground);
    }
  }
}

TEST(World, IsHeldByTheGroundInWindAndDisturbance) {
  const Setting setting;
  WorldOptions options;
  options.wind_m_s = {6.0, 3.0, 0.0};
  options.gust_m_s = 1.0;
  World world = setting.In(options);
  RunFor(&world, 20.0);
  EXPECT_LT(world.Truth().p_WB.norm(), 0.002);
  EXPECT_LT(Log(world.Truth().q_WB).norm(), 0.02);
}

TEST(World, SlidesWhereFrictionGivesWay) {
  Setting setting(test::NominalVehicle(), {"thrust", "rotor_torque", "gravity"});
  setting.values[setting.model.IndexOf("gravity.y")] = -0.5;  // downhill is along x
  const BodyProperties body = setting.model.Properties(setting.values);
  const double slope = body.g_W.x() / -body.g_W.z();
  for (const double friction : {1.3 * slope, 0.5 * slope}) {
    WorldOptions options = Quiet();
    options.ground_friction = friction;
    World world = setting.In(options);
    RunFor(&world, 1.0);
    const double slip = std::max(0.0, body.g_W.x() + friction * body.g_W.z());
    EXPECT_NEAR(world.Truth().v_WB.x(), slip, 0.02 * slip + 1e-3) << friction;
  }
}

TEST(World, SettlesAfterADropAndGainsNoEnergy) {
  for (const Vehicle& vehicle : {test::NominalVehicle(), test::NanoVehicle(), HeavyVehicle()}) {
    for (const double damping : {0.1, 0.6, 1.0}) {
      const Setting setting(vehicle, {"thrust", "rotor_torque", "centre_of_gravity", "inertia"});
      WorldOptions options = Quiet();
      options.start_height_m = 0.5;
      options.motor_time_constant_s = 0.001;  // rotors stop at once
      options.ground_damping_ratio = damping;
      World world = setting.In(options);
      world.Command(setting.All(0.0));
      RunFor(&world, 0.02);
      const double start = Energy(world);
      double airborne = start;
      for (int i = 0; i < 5000; ++i) {
        world.Step();
        ASSERT_GE((world.Truth().q_WB * world.Truth().external_f_B).z(), -1e-12) << "no pull";
        if (world.touches_ground()) continue;
        ASSERT_LT(Energy(world), airborne + 1e-6 * start) << vehicle.name << " at " << i;
        airborne = Energy(world);
      }
      if (damping < 0.5) continue;  // bounces often enough to turn over
      const TruthSample truth = world.Truth();
      EXPECT_LT(std::abs(truth.p_WB.z()), 0.001) << vehicle.name << " " << damping;
      EXPECT_LT(Log(truth.q_WB).head<2>().norm(), 0.01);
      EXPECT_LT(truth.v_WB.norm() + truth.w_WB_B.norm(), 1e-3);
      EXPECT_TRUE(truth.on_ground);
    }
  }
}

// A hard landing with one rotor still pushing: it tumbles, and comes to lie on the ground.
TEST(World, CarriesAVehicleThatTumbled) {
  for (const Vehicle& vehicle : {test::NominalVehicle(), test::NanoVehicle(), HeavyVehicle()}) {
    const Setting setting(vehicle);
    World world = setting.In(Quiet());
    RotorVector command = setting.All(0.0);
    command[0] = world.max_rotor_speed();
    world.Command(command);
    RunFor(&world, 1.0);
    world.Command(setting.All(0.0));
    RunFor(&world, 4.0);
    const TruthSample truth = world.Truth();
    EXPECT_TRUE(truth.on_ground);
    EXPECT_GT(truth.p_WB.z(), -0.1) << vehicle.name;
    EXPECT_LT(truth.v_WB.norm() + truth.w_WB_B.norm(), 1e-2) << vehicle.name;
  }
}

// ---- Flight ----

TEST(World, HoversAtItsHoverSpeeds) {
  for (const Vehicle& vehicle : {test::NominalVehicle(), test::NanoVehicle(), HeavyVehicle()}) {
    const Setting setting(vehicle);
    WorldOptions options = Quiet();
    options.start_height_m = 1.0;
    World world = setting.In(options);
    RunFor(&world, 1.0);
    EXPECT_LT(AccelerationOfBcm_W(world).norm(), 1e-3);
    EXPECT_LT(world.Truth().dw_WB_B.norm(), 1e-3);
    EXPECT_NEAR(world.Truth().p_WB.z(), 1.0, 1e-3);
  }
}

TEST(World, FallsAlongAParabola) {
  const Setting setting(test::NominalVehicle(), {"thrust", "rotor_torque"});
  WorldOptions options = Quiet();
  options.start_height_m = 100.0;
  World world = setting.In(options);
  world.Command(setting.All(0.0));
  RunFor(&world, 1.5);  // the rotors are at rest to 1e-26
  const TruthSample start = world.Truth();
  RunFor(&world, 2.0);
  const TruthSample end = world.Truth();
  const Eigen::Vector3d g_W = world.properties().g_W;
  EXPECT_LT((end.p_WB - start.p_WB - 2.0 * start.v_WB - 2.0 * g_W).norm(), 1e-9);
  EXPECT_LT((end.v_WB - start.v_WB - 2.0 * g_W).norm(), 1e-9);
}

TEST(World, TruthObeysNewtonAndEuler) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  World world = setting.In(options);
  RotorVector command = world.HoverSpeeds();
  command[0] *= 1.1;
  world.Command(command);
  RunFor(&world, 0.2);
  const TruthSample a = world.Truth();
  world.Step();
  const TruthSample b = world.Truth();
  world.Step();
  const TruthSample c = world.Truth();
  const double h = 0.001;
  EXPECT_LT(((c.w_WB_B - a.w_WB_B) / (2 * h) - b.dw_WB_B).norm(), 1e-3 * b.dw_WB_B.norm());
  const BodyProperties& body = world.properties();
  const auto v_Bcm = [&](const TruthSample& s) {
    return Eigen::Vector3d(s.v_WB + s.q_WB * s.w_WB_B.cross(body.p_BBcm));
  };
  const Eigen::Vector3d a_Bcm = (v_Bcm(c) - v_Bcm(a)) / (2 * h) - body.g_W;
  EXPECT_LT((b.q_WB.conjugate() * a_Bcm * body.mass - b.f_B).norm(), 1e-3);
}

// Puts what is on the ground at its place, too: its feet forget where they stood.
TEST(World, PutsTheVehicleWhereItIsTold) {
  const Setting setting;
  World world = setting.In(Quiet());
  RunFor(&world, 0.1);
  const Eigen::Vector3d p_WB(2.0, -1.0, 0.0);
  const Eigen::Quaterniond q_WB(Exp({0.0, 0.0, 0.7}));
  world.Put(p_WB, q_WB, setting.All(0.0));
  RunFor(&world, 1.0);
  EXPECT_LT((world.Truth().p_WB - p_WB).norm(), 1e-9);
  EXPECT_LT(Log(q_WB.conjugate() * world.Truth().q_WB).norm(), 1e-9);
  EXPECT_TRUE(world.touches_ground());
  world.Put({0.0, 0.0, 3.0}, Eigen::Quaterniond::Identity(), world.HoverSpeeds());
  EXPECT_FALSE(world.touches_ground());
  RunFor(&world, 0.5);
  EXPECT_NEAR(world.Truth().p_WB.z(), 3.0, 1e-3);
  EXPECT_EQ(world.state().rotor_speed, world.Truth().rotor_speed);
  EXPECT_THROW(world.Put(p_WB, q_WB, RotorVector::Zero(3)), std::invalid_argument);
  EXPECT_THROW(world.Put({0.0, 0.0, std::nan("")}, q_WB, setting.All(0.0)), std::invalid_argument);
}

TEST(World, FallsOnWhereThereIsNoGround) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.ground = false;
  World world = setting.In(options);
  RunFor(&world, 1.0);
  EXPECT_LT(world.Truth().p_WB.z(), -4.0);
  EXPECT_FALSE(world.Truth().on_ground);
}

// It is an external wrench, asked of the state and of the newest command.
TEST(World, AddsWhatIsUnmodelled) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  options.odometry_rate_hz = options.imu_rate_hz = options.rotor_rate_hz = 0.0;
  World world = setting.In(options);
  int asked = 0;
  world.SetUnmodelled([&](const FlightState& state) {
    ++asked;
    const double faster = state.rotors.acceleration[0];
    return BodyWrench{{0.75, 0.0, state.time_s}, {0.0, 0.0, 1e-9 * faster}};
  });
  RunFor(&world, 0.5);
  EXPECT_EQ(asked, 500);
  EXPECT_NEAR(world.Truth().external_f_B.x(), 0.75, 1e-12);
  EXPECT_NEAR(world.Truth().external_f_B.z(), 0.5, 1e-12);
  const RotorVector now = world.Truth().rotor_speed;
  world.Command(now + setting.All(25.0));  // through a lag of 25 ms
  EXPECT_NEAR(world.Truth().external_tau_Bcm_B.z(), 1e-6, 1e-9);
  EXPECT_GT(world.Truth().v_WB.x(), 0.3) << "1 m/s² for half a second, less drag";
}

// ---- Motors and battery ----

TEST(World, TurnsRotorsAsToldWhereNothingLimitsThem) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.max_thrust_over_weight = options.idle_speed_share = 0.0;
  options.battery_slope_V_s = -100.0;  // empty at once
  World world = setting.In(options);
  RotorVector command(4);
  command << 0.0, 1.0, 100.0, 1e4;
  world.Command(command);
  RunFor(&world, 1.0);
  EXPECT_LT((world.Truth().rotor_speed - command).norm(), 1e-6);
  EXPECT_TRUE(std::isinf(world.max_rotor_speed()));
}

// By itself and by what is drawn.
TEST(World, ABatteryFallsWithTime) {
  const Setting setting;
  for (const double slope_V_s : {0.0, -0.02, -2.0}) {
    WorldOptions options = Quiet();
    options.start_height_m = 5.0;
    options.battery_capacity_As = 1000.0;
    options.battery_slope_V_s = slope_V_s;
    World world = setting.In(options);
    RunFor(&world, 0.001);
    double power = 0.0;
    for (const double speed : world.Truth().rotor_speed)
      power += setting.k_m() * std::pow(speed, 3);
    RunFor(&world, 1.999);
    const double voltage = 16.8 + 2.0 * slope_V_s;
    const double drawn_As = 2.0 * power / 0.6 / (0.5 * (16.8 + voltage));
    EXPECT_NEAR(world.battery_voltage_V(), voltage - 3.6 * drawn_As / 1000.0, 2e-2) << slope_V_s;
    RunFor(&world, 8.0);
    if (slope_V_s == -2.0) {
      EXPECT_EQ(world.battery_voltage_V(), 0.0);
    }
  }
}

TEST(World, LimitsCommandsToWhatMotorsCan) {
  const Setting setting;
  World world = setting.In(Quiet());
  const double hover = std::sqrt(0.75 * 9.81 / (4.0 * setting.k_f()));
  EXPECT_NEAR(world.max_rotor_speed(), std::sqrt(3.5) * hover, 1e-6);
  RotorVector command(4);
  command << 0.0, -5.0, 1.0, 1e5;
  world.Command(command);
  RunFor(&world, 1.0);
  const RotorVector speed = world.Truth().rotor_speed;
  EXPECT_EQ(speed[0], 0.0);
  EXPECT_EQ(speed[1], 0.0);
  EXPECT_NEAR(speed[2], 0.1 * hover, 1e-6);
  EXPECT_NEAR(speed[3], std::sqrt(3.5) * hover, 1e-6);
}

TEST(World, RefusesBrokenCommands) {
  const Setting setting;
  World world = setting.In(Quiet());
  EXPECT_THROW(world.Command(RotorVector::Zero(3)), std::invalid_argument);
  EXPECT_THROW(world.Command(setting.All(std::nan(""))), std::invalid_argument);
  EXPECT_THROW(world.DamagePropeller(4, 0.1), std::invalid_argument);
  EXPECT_THROW(world.DamagePropeller(0, 1.5), std::invalid_argument);
  EXPECT_THROW(world.AttachPayload(-0.1, Eigen::Vector3d::Zero()), std::invalid_argument);
  WorldOptions broken;
  broken.step_s = 0.002;
  EXPECT_THROW(setting.In(broken), std::invalid_argument);
  broken = WorldOptions();
  broken.damage_rotor = 5;
  EXPECT_THROW(setting.In(broken), std::invalid_argument);
}

TEST(World, BatterySagsUnderLoadAndEmpties) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  options.battery_resistance_ohm = 0.05;
  options.battery_capacity_As = 200.0;
  World world = setting.In(options);
  const double full_speed = world.max_rotor_speed();
  world.Step();
  double power = 0.0;
  for (const double speed : world.Truth().rotor_speed) {
    power += setting.k_m() * speed * speed * speed / 0.6;
  }
  const double sagged = world.battery_voltage_V();
  EXPECT_NEAR(16.8 - sagged, 0.05 * power / sagged, 1e-6);
  EXPECT_GT(16.8 - sagged, 0.3);
  EXPECT_NEAR(world.max_rotor_speed(), full_speed * sagged / 16.8, 1e-6);
  // In ten seconds at constant power: charge at the mean voltage, and more current at the end.
  RunFor(&world, 10.0);
  const double now = world.battery_voltage_V();
  const double charge = power * 10.0 / (0.5 * (sagged + now));
  const double more_current = power / now - power / sagged;
  EXPECT_NEAR(sagged - now, 3.6 * charge / 200.0 + 0.05 * more_current, 0.02);
  RunFor(&world, 60.0);
  EXPECT_GT(world.battery_voltage_V(), 11.0);
  EXPECT_LT(world.battery_voltage_V(), 13.2);
  EXPECT_NEAR(world.max_rotor_speed(), full_speed * world.battery_voltage_V() / 16.8, 1e-6);
}

TEST(MotorLag, SolvesTheMotorOfTheModelDocument) {
  const MotorLag motor = {0.025, 12.0, 0.015};
  RotorVector speed(4), command(4);
  speed << 0.0, 800.0, 1500.0, 1000.0;
  command << 1200.0, 1200.0, 300.0, 0.0;
  RotorVector fine = speed;
  const int num_steps = 4000;
  const double h = 0.04 / num_steps;
  const auto rate = [&](const RotorVector& w) { return motor.At(w, command).acceleration; };
  for (int i = 0; i < num_steps; ++i) {
    const RotorVector k1 = rate(fine), k2 = rate(fine + 0.5 * h * k1);
    const RotorVector k3 = rate(fine + 0.5 * h * k2), k4 = rate(fine + h * k3);
    fine += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
  }
  EXPECT_LT((motor.After(speed, command, 0.04) - fine).norm(), 1e-8);
  EXPECT_GT((fine - command).norm(), 10.0) << "still on its way";
  EXPECT_LT((motor.After(speed, command, 60.0) - command).norm(), 1e-9);
  // The right-hand side by hand: S1 Omega_cmd + S2 Omega_cmd² is what the voltage drives.
  const double drive = 12.0 * 1200.0 + 0.015 * 1200.0 * 1200.0;
  EXPECT_NEAR(rate(speed)[1], drive - 12.0 * 800.0 - 0.015 * 800.0 * 800.0, 1e-9);
}

TEST(World, VoltageLimitsTheMotorOfTheModelDocument) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.motor_S0 = 2000.0;
  options.motor_S1 = 10.0;
  options.motor_S2 = 0.012;
  World world = setting.In(options);
  const double top = world.max_rotor_speed();
  EXPECT_NEAR(10.0 * top + 0.012 * top * top, 2000.0 * 16.8, 1e-6);
  world.Command(setting.All(1e5));
  RunFor(&world, 2.0);
  EXPECT_NEAR(world.Truth().rotor_speed[2], top, 1e-6);
}

// ---- Actuator ----

// Every motor with constants of its own and a delay that ends within a step.
Vehicle UnequalMotors() {
  Vehicle vehicle = test::VehicleWithActuator();
  const Motor motor = vehicle.actuator->motors.front();
  vehicle.actuator->motors.assign(4, motor);
  for (size_t j = 0; j < 4; ++j) {
    Motor& own = vehicle.actuator->motors[j];
    const double k = static_cast<double>(j);
    own.delay_s = 0.0033 + 0.0017 * k;
    own.esc.root *= 1.0 + 0.05 * k;
    own.dynamics.S2 *= 1.0 + 0.2 * k;
  }
  return vehicle;
}

// The free run of the actuator room, which knows nothing of steps or of the rigid body.
TEST(World, FliesTheActuatorFromThrottles) {
  const Setting setting(UnequalMotors());
  const Actuator& actuator = *setting.model.vehicle().actuator;
  World world = setting.In(Quiet());
  std::vector<SpeedPredictor> predictors;
  for (const Motor& motor : actuator.motors) {
    predictors.emplace_back(motor);
    predictors.back().Command(0.0, 0.0, 16.8);
    predictors.back().At(0.0);
  }
  double largest = 0.0;
  for (int i = 0; i < 400; ++i) {
    if (i % 7 == 0) {
      RotorVector throttle(4);
      throttle << 0.1, 0.3, 0.5, 0.9;
      throttle *= i % 2 == 0 ? 1.0 : 0.6;
      world.CommandThrottle(throttle);
      for (int j = 0; j < 4; ++j)
        predictors[static_cast<size_t>(j)].Command(ToSeconds(world.now()), throttle[j], 16.8);
    }
    world.Step();
    const TruthSample truth = world.Truth();
    for (int j = 0; j < 4; ++j) {
      const double expected = predictors[static_cast<size_t>(j)].At(ToSeconds(world.now()));
      largest = std::max(largest, expected);
      ASSERT_NEAR(truth.rotor_speed[j], expected, 1e-6) << i << " rotor " << j;
    }
  }
  EXPECT_GT(largest, 1500.0);
}

TEST(World, ThrottleHasTheRatesOfItsMotionAndTheVoltageOfTheBattery) {
  const Setting setting(UnequalMotors());
  WorldOptions options = Quiet();
  options.battery_resistance_ohm = 0.05;
  World world = setting.In(options);
  world.CommandThrottle(setting.All(0.6));
  RunFor(&world, 0.030);
  const TruthSample a = world.Truth();
  const double voltage = world.battery_voltage_V();
  EXPECT_LT(voltage, 16.6);
  for (int j = 0; j < 4; ++j) {
    const Motor& motor = setting.model.vehicle().actuator->MotorOf(j);
    EXPECT_NEAR(a.rotor_speed_cmd[j], motor.SteadySpeed(0.6, voltage), 1e-9);
  }
  world.Step();
  const TruthSample b = world.Truth();
  const MotorLag lag = MotorLag::Of(*setting.model.vehicle().actuator, 4);
  for (int j = 0; j < 4; ++j) {
    const Motor& motor = setting.model.vehicle().actuator->MotorOf(j);
    const double drive = motor.esc.Drive(0.6, voltage);
    EXPECT_NEAR(b.rotor_speed[j], motor.dynamics.After(a.rotor_speed[j], drive, 1e-3), 1e-9);
    EXPECT_NEAR(lag.At(a.rotor_speed, a.rotor_speed_cmd).acceleration[j],
                drive - motor.dynamics.DriveFor(a.rotor_speed[j]), 1e-6);
  }
}

TEST(World, GivesSpeedsToAVehicleWithAnActuatorByItsInverse) {
  const Setting setting(UnequalMotors());
  WorldOptions options = Quiet();
  options.start_height_m = 1.0;
  World world = setting.In(options);
  const RotorVector hover = world.HoverSpeeds();
  EXPECT_LT((world.Truth().rotor_speed_cmd - hover).norm(), 1e-6);
  RunFor(&world, 1.0);
  EXPECT_NEAR(world.Truth().p_WB.z(), 1.0, 1e-3);
  RotorVector command(4);
  command << 0.0, 1.0, 900.0, 1e5;
  world.Command(command);
  RunFor(&world, 1.0);
  const RotorVector speed = world.Truth().rotor_speed;
  EXPECT_NEAR(speed[0], 0.0, 1e-6);
  EXPECT_NEAR(speed[1], world.idle_rotor_speed(), 1e-6);
  EXPECT_NEAR(speed[2], 900.0, 1e-6);
  EXPECT_NEAR(speed[3], setting.model.vehicle().actuator->MotorOf(3).SteadySpeed(1.0, 16.8), 1e-3);
  EXPECT_GE(speed[3], world.max_rotor_speed());
}

// One sample a stamp, of what holds from it on, at the rate of the rotors and where a command
// comes.
TEST(World, TellsWhatTheEscsAreTold) {
  const Setting setting(test::VehicleWithActuator());
  World world = setting.In(Quiet());
  const Setting plain;
  World without = plain.In(Quiet());
  for (int i = 0; i < 20; ++i) {
    if (i == 5) world.CommandThrottle(setting.All(0.3));
    if (i == 10) world.CommandThrottle(setting.All(1.4));
    world.Step();
    without.Step();
  }
  const auto samples = Only<CommandSample>(world.TakeSamples());
  ASSERT_EQ(samples.size(), 11u);  // 0, 2, 4, 5, 6, ... 18 ms
  EXPECT_EQ(samples[3].stamp, FromSeconds(0.005));
  for (const CommandSample& sample : samples) {
    const double told = sample.stamp >= FromSeconds(0.010)   ? 1.0
                        : sample.stamp >= FromSeconds(0.005) ? 0.3
                                                             : 0.0;
    EXPECT_EQ(sample.throttle, setting.All(told)) << sample.stamp;
  }
  EXPECT_TRUE(Only<CommandSample>(without.TakeSamples()).empty());
  EXPECT_THROW(without.CommandThrottle(plain.All(0.3)), std::invalid_argument);
  EXPECT_THROW(world.CommandThrottle(setting.All(std::nan(""))), std::invalid_argument);
  EXPECT_THROW(world.CommandThrottle(RotorVector::Zero(3)), std::invalid_argument);
}

// ---- Air ----

struct AxisFigures {
  double variance, correlation;  // second: of two values one length apart in time
};

std::array<AxisFigures, 3> TurbulenceFigures(double sigma, double length, double airspeed) {
  Turbulence turbulence(sigma, length, 3);
  const double dt = 0.005;
  const int apart = static_cast<int>(std::lround(length / airspeed / dt));
  const int count = 4000000;
  std::vector<Eigen::Vector3d> past(static_cast<size_t>(apart));
  Eigen::Vector3d square(0, 0, 0), product(0, 0, 0);
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d now = turbulence.velocity();
    Eigen::Vector3d& before = past[static_cast<size_t>(i % apart)];
    square += now.cwiseAbs2();
    if (i >= apart) product += now.cwiseProduct(before);
    before = now;
    turbulence.Advance(airspeed, dt);
  }
  std::array<AxisFigures, 3> figures;
  for (int k = 0; k < 3; ++k) figures[k] = {square[k] / count, product[k] / square[k]};
  return figures;
}

// Autocorrelations: along exp(-d), across (1 - d/2) exp(-d), d the distance in lengths; so at
// d = 1: 0.368 and 0.184. The run is of 10000 lengths.
TEST(Turbulence, HasTheVarianceAndCorrelationOfDryden) {
  const auto figures = TurbulenceFigures(1.5, 20.0, 10.0);
  for (const AxisFigures& axis : figures) EXPECT_NEAR(axis.variance, 2.25, 0.09);
  EXPECT_NEAR(figures[0].correlation, std::exp(-1.0), 0.03);
  EXPECT_NEAR(figures[1].correlation, 0.5 * std::exp(-1.0), 0.03);
  EXPECT_NEAR(figures[2].correlation, 0.5 * std::exp(-1.0), 0.03);
}

// Steps of any size draw from the same process; only the shape over short times differs.
TEST(Turbulence, AddsUpOverSteps) {
  for (const double airspeed : {1.0, 30.0}) {
    Turbulence turbulence(1.0, 1.0, 5);
    Eigen::Vector3d square(0, 0, 0);
    const int count = 200000;
    for (int i = 0; i < count; ++i) {
      turbulence.Advance(airspeed, 0.01);
      square += turbulence.velocity().cwiseAbs2() / count;
    }
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(square[k], 1.0, 0.12) << airspeed;
  }
}

TEST(World, BlowsAlongTheMeanWindAndFollowsEvents) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.wind_m_s = {0.0, 4.0, 0.5};
  World world = setting.In(options);
  EXPECT_EQ(world.wind_W(), options.wind_m_s);
  world.SetWind({1.0, 2.0, 3.0});
  EXPECT_EQ(world.wind_W(), Eigen::Vector3d(1.0, 2.0, 3.0));
  // Drag of the wind on a vehicle at rest, by hand.
  const TruthSample truth = world.Truth();
  const Eigen::Vector3d d = setting.values.segment<3>(setting.model.IndexOf("drag.d_x"));
  const double hvt = setting.values[setting.model.IndexOf("hvt.k_h")] * (1.0 + 4.0);
  const Eigen::Vector3d air_B = -d.cwiseProduct(Eigen::Vector3d(1.0, 2.0, 3.0));
  EXPECT_LT((truth.f_B - truth.external_f_B - air_B - hvt * Eigen::Vector3d::UnitZ()).norm(), 1e-9);
}

// Turned by 90 deg, the gust along the wind is that along W y.
TEST(World, GustsTurnWithTheMeanWind) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.gust_m_s = 1.0;
  options.wind_m_s = {5.0, 0.0, 0.0};
  World east = setting.In(options);
  options.wind_m_s = {0.0, 5.0, 0.0};
  World north = setting.In(options);
  RunFor(&east, 0.5);
  RunFor(&north, 0.5);
  const Eigen::Vector3d a = east.wind_W(), b = north.wind_W();
  EXPECT_GT((a - Eigen::Vector3d(5.0, 0.0, 0.0)).norm(), 0.1);
  EXPECT_LT((b - Eigen::Vector3d(-a.y(), a.x(), a.z())).norm(), 1e-2);
}

TEST(World, VariesTheParametersThatVary) {
  Setting setting(test::NominalVehicle(), {"thrust", "rotor_torque", "drag", "gust"});
  World world = setting.In(Quiet());
  double square = 0.0;
  for (int i = 0; i < 20000; ++i) {
    RunFor(&world, 0.01);
    square += world.wind_W().squaredNorm() / 3.0 / 20000;
  }
  const double sigma = setting.values[setting.model.IndexOf("gust.sigma")];
  EXPECT_NEAR(std::sqrt(square), sigma, 0.25 * sigma);
}

// ---- Sensors ----

TEST(World, OdometryNoiseHasTheStatedSpread) {
  const Setting setting;
  WorldOptions options;
  options.disturbance_force_N = options.disturbance_torque_Nm = 0.0;
  World world = setting.In(options);
  RunFor(&world, 60.0);
  const auto samples = Only<OdometrySample>(world.TakeSamples());
  ASSERT_EQ(samples.size(), 5999u);  // 60.02 s would give the last
  const Eigen::Vector3d p_BS = setting.model.vehicle().odometry.p_BS;
  Eigen::Vector3d p(0, 0, 0), q = p, v = p, w = p;
  const double n = static_cast<double>(samples.size());
  for (const OdometrySample& s : samples) {
    p += (s.p_WS - p_BS).cwiseAbs2() / n;
    q += Log(s.q_WS).cwiseAbs2() / n;
    v += s.v_WS->cwiseAbs2() / n;
    w += s.w_WS_S->cwiseAbs2() / n;
  }
  for (int i = 0; i < 3; ++i) {
    EXPECT_NEAR(std::sqrt(p[i]), 0.005, 0.0002);
    EXPECT_NEAR(std::sqrt(q[i]), 0.002, 0.00008);
    EXPECT_NEAR(std::sqrt(v[i]), 0.03, 0.0012);
    EXPECT_NEAR(std::sqrt(w[i]), 0.01, 0.0004);
  }
}

// Climbs, so that every stamp has its own truth.
World Climbing(const Setting& setting, WorldOptions options) {
  options.start_height_m = 1.0;
  World world = setting.In(options);
  world.Command(1.1 * world.HoverSpeeds());
  return world;
}

TEST(World, OdometryArrivesLateWithTheStampOfItsTruth) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.odometry_delay_s = 0.025;
  World world = Climbing(setting, options);
  const Eigen::Vector3d p_BS = setting.model.vehicle().odometry.p_BS;
  std::vector<TruthSample> truth = {world.Truth()};
  int count = 0;
  for (int i = 0; i < 500; ++i) {
    world.Step();
    truth.push_back(world.Truth());
    for (const OdometrySample& sample : Only<OdometrySample>(world.TakeSamples())) {
      EXPECT_EQ(world.now() - sample.stamp, FromSeconds(0.025));
      const TruthSample& then = truth[static_cast<size_t>(sample.stamp / 1000000)];
      ASSERT_EQ(then.stamp, sample.stamp);
      EXPECT_LT((sample.p_WS - then.p_WB - then.q_WB * p_BS).norm(), 1e-12);
      ++count;
    }
  }
  EXPECT_EQ(count, 48);  // 0, 0.01, ... 0.47
}

TEST(World, StampsWholePeriodsFromZero) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.odometry_rate_hz = 30.0;
  options.odometry_delay_s = 0.0;
  World world = setting.In(options);
  RunFor(&world, 10.0);
  const std::vector<Sample> samples = world.TakeSamples();
  EXPECT_EQ(Only<ImuSample>(samples).size(), 5001u);
  EXPECT_EQ(Only<RotorSample>(samples).size(), 5001u);
  EXPECT_EQ(Only<BatterySample>(samples).size(), 101u);
  const auto odometry = Only<OdometrySample>(samples);
  ASSERT_EQ(odometry.size(), 301u);  // on the grid of steps, at the mean rate
  EXPECT_EQ(odometry[1].stamp, FromSeconds(0.034));
  EXPECT_EQ(odometry[3].stamp, FromSeconds(0.1));
  EXPECT_EQ(Only<ImuSample>(samples)[7].stamp, FromSeconds(0.014));
}

TEST(World, DelaysRotorSpeeds) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.rotor_delay_s = 0.0105;
  World world = Climbing(setting, options);
  std::vector<RotorVector> truth = {world.Truth().rotor_speed};
  for (int i = 0; i < 100; ++i) {
    world.Step();
    truth.push_back(world.Truth().rotor_speed);
    for (const RotorSample& sample : Only<RotorSample>(world.TakeSamples())) {
      const long k = static_cast<long>(sample.stamp / 1000000);
      const RotorVector& late = truth[static_cast<size_t>(std::max(0L, k - 10))];
      const RotorVector& later = truth[static_cast<size_t>(std::max(0L, k - 11))];
      EXPECT_LT((sample.speed - 0.5 * (late + later)).norm(), 1e-9) << k;
    }
  }
}

TEST(World, QuantisesRotorSpeeds) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.rotor_quantum_rad_s = 12.5;
  World world = Climbing(setting, options);
  RunFor(&world, 0.2);
  const auto samples = Only<RotorSample>(world.TakeSamples());
  const RotorVector last = samples.back().speed;
  for (const RotorSample& sample : samples) {
    const RotorVector steps = sample.speed / 12.5;
    EXPECT_LT((steps - RotorVector(steps.array().round().matrix())).norm(), 1e-9);
  }
  EXPECT_LT((last - world.Truth().rotor_speed).cwiseAbs().maxCoeff(), 6.25 + 1e-9);
}

TEST(World, AJumpMovesPositionsOnly) {
  const Setting setting;
  WorldOptions options;
  World plain = setting.In(options);
  options.jump_at_s = 0.5;
  options.jump_m = {0.3, -0.2, 0.1};
  World jumping = setting.In(options);
  RunFor(&plain, 1.0);
  RunFor(&jumping, 1.0);
  const auto a = Only<OdometrySample>(plain.TakeSamples());
  const auto b = Only<OdometrySample>(jumping.TakeSamples());
  ASSERT_EQ(a.size(), b.size());
  for (size_t k = 0; k < a.size(); ++k) {
    const bool off = a[k].stamp >= FromSeconds(0.5);
    const Eigen::Vector3d expected = off ? options.jump_m : Eigen::Vector3d::Zero();
    EXPECT_LT((b[k].p_WS - a[k].p_WS - expected).norm(), 1e-12);
    EXPECT_EQ(*a[k].v_WS, *b[k].v_WS);
    EXPECT_EQ(*a[k].w_WS_S, *b[k].w_WS_S);
    EXPECT_EQ(a[k].q_WS.coeffs(), b[k].q_WS.coeffs());
  }
}

TEST(World, OdometryDriftsAsARandomWalk) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.position_drift_m_sqrt_s = 0.02;
  options.yaw_drift_rad_sqrt_s = 0.01;
  options.odometry_rate_hz = 50.0;
  options.imu_rate_hz = options.rotor_rate_hz = 0.0;
  double position = 0.0, yaw = 0.0;
  const int num_runs = 200;
  for (int seed = 1; seed <= num_runs; ++seed) {
    World world = setting.In(options, seed);
    RunFor(&world, 1.0);
    const OdometrySample end = Only<OdometrySample>(world.TakeSamples()).back();
    const Eigen::Vector3d p_BS = setting.model.vehicle().odometry.p_BS;
    position += (end.p_WS - end.q_WS * p_BS).squaredNorm() / 3.0 / num_runs;
    yaw += Log(end.q_WS).squaredNorm() / num_runs;
  }
  EXPECT_NEAR(std::sqrt(position), 0.02, 0.002);
  EXPECT_NEAR(std::sqrt(yaw), 0.01, 0.0015);
}

Vehicle WithImu() {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.imu = SensorMount{};
  vehicle.imu->p_BS = {0.05, -0.02, 0.03};
  vehicle.imu->q_BS = Exp({0.3, -0.2, 1.0});
  return vehicle;
}

TEST(World, ImuAtRestFeelsTheGround) {
  const Setting setting(WithImu());
  WorldOptions options = Quiet();
  options.gyro_bias_rad_s = {0.01, -0.02, 0.03};
  options.accelerometer_bias_m_s2 = {0.1, 0.2, -0.1};
  World world = setting.In(options);
  RunFor(&world, 1.0);
  const ImuSample last = Only<ImuSample>(world.TakeSamples()).back();
  const Eigen::Quaterniond q_IB = setting.model.vehicle().imu->q_BS.conjugate();
  const Eigen::Vector3d up(0.0, 0.0, 9.81);
  EXPECT_LT((*last.specific_force_I - q_IB * up - options.accelerometer_bias_m_s2).norm(), 1e-6);
  EXPECT_LT((*last.gyro_I - options.gyro_bias_rad_s).norm(), 1e-8);
}

TEST(World, ImuNoiseHasTheStatedDensity) {
  const Setting setting(WithImu());
  WorldOptions options = Quiet();
  options.gyro_noise_density = 1e-3;
  options.accelerometer_noise_density = 4e-3;
  World world = setting.In(options);
  RunFor(&world, 40.0);
  const auto samples = Only<ImuSample>(world.TakeSamples());
  double gyro = 0.0, force = 0.0;
  const Eigen::Vector3d rest =
      setting.model.vehicle().imu->q_BS.conjugate() * Eigen::Vector3d(0.0, 0.0, 9.81);
  for (const ImuSample& s : samples) {
    gyro += s.gyro_I->squaredNorm() / 3.0 / static_cast<double>(samples.size());
    force += (*s.specific_force_I - rest).squaredNorm() / 3.0 / static_cast<double>(samples.size());
  }
  EXPECT_NEAR(std::sqrt(gyro), 1e-3 * std::sqrt(500.0), 1e-3);
  EXPECT_NEAR(std::sqrt(force), 4e-3 * std::sqrt(500.0), 4e-3);
}

// What it feels is the acceleration of its own place, lever arm and all.
TEST(World, ImuFeelsTheMotionOfItsPlace) {
  const Setting setting(WithImu());
  WorldOptions options = Quiet();
  options.start_height_m = 20.0;
  options.imu_rate_hz = 1000.0;
  World world = setting.In(options);
  RotorVector command = world.HoverSpeeds();
  command[0] *= 1.3;
  command[2] *= 1.25;  // mostly yaw, some roll
  world.Command(command);
  RunFor(&world, 0.3);
  world.TakeSamples();
  const SensorMount mount = *setting.model.vehicle().imu;
  std::vector<Eigen::Vector3d> v_WI;
  std::vector<TruthSample> truth;
  std::vector<ImuSample> felt;
  for (int i = 0; i < 100; ++i) {
    world.Step();
    truth.push_back(world.Truth());
    const TruthSample& t = truth.back();
    v_WI.push_back(t.v_WB + t.q_WB * t.w_WB_B.cross(mount.p_BS));
    felt.push_back(Only<ImuSample>(world.TakeSamples()).at(0));
  }
  EXPECT_GT(truth.back().w_WB_B.norm(), 3.0);
  for (size_t k = 1; k + 1 < felt.size(); ++k) {
    const Eigen::Vector3d a = (v_WI[k + 1] - v_WI[k - 1]) / 0.002 + Eigen::Vector3d(0, 0, 9.81);
    const Eigen::Vector3d expected = (truth[k].q_WB * mount.q_BS).conjugate() * a;
    ASSERT_LT((*felt[k].specific_force_I - expected).norm(), 2e-3) << k;
  }
}

// Whoever commands first and asks then gets what the command does, in truth and sensors.
TEST(World, SensorsSeeTheCommandOfTheirInstant) {
  Setting setting(WithImu(), {"thrust", "rotor_torque", "inertia", "rotor_reaction"});
  setting.values[setting.model.IndexOf("rotor_reaction.J_r")] = 3e-5;
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  for (const bool commands_first : {true, false}) {
    World world = setting.In(options);
    RunFor(&world, 0.1);
    world.TakeSamples();
    RunFor(&world, 0.002);
    const RotorVector command = world.HoverSpeeds().cwiseProduct(RotorVector::LinSpaced(4, 1, 1.3));
    if (commands_first) world.Command(command);
    const auto felt = Only<ImuSample>(world.TakeSamples());
    ASSERT_EQ(felt.size(), 1u);
    EXPECT_EQ(felt[0].stamp, world.now());
    if (!commands_first) world.Command(command);
    const ImuSample truth = ImuOf(world.Truth(), world.properties());
    const double apart = (*felt[0].specific_force_I - *truth.specific_force_I).norm();
    if (commands_first) {
      EXPECT_LT(apart, 1e-12);
    } else {
      EXPECT_GT(apart, 1e-2);
    }
  }
}

// The IMU asks for the truth of its instant; whatever changes then shows in the next answer.
TEST(World, TruthFollowsWhatChangesAfterASample) {
  const Setting setting(WithImu());
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  World world = setting.In(options);
  const auto change = [&](const std::function<void()>& act) {
    RunFor(&world, 0.002);
    ASSERT_EQ(Only<ImuSample>(world.TakeSamples()).back().stamp, world.now());
    const double force = world.Truth().f_B.x();
    act();
    EXPECT_GT(std::abs(world.Truth().f_B.x() - force), 0.01);
  };
  change([&] { world.SetWind({3.0, 0.0, 0.0}); });
  change([&] {
    world.SetUnmodelled([](const FlightState&) { return BodyWrench{{1, 0, 0}, {}}; });
  });
  change([&] {
    world.Put({0.0, 0.0, 4.0}, Eigen::Quaterniond(Exp({0.0, 0.0, 1.5})), world.HoverSpeeds());
  });
  const double stamp_s = ToSeconds(world.Truth().stamp);
  RunFor(&world, 0.002);
  EXPECT_NEAR(ToSeconds(world.Truth().stamp), stamp_s + 0.002, 1e-12);
}

// ---- Events ----

TEST(World, APayloadWeighsAndMovesTheCentreOfGravity) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  options.payload_attach_at_s = 0.1;
  options.payload_drop_at_s = 0.2;
  options.payload_kg = 0.25;
  options.payload_p_B_m = {0.06, 0.0, -0.05};
  World world = setting.In(options);
  const BodyProperties bare = world.properties();
  const RotorVector bare_hover = world.HoverSpeeds();
  RunFor(&world, 0.15);
  const BodyProperties loaded = world.properties();
  EXPECT_NEAR(world.mass(), 1.0, 1e-12);
  const Eigen::Vector3d p_BBcm = 0.75 * bare.p_BBcm + 0.25 * options.payload_p_B_m;
  EXPECT_LT((loaded.p_BBcm - p_BBcm).norm(), 1e-12);
  // Steiner's theorem, both parts about the new centre.
  const Eigen::Matrix3d a = Hat(bare.p_BBcm - p_BBcm), b = Hat(options.payload_p_B_m - p_BBcm);
  const Eigen::Matrix3d inertia = bare.I_BBcm_B - 0.75 * a * a - 0.25 * b * b;
  EXPECT_LT((loaded.I_BBcm_B - inertia).norm(), 1e-12);
  // The rotors carry a quarter too little now, and pull behind the centre of mass.
  EXPECT_NEAR(AccelerationOfBcm_W(world).z(), -0.25 * 9.81, 0.02);
  EXPECT_GT(world.Truth().dw_WB_B.y(), 1.0);
  const RotorVector hover = world.HoverSpeeds();
  EXPECT_NEAR(setting.k_f() * hover.squaredNorm(), 9.81, 1e-9);
  RunFor(&world, 0.06);
  EXPECT_EQ(world.mass(), bare.mass);
  EXPECT_EQ(world.properties().p_BBcm, bare.p_BBcm);
  EXPECT_EQ(world.properties().I_BBcm_B, bare.I_BBcm_B);
  EXPECT_EQ(world.HoverSpeeds(), bare_hover);
}

// Drag acts where it did on the airframe, whatever hangs from it.
TEST(World, APayloadLeavesTheAirForcesOnTheAirframe) {
  const Setting setting(test::NominalVehicle(), {"thrust", "rotor_torque", "drag", "inertia"});
  WorldOptions options = Quiet();
  options.wind_m_s = {4.0, 0.0, 0.0};
  options.start_height_m = 5.0;
  World world = setting.In(options);
  world.AttachPayload(0.25, {0.0, 0.0, -0.2});  // Bcm 0.05 below
  const TruthSample truth = world.Truth();
  EXPECT_NEAR(truth.f_B.x(), 1.2, 1e-12);
  EXPECT_NEAR(truth.tau_Bcm_B.y(), 0.05 * 1.2, 1e-12);
  world.DropPayload();
  world.ShiftCentreOfGravity({0.0, 0.0, -0.05});
  EXPECT_NEAR(world.Truth().tau_Bcm_B.y(), 0.0, 1e-12);
}

TEST(World, AShiftMovesTheCentreOfGravityOnly) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  options.cog_shift_at_s = 0.1;
  options.cog_shift_m = {0.02, 0.0, 0.0};
  World world = setting.In(options);
  const BodyProperties before = world.properties();
  RunFor(&world, 0.1);
  EXPECT_LT((world.properties().p_BBcm - before.p_BBcm - options.cog_shift_m).norm(), 1e-12);
  EXPECT_EQ(world.properties().I_BBcm_B, before.I_BBcm_B);
  EXPECT_EQ(world.mass(), before.mass);
  // Weight times lever: it pitches forward.
  EXPECT_NEAR(world.Truth().tau_Bcm_B.y(), 0.75 * 9.81 * 0.02, 1e-6);
}

TEST(World, ADamagedPropellerLosesItsShare) {
  const Setting setting;
  WorldOptions options = Quiet();
  options.start_height_m = 5.0;
  options.damage_at_s = 0.1;
  options.damage_rotor = 2;
  options.damage_share = 0.3;
  World world = setting.In(options);
  const RotorVector hover = world.HoverSpeeds();
  RunFor(&world, 0.1);
  const TruthSample truth = world.Truth();
  const Rotor& rotor = setting.model.vehicle().rotors[1];
  const double squared = truth.rotor_speed[1] * truth.rotor_speed[1];
  const Eigen::Vector3d f_B(0.0, 0.0, -0.3 * setting.k_f() * squared);
  Eigen::Vector3d tau_B = (rotor.p_BP - world.properties().p_BBcm).cross(f_B);
  tau_B.z() -= 0.3 * rotor.spin * setting.k_m() * squared;
  EXPECT_LT((truth.external_f_B - f_B).norm(), 1e-9);
  EXPECT_LT((truth.external_tau_Bcm_B - tau_B).norm(), 1e-9);
  const RotorVector damaged = world.HoverSpeeds();
  EXPECT_NEAR(damaged[1] * damaged[1] * 0.7, hover[1] * hover[1], 1e-3);
  world.Repair();
  EXPECT_LT(world.Truth().external_f_B.norm(), 1e-12);
}

// ---- Randomness ----

void ExpectSame(const std::vector<ImuSample>& a, const std::vector<ImuSample>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (size_t k = 0; k < a.size(); ++k) {
    ASSERT_EQ(a[k].stamp, b[k].stamp);
    ASSERT_EQ(*a[k].gyro_I, *b[k].gyro_I);
    ASSERT_EQ(*a[k].specific_force_I, *b[k].specific_force_I);
  }
}

TEST(World, IsTheSameForTheSameSeed) {
  const Setting setting;
  WorldOptions options;
  options.gust_m_s = 1.0;
  options.start_height_m = 2.0;
  std::array<std::vector<Sample>, 3> samples;
  const std::array<int, 3> seeds = {4, 4, 5};
  for (size_t i = 0; i < 3; ++i) {
    World world = setting.In(options, seeds[i]);
    RunFor(&world, 1.0);
    samples[i] = world.TakeSamples();
  }
  ExpectSame(Only<ImuSample>(samples[0]), Only<ImuSample>(samples[1]));
  EXPECT_EQ(Only<RotorSample>(samples[0]).back().speed, Only<RotorSample>(samples[1]).back().speed);
  EXPECT_EQ(Only<OdometrySample>(samples[0]).back().p_WS,
            Only<OdometrySample>(samples[1]).back().p_WS);
  EXPECT_NE(*Only<ImuSample>(samples[0]).back().gyro_I, *Only<ImuSample>(samples[2]).back().gyro_I);
}

TEST(World, EverySensorTakesTheSeed) {
  const Setting setting;
  WorldOptions options;
  options.start_height_m = 2.0;
  options.disturbance_force_N = options.disturbance_torque_Nm = 0.0;
  World one = setting.In(options, 1), two = setting.In(options, 2);
  RunFor(&one, 0.1);
  RunFor(&two, 0.1);
  EXPECT_EQ(one.Truth().p_WB, two.Truth().p_WB);
  const std::vector<Sample> a = one.TakeSamples(), b = two.TakeSamples();
  EXPECT_NE(*Only<ImuSample>(a)[7].gyro_I, *Only<ImuSample>(b)[7].gyro_I);
  EXPECT_NE(Only<OdometrySample>(a)[7].p_WS, Only<OdometrySample>(b)[7].p_WS);
  EXPECT_NE(Only<RotorSample>(a)[7].speed, Only<RotorSample>(b)[7].speed);
}

// With everything but the IMU switched off, the IMU feels the same; and so on.
TEST(World, SensorsDoNotHangOnEachOther) {
  const Setting setting;
  WorldOptions all;
  all.start_height_m = 2.0;
  World world = setting.In(all);
  RunFor(&world, 1.0);
  const std::vector<Sample> samples = world.TakeSamples();

  WorldOptions imu_only = all;
  imu_only.odometry_rate_hz = imu_only.rotor_rate_hz = imu_only.battery_rate_hz = 0.0;
  World with_imu = setting.In(imu_only);
  RunFor(&with_imu, 1.0);
  const std::vector<Sample> imu = with_imu.TakeSamples();
  EXPECT_EQ(imu.size(), 501u);
  ExpectSame(Only<ImuSample>(samples), Only<ImuSample>(imu));

  WorldOptions without_imu = all;
  without_imu.imu_rate_hz = 0.0;
  without_imu.position_drift_m_sqrt_s = 0.01;
  without_imu.rotor_noise_rad_s = 0.0;
  World rest = setting.In(without_imu);
  RunFor(&rest, 1.0);
  const std::vector<Sample> others = rest.TakeSamples();
  EXPECT_EQ(world.Truth().p_WB, rest.Truth().p_WB);
  EXPECT_EQ(*Only<OdometrySample>(samples).back().v_WS, *Only<OdometrySample>(others).back().v_WS);
}

}  // namespace
}  // namespace odmc
