#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <fstream>
#include <future>
#include <limits>
#include <thread>

#include "odmc/estimator/acceptance.h"
#include "odmc/ros/background_analysis.h"
#include "odmc/ros/conversions.h"
#include "odmc/ros/estimate_messages.h"
#include "odmc/ros/input_queue.h"
#include "odmc/ros/live_image.h"
#include "odmc/ros/node_status.h"
#include "odmc/ros/pose_twist.h"
#include "odmc/ros/sample_intake.h"
#include "odmc/ros/urdf_vehicle.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/error_text.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// ---- Conversions -------------------------------------------------------------------------------

nav_msgs::Odometry OdometryAt(double t_s, double x, double speed) {
  nav_msgs::Odometry m;
  m.header.stamp = ros::Time(t_s);
  m.header.frame_id = "world";
  m.child_frame_id = "base_link";
  m.pose.pose.position.x = x;
  m.pose.pose.orientation.z = m.pose.pose.orientation.w = std::sqrt(0.5);  // heads along y
  m.twist.twist.linear.x = speed;
  m.twist.twist.angular.z = 0.001;
  return m;
}

RotorSpeeds RotorsAt(double t_s) {
  RotorSpeeds m;
  m.header.stamp = ros::Time(t_s);
  m.angular_velocity_rad_s = {-900.0, 901.0, -902.0, 903.0};
  return m;
}

TEST(Conversions, RefuseWhatIsNotSound) {
  nav_msgs::Odometry m = OdometryAt(1.0, 0.0, 0.0);
  EXPECT_TRUE(ToInput(m));
  m.pose.pose.position.y = kNan;
  EXPECT_FALSE(ToInput(m));
  m = OdometryAt(1.0, 0.0, kNan);
  EXPECT_FALSE(ToInput(m));
  m = OdometryAt(1.0, 0.0, 0.0);
  m.pose.pose.orientation = geometry_msgs::Quaternion();  // all zero
  EXPECT_FALSE(ToInput(m));
  EXPECT_FALSE(ToInput(OdometryAt(0.0, 0.0, 0.0))) << "no stamp";
}

TEST(Conversions, RotorSpeedsComeInAnyUnitAndWithoutSign) {
  EXPECT_EQ(ToInput(RotorsAt(1.0), 4)->sample.speed[0], 900.0);
  EXPECT_FALSE(ToInput(RotorsAt(1.0), 6)) << "another number of rotors";
  EXPECT_NEAR(RotorSpeedScale("rpm", 7) * 60.0, 2.0 * M_PI, 1e-12);
  EXPECT_NEAR(RotorSpeedScale("erpm", 7) * 7.0 * 60.0, 2.0 * M_PI, 1e-12);
  ODMC_EXPECT_ERROR(RotorSpeedScale("hz", 7), "must be rad_s, rpm or erpm");
}

TEST(Conversions, RefuseWhatNoSensorReads) {
  EXPECT_FALSE(ToInput(OdometryAt(1.0, 1e200, 0.0)));
  EXPECT_FALSE(ToInput(OdometryAt(1.0, 0.0, 1e200)));
  nav_msgs::Odometry m = OdometryAt(1.0, 0.0, 0.0);
  m.twist.twist.angular.x = 1e200;
  EXPECT_FALSE(ToInput(m));
  RotorSpeeds rotors = RotorsAt(1.0);
  rotors.angular_velocity_rad_s[1] = 65535.0;
  EXPECT_FALSE(ToInput(rotors, 4));
  sensor_msgs::Imu imu;
  imu.header.stamp = ros::Time(1.0);
  EXPECT_TRUE(ToInput(imu));
  imu.angular_velocity.x = 1e200;
  EXPECT_FALSE(ToInput(imu));
}

TEST(Conversions, JointsAreTakenByTheNumbersInTheirNames) {
  sensor_msgs::JointState m;
  m.header.stamp = ros::Time(1.0);
  m.velocity = {400.0, 200.0, 300.0, 100.0};
  EXPECT_EQ(SpeedsOfJoints(m)[0], 400.0) << "no names: as they come";
  m.name = {"rotor_3_joint", "rotor_1_joint", "rotor_2_joint", "rotor_0_joint"};
  for (int j = 0; j < 4; ++j) EXPECT_EQ(SpeedsOfJoints(m)[j], 100.0 * (j + 1));
  m.name = {"front", "left", "rear", "right"};
  EXPECT_EQ(SpeedsOfJoints(m)[0], 400.0);
  m.name = {"rotor_1", "rotor_1", "rotor_2", "rotor_3"};
  EXPECT_EQ(SpeedsOfJoints(m)[0], 400.0);
}

