#include "odmc/bench/experiments.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <utility>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/parallel.h"
#include "odmc/analysis/replay.h"
#include "odmc/math/gaussian.h"
#include "odmc/math/statistics.h"
#include "odmc/model/parameter_set.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kGround_s = 1.0;
constexpr double kLongest_s = 1000.0;
constexpr double kEvent_s = 15.0, kSecondEvent_s = 30.0;  // after the start of the path's ramp
constexpr double kSettled_s = 5.0;                        // after an event
constexpr double kRecovered = 1.5;                        // of the RMSE before
constexpr double kRecoveryWindow_s = 2.0;
constexpr double kBefore_s = 8.0;  // the first hand-over is over by then
constexpr int kTruthStream = 77;   // of random numbers

struct Variant {
  std::string name;
  std::function<void(ControlledFlightSetup*)> change;
  /// Set where the torque is to be predicted: by a model without this effect (empty: with all).
  std::optional<std::string> predicts_without = {};
};

struct Design {
  std::string description;
  bool warm_start;  // with what a figure of eight before taught
  std::function<void(ControlledFlightSetup*)> common;
  std::vector<Variant> variants;
};

void NoChange(ControlledFlightSetup*) {}

Variant Compensated() { return {"compensated", NoChange}; }

Variant Uncompensated() {
  return {"uncompensated", [](ControlledFlightSetup* s) {
            s->controller.compensation = CompensatedEffects::None();
          }};
}

void Fly(const std::string& trajectory, double top_speed_m_s, ControlledFlightSetup* setup) {
  setup->trajectory.name = trajectory;
  setup->trajectory.top_speed_m_s = top_speed_m_s;
}

void ShiftTruth(const std::string& name, double by, ControlledFlightSetup* setup) {
  setup->truth[setup->truth_model->IndexOf(name)] += by;
}

const std::map<std::string, Design>& Designs() {
  static const std::map<std::string, Design> designs = {
      {"octo",
       {"figure of eight, top speed 5 m/s",
        false,
        [](ControlledFlightSetup* s) { Fly("octo", 5.0, s); },
        {Compensated(), Uncompensated()}}},
      {"vshape",
       {"horizontal V forth and back, top speed 3.5 m/s, parameters saved from a figure of eight",
        true,
        [](ControlledFlightSetup* s) { Fly("vshape", 3.5, s); },
        {{"hvt_on", NoChange},
         {"hvt_off", [](ControlledFlightSetup* s) { s->controller.compensation.hvt = false; }}}}},
      {"cog_shift",
       {"figure of eight at 5 m/s, centre of gravity 1.0 cm further forward",
        false,
        [](ControlledFlightSetup* s) {
          Fly("octo", 5.0, s);
          ShiftTruth("centre_of_gravity.x", 0.01, s);
        },
        {{"cog_on", NoChange, ""},
         {"cog_off",
          [](ControlledFlightSetup* s) { s->controller.compensation.centre_of_gravity = false; },
          "centre_of_gravity"}}}},
      {"payload",
       {"figure of eight at 3 m/s, 20 % of the mass attached and dropped in flight",
        false,
        [](ControlledFlightSetup* s) {
          Fly("octo", 3.0, s);
          s->world.payload_kg = 0.2 * s->vehicle.mass_kg;
          s->world.payload_p_B_m = {0.0, 0.0, -0.03};
        },
        {{"payload", NoChange}}}},
      {"wind",
       {"figure of eight at 5 m/s, wind of 3 m/s with gusts of 0.5 m/s",
        false,
        [](ControlledFlightSetup* s) {
          Fly("octo", 5.0, s);
          s->world.wind_m_s = {3.0 * std::cos(0.7), 3.0 * std::sin(0.7), 0.0};
          s->world.gust_m_s = 0.5;
          // Drag in a steady wind and a tilted world are nearly one: odometry knows the vertical.
          auto& effects = s->vehicle.effects;
          effects.erase(std::remove(effects.begin(), effects.end(), "gravity"), effects.end());
          effects.push_back("wind");
        },
        {Compensated(), Uncompensated()}}},
      {"damaged_propeller",
       {"figure of eight at 3 m/s, one rotor loses 15 % of its thrust in flight",
        false,
        [](ControlledFlightSetup* s) {
          Fly("octo", 3.0, s);
          s->world.damage_rotor = 1;
          s->world.damage_share = 0.15;
        },
        {{"estimated", NoChange},
         {"nominal", [](ControlledFlightSetup* s) { s->estimates = false; }}}}},
  };
  return designs;
}

const Design& DesignOf(const std::string& name) {
  const auto it = Designs().find(name);
  if (it != Designs().end()) return it->second;
  throw std::invalid_argument("there is no experiment '" + name +
                              "'; known are: " + Listed(ExperimentNames()));
}

