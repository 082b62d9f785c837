#include "odmc/analysis/actuator_report.h"

#include <cmath>
#include <fstream>
#include <stdexcept>

#include "odmc/actuator/free_run.h"
#include "odmc/analysis/json.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json ParameterJson(const ActuatorParameter& p) {
  if (!p.found) return nullptr;
  return {{"value", JsonNumber(p.found->value)},
          {"sigma", JsonNumber(p.found->sigma)},
          {"unit", p.unit}};
}

// Share of the speed range, or of the mean speed, in percent; null where nothing was measured.
Json Percent(double part, double whole, bool known) {
  return known && whole > 0.0 ? JsonNumber(100.0 * part / whole) : Json(nullptr);
}

Json ErrorJson(const FreeRunError& e, bool has_time) {
  Json json;
  json["sigma_steady_rad_s"] = e.steady > 0 ? JsonNumber(e.steady_rad_s) : Json(nullptr);
  json["sigma_response_rad_s"] =
      has_time && e.response > 0 ? JsonNumber(e.response_rad_s) : Json(nullptr);
  json["steady_error_percent"] = Percent(e.steady_rad_s, e.speed_range_rad_s, e.steady > 0);
  json["response_error_percent"] =
      Percent(e.response_rad_s, e.speed_range_rad_s, has_time && e.response > 0);
  const bool measured = e.steady + e.response > 0;
  json["free_run_rms_rad_s"] = measured ? JsonNumber(e.all_rad_s) : Json(nullptr);
  json["free_run_percent_of_mean"] = Percent(e.all_rad_s, e.mean_speed_rad_s, measured);
  json["mean_speed_rad_s"] = JsonNumber(e.mean_speed_rad_s);
  json["speed_range_rad_s"] = JsonNumber(e.speed_range_rad_s);
  json["steady_samples"] = e.steady;
  json["response_samples"] = e.response;
  json["outliers"] = e.outliers;
  return json;
}

Json StandJson(const std::optional<StandFit>& fit, const char* unit) {
  if (!fit) return nullptr;
  Json offsets = Json::array();  // in the order of the files
  for (const MeasuredValue& offset : fit->offsets)
    offsets.push_back(
        {{"value", JsonNumber(offset.value)}, {"sigma", JsonNumber(offset.sigma)}, {"unit", unit}});
  return {{"offsets", offsets},
          {"rmse", JsonNumber(fit->rmse)},
          {"rows", fit->rows},
          {"outliers", fit->outliers}};
}

// "name                value", the name padded.
std::string Line(const std::string& name, const std::string& value) {
  return name + std::string(name.size() < 19 ? 19 - name.size() : 1, ' ') + value + "\n";
}

double PercentOf(double part, double whole) { return whole > 0.0 ? 100.0 * part / whole : 0.0; }

}  // namespace

std::string ActuatorReport(const ActuatorCalibration& c, const std::vector<BenchRun>& runs,
                           const std::vector<ActuatorEvaluation>& evaluations) {
  const bool has_time = c.fit.has_time;
  Json json;
  for (const ActuatorParameter& p : c.parameters) json["parameters"][p.name] = ParameterJson(p);
  const Json error = ErrorJson(c.error, has_time);
  for (const auto& [key, value] : error.items()) json[key] = value;
  json["identifiable"] = Json::array();
  for (const ActuatorParameter& p : c.parameters) {
    if (p.found) json["identifiable"].push_back(p.name);
  }
  json["lag_s"] = JsonNumber(c.fit.common.lag_s);
  json["command_unit"] = NameOf(c.fit.command_unit);
  json["uses_voltage"] = c.fit.uses_voltage;
  json["thrust_cell"] = StandJson(c.thrust, "N");
  json["torque_cell"] = StandJson(c.torque, "N m");
  json["step_times_s"] = c.fit.step_times_s;
  for (const MotorFit& motor : c.fit.motors) {
    Json one;
    for (const ActuatorParameter& p : motor.parameters)
      one["parameters"][p.name] = ParameterJson(p);
    one["error"] = ErrorJson(motor.error, has_time);
    one["lag_s"] = JsonNumber(motor.lag_s);
    json["motors"].push_back(one);
  }
  for (const BenchRun& run : runs) {
    json["files"].push_back({{"file", run.file},
                             {"rows", run.rows},
                             {"zero_speed", run.zero_speed},
                             {"dropped", run.dropped}});
  }
  json["evaluated"] = Json::array();
  for (const ActuatorEvaluation& evaluation : evaluations) {
    Json one = {{"file", evaluation.file}, {"motors", Json::array()}};
    for (const FreeRunError& e : evaluation.motors) one["motors"].push_back(ErrorJson(e, has_time));
    json["evaluated"].push_back(one);
  }
  json["warnings"] = c.warnings;
  return JsonText(json);
}

