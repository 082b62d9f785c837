// What we write as an autopilot's log, our readers read back: to the log's own resolution.

#include <gtest/gtest.h>

#include <cmath>

#include "odmc/io/autopilot_log_writers.h"
#include "odmc/io/flight_reader.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr Stamp kStart = 1700000000123456000;  // a clock since 1970, whole microseconds

Vector3d PositionAt(double t) {
  return {std::sin(t), 2.0 + 0.3 * t, 1.5 + 0.2 * std::cos(2.0 * t)};
}
Vector3d VelocityAt(double t) { return {std::cos(t), 0.3, -0.4 * std::sin(2.0 * t)}; }
Vector3d RatesAt(double t) { return {0.8 * std::sin(3.0 * t), -0.5, 0.3 * std::cos(t)}; }
Vector3d ForceAt(double t) { return {0.4, -0.6 * std::sin(t), 9.8 + std::cos(4.0 * t)}; }
Eigen::Quaterniond AttitudeAt(double t) {
  return Eigen::AngleAxisd(0.5 + 0.7 * t, Vector3d::UnitZ()) *
         Eigen::AngleAxisd(0.3 * std::sin(t), Vector3d::UnitY()) *
         Eigen::AngleAxisd(0.2 * std::cos(2.0 * t), Vector3d::UnitX());
}
double SpeedAt(int rotor, double t) { return 800.0 + 50.0 * rotor + 40.0 * std::sin(5.0 * t); }
double ThrottleAt(int rotor, double t) { return 0.4 + 0.05 * rotor + 0.1 * std::sin(5.0 * t); }

/// Every stream at a rate of its own.
FlightLog MadeUpFlight(int num_rotors = 4) {
  FlightLog log;
  log.file = "made_up";
  const auto stamps = [](double rate_hz, auto use) {
    for (int i = 0; i < static_cast<int>(4.0 * rate_hz); ++i) {
      const double t = i / rate_hz;
      use(kStart + 1000 * static_cast<Stamp>(std::llround(1e6 * t)), t);
    }
  };
  stamps(100.0, [&](Stamp stamp, double t) {
    OdometrySample s;
    s.stamp = stamp;
    s.p_WS = PositionAt(t);
    s.q_WS = AttitudeAt(t);
    s.v_WS = VelocityAt(t);
    log.odometry.push_back(s);
  });
  stamps(500.0, [&](Stamp stamp, double t) { log.imu.push_back({stamp, RatesAt(t), ForceAt(t)}); });
  stamps(250.0, [&](Stamp stamp, double t) {
    RotorSample s{stamp, RotorVector(num_rotors)};
    for (int j = 0; j < num_rotors; ++j) s.speed[j] = SpeedAt(j, t);
    log.rotors.push_back(s);
  });
  stamps(200.0, [&](Stamp stamp, double t) {
    CommandSample s{stamp, RotorVector(num_rotors)};
    for (int j = 0; j < num_rotors; ++j) s.throttle[j] = ThrottleAt(j, t);
    log.commands.push_back(s);
  });
  stamps(50.0, [&](Stamp stamp, double t) { log.battery.push_back({stamp, 16.0 - 0.1 * t}); });
  return log;
}

/// Half a unit of each quantity in a log, and what interpolation adds.
struct Resolution {
  double position_m, attitude_rad, velocity_m_s, gyro_rad_s, force_m_s2, speed_rad_s, throttle,
      volt;
};