// Flight time at which a path event happens: its ramp is over by then.
double EventTime(const ControlledFlightSetup& setup, double after_s) {
  return Trajectory(setup.trajectory).start_s() + after_s;
}

ControlledFlightSetup SetupOf(const Design& design, const Variant& variant, const Vehicle& vehicle,
                              const ExperimentOptions& options, int seed) {
  ControlledFlightSetup setup;
  setup.vehicle = vehicle;
  setup.truth_model = std::make_shared<DynamicModel>(vehicle, vehicle.effects);
  setup.truth = DrawTruth(*setup.truth_model, seed);
  setup.trajectory.ground_s = kGround_s;
  setup.trajectory.from_origin = true;
  setup.trajectory.duration_s = options.duration_s;
  setup.estimator = OfflineOptions();
  setup.estimator.keyframe_rate_hz = options.keyframe_rate_hz;
  setup.estimator.detect_changes = true;
  setup.estimator.phases.near_ground_m = 0.3;
  setup.estimator_dies_at_s = options.estimator_dies_at_s;
  setup.seed = seed;
  design.common(&setup);
  variant.change(&setup);
  const double event_s = EventTime(setup, kEvent_s);
  if (setup.world.payload_kg > 0.0) {
    setup.world.payload_attach_at_s = event_s;
    setup.world.payload_drop_at_s = EventTime(setup, kSecondEvent_s);
    setup.trajectory.duration_s = std::max(setup.trajectory.duration_s, kSecondEvent_s + kEvent_s);
  }
  if (setup.world.damage_share > 0.0) setup.world.damage_at_s = event_s;
  return setup;
}

// What a figure of eight of 20 s teaches about the vehicle of `setup`.
std::optional<ParameterSet> LearnFirst(ControlledFlightSetup setup) {
  Fly("octo", 5.0, &setup);
  setup.trajectory.duration_s = 20.0;
  return FlyControlled(setup).accepted;
}

// Time after `event_s` at which the RMSE of the following kRecoveryWindow_s is within its limit for
// the first time; up to `end_s` where it never is.
double RecoveryTime(const ControlledFlight& flight, double event_s, double end_s, double limit_m) {
  double t = event_s;
  while (t + kRecoveryWindow_s <= end_s &&
         ErrorsBetween(flight, t, t + kRecoveryWindow_s).rmse_m.norm() > limit_m) {
    t += 0.1;
  }
  return t - event_s;
}

// Torque that a model without the effect `without` predicts on the second half of the flight, once
// it has been calibrated on the first, against what the motion shows.
Eigen::Vector3d TorqueError(const ControlledFlightSetup& setup, const ControlledFlight& flight,
                            const std::string& without) {
  Vehicle vehicle = setup.vehicle;
  auto& effects = vehicle.effects;
  effects.erase(std::remove(effects.begin(), effects.end(), without), effects.end());
  const DynamicModel model(vehicle, effects);
  FlightLog first = flight.log, second = flight.log;
  CutFlight(0.0, 0.5 * flight.flown_s, &first);
  CutFlight(0.5 * flight.flown_s, setup.trajectory.duration_s, &second);  // not the landing
  const Calibration calibration = Calibrate(first, flight.log, vehicle, model, setup.estimator);
  Vehicle calibrated = vehicle;
  ApplyParameters(calibration.parameters, &calibrated);
  const Evaluation evaluation =
      Evaluate(second, vehicle, DynamicModel(calibrated, effects), calibration.parameters);
  return evaluation.prediction.figures.torque_rmse_Nm.value_or(Eigen::Vector3d::Zero());
}

// What is counted of one flight of a variant: a part of it and what else it gives.
struct Part {
  TrackingErrors errors;
  double recovery_s = -1.0;
};

std::map<std::string, Part> PartsOf(const std::string& variant, const ControlledFlightSetup& setup,
                                    const ControlledFlight& flight) {
  if (setup.world.payload_attach_at_s == 0.0) return {{variant, {ErrorsOf(flight), -1.0}}};
  const double attach_s = setup.world.payload_attach_at_s, drop_s = setup.world.payload_drop_at_s;
  const double end_s = flight.flown_s;
  const TrackingErrors before = ErrorsBetween(flight, attach_s - kBefore_s, attach_s);
  const double limit_m = kRecovered * before.rmse_m.norm();
  return {{"before", {before, -1.0}},
          {"with_load",
           {ErrorsBetween(flight, attach_s + kSettled_s, drop_s),
            RecoveryTime(flight, attach_s, drop_s, limit_m)}},
          {"after_drop",
           {ErrorsBetween(flight, drop_s + kSettled_s, end_s),
            RecoveryTime(flight, drop_s, end_s, limit_m)}}};
}

// Everything of one variant, seed by seed.
struct Collected {
  std::array<std::vector<double>, 3> rmse, max, torque;
  std::vector<double> accepted_s, recovery_s;
  VariantFigures figures;
};

