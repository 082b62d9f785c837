#include <gtest/gtest.h>

#include <cmath>

#include "odmc/model/motor.h"
#include "support/bench.h"

namespace odmc {
namespace {

// An independent solution: fourth-order Runge-Kutta in steps of 10 µs.
double Integrated(const MotorDynamics& m, double speed, double drive, double duration_s) {
  const auto rate = [&](double w) { return drive - m.S1 * w - m.S2 * w * w; };
  constexpr double kStep_s = 1e-5;
  for (int i = 0; i < std::lround(duration_s / kStep_s); ++i) {
    const double a = rate(speed), b = rate(speed + 0.5 * kStep_s * a);
    const double c = rate(speed + 0.5 * kStep_s * b), d = rate(speed + kStep_s * c);
    speed += kStep_s / 6.0 * (a + 2.0 * b + 2.0 * c + d);
  }
  return speed;
}

TEST(MotorDynamics, SolvesItsEquation) {
  for (const MotorDynamics& m : {MotorDynamics{24.0, 0.006}, {40.0, 0.0}, {1.0, 0.02}}) {
    for (const double start : {0.0, 300.0, 1500.0}) {
      for (const double drive : {0.0, 5000.0, 50000.0}) {
        EXPECT_NEAR(m.After(start, drive, 0.02), Integrated(m, start, drive, 0.02), 1e-6)
            << m.S1 << ' ' << m.S2 << ' ' << start << ' ' << drive;
      }
    }
  }
}

TEST(MotorDynamics, HoldsTheSpeedOfItsDrive) {
  const MotorDynamics m = {24.0, 0.006};
  EXPECT_NEAR(m.SteadySpeed(m.DriveFor(1100.0)), 1100.0, 1e-9);
  EXPECT_NEAR(m.After(1100.0, m.DriveFor(1100.0), 0.1), 1100.0, 1e-9);
  EXPECT_EQ(m.SteadySpeed(-10.0), 0.0);
  // The time constant is that of small changes.
  const double later = m.After(1101.0, m.DriveFor(1100.0), m.TimeConstant(1100.0));
  EXPECT_NEAR(later - 1100.0, std::exp(-1.0), 1e-3);
}

TEST(EscMap, InvertsItself) {
  for (const EscMap& esc : {EscMap{3200.0, 12000.0, -9000.0, -0.25},
                            {3200.0, 0.0, 500.0, 0.05},
                            {3200.0, -4000.0, 0.0, 0.0},
                            {0.0, 30000.0, -1000.0, -1.0}}) {
    for (const double throttle : {0.1, 0.4, 0.9}) {
      EXPECT_NEAR(esc.ThrottleFor(esc.Drive(throttle, 15.0), 15.0), throttle, 1e-9);
    }
  }
}

TEST(Actuator, CommandsWhatTurnsTheRotorAtThisVoltage) {
  Actuator actuator;
  actuator.command_unit = CommandUnit::kMicroseconds;
  actuator.motors = {test::TypicalMotor()};
  for (const double voltage : {14.0, 16.0}) {
    const double command = actuator.CommandFor(2, 1000.0, 0.0, voltage);
    EXPECT_NEAR(
        actuator.MotorOf(2).SteadySpeed(ThrottleOf(command, actuator.command_unit), voltage),
        1000.0, 1e-6);
    EXPECT_GT(actuator.CommandFor(2, 1000.0, 5000.0, voltage), command);  // to speed up
  }
  EXPECT_GT(actuator.CommandFor(0, 1000.0, 0.0, 14.0), actuator.CommandFor(0, 1000.0, 0.0, 16.0));
  EXPECT_LE(actuator.CommandFor(0, 9000.0, 0.0, 16.0), 2000.0);
  EXPECT_GE(actuator.CommandFor(0, 0.0, -1e6, 16.0), 1000.0);
}

TEST(CommandUnit, TakesCommandsToThrottleAndBack) {
  EXPECT_DOUBLE_EQ(ThrottleOf(1500.0, CommandUnit::kMicroseconds), 0.5);
  EXPECT_DOUBLE_EQ(ThrottleOf(65535.0, CommandUnit::kRaw16), 1.0);
  EXPECT_DOUBLE_EQ(ThrottleOf(0.3, CommandUnit::kFraction), 0.3);
  for (const char* name : {"us", "raw16", "fraction"}) {
    const CommandUnit unit = *CommandUnitNamed(name);
    EXPECT_STREQ(NameOf(unit), name);
    EXPECT_NEAR(ThrottleOf(CommandOf(0.37, unit), unit), 0.37, 1e-12);
  }
  EXPECT_FALSE(CommandUnitNamed("percent"));
}

}  // namespace
}  // namespace odmc
