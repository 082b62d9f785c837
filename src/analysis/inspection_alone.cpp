#include <algorithm>
#include <stdexcept>

#include "odmc/analysis/flight_inspection.h"
#include "odmc/analysis/new_vehicle.h"

namespace odmc {
namespace {

constexpr double kOtherFrame = 7.0;  // nats: a thousand to one

/// Only ratios to the mass can be told.
constexpr double kSomeMass_kg = 1.0;

KnownVehicle Unknown(const std::string& frame) {
  KnownVehicle known;
  known.name = "unknown";
  known.mass_kg = kSomeMass_kg;
  known.frame = frame;
  return known;
}

RotorGuess GuessOf(const KnownVehicle& known, const VehicleFit& fit, const NewVehicle& made) {
  RotorGuess guess;
  guess.frame = known.frame;
  const std::vector<FramePlace> places = FrameLayout(known.frame, known.autopilot);
  for (size_t j = 0; j < places.size(); ++j) {
    guess.spins.emplace_back(made.vehicle.rotors[j].spin > 0.0 ? "cw" : "ccw");
    guess.places.push_back(places[static_cast<size_t>(made.order[j])].name);
  }
  if (fit.rotors_tested) {
    guess.places_told = fit.order_choice.is_told;
    guess.spins_told = fit.spin_choice.is_told;
    guess.places_probability =
        made.order == fit.order ? fit.order_choice.probability : fit.nominal_order_probability;
    guess.spins_probability = made.order == fit.order ? fit.spin_choice.probability : 0.0;
  }
  if (fit.balance) guess.hover_speed_rad_s = fit.balance->hover_speed_rad_s;
  guess.advice = made.advice;
  return guess;
}

/// The frame of so many rotors that fits best, where one does clearly; else the first.
KnownVehicle BestFrame(const FlightLog& log, int num_rotors, VehicleFit* fit) {
  const std::vector<std::string> frames = FramesOf(num_rotors);
  if (frames.empty()) {
    throw std::invalid_argument("there is no frame of " + std::to_string(num_rotors) + " rotors");
  }
  const KnownVehicle known = Unknown(frames.front());
  *fit = FitVehicle(log, VehicleBeforeFlight(known));
  const auto best = std::max_element(fit->other_frames.begin(), fit->other_frames.end(),
                                     [](const auto& a, const auto& b) { return a.nats < b.nats; });
  if (best == fit->other_frames.end() || best->nats < kOtherFrame) return known;
  const KnownVehicle other = Unknown(best->frame);
  *fit = FitVehicle(log, VehicleBeforeFlight(other));
  return other;
}

}  // namespace

FlightInspection InspectFlightAlone(const FlightLog& log, int num_rotors) {
  VehicleFit fit;
  const KnownVehicle known = BestFrame(log, num_rotors, &fit);
  const NewVehicle made = MakeVehicle(known, &fit, log.file);
  FlightInspection result = InspectFlight(log, made.vehicle);
  result.vehicle = "";
  result.rotors = GuessOf(known, fit, made);
  auto& findings = result.inspection.findings;
  findings.erase(std::remove_if(findings.begin(), findings.end(), IsOfVehicle), findings.end());
  if (fit.leans) {
    for (const Finding& finding : fit.streams.findings) {
      if (finding.check == "body_lean") findings.push_back(finding);
    }
  }
  return result;
}

}  // namespace odmc
