#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>

#include "odmc/analysis/model_choice.h"
#include "odmc/analysis/report.h"
#include "support/error_text.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// One parameter that steps through `values` a tenth of a second apart, with a constant sigma.
EstimateHistory HistoryOf(const std::vector<double>& values, double sigma) {
  EstimateHistory history;
  for (size_t i = 0; i < values.size(); ++i) {
    HistoryRow row;
    row.t_s = 5.0 + 0.1 * static_cast<double>(i);
    row.values = ModelValues::Constant(1, values[i]);
    row.sigma = Eigen::VectorXd::Constant(1, sigma);
    history.push_back(row);
  }
  return history;
}

TEST(Convergence, StartsWhereTheValueStaysWithinFivePercent) {
  const auto history = HistoryOf({2.0, 1.5, 1.06, 1.04, 1.0, 1.0}, 0.001);
  EXPECT_NEAR(Convergence(history, {true})[0].value(), 0.3, 1e-12);
}

TEST(Convergence, StartsAgainAfterALaterExcursion) {
  const auto history = HistoryOf({1.0, 1.0, 1.0, 1.2, 1.0, 1.0}, 0.001);
  EXPECT_NEAR(Convergence(history, {true})[0].value(), 0.4, 1e-12);
}

TEST(Convergence, AllowsOneSigmaWhereThatIsWider) {
  const auto history = HistoryOf({2.0, 1.5, 1.06, 1.04, 1.0, 1.0}, 0.6);
  EXPECT_NEAR(Convergence(history, {true})[0].value(), 0.1, 1e-12);
}

TEST(Convergence, IsZeroWhereTheStartIsRight) {
  EXPECT_EQ(Convergence(HistoryOf({1.0, 1.01, 1.0}, 0.0), {true})[0].value(), 0.0);
}

TEST(Convergence, IsMissingWhereNotObservableOrNeverFlown) {
  EXPECT_FALSE(Convergence(HistoryOf({2.0, 1.0}, 0.1), {false})[0].has_value());
  EXPECT_FALSE(Convergence({}, {true})[0].has_value());
}

TEST(Timing, CountsEveryUpdateTheStartApart) {
  ReplayResult replay;
  replay.first_airborne_s = 1.0;
  const auto add = [&](double t_s, double wall_ms, int states) {
    UpdateTiming timing;
    timing.wall_ms = wall_ms;
    timing.states = states;
    replay.timing.emplace_back(t_s, timing);
  };
  add(1.0, 40.0, 3);
  add(3.9, 50.0, 300);
  for (int i = 1; i <= 4; ++i) add(4.0 + i, i, 100);
  const TimingFigures figures = SummariseTiming(replay, &UpdateTiming::wall_ms);
  EXPECT_EQ(figures.updates, 4);
  EXPECT_DOUBLE_EQ(figures.median.value(), 2.5);
  EXPECT_DOUBLE_EQ(figures.max.value(), 4.0);
  EXPECT_EQ(StatesInWindow(replay), 100);
  const TimingFigures start = SummariseTiming(replay, &UpdateTiming::wall_ms, TimingPart::kStart);
  EXPECT_EQ(start.updates, 2);
  EXPECT_DOUBLE_EQ(start.max.value(), 50.0);
}

TEST(Timing, IsMissingWithoutUpdates) {
  const TimingFigures figures = SummariseTiming({}, &UpdateTiming::cpu_ms);
  EXPECT_EQ(figures.updates, 0);
  EXPECT_FALSE(figures.p99.has_value());
}

