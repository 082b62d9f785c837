#include "odmc/analysis/flight_inspection.h"

#include <algorithm>
#include <cmath>

#include "odmc/analysis/inspection_json.h"
#include "odmc/analysis/json.h"
#include "odmc/inspection/recording_inspection.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/model/effect.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kKeyframeRate_Hz = 25.0;
constexpr double kGap = 3.0;           // median steps
constexpr double kIqr = 1.349;         // interquartile range of a normal variable of sigma one
constexpr double kFast = 0.99;         // percentile that counts as the largest
constexpr double kVagueLag_s = 0.02;   // sigma of a delay that says nothing
constexpr double kMostLook_s = 120.0;  // of flight, for what it teaches

/// As Quantile() of math/statistics.h, but a value that occurs: the lower of two.
double OccurringQuantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

bool IsSame(const OdometrySample& a, const OdometrySample& b) { return IsSamePose(a, b); }
bool IsSame(const ImuSample& a, const ImuSample& b) {
  return a.gyro_I == b.gyro_I && a.specific_force_I == b.specific_force_I;
}
bool IsSame(const RotorSample& a, const RotorSample& b) { return a.speed == b.speed; }
template <typename Sample>
bool IsSame(const Sample&, const Sample&) {
  return false;  // a voltage or a throttle may stay
}

template <typename Sample>
void AddStream(const std::string& name, const std::vector<Sample>& samples,
               const std::vector<std::string>& holds, std::vector<StreamFigures>* streams) {
  if (samples.empty()) return;
  StreamFigures figures;
  figures.name = name;
  figures.holds = holds;
  figures.samples = static_cast<long>(samples.size());
  std::vector<double> steps;
  for (size_t i = 1; i < samples.size(); ++i) {
    steps.push_back(ToSeconds(samples[i].stamp - samples[i - 1].stamp));
    if (IsSame(samples[i], samples[i - 1])) ++figures.repeated;
  }
  if (!steps.empty()) {
    const double median = OccurringQuantile(steps, 0.5);
    figures.rate_Hz = median > 0.0 ? 1.0 / median : 0.0;
    figures.longest_gap_s = *std::max_element(steps.begin(), steps.end());
    figures.gaps = std::count_if(steps.begin(), steps.end(),
                                 [&](double step) { return step > kGap * median; });
    figures.jitter_s = (OccurringQuantile(steps, 0.75) - OccurringQuantile(steps, 0.25)) / kIqr;
  }
  streams->push_back(std::move(figures));
}

FlownFigures FlownOf(const FlightLog& log, const ReplayResult& replay) {
  FlownFigures flown;
  std::vector<double> speed, climb, rate, height;
  for (const PhaseSpan& span : replay.phases) {
    if (!Teaches(span.phase)) continue;
    flown.flight_s += ToSeconds(span.to - span.from);
    for (const OdometrySample& s : log.odometry) {
      if (s.stamp < span.from || s.stamp > span.to) continue;
      height.push_back(s.p_WS.z());
      if (s.v_WS) {
        speed.push_back(s.v_WS->norm());
        climb.push_back(std::abs(s.v_WS->z()));
      }
      if (s.w_WS_S) rate.push_back(s.w_WS_S->norm());
    }
  }
  flown.speed_m_s = OccurringQuantile(speed, kFast);
  flown.climb_m_s = OccurringQuantile(climb, kFast);
  flown.rate_rad_s = OccurringQuantile(rate, kFast);
  flown.height_range_m = OccurringQuantile(height, 0.95) - OccurringQuantile(height, 0.05);
  return flown;
}

std::string ManoeuvreFor(const DynamicModel& model, int k) {
  for (int i = 0; i < model.num_effects(); ++i) {
    if (model.effect(i).name() != model.parameters()[k].effect) continue;
    return model.effect(i).manoeuvre(static_cast<size_t>(k - model.FirstParameterOf(i)));
  }
  return "";
}

