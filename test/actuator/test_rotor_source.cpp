#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <stdexcept>

#include "odmc/identification/flight_actuator.h"
#include "support/bench.h"

namespace odmc {
namespace {

constexpr double kPeriod_s = 0.005;

Actuator TypicalActuator() {
  Actuator actuator;
  actuator.motors = {test::TypicalMotor()};
  actuator.sigma_steady_rad_s = 4.0;
  actuator.sigma_response_rad_s = 6.0;
  return actuator;
}

// Four rotors that follow changing commands; the test breaks what their sensors say.
class RotorSourceTest : public ::testing::Test {
 protected:
  void Step(RotorSource* source) {
    now_ += FromSeconds(kPeriod_s);
    const double t_s = ToSeconds(now_);
    CommandSample command{now_, RotorVector(4)};
    for (int j = 0; j < 4; ++j)
      command.throttle[j] = 0.35 + 0.08 * std::sin((3.0 + j) * t_s) + 0.03 * std::sin(25.0 * t_s);
    source->Add(BatterySample{now_, kVoltage_V});
    modelled_ = source->Add(command);
    RotorSample sample{now_, RotorVector(4)};
    for (size_t j = 0; j < 4; ++j) {
      truth_[j].Command(t_s, command.throttle[static_cast<long>(j)], kVoltage_V);
      sample.speed[static_cast<long>(j)] = truth_[j].At(t_s);
    }
    true_speed_ = sample.speed;
    if (break_) break_(&sample.speed);
    used_ = source->Add(sample);
    for (const RotorFault& fault : source->TakeFaults()) faults_.push_back(fault);
  }
  void Fly(double seconds, RotorSource* source) {
    for (int k = 0; k < std::lround(seconds / kPeriod_s); ++k) Step(source);
  }

