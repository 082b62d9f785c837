#include "odmc/inspection/rotor_units.h"

#include <algorithm>
#include <cmath>

#include "odmc/inspection/motion_signals.h"
#include "odmc/math/statistics.h"
#include "odmc/sensing/plausible.h"
#include "odmc/text/format.h"
#include "rotor_unit_check.h"

namespace odmc {
namespace {

constexpr double kToRpm = 30.0 / M_PI;
constexpr int kLeastPolePairs = 2, kMostPolePairs = 14;
constexpr double kRunnerUp = 0.05;  // of the probability
constexpr size_t kFewWindows = 10;

// Four files in five know k_f as well as they say, but for 25 % at least: battery, other
// propellers, ground effect, the mass on the day.
constexpr double kFileKnows = 0.8, kLeastSigma = 0.25;
// k_f over radius^4: thrust coefficients (of density, turns and diameter) from 0.1 to 0.4 in nine
// vehicles of 2 to 5 inches, some with guessed radii, which enter by their fourth power.
constexpr double kPerRadius4 = 0.1, kLogSigma = 0.7;

struct Unit {
  std::string name, mend;
  double factor;  // readings over rad/s
  double prior;
};

std::string Divide(const std::string& by) {
  return "divide the readings (columns rotor1, ...) by " + by;
}

std::vector<Unit> Units() {
  std::vector<Unit> units = {
      {"rad/s", "", 1.0, 0.7},
      {"rpm", Divide("9.549") + "; of a bag: rotor_speed_unit: rpm", kToRpm, 0.1},
      {"krpm", Divide("0.009549"), 1e-3 * kToRpm, 0.02},
      {"turns per second (Hz)", Divide("0.1592"), 0.5 / M_PI, 0.05},
      {"deg/s", Divide("57.3"), 180.0 / M_PI, 0.01}};
  const double pairs = kMostPolePairs - kLeastPolePairs + 1;
  for (int p = kLeastPolePairs; p <= kMostPolePairs; ++p) {
    const std::string of =
        " of " + std::to_string(p) + " pole pairs (" + std::to_string(2 * p) + " poles)";
    units.push_back({"erpm" + of,
                     Divide(Format("%.4g", p * kToRpm)) +
                         "; of a bag: rotor_speed_unit: erpm, pole_pairs: " + std::to_string(p),
                     p * kToRpm, 0.1 / pairs});
    units.push_back(
        {"electric rad/s" + of, Divide(std::to_string(p)), static_cast<double>(p), 0.02 / pairs});
  }
  return units;
}

double Density(double x, double sigma) { return std::exp(-0.5 * x * x / (sigma * sigma)) / sigma; }

/// Of a thrust coefficient, up to a factor. @param setting what the file says of it
double PriorOf(double k_f, const ParameterSetting& setting, const Vehicle& vehicle) {
  const double radius = vehicle.rotors.front().radius_m;
  const double by_size = Density(std::log(k_f / (kPerRadius4 * std::pow(radius, 4))), kLogSigma);
  const double file = *setting.value;
  const double relative = setting.sigma ? *setting.sigma / file : kLogSigma;
  const double sigma = std::clamp(relative, kLeastSigma, kLogSigma);
  return kFileKnows * Density(std::log(k_f / file), sigma) + (1.0 - kFileKnows) * by_size;
}

}  // namespace

RotorUnit FindRotorUnit(double carrying_k_f, const Vehicle& vehicle) {
  if (!(carrying_k_f > 0.0) || !std::isfinite(carrying_k_f)) return {};
  const auto setting = vehicle.parameters.find("thrust.k_f");
  if (setting == vehicle.parameters.end() || !setting->second.value) return {};
  if (!(*setting->second.value > 0.0)) return {};
  std::vector<Unit> units = Units();
  double sum = 0.0;
  for (Unit& unit : units) {
    unit.prior *= PriorOf(carrying_k_f * unit.factor * unit.factor, setting->second, vehicle);
    sum += unit.prior;
  }
  if (!(sum > 0.0)) return {};
  RotorUnit result;
  result.declared_share = units.front().prior / sum;
  std::sort(units.begin(), units.end(),
            [](const Unit& a, const Unit& b) { return a.prior > b.prior; });
  result.best = units[0].name;
  result.best_share = units[0].prior / sum;
  result.mend = units[0].mend;
  for (size_t i = 1; i < units.size() && units[i].prior > kRunnerUp * sum; ++i) {
    result.or_best += (i == 1 ? "" : ", ") + units[i].name;
  }
  return result;
}

std::optional<Finding> RotorUnitFinding(double carrying_k_f, const Vehicle& vehicle) {
  const RotorUnit unit = FindRotorUnit(carrying_k_f, vehicle);
  if (!unit.Refutes()) return std::nullopt;
  const std::string alternative = unit.or_best.empty() ? "" : ", or " + unit.or_best;
  return Finding{"rotor_unit", Trust::kBad,
                 "the rotor speeds are not in rad/s but in " + unit.best + " (probability " +
                     Format("%.2g", unit.best_share) + alternative + "; of rad/s " +
                     Format("%.1g", unit.declared_share) +
                     "): as they are, the vehicle would fly with a k_f of " +
                     Format("%.2g", carrying_k_f) + " N s^2",
                 unit.mend};
}

namespace {

/// k_f that carries the mass, wherever the thrust points and however the body turns.
std::optional<double> CarryingThrust(const MotionWindows& w, const Vehicle& vehicle) {
  std::vector<double> ratios;
  for (int i = 0; i < w.rotors.cols(); ++i) {
    const Eigen::Vector3d force_W =
        Eigen::Vector3d(w.acceleration_W.col(i)) + vehicle.gravity_m_s2 * Eigen::Vector3d::UnitZ();
    const double squares = w.rotors.col(i).sum();
    if (squares > 0.0) ratios.push_back(vehicle.mass_kg * force_W.norm() / squares);
  }
  if (ratios.size() < kFewWindows) return std::nullopt;
  return Median(ratios);
}

}  // namespace

std::optional<Finding> CheckRotorUnit(const MotionWindows& windows, const Vehicle& vehicle) {
  const auto k_f = CarryingThrust(windows, vehicle);
  return k_f ? RotorUnitFinding(*k_f, vehicle) : std::nullopt;
}

std::string ImpossibleRotorUnit(const FlightLog& log, const Vehicle& vehicle) {
  std::vector<double> fastest;
  for (const RotorSample& sample : log.rotors) {
    if (!sample.speed.allFinite() || sample.speed.size() == 0) continue;
    const double most = sample.speed.cwiseAbs().maxCoeff();
    if (most > 0.0) fastest.push_back(most);
  }
  if (!(Median(fastest) > kMostRotorSpeed_rad_s)) return "";
  const std::optional<MotionSignals> signals = SignalsOf(log);
  if (!signals) return "";
  const auto finding = CheckRotorUnit(WindowsOf(*signals, FindFlight(*signals)), vehicle);
  return finding ? Sentence(*finding) : "";
}

}  // namespace odmc
