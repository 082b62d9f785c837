#pragma once

#include <algorithm>
#include <array>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/torque_bands.h"
#include "odmc/attribution/attribution.h"
#include "odmc/attribution/structure.h"
#include "odmc/estimator/options.h"
#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// How the loop is closed.
struct CloseLoopOptions {
  EstimatorOptions estimator = OfflineOptions();
  BlockSplit blocks;
  AttributionOptions attribution;
  std::vector<std::string> ruled_out;  ///< effects that cannot act, as wind and gusts indoors
  /// What may be wrong with the streams (StreamInspection::doubts): sigmas say it, too.
  std::vector<StreamDoubt> doubts;
  int jobs = 1;  ///< threads that look at ways of effects to act; the result is the same
};

/// What is not looked at. Contact is left out like the ground, unless it is most of the flight: no
/// hand holds a vehicle that long, and what acts so long is something the model lacks.
std::vector<std::pair<Stamp, Stamp>> NotLookedAt(const ReplayResult& replay);

/// What a closed loop found: an effect, nothing worth one, or something that no effect explains.
enum class Verdict { kEffect, kNone, kUnexplained };
std::string NameOf(Verdict verdict);

/// An effect that earned its place.
struct AddedEffect {
  RankedEffect effect;
  std::vector<std::string> alternatives;        ///< that explain the same on this flight
  std::string manoeuvre;                        ///< what would tell them apart
  std::vector<ParameterEstimate> derived = {};  ///< DerivedFigures() of its online estimate
  bool taken_off =
      false;  ///< found by the streams and put right in the recording, not in the model
};

/// One sample for pictures: the residual before and after.
struct LoopSample {
  double t_s;
  bool held_out;
  double speed_m_s;
  std::array<double, 6> before, after;  ///< measured minus predicted [N, N m]
};

/// A flight on which the loop was closed, with everything its report shows.
struct ClosedLoop {
  Verdict verdict = Verdict::kNone;
  FlightFigures flight;
  std::vector<AddedEffect> effects;
  std::vector<RankedEffect> ranking;  ///< of the first choice, best first
  std::vector<ChannelStructure> structure;
  double structured_share = 0.0;  ///< of the most structured channel
  double whiteness_p = 1.0;       ///< smallest of the channels, times their number
  /// What the named (or, unexplained, the dropped) effects gain together, and what arbitrary
  /// functions of the state gain beside them [nats].
  double named_gain = 0.0, flexible_gain = 0.0;
  PredictionFigures before, after;  ///< on blocks held out
  /// Force by the accelerometer instead, its mean taken off; empty without one.
  PredictionFigures::Axes accelerometer_before, accelerometer_after;
  TorqueBands bands;  ///< of the whole flight, with the model as extended
  Eigen::Vector3d nominal_inertia = Eigen::Vector3d::Ones();  ///< of the vehicle file [kg m²]
  std::vector<LoopSample> samples;
  ParameterSet declared_parameters;  ///< of the model as declared
  ParameterSet parameters;           ///< of the model as extended (as declared without an effect)
  std::vector<std::string> effect_names;  ///< of that model
  std::string where;                      ///< words on where the unexplained part lives
  std::vector<Finding> findings;          ///< about the recording
  std::vector<TimeOffset> time_offsets;   ///< of its streams, as recorded
  std::vector<std::string> warnings;      ///< the findings' sentences among them
  std::vector<std::string> denied;        ///< effects that the fit chose and the estimator denies
};

/// Holds a thrust coefficient that is known to 5 % (from an earlier, unloaded flight) as it is:
/// mass can then be found.
void HoldKnownThrust(const AttributionOptions& options, Vehicle* vehicle);

/// Calibrates `vehicle`'s model on a flight, finds what it leaves unexplained, traces it to an
/// effect of the catalogue, adds that and says what it changed. An effect that the fit chooses and
/// the online estimate denies stood for another: the flight is looked at once more without it, and
/// what predicts blocks held out better counts. `progress` gets the share done.
/// @param file_vehicle the vehicle file as it is: measured forces and torques come from it
/// @param vehicle with the configured effects and parameters; the sigmas of an earlier estimate are
///   no priors here, see WithPriorsOf()
/// @throws std::invalid_argument where the flight cannot be calibrated
ClosedLoop CloseLoop(const FlightLog& log, const Vehicle& file_vehicle, const Vehicle& vehicle,
                     const CloseLoopOptions& options,
                     const std::function<void(double)>& progress = {});

/// Which of two looks at a flight counts, the second without what the online estimate denied at the
/// first: the second where it names an effect and predicts blocks held out better, with a warning.
ClosedLoop BetterLook(ClosedLoop first, ClosedLoop again);

}  // namespace odmc
