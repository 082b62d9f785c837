#include "odmc/analysis/new_vehicle.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <stdexcept>

#include "odmc/effects/effects.h"
#include "odmc/inspection/rotor_assignment.h"
#include "odmc/math/rotation_between.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kArm_m = 0.13, kRadiusShare = 0.8;
constexpr double kInertiaShare = 0.22, kYawShare = 0.85, kInertiaGuessSigma = 0.3;
constexpr double kReactionShare = 0.2;  // k_m over k_f and the propeller's radius
constexpr double kReactionSigma = 0.3;
constexpr double kThrustSigma = 0.2;  // what was found is not counted twice: a wide prior
// Without a flight: tips of propellers hover at 40 to 100 m/s.
constexpr double kTipSpeed_m_s = 60.0, kGuessedThrustSigma = 0.7;
// Readings come in the order of the autopilot's numbers far more often than in any other.
constexpr double kOddsOfNumbers = 10.0;
constexpr double kOtherFrame = 7.0;  // nats: a thousand to one
constexpr double kBadScatter = 0.1;  // of k_f: the rotors hardly explain the motion

/// To four digits: what is guessed or found has no more.
double ToFourDigits(double value) { return std::strtod(Rounded(value, 4).c_str(), nullptr); }

void RefuseLength(size_t length, size_t rotors, const std::string& what) {
  if (length == 0 || length == rotors) return;
  throw std::invalid_argument(what + " has " + std::to_string(length) + " entries, the vehicle " +
                              std::to_string(rotors) + " rotors");
}

void RefuseNoOrder(const std::vector<int>& places, size_t rotors) {
  RefuseLength(places.size(), rotors, "the list of places");
  std::vector<int> sorted = places;
  std::sort(sorted.begin(), sorted.end());
  for (size_t j = 0; j < sorted.size(); ++j) {
    if (sorted[j] != static_cast<int>(j) + 1) {
      throw std::invalid_argument("the list of places must name each motor from 1 to " +
                                  std::to_string(rotors) + " once");
    }
  }
}

double GuessedArm(double mass_kg) { return kArm_m * std::cbrt(mass_kg); }

/// Half the least horizontal distance of two hubs that are not above each other.
double HalfGap(const std::vector<Rotor>& rotors) {
  double least = 1e9;
  for (size_t j = 0; j < rotors.size(); ++j) {
    for (size_t i = 0; i < j; ++i) {
      if (IsCoaxial(rotors[i], rotors[j])) continue;
      least = std::min(least, (rotors[i].p_BP - rotors[j].p_BP).head<2>().norm());
    }
  }
  return 0.5 * least;
}

std::vector<Rotor> RotorsOf(const KnownVehicle& known) {
  const std::vector<FramePlace> places = FrameLayout(known.frame, known.autopilot);
  if (known.half_m) return RotorsAt(places, known.half_m->x(), known.half_m->y(), 0.0);
  const double arm_m = known.arm_m.value_or(GuessedArm(known.mass_kg));
  std::vector<Rotor> rotors;
  for (const FramePlace& place : places) {
    const Eigen::Vector3d p_BP = arm_m * place.direction;
    rotors.push_back({p_BP.unaryExpr(&ToFourDigits), place.spin, 0.0});
  }
  return rotors;
}

// ---- Words -------------------------------------------------------------------------------------

/// Builds the vehicle entry by entry, each with its mark.
class Maker {
 public:
  Maker(const KnownVehicle& known, const VehicleFit* fit, const std::string& flight)
      : known_(known), fit_(fit), flight_(flight), nominal_(VehicleBeforeFlight(known)) {
    made_.vehicle = nominal_;
  }

  NewVehicle Make() {
    Head();
    Mark("mass_kg", "asked", "everything else scales with it: weigh the vehicle ready to fly");
    Order();
    Spins();
    RotorMarks();
    Inertia();
    Odometry();
    Thrust();
    Reaction();
    OtherFrames();
    return std::move(made_);
  }

 private:
  bool tested() const { return fit_ != nullptr && fit_->rotors_tested; }
  bool has_balance() const {
    return fit_ != nullptr && fit_->balance && fit_->balance->relative_sigma < kBadScatter;
  }

  void Mark(const std::string& key, const std::string& source, const std::string& why) {
    made_.comments.key[key] = source + ": " + why;
    made_.report.push_back(key + " " + source + ": " + why);
  }

  void Head() {
    made_.comments.head.push_back(
        "Vehicle file of new_vehicle" + (flight_.empty() ? "" : ", from " + flight_) +
        ". found: the flight shows it (nats: log odds against the next likely). guessed: by the "
        "formula beside it. asked: given on the command line.");
    made_.comments.head.push_back(
        "Frame B: x forward, y left, z up, origin in the middle of the rotor hubs. All numbers in "
        "SI "
        "units, with a decimal point (1.0e-06, not 1e-06).");
  }

