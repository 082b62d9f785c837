#include "odmc/attribution/close_loop_report.h"

#include <cmath>
#include <fstream>
#include <stdexcept>

#include "odmc/analysis/inspection_json.h"
#include "odmc/analysis/json.h"
#include "odmc/analysis/parameters_json.h"
#include "odmc/analysis/torque_bands_report.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

std::string Row(const char* name, const PredictionFigures::Axes& before,
                const PredictionFigures::Axes& after) {
  if (!before || !after) return "";
  std::string text;
  for (int i = 0; i < 3; ++i) {
    text += Format("%-12s %c %12.5f %12.5f %12.3f\n", i == 0 ? name : "", "xyz"[i], (*before)[i],
                   (*after)[i], (*after)[i] / (*before)[i]);
  }
  return text;
}

Json FlightJson(const FlightFigures& flight) {
  return {{"duration_s", JsonNumber(flight.duration_s)},
          {"on_ground_s", JsonNumber(flight.on_ground_s)},
          {"keyframes", flight.keyframes},
          {"dropped", flight.dropped}};
}

/// @param gain of all effects [nats]
Json EffectJson(const AddedEffect& added, double gain, const DynamicModel& model) {
  Json json = {{"name", added.effect.name},
               {"score", JsonNumber(added.effect.score)},
               {"p_value", JsonNumber(added.effect.p_value)},
               {"probability", JsonNumber(added.effect.probability)},
               {"alternatives", added.alternatives},
               {"parameters", ParametersJson(added.effect.parameters, model)}};
  json["gain_share"] = JsonNumber(added.effect.score / gain);
  for (size_t k = 0; k < added.effect.alternative_shares.size(); ++k) {
    json["alternative_shares"][added.alternatives[k]] =
        JsonNumber(added.effect.alternative_shares[k]);
  }
  if (added.effect.second_score) json["second_score"] = JsonNumber(*added.effect.second_score);
  if (!added.derived.empty()) json["derived"] = ParametersJson(added.derived);
  if (!added.manoeuvre.empty()) json["told_apart_by"] = added.manoeuvre;
  if (added.taken_off) json["taken_off_the_recording"] = true;
  return json;
}

/// ", not told from hub_moment (31 %)", and what is far less likely, where a few moments of the
/// flight make the difference.
std::string AlternativesText(const AddedEffect& added) {
  constexpr double kSmall = 0.01;
  std::vector<std::string> likely, by_moments;
  for (size_t k = 0; k < added.alternatives.size(); ++k) {
    const std::string& name = added.alternatives[k];
    const std::vector<double>& shares = added.effect.alternative_shares;
    if (k >= shares.size()) {
      likely.push_back(name);
    } else if (shares[k] < kSmall) {
      by_moments.push_back(name);
    } else {
      likely.push_back(name + " (" + Rounded(100.0 * shares[k]) + " %)");
    }
  }
  std::string text;
  if (!likely.empty()) text += ", not told from " + Listed(likely);
  if (!by_moments.empty()) text += ", ahead of " + Listed(by_moments) + " in a few moments only";
  return text;
}

Json RankedJson(const RankedEffect& ranked) {
  Json json = {{"name", ranked.name},
               {"score", JsonNumber(ranked.score)},
               {"p_value", JsonNumber(ranked.p_value)}};
  if (ranked.second_score) json["second_score"] = JsonNumber(*ranked.second_score);
  if (!ranked.remarks.empty()) json["remarks"] = ranked.remarks;
  json["parameters"] = ParametersJson(ranked.parameters);
  return json;
}

/// Adds the errors on what was held out, before and after.
void AddErrors(const ClosedLoop& loop, Json* json) {
  Json& to = *json;
  to["force_rmse_before"] = JsonAxes(loop.before.force_rmse_N);
  to["force_rmse_after"] = JsonAxes(loop.after.force_rmse_N);
  to["predicted_swing_force_rmse_before"] = JsonAxes(loop.before.predicted_swing_force_rmse_N);
  to["predicted_swing_force_rmse_after"] = JsonAxes(loop.after.predicted_swing_force_rmse_N);
  to["torque_rmse_before"] = JsonAxes(loop.before.torque_rmse_Nm);
  to["torque_rmse_after"] = JsonAxes(loop.after.torque_rmse_Nm);
  to["angular_acceleration_rmse_before"] = JsonAxes(loop.before.angular_acceleration_rmse_rad_s2);
  to["angular_acceleration_rmse_after"] = JsonAxes(loop.after.angular_acceleration_rmse_rad_s2);
  if (!loop.accelerometer_before) return;
  to["accelerometer_force_rmse_before"] = JsonAxes(loop.accelerometer_before);
  to["accelerometer_force_rmse_after"] = JsonAxes(loop.accelerometer_after);
}

Json ChannelJson(const ChannelStructure& channel) {
  Json dependence = Json::object();
  for (const auto& [name, share] : channel.dependence) dependence[name] = JsonNumber(share);
  Json json = {{"rmse", JsonNumber(channel.rmse)},
               {"unit", channel.unit},
               {"structured_share", JsonNumber(channel.whiteness.structured_share)},
               {"whiteness_p", JsonNumber(channel.whiteness.p)},
               {"sampling_share", JsonNumber(channel.whiteness.sampling_share)},
               {"peak_Hz", JsonNumber(channel.whiteness.peak_Hz)},
               {"autocorrelation_40ms", channel.autocorrelation},
               {"dependence", dependence}};
  if (channel.shared) {
    json["motion_shows"] = {{"share", JsonNumber(channel.shared->share)},
                            {"sigma", JsonNumber(channel.shared->sigma)}};
  }
  return json;
}