std::string ActuatorTable(const ActuatorCalibration& c,
                          const std::vector<ActuatorEvaluation>& evaluations) {
  std::string text;
  for (const ActuatorParameter& p : c.parameters) {
    text +=
        Line(p.name, p.found ? Format("%12.5g +- %-9.2g ", p.found->value, p.found->sigma) + p.unit
                             : "not identifiable from these runs");
  }
  const FreeRunError& e = c.error;
  const char* of_range = "%8.2f rad/s, %5.2f %% of the speed range";
  text += Line("steady error",
               Format(of_range, e.steady_rad_s, PercentOf(e.steady_rad_s, e.speed_range_rad_s)));
  if (c.fit.has_time) {
    text += Line("response error", Format(of_range, e.response_rad_s,
                                          PercentOf(e.response_rad_s, e.speed_range_rad_s)));
    if (c.fit.common.lag_s)
      text += Line("correlation lag", Format("%8.1f ms", 1e3 * *c.fit.common.lag_s));
  }
  for (const ActuatorEvaluation& evaluation : evaluations) {
    for (size_t j = 0; j < evaluation.motors.size(); ++j) {
      const FreeRunError& m = evaluation.motors[j];
      text += Line("held out, motor " + std::to_string(j + 1),
                   Format("%8.2f rad/s, %5.2f %% of the mean speed, ", m.all_rad_s,
                          PercentOf(m.all_rad_s, m.mean_speed_rad_s)) +
                       evaluation.file);
    }
  }
  for (const std::string& warning : c.warnings) text += "note: " + warning + "\n";
  return text;
}

void WriteFreeRuns(const ActuatorCalibration& c, const std::vector<BenchRun>& runs,
                   const std::string& file) {
  std::ofstream stream(file);
  stream << "file,motor,t_s,command,voltage_V,measured_rad_s,predicted_rad_s,phase\n";
  const auto cell = [](double value) {
    return std::isfinite(value) ? FormatNumber(value) : std::string();
  };
  for (const BenchRun& run : runs) {
    if (!HasSpeeds(run)) continue;
    for (int j = 0; j < run.num_motors(); ++j) {
      const MotorFit& fit = c.fit.motors[c.fit.motors.size() == 1 ? 0 : static_cast<size_t>(j)];
      MotorSignal signal = SignalOf(run, j, c.fit.uses_voltage);
      std::vector<double> held;
      const std::vector<double> speed = FreeRun(fit.motor, signal, &held);
      for (size_t i = 0; i < speed.size(); ++i) {
        const bool steady =
            std::abs(held[i] - speed[i]) <= kSteadyShare * fit.error.speed_range_rad_s;
        stream << run.file << ',' << j + 1 << ',' << (signal.t_s.empty() ? "" : cell(signal.t_s[i]))
               << ',' << cell(CommandOf(signal.throttle[i], run.command_unit)) << ','
               << (run.voltage_V.empty() ? "" : cell(run.voltage_V[i])) << ','
               << cell(signal.speed_rad_s[i]) << ',' << cell(speed[i]) << ','
               << (steady ? "steady" : "response") << '\n';
      }
    }
  }
  stream.close();
  if (!stream) throw std::runtime_error(file + ": cannot be written");
}

}  // namespace odmc
