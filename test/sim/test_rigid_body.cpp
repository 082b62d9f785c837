#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "odmc/math/so3.h"
#include "odmc/sim/rigid_body.h"
#include "odmc/sim/tracking_controller.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr double kStep = 0.0005;

// Air that moves along world x at 5 m/s.
class Breeze final : public Effect {
 public:
  explicit Breeze(const Vehicle& vehicle) : Effect(vehicle, {"breeze", "", "", "", ""}, {}) {}
  bool adds_wrench() const override { return false; }

 private:
  void DoShape(const ParameterValues& /*values*/, BodyProperties* body,
               BodyPropertyJacobian* /*J*/) const override {
    body->wind_W.x() = 5.0;
  }
};

RigidBodyState AtRest(const DynamicModel& model) {
  RigidBodyState state;
  state.rotor_speed = RotorVector::Zero(model.vehicle().num_rotors());
  return state;
}

RigidBodyState Tumbling(const DynamicModel& model) {
  RigidBodyState state = AtRest(model);
  state.q_WB = Exp({0.3, -0.8, 1.1});
  state.v_WB = {3.0, -1.0, 2.0};
  state.w_WB_B = {4.0, -6.0, 5.0};
  return state;
}

RigidBodyState Fly(const RigidBody& body, RigidBodyState state, const RotorVector& command,
                   double duration_s, double step_s = kStep) {
  const int num_steps = static_cast<int>(std::lround(duration_s / step_s));
  for (int i = 0; i < num_steps; ++i) state = body.Step(i * step_s, state, command, {}, step_s);
  return state;
}

Eigen::Vector3d MomentumAboutBcm_W(const RigidBody& body, const RigidBodyState& state) {
  return state.q_WB * (body.properties().I_BBcm_B * state.w_WB_B);
}

double Energy(const RigidBody& body, const RigidBodyState& state) {
  const BodyProperties& properties = body.properties();
  const Eigen::Vector3d p_WBcm = state.p_WB + state.q_WB * properties.p_BBcm;
  const Eigen::Vector3d v_WBcm = state.v_WB + state.q_WB * state.w_WB_B.cross(properties.p_BBcm);
  return 0.5 * properties.mass * v_WBcm.squaredNorm() +
         0.5 * state.w_WB_B.dot(properties.I_BBcm_B * state.w_WB_B) -
         properties.mass * properties.g_W.dot(p_WBcm);
}

class RigidBodyTest : public ::testing::Test {
 protected:
  RigidBodyTest()
      : airless_(test::NominalVehicle(),
                 {"thrust", "rotor_torque", "centre_of_gravity", "inertia"}),
        full_(test::NominalVehicle(), test::PaperEffects()) {}

  // Force and torque with rotor `j` at `factor` times the others' speed.
  BodyWrench WithOneRotorAt(int j, double factor) const {
    const DynamicModel model(test::NominalVehicle(), {"thrust", "rotor_torque"});
    const RigidBody body(model, DefaultTruth(model));
    RigidBodyState state = AtRest(model);
    state.rotor_speed.setConstant(1000.0);
    state.rotor_speed[j] *= factor;
    return body.WrenchOf(body.FlightStateOf(0.0, state, state.rotor_speed));
  }

  DynamicModel airless_;
  DynamicModel full_;
};

TEST_F(RigidBodyTest, FallsFreelyAboutItsCentreOfGravity) {
  const RigidBody body(airless_, DefaultTruth(airless_));
  const RigidBodyState start = Tumbling(airless_);
  const RigidBodyState end = Fly(body, start, start.rotor_speed, 1.0);
  const Eigen::Vector3d& p_BBcm = body.properties().p_BBcm;
  EXPECT_GT(p_BBcm.norm(), 0.01);
  const Eigen::Vector3d v_WBcm = start.v_WB + start.q_WB * start.w_WB_B.cross(p_BBcm);
  const Eigen::Vector3d expected =
      start.p_WB + start.q_WB * p_BBcm + v_WBcm + 0.5 * body.properties().g_W;
  EXPECT_LT((end.p_WB + end.q_WB * p_BBcm - expected).norm(), 1e-9);
}

