#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "odmc/attribution/residual_watch.h"
#include "odmc/bench/undeclared.h"
#include "odmc/estimator/estimator.h"
#include "odmc/math/gaussian.h"
#include "support/fading_thrust.h"
#include "support/flight_feed.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

UndeclaredFlight Fly(const std::vector<std::string>& effects, const std::string& trajectory,
                     int seed) {
  UndeclaredPlan plan;
  plan.kind = effects.empty() ? UndeclaredKind::kNothing : UndeclaredKind::kOneEffect;
  plan.effects = effects;
  plan.share = effects.empty() ? 0.0 : 0.8;
  plan.strength = "strong";
  plan.trajectory = trajectory;
  plan.vehicle = 1;
  plan.seed = seed;
  return MakeUndeclared(plan);
}

/// Estimator and watch side by side, as the node has them.
class Pilot {
 public:
  Pilot(const UndeclaredFlight& flight, const ResidualWatchOptions& options)
      : Pilot(flight.log, flight.declared, options) {}
  Pilot(const FlightLog& log, const Vehicle& declared, const ResidualWatchOptions& options)
      : log_(log), feed_(log_), declared_(declared), watch_(declared, options, true) {
    estimator_options_.keyframe_rate_hz = 50.0;
    model_ = std::make_shared<DynamicModel>(declared_, declared_.effects);
    estimator_ = std::make_unique<Estimator>(model_.get(), estimator_options_, true);
  }

  /// Flies on until `end_s`, looking whenever it is time.
  void FlyUntil(double end_s) {
    const Stamp end = log_.odometry.front().stamp + FromSeconds(end_s);
    while (!feed_.AtEnd() && feed_.next_pose().stamp < end) {
      feed_.Next([this](const auto& sample) {
        watch_.Add(sample);
        estimator_->Add(sample);
      });
      Step();
      if (auto look = watch_.Look()) looks_.push_back(*std::move(look));
    }
  }

  /// As the node adds an effect in flight.
  void Add(const ResidualAnalysis& found) {
    declared_ = VehicleWith(declared_, *found.candidate);
    const DynamicModel declared(declared_, declared_.effects);
    const Vehicle warm = WarmStarted(declared_, Estimator::ToParameterSet(*model_, *last_), found);
    auto model = std::make_shared<DynamicModel>(warm, warm.effects);
    auto estimator = std::make_unique<Estimator>(model.get(), estimator_options_, true);
    estimator->CarryOn(*estimator_, declared);
    estimator_ = std::move(estimator);
    model_ = std::move(model);
    last_.reset();
  }

  const std::vector<ResidualAnalysis>& looks() const { return looks_; }
  const Snapshot& last() const { return *last_; }
  const DynamicModel& model() const { return *model_; }
  const Estimator& estimator() const { return *estimator_; }
  double Value(const std::string& name) const { return last_->values[model_->IndexOf(name)]; }
  double Sigma(const std::string& name) const { return last_->sigma[model_->IndexOf(name)]; }

 private:
  void Step() {
    while (true) {
      const Snapshot* const snapshot = estimator_->Step();
      if (!estimator_->made_progress()) return;
      watch_.SetAirborne(estimator_->last_keyframe_stamp(), estimator_->airborne());
      if (!snapshot) continue;
      watch_.SetEstimate(model_, snapshot->values, estimator_->start());
      last_ = *snapshot;
    }
  }

  const FlightLog& log_;
  testing_support::FlightFeed feed_;
  Vehicle declared_;
  EstimatorOptions estimator_options_ = OfflineOptions();
  ResidualWatch watch_;
  std::shared_ptr<const DynamicModel> model_;
  std::unique_ptr<Estimator> estimator_;
  std::optional<Snapshot> last_;
  std::vector<ResidualAnalysis> looks_;
};

ResidualWatchOptions Often() {
  ResidualWatchOptions options;
  options.residual_watch_period_s = 2.0;
  return options;
}

