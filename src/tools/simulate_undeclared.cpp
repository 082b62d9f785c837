#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "odmc/analysis/parallel.h"
#include "odmc/analysis/report.h"
#include "odmc/attribution/undeclared.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/parameters_yaml.h"
#include "tool_support.h"

namespace {

using Json = nlohmann::ordered_json;

std::string FlightName(int number) {
  char name[32];
  std::snprintf(name, sizeof name, "flight_%03d", number);
  return name;
}

const char* KindName(odmc::Undeclared kind) {
  switch (kind) {
    case odmc::Undeclared::kNothing:
      return "nothing";
    case odmc::Undeclared::kNotExcited:
      return "not_excited";
    case odmc::Undeclared::kOneEffect:
      return "one_effect";
    case odmc::Undeclared::kTwoEffects:
      return "two_effects";
    default:
      return "unknown";
  }
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
  std::string folder;
  app.add_option("--seed", seed, "of all randomness")->required()->check(tools::NotNegative());
  app.add_option("--flights", flights, "number of flights")
      ->capture_default_str()
      ->check(tools::Positive());
  app.add_option("--jobs", jobs, "flights at a time")
      ->capture_default_str()
      ->check(tools::Positive());
  tools::AddFolder(&app, &folder);
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const std::string input = tools::In(folder, "input");
    tools::MakeFolder(input);
    for (const Vehicle& vehicle : UndeclaredVehicles()) {
      WriteText(FormatVehicle(vehicle), tools::In(input, "vehicle_" + vehicle.name + ".yaml"));
    }
    const std::vector<UndeclaredPlan> plans = PlanUndeclared(seed, flights);
    std::vector<Json> manifest(plans.size()), truth(plans.size());
    tools::ProgressBar bar("simulating");
    const auto make = [&](int i) {
      const UndeclaredFlight made = MakeUndeclared(plans[i]);
      const std::string name = FlightName(plans[i].number);
      WriteFlightCsv(made.log, tools::In(input, name + ".csv"));
      manifest[i] = {{"flight", name},
                     {"file", name + ".csv"},
                     {"vehicle", "vehicle_" + made.declared.name + ".yaml"}};
      Json parameters = Json::object();
      for (const ParameterEstimate& p : made.truth.parameters) {
        parameters[p.full_name] = p.value;
      }
      truth[i] = {{"flight", name},
                  {"kind", KindName(made.plan.kind)},
                  {"right_answer", made.right_answer},
                  {"effects", made.plan.effects},
                  {"strength", made.plan.strength},
                  {"share", made.share},
                  {"axis_share", made.axis_share},
                  {"trajectory", made.plan.trajectory},
                  {"parameters", parameters}};
    };
    ForEachOf(static_cast<int>(plans.size()), jobs, make, [&](double share) { bar.Show(share); });
    WriteText(Json(manifest).dump(2) + "\n", tools::In(input, "manifest.json"));
    WriteText(Json(truth).dump(2) + "\n", tools::In(folder, "truth.json"));
    std::cout << plans.size() << " flights in " << input << "\n";
  });
}
