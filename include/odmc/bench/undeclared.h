#pragma once

#include <functional>
#include <string>
#include <vector>

#include "odmc/bench/undeclared_recording.h"
#include "odmc/model/parameter_set.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/simulator.h"

namespace odmc {

/// What is wrong with the declared model of one test flight.
enum class UndeclaredKind {
  kNothing,     ///< the declared model is the truth
  kNotExcited,  ///< an effect acts whose regressor the flight hardly moves
  kOneEffect,
  kTwoEffects,
  kUnknown,  ///< a disturbance that no catalogue knows
};

/// One test flight to be made.
struct UndeclaredPlan {
  int number = 0;
  UndeclaredKind kind = UndeclaredKind::kNothing;
  std::vector<std::string> effects;  ///< undeclared ones, the larger first
  std::string strength;              ///< strong, medium, weak; empty without
  double share = 0.0;  ///< wanted share of the residual's variance on its largest axis
  int vehicle = 0;     ///< of UndeclaredVehicles()
  std::string trajectory;
  int seed = 0;
  RecordingModel recording = RecordingModel::kWhite;
};

/// A test flight with its answer.
struct UndeclaredFlight {
  UndeclaredPlan plan;
  Vehicle declared;  ///< what close_loop is given
  RecordingConditions recording;
  FlightLog log;
  ParameterSet truth;
  double share = 0.0;              ///< reached, on the largest axis
  std::vector<double> axis_share;  ///< per channel
  std::string right_answer;        ///< effect, none, unexplained
};

/// The plan of a set: of `flights`, 5/16 with nothing, 3/32 with something not excited, 1/8
/// unknown, 1/16 with two effects, the rest with one, over all effects, vehicles and trajectories
/// in turn.
std::vector<UndeclaredPlan> PlanUndeclared(int seed, int flights);

/// A plan of flights on which nothing undeclared acts, over all vehicles and trajectories in turn.
std::vector<UndeclaredPlan> PlanNothing(int seed, int flights);

/// A plan of flights on which one effect acts, over all strengths, vehicles and the trajectories
/// that show it in turn.
/// @throws std::invalid_argument for an effect no test flight can be made with; names those there
///   are
std::vector<UndeclaredPlan> PlanOneEffect(int seed, int flights, const std::string& effect);

/// A plan of flights on which something acts that no catalogue knows, strong and medium in turn,
/// over all vehicles and trajectories.
std::vector<UndeclaredPlan> PlanUnknown(int seed, int flights);

/// The vehicles of the set, as files declare them.
std::vector<Vehicle> UndeclaredVehicles();

/// Simulates one flight of the plan: true parameters off the declared start values, realistic
/// sensors, and the undeclared effect at the size that makes up its share of the variance of the
/// declared model's residual (10 Hz, declared parameters fitted) on the largest axis: one minus the
/// variance without it over that with it, the same noise in both. A single effect that would need
/// an absurd size is flown on the trajectory that shows it best; what still shows less stays so,
/// and `share` says what it reached.
UndeclaredFlight MakeUndeclared(const UndeclaredPlan& plan);

/// Vehicle file text that LoadVehicle() reads back.
std::string FormatVehicle(const Vehicle& vehicle);

}  // namespace odmc
