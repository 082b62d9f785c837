#include "odmc/analysis/new_vehicle.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include "flight_arguments.h"
#include "odmc/analysis/report.h"
#include "odmc/io/foreign_messages.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/ros/urdf_vehicle.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"
#include "tool_support.h"

namespace {

using namespace odmc;

/// What is given as text.
struct Words {
  std::string urdf, autopilot, arm, inertia, places, spins, out;
  double mass_kg = 0.0, radius_m = 0.0;
  bool force = false;
};

/// "0.1" or "0.1,0.2", all above zero.
std::vector<double> Numbers(const std::string& text, const std::string& option) {
  std::vector<double> numbers;
  std::istringstream stream(text);
  for (std::string item; std::getline(stream, item, ',');) {
    double number = 0.0;
    if (!ParseNumber(item, &number) || !std::isfinite(number) || !(number > 0.0)) {
      throw tools::UsageError(option + " " + text + ": expected numbers above zero, not '" + item +
                              "'");
    }
    numbers.push_back(number);
  }
  return numbers;
}

std::vector<double> Spins(const std::string& text) {
  std::vector<double> spins;
  std::istringstream stream(text);
  for (std::string item; std::getline(stream, item, ',');) {
    if (item != "cw" && item != "ccw") {
      throw tools::UsageError("--spins " + text + ": expected cw or ccw, not '" + item + "'");
    }
    spins.push_back(item == "cw" ? 1.0 : -1.0);
  }
  return spins;
}

std::string ReadFile(const std::string& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  if (!in || !std::filesystem::is_regular_file(file)) {
    RefuseFile(file, "cannot be read");
  }
  return text.str();
}

/// Whose numbers a recording's readings most likely have.
Autopilot UsualAutopilot(const std::string& ending) {
  if (ending == ".bfl" || ending == ".bbl") return Autopilot::kBetaflight;
  return ending == ".bin" ? Autopilot::kArduPilot : Autopilot::kPx4;
}

void ReadShape(const Words& words, KnownVehicle* known) {
  const std::vector<double> arm = Numbers(words.arm, "--arm");
  if (arm.size() == 1) known->arm_m = arm[0];
  if (arm.size() == 2) known->half_m = Eigen::Vector2d(arm[0], arm[1]);
  if (arm.size() > 2) throw tools::UsageError("--arm " + words.arm + ": expected M or X,Y");
  const std::vector<double> inertia = Numbers(words.inertia, "--inertia");
  if (!inertia.empty() && inertia.size() != 3) {
    throw tools::UsageError("--inertia " + words.inertia + ": expected X,Y,Z");
  }
  if (!inertia.empty()) known->inertia_kg_m2 = Eigen::Vector3d(inertia.data());
  if (words.radius_m > 0.0) known->radius_m = words.radius_m;
}

void Read(const Words& words, const std::string& ending, KnownVehicle* known) {
  known->autopilot_asked = !words.autopilot.empty();
  known->autopilot = UsualAutopilot(ending);
  for (const Autopilot one : {Autopilot::kPx4, Autopilot::kArduPilot, Autopilot::kBetaflight}) {
    if (words.autopilot == Name(one)) known->autopilot = one;
  }
  ReadShape(words, known);
  if (!words.places.empty()) {
    try {
      known->places = ParseOrder(words.places);
    } catch (const std::invalid_argument& e) {
      throw tools::UsageError("--places: " + std::string(e.what()));
    }
  }
  known->spins = Spins(words.spins);
  if (!words.urdf.empty()) known->drawing = VehicleFromUrdf(ReadFile(words.urdf), words.radius_m);
  if (words.mass_kg <= 0.0 && !known->drawing) {
    throw tools::UsageError("--mass is required, unless --urdf gives it");
  }
  known->mass_kg = words.mass_kg > 0.0 ? words.mass_kg : known->drawing->mass_kg;
}

void AddTo(CLI::App* app, Words* words, KnownVehicle* known) {
  app->add_option("--urdf", words->urdf, "geometry and inertia from a URDF, in --frame's place")
      ->check(CLI::ExistingFile)
      ->type_name("FILE");
  app->add_option("--mass", words->mass_kg, "ready to fly [kg]")->check(tools::Positive());
  app->add_option("--out", words->out, "vehicle file to write")->required()->type_name("FILE");
  app->add_option("--frame", known->frame, "where the rotors sit")
      ->check(CLI::IsMember(FrameNames()).description(""))
      ->type_name(CLI::detail::join(FrameNames(), "|"))
      ->capture_default_str();
  app->add_option("--autopilot", words->autopilot,
                  "whose motor numbers the readings have, where the flight does not tell "
                  "[betaflight for .bfl and .bbl, ardupilot for .bin, else px4]")
      ->check(CLI::IsMember({"px4", "ardupilot", "betaflight"}).description(""))
      ->type_name("px4|ardupilot|betaflight");
  app->add_option("--arm", words->arm,
                  "distance of the hubs from the middle [m], or largest x and y of a hub [m] "
                  "[0.13 m times the cube root of the mass in kg]")
      ->type_name("M|X,Y");
  app->add_option("--radius", words->radius_m,
                  "of the propellers [m] [0.8 times half the least "
                  "distance of two hubs]")
      ->check(tools::Positive());
  app->add_option("--inertia", words->inertia, "about x, y, z [kg m^2]")->type_name("X,Y,Z");
  app->add_option("--places", words->places,
                  "which motor of the frame reading 1, 2, ... is, as 2,4,1,3 [as the flight says]")
      ->type_name("i,j,..");
  app->add_option(
         "--spins", words->spins,
         "turning directions of the readings' rotors seen from above, as cw,ccw,cw,ccw [as "
         "the flight says, else as the autopilot's drawing]")
      ->type_name("a,b,..");
  app->add_option("--name", known->name, "of the vehicle [the file's]");
  app->add_flag("--force", words->force, "overwrite a file that is there");
}

/// Warnings of a recording that do not speak of the guessed vehicle.
void Warn(const VehicleFit& fit) {
  for (const Finding& finding : fit.streams.findings) {
    if (finding.leaves == Trust::kGood || IsOfVehicle(finding)) continue;
    std::cerr << "warning: " << Printable(Sentence(finding)) << "\n";
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Writes a vehicle file from a recording, or from a drawing, and the mass. Order and spins "
      "of\n"
      "the rotors, k_f, the lean of the pose's frame and the inertia are taken from the flight as\n"
      "far as it shows them; each entry says whether it was found, guessed or asked for.");
  tools::FlightArguments flight;
  Words words;
  KnownVehicle known;
  known.name.clear();
  flight.AddOptionTo(&app, "--from");
  AddTo(&app, &words, &known);
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    if (flight.file.empty() && words.urdf.empty()) {
      throw tools::UsageError("--from FLIGHT or --urdf FILE is required");
    }
    if (std::filesystem::exists(words.out) && !words.force) {
      throw std::invalid_argument(words.out + ": is there already; --force overwrites it");
    }
    Read(words, flight.file.empty() ? "" : flight.FormatEnding(), &known);
    if (known.name.empty()) known.name = std::filesystem::path(words.out).stem().string();
    const Vehicle nominal = VehicleBeforeFlight(known);
    std::optional<VehicleFit> fit;
    std::string file;
    if (!flight.file.empty()) {
      const FlightLog log = flight.Read(nominal);
      file = log.file;
      fit = FitVehicle(log, nominal);
      if (!fit->streams.refusal.empty()) RefuseFile(file, fit->streams.refusal);
      Warn(*fit);
    }
    const NewVehicle made = MakeVehicle(known, fit ? &*fit : nullptr, file);
    const std::string text = VehicleText(made.vehicle, made.comments);
    ParseVehicle(text, words.out);  // what every tool will read
    WriteText(text, words.out);
    for (const std::string& line : made.report) std::cout << line << "\n";
    for (const std::string& line : made.advice) std::cout << "note: " << line << "\n";
    std::cout << Printable(words.out) << " written\n";
  });
}
