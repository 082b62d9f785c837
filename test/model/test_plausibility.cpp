#include <gtest/gtest.h>

#include <algorithm>

#include "odmc/model/plausibility.h"
#include "support/error_text.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

using testing_support::Contains;

Vehicle WithInertia(double x, double y, double z) {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.inertia_kg_m2 = {x, y, z};
  return vehicle;
}

/// What is said of an inertia that was estimated beside the nominal one of (2.5, 2.1, 4.3) g m².
bool IsUnphysical(const Eigen::Vector3d& inertia, double sigma, const Vehicle& vehicle) {
  const DynamicModel model(vehicle, vehicle.effects);
  ModelValues values = model.InitialValues();
  Eigen::VectorXd sigmas = Eigen::VectorXd::Zero(model.num_parameters());
  for (int i = 0; i < 3; ++i) {
    const int at = model.IndexOf(std::string("inertia.") + "xyz"[i]);
    values[at] = inertia[i];
    sigmas[at] = sigma;
  }
  const std::vector<std::string> sentences = UnphysicalValues(model, values, sigmas);
  return std::any_of(sentences.begin(), sentences.end(), [](const std::string& sentence) {
    return Contains(sentence, "more than the other two together");
  });
}

TEST(Inertia, OfAFlatFrameIsUsedWithAWarning) {
  for (const double z : {0.0043, 0.0048, 0.0078}) {
    const Vehicle vehicle = WithInertia(0.002, 0.002, z);
    std::string error;
    EXPECT_TRUE(vehicle.IsValid(&error)) << error;
    EXPECT_TRUE(Contains(InertiaDoubt(vehicle), "triangle inequality")) << z;
  }
  EXPECT_TRUE(Contains(InertiaDoubt(WithInertia(0.002, 0.002, 0.0043)), "by 7.5 %"));
  EXPECT_EQ(InertiaDoubt(test::NominalVehicle()), "");
  EXPECT_EQ(InertiaDoubt(WithInertia(0.001, 0.002, 0.003)), "");  // flat to the last bit
  std::string error;
  EXPECT_FALSE(WithInertia(0.002, 0.002, 0.0081).IsValid(&error));
  EXPECT_TRUE(Contains(error, "triangle inequality")) << error;
}

TEST(Inertia, MustFitTheGeometry) {
  std::string error;
  EXPECT_FALSE(WithInertia(2.5, 2.1, 4.3).IsValid(&error));
  EXPECT_TRUE(Contains(error, "2.5 about x cannot be that of 0.75 kg")) << error;
  EXPECT_FALSE(WithInertia(2.5e-6, 2.1e-6, 4.3e-6).IsValid(&error));
  EXPECT_TRUE(WithInertia(0.01, 0.01, 0.02).IsValid(&error)) << error;  // four times too large
  EXPECT_TRUE(test::NanoVehicle().IsValid(&error)) << error;
}

TEST(Inertia, EstimatedOneMayBreakTheRuleByItsSigmas) {
  const Vehicle vehicle = test::NominalVehicle();
  EXPECT_FALSE(IsUnphysical({2.0e-3, 2.0e-3, 4.3e-3}, 0.0, vehicle));  // 7.5 %
  EXPECT_TRUE(IsUnphysical({1.5e-3, 1.5e-3, 4.0e-3}, 0.0, vehicle));   // 33 %
  EXPECT_TRUE(IsUnphysical({1.5e-3, 1.5e-3, 4.0e-3}, 0.1e-3, vehicle));
  EXPECT_FALSE(IsUnphysical({1.5e-3, 1.5e-3, 4.0e-3}, 0.2e-3, vehicle));
}

// A frozen one stays what the vehicle file says.
TEST(Inertia, NominalOneThatWasUsedIsNoObjection) {
  const Eigen::Vector3d flat(0.002, 0.002, 0.0065);
  EXPECT_FALSE(IsUnphysical(flat, 0.0, WithInertia(flat.x(), flat.y(), flat.z())));
  EXPECT_TRUE(IsUnphysical(flat, 0.0, test::NominalVehicle()));
}

TEST(Settings, ThatNoVehicleHasAreRefused) {
  const auto model_with = [](const std::string& name, const ParameterSetting& setting) {
    Vehicle vehicle = test::NominalVehicle();
    vehicle.parameters[name] = setting;
    return DynamicModel(vehicle, vehicle.effects);
  };
  for (const double k_f : {1e300, 1e-300, 5e-324, 1.0}) {
    ODMC_EXPECT_ERROR(model_with("thrust.k_f", {k_f, {}, {}}), "thrust.k_f.value: ");
  }
  for (const double drag : {1e300, -1e8}) {
    ODMC_EXPECT_ERROR(model_with("drag.d_x", {drag, {}, {}}), "drag.d_x.value: ");
  }
  for (const double sigma : {1e300, 1e-300, 1e-12}) {
    ODMC_EXPECT_ERROR(model_with("drag.d_x", {{}, sigma, {}}), "drag.d_x.sigma: ");
  }
  ODMC_EXPECT_ERROR(model_with("inertia.x", {2.5, {}, {}}), "inertia.x.value: 2.5 kg m^2 cannot");
  EXPECT_NO_THROW(model_with("drag.d_x", {-3.0, 1e-6, {}}));
  EXPECT_NO_THROW(model_with("inertia.x", {0.01, 1e-5, {}}));
}

}  // namespace
}  // namespace odmc
