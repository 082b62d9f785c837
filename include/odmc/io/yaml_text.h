#pragma once

#include <Eigen/Core>
#include <string>

#include "odmc/model/vehicle.h"

namespace odmc {

/// Text in double quotes, for any content.
std::string YamlQuoted(const std::string& text);

/// Numbers as FormatYamlNumber() writes them: `[1.0, 0.5]`.
std::string YamlList(const Eigen::Ref<const Eigen::VectorXd>& numbers);

/// Where a sensor sits, as vehicle files say it; the sigmas of a measured mount are left out.
std::string YamlMount(const SensorMount& mount);

}  // namespace odmc