void ExpectSame(const FlightLog& read, const Resolution& r, int num_rotors = 4) {
  // The clock starts within the second from 1 s on; its fraction of a second is the flight's.
  const Stamp zero = 1123456000;
  ASSERT_FALSE(read.odometry.empty());
  for (const OdometrySample& s : read.odometry) {
    const double t = ToSeconds(s.stamp - zero);
    EXPECT_LT((s.p_WS - PositionAt(t)).norm(), r.position_m);
    EXPECT_LT(s.q_WS.angularDistance(AttitudeAt(t)), r.attitude_rad);
    ASSERT_TRUE(s.v_WS);
    EXPECT_LT((*s.v_WS - VelocityAt(t)).norm(), r.velocity_m_s);
  }
  for (const ImuSample& s : read.imu) {
    const double t = ToSeconds(s.stamp - zero);
    ASSERT_TRUE(s.gyro_I && s.specific_force_I);
    EXPECT_LT((*s.gyro_I - RatesAt(t)).norm(), r.gyro_rad_s);
    EXPECT_LT((*s.specific_force_I - ForceAt(t)).norm(), r.force_m_s2);
  }
  for (const RotorSample& s : read.rotors) {
    ASSERT_EQ(s.speed.size(), num_rotors);
    for (int j = 0; j < num_rotors; ++j) {
      EXPECT_NEAR(s.speed[j], SpeedAt(j, ToSeconds(s.stamp - zero)), r.speed_rad_s);
    }
  }
  for (const CommandSample& s : read.commands) {
    for (int j = 0; j < num_rotors; ++j) {
      EXPECT_NEAR(s.throttle[j], ThrottleAt(j, ToSeconds(s.stamp - zero)), r.throttle);
    }
  }
  for (const BatterySample& s : read.battery) {
    EXPECT_NEAR(s.voltage_V, 16.0 - 0.1 * ToSeconds(s.stamp - zero), r.volt);
  }
}

// Single precision, and whole rpm.
constexpr Resolution kULog = {2e-6, 1e-6, 1e-6, 1e-6, 3e-6, 0.0525, 1e-6, 2e-6};
// Single precision, and whole microseconds of pulse length.
constexpr Resolution kDataflash = {2e-6, 1e-6, 1e-6, 1e-6, 3e-6, 2e-4, 5.01e-4, 2e-6};
// mm, 1/8127, cm/s, 0.1 deg/s, 1/2048 g, rad/s, 1/1889, 10 mV; each of a norm of three axes, and
// what lines between samples are off the curves.
constexpr Resolution kBlackbox = {1e-3, 3e-4, 1e-2, 2e-3, 5e-3, 0.51, 3e-4, 5.1e-3};

class LogWriters : public ::testing::Test {
 protected:
  FlightLog Read(const std::string& name, FlightPart part = FlightPart::kWhole,
                 int num_rotors = 4) const {
    FlightReadOptions options;
    options.part = part;
    options.num_rotors = num_rotors;
    return FlightReaders::Core().Read(folder_.File(name), options);
  }
  testing_support::TemporaryFolder folder_;
};

TEST_F(LogWriters, ULogKeepsEveryStreamAtItsStamps) {
  WriteULog(MadeUpFlight(), folder_.File("a.ulg"));
  const FlightLog read = Read("a.ulg");
  EXPECT_EQ(read.odometry.size(), 400u);
  EXPECT_EQ(read.imu.size(), 2000u);
  EXPECT_EQ(read.rotors.size(), 1000u);
  EXPECT_EQ(read.commands.size(), 800u);
  EXPECT_EQ(read.battery.size(), 200u);
  ExpectSame(read, kULog);
}

TEST_F(LogWriters, DataflashKeepsEveryStreamAtItsStamps) {
  WriteDataflash(MadeUpFlight(), folder_.File("a.bin"));
  const FlightLog read = Read("a.bin");
  EXPECT_EQ(read.odometry.size(), 400u);
  EXPECT_EQ(read.imu.size(), 2000u);
  EXPECT_EQ(read.rotors.size(), 1000u);
  EXPECT_EQ(read.commands.size(), 800u);
  EXPECT_EQ(read.battery.size(), 200u);
  ExpectSame(read, kDataflash);
}

TEST_F(LogWriters, BlackboxHasAFramePerImuSample) {
  WriteBlackbox(MadeUpFlight(), folder_.File("a.bbl"));
  const FlightLog read = Read("a.bbl");
  // Frames end with the battery's last sample, 3.98 s on.
  EXPECT_EQ(read.odometry.size(), 1991u);
  EXPECT_EQ(read.rotors.size(), 1991u);
  ExpectSame(read, kBlackbox);
}

