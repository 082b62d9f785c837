#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "../../src/ros/child_reader.h"
#include "support/error_text.h"

namespace odmc {
namespace {

FlightLog SomeFlight() {
  FlightLog log;
  log.file = "f.bag";
  log.odometry.resize(2);
  log.odometry[1].stamp = 1700000000123456789;
  log.odometry[1].v_WS = Eigen::Vector3d(1.0 / 3.0, -0.0, 5e-324);
  log.imu.push_back({3, std::nullopt, Eigen::Vector3d(1.0, 2.0, 3.0)});
  log.rotors.push_back({4, RotorVector::LinSpaced(6, 1.0, 2.0), RotorVector::Constant(6, 0.5)});
  log.battery.push_back({5, 16.1});
  log.commands.push_back({6, RotorVector::Constant(4, 0.1)});
  log.command_unit = CommandUnit::kRaw16;
  log.rotor_rms_only = true;
  log.dropped = 7;
  log.warnings = {"one", std::string(200000, 'x')};
  return log;
}

TEST(ChildReader, HandsOverEveryBit) {
  const FlightLog log = SomeFlight(), back = ReadInChild("f.bag", SomeFlight);
  EXPECT_EQ(back.file, log.file);
  ASSERT_EQ(back.odometry.size(), 2u);
  EXPECT_EQ(back.odometry[1].stamp, log.odometry[1].stamp);
  EXPECT_EQ(back.odometry[1].v_WS, log.odometry[1].v_WS);
  EXPECT_FALSE(back.odometry[0].v_WS || back.odometry[0].w_WS_S);
  EXPECT_FALSE(back.imu.at(0).gyro_I.has_value());
  EXPECT_EQ(back.imu[0].specific_force_I, log.imu[0].specific_force_I);
  EXPECT_EQ(back.rotors.at(0).speed, log.rotors[0].speed);
  EXPECT_EQ(back.rotors[0].model_sigma, log.rotors[0].model_sigma);
  EXPECT_EQ(back.battery.at(0).voltage_V, 16.1);
  EXPECT_EQ(back.commands.at(0).throttle, log.commands[0].throttle);
  EXPECT_EQ(back.command_unit, log.command_unit);
  EXPECT_EQ(back.rotor_rms_only, log.rotor_rms_only);
  EXPECT_EQ(back.dropped, 7);
  EXPECT_EQ(back.warnings, log.warnings);
}

TEST(ChildReader, ErrorsComeBackInTheirWords) {
  ODMC_EXPECT_ERROR(
      ReadInChild("f.bag", []() -> FlightLog { throw std::runtime_error("so and so"); }),
      "so and so");
}

TEST(ChildReader, CrashesAreASentence) {
  const char kCrashed[] = "f.bag: the bag library crashed while reading it: the file is damaged";
  for (const int signal : {SIGSEGV, SIGABRT, SIGBUS, SIGFPE}) {
    ODMC_EXPECT_ERROR(ReadInChild("f.bag",
                                  [signal]() -> FlightLog {
                                    std::signal(signal, SIG_DFL);
                                    std::raise(signal);
                                    return {};
                                  }),
                      kCrashed);
  }
  ODMC_EXPECT_ERROR(ReadInChild("f.bag", []() -> FlightLog { _exit(0); }), kCrashed);
}

TEST(ChildReader, TimeIsBounded) {
  const auto start = std::chrono::steady_clock::now();
  ODMC_EXPECT_ERROR(ReadInChild("f.bag",
                                []() -> FlightLog {
                                  Restrict({1 << 30, 1});
                                  for (volatile bool on = true; on;) {
                                  }
                                  return {};
                                }),
                    "f.bag: reading takes longer than a sound file");
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(30));
}

TEST(ChildReader, MemoryIsBounded) {
  ODMC_EXPECT_ERROR(ReadInChild("f.bag",
                                []() -> FlightLog {
                                  Restrict({64 << 20, 10});
                                  FlightLog log;
                                  log.odometry.resize(10000000);
                                  return log;
                                }),
                    "bad_alloc");
}

}  // namespace
}  // namespace odmc
