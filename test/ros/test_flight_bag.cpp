#include <geometry_msgs/PoseStamped.h>
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/JointState.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/ros/flight_bag.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using testing_support::Contains;

Eigen::Vector3d Random(std::mt19937* generator) {
  std::normal_distribution<double> noise;
  return Eigen::Vector3d(noise(*generator), noise(*generator), noise(*generator));
}

RotorVector Speeds(double speed) { return RotorVector::Constant(4, speed); }

/// A flight of circles at changing heading with every stream on its own stamps, from `start` on.
FlightLog Circles(Stamp start, int count = 300) {
  std::mt19937 generator(5);
  FlightLog log;
  for (int i = 0; i < count; ++i) {
    const double t = 0.01 * i;
    OdometrySample odometry;
    odometry.stamp = start + 10000001 * static_cast<Stamp>(i);
    odometry.p_WS = Eigen::Vector3d(std::cos(2.0 * t), std::sin(2.0 * t), 1.0 / 3.0);
    odometry.q_WS = Eigen::AngleAxisd(1.0 + 0.3 * t, Eigen::Vector3d::UnitZ());
    odometry.v_WS = Eigen::Vector3d(-2.0 * std::sin(2.0 * t), 2.0 * std::cos(2.0 * t), 0.0);
    odometry.w_WS_S = Random(&generator);
    log.odometry.push_back(odometry);
    log.imu.push_back({odometry.stamp + 3, Random(&generator), Random(&generator)});
    RotorSample rotors{odometry.stamp + 5, Speeds(1000.0)};
    rotors.speed.head<3>() += Random(&generator);
    rotors.speed.tail<3>() += Random(&generator);
    log.rotors.push_back(rotors);
    log.battery.push_back({odometry.stamp + 7, (16000 + i) / 1000.0});
    log.commands.push_back({odometry.stamp + 2, RotorVector{{0.0, i / 300.0, 1.0 / 3.0, 1.0}}});
  }
  return log;
}

void ExpectSame(const FlightLog& a, const FlightLog& b) {
  ASSERT_EQ(a.odometry.size(), b.odometry.size());
  for (size_t i = 0; i < a.odometry.size(); ++i) {
    EXPECT_EQ(a.odometry[i].stamp, b.odometry[i].stamp);
    EXPECT_EQ(a.odometry[i].p_WS, b.odometry[i].p_WS);
    EXPECT_EQ(a.odometry[i].q_WS.coeffs(), b.odometry[i].q_WS.coeffs());
    EXPECT_EQ(a.odometry[i].v_WS, b.odometry[i].v_WS);
    EXPECT_EQ(a.odometry[i].w_WS_S, b.odometry[i].w_WS_S);
  }
  ASSERT_EQ(a.imu.size(), b.imu.size());
  for (size_t i = 0; i < a.imu.size(); ++i) {
    EXPECT_EQ(a.imu[i].stamp, b.imu[i].stamp);
    EXPECT_EQ(a.imu[i].gyro_I, b.imu[i].gyro_I);
    EXPECT_EQ(a.imu[i].specific_force_I, b.imu[i].specific_force_I);
  }
  ASSERT_EQ(a.rotors.size(), b.rotors.size());
  for (size_t i = 0; i < a.rotors.size(); ++i) {
    EXPECT_EQ(a.rotors[i].stamp, b.rotors[i].stamp);
    EXPECT_EQ(a.rotors[i].speed, b.rotors[i].speed);
  }
  ASSERT_EQ(a.battery.size(), b.battery.size());
  for (size_t i = 0; i < a.battery.size(); ++i) {
    EXPECT_EQ(a.battery[i].stamp, b.battery[i].stamp);
    EXPECT_EQ(a.battery[i].voltage_V, b.battery[i].voltage_V);
  }
  ASSERT_EQ(a.commands.size(), b.commands.size());
  for (size_t i = 0; i < a.commands.size(); ++i) {
    EXPECT_EQ(a.commands[i].stamp, b.commands[i].stamp);
    EXPECT_EQ(a.commands[i].throttle, b.commands[i].throttle);
  }
  EXPECT_EQ(a.rotor_rms_only, b.rotor_rms_only);
}

