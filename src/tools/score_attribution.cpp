#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "flight_arguments.h"
#include "model_arguments.h"
#include "odmc/analysis/parallel.h"
#include "odmc/analysis/report.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/attribution/stream_effects.h"
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

/// What a report finds, held against the answers of all flights.
class Score {
 public:
  /// @param answer the flight's of truth.json
  /// @param report what close_loop says of it
  void Count(const Json& answer, const Json& report);
  void Print();
  /// @param seconds what close_loop took, or null
  Json ToJson(const Json& seconds);

 private:
  /// @returns true if the class is right
  bool CountEffect(const Json& answer, const Json& report);
  void CountTwo(const Json& answer, const Json& report);
  void GatherRatios(const Json& answer, const Json& report, Tally* tally) const;
  /// Coefficients of an effect that acts and is named, where the answers have them and the flight
  /// shows them.
  void CountCoefficients(const Json& answer, const Json& effect);
  double RmsOfSigmas() const;

  std::map<std::string, Tally> tallies_;
  int flights_ = 0, null_flights_ = 0, false_alarms_ = 0;
  int unknown_ = 0, called_unexplained_ = 0, unknown_named_ = 0, two_ = 0, both_of_two_ = 0,
      both_classes_ = 0;
  int coefficients_ = 0, within_three_sigma_ = 0;
  double squared_sigmas_ = 0.0;  // errors over their sigma
  Json mistakes_ = Json::array();
};

constexpr std::array<const char*, 3> kStrengths = {"strong", "medium", "weak"};

/// What answers call something that no catalogue had, and ours has by another name.
const std::map<std::string, std::string> kOurNames = {{"pendulum", "suspended_load"}};

/// True if all that was found is what acts, by our name for it.
bool IsNamedOurWay(const Json& answer, const std::vector<std::string>& found) {
  return !found.empty() && std::all_of(found.begin(), found.end(), [&](const std::string& name) {
    return std::any_of(answer["effects"].begin(), answer["effects"].end(), [&](const Json& effect) {
      const auto ours = kOurNames.find(effect);
      return ours != kOurNames.end() && ours->second == name;
    });
  });
}

std::vector<std::string> NamesIn(const Json& report) {
  std::vector<std::string> names;
  for (const Json& effect : report["effects"]) names.push_back(effect["name"]);
  return names;
}

void Score::Count(const Json& answer, const Json& report) {
  const std::string verdict = report["verdict"], right = answer["right_answer"];
  bool correct = verdict == right;
  ++flights_;
  if (right == "none") {
    ++null_flights_;
    if (!correct) ++false_alarms_;
  } else if (right == "unexplained") {
    ++unknown_;
    if (correct) {
      ++called_unexplained_;
    } else if (IsNamedOurWay(answer, NamesIn(report))) {
      ++unknown_named_;
      correct = true;
    }
  } else {
    correct = CountEffect(answer, report);
  }
  if (correct) return;
  mistakes_.push_back({{"flight", answer["flight"]},
                       {"right", right},
                       {"effects", answer["effects"]},
                       {"strength", answer["strength"]},
                       {"share", answer["share"]},
                       {"trajectory", answer["trajectory"]},
                       {"verdict", verdict},
                       {"found", NamesIn(report)}});
}

bool Score::CountEffect(const Json& answer, const Json& report) {
  Tally& tally = tallies_[answer["strength"]];
  const Json& effects = answer["effects"];
  const std::vector<std::string> found = NamesIn(report);
  const bool first = !found.empty() && Contains(effects, found[0]);
  bool in_class = first, in_two = first;
  if (!found.empty()) {
    for (const Json& other : report["effects"][0]["alternatives"]) {
      in_class = in_class || Contains(effects, other);
    }
  }
  if (found.size() > 1) in_two = in_two || Contains(effects, found[1]);
  if (found.size() < 2 && report["ranking"].size() > 1) {
    in_two = in_two || Contains(effects, report["ranking"][1]["name"]);
  }
  ++tally.flights;
  tally.top1 += first;
  tally.top2 += in_two;
  tally.class_top1 += in_class;
  CountTwo(answer, report);
  for (const Json& effect : report["effects"]) {
    if (Contains(effects, effect["name"])) CountCoefficients(answer, effect);
  }
  if (report["verdict"] == "effect") GatherRatios(answer, report, &tally);
  return in_class;
}

