#include <algorithm>

#include "odmc/analysis/json.h"
#include "odmc/analysis/parameters_json.h"
#include "odmc/fleet/joint_loop.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json EffectJson(const JointEffect& joint, const std::vector<std::string>& flights) {
  Json json = {{"name", joint.effect.name},
               {"score", JsonNumber(joint.effect.score)},
               {"p_value", JsonNumber(joint.effect.p_value)},
               {"probability", JsonNumber(joint.effect.probability)},
               {"alternatives", joint.effect.alternatives},
               {"flights_for", joint.speak_for},
               {"flights_against", joint.against},
               {"parameters", ParametersJson(joint.effect.parameters)}};
  if (!joint.effect.remarks.empty()) json["remarks"] = joint.effect.remarks;
  if (!joint.manoeuvre.empty()) json["told_apart_by"] = joint.manoeuvre;
  Json spreads = Json::object();
  for (const CoefficientSpread& s : joint.spreads) {
    spreads[s.full_name] = {{"mean", JsonNumber(s.mean)},           {"sigma", JsonNumber(s.sigma)},
                            {"scatter", JsonNumber(s.scatter)},     {"unit", s.unit},
                            {"flights_within_2_sigma", s.agreeing}, {"by_flight", Json::array()}};
    for (const CoefficientSpread::OfFlight& of : s.by_flight) {
      spreads[s.full_name]["by_flight"].push_back(
          {{"value", JsonNumber(of.value)}, {"sigma", JsonNumber(of.sigma)}});
    }
  }
  json["between_flights"] = spreads;
  json["by_flight"] = Json::array();
  for (size_t f = 0; f < joint.effect.by_flight.size(); ++f) {
    const FlightEvidence& says = joint.effect.by_flight[f];
    json["by_flight"].push_back({{"file", flights[f]},
                                 {"gain_nats", JsonNumber(says.nats)},
                                 {"parameters", ParametersJson(says.parameters)}});
  }
  return json;
}

Json ErrorsJson(const std::vector<FleetFlight>& before, const std::vector<FleetFlight>& after) {
  Json json = Json::array();
  for (size_t f = 0; f < std::min(before.size(), after.size()); ++f) {
    if (!before[f].failure.empty() || !after[f].failure.empty()) continue;
    const PredictionFigures &b = before[f].left_out, &a = after[f].left_out;
    json.push_back(
        {{"file", before[f].file},
         {"force_rmse_before_N", JsonAxes(b.force_rmse_N)},
         {"force_rmse_after_N", JsonAxes(a.force_rmse_N)},
         {"predicted_swing_force_rmse_before_N", JsonAxes(b.predicted_swing_force_rmse_N)},
         {"predicted_swing_force_rmse_after_N", JsonAxes(a.predicted_swing_force_rmse_N)},
         {"torque_rmse_before_Nm", JsonAxes(b.torque_rmse_Nm)},
         {"torque_rmse_after_Nm", JsonAxes(a.torque_rmse_Nm)},
         {"accelerometer_force_rmse_before_N", JsonAxes(b.accelerometer_force_rmse_N)},
         {"accelerometer_force_rmse_after_N", JsonAxes(a.accelerometer_force_rmse_N)},
         {"own_fit_force_rmse_N", JsonAxes(after[f].own_fit.force_rmse_N)},
         {"own_fit_torque_rmse_Nm", JsonAxes(after[f].own_fit.torque_rmse_Nm)}});
  }
  return json;
}

/// Rows of a table: each axis' error before, after, and their ratio; root mean square over flights.
std::string Rows(const char* name, const std::vector<FleetFlight>& before,
                 const std::vector<FleetFlight>& after,
                 PredictionFigures::Axes PredictionFigures::*of) {
  Eigen::Vector3d b = Eigen::Vector3d::Zero(), a = b;
  double n = 0.0;
  for (size_t f = 0; f < std::min(before.size(), after.size()); ++f) {
    const auto &of_b = before[f].left_out.*of, &of_a = after[f].left_out.*of;
    if (!of_b || !of_a) continue;
    b += of_b->cwiseAbs2();
    a += of_a->cwiseAbs2();
    n += 1.0;
  }
  if (n == 0.0) return "";
  b = (b / n).cwiseSqrt();
  a = (a / n).cwiseSqrt();
  std::string text;
  for (int i = 0; i < 3; ++i) {
    text += Format("%-12s %c %12.5f %12.5f %12.3f\n", i == 0 ? name : "", "xyz"[i], b[i], a[i],
                   a[i] / b[i]);
  }
  return text;
}

