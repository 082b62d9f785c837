#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/phases/flight_phase.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Inertia and reaction torque of the rotors by bands of frequency. Over all frequencies the torque
/// equation, rotor torque = inertia times angular acceleration, rewards inertia without end: below
/// the bandwidth of the controller rotor torque answers disturbances. docs/estimator.md, "By bands
/// of frequency", derives what is done here.

/// What one band says of a quantity.
struct BandEstimate {
  double low_Hz = 0.0, high_Hz = 0.0;
  double value = 0.0;
  double sigma = 0.0;        ///< all of it
  double noise_sigma = 0.0;  ///< of it, what more flight would make smaller; it knows of bursts
  double coherence = 0.0;  ///< of torque and angular acceleration, noise of rotor speeds taken off
  bool used = false;       ///< of the range that is most likely
};

/// What all bands say together.
struct BandedQuantity {
  std::vector<BandEstimate> bands;
  std::optional<double> value;  ///< empty: the flight does not show it; `why` says so
  double sigma = 0.0;
  double chi_squared = 0.0;  ///< of the bands used, about their mean; `freedom` degrees of freedom
  int freedom = 0;
  double slope = 0.0, slope_sigma = 0.0;  ///< d log(value) / d log(frequency): 0 where torque leads
  /// Variance between stretches of the flight over that of excitation and noise that are stationary
  /// within each, all bands together; and how many degrees of freedom show it.
  double block_scatter = 1.0, block_freedom = 0.0;
  std::string why;
};

/// k_m as the bands have it, against the one in use.
struct ReactionCheck {
  static constexpr double kErrorRate = 1e-3;  ///< a p below it contradicts

  double in_use = 0.0;                            ///< [N m s²]
  double fits = 0.0;                              ///< the same for the inertia below
  double sigma = 0.0;                             ///< with that of the inertia
  double inertia_z = 0.0, inertia_z_sigma = 0.0;  ///< taken for I_z [kg m²]
  double p = 1.0;                                 ///< chance of a difference like this
  bool contradicted = false;
};

/// Everything the bands of one flight say.
struct TorqueBands {
  double flight_s = 0.0;  ///< that was looked at
  /// Delay of rates behind rotor torque that fits the phases best, with its noise. Torques of the
  /// air turn phases, too: it is no offset of streams (inspection/ finds those).
  double delay_s = 0.0, delay_sigma_s = 0.0;
  std::array<BandedQuantity, 2> inertia;  ///< I_x, I_y [kg m²]
  BandedQuantity k_m_over_I;              ///< k_m / I_z [1/rad^2]
  BandedQuantity J_r_over_I;              ///< inertia of a rotor over I_z [-]
  std::optional<ReactionCheck> k_m;       ///< where bands show it
  std::string why;                        ///< nothing could be looked at; empty: it was

  /// I_x, I_y, k_m / I_z, J_r / I_z.
  std::array<BandedQuantity*, 4> Quantities();
  /// Says of everything why it could not be looked at.
  void Refuse(const std::string& reason);
};

/// The bands of a recorded flight, with thrust, centre of mass and mounts as `values` say.
/// @param k_f_sigma of thrust.k_f, which the inertia goes with [N s²]
/// @param ground_spans stamps that do not count
TorqueBands FindTorqueBands(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, double k_f_sigma,
                            const StampSpans& ground_spans);

/// What bands know of parameters that the estimator sees at all frequencies: the inertia of a
/// rotor, as a share of the I_z in `values`; by full name. Empty where they show it not, or the
/// model has none.
std::map<std::string, ParameterSetting> KnownByBands(const TorqueBands& bands,
                                                     const DynamicModel& model,
                                                     const ModelValues& values);

/// What bands know of I_x and I_y better than an estimate at all frequencies, which takes answers
/// to disturbances for inertia: where their sigma is the smaller one; by full name.
/// @param sigma of that estimate, by index in the model's parameters
std::map<std::string, ParameterSetting> InertiaByBands(const TorqueBands& bands,
                                                       const DynamicModel& model,
                                                       const Eigen::VectorXd& sigma);

/// One sentence where the bands contradict the k_m in use; else empty.
std::string ReactionWarning(const TorqueBands& bands);

/// One sentence where bands show a rotor's inertia beyond chance (ReactionCheck::kErrorRate), for a
/// model that has none; else empty.
std::string RotorInertiaWarning(const TorqueBands& bands);

/// Whether a flight contradicts the k_m that is held, look after look at its newest seconds. That
/// any of the looks does so by chance is ReactionCheck::kErrorRate: a look's p counts times the
/// number of looks so far.
class ReactionWatch {
 public:
  /// @param bands of one look; those that show no k_m change nothing
  void Add(const TorqueBands& bands);
  /// As ReactionWarning(), of the newest look that shows k_m.
  const std::string& sentence() const { return sentence_; }

 private:
  int looks_ = 0;
  std::string sentence_;
};

}  // namespace odmc
