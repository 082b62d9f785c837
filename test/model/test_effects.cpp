#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <stdexcept>

#include "odmc/effects/effects.h"
#include "odmc/factors/dynamics_factor.h"
#include "odmc/math/so3.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/sim/rigid_body.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/jacobian_check.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

Vehicle VehicleWithImu() {
  Vehicle vehicle = NominalVehicle();
  vehicle.imu.emplace();
  vehicle.imu->p_BS = {0.05, 0.03, -0.02};
  vehicle.imu->q_BS = Exp(Vector3d(-0.4, 0.5, 1.2));
  vehicle.imu->estimate = true;
  vehicle.odometry.q_BS = Exp(Vector3d(0.3, -0.2, 0.9));
  return vehicle;
}

FlightState RandomFlight(const Vehicle& vehicle, Random* random) {
  FlightState flight;
  flight.R_WB = Exp(random->Next3(1.5)).toRotationMatrix();
  flight.p_WB = Vector3d(0.0, 0.0, 1.0) + random->Next3(0.5);
  flight.v_AB_B = random->Next3(6.0);
  flight.w_WB_B = random->Next3(6.0);
  flight.load.pull_W += random->Next3(3.0);
  for (int i = 0; i < 4; ++i) flight.load.d_swing.col(i) = random->Next3(8.0);
  flight.load.swing << random->Next(0.2), random->Next(0.2), random->Next(0.2), random->Next(0.2);
  RotorVector speed(vehicle.num_rotors());
  for (int j = 0; j < speed.size(); ++j) speed[j] = 1100.0 + random->Next(300.0);
  flight.rotors = RotorState::Steady(speed);
  for (int j = 0; j < speed.size(); ++j) {
    flight.rotors.acceleration[j] = random->Next(2000.0);
    flight.rotors.speed_squared_rate[j] = 2.0 * speed[j] * flight.rotors.acceleration[j];
  }
  return flight;
}

Eigen::VectorXd RandomOwnValues(const DynamicModel& model, Random* random) {
  Eigen::VectorXd values = model.InitialValues();
  for (int k = 0; k < values.size(); ++k) {
    const ParameterSpec& spec = model.parameters()[k].spec;
    values[k] = spec.transform == ParameterTransform::kLog
                    ? spec.prior_value * std::exp(random->Next(0.4))
                    : spec.prior_value + spec.scale * random->Next(1.5);
  }
  return values;
}

FlightState Moved(const FlightState& flight, int column, double step) {
  FlightState moved = flight;
  const Vector3d d = step * Vector3d::Unit(column % 3);
  if (column < kColumnAngularRate) {
    moved.v_AB_B += d;
  } else if (column < kColumnAttitude) {
    moved.w_WB_B += d;
  } else if (column < kColumnPosition) {
    moved.R_WB = flight.R_WB * Exp(d).toRotationMatrix();
  } else {
    moved.p_WB += d;
  }
  return moved;
}

/// Every registered effect in a model of its own (with its priors for what it borrows).
class EveryEffect : public testing::TestWithParam<std::string> {
 protected:
  EveryEffect() : vehicle_(VehicleWithImu()), model_(vehicle_, {GetParam()}) {}

  Eigen::Matrix<double, 6, 1> WrenchAt(const FlightState& flight, const ModelValues& values,
                                       const Vector3d& c) const {
    Vector3d f, tau;
    model_.EvaluateWrench(flight, values, c, &f, &tau);
    return (Eigen::Matrix<double, 6, 1>() << f, tau).finished();
  }

  Vehicle vehicle_;
  DynamicModel model_;
};

/// Rows 0-2 (newtons) and 3-5 (newton-metres) apart.
void ExpectClose(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, const std::string& what) {
  for (int row = 0; row + 3 <= a.rows(); row += 3) {
    const double scale = std::max(b.middleRows(row, 3).norm(), 1e-9);
    EXPECT_LT((a - b).middleRows(row, 3).norm() / scale, 1e-5) << what << ", rows from " << row;
  }
}

