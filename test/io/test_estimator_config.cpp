#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "odmc/estimator/options.h"
#include "odmc/io/options_yaml.h"

namespace odmc {
namespace {

constexpr char kFile[] = ODMC_SOURCE_DIR "/config/estimator.yaml";

/// Whole content of the shipped file.
std::string Text() {
  std::ifstream in(kFile);
  std::stringstream text;
  text << in.rdbuf();
  return "\n" + text.str();
}

TEST(EstimatorConfig, ShippedFileEqualsTheDefaults) {
  EstimatorOptions options;
  options.window_s = 0.5;  // the file has to set it back
  LoadOptions(kFile, &options);
  EXPECT_EQ(FormatOptions(options), FormatOptions(EstimatorOptions()));
}

TEST(EstimatorConfig, ShippedFileListsEveryKey) {
  const std::string text = Text();
  std::istringstream defaults(FormatOptions(EstimatorOptions()));
  for (std::string line; std::getline(defaults, line);) {
    const std::string key = line.substr(0, line.find(':'));
    EXPECT_NE(text.find("\n" + key + ":"), std::string::npos) << key << " is missing";
  }
}

}  // namespace
}  // namespace odmc
