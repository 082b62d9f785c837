#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>

#include "odmc/analysis/parallel.h"
#include "odmc/analysis/report.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/math/statistics.h"
#include "tool_support.h"

namespace {

using Json = nlohmann::ordered_json;

Json ReadJson(const std::string& file) {
  std::ifstream in(file);
  if (!in) throw std::invalid_argument("cannot read " + file);
  Json json = Json::parse(in, nullptr, false);
  if (json.is_discarded()) throw std::invalid_argument(file + " is not JSON");
  return json;
}

/// Counts of one strength.
struct Tally {
  int flights = 0, top1 = 0, top2 = 0, class_top1 = 0;
  // After/before over the best possible, on affected axes: force and angular acceleration; force
  // and torque.
  std::vector<double> over_best, over_best_torque;
};

Json Share(int count, int of) { return of == 0 ? Json(nullptr) : Json(double(count) / of); }

bool Contains(const Json& list, const std::string& name) {
  return std::find(list.begin(), list.end(), Json(name)) != list.end();
}

}  // namespace

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Runs close_loop on every flight of a folder made by simulate_undeclared and scores it "
      "against\n"
      "the answer key. Writes DIR/results/flight_NNN.json, DIR/score.json.");
  std::string folder;
  int jobs = 1;
  bool rescore = false;
  tools::EstimatorArguments estimator;
  app.add_option("DIR", folder, "folder of the set")->required();
  app.add_option("--jobs", jobs, "flights at a time")
      ->capture_default_str()
      ->check(tools::Positive());
  app.add_flag("--rescore", rescore, "use the results that are there");
  estimator.defaults = tools::AttributionEstimatorOptions();
  estimator.AddTo(&app);
  std::vector<std::string> decision;
  app.add_option("--decision", decision, "NAME=VALUE: a number of the decision (close_loop --help)")
      ->take_all()
      ->allow_extra_args(false);
  return tools::Run(&app, argc, argv, [&] {
    const std::string input = tools::In(folder, "input"), results = tools::In(folder, "results");
    const Json manifest = ReadJson(tools::In(input, "manifest.json"));
    tools::MakeFolder(results);
    CloseLoopOptions options;
    options.estimator = estimator.Read();
    try {
      for (const std::string& set : decision) SetDecision(set, &options.attribution);
    } catch (const std::invalid_argument& error) {
      throw tools::UsageError(error.what());
    }
    tools::ProgressBar bar("close_loop");
    const auto start = std::chrono::steady_clock::now();
    const auto close = [&](int i) {
      const Vehicle vehicle = LoadVehicle(tools::In(input, manifest[i]["vehicle"]));
      const FlightLog log = ReadFlightCsv(tools::In(input, manifest[i]["file"]),
                                          vehicle.num_rotors(), PoseSource::kEkf);
      ClosedLoop loop = CloseLoop(log, vehicle, vehicle, options);
      loop.parameters.provenance["decision"] = DescribeChanges(options.attribution);
      WriteText(CloseLoopReport(loop),
                tools::In(results, std::string(manifest[i]["flight"]) + ".json"));
    };
    const int flights = rescore ? 0 : static_cast<int>(manifest.size());
    ForEachOf(flights, jobs, close, [&](double share) { bar.Show(share); });
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();

    // Only from here on the answers are looked at.
    const Json truth = ReadJson(tools::In(folder, "truth.json"));
    std::map<std::string, Tally> tallies;
    int null_flights = 0, false_alarms = 0, unknown = 0, called_unexplained = 0, two = 0, both = 0;
    Json mistakes = Json::array();
    for (const Json& answer : truth) {
      const std::string name = answer["flight"];
      const Json report = ReadJson(tools::In(results, name + ".json"));
      const std::string verdict = report["verdict"], right = answer["right_answer"];
      std::vector<std::string> found;
      for (const Json& effect : report["effects"]) found.push_back(effect["name"]);
      bool correct = verdict == right;
      if (right == "none") {
        ++null_flights;
        if (verdict != "none") ++false_alarms;
      } else if (right == "unexplained") {
        ++unknown;
        if (correct) ++called_unexplained;
      } else {
        Tally& tally = tallies[answer["strength"]];
        const bool two_effects = answer["effects"].size() > 1;
        ++tally.flights;
        const bool first = !found.empty() && Contains(answer["effects"], found[0]);
        bool in_class = first, in_two = first;
        if (!found.empty()) {
          for (const Json& other : report["effects"][0]["alternatives"]) {
            in_class = in_class || Contains(answer["effects"], other);
          }
        }
        for (size_t i = 1; i < found.size() && i < 2; ++i) {
          in_two = in_two || Contains(answer["effects"], found[i]);
        }
        if (found.size() < 2 && report["ranking"].size() > 1 && !first) {
          in_two = in_two || Contains(answer["effects"], report["ranking"][1]["name"]);
        }
        tally.top1 += first;
        tally.top2 += in_two;
        tally.class_top1 += in_class;
        correct = in_class;
        if (two_effects) {
          ++two;
          int hits = 0;
          for (const std::string& f : found) hits += Contains(answer["effects"], f);
          both += hits >= 2;
        }
        const auto gather = [&](const std::string& quantity, int from, std::vector<double>* into) {
          const Json& before = report[quantity + "_rmse_before"];
          const Json& after = report[quantity + "_rmse_after"];
          for (int axis = 0; axis < 3 && verdict == "effect" && !before.is_null(); ++axis) {
            const double share = answer["axis_share"][from + axis];
            if (share < 0.25 || share > 0.99) continue;
            const double ratio = after[axis].get<double>() / before[axis].get<double>();
            into->push_back(ratio / std::sqrt(1.0 - share));
          }
        };
        gather("force", 0, &tally.over_best);
        gather("force", 0, &tally.over_best_torque);
        // The torque's own RMSE keeps the file's inertia, which no effect makes right.
        gather("angular_acceleration", 3, &tally.over_best);
        gather("torque", 3, &tally.over_best_torque);
      }
      if (!correct) {
        mistakes.push_back({{"flight", name},
                            {"right", right},
                            {"effects", answer["effects"]},
                            {"strength", answer["strength"]},
                            {"share", answer["share"]},
                            {"trajectory", answer["trajectory"]},
                            {"verdict", verdict},
                            {"found", found}});
      }
    }
    Json score;
    Json top1 = Json::object(), top2 = top1, class_top1 = top1, over = top1, over_torque = top1;
    std::printf("%-10s %8s %8s %8s %12s %16s\n", "strength", "flights", "top-1", "top-2",
                "class top-1", "after/best");
    for (const char* strength : {"strong", "medium", "weak"}) {
      const Tally& t = tallies[strength];
      top1[strength] = Share(t.top1, t.flights);
      top2[strength] = Share(t.top2, t.flights);
      class_top1[strength] = Share(t.class_top1, t.flights);
      const auto median = [](const std::vector<double>& values) {
        return values.empty() ? Json(nullptr) : Json(Median(values));
      };
      over[strength] = median(t.over_best);
      over_torque[strength] = median(t.over_best_torque);
      const double of = std::max(1, t.flights);
      std::printf("%-10s %8d %7.0f%% %7.0f%% %11.0f%% %16.2f\n", strength, t.flights,
                  100.0 * t.top1 / of, 100.0 * t.top2 / of, 100.0 * t.class_top1 / of,
                  Median(t.over_best));
    }
    std::printf("false alarms %d of %d, unexplained %d of %d, both of two effects %d of %d\n",
                false_alarms, null_flights, called_unexplained, unknown, both, two);
    score["top1"] = top1;
    score["top2"] = top2;
    score["class_top1"] = class_top1;
    score["false_alarm"] = Share(false_alarms, null_flights);
    score["unexplained_recall"] = Share(called_unexplained, unknown);
    score["after_over_before"] = over;
    score["after_over_before_with_torque_rmse"] = over_torque;
    score["both_of_two"] = Share(both, two);
    score["flights"] = truth.size();
    score["seconds"] = rescore ? Json(nullptr) : Json(seconds);
    score["mistakes"] = mistakes;
    WriteText(score.dump(2) + "\n", tools::In(folder, "score.json"));
    for (const Json& m : mistakes) std::cout << m.dump() << "\n";
  });
}