TEST(InputQueue, CountsWhatComesAndWhatItHasNoRoomFor) {
  InputQueue queue(2);
  for (int i = 0; i < 3; ++i) queue.Push(InputStream::kImu, {ImuInput()});
  queue.Refuse(InputStream::kImu, "is not finite");
  queue.CountPassedOver(InputStream::kRotorSpeeds);
  const InputQueue::Look look = queue.Snapshot();
  const StreamStatus& imu = look.streams[static_cast<size_t>(InputStream::kImu)];
  EXPECT_EQ(look.queued, 2u);
  EXPECT_EQ(imu.received, 4);
  EXPECT_EQ(imu.overflowed, 1);
  EXPECT_EQ(imu.refused, 1);
  EXPECT_EQ(imu.refusal, "is not finite");
  EXPECT_EQ(look.streams[static_cast<size_t>(InputStream::kRotorSpeeds)].passed_over, 1);
  std::deque<InputSample> batch;
  EXPECT_TRUE(queue.TakeBatch(&batch));
  EXPECT_EQ(batch.size(), 2u);
  EXPECT_FALSE(queue.TakeBatch(&batch));
}

TEST(InputQueue, AnswersComeFromTheThreadThatTakesTheInput) {
  InputQueue queue(100);
  std::thread::id answered_by;
  std::thread estimator([&] {
    std::deque<InputSample> batch;
    while (queue.WaitForInput(&batch)) queue.AnswerRequests();
  });
  const std::thread::id estimator_id = estimator.get_id();
  const InputQueue::Answer answer = queue.Ask([&] {
    answered_by = std::this_thread::get_id();
    return InputQueue::Answer(true, "done");
  });
  EXPECT_TRUE(answer.first);
  EXPECT_EQ(answer.second, "done");
  EXPECT_EQ(answered_by, estimator_id);
  const InputQueue::Answer failed =
      queue.Ask([]() -> InputQueue::Answer { throw std::runtime_error("no disk"); });
  EXPECT_FALSE(failed.first);
  EXPECT_EQ(failed.second, "no disk");
  EXPECT_FALSE(queue.SleepUnlessStopping(std::chrono::milliseconds(1)));
  queue.Stop();
  estimator.join();
  EXPECT_TRUE(queue.SleepUnlessStopping(std::chrono::hours(1)));
}

TEST(InputQueue, DoesNotDoLaterWhatItWasAskedInVain) {
  InputQueue queue(100, std::chrono::milliseconds(20));
  bool done = false;
  const InputQueue::Answer answer = queue.Ask([&] {
    done = true;
    return InputQueue::Answer(true, "done");
  });
  EXPECT_FALSE(answer.first);
  EXPECT_EQ(answer.second, "the estimator does not answer; nothing was done");
  queue.AnswerRequests();
  EXPECT_FALSE(done);
}

TEST(InputQueue, SaysThatTheEstimatorIsStillAtIt) {
  InputQueue queue(100, std::chrono::milliseconds(200));
  std::promise<void> may_end;
  std::thread estimator([&] {
    std::deque<InputSample> batch;
    while (queue.WaitForInput(&batch)) queue.AnswerRequests();
  });
  const InputQueue::Answer answer = queue.Ask([ends = may_end.get_future().share()] {
    ends.wait();
    return InputQueue::Answer(true, "done");
  });
  EXPECT_FALSE(answer.first);
  EXPECT_EQ(answer.second, "the estimator is still at it");
  may_end.set_value();
  queue.Stop();
  estimator.join();
}

TEST(InputQueue, TellsHowLongAgoItWasStopped) {
  InputQueue queue(100);
  const std::chrono::milliseconds soon(20), late(600000);
  std::this_thread::sleep_for(2 * soon);
  EXPECT_FALSE(queue.StoppedBefore(soon));  // not stopped at all
  queue.Stop();
  std::this_thread::sleep_for(2 * soon);
  EXPECT_TRUE(queue.StoppedBefore(soon));
  EXPECT_FALSE(queue.StoppedBefore(late));
}

TEST(EstimatorDiagnostic, WarnsWhileNothingIsLearned) {
  NodeStatus status;
  status.airborne = status.accepted = true;
  EXPECT_EQ(EstimatorDiagnostic(status, "n").level, diagnostic_msgs::DiagnosticStatus::OK);
  status.interrupted = "nothing is learned any more: no odometry";
  EXPECT_EQ(EstimatorDiagnostic(status, "n").level, diagnostic_msgs::DiagnosticStatus::WARN);
  EXPECT_EQ(EstimatorDiagnostic(status, "n").message, status.interrupted);
}