std::string ErrorTable(const std::vector<FleetFlight>& before,
                       const std::vector<FleetFlight>& after) {
  const auto gives_away = [](const std::vector<FleetFlight>& flights) {
    return std::any_of(flights.begin(), flights.end(),
                       [](const FleetFlight& f) { return f.left_out.GivesAway(); });
  };
  return Rows("force [N]", before, after, &PredictionFigures::force_rmse_N) +
         (gives_away(before) || gives_away(after)
              ? Rows("  own swing", before, after, &PredictionFigures::predicted_swing_force_rmse_N)
              : "") +
         Rows("torque [N m]", before, after, &PredictionFigures::torque_rmse_Nm) +
         Rows("by IMU [N]", before, after, &PredictionFigures::accelerometer_force_rmse_N);
}

}  // namespace

std::string JointLoopReport(const JointLoop& loop, const DynamicModel& model) {
  Json json = Json::parse(FleetReport(loop.after, model));
  Json found;
  found["verdict"] = NameOf(loop.verdict);
  found["effects"] = Json::array();
  for (const JointEffect& e : loop.effects) found["effects"].push_back(EffectJson(e, loop.flights));
  found["ranking"] = Json::array();
  for (const RankedEffect& r : loop.ranking) {
    Json entry = {
        {"name", r.name}, {"score", JsonNumber(r.score)}, {"p_value", JsonNumber(r.p_value)}};
    if (!r.remarks.empty()) entry["remarks"] = r.remarks;
    entry["parameters"] = ParametersJson(r.parameters);
    found["ranking"].push_back(entry);
  }
  found["effects_gain_nats"] = JsonNumber(loop.named_gain);
  found["functions_gain_nats"] = JsonNumber(loop.flexible_gain);
  found["structured_on_flights"] = Json::object();
  for (const auto& [name, count] : loop.structured) found["structured_on_flights"][name] = count;
  found["left_out_in_turn"] = ErrorsJson(loop.before.flights, loop.after.flights);
  found["held_out"] = ErrorsJson(loop.held_out_before, loop.held_out_after);
  found["warnings"] = loop.warnings;
  json["close_loop"] = found;
  return JsonText(json);
}

std::string JointLoopTable(const JointLoop& loop) {
  const std::string all = std::to_string(loop.flights.size());
  std::string text = "verdict of " + all + " flights: " + NameOf(loop.verdict) + "\n";
  for (const JointEffect& joint : loop.effects) {
    text += "  " + joint.effect.name + " (gain " + Format("%.1f", joint.effect.score) + " nats; " +
            std::to_string(joint.speak_for) + " flights for it, " + std::to_string(joint.against) +
            " against)";
    for (size_t i = 0; i < joint.effect.alternatives.size(); ++i) {
      text += (i == 0 ? ", not told from " : ", ") + joint.effect.alternatives[i];
    }
    text += "\n";
    for (const CoefficientSpread& s : joint.spreads) {
      text += Format(
          "    %-28s %12.5g +- %-10.3g %s, between flights %.2g, %d of %s within 2 sigma\n",
          s.full_name.c_str(), s.mean, s.sigma, s.unit.c_str(), s.scatter, s.agreeing, all.c_str());
    }
    for (const std::string& remark : joint.effect.remarks) text += "    " + remark + "\n";
    if (!joint.manoeuvre.empty()) text += "    would be told apart by: " + joint.manoeuvre + "\n";
  }
  text += "RMSE on each flight by the parameters of all others\n";
  text += "                     before        after  after/before\n";
  text += ErrorTable(loop.before.flights, loop.after.flights);
  if (!loop.held_out_before.empty()) {
    text += "RMSE on flights held out\n";
    text += ErrorTable(loop.held_out_before, loop.held_out_after);
  }
  for (const std::string& warning : loop.warnings) text += "warning: " + warning + "\n";
  return text;
}

std::string JointLoopCsv(const JointLoop& loop) {
  std::string text = "flight,effect,gain_nats,parameter,unit,value,sigma\n";
  for (const JointEffect& joint : loop.effects) {
    for (size_t f = 0; f < joint.effect.by_flight.size(); ++f) {
      const FlightEvidence& says = joint.effect.by_flight[f];
      std::string file = loop.flights[f];
      std::replace(file.begin(), file.end(), ',', '_');
      const std::string start =
          file + "," + joint.effect.name + "," + FormatNumber(says.nats) + ",";
      for (const CoefficientSpread& s : joint.spreads) {
        text += start + s.full_name + "," + s.unit + "," + FormatNumber(s.by_flight[f].value) +
                "," + FormatNumber(s.by_flight[f].sigma) + "\n";
      }
      for (const ParameterEstimate& p : says.parameters) {
        const bool is_shared =
            std::any_of(joint.spreads.begin(), joint.spreads.end(),
                        [&](const CoefficientSpread& s) { return s.full_name == p.full_name; });
        if (is_shared) continue;
        text += start + p.full_name + "," + p.unit + "," + FormatNumber(p.value) + "," +
                FormatNumber(p.sigma) + "\n";
      }
    }
  }
  return text;
}

}  // namespace odmc
