#include "odmc/analysis/json.h"

#include <cmath>

namespace odmc {

using Json = nlohmann::ordered_json;

Json JsonNumber(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json JsonNumber(const std::optional<double>& value) {
  return value ? JsonNumber(*value) : Json(nullptr);
}

Json JsonAxes(const std::optional<Eigen::Vector3d>& value) {
  if (!value) return nullptr;
  return Json::array({JsonNumber(value->x()), JsonNumber(value->y()), JsonNumber(value->z())});
}

std::string JsonText(const Json& json) {
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace odmc
