#include <algorithm>
#include <cmath>

#include "odmc/analysis/json.h"
#include "odmc/fleet/joint_calibration.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json FiguresJson(const PredictionFigures& f) {
  return {{"force_rmse_N", JsonAxes(f.force_rmse_N)},
          {"predicted_swing_force_rmse_N", JsonAxes(f.predicted_swing_force_rmse_N)},
          {"torque_rmse_Nm", JsonAxes(f.torque_rmse_Nm)},
          {"accelerometer_force_rmse_N", JsonAxes(f.accelerometer_force_rmse_N)},
          {"samples", f.samples}};
}

std::string Name(VehicleChange::Kind kind) {
  return kind == VehicleChange::Kind::kStep ? "step" : "trend";
}

/// By how many sigmas a flight's own estimate is off what the fleet predicts: its own noise and
/// the scatter between flights.
double ZScore(const FleetCalibration& fleet, size_t k, int parameter) {
  const FlightFactor& f = fleet.flights[static_cast<size_t>(fleet.used()[k])].factor;
  const double expected =
      fleet.joint.fit.of_flight[k][parameter] - fleet.joint.fit.own[k][parameter];
  const double sigma = std::hypot(f.sigma[parameter], fleet.joint.fit.scatter[parameter]);
  return (f.value[parameter] - expected) / sigma;
}

std::string Pad(const std::string& text, size_t width) {
  return text.size() < width ? text + std::string(width - text.size(), ' ') : text;
}

/// Root mean square over flights of one axis' error by the parameters of all others, over that by
/// the flight's own.
std::string Ratios(const std::vector<FleetFlight>& flights,
                   PredictionFigures::Axes PredictionFigures::*figure) {
  std::string text;
  for (int axis = 0; axis < 3; ++axis) {
    double others = 0.0, own = 0.0;
    for (const FleetFlight& flight : flights) {
      const auto &a = flight.left_out.*figure, &b = flight.own_fit.*figure;
      if (!a || !b) continue;
      others += std::pow((*a)[axis], 2);
      own += std::pow((*b)[axis], 2);
    }
    text += " " + (own > 0.0 ? Fixed(std::sqrt(others / own), 3) : "-");
  }
  return text;
}

Json RecurrentJson(const RecurrentResidual& r) {
  return {{"channel", kResidualChannelNames[static_cast<size_t>(r.channel)]},
          {"quantity", kResidualQuantityTable[static_cast<size_t>(r.quantity)].name},
          {"from", JsonNumber(r.from)},
          {"to", JsonNumber(r.to)},
          {"mean", JsonNumber(r.mean)},
          {"sigma", JsonNumber(r.sigma)},
          {"scatter", JsonNumber(r.scatter)},
          {"share_of_error", JsonNumber(r.share_of_error)},
          {"flights", r.flights},
          {"same_sign", r.same_sign},
          {"p_value", JsonNumber(r.p_value)}};
}

/// All bins that were looked at, the least likely by chance first; null where there are none.
Json RecurrentJson(const FleetCalibration& fleet) {
  if (fleet.recurrent.empty()) return nullptr;
  Json bins = Json::array();
  for (const RecurrentResidual& r : fleet.recurrent) bins.push_back(RecurrentJson(r));
  return {{"false_alarm_rate", JsonNumber(fleet.false_alarm_rate)},
          {"least_share_of_error", kLeastResidualShare},
          {"bins", bins}};
}

std::string RecurrentText(const RecurrentResidual& r) {
  const std::string channel = kResidualChannelNames[static_cast<size_t>(r.channel)];
  return "recurrent: " + channel + " off by " + Rounded(r.mean) + " +- " + Rounded(r.sigma, 2) +
         " where " + kResidualQuantityTable[static_cast<size_t>(r.quantity)].name + " is " +
         Rounded(r.from, 4) + " to " + Rounded(r.to, 4) + ", that sign in " +
         std::to_string(r.same_sign) + " of " + std::to_string(r.flights) + " flights (p " +
         Rounded(r.p_value, 1) + ")\n";
}

/// The largest of those that count.
std::string RecurrentTable(const FleetCalibration& fleet) {
  constexpr size_t kShown = 5;
  std::vector<RecurrentResidual> found;
  for (const RecurrentResidual& r : fleet.recurrent) {
    if (r.p_value < fleet.false_alarm_rate) found.push_back(r);
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) {
    return a.share_of_error > b.share_of_error;
  });
  std::string text;
  for (size_t k = 0; k < std::min(kShown, found.size()); ++k) text += RecurrentText(found[k]);
  if (found.size() > kShown) {
    text += "and " + std::to_string(found.size() - kShown) +
            " more in report.json (recurrent_residuals)\n";
  }
  return text;
}