  static constexpr double kVoltage_V = 15.5;
  Stamp now_ = FromSeconds(10.0);
  std::vector<SpeedPredictor> truth_ =
      std::vector<SpeedPredictor>(4, SpeedPredictor(test::TypicalMotor()));
  std::function<void(RotorVector*)> break_;
  RotorVector true_speed_;
  std::optional<RotorSample> used_, modelled_;
  std::vector<RotorFault> faults_;
};

TEST_F(RotorSourceTest, LeavesSoundSensorsAlone) {
  RotorSource source(TypicalActuator(), 4, false);
  for (int k = 0; k < 1000; ++k) {
    Step(&source);
    ASSERT_TRUE(used_);
    EXPECT_EQ(used_->speed, true_speed_);
    EXPECT_EQ(used_->model_sigma.size(), 0);
    EXPECT_FALSE(modelled_);
  }
  EXPECT_TRUE(faults_.empty());
  EXPECT_EQ(source.replaced(), 0);
}

TEST_F(RotorSourceTest, ReplacesADeadSensorAndTakesItBack) {
  RotorSource source(TypicalActuator(), 4, false);
  Fly(2.0, &source);
  break_ = [](RotorVector* speed) { (*speed)[2] = 0.0; };
  Fly(1.0, &source);
  ASSERT_EQ(faults_.size(), 1u);
  EXPECT_EQ(faults_[0].rotor, 2);
  EXPECT_TRUE(faults_[0].failed);
  EXPECT_LT(ToSeconds(faults_[0].stamp) - 12.0, 0.25);
  EXPECT_NEAR(used_->speed[2], true_speed_[2], 1.0);
  EXPECT_NEAR(used_->model_sigma[2], std::sqrt(0.5 * (16.0 + 36.0)), 1e-9);
  EXPECT_EQ(used_->model_sigma[0], 0.0);
  EXPECT_EQ(used_->speed[0], true_speed_[0]);
  break_ = nullptr;
  Fly(3.0, &source);
  ASSERT_EQ(faults_.size(), 2u);
  EXPECT_FALSE(faults_[1].failed);
  EXPECT_EQ(used_->speed, true_speed_);
}

TEST_F(RotorSourceTest, SeesAFrozenAndAHalvedSensor) {
  RotorSource source(TypicalActuator(), 4, false);
  Fly(2.0, &source);
  const double held = true_speed_[0];
  break_ = [held](RotorVector* speed) {
    (*speed)[0] = held;
    (*speed)[3] *= 0.5;
  };
  Fly(2.0, &source);
  ASSERT_EQ(faults_.size(), 2u);
  EXPECT_EQ(faults_[0].rotor, 3);
  EXPECT_NE(faults_[0].reason.find("0.5"), std::string::npos);
  EXPECT_EQ(faults_[1].rotor, 0);
  EXPECT_NE(faults_[1].reason.find("frozen"), std::string::npos);
  EXPECT_NEAR(used_->speed[0], true_speed_[0], 1.0);
  EXPECT_NEAR(used_->speed[3], true_speed_[3], 1.0);
}

TEST_F(RotorSourceTest, DoesNotBelieveABadSensorWithoutCommands) {
  RotorSource source(TypicalActuator(), 4, false);
  Fly(2.0, &source);
  const RotorSample late{now_ + FromSeconds(1.0), true_speed_};
  RotorSource sound = source;
  EXPECT_TRUE(sound.Add(late));
  break_ = [](RotorVector* speed) { (*speed)[2] = 0.0; };
  Fly(0.5, &source);
  EXPECT_FALSE(source.Add(RotorSample{now_ + FromSeconds(1.0), true_speed_}));
}

TEST_F(RotorSourceTest, ReplacesSingleMissedReadings) {
  RotorSource source(TypicalActuator(), 4, false);
  int k = 0;
  break_ = [&k](RotorVector* speed) {
    if (++k % 50 == 0) (*speed)[1] = 0.0;
  };
  for (int i = 0; i < 1000; ++i) {
    Step(&source);
    EXPECT_NEAR(used_->speed[1], true_speed_[1], 1.0);
  }
  EXPECT_TRUE(faults_.empty());
  EXPECT_EQ(source.replaced(), 20);
}

TEST_F(RotorSourceTest, GivesSpeedsFromCommandsAlone) {
  RotorSource source(TypicalActuator(), 4, true);
  for (int k = 0; k < 500; ++k) {
    Step(&source);
    ASSERT_TRUE(modelled_);
    EXPECT_NEAR((modelled_->speed - true_speed_).cwiseAbs().maxCoeff(), 0.0, 1e-6);
    EXPECT_FALSE(used_);
  }
}

TEST_F(RotorSourceTest, RefusesActuatorsThatDoNotFit) {
  Actuator three = TypicalActuator();
  three.motors.resize(3, test::TypicalMotor());
  EXPECT_THROW(RotorSource(three, 4, false), std::invalid_argument);
  Actuator steady = TypicalActuator();
  steady.knows_dynamics = false;
  EXPECT_THROW(RotorSource(steady, 4, true), std::invalid_argument);
}

// A flight's log with one halved sensor and nothing known of the actuators beforehand.
TEST_F(RotorSourceTest, SettlesARecordedFlightWithoutAnActuator) {
  RotorSource unused(TypicalActuator(), 4, false);
  FlightLog log;
  log.file = "flight.csv";
  std::vector<RotorVector> truth;
  for (int k = 0; k < 2000; ++k) {
    Step(&unused);
    CommandSample command{now_, RotorVector(4)};
    const double t_s = ToSeconds(now_);
    for (int j = 0; j < 4; ++j)
      command.throttle[j] = 0.35 + 0.08 * std::sin((3.0 + j) * t_s) + 0.03 * std::sin(25.0 * t_s);
    log.commands.push_back(command);
    log.battery.push_back({now_, kVoltage_V});
    RotorSample sample{now_, true_speed_};
    truth.push_back(true_speed_);
    sample.speed[1] *= 0.5;
    log.rotors.push_back(sample);
  }
  EXPECT_EQ(SuspectRotors(log), std::vector<int>{1});
  const auto faults = SettleRotors(std::nullopt, 4, false, &log);
  ASSERT_EQ(faults.size(), 1u);
  EXPECT_EQ(faults[0].rotor, 1);
  ASSERT_FALSE(log.warnings.empty());
  EXPECT_NE(log.warnings[0].find("rotor2"), std::string::npos);
  for (size_t k = 200; k < truth.size(); ++k)
    ASSERT_NEAR(log.rotors[k].speed[1] / truth[k][1], 1.0, 0.02);
}

TEST(SettleRotors, NeedsCommandsAndActuator) {
  FlightLog log;
  log.file = "flight.csv";
  EXPECT_THROW(SettleRotors(TypicalActuator(), 4, true, &log), std::invalid_argument);
  log.commands.push_back({0, RotorVector::Constant(4, 0.3)});
  EXPECT_THROW(SettleRotors(std::nullopt, 4, true, &log), std::invalid_argument);
}

TEST(SpeedPredictor, WaitsForTheDelay) {
  SpeedPredictor predictor(test::TypicalMotor());
  predictor.Command(0.0, 0.3, 15.0);
  const double steady = predictor.At(0.1);
  predictor.Command(0.2, 0.5, 15.0);
  EXPECT_EQ(predictor.At(0.2059), steady);
  EXPECT_GT(predictor.At(0.21), steady + 5.0);
  EXPECT_NEAR(predictor.At(2.0), test::TypicalMotor().SteadySpeed(0.5, 15.0), 1e-6);
}

}  // namespace
}  // namespace odmc