TEST_P(EveryEffect, JacobiansAgreeWithCentralDifferences) {
  Random random(21);
  for (int round = 0; round < 5; ++round) {
    const FlightState flight = RandomFlight(vehicle_, &random);
    const ModelValues values = RandomOwnValues(model_, &random);
    const Vector3d c = random.Next3(0.02);
    Vector3d f, tau;
    ModelWrenchJacobians J;
    model_.EvaluateWrench(flight, values, c, &f, &tau, &J);
    EXPECT_EQ(WrenchAt(flight, values, c).head<3>(), f);

    Eigen::Matrix<double, 6, kNumFlightStateColumns> d_state;
    for (int k = 0; k < kNumFlightStateColumns; ++k) {
      constexpr double kStep = 1e-5;
      d_state.col(k) = (WrenchAt(Moved(flight, k, kStep), values, c) -
                        WrenchAt(Moved(flight, k, -kStep), values, c)) /
                       (2.0 * kStep);
    }
    ExpectClose(J.d_state, d_state, "state");

    Eigen::Matrix<double, 6, 3> d_com;
    for (int k = 0; k < 3; ++k) {
      const Vector3d d = 1e-4 * Vector3d::Unit(k);
      d_com.col(k) = (WrenchAt(flight, values, c + d) - WrenchAt(flight, values, c - d)) / 2e-4;
    }
    ExpectClose(J.d_p_BBcm, d_com, "centre of mass");

    Eigen::MatrixXd d_values(6, model_.num_parameters());
    for (int k = 0; k < model_.num_parameters(); ++k) {
      const double step = 1e-5 * model_.parameters()[k].spec.scale;
      ModelValues plus = values, minus = values;
      plus[k] += step;
      minus[k] -= step;
      d_values.col(k) = (WrenchAt(flight, plus, c) - WrenchAt(flight, minus, c)) / (2.0 * step);
    }
    for (int k = 0; k < model_.num_parameters(); ++k) {
      ExpectClose(J.d_values.col(k), d_values.col(k), model_.parameters()[k].full_name);
    }
  }
}

/// The body as the rows of BodyPropertyRow; rotations relative to `at` by Log.
Eigen::Matrix<double, kNumBodyPropertyRows, 1> RowsOf(const BodyProperties& body,
                                                      const BodyProperties& at) {
  Eigen::Matrix<double, kNumBodyPropertyRows, 1> rows;
  const auto& I = body.I_BBcm_B;
  const auto turn = [](const Eigen::Matrix3d& from, const Eigen::Matrix3d& to) {
    return Log(Eigen::Quaterniond(Eigen::Matrix3d(from.transpose() * to)));
  };
  rows << body.mass, body.p_BBcm, I(0, 0), I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2), body.g_W,
      body.wind_W, body.p_BS, turn(at.R_BS, body.R_BS), body.p_BI, turn(at.R_BI, body.R_BI);
  return rows;
}

TEST_P(EveryEffect, ShapesTheBodyAsItsDerivativesSay) {
  Random random(22);
  for (int round = 0; round < 5; ++round) {
    const ModelValues values = RandomOwnValues(model_, &random);
    BodyPropertiesJacobian J;
    const BodyProperties at = model_.Properties(values, &J);
    for (int k = 0; k < model_.num_parameters(); ++k) {
      const double step = 1e-5 * model_.parameters()[k].spec.scale;
      ModelValues plus = values, minus = values;
      plus[k] += step;
      minus[k] -= step;
      const Eigen::VectorXd slope =
          (RowsOf(model_.Properties(plus), at) - RowsOf(model_.Properties(minus), at)) /
          (2.0 * step);
      const Eigen::VectorXd column = J.col(k);
      EXPECT_LT((column - slope).norm(), 1e-5 * std::max(1e-3, slope.norm()))
          << model_.parameters()[k].full_name;
    }
  }
}

TEST_P(EveryEffect, DescribesItselfWithFormulaAndSource) {
  const auto effect = EffectRegistry::Default().Make(GetParam(), vehicle_);
  const EffectDescription& d = effect->description();
  EXPECT_EQ(d.name, GetParam());
  EXPECT_FALSE(d.title.empty());
  EXPECT_FALSE(d.formula.empty());
  EXPECT_FALSE(d.validity.empty());
  EXPECT_NE(d.source.find("model.md"), std::string::npos);
  std::set<std::string> names;
  for (const ParameterSpec& spec : effect->parameters()) {
    EXPECT_TRUE(names.insert(spec.name).second) << spec.name << " twice";
    EXPECT_FALSE(spec.unit.empty());
    EXPECT_FALSE(spec.description.empty());
    EXPECT_GT(spec.prior_sigma, 0.0);
    EXPECT_GT(spec.scale, 0.0);
    if (spec.transform == ParameterTransform::kLog) {
      EXPECT_GT(spec.prior_value, 0.0);
    }
  }
}

