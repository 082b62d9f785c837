// Parameters that follow a flight: each sample is predicted from what was before it.
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/follow_flight.h"
#include "odmc/estimator/options.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

/// A flight whose centre of gravity is 4 mm from where the parameters have it, as after a change of
/// the battery; everything else is known.
class FollowFlightOf : public ::testing::Test {
 protected:
  FollowFlightOf() : vehicle_(test::NominalVehicle()), model_(vehicle_, vehicle_.effects) {
    truth_ = DefaultTruth(model_);
    SimulationOptions simulation;
    simulation.trajectory = "aggressive";
    simulation.duration_s = 16.0;
    log_ = Simulate(model_, truth_, simulation, SimulationNoise()).log;
    known_ = vehicle_;
    for (int k = 0; k < model_.num_parameters(); ++k) {
      const ModelParameter& p = model_.parameters()[k];
      ParameterSetting& setting = known_.parameters[p.full_name];
      const double shift = p.full_name == kName ? kShift_m : 0.0;
      setting.value = truth_[k] + shift;
      setting.sigma = p.full_name == kName ? kShift_m : 1e-3 * p.spec.scale;
      setting.estimated = p.full_name != "rotor_torque.k_m";
    }
  }

  FollowedParameters Follow(const FlightLog& log, const std::vector<std::string>& names) const {
    return FollowFlight(log, known_, names, OfflineOptions());
  }

  Evaluation Evaluated(const FollowedParameters& followed) const {
    const DynamicModel model(known_, known_.effects);
    return Evaluate(log_, vehicle_, model, ParameterSet(), {}, followed);
  }

  static constexpr char kName[] = "centre_of_gravity.x";
  static constexpr double kShift_m = 4e-3;
  Vehicle vehicle_, known_;
  DynamicModel model_;
  ModelValues truth_;
  FlightLog log_;
};

constexpr char FollowFlightOf::kName[];

TEST_F(FollowFlightOf, LearnsWhatTheFlightShows) {
  const Evaluation held = Evaluated({});
  const FollowedParameters followed = Follow(log_, {kName});
  const Evaluation follows = Evaluated(followed);
  EXPECT_EQ(follows.followed, std::vector<std::string>{kName});
  // About pitch the thrust times 4 mm is missing; it takes a second of flight to learn it.
  const double before = (*held.prediction.figures.torque_rmse_Nm)[1];
  const double after = (*follows.prediction.figures.torque_rmse_Nm)[1];
  std::printf("torque about y: held %.2g, follows %.2g N m\n", before, after);
  EXPECT_LT(after, 0.4 * before);
  EXPECT_GT(before, 0.5 * kShift_m * vehicle_.mass_kg * vehicle_.gravity_m_s2);
  ModelValues values = model_.InitialValues();
  const int k = model_.IndexOf(kName);
  values[k] = 1.0;
  followed.vary(0.0, &values);
  EXPECT_EQ(values[k], 1.0) << "nothing is known before the first estimate";
  followed.vary(15.0, &values);
  EXPECT_NEAR(values[k], truth_[k], 0.2 * kShift_m);
}

TEST_F(FollowFlightOf, SeesNothingOfTheFuture) {
  FlightLog part = log_;
  const Stamp end = log_.odometry.front().stamp + FromSeconds(8.0);
  const auto cut = [&](auto* samples) {
    while (!samples->empty() && samples->back().stamp > end) samples->pop_back();
  };
  cut(&part.odometry);
  cut(&part.imu);
  cut(&part.rotors);
  const FollowedParameters whole = Follow(log_, {kName}), half = Follow(part, {kName});
  ModelValues by_whole = model_.InitialValues(), by_half = by_whole;
  // A sample is filtered from 0.05 s on either side.
  for (double t_s = 0.55; t_s < 8.06; t_s += 0.1) {
    whole.vary(t_s, &by_whole);
    half.vary(t_s, &by_half);
    ASSERT_EQ(by_whole, by_half) << t_s << " s";
  }
}

TEST_F(FollowFlightOf, AWalkingThrustComesByItself) {
  EstimatorOptions options = OfflineOptions();
  EXPECT_TRUE(FollowFlight(log_, known_, {}, options).names.empty());
  EXPECT_FALSE(FollowFlight(log_, known_, {}, options).vary);
  options.k_f_walk_rate = 0.004;
  EXPECT_EQ(FollowFlight(log_, known_, {kName}, options).names,
            (std::vector<std::string>{kName, "thrust.k_f"}));
  known_.parameters["rotor_torque.k_m"].estimated = true;
  EXPECT_EQ(FollowFlight(log_, known_, {"thrust.k_f"}, options).names,
            (std::vector<std::string>{"thrust.k_f", "rotor_torque.k_m"}));
}

TEST_F(FollowFlightOf, RefusesWhatCannotFollow) {
  const auto sentence = [&](const std::string& name) -> std::string {
    try {
      Follow(log_, {name});
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_EQ(sentence("drag.d_q")
                .find("drag.d_q cannot follow the flight: the vehicle has no such "
                      "parameter; those that can are thrust.k_f, drag.d_x"),
            0u);
  EXPECT_EQ(sentence("rotor_torque.k_m")
                .find("rotor_torque.k_m cannot follow the flight: the parameters hold it; "),
            0u);
}

}  // namespace
}  // namespace odmc
