#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <cmath>
#include <fstream>

#include "odmc/ros/flight_bag.h"
#include "odmc/ros/pose_twist.h"
#include "support/error_text.h"
#include "support/foreign_bag.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using testing_support::Contains;
using testing_support::MessageBytes;
using testing_support::Raw;
using testing_support::WithHeader;

constexpr Stamp kStart = 5000000000;
constexpr double kRpm = M_PI / 30.0;

/// A straight flight at changing rotor speeds.
FlightLog Flight() {
  FlightLog log;
  for (int i = 0; i < 200; ++i) {
    const Stamp stamp = kStart + 10000001 * static_cast<Stamp>(i);
    OdometrySample odometry;
    odometry.stamp = stamp;
    odometry.p_WS = Eigen::Vector3d(0.01 * i, 0.0, 1.0);
    log.odometry.push_back(odometry);
    RotorVector speed(4);
    for (int j = 0; j < 4; ++j) speed[j] = 700.0 + 50.0 * j + 20.0 * std::sin(0.1 * i + j);
    log.rotors.push_back({stamp + 5, speed});
  }
  return log;
}

class ForeignBag : public ::testing::Test {
 protected:
  std::string File() const { return folder_.File("f.bag"); }
  FlightLog Read(const BagOptions& options = {}) const { return ReadFlightBag(File(), 4, options); }

  /// The flight with its rotor speeds in messages of another kind.
  void WriteKind(const std::string& kind) const {
    WriteFlightBag(Flight(), folder_.File("plain.bag"));
    testing_support::WriteForeign(folder_.File("plain.bag"), File(), kind);
  }

  /// A bag with poses, and what `fill` adds.
  template <typename Fill>
  void WriteBag(Fill fill) const {
    FlightLog flight = Flight();
    flight.rotors.clear();
    WriteFlightBag(flight, File());
    rosbag::Bag bag(File(), rosbag::bagmode::Append);
    fill(&bag);
    bag.close();
  }

  void ExpectSameRotors(const FlightLog& log, double tolerance) const {
    const FlightLog flight = Flight();
    ASSERT_EQ(log.rotors.size(), flight.rotors.size());
    for (size_t i = 0; i < flight.rotors.size(); ++i) {
      EXPECT_EQ(log.rotors[i].stamp, flight.rotors[i].stamp);
      EXPECT_LE((log.rotors[i].speed - flight.rotors[i].speed).cwiseAbs().maxCoeff(), tolerance);
    }
    EXPECT_EQ(log.dropped, 0);
  }

  testing_support::TemporaryFolder folder_;
};

TEST_F(ForeignBag, ActuatorsGiveTheSameSamplesToTheLastBit) {
  WriteKind("actuators");
  const FlightLog log = Read();
  ExpectSameRotors(log, 0.0);
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_TRUE(Contains(log.warnings[0], "200 samples have negative rotor speeds"))
      << log.warnings[0];
}

TEST_F(ForeignBag, EscStatusGivesTheSameSamplesToHalfAnRpm) {
  WriteKind("esc_status");
  const FlightLog log = Read();
  ExpectSameRotors(log, 0.501 * kRpm);
  EXPECT_TRUE(log.warnings.empty()) << log.warnings[0];
}

TEST_F(ForeignBag, AnyTypeGivesTheSameSamplesByFieldUnitAndOrder) {
  WriteKind("made_up");
  ODMC_EXPECT_ERROR(Read(),
                    "no rotor speeds (odmc/RotorSpeeds, sensor_msgs/JointState, or a type "
                    "that is known); --topic rotor_speeds:=/name and --rotor-topic-field");
  BagOptions options;
  options.rotor_topic_field = testing_support::kMadeUpField;
  ODMC_EXPECT_ERROR(Read(options), "which topic has the field arms[].esc.erpm?");
  options.topics["rotor_speeds"] = "/garage/motors";
  ODMC_EXPECT_ERROR(Read(options), "/garage/motors: garage_quad/Motors does not say in which unit");
  options.rotor_speed_unit = "erpm";
  options.pole_pairs = testing_support::kMadeUpPolePairs;
  options.rotor_order = testing_support::MadeUpOrder();
  const FlightLog log = Read(options);
  ExpectSameRotors(log, 1e-4);  // single precision
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_TRUE(Contains(log.warnings[0],
                       "/garage/motors: garage_quad/Motors has no stamp: took "
                       "the time of arrival"))
      << log.warnings[0];
  options.rotor_topic_field = "arms[].esc.rpm";
  ODMC_EXPECT_ERROR(Read(options),
                    "there is no 'rpm' in garage_quad/Esc, which has temperature, "
                    "on, erpm");
  options.rotor_topic_field.clear();
  ODMC_EXPECT_ERROR(Read(options), "garage_quad/Motors is not known: say which of its fields");
}

