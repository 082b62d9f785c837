#include "odmc/attribution/candidates.h"

#include <algorithm>
#include <cmath>

#include "odmc/model/effect.h"

namespace odmc {
namespace {

// Not candidates: the base of every model, what turns the frame, what replaces other effects, and
// what needs a test of its own (gust).
const char* const kNever[] = {"thrust",      "rotor_torque",        "inertia",
                              "rotor_level", "odometry_extrinsics", "imu_extrinsics",
                              "gust"};
constexpr double kMassStep_s = 1.0;
constexpr double kCableRatio = 1.15;  // from one length to the next

bool IsListed(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
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
      candidates.push_back({name, {{"mass_change.from", 0.0}}, some});
      for (double t = start_s + 2.0; t < end_s - 2.0; t += kMassStep_s) {
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
      double lowest = flight.samples.front().p_WS.z();
      for (const FilteredMotion& m : flight.samples) lowest = std::min(lowest, m.p_WS.z());
      const double radius = vehicle.rotors.front().radius_m;
      candidates.push_back({name, {{"ground_effect.z_0", 0.0}}});
      for (const double below : {1.5, 3.0}) {
        candidates.push_back({name, {{"ground_effect.z_0", lowest - below * radius}}});
      }
    } else {
      candidates.push_back({name, {}});
    }
  }
  return candidates;
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