std::vector<ParameterObservability> LessonsOf(const DynamicModel& model, const Snapshot& last) {
  std::vector<ParameterObservability> lessons;
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    if (!p.estimated) continue;
    ParameterObservability lesson{p.full_name,
                                  p.spec.unit,
                                  last.values[k],
                                  last.sigma[k],
                                  p.spec.prior_sigma,
                                  last.observable[static_cast<size_t>(k)],
                                  ""};
    if (!lesson.is_shown) lesson.manoeuvre = ManoeuvreFor(model, k);
    lessons.push_back(std::move(lesson));
  }
  return lessons;
}

/// What fits of the thrust coefficient beside what the file says: mass and k_f are one in flight.
std::optional<Finding> ThrustOffTheFile(const std::vector<ParameterObservability>& lessons,
                                        const DynamicModel& model) {
  constexpr double kAbsurd = 3.0;
  constexpr double kShare = 0.1;  // a rough k_f, of a data sheet, is good to that
  for (const ParameterObservability& l : lessons) {
    if (l.full_name != "thrust.k_f") continue;
    const double file = model.InitialValues()[model.IndexOf(l.full_name)];
    const double ratio = l.value / file;
    if (std::abs(ratio - 1.0) < std::max(kShare, 3.0 * l.sigma / file)) return std::nullopt;
    return Finding{"weight", Trust::kGood,
                   "the thrust coefficient that carries the vehicle is " + Rounded(l.value) +
                       " N s^2, " + Rounded(ratio) + " times the file's",
                   "check mass_kg (" + Rounded(model.vehicle().mass_kg / ratio) +
                       " would fit the file's k_f), thrust.k_f" +
                       (ratio > kAbsurd || ratio * kAbsurd < 1.0
                            ? " or the unit of the rotor speeds (rpm for rad/s: 0.011 times)"
                            : "")};
  }
  return std::nullopt;
}

/// What is learned of a flight, and its phases; of a long one its first minutes.
void Learn(FlightLog log, const Vehicle& vehicle, FlightInspection* result) {
  const double duration_s = result->duration_s;
  if (duration_s > kMostLook_s) {
    CutFlight(0.0, kMostLook_s, &log);
    result->notes.push_back("phases and parameters are those of the first " +
                            std::to_string(static_cast<int>(kMostLook_s)) + " s");
  }
  const DynamicModel model(vehicle, vehicle.effects);
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = kKeyframeRate_Hz;
  Estimator estimator(&model, options, !log.rotor_rms_only);
  const ReplayResult replay = Replay(log, &estimator);
  result->phases = replay.phases;
  if (!replay.last) return;
  result->flown = FlownOf(log, replay);
  result->lessons = LessonsOf(model, *replay.last);
  const auto& findings = result->inspection.findings;
  const bool has = std::any_of(findings.begin(), findings.end(),
                               [](const Finding& f) { return f.check == "weight"; });
  const std::optional<Finding> thrust = ThrustOffTheFile(result->lessons, model);
  if (thrust && !has) result->inspection.findings.push_back(*thrust);
}

std::string StreamLine(const StreamFigures& s) {
  std::string line = "  " + s.name;
  line.resize(std::max<size_t>(line.size() + 1, 16), ' ');
  line += std::to_string(s.samples) + " at " + Rounded(s.rate_Hz) + " Hz";
  if (s.gaps > 0) {
    line += ", " + std::to_string(s.gaps) + (s.gaps == 1 ? " gap, of " : " gaps, the longest ") +
            Rounded(s.longest_gap_s) + " s";
  }
  if (s.rate_Hz > 0.0 && s.jitter_s * s.rate_Hz > 0.05) {
    line += ", steps spread by " + Rounded(1e3 * s.jitter_s) + " ms";
  }
  if (10 * s.repeated > s.samples)
    line += ", " + std::to_string(s.repeated) + " repeat the one before";
  if (!s.holds.empty()) line += "; with " + Listed(s.holds);
  return line + "\n";
}

std::string LessonLine(const ParameterObservability& l, bool has_value) {
  const std::string line =
      has_value ? Format("  %-24s %12.4g +- %-9.2g %-8s %s", l.full_name.c_str(), l.value, l.sigma,
                         l.unit.c_str(), l.is_shown ? "" : "hardly shown")
                : Format("  %-24s %s", l.full_name.c_str(), l.is_shown ? "shown" : "hardly shown");
  return line + (l.manoeuvre.empty() ? "" : ": fly " + l.manoeuvre) + "\n";
}

