#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>

#include "odmc/control/flat_inputs.h"
#include "odmc/control/flatness_controller.h"
#include "odmc/math/so3.h"
#include "odmc/sim/rigid_body.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/trajectory/trajectory.h"
#include "support/test_actuator.h"

namespace odmc {
namespace {

// The vehicle of model.md section 8 at its true values, known to the controller.
struct Known {
  Known() {
    vehicle.odometry = SensorMount();
    model = std::make_shared<DynamicModel>(vehicle, vehicle.effects);
    truth = DefaultTruth(*model);
  }
  Vehicle vehicle = test::NominalVehicle();
  std::shared_ptr<const DynamicModel> model;
  ModelValues truth;
};

TrajectoryOptions Octo(double top_speed_m_s) {
  TrajectoryOptions options;
  options.name = "octo";
  options.top_speed_m_s = top_speed_m_s;
  return options;
}

// Largest distance from the reference over `duration_s` of flight without any feedback, from a
// start that is exact.
double OpenLoopError(const Known& known, const CompensatedEffects& compensation, double from_s,
                     double duration_s) {
  ControlModel control(known.model, compensation);
  control.SetValues(known.truth);
  const Allocation allocation(control.rotor_map(), known.vehicle.ArmLength(), 1e3, 1e7);
  const Trajectory trajectory(Octo(5.0));
  const RigidBody body(*known.model, known.truth, MotorLag{1e-5});

  const FlatReference start = trajectory.At(from_s);
  const FlatInputs inputs = FlatInputsOf(control, allocation, start);
  RigidBodyState state;
  state.p_WB = start.p_WB;
  state.v_WB = start.v_WB;
  state.q_WB = inputs.attitude.q_WB;
  state.w_WB_B = inputs.attitude.w_WB_B;
  state.rotor_speed = inputs.rotor_speed;
  constexpr double kStep_s = 0.0005;
  double largest = 0.0;
  for (int k = 0; k < std::lround(duration_s / kStep_s); ++k) {
    const double t = from_s + kStep_s * k;
    const RotorVector speeds =
        FlatInputsOf(control, allocation, trajectory.At(t + 0.5 * kStep_s)).rotor_speed;
    state = body.Step(t, state, speeds, {}, kStep_s);
    const double error = (state.p_WB - trajectory.At(t + kStep_s).p_WB).norm();
    largest = std::max(largest, error);
  }
  return largest;
}

// Rotor speeds from the reference alone keep the vehicle on it: every formula of flatness agrees
// with the simulator, drag, HVT, viscous torque and centre of gravity included.
TEST(FlatInputs, TrackTheReferenceOpenLoop) {
  const Known known;
  const double with_all = OpenLoopError(known, {}, 5.0, 2.0);
  EXPECT_LT(with_all, 0.03);  // of 9 m flown
  CompensatedEffects no_drag;
  no_drag.drag = false;
  EXPECT_GT(OpenLoopError(known, no_drag, 5.0, 2.0), 20.0 * with_all);
  CompensatedEffects no_viscous;
  no_viscous.viscous_torque = false;
  EXPECT_GT(OpenLoopError(known, no_viscous, 5.0, 2.0), 5.0 * with_all);
  CompensatedEffects no_hvt;
  no_hvt.hvt = false;
  EXPECT_GT(OpenLoopError(known, no_hvt, 5.0, 2.0), 5.0 * with_all);
}

TEST(ControlModel, SwitchesOffWhatIsNotCompensated) {
  const Known known;
  ControlModel all(known.model, {}), none(known.model, CompensatedEffects::None());
  all.SetValues(known.truth);
  none.SetValues(known.truth);
  const RotorVector speeds = RotorVector::Constant(4, 1000.0);
  const Eigen::Vector3d v(3.0, -2.0, 1.0), w(1.0, 2.0, -1.0), p(0.0, 0.0, 5.0);
  const Eigen::Matrix3d R = Exp({0.2, -0.1, 0.4}).toRotationMatrix();
  EXPECT_GT(all.AirWrench(p, R, v, w, speeds).f_B.norm(), 0.5);
  EXPECT_LT(none.AirWrench(p, R, v, w, speeds).f_B.norm(), 1e-9);
  EXPECT_LT(none.AirWrench(p, R, v, w, speeds).tau_Bcm_B.norm(), 1e-9);
  EXPECT_EQ(none.properties().p_BBcm, Eigen::Vector3d::Zero());
  EXPECT_EQ(none.properties().I_BBcm_B, all.properties().I_BBcm_B);  // thrust and inertia stay
  EXPECT_NEAR(none.rotor_map()(0, 0), all.rotor_map()(0, 0), 1e-15);
}

// A vehicle and its controller without noise.
class ControllerTest : public ::testing::Test {
 protected:
  void SetUp() override {
    state_.p_WB = {0.0, 0.0, 2.0};
    state_.rotor_speed = RotorVector::Constant(4, std::sqrt(known_.vehicle.mass_kg * 9.81 / 6e-6));
    command_ = state_.rotor_speed;
    reference_.p_WB = state_.p_WB;
    controller_.SetModel(known_.model, known_.truth);
  }