class FlightBag : public ::testing::Test {
 protected:
  std::string File() const { return folder_.File("f.bag"); }
  FlightLog Read(const BagOptions& options = {}) const { return ReadFlightBag(File(), 4, options); }

  /// Writes messages of our own making into a bag.
  template <typename Fill>
  void WriteBag(Fill fill) const {
    rosbag::Bag bag(File(), rosbag::bagmode::Write);
    fill(&bag);
    bag.close();
  }

  testing_support::TemporaryFolder folder_;
};

TEST_F(FlightBag, RoundTripKeepsEveryBit) {
  for (const Stamp start : {Stamp{-30500000000}, Stamp{-1}, Stamp{0}, Stamp{999999999},
                            Stamp{1000000000}, Stamp{1700000000123456789}}) {
    const FlightLog log = Circles(start);
    WriteFlightBag(log, File());
    const FlightLog back = Read();
    ExpectSame(log, back);
    EXPECT_EQ(back.file, "f.bag");
    EXPECT_TRUE(back.warnings.empty()) << back.warnings[0];
    EXPECT_EQ(back.dropped, 0);
  }
}

// Of a bench there need be no pose; the number of rotors is that of the commands.
TEST_F(FlightBag, GivesWhatActuatorsAreIdentifiedFrom) {
  const FlightLog flight = Circles(0);
  WriteFlightBag(flight, File());
  const FlightLog log = ReadActuatorBag(File(), {});
  EXPECT_TRUE(log.odometry.empty());
  ASSERT_EQ(log.commands.size(), flight.commands.size());
  ASSERT_EQ(log.rotors.size(), flight.rotors.size());
  EXPECT_EQ(log.commands.back().throttle, flight.commands.back().throttle);
  EXPECT_EQ(log.rotors.back().speed, flight.rotors.back().speed);
  EXPECT_EQ(log.rotors[5].stamp - log.commands[5].stamp,
            flight.rotors[5].stamp - flight.commands[5].stamp);
  FlightLog silent = flight;
  silent.commands.clear();
  WriteFlightBag(silent, File());
  ODMC_EXPECT_ERROR(ReadActuatorBag(File(), {}), "MotorCommands");
}

TEST_F(FlightBag, AbsentPartsStayAbsent) {
  FlightLog log = Circles(0);
  log.battery.clear();
  log.commands.clear();
  log.rotor_rms_only = true;
  for (size_t i = 0; i < log.odometry.size(); ++i) {
    log.odometry[i].v_WS.reset();
    if (i % 2 == 0) log.odometry[i].w_WS_S.reset();
    if (i % 3 == 0) log.imu[i].gyro_I.reset();
    if (i % 3 == 1) log.imu[i].specific_force_I.reset();
  }
  WriteFlightBag(log, File());
  ExpectSame(log, Read());
}

TEST_F(FlightBag, CommandsMayStandInForRotorSpeeds) {
  FlightLog log = Circles(0);
  log.rotors.clear();
  WriteFlightBag(log, File());
  ExpectSame(log, Read());
  BagOptions options;
  options.topics["rotor_speeds"] = "/rotor_speeds";
  ODMC_EXPECT_ERROR(Read(options), "has no topic /rotor_speeds for rotor_speeds");
}

// Little motion does not tell the frame; the header then does.
TEST_F(FlightBag, HoverKeepsItsVelocityFrame) {
  FlightLog log = Circles(0);
  for (OdometrySample& sample : log.odometry) {
    sample.p_WS *= 0.01;
    *sample.v_WS *= 0.01;
  }
  WriteFlightBag(log, File());
  ExpectSame(log, Read());
}

TEST_F(FlightBag, CsvAndBagGiveTheSameFlight) {
  FlightLog log = Circles(0);
  for (size_t i = 0; i < log.odometry.size(); ++i) {
    log.imu[i].stamp = log.battery[i].stamp = log.odometry[i].stamp;
    log.commands[i].stamp = log.rotors[i].stamp;  // a CSV has both in one table
  }
  WriteFlightBag(log, File());
  WriteFlightCsv(log, folder_.File("f.csv"));
  ExpectSame(ReadFlight(folder_.File("f.csv"), 4, PoseSource::kEkf, {}),
             ReadFlight(File(), 4, PoseSource::kEkf, {}));
  ODMC_EXPECT_ERROR(ReadFlight("f.txt", 4, PoseSource::kEkf, {}),
                    "f.txt: cannot be opened; a flight is a CSV file (.csv), ");
}