TEST_F(ForeignBag, StampsOfAHeaderCountWhereverTheTypeIsFrom) {
  WriteKind("made_up_stamped");
  BagOptions options;
  options.topics["rotor_speeds"] = "/garage/motors";
  options.rotor_topic_field = testing_support::kMadeUpField;
  options.rotor_speed_unit = "erpm";
  options.pole_pairs = testing_support::kMadeUpPolePairs;
  options.rotor_order = testing_support::MadeUpOrder();
  const FlightLog log = Read(options);
  ExpectSameRotors(log, 1e-4);
  EXPECT_TRUE(log.warnings.empty()) << log.warnings[0];
}

// ESCs with microseconds of their own beside a header that is 4 ms late.
TEST_F(ForeignBag, StampsOfTheRotorsCountWhereTheyAreNamed) {
  const std::string definition = testing_support::With(WithHeader("Header header\nEsc[4] escs\n"),
                                                       "my/Esc", "uint64 timestamp\nfloat64 rpm\n");
  const FlightLog flight = Flight();
  WriteBag([&](rosbag::Bag* bag) {
    for (const RotorSample& sample : flight.rotors) {
      MessageBytes bytes;
      bytes.AddHeader(sample.stamp + 4000000, "");
      for (int j = 0; j < 4; ++j) {
        bytes.Add(static_cast<std::uint64_t>((sample.stamp - kStart + 1000000000) / 1000));
        bytes.Add(sample.speed[j] / kRpm);
      }
      bag->write("/escs", ToRos(sample.stamp + 6000000), Raw("my/Escs", "", definition, bytes));
    }
  });
  BagOptions options;
  options.topics["rotor_speeds"] = "/escs";
  options.rotor_topic_field = "escs[].rpm";
  options.rotor_speed_unit = "rpm";
  options.rotor_stamp_field = "escs[].timestamp";
  options.rotor_stamp_unit = "us";
  const FlightLog log = Read(options);
  ASSERT_EQ(log.rotors.size(), flight.rotors.size());
  for (size_t i = 0; i < log.rotors.size(); ++i) {
    // Late by what every header is; to a microsecond, and the clocks' drift.
    EXPECT_NEAR(ToSeconds(log.rotors[i].stamp - flight.rotors[i].stamp), 0.004, 3e-6);
  }
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_TRUE(Contains(log.warnings[0],
                       "/escs: stamps are escs[].timestamp, a clock of its own "
                       "laid on header.stamp"))
      << log.warnings[0];
  WriteFlightBag(Flight(), File());
  BagOptions own;
  own.rotor_stamp_field = "escs[].timestamp";
  ODMC_EXPECT_ERROR(Read(own), "/rotor_speeds: is a odmc/RotorSpeeds, whose header has the stamp");
}

// The order counts for our own messages, too.
TEST_F(ForeignBag, OrderHoldsForEveryType) {
  WriteFlightBag(Flight(), File());
  BagOptions options;
  options.rotor_order = {4, 3, 2, 1};
  const FlightLog log = Read(options), flight = Flight();
  EXPECT_EQ(log.rotors[7].speed[0], flight.rotors[7].speed[3]);
  EXPECT_EQ(log.rotors[7].speed[2], flight.rotors[7].speed[1]);
  options.rotor_order = {1, 2, 3, 5};
  ODMC_EXPECT_ERROR(Read(options), "/rotor_speeds: has 4 speeds, an order of 4 was given");
}

