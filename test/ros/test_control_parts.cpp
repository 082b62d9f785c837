#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "odmc/io/options_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/ros/control_messages.h"
#include "odmc/ros/controller_node.h"
#include "odmc/ros/controller_report.h"
#include "odmc/ros/conversions.h"
#include "odmc/ros/reference_intake.h"
#include "odmc/ros/simulator_node.h"
#include "odmc/trajectory/flatness.h"
#include "odmc/trajectory/trajectory.h"
#include "support/error_text.h"

namespace odmc {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const Eigen::Vector3d kGravity_W(0.0, 0.0, -9.81);
const std::string kFolder = ODMC_SOURCE_DIR;

double LargestDifference(const FlatReference& a, const FlatReference& b) {
  return std::max({(a.p_WB - b.p_WB).norm(), (a.v_WB - b.v_WB).norm(), (a.a_WB - b.a_WB).norm(),
                   (a.j_WB - b.j_WB).norm(), (a.s_WB - b.s_WB).norm(), std::abs(a.yaw - b.yaw),
                   std::abs(a.d_yaw - b.d_yaw), std::abs(a.dd_yaw - b.dd_yaw)});
}

TimedReference PointOf(const Trajectory& trajectory, double t_s) {
  return {FromSeconds(t_s), trajectory.At(t_s)};
}

// ---- Motor commands ----------------------------------------------------------------------------

TEST(MotorCommandsMessage, HoldsTheSample) {
  const CommandSample sample{FromSeconds(1.5), RotorVector{{0.0, 1.0 / 3.0, 0.7, 1.0}}};
  const MotorCommands m = ToMessage(sample);
  EXPECT_EQ(m.header.stamp, ros::Time(1.5));
  const std::optional<CommandSample> back = ToInput(m, 4);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->stamp, sample.stamp);
  EXPECT_EQ(back->throttle, sample.throttle);
}

TEST(MotorCommandsMessage, IsRefusedWhereItIsNotSound) {
  MotorCommands m = ToMessage(CommandSample{FromSeconds(1.5), RotorVector::Constant(4, 0.5)});
  EXPECT_FALSE(ToInput(m, 6)) << "another number of rotors";
  m.throttle[2] = kNan;
  EXPECT_FALSE(ToInput(m, 4));
  m.throttle[2] = 1500.0;
  EXPECT_FALSE(ToInput(m, 4)) << "a pulse width";
  m.throttle[2] = -0.1;
  EXPECT_TRUE(ToInput(m, 4)) << "900 us: the ESC is armed and idle";
  m.header.stamp = ros::Time();
  EXPECT_FALSE(ToInput(m, 4)) << "no stamp";
}

// ---- References --------------------------------------------------------------------------------

TEST(ReferenceMovedOn, FollowsConstantSnap) {
  FlatReference r;
  r.p_WB = {1.0, 0.0, 2.0};
  r.v_WB = {2.0, -1.0, 0.0};
  r.a_WB = {0.0, 3.0, 0.5};
  r.j_WB = {6.0, 0.0, -3.0};
  r.s_WB = {0.0, 24.0, 0.0};
  r.yaw = 1.0;
  r.d_yaw = 0.5;
  r.dd_yaw = 2.0;
  const double t = 0.5;
  const FlatReference moved = ReferenceMovedOn(r, t);
  EXPECT_NEAR(moved.p_WB.x(), 1.0 + 2.0 * t + t * t * t, 1e-12);
  EXPECT_NEAR(moved.p_WB.y(), -t + 1.5 * t * t + std::pow(t, 4), 1e-12);
  EXPECT_NEAR(moved.v_WB.z(), 0.5 * t - 1.5 * t * t, 1e-12);
  EXPECT_NEAR(moved.a_WB.y(), 3.0 + 12.0 * t * t, 1e-12);
  EXPECT_NEAR(moved.j_WB.y(), 24.0 * t, 1e-12);
  EXPECT_NEAR(moved.yaw, 1.0 + 0.5 * t + t * t, 1e-12);
  EXPECT_NEAR(moved.d_yaw, 0.5 + 2.0 * t, 1e-12);
}

