#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <random>

#include "odmc/io/flight_csv.h"
#include "odmc/text/number_text.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using testing_support::Contains;

const char kHeader[] = "t,px,py,pz,qw,qx,qy,qz,rotor1,rotor2,rotor3,rotor4";

/// One row of kHeader at `t`.
std::string Row(double t, const std::string& rotors = "1000,1001,1002,1003") {
  return "\n" + FormatNumber(t) + ",1,2,3,1,0,0,0," + rotors;
}

std::string Rows(int count, const std::string& rotors = "1000,1001,1002,1003") {
  std::string text;
  for (int i = 0; i < count; ++i) text += Row(0.01 * i, rotors);
  return text;
}

class FlightCsv : public ::testing::Test {
 protected:
  FlightLog Read(const std::string& text, PoseSource pose = PoseSource::kEkf) {
    return ReadFlightCsv(folder_.Write("f.csv", text), 4, pose);
  }
  testing_support::TemporaryFolder folder_;
};

int CountWarnings(const FlightLog& log, const std::string& part) {
  int count = 0;
  for (const std::string& warning : log.warnings) count += Contains(warning, part) ? 1 : 0;
  return count;
}

TEST_F(FlightCsv, ColumnsComeInAnyOrder) {
  const FlightLog log = Read(
      "vbat,rotor2,rotor1,rotor4,rotor3,ax,ay,az,wx,wy,wz,vx,vy,vz,qx,qy,qz,qw,pz,py,px,t\n"
      "16,2,1,4,3,5,6,7,8,9,10,11,12,13,0,0,0.6,0.8,16,15,14,-0.5\n");
  ASSERT_EQ(log.odometry.size(), 1u);
  const OdometrySample& odometry = log.odometry[0];
  EXPECT_EQ(odometry.stamp, -500000000);
  EXPECT_EQ(odometry.p_WS, Eigen::Vector3d(14, 15, 16));
  EXPECT_NEAR(odometry.q_WS.z(), 0.6, 1e-15);
  EXPECT_EQ(*odometry.v_WS, Eigen::Vector3d(11, 12, 13));
  EXPECT_EQ(*odometry.w_WS_S, Eigen::Vector3d(8, 9, 10));
  EXPECT_EQ(*log.imu.at(0).specific_force_I, Eigen::Vector3d(5, 6, 7));
  EXPECT_FALSE(log.imu[0].gyro_I.has_value());
  EXPECT_EQ(log.rotors.at(0).speed, Eigen::Vector4d(1, 2, 3, 4));
  EXPECT_EQ(log.battery.at(0).voltage_V, 16.0);
  EXPECT_EQ(log.file, "f.csv");
  EXPECT_TRUE(log.warnings.empty());
}