void Score::CountTwo(const Json& answer, const Json& report) {
  if (answer["effects"].size() < 2) return;
  const std::vector<std::string> found = NamesIn(report);
  size_t named = 0, in_class = 0;
  std::set<size_t> answers;  // each stands for one of the two
  for (const Json& truth : answer["effects"]) {
    const std::string name = truth;
    named += std::count(found.begin(), found.end(), name);
    for (size_t k = 0; k < found.size(); ++k) {
      const Json& others = report["effects"][k]["alternatives"];
      if ((found[k] != name && !Contains(others, name)) || !answers.insert(k).second) continue;
      ++in_class;
      break;
    }
  }
  ++two_;
  both_of_two_ += named >= 2;
  both_classes_ += in_class >= 2;
}

void Score::GatherRatios(const Json& answer, const Json& report, Tally* tally) const {
  const auto gather = [&](const std::string& quantity, int from, std::vector<double>* into) {
    const Json& before = report[quantity + "_rmse_before"];
    const Json& after = report[quantity + "_rmse_after"];
    for (int axis = 0; axis < 3 && !before.is_null(); ++axis) {
      const double share = answer["axis_share"][from + axis];
      if (share < 0.25 || share > 0.99) continue;
      const double ratio = after[axis].get<double>() / before[axis].get<double>();
      into->push_back(ratio / std::sqrt(1.0 - share));
    }
  };
  gather("force", 0, &tally->over_best);
  gather("force", 0, &tally->over_best_torque);
  // The torque's own RMSE keeps the file's inertia, which no effect makes right.
  gather("angular_acceleration", 3, &tally->over_best);
  gather("torque", 3, &tally->over_best_torque);
}

void Score::CountCoefficients(const Json& answer, const Json& effect) {
  const auto truth = answer.find("parameters");
  if (truth == answer.end()) return;
  for (const auto& [name, found] : effect["parameters"].items()) {
    const auto true_value = truth->find(name);
    const double sigma = found["sigma"];
    if (true_value == truth->end() || !found["observable"].get<bool>() || !(sigma > 0.0)) continue;
    const double sigmas = (found["value"].get<double>() - true_value->get<double>()) / sigma;
    ++coefficients_;
    within_three_sigma_ += std::abs(sigmas) <= 3.0;
    squared_sigmas_ += sigmas * sigmas;
  }
}

double Score::RmsOfSigmas() const {
  return std::sqrt(squared_sigmas_ / std::max(1, coefficients_));
}

void Score::Print() {
  std::printf("%-10s %8s %8s %8s %12s %16s\n", "strength", "flights", "top-1", "top-2",
              "class top-1", "after/best");
  for (const char* strength : kStrengths) {
    const Tally& t = tallies_[strength];
    const double of = std::max(1, t.flights);
    std::printf("%-10s %8d %7.0f%% %7.0f%% %11.0f%% %16.2f\n", strength, t.flights,
                100.0 * t.top1 / of, 100.0 * t.top2 / of, 100.0 * t.class_top1 / of,
                odmc::Median(t.over_best));
  }
  std::printf(
      "false alarms %d of %d, unexplained %d of %d (named by our name for it: %d more), both of "
      "two "
      "effects %d of %d (class: %d)\n",
      false_alarms_, null_flights_, called_unexplained_, unknown_, unknown_named_, both_of_two_,
      two_, both_classes_);
  std::printf(
      "coefficients of effects named: %d of %d within three sigma, errors %.2f sigma (RMS)\n",
      within_three_sigma_, coefficients_, RmsOfSigmas());
  for (const Json& m : mistakes_) std::cout << m.dump() << "\n";
}

Json Score::ToJson(const Json& seconds) {
  const auto of_each = [&](const auto& figure) {
    Json figures = Json::object();
    for (const char* strength : kStrengths) figures[strength] = figure(tallies_[strength]);
    return figures;
  };
  const auto median = [](const std::vector<double>& values) {
    return values.empty() ? Json(nullptr) : Json(odmc::Median(values));
  };
  Json score;
  score["top1"] = of_each([](const Tally& t) { return Share(t.top1, t.flights); });
  score["top2"] = of_each([](const Tally& t) { return Share(t.top2, t.flights); });
  score["class_top1"] = of_each([](const Tally& t) { return Share(t.class_top1, t.flights); });
  score["false_alarm"] = Share(false_alarms_, null_flights_);
  score["unexplained_recall"] = Share(called_unexplained_, unknown_);
  score["unknown_named_our_way"] = Share(unknown_named_, unknown_);
  score["after_over_before"] = of_each([&](const Tally& t) { return median(t.over_best); });
  score["after_over_before_with_torque_rmse"] =
      of_each([&](const Tally& t) { return median(t.over_best_torque); });
  score["both_of_two"] = Share(both_of_two_, two_);
  score["both_of_two_by_class"] = Share(both_classes_, two_);
  score["coefficients"] = {
      {"count", coefficients_},
      {"within_three_sigma", Share(within_three_sigma_, coefficients_)},
      {"rms_sigmas", coefficients_ == 0 ? Json(nullptr) : Json(RmsOfSigmas())}};
  score["flights"] = flights_;
  score["seconds"] = seconds;
  score["mistakes"] = mistakes_;
  return score;
}