  std::string Numbering() const {
    if (known_.drawing) return "the drawing";
    return std::string(Name(known_.autopilot)) + "'s " + known_.frame;
  }

  std::string NumbersOf(const std::vector<int>& order) const {
    std::vector<std::string> numbers;
    for (const int place : order) numbers.push_back(std::to_string(place + 1));
    return Listed(numbers);
  }

  void Order() {
    const int n = nominal_.num_rotors();
    made_.order.clear();
    for (int j = 0; j < n; ++j) made_.order.push_back(j);
    if (!known_.places.empty()) {
      for (size_t j = 0; j < made_.order.size(); ++j) made_.order[j] = known_.places[j] - 1;
      order_mark_ = "asked";
      order_why_ = "readings are those of motors " + NumbersOf(made_.order) + " of " + Numbering();
      if (tested() && fit_->order_choice.is_told && fit_->order != made_.order) {
        made_.advice.push_back(
            "the flight says that readings are those of motors " + NumbersOf(fit_->order) + " (" +
            Rounded(fit_->order_choice.lead_nats) + " nats); what was asked for stays");
      }
    } else if (tested() && fit_->order_choice.is_told) {
      made_.order = fit_->order;
      order_mark_ = "found";
      order_why_ = "readings are those of motors " + NumbersOf(made_.order) + " of " + Numbering() +
                   ", " + Rounded(fit_->order_choice.lead_nats) + " nats before any other order (" +
                   Rounded(fit_->flight_s) + " s of flight)";
    } else {
      GuessOrder();
    }
    for (size_t j = 0; j < made_.order.size(); ++j) {
      made_.vehicle.rotors[j] = nominal_.rotors[static_cast<size_t>(made_.order[j])];
    }
  }

  void GuessOrder() {
    order_mark_ = known_.autopilot_asked ? "asked" : "guessed";
    order_why_ = "readings in the order of " + Numbering();
    if (fit_ == nullptr) return;
    if (!tested()) {
      made_.advice.push_back(
          "the flight says nothing of the rotors' order and spins: it needs rotor speeds and poses "
          "or "
          "body rates at 15 Hz and more, " +
          std::to_string(std::max(5, nominal_.num_rotors() + 1)) +
          " blocks of half a second in flight; fly ten seconds with brisk rolls, pitches and yaws");
      return;
    }
    const double likeliest = fit_->order_choice.probability;
    if (likeliest > kOddsOfNumbers * fit_->nominal_order_probability) {
      made_.order = fit_->order;
      order_mark_ = "guessed";
      order_why_ = "readings are those of motors " + NumbersOf(made_.order) + " of " + Numbering();
    }
    order_why_ += "; the flight does not tell orders apart: the likeliest, " +
                  NumbersOf(fit_->order) + ", has a probability of " + Rounded(likeliest);
    made_.advice.push_back("the flight does not tell the rotors' order (likeliest " +
                           NumbersOf(fit_->order) + ", probability " +
                           Rounded(fit_->order_choice.probability) +
                           "): fly brisk rolls and pitches, one after the other, for ten seconds");
  }

  /// True if the order is the one that the flight's spins were judged in.
  bool order_is_fits() const { return tested() && made_.order == fit_->order; }

  void Spins() {
    std::vector<double> drawn;
    for (const Rotor& rotor : made_.vehicle.rotors) drawn.push_back(rotor.spin);
    std::vector<double> spins = drawn;
    if (!known_.spins.empty()) {
      spins = known_.spins;
      spin_mark_ = "asked";
      spin_why_ = SpinText(spins);
    } else if (tested() && fit_->spin_choice.is_told) {
      spins = fit_->spin;
      spin_mark_ = "found";
      spin_why_ = SpinText(spins) + ", " + Rounded(fit_->spin_choice.lead_nats) +
                  " nats before any others by the yaw motion";
      if (!fit_->spins_are_usual) spin_why_ += "; no usual frame has these: look at the propellers";
    } else {
      spin_mark_ = "guessed";
      spin_why_ = SpinText(spins) + ", as " + Numbering() + " turn";
      if (tested()) GuessSpins(&spins);
    }
    for (size_t j = 0; j < spins.size(); ++j) made_.vehicle.rotors[j].spin = spins[j];
    if (spins != drawn && !known_.drawing) spin_why_ += "; not as the autopilot's drawing";
  }

  void GuessSpins(std::vector<double>* spins) {
    if (order_is_fits()) *spins = fit_->spin;
    spin_why_ = SpinText(*spins) + ", the likeliest (probability " +
                Rounded(fit_->spin_choice.probability) + "; before the flight 80 % for those of " +
                Numbering() + "): yaw is hardly excited";
    made_.advice.push_back("the flight does not tell the rotors' spins (likeliest " +
                           SpinText(*spins) + ", probability " +
                           Rounded(fit_->spin_choice.probability) +
                           "): look at the propellers, or fly quick yaw steps for ten seconds");
  }