std::string Text(const ResidualAnalysis& look) {
  return "share " + std::to_string(look.structured_share) + " p " +
         std::to_string(look.whiteness_p) + " " + look.channel + " " +
         (look.candidate ? look.candidate->name + " " + std::to_string(look.candidate->score)
                         : std::string("none")) +
         " explains " + std::to_string(look.explained_share);
}

TEST(ResidualWatch, NamesTheMissingEffectAndTheEstimatorCarriesOnWithIt) {
  const UndeclaredFlight flight = Fly({"quadratic_drag"}, "aggressive", 12);
  const double truth = flight.truth.Find("quadratic_drag.c_q")->value;
  Pilot pilot(flight, Often());
  pilot.FlyUntil(19.0);  // of the first ten seconds a tilt of rotors tells as much
  ASSERT_GE(pilot.looks().size(), 3u);
  const ResidualAnalysis look = pilot.looks().back();
  ASSERT_TRUE(look.candidate.has_value()) << Text(look);
  EXPECT_EQ(look.candidate->name, "quadratic_drag") << Text(look);
  EXPECT_GE(look.in_a_row, 3) << Text(look);
  EXPECT_TRUE(look.structured) << Text(look);
  EXPECT_GT(look.structured_share, 0.3) << Text(look);
  EXPECT_GT(look.explained_share, 0.5) << Text(look);
  EXPECT_LT(look.candidate->p_value, CloseLoopOptions().attribution.false_alarm_rate);
  EXPECT_NEAR(look.candidate->parameters.front().value, truth, 0.1 * truth);
  EXPECT_GT(look.force_rmse_N.minCoeff(), 0.0);
  EXPECT_GT(look.flight_s, 10.0);
  EXPECT_LT(look.flight_s, Often().residual_watch_window_s);

  // The drag stood in for it and is wrong by many sigmas now.
  const Snapshot before = pilot.last();
  const double d_x = flight.truth.Find("drag.d_x")->value;
  const double was_wrong = std::abs(pilot.Value("drag.d_x") - d_x);
  EXPECT_GT(was_wrong, 5.0 * pilot.Sigma("drag.d_x"));
  const long keyframes = pilot.estimator().counters().keyframes;
  pilot.Add(look);
  pilot.FlyUntil(19.1);
  EXPECT_GT(pilot.last().time_s, before.time_s) << "flight time goes on";
  EXPECT_LT(pilot.last().time_s, before.time_s + 0.2) << "and at once";
  EXPECT_GT(pilot.estimator().counters().keyframes, keyframes);
  EXPECT_EQ(pilot.estimator().counters().gaps, 0);
  EXPECT_TRUE(pilot.last().observable[pilot.model().IndexOf("thrust.k_f")]) << "what was learned";
  pilot.FlyUntil(24.0);
  EXPECT_NEAR(pilot.Value("quadratic_drag.c_q"), truth, 0.1 * truth);
  EXPECT_TRUE(pilot.last().observable[pilot.model().IndexOf("quadratic_drag.c_q")]);
  EXPECT_LT(std::abs(pilot.Value("drag.d_x") - d_x), 0.3 * was_wrong);
  const ResidualAnalysis& after = pilot.looks().back();
  EXPECT_EQ(after.model->effect_names().back(), "quadratic_drag");
  EXPECT_FALSE(after.candidate.has_value()) << Text(after);
  EXPECT_LT(after.force_rmse_N.norm(), 0.7 * look.force_rmse_N.norm());
}

// What odometry shows of a slow effect is not lost behind a noisy accelerometer.
TEST(ResidualWatch, SeesWhatIsSlowBehindANoisyAccelerometer) {
  const auto gain = [](bool with_accelerometer) {
    const FlightLog log = FlightOfFadingThrust(with_accelerometer, 1, 23.0);
    Pilot pilot(log, VehicleWithImu(), ResidualWatchOptions());
    pilot.FlyUntil(22.0);
    double most = 0.0;
    for (const ResidualAnalysis& look : pilot.looks()) {
      if (look.candidate) most = std::max(most, look.candidate->score);
    }
    return most;
  };
  const double by_motion = gain(false);
  EXPECT_GT(by_motion, 50.0);
  EXPECT_GT(gain(true), 0.5 * by_motion);
}