Json ParametersJson(const FleetCalibration& fleet, const FlightFactor& first,
                    const DynamicModel& model) {
  const RandomEffects& fit = fleet.joint.fit;
  Json json = Json::object();
  for (int k = 0; k < first.size(); ++k) {
    const ParameterEstimate* p = fleet.parameters.Find(first.names[static_cast<size_t>(k)]);
    const int at = model.IndexOf(p->full_name);
    const bool unphysical =
        at >= 0 && IsSignUnphysical(model.parameters()[at].spec, p->value, p->sigma);
    json[p->full_name] = {{"value", JsonNumber(p->value)},
                          {"sigma", JsonNumber(p->sigma)},
                          {"scatter", JsonNumber(fit.scatter[k])},
                          {"scatter_sigma", JsonNumber(fit.scatter_sigma[k])},
                          {"new_flight_sigma", JsonNumber(std::hypot(p->sigma, p->scatter))},
                          {"degrees_of_freedom", JsonNumber(fit.degrees_of_freedom[k])},
                          {"unit", p->unit},
                          {"observable", p->observable},
                          {"sign_unphysical", unphysical}};
  }
  return json;
}

/// Files of the flights that were used.
std::vector<std::string> FilesOf(const FleetCalibration& fleet) {
  std::vector<std::string> files;
  for (const int i : fleet.used()) files.push_back(fleet.flights[static_cast<size_t>(i)].file);
  return files;
}

Json ChangesJson(const FleetCalibration& fleet, const FlightFactor& first) {
  const std::vector<std::string> files = FilesOf(fleet);
  Json json = Json::array();
  for (const VehicleChange& c : fleet.joint.changes) {
    json.push_back({{"kind", Name(c.kind)},
                    {"parameter", first.names[static_cast<size_t>(c.parameter)]},
                    {"from_flight", c.from},
                    {"from_file", files[static_cast<size_t>(c.from)]},
                    {"size", JsonNumber(c.size)},
                    {"sigma", JsonNumber(c.sigma)},
                    {"p_value", JsonNumber(c.p_value)}});
  }
  return json;
}

Json OutliersJson(const FleetCalibration& fleet, const FlightFactor& first) {
  const std::vector<std::string> files = FilesOf(fleet);
  Json json = Json::array();
  for (const OutlierFlight& o : fleet.joint.outliers) {
    json.push_back({{"flight", o.flight},
                    {"file", files[static_cast<size_t>(o.flight)]},
                    {"parameter", first.names[static_cast<size_t>(o.parameter)]},
                    {"by", JsonNumber(o.by)},
                    {"sigma", JsonNumber(o.sigma)},
                    {"p_value", JsonNumber(o.p_value)}});
  }
  return json;
}

/// @param k which of the flights that were used
Json FlightJson(const FleetCalibration& fleet, const FlightFactor& first, size_t k) {
  const FleetFlight& flight = fleet.flights[static_cast<size_t>(fleet.used()[k])];
  const RandomEffects& fit = fleet.joint.fit;
  Json of = Json::object();
  for (int p = 0; p < first.size(); ++p) {
    of[first.names[static_cast<size_t>(p)]] = {
        {"value", JsonNumber(flight.factor.value[p])},
        {"sigma", JsonNumber(flight.factor.sigma[p])},
        {"given_all", JsonNumber(fit.of_flight[k][p])},
        {"expected", JsonNumber(fit.of_flight[k][p] - fit.own[k][p])},
        {"z", JsonNumber(ZScore(fleet, k, p))}};
  }
  return {{"file", flight.file},
          {"start_s", JsonNumber(flight.factor.start_s)},
          {"duration_s", JsonNumber(flight.factor.duration_s)},
          {"passes", flight.passes},
          {"parameters", of},
          {"own_fit", FiguresJson(flight.own_fit)},
          {"left_out", FiguresJson(flight.left_out)},
          {"warnings", flight.warnings}};
}

}  // namespace