// ---- Messages of other sources -----------------------------------------------------------------

nav_msgs::Odometry OdometryMessage(const OdometrySample& sample, bool body_twist) {
  nav_msgs::Odometry m;
  m.header.stamp.fromNSec(static_cast<std::uint64_t>(sample.stamp));
  m.header.frame_id = "map";
  m.child_frame_id = "base_link";
  m.pose.pose.position.x = sample.p_WS.x();
  m.pose.pose.position.y = sample.p_WS.y();
  m.pose.pose.position.z = sample.p_WS.z();
  m.pose.pose.orientation.w = sample.q_WS.w();
  m.pose.pose.orientation.z = sample.q_WS.z();
  const Eigen::Vector3d v =
      body_twist ? Eigen::Vector3d(sample.q_WS.conjugate() * *sample.v_WS) : *sample.v_WS;
  m.twist.twist.linear.x = v.x();
  m.twist.twist.linear.y = v.y();
  m.twist.twist.linear.z = v.z();
  m.twist.twist.angular.z = 0.3;
  return m;
}

odmc::RotorSpeeds RotorMessage(Stamp stamp) {
  odmc::RotorSpeeds m;
  m.header.stamp.fromNSec(static_cast<std::uint64_t>(stamp));
  m.angular_velocity_rad_s = {1000.0, 1001.0, 1002.0, 1003.0};
  return m;
}

sensor_msgs::JointState JointMessage(Stamp stamp, double speed) {
  sensor_msgs::JointState m;
  m.header.stamp.fromNSec(static_cast<std::uint64_t>(stamp));
  m.velocity = {speed, -speed, speed, -speed};
  return m;
}

constexpr Stamp kStart = 5000000000;

template <typename Change>
void WriteOdometry(rosbag::Bag* bag, const std::string& topic, bool body_twist, Change change) {
  for (const OdometrySample& sample : Circles(kStart).odometry) {
    nav_msgs::Odometry m = OdometryMessage(sample, body_twist);
    change(&m);
    bag->write(topic, ros::Time(100.0), m);
  }
}

void WriteOdometry(rosbag::Bag* bag, const std::string& topic, bool body_twist = true) {
  WriteOdometry(bag, topic, body_twist, [](nav_msgs::Odometry*) {});
}

void WriteRotors(rosbag::Bag* bag, const std::string& topic) {
  for (int i = 0; i < 100; ++i) {
    bag->write(topic, ros::Time(100.0), RotorMessage(kStart + 10000000 * static_cast<Stamp>(i)));
  }
}

TEST_F(FlightBag, TwistFrameIsFound) {
  for (const bool body : {true, false}) {
    WriteBag([&](rosbag::Bag* bag) {
      WriteOdometry(bag, "/odometry", body);
      WriteRotors(bag, "/rotor_speeds");
    });
    const FlightLog log = Read();
    const FlightLog truth = Circles(kStart);
    for (size_t i = 0; i < log.odometry.size(); ++i) {
      EXPECT_LT((*log.odometry[i].v_WS - *truth.odometry[i].v_WS).norm(), 1e-12);
    }
    BagOptions options;
    options.twist_frame = body ? "world" : "body";  // wrong on purpose: it is taken as told
    EXPECT_GT((*Read(options).odometry[0].v_WS - *truth.odometry[0].v_WS).norm(), 0.5);
  }
  BagOptions options;
  options.twist_frame = "ned";
  ODMC_EXPECT_ERROR(Read(options), "twist_frame must be auto, body or world, not 'ned'");
}

TEST_F(FlightBag, TwistThatFitsNeitherFrameIsRefused) {
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/odometry", true,
                  [](nav_msgs::Odometry* m) { m->twist.twist.linear.x = 3.0; });
    WriteRotors(bag, "/rotor_speeds");
  });
  ODMC_EXPECT_ERROR(Read(), "/odometry: the twist fits neither frame");
  ODMC_EXPECT_ERROR(Read(), "in the body frame and by ");
}