TEST(ResidualWatch, NamesNothingWhenTheModelIsTheTruth) {
  for (const char* trajectory : {"octo", "aggressive"}) {
    const UndeclaredFlight flight = Fly({}, trajectory, 11);
    Pilot pilot(flight, Often());
    pilot.FlyUntil(24.0);
    EXPECT_GE(pilot.looks().size(), 5u);
    for (const ResidualAnalysis& look : pilot.looks()) {
      EXPECT_FALSE(look.candidate.has_value()) << Text(look);
      EXPECT_FALSE(look.structured) << Text(look);
      EXPECT_EQ(look.in_a_row, 0);
    }
  }
}

TEST(ResidualWatch, WarmStartWidensWhatTheEffectMoves) {
  ResidualAnalysis look;
  look.candidate = RankedEffect();
  look.candidate->name = "quadratic_drag";
  look.candidate->parameters = {{"quadratic_drag.c_q", "kg/m", 0.03, 0.001, true, true}};
  look.refitted = {{"drag.d_x", -0.2}, {"thrust.k_f", 1.5e-6}};
  ParameterSet present;
  present.parameters = {{"drag.d_x", "N s/m", -0.5, 0.03, true, true},
                        {"thrust.k_f", "N s^2", 1.5e-6, 2e-9, true, true},
                        {"rotor_torque.k_m", "N m s^2", 2e-8, 0.0, false, false}};
  const Vehicle warm = WarmStarted(
      VehicleWith(NominalVehicle(), EffectCandidate{"quadratic_drag", {}}), present, look);
  EXPECT_EQ(warm.effects.back(), "quadratic_drag");
  EXPECT_EQ(*warm.parameters.at("drag.d_x").value, -0.5) << "starts where it is";
  EXPECT_NEAR(*warm.parameters.at("drag.d_x").sigma, std::hypot(0.03, 0.3), 1e-12);
  EXPECT_NEAR(*warm.parameters.at("thrust.k_f").sigma, 2e-9, 1e-15);
  EXPECT_FALSE(*warm.parameters.at("rotor_torque.k_m").estimated);
  EXPECT_EQ(*warm.parameters.at("quadratic_drag.c_q").value, 0.03);
  EXPECT_FALSE(warm.parameters.at("quadratic_drag.c_q").sigma) << "the catalogue's";
}

// ---- The buffer --------------------------------------------------------------------------------

/// A watch that is fed with something like hover.
class ResidualWatchBuffer : public ::testing::Test {
 protected:
  static constexpr double kRate_Hz = 100.0;

  void Feed(ResidualWatch* watch, double from_s, double to_s, bool airborne = true) {
    for (int i = static_cast<int>(from_s * kRate_Hz); i < static_cast<int>(to_s * kRate_Hz); ++i) {
      const Stamp stamp = FromSeconds(i / kRate_Hz);
      OdometrySample odometry;
      odometry.stamp = stamp;
      odometry.p_WS = {0.1 * std::sin(0.02 * i), 0.05 * std::cos(0.013 * i), 1.0};
      odometry.v_WS = Eigen::Vector3d(0.2 * std::cos(0.02 * i), 0.0, 0.0) + Noise(0.02);
      odometry.w_WS_S = Noise(0.01);
      RotorSample rotors;
      rotors.stamp = stamp;
      rotors.speed = RotorVector::Constant(4, 1100.0) + RotorVector::Constant(4, Noise(2.0).x());
      watch->Add(rotors);
      watch->Add(odometry);
      watch->SetAirborne(stamp, airborne);
    }
    watch->SetEstimate(model_, model_->InitialValues(), 0);
  }

  Eigen::Vector3d Noise(double sigma) {
    return sigma * Eigen::Vector3d(random_.Next(), random_.Next(), random_.Next());
  }

