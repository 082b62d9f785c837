#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <limits>

#include "odmc/attribution/residual_watch.h"
#include "odmc/attribution/undeclared.h"
#include "odmc/estimator/estimator.h"
#include "support/error_text.h"

namespace odmc {
namespace test {
namespace {

UndeclaredFlight Fly(const std::vector<std::string>& effects, const std::string& trajectory,
                     int seed) {
  UndeclaredPlan plan;
  plan.kind = effects.empty() ? Undeclared::kNothing : Undeclared::kOneEffect;
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
      : log_(flight.log), declared_(flight.declared), watch_(flight.declared, options, true) {
    estimator_options_.keyframe_rate_hz = 50.0;
    estimator_options_.max_update_time_s = 1.0;
    model_ = std::make_shared<DynamicModel>(declared_, declared_.effects);
    estimator_ = std::make_unique<Estimator>(model_.get(), estimator_options_, true);
  }

  /// Flies on until `end_s`, looking whenever it is time.
  void FlyUntil(double end_s) {
    const Stamp end = log_.odometry.front().stamp + FromSeconds(end_s);
    for (; at_ < log_.odometry.size() && log_.odometry[at_].stamp < end; ++at_) {
      const OdometrySample& odometry = log_.odometry[at_];
      while (rotors_ < log_.rotors.size() && log_.rotors[rotors_].stamp <= odometry.stamp) {
        Feed(log_.rotors[rotors_++]);
      }
      while (imu_ < log_.imu.size() && log_.imu[imu_].stamp <= odometry.stamp) {
        Feed(log_.imu[imu_++]);
      }
      Feed(odometry);
      Step();
      if (auto look = watch_.Look()) looks_.push_back(*std::move(look));
    }
  }

  /// As the node adds an effect in flight.
  void Add(const ResidualLook& found) {
    declared_ = With(declared_, {found.candidate->name, found.candidate->settings});
    const DynamicModel declared(declared_, declared_.effects);
    const Vehicle warm = WarmStarted(declared_, Estimator::ToParameterSet(*model_, *last_), found);
    auto model = std::make_shared<DynamicModel>(warm, warm.effects);
    auto estimator = std::make_unique<Estimator>(model.get(), estimator_options_, true);
    estimator->CarryOn(*estimator_, declared);
    estimator_ = std::move(estimator);
    model_ = std::move(model);
    last_.reset();
  }

  const std::vector<ResidualLook>& looks() const { return looks_; }
  const Snapshot& last() const { return *last_; }
  const DynamicModel& model() const { return *model_; }
  const Estimator& estimator() const { return *estimator_; }
  double Value(const std::string& name) const { return last_->values[model_->IndexOf(name)]; }
  double Sigma(const std::string& name) const { return last_->sigma[model_->IndexOf(name)]; }

 private:
  template <typename Sample>
  void Feed(const Sample& sample) {
    watch_.Add(sample);
    estimator_->Add(sample);
  }

  void Step() {
    while (true) {
      const std::optional<Snapshot> snapshot = estimator_->Step();
      if (!estimator_->made_progress()) return;
      watch_.SetAirborne(estimator_->last_keyframe_stamp(), estimator_->airborne());
      if (!snapshot) continue;
      watch_.SetEstimate(model_, snapshot->values, estimator_->start());
      last_ = *snapshot;
    }
  }

  const FlightLog& log_;
  Vehicle declared_;
  EstimatorOptions estimator_options_;
  ResidualWatch watch_;
  std::shared_ptr<const DynamicModel> model_;
  std::unique_ptr<Estimator> estimator_;
  std::optional<Snapshot> last_;
  std::vector<ResidualLook> looks_;
  size_t at_ = 0, rotors_ = 0, imu_ = 0;
};

ResidualWatchOptions Often() {
  ResidualWatchOptions options;
  options.residual_watch_period_s = 2.0;
  return options;
}

std::string Text(const ResidualLook& look) {
  return "share " + std::to_string(look.structured_share) + " p " +
         std::to_string(look.whiteness_p) + " " + look.channel + " " +
         (look.candidate ? look.candidate->name + " " + std::to_string(look.candidate->score)
                         : std::string("none")) +
         " explains " + std::to_string(look.explained_share);
}

TEST(ResidualWatch, NamesTheMissingEffectWhileFlying) {
  const UndeclaredFlight flight = Fly({"quadratic_drag"}, "aggressive", 12);
  Pilot pilot(flight, Often());
  const auto began = std::chrono::steady_clock::now();
  pilot.FlyUntil(100.0);
  std::printf("%.1f s\n",
              std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count());
  for (const ResidualLook& look : pilot.looks()) std::printf("%s\n", Text(look).c_str());
  ASSERT_GE(pilot.looks().size(), 4u);
  const ResidualLook& last = pilot.looks().back();
  ASSERT_TRUE(last.candidate.has_value()) << Text(last);
  EXPECT_EQ(last.candidate->name, "quadratic_drag");
  EXPECT_TRUE(last.structured) << Text(last);
  EXPECT_GE(last.in_a_row, 3) << Text(last);
  EXPECT_GT(last.structured_share, 0.3);
  EXPECT_GT(last.explained_share, 0.5);
  EXPECT_GT(last.force_rmse_N.minCoeff(), 0.0);
  EXPECT_LE(last.flight_s, Often().residual_watch_window_s + 0.5);
}

}  // namespace
}  // namespace test
}  // namespace odmc
