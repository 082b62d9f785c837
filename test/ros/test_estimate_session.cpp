#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "odmc/ros/estimate_session.h"
#include "odmc/ros/estimate_trust.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr char kEffect[] = "quadratic_drag";

EstimatorNodeSetup MakeSetup() {
  EstimatorNodeSetup setup;
  setup.vehicle = test::NominalVehicle();
  return setup;
}

FlightLog Flight() {
  const DynamicModel flown(test::NominalVehicle(), test::PaperEffects());
  SimulationOptions options;
  options.duration_s = 6.0;
  options.log_rate_hz = 200.0;
  return Simulate(flown, DefaultTruth(flown), options, SimulationNoise()).log;
}

/// A session that is given a flight bit by bit, as the node does.
class EstimateSessionTest : public testing::Test {
 protected:
  EstimateSessionTest() { session_.Start(true); }

  /// The samples that come until `time_s`.
  void FeedUntil(double time_s) {
    const auto feed = [&](const auto& samples, size_t* next) {
      const Stamp end = log_.odometry.front().stamp + FromSeconds(time_s);
      for (; *next < samples.size() && samples[*next].stamp <= end; ++*next) {
        session_.estimator().Add(samples[*next]);
      }
    };
    feed(log_.rotors, &next_rotors_);
    feed(log_.odometry, &next_pose_);
  }

  /// @returns new estimates
  int FlyUntil(double time_s) {
    FeedUntil(time_s);
    int taken = 0;
    while (true) {
      const Snapshot* const snapshot = session_.Step();
      if (!session_.estimator().made_progress()) return taken;
      if (snapshot != nullptr) {
        session_.Take(*snapshot);
        ++taken;
      } else if (session_.last() != nullptr) {
        session_.KeepLast();
      }
    }
  }

  ResidualAnalysis Found() const {
    ResidualAnalysis look;
    look.model = session_.model();
    look.candidate = RankedEffect();
    look.candidate->name = kEffect;
    look.candidate->parameters = {{"quadratic_drag.c_q", "kg/m", 0.03, 0.001, true, true}};
    look.in_a_row = 2;
    return look;
  }

  bool HasEffect() const {
    const std::vector<std::string>& effects = session_.vehicle().effects;
    return std::count(effects.begin(), effects.end(), kEffect) > 0;
  }

  const EstimatorNodeSetup setup_ = MakeSetup();
  const FlightLog log_ = Flight();
  EstimateSession session_{&setup_};
  size_t next_rotors_ = 0, next_pose_ = 0;
};

TEST_F(EstimateSessionTest, LearnsNothingWhileItIsFrozen) {
  ASSERT_GT(FlyUntil(2.0), 0);
  const ModelValues before = session_.last()->values;
  const Stamp stamp = session_.last()->stamp;
  session_.Freeze(true);
  EXPECT_EQ(FlyUntil(3.0), 0);
  EXPECT_EQ(session_.last()->values, before);
  EXPECT_GT(session_.last()->stamp, stamp);  // it still stands
  session_.Freeze(false);
  EXPECT_GT(FlyUntil(4.0), 0);
}

TEST_F(EstimateSessionTest, AddsWhatWasFoundUntilItIsReset) {
  ASSERT_GT(FlyUntil(3.0), 0);
  const ResidualAnalysis found = Found();
  ASSERT_TRUE(session_.Extend(found, true));
  EXPECT_TRUE(HasEffect());
  EXPECT_FALSE(session_.Extend(found, true)) << "was found about the model before";
  ASSERT_GT(FlyUntil(4.0), 0);
  EXPECT_EQ(session_.ToSave().provenance.at("added_in_flight"), kEffect);
  session_.Reset(true);
  EXPECT_FALSE(HasEffect());
  EXPECT_EQ(session_.last(), nullptr);
  EXPECT_EQ(session_.ObjectionToAccepting(), "nothing is estimated yet");
}

TEST_F(EstimateSessionTest, AddsNothingToAnEstimateThatIsForgotten) {
  ASSERT_GT(FlyUntil(2.0), 0);
  session_.estimator().StartAnew();
  FeedUntil(2.1);
  session_.Step();
  EXPECT_EQ(session_.last(), nullptr);
  EXPECT_FALSE(session_.Extend(Found(), true));
  EXPECT_FALSE(HasEffect());
}

/// An estimate of one parameter that is not known well, and a rotor whose reading may be off.
class EstimateTrustTest : public testing::Test {
 protected:
  EstimateTrustTest() {
    snapshot_.values = model_->InitialValues();
    const auto n = snapshot_.values.size();
    snapshot_.sigma = Eigen::VectorXd::Zero(n);
    snapshot_.inflation = Eigen::VectorXd::Ones(n);
    snapshot_.observable.assign(static_cast<size_t>(n), true);
    snapshot_.covariance = Eigen::MatrixXd::Zero(n, n);
    snapshot_.sigma[k_f_] = 3e-9;
    snapshot_.covariance(k_f_, k_f_) = 9e-18;
  }

  /// @param change of k_f without the error
  void Doubt(double change) {
    BackgroundAnalysis::StreamsFound found;
    found.model = model_;
    found.inspection.doubts = {{"rotor_speeds", 0.0, 0.95, 1}};
    found.changes = {Eigen::VectorXd::Unit(snapshot_.values.size(), k_f_) * change};
    trust_.Adopt(std::move(found));
  }

  Snapshot Widened() {
    Snapshot snapshot = snapshot_;
    trust_.Widen(model_, &snapshot);
    return snapshot;
  }

  const std::shared_ptr<const DynamicModel> model_ =
      std::make_shared<DynamicModel>(test::NominalVehicle(), test::PaperEffects());
  const int k_f_ = model_->IndexOf("thrust.k_f");
  Snapshot snapshot_;
  EstimateTrust trust_;
};

TEST_F(EstimateTrustTest, SaysWhatADoubtMakesOfASigma) {
  Doubt(4e-9);
  EXPECT_TRUE(trust_.findings().empty());  // no estimate yet
  for (int i = 0; i < 2; ++i) {
    EXPECT_NEAR(Widened().sigma[k_f_], 5e-9, 1e-15);
    ASSERT_EQ(trust_.findings().size(), 1u);
    EXPECT_EQ(trust_.findings()[0].what,
              "the recording does not exclude an error (speed of rotor 2: 5 % too small), which is "
              "a large part of sigma of thrust.k_f");
    EXPECT_EQ(trust_.findings()[0].leaves, Trust::kGood);
  }
}

TEST_F(EstimateTrustTest, ADoubtThatIsNotFiniteWidensNothing) {
  Doubt(std::numeric_limits<double>::quiet_NaN());
  EXPECT_EQ(Widened().sigma, snapshot_.sigma);
}

TEST_F(EstimateTrustTest, ARemarkEndsWithItsDoubtAndWithItsEstimate) {
  Doubt(4e-9);
  Widened();
  Doubt(1e-9);  // next look at the streams: a tenth of the variance
  Widened();
  EXPECT_TRUE(trust_.findings().empty());
  Doubt(4e-9);
  Widened();
  trust_.ForgetEstimate();
  EXPECT_TRUE(trust_.findings().empty());
  Widened();  // the streams are as doubtful as before
  EXPECT_EQ(trust_.findings().size(), 1u);
}

}  // namespace
}  // namespace odmc