void Collect(const Part& part, const Variant& variant, const ControlledFlightSetup& setup,
             const ControlledFlight& flight, Collected* all) {
  VariantFigures& figures = all->figures;
  ++figures.seeds;
  if (!flight.crash.empty()) {
    ++figures.crashes;
    figures.crash_reports.push_back("seed " + std::to_string(setup.seed) + ": " + flight.crash);
  }
  for (int axis = 0; axis < 3; ++axis) {
    all->rmse[axis].push_back(part.errors.rmse_m[axis]);
    all->max[axis].push_back(part.errors.max_m[axis]);
  }
  if (part.recovery_s >= 0.0) all->recovery_s.push_back(part.recovery_s);
  figures.control_ms_p99 = std::max(figures.control_ms_p99, flight.control_ms_p99);
  all->accepted_s.push_back(flight.first_accepted_s);
  if (!variant.predicts_without) return;
  const Eigen::Vector3d torque = TorqueError(setup, flight, *variant.predicts_without);
  figures.has_torque = true;
  for (int axis = 0; axis < 3; ++axis) all->torque[axis].push_back(torque[axis]);
}

VariantFigures Summarised(Collected all) {
  VariantFigures& figures = all.figures;
  for (int axis = 0; axis < 3; ++axis) {
    figures.rmse_m[axis] = Median(all.rmse[axis]);
    figures.max_m[axis] = Median(all.max[axis]);
    figures.spread_m[axis] = Quantile(all.rmse[axis], 0.75) - Quantile(all.rmse[axis], 0.25);
    figures.torque_rmse_Nm[axis] = Median(all.torque[axis]);
  }
  figures.first_accepted_s = Median(all.accepted_s);
  if (!all.recovery_s.empty()) {
    figures.recovery_s = Median(all.recovery_s);
    figures.recovery_max_s = Quantile(all.recovery_s, 1.0);
  }
  return figures;
}

}  // namespace

const std::vector<std::string>& ExperimentNames() {
  static const std::vector<std::string> names = {"octo",    "vshape", "cog_shift",
                                                 "payload", "wind",   "damaged_propeller"};
  return names;
}

ModelValues DrawTruth(const DynamicModel& model, int seed) {
  // Relative spreads; angles absolute.
  static const std::map<std::string, double> spreads = {
      {"thrust", 0.05},          {"rotor_torque", 0.05}, {"drag", 0.15},
      {"viscous_torque", 0.15},  {"hvt", 0.15},          {"inertia", 0.08},
      {"centre_of_gravity", 0.3}};
  constexpr double kTilt_rad = 0.005;
  Gaussian random(seed, kTruthStream);
  ModelValues truth = DefaultTruth(model);
  for (int i = 0; i < model.num_parameters(); ++i) {
    const double draw = std::clamp(random.Next(), -2.0, 2.0);
    const std::string& effect = model.parameters()[i].effect;
    const auto spread = spreads.find(effect);
    if (spread != spreads.end()) truth[i] *= 1.0 + spread->second * draw;
    if (effect == "gravity") truth[i] += kTilt_rad * draw;
  }
  return truth;
}

Experiment RunExperiment(const std::string& name, const Vehicle& vehicle,
                         const ExperimentOptions& options,
                         const std::function<void(double)>& progress) {
  const Design& design = DesignOf(name);
  const int num_variants = static_cast<int>(design.variants.size());
  std::vector<ControlledFlightSetup> setups;
  for (int seed = 0; seed < options.seeds; ++seed) {
    for (const Variant& variant : design.variants) {
      setups.push_back(SetupOf(design, variant, vehicle, options, options.first_seed + seed));
    }
  }
  std::vector<ControlledFlight> flights(setups.size());
  ForEachOf(
      static_cast<int>(setups.size()), options.jobs,
      [&](int i) {
        if (design.warm_start) setups[i].warm_start = LearnFirst(setups[i]);
        flights[i] = FlyControlled(setups[i], kLongest_s);
      },
      progress);

  Experiment experiment;
  experiment.name = name;
  experiment.description = design.description;
  std::map<std::string, Collected> collected;
  for (size_t i = 0; i < flights.size(); ++i) {
    const Variant& variant = design.variants[i % num_variants];
    for (const auto& [part_name, part] : PartsOf(variant.name, setups[i], flights[i])) {
      Collect(part, variant, setups[i], flights[i], &collected[part_name]);
    }
    if (i < design.variants.size()) experiment.example[variant.name] = std::move(flights[i]);
  }
  for (auto& [variant, all] : collected) experiment.figures[variant] = Summarised(all);
  for (const Variant& variant : design.variants) experiment.variants.push_back(variant.name);
  if (name == "payload") experiment.variants = {"before", "with_load", "after_drop"};
  return experiment;
}

}  // namespace odmc
