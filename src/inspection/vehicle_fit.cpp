#include "odmc/inspection/vehicle_fit.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "odmc/inspection/stamp_checks.h"
#include "odmc/inspection/time_offsets.h"
#include "odmc/math/rotation_between.h"
#include "odmc/model/frame_layout.h"

namespace odmc {
namespace {

using Eigen::VectorXd;

constexpr double kTold = 0.99;
// Hardly anybody builds a frame whose spins are neither the drawing's nor their mirror image. Where
// the flight does not tell these two apart, the drawing is four times as likely as propellers
// "out".
constexpr double kOdd = 0.01, kAsDrawn = 0.8;
// Where the rotors explain this share of the turning, the torque regression was within 4 % on
// simulated flights, and within 20 % (filtered rates: 50 to 110 %) of what is published of five
// vehicles; where less, up to a factor of 14 off.
constexpr double kLeastExplained = 0.45, kInertiaSigma = 0.3;
constexpr double kLeastLikeness = 0.8;  // of the torques found and the levers
constexpr double kMostInertia = 5.0;    // over the nominal one: beyond, something else is wrong

FittedChoice ChoiceOf(double probability, double lead_nats) {
  return {probability > kTold, probability, lead_nats};
}

// ---- Spins -------------------------------------------------------------------------------------

unsigned BitsOf(const std::vector<Rotor>& rotors) {
  unsigned bits = 0;
  for (size_t j = 0; j < rotors.size(); ++j) bits |= (rotors[j].spin > 0.0 ? 1U : 0U) << j;
  return bits;
}

/// What is believed of patterns of spins before the flight, by pattern; all others are odd ones.
using SpinPriors = std::map<unsigned, double>;

/// The usual patterns alike.
SpinPriors EvenPriors(const std::vector<Rotor>& rotors) {
  SpinPriors priors;
  const std::vector<unsigned> usual = UsualSpins(rotors);
  for (const unsigned pattern : usual) {
    priors[pattern] = (1.0 - kOdd) / static_cast<double>(usual.size());
  }
  return priors;
}

/// The drawing before its mirror image, where coaxial pairs do not make both the same.
SpinPriors DrawnPriors(const std::vector<Rotor>& rotors) {
  SpinPriors priors = EvenPriors(rotors);
  if (priors.size() != 2) return priors;
  for (auto& [pattern, prior] : priors) {
    prior = (1.0 - kOdd) * (pattern == BitsOf(rotors) ? kAsDrawn : 1.0 - kAsDrawn);
  }
  return priors;
}

/// The likeliest pattern. @param nats log evidence of every pattern over the best
unsigned Likeliest(const std::vector<double>& nats, const SpinPriors& priors,
                   FittedChoice* choice) {
  const double odd = kOdd / std::max(1.0, static_cast<double>(nats.size() - priors.size()));
  std::vector<double> logs;
  for (unsigned pattern = 0; pattern < nats.size(); ++pattern) {
    const auto prior = priors.find(pattern);
    logs.push_back(nats[pattern] + std::log(prior == priors.end() ? odd : prior->second));
  }
  const auto best = std::max_element(logs.begin(), logs.end());
  double sum = 0.0, next = -std::numeric_limits<double>::infinity();
  for (auto log = logs.begin(); log != logs.end(); ++log) {
    sum += std::exp(*log - *best);
    if (log != best) next = std::max(next, *log);
  }
  *choice = ChoiceOf(1.0 / sum, *best - next);
  return static_cast<unsigned>(best - logs.begin());
}

/// @param rotors in the order of the columns, with their usual spins
void ChooseSpins(const std::vector<double>& nats, const std::vector<Rotor>& rotors,
                 VehicleFit* fit) {
  unsigned best = Likeliest(nats, EvenPriors(rotors), &fit->spin_choice);
  if (!fit->spin_choice.is_told) {
    best = Likeliest(nats, DrawnPriors(rotors), &fit->spin_choice);
    fit->spin_choice.is_told = false;
  }
  fit->spin.clear();
  for (size_t j = 0; j < rotors.size(); ++j) {
    fit->spin.push_back((best >> j & 1U) != 0U ? 1.0 : -1.0);
  }
  fit->spins_are_usual = EvenPriors(rotors).count(best) > 0;
}

/// Coaxial places whose spins are found the other way round change places: the upper rotor is the
/// one that turns as the drawing's upper one does.
void SortCoaxial(const Vehicle& nominal, VehicleFit* fit) {
  for (size_t a = 0; a < fit->order.size(); ++a) {
    for (size_t b = 0; b < a; ++b) {
      const Rotor& at_a = nominal.rotors[static_cast<size_t>(fit->order[a])];
      const Rotor& at_b = nominal.rotors[static_cast<size_t>(fit->order[b])];
      if (!IsCoaxial(at_a, at_b)) continue;
      if (fit->spin[a] == at_b.spin && fit->spin[b] == at_a.spin && at_a.spin != at_b.spin) {
        std::swap(fit->order[a], fit->order[b]);
      }
    }
  }
}

// ---- Rotors ------------------------------------------------------------------------------------

Vehicle InOrder(const Vehicle& nominal, const std::vector<int>& order) {
  Vehicle vehicle = nominal;
  for (size_t j = 0; j < order.size(); ++j) {
    vehicle.rotors[j] = nominal.rotors[static_cast<size_t>(order[j])];
  }
  return vehicle;
}

/// Inertia about x or y by what the prediction-error method finds each column's torque to be.
/// @param vehicle its rotors in the order of the columns
std::optional<ShownInertia> InertiaOf(const StreamLag& lag, const Vehicle& vehicle, double k_f,
                                      int axis) {
  if (!lag.determined() || lag.explained < kLeastExplained) return std::nullopt;
  if (lag.gain.rows() < vehicle.num_rotors() || lag.gain.cols() != 2) return std::nullopt;
  VectorXd lever(vehicle.num_rotors());
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    const Eigen::Vector3d& p = vehicle.rotors[static_cast<size_t>(j)].p_BP;
    lever[j] = axis == 0 ? p.y() : -p.x();
  }
  const VectorXd gain = lag.gain.col(axis).head(vehicle.num_rotors());
  const double along = lever.dot(gain);
  if (along < kLeastLikeness * lever.norm() * gain.norm()) return std::nullopt;
  const double inertia = k_f * lever.squaredNorm() / along;
  const double ratio = inertia / vehicle.inertia_kg_m2[axis];
  if (!(ratio < kMostInertia && ratio > 1.0 / kMostInertia)) return std::nullopt;
  return ShownInertia{inertia, kInertiaSigma};
}

void FitInertia(const MotionSignals& signals, const std::vector<bool>& flight,
                const Vehicle& nominal, VehicleFit* fit) {
  if (!fit->balance || !fit->rotors_tested) return;
  const std::optional<TimeOffset> torque = RotorOffset(signals, nominal, flight);
  if (!torque) return;
  const Vehicle ordered = InOrder(nominal, fit->order);
  const double k_f = nominal.mass_kg * fit->balance->k_f_over_mass;
  fit->inertia_x = InertiaOf(torque->lag, ordered, k_f, 0);
  fit->inertia_y = InertiaOf(torque->lag, ordered, k_f, 1);
}

std::vector<FrameFit> OtherFrames(const RotorResponse& response, const Vehicle& nominal,
                                  const RotorAssignment& assignment) {
  std::vector<FrameFit> frames;
  for (const std::string& name : FramesOf(nominal.num_rotors())) {
    Vehicle other = nominal;
    const std::vector<FramePlace> places = FrameLayout(name, Autopilot::kPx4);
    const double half_m = nominal.ArmLength();
    other.rotors = RotorsAt(places, half_m, half_m, nominal.rotors.front().radius_m);
    // Arms of the same length: RotorsAt() stretches frames whose hubs are not on the axes.
    const double stretch = half_m / other.ArmLength();
    for (Rotor& rotor : other.rotors) rotor.p_BP *= stretch;
    const RotorAssignment fit = TestRotorAssignment(response, other);
    const double misfit = std::min(fit.misfit, assignment.misfit);
    frames.push_back({name, (fit.log_evidence - assignment.log_evidence) / misfit});
  }
  return frames;
}

void FitRotors(const FlightLog& log, const Vehicle& nominal, VehicleFit* fit) {
  const RotorResponse response = MeasureRotorResponse(CutRotorBlocks(log, nominal), nominal);
  const RotorAssignment places = TestRotorAssignment(response, nominal);
  if (!places.tested) return;
  fit->rotors_tested = true;
  fit->flight_s = 0.5 * (response.blocks + 1);
  fit->order = places.order;
  fit->order_choice = ChoiceOf(places.places.best_share, places.places.lead);
  fit->nominal_order_probability = places.places.file_share;
  const Vehicle ordered = InOrder(nominal, places.order);
  ChooseSpins(TestRotorAssignment(response, ordered).spin_nats, ordered.rotors, fit);
  SortCoaxial(nominal, fit);
  fit->other_frames = OtherFrames(response, nominal, places);
}

}  // namespace

