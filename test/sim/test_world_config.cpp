#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "odmc/io/options_yaml.h"
#include "odmc/sim/world_options.h"

namespace odmc {
namespace {

const std::string kFolder = ODMC_SOURCE_DIR "/config/worlds/";

/// Text of a file's lines that set a key, comments aside.
std::vector<std::string> KeysOf(std::istream&& text) {
  std::vector<std::string> keys;
  for (std::string line; std::getline(text, line);) {
    const size_t colon = line.find(':');
    if (colon != std::string::npos && line[0] != '#') keys.push_back(line.substr(0, colon));
  }
  return keys;
}

WorldOptions Load(const std::string& name) {
  WorldOptions options;
  LoadOptions(kFolder + name, &options);
  return options;
}

TEST(WorldConfig, DefaultFileEqualsTheDefaults) {
  WorldOptions options;
  options.gust_m_s = 3.0;  // the file has to set it back
  LoadOptions(kFolder + "default.yaml", &options);
  EXPECT_EQ(FormatOptions(options), FormatOptions(WorldOptions()));
}

TEST(WorldConfig, DefaultFileListsEveryKeyInOrder) {
  EXPECT_EQ(KeysOf(std::ifstream(kFolder + "default.yaml")),
            KeysOf(std::istringstream(FormatOptions(WorldOptions()))));
}

TEST(WorldConfig, OtherFilesSetOnlyWhatDiffers) {
  const std::string defaults = FormatOptions(WorldOptions());
  for (const char* name :
       {"windy.yaml", "payload.yaml", "damaged_propeller.yaml", "cog_shift.yaml"}) {
    std::istringstream lines(FormatOptions(Load(name)));
    std::vector<std::string> differing;
    for (std::string line; std::getline(lines, line);) {
      if (defaults.find(line + "\n") != std::string::npos) continue;
      differing.push_back(line.substr(0, line.find(':')));
    }
    EXPECT_EQ(KeysOf(std::ifstream(kFolder + name)), differing) << name;
  }
}

TEST(WorldOptions, SaysWhatIsWrong) {
  WorldOptions options;
  std::string error;
  EXPECT_TRUE(options.IsValid(&error));
  options.ground_static_sink_m = 0.04;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_EQ(error, "ground_static_sink_m must be 0.001 to 0.025, not 0.04");
  options = WorldOptions();
  options.position_noise_m = -0.1;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_EQ(error, "position_noise_m must be a number of at least 0, not -0.1");
  options = WorldOptions();
  options.max_thrust_over_weight = 0.5;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_EQ(error, "max_thrust_over_weight must be 1.01 to 100, not 0.5");
  options.max_thrust_over_weight = 0.0;
  EXPECT_TRUE(options.IsValid(&error));
  options.battery_slope_V_s = std::nan("");
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_EQ(error, "battery_slope_V_s is not finite");
  options = WorldOptions();
  options.motor_S2 = 0.01;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_EQ(error, "motor_S1 must be positive where motor_S2 is");
  options = WorldOptions();
  options.payload_attach_at_s = 1.0;
  EXPECT_FALSE(options.IsValid(&error));
  EXPECT_EQ(error, "payload_kg must be positive where payload_attach_at_s is");
}

}  // namespace
}  // namespace odmc
