#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "block_scatter.h"
#include "odmc/analysis/band_join.h"
#include "odmc/analysis/torque_spectra.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Matrix4d;
using Eigen::Vector4d;

constexpr double kPi = 3.14159265358979323846;
constexpr double kLowest_Hz = 1.0;
// Lines of whole segments lie on edges of bands: to which one they belong must not hang on how
// stamps are rounded.
constexpr double kAside = 0.99;
constexpr double kBandRatio = 1.4142135623730951;  // half an octave
constexpr double kNothing = 1e-9;                  // of a power
constexpr double kFewestDegrees = 2.0;  // of freedom: fewer do not show how blocks scatter
constexpr double kMostDelay_s = 0.03;
constexpr double kLoop = 0.70710678118654752;  // RMS of the real part of a number of size one

std::vector<std::pair<double, double>> Edges(double lowest_Hz, double highest_Hz) {
  std::vector<std::pair<double, double>> edges;
  for (double low = kLowest_Hz; low * kBandRatio <= highest_Hz; low *= kBandRatio) {
    if (low >= kAside * lowest_Hz) edges.emplace_back(low, low * kBandRatio);
  }
  return edges;
}

/// Of spectra of segments, an eighth of a length apart, in blocks of `size`: what two segments
/// share of their variance is the square of how much their windows overlap.
BlockOverlap OverlapOf(const std::vector<double>& window, long size) {
  const size_t step = window.size() / TorqueSpectra::kSegmentsPerLength;
  std::array<double, TorqueSpectra::kSegmentsPerLength> shared{};
  for (size_t lag = 0; lag < shared.size(); ++lag) {
    for (size_t i = lag * step; i < window.size(); ++i) {
      shared[lag] += window[i] * window[i - lag * step];
    }
    shared[lag] *= shared[lag];
  }
  // Between the sums over two blocks, `apart` blocks from each other.
  const auto between = [&](long apart) {
    double sum = 0.0;
    for (long lag = -size + 1; lag < size; ++lag) {
      const auto distance = static_cast<size_t>(std::abs(lag + apart * size));
      if (distance < shared.size())
        sum += static_cast<double>(size - std::abs(lag)) * shared[distance];
    }
    return sum;
  };
  BlockOverlap overlap;
  double squares = 1.0;
  for (long apart = 1; apart <= TorqueSpectra::kSegmentsPerLength; ++apart) {
    const double correlation = between(apart) / between(0);
    overlap.variance += 2.0 * correlation;
    squares += 2.0 * correlation * correlation;
  }
  overlap.freedom = 1.0 / squares;
  return overlap;
}

}  // namespace

/// A band's mean spectra. x, y: torque u against acceleration y; z: acceleration against drag and
/// spin.
struct TorqueSpectra::Band {
  struct Axis {
    double uu = 0.0, noise = 0.0, yy = 0.0, ww = 0.0;  // uu without noise; w the rate
    double uw = 0.0;                                   // real part
    Complex uy;
    /// Torque without what goes with the rate.
    double Own() const { return ww > 0.0 ? uu - uw * uw / ww : uu; }
    /// Of acceleration on torque and rate. Rate and acceleration are a quarter of a turn apart.
    Regression AsRegression(double share_of_flight) const {
      Regression r;
      r.share = share_of_flight;
      r.gram = Eigen::Matrix2d{{uu, uw}, {uw, ww}};
      r.noise = Eigen::Matrix2d{{noise, 0.0}, {0.0, 0.0}};
      r.right = Eigen::Vector2d(uy.real(), 0.0);
      r.power = yy;
      return r;
    }
    /// Of so few values it is not known to be closer to one.
    double Coherence(double independent_values) const {
      if (!(Own() > 0.0 && yy > 0.0)) return 0.0;
      const double shared = uy.real() * uy.real() / (Own() * yy);
      return std::min(1.0 - 0.5 / independent_values, shared);
    }
  };
  /// Adds the sums at one frequency.
  /// @param w its angular frequency [rad/s]
  void Add(const Bin& bin, double w, const Noise& noise, double delay_s);
  /// Makes means of the sums over so many bins and segments, and takes off what noise adds.
  void TakeMean(double bins, double segments, const Noise& noise, double window_power);