  // Flies on; with `sees`, odometry comes too.
  ControlCommand Fly(double seconds, bool sees = true, bool has_imu = true) {
    ControlCommand command;
    for (int k = 0; k < std::lround(seconds / 0.002); ++k) {
      now_ += FromSeconds(0.002);
      state_ = body_.Step(ToSeconds(now_), state_, command_, external_, 0.001);
      state_ = body_.Step(ToSeconds(now_), state_, command_, external_, 0.001);
      const FlightState flight = body_.FlightStateOf(0.0, state_, command_);
      BodyWrench wrench = body_.WrenchOf(flight);
      wrench.f_B += external_.f_B;
      wrench.tau_Bcm_B += external_.tau_Bcm_B;
      const Eigen::Vector3d a_WB = body_.RateOf(state_, wrench).d_v_WB;
      if (has_imu) {
        controller_.Add(ImuSample{now_, state_.w_WB_B,
                                  state_.q_WB.conjugate() * (a_WB - body_.properties().g_W)});
      }
      controller_.Add(RotorSample{now_, state_.rotor_speed});
      if (sees && k % 5 == 0) {
        controller_.Add(OdometrySample{now_, state_.p_WB, state_.q_WB, state_.v_WB, state_.w_WB_B});
      }
      command = controller_.Update(now_, reference_);
      command_ = command.rotor_speed;
      EXPECT_TRUE(command_.allFinite());
    }
    return command;
  }

  double Error() const { return (state_.p_WB - reference_.p_WB).norm(); }
  double Tilt() const { return std::acos((state_.q_WB * Eigen::Vector3d::UnitZ()).z()); }