TEST(CalibrationReport, HasNullForWhatCannotBeHad) {
  const Vehicle vehicle = test::NominalVehicle();
  const DynamicModel model(vehicle, {"thrust", "rotor_torque"});
  Calibration c;
  c.flight.file = std::string("bad \xff name.csv");
  c.replay.last.emplace();
  c.parameters = ExactParameters(model, model.InitialValues());
  c.parameters.parameters[0].estimated = true;
  c.parameters.parameters[0].sigma = kNaN;
  c.convergence_s = {std::nullopt, std::nullopt};
  c.prediction.figures.force_rmse_N = Eigen::Vector3d(0.1, kNaN, 0.3);
  const std::string text = CalibrationReport(c, model);
  EXPECT_FALSE(testing_support::Contains(text, "nan"));
  const auto json = nlohmann::json::parse(text);
  EXPECT_TRUE(json["parameters"]["thrust.k_f"]["sigma"].is_null());
  EXPECT_EQ(json["parameters"]["rotor_torque.k_m"]["state"], "frozen");
  EXPECT_EQ(json["parameters"]["rotor_torque.k_m"]["sigma"], 0.0);
  EXPECT_TRUE(json["convergence_s"]["thrust.k_f"].is_null());
  EXPECT_TRUE(json["prediction"]["force_rmse_N"][1].is_null());
  EXPECT_EQ(json["prediction"]["force_rmse_N"][2], 0.3);
  EXPECT_TRUE(json["prediction"]["torque_rmse_Nm"].is_null());
  EXPECT_TRUE(json["timing_ms"]["p99"].is_null());
  EXPECT_EQ(json["timing_ms"]["updates"], 0);
}

TEST(CalibrationReport, TellsOfSignsThatPhysicsDoesNotAllow) {
  const DynamicModel model(test::NominalVehicle(), {"thrust", "drag"});
  Calibration c;
  c.replay.last.emplace();
  c.parameters = ExactParameters(model, model.InitialValues());
  c.convergence_s.assign(c.parameters.parameters.size(), std::nullopt);
  const auto set = [&](const char* name, double value, double sigma) {
    ParameterEstimate& p = c.parameters.parameters[static_cast<size_t>(model.IndexOf(name))];
    p.estimated = true;
    p.value = value;
    p.sigma = sigma;
  };
  set("drag.d_x", 0.04, 0.01);
  set("drag.d_y", 0.02, 0.01);  // chance does that
  set("drag.d_z", -0.04, 0.01);
  const auto json = nlohmann::json::parse(CalibrationReport(c, model))["parameters"];
  EXPECT_EQ(json["drag.d_x"]["sign_unphysical"], true);
  EXPECT_EQ(json["drag.d_y"]["sign_unphysical"], false);
  EXPECT_EQ(json["drag.d_z"]["sign_unphysical"], false);
  EXPECT_EQ(json["thrust.k_f"]["sign_unphysical"], false);
}

TEST(ModelWarnings, NameWhatIsUnphysical) {
  const DynamicModel model(test::NominalVehicle(), {"thrust", "drag", "hvt"});
  ModelValues values = model.InitialValues();
  Eigen::VectorXd sigma = Eigen::VectorXd::Constant(model.num_parameters(), 0.01);
  values[model.IndexOf("drag.d_x")] = 0.04;
  values[model.IndexOf("drag.d_y")] = 0.02;  // chance does that: two sigma from zero
  values[model.IndexOf("hvt.k_h")] = -0.04;
  PredictionFigures figures;
  figures.inertia_over_nominal = Eigen::Vector3d(1.0, 2.3, 0.4);
  figures.rotor_torque_gain = Eigen::Vector3d(0.42, 1.0, 1.0);
  figures.torque_rmse_Nm = Eigen::Vector3d(0.02, 0.01, 0.01);
  figures.zero_torque_rmse_Nm = Eigen::Vector3d(0.01, 0.02, 0.02);
  std::string all;
  for (const std::string& warning : ModelWarnings(model, values, sigma, figures)) {
    all += warning + "\n";
  }
  EXPECT_TRUE(testing_support::Contains(all, "drag.d_x"));
  EXPECT_FALSE(testing_support::Contains(all, "drag.d_y"));
  EXPECT_TRUE(testing_support::Contains(all, "hvt.k_h"));
  EXPECT_TRUE(
      testing_support::Contains(all, "inertia over nominal is outside 0.5 to 2: y 2.3, z 0.4"));
  EXPECT_TRUE(testing_support::Contains(all, "rotor torque gain is outside 0.85 to 1.15: x 0.42"));
  EXPECT_TRUE(testing_support::Contains(all, "worse than predicting zero: RMSE in N m x 0.02"));
}

