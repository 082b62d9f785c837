#include <gtest/gtest.h>

#include "odmc/io/options_yaml.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

struct ExampleOptions {
  double window_s = 1.0;
  int iterations = 8;
  bool robust = true;
  std::string frame = "auto";
  Eigen::Vector3d sigma = Eigen::Vector3d(0.1, 0.2, 0.3);

  template <typename Visitor>
  void Visit(Visitor* visitor) {
    visitor->Field("window_s", &window_s);
    visitor->Field("iterations", &iterations);
    visitor->Field("robust", &robust);
    visitor->Field("frame", &frame);
    visitor->Field("sigma", &sigma);
  }

  bool IsValid(std::string* error) const {
    if (window_s > 0.0) return true;
    *error = "window_s must be positive";
    return false;
  }
};

class OptionsYaml : public ::testing::Test {
 protected:
  ExampleOptions Load(const std::string& text) {
    ExampleOptions options;
    LoadOptions(folder_.Write("options.yaml", text), &options);
    return options;
  }
  testing_support::TemporaryFolder folder_;
};

TEST_F(OptionsYaml, ReadsEveryType) {
  const ExampleOptions options = Load(
      "window_s: 2e0\niterations: 3\nrobust: false\nframe: world\nsigma: ['1e-6', 5e-06, 1.0e6]\n");
  EXPECT_EQ(options.window_s, 2.0);
  EXPECT_EQ(options.iterations, 3);
  EXPECT_FALSE(options.robust);
  EXPECT_EQ(options.frame, "world");
  EXPECT_EQ(options.sigma, Eigen::Vector3d(1e-6, 5e-6, 1e6));
}

TEST_F(OptionsYaml, AbsentKeysKeepTheirDefaults) {
  EXPECT_EQ(Load("iterations: 3\n").window_s, 1.0);
  EXPECT_EQ(Load("# nothing\n").iterations, 8);
}

TEST_F(OptionsYaml, RefusesWhatItDoesNotUnderstand) {
  ODMC_EXPECT_ERROR(Load("windows_s: 2.0\n"),
                    "options.yaml: windows_s: unknown key 'windows_s'; "
                    "did you mean window_s?");
  ODMC_EXPECT_ERROR(Load("window_s: long\n"), "window_s: must be a number, not 'long'");
  ODMC_EXPECT_ERROR(Load("iterations: 2.5\n"), "iterations: must be a whole number");
  ODMC_EXPECT_ERROR(Load("window_s: -1.0\n"), "options.yaml: window_s must be positive");
  ODMC_EXPECT_ERROR(Load("sigma: [1.0, 2.0]\n"), "sigma: must be three numbers");
  ODMC_EXPECT_ERROR(Load("robust: {\n"), "is not YAML");
}

TEST_F(OptionsYaml, PrintedOptionsReadBack) {
  ExampleOptions options;
  options.window_s = 1e-6;
  options.iterations = -4;
  options.frame = "body";
  const ExampleOptions back = Load(FormatOptions(options));
  EXPECT_EQ(FormatOptions(back), FormatOptions(options));
  EXPECT_TRUE(testing_support::Contains(FormatOptions(options), "window_s: 1.0e-06\n"));
}

}  // namespace
}  // namespace odmc