  BlockScatter ScatterOfAxis(size_t axis) const {
    std::vector<Regression> parts;
    for (const Band& block : blocks) parts.push_back(block.axes[axis].AsRegression(block.share));
    return ScatterOf(axes[axis].AsRegression(share), parts, independent, overlap);
  }
  BlockScatter ScatterOfReaction() const {
    std::vector<Regression> parts;
    for (const Band& block : blocks) parts.push_back(block.Reaction(reaction_terms));
    return ScatterOf(Reaction(reaction_terms), parts, independent, overlap);
  }
  /// With the first `terms` of the regressors.
  Regression Reaction(Eigen::Index terms) const {
    Regression r;
    r.share = share;
    r.gram = gram.topLeftCorner(terms, terms);
    r.noise = gram_noise.topLeftCorner(terms, terms);
    r.right = right.head(terms);
    r.power = zz;
    return r;
  }
  /// Relative variance that noise gives the inertia in a stationary flight. The rest is known no
  /// better than so few values show it.
  double StationaryNoise(size_t axis) const {
    const Axis& a = axes[axis];
    const double coherence = a.Coherence(independent), noisy = a.noise / a.Own();
    const double rest = (1.0 - coherence) / std::max(1e-9, coherence);
    return (1.0 + noisy) * rest / (2.0 * independent) + noisy * noisy / independent;
  }
  /// At least this, and as the blocks have it.
  double RelativeNoise(size_t axis, const BlockScatter& scatter) const {
    const double coefficient = axes[axis].uy.real() / axes[axis].Own();
    return std::max(StationaryNoise(axis), scatter.variance[0] / (coefficient * coefficient));
  }

  double share = 1.0;        // of the flight
  std::vector<Band> blocks;  // of the flight
  BlockOverlap overlap;
  std::array<Axis, 2> axes;
  // Drag, spin, rate, known torque.
  Matrix4d gram = Matrix4d::Zero(), gram_noise = Matrix4d::Zero();
  Vector4d right = Vector4d::Zero();
  Eigen::Index reaction_terms = 4;
  double zz = 0.0;
  double low_Hz = 0.0, high_Hz = 0.0, frequency_Hz = 0.0;  // edges, middle
  double independent = 0.0;  // complex numbers that are independent of each other
};

void TorqueSpectra::Band::Add(const Bin& bin, double w, const Noise& noise, double delay_s) {
  const Complex shift = std::polar(1.0, -w * delay_s);
  // The rate is the acceleration over i w.
  const Complex to_rate(0.0, 1.0 / w);
  for (size_t axis = 0; axis < 2; ++axis) {
    axes[axis].uu += bin.uu[axis];
    axes[axis].yy += bin.yy[axis];
    axes[axis].uy += shift * bin.uy[axis];
    axes[axis].ww += bin.yy[axis] / (w * w);
    axes[axis].uw += std::real(shift * bin.uy[axis] * to_rate);
  }
  gram(0, 0) += bin.drag2;
  gram(0, 1) += bin.drag_spin.real();
  gram(0, 2) += std::real(shift * bin.drag_z * to_rate);
  gram(0, 3) += bin.drag_known.real();
  gram(1, 1) += bin.spin2;
  gram(1, 2) += std::real(shift * bin.spin_z * to_rate);
  gram(1, 3) += bin.spin_known.real();
  gram(2, 2) += bin.zz / (w * w);
  gram(2, 3) += std::real(shift * bin.known_z * to_rate);
  gram(3, 3) += bin.known2;
  right[0] += std::real(shift * bin.drag_z);
  right[1] += std::real(shift * bin.spin_z);
  right[3] += std::real(shift * bin.known_z);
  zz += bin.zz;
  gram_noise(0, 0) += noise.drag * noise.drag;
  gram_noise(1, 1) += w * w * noise.spin * noise.spin;
}

void TorqueSpectra::Band::TakeMean(double bins, double segments, const Noise& noise,
                                   double window_power) {
  const double mean = 1.0 / (bins * segments);
  const std::array<double, 2> torque_noise = {noise.torque_x, noise.torque_y};
  for (size_t axis = 0; axis < 2; ++axis) {
    Axis& a = axes[axis];
    a.noise = window_power * torque_noise[axis] * torque_noise[axis];
    a.uu = a.uu * mean - a.noise;
    a.yy *= mean;
    a.uy *= mean;
    a.ww *= mean;
    a.uw *= mean;
  }
  gram.triangularView<Eigen::StrictlyLower>() = gram.transpose();
  gram *= mean;
  gram_noise *= window_power / bins;
  gram -= gram_noise;
  right *= mean;
  zz *= mean;
}