TEST_F(FlightBag, TwistThatNobodyFilledIsNotUsed) {
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/odometry", true,
                  [](nav_msgs::Odometry* m) { m->twist.twist = geometry_msgs::Twist(); });
    WriteRotors(bag, "/rotor_speeds");
  });
  const FlightLog log = Read();
  EXPECT_FALSE(log.odometry[0].v_WS.has_value());
  EXPECT_FALSE(log.odometry[0].w_WS_S.has_value());
  EXPECT_EQ(log.warnings.size(), 2u);
}

TEST_F(FlightBag, JointStatesAreConverted) {
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/odometry");
    bag->write("/joint_states", ros::Time(100.0), JointMessage(kStart, 3000.0));
  });
  BagOptions options;
  EXPECT_EQ(Read().rotors.at(0).speed, Speeds(3000.0));
  options.rotor_speed_unit = "rpm";
  EXPECT_NEAR(Read(options).rotors.at(0).speed[1], 100.0 * M_PI, 1e-9);
  options.rotor_speed_unit = "erpm";
  options.pole_pairs = 6;
  EXPECT_NEAR(Read(options).rotors.at(0).speed[1], 100.0 * M_PI / 6.0, 1e-9);
  options.rotor_speed_unit = "hz";
  ODMC_EXPECT_ERROR(Read(options), "rotor_speed_unit must be rad_s, rpm or erpm, not 'hz'");
}

TEST_F(FlightBag, PosesServeWhereThereIsNoOdometry) {
  WriteBag([&](rosbag::Bag* bag) {
    for (const OdometrySample& sample : Circles(kStart).odometry) {
      const nav_msgs::Odometry odometry = OdometryMessage(sample, true);
      geometry_msgs::PoseStamped m;
      m.header = odometry.header;
      m.pose = odometry.pose.pose;
      bag->write("/vrpn/quad/pose", ros::Time(100.0), m);
    }
    WriteRotors(bag, "/rotor_speeds");
  });
  const FlightLog log = Read();
  EXPECT_EQ(log.odometry.size(), 300u);
  EXPECT_FALSE(log.odometry[0].v_WS.has_value());
}

TEST_F(FlightBag, TopicsAreFoundByTypeAndName) {
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/mavros/local_position/odom");
    WriteRotors(bag, "/quad/rotor_speeds");
    WriteRotors(bag, "/quad/rotor_speeds_cmd");
  });
  EXPECT_EQ(Read().odometry.size(), 300u);
}

TEST_F(FlightBag, SeveralCandidatesNeedATopicMap) {
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/a/odometry");
    WriteOdometry(bag, "/b/odometry");
    WriteRotors(bag, "/rotor_speeds");
  });
  ODMC_EXPECT_ERROR(Read(),
                    "several topics could be odometry: /a/odometry, /b/odometry; choose "
                    "with --topic odometry:=/a/odometry");
  BagOptions options;
  options.topics["odometry"] = "b/odometry";
  EXPECT_EQ(Read(options).odometry.size(), 300u);
  options.topics["odometry"] = "/c";
  ODMC_EXPECT_ERROR(Read(options), "has no topic /c for odometry; the bag has /a/odometry (nav_");
  options.topics["odometry"] = "/rotor_speeds";
  ODMC_EXPECT_ERROR(Read(options), "topic /rotor_speeds is a odmc/RotorSpeeds, but odometry must");
  options.topics = {{"odom", "/a/odometry"}};
  ODMC_EXPECT_ERROR(Read(options), "unknown topic role 'odom'");
}

