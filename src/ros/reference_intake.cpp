#include "odmc/ros/reference_intake.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>

namespace odmc {
namespace {

constexpr double kRests_m_s = 0.01;  // slower: a trajectory that ends there has ended

/// x, y, z, yaw and their derivatives from 0 to 4.
using Derivatives = std::array<Eigen::Vector4d, 5>;

Derivatives ToDerivatives(const FlatReference& r) {
  Derivatives d;
  d[0] << r.p_WB, r.yaw;
  d[1] << r.v_WB, r.d_yaw;
  d[2] << r.a_WB, r.dd_yaw;
  d[3] << r.j_WB, 0.0;
  d[4] << r.s_WB, 0.0;
  return d;
}

FlatReference FromDerivatives(const Derivatives& d, bool standing) {
  FlatReference r;
  r.p_WB = d[0].head<3>();
  r.v_WB = d[1].head<3>();
  r.a_WB = d[2].head<3>();
  r.j_WB = d[3].head<3>();
  r.s_WB = d[4].head<3>();
  r.yaw = d[0][3];
  r.d_yaw = d[1][3];
  r.dd_yaw = d[2][3];
  r.standing = standing;
  return r;
}

/// At rest where `reference` is.
FlatReference Held(const FlatReference& reference) {
  FlatReference held;
  held.p_WB = reference.p_WB;
  held.yaw = reference.yaw;
  held.standing = reference.standing;
  return held;
}

}  // namespace

FlatReference ReferenceBetween(const TimedReference& from, const TimedReference& to, Stamp at) {
  const double T = ToSeconds(to.stamp - from.stamp);
  const double u = ToSeconds(at - from.stamp) / T;
  const Derivatives a = ToDerivatives(from.reference), b = ToDerivatives(to.reference);
  // Coefficients in u, 0 to 1; what the first three leave open at the far end is d, dv, da.
  std::array<Eigen::Vector4d, 6> c;
  c[0] = a[0];
  c[1] = T * a[1];
  c[2] = 0.5 * T * T * a[2];
  const Eigen::Vector4d d = b[0] - c[0] - c[1] - c[2];
  const Eigen::Vector4d dv = T * b[1] - c[1] - 2.0 * c[2];
  const Eigen::Vector4d da = T * T * b[2] - 2.0 * c[2];
  c[3] = 10.0 * d - 4.0 * dv + 0.5 * da;
  c[4] = -15.0 * d + 7.0 * dv - da;
  c[5] = 6.0 * d - 3.0 * dv + 0.5 * da;

  Derivatives result;
  double per_second = 1.0;
  for (Eigen::Vector4d& derivative : result) {
    derivative = c[5];
    for (int k = 4; k >= 0; --k) derivative = (derivative * u + c[k]).eval();
    derivative *= per_second;
    per_second /= T;
    for (int k = 0; k < 5; ++k) c[k] = (k + 1) * c[k + 1];
    c[5].setZero();
  }
  return FromDerivatives(result, from.reference.standing);
}

FlatReference ReferenceMovedOn(const FlatReference& reference, double dt) {
  Derivatives d = ToDerivatives(reference);
  for (size_t i = 0; i < d.size(); ++i) {
    double factor = 1.0;
    for (size_t k = i + 1; k < d.size(); ++k) {
      factor *= dt / static_cast<double>(k - i);
      d[i] += factor * d[k];  // d[k] is not moved yet
    }
  }
  return FromDerivatives(d, reference.standing);
}

bool ReferenceIntake::FollowsTrajectory(Stamp now) const {
  if (trajectory_.empty()) return false;
  return !newest_ || ToSeconds(now - newest_->stamp) > timeout_s_;
}

FlatReference ReferenceIntake::After(const TimedReference& point, Stamp now) const {
  const double age_s = ToSeconds(now - point.stamp);
  const FlatReference moved =
      ReferenceMovedOn(point.reference, std::clamp(age_s, -kMovesOn_s, kMovesOn_s));
  return age_s > timeout_s_ ? Held(moved) : moved;
}

std::optional<FlatReference> ReferenceIntake::At(Stamp now) const {
  if (!FollowsTrajectory(now)) {
    return newest_ ? std::optional<FlatReference>(After(*newest_, now)) : std::nullopt;
  }
  const TimedReference &first = trajectory_.front(), &last = trajectory_.back();
  if (now >= last.stamp || trajectory_.size() == 1) return After(last, now);
  if (now <= first.stamp) return Held(first.reference);
  const auto next = std::upper_bound(trajectory_.begin(), trajectory_.end(), now,
                                     [](Stamp t, const TimedReference& p) { return t < p.stamp; });
  return ReferenceBetween(*(next - 1), *next, now);
}

bool ReferenceIntake::IsLost(Stamp now) const {
  if (!newest_ && trajectory_.empty()) return false;
  const bool on_trajectory = FollowsTrajectory(now);
  const TimedReference& last = on_trajectory ? trajectory_.back() : *newest_;
  if (last.reference.standing || ToSeconds(now - last.stamp) <= timeout_s_) return false;
  // A trajectory that ends at rest is over, not lost.
  return !on_trajectory || last.reference.v_WB.norm() > kRests_m_s;
}

void ReferenceIntake::Reset() {
  newest_.reset();
  trajectory_.clear();
}

}  // namespace odmc