TEST_P(EveryEffect, SaysWhetherItTakesRotorRates) {
  Random random(23);
  const ModelValues values = RandomOwnValues(model_, &random);
  const FlightState moving = RandomFlight(vehicle_, &random);
  FlightState steady = moving;
  steady.rotors.acceleration.setZero();
  steady.rotors.speed_squared_rate.setZero();
  Vector3d f, tau, f_steady, tau_steady;
  model_.EvaluateWrench(moving, values, Vector3d::Zero(), &f, &tau);
  model_.EvaluateWrench(steady, values, Vector3d::Zero(), &f_steady, &tau_steady);
  EXPECT_EQ(f != f_steady || tau != tau_steady, model_.takes_rotor_rates());
}

TEST_P(EveryEffect, AnswersTheSameInATurnedScene) {
  // Whatever the heading, a vehicle that sees the same air and rates in its own axes feels the
  // same.
  Random random(23);
  FlightState flight = RandomFlight(vehicle_, &random);
  const ModelValues values = RandomOwnValues(model_, &random);
  const Eigen::Matrix<double, 6, 1> before = WrenchAt(flight, values, Vector3d::Zero());
  const Eigen::Matrix3d turn = Exp(Vector3d(0.0, 0.0, 1.1)).toRotationMatrix();
  flight.R_WB = (turn * flight.R_WB).eval();
  flight.p_WB = (turn * flight.p_WB).eval();
  flight.load.pull_W = (turn * flight.load.pull_W).eval();
  flight.load.d_swing = (turn * flight.load.d_swing).eval();
  EXPECT_LT((WrenchAt(flight, values, Vector3d::Zero()) - before).norm(), 1e-12);
}

INSTANTIATE_TEST_SUITE_P(Registered, EveryEffect,
                         testing::ValuesIn(EffectRegistry::Default().names()),
                         [](const auto& name) { return name.param; });

TEST(EffectRegistry, HasEveryEffectOfTheIssueOnce) {
  const auto& names = EffectRegistry::Default().names();
  EXPECT_EQ(std::set<std::string>(names.begin(), names.end()).size(), names.size());
  for (const char* name :
       {"thrust", "rotor_torque", "drag", "viscous_torque", "hvt", "centre_of_gravity", "inertia",
        "gravity", "odometry_extrinsics", "imu_extrinsics"}) {
    EXPECT_TRUE(EffectRegistry::Default().Has(name)) << name;
  }
}

TEST(EffectRegistry, RefusesAnUnknownNameAndOneTwice) {
  const Vehicle vehicle = NominalVehicle();
  EXPECT_THROW(EffectRegistry::Default().Make("lift", vehicle), std::invalid_argument);
  EffectRegistry registry;
  RegisterAllEffects(&registry);
  EXPECT_THROW(registry.Add("drag", MakeDrag), std::invalid_argument);
  EXPECT_THROW(DynamicModel(vehicle, {"drag", "drag"}), std::invalid_argument);
}

// ---- Physics -----------------------------------------------------------------------------------

/// Force and torque of the paper's model at rest for given rotor speeds.
struct Rest {
  Vector3d f, tau;
};

Rest AtRest(const RotorVector& speed, const Vector3d& c) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  FlightState flight;
  flight.rotors = RotorState::Steady(speed);
  Rest rest;
  model.EvaluateWrench(flight, model.InitialValues(), c, &rest.f, &rest.tau);
  return rest;
}

RotorVector Speeds(double a, double b, double c, double d) {
  RotorVector speed(4);
  speed << a, b, c, d;
  return speed;
}

