#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "odmc/io/autopilot_logs.h"
#include "odmc/io/flight_reader.h"
#include "support/error_text.h"
#include "support/made_up_log.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using namespace testing_support;

/// Writes a ULog file message by message, after PX4's description of the format.
class ULogWriter {
 public:
  ULogWriter() {
    text_ = std::string("ULog\x01\x12\x35\x01", 8) + Raw<std::uint64_t>(1000);
    Message('B', std::string(40, '\0'));
  }
  void Message(char type, const std::string& body) {
    text_ += Raw(static_cast<std::uint16_t>(body.size())) + type + body;
  }
  void Format(const std::string& text) { Message('F', text); }
  void Subscribe(int id, const std::string& topic, int instance = 0) {
    Message('A', std::string(1, static_cast<char>(instance)) + Raw(static_cast<std::uint16_t>(id)) +
                     topic);
  }
  void Data(int id, std::uint64_t stamp_us, const std::string& fields) {
    Message('D', Raw(static_cast<std::uint16_t>(id)) + Raw(stamp_us) + fields);
  }
  void Parameter(const std::string& name, std::int32_t value) {
    const std::string key = "int32_t " + name;
    Message('P', std::string(1, static_cast<char>(key.size())) + key + Raw(value));
  }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

struct Choice {
  bool odometry = true, position_and_attitude = false, esc = true, body_velocity = false;
  bool has_functions = false, damaged_subscription = false;
  int rotor_step_ms = 5;
};

constexpr int kLength_ms = 2000;

void Declare(const Choice& choice, ULogWriter* writer) {
  writer->Format(
      "vehicle_odometry:uint64_t timestamp;uint64_t timestamp_sample;float[3] position;"
      "float[4] q;float[3] velocity;float[3] angular_velocity;uint8_t pose_frame;"
      "uint8_t velocity_frame;uint8_t[6] _padding0;");
  writer->Format(
      "vehicle_local_position:uint64_t timestamp;float x;float y;float z;float vx;float "
      "vy;float vz;bool xy_valid;uint8_t[7] _padding0;");
  writer->Format("vehicle_attitude:uint64_t timestamp;float[4] q;");
  writer->Format(
      "sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
      "float[3] accelerometer_m_s2;");
  writer->Format(
      "esc_status:uint64_t timestamp;uint16_t counter;uint8_t esc_count;uint8_t "
      "esc_connectiontype;uint8_t[4] _padding0;esc_report[8] esc;");
  writer->Format(
      "esc_report:uint64_t timestamp;int32_t esc_rpm;float esc_voltage;uint8_t "
      "actuator_function;uint8_t[7] _padding0;");
  writer->Format("actuator_motors:uint64_t timestamp;float[12] control;");
  writer->Format("battery_status:uint64_t timestamp;float voltage_v;uint8_t[4] _padding0;");
  writer->Parameter("MOT_POLE_COUNT", 14);
  if (choice.odometry) writer->Subscribe(1, "vehicle_odometry");
  if (choice.position_and_attitude) {
    writer->Subscribe(2, "vehicle_local_position");
    writer->Subscribe(3, "vehicle_attitude");
  }
  writer->Subscribe(4, "sensor_combined");
  if (choice.esc) writer->Subscribe(5, "esc_status");
  writer->Subscribe(6, "actuator_motors");
  writer->Subscribe(7, "battery_status");
}

std::string Vector(const Eigen::Vector3d& v) { return Floats({v.x(), v.y(), v.z()}); }
std::string Quaternion(const Eigen::Quaterniond& q) { return Floats({q.w(), q.x(), q.y(), q.z()}); }

/// Reports of four motors; each ESC read its own 200 us after the one before.
std::string EscStatus(std::uint64_t stamp_us, bool has_functions) {
  std::string body = Raw<std::uint16_t>(0) + char(4) + char(0) + std::string(4, '\0');
  for (int i = 0; i < 8; ++i) {
    const std::uint64_t own_us = i < 4 ? stamp_us - 800 + 200 * static_cast<std::uint64_t>(i) : 0;
    const int motor = has_functions ? 3 - i : i;  // wired the other way round
    body += Raw(own_us) +
            Raw(static_cast<std::int32_t>(
                i < 4 ? std::lround(Rpm(motor, 1e-6 * static_cast<double>(own_us))) : 0)) +
            Floats({16.0}) + static_cast<char>(has_functions && i < 4 ? 101 + motor : 0) +
            std::string(7, '\0');
  }
  return body;
}

std::string MadeUpLog(const Choice& choice = {}) {
  ULogWriter writer;
  Declare(choice, &writer);
  for (int ms = 0; ms < kLength_ms; ++ms) {
    const std::uint64_t now = 10000000 + 1000 * static_cast<std::uint64_t>(ms);
    const double t = 1e-6 * static_cast<double>(now);
    if (choice.odometry && ms % 10 == 0) {  // 2 ms after the sample
      const double sampled = t - 0.002;
      const Eigen::Quaterniond q = AttitudeNed(sampled);
      const Eigen::Vector3d v = VelocityNed(sampled);
      writer.Data(1, now,
                  Raw(now - 2000) + Vector(PositionNed(sampled)) + Quaternion(q) +
                      Vector(choice.body_velocity ? q.conjugate() * v : v) +
                      Floats({0.1, 0.2, 0.3}) + char(1) +
                      static_cast<char>(choice.body_velocity ? 3 : 1));
    }
    if (choice.position_and_attitude && ms % 20 == 3) {
      writer.Data(2, now, Vector(PositionNed(t)) + Vector(VelocityNed(t)) + char(1));
    }
    if (choice.position_and_attitude && ms % 4 == 0)
      writer.Data(3, now, Quaternion(AttitudeNed(t)));
    if (ms % 4 == 1) {
      writer.Data(
          4, now,
          Floats({0.01, 0.02, 0.03}) + Raw<std::uint32_t>(4000) + Floats({0.5, 0.25, -9.5}));
    }
    if (choice.esc && ms % choice.rotor_step_ms == 2)
      writer.Data(5, now, EscStatus(now, choice.has_functions));
    if (ms % 5 == 3) {
      writer.Data(6, now, Floats({0.5, 0.6, 0.7, 0.8, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN}));
    }
    if (ms % 100 == 0) writer.Data(7, now, Floats({15.5}));
  }
  return writer.text();
}

class ULog : public ::testing::Test {
 protected:
  FlightLog Read(const std::string& text, FlightReadOptions options = {}) const {
    return ReadULog(folder_.Write("flight.ulg", text), options);
  }
  TemporaryFolder folder_;
};

/// The made-up flight at a stamp in our frames: east, north, up and x forward, y left, z up.
void ExpectPose(const OdometrySample& pose) {
  const double t = ToSeconds(pose.stamp);
  EXPECT_LT((pose.p_WS - Enu(PositionNed(t))).norm(), 1e-5);
  EXPECT_LT((*pose.v_WS - Enu(VelocityNed(t))).norm(), 1e-5);
  EXPECT_LT(AttitudeError(pose.q_WS, t), 1e-4);
}

TEST_F(ULog, GivesTheFlightInOurFramesAndUnits) {
  const FlightLog log = Read(MadeUpLog());
  ASSERT_EQ(log.odometry.size(), 200u);
  for (const OdometrySample& pose : log.odometry) ExpectPose(pose);
  EXPECT_LT((*log.odometry[0].w_WS_S - Eigen::Vector3d(0.1, -0.2, -0.3)).norm(), 1e-6);
  ASSERT_EQ(log.imu.size(), 500u);
  EXPECT_LT((*log.imu[0].gyro_I - Eigen::Vector3d(0.01, -0.02, -0.03)).norm(), 1e-6);
  EXPECT_LT((*log.imu[0].specific_force_I - Eigen::Vector3d(0.5, -0.25, 9.5)).norm(), 1e-6);
  EXPECT_NEAR(log.commands[0].throttle[2], 0.7, 1e-6);
  EXPECT_NEAR(log.battery[0].voltage_V, 15.5, 1e-6);
  EXPECT_EQ(log.dropped, 0);
  EXPECT_TRUE(Contains(log.warnings.back(),
                       "flight.ulg: read pose 100 Hz, IMU 250 Hz, rotor speeds 200 Hz, commands "
                       "200 Hz, battery voltage 10 Hz"))
      << log.warnings.back();
}

TEST_F(ULog, RotorsOfEscsThatAnswerInTurnAreOnOneClock) {
  for (const bool has_functions : {false, true}) {
    Choice choice;
    choice.has_functions = has_functions;
    const FlightLog log = Read(MadeUpLog(choice));
    ASSERT_GT(log.rotors.size(), 390u);
    for (const RotorSample& sample : log.rotors) {
      for (int j = 0; j < 4; ++j) {
        ASSERT_NEAR(sample.speed[j], Rpm(j, ToSeconds(sample.stamp)) * M_PI / 30.0, 0.12);
      }
    }
  }
}

TEST_F(ULog, TakesVelocityInTheBodyFrame) {
  Choice choice;
  choice.body_velocity = true;
  for (const OdometrySample& pose : Read(MadeUpLog(choice)).odometry) ExpectPose(pose);
}

TEST_F(ULog, JoinsLocalPositionAndAttitude) {
  Choice choice;
  choice.odometry = false;
  choice.position_and_attitude = true;
  const FlightLog log = Read(MadeUpLog(choice));
  ASSERT_GT(log.odometry.size(), 95u);
  for (const OdometrySample& pose : log.odometry) ExpectPose(pose);
}

TEST_F(ULog, PolePairsOfTheUserReplaceTheAutopilots) {
  FlightReadOptions options;
  options.pole_pairs = 6;
  EXPECT_NEAR(Read(MadeUpLog(), options).rotors[0].speed[0] * 6.0,
              Read(MadeUpLog()).rotors[0].speed[0] * 7.0, 1e-6);
}

TEST_F(ULog, RefusesSlowRotorSpeedsWithTheLineThatMendsIt) {
  Choice choice;
  choice.rotor_step_ms = 250;
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "rotor speeds are logged at 4.0 Hz, at least 50 Hz");
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "'esc_status 5' to etc/logging/logger_topics.txt");
}

