#pragma once

#include <functional>
#include <string>
#include <vector>

#include "odmc/attribution/close_loop.h"
#include "odmc/fleet/joint_calibration.h"

namespace odmc {

/// How the loop is closed on several flights.
struct JointLoopOptions {
  JointCalibrationOptions calibration;
  AttributionOptions attribution;
  std::vector<std::string> ruled_out;  ///< effects that cannot act, as wind indoors
};

/// How a coefficient of an effect is spread over the flights (random effects, by REML).
struct CoefficientSpread {
  std::string full_name, unit;
  double mean = 0.0, sigma = 0.0;  ///< of the vehicle's value; sigma holds the scatter
  double scatter = 0.0;            ///< between flights
  /// What each flight says of it, the other parameters where all flights have them.
  struct OfFlight {
    double value, sigma;
  };
  std::vector<OfFlight> by_flight;  ///< in the order of JointLoop::flights
  /// Flights whose value lies within two sigma (its own and the scatter) of the mean.
  int agreeing = 0;
};

/// An effect that acts on the vehicle, by the evidence of all flights.
struct JointEffect {
  RankedEffect effect;  ///< `by_flight`: in the order of JointLoop::flights
  std::vector<CoefficientSpread> spreads;
  int speak_for = 0, against = 0;  ///< flights that do, by clear odds; the rest are silent
  std::string manoeuvre;           ///< what would tell it from its alternatives
};

/// The loop closed on several flights of one vehicle.
struct JointLoop {
  Verdict verdict = Verdict::kNone;
  std::vector<std::string> flights;  ///< that the evidence is of
  std::vector<JointEffect> effects;
  std::vector<RankedEffect> ranking;             ///< every candidate alone, best first
  double named_gain = 0.0, flexible_gain = 0.0;  ///< [nats]
  /// Channels of the residual that are structured, by number of flights; of the declared model.
  std::vector<std::pair<std::string, int>> structured;
  /// The vehicle as declared, and as extended (as declared without an effect); each flight left out
  /// in turn.
  FleetCalibration before, after;
  std::vector<FleetFlight> held_out_before, held_out_after;  ///< flights that had no part in it
  std::vector<std::string> effect_names;                     ///< of the extended model
  std::vector<std::string> warnings;
};

/// Chance that what tells an effect's size differs from zero by as much as it does on all flights
/// together, were it zero (Wald's test; the scatter between flights counts). 0 for effects that are
/// each flight's own.
double ChanceOfNoSize(const std::string& effect, const FleetCalibration& fleet,
                      const Vehicle& vehicle);

/// Why an effect that all flights were calibrated with is not the vehicle's, in words that go on
/// after "it gains ... nats, but". Empty where it is, and for effects that are each flight's own.
/// It is not where, scatter between flights included,
/// - a size has a sign that it cannot have, such as a negative mass;
/// - it would have the other sign on too many flights, and as many of those that say something
/// speak
///   against it.
std::string WhyNotTheVehicles(const RankedEffect& effect, const FleetCalibration& fleet,
                              const Vehicle& vehicle, const AttributionOptions& options);

/// Calibrates the declared model on all flights together, looks in what it leaves on all of them
/// for effects that the vehicle lacks, adds these and calibrates anew. A coefficient is the
/// vehicle's: one that jumps from flight to flight is no effect.
/// @param files of flights that are learned from
/// @param held_out of flights that nothing is learned from; may be empty: then each of `files` is
///   left out in turn, by the parameters (what effects there are all of them have decided)
/// @param file_vehicle, configured as in CloseLoop()
/// @throws std::invalid_argument if no flight can be used
JointLoop CloseLoopOnSeveral(const std::vector<std::string>& files,
                             const std::vector<std::string>& held_out, const FlightSource& source,
                             const Vehicle& file_vehicle, const Vehicle& configured,
                             const JointLoopOptions& options,
                             const std::function<void(double)>& progress = {});

/// report.json of it: FleetReport() of the extended vehicle, with what was found and the errors
/// before and after.
std::string JointLoopReport(const JointLoop& loop, const DynamicModel& model);
/// The same in short, for a terminal.
std::string JointLoopTable(const JointLoop& loop);
/// Coefficients over flights as CSV: flight, effect, parameter, unit, value, sigma, nats.
std::string JointLoopCsv(const JointLoop& loop);

}  // namespace odmc