TEST(Thrust, BalancesWeightInHover) {
  const double speed = std::sqrt(0.75 * 9.81 / (4.0 * 1.5e-6));
  const Rest rest = AtRest(Speeds(speed, speed, speed, speed), Vector3d::Zero());
  EXPECT_LT((rest.f - Vector3d(0.0, 0.0, 0.75 * 9.81)).norm(), 1e-12);
  EXPECT_LT(rest.tau.norm(), 1e-12);
}

// model.md section 13, test 2. Rotors: front right, front left, rear left, rear right.
TEST(Thrust, HoverWithTheCentreOfGravityAheadNeedsFasterFrontRotors) {
  const Vector3d c(0.010, 0.0, 0.0);
  const Rest even = AtRest(Speeds(1100, 1100, 1100, 1100), c);
  EXPECT_GT(even.tau.y(), 0.0);  // nose down: M_y = +T c_x
  EXPECT_NEAR(even.tau.y(), even.f.z() * c.x(), 1e-12);
  // Front and rear shares of the weight by the lever rule.
  const double weight = 0.75 * 9.81, k_f = 1.5e-6, half = 0.095;
  const double front = 0.25 * weight * (1.0 + c.x() / half) / k_f;
  const double rear = 0.25 * weight * (1.0 - c.x() / half) / k_f;
  ASSERT_GT(front, rear);
  const Rest hover =
      AtRest(Speeds(std::sqrt(front), std::sqrt(front), std::sqrt(rear), std::sqrt(rear)), c);
  EXPECT_LT(hover.tau.norm(), 1e-12);
  EXPECT_NEAR(hover.f.z(), weight, 1e-12);
}

TEST(Thrust, CentreOfGravityToTheLeftRollsLeftSideDown) {
  const Rest rest = AtRest(Speeds(1100, 1100, 1100, 1100), Vector3d(0.0, 0.01, 0.0));
  EXPECT_NEAR(rest.tau.x(), -rest.f.z() * 0.01, 1e-12);
}

// model.md section 13, test 3.
TEST(Thrust, FasterFrontLeftRotorRollsRightAndPitchesUp) {
  const Rest rest = AtRest(Speeds(1100, 1200, 1100, 1100), Vector3d::Zero());
  EXPECT_GT(rest.tau.x(), 0.0);
  EXPECT_LT(rest.tau.y(), 0.0);
}

// model.md section 13, test 4.
TEST(RotorTorque, FasterClockwiseRotorsTurnTheNoseLeft) {
  const Rest rest = AtRest(Speeds(1200, 1100, 1200, 1100), Vector3d::Zero());
  EXPECT_GT(rest.tau.z(), 0.0);
  EXPECT_NEAR(rest.tau.z(), 2.1e-8 * 2.0 * (1200.0 * 1200.0 - 1100.0 * 1100.0), 1e-12);
  EXPECT_NEAR(rest.tau.x(), 0.0, 1e-12);
}

TEST(Drag, NeverAddsEnergy) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, {"drag", "viscous_torque"});
  ModelValues values(model.num_parameters());
  values << -0.30, -0.25, -0.20, -3e-3, -3e-3, -1.5e-3;
  Random random(4);
  for (int i = 0; i < 100; ++i) {
    const FlightState flight = RandomFlight(vehicle, &random);
    Vector3d f, tau;
    model.EvaluateWrench(flight, values, Vector3d::Zero(), &f, &tau);
    EXPECT_LT(f.dot(flight.v_AB_B), 0.0);
    EXPECT_LT(tau.dot(flight.w_WB_B), 0.0);
  }
}

TEST(Drag, IsLinearInTheVelocity) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, {"drag"});
  ModelValues values(3);
  values << -0.30, -0.25, -0.20;
  FlightState flight;
  flight.v_AB_B = {1.0, -2.0, 3.0};
  flight.rotors = RotorState::Steady(RotorVector::Zero(4));
  Vector3d f, tau;
  model.EvaluateWrench(flight, values, {0.01, 0.02, 0.03}, &f, &tau);
  EXPECT_LT((f - Vector3d(-0.30, 0.50, -0.60)).norm(), 1e-15);
  EXPECT_EQ(tau, Vector3d::Zero());  // the paper's drag has no lever
}

