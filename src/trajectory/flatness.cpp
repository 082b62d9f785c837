#include "odmc/trajectory/flatness.h"

#include <cmath>

namespace odmc {
namespace {

// A vector of W with two derivatives by time.
struct Moving {
  Eigen::Vector3d x, d, dd;
};

Moving Normalised(const Moving& u) {
  const double n = u.x.norm();
  Moving e;
  e.x = u.x / n;
  const double d_n = e.x.dot(u.d);
  e.d = (u.d - d_n * e.x) / n;
  const double dd_n = e.x.dot(u.dd) + e.d.dot(u.d);
  e.dd = (u.dd - 2.0 * d_n * e.d - dd_n * e.x) / n;
  return e;
}

Moving Cross(const Moving& a, const Moving& b) {
  return {a.x.cross(b.x), a.d.cross(b.x) + a.x.cross(b.d),
          a.dd.cross(b.x) + 2.0 * a.d.cross(b.d) + a.x.cross(b.dd)};
}

Moving Heading(const FlatReference& reference) {
  const Eigen::Vector3d h(std::cos(reference.yaw), std::sin(reference.yaw), 0.0);
  const Eigen::Vector3d n(-h.y(), h.x(), 0.0);
  return {h, reference.d_yaw * n, reference.dd_yaw * n - reference.d_yaw * reference.d_yaw * h};
}

// Body x of an attitude that is turned by the yaw of heading `h` and then tilted to body z along
// `z` the shortest way: x = h - s (z + e3), s = h·z / (1 + z·e3).
Moving Tilted(const Moving& h, const Moving& z) {
  const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
  const double d = 1.0 + z.x.z(), d_d = z.d.z(), dd_d = z.dd.z();
  const double s = h.x.dot(z.x) / d;
  const double d_s = (h.d.dot(z.x) + h.x.dot(z.d) - s * d_d) / d;
  const double dd_s =
      (h.dd.dot(z.x) + 2.0 * h.d.dot(z.d) + h.x.dot(z.dd) - 2.0 * d_s * d_d - s * dd_d) / d;
  return {h.x - s * (z.x + e3), h.d - d_s * (z.x + e3) - s * z.d,
          h.dd - dd_s * (z.x + e3) - 2.0 * d_s * z.d - s * z.dd};
}

}  // namespace

FlatAttitude FlatAttitudeOf(const FlatReference& reference, const Eigen::Vector3d& g_W) {
  const Moving thrust = {reference.a_WB - g_W, reference.j_WB, reference.s_WB};
  const Moving z = Normalised(thrust);
  const Moving x = Tilted(Heading(reference), z);
  const Moving y = Cross(z, x);

  FlatAttitude flat;
  Eigen::Matrix3d R_WB;
  R_WB << x.x, y.x, z.x;
  flat.q_WB = Eigen::Quaterniond(R_WB);
  // From dR/dt = R [w]×: w = (z·dy, x·dz, y·dx).
  flat.w_WB_B << z.x.dot(y.d), x.x.dot(z.d), y.x.dot(x.d);
  flat.dw_WB_B << z.d.dot(y.d) + z.x.dot(y.dd), x.d.dot(z.d) + x.x.dot(z.dd),
      y.d.dot(x.d) + y.x.dot(x.dd);
  flat.specific_thrust = thrust.x.norm();
  return flat;
}

}  // namespace odmc