TEST_F(RigidBodyTest, KeepsEnergyAndAngularMomentumWithoutTorque) {
  const RigidBody body(airless_, DefaultTruth(airless_));
  const RigidBodyState start = Tumbling(airless_);
  const RigidBodyState end = Fly(body, start, start.rotor_speed, 2.0);
  EXPECT_GT((end.w_WB_B - start.w_WB_B).norm(), 0.1) << "an asymmetric body must tumble";
  EXPECT_LT((MomentumAboutBcm_W(body, end) - MomentumAboutBcm_W(body, start)).norm(), 1e-10);
  EXPECT_NEAR(Energy(body, end), Energy(body, start), 1e-9);
}

TEST_F(RigidBodyTest, PrecessesAsASymmetricTop) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.inertia_kg_m2 = {2e-3, 2e-3, 3e-3};
  const DynamicModel model(vehicle, {"thrust"});
  const RigidBody body(model, DefaultTruth(model));
  RigidBodyState state = AtRest(model);
  state.w_WB_B = {1.0, 0.0, 8.0};
  state = Fly(body, state, state.rotor_speed, 1.0);
  // Euler: the equatorial rate turns in the body at (I3 - I1) / I1 w3 = 4 rad/s.
  EXPECT_NEAR(state.w_WB_B.x(), std::cos(4.0), 1e-9);
  EXPECT_NEAR(state.w_WB_B.y(), std::sin(4.0), 1e-9);
  EXPECT_NEAR(state.w_WB_B.z(), 8.0, 1e-12);
}

TEST_F(RigidBodyTest, LosesEnergyToTheAir) {
  const RigidBody body(full_, DefaultTruth(full_));
  RigidBodyState state = Tumbling(full_);
  double energy = Energy(body, state);
  for (int i = 0; i < 20; ++i) {
    state = Fly(body, state, state.rotor_speed, 0.05);
    EXPECT_LT(Energy(body, state), energy);
    energy = Energy(body, state);
  }
}

TEST_F(RigidBodyTest, HoversAtTheSpeedsThatBalanceIt) {
  const RigidBody body(full_, DefaultTruth(full_));
  RigidBodyState state = AtRest(full_);
  state.rotor_speed = TrackingController(body).HoverSpeeds();
  const RotorVector command = state.rotor_speed;
  state = Fly(body, state, command, 1.0);
  EXPECT_LT(state.p_WB.norm(), 1e-9);
  EXPECT_LT(state.w_WB_B.norm(), 1e-9);
}

// model.md section 13, test 2.
TEST_F(RigidBodyTest, FrontRotorsCarryMoreWithTheCentreOfGravityAhead) {
  ModelValues truth = DefaultTruth(full_);
  truth.segment<3>(full_.IndexOf("centre_of_gravity.x")) << 0.010, 0.0, 0.0;
  const RigidBody body(full_, truth);
  const RotorVector speed = TrackingController(body).HoverSpeeds();
  EXPECT_GT(speed[0], speed[3]);  // front right over rear right
  EXPECT_GT(speed[1], speed[2]);  // front left over rear left
  const double k_f = truth[full_.IndexOf("thrust.k_f")];
  Eigen::Vector3d torque = Eigen::Vector3d::Zero();
  double thrust = 0.0;
  for (int j = 0; j < 4; ++j) {
    const Eigen::Vector3d f_j = k_f * speed[j] * speed[j] * Eigen::Vector3d::UnitZ();
    torque += (full_.vehicle().rotors[j].p_BP - Eigen::Vector3d(0.010, 0.0, 0.0)).cross(f_j);
    thrust += f_j.z();
  }
  EXPECT_LT(torque.norm(), 1e-12);
  EXPECT_NEAR(thrust, 0.75 * 9.81, 1e-9);
}

// model.md section 13, test 3.
TEST_F(RigidBodyTest, FasterFrontLeftRotorRollsRightAndPitchesUp) {
  const BodyWrench wrench = WithOneRotorAt(1, 1.1);
  EXPECT_GT(wrench.tau_Bcm_B.x(), 1e-3);
  EXPECT_LT(wrench.tau_Bcm_B.y(), -1e-3);
}