TEST(Hvt, IsAForceAlongBodyZByTheSquareOfTheHorizontalSpeed) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, {"hvt"});
  ModelValues values(1);
  values << 0.007;
  FlightState flight;
  flight.R_WB = Exp(Vector3d(0.8, 0.0, 0.0)).toRotationMatrix();
  flight.v_AB_B = {3.0, -4.0, 7.0};
  flight.rotors = RotorState::Steady(RotorVector::Zero(4));
  Vector3d f, tau;
  model.EvaluateWrench(flight, values, Vector3d::Zero(), &f, &tau);
  EXPECT_LT((f - Vector3d(0.0, 0.0, 0.007 * 25.0)).norm(), 1e-15);
}

TEST(Gravity, TurnsTheVerticalAndKeepsItsLength) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, {"gravity"});
  ModelValues values(2);
  values << 0.02, -0.03;
  const BodyProperties body = model.Properties(values);
  EXPECT_NEAR(body.g_W.norm(), 9.81, 1e-12);
  // -g R_G e3 with R_G = Exp((x, y, 0)): e3 leans by (y, -x).
  EXPECT_NEAR(body.g_W.x(), 9.81 * 0.03, 1e-3);
  EXPECT_NEAR(body.g_W.y(), 9.81 * 0.02, 1e-3);
}

// The whole scene turned about the vertical: states, attitude and path of the simulated vehicle.
TEST(RigidBody, TurningTheWholeSceneTurnsTheAnswer) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  const RigidBody body(model, DefaultTruth(model));
  Random random(31);
  RigidBodyState a;
  a.p_WB = random.Next3();
  a.q_WB = Exp(random.Next3());
  a.v_WB = random.Next3(5.0);
  a.w_WB_B = random.Next3(3.0);
  a.rotor_speed = Speeds(1100, 1150, 1080, 1120);
  const Eigen::Quaterniond turn = Exp(Vector3d(0.0, 0.0, 2.0));
  RigidBodyState b = a;
  b.p_WB = turn * a.p_WB;
  b.q_WB = turn * a.q_WB;
  b.v_WB = turn * a.v_WB;
  const RotorVector command = Speeds(1150, 1120, 1090, 1180);
  for (int i = 0; i < 500; ++i) {
    a = body.Step(0.001 * i, a, command, {}, 0.001);
    b = body.Step(0.001 * i, b, command, {}, 0.001);
  }
  EXPECT_LT((b.p_WB - turn * a.p_WB).norm(), 1e-10);
  EXPECT_LT((b.v_WB - turn * a.v_WB).norm(), 1e-10);
  EXPECT_LT((b.w_WB_B - a.w_WB_B).norm(), 1e-10);
  EXPECT_LT(b.q_WB.angularDistance(turn * a.q_WB), 1e-10);
}

// ---- Through the equations of motion -----------------------------------------------------------

/// Sensor states `dt` apart of a body that turns at a constant rate about its resting Bcm.
struct Spin {
  State s0, s1;
};

Spin SpinAboutCom(const Vector3d& rate, double dt, const Vector3d& p_BcmS) {
  const auto at = [&](double time) {
    State s;
    s.q_WS = Exp(rate * time);
    s.p_WS = s.q_WS * p_BcmS;
    s.v_WS = s.q_WS * rate.cross(p_BcmS);
    s.w_WS_S = rate;
    return s;
  };
  return {at(0.0), at(dt)};
}

// model.md section 13, test 6.
TEST(DynamicsResidual, PureRotationAboutTheCentreOfGravityLeavesNoForceResidual) {
  Vehicle vehicle = NominalVehicle();
  vehicle.gravity_m_s2 = 1e-9;  // no forces at all
  const DynamicModel model(vehicle, {"centre_of_gravity"});
  const Vector3d c(0.010, -0.006, 0.015);
  ModelValues values(3);
  values << c;
  DynamicsMeasurement measurement;
  measurement.dt = 0.01;
  measurement.rotors = RotorState::Steady(RotorVector::Zero(4));
  const Vector3d rate(0.0, 0.0, 5.0);  // about a principal axis: no torque needed
  const Spin spin = SpinAboutCom(rate, measurement.dt, vehicle.odometry.p_BS - c);
  const auto e = DynamicsResidual(measurement, spin.s0, spin.s1, model, values);
  EXPECT_LT(e.segment<3>(kRowVelocity).norm(), 1e-9);
  EXPECT_LT(e.segment<3>(kRowAngular).norm(), 1e-12);
  // With the lever to the geometric centre, q = l, it does not vanish: m |w|^2 |c_xy| dt.
  const auto e_centre =
      DynamicsResidual(measurement, spin.s0, spin.s1, model, ModelValues(ModelValues::Zero(3)));
  EXPECT_NEAR(e_centre.segment<3>(kRowVelocity).norm(),
              0.75 * 25.0 * c.head<2>().norm() * measurement.dt, 1e-5);
  // A wrong sign of c doubles it.
  const auto e_mirrored =
      DynamicsResidual(measurement, spin.s0, spin.s1, model, ModelValues(ModelValues(-values)));
  EXPECT_NEAR(e_mirrored.segment<3>(kRowVelocity).norm(),
              2.0 * e_centre.segment<3>(kRowVelocity).norm(), 1e-5);
}