TorqueSpectra::Band TorqueSpectra::MeanOver(const Block& block, double low_Hz, double high_Hz,
                                            const Noise& noise, double delay_s) const {
  Band band;
  band.low_Hz = low_Hz;
  band.high_Hz = high_Hz;
  band.frequency_Hz = std::sqrt(low_Hz * high_Hz);
  double bins = 0.0;
  for (size_t k = 1; k < num_bins_; ++k) {
    const double f = static_cast<double>(k) * rate_Hz_ / length_;
    if (f < kAside * low_Hz || f >= kAside * high_Hz) continue;
    band.Add(block.bins[k], 2.0 * kPi * f, noise, delay_s);
    bins += 1.0;
  }
  if (bins == 0.0) return band;
  const double segments = static_cast<double>(std::max(block.segments, 1L));
  band.TakeMean(bins, segments, noise, window_power_);
  band.share = static_cast<double>(block.segments) / static_cast<double>(segments_);
  return band;
}

TorqueSpectra::Band TorqueSpectra::BandOf(const Block& flight, double low_Hz, double high_Hz,
                                          const Noise& noise, double delay_s) const {
  Band band = MeanOver(flight, low_Hz, high_Hz, noise, delay_s);
  band.independent = std::max(1.0, (high_Hz - low_Hz) * Seconds());
  if (band.gram(3, 3) < kNothing * band.zz) band.reaction_terms = 3;
  band.overlap = OverlapOf(window_, block_segments_);
  for (const Block& block : blocks_) {
    band.blocks.push_back(MeanOver(block, low_Hz, high_Hz, noise, delay_s));
  }
  return band;
}

/// The phase of torque against acceleration grows with frequency where one stream is late.
void TorqueSpectra::FindDelay(const Block& flight,
                              const std::vector<std::pair<double, double>>& edges,
                              const Noise& noise, TorqueBands* bands) const {
  for (int round = 0; round < 5; ++round) {
    double sum = 0.0, weights = 0.0;
    for (const auto& [low, high] : edges) {
      const Band band = BandOf(flight, low, high, noise, bands->delay_s);
      for (size_t axis = 0; axis < 2; ++axis) {
        const double coherence = band.axes[axis].Coherence(band.independent);
        if (!(coherence > 0.0)) continue;
        const double rest = (1.0 - coherence) / coherence;
        // Noise, and what of the rest comes back through the loop, in quadrature.
        const double variance =
            band.RelativeNoise(axis, band.ScatterOfAxis(axis)) + kLoop * kLoop * rest * rest;
        const double w = 2.0 * kPi * band.frequency_Hz;
        sum += w * std::arg(band.axes[axis].uy) / variance;
        weights += w * w / variance;
      }
    }
    if (!(weights > 0.0)) return;
    bands->delay_s = std::clamp(bands->delay_s + sum / weights, -kMostDelay_s, kMostDelay_s);
    bands->delay_sigma_s = 1.0 / std::sqrt(weights);
  }
}

namespace {

/// Lets the bands' noise grow to what the flight's blocks say of it.
void Widen(const PooledScatter& scatter, BandedQuantity* q) {
  q->block_scatter = scatter.ratio();
  q->block_freedom = scatter.freedom();
  for (size_t k = 0; k < q->bands.size(); ++k) {
    BandEstimate& band = q->bands[k];
    const double stationary2 = band.noise_sigma * band.noise_sigma;
    const double systematic2 = std::max(0.0, band.sigma * band.sigma - stationary2);
    band.noise_sigma = std::sqrt(scatter.Variance(k, stationary2));
    band.sigma = std::sqrt(systematic2 + band.noise_sigma * band.noise_sigma);
  }
}

}  // namespace

void TorqueSpectra::AddInertia(const Band& band, TorqueBands* result, Scatters* scatters) {
  for (size_t axis = 0; axis < 2; ++axis) {
    const Band::Axis& a = band.axes[axis];
    if (!(a.Own() > 0.0) || !(a.uy.real() > 0.0)) continue;
    const BlockScatter scatter = band.ScatterOfAxis(axis);
    BandEstimate estimate;
    estimate.low_Hz = band.low_Hz;
    estimate.high_Hz = band.high_Hz;
    estimate.coherence = a.Coherence(band.independent);
    estimate.value = a.Own() / a.uy.real();
    const double rest = (1.0 - estimate.coherence) / std::max(1e-9, estimate.coherence);
    estimate.noise_sigma = estimate.value * std::sqrt(band.StationaryNoise(axis));
    estimate.sigma = std::hypot(estimate.noise_sigma, estimate.value * kLoop * rest);
    result->inertia[axis].bands.push_back(estimate);
    const double coefficient = a.uy.real() / a.Own();
    (*scatters)[axis].Add(scatter, 0, std::pow(estimate.value / coefficient, 2));
  }
}

