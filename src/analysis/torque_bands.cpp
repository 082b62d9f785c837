#include "odmc/analysis/torque_bands.h"

#include <algorithm>
#include <cmath>

#include "flight_torque.h"
#include "odmc/text/format.h"

namespace odmc {

std::array<BandedQuantity*, 4> TorqueBands::Quantities() {
  return {&inertia[0], &inertia[1], &k_m_over_I, &J_r_over_I};
}

void TorqueBands::Refuse(const std::string& reason) {
  why = reason;
  for (BandedQuantity* quantity : Quantities()) quantity->why = reason;
}

namespace {

/// I_z by what the vehicle file says, with its sigma also where it is frozen or no parameter (a
/// nominal inertia is a guess, or weighed), and by the other two: a body has at most their sum, and
/// a vehicle that is wider than high at least the larger.
void TakeInertiaZ(const DynamicModel& model, const ModelValues& values, const TorqueBands& bands,
                  ReactionCheck* check) {
  const int k = model.IndexOf("inertia.z");
  const DynamicModel alone(model.vehicle(), {"inertia"});
  const ModelParameter& p = alone.parameters()[alone.IndexOf("inertia.z")];
  const bool is_frozen = k >= 0 && !model.parameters()[k].estimated;
  double mean = std::log(is_frozen ? values[k] : p.spec.prior_value);
  double variance = std::pow(p.spec.prior_sigma / p.spec.prior_value, 2);
  if (bands.inertia[0].value && bands.inertia[1].value) {
    const double I_x = *bands.inertia[0].value, I_y = *bands.inertia[1].value;
    const double low = std::log(std::max(I_x, I_y)), high = std::log(I_x + I_y);
    const double relative = std::max(bands.inertia[0].sigma / I_x, bands.inertia[1].sigma / I_y);
    const double of_plate = (high - low) * (high - low) / 12.0 + relative * relative;
    const double weight = 1.0 / variance + 1.0 / of_plate;
    mean = (mean / variance + 0.5 * (low + high) / of_plate) / weight;
    variance = 1.0 / weight;
  }
  check->inertia_z = std::exp(mean);
  check->inertia_z_sigma = check->inertia_z * std::sqrt(variance);
}

/// Inertia goes with the thrust coefficient, and is known no better.
void WidenByThrust(const DynamicModel& model, const ModelValues& values, double k_f_sigma,
                   TorqueBands* bands) {
  const int k_f = model.IndexOf("thrust.k_f");
  const double of_thrust = k_f >= 0 ? k_f_sigma / values[k_f] : 0.0;
  for (BandedQuantity& inertia : bands->inertia) {
    if (inertia.value) inertia.sigma = std::hypot(inertia.sigma, *inertia.value * of_thrust);
  }
}

/// Nothing where the bands do not show k_m, or the model has none.
std::optional<ReactionCheck> CheckReaction(const DynamicModel& model, const ModelValues& values,
                                           const TorqueBands& bands) {
  const int k_m = model.IndexOf("rotor_torque.k_m");
  if (!bands.k_m_over_I.value || k_m < 0) return {};
  ReactionCheck check;
  TakeInertiaZ(model, values, bands, &check);
  check.in_use = values[k_m];
  check.fits = *bands.k_m_over_I.value * check.inertia_z;
  const double relative = std::hypot(bands.k_m_over_I.sigma / *bands.k_m_over_I.value,
                                     check.inertia_z_sigma / check.inertia_z);
  check.sigma = check.fits * relative;
  if (check.in_use > 0.0 && relative > 0.0) {
    const double off = std::abs(std::log(check.fits / check.in_use)) / relative;
    check.p = std::erfc(off / std::sqrt(2.0));
  }
  check.contradicted = !model.parameters()[k_m].estimated && check.p < ReactionCheck::kErrorRate;
  return check;
}

}  // namespace

TorqueBands FindTorqueBands(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, double k_f_sigma,
                            const StampSpans& ground_spans) {
  TorqueBands bands;
  std::string why;
  const auto flight = SpectraOfFlight(log, model, values, ground_spans, &why);
  if (!flight) {
    bands.Refuse(why);
    return bands;
  }
  bands = flight->spectra.Bands(flight->noise);
  WidenByThrust(model, values, k_f_sigma, &bands);
  bands.k_m = CheckReaction(model, values, bands);
  return bands;
}

std::map<std::string, ParameterSetting> KnownByBands(const TorqueBands& bands,
                                                     const DynamicModel& model,
                                                     const ModelValues& values) {
  std::map<std::string, ParameterSetting> known;
  const int k = model.IndexOf("rotor_reaction.J_r");
  if (k < 0 || !model.parameters()[k].estimated || !bands.J_r_over_I.value) return known;
  const double inertia = model.Properties(values).I_BBcm_B(2, 2);
  ParameterSetting& setting = known[model.parameters()[k].full_name];
  setting.value = inertia * *bands.J_r_over_I.value;
  setting.sigma = inertia * bands.J_r_over_I.sigma;
  return known;
}

std::map<std::string, ParameterSetting> InertiaByBands(const TorqueBands& bands,
                                                       const DynamicModel& model,
                                                       const Eigen::VectorXd& sigma) {
  std::map<std::string, ParameterSetting> known;
  for (size_t axis = 0; axis < bands.inertia.size(); ++axis) {
    const BandedQuantity& inertia = bands.inertia[axis];
    const int k = model.IndexOf(std::string("inertia.") + "xyz"[axis]);
    if (k < 0 || !model.parameters()[k].estimated || !inertia.value) continue;
    if (!(inertia.sigma < sigma[k])) continue;
    ParameterSetting& setting = known[model.parameters()[k].full_name];
    setting.value = *inertia.value;
    setting.sigma = inertia.sigma;
  }
  return known;
}

std::string ReactionWarning(const TorqueBands& bands) {
  if (!bands.k_m || !bands.k_m->contradicted) return "";
  const ReactionCheck& c = *bands.k_m;
  return "rotor_torque.k_m is held at " + Rounded(c.in_use) +
         " N m s^2, and the flight contradicts it: " + Rounded(c.fits) + " +- " + Rounded(c.sigma) +
         " fits where rotor torque leads (chance in " + Rounded(100.0 * c.p) + " %, with I_z " +
         Rounded(c.inertia_z) + " +- " + Rounded(c.inertia_z_sigma) + " kg m^2)";
}

std::string RotorInertiaWarning(const TorqueBands& bands) {
  const BandedQuantity& shown = bands.J_r_over_I;
  if (!shown.value || !(*shown.value > 0.0) || !(shown.sigma > 0.0)) return "";
  const double sigmas = *shown.value / shown.sigma;
  if (std::erfc(sigmas / std::sqrt(2.0)) >= ReactionCheck::kErrorRate) return "";
  return "bands of frequency show that a rotor's inertia is " + Rounded(*shown.value) + " +- " +
         Rounded(shown.sigma) + " of I_z (" + Rounded(sigmas) +
         " sigma); the model has none: rotor_reaction is probable";
}

void ReactionWatch::Add(const TorqueBands& bands) {
  if (!bands.k_m) return;
  ++looks_;
  TorqueBands counted;
  counted.k_m = bands.k_m;
  ReactionCheck& check = *counted.k_m;
  check.p = std::min(1.0, check.p * looks_);
  check.contradicted = check.contradicted && check.p < ReactionCheck::kErrorRate;
  sentence_ = ReactionWarning(counted);
}

}  // namespace odmc