struct RandomInterval {
  explicit RandomInterval(const Vehicle& vehicle, unsigned seed) {
    Random random(seed);
    measurement.dt = 0.01;
    measurement.rotors = RandomFlight(vehicle, &random).rotors;
    s0.q_WS = Exp(random.Next3());
    s0.p_WS = random.Next3();
    s0.v_WS = random.Next3(5.0);
    s0.w_WS_S = random.Next3(5.0);
    s1 = s0;
    s1.q_WS = s0.q_WS * Exp(0.01 * s0.w_WS_S + random.Next3(0.01));
    s1.p_WS += 0.01 * s0.v_WS;
    s1.v_WS += random.Next3(0.2);
    s1.w_WS_S += random.Next3(0.2);
  }
  DynamicsMeasurement measurement;
  State s0, s1;
};

// model.md section 13, test 9.
TEST(DynamicsResidual, ScalesWithMassAndEveryCoefficientExceptWhereNormalised) {
  const Vehicle vehicle = NominalVehicle();
  Vehicle heavier = vehicle;
  heavier.mass_kg *= 1.1;
  const DynamicModel model(vehicle, vehicle.effects), heavy(heavier, vehicle.effects);
  const ModelValues values = DefaultTruth(model);
  ModelValues scaled = values;
  for (int k = 0; k < model.num_parameters(); ++k) {
    const std::string& effect = model.parameters()[k].effect;
    if (effect != "centre_of_gravity" && effect != "gravity") scaled[k] *= 1.1;
  }
  for (const auto form : {DynamicsForm::kMidpoint, DynamicsForm::kEuler}) {
    RandomInterval interval(vehicle, 41);
    interval.measurement.form = form;
    const auto e = DynamicsResidual(interval.measurement, interval.s0, interval.s1, model, values);
    const auto e_scaled =
        DynamicsResidual(interval.measurement, interval.s0, interval.s1, heavy, scaled);
    EXPECT_LT((e_scaled - 1.1 * e).head<6>().norm(), 1e-12 * e.head<6>().norm());
    EXPECT_LT((e_scaled - e).tail<3>().norm(), 1e-12 * e.tail<3>().norm());
  }
}

// model.md 6.4: d e_omega / d c = -dt k_f S [e3]x, the opposite of what the paper's (19) gives.
TEST(DynamicsResidual, TorqueMovesWithTheCentreOfGravityAsInModelMd64) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues values = DefaultTruth(model);
  RandomInterval interval(vehicle, 42);
  DynamicsJacobians J;
  Vector3d inertia;
  DynamicsResidual(interval.measurement, interval.s0, interval.s1, model, values, &inertia, &J);
  const int first = model.IndexOf("centre_of_gravity.x");
  const Eigen::Matrix3d d_e_omega =
      inertia.asDiagonal() * J.d_values.block<3, 3>(kRowAngular, first);
  const double thrust =
      values[model.IndexOf("thrust.k_f")] * interval.measurement.rotors.speed_squared.sum();
  const Eigen::Matrix3d expected = -interval.measurement.dt * thrust * Hat(Vector3d::UnitZ());
  EXPECT_LT((d_e_omega - expected).norm(), 1e-12);
  EXPECT_GT(expected.norm(), 1e-2);
}

}  // namespace
}  // namespace test
}  // namespace odmc
