#include "odmc/fleet/fleet_flight_json.h"

#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>

#include "odmc/io/parameters_yaml.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

using Json = nlohmann::json;

Json ToJson(const Eigen::MatrixXd& matrix) {
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    rows.push_back(std::vector<double>(matrix.row(i).begin(), matrix.row(i).end()));
  }
  return rows;
}

Json ToJson(const Eigen::VectorXd& vector) {
  return std::vector<double>(vector.begin(), vector.end());
}

Eigen::VectorXd VectorOf(const Json& json, Eigen::Index n) {
  const auto numbers = json.get<std::vector<double>>();
  if (static_cast<Eigen::Index>(numbers.size()) != n) {
    throw std::invalid_argument("has " + std::to_string(numbers.size()) + " numbers, not " +
                                std::to_string(n));
  }
  return Eigen::VectorXd::Map(numbers.data(), n);
}

Json ToJson(const PredictionFigures::Axes& axes) {
  return axes ? ToJson(Eigen::VectorXd(*axes)) : Json(nullptr);
}

PredictionFigures::Axes AxesOf(const Json& json) {
  if (json.is_null()) return std::nullopt;
  return Eigen::Vector3d(VectorOf(json, 3));
}

Json ToJson(const FlightFactor& factor) {
  return {{"flight", factor.flight},
          {"start_s", factor.start_s},
          {"duration_s", factor.duration_s},
          {"names", factor.names},
          {"units", factor.units},
          {"prior_value", ToJson(factor.prior_value)},
          {"prior_sigma", ToJson(factor.prior_sigma)},
          {"value", ToJson(factor.value)},
          {"sigma", ToJson(factor.sigma)},
          {"linearized_at", ToJson(factor.linearized_at)},
          {"root", ToJson(factor.root)},
          {"rhs", ToJson(factor.rhs)},
          {"estimate", FormatParameters(factor.estimate)}};
}

}  // namespace

std::string FormatFleetFlight(const FleetFlight& flight) {
  const Json json = {
      {"file", flight.file},
      {"warnings", flight.warnings},
      {"factor", ToJson(flight.factor)},
      {"own_fit",
       {{"force_rmse_N", ToJson(flight.own_fit.force_rmse_N)},
        {"torque_rmse_Nm", ToJson(flight.own_fit.torque_rmse_Nm)},
        {"accelerometer_force_rmse_N", ToJson(flight.own_fit.accelerometer_force_rmse_N)},
        {"samples", flight.own_fit.samples}}}};
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

FleetFlight ParseFleetFlight(const std::string& text, const std::string& file) {
  std::string at;
  try {
    const Json all = Json::parse(text);
    FleetFlight flight;
    flight.passes = 1;
    at = "file ";
    flight.file = all.at("file").get<std::string>();
    at = "warnings ";
    flight.warnings = all.at("warnings").get<std::vector<std::string>>();
    at = "own_fit ";
    const Json& figures = all.at("own_fit");
    flight.own_fit.force_rmse_N = AxesOf(figures.at("force_rmse_N"));
    flight.own_fit.torque_rmse_Nm = AxesOf(figures.at("torque_rmse_Nm"));
    flight.own_fit.accelerometer_force_rmse_N = AxesOf(figures.at("accelerometer_force_rmse_N"));
    flight.own_fit.samples = figures.at("samples").get<long>();
    at = "factor ";
    const Json& json = all.at("factor");
    const auto get = [&](const char* key) -> const Json& {
      at = "factor." + std::string(key) + " ";
      return json.at(key);
    };
    FlightFactor& factor = flight.factor;
    factor.flight = get("flight").get<std::string>();
    factor.start_s = get("start_s").get<double>();
    factor.duration_s = get("duration_s").get<double>();
    factor.names = get("names").get<std::vector<std::string>>();
    factor.units = get("units").get<std::vector<std::string>>();
    const Eigen::Index n = factor.size();
    if (factor.units.size() != factor.names.size()) {
      throw std::invalid_argument("does not go with names");
    }
    factor.prior_value = VectorOf(get("prior_value"), n);
    factor.prior_sigma = VectorOf(get("prior_sigma"), n);
    factor.value = VectorOf(get("value"), n);
    factor.sigma = VectorOf(get("sigma"), n);
    factor.linearized_at = VectorOf(get("linearized_at"), n);
    factor.rhs = VectorOf(get("rhs"), n);
    const Json& root = get("root");
    if (static_cast<Eigen::Index>(root.size()) != n) {
      throw std::invalid_argument("has another number of rows");
    }
    factor.root.resize(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      factor.root.row(i) = VectorOf(root[static_cast<size_t>(i)], n).transpose();
    }
    factor.estimate = ParseParameters(get("estimate").get<std::string>(), file);
    return flight;
  } catch (const std::exception& e) {
    RefuseFile(file, at + e.what());
  }
}

FleetFlight LoadFleetFlight(const std::string& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  if (!stream) RefuseFile(file, "cannot be read");
  return ParseFleetFlight(text.str(), file);
}

}  // namespace odmc