TEST_F(ForeignBag, SpeedsWithStampsOfTheirOwnAreBroughtToOne) {
  const auto speed_at = [](int rotor, Stamp stamp) {
    return 700.0 + 10.0 * rotor + 20.0 * ToSeconds(stamp - kStart);
  };
  WriteBag([&](rosbag::Bag* bag) {
    for (int i = 0; i < 100; ++i) {
      const Stamp t = kStart + 5000000 * static_cast<Stamp>(i);
      const std::vector<Stamp> stamps = {t + 2000000, t, t + 3000000, t + 1000000};
      std::vector<float> rpm;
      for (int j = 0; j < 4; ++j) {
        rpm.push_back(static_cast<float>(speed_at(j, stamps[j]) / kRpm));
      }
      bag->write("/blackbird/rotor_rpm", ToRos(t + 9000000),
                 Raw("blackbird/MotorRPM", "b5f09223542b26e832f8faf8e5bf6d22",
                     testing_support::MotorRpmDefinition(),
                     testing_support::MotorRpm(t + 8000000, stamps, rpm)));
    }
  });
  const FlightLog log = Read();
  ASSERT_EQ(log.rotors.size(), 99u);
  EXPECT_TRUE(log.warnings.empty()) << log.warnings[0];
  for (const RotorSample& sample : log.rotors) {
    EXPECT_EQ((sample.stamp - kStart) % 5000000, 0);
    for (int j = 0; j < 4; ++j) EXPECT_NEAR(sample.speed[j], speed_at(j, sample.stamp), 1e-4);
  }
}

TEST_F(ForeignBag, CommandsAndVoltageOfOtherPackagesAreRead) {
  WriteBag([&](rosbag::Bag* bag) {
    for (int i = 0; i < 50; ++i) {
      const Stamp t = kStart + 10000000 * static_cast<Stamp>(i);
      MessageBytes channels, feedback;
      channels.AddHeader(t).AddArray<std::uint16_t>({1100, 1200, 1300, 1400, 0, 0, 0, 0});
      bag->write("/mavros/rc/out", ToRos(t),
                 Raw("mavros_msgs/RCOut", "52cacf104bab5ae3b103cfe176590713",
                     WithHeader("std_msgs/Header header\nuint16[] channels\n"), channels));
      feedback.AddHeader(t).Add(15.5f).Add(std::uint8_t{0}).Add(std::uint8_t{1});
      feedback.AddArray<std::int16_t>({6000, 6100, 6200, 6300}).AddArray<double>({});
      bag->write("/low_level_feedback", ToRos(t),
                 Raw("quadrotor_msgs/LowLevelFeedback", "e3cfad3ba98dfdc505bcf1fe91833d87",
                     WithHeader("Header header\nuint8 NONE=0\nfloat32 battery_voltage\n"
                                "uint8 battery_state\nuint8 control_mode\nint16[] motor_speeds\n"
                                "float64[] thrust_mapping_coeffs\n"),
                     feedback));
    }
  });
  const FlightLog log = Read();
  ASSERT_EQ(log.commands.size(), 50u);
  EXPECT_NEAR(log.commands[9].throttle[3], 0.4, 1e-12);
  ASSERT_EQ(log.rotors.size(), 50u);
  EXPECT_NEAR(log.rotors[9].speed[3], 6300 * kRpm, 1e-9);
  ASSERT_EQ(log.battery.size(), 50u);
  EXPECT_EQ(log.battery[9].voltage_V, 15.5);
  BagOptions options;
  options.command_order = {4, 3, 2, 1};
  EXPECT_NEAR(Read(options).commands[9].throttle[0], 0.4, 1e-12);
  ODMC_EXPECT_ERROR(ReadActuatorBag(File(), {}), "say which of them are rotors by an order");
  EXPECT_EQ(ReadActuatorBag(File(), options).commands.size(), 50u);
}