/// "found" or "guessed", with what it rests on.
std::string Mark(bool told, double probability) {
  if (told && probability > 0.9999) return "found, probability above 0.9999";
  if (told) return "found, probability " + Fixed(probability, 4);
  return probability > 0.0 ? "a guess, probability " + Fixed(probability, 3) : "a guess";
}

std::string RotorsText(const RotorGuess& rotors) {
  std::string text = "rotors that would fit, as a " + rotors.frame + "\n";
  text += "  places: " + Listed(rotors.places) + " (" +
          Mark(rotors.places_told, rotors.places_probability) + ")\n";
  text += "  spins: " + Listed(rotors.spins) + " (" +
          Mark(rotors.spins_told, rotors.spins_probability) + ")\n";
  if (rotors.hover_speed_rad_s) {
    text += "  each hovers at " + Rounded(*rotors.hover_speed_rad_s, 4) + " rad/s\n";
  }
  for (const std::string& advice : rotors.advice) text += "  note: " + advice + "\n";
  return text;
}

Json RotorsJson(const RotorGuess& rotors) {
  Json json = {{"frame", rotors.frame},
               {"places", rotors.places},
               {"places_told", rotors.places_told},
               {"places_probability", JsonNumber(rotors.places_probability)},
               {"spins", rotors.spins},
               {"spins_told", rotors.spins_told},
               {"spins_probability", JsonNumber(rotors.spins_probability)},
               {"advice", rotors.advice}};
  if (rotors.hover_speed_rad_s) json["hover_speed_rad_s"] = JsonNumber(*rotors.hover_speed_rad_s);
  return json;
}

}  // namespace

std::vector<StreamFigures> StreamsOf(const FlightLog& log) {
  std::vector<StreamFigures> streams;
  const auto any = [](const auto& samples, auto has) {
    return std::any_of(samples.begin(), samples.end(), has);
  };
  std::vector<std::string> pose, imu;
  if (any(log.odometry, [](const auto& s) { return s.v_WS.has_value(); }))
    pose.push_back("velocity");
  if (any(log.odometry, [](const auto& s) { return s.w_WS_S.has_value(); })) {
    pose.push_back("body rates");
  }
  if (any(log.imu, [](const auto& s) { return s.gyro_I.has_value(); })) imu.push_back("gyro");
  if (any(log.imu, [](const auto& s) { return s.specific_force_I.has_value(); })) {
    imu.push_back("accelerometer");
  }
  AddStream("poses", log.odometry, pose, &streams);
  AddStream("IMU", log.imu, imu, &streams);
  AddStream("rotor speeds", log.rotors, {}, &streams);
  AddStream("battery", log.battery, {}, &streams);
  AddStream("commands", log.commands, {}, &streams);
  return streams;
}

FlightInspection InspectFlight(FlightLog log, const Vehicle& vehicle) {
  FlightInspection result;
  result.file = log.file;
  result.vehicle = vehicle.name;
  result.streams = StreamsOf(log);
  result.notes = log.warnings;
  if (!log.odometry.empty()) {
    result.first_stamp = log.odometry.front().stamp;
    result.duration_s = ToSeconds(log.odometry.back().stamp - result.first_stamp);
  }
  result.inspection = InspectRecording(vehicle, &log);
  if (result.inspection.refusal.empty()) Learn(std::move(log), vehicle, &result);
  return result;
}

