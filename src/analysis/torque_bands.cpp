#include "odmc/analysis/torque_bands.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <unsupported/Eigen/FFT>

#include "block_scatter.h"
#include "odmc/estimator/noise_estimation.h"
#include "odmc/math/statistics.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Matrix4d;
using Eigen::Vector3d;
using Eigen::Vector4d;

constexpr double kPi = 3.14159265358979323846;
constexpr double kErrorRate = ReactionCheck::kErrorRate;  // of every test here
constexpr double kErrorSigmas = 3.29;                     // the same, two-sided, normal
constexpr double kShown = 0.5;      // relative sigma above which nothing is shown
constexpr double kAnywhere = 10.0;  // answers to disturbances look like any inertia of this range
constexpr double kLowest_Hz = 1.0;
// Lines of whole segments lie on edges of bands: to which one they belong must not hang on how
// stamps are rounded.
constexpr double kAside = 0.99;
constexpr double kBandRatio = 1.4142135623730951;  // half an octave
constexpr double kLongestSegment_s = 2.0, kShortestSegment_s = 0.5;
constexpr int kSegments = 8;  // at least, of a flight, half a length apart
// What Hann windows half a length apart say still depends on where the first one lies.
constexpr int kSegmentsPerLength = 8;
constexpr long kBlockSegments = 2;      // what a block starts with
constexpr size_t kMostBlocks = 128;     // even
constexpr double kNothing = 1e-9;       // of a power
constexpr double kFewestDegrees = 2.0;  // of freedom: fewer do not show how blocks scatter
constexpr double kHighestShare = 0.2;   // of the slowest stream's rate
constexpr double kLongestGap_s = 0.03;
constexpr double kMostDelay_s = 0.03;
constexpr double kLoop = 0.70710678118654752;  // RMS of the real part of a number of size one

std::vector<std::pair<double, double>> Edges(double lowest_Hz, double highest_Hz) {
  std::vector<std::pair<double, double>> edges;
  for (double low = kLowest_Hz; low * kBandRatio <= highest_Hz; low *= kBandRatio) {
    if (low >= kAside * lowest_Hz) edges.emplace_back(low, low * kBandRatio);
  }
  return edges;
}

}  // namespace