// ESCs that have not reported yet; others than the vehicle's; messages that were cut.
TEST_F(ForeignBag, WhatDoesNotFitIsNamed) {
  const auto esc_bag = [&](const std::vector<std::int32_t>& rpm) {
    WriteBag([&](rosbag::Bag* bag) {
      for (int i = 0; i < 10; ++i) {
        const Stamp t = kStart + 10000000 * static_cast<Stamp>(i);
        bag->write("/mavros/esc_status", ToRos(t), testing_support::RawEscStatus(t, {}));
        bag->write("/mavros/esc_status", ToRos(t), testing_support::RawEscStatus(t + 1, rpm));
      }
    });
  };
  esc_bag({6000, 6000, 6000, 6000});
  const FlightLog log = Read();
  EXPECT_EQ(log.rotors.size(), 10u);
  EXPECT_TRUE(Contains(log.warnings.at(0), "10 messages without an entry")) << log.warnings[0];
  esc_bag({6000, 6000, 6000});
  ODMC_EXPECT_ERROR(Read(),
                    "topic /mavros/esc_status: mavros_msgs/ESCStatus: esc_status[].rpm has "
                    "3 entries, the vehicle has 4 rotors");
  WriteBag([&](rosbag::Bag* bag) {
    RawMessage cut = testing_support::RawEscStatus(kStart, {6000, 6000, 6000, 6000});
    cut.bytes.resize(50);
    bag->write("/mavros/esc_status", ToRos(kStart), cut);
  });
  ODMC_EXPECT_ERROR(Read(),
                    "topic /mavros/esc_status: mavros_msgs/ESCStatus: a message ends at "
                    "byte 50, but esc_status at byte 20 takes 112 more");
  WriteBag([&](rosbag::Bag* bag) {
    RawMessage garbage = testing_support::RawEscStatus(kStart, {1, 2, 3, 4});
    (*garbage.connection)["message_definition"] = "\x01\xff nonsense [[[";
    bag->write("/mavros/esc_status", ToRos(kStart), garbage);
  });
  ODMC_EXPECT_ERROR(Read(),
                    "topic /mavros/esc_status: mavros_msgs/ESCStatus: line 1 of its "
                    "definition is no field: '\\x01\\xff nonsense [[['");
}

TEST_F(ForeignBag, CommandedSpeedsAreNotTakenForMeasuredOnes) {
  WriteBag([&](rosbag::Bag* bag) {
    bag->write("/command/motor_speed", ToRos(kStart),
               testing_support::RawActuators(kStart, {1, 2, 3, 4}));
  });
  ODMC_EXPECT_ERROR(Read(), "no rotor speeds");
  BagOptions options;
  options.topics["rotor_speeds"] = "/command/motor_speed";
  EXPECT_EQ(Read(options).rotors.size(), 1u);
}

template <typename Message>
void WritePoses(const std::string& topic, rosbag::Bag* bag) {
  for (const OdometrySample& sample : Flight().odometry) {
    Message m;
    m.header.stamp = ToRos(sample.stamp);
    if constexpr (std::is_same_v<Message, geometry_msgs::TransformStamped>) {
      m.transform.translation = ToVector3(sample.p_WS);
      m.transform.rotation.w = 1.0;
    } else {
      m.pose.pose.position.x = sample.p_WS.x();
      m.pose.pose.position.z = sample.p_WS.z();
      m.pose.pose.orientation.w = 1.0;
    }
    bag->write(topic, m.header.stamp, m);
  }
}

