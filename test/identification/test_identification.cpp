#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include "odmc/actuator/free_run.h"
#include "odmc/actuator/rotor_inertia.h"
#include "odmc/identification/actuator_calibration.h"
#include "support/bench.h"

namespace odmc {
namespace {

using test::BenchErrors;
using test::StepBench;
using test::TypicalMotor;

MeasuredValue Found(const std::vector<ActuatorParameter>& parameters, const std::string& name) {
  for (const ActuatorParameter& p : parameters) {
    if (p.name == name && p.found) return *p.found;
  }
  ADD_FAILURE() << name << " was not found";
  return {};
}

bool Knows(const std::vector<ActuatorParameter>& parameters, const std::string& name) {
  for (const ActuatorParameter& p : parameters) {
    if (p.name == name) return p.found.has_value();
  }
  return false;
}

// The fit gives the motor back: dynamics, and speeds on a run it has not seen.
void ExpectTheMotor(const ActuatorFit& fit, const Motor& truth, double most_rad_s) {
  const double speed = fit.common.error.mean_speed_rad_s;
  const double tau_s = truth.dynamics.TimeConstant(speed);
  EXPECT_NEAR(Found(fit.common.parameters, "time_constant_s").value, tau_s, 0.05 * tau_s);
  EXPECT_NEAR(Found(fit.common.parameters, "delay_s").value, truth.delay_s, 0.001);
  BenchErrors none;
  none.noise_rad_s = 0.0;
  const BenchRun other = StepBench(truth, none, 99);
  const FreeRunError error = ErrorOfFreeRun(fit.common.motor, {SignalOf(other, 0, true)});
  EXPECT_LT(error.all_rad_s, most_rad_s);
}

TEST(Identification, GivesTheMotorBack) {
  const ActuatorFit fit = IdentifyActuator({StepBench(TypicalMotor(), {}, 1)});
  ExpectTheMotor(fit, TypicalMotor(), 1.0);
  EXPECT_NEAR(fit.common.error.steady_rad_s, 2.0, 0.2);  // the noise
  EXPECT_NEAR(fit.common.error.response_rad_s, 2.0, 0.4);
  ASSERT_EQ(fit.step_times_s.size(), 10u);
  EXPECT_NEAR(fit.step_times_s[3], 10.0, 0.006);
}

TEST(Identification, SurvivesABadBench) {
  BenchErrors errors;
  errors.noise_rad_s = 5.0;
  errors.quantum_rad_s = 10.0;
  errors.outlier_share = 0.03;
  errors.zero_share = 0.05;
  errors.missing_step = 6;
  const ActuatorFit fit = IdentifyActuator({StepBench(TypicalMotor(), errors, 2)});
  ExpectTheMotor(fit, TypicalMotor(), 4.0);
  EXPECT_GT(fit.common.error.outliers, 100);
}

// Truth within three sigma, over seeds; sigma is neither idle nor shy.
TEST(Identification, SigmaIsHonest) {
  const Motor truth = TypicalMotor();
  double worst = 0.0, squares = 0.0;
  int count = 0;
  for (int seed = 1; seed <= 12; ++seed) {
    const ActuatorFit fit = IdentifyActuator({StepBench(truth, {}, seed)});
    const double speed = fit.common.error.mean_speed_rad_s;
    for (const auto& [name, value] :
         {std::pair<const char*, double>{"time_constant_s", truth.dynamics.TimeConstant(speed)},
          {"delay_s", truth.delay_s}}) {
      const MeasuredValue found = Found(fit.common.parameters, name);
      const double z = (found.value - value) / found.sigma;
      worst = std::max(worst, std::abs(z));
      squares += z * z;
      ++count;
    }
  }
  const double rms = std::sqrt(squares / count);
  EXPECT_LT(worst, 4.0);
  EXPECT_GT(rms, 0.3);
  EXPECT_LT(rms, 1.8);
}

TEST(Identification, BeginsWhereTheMotorTurns) {
  BenchRun run = StepBench(TypicalMotor(), {}, 1);
  const size_t idle = 8000;  // 40 s before the first step
  run.throttle[0].insert(run.throttle[0].begin(), idle, 0.0);
  run.speed_rad_s[0].insert(run.speed_rad_s[0].begin(), idle, NAN);
  run.voltage_V.insert(run.voltage_V.begin(), idle, 16.3);
  std::vector<double> t_s(idle + run.t_s.size());
  for (size_t i = 0; i < t_s.size(); ++i) t_s[i] = 0.005 * static_cast<double>(i);
  run.t_s = t_s;
  ExpectTheMotor(IdentifyActuator({run}), TypicalMotor(), 1.0);
}

TEST(Identification, RefusesRowsTooFarApartForDynamics) {
  BenchRun run = StepBench(TypicalMotor(), {}, 1, 10.0);
  for (double& t : run.t_s) t *= 1000.0;  // milliseconds
  EXPECT_THROW(IdentifyActuator({run}), std::invalid_argument);
}

TEST(Identification, FindsCommandsStampedLate) {
  BenchRun run = StepBench(TypicalMotor(), {}, 1, 500.0);
  const std::vector<double> true_throttle = run.throttle[0];
  for (size_t i = 4; i < run.size(); ++i) run.throttle[0][i] = true_throttle[i - 4];  // 8 ms
  Motor late = TypicalMotor();
  late.delay_s -= 0.008;
  const ActuatorFit fit = IdentifyActuator({run});
  EXPECT_NEAR(Found(fit.common.parameters, "delay_s").value, late.delay_s, 0.001);
}

TEST(Identification, FitsSeveralMotorsAndFiles) {
  Motor strong = TypicalMotor();
  strong.esc.root *= 1.05;
  std::vector<BenchRun> runs;
  for (const int seed : {1, 2}) {
    BenchRun run = StepBench(TypicalMotor(), {}, seed);
    run.speed_rad_s.push_back(StepBench(strong, {}, seed + 10).speed_rad_s.front());
    runs.push_back(run);
  }
  const ActuatorFit fit = IdentifyActuator(runs);
  ASSERT_EQ(fit.motors.size(), 2u);
  const auto gain = [](const Motor& motor) { return motor.SteadySpeed(0.4, 15.5); };
  EXPECT_NEAR(gain(fit.motors[0].motor), gain(TypicalMotor()), 2.0);
  EXPECT_NEAR(gain(fit.motors[1].motor), gain(strong), 2.0);
  EXPECT_GT(gain(strong) - gain(TypicalMotor()), 20.0);
}

TEST(Identification, SaysWhatSteadyReadingsDoNotShow) {
  BenchRun run = StepBench(TypicalMotor(), {}, 1);
  run.t_s.clear();
  const ActuatorCalibration c = CalibrateActuator({run}, std::nullopt);
  for (const char* name : {"S_0", "S_1", "S_2", "time_constant_s", "delay_s", "k_f", "k_m"})
    EXPECT_FALSE(Knows(c.parameters, name)) << name;
  EXPECT_LT(c.error.steady_rad_s, 10.0);
  EXPECT_FALSE(ActuatorOf(c).knows_dynamics);
}

TEST(Identification, TorqueCoefficientNeedsTheInertia) {
  BenchErrors errors;
  errors.noise_rad_s = 0.5;
  const BenchRun run = StepBench(TypicalMotor(), errors, 1);
  EXPECT_FALSE(Knows(CalibrateActuator({run}, std::nullopt).parameters, "k_m"));
  const MeasuredValue inertia = {3e-6, 3e-7};
  const ActuatorCalibration c = CalibrateActuator({run}, inertia);
  const MeasuredValue k_m = Found(c.parameters, "k_m"), S2 = Found(c.parameters, "S_2");
  EXPECT_NEAR(k_m.value, S2.value * 3e-6, 1e-15);
  EXPECT_GT(k_m.sigma / k_m.value, 0.1);  // at least that of the inertia
  EXPECT_NEAR(k_m.value, 0.006 * 3e-6, 4.0 * k_m.sigma);
}

TEST(Identification, RefusesWhatCannotBeFitted) {
  BenchRun run = StepBench(TypicalMotor(), {}, 1);
  EXPECT_THROW(IdentifyActuator({}), std::invalid_argument);
  BenchRun constant = run;
  std::fill(constant.throttle[0].begin(), constant.throttle[0].end(), 0.3);
  EXPECT_THROW(IdentifyActuator({constant}), std::invalid_argument);
  BenchRun silent = run;
  std::fill(silent.speed_rad_s[0].begin(), silent.speed_rad_s[0].end(), NAN);
  EXPECT_THROW(IdentifyActuator({silent}), std::invalid_argument);
  BenchRun two = run;
  two.speed_rad_s.push_back(two.speed_rad_s[0]);
  EXPECT_THROW(IdentifyActuator({run, two}), std::invalid_argument);
}

TEST(Identification, LeavesOutARunWithoutSpeeds) {
  const BenchRun run = StepBench(TypicalMotor(), {}, 1);
  BenchRun silent = run;
  silent.file = "silent.csv";
  std::fill(silent.speed_rad_s[0].begin(), silent.speed_rad_s[0].end(), NAN);
  const ActuatorCalibration c = CalibrateActuator({silent, run}, std::nullopt);
  EXPECT_TRUE(Knows(c.parameters, "time_constant_s"));
  ASSERT_FALSE(c.warnings.empty());
  EXPECT_NE(c.warnings.back().find("silent.csv"), std::string::npos);
  EXPECT_THROW(CalibrateActuator({silent}, std::nullopt), std::invalid_argument);
}

TEST(ThrustStand, FindsCoefficientsBesideAnOffset) {
  BenchRun run = StepBench(TypicalMotor(), {}, 3, 10.0);
  for (size_t i = 0; i < run.t_s.size(); ++i) {
    const double squares = std::pow(run.speed_rad_s[0][i], 2);
    run.thrust_N.push_back(1.5e-6 * squares + 0.01 * std::sin(7.0 * static_cast<double>(i)));
    run.torque_Nm.push_back(2e-8 * squares - 0.008 + 1e-4 * std::cos(5.0 * static_cast<double>(i)));
    if (i % 25 == 0) run.thrust_N.back() = 9.0;  // a knock at the stand
  }
  const auto thrust = FitThrust({run}), torque = FitTorque({run});
  ASSERT_TRUE(thrust && torque);
  EXPECT_NEAR(thrust->coefficient.value, 1.5e-6, 0.01e-6);
  EXPECT_EQ(thrust->outliers, 11);
  EXPECT_NEAR(torque->coefficient.value, 2e-8, 0.01e-8);
  EXPECT_NEAR(torque->offsets.at(0).value, -0.008, 1e-4);
  EXPECT_FALSE(FitThrust({StepBench(TypicalMotor(), {}, 3)}));
}

// As few levels as unknowns fit exactly; sigma must not take that for certainty.
TEST(ThrustStand, TwoLevelsDoNotMakeItSure) {
  for (int seed = 1; seed <= 20; ++seed) {
    std::mt19937 random(static_cast<unsigned>(seed));
    std::normal_distribution<double> noise(0.0, 1e-3);
    BenchRun run;
    run.throttle.resize(1);
    run.speed_rad_s.resize(1);
    for (int i = 0; i < 40; ++i) {
      const double speed = i < 20 ? 400.0 : 900.0;
      run.throttle[0].push_back(i < 20 ? 0.2 : 0.5);
      run.speed_rad_s[0].push_back(speed);
      run.torque_Nm.push_back(2e-8 * speed * speed - 0.008 + noise(random));
    }
    const auto torque = FitTorque({run});
    ASSERT_TRUE(torque);
    EXPECT_LT(std::abs(torque->coefficient.value - 2e-8), 4.0 * torque->coefficient.sigma) << seed;
    EXPECT_LT(torque->coefficient.sigma, 2e-9);
  }
}

TEST(Identification, SeesStepsThatSlew) {
  MotorSignal signal;
  for (int i = 0; i < 400; ++i) {  // 10 Hz: holds of 2 s, half a second from one to the next
    const int step = i / 25, within = i % 25;
    signal.t_s.push_back(0.1 * i);
    signal.throttle.push_back(0.1 + 0.05 * (step + std::max(0, within - 20) / 5.0));
  }
  const std::vector<double> times = StepTimes(signal);
  ASSERT_EQ(times.size(), 16u);
  EXPECT_NEAR(times[2], 7.1, 0.11);
  for (size_t i = 0; i < signal.throttle.size(); ++i)
    signal.throttle[i] = 0.4 + 0.2 * std::sin(0.5 * static_cast<double>(i));
  EXPECT_TRUE(StepTimes(signal).empty());
}

TEST(RotorInertia, AddsBladesAndBell) {
  const RotorGeometry geometry = {2, 0.0015, 0.0635, 0.012, 0.014};
  const double blades = 2.0 * 0.0015 * 0.0635 * 0.0635 / 3.0;
  EXPECT_GT(RotorInertia(geometry), blades + 0.5 * 0.012 * 0.014 * 0.014);
  EXPECT_LT(RotorInertia(geometry), blades + 0.012 * 0.014 * 0.014);
}

}  // namespace
}  // namespace odmc
