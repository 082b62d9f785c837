#include <fstream>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <tuple>
#include <utility>

#include "odmc/analysis/parallel.h"
#include "odmc/analysis/report.h"
#include "odmc/bench/undeclared.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/text/format.h"
#include "tool_support.h"

namespace {

using Json = nlohmann::ordered_json;

std::string FlightName(int number) { return odmc::Format("flight_%03d", number); }

const char* KindName(odmc::UndeclaredKind kind) {
  switch (kind) {
    case odmc::UndeclaredKind::kNothing:
      return "nothing";
    case odmc::UndeclaredKind::kNotExcited:
      return "not_excited";
    case odmc::UndeclaredKind::kOneEffect:
      return "one_effect";
    case odmc::UndeclaredKind::kTwoEffects:
      return "two_effects";
    default:
      return "unknown";
  }
}

const std::map<std::string, odmc::RecordingModel> kRecordings = {
    {"drawn", odmc::RecordingModel::kDrawn},
    {"white", odmc::RecordingModel::kWhite},
    {"independent", odmc::RecordingModel::kIndependent}};

Json MountJson(const odmc::SensorMount& mount) {
  const Eigen::Vector3d& p = mount.p_BS;
  const Eigen::Quaterniond& q = mount.q_BS;
  return {{"p_BS_m", {p.x(), p.y(), p.z()}}, {"q_BS_xyzw", {q.x(), q.y(), q.z(), q.w()}}};
}

Json RecordingJson(const odmc::RecordingConditions& c) {
  Json json = {{"model", NameOf(c.model)},
               {"log_rate_hz", c.log_rate_hz},
               {"pilot_bandwidth", c.pilot_bandwidth},
               {"odometry", MountJson(c.odometry)},
               {"position_m", c.noise.position_m},
               {"attitude_rad", c.noise.attitude_rad},
               {"velocity_m_s", c.noise.velocity_m_s},
               {"rate_rad_s", c.noise.rate_rad_s},
               {"rotor_speed_rad_s", c.noise.rotor_speed_rad_s},
               {"force_N", c.noise.force_N},
               {"torque_Nm", c.noise.torque_Nm},
               {"slow_velocity_m_s", c.slow_velocity_m_s},
               {"slow_time_constant_s", c.slow_time_constant_s},
               {"rotor_quantum_rad_s", c.rotor_quantum_rad_s},
               {"vibration_rad_s", c.vibration_rad_s},
               {"stamp_jitter_s", c.stamp_jitter_s}};
  if (c.imu) json["imu"] = MountJson(*c.imu);
  return json;
}

/// Writes a made flight's files. @returns its entries in the manifest and in the answer key
std::pair<Json, Json> WriteFlight(const odmc::UndeclaredFlight& made, int number,
                                  const std::string& input) {
  using namespace odmc;
  const std::string name = FlightName(number);
  WriteFlightCsv(made.log, tools::In(input, name + ".csv"));
  std::string vehicle = "vehicle_" + made.declared.name + ".yaml";
  if (made.recording.model != RecordingModel::kWhite) {  // its sensors sit elsewhere
    vehicle = "vehicle_" + name + ".yaml";
    WriteText(FormatVehicle(made.declared), tools::In(input, vehicle));
  }
  Json parameters = Json::object();
  for (const ParameterEstimate& p : made.truth.parameters) parameters[p.full_name] = p.value;
  const Json manifest = {{"flight", name}, {"file", name + ".csv"}, {"vehicle", vehicle}};
  const Json truth = {{"flight", name},
                      {"kind", KindName(made.plan.kind)},
                      {"right_answer", made.right_answer},
                      {"effects", made.plan.effects},
                      {"strength", made.plan.strength},
                      {"share", made.share},
                      {"axis_share", made.axis_share},
                      {"trajectory", made.plan.trajectory},
                      {"vehicle", made.declared.name},
                      {"recording", RecordingJson(made.recording)},
                      {"parameters", parameters}};
  return {manifest, truth};
}

std::vector<odmc::UndeclaredPlan> PlanFlights(int seed, int flights, bool nothing, bool unknown,
                                              const std::string& effect) {
  if (unknown) return odmc::PlanUnknown(seed, flights);
  if (nothing) return odmc::PlanNothing(seed, flights);
  if (!effect.empty()) return odmc::PlanOneEffect(seed, flights, effect);
  return odmc::PlanUndeclared(seed, flights);
}

}  // namespace

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Simulates flights in which something acts that the declared model lacks.\n"
      "Writes DIR/input/ (flight_NNN.csv, vehicle_*.yaml, manifest.json) and, outside it, the "
      "answer\n"
      "key DIR/truth.json.");
  int seed = 0, flights = 160, jobs = 1;
  std::string folder, recording = "drawn", effect;
  bool nothing = false, unknown = false;
  app.add_option("--seed", seed, "of all randomness")->required()->check(tools::NotNegative());
  app.add_option("--flights", flights, "number of flights")
      ->capture_default_str()
      ->check(tools::Positive());
  tools::AddJobs(&app, &jobs);
  app.add_option(
         "--recording", recording,
         "conditions of the recordings: drawn; white: white noise at 250 Hz, the body's own "
         "odometry; independent: with an IMU, as another author's simulator")
      ->capture_default_str()
      ->check(CLI::IsMember({"drawn", "white", "independent"}));
  CLI::Option* on_no_flight =
      app.add_flag("--nothing", nothing, "nothing undeclared acts on any flight");
  CLI::Option* on_every_flight =
      app.add_flag("--unknown", unknown, "something outside the catalogue acts on every flight")
          ->excludes(on_no_flight);
  app.add_option("--effect", effect,
                 "one effect on all flights: strong, medium, weak in turn (list_effects)")
      ->excludes(on_no_flight)
      ->excludes(on_every_flight);
  tools::AddFolder(&app, &folder);
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    std::vector<UndeclaredPlan> plans = PlanFlights(seed, flights, nothing, unknown, effect);
    for (UndeclaredPlan& plan : plans) plan.recording = kRecordings.at(recording);
    const std::string input = tools::In(folder, "input");
    tools::MakeFolder(input);
    for (const Vehicle& vehicle : UndeclaredVehicles()) {
      WriteText(FormatVehicle(vehicle), tools::In(input, "vehicle_" + vehicle.name + ".yaml"));
    }
    std::vector<Json> manifest(plans.size()), truth(plans.size());
    tools::ProgressBar bar("simulating");
    const auto make = [&](int i) {
      std::tie(manifest[i], truth[i]) =
          WriteFlight(MakeUndeclared(plans[i]), plans[i].number, input);
    };
    ForEachOf(static_cast<int>(plans.size()), jobs, make, [&](double share) { bar.Show(share); });
    WriteText(Json(manifest).dump(2) + "\n", tools::In(input, "manifest.json"));
    WriteText(Json(truth).dump(2) + "\n", tools::In(folder, "truth.json"));
    std::cout << plans.size() << " flights in " << input << "\n";
  });
}