std::string InspectionReport(const FlightInspection& inspection) {
  Json json;
  json["flight"] = inspection.file;
  json["vehicle"] = inspection.vehicle;
  json["duration_s"] = JsonNumber(inspection.duration_s);
  json["streams"] = Json::array();
  for (const StreamFigures& s : inspection.streams) {
    json["streams"].push_back({{"name", s.name},
                               {"holds", s.holds},
                               {"samples", s.samples},
                               {"rate_Hz", JsonNumber(s.rate_Hz)},
                               {"gaps", s.gaps},
                               {"longest_gap_s", JsonNumber(s.longest_gap_s)},
                               {"jitter_s", JsonNumber(s.jitter_s)},
                               {"repeated", s.repeated}});
  }
  json["trust"] = Name(TrustOf(inspection.inspection.findings));
  json["refusal"] = inspection.inspection.refusal;
  json["findings"] = FindingsJson(inspection.inspection.findings);
  json["time_offsets"] = TimeOffsetsJson(inspection.inspection.offsets);
  json["phases"] = Json::array();
  for (const PhaseSpan& span : inspection.phases) {
    json["phases"].push_back({{"phase", Name(span.phase)},
                              {"from_s", ToSeconds(span.from - inspection.first_stamp)},
                              {"to_s", ToSeconds(span.to - inspection.first_stamp)}});
  }
  if (inspection.flown) {
    const FlownFigures& f = *inspection.flown;
    json["flown"] = {{"flight_s", JsonNumber(f.flight_s)},
                     {"speed_m_s", JsonNumber(f.speed_m_s)},
                     {"climb_m_s", JsonNumber(f.climb_m_s)},
                     {"rate_rad_s", JsonNumber(f.rate_rad_s)},
                     {"height_range_m", JsonNumber(f.height_range_m)}};
  }
  if (inspection.rotors) json["rotors"] = RotorsJson(*inspection.rotors);
  json["parameters"] = Json::object();
  for (const ParameterObservability& l : inspection.lessons) {
    Json entry = {{"unit", l.unit}, {"shown", l.is_shown}};
    if (!inspection.rotors) {
      entry["value"] = JsonNumber(l.value);
      entry["sigma"] = JsonNumber(l.sigma);
      entry["prior_sigma"] = JsonNumber(l.prior_sigma);
    }
    json["parameters"][l.full_name] = entry;
    if (!l.manoeuvre.empty()) json["parameters"][l.full_name]["manoeuvre"] = l.manoeuvre;
  }
  json["notes"] = inspection.notes;
  return JsonText(json);
}

std::string InspectionText(const FlightInspection& inspection) {
  std::string text = inspection.file + ": " + Rounded(inspection.duration_s) + " s, " +
                     (inspection.rotors ? "no vehicle file" : "vehicle " + inspection.vehicle) +
                     "\n";
  text += "streams\n";
  for (const StreamFigures& s : inspection.streams) text += StreamLine(s);
  for (const TimeOffset& offset : inspection.inspection.offsets) {
    if (!offset.lag.determined() || offset.lag.sigma_s() > kVagueLag_s) continue;
    text += "  " + offset.stream + ": " + Rounded(1e3 * offset.lag.lag_s) + " +- " +
            Rounded(1e3 * offset.lag.sigma_s(), 2) + " ms late against " + offset.against;
    if (offset.compensated_s != 0.0) {
      text += "; " + Rounded(1e3 * offset.compensated_s, 2) + " ms taken off";
    }
    text += "\n";
  }
  text += "findings\n";
  for (const Finding& f : inspection.inspection.findings) {
    text += "  " + f.check + " (" + Name(f.leaves) + "): " + Sentence(f) + "\n";
  }
  if (inspection.inspection.findings.empty()) text += "  none\n";
  if (!inspection.inspection.refusal.empty()) {
    text += "nothing sensible can be learned: " + inspection.inspection.refusal + "\n";
    return text;
  }
  if (inspection.rotors) text += RotorsText(*inspection.rotors);
  text += "phases\n";
  for (const PhaseSpan& span : inspection.phases) {
    text += "  " + span.Describe(inspection.first_stamp) + "\n";
  }
  if (!inspection.flown) {
    text +=
        "never airborne: thrust stays below the weight; check thrust.k_f, mass_kg and the unit of "
        "the rotor speeds\n";
    return text;
  }
  const FlownFigures& f = *inspection.flown;
  text += "flown: " + Rounded(f.flight_s) + " s, up to " + Rounded(f.speed_m_s) + " m/s, climb " +
          Rounded(f.climb_m_s) + " m/s, " + Rounded(f.rate_rad_s) + " rad/s, heights over " +
          Rounded(f.height_range_m) + " m\n";
  text += "what can be learned from it\n";
  for (const ParameterObservability& l : inspection.lessons) {
    text += LessonLine(l, !inspection.rotors);
  }
  for (const std::string& note : inspection.notes) text += "note: " + note + "\n";
  return text;
}

}  // namespace odmc
