#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "odmc/io/autopilot_logs.h"
#include "odmc/io/flight_reader.h"
#include "support/error_text.h"
#include "support/made_up_log.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using namespace testing_support;

std::string Padded(const std::string& text, size_t size) {
  return text + std::string(size - text.size(), '\0');
}

/// Writes a dataflash log, definitions first, as ArduPilot's logger does.
class DataflashWriter {
 public:
  DataflashWriter() {
    Format("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 128);
    Format("MULT", "Qbd", "TimeUS,Id,Mult", 2);
    Format("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", 3);
    for (const auto& [id, factor] : std::map<char, double>{
             {'-', 0.0}, {'?', 1.0}, {'0', 1.0}, {'B', 1e-2}, {'C', 1e-3}, {'F', 1e-6}}) {
      Message(2, Raw<std::uint64_t>(0) + id + Raw(factor));
    }
  }
  void Message(int type, const std::string& body) {
    text_ += std::string("\xa3\x95", 2) + static_cast<char>(type) + body;
  }
  void Format(const std::string& name, const std::string& letters, const std::string& labels,
              int type) {
    static const std::map<char, int> sizes = {{'b', 1}, {'B', 1}, {'H', 2}, {'c', 2},  {'C', 2},
                                              {'f', 4}, {'i', 4}, {'I', 4}, {'e', 4},  {'L', 4},
                                              {'n', 4}, {'Q', 8}, {'d', 8}, {'N', 16}, {'Z', 64}};
    int length = 3;
    for (const char letter : letters) length += sizes.at(letter);
    Message(128, std::string(1, static_cast<char>(type)) + static_cast<char>(length) +
                     Padded(name, 4) + Padded(letters, 16) + Padded(labels, 64));
  }
  void Units(int type, const std::string& units, const std::string& factors) {
    Message(3, Raw<std::uint64_t>(0) + static_cast<char>(type) + Padded(units, 16) +
                   Padded(factors, 16));
  }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

struct Choice {
  bool filter = true, quaternions = true, global = false, esc = true;
  bool old_esc = false;  ///< RPM as "e", hundredths
  int esc_step_ms = 10, pose_step_ms = 10;
};

void Define(const Choice& choice, DataflashWriter* writer) {
  writer->Format("PARM", "QNff", "TimeUS,Name,Value,Default", 10);
  writer->Format("XKF1", "QBccCfffffffccce",
                 "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH", 11);
  writer->Format("XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4", 12);
  writer->Format("ATT", "QccccCCCCB",
                 "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF", 13);
  writer->Format("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", 14);
  writer->Format("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", 15);
  writer->Format("ESC", choice.old_esc ? "QBeCC" : "QBffffcfcf",
                 choice.old_esc ? "TimeUS,Instance,RPM,Volt,Curr"
                                : "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err",
                 16);
  writer->Format("RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4", 17);
  writer->Format("BAT", "QBH", "TimeUS,Inst,Volt", 18);
  writer->Units(16, "s#qqvAOaO%", choice.old_esc ? "F-BBB" : "F-00--BCB-");
  writer->Units(18, "s#v", "F-C");  // millivolts
  writer->Message(10, Raw<std::uint64_t>(1) + Padded("SERVO_BLH_POLES", 16) + Floats({14, 14}));
}

void WritePose(const Choice& choice, std::uint64_t now, DataflashWriter* writer) {
  const double t = 1e-6 * static_cast<double>(now);
  const Eigen::Vector3d p = PositionNed(t), v = VelocityNed(t), a = 5729.577951 * Angles(t);
  const Eigen::Quaterniond q = AttitudeNed(t);
  const auto c = [](double value) { return Raw(static_cast<std::int16_t>(std::lround(value))); };
  for (int core = 0; choice.filter && core < 2; ++core) {  // the second one is elsewhere
    writer->Message(11, Raw(now) + char(core) + c(a.x()) + c(a.y()) + c(a.z()) +
                            Floats({v.x(), v.y(), v.z(), 0.0, p.x() + 5.0 * core, p.y(), p.z()}) +
                            c(0) + c(0) + c(0) + Raw<std::int32_t>(0));
    if (choice.quaternions) {
      writer->Message(12, Raw(now) + char(core) + Floats({q.w(), q.x(), q.y(), q.z()}));
    }
  }
  writer->Message(
      13, Raw(now) + c(0) + c(a.x()) + c(0) + c(a.y()) + c(0) + c(a.z()) + c(0) + c(0) + char(3));
  if (choice.global) {
    const auto degrees = [](double metres) {
      return Raw(
          static_cast<std::int32_t>(std::lround(1e7 * (10.0 + metres / 6378137.0 * 180.0 / M_PI))));
    };
    writer->Message(14, Raw(now) + degrees(p.x()) + degrees(p.y() / std::cos(10.0 * M_PI / 180.0)) +
                            Floats({100.0 - p.z(), 0.0, 0.0}));
  }
}

std::string MadeUpLog(const Choice& choice = {}) {
  DataflashWriter writer;
  Define(choice, &writer);
  for (int ms = 0; ms < 2000; ++ms) {
    const std::uint64_t now = 10000000 + 1000 * static_cast<std::uint64_t>(ms);
    if (ms % choice.pose_step_ms == 0) WritePose(choice, now, &writer);
    if (ms % 5 == 1) {
      writer.Message(15, Raw(now) + char(0) + Floats({0.01, 0.02, 0.03, 0.5, 0.25, -9.5}));
    }
    for (int j = 0; choice.esc && j < 4; ++j) {  // each a while after the one before
      if (ms % choice.esc_step_ms != 2 * j) continue;
      const double rpm = Rpm(j, 1e-6 * static_cast<double>(now));
      writer.Message(16,
                     Raw(now) + static_cast<char>(j) +
                         (choice.old_esc ? Raw(static_cast<std::int32_t>(std::lround(100 * rpm))) +
                                               std::string(4, '\0')
                                         : Floats({rpm, rpm, 16.0, 1.0}) + std::string(12, '\0')));
    }
    if (ms % 10 == 4) {
      writer.Message(17, Raw(now) + Raw<std::uint16_t>(1500) + Raw<std::uint16_t>(1600) +
                             Raw<std::uint16_t>(1700) + Raw<std::uint16_t>(1800));
    }
    if (ms % 100 == 0) writer.Message(18, Raw(now) + char(0) + Raw<std::uint16_t>(15500));
  }
  return writer.text();
}

class Dataflash : public ::testing::Test {
 protected:
  FlightLog Read(const std::string& text, FlightReadOptions options = {}) const {
    return ReadDataflash(folder_.Write("flight.bin", text), options);
  }
  TemporaryFolder folder_;
};

TEST_F(Dataflash, GivesTheFlightInOurFramesAndUnits) {
  const FlightLog log = Read(MadeUpLog());
  ASSERT_EQ(log.odometry.size(), 200u);
  for (const OdometrySample& pose : log.odometry) {
    const double t = ToSeconds(pose.stamp);
    EXPECT_LT((pose.p_WS - Enu(PositionNed(t))).norm(), 1e-5);
    EXPECT_LT((*pose.v_WS - Enu(VelocityNed(t))).norm(), 1e-5);
    EXPECT_LT(AttitudeError(pose.q_WS, ToSeconds(pose.stamp)), 1e-5);
  }
  ASSERT_EQ(log.imu.size(), 400u);
  EXPECT_LT((*log.imu[0].gyro_I - Eigen::Vector3d(0.01, -0.02, -0.03)).norm(), 1e-6);
  EXPECT_LT((*log.imu[0].specific_force_I - Eigen::Vector3d(0.5, -0.25, 9.5)).norm(), 1e-6);
  EXPECT_EQ(log.command_unit, CommandUnit::kMicroseconds);
  EXPECT_NEAR(log.commands[0].throttle[2], 0.7, 1e-6);
  EXPECT_NEAR(log.battery[0].voltage_V, 15.5, 1e-9);
  EXPECT_EQ(log.dropped, 0);
  EXPECT_TRUE(Contains(log.warnings.back(),
                       "flight.bin: read pose 100 Hz, IMU 200 Hz, rotor speeds 100 Hz, commands "
                       "100 Hz, battery voltage 10 Hz"))
      << log.warnings.back();
}

TEST_F(Dataflash, RotorsOfEscsThatAnswerInTurnAreOnOneClock) {
  for (const bool old_esc : {false, true}) {
    Choice choice;
    choice.old_esc = old_esc;
    const FlightLog log = Read(MadeUpLog(choice));
    ASSERT_GT(log.rotors.size(), 195u);
    for (const RotorSample& sample : log.rotors) {
      for (int j = 0; j < 4; ++j) {
        ASSERT_NEAR(sample.speed[j], Rpm(j, ToSeconds(sample.stamp)) * M_PI / 30.0, 0.05);
      }
    }
  }
}

TEST_F(Dataflash, AnglesServeWhereThereIsNoQuaternion) {
  Choice choice;
  choice.quaternions = false;
  const FlightLog log = Read(MadeUpLog(choice));
  ASSERT_EQ(log.odometry.size(), 200u);
  for (const OdometrySample& pose : log.odometry)
    EXPECT_LT(AttitudeError(pose.q_WS, ToSeconds(pose.stamp)), 2e-4);  // of 0.01 deg
}

TEST_F(Dataflash, GlobalPositionServesWhereThereIsNoFilter) {
  Choice choice;
  choice.filter = false;
  choice.global = true;
  const FlightLog log = Read(MadeUpLog(choice));
  ASSERT_EQ(log.odometry.size(), 200u);
  const Eigen::Vector3d first = Enu(PositionNed(10.0));
  for (const OdometrySample& pose : log.odometry) {
    EXPECT_LT((pose.p_WS - Enu(PositionNed(ToSeconds(pose.stamp))) + first).norm(), 0.02);
    EXPECT_FALSE(pose.v_WS);
  }
}

TEST_F(Dataflash, PolePairsOfTheUserReplaceTheAutopilots) {
  FlightReadOptions options;
  options.pole_pairs = 6;
  EXPECT_NEAR(Read(MadeUpLog(), options).rotors[0].speed[0] * 6.0,
              Read(MadeUpLog()).rotors[0].speed[0] * 7.0, 1e-6);
}

TEST_F(Dataflash, RefusesSlowStreamsWithTheSettingThatMendsThem) {
  Choice choice;
  choice.esc_step_ms = 100;
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "rotor speeds are logged at 10 Hz, at least 50 Hz");
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "SERVO_BLH_BDMASK");
  choice = Choice();
  choice.pose_step_ms = 200;
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "poses are logged at 5.0 Hz, at least 10 Hz");
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "bit 0 of LOG_BITMASK");
}