TEST(ReferenceBetween, HasBothEndsAndDerivativesOfItself) {
  const Trajectory octo("octo");
  const TimedReference from = PointOf(octo, 5.0), to = PointOf(octo, 5.2);
  for (const TimedReference& end : {from, to}) {
    const FlatReference r = ReferenceBetween(from, to, end.stamp);
    EXPECT_NEAR((r.p_WB - end.reference.p_WB).norm(), 0.0, 1e-9);
    EXPECT_NEAR((r.v_WB - end.reference.v_WB).norm(), 0.0, 1e-9);
    EXPECT_NEAR((r.a_WB - end.reference.a_WB).norm(), 0.0, 1e-8);
  }
  const double h = 1e-4;
  const auto at = [&](double t_s) { return ReferenceBetween(from, to, FromSeconds(t_s)); };
  const FlatReference low = at(5.1 - h), mid = at(5.1), high = at(5.1 + h);
  EXPECT_NEAR(((high.p_WB - low.p_WB) / (2.0 * h) - mid.v_WB).norm(), 0.0, 1e-5);
  EXPECT_NEAR(((high.a_WB - low.a_WB) / (2.0 * h) - mid.j_WB).norm(), 0.0, 1e-3);
  EXPECT_NEAR(((high.j_WB - low.j_WB) / (2.0 * h) - mid.s_WB).norm(), 0.0, 1e-2);
  EXPECT_NEAR((mid.p_WB - octo.At(5.1).p_WB).norm(), 0.0, 1e-4) << "near what was sampled";
}

TEST(ReferenceIntake, MovesOnAndThenHoldsItsPlace) {
  ReferenceIntake intake(0.5);
  EXPECT_FALSE(intake.At(0));
  EXPECT_FALSE(intake.IsLost(FromSeconds(9.0))) << "nothing to lose yet";
  TimedReference point;
  point.stamp = FromSeconds(1.0);
  point.reference.v_WB = {2.0, 0.0, 0.0};
  intake.Add(point);
  EXPECT_NEAR(intake.At(FromSeconds(1.05))->p_WB.x(), 0.1, 1e-12);
  EXPECT_FALSE(intake.IsLost(FromSeconds(1.4)));
  const Stamp late = FromSeconds(2.0);
  EXPECT_TRUE(intake.IsLost(late));
  EXPECT_NEAR(intake.At(late)->p_WB.x(), 2.0 * ReferenceIntake::kMovesOn_s, 1e-12);
  EXPECT_TRUE(intake.At(late)->v_WB.isZero(0.0));
  intake.Reset();
  EXPECT_FALSE(intake.At(late));
}

TEST(ReferenceIntake, StandingIsNeverLost) {
  ReferenceIntake intake(0.5);
  TimedReference point;
  point.stamp = FromSeconds(1.0);
  point.reference.standing = true;
  intake.Add(point);
  EXPECT_FALSE(intake.IsLost(FromSeconds(9.0)));
  EXPECT_TRUE(intake.At(FromSeconds(9.0))->standing);
}

TEST(ReferenceIntake, TrajectoryServesWhereNoReferenceComes) {
  TrajectoryOptions options;
  options.duration_s = 8.0;
  const Trajectory octo(options);
  std::vector<TimedReference> path;
  for (double t = 1.0; t <= 8.001; t += 0.05) path.push_back(PointOf(octo, t));
  ReferenceIntake intake(0.5);
  intake.Add(path);
  const Stamp between = FromSeconds(3.333);
  EXPECT_NEAR((intake.At(between)->p_WB - octo.At(3.333).p_WB).norm(), 0.0, 1e-3);
  EXPECT_NEAR((intake.At(between)->a_WB - octo.At(3.333).a_WB).norm(), 0.0, 0.05);
  EXPECT_FALSE(intake.IsLost(FromSeconds(20.0))) << "it came to rest";
  TimedReference point;
  point.stamp = between;
  point.reference.p_WB = {9.0, 9.0, 9.0};
  intake.Add(point);
  EXPECT_EQ(intake.At(between)->p_WB.x(), 9.0) << "single references go first";
  EXPECT_LT(intake.At(FromSeconds(5.0))->p_WB.x(), 8.0) << "until they stay out";
}