TorqueBands TorqueSpectra::Bands(const Noise& noise) const {
  TorqueBands result;
  result.flight_s = Seconds();
  if (2 * segments_ < long{kFewestSegments} * kSegmentsPerLength) {
    result.Refuse("less than " + std::to_string(kFewestSegments) + " whole stretches of " +
                  Rounded(length_ / rate_Hz_) + " s");
    return result;
  }
  Block flight{std::vector<Bin>(num_bins_), segments_};
  for (const Block& block : blocks_) {
    for (size_t k = 0; k < num_bins_; ++k) flight.bins[k].Add(block.bins[k]);
  }
  // Below twice the resolution a window's line is not told from zero.
  const auto edges = Edges(2.0 * rate_Hz_ / length_, highest_Hz_);
  FindDelay(flight, edges, noise, &result);
  Scatters scatters;
  for (const auto& [low, high] : edges) {
    const Band band = BandOf(flight, low, high, noise, result.delay_s);
    AddInertia(band, &result, &scatters);
    // Where in its step a sample lies is nobody's to say.
    const double step_s = 1.0 / (rate_Hz_ * std::sqrt(12.0));
    AddReaction(band, std::hypot(result.delay_sigma_s, step_s), &result, &scatters);
  }
  const auto quantities = result.Quantities();
  for (size_t i = 0; i < quantities.size(); ++i) {
    Widen(scatters[i], quantities[i]);
    if (quantities[i]->bands.size() >= 2 && scatters[i].freedom() < kFewestDegrees) {
      quantities[i]->why = "one stretch of the flight carries all that shows it";
    } else {
      JoinBands(quantities[i]);
    }
  }
  return result;
}

void TorqueSpectra::AddReaction(const Band& band, double delay_sigma_s, TorqueBands* result,
                                Scatters* scatters) {
  const Regression regression = band.Reaction(band.reaction_terms);
  const Regression::Gram& G = regression.gram;
  const Regression::Terms size = G.diagonal().cwiseMax(0.0).cwiseSqrt();
  if (!(size.minCoeff() > 0.0)) return;
  const Regression::Gram unit =
      size.cwiseInverse().asDiagonal() * G * size.cwiseInverse().asDiagonal();
  if (!(unit.determinant() > 1e-6)) return;
  const Regression::Gram inverse = G.inverse();
  const Regression::Terms x = inverse * regression.right;
  const double fitted = x.dot(G * x);
  const double rest_power = std::max(0.0, band.zz - x.dot(regression.right));
  if (!(fitted > 0.0)) return;
  const double rest = std::max(rest_power / fitted, 0.5 / band.independent);
  const double w = 2.0 * kPi * band.frequency_Hz;
  const BlockScatter scatter = band.ScatterOfReaction();
  const std::array<BandedQuantity*, 2> quantities = {&result->k_m_over_I, &result->J_r_over_I};
  for (int i = 0; i < 2; ++i) {
    if (!(x[i] > 0.0)) continue;
    BandEstimate estimate;
    estimate.low_Hz = band.low_Hz;
    estimate.high_Hz = band.high_Hz;
    estimate.value = x[i];
    estimate.coherence = fitted / (fitted + rest_power);
    const double noisy = regression.noise(i, i) / G(i, i);
    const double n = band.independent;
    estimate.noise_sigma =
        std::sqrt(0.5 * rest_power * inverse(i, i) / n + x[i] * x[i] * noisy * noisy / n);
    const double loop = kLoop * rest * std::sqrt(fitted / G(i, i));
    // A delay turns one of the two into the other: they are a quarter of a turn apart.
    const int other = 1 - i;
    const double late = w * delay_sigma_s * x[other] * std::sqrt(G(other, other) / G(i, i));
    estimate.sigma = std::hypot(estimate.noise_sigma, std::hypot(loop, late));
    quantities[static_cast<size_t>(i)]->bands.push_back(estimate);
    (*scatters)[2 + static_cast<size_t>(i)].Add(scatter, i, 1.0);
  }
}

}  // namespace odmc