TEST_F(FlightCsv, RawGyroGoesToTheImu) {
  const FlightLog log =
      Read(std::string(kHeader) + ",gx,gy,gz,ax,ay,az" + Row(0.0) + ",1,2,3,4,5,6");
  EXPECT_EQ(*log.imu.at(0).gyro_I, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(*log.imu.at(0).specific_force_I, Eigen::Vector3d(4, 5, 6));
  EXPECT_FALSE(log.odometry[0].w_WS_S.has_value());
  EXPECT_FALSE(log.odometry[0].v_WS.has_value());
}

TEST_F(FlightCsv, ToleratesOtherWritersHabits) {
  const FlightLog log = Read(
      "\xEF\xBB\xBF\"t\", \"px\", py ,pz,qw,qx,qy,qz,rotor1,rotor2,rotor3,rotor4\r\n"
      " 0.0, 1 ,+2,3e0,1,0,0,0, 1,2,3,4\r\n\r\n"
      "0.01,\"1\",2,3,1,0,0,0,1,2,3,4");
  ASSERT_EQ(log.odometry.size(), 2u);
  EXPECT_EQ(log.odometry[0].p_WS, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(log.dropped, 0);
  EXPECT_TRUE(log.warnings.empty());
}

TEST_F(FlightCsv, StampsSince1970KeepEveryNanosecond) {
  const FlightLog log = Read(std::string(kHeader) +
                             "\n1700000000.123456789,1,2,3,1,0,0,0,1,2,3,4"
                             "\n1700000000.133456788,1,2,3,1,0,0,0,1,2,3,4");
  EXPECT_EQ(log.odometry[0].stamp, 1700000000123456789);
  EXPECT_EQ(log.odometry[1].stamp, 1700000000133456788);
}

TEST_F(FlightCsv, CommandsDeclareTheirUnitByTheirNames) {
  for (const auto& [names, cells] : std::vector<std::pair<std::string, std::string>>{
           {",pwm1_us,pwm2_us,pwm3_us,pwm4_us", "1000,1250,1500,2000"},
           {",throttle1,throttle2,throttle3,throttle4", "0,0.25,0.5,1"},
           {",pwm1,pwm2,pwm3,pwm4", "0,16383.75,32767.5,65535"}}) {
    const std::string rotors = "1000,1001,1002,1003," + cells;
    const FlightLog log = Read(std::string(kHeader) + names + Row(0.0, rotors) + Row(0.1, rotors));
    ASSERT_EQ(log.commands.size(), 2u) << names;
    EXPECT_TRUE(log.commands[1].throttle.isApprox(RotorVector{{0.0, 0.25, 0.5, 1.0}}, 1e-12));
    EXPECT_TRUE(log.warnings.empty());
  }
}

TEST_F(FlightCsv, CommandsMayStandInForRotorSpeeds) {
  const std::string head = "t,px,py,pz,qw,qx,qy,qz,throttle1,throttle2,throttle3,throttle4";
  const FlightLog log = Read(head + Row(0.0, "0.1,0.2,0.3,0.4") + Row(0.1, "0.1,0.2,0.3,0.4"));
  EXPECT_TRUE(log.rotors.empty());
  EXPECT_EQ(log.commands.size(), 2u);
}

TEST_F(FlightCsv, UnknownColumnsAreNamedOnce) {
  const FlightLog log = Read(std::string(kHeader) + ",pwm1,count1,t_arrival" + Row(0.0) + ",x,,0" +
                             Row(0.01) + ",,,");
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_TRUE(Contains(log.warnings[0], "unknown columns ignored: pwm1, count1, t_arrival"));
  EXPECT_EQ(log.dropped, 0);
}

TEST_F(FlightCsv, EmptyFilesAreRefused) {
  ODMC_EXPECT_ERROR(Read(""), "f.csv: is empty");
  ODMC_EXPECT_ERROR(Read("\n\r\n "), "f.csv: is empty");
  ODMC_EXPECT_ERROR(Read(kHeader), "f.csv: has a header but no usable row");
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + "\n"), "no usable row");
  ODMC_EXPECT_ERROR(ReadFlightCsv("/no/such.csv", 4, PoseSource::kEkf), "cannot be opened");
  ODMC_EXPECT_ERROR(ReadFlightCsv("/tmp", 4, PoseSource::kEkf), "/tmp: ");
}

TEST_F(FlightCsv, MissingColumnsAreNamed) {
  ODMC_EXPECT_ERROR(Read("time,px\n0,1\n"), "column t is missing; found are: time, px");
  ODMC_EXPECT_ERROR(Read("t,px,pz,qw,qx,qy,qz\n0,1,2,1,0,0,0\n"), "column py is missing");
  ODMC_EXPECT_ERROR(Read("t,px,py,pz,qw,qx\n0,1,2,3,1,0\n"), "columns qy, qz are missing");
  ODMC_EXPECT_ERROR(Read("t,px,py,pz,qw,qx,qy,qz,rotor1,rotor2,rotor3\n0,1,2,3,1,0,0,0,1,2,3\n"),
                    "column rotor4 is missing");
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + ",vx,vz" + Row(0.0) + ",1,2"), "column vy is miss");
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + ",rotor5" + Row(0.0) + ",1"),
                    "has a column rotor5");
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + ",px" + Row(0.0) + ",1"),
                    "column px is there twice");
  ODMC_EXPECT_ERROR(Read("t;px;py\n0;1;2\n"), "must be separated by commas");
}