TEST_F(ULog, SaysWhatIsMissing) {
  Choice choice;
  choice.odometry = false;
  ODMC_EXPECT_ERROR(Read(MadeUpLog(choice)), "no pose: neither vehicle_odometry nor");
  FlightReadOptions options;
  options.num_rotors = 6;
  ODMC_EXPECT_ERROR(Read(MadeUpLog(), options), "has 4 ESCs, the vehicle has 6 rotors");
  ODMC_EXPECT_ERROR(Read("something else"), "flight.ulg: is no ULog");
}

TEST_F(ULog, CommandsMayStandInForRotorSpeeds) {
  Choice choice;
  choice.esc = false;
  const FlightLog log = Read(MadeUpLog(choice));
  EXPECT_TRUE(log.rotors.empty());
  EXPECT_EQ(log.commands.size(), 400u);
}

TEST_F(ULog, IsFoundByContent) {
  const std::string file = folder_.Write("flight.txt", MadeUpLog());
  EXPECT_EQ(FlightReaders::Core().Read(file, {}).odometry.size(), 200u);
}

TEST_F(ULog, TruncatedAnywhereGivesWhatIsThereOrASentence) {
  const std::string whole = MadeUpLog();
  size_t last = 0;
  for (size_t length = 1; length < whole.size(); length += length < 3000 ? 13 : 1997) {
    try {
      const FlightLog log = Read(whole.substr(0, length));
      EXPECT_GE(log.odometry.size(), last);
      last = log.odometry.size();
    } catch (const std::invalid_argument& e) {
      EXPECT_TRUE(Contains(e.what(), "flight.ulg: ")) << e.what();
      EXPECT_EQ(last, 0u) << length << ": " << e.what();
    }
  }
  EXPECT_GT(last, 190u);
}

