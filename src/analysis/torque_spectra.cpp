#include "odmc/analysis/torque_spectra.h"

#include <algorithm>
#include <cmath>
#include <unsupported/Eigen/FFT>

#include "odmc/math/line.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr double kPi = 3.14159265358979323846;
constexpr long kBlockSegments = 2;   // what a block starts with
constexpr size_t kMostBlocks = 128;  // even

/// The line through a channel leaks into all frequencies: out with it.
void TakeOffLine(std::vector<double>* channel) {
  const StraightLine line = LineThrough(channel->data(), channel->size());
  for (size_t i = 0; i < channel->size(); ++i) {
    double& value = (*channel)[i];
    value = value - line.mean - line.slope * (static_cast<double>(i) - line.middle);
  }
}

}  // namespace

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
  const long apart = length_ / kSegmentsPerLength;  // samples
  return static_cast<double>(segments_ * apart) / rate_Hz_;
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

TorqueSpectra::Channels TorqueSpectra::ChannelsOfRun() const {
  Channels channels;
  for (auto& channel : channels) channel.resize(static_cast<size_t>(length_));
  for (size_t k = 0; k < static_cast<size_t>(length_); ++k) {
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
  return channels;
}

TorqueSpectra::Spectra TorqueSpectra::SpectraOf(Channels channels) const {
  Eigen::FFT<double> fft;
  Spectra spectra;
  for (size_t c = 0; c < kNumChannels; ++c) {
    TakeOffLine(&channels[c]);
    for (size_t k = 0; k < window_.size(); ++k) channels[c][k] = window_[k] * channels[c][k];
    fft.fwd(spectra[c], channels[c]);
  }
  return spectra;
}

void TorqueSpectra::Bin::AddSegment(const Spectra& spectra, size_t k, double mend) {
  for (size_t axis = 0; axis < 2; ++axis) {
    const Complex u = spectra[kTorqueX + axis][k], y = mend * spectra[kRateX + axis][k];
    uu[axis] += std::norm(u);
    yy[axis] += std::norm(y);
    uy[axis] += u * std::conj(y);
  }
  const Complex z = mend * spectra[kRateZ][k], known = spectra[kKnownZ][k];
  const Complex drag = spectra[kDrag][k], spin = mend * spectra[kSpin][k];
  zz += std::norm(z);
  known_z += known * std::conj(z);
  known2 += std::norm(known);
  drag2 += std::norm(drag);
  spin2 += std::norm(spin);
  drag_spin += drag * std::conj(spin);
  drag_z += drag * std::conj(z);
  spin_z += spin * std::conj(z);
  drag_known += drag * std::conj(known);
  spin_known += spin * std::conj(known);
}

TorqueSpectra::Block& TorqueSpectra::OpenBlock() {
  if (!block_is_open_ || blocks_.back().segments >= block_segments_) {
    if (blocks_.size() == kMostBlocks) MergeBlocks();
    blocks_.emplace_back().bins.resize(num_bins_);
    block_is_open_ = true;
  }
  return blocks_.back();
}

void TorqueSpectra::TakeSegment() {
  const Spectra spectra = SpectraOf(ChannelsOfRun());
  Block& block = OpenBlock();
  for (size_t k = 1; k < num_bins_; ++k) {
    // What central differences take from a derivative.
    const double angle = 2.0 * kPi * static_cast<double>(k) / length_;
    const double mend = angle < 0.8 * kPi ? angle / std::sin(angle) : 1.0;  // nobody looks above
    block.bins[k].AddSegment(spectra, k, mend);
  }
  ++block.segments;
  ++segments_;
}

}  // namespace odmc