TEST_F(Dataflash, SaysWhatIsMissing) {
  Choice choice;
  choice.filter = false;
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "no position: neither XKF1");
  FlightReadOptions options;
  options.num_rotors = 6;
  ODMC_EXPECT_ERROR(Read(MadeUpLog(), options), "of 4 ESCs, the vehicle has 6 rotors");
  ODMC_EXPECT_ERROR(Read("something else"), "flight.bin: is no ArduPilot dataflash log");
}

TEST_F(Dataflash, IsFoundByContentAndNotByItsSharedEnding) {
  const FlightReaders readers = FlightReaders::Core();
  EXPECT_EQ(readers.Read(folder_.Write("flight.txt", MadeUpLog()), {}).odometry.size(), 200u);
  EXPECT_TRUE(readers.IsFlight(folder_.Write("flight.bin", MadeUpLog())));
  EXPECT_FALSE(readers.IsFlight(folder_.Write("firmware.bin", std::string(5000, '\x7f'))));
}

TEST_F(Dataflash, TruncatedAnywhereGivesWhatIsThereOrASentence) {
  const std::string whole = MadeUpLog();
  size_t last = 0;
  for (size_t length = 1; length < whole.size(); length += length < 3000 ? 13 : 997) {
    try {
      const FlightLog log = Read(whole.substr(0, length));
      EXPECT_GE(log.odometry.size(), last);
      last = log.odometry.size();
    } catch (const std::invalid_argument& e) {
      EXPECT_TRUE(Contains(e.what(), "flight.bin: ")) << e.what();
      EXPECT_EQ(last, 0u) << length << ": " << e.what();
    }
  }
  EXPECT_GT(last, 195u);
}

TEST_F(Dataflash, DamagedBytesAreSentencesOrFewLostMessagesNotCrashes) {
  const std::string whole = MadeUpLog();
  for (size_t at = 0; at < whole.size(); at += at < 3000 ? 3 : 701) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << at % 8));
    try {
      const FlightLog log = Read(damaged);
      EXPECT_GE(log.odometry.size(), at > 3000 ? 195u : 0u) << at;
      EXPECT_GE(log.rotors.size(), at > 3000 ? 190u : 0u) << at;
    } catch (const std::invalid_argument& e) {
      EXPECT_TRUE(Contains(e.what(), "flight.bin: ")) << e.what();
      EXPECT_LT(at, 3000u) << e.what();
    }
  }
}

TEST_F(Dataflash, GarbageInTheMiddleIsSkippedAndCounted) {
  const std::string whole = MadeUpLog();
  const size_t middle = whole.size() / 2;
  const FlightLog log =
      Read(whole.substr(0, middle) + std::string(5000, '\xa3') + whole.substr(middle));
  EXPECT_GE(log.odometry.size(), 198u);
  EXPECT_TRUE(Contains(log.warnings[0], "damaged at 1 place at byte")) << log.warnings[0];
}

}  // namespace
}  // namespace odmc