TEST(ModelWarnings, AreSilentForASoundModel) {
  const DynamicModel model(test::NominalVehicle(), {"thrust", "drag"});
  EXPECT_TRUE(
      ModelWarnings(model, model.InitialValues(), Eigen::VectorXd::Zero(model.num_parameters()), {})
          .empty());
}

TEST(Configure, AppendsExtrinsicsThatTheVehicleWantsEstimated) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.odometry.estimate = true;
  ModelChoice choice;
  choice.effects = {"thrust"};
  EXPECT_EQ(Configure(vehicle, choice).effects,
            (std::vector<std::string>{"thrust", "odometry_extrinsics"}));
  choice.without = {"odometry_extrinsics"};
  EXPECT_EQ(Configure(vehicle, choice).effects, std::vector<std::string>{"thrust"});
}

TEST(Configure, FreesAndFreezesByEffectAndByName) {
  ModelChoice choice;
  choice.freeze = {"inertia", "drag.d_z"};
  choice.free = {"rotor_torque.k_m"};
  const Vehicle vehicle = Configure(test::NominalVehicle(), choice);
  const DynamicModel model(vehicle, vehicle.effects);
  const auto estimated = [&](const char* name) {
    return model.parameters()[model.IndexOf(name)].estimated;
  };
  EXPECT_FALSE(estimated("inertia.y"));
  EXPECT_FALSE(estimated("drag.d_z"));
  EXPECT_TRUE(estimated("drag.d_x"));
  EXPECT_TRUE(estimated("rotor_torque.k_m"));
  choice.free = {"imu_extrinsics"};
  ODMC_EXPECT_ERROR(Configure(test::NominalVehicle(), choice), "imu_extrinsics");
}

// Mass and k_f of a whole flight are a ratio; before a change in flight k_f is seen alone.
TEST(ModelChoice, RefusesAMassBesideThrustOnlyOverTheWholeFlight) {
  const auto refusal = [](double from_s, bool mass, bool k_f) {
    Vehicle vehicle = test::NominalVehicle();
    vehicle.effects.emplace_back("mass_change");
    vehicle.parameters["mass_change.from"].value = from_s;
    vehicle.parameters["mass_change.mass"].estimated = mass;
    vehicle.parameters["thrust.k_f"].estimated = k_f;
    return MassBesideThrust(DynamicModel(vehicle, vehicle.effects));
  };
  EXPECT_NE(refusal(0.0, true, true).find("mass_change.mass and thrust.k_f cannot both"),
            std::string::npos);
  EXPECT_EQ(refusal(12.0, true, true), "");
  EXPECT_EQ(refusal(0.0, false, true), "");
  EXPECT_EQ(refusal(0.0, true, false), "");
  const Vehicle without = test::NominalVehicle();
  EXPECT_EQ(MassBesideThrust(DynamicModel(without, without.effects)), "");
}

TEST(Configure, LetsTheParameterFileSetEffectsValuesAndStates) {
  ModelChoice choice;
  choice.parameters.emplace();
  choice.parameters->effects = {"thrust", "drag"};
  choice.parameters->parameters = {{"thrust.k_f", "N s^2", 1.7e-6, 1e-8, true, true},
                                   {"drag.d_x", "N s/m", -0.2, 0.0, false, false}};
  const Vehicle vehicle = Configure(test::NominalVehicle(), choice);
  const DynamicModel model(vehicle, vehicle.effects);
  EXPECT_EQ(model.parameters()[0].spec.prior_value, 1.7e-6);
  EXPECT_EQ(model.parameters()[0].spec.prior_sigma, 1e-8);
  EXPECT_FALSE(model.parameters()[1].estimated);
}

}  // namespace
}  // namespace odmc
