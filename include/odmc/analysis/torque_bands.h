#pragma once

#include <Eigen/Core>
#include <array>
#include <complex>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/sensing/samples.h"

namespace odmc {

class PooledScatter;

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
  double flight_s = 0.0;                      ///< that was looked at
  double delay_s = 0.0, delay_sigma_s = 0.0;  ///< by which rotor speeds lead angular rates
  std::array<BandedQuantity, 2> inertia;      ///< I_x, I_y [kg m²]
  BandedQuantity k_m_over_I;                  ///< k_m / I_z [1/rad^2]
  BandedQuantity J_r_over_I;                  ///< inertia of a rotor over I_z [-]
  std::optional<ReactionCheck> k_m;           ///< where bands show it
  std::string why;                            ///< nothing could be looked at; empty: it was
};

/// Torque and angular acceleration, evenly sampled, summed up as spectra.
class TorqueSpectra {
 public:
  struct Sample {
    Eigen::Vector3d torque;  ///< of thrust about Bcm, in B, less w × I w [N m]
    Eigen::Vector3d rate;    ///< [rad/s]
    double drag = 0.0;       ///< sum of s Ω² [rad²/s²]
    double spin = 0.0;       ///< sum of s Ω [rad/s]
  };

  /// @param segment_s length of a segment; the lowest band is a few of its inverse
  /// @param highest_Hz frequencies above are not looked at
  /// @param inertia_z by which what is known of the torque about z is divided [kg m²]
  TorqueSpectra(double rate_Hz, double segment_s, double highest_Hz, double inertia_z);

  /// Adds the next sample; Break() tells that it does not follow the one before.
  void Add(const Sample& sample);
  void Break();

  /// Noise of one sample that rotor speeds put into torque (x, y), drag and spin.
  struct Noise {
    double torque_x = 0.0, torque_y = 0.0, drag = 0.0, spin = 0.0;
  };

  /// What the bands say.
  TorqueBands Bands(const Noise& noise) const;

 private:
  using Complex = std::complex<double>;
  enum Channel : size_t {
    kTorqueX,
    kTorqueY,
    kKnownZ,
    kRateX,
    kRateY,
    kRateZ,
    kDrag,
    kSpin,
    kNumChannels
  };
  /// Sums over segments at one frequency: torque u and angular acceleration y about x and y; about
  /// z acceleration, what is known of it, and the regressors: drag, and the rate of spin.
  struct Bin {
    std::array<double, 2> uu{}, yy{};
    std::array<Complex, 2> uy{};
    double zz = 0.0, known2 = 0.0, drag2 = 0.0, spin2 = 0.0;
    Complex known_z, drag_spin, drag_z, spin_z, drag_known, spin_known;
    void Add(const Bin& other);
  };
  /// Segments that follow each other, summed up. Their number is bounded: the longer the flight,
  /// the longer they are.
  struct Block {
    std::vector<Bin> bins;
    long segments = 0;
  };
  struct Band;
  /// Of I_x, I_y, k_m / I_z, J_r / I_z.
  using Scatters = std::array<PooledScatter, 4>;

  void TakeSegment();
  void MergeBlocks();
  double Seconds() const;
  /// Mean spectra over the bins of a band and some blocks, torque shifted by `delay_s`, noise of
  /// rotor speeds taken off.
  Band MeanOver(const Block& block, double low_Hz, double high_Hz, const Noise& noise,
                double delay_s) const;
  /// The band over the whole flight, and over each block.
  Band BandOf(const Block& flight, double low_Hz, double high_Hz, const Noise& noise,
              double delay_s) const;
  static void AddInertia(const Band& band, double low_Hz, double high_Hz, TorqueBands* result,
                         Scatters* scatters);
  static void AddReaction(const Band& band, double low_Hz, double high_Hz, double delay_sigma_s,
                          TorqueBands* result, Scatters* scatters);
  void FindDelay(const Block& flight, const std::vector<std::pair<double, double>>& edges,
                 const Noise& noise, TorqueBands* bands) const;

  double rate_Hz_;
  int length_;
  double highest_Hz_, inertia_z_;
  std::vector<Sample> run_;
  std::vector<double> window_;
  double window_power_ = 0.0;
  size_t num_bins_;
  std::vector<Block> blocks_;
  long block_segments_;  // of a whole block
  bool block_is_open_ = false;
  long segments_ = 0;
};

/// Joins what bands say of one quantity: the mean over all ranges of bands that agree, and whose
/// values do not fall with frequency as answers to disturbances would, by how likely each makes
/// what is seen. Its sigma knows that the range is not known.
void JoinBands(BandedQuantity* quantity);

/// The bands of a recorded flight, with thrust, centre of mass and mounts as `values` say.
/// @param k_f_sigma of thrust.k_f, which the inertia goes with [N s²]
/// @param ground_spans stamps that do not count
TorqueBands FindTorqueBands(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, double k_f_sigma,
                            const std::vector<std::pair<Stamp, Stamp>>& ground_spans);

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