  Gaussian random_{1, 0};
  Vehicle vehicle_ = NominalVehicle();
  std::shared_ptr<const DynamicModel> model_ =
      std::make_shared<DynamicModel>(vehicle_, vehicle_.effects);
};

TEST_F(ResidualWatchBuffer, HoldsNoMoreThanItsWindow) {
  ResidualWatch watch(vehicle_, ResidualWatchOptions(), true);
  const auto most = static_cast<size_t>(3.0 * 21.0 * kRate_Hz);
  Feed(&watch, 0.0, 120.0);  // nobody looks
  EXPECT_LT(watch.size(), most);
  ASSERT_TRUE(watch.Look().has_value());
  Feed(&watch, 120.0, 126.0);
  ASSERT_TRUE(watch.Look().has_value());
  EXPECT_LT(watch.size(), most);
}

TEST_F(ResidualWatchBuffer, LooksOncePerPeriodAndOnlyWhileFlying) {
  ResidualWatch watch(vehicle_, ResidualWatchOptions(), true);
  Feed(&watch, 0.0, 8.0);
  EXPECT_FALSE(watch.Look().has_value()) << "too little flight";
  Feed(&watch, 8.0, 14.0);
  const std::optional<ResidualAnalysis> look = watch.Look();
  ASSERT_TRUE(look.has_value());
  EXPECT_NEAR(look->flight_s, 13.0, 0.3);  // less the first second
  EXPECT_NEAR(ToSeconds(look->stamp), 14.0, 0.02);
  EXPECT_FALSE(watch.Look().has_value()) << "it was just looked at";
  Feed(&watch, 14.0, 20.0, false);
  EXPECT_FALSE(watch.Look().has_value()) << "it stands";
  Feed(&watch, 20.0, 28.0);
  const std::optional<ResidualAnalysis> again = watch.Look();
  ASSERT_TRUE(again.has_value());
  EXPECT_NEAR(again->flight_s, 13.0, 0.5) << "6 of the 20 s it stood, one is the filter's";
}

TEST_F(ResidualWatchBuffer, RefusesWhatIsNotSoundAndForgetsWhenTheClockStepsBack) {
  ResidualWatch watch(vehicle_, ResidualWatchOptions(), true);
  Feed(&watch, 100.0, 118.0);
  OdometrySample bad;
  bad.stamp = FromSeconds(118.001);
  bad.p_WS.x() = std::numeric_limits<double>::quiet_NaN();
  watch.Add(bad);
  RotorSample late;
  late.stamp = FromSeconds(110.0);
  late.speed = RotorVector::Constant(4, 1e6);
  watch.Add(late);
  RotorSample wild;
  wild.stamp = FromSeconds(118.002);
  wild.speed = RotorVector::Constant(4, std::numeric_limits<double>::infinity());
  watch.Add(wild);
  const std::optional<ResidualAnalysis> look = watch.Look();
  ASSERT_TRUE(look.has_value());
  EXPECT_LT(look->force_rmse_N.norm(), 20.0);
  watch.Clear();
  Feed(&watch, 0.0, 8.0);
  EXPECT_FALSE(watch.Look().has_value()) << "of the old clock nothing counts";
  Feed(&watch, 8.0, 16.0);
  EXPECT_TRUE(watch.Look().has_value());
}

TEST_F(ResidualWatchBuffer, GivesUpWhenAskedAndIsOffAtPeriodZero) {
  ResidualWatch watch(vehicle_, ResidualWatchOptions(), true);
  Feed(&watch, 0.0, 16.0);
  EXPECT_FALSE(watch.Look([] { return true; }).has_value());
  ResidualWatchOptions options;
  options.residual_watch_period_s = 0.0;
  ResidualWatch off(vehicle_, options, true);
  Feed(&off, 0.0, 30.0);
  EXPECT_FALSE(off.Look().has_value());
  options.residual_watch_window_s = 3.0;
  EXPECT_THROW(ResidualWatch(vehicle_, options, true), std::invalid_argument);
}

}  // namespace
}  // namespace test
}  // namespace odmc