Json ResidualJson(const ClosedLoop& loop) {
  Json channels = Json::object();
  for (const ChannelStructure& channel : loop.structure) {
    channels[channel.name] = ChannelJson(channel);
  }
  Json json = {{"structured_share", JsonNumber(loop.structured_share)},
               {"whiteness_p", JsonNumber(loop.whiteness_p)},
               {"effects_gain_nats", JsonNumber(loop.named_gain)},
               {"functions_gain_nats", JsonNumber(loop.flexible_gain)},
               {"channels", channels}};
  if (!loop.where.empty()) json["where"] = loop.where;
  return json;
}

}  // namespace

std::string CloseLoopReport(const ClosedLoop& loop, const Vehicle& vehicle) {
  const DynamicModel model(vehicle, loop.effect_names);
  Json json;
  json["flight"] = loop.flight.file;
  json["flight_info"] = FlightJson(loop.flight);
  json["verdict"] = NameOf(loop.verdict);
  json["effects"] = Json::array();
  double gain = 0.0;
  for (const AddedEffect& added : loop.effects) gain += added.effect.score;
  for (const AddedEffect& added : loop.effects) {
    json["effects"].push_back(EffectJson(added, gain, model));
  }
  json["ranking"] = Json::array();
  for (const RankedEffect& ranked : loop.ranking) json["ranking"].push_back(RankedJson(ranked));
  AddErrors(loop, &json);
  json["rotor_torque_gain"] = JsonAxes(loop.after.rotor_torque_gain);
  json["inertia_over_nominal"] = JsonAxes(loop.after.inertia_over_nominal);
  json["inertia_by_band"] = TorqueBandsJson(loop.bands, loop.nominal_inertia);
  json["held_out"] = true;
  json["residual"] = ResidualJson(loop);
  json["provenance"] = loop.parameters.provenance;
  json["model"] = loop.effect_names;
  json["parameters"] = ParametersJson(loop.parameters.parameters, model);
  json["trust"] = Name(TrustOf(loop.findings));
  json["findings"] = FindingsJson(loop.findings);
  json["time_offsets"] = TimeOffsetsJson(loop.time_offsets);
  json["warnings"] = loop.warnings;
  return JsonText(json);
}

std::string CloseLoopTable(const ClosedLoop& loop) {
  std::string text = "verdict: " + NameOf(loop.verdict) + "\n";
  for (const AddedEffect& added : loop.effects) {
    text += "  " + added.effect.name + Format(" (gain %.1f nats)", added.effect.score);
    text += AlternativesText(added);
    text += added.taken_off ? ", taken off the recording\n" : "\n";
    std::vector<ParameterEstimate> rows = added.effect.parameters;
    rows.insert(rows.end(), added.derived.begin(), added.derived.end());
    for (const ParameterEstimate& p : rows) {
      text += Format("    %-28s %12.5g +- %-10.3g %s\n", p.full_name.c_str(), p.value, p.sigma,
                     p.unit.c_str());
    }
    if (!added.manoeuvre.empty()) text += "    would be told apart by: " + added.manoeuvre + "\n";
  }
  if (!loop.where.empty()) text += "  where: " + loop.where + "\n";
  text += Format("structured share of the residual %.2f, whiteness p %.2g\n", loop.structured_share,
                 loop.whiteness_p);
  text += "RMSE on blocks held out     before        after  after/before\n";
  text += Row("force [N]", loop.before.force_rmse_N, loop.after.force_rmse_N);
  if (loop.before.GivesAway() || loop.after.GivesAway()) {
    text += Row("  own swing", loop.before.predicted_swing_force_rmse_N,
                loop.after.predicted_swing_force_rmse_N);
  }
  text += Row("torque [N m]", loop.before.torque_rmse_Nm, loop.after.torque_rmse_Nm);
  text += Row("by IMU [N]", loop.accelerometer_before, loop.accelerometer_after);
  text += TorqueBandsTable(loop.bands, loop.nominal_inertia);
  for (const std::string& warning : loop.warnings) text += "warning: " + warning + "\n";
  return text;
}

void WriteLoopSamples(const ClosedLoop& loop, const std::string& file) {
  std::ofstream out(file);
  out << "t_s,held_out,speed_m_s";
  for (const char* when : {"before", "after"}) {
    for (const char* channel :
         {"force_x_N", "force_y_N", "force_z_N", "torque_x_Nm", "torque_y_Nm", "torque_z_Nm"}) {
      out << ',' << when << '_' << channel;
    }
  }
  out << '\n';
  for (const LoopSample& s : loop.samples) {
    out << Format("%.6f", s.t_s) << ',' << (s.held_out ? 1 : 0) << ',' << s.speed_m_s;
    for (const auto* values : {&s.before, &s.after}) {
      for (const double v : *values) {
        out << ',';
        if (std::isfinite(v)) out << v;
      }
    }
    out << '\n';
  }
  if (!out.flush()) throw std::runtime_error("cannot write " + file);
}

}  // namespace odmc
