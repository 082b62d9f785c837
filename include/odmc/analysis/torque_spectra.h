#pragma once

#include <Eigen/Core>
#include <array>
#include <complex>
#include <utility>
#include <vector>

#include "odmc/analysis/torque_bands.h"

namespace odmc {

class PooledScatter;

/// Torque and angular acceleration, evenly sampled, summed up as spectra.
class TorqueSpectra {
 public:
  /// One sample of a flight.
  struct Sample {
    Eigen::Vector3d torque;  ///< of thrust about Bcm, in B, less w × I w [N m]
    Eigen::Vector3d rate;    ///< [rad/s]
    double drag = 0.0;       ///< sum of s Ω² [rad²/s²]
    double spin = 0.0;       ///< sum of s Ω [rad/s]
  };

  /// Of a flight: fewer segments, half a length apart, say nothing.
  static constexpr int kFewestSegments = 8;
  /// Segments begin this often within a length: what Hann windows half a length apart say still
  /// depends on where the first one lies.
  static constexpr int kSegmentsPerLength = 8;

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
  using Channels = std::array<std::vector<double>, kNumChannels>;
  using Spectra = std::array<std::vector<Complex>, kNumChannels>;
  /// Sums over segments at one frequency: torque u and angular acceleration y about x and y; about
  /// z acceleration, what is known of it, and the regressors: drag, and the rate of spin.
  struct Bin {
    std::array<double, 2> uu{}, yy{};
    std::array<Complex, 2> uy{};
    double zz = 0.0, known2 = 0.0, drag2 = 0.0, spin2 = 0.0;
    Complex known_z, drag_spin, drag_z, spin_z, drag_known, spin_known;
    void Add(const Bin& other);
    /// @param k number of the frequency
    /// @param mend of derivatives that were taken by differences
    void AddSegment(const Spectra& spectra, size_t k, double mend);
  };
  /// Segments that follow each other, summed up. Their number is bounded: the longer the flight,
  /// the longer they are.
  struct Block {
    std::vector<Bin> bins;
    long segments = 0;
  };
  struct Band;
  /// Of TorqueBands::Quantities().
  using Scatters = std::array<PooledScatter, 4>;

  /// Adds the segment that the run holds.
  void TakeSegment();
  Channels ChannelsOfRun() const;
  Spectra SpectraOf(Channels channels) const;
  Block& OpenBlock();
  void MergeBlocks();
  double Seconds() const;
  /// Mean spectra over the bins of a band and some blocks, torque shifted by `delay_s`, noise of
  /// rotor speeds taken off.
  Band MeanOver(const Block& block, double low_Hz, double high_Hz, const Noise& noise,
                double delay_s) const;
  /// The band over the whole flight, and over each block.
  Band BandOf(const Block& flight, double low_Hz, double high_Hz, const Noise& noise,
              double delay_s) const;
  static void AddInertia(const Band& band, TorqueBands* result, Scatters* scatters);
  static void AddReaction(const Band& band, double delay_sigma_s, TorqueBands* result,
                          Scatters* scatters);
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

}  // namespace odmc