  void RotorMarks() {
    std::string why = "order " + order_mark_ + ": " + order_why_ + ". Spins " + spin_mark_ + ": " +
                      spin_why_ + ". ";
    if (known_.drawing) {
      why += "Places asked: the drawing's.";
    } else if (known_.half_m) {
      why += "Places asked: " + known_.frame + ", x " + Rounded(known_.half_m->x()) + " m, y " +
             Rounded(known_.half_m->y()) + " m.";
    } else if (known_.arm_m) {
      why += "Places asked: " + known_.frame + ", arm " + Rounded(*known_.arm_m) + " m.";
    } else {
      why += "Places guessed: " + known_.frame +
             ", arm 0.13 m (m/kg)^(1/3), x and y alike; a flight "
             "shows arm over inertia, not the arm: measure it.";
    }
    if (!known_.drawing) {
      why += known_.radius_m ? " Radius asked."
                             : " Radius guessed: 0.8 times half the least distance of two hubs.";
    }
    made_.comments.key["rotors"] = why;
    made_.report.push_back("rotor order " + order_mark_ + ": " + order_why_);
    made_.report.push_back("spins " + spin_mark_ + ": " + spin_why_);
    made_.report.push_back(
        "places " +
        std::string(known_.drawing || known_.half_m || known_.arm_m ? "asked" : "guessed") +
        ": arm " + Rounded(made_.vehicle.ArmLength()) + " m");
    if (known_.drawing) return;
    const std::vector<FramePlace> places = FrameLayout(known_.frame, known_.autopilot);
    for (const int place : made_.order) {
      made_.comments.rotor.push_back(places[static_cast<size_t>(place)].name + ", motor " +
                                     std::to_string(place + 1));
    }
  }

  void Inertia() {
    const bool shown = order_is_fits() && fit_->inertia_x && fit_->inertia_y;
    if (known_.inertia_kg_m2 || known_.drawing) {
      return Mark("inertia_kg_m2", "asked",
                  known_.drawing && !known_.inertia_kg_m2 ? "the drawing's" : "as given");
    }
    const std::string formula = "0.22 m arm^2 about x and y (0.17 to 0.33 on seven vehicles)";
    const std::string yaw = "0.85 (I_x + I_y) about z";
    if (!shown) return Mark("inertia_kg_m2", "guessed", formula + ", " + yaw);
    Eigen::Vector3d& inertia = made_.vehicle.inertia_kg_m2;
    inertia.x() = Refined(nominal_.inertia_kg_m2.x(), *fit_->inertia_x);
    inertia.y() = Refined(nominal_.inertia_kg_m2.y(), *fit_->inertia_y);
    inertia.z() = ToFourDigits(kYawShare * (inertia.x() + inertia.y()));
    std::string error;
    if (!made_.vehicle.IsValid(&error)) {
      inertia = nominal_.inertia_kg_m2;
      return Mark("inertia_kg_m2", "guessed", formula + ", " + yaw);
    }
    Mark("inertia_kg_m2", "found",
         "about x and y the mean of what thrust, arm and angular acceleration show (" +
             Rounded(fit_->inertia_x->value_kg_m2) + " and " +
             Rounded(fit_->inertia_y->value_kg_m2) + ", +- 30 %) and the guess " + formula +
             "; guessed: " + yaw);
  }

  /// Geometric mean, weighed by relative sigmas.
  static double Refined(double guess, const ShownInertia& shown) {
    const double by_guess = std::pow(kInertiaGuessSigma, -2);
    const double by_motion = std::pow(shown.relative_sigma, -2);
    return ToFourDigits(
        std::exp((by_guess * std::log(guess) + by_motion * std::log(shown.value_kg_m2)) /
                 (by_guess + by_motion)));
  }

  void Odometry() {
    if (fit_ == nullptr || !fit_->leans) {
      if (fit_ != nullptr) {
        return Mark("odometry", has_balance() ? "found" : "guessed",
                    has_balance() ? "the pose's z is along the thrust (lean " +
                                        Degrees(fit_->balance->lean_rad) + " +- " +
                                        Degrees(fit_->balance->lean_sigma_rad) +
                                        " degrees); its origin is taken for B's"
                                  : "the pose is taken for that of B");
      }
      return Mark("odometry", "guessed", "the pose is taken for that of B");
    }
    SensorMount& mount = made_.vehicle.odometry;
    mount.q_BS = RotationBetween(fit_->balance->thrust_axis_S, Eigen::Vector3d::UnitZ());
    mount.estimate = true;
    made_.vehicle.effects.push_back("odometry_extrinsics");
    Mark("odometry", "found",
         "the pose's frame leans by " + Degrees(fit_->balance->lean_rad) + " +- " +
             Degrees(fit_->balance->lean_sigma_rad) +
             " degrees against the thrust axis; its turn about z and its origin are taken for B's");
  }