// ---- Messages ----------------------------------------------------------------------------------

TEST(ControlMessages, FlatReferenceComesBackAsSent) {
  const FlatReference sent = Trajectory("aggressive").At(7.0);
  FlatOutput m = ToMessage(sent, FromSeconds(7.0), "world");
  const std::optional<TimedReference> back = ToReference(m);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->stamp, FromSeconds(7.0));
  EXPECT_EQ(LargestDifference(back->reference, sent), 0.0);
  m.jerk.y = kNan;
  EXPECT_FALSE(ToReference(m));
  EXPECT_FALSE(ToReference(ToMessage(sent, 0, "world"))) << "no stamp";
}

TEST(ControlMessages, TrajectoryComesBackAndYawIsUnwrapped) {
  std::vector<TimedReference> points(3);
  for (int i = 0; i < 3; ++i) {
    points[i].stamp = FromSeconds(2.0 + 0.1 * i);
    points[i].reference.p_WB = {0.1 * i, 0.0, 1.0};
    points[i].reference.yaw = 3.0 + 0.1 * i;  // passes pi
  }
  const auto m = ToMessage(points, "world", "base_link");
  std::string error;
  const auto back = ToReferences(m, 0, &error);
  ASSERT_TRUE(back) << error;
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ((*back)[i].stamp, points[i].stamp);
    EXPECT_NEAR(LargestDifference((*back)[i].reference, points[i].reference), 0.0, 1e-9);
  }
}

TEST(ControlMessages, YawIsTheTurnBeforeTheShortestTilt) {
  FlatReference tilted;
  tilted.a_WB = {4.0, -6.0, 1.0};
  tilted.yaw = 0.7;
  auto m = ToMessage({{FromSeconds(1.0), tilted}}, "world", "base_link");
  m.points[0].transforms[0].rotation = ToQuaternion(FlatAttitudeOf(tilted, kGravity_W).q_WB);
  std::string error;
  EXPECT_NEAR(ToReferences(m, 0, &error)->front().reference.yaw, 0.7, 1e-9);
}

TEST(ControlMessages, TrajectoriesThatCannotBeFlownAreRefusedInWords) {
  std::string error;
  auto m = ToMessage({{FromSeconds(1.0), {}}, {FromSeconds(2.0), {}}}, "world", "base_link");
  EXPECT_TRUE(ToReferences(m, 0, &error));
  auto bad = m;
  bad.points[1].time_from_start = bad.points[0].time_from_start;
  EXPECT_FALSE(ToReferences(bad, 0, &error));
  EXPECT_NE(error.find("order of time"), std::string::npos);
  bad = m;
  bad.points[0].velocities.clear();
  EXPECT_FALSE(ToReferences(bad, 0, &error));
  EXPECT_NE(error.find("without velocity"), std::string::npos);
  bad = m;
  bad.points[0].transforms[0].translation.z = kNan;
  EXPECT_FALSE(ToReferences(bad, 0, &error));
  EXPECT_FALSE(ToReferences({}, 0, &error));
  EXPECT_NE(error.find("no points"), std::string::npos);
}

TEST(ControlMessages, ParametersComeBackAsSent) {
  const Vehicle vehicle = LoadVehicle(kFolder + "/config/vehicles/generic.yaml");
  const DynamicModel model(vehicle, vehicle.effects);
  DynamicParameters m =
      TruthParameters(model, model.InitialValues(), FromSeconds(3.0), "base_link_truth");
  EXPECT_EQ(m.covariance.size(), m.parameters.size() * m.parameters.size());
  const std::optional<ParameterSet> set = ToParameterSet(m);
  ASSERT_TRUE(set);
  EXPECT_EQ(set->effects, vehicle.effects);
  EXPECT_EQ(set->Find("thrust.k_f")->value, 1.5e-6);
  EXPECT_EQ(set->Find("thrust.k_f")->sigma, 0.0);
  m.parameters.front().value = kNan;
  EXPECT_FALSE(ToParameterSet(m));
}