namespace {

/// Of spectra of segments, an eighth of a length apart, in blocks of `size`: what two segments
/// share of their variance is the square of how much their windows overlap.
BlockOverlap OverlapOf(const std::vector<double>& window, long size) {
  const size_t step = window.size() / kSegmentsPerLength;
  std::array<double, kSegmentsPerLength> shared{};
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
  for (long apart = 1; apart <= kSegmentsPerLength; ++apart) {
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
    Regression AsRegression(double share) const {
      Regression r;
      r.share = share;
      r.gram = Eigen::Matrix2d{{uu, uw}, {uw, ww}};
      r.noise = Eigen::Matrix2d{{noise, 0.0}, {0.0, 0.0}};
      r.right = Eigen::Vector2d(uy.real(), 0.0);
      r.power = yy;
      return r;
    }
    /// Of so few values it is not known to be closer to one.
    double Coherence(double independent) const {
      if (!(Own() > 0.0 && yy > 0.0)) return 0.0;
      const double shared = uy.real() * uy.real() / (Own() * yy);
      return std::min(1.0 - 0.5 / independent, shared);
    }
  };
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
  double frequency_Hz = 0.0;  // middle
  double independent = 0.0;   // complex numbers that are independent of each other
};

void TorqueSpectra::Bin::Add(const Bin& other) {
  for (size_t axis = 0; axis < 2; ++axis) {
    uu[axis] += other.uu[axis];
    yy[axis] += other.yy[axis];
    uy[axis] += other.uy[axis];
  }
  zz += other.zz;
  known2 += other.known2;
  drag2 += other.drag2;
  spin2 += other.spin2;
  known_z += other.known_z;
  drag_spin += other.drag_spin;
  drag_z += other.drag_z;
  spin_z += other.spin_z;
  drag_known += other.drag_known;
  spin_known += other.spin_known;
}

TorqueSpectra::TorqueSpectra(double rate_Hz, double segment_s, double highest_Hz, double inertia_z)
    : rate_Hz_(rate_Hz),
      length_(2 * static_cast<int>(std::lround(0.5 * segment_s * rate_Hz))),
      highest_Hz_(highest_Hz),
      inertia_z_(inertia_z),
      num_bins_(std::min(static_cast<size_t>(length_ / 2),
                         static_cast<size_t>(std::ceil(highest_Hz * length_ / rate_Hz)) + 1)),
      block_segments_(kBlockSegments) {
  for (int i = 0; i < length_; ++i) {
    window_.push_back(0.5 - 0.5 * std::cos(2.0 * kPi * (i + 0.5) / length_));
    window_power_ += window_.back() * window_.back();
  }
}

double TorqueSpectra::Seconds() const {
  return static_cast<double>(segments_ * (length_ / kSegmentsPerLength)) / rate_Hz_;
}

void TorqueSpectra::Break() {
  run_.clear();
  block_is_open_ = false;
}

void TorqueSpectra::MergeBlocks() {
  for (size_t i = 0; 2 * i + 1 < blocks_.size(); ++i) {
    Block pair = std::move(blocks_[2 * i]);
    const Block& second = blocks_[2 * i + 1];
    for (size_t k = 0; k < num_bins_; ++k) pair.bins[k].Add(second.bins[k]);
    pair.segments += second.segments;
    blocks_[i] = std::move(pair);
  }
  blocks_.resize(blocks_.size() / 2);
  block_segments_ *= 2;
}

void TorqueSpectra::Add(const Sample& sample) {
  run_.push_back(sample);
  if (static_cast<int>(run_.size()) < length_ + 2) return;  // one on either side, to differentiate
  TakeSegment();
  run_.erase(run_.begin(), run_.begin() + length_ / kSegmentsPerLength);
}

void TorqueSpectra::TakeSegment() {
  std::array<std::vector<double>, kNumChannels> channels;
  for (auto& channel : channels) channel.resize(static_cast<size_t>(length_));
  for (int i = 0; i < length_; ++i) {
    const auto k = static_cast<size_t>(i);
    const Sample &before = run_[k], &now = run_[k + 1], &after = run_[k + 2];
    const Vector3d acceleration = 0.5 * rate_Hz_ * (after.rate - before.rate);
    channels[kTorqueX][k] = now.torque.x();
    channels[kTorqueY][k] = now.torque.y();
    channels[kKnownZ][k] = now.torque.z() / inertia_z_;
    channels[kRateX][k] = acceleration.x();
    channels[kRateY][k] = acceleration.y();
    channels[kRateZ][k] = acceleration.z();
    channels[kDrag][k] = now.drag;
    channels[kSpin][k] = 0.5 * rate_Hz_ * (after.spin - before.spin);
  }
  Eigen::FFT<double> fft;
  std::array<std::vector<Complex>, kNumChannels> spectra;
  for (size_t c = 0; c < kNumChannels; ++c) {
    std::vector<double>& x = channels[c];
    // The line through the channel leaks into all frequencies: out with it.
    const double middle = 0.5 * (length_ - 1);
    double mean = 0.0, slope = 0.0, square = 0.0;
    for (int i = 0; i < length_; ++i) {
      mean += x[static_cast<size_t>(i)] / length_;
      slope += (i - middle) * x[static_cast<size_t>(i)];
      square += (i - middle) * (i - middle);
    }
    for (int i = 0; i < length_; ++i) {
      const auto k = static_cast<size_t>(i);
      x[k] = window_[k] * (x[k] - mean - slope / square * (i - middle));
    }
    fft.fwd(spectra[c], x);
  }
  if (!block_is_open_ || blocks_.back().segments >= block_segments_) {
    if (blocks_.size() == kMostBlocks) MergeBlocks();
    blocks_.emplace_back().bins.resize(num_bins_);
    block_is_open_ = true;
  }
  ++blocks_.back().segments;
  for (size_t k = 1; k < num_bins_; ++k) {
    // What central differences take from a derivative.
    const double angle = 2.0 * kPi * static_cast<double>(k) / length_;
    const double mend = angle < 0.8 * kPi ? angle / std::sin(angle) : 1.0;  // nobody looks above
    Bin& bin = blocks_.back().bins[k];
    for (size_t axis = 0; axis < 2; ++axis) {
      const Complex u = spectra[kTorqueX + axis][k], y = mend * spectra[kRateX + axis][k];
      bin.uu[axis] += std::norm(u);
      bin.yy[axis] += std::norm(y);
      bin.uy[axis] += u * std::conj(y);
    }
    const Complex z = mend * spectra[kRateZ][k], known = spectra[kKnownZ][k];
    const Complex drag = spectra[kDrag][k], spin = mend * spectra[kSpin][k];
    bin.zz += std::norm(z);
    bin.known_z += known * std::conj(z);
    bin.known2 += std::norm(known);
    bin.drag2 += std::norm(drag);
    bin.spin2 += std::norm(spin);
    bin.drag_spin += drag * std::conj(spin);
    bin.drag_z += drag * std::conj(z);
    bin.spin_z += spin * std::conj(z);
    bin.drag_known += drag * std::conj(known);
    bin.spin_known += spin * std::conj(known);
  }
  ++segments_;
}

TorqueSpectra::Band TorqueSpectra::MeanOver(const Block& block, double low_Hz, double high_Hz,
                                            const Noise& noise, double delay_s) const {
  Band band;
  band.frequency_Hz = std::sqrt(low_Hz * high_Hz);
  double count = 0.0;
  for (size_t k = 1; k < num_bins_; ++k) {
    const double f = static_cast<double>(k) * rate_Hz_ / length_;
    if (f < kAside * low_Hz || f >= kAside * high_Hz) continue;
    const Bin& bin = block.bins[k];
    const double w = 2.0 * kPi * f;
    const Complex shift = std::polar(1.0, -w * delay_s);
    count += 1.0;
    for (size_t axis = 0; axis < 2; ++axis) {
      band.axes[axis].uu += bin.uu[axis];
      band.axes[axis].yy += bin.yy[axis];
      band.axes[axis].uy += shift * bin.uy[axis];
      // The rate is the acceleration over i w.
      band.axes[axis].ww += bin.yy[axis] / (w * w);
      band.axes[axis].uw += std::real(shift * bin.uy[axis] * Complex(0.0, 1.0 / w));
    }
    band.gram(2, 2) += bin.zz / (w * w);
    band.gram(0, 2) += std::real(shift * bin.drag_z * Complex(0.0, 1.0 / w));
    band.gram(1, 2) += std::real(shift * bin.spin_z * Complex(0.0, 1.0 / w));
    band.zz += bin.zz;
    band.gram(0, 0) += bin.drag2;
    band.gram(1, 1) += bin.spin2;
    band.gram(0, 1) += bin.drag_spin.real();
    band.right[0] += std::real(shift * bin.drag_z);
    band.right[1] += std::real(shift * bin.spin_z);
    band.gram(0, 3) += bin.drag_known.real();
    band.gram(1, 3) += bin.spin_known.real();
    band.gram(2, 3) += std::real(shift * bin.known_z * Complex(0.0, 1.0 / w));
    band.gram(3, 3) += bin.known2;
    band.right[3] += std::real(shift * bin.known_z);
    band.gram_noise(1, 1) += w * w * noise.spin * noise.spin;
    band.gram_noise(0, 0) += noise.drag * noise.drag;
  }
  if (count == 0.0) return band;
  const double mean = 1.0 / (count * static_cast<double>(std::max(block.segments, 1L)));
  const std::array<double, 2> torque_noise = {noise.torque_x, noise.torque_y};
  for (size_t axis = 0; axis < 2; ++axis) {
    Band::Axis& a = band.axes[axis];
    a.noise = window_power_ * torque_noise[axis] * torque_noise[axis];
    a.uu = a.uu * mean - a.noise;
    a.yy *= mean;
    a.uy *= mean;
    a.ww *= mean;
    a.uw *= mean;
  }
  band.gram.triangularView<Eigen::StrictlyLower>() = band.gram.transpose();
  band.gram *= mean;
  band.gram_noise *= window_power_ / count;
  band.gram -= band.gram_noise;
  band.right *= mean;
  band.zz *= mean;
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

void TorqueSpectra::AddInertia(const Band& band, double low_Hz, double high_Hz, TorqueBands* result,
                               Scatters* scatters) {
  for (size_t axis = 0; axis < 2; ++axis) {
    const Band::Axis& a = band.axes[axis];
    if (!(a.Own() > 0.0) || !(a.uy.real() > 0.0)) continue;
    const BlockScatter scatter = band.ScatterOfAxis(axis);
    BandEstimate estimate;
    estimate.low_Hz = low_Hz;
    estimate.high_Hz = high_Hz;
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
  if (2 * segments_ < kSegments * kSegmentsPerLength) {
    result.why = "less than " + std::to_string(kSegments) + " whole stretches of " +
                 Rounded(length_ / rate_Hz_) + " s";
    for (BandedQuantity* q :
         {&result.inertia[0], &result.inertia[1], &result.k_m_over_I, &result.J_r_over_I}) {
      q->why = result.why;
    }
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
    AddInertia(band, low, high, &result, &scatters);
    // Where in its step a sample lies is nobody's to say.
    const double step_s = 1.0 / (rate_Hz_ * std::sqrt(12.0));
    AddReaction(band, low, high, std::hypot(result.delay_sigma_s, step_s), &result, &scatters);
  }
  const std::array<BandedQuantity*, 4> quantities = {&result.inertia[0], &result.inertia[1],
                                                     &result.k_m_over_I, &result.J_r_over_I};
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

void TorqueSpectra::AddReaction(const Band& band, double low_Hz, double high_Hz,
                                double delay_sigma_s, TorqueBands* result, Scatters* scatters) {
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
    estimate.low_Hz = low_Hz;
    estimate.high_Hz = high_Hz;
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
    (*scatters)[static_cast<size_t>(2 + i)].Add(scatter, i, 1.0);
  }
}

namespace {

/// Bands [from, to), joined in logarithms.
struct Join {
  double weight = 0.0, mean = 0.0, chi_squared = 0.0, slope = 0.0, slope_sigma = 0.0, spread = 0.0;
  double sigma = 0.0;
};

Join JoinRange(const std::vector<BandEstimate>& bands, size_t from, size_t to) {
  Join join;
  double of_log = 0.0, of_frequency = 0.0;
  const auto weight = [&](size_t i) {
    const double relative = std::max(1e-6, bands[i].sigma / bands[i].value);
    return 1.0 / (relative * relative);
  };
  const auto frequency = [&](size_t i) {
    return 0.5 * std::log(bands[i].low_Hz * bands[i].high_Hz);
  };
  for (size_t i = from; i < to; ++i) {
    join.weight += weight(i);
    of_log += weight(i) * std::log(bands[i].value);
    of_frequency += weight(i) * frequency(i);
  }
  join.mean = of_log / join.weight;
  const double middle = of_frequency / join.weight;
  double square = 0.0, product = 0.0, noise = 0.0, systematic = 0.0;
  for (size_t i = from; i < to; ++i) {
    const double w = weight(i), off = std::log(bands[i].value) - join.mean;
    const double along = frequency(i) - middle;
    join.chi_squared += w * off * off;
    square += w * along * along;
    product += w * along * off;
    const double relative = bands[i].noise_sigma / bands[i].value, share = w / join.weight;
    noise += share * share * relative * relative;
    systematic += share * std::sqrt(std::max(0.0, 1.0 / w - relative * relative));
  }
  join.slope = product / square;
  join.slope_sigma = 1.0 / std::sqrt(square);
  // What is not noise is taken for common to all bands; and what a slope changes over them.
  join.spread = std::abs(join.slope) * std::sqrt(square / join.weight);
  join.sigma = std::sqrt(noise + systematic * systematic + join.spread * join.spread);
  return join;
}

/// Bands [from, to) as those in which rotor torque leads.
struct Range {
  size_t from, to;
  Join join;
  double log_evidence;
};

/// How likely the bands' values are if those of the range are one, and every other band, as the
/// value itself, lies anywhere within a factor of kAnywhere.
double LogEvidence(const std::vector<BandEstimate>& bands, size_t from, size_t to,
                   const Join& join) {
  double sum = 0.5 * std::log(2.0 * kPi / join.weight) - 0.5 * join.chi_squared;
  for (size_t i = from; i < to; ++i) {
    const double relative = std::max(1e-6, bands[i].sigma / bands[i].value);
    sum -= std::log(relative * std::sqrt(2.0 * kPi));
  }
  const double others = static_cast<double>(bands.size() - (to - from));
  return sum - (1.0 + others) * std::log(std::log(kAnywhere));
}

/// Mean and standard deviation of the logarithm, whichever range it is.
std::pair<double, double> AverageOf(const std::vector<Range>& ranges, double most) {
  double weight = 0.0, mean = 0.0, square = 0.0;
  for (const Range& range : ranges) {
    const double w = std::exp(range.log_evidence - most);
    weight += w;
    mean += w * range.join.mean;
    square += w * (range.join.sigma * range.join.sigma + range.join.mean * range.join.mean);
  }
  mean /= weight;
  return {mean, std::sqrt(std::max(0.0, square / weight - mean * mean))};
}

}  // namespace

void JoinBands(BandedQuantity* q) {
  q->value.reset();
  for (BandEstimate& band : q->bands) band.used = false;
  if (q->bands.size() < 2) {
    q->why = "fewer than two bands show it";
    return;
  }
  std::vector<Range> ranges;
  bool agree = false;
  for (size_t from = 0; from + 2 <= q->bands.size(); ++from) {
    for (size_t to = from + 2; to <= q->bands.size(); ++to) {
      const Join join = JoinRange(q->bands, from, to);
      const int freedom = static_cast<int>(to - from) - 1;
      if (ChiSquaredTail(join.chi_squared, freedom) < kErrorRate) continue;
      if (std::abs(join.slope) > kErrorSigmas * join.slope_sigma) continue;
      agree = true;
      if (join.slope + 1.0 < kErrorSigmas * join.slope_sigma || join.sigma > kShown) continue;
      ranges.push_back({from, to, join, LogEvidence(q->bands, from, to, join)});
    }
  }
  if (ranges.empty()) {
    q->why = agree
                 ? "where bands agree, they are too uncertain to tell rotor torque that leads from "
                   "rotor torque that answers disturbances"
                 : "no two bands agree";
    return;
  }
  const Range best = *std::max_element(
      ranges.begin(), ranges.end(),
      [](const Range& a, const Range& b) { return a.log_evidence < b.log_evidence; });
  for (size_t i = best.from; i < best.to; ++i) q->bands[i].used = true;
  const auto [mean, sigma] = AverageOf(ranges, best.log_evidence);
  q->value = std::exp(mean);
  q->sigma = *q->value * sigma;
  q->chi_squared = best.join.chi_squared;
  q->freedom = static_cast<int>(best.to - best.from) - 1;
  q->slope = best.join.slope;
  q->slope_sigma = best.join.slope_sigma;
}

namespace {

/// Body rates of a flight, by the stream that has more of them.
struct Rates {
  std::vector<Stamp> stamps;
  std::vector<Vector3d> w_B;
};

Rates RatesOf(const FlightLog& log, const BodyProperties& body) {
  Rates odometry, gyro;
  for (const OdometrySample& s : log.odometry) {
    if (!s.w_WS_S) continue;
    odometry.stamps.push_back(s.stamp);
    odometry.w_B.push_back(body.R_BS * *s.w_WS_S);
  }
  for (const ImuSample& s : log.imu) {
    if (!s.gyro_I) continue;
    gyro.stamps.push_back(s.stamp);
    gyro.w_B.push_back(body.R_BI * *s.gyro_I);
  }
  return gyro.stamps.size() >= odometry.stamps.size() ? gyro : odometry;
}

template <typename T>
double MedianStep_s(const std::vector<T>& samples, Stamp (*stamp)(const T&)) {
  std::vector<double> steps;
  for (size_t i = 1; i < samples.size(); ++i) {
    steps.push_back(ToSeconds(stamp(samples[i]) - stamp(samples[i - 1])));
  }
  return Median(steps);
}

/// Goes along a stream and reads it between two samples.
template <typename Sample>
class Reader {
 public:
  explicit Reader(const std::vector<Sample>& samples) : samples_(samples) {}

  /// @returns false where there is a hole, or nothing around the stamp
  bool MoveTo(Stamp stamp, double longest_s) {
    while (next_ < samples_.size() && samples_[next_].stamp <= stamp) ++next_;
    if (next_ == 0) return false;
    if (samples_[next_ - 1].stamp == stamp) {
      share_ = 0.0;
      after_ = next_ - 1;
      return true;
    }
    if (next_ == samples_.size()) return false;
    const double span_s = ToSeconds(samples_[next_].stamp - before().stamp);
    if (span_s > longest_s) return false;
    share_ = ToSeconds(stamp - before().stamp) / span_s;
    after_ = next_;
    return true;
  }
  const Sample& before() const { return samples_[next_ - 1]; }
  const Sample& after() const { return samples_[after_]; }
  double share() const { return share_; }

 private:
  const std::vector<Sample>& samples_;
  size_t next_ = 0, after_ = 0;
  double share_ = 0.0;
};

/// The effects of a model that are thrust.
std::vector<std::string> ThrustEffects(const DynamicModel& model) {
  std::vector<std::string> names;
  for (const std::string& name : model.effect_names()) {
    if (name == "thrust" || name == "rotor_asymmetry") names.push_back(name);
  }
  return names;
}

/// Torque of the rotors' thrust at one instant.
class TorqueReader {
 public:
  TorqueReader(const FlightLog& log, const DynamicModel& model, const ModelValues& values)
      : model_(model.vehicle(), ThrustEffects(model)),
        values_(model_.InitialValues()),
        poses_(log.odometry),
        rotors_(log.rotors) {
    for (int i = 0; i < model_.num_parameters(); ++i) {
      const int k = model.IndexOf(model_.parameters()[i].full_name);
      if (k >= 0) values_[i] = values[k];
    }
    first_ = log.odometry.front().stamp;
    body_ = model.Properties(values);
  }

  const BodyProperties& body() const { return body_; }

  std::optional<TorqueSpectra::Sample> At(Stamp stamp, const Vector3d& w_B, double rotor_gap_s,
                                          double pose_gap_s) {
    if (!rotors_.MoveTo(stamp, rotor_gap_s) || !poses_.MoveTo(stamp, pose_gap_s)) return {};
    FlightState state;
    const double x = poses_.share();
    const OdometrySample &a = poses_.before(), &b = poses_.after();
    const Eigen::Quaterniond q = a.q_WS.slerp(x, b.q_WS);
    state.time_s = ToSeconds(stamp - first_);
    state.R_WB = q.toRotationMatrix() * body_.R_BS.transpose();
    state.w_WB_B = w_B;
    Vector3d v_WS = Vector3d::Zero();
    if (a.v_WS && b.v_WS) {
      v_WS = (1.0 - x) * *a.v_WS + x * *b.v_WS;
    } else if (b.stamp > a.stamp) {
      v_WS = (b.p_WS - a.p_WS) / ToSeconds(b.stamp - a.stamp);
    }
    state.p_WB = (1.0 - x) * a.p_WS + x * b.p_WS - state.R_WB * body_.p_BS;
    state.v_AB_B = state.R_WB.transpose() * (v_WS - body_.wind_W) - w_B.cross(body_.p_BS);
    const double y = rotors_.share();
    const RotorVector speed = (1.0 - y) * rotors_.before().speed + y * rotors_.after().speed;
    state.rotors = RotorState::Steady(speed);
    Vector3d f_B, tau_B;
    model_.EvaluateWrench(state, values_, body_.p_BBcm, &f_B, &tau_B);
    TorqueSpectra::Sample sample;
    sample.rate = w_B;
    sample.torque = tau_B - w_B.cross(body_.I_BBcm_B * w_B);
    const Vehicle& vehicle = model_.vehicle();
    for (int j = 0; j < vehicle.num_rotors(); ++j) {
      sample.drag += vehicle.rotors[j].spin * speed[j] * speed[j];
      sample.spin += vehicle.rotors[j].spin * speed[j];
    }
    speed_squares_ += speed.cwiseAbs2().mean();
    ++count_;
    return sample;
  }

  double MeanSquaredSpeed() const { return count_ > 0 ? speed_squares_ / count_ : 0.0; }

 private:
  DynamicModel model_;
  ModelValues values_;
  Reader<OdometrySample> poses_;
  Reader<RotorSample> rotors_;
  BodyProperties body_;
  Stamp first_ = 0;
  double speed_squares_ = 0.0;
  double count_ = 0.0;
};

TorqueSpectra::Noise NoiseOf(const FlightLog& log, const DynamicModel& model,
                             const ModelValues& values, double mean_squared_speed) {
  StreamNoise streams({0.0, 0.0, 0.0, 0.0});
  std::vector<double> levels;
  for (size_t i = 0; i < log.rotors.size(); ++i) {
    streams.Add(log.rotors[i]);
    if (i % 200 != 199) continue;
    streams.AdvanceTo(log.rotors[i].stamp);
    levels.push_back(streams.rotor_speed());
  }
  const double sigma = Median(levels), speed = std::sqrt(mean_squared_speed);
  const Vehicle& vehicle = model.vehicle();
  const int k_f = model.IndexOf("thrust.k_f");
  const double slope = k_f >= 0 ? 2.0 * values[k_f] * speed * sigma : 0.0;
  TorqueSpectra::Noise noise;
  double x2 = 0.0, y2 = 0.0;
  for (const Rotor& rotor : vehicle.rotors) {
    x2 += rotor.p_BP.x() * rotor.p_BP.x();
    y2 += rotor.p_BP.y() * rotor.p_BP.y();
  }
  const double count = std::sqrt(static_cast<double>(vehicle.num_rotors()));
  noise.torque_x = slope * std::sqrt(y2);
  noise.torque_y = slope * std::sqrt(x2);
  noise.drag = 2.0 * speed * sigma * count;
  noise.spin = sigma * count;
  return noise;
}

bool IsInside(Stamp stamp, const std::vector<std::pair<Stamp, Stamp>>& spans) {
  return std::any_of(spans.begin(), spans.end(), [stamp](const auto& span) {
    return stamp >= span.first && stamp <= span.second;
  });
}

/// I_z by what the vehicle file says, as far as it does, and by the other two: a body has at most
/// their sum, and a vehicle that is wider than high at least the larger.
void TakeInertiaZ(const DynamicModel& model, const ModelValues& values, const TorqueBands& bands,
                  ReactionCheck* check) {
  const int k = model.IndexOf("inertia.z");
  double mean = std::log(model.vehicle().inertia_kg_m2.z()), variance = 0.0;
  if (k >= 0) {
    const ModelParameter& p = model.parameters()[k];
    mean = std::log(p.estimated ? p.spec.prior_value : values[k]);
    if (p.estimated) variance = std::pow(p.spec.prior_sigma / p.spec.prior_value, 2);
  }
  if (variance > 0.0 && bands.inertia[0].value && bands.inertia[1].value) {
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

}  // namespace

TorqueBands FindTorqueBands(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, double k_f_sigma,
                            const std::vector<std::pair<Stamp, Stamp>>& ground_spans) {
  TorqueBands bands;
  const auto refuse = [&bands](const std::string& why) {
    bands.why = why;
    for (BandedQuantity* q :
         {&bands.inertia[0], &bands.inertia[1], &bands.k_m_over_I, &bands.J_r_over_I}) {
      q->why = why;
    }
    return bands;
  };
  if (log.rotor_rms_only) return refuse("single rotor speeds are not known");
  if (log.odometry.size() < 2 || log.rotors.size() < 2) return refuse("there is no flight");
  if (std::any_of(log.rotors.begin(), log.rotors.end(),
                  [](const RotorSample& s) { return s.model_sigma.size() > 0; })) {
    return refuse("rotor speeds come from a model");
  }
  TorqueReader reader(log, model, values);
  const Rates rates = RatesOf(log, reader.body());
  if (rates.stamps.size() < 2) return refuse("there are no angular rates");
  const double step_s = MedianStep_s<Stamp>(rates.stamps, [](const Stamp& stamp) { return stamp; });
  const double rotor_step_s =
      MedianStep_s<RotorSample>(log.rotors, [](const RotorSample& sample) { return sample.stamp; });
  const double pose_step_s = MedianStep_s<OdometrySample>(
      log.odometry, [](const OdometrySample& sample) { return sample.stamp; });
  if (!(step_s > 0.0) || !(rotor_step_s > 0.0)) return refuse("stamps stand still");
  const double flown_s = ToSeconds(rates.stamps.back() - rates.stamps.front());
  const double segment_s = std::clamp(flown_s / kSegments, kShortestSegment_s, kLongestSegment_s);
  const double highest_Hz = kHighestShare / std::max(step_s, rotor_step_s);
  TorqueSpectra spectra(1.0 / step_s, segment_s, highest_Hz, reader.body().I_BBcm_B(2, 2));
  const double hole_s = std::max(3.5 * step_s, kLongestGap_s);
  const double rotor_hole_s = std::max(3.5 * rotor_step_s, kLongestGap_s);
  const double pose_hole_s = std::max(3.5 * pose_step_s, 5.0 * kLongestGap_s);
  // At even steps from the first rate of each whole stretch.
  size_t i = 0;
  while (i + 1 < rates.stamps.size()) {
    spectra.Break();
    const Stamp from = rates.stamps[i];
    for (long k = 0;; ++k) {
      const Stamp stamp = from + FromSeconds(static_cast<double>(k) * step_s);
      while (i + 1 < rates.stamps.size() && rates.stamps[i + 1] <= stamp) ++i;
      if (i + 1 == rates.stamps.size()) break;
      const double span_s = ToSeconds(rates.stamps[i + 1] - rates.stamps[i]);
      if (span_s > hole_s || IsInside(stamp, ground_spans)) break;
      const double x = ToSeconds(stamp - rates.stamps[i]) / span_s;
      const Vector3d w_B = (1.0 - x) * rates.w_B[i] + x * rates.w_B[i + 1];
      const auto sample = reader.At(stamp, w_B, rotor_hole_s, pose_hole_s);
      if (!sample) break;
      spectra.Add(*sample);
    }
    ++i;
  }
  bands = spectra.Bands(NoiseOf(log, model, values, reader.MeanSquaredSpeed()));
  const int k_f = model.IndexOf("thrust.k_f"), k_m = model.IndexOf("rotor_torque.k_m");
  const double of_thrust = k_f >= 0 ? k_f_sigma / values[k_f] : 0.0;
  for (BandedQuantity& inertia : bands.inertia) {
    if (inertia.value) inertia.sigma = std::hypot(inertia.sigma, *inertia.value * of_thrust);
  }
  if (!bands.k_m_over_I.value || k_m < 0) return bands;
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
  bands.k_m = check;
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