TEST_F(FlightCsv, UnreadableNumbersNameLineAndColumn) {
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + Row(0.0) + "\n0.01,1,two,3,1,0,0,0,1,2,3,4"),
                    "f.csv:3: column py: 'two' is not a number");
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + Row(0.0) + "\n0.01,1,2,3,1,0,0,0,1,2,3.4.5,4"),
                    "f.csv:3: column rotor3: '3.4.5'");
}

TEST_F(FlightCsv, RowsThatStepBackAreCounted) {
  const FlightLog log =
      Read(std::string(kHeader) + Row(0.0) + Row(0.01) + Row(0.005) + Row(0.01) + Row(0.02));
  EXPECT_EQ(log.odometry.size(), 3u);
  EXPECT_EQ(log.rotors.size(), 3u);
  EXPECT_EQ(log.dropped, 2);
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_TRUE(
      Contains(log.warnings[0], "dropped 2 rows whose t steps back or repeats (first: line 4"));
}

TEST_F(FlightCsv, MostlyBackwardFilesAreRefused) {
  std::string rows;
  for (int i = 0; i < 20; ++i) rows += Row(1.0 - 0.01 * i);
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + rows),
                    "column t steps back or repeats in 19 of 20");
}

TEST_F(FlightCsv, MillisecondsAreNotSeconds) {
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + Row(0.0) + Row(10.0) + Row(20.0) + Row(30.0)),
                    "column t steps by 10 s; is it in seconds?");
}

TEST_F(FlightCsv, OptionalCellsThatAreNotFiniteDropTheirSampleOnly) {
  const FlightLog log =
      Read(std::string(kHeader) + ",ax,ay,az,vbat,vx,vy,vz" + Row(0.0) + ",1,2,3,16,1,1,1" +
           Row(0.01, "1,,3,4") + ",1,nan,3,,1,1,inf" + Row(0.02) + ",1,2,3,16,1,1,1");
  EXPECT_EQ(log.odometry.size(), 3u);
  EXPECT_FALSE(log.odometry[1].v_WS.has_value());
  EXPECT_TRUE(log.odometry[2].v_WS.has_value());
  EXPECT_EQ(log.rotors.size(), 2u);
  EXPECT_EQ(log.imu.size(), 2u);
  EXPECT_EQ(log.battery.size(), 2u);
  EXPECT_EQ(log.dropped, 4);
  EXPECT_EQ(log.warnings.size(), 4u);
  EXPECT_EQ(CountWarnings(log, "first: line 3"), 4);
}

TEST_F(FlightCsv, RowsWithoutAPoseAreDroppedWhole) {
  const FlightLog log = Read(std::string(kHeader) + Row(0.0) + "\n0.01,nan,2,3,1,0,0,0,1,2,3,4" +
                             "\n,1,2,3,1,0,0,0,1,2,3,4\n0.02,1,2,3,1,0,0,0,1,2" + Row(0.03));
  EXPECT_EQ(log.odometry.size(), 2u);
  EXPECT_EQ(log.rotors.size(), 2u);
  EXPECT_EQ(log.dropped, 3);
}

TEST_F(FlightCsv, NothingButNanIsRefused) {
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + "\n0,nan,2,3,1,0,0,0,1,2,3,4"),
                    "no row has a finite pose");
  ODMC_EXPECT_ERROR(Read(std::string(kHeader) + Row(0.0, "nan,1,2,3")), "no usable rotor speeds");
}

TEST_F(FlightCsv, QuaternionsBecomeUnitAndContinuous) {
  const FlightLog log = Read(
      "t,px,py,pz,qw,qx,qy,qz,rotor1,rotor2,rotor3,rotor4\n"
      "0.00,0,0,0,0.808,0,0,0.606,1,1,1,1\n"
      "0.01,0,0,0,-0.8,0,0,-0.6,1,1,1,1\n"
      "0.02,0,0,0,0.8,0,0,0.9,1,1,1,1\n"
      "0.03,0,0,0,0.8,0,0,0.6,1,1,1,1\n");
  ASSERT_EQ(log.odometry.size(), 3u);
  for (const OdometrySample& sample : log.odometry) {
    EXPECT_NEAR(sample.q_WS.w(), 0.8, 1e-12);
    EXPECT_NEAR(sample.q_WS.norm(), 1.0, 1e-15);
  }
  EXPECT_EQ(CountWarnings(log, "dropped 1 samples whose quaternion is not unit"), 1);
  ODMC_EXPECT_ERROR(
      Read(std::string(kHeader) + "\n0,1,2,3,1,1,0,0,1,2,3,4\n0.01,1,2,3,0,0,0,0,1,2,3,4"),
      "f.csv: the quaternions are not unit: 2 of 2");
}