TEST_F(ULog, DamagedBytesAreSentencesOrFewLostMessagesNotCrashes) {
  const std::string whole = MadeUpLog();
  int read = 0, tried = 0;
  for (size_t at = 0; at < whole.size(); at += at < 2000 ? 5 : 1601, ++tried) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << at % 8));
    try {
      const FlightLog log = Read(damaged);
      ++read;
      for (size_t i = 1; i < log.odometry.size(); ++i) {
        ASSERT_GT(log.odometry[i].stamp, log.odometry[i - 1].stamp) << at;
      }
      EXPECT_GE(log.odometry.size(), at > 2000 ? 190u : 0u) << at;
    } catch (const std::invalid_argument& e) {
      EXPECT_TRUE(Contains(e.what(), "flight.ulg: ")) << e.what();
      EXPECT_LT(at, 2000u) << e.what();
    }
  }
  EXPECT_GT(read, tried / 2);
}

TEST_F(ULog, GarbageInTheMiddleIsSkippedAndCounted) {
  const std::string whole = MadeUpLog();
  const size_t middle = whole.size() / 2;
  std::string damaged = whole.substr(0, middle) + std::string(5000, '\xff') + whole.substr(middle);
  const FlightLog log = Read(damaged);
  EXPECT_GE(log.odometry.size(), 195u);
  EXPECT_TRUE(Contains(log.warnings[0], "damaged at 1 place at byte")) << log.warnings[0];
}

}  // namespace
}  // namespace odmc