// model.md section 13, test 4.
TEST_F(RigidBodyTest, FasterClockwiseRotorTurnsTheNoseLeft) {
  EXPECT_GT(WithOneRotorAt(0, 1.1).tau_Bcm_B.z(), 1e-4);
  EXPECT_LT(WithOneRotorAt(1, 1.1).tau_Bcm_B.z(), -1e-4);
}

TEST_F(RigidBodyTest, AnExternalWrenchActsAboutTheCentreOfGravity) {
  const RigidBody body(full_, DefaultTruth(full_));
  const RigidBodyState state = AtRest(full_);
  const BodyWrench push = {Eigen::Vector3d(1.5, 0.0, 0.0), Eigen::Vector3d(0.0, 0.0, 4.3e-3)};
  const RigidBodyRate rate = body.RateOf(state, push);
  EXPECT_LT((rate.d_w_WB_B - Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  const Eigen::Vector3d a_Bcm =
      rate.d_v_WB + rate.d_w_WB_B.cross(body.properties().p_BBcm) - body.properties().g_W;
  EXPECT_LT((a_Bcm - Eigen::Vector3d(2.0, 0.0, 0.0)).norm(), 1e-12);
}

TEST_F(RigidBodyTest, IsPushedByTheWind) {
  EffectRegistry registry;
  RegisterAllEffects(&registry);
  registry.Add("breeze", [](const Vehicle& vehicle) { return std::make_unique<Breeze>(vehicle); });
  const DynamicModel model(test::NominalVehicle(), {"drag", "breeze"}, registry);
  ModelValues values = ModelValues::Zero(3);
  values[model.IndexOf("drag.d_x")] = -0.30;
  const RigidBody body(model, values);
  const RigidBodyState state = AtRest(model);
  const FlightState flight = body.FlightStateOf(0.0, state, state.rotor_speed);
  EXPECT_NEAR(body.WrenchOf(flight).f_B.x(), 0.30 * 5.0, 1e-12);
}

TEST_F(RigidBodyTest, StepsWithFourthOrder) {
  const RigidBody body(full_, DefaultTruth(full_));
  RigidBodyState start = Tumbling(full_);
  start.rotor_speed.setConstant(900.0);
  RotorVector command(4);
  command << 1200.0, 1000.0, 1150.0, 1300.0;
  const RigidBodyState exact = Fly(body, start, command, 0.4, 0.0005);
  const auto error = [&](double step_s) {
    const RigidBodyState end = Fly(body, start, command, 0.4, step_s);
    return (end.p_WB - exact.p_WB).norm() + (end.v_WB - exact.v_WB).norm() +
           Log(exact.q_WB.conjugate() * end.q_WB).norm() + (end.w_WB_B - exact.w_WB_B).norm();
  };
  const double order = std::log2(error(0.02) / error(0.01));
  EXPECT_GT(order, 3.7);
  EXPECT_LT(order, 4.5);
}

TEST(MotorLag, GivesTheRatesOfItsOwnMotion) {
  const MotorLag motor;
  RotorVector start(2), command(2);
  start << 800.0, 1000.0;
  command << 1200.0, 900.0;
  const double dt = 1e-5;
  const RotorVector now = motor.After(start, command, 0.01);
  const RotorVector before = motor.After(start, command, 0.01 - dt);
  const RotorVector after = motor.After(start, command, 0.01 + dt);
  const RotorState state = motor.At(now, command);
  for (int j = 0; j < 2; ++j) {
    EXPECT_NEAR(state.acceleration[j], (after[j] - before[j]) / (2 * dt), 1e-2);
    EXPECT_NEAR(state.speed_squared[j], now[j] * now[j], 1e-6);
    EXPECT_NEAR(state.speed_squared_rate[j],
                (after[j] * after[j] - before[j] * before[j]) / (2 * dt), 20.0);
  }
  EXPECT_NEAR(motor.After(start, command, 0.025)[0], 1200.0 - 400.0 * std::exp(-1.0), 1e-9);
}

}  // namespace
}  // namespace odmc