TEST_F(FlightCsv, DeadRotorIsNamedWithItsShare) {
  const FlightLog log = Read(std::string(kHeader) + Rows(50) + [] {
    std::string rows;
    for (int i = 50; i < 100; ++i) rows += Row(0.01 * i, "990,1001,0,1003");
    return rows;
  }());
  EXPECT_EQ(CountWarnings(log, "rotor3 reads zero in 50 %"), 1);
  EXPECT_EQ(log.warnings.size(), 1u);
}

TEST_F(FlightCsv, StuckRotorIsNamed) {
  std::string rows;
  for (int i = 0; i < 200; ++i) {
    const std::string speed = std::to_string(1000 + i % 7);
    rows += Row(0.01 * i, speed + ",777," + speed + "," + speed);
  }
  const FlightLog log = Read(std::string(kHeader) + rows);
  EXPECT_EQ(CountWarnings(log, "rotor2 is stuck at one value in 100 %"), 1);
  EXPECT_EQ(log.warnings.size(), 1u);
}

TEST_F(FlightCsv, RotorsAtRestAreNotDead) {
  EXPECT_TRUE(Read(std::string(kHeader) + Rows(100, "0,0,0,0")).warnings.empty());
  EXPECT_TRUE(Read(std::string(kHeader) + Rows(100, "500,500,500,500")).warnings.empty());
}

TEST_F(FlightCsv, NegativeSpeedsKeepTheirMagnitude) {
  const FlightLog log = Read(std::string(kHeader) + Row(0.0, "1000,-1000,1000,-1000"));
  EXPECT_EQ(log.rotors[0].speed, Eigen::Vector4d::Constant(1000.0));
  EXPECT_EQ(CountWarnings(log, "negative rotor speeds"), 1);
}

TEST_F(FlightCsv, RotorRmsStandsInForSingleRotors) {
  const FlightLog log = Read("t,px,py,pz,qw,qx,qy,qz,rotor_rms\n0,1,2,3,1,0,0,0,1100\n");
  EXPECT_TRUE(log.rotor_rms_only);
  EXPECT_EQ(log.rotors[0].speed, Eigen::Vector4d::Constant(1100.0));
}

TEST_F(FlightCsv, RotorSiblingReplacesTheColumns) {
  folder_.Write("f_rotor.csv",
                "t,rotor1,rotor2,rotor3,rotor4,count1\n0.002,1,2,3,4,9\n0.004,1,2,3,4,9");
  const FlightLog log = Read(std::string(kHeader) + Rows(5));
  ASSERT_EQ(log.rotors.size(), 2u);
  EXPECT_EQ(log.rotors[0].stamp, 2000000);
  EXPECT_EQ(CountWarnings(log, "f_rotor.csv: unknown columns ignored: count1"), 1);
}