std::string FleetReport(const FleetCalibration& fleet, const DynamicModel& model) {
  const std::vector<int> used = fleet.used();
  const FlightFactor& first = fleet.flights[static_cast<size_t>(used.front())].factor;
  Json json;
  json["vehicle"] = model.vehicle().name;
  json["effects"] = model.effect_names();
  json["flights_used"] = used.size();
  json["parameters"] = ParametersJson(fleet, first, model);
  json["changes"] = ChangesJson(fleet, first);
  json["outliers"] = OutliersJson(fleet, first);
  json["recurrent_residuals"] = RecurrentJson(fleet);
  json["flights"] = Json::array();
  for (size_t k = 0; k < used.size(); ++k) json["flights"].push_back(FlightJson(fleet, first, k));
  json["failed"] = Json::array();
  for (const FleetFlight& flight : fleet.flights) {
    if (flight.failure.empty()) continue;
    json["failed"].push_back({{"file", flight.file}, {"why", flight.failure}});
  }
  return JsonText(json);
}

std::string FleetTable(const FleetCalibration& fleet) {
  const std::vector<int> used = fleet.used();
  const FlightFactor& first = fleet.flights[static_cast<size_t>(used.front())].factor;
  std::string text = std::to_string(used.size()) + " flights together\n";
  text += Pad("parameter", 26) + Pad("value", 13) + Pad("sigma", 11) + Pad("between flights", 17) +
          Pad("of one", 10) + "unit\n";
  for (int k = 0; k < first.size(); ++k) {
    const ParameterEstimate* p = fleet.parameters.Find(first.names[static_cast<size_t>(k)]);
    double own = 0.0;
    for (const int i : used)
      own += std::pow(fleet.flights[static_cast<size_t>(i)].factor.sigma[k], 2);
    own = std::sqrt(own / static_cast<double>(used.size()));
    text += Pad(p->full_name, 26) + Pad(Rounded(p->value, 5), 13) + Pad(Rounded(p->sigma), 11) +
            Pad(Rounded(fleet.joint.fit.scatter[k]), 17) + Pad(Rounded(own), 10) + p->unit +
            (p->observable ? "" : "  (hardly shown)") + "\n";
  }
  const auto place = [&](int flight) {
    return fleet.flights[static_cast<size_t>(used[static_cast<size_t>(flight)])].file;
  };
  for (const VehicleChange& c : fleet.joint.changes) {
    const std::string& name = first.names[static_cast<size_t>(c.parameter)];
    const std::string size = Rounded(c.size, 4) + " +- " + Rounded(c.sigma, 2);
    text += c.kind == VehicleChange::Kind::kStep
                ? "step: " + name + " by " + size + " from " + place(c.from) + " on"
                : "trend: " + name + " by " + size + " over all flights";
    text += " (p " + Rounded(c.p_value, 1) + ")\n";
  }
  for (const OutlierFlight& o : fleet.joint.outliers) {
    text += "outlier: " + place(o.flight) + ", " + first.names[static_cast<size_t>(o.parameter)] +
            " off by " + Rounded(o.by, 4) + " +- " + Rounded(o.sigma, 2) + " (p " +
            Rounded(o.p_value, 1) + "); not averaged in\n";
  }
  if (used.size() > 1) {
    text += "error by the parameters of all others over that of the flight's own fit (x y z):\n";
    text += "  force " + Ratios(fleet.flights, &PredictionFigures::force_rmse_N) + "\n";
    text += "  torque" + Ratios(fleet.flights, &PredictionFigures::torque_rmse_Nm) + "\n";
  }
  text += RecurrentTable(fleet);
  for (const FleetFlight& flight : fleet.flights) {
    if (!flight.failure.empty()) text += "not used: " + flight.failure + "\n";
  }
  return text;
}

std::string FleetHistoryCsv(const FleetCalibration& fleet) {
  std::string text = "flight,start_s,parameter,unit,value,sigma,given_all,expected,scatter,z\n";
  const std::vector<int> used = fleet.used();
  for (size_t k = 0; k < used.size(); ++k) {
    const FleetFlight& flight = fleet.flights[static_cast<size_t>(used[k])];
    for (int p = 0; p < flight.factor.size(); ++p) {
      const double all = fleet.joint.fit.of_flight[k][p];
      std::string file = flight.file;
      std::replace(file.begin(), file.end(), ',', '_');
      text += file + "," + FormatNumber(flight.factor.start_s) + "," +
              flight.factor.names[static_cast<size_t>(p)] + "," +
              flight.factor.units[static_cast<size_t>(p)] + "," +
              FormatNumber(flight.factor.value[p]) + "," + FormatNumber(flight.factor.sigma[p]) +
              "," + FormatNumber(all) + "," + FormatNumber(all - fleet.joint.fit.own[k][p]) + "," +
              FormatNumber(fleet.joint.fit.scatter[p]) + "," + FormatNumber(ZScore(fleet, k, p)) +
              "\n";
    }
  }
  return text;
}

}  // namespace odmc
