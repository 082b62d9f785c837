#include "odmc/attribution/force_blend.h"

#include <algorithm>
#include <array>

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixX3d;
using Eigen::RowVector3d;

constexpr std::array<double, 5> kSpline = {1.0 / 16, 4.0 / 16, 6.0 / 16, 4.0 / 16, 1.0 / 16};

}  // namespace

ForceBlend::ForceBlend(std::vector<bool> follows, const std::vector<bool>& counts,
                       const MatrixX3d& felt, const MatrixX3d& by_motion) {
  const auto n = static_cast<int>(follows.size());
  run_from_.resize(follows.size());
  run_to_.resize(follows.size());
  for (int i = 0; i < n; ++i) run_from_[i] = i > 0 && follows[i] ? run_from_[i - 1] : i;
  for (int i = n - 1; i >= 0; --i)
    run_to_[i] = i + 1 < n && follows[i + 1] ? run_to_[i + 1] : i + 1;
  const std::vector<MatrixX3d> motion = OctavesOf(by_motion), apart = OctavesOf(felt - by_motion);
  felt_weight_.setOnes(kOctaves + 1, 3);
  for (size_t b = 0; b < motion.size(); ++b) {
    // Noise of the motion is what of its residual is in the difference of both (what the model
    // lacks is in neither difference): the blend of least variance.
    RowVector3d mean_m = RowVector3d::Zero(), mean_d = RowVector3d::Zero();
    double count = 0.0;
    for (int i = 0; i < n; ++i) {
      if (!counts[i]) continue;
      mean_m += motion[b].row(i);
      mean_d += apart[b].row(i);
      ++count;
    }
    mean_m /= std::max(1.0, count);
    mean_d /= std::max(1.0, count);
    RowVector3d md = RowVector3d::Zero(), dd = RowVector3d::Constant(1e-300);
    for (int i = 0; i < n; ++i) {
      if (!counts[i]) continue;
      const RowVector3d d = apart[b].row(i) - mean_d;
      md += (motion[b].row(i) - mean_m).cwiseProduct(d);
      dd += d.cwiseAbs2();
    }
    felt_weight_.row(static_cast<Index>(b)) = (-md.cwiseQuotient(dd)).cwiseMax(0.0).cwiseMin(1.0);
  }
}

MatrixX3d ForceBlend::Smoothed(const MatrixX3d& x, int step) const {
  MatrixX3d smooth(x.rows(), 3);
  for (Index i = 0; i < x.rows(); ++i) {
    const auto at = static_cast<size_t>(i);
    RowVector3d sum = RowVector3d::Zero();
    double weight = 0.0;
    for (int k = 0; k < 5; ++k) {
      const Index j = i + (k - 2) * step;
      if (j < run_from_[at] || j >= run_to_[at]) continue;
      sum += kSpline[static_cast<size_t>(k)] * x.row(j);
      weight += kSpline[static_cast<size_t>(k)];
    }
    smooth.row(i) = sum / weight;
  }
  return smooth;
}

std::vector<MatrixX3d> ForceBlend::OctavesOf(const MatrixX3d& x) const {
  std::vector<MatrixX3d> octaves;
  MatrixX3d rest = x;
  for (int b = 0; b < kOctaves; ++b) {
    MatrixX3d smooth = Smoothed(rest, 1 << b);
    octaves.push_back(rest - smooth);
    rest = std::move(smooth);
  }
  octaves.push_back(std::move(rest));
  return octaves;
}

MatrixX3d ForceBlend::Blend(const MatrixX3d& felt, const MatrixX3d& by_motion) const {
  const std::vector<MatrixX3d> apart = OctavesOf(felt - by_motion);
  MatrixX3d blend = by_motion;
  for (size_t b = 0; b < apart.size(); ++b) {
    for (int axis = 0; axis < 3; ++axis) {
      blend.col(axis) += felt_weight_(static_cast<Index>(b), axis) * apart[b].col(axis);
    }
  }
  return blend;
}

}  // namespace odmc
