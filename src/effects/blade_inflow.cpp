#include "odmc/effects/blade_inflow.h"

namespace odmc {
namespace {

/// A number with its derivative by the induced velocity.
struct Slope {
  double v = 0.0, d = 0.0;
};

/// 2 v W - blades' thrust over ρA and its derivative by v.
Slope Excess(const BladeFlow<double>& flow, double v) {
  const double sign = v < 0.0 ? -1.0 : 1.0;
  const double speed_squared = DiscSpeedSquared(flow, v);
  const double speed = std::sqrt(speed_squared);
  double d_squared = 2.0 * (flow.axial + v);
  const double d = -sign * flow.axial, t = sign * v - 0.5 * d;
  if (d >= 1e-6 && t > 0.0) {
    const double gate = d * d / (d * d + 4.0 * flow.in_plane_squared);
    const double top = t * t * (2.0 * d - 2.5 * t), bottom = d * d * d + 5.0 * t * t * t;
    const double d_top = 4.0 * d * t - 7.5 * t * t, d_bottom = 15.0 * t * t;
    d_squared += sign * gate * d * d * (d_top * bottom - top * d_bottom) / (bottom * bottom);
  }
  return {2.0 * v * speed - BladeThrust(flow, v),
          2.0 * speed + v * d_squared / speed + 0.25 * flow.lift * flow.tip};
}

}  // namespace

double InflowSlope(const BladeFlow<double>& flow, double v) { return Excess(flow, v).d; }

double InducedVelocity(const BladeFlow<double>& flow, int* steps) {
  constexpr double kTolerance = 1e-13;
  int count = 0;
  const auto excess = [&](double v) {
    ++count;
    return Excess(flow, v);
  };
  const double at_zero = BladeThrust(flow, 0.0);
  const double sign = at_zero < 0.0 ? -1.0 : 1.0;
  // Where 2 v² alone is the thrust at v = 0: the induced velocity of hover with these blades, or
  // so.
  double far = sign * std::max(1e-6, std::sqrt(0.5 * std::abs(at_zero)));
  double near = 0.0, v = far;
  Slope at = excess(v);
  while (sign * at.v < 0.0) {
    near = far;
    far *= 2.0;
    v = far;
    at = excess(v);
  }
  while (at.v != 0.0) {
    (sign * at.v < 0.0 ? near : far) = v;
    double next = v - at.v / at.d;
    const bool inside = sign * (next - near) > 0.0 && sign * (far - next) > 0.0;
    if (!inside) next = 0.5 * (near + far);
    const double step = std::abs(next - v);
    v = next;
    if (step <= kTolerance * std::abs(far) || std::abs(far - near) <= kTolerance * std::abs(far))
      break;
    at = excess(v);
  }
  if (steps != nullptr) *steps = count;
  return v;
}

}  // namespace odmc