TEST_F(FlightCsv, MocapSiblingReplacesPoseAndKeepsRates) {
  const std::string text =
      std::string(kHeader) + ",vx,vy,vz,wx,wy,wz,ax,ay,az" + Row(0.0) + ",1,1,1,4,5,6,7,8,9";
  ODMC_EXPECT_ERROR(Read(text, PoseSource::kMocap), "f_mocap.csv: cannot be opened");
  folder_.Write("f_mocap.csv",
                "t,px,py,pz,qw,qx,qy,qz\n-0.001,7,8,9,1,0,0,0\n0.01,7,8,9,1,0,0,0\n");
  const FlightLog log = Read(text, PoseSource::kMocap);
  ASSERT_EQ(log.odometry.size(), 2u);
  EXPECT_EQ(log.odometry[0].p_WS, Eigen::Vector3d(7, 8, 9));
  EXPECT_FALSE(log.odometry[0].v_WS.has_value());
  EXPECT_FALSE(log.odometry[0].w_WS_S.has_value());
  ASSERT_EQ(log.imu.size(), 1u);
  EXPECT_EQ(*log.imu[0].gyro_I, Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(*log.imu[0].specific_force_I, Eigen::Vector3d(7, 8, 9));
  EXPECT_EQ(Read(text).odometry.size(), 1u);
}

/// A flight with noise in every digit; rotors on their own stamps if `own_stamps`.
FlightLog RandomFlight(int count, bool own_stamps) {
  std::mt19937 generator(3);
  std::normal_distribution<double> noise;
  const auto vector = [&] {
    return Eigen::Vector3d(noise(generator), noise(generator), noise(generator));
  };
  FlightLog log;
  for (int i = 0; i < count; ++i) {
    const Stamp stamp = 2500001 * static_cast<Stamp>(i) - 7;
    OdometrySample odometry;
    odometry.stamp = stamp;
    odometry.p_WS = vector();
    odometry.q_WS = Eigen::Quaterniond(1.0, 0.1 * noise(generator), 0.1, 0.2).normalized();
    if (i % 5 != 0) odometry.v_WS = vector();
    odometry.w_WS_S = vector();
    log.odometry.push_back(odometry);
    log.imu.push_back({stamp, vector(), vector()});
    RotorVector speed(4);
    speed << 1000.0 + noise(generator), 1000.0 + noise(generator), 1e-6, 900.0 + noise(generator);
    speed[2] = 950.0 + noise(generator);
    log.rotors.push_back({stamp + (own_stamps ? 1000 : 0), speed});
    log.battery.push_back({stamp, 16.0 + 0.1 * noise(generator)});
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
  EXPECT_EQ(a.rotor_rms_only, b.rotor_rms_only);
}

TEST_F(FlightCsv, WrittenFlightsReadBackBitEqual) {
  for (const bool own_stamps : {true, false}) {
    const FlightLog log = RandomFlight(200, own_stamps);
    WriteFlightCsv(log, folder_.File("w.csv"));
    EXPECT_EQ(std::filesystem::exists(folder_.File("w_rotor.csv")), own_stamps);
    ExpectSame(log, ReadFlightCsv(folder_.File("w.csv"), 4, PoseSource::kEkf));
  }
}

TEST_F(FlightCsv, WrittenRmsReadsBack) {
  FlightLog log = RandomFlight(10, false);
  log.rotor_rms_only = true;
  for (RotorSample& sample : log.rotors) sample.speed.setConstant(1100.5);
  WriteFlightCsv(log, folder_.File("w.csv"));
  ExpectSame(log, ReadFlightCsv(folder_.File("w.csv"), 4, PoseSource::kEkf));
}

TEST_F(FlightCsv, ImuWithOtherStampsIsInterpolated) {
  FlightLog log = RandomFlight(3, false);
  log.imu.clear();
  for (const Stamp stamp : {Stamp{0}, Stamp{5000000}}) {
    const double t = ToSeconds(stamp);
    log.imu.push_back({stamp, std::nullopt, Eigen::Vector3d(t, 2.0 * t, 1.0)});
  }
  WriteFlightCsv(log, folder_.File("w.csv"));
  const FlightLog back = ReadFlightCsv(folder_.File("w.csv"), 4, PoseSource::kEkf);
  ASSERT_EQ(back.imu.size(), 2u);  // the odometry's first stamp is before the IMU
  EXPECT_NEAR(back.imu[0].specific_force_I->x(), ToSeconds(back.imu[0].stamp), 1e-12);
}

TEST_F(FlightCsv, SixMegabytesTakeWellUnderASecond) {
  FlightLog log = RandomFlight(20000, false);
  WriteFlightCsv(log, folder_.File("w.csv"));
  ASSERT_GT(std::filesystem::file_size(folder_.File("w.csv")), 6000000u);
  const auto start = std::chrono::steady_clock::now();
  ReadFlightCsv(folder_.File("w.csv"), 4, PoseSource::kEkf);
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
  std::printf("%.3f s\n", elapsed.count());
  EXPECT_LT(elapsed.count(), 5.0);  // a few tenths of a second on an idle machine
}

}  // namespace
}  // namespace odmc