  Known known_;
  RigidBody body_{*known_.model, known_.truth};
  FlatnessController controller_{ControllerOptions(), known_.model};
  RigidBodyState state_;
  RotorVector command_;
  BodyWrench external_;
  FlatReference reference_;
  Stamp now_ = 0;
};

TEST_F(ControllerTest, ReachesAStepWithoutLeavingItsBounds) {
  Fly(1.0);
  reference_.p_WB += Eigen::Vector3d(2.0, -1.0, 0.5);
  reference_.yaw = 1.5;
  Fly(4.0);
  EXPECT_LT(Error(), 0.002);
  const Eigen::Vector3d ahead = state_.q_WB * Eigen::Vector3d::UnitX();
  EXPECT_NEAR(std::atan2(ahead.y(), ahead.x()), 1.5, 0.01);
}

TEST_F(ControllerTest, RecoversFromAlmostUpsideDown) {
  state_.q_WB = Exp({2.5, 0.0, 0.0});
  state_.p_WB.z() = 20.0;
  reference_.p_WB.z() = 20.0;
  Fly(6.0);
  EXPECT_LT(Error(), 0.01);
  EXPECT_LT(Tilt(), 0.1);
}

// Incremental inversion takes a torque nobody told it of; without it the vehicle is pushed off.
TEST_F(ControllerTest, TheInnerLoopRejectsAnUnknownTorque) {
  external_.tau_Bcm_B = {0.03, -0.02, 0.0};
  const ControlCommand command = Fly(4.0);
  EXPECT_TRUE(command.indi);
  const double with = Error();
  EXPECT_LT(with, 0.003);
  ControllerOptions plain;
  plain.indi = false;
  controller_ = FlatnessController(plain, known_.model);
  controller_.SetModel(known_.model, known_.truth);
  EXPECT_FALSE(Fly(4.0).indi);
  EXPECT_GT(Error(), 10.0 * with);
}

TEST_F(ControllerTest, FliesWithoutAnImu) {
  const ControlCommand command = Fly(4.0, true, false);
  EXPECT_FALSE(command.indi);
  EXPECT_EQ(command.mode, ControlMode::kTracking);
  EXPECT_LT(Error(), 0.02);
}

TEST_F(ControllerTest, LevelsAndSinksWithoutOdometryAndComesBack) {
  Fly(1.0);
  state_.q_WB = Exp({0.3, 0.0, 0.0});
  Fly(0.02);
  const double height = state_.p_WB.z();
  const ControlCommand command = Fly(2.0, false);
  EXPECT_EQ(command.mode, ControlMode::kFailsafe);
  EXPECT_LT(Tilt(), 0.15);
  EXPECT_LT(state_.v_WB.z(), -0.1);
  EXPECT_GT(state_.p_WB.z(), height - 3.0);
  EXPECT_EQ(Fly(3.0).mode, ControlMode::kTracking);
  EXPECT_LT(Error(), 0.05);
}

TEST_F(ControllerTest, IdlesWithoutReferenceAndOnTheGround) {
  EXPECT_EQ(controller_.Update(0, std::nullopt).mode, ControlMode::kIdle);
  Fly(0.1);
  reference_.standing = true;
  const ControlCommand command = controller_.Update(now_ + 1, reference_);
  EXPECT_EQ(command.mode, ControlMode::kIdle);
  EXPECT_LT(command.rotor_speed.maxCoeff(), 0.3 * state_.rotor_speed.minCoeff());
}

TEST_F(ControllerTest, CompensatesACentreOfMassOffTheOrigin) {
  ASSERT_GT(body_.properties().p_BBcm.norm(), 0.01);
  ControllerOptions options;
  options.indi = false;
  options.compensation.centre_of_gravity = false;
  controller_ = FlatnessController(options, known_.model);
  controller_.SetModel(known_.model, known_.truth);
  Fly(5.0);
  const double without = Error();
  options.compensation.centre_of_gravity = true;
  controller_ = FlatnessController(options, known_.model);
  controller_.SetModel(known_.model, known_.truth);
  Fly(5.0);
  EXPECT_LT(Error(), 0.1 * without);
}

// ---- One step, against the law by hand ---------------------------------------------------------

constexpr double kGravity = 9.81, kMass = 0.75;
const Eigen::Vector3d kUp = Eigen::Vector3d::UnitZ();

double& Value(Known* known, const std::string& name) {
  return known->truth[known->model->IndexOf(name)];
}

FlatnessController Controller(const Known& known, const ControllerOptions& options = {}) {
  FlatnessController controller(options, known.model);
  controller.SetModel(known.model, known.truth);
  return controller;
}

// What `controller` commands where odometry sees the body level, on its reference and at its speed,
// turning with `w_WB_B`.
ControlCommand CommandOf(FlatnessController controller, const FlatReference& reference,
                         const Eigen::Vector3d& w_WB_B = Eigen::Vector3d::Zero()) {
  constexpr Stamp kNow = 1000000000;
  controller.Add(
      OdometrySample{kNow, reference.p_WB, Eigen::Quaterniond::Identity(), reference.v_WB, w_WB_B});
  return controller.Update(kNow, reference);
}

// Collective thrust and torque about Bcm that rotor speeds make.
Eigen::Vector4d WrenchOf(const Known& known, const RotorVector& rotor_speed) {
  const RotorMap map =
      RotorMapAtRest(*known.model, known.truth, known.model->Properties(known.truth));
  return map * rotor_speed.cwiseAbs2();
}

void ExpectThrustAlong(const Eigen::Vector3d& direction_W, const ControlCommand& command) {
  const Eigen::Vector3d z_W = command.q_WB_cmd * kUp;
  EXPECT_LT((z_W - direction_W.normalized()).norm(), 1e-6)
      << z_W.transpose() << " instead of " << direction_W.normalized().transpose();
}

TEST(FlatnessController, LeansAgainstTheDragOfItsFlightThroughTheAir) {
  Known known;
  known.vehicle.effects.push_back("wind");
  known.model = std::make_shared<DynamicModel>(known.vehicle, known.vehicle.effects);
  known.truth = DefaultTruth(*known.model);
  Value(&known, "hvt.k_h") = 0.0;
  FlatReference reference;
  reference.v_WB = {4.0, 0.0, 0.0};
  const Eigen::Vector3d against_drag(0.30 * 4.0 / kMass, 0.0, 0.0);
  ExpectThrustAlong(against_drag + kGravity * kUp, CommandOf(Controller(known), reference));
  Value(&known, "wind.w_x") = 4.0;
  ExpectThrustAlong(kUp, CommandOf(Controller(known), reference));
}

// Speeding up from rest, drag grows with a d_x / m; leaning into it takes that rate over g.
TEST(FlatnessController, TurnsAsTheDragAlongTheReferenceGrows) {
  const Known known;
  FlatReference reference;
  reference.a_WB = {1.0, 0.0, 0.0};
  const FlatnessController controller = Controller(known);
  const ControlCommand command = CommandOf(controller, reference);
  const Eigen::Vector3d feedback =
      controller.gains().attitude_1_s.cwiseProduct(Log(command.q_WB_cmd));
  const double growth = 0.30 / kMass * 1.0;  // [m/s³]
  const double lean = growth * kGravity / (1.0 + kGravity * kGravity);
  EXPECT_NEAR((command.w_WB_B_cmd - feedback).y(), lean, 0.03 * lean);
}

// Thrust acts at Bcm, which circles about Bo while the body turns.
TEST(FlatnessController, CarriesTheCentreOfMassRoundInATurn) {
  const Known known;
  FlatReference reference;
  reference.d_yaw = 3.0;
  const Eigen::Vector3d to_the_axis(-9.0 * 0.010, 9.0 * 0.006, 0.0);
  ExpectThrustAlong(to_the_axis + kGravity * kUp,
                    CommandOf(Controller(known), reference, {0.0, 0.0, 3.0}));
}

TEST(FlatnessController, PushesAgainstTheEstimatedGravity) {
  Known known;
  Value(&known, "gravity.x") = 0.05;
  Value(&known, "gravity.y") = -0.03;
  const Eigen::Vector3d up_W = Exp({0.05, -0.03, 0.0}) * kUp;
  FlatnessController controller = Controller(known);
  ExpectThrustAlong(up_W, CommandOf(controller, FlatReference()));
  // Between odometry samples, too, a body that hangs still is known to hang still.
  controller.Add(OdometrySample{0, Eigen::Vector3d::Zero(), Eigen::Quaterniond::Identity(),
                                Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()});
  for (int k = 0; k <= 50; ++k) {
    controller.Add(ImuSample{FromSeconds(0.002 * k), Eigen::Vector3d::Zero(), kGravity * up_W});
  }
  EXPECT_LT(controller.StateAt(FromSeconds(0.1))->v_WB.norm(), 1e-6);
}

TEST(FlatnessController, HoversWithoutTorqueAboutTheCentreOfMass) {
  const Known known;
  const RotorVector squared = CommandOf(Controller(known), FlatReference()).rotor_speed.cwiseAbs2();
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  for (int j = 0; j < squared.size(); ++j) {
    const Eigen::Vector3d arm = known.vehicle.rotors[j].p_BP - Eigen::Vector3d(0.010, -0.006, 0.0);
    moment += arm.cross(1.5e-6 * squared[j] * kUp);
  }
  EXPECT_LT(moment.norm(), 1e-5);  // the offset alone makes 0.09
  EXPECT_NEAR(1.5e-6 * squared.sum(), kMass * kGravity, 1e-6);
}

// Torque by the model: gyroscopic moment and viscous torque, by hand.
TEST(FlatnessController, TorqueWithoutTheInnerLoopIsEulersEquation) {
  const Known known;
  ControllerOptions options;
  options.indi = false;
  const Eigen::Vector3d w(1.5, -1.0, 0.5);
  const ControlCommand command = CommandOf(Controller(known, options), FlatReference(), w);
  ASSERT_FALSE(command.allocation.saturated());
  const Eigen::Vector3d I(2.5e-3, 2.1e-3, 4.3e-3), b(-3.0e-3, -3.0e-3, -1.5e-3);
  const Eigen::Vector3d dw = GainsFor(options).rate_1_s.cwiseProduct(command.w_WB_B_cmd - w);
  const Eigen::Vector3d torque =
      I.cwiseProduct(dw) + w.cross(I.cwiseProduct(w)) - b.cwiseProduct(w);
  EXPECT_LT((WrenchOf(known, command.rotor_speed).tail<3>() - torque).norm(), 1e-6);
}

// While rotors turn the body as they should, filtered torque and filtered acceleration cancel: one
// phase for both. Otherwise the loop answers to its own delay.
TEST(FlatnessController, FiltersRotorTorqueAndAccelerationAlike) {
  const Known known;
  ControllerOptions options;
  options.motor_lead = 1.0;
  FlatnessController controller = Controller(known, options);
  const Allocation allocation(controller.model().rotor_map(), known.vehicle.ArmLength(), 1e3, 1e7);
  constexpr double kRate = 2.0 * M_PI * 15.0, kRoll = 0.2, kInertia = 2.5e-3;  // 15 Hz
  double largest = 0.0;
  for (int k = 0; k < 500; ++k) {
    const double t = 0.001 * k;
    const Stamp now = FromSeconds(t);
    const Eigen::Vector3d w(kRoll * std::sin(kRate * t), 0.0, 0.0);
    const double torque = kInertia * kRoll * kRate * std::cos(kRate * t);
    const RotorVector squared = allocation.SquaredSpeeds({kMass * kGravity, torque, 0.0, 0.0});
    controller.Add(ImuSample{now, w, kGravity * kUp});
    controller.Add(RotorSample{now, squared.cwiseSqrt()});
    controller.Add(OdometrySample{now, Eigen::Vector3d::Zero(), Eigen::Quaterniond::Identity(),
                                  Eigen::Vector3d::Zero(), w});
    const ControlCommand command = controller.Update(now, FlatReference());
    if (t < 0.2) continue;
    ASSERT_TRUE(command.indi);
    ASSERT_FALSE(command.allocation.saturated());
    const double asked = kInertia * controller.gains().rate_1_s.x() * (command.w_WB_B_cmd - w).x();
    largest = std::max(largest, std::abs(WrenchOf(known, command.rotor_speed)[1] - asked));
  }
  EXPECT_LT(largest, 0.02 * kInertia * kRoll * kRate);
}

TEST(FlatnessController, SeesTheBodyThroughMountedSensors) {
  Known known;
  SensorMount S, I;
  S.p_BS = {-0.03, 0.02, 0.04};
  S.q_BS = Exp({0.1, -0.2, 0.5});
  I.p_BS = {0.05, -0.04, 0.02};
  I.q_BS = Exp({-0.3, 0.1, 0.2});
  known.vehicle.odometry = S;
  known.vehicle.imu = I;
  known.model = std::make_shared<DynamicModel>(known.vehicle, known.vehicle.effects);
  known.truth = DefaultTruth(*known.model);
  FlatnessController controller = Controller(known);
  // Turns on the spot.
  const Eigen::Vector3d p_WB(1.0, 2.0, 3.0), w(0.0, 0.0, 4.0);
  const Eigen::Quaterniond q_WB = Exp({0.0, 0.0, 0.3});
  controller.Add(OdometrySample{0, p_WB + q_WB * S.p_BS, q_WB * S.q_BS, q_WB * w.cross(S.p_BS),
                                S.q_BS.conjugate() * w});
  const Eigen::Vector3d at_imu_B = kGravity * kUp + w.cross(w.cross(I.p_BS));
  for (int k = 0; k <= 50; ++k) {
    controller.Add(
        ImuSample{FromSeconds(0.002 * k), I.q_BS.conjugate() * w, I.q_BS.conjugate() * at_imu_B});
  }
  const std::optional<BodyState> state = controller.StateAt(FromSeconds(0.1));
  ASSERT_TRUE(state);
  EXPECT_LT((state->p_WB - p_WB).norm(), 1e-6);
  EXPECT_LT(state->v_WB.norm(), 1e-6);
  EXPECT_LT(Log(state->q_WB.conjugate() * Exp({0.0, 0.0, 0.7})).norm(), 1e-6);
}

TEST(FlatnessController, LimitsFeedbackAndTilt) {
  const Known known;
  ControllerOptions options;
  FlatReference far;
  far.p_WB = {100.0, 0.0, 0.0};
  const auto command_of = [&] {
    FlatnessController controller = Controller(known, options);
    controller.Add(OdometrySample{0, Eigen::Vector3d::Zero(), Eigen::Quaterniond::Identity(),
                                  Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()});
    return controller.Update(0, far);
  };
  ExpectThrustAlong({options.max_feedback_m_s2, 0.0, kGravity}, command_of());
  options.max_feedback_m_s2 = 1000.0;
  ExpectThrustAlong({std::sin(options.max_tilt_rad), 0.0, std::cos(options.max_tilt_rad)},
                    command_of());
}

TEST(FlatnessController, LeadsTheMotorsWithinTheirLimits) {
  const Known known;
  const auto command_of = [&](double lead, double rotor_speed) {
    ControllerOptions options;
    options.motor_lead = lead;
    FlatnessController controller = Controller(known, options);
    controller.Add(RotorSample{1000000000, RotorVector::Constant(4, rotor_speed)});
    return CommandOf(controller, FlatReference()).rotor_speed;
  };
  const RotorVector now = RotorVector::Constant(4, 1080.0);
  EXPECT_LT((command_of(2.0, 1080.0) - now - 2.0 * (command_of(1.0, 1080.0) - now)).norm(), 1e-6);
  const double hover = std::sqrt(kMass * kGravity / 6e-6);
  EXPECT_NEAR(command_of(4.0, 1.7 * hover).minCoeff(), std::sqrt(0.05) * hover, 1e-6);
}

TEST(ControllerOptions, RefusesWhatCannotBeFlown) {
  std::string error;
  ControllerOptions options;
  EXPECT_TRUE(options.IsValid(&error));
  options.motor_time_constant_s = 0.0;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_NE(error.find("motor_time_constant_s"), std::string::npos);
  options = ControllerOptions();
  options.position_gain_1_s2.x() = std::nan("");
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_THROW(FlatnessController(options, Known().model), std::invalid_argument);
}

// The loops of GainsFor() are well damped around motors of very different speed.
TEST(ControllerOptions, DerivesGainsFromTheMotors) {
  for (const double T : {0.01, 0.025, 0.08}) {
    ControllerOptions options;
    options.motor_time_constant_s = T;
    const ControllerGains gains = GainsFor(options);
    // T' s² + s + K with T' the time constant with lead: ζ = 1 / (2 √(K T')).
    const double zeta = 0.5 / std::sqrt(gains.rate_1_s.x() * T / options.motor_lead);
    EXPECT_NEAR(zeta, M_SQRT1_2, 1e-9);
    EXPECT_GT(gains.rate_1_s.x(), 2.0 * gains.attitude_1_s.x());
    EXPECT_GT(gains.attitude_1_s.x(), 2.0 * std::sqrt(gains.position_1_s2.x()));
  }
  ControllerOptions stated;
  stated.attitude_gain_1_s = {0.0, 5.0, 0.0};
  EXPECT_EQ(GainsFor(stated).attitude_1_s.y(), 5.0);
  EXPECT_EQ(GainsFor(stated).attitude_1_s.x(), GainsFor({}).attitude_1_s.x());
}

// ---- Throttle ----

// A controller that idles, and what its throttles ask of the motors at `voltage`.
struct Throttled {
  explicit Throttled(const Actuator& actuator, const ControllerOptions& options = {}) {
    Vehicle vehicle = test::NominalVehicle();
    vehicle.actuator = actuator;
    controller.emplace(options, std::make_shared<DynamicModel>(vehicle, vehicle.effects));
    motor = actuator.motors.front();
  }
  ControlCommand Update(double t_s) { return controller->Update(FromSeconds(t_s), std::nullopt); }
  // Of the first rotor [rad/s²].
  double Acceleration(const ControlCommand& command, double speed, double voltage) const {
    return motor.esc.Drive(command.throttle[0], voltage) - motor.dynamics.DriveFor(speed);
  }
  std::optional<FlatnessController> controller;
  Motor motor;
};

TEST(Throttle, IsThereWithAnActuatorOnly) {
  const auto model =
      std::make_shared<DynamicModel>(test::NominalVehicle(), test::NominalVehicle().effects);
  FlatnessController plain({}, model);
  EXPECT_EQ(plain.Update(FromSeconds(1.0), std::nullopt).throttle.size(), 0);
  Throttled with(test::GenericActuator());
  EXPECT_EQ(with.Update(1.0).throttle.size(), 4);
  Actuator three = test::GenericActuator();
  three.motors.assign(3, three.motors.front());
  EXPECT_THROW(Throttled{three}, std::invalid_argument);
}

// Idling is a goal like any other: rotors that are told nothing more hold its speed.
TEST(Throttle, HoldsTheGoalAtTheVoltageLastHeard) {
  Throttled t(test::GenericActuator());
  const double idle = t.Update(1.0).rotor_speed[0];
  EXPECT_NEAR(t.Acceleration(t.Update(1.1), idle, 15.2), 0.0, 1e-6) << "nominal before the first";
  t.controller->Add(BatterySample{FromSeconds(1.2), 13.7});
  EXPECT_NEAR(t.Acceleration(t.Update(1.2), idle, 13.7), 0.0, 1e-6);
  t.controller->Add(BatterySample{FromSeconds(1.3), std::nan("")});
  EXPECT_NEAR(t.Acceleration(t.Update(1.3), idle, 13.7), 0.0, 1e-6);
}

// Once, at any speed: the motors close the gap as a lag of motor_time_constant_s / motor_lead does.
TEST(Throttle, AsksForTheLagTheGainsWereMadeFor) {
  for (const double lead : {1.0, 1.5}) {
    ControllerOptions options;
    options.motor_lead = lead;
    options.min_thrust_over_weight = 0.5;
    Throttled t(test::GenericActuator(), options);
    const double idle = t.Update(1.0).rotor_speed[0];
    for (const double short_of : {-40.0, 0.0, 40.0, 100.0}) {
      const double speed = idle - short_of;
      t.controller->Add(RotorSample{FromSeconds(2.0), RotorVector::Constant(4, speed)});
      const ControlCommand command = t.Update(2.0);
      const double asked = lead * short_of / options.motor_time_constant_s;
      // Never less than what idles.
      const double least = t.motor.dynamics.DriveFor(idle) - t.motor.dynamics.DriveFor(speed);
      EXPECT_NEAR(t.Acceleration(command, speed, 15.2), std::max(asked, least), 1e-6) << lead;
    }
  }
}

TEST(Throttle, OfAnActuatorWithoutDynamicsHoldsTheLeadingSpeed) {
  Actuator actuator = test::GenericActuator();
  actuator.knows_dynamics = false;
  ControllerOptions options;
  options.min_thrust_over_weight = 0.5;
  Throttled t(actuator, options);
  const double idle = t.Update(1.0).rotor_speed[0];
  t.controller->Add(RotorSample{FromSeconds(2.0), RotorVector::Constant(4, idle - 60.0)});
  EXPECT_NEAR(t.motor.SteadySpeed(t.Update(2.0).throttle[0], 15.2), idle + 30.0, 1e-6);
}

}  // namespace
}  // namespace odmc