struct Arguments {
  std::string folder;
  int jobs = 1;
  bool rescore = false;
  odmc::tools::EstimatorArguments estimator;
  std::vector<std::string> decision;
};

void AddOptions(CLI::App* app, Arguments* a) {
  app->add_option("DIR", a->folder, "folder of the set")->required();
  odmc::tools::AddJobs(app, &a->jobs);
  app->add_flag("--rescore", a->rescore, "use the results that are there");
  a->estimator.defaults = odmc::tools::AttributionEstimatorOptions();
  a->estimator.AddTo(app);
  app->add_option("--decision", a->decision,
                  "NAME=VALUE: a number of the decision (close_loop --help)")
      ->take_all()
      ->allow_extra_args(false);
}

odmc::CloseLoopOptions OptionsOf(const Arguments& a) {
  odmc::CloseLoopOptions options;
  options.estimator = a.estimator.Read();
  try {
    for (const std::string& set : a.decision) odmc::SetDecision(set, &options.attribution);
  } catch (const std::invalid_argument& error) {
    throw odmc::tools::UsageError(error.what());
  }
  return options;
}

/// Closes the loop on one flight of the manifest in `input` and writes its report to `results`.
void CloseOne(const Json& flight, const std::string& input, const std::string& results,
              const odmc::CloseLoopOptions& options) {
  using namespace odmc;
  const Vehicle vehicle = LoadVehicle(tools::In(input, flight["vehicle"]));
  FlightLog log =
      ReadFlightCsv(tools::In(input, flight["file"]), vehicle.num_rotors(), PoseSource::kEkf);
  const StreamInspection inspection = tools::InspectFlight(vehicle, true, &log);
  ClosedLoop loop = CloseLoopInspected(log, inspection, vehicle, vehicle, options);
  loop.parameters.provenance["decision"] = DescribeChanges(options.attribution);
  WriteText(CloseLoopReport(loop, vehicle),
            tools::In(results, std::string(flight["flight"]) + ".json"));
}

/// Closes the loop on every flight. @returns the time it took [s]
double CloseAll(const Arguments& a, const std::string& results) {
  const std::string input = odmc::tools::In(a.folder, "input");
  const Json manifest = ReadJson(odmc::tools::In(input, "manifest.json"));
  odmc::tools::MakeFolder(results);
  const odmc::CloseLoopOptions options = OptionsOf(a);
  odmc::tools::ProgressBar bar("close_loop");
  const auto start = std::chrono::steady_clock::now();
  const int flights = a.rescore ? 0 : static_cast<int>(manifest.size());
  odmc::ForEachOf(
      flights, a.jobs, [&](int i) { CloseOne(manifest[i], input, results, options); },
      [&](double share) { bar.Show(share); });
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Runs close_loop on every flight of a folder made by simulate_undeclared and scores it "
      "against\n"
      "the answer key. Writes DIR/results/flight_NNN.json, DIR/score.json.");
  Arguments a;
  AddOptions(&app, &a);
  return tools::Run(&app, argc, argv, [&] {
    const std::string results = tools::In(a.folder, "results");
    const double seconds = CloseAll(a, results);
    // Only from here on the answers are looked at.
    Score score;
    for (const Json& answer : ReadJson(tools::In(a.folder, "truth.json"))) {
      const std::string name = answer["flight"];
      score.Count(answer, ReadJson(tools::In(results, name + ".json")));
    }
    score.Print();
    WriteText(score.ToJson(a.rescore ? Json(nullptr) : Json(seconds)).dump(2) + "\n",
              tools::In(a.folder, "score.json"));
  });
}