TEST(ControlMessages, SamplesOfTheSimulatorComeBackAsSent) {
  OdometrySample odometry;
  odometry.stamp = FromSeconds(1.5);
  odometry.q_WS = Eigen::AngleAxisd(1.0, Eigen::Vector3d::UnitZ());
  odometry.v_WS = Eigen::Vector3d(1.0, 2.0, 3.0);
  odometry.w_WS_S = Eigen::Vector3d(0.1, 0.2, 0.3);
  const nav_msgs::Odometry m = ToMessage(odometry, "world", "base_link");
  const std::optional<OdometryInput> input = ToInput(m);
  ASSERT_TRUE(input && input->linear);
  EXPECT_NEAR((input->sample.q_WS * *input->linear - *odometry.v_WS).norm(), 0.0, 1e-12)
      << "twist in the sensor's frame";
  odometry.v_WS.reset();
  EXPECT_FALSE(ToInput(ToMessage(odometry, "world", "base_link"))->linear);

  ImuSample imu;
  imu.stamp = FromSeconds(1.5);
  imu.gyro_I = Eigen::Vector3d(1.0, 2.0, 3.0);
  EXPECT_EQ(*ToInput(ToMessage(imu, "imu_link"))->sample.gyro_I, *imu.gyro_I);
  EXPECT_FALSE(ToInput(ToMessage(imu, "imu_link"))->sample.specific_force_I);
  EXPECT_NEAR(ToInput(ToMessage(BatterySample{FromSeconds(1.0), 15.5}))->voltage_V, 15.5, 1e-6);
  const RotorSample rotors{FromSeconds(1.0), RotorVector::Constant(4, 900.0)};
  EXPECT_EQ(ToInput(ToMessage(rotors), 4)->sample.speed[3], 900.0);
}

TEST(ControlMessages, CommandsThatAreNotFiniteAreSeen) {
  ControlCommand command;
  command.rotor_speed = RotorVector::Constant(4, 900.0);
  EXPECT_TRUE(IsFinite(command));
  EXPECT_EQ(RotorCommand(command).angular_velocity_rad_s.size(), 4u);
  command.rotor_speed[2] = kNan;
  EXPECT_FALSE(IsFinite(command));
  command.rotor_speed[2] = 900.0;
  command.w_WB_B_cmd.y() = kNan;
  EXPECT_FALSE(IsFinite(command));
  command.w_WB_B_cmd.y() = 0.0;
  command.stamp = FromSeconds(1.0);
  command.throttle = RotorVector::Constant(4, 0.4);
  EXPECT_TRUE(IsFinite(command));
  EXPECT_EQ(ToInput(MotorCommand(command), 4)->throttle[3], 0.4);
  command.throttle[1] = kNan;
  EXPECT_FALSE(IsFinite(command));
}

// ---- The controller's report -------------------------------------------------------------------

TEST(ControllerReport, LevelSaysWhatIsWrong) {
  using diagnostic_msgs::DiagnosticStatus;
  ControllerReport report;
  report.has_state = report.has_reference = true;
  report.command.mode = ControlMode::kTracking;
  report.handover = HandoverState::kFollowing;
  const auto level = [&] { return ControllerDiagnostic(report, 0, "n").level; };
  EXPECT_EQ(level(), DiagnosticStatus::WARN) << "no IMU";
  report.imu.received = 10;
  EXPECT_EQ(level(), DiagnosticStatus::OK);
  EXPECT_EQ(ControllerDiagnostic(report, 0, "n").message, "tracking, following");
  report.imu.refused = 3;
  EXPECT_EQ(level(), DiagnosticStatus::WARN);
  EXPECT_EQ(ControllerDiagnostic(report, 3, "n").level, DiagnosticStatus::OK) << "not since then";
  report.imu.refused = 0;
  report.has_actuator = true;
  EXPECT_EQ(level(), DiagnosticStatus::WARN) << "no battery voltage";
  report.battery.received = 1;
  EXPECT_EQ(level(), DiagnosticStatus::OK);
  report.handover = HandoverState::kHolding;
  EXPECT_EQ(level(), DiagnosticStatus::WARN);
  report.handover = HandoverState::kRolledBack;
  EXPECT_EQ(level(), DiagnosticStatus::WARN);
  report.command.mode = ControlMode::kFailsafe;
  EXPECT_EQ(level(), DiagnosticStatus::ERROR);
}