TEST_F(ForeignBag, PosesComeInThreeTypes) {
  const auto expect_flight = [&] {
    const FlightLog log = Read(), flight = Flight();
    ASSERT_EQ(log.odometry.size(), flight.odometry.size());
    for (size_t i = 0; i < flight.odometry.size(); ++i) {
      EXPECT_EQ(log.odometry[i].stamp, flight.odometry[i].stamp);
      EXPECT_EQ(log.odometry[i].p_WS, flight.odometry[i].p_WS);
      EXPECT_FALSE(log.odometry[i].v_WS);
    }
  };
  const auto write = [&](auto poses) {
    rosbag::Bag bag(File(), rosbag::bagmode::Write);
    poses(&bag);
    bag.write("/motor_speed", ToRos(kStart), testing_support::RawActuators(kStart, {1, 2, 3, 4}));
    bag.close();
  };
  write([](rosbag::Bag* bag) {
    WritePoses<geometry_msgs::PoseWithCovarianceStamped>("/ov_msckf/poseimu", bag);
  });
  expect_flight();
  write([](rosbag::Bag* bag) {
    WritePoses<geometry_msgs::TransformStamped>("/vicon/quad/quad", bag);
  });
  expect_flight();
}

// A turning flight, with velocities of 100 Hz between poses of 50 Hz, in the world or in the body.
TEST_F(ForeignBag, TwistsBesidePosesGiveTheVelocity) {
  const auto velocity_at = [](double t) { return Eigen::Vector3d(2.0 * t, 1.0 - t, 0.5); };
  for (const bool in_body : {false, true}) {
    rosbag::Bag bag(File(), rosbag::bagmode::Write);
    bag.write("/motor_speed", ToRos(kStart), testing_support::RawActuators(kStart, {1, 2, 3, 4}));
    for (int i = 0; i < 300; ++i) {
      const double t = 0.01 * i;
      const Eigen::Quaterniond q_WB(Eigen::AngleAxisd(2.0 + 0.5 * t, Eigen::Vector3d::UnitZ()));
      geometry_msgs::TwistStamped twist;
      twist.header.stamp = ToRos(kStart + 10000000 * static_cast<Stamp>(i) + 3000000);
      const Eigen::Quaterniond q_late(
          Eigen::AngleAxisd(2.0 + 0.5 * (t + 0.003), Eigen::Vector3d::UnitZ()));
      const Eigen::Vector3d v_WB = velocity_at(t + 0.003);
      twist.twist.linear = ToVector3(in_body ? Eigen::Vector3d(q_late.conjugate() * v_WB) : v_WB);
      twist.twist.angular.x = 9.0;  // in a frame nobody knows: not used
      bag.write("/velocity", twist.header.stamp, twist);
      if (i % 2 != 0) continue;
      geometry_msgs::PoseStamped pose;
      pose.header.stamp = ToRos(kStart + 10000000 * static_cast<Stamp>(i));
      pose.pose.position.x = t * t;
      pose.pose.position.y = t - 0.5 * t * t;
      pose.pose.position.z = 0.5 * t;
      pose.pose.orientation.z = q_WB.z();
      pose.pose.orientation.w = q_WB.w();
      bag.write("/pose", pose.header.stamp, pose);
    }
    bag.close();
    EXPECT_FALSE(Read().odometry.at(10).v_WS) << "not named, not used";
    BagOptions options;
    options.topics["twist"] = "/velocity";
    const FlightLog log = Read(options);
    ASSERT_EQ(log.odometry.size(), 150u);
    EXPECT_FALSE(log.odometry[0].v_WS) << "before the first twist";
    for (size_t i = 1; i < log.odometry.size(); ++i) {
      ASSERT_TRUE(log.odometry[i].v_WS) << i;
      EXPECT_LT((*log.odometry[i].v_WS - velocity_at(0.02 * i)).norm(), 1e-4);
      EXPECT_FALSE(log.odometry[i].w_WS_S);
    }
    EXPECT_TRUE(log.warnings.empty()) << log.warnings[0];
  }
}