bool IsOfVehicle(const Finding& finding) {
  for (const char* check : {"vehicle_units", "inertia_bounds", "inertia", "gravity", "weight",
                            "body_lean", "rotor_unit", "battery_unit"}) {
    if (finding.check == check) return true;
  }
  return false;
}

VehicleFit FitVehicle(FlightLog log, const Vehicle& nominal) {
  VehicleFit fit;
  std::vector<Finding> stamps = EvenOutStamps(&log);
  fit.streams = InspectStreams(log, nominal);
  fit.streams.findings.insert(fit.streams.findings.begin(), stamps.begin(), stamps.end());
  if (!fit.streams.refusal.empty()) return fit;
  MendStreams(fit.streams, &log);
  const std::optional<MotionSignals> signals = SignalsOf(log);
  if (!signals) return fit;
  const std::vector<bool> flight = FindFlight(*signals);
  fit.balance = BalanceForces(*signals, nominal.gravity_m_s2, flight);
  const auto& findings = fit.streams.findings;
  fit.leans = fit.balance && std::any_of(findings.begin(), findings.end(),
                                         [](const Finding& f) { return f.check == "body_lean"; });
  Vehicle upright = nominal;
  if (fit.leans) {
    upright.odometry.q_BS = RotationBetween(fit.balance->thrust_axis_S, Eigen::Vector3d::UnitZ());
  }
  FitRotors(log, upright, &fit);
  FitInertia(*signals, flight, upright, &fit);
  return fit;
}

}  // namespace odmc
