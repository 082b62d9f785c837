#include "odmc/attribution/candidates.h"

#include <algorithm>
#include <cmath>

#include "odmc/attribution/stage.h"
#include "odmc/model/effect.h"

namespace odmc {
namespace {

// Not candidates: the base of every model, what turns the frame, what replaces other effects, and
// what needs a test of its own (gust).
const char* const kNever[] = {"thrust",      "rotor_torque",        "inertia",
                              "rotor_level", "odometry_extrinsics", "imu_extrinsics",
                              "gust"};
constexpr double kMassStep_s = 1.0;
constexpr double kShortest_s = 0.05;  // of its refinement
constexpr double kEdge_s = 2.0;       // no change is looked for closer to start and end
constexpr double kCableRatio = 1.15;  // from one length to the next

constexpr double kDampingRatio = 4.0;
constexpr int kSections = 8;  // to 2 % of the bracket

/// Where `score` is best for a positive x in [low, high], by golden section in log(x).
double BestBetween(double low, double high, const std::function<double(double)>& score) {
  const double share = 0.5 * (std::sqrt(5.0) - 1.0);
  double a = std::log(low), b = std::log(high);
  double x1 = b - share * (b - a), x2 = a + share * (b - a);
  double s1 = score(std::exp(x1)), s2 = score(std::exp(x2));
  for (int i = 0; i < kSections; ++i) {
    if (s1 > s2) {
      b = x2;
      x2 = x1;
      s2 = s1;
      x1 = b - share * (b - a);
      s1 = score(std::exp(x1));
    } else {
      a = x1;
      x1 = x2;
      s1 = s2;
      x2 = a + share * (b - a);
      s2 = score(std::exp(x2));
    }
  }
  return std::exp(s1 > s2 ? x1 : x2);
}

bool IsListed(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// True if the model estimates the thrust coefficient: a mass over the whole flight is one with it.
bool FitsThrust(const Vehicle& vehicle) {
  const DynamicModel model(vehicle, vehicle.effects);
  const int k_f = model.IndexOf("thrust.k_f");
  return k_f >= 0 && model.parameters()[k_f].estimated;
}

}  // namespace

std::vector<Candidate> CandidatesFor(const Vehicle& vehicle, const FlightMotion& flight) {
  std::vector<Candidate> candidates;
  if (flight.samples.empty()) return candidates;
  const double start_s = flight.samples.front().t_s, end_s = flight.samples.back().t_s;
  for (const std::string& name : EffectRegistry::Default().names()) {
    const bool never = std::any_of(std::begin(kNever), std::end(kNever),
                                   [&](const char* other) { return name == other; });
    if (never || IsListed(vehicle.effects, name)) continue;
    if (name == "mass_change") {
      const std::map<std::string, double> some = {{"mass_change.mass", 0.05 * vehicle.mass_kg}};
      if (!FitsThrust(vehicle)) candidates.push_back({name, {{"mass_change.from", 0.0}}, some});
      for (double t = start_s + kEdge_s; t < end_s - kEdge_s; t += kMassStep_s) {
        candidates.push_back({name, {{"mass_change.from", t}}, some});
      }
    } else if (name == "suspended_load") {
      const double arm = vehicle.ArmLength();
      for (double l = std::max(0.08, arm); l < 2.6; l *= kCableRatio) {
        for (const double damping : {0.02, 0.1}) {
          candidates.push_back({name,
                                {{"suspended_load.length", l}, {"suspended_load.damping", damping}},
                                {{"suspended_load.mass", 0.05 * vehicle.mass_kg}}});
        }
      }
    } else if (name == "ground_effect") {
      std::vector<double> heights;
      for (const FilteredMotion& m : flight.samples) heights.push_back(m.p_WS.z());
      std::sort(heights.begin(), heights.end());
      const double lowest = heights.front();
      const double radius = vehicle.rotors.front().radius_m;
      // At one height the ground's share is one with the thrust coefficient, and ground that may
      // lie anywhere only turns bank into torque.
      const size_t tail = heights.size() / 20;
      if (heights[heights.size() - 1 - tail] - heights[tail] < radius) continue;
      candidates.push_back({name, {{"ground_effect.z_0", 0.0}}});
      for (const double below : {1.5, 3.0}) {
        candidates.push_back({name, {{"ground_effect.z_0", lowest - below * radius}}});
      }
    } else if (name == "wind") {
      // Air speed enters some effects squared: wind has more than one valley.
      candidates.push_back({name, {}});
      for (const double w : {-4.0, 4.0}) {
        candidates.push_back({name, {}, {{"wind.w_x", w}}});
        candidates.push_back({name, {}, {{"wind.w_y", w}}});
      }
    } else {
      candidates.push_back({name, {}});
    }
  }
  return candidates;
}

Candidate Refined(const Candidate& candidate,
                  const std::function<double(const Candidate&)>& score) {
  Candidate best = candidate;
  if (candidate.effect == "mass_change") {
    // A step in time: finer and finer.
    if (best.settings.at("mass_change.from") <= 0.0) return best;
    double most = score(best);
    const double first = candidate.settings.at("mass_change.from") - 0.5 * kMassStep_s;
    for (double step = kMassStep_s / 2.0; step > kShortest_s; step /= 2.0) {
      Candidate trial = best;
      const double from = best.settings.at("mass_change.from");
      for (const double at : {std::max(first, from - step), from + step}) {
        trial.settings["mass_change.from"] = at;
        const double value = score(trial);
        if (value <= most) continue;
        most = value;
        best = trial;
      }
    }
    return best;
  }
  if (candidate.effect != "suspended_load") return best;
  const std::pair<const char*, double> ratios[] = {{"suspended_load.length", kCableRatio},
                                                   {"suspended_load.damping", kDampingRatio}};
  for (const auto& [name, ratio] : ratios) {
    const double start = best.settings.at(name);
    Candidate trial = best;
    best.settings[name] = BestBetween(start / ratio, start * ratio, [&, key = name](double value) {
      trial.settings[key] = value;
      return score(trial);
    });
  }
  return best;
}

std::vector<ParameterEstimate> DerivedFigures(const Vehicle& vehicle, const std::string& effect,
                                              const ParameterSet& online) {
  constexpr double kTurn = 6.283185307179586;
  std::vector<ParameterEstimate> derived;
  double mass_kg = vehicle.mass_kg;
  for (const ParameterEstimate& p : online.parameters) {
    if (p.full_name == "suspended_load.mass" || p.full_name == "mass_change.mass") {
      mass_kg += p.value;
    }
  }
  for (const ParameterEstimate& p : online.parameters) {
    if (p.full_name.rfind(effect + ".", 0) != 0) continue;
    if (p.full_name == "suspended_load.length") {
      derived.push_back({"suspended_load.swing_frequency", "Hz",
                         std::sqrt(vehicle.gravity_m_s2 / p.value) / kTurn, 0.0, false, false});
    }
    if (p.full_name == "suspended_load.mass" || p.full_name == "mass_change.mass") {
      derived.push_back(
          {effect + ".total_mass", p.unit, mass_kg, p.sigma, p.estimated, p.observable});
    }
  }
  return derived;
}

std::string TellingManoeuvre(const std::string& effect, const std::string& alternative) {
  struct Pair {
    const char *a, *b, *manoeuvre;
  };
  static const Pair kPairs[] = {
      {"rotor_drag", "drag", "climbs and high tilt, so that the sum of the rotor speeds varies"},
      {"rotor_drag", "quadratic_drag", "the same course at half and at full speed"},
      {"quadratic_drag", "drag", "the same course at half and at full speed"},
      {"axial_inflow", "drag", "vertical oscillation with load changes, and roll rates"},
      {"axial_inflow", "rotor_delay", "slow climbs and descents"},
      {"rotor_hvt", "hvt", "fast yaw while flying fast"},
      {"rotor_hvt", "anisotropic_hvt", "fast flight along both body axes"},
      {"anisotropic_hvt", "hvt", "fast flight along both body axes"},
      {"hub_moment", "pressure_centre", "fast flight at different rotor speeds (climbing turns)"},
      {"hub_moment", "rotor_drag", "fast flight at different rotor speeds (climbing turns)"},
      {"rotor_gyroscopic", "rotor_reaction", "yaw acceleration without roll and pitch rates"},
      {"wind", "gravity", "yaw by 90 degrees or more while flying"},
      {"wind", "rotor_tilt", "yaw by 90 degrees or more while flying"},
      {"gravity", "rotor_tilt", "yaw by 90 degrees or more while flying"},
      {"wind", "thrust_lean", "yaw by 90 degrees or more while flying"},
      {"gravity", "thrust_lean", "yaw by 90 degrees or more while flying"},
      {"rotor_tilt", "thrust_lean", "strong differential thrust: rolls and pitches"},
      {"rotor_asymmetry", "centre_of_gravity", "strong differential thrust: rolls and pitches"},
      {"rotor_asymmetry", "rotor_tilt", "strong differential thrust: rolls and pitches"},
      {"thrust_drift", "mass_change", "hover at the start and at the end of the flight"},
      {"ground_effect", "hvt", "hover at several heights"},
      {"suspended_load", "mass_change", "side steps, so that the load swings"},
      {"suspended_load", "wind", "side steps, so that the load swings"},
  };
  for (const Pair& pair : kPairs) {
    if ((effect == pair.a && alternative == pair.b) ||
        (effect == pair.b && alternative == pair.a)) {
      return pair.manoeuvre;
    }
  }
  return "";
}

}  // namespace odmc
