#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

namespace odmc {

/// A number for a report.json; null where it is not finite.
nlohmann::ordered_json JsonNumber(double value);
/// The same; null where there is none.
nlohmann::ordered_json JsonNumber(const std::optional<double>& value);

/// x, y and z; null where there is none.
nlohmann::ordered_json JsonAxes(const std::optional<Eigen::Vector3d>& value);

/// The text of a report.json. What is not UTF-8 (a file name may be) is replaced.
std::string JsonText(const nlohmann::ordered_json& json);

}  // namespace odmc