TEST(PoseTwistPairing, WaitsForTheTwistAfterAPose) {
  constexpr Stamp kMs = 1000000;
  const auto pose_at = [](Stamp stamp) {
    OdometryInput pose;
    pose.sample.stamp = stamp;
    pose.is_pose = true;
    return pose;
  };
  const auto twist_at = [](Stamp stamp, double v) {
    OdometryInput twist;
    twist.sample.stamp = stamp;
    twist.linear = Eigen::Vector3d(v, 0.0, 0.0);
    return twist;
  };
  PoseTwistPairing pairing;
  EXPECT_TRUE(pairing.AddPose(pose_at(1000 * kMs)).empty()) << "no twist yet";
  const auto first = pairing.AddTwist(twist_at(1005 * kMs, 1.0));
  ASSERT_EQ(first.size(), 1u);
  EXPECT_FALSE(first[0].linear) << "before the first twist";
  EXPECT_TRUE(pairing.AddPose(pose_at(1010 * kMs)).empty());
  const auto ready = pairing.AddTwist(twist_at(1015 * kMs, 3.0));
  ASSERT_EQ(ready.size(), 1u);
  EXPECT_FALSE(ready[0].is_pose);
  EXPECT_NEAR(ready[0].linear->x(), 2.0, 1e-12);
  // Twists stop: poses go on without a velocity.
  size_t released = 0;
  for (Stamp t = 1020 * kMs; t <= 1300 * kMs; t += 10 * kMs) {
    for (const OdometryInput& pose : pairing.AddPose(pose_at(t))) {
      EXPECT_FALSE(pose.linear);
      ++released;
    }
  }
  EXPECT_EQ(released, 18u);
  EXPECT_EQ(pairing.Flush().size(), 11u);
  // The clock steps back.
  EXPECT_TRUE(pairing.AddPose(pose_at(10 * kMs)).empty());
  EXPECT_TRUE(pairing.AddTwist(twist_at(5 * kMs, 1.0)).empty());
  EXPECT_EQ(pairing.AddTwist(twist_at(15 * kMs, 1.0)).size(), 1u);
  EXPECT_FALSE(pairing.is_late());
}

// Motion capture and autopilot on two clocks.
TEST(PoseTwistPairing, PosesComeOutWhereTheTwistsClockIsFarBehind) {
  constexpr Stamp kMs = 1000000;
  PoseTwistPairing pairing;
  size_t released = 0;
  OdometryInput pose, twist;
  twist.linear = Eigen::Vector3d::Zero();
  for (Stamp t = 1000 * kMs; t < 2000 * kMs; t += 10 * kMs) {
    pose.sample.stamp = t;
    twist.sample.stamp = t - 600 * kMs;
    released += pairing.AddPose(pose).size() + pairing.AddTwist(twist).size();
  }
  EXPECT_GE(released, 88u);
}

TEST(PoseTwistPairing, TwistsThatBeginLateAreNotUsed) {
  PoseTwistPairing pairing;
  OdometryInput pose, twist;
  twist.linear = Eigen::Vector3d::Zero();
  pose.is_pose = true;
  size_t released = 0;
  for (Stamp t = 1; t < 1000000000; t += 100000000) {
    pose.sample.stamp = t;
    for (const OdometryInput& ready : pairing.AddPose(pose)) {
      EXPECT_TRUE(ready.is_pose);
      ++released;
    }
  }
  EXPECT_EQ(released, 10u);
  twist.sample.stamp = 1000000000;
  EXPECT_TRUE(pairing.AddTwist(twist).empty());
  EXPECT_TRUE(pairing.is_late());
  pose.sample.stamp = 1100000000;
  EXPECT_EQ(pairing.AddPose(pose).size(), 1u);
}

// Of the same pose, the plain one.
TEST_F(ForeignBag, PlainPosesComeFirst) {
  rosbag::Bag bag(File(), rosbag::bagmode::Write);
  WritePoses<geometry_msgs::PoseWithCovarianceStamped>("/mavros/local_position/pose_cov", &bag);
  geometry_msgs::PoseStamped pose;
  pose.header.stamp = ToRos(kStart);
  pose.pose.orientation.w = 1.0;
  bag.write("/mavros/local_position/pose", pose.header.stamp, pose);
  bag.write("/motor_speed", ToRos(kStart), testing_support::RawActuators(kStart, {1, 2, 3, 4}));
  bag.close();
  EXPECT_EQ(Read().odometry.size(), 1u);
}

}  // namespace
}  // namespace odmc
