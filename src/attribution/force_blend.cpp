#include "odmc/attribution/force_blend.h"

#include <algorithm>
#include <utility>

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::VectorXd;

constexpr std::array<double, 5> kSpline = {1.0 / 16, 4.0 / 16, 6.0 / 16, 4.0 / 16, 1.0 / 16};

/// The samples that count, without their mean: an accelerometer has a bias.
VectorXd Counted(const VectorXd& x, const std::vector<Index>& counted) {
  VectorXd some(static_cast<Index>(counted.size()));
  for (Index k = 0; k < some.size(); ++k) some[k] = x[counted[static_cast<size_t>(k)]];
  return some.array() - (some.size() > 0 ? some.mean() : 0.0);
}

}  // namespace

ForceBlend::ForceBlend(const std::vector<bool>& follows, const std::vector<bool>& counts,
                       const VectorXd& felt, const VectorXd& by_motion) {
  const size_t n = follows.size();
  std::vector<Index> counted;
  run_from_.resize(n);
  run_to_.resize(n);
  for (size_t i = 0; i < n; ++i) {
    run_from_[i] = i > 0 && follows[i] ? run_from_[i - 1] : static_cast<Index>(i);
    if (counts[i]) counted.push_back(static_cast<Index>(i));
  }
  for (size_t i = n; i-- > 0;) {
    run_to_[i] = i + 1 < n && follows[i + 1] ? run_to_[i + 1] : static_cast<Index>(i) + 1;
  }
  const Octaves motion = OctavesOf(by_motion), apart = OctavesOf(felt - by_motion);
  for (size_t b = 0; b < felt_weight_.size(); ++b) {
    // The blend of least variance. Of the motion's residual only its noise is in the difference of
    // both: what the model lacks is in both alike.
    const VectorXd d = Counted(apart[b], counted);
    const double noise = -Counted(motion[b], counted).dot(d), all = d.squaredNorm();
    felt_weight_[b] = all > 0.0 ? std::clamp(noise / all, 0.0, 1.0) : 1.0;
  }
}

VectorXd ForceBlend::Smoothed(const VectorXd& x, Index step) const {
  VectorXd smooth(x.size());
  for (Index i = 0; i < x.size(); ++i) {
    const auto at = static_cast<size_t>(i);
    double sum = 0.0, weight = 0.0;
    for (size_t k = 0; k < kSpline.size(); ++k) {
      const Index j = i + (static_cast<Index>(k) - 2) * step;
      if (j < run_from_[at] || j >= run_to_[at]) continue;
      sum += kSpline[k] * x[j];
      weight += kSpline[k];
    }
    smooth[i] = sum / weight;
  }
  return smooth;
}

ForceBlend::Octaves ForceBlend::OctavesOf(const VectorXd& x) const {
  Octaves octaves;
  VectorXd rest = x;
  for (size_t b = 0; b < kOctaves; ++b) {
    VectorXd smooth = Smoothed(rest, Index{1} << b);
    octaves[b] = rest - smooth;
    rest = std::move(smooth);
  }
  octaves[kOctaves] = std::move(rest);
  return octaves;
}

VectorXd ForceBlend::Blend(const VectorXd& felt, const VectorXd& by_motion) const {
  const Octaves apart = OctavesOf(felt - by_motion);
  VectorXd blend = by_motion;
  for (size_t b = 0; b < apart.size(); ++b) blend += felt_weight_[b] * apart[b];
  return blend;
}

}  // namespace odmc
