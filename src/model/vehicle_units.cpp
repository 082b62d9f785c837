#include "odmc/model/vehicle_units.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "odmc/text/format.h"

namespace odmc {
namespace {

/// Factors by which quantities of a file differ from SI.
struct Slip {
  const char* what;
  const char* mend;
  double arm, radius, inertia, mass;
};

constexpr Slip kSlips[] = {
    {"rotor positions (position_m) are in mm", "divide position_m of the rotors by 1000", 1e3, 1.0,
     1.0, 1.0},
    {"rotor positions (position_m) are in cm", "divide position_m of the rotors by 100", 1e2, 1.0,
     1.0, 1.0},
    {"rotor positions (position_m) are 10 times too large", "divide position_m of the rotors by 10",
     10.0, 1.0, 1.0, 1.0},
    {"rotor positions (position_m) are 10 times too small",
     "multiply position_m of the rotors by 10", 0.1, 1.0, 1.0, 1.0},
    {"rotor positions and radii are in mm", "divide position_m and radius_m of the rotors by 1000",
     1e3, 1e3, 1.0, 1.0},
    {"rotor positions and radii are in cm", "divide position_m and radius_m of the rotors by 100",
     1e2, 1e2, 1.0, 1.0},
    {"propeller radii (radius_m) are in mm", "divide radius_m by 1000", 1.0, 1e3, 1.0, 1.0},
    {"propeller radii (radius_m) are in cm", "divide radius_m by 100", 1.0, 1e2, 1.0, 1.0},
    {"propeller radii (radius_m) are in inches", "multiply radius_m by 0.0254", 1.0, 39.37, 1.0,
     1.0},
    {"inertia (inertia_kg_m2) is in g cm^2", "multiply inertia_kg_m2 by 1.0e-07", 1.0, 1.0, 1e7,
     1.0},
    {"inertia (inertia_kg_m2) is in kg cm^2", "multiply inertia_kg_m2 by 1.0e-04", 1.0, 1.0, 1e4,
     1.0},
    {"inertia (inertia_kg_m2) is in kg mm^2", "multiply inertia_kg_m2 by 1.0e-06", 1.0, 1.0, 1e6,
     1.0},
    {"inertia (inertia_kg_m2) is in g mm^2", "multiply inertia_kg_m2 by 1.0e-09", 1.0, 1.0, 1e9,
     1.0},
    {"inertia (inertia_kg_m2) is in g m^2", "multiply inertia_kg_m2 by 1.0e-03", 1.0, 1.0, 1e3,
     1.0},
    {"inertia (inertia_kg_m2) is 10 times too large", "divide inertia_kg_m2 by 10", 1.0, 1.0, 10.0,
     1.0},
    {"inertia (inertia_kg_m2) is 10 times too small", "multiply inertia_kg_m2 by 10", 1.0, 1.0, 0.1,
     1.0},
    {"mass (mass_kg) is in g", "divide mass_kg by 1000", 1.0, 1.0, 1.0, 1e3}};
constexpr double kSlipsAre = 0.1;  // of the files, any of them

/// A ratio in which multirotors are alike: median and spread of its logarithm.
struct Alike {
  double typical, log_sigma;
};

// Nine vehicles of 35 g to 1.7 kg: 0.49 to 0.55, 0.19 to 0.29, 15 to 74 kg/m². Propellers of
// neighbours must not touch (0.71 of the arm of a quadrotor) and small ones on long arms are rare;
// the spreads are twice to three times what these vehicles show.
constexpr Alike kRadiusOverArm{0.48, 0.35}, kInertiaOverArm{0.22, 0.5}, kMassOverArea{35.0, 0.8};

double LogDensity(double log_ratio, const Alike& alike) {
  const double z = (log_ratio - std::log(alike.typical)) / alike.log_sigma;
  return -0.5 * z * z;
}

/// Logarithms of the three ratios.
struct Ratios {
  double radius_over_arm = 0.0, inertia_over_arm = 0.0, mass_over_area = 0.0;

  explicit Ratios(const Vehicle& vehicle) {
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    const double n = vehicle.num_rotors();
    for (const Rotor& rotor : vehicle.rotors) middle += rotor.p_BP / n;
    double arm_m = 0.0, radius_m = 0.0;
    for (const Rotor& rotor : vehicle.rotors) {
      arm_m += (rotor.p_BP - middle).head<2>().norm() / n;
      radius_m += rotor.radius_m / n;
    }
    const double inertia = 0.5 * (vehicle.inertia_kg_m2.x() + vehicle.inertia_kg_m2.y());
    radius_over_arm = std::log(radius_m / arm_m);
    inertia_over_arm = std::log(inertia / (vehicle.mass_kg * arm_m * arm_m));
    mass_over_area = std::log(vehicle.mass_kg / (n * M_PI * radius_m * radius_m));
  }

  /// Of what the file would say with this slip mended.
  double LogDensityWithout(const Slip& slip) const {
    const double arm = std::log(slip.arm), radius = std::log(slip.radius);
    const double mass = std::log(slip.mass), inertia = std::log(slip.inertia);
    return LogDensity(radius_over_arm - radius + arm, kRadiusOverArm) +
           LogDensity(inertia_over_arm - inertia + mass + 2.0 * arm, kInertiaOverArm) +
           LogDensity(mass_over_area - mass + 2.0 * radius, kMassOverArea);
  }
};

}  // namespace

std::string UnitError::Sentence() const {
  return what + Format(" (probability %.3g); ", best_share) + mend;
}

UnitError FindUnitError(const Vehicle& vehicle) {
  const Ratios ratios(vehicle);
  const double log_right =
      std::log(1.0 - kSlipsAre) + ratios.LogDensityWithout({"", "", 1.0, 1.0, 1.0, 1.0});
  if (!std::isfinite(log_right)) return {};
  const double log_prior = std::log(kSlipsAre / static_cast<double>(std::size(kSlips)));
  double most = log_right;
  const Slip* best = nullptr;
  std::array<double, std::size(kSlips)> log{};
  double log_best = -1e300;
  for (size_t i = 0; i < std::size(kSlips); ++i) {
    log[i] = log_prior + ratios.LogDensityWithout(kSlips[i]);
    most = std::max(most, log[i]);
    if (log[i] <= log_best) continue;
    log_best = log[i];
    best = &kSlips[i];
  }
  double sum = std::exp(log_right - most);
  for (const double l : log) sum += std::exp(l - most);
  return {std::exp(log_right - most) / sum, std::exp(log_best - most) / sum, best->what,
          best->mend};
}

}  // namespace odmc