TEST_F(LogWriters, SixRotors) {
  WriteULog(MadeUpFlight(6), folder_.File("a.ulg"));
  ExpectSame(Read("a.ulg", FlightPart::kWhole, 6), kULog, 6);
  WriteDataflash(MadeUpFlight(6), folder_.File("a.bin"));
  ExpectSame(Read("a.bin", FlightPart::kWhole, 6), kDataflash, 6);
  WriteBlackbox(MadeUpFlight(6), folder_.File("a.bbl"));
  ExpectSame(Read("a.bbl", FlightPart::kWhole, 6), kBlackbox, 6);
}

TEST_F(LogWriters, AFlightWithoutPosesIsReadWhereNoneAreWanted) {
  FlightLog log = MadeUpFlight();
  log.odometry.clear();
  WriteBlackbox(log, folder_.File("a.bbl"));
  WriteULog(log, folder_.File("a.ulg"));
  WriteDataflash(log, folder_.File("a.bin"));
  for (const char* name : {"a.bbl", "a.ulg", "a.bin"}) {
    ODMC_EXPECT_ERROR(Read(name), "no po");
    const FlightLog read = Read(name, FlightPart::kOnboard);
    EXPECT_TRUE(read.odometry.empty()) << name;
    EXPECT_GT(read.imu.size(), 1900u) << name;
    EXPECT_GT(read.rotors.size(), 900u) << name;
    EXPECT_NEAR(read.rotors[300].speed[2],
                SpeedAt(2, ToSeconds(read.rotors[300].stamp - 1123456000)),
                0.8)
        << name;  // Betaflight's unit is 1.5 rad/s
  }
}

TEST_F(LogWriters, PosesAloneAreReadFromAnyLog) {
  WriteULog(MadeUpFlight(), folder_.File("a.ulg"));
  WriteDataflash(MadeUpFlight(), folder_.File("a.bin"));
  WriteBlackbox(MadeUpFlight(), folder_.File("a.bbl"));
  for (const char* name : {"a.ulg", "a.bin", "a.bbl"}) {
    const FlightLog read = Read(name, FlightPart::kPoses, 6);  // whatever the rotors are
    EXPECT_GE(read.odometry.size(), 400u) << name;
    EXPECT_TRUE(read.imu.empty() && read.rotors.empty() && read.commands.empty()) << name;
  }
}

TEST_F(LogWriters, BodyRatesStandInForAMissingGyro) {
  FlightLog log = MadeUpFlight();
  log.imu.clear();
  for (OdometrySample& s : log.odometry) s.w_WS_S = RatesAt(ToSeconds(s.stamp - kStart));
  WriteDataflash(log, folder_.File("a.bin"));
  const FlightLog read = Read("a.bin");
  ASSERT_EQ(read.imu.size(), 400u);
  EXPECT_FALSE(read.imu.front().specific_force_I);
  for (const ImuSample& s : read.imu) {
    ASSERT_TRUE(s.gyro_I);
    EXPECT_LT((*s.gyro_I - RatesAt(ToSeconds(s.stamp - 1123456000))).norm(), 1e-6);
  }
  WriteULog(log, folder_.File("a.ulg"));  // has a place for them
  const FlightLog px4 = Read("a.ulg");
  EXPECT_TRUE(px4.imu.empty());
  ASSERT_TRUE(px4.odometry[7].w_WS_S);
  EXPECT_LT((*px4.odometry[7].w_WS_S - RatesAt(0.07)).norm(), 1e-6);
}

TEST_F(LogWriters, RefuseWhatCannotBeWritten) {
  FlightLog log = MadeUpFlight();
  log.rotors.clear();
  log.commands.clear();
  ODMC_EXPECT_ERROR(WriteULog(log, folder_.File("a.ulg")), "neither rotor speeds nor commands");
  FlightLog apart = MadeUpFlight();
  for (BatterySample& s : apart.battery) s.stamp += 100000000000;
  ODMC_EXPECT_ERROR(WriteBlackbox(apart, folder_.File("a.bbl")), "nowhere at the same time");
  EXPECT_THROW(WriteULog(MadeUpFlight(), "/no/such/folder/a.ulg"), std::runtime_error);
}

}  // namespace
}  // namespace odmc