TEST(ControllerReport, MessageHoldsTheReport) {
  ControllerReport report;
  report.command.stamp = FromSeconds(2.0);
  report.command.allocation.yaw_share = 0.5;
  report.handover = HandoverState::kHolding;
  report.estimate_stamp = FromSeconds(1.0);
  report.last_transition = "following to holding: the estimator is silent";
  const ControllerStatus m = ToMessage(report, "base_link");
  EXPECT_EQ(m.header.stamp, ros::Time(2.0));
  EXPECT_EQ(m.mode, "idle");
  EXPECT_EQ(m.handover_state, "holding");
  EXPECT_EQ(m.estimate_stamp, ros::Time(1.0));
  EXPECT_EQ(m.yaw_share, 0.5);
  EXPECT_EQ(m.last_transition, report.last_transition);
}

// ---- Options -----------------------------------------------------------------------------------

TEST(ControllerConfig, ShippedFilesAreValidAndTheDefaultsAreTheDefaults) {
  for (const std::string name : {"default", "generic"}) {
    ControllerConfig config;
    LoadOptions(kFolder + "/config/controller/" + name + ".yaml", &config);
    EXPECT_EQ(FormatOptions(config), FormatOptions(ControllerConfig())) << name;
  }
}

TEST(ControllerNodeOptions, SayWhatIsWrong) {
  std::string error;
  ControllerNodeOptions options;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_NE(error.find("vehicle_file"), std::string::npos);
  options.vehicle_file = "a.yaml";
  EXPECT_TRUE(options.IsValid(&error));
  options.twist_frame = "sideways";
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_NE(error.find("'sideways'"), std::string::npos);
}

TEST(SimulatorNodeOptions, SayWhatIsWrong) {
  std::string error;
  SimulatorNodeOptions options;
  options.vehicle_file = "a.yaml";
  EXPECT_TRUE(options.IsValid(&error));
  options.real_time_factor = 0.0;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_NE(error.find("real_time_factor"), std::string::npos);
  options.real_time_factor = 1.0;
  options.trajectory.name = "loop";
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_NE(error.find("'loop'"), std::string::npos);
}

TEST(ObjectionTo, RefusesOtherVehiclesAndWhatIsNotGood) {
  DynamicParameters message;
  message.vehicle = "generic";
  EXPECT_EQ(ObjectionTo(message, "generic"), "");  // of an older sender
  EXPECT_NE(ObjectionTo(message, "other"), "");
  message.trust = "good";
  EXPECT_EQ(ObjectionTo(message, "generic"), "");
  message.trust = "doubtful";
  message.trust_reasons = {"the thirds disagree"};
  EXPECT_EQ(ObjectionTo(message, "generic"), "its trust is doubtful: the thirds disagree");
}

TEST(ObjectionTo, SavedParametersNeedGoodTrustToo) {
  ParameterSet set;
  EXPECT_EQ(ObjectionTo(set), "");  // a file written by hand
  Finding finding;
  finding.what = "a remark";
  AddTrust({finding}, &set);
  EXPECT_EQ(ObjectionTo(set), "");
  finding.leaves = Trust::kBad;
  finding.what = "rotor speeds fit another order";
  AddTrust({finding}, &set);
  EXPECT_EQ(ObjectionTo(set), "its trust is bad: rotor speeds fit another order");
  AddTrust({}, &set);
  EXPECT_EQ(ObjectionTo(set), "");
}

}  // namespace
}  // namespace odmc