TEST_F(FlightBag, MissingStreamsAreNamed) {
  WriteBag([&](rosbag::Bag* bag) { WriteOdometry(bag, "/odometry"); });
  ODMC_EXPECT_ERROR(Read(), "no rotor speeds");
  WriteBag([&](rosbag::Bag* bag) { WriteRotors(bag, "/rotor_speeds"); });
  ODMC_EXPECT_ERROR(Read(), "no odometry");
  WriteBag([&](rosbag::Bag*) {});
  ODMC_EXPECT_ERROR(Read(), "the bag is empty");
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/odometry");
    odmc::RotorSpeeds m = RotorMessage(kStart);
    m.angular_velocity_rad_s.pop_back();
    bag->write("/rotor_speeds", ros::Time(100.0), m);
  });
  ODMC_EXPECT_ERROR(Read(), "/rotor_speeds: has 3 speeds, the vehicle has 4 rotors");
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/odometry");
    odmc::MotorCommands m;
    m.header.stamp = ros::Time(5.0);
    m.throttle.resize(6);
    bag->write("/motor_commands", ros::Time(100.0), m);
  });
  ODMC_EXPECT_ERROR(Read(), "/motor_commands: has 6 commands, the vehicle has 4 rotors");
}

TEST_F(FlightBag, BadSamplesAreCounted) {
  WriteBag([&](rosbag::Bag* bag) {
    int i = 0;
    WriteOdometry(bag, "/odometry", true, [&](nav_msgs::Odometry* m) {
      if (++i == 50) m->pose.pose.position.x = std::nan("");
      if (i == 60) m->header.stamp = ros::Time(5, 0);
      if (i == 70) m->header.stamp = ros::Time();
      if (i == 80) m->pose.pose.orientation.w = 7.0;
    });
    WriteRotors(bag, "/rotor_speeds");
  });
  const FlightLog log = Read();
  EXPECT_EQ(log.odometry.size(), 296u);
  EXPECT_EQ(log.dropped, 4);
  EXPECT_EQ(log.warnings.size(), 4u);
}

TEST_F(FlightBag, DeadRotorIsNamed) {
  FlightLog log = Circles(kStart);
  for (RotorSample& sample : log.rotors) sample.speed[1] = 0.0;
  WriteFlightBag(log, File());
  const FlightLog back = Read();
  ASSERT_EQ(back.warnings.size(), 1u);
  EXPECT_TRUE(Contains(back.warnings[0], "rotor2 reads zero in 100 %"));
}

TEST_F(FlightBag, BrokenFilesAreRefusedInWords) {
  ODMC_EXPECT_ERROR(ReadFlightBag("/no/such.bag", 4, {}), "/no/such.bag: cannot be opened");
  ODMC_EXPECT_ERROR(ReadFlightBag("/tmp", 4, {}), "/tmp: cannot be opened");
  folder_.Write("f.bag", "");
  ODMC_EXPECT_ERROR(Read(), "f.bag: ");
  folder_.Write("f.bag", "t,px,py\n1,2,3\n");
  ODMC_EXPECT_ERROR(Read(), "f.bag: is not a bag");
}

TEST_F(FlightBag, TruncatedBagsAreRefusedInWords) {
  WriteFlightBag(Circles(kStart, 2000), File());
  const auto size = std::filesystem::file_size(File());
  for (const double share : {0.999, 0.9, 0.5, 0.1, 0.01}) {
    WriteFlightBag(Circles(kStart, 2000), File());
    std::filesystem::resize_file(File(),
                                 static_cast<std::uintmax_t>(share * static_cast<double>(size)));
    ODMC_EXPECT_ERROR(Read(), "truncated");
  }
}

// What a recorder leaves that was killed: messages, but no index yet.
TEST_F(FlightBag, BagsThatWereNeverClosedAreRefusedInWords) {
  rosbag::Bag bag(folder_.File("open.bag"), rosbag::bagmode::Write);
  WriteOdometry(&bag, "/odometry");
  bag.setChunkThreshold(1);  // writes the chunk out
  WriteRotors(&bag, "/rotor_speeds");
  std::filesystem::copy_file(folder_.File("open.bag"), File());
  bag.close();
  ODMC_EXPECT_ERROR(Read(), "has no index: recording was cut off");
}

// What a file system leaves after a power cut: the right length, but zeros.
TEST_F(FlightBag, BagsThatEndInZerosAreRefusedInWords) {
  for (const double share : {0.99, 0.5, 0.1}) {
    WriteFlightBag(Circles(kStart, 2000), File());
    const auto size = std::filesystem::file_size(File());
    std::filesystem::resize_file(File(),
                                 static_cast<std::uintmax_t>(share * static_cast<double>(size)));
    std::filesystem::resize_file(File(), size);
    ODMC_EXPECT_ERROR(Read(), "truncated");
  }
}