  static std::string Degrees(double angle_rad) { return Rounded(angle_rad * 180.0 / M_PI, 2); }

  void Thrust() {
    ParameterSetting& k_f = made_.vehicle.parameters["thrust.k_f"];
    k_f.estimated = true;
    if (has_balance()) {
      const ForceBalance& b = *fit_->balance;
      k_f.value = ToFourDigits(known_.mass_kg * b.k_f_over_mass);
      k_f.sigma = ToFourDigits(kThrustSigma * *k_f.value);
      return Mark("thrust.k_f", "found",
                  Rounded(*k_f.value) + " N s^2 +- " + Rounded(100.0 * b.relative_sigma, 2) +
                      " % carries the mass over " + Rounded(0.1 * b.windows) +
                      " s of flight (hover at " + Fixed(b.hover_speed_rad_s, 0) +
                      " rad/s); the prior is 20 % wide, for calibrate may see the same flight");
    }
    const double speed = kTipSpeed_m_s / made_.vehicle.rotors.front().radius_m;
    const double weight_N = known_.mass_kg * nominal_.gravity_m_s2;
    k_f.value = ToFourDigits(weight_N / (nominal_.num_rotors() * speed * speed));
    k_f.sigma = ToFourDigits(kGuessedThrustSigma * *k_f.value);
    Mark("thrust.k_f", "guessed", "hover with propeller tips at 60 m/s");
    if (fit_ != nullptr) {
      made_.advice.push_back(
          "the flight does not show k_f: fly ten seconds of hover and slow figures, with rotor "
          "speeds");
    }
  }

  void Reaction() {
    ParameterSetting& k_m = made_.vehicle.parameters["rotor_torque.k_m"];
    k_m.value = ToFourDigits(kReactionShare * made_.vehicle.rotors.front().radius_m *
                             *made_.vehicle.parameters["thrust.k_f"].value);
    k_m.sigma = ToFourDigits(kReactionSigma * *k_m.value);
    k_m.estimated = false;
    Mark(
        "rotor_torque.k_m", "guessed",
        "k_f times 0.2 propeller radii; frozen, since gentle flight can't tell it from the inertia "
        "about z");
  }

  void OtherFrames() {
    if (!tested() || known_.drawing) return;
    for (const FrameFit& other : fit_->other_frames) {
      if (other.frame == known_.frame || other.nats < kOtherFrame) continue;
      made_.advice.push_back("the rotors' places fit " + other.frame + " better than " +
                             known_.frame + ", by " + Rounded(other.nats) + " nats: --frame " +
                             other.frame);
    }
  }

  const KnownVehicle& known_;
  const VehicleFit* fit_;
  const std::string flight_;
  const Vehicle nominal_;
  NewVehicle made_;
  std::string order_mark_, order_why_, spin_mark_, spin_why_;
};

}  // namespace

Vehicle VehicleBeforeFlight(const KnownVehicle& known) {
  Vehicle vehicle;
  if (known.drawing) {
    vehicle = *known.drawing;
    vehicle.inertia_kg_m2 *= known.mass_kg / vehicle.mass_kg;
  } else {
    vehicle.rotors = RotorsOf(known);
    const double radius_m =
        known.radius_m.value_or(ToFourDigits(kRadiusShare * HalfGap(vehicle.rotors)));
    for (Rotor& rotor : vehicle.rotors) rotor.radius_m = radius_m;
    const double about_x = kInertiaShare * known.mass_kg * std::pow(vehicle.ArmLength(), 2);
    vehicle.inertia_kg_m2 = {ToFourDigits(about_x), ToFourDigits(about_x),
                             ToFourDigits(2.0 * kYawShare * about_x)};
    vehicle.effects = DefaultEffects();
  }
  vehicle.name = known.name;
  vehicle.mass_kg = known.mass_kg;
  if (known.inertia_kg_m2) vehicle.inertia_kg_m2 = *known.inertia_kg_m2;
  RefuseNoOrder(known.places, vehicle.rotors.size());
  RefuseLength(known.spins.size(), vehicle.rotors.size(), "the list of spins");
  std::string error;
  if (!vehicle.IsValid(&error)) throw std::invalid_argument(error);
  return vehicle;
}

NewVehicle MakeVehicle(const KnownVehicle& known, const VehicleFit* fit,
                       const std::string& flight) {
  return Maker(known, fit, flight).Make();
}

}  // namespace odmc