/// The newest seconds of a flight in which k_m is taken for `share` of the true one.
BackgroundAnalysis::StreamsSeen SeenWith(double share, bool estimated) {
  Vehicle vehicle = test::NominalVehicle();
  const DynamicModel flown(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(flown);
  SimulationOptions options;
  options.trajectory = "aggressive";
  options.log_rate_hz = 200.0;
  SimulationNoise noise;
  noise.rotor_speed_rad_s = 0.3;
  BackgroundAnalysis::StreamsSeen seen;
  seen.log = Simulate(flown, truth, options, noise).log;
  const int k_m = flown.IndexOf("rotor_torque.k_m");
  vehicle.parameters["rotor_torque.k_m"].value = share * truth[k_m];
  vehicle.parameters["rotor_torque.k_m"].estimated = estimated;
  vehicle.inertia_kg_m2.z() = truth[flown.IndexOf("inertia.z")];
  vehicle.parameters["inertia.z"].sigma = 0.1 * vehicle.inertia_kg_m2.z();
  seen.vehicle = vehicle;
  seen.model = std::make_shared<DynamicModel>(vehicle, vehicle.effects);
  seen.values = truth;
  (*seen.values)[seen.model->IndexOf("rotor_torque.k_m")] = share * truth[k_m];
  return seen;
}

TEST(BackgroundAnalysis, AskWhetherAReactionThatIsHeldIsRight) {
  const TorqueBands right = BackgroundAnalysis::BandsOf(SeenWith(1.0, false));
  ASSERT_TRUE(right.k_m);
  EXPECT_FALSE(right.k_m->contradicted);
  // The estimator learns it: nobody has to look. Nor can anybody without an estimate.
  EXPECT_FALSE(BackgroundAnalysis::BandsOf(SeenWith(0.5, true)).k_m);
  BackgroundAnalysis::StreamsSeen early = SeenWith(0.5, false);
  early.values.reset();
  EXPECT_FALSE(BackgroundAnalysis::BandsOf(early).k_m);
}

TEST(BackgroundAnalysis, FindThatTheFlightContradictsAReaction) {
  InputQueue queue(10);
  BackgroundAnalysis looks(
      {}, [](const ResidualAnalysis&) {}, &queue);
  looks.Inspect(SeenWith(0.5, false));
  std::optional<BackgroundAnalysis::StreamsFound> found;
  for (int i = 0; i < 1200 && !found; ++i) {  // of low priority, on a busy machine
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    found = looks.TakeInspection();
  }
  queue.Stop();
  ASSERT_TRUE(found);
  ReactionWatch watch;
  watch.Add(found->bands);
  NodeStatus status;
  status.airborne = true;
  EXPECT_EQ(EstimatorDiagnostic(status, "n").level, diagnostic_msgs::DiagnosticStatus::OK);
  status.contradicted_k_m = watch.sentence();
  const auto diagnostic = EstimatorDiagnostic(status, "n");
  EXPECT_EQ(diagnostic.level, diagnostic_msgs::DiagnosticStatus::WARN);
  EXPECT_NE(diagnostic.message.find("rotor_torque.k_m is held at"), std::string::npos);
  EXPECT_NE(diagnostic.message.find("contradicts it"), std::string::npos);
}

TEST(Conversions, BodyMovesWithItsSensorLessTheLeverArm) {
  Snapshot snapshot;
  snapshot.stamp = FromSeconds(1.0);
  snapshot.body.p_BS = {1.0, 0.0, 0.0};
  snapshot.state.p_WS = {1.0, 0.0, 2.0};
  snapshot.state.v_WS = {0.0, 2.0, 0.0};
  snapshot.state.w_WS_S = {0.0, 0.0, 2.0};  // So circles about Bo, which stands
  const nav_msgs::Odometry m = BodyOdometry(snapshot, "world", "base_link");
  EXPECT_NEAR(m.pose.pose.position.x, 0.0, 1e-12);
  EXPECT_NEAR(m.twist.twist.linear.y, 0.0, 1e-12);
  EXPECT_NEAR(m.twist.twist.angular.z, 2.0, 1e-12);
}

// ---- Intake ------------------------------------------------------------------------------------

/// Feeds a flight along world x, heading along y, as messages at 100 Hz.
class Intake : public ::testing::Test {
 protected:
  explicit Intake(const std::string& twist_frame = "auto") : intake_(twist_frame) {}

  /// The twist is along x like the motion, so in the world.
  void Fly(double from_s, double to_s, double metres_per_s) {
    for (double t = from_s; t < to_s - 1e-6; t += 0.01) {
      const nav_msgs::Odometry m = OdometryAt(t, x_ += 0.01 * metres_per_s, metres_per_s);
      ++pushed_;
      EXPECT_TRUE(intake_.Push(*ToInput(m)));
      EXPECT_TRUE(intake_.Push(*ToInput(RotorsAt(t), 4)));
    }
  }

  SampleIntake intake_;
  int pushed_ = 0;
  double x_ = 0.0;
};

TEST_F(Intake, HoldsEverySampleUntilTheFrameIsKnown) {
  Fly(1.0, 3.0, 0.0);
  EXPECT_FALSE(intake_.decided()) << "standing still tells nothing";
  EXPECT_TRUE(intake_.Take().empty());
  Fly(3.0, 6.0, 1.0);
  ASSERT_TRUE(intake_.decided());
  EXPECT_EQ(intake_.frame(), TwistFrame::kWorld);
  intake_.Release();
  const std::vector<Sample> samples = intake_.Take();
  EXPECT_EQ(samples.size(), static_cast<size_t>(2 * pushed_));
  EXPECT_TRUE(std::holds_alternative<RotorSample>(samples.front())) << "rotors before odometry";
}

// Up and down a hand's breadth, where body and world have the same upward axis.
TEST_F(Intake, LetsHoverFlowWithoutVelocityUntilItsFrameIsKnown) {
  const auto hover = [this](double from_s, double to_s) {
    for (double t = from_s; t < to_s - 1e-6; t += 0.01) {
      nav_msgs::Odometry m = OdometryAt(t, 0.0, 0.0);
      m.pose.pose.position.z = 1.0 - std::cos(t - 1.0);
      m.twist.twist.linear.z = std::sin(t - 1.0);
      intake_.Push(*ToInput(m));
      intake_.Push(*ToInput(RotorsAt(t), 4));
    }
  };
  const auto velocities = [this] {
    long count = 0;
    for (const Sample& sample : intake_.Take()) {
      const auto* odometry = std::get_if<OdometrySample>(&sample);
      count += odometry != nullptr && odometry->v_WS;
    }
    return count;
  };
  hover(1.0, 3.5);
  EXPECT_FALSE(intake_.decided());
  hover(3.5, 7.0);
  ASSERT_TRUE(intake_.decided());
  intake_.Release();
  EXPECT_EQ(velocities(), 0);
  EXPECT_EQ(intake_.phase(), IntakePhase::kFlowing);
  Fly(7.0, 10.0, 1.0);
  EXPECT_EQ(intake_.frame(), TwistFrame::kWorld);
  EXPECT_GT(velocities(), 100);
}

// Whichever part of the climb falls into one of the stretches in which motion is judged.
TEST_F(Intake, LetsHoverFlowAfterAnyClimb) {
  const std::pair<double, double> climbs[] = {{0.15, 2.0}, {0.8, 0.55}};
  for (const auto& [climb_m_s, climb_s] : climbs) {
    for (const double first_s : {1.0, 1.1, 1.2}) {
      SampleIntake intake("auto");
      for (double t = first_s; t < 9.0; t += 0.01) {
        const double along_s = std::min(std::max(t - 2.0, 0.0), climb_s);
        const bool climbs_now = along_s > 0.0 && along_s < climb_s;
        nav_msgs::Odometry m = OdometryAt(t, 0.0, 0.0);
        m.pose.pose.position.z = climb_m_s * along_s;
        m.twist.twist.linear.z = climbs_now ? climb_m_s : 0.01;
        intake.Push(*ToInput(m));
        intake.Push(*ToInput(RotorsAt(t), 4));
      }
      EXPECT_TRUE(intake.decided()) << climb_m_s << " m/s from " << first_s << " s";
      EXPECT_EQ(intake.frame(), TwistFrame::kUndecided);
    }
  }
}

TEST_F(Intake, TakesAMissingTwistForWhatItIs) {
  for (double t = 1.0; t < 4.0; t += 0.01) {
    nav_msgs::Odometry m = OdometryAt(t, t, 0.0);
    m.twist = geometry_msgs::TwistWithCovariance();
    m.pose.pose.orientation.z = std::sin(0.1 * t);
    m.pose.pose.orientation.w = std::cos(0.1 * t);
    intake_.Push(*ToInput(m));
    intake_.Push(*ToInput(RotorsAt(t), 4));
  }
  ASSERT_TRUE(intake_.decided());
  EXPECT_FALSE(intake_.has_velocity());
  EXPECT_FALSE(intake_.has_rates());
}

TEST_F(Intake, SeesTheClockStepBackOnceForAllStreams) {
  Fly(10.0, 13.0, 1.0);
  EXPECT_TRUE(intake_.Push(*ToInput(OdometryAt(12.8, 0.0, 1.0)))) << "0.2 s is only late";
  EXPECT_TRUE(intake_.Push(*ToInput(OdometryAt(1.0, 0.0, 1.0)))) << "one message tells nothing";
  EXPECT_FALSE(intake_.Push(*ToInput(OdometryAt(1.01, 0.0, 1.0))));
  EXPECT_TRUE(intake_.Push(*ToInput(RotorsAt(13.01), 4)));  // still of the old time
  EXPECT_EQ(intake_.stale(), 1);
  EXPECT_TRUE(intake_.Push(*ToInput(RotorsAt(1.0), 4)));
  EXPECT_EQ(intake_.resets(), 1);
}

// The stream that showed the step may be slow, or die.
TEST_F(Intake, AnyStreamThatHasSteppedBackEndsTheWaitForTheOldTime) {
  Fly(10.0, 13.0, 1.0);
  intake_.Push(BatterySample{FromSeconds(13.0), 16.0});
  intake_.Push(BatterySample{FromSeconds(9.0), 16.0});
  EXPECT_FALSE(intake_.Push(BatterySample{FromSeconds(9.01), 16.0}));
  for (double t = 9.0; t < 12.9; t += 0.01) intake_.Push(*ToInput(RotorsAt(t), 4));
  EXPECT_EQ(intake_.stale(), 0);
}

// Two monitors of one battery, one of which stamps late.
TEST_F(Intake, LateMessagesAmongOthersAreNoStepOfTheClock) {
  Fly(10.0, 13.0, 1.0);
  for (int i = 0; i < 5; ++i) {
    EXPECT_TRUE(intake_.Push(BatterySample{FromSeconds(13.0 + i), 16.0}));
    EXPECT_TRUE(intake_.Push(BatterySample{FromSeconds(12.4 + i), 16.0}));
  }
  EXPECT_EQ(intake_.resets(), 0);
  EXPECT_EQ(intake_.leaps(), 5);
}

TEST_F(Intake, ASingleStampFarAheadIsNoStepOfTheClock) {
  Fly(10.0, 13.0, 1.0);
  EXPECT_TRUE(intake_.Push(*ToInput(OdometryAt(99.0, x_, 1.0))));
  EXPECT_EQ(intake_.leaps(), 1);
  Fly(13.0, 14.0, 1.0);
  EXPECT_EQ(intake_.resets(), 0);
  // After a pause of all streams each of them loses one sample at most.
  Fly(50.0, 51.0, 1.0);
  EXPECT_EQ(intake_.leaps(), 3);
  EXPECT_EQ(intake_.resets(), 0);
  ASSERT_TRUE(intake_.decided());
  intake_.Release();
  EXPECT_EQ(intake_.Take().size(), static_cast<size_t>(2 * pushed_) - 2);
}

TEST(PoseTwistPairing, TwistsWithoutPosesDoNotPileUp) {
  PoseTwistPairing pairing;
  OdometryInput twist;
  twist.linear = Eigen::Vector3d::UnitX();
  for (int i = 0; i < 100000; ++i) {
    twist.sample.stamp = FromSeconds(1.0 + 0.01 * i);
    pairing.AddTwist(twist);
  }
  EXPECT_LT(pairing.num_twists(), 110u);
}

TEST_F(Intake, HoldsNoMoreOfAFastImuThanOfASlowOne) {
  ImuInput imu;
  for (int i = 0; i < 150000; ++i) {
    imu.sample.stamp = FromSeconds(1.0 + i / 8000.0);
    intake_.Push(imu);
  }
  EXPECT_EQ(intake_.forgotten(), 50000);
}

TEST_F(Intake, ForgetsTheOldestAfterAMinuteOfStanding) {
  Fly(1.0, 63.0, 0.0);
  EXPECT_NEAR(static_cast<double>(intake_.forgotten()), 2.0 * 200.0, 250.0);
}

// ---- Rotor speeds from commands ----------------------------------------------------------------

class CommandIntake : public ::testing::Test {
 protected:
  /// Two seconds of odometry, commands and, where the vehicle has them, sensors.
  void Fly(double from_s, bool with_commands, bool with_sensor) {
    for (int k = 0; k < 200; ++k) {
      const double t = from_s + 0.01 * k;
      intake_.Push(*ToInput(OdometryAt(t, t, 1.0)));
      if (with_sensor) intake_.Push(*ToInput(RotorsAt(t), 4));
      if (with_commands) intake_.Push(CommandSample{FromSeconds(t), RotorVector::Constant(4, 0.5)});
    }
  }

  SampleIntake intake_{"world", RotorIntake{true, true}};
};

TEST_F(CommandIntake, NeedsCommandsAndAVoltageButNoSensor) {
  Fly(1.0, false, true);
  EXPECT_FALSE(intake_.decided());
  EXPECT_EQ(intake_.WaitingFor(), "motor_commands");
  Fly(3.0, true, false);
  EXPECT_FALSE(intake_.decided());
  EXPECT_EQ(intake_.WaitingFor(), "battery_state");
  intake_.Push(BatterySample{FromSeconds(5.0), 16.0});
  EXPECT_TRUE(intake_.decided());
}

TEST_F(CommandIntake, PassesCommandsAndNoSensor) {
  intake_.Push(BatterySample{FromSeconds(1.0), 16.0});
  Fly(1.0, true, true);
  ASSERT_TRUE(intake_.decided());
  intake_.Release();
  const std::vector<Sample> samples = intake_.Take();
  ASSERT_EQ(samples.size(), 401u);
  EXPECT_TRUE(std::holds_alternative<BatterySample>(samples[0])) << "acts on what comes with it";
  EXPECT_TRUE(std::holds_alternative<CommandSample>(samples[1]));
  for (const Sample& sample : samples) EXPECT_FALSE(std::holds_alternative<RotorSample>(sample));
}

// ---- Acceptance --------------------------------------------------------------------------------

class AcceptanceTest : public ::testing::Test {
 protected:
  AcceptanceTest() : model_(test::NominalVehicle(), test::PaperEffects()) {
    snapshot_.values = DefaultTruth(model_);
    snapshot_.body = model_.Properties(snapshot_.values);
    snapshot_.sigma = 0.01 * snapshot_.values.cwiseAbs();
    snapshot_.observable.assign(model_.num_parameters(), true);
  }

  /// Half a second later.
  bool Update() {
    snapshot_.stamp += FromSeconds(0.5);
    snapshot_.covariance = snapshot_.sigma.cwiseAbs2().asDiagonal();
    return acceptance_.Update(model_, snapshot_);
  }
  double& Value(const std::string& name) { return snapshot_.values[model_.IndexOf(name)]; }

  DynamicModel model_;
  Snapshot snapshot_;
  Acceptance acceptance_{AcceptanceOptions()};
};

TEST_F(AcceptanceTest, AGoodEstimateHasToLast) {
  EXPECT_FALSE(Update());
  EXPECT_FALSE(Update());
  EXPECT_TRUE(Update());
  snapshot_.sigma[model_.IndexOf("thrust.k_f")] *= 20.0;
  EXPECT_FALSE(Update());
  EXPECT_EQ(acceptance_.reasons().size(), 1u);
}

TEST_F(AcceptanceTest, AWrongSignIsHeldBack) {
  Value("drag.d_x") *= -1.0;
  for (int i = 0; i < 3; ++i) Update();
  EXPECT_TRUE(acceptance_.accepted());
  ASSERT_EQ(acceptance_.held_back().size(), 1u);
  EXPECT_TRUE(testing_support::Contains(acceptance_.held_back().front(), "wrong sign"));
  const int d_x = model_.IndexOf("drag.d_x");
  EXPECT_EQ(acceptance_.Usable().values[d_x], model_.parameters()[d_x].spec.prior_value);
}

TEST_F(AcceptanceTest, UnsureParametersDoNotStandInTheWayButThrustDoes) {
  const int b_z = model_.IndexOf("viscous_torque.b_z");
  snapshot_.sigma[b_z] = 1e3;
  snapshot_.observable[b_z] = false;
  Update();
  Update();
  EXPECT_TRUE(Update());
  snapshot_.sigma[model_.IndexOf("thrust.k_f")] = 1e-6;
  EXPECT_FALSE(Update());
}

TEST_F(AcceptanceTest, NothingThatIsNotFiniteIsPublished) {
  snapshot_.covariance = Eigen::MatrixXd::Zero(2, 2);
  EXPECT_TRUE(IsFinite(snapshot_));
  snapshot_.covariance(0, 1) = kNan;
  EXPECT_FALSE(IsFinite(snapshot_));
}

// ---- URDF --------------------------------------------------------------------------------------

std::string RotorText(int number, const std::string& xyz, const std::string& axis) {
  const std::string n = std::to_string(number);
  return "<link name='rotor_" + n +
         "'><inertial><mass value='0.01'/><inertia ixx='1e-6' iyy='1e-6' izz='2e-6' ixy='0' "
         "ixz='0' iyz='0'/></inertial><visual><geometry><cylinder radius='0.07' "
         "length='0.01'/></geometry></visual></link>"
         "<joint name='rotor_" +
         n + "_joint' type='continuous'><origin xyz='" + xyz +
         "'/><parent link='base_link'/><child link='rotor_" + n + "'/><axis xyz='" + axis +
         "'/></joint>";
}

std::string Quad(const std::string& clockwise_axis) {
  return "<robot name='quad'><link name='base_link'><inertial><origin xyz='0 0 0.01'/>"
         "<mass value='0.71'/><inertia ixx='2e-3' iyy='2.5e-3' izz='4e-3' ixy='0' ixz='0' "
         "iyz='0'/></inertial></link>" +
         RotorText(2, "-0.1 -0.1 0.02", "0 0 1") + RotorText(0, "0.1 -0.1 0.02", "0 0 1") +
         RotorText(1, "-0.1 0.1 0.02", clockwise_axis) +
         RotorText(3, "0.1 0.1 0.02", clockwise_axis) +
         "<link name='imu_link'/><joint name='imu' type='fixed'><origin xyz='0.03 0 0' rpy='0 0 "
         "1.5707963267948966'/><parent link='base_link'/><child link='imu_link'/></joint></robot>";
}

TEST(UrdfVehicle, TakesMassRotorsAndImuFromTheLinks) {
  const Vehicle vehicle = VehicleFromUrdf(Quad("0 0 -1"));
  EXPECT_EQ(vehicle.name, "quad");
  EXPECT_NEAR(vehicle.mass_kg, 0.75, 1e-12);
  ASSERT_EQ(vehicle.num_rotors(), 4);
  EXPECT_EQ(vehicle.rotors[0].p_BP, Eigen::Vector3d(0.1, -0.1, 0.02)) << "in the order of N";
  EXPECT_EQ(vehicle.rotors[0].spin, -1.0) << "axis up is counter-clockwise";
  EXPECT_EQ(vehicle.rotors[1].spin, 1.0);
  EXPECT_EQ(vehicle.rotors[1].radius_m, 0.07);
  // By hand: Bcm at z = (0.71 0.01 + 0.04 0.02) / 0.75.
  const double z = (0.71 * 0.01 + 0.04 * 0.02) / 0.75;
  EXPECT_NEAR(*vehicle.parameters.at("centre_of_gravity.z").value, z, 1e-12);
  const double ixx =
      2e-3 + 0.71 * std::pow(0.01 - z, 2) + 4.0 * (1e-6 + 0.01 * (0.01 + std::pow(0.02 - z, 2)));
  EXPECT_NEAR(vehicle.inertia_kg_m2.x(), ixx, 1e-12);
  ASSERT_TRUE(vehicle.imu.has_value());
  EXPECT_NEAR(vehicle.imu->p_BS.x(), 0.03, 1e-12);
  EXPECT_NEAR((vehicle.imu->q_BS * Eigen::Vector3d::UnitX()).y(), 1.0, 1e-9);
}

TEST(UrdfVehicle, SaysWhatIsMissing) {
  ODMC_EXPECT_ERROR(VehicleFromUrdf(Quad("0 0 1")), "turn about the same axis");
  ODMC_EXPECT_ERROR(VehicleFromUrdf("<robot name='a'><link name='base_link'/></robot>"),
                    "no link has a mass");
  ODMC_EXPECT_ERROR(VehicleFromUrdf("nonsense"), "is not a URDF");
}

// ---- Live image --------------------------------------------------------------------------------

/// For people: ODMC_LIVE_IMAGE=/tmp/live.ppm test_node_parts --gtest_filter='LiveImage*'
void WritePpm(const cv::Mat& image, const std::string& file) {
  std::ofstream out(file, std::ios::binary);
  out << "P6 " << image.cols << " " << image.rows << " 255\n";
  for (auto pixel = image.begin<cv::Vec3b>(); pixel != image.end<cv::Vec3b>(); ++pixel) {
    out << (*pixel)[2] << (*pixel)[1] << (*pixel)[0];
  }
}

TEST(LiveImage, ShowsParametersAndResidualsAndStaysBounded) {
  const DynamicModel model(test::NominalVehicle(), test::PaperEffects());
  const ModelValues truth = DefaultTruth(model);
  LiveHistory history;
  std::vector<bool> observable(model.num_parameters(), true);
  observable[model.IndexOf("centre_of_gravity.z")] = false;
  for (int k = 0; k < 6000; ++k) {
    const double t = 0.01 * k, settle = std::exp(-t / 4.0);
    Snapshot snapshot;
    snapshot.time_s = t;
    snapshot.values = truth;
    snapshot.sigma = Eigen::VectorXd::Zero(model.num_parameters());
    for (int i = 0; i < model.num_parameters(); ++i) {
      const double size = model.parameters()[i].spec.scale;
      snapshot.values[i] += size * settle * std::cos(1.1 * t + i);
      snapshot.sigma[i] = 0.4 * size * (0.05 + settle);
    }
    snapshot.residual_force_B = 0.3 * Eigen::Vector3d(std::sin(9 * t), std::cos(7 * t), -0.4);
    snapshot.residual_torque_B = 4e-3 * Eigen::Vector3d(std::cos(8 * t), std::sin(6 * t), 0.1);
    history.Add(snapshot);
  }
  EXPECT_LT(history.entries().size(), 601u);
  EXPECT_GT(history.entries().size(), 250u);
  const LiveImageTexts texts{"generic",
                             "airborne, accepted",
                             true,
                             "60.0 s   residual 0.21 N, 0.003 N m   update 4.1 ms (p99 6.0)",
                             {}};
  const cv::Mat image = DrawLiveImage(model, history, observable, texts);
  EXPECT_EQ(image.cols, 1280);
  EXPECT_EQ(image.rows, 800);
  cv::Scalar mean, deviation;
  cv::meanStdDev(image, mean, deviation);
  EXPECT_GT(deviation[0], 5.0) << "something is drawn";
  if (const char* file = std::getenv("ODMC_LIVE_IMAGE")) WritePpm(image, file);
  EXPECT_FALSE(DrawLiveImage(model, LiveHistory(), {}, texts).empty()) << "before the first update";
}

// ---- What the model leaves unexplained ---------------------------------------------------------

ResidualAnalysis LookAtDrag() {
  ResidualAnalysis look;
  look.stamp = 1500000000;
  look.flight_s = 19.0;
  look.model = std::make_shared<DynamicModel>(test::NominalVehicle(), test::PaperEffects());
  look.structured_share = 0.4;
  look.channel = "force_x";
  look.whiteness_p = 1e-9;
  look.structured = true;
  look.force_rmse_N = {0.3, 0.2, 0.1};
  look.candidate = RankedEffect();
  look.candidate->name = "quadratic_drag";
  look.candidate->score = 25.0;
  look.candidate->parameters = {{"quadratic_drag.c_q", "kg/m", 0.03, 0.001, true, true}};
  look.explained_share = 0.8;
  look.alternatives = {"rotor_drag"};
  look.in_a_row = 2;
  return look;
}

std::string ValueOf(const diagnostic_msgs::DiagnosticStatus& status, const std::string& key) {
  for (const auto& pair : status.values) {
    if (pair.key == key) return pair.value;
  }
  return "absent";
}

TEST(RotorDiagnostic, NamesBadSensorsWhileTheyAreBad) {
  RotorStatus rotors;
  EXPECT_TRUE(testing_support::Contains(RotorDiagnostic(rotors, "n").message, "not watched"));
  rotors.is_watching = true;
  rotors.replaced = 7;
  const auto good = RotorDiagnostic(rotors, "n");
  EXPECT_EQ(good.level, diagnostic_msgs::DiagnosticStatus::OK);
  EXPECT_EQ(good.message, "sensors agree with commands");
  EXPECT_EQ(ValueOf(good, "replaced_readings"), "7");
  rotors.bad = {{FromSeconds(1700000012.345), 2, true, "its sensor is frozen at 800 rad/s"}};
  const auto bad = RotorDiagnostic(rotors, "n");
  EXPECT_EQ(bad.level, diagnostic_msgs::DiagnosticStatus::WARN);
  EXPECT_TRUE(testing_support::Contains(bad.message, "rotor3: its sensor is frozen at 800"));
  EXPECT_EQ(ValueOf(bad, "bad_sensors"), "rotor3");
  EXPECT_EQ(ValueOf(bad, "rotor3_since_s"), "1700000012.345");
  NodeStatus status;
  EXPECT_EQ(ValueOf(EstimatorDiagnostic(status, "n"), "bad_rotor_sensors"), "absent");
  status.rotors = rotors;
  const auto estimator = EstimatorDiagnostic(status, "n");
  EXPECT_EQ(estimator.level, diagnostic_msgs::DiagnosticStatus::WARN);
  EXPECT_EQ(estimator.message, "rotor3: its sensor is frozen at 800 rad/s");
}

TEST(Unexplained, MessageHoldsTheLook) {
  const UnexplainedResidual m = ToMessage(LookAtDrag(), "base_link", {"wind"});
  EXPECT_EQ(m.header.stamp, ros::Time(1.5));
  EXPECT_EQ(m.header.frame_id, "base_link");
  EXPECT_EQ(m.effects, test::PaperEffects());
  EXPECT_EQ(m.force_rmse_N[2], 0.1);
  EXPECT_EQ(m.candidate, "quadratic_drag");
  ASSERT_EQ(m.parameters.size(), 1u);
  EXPECT_EQ(m.parameters.front().unit, "kg/m");
  EXPECT_EQ(m.added, std::vector<std::string>{"wind"});
  ResidualAnalysis nothing = LookAtDrag();
  nothing.candidate.reset();
  const UnexplainedResidual without = ToMessage(nothing, "base_link", {});
  EXPECT_TRUE(without.candidate.empty());
  EXPECT_EQ(without.score, 0.0);
}

TEST(Unexplained, DiagnosticSaysWhatWouldExplainIt) {
  NodeStatus status;
  EXPECT_EQ(UnexplainedDiagnostic(status, "n").message, "off");
  status.watches_residual = true;
  EXPECT_EQ(UnexplainedDiagnostic(status, "n").message, "too little flight yet");
  status.unexplained = LookAtDrag();
  status.added_effects = {"wind"};
  const auto named = UnexplainedDiagnostic(status, "n");
  EXPECT_EQ(named.message, "quadratic_drag would explain it; added in flight: wind");
  EXPECT_EQ(ValueOf(named, "candidate"), "quadratic_drag");
  EXPECT_EQ(ValueOf(named, "structured_share"), "0.4");
  EXPECT_EQ(ValueOf(named, "added_effects"), "wind");
  status.unexplained->candidate.reset();
  EXPECT_NE(UnexplainedDiagnostic(status, "n").message.find("no effect of the catalogue"),
            std::string::npos);
  status.unexplained->structured = false;
  EXPECT_EQ(UnexplainedDiagnostic(status, "n").message.find("nothing to explain"), 0u);
}

}  // namespace
}  // namespace odmc