// ---- Damage ------------------------------------------------------------------------------------

std::string Content(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// One of: bits flipped, a huge number, a stretch of zeros, the end cut off.
std::string Damaged(std::string bag, std::mt19937* generator) {
  const auto below = [&](size_t n) { return (*generator)() % n; };
  const size_t at = below(bag.size() - 600);
  switch (below(4)) {
    case 0:
      for (size_t flips = 1 + below(20); flips > 0; --flips) {
        bag[below(bag.size())] ^= static_cast<char>(1 << below(8));
      }
      return bag;
    case 1:
      return bag.replace(at, 4, "\xff\xff\xff\x7f");
    case 2:
      return bag.replace(at, 512, std::string(512, '\0'));
    default:
      return bag.substr(0, at);
  }
}

// Half of the damage is done where the records' headers are thick: the list of chunks at the end.
TEST_F(FlightBag, DamageEndsInASentence) {
  std::mt19937 generator(11);
  int refused = 0;
  for (const auto compression : {rosbag::CompressionType::Uncompressed,
                                 rosbag::CompressionType::LZ4, rosbag::CompressionType::BZ2}) {
    WriteBag([&](rosbag::Bag* bag) {
      bag->setCompression(compression);
      bag->setChunkThreshold(20000);
      WriteOdometry(bag, "/odometry");
      WriteRotors(bag, "/rotor_speeds");
    });
    const std::string sound = Content(File());
    const size_t tail = sound.size() - 2000;
    for (int i = 0; i < 20; ++i) {
      const std::string bag = i % 2 == 0
                                  ? Damaged(sound, &generator)
                                  : sound.substr(0, tail) + Damaged(sound.substr(tail), &generator);
      folder_.Write("f.bag", bag);
      try {
        EXPECT_LE(Read().odometry.size(), 300u);
      } catch (const std::invalid_argument& e) {
        EXPECT_EQ(std::string(e.what()).rfind(File() + ": ", 0), 0u) << e.what();
        ++refused;
      }
    }
  }
  EXPECT_GE(refused, 40);
}

// The library would take the count as it finds it and lose messages without a word.
TEST_F(FlightBag, IndexThatDisagreesIsRefused) {
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/odometry");
    WriteRotors(bag, "/rotor_speeds");
  });
  std::string bag = Content(File());
  const size_t index = bag.find(std::string("count=\x2c\x01\0\0", 10));  // 300
  ASSERT_NE(index, std::string::npos);
  bag[index + 6] = 20;
  folder_.Write("f.bag", bag);
  ODMC_EXPECT_ERROR(Read(), "f.bag: is damaged or truncated: a chunk's index disagrees");
}

TEST_F(FlightBag, OneStampThatLeapsIsLeftOut) {
  WriteBag([&](rosbag::Bag* bag) {
    int i = 0;
    WriteOdometry(bag, "/odometry", true, [&](nav_msgs::Odometry* m) {
      if (++i == 50) m->header.stamp.sec += 1 << 20;
    });
    WriteRotors(bag, "/rotor_speeds");
  });
  const FlightLog log = Read();
  EXPECT_EQ(log.odometry.size(), 299u);
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_TRUE(Contains(log.warnings[0], "dropped 1 samples whose stamp leaps ahead"));
}

TEST_F(FlightBag, NamesOfTopicsArePrintable) {
  WriteBag([&](rosbag::Bag* bag) {
    WriteOdometry(bag, "/\x1b[2J/odometry", true,
                  [](nav_msgs::Odometry* m) { m->twist.twist = geometry_msgs::Twist(); });
    WriteRotors(bag, "/rotor_speeds");
  });
  const FlightLog log = Read();
  ASSERT_EQ(log.warnings.size(), 2u);
  EXPECT_TRUE(Contains(log.warnings[0], "/\\x1b[2J/odometry")) << log.warnings[0];
}

}  // namespace
}  // namespace odmc
