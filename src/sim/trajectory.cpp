#include "odmc/sim/trajectory.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>

namespace odmc {
namespace {

using Axes = std::array<std::vector<Sinusoid>, 4>;

constexpr double kRamp_s = 2.5;    // from rest to full rate along the path
constexpr double kClimb_s = 3.0;   // from the ground to the start
constexpr double kHeight_m = 2.5;  // of the middle of every path
constexpr double kQuarter = 1.5707963267948966;

// A value and its first four derivatives by time.
using Derivatives = std::array<double, 5>;

// Smooth step 35 s⁴ - 84 s⁵ + 70 s⁶ - 20 s⁷ from 0 to 1 over `width`: its first three derivatives
// vanish at both ends.
Derivatives SmoothStep(double t, double width) {
  if (t <= 0.0) return {};
  if (t >= width) return {1.0, 0.0, 0.0, 0.0, 0.0};
  const double s = t / width;
  const double s2 = s * s, s3 = s2 * s;
  const double w2 = width * width;
  return {s2 * s2 * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s))),
          s3 * (140.0 + s * (-420.0 + s * (420.0 - 140.0 * s))) / width,
          s2 * (420.0 + s * (-1680.0 + s * (2100.0 - 840.0 * s))) / w2,
          s * (840.0 + s * (-5040.0 + s * (8400.0 - 4200.0 * s))) / (w2 * width),
          (840.0 + s * (-10080.0 + s * (25200.0 - 16800.0 * s))) / (w2 * w2)};
}

// Time along the path: the integral of SmoothStep(), then straight.
Derivatives PathTime(double t) {
  const Derivatives step = SmoothStep(t, kRamp_s);
  if (t >= kRamp_s) return {t - 0.5 * kRamp_s, 1.0, 0.0, 0.0, 0.0};
  const double s = std::max(0.0, t / kRamp_s);
  const double integral = std::pow(s, 5) * (7.0 + s * (-14.0 + s * (10.0 - 2.5 * s)));
  return {kRamp_s * integral, step[0], step[1], step[2], step[3]};
}

// A sin(y) with y = w phi(t) + phase, by the chain rule.
Derivatives Along(const Sinusoid& sine, const Derivatives& phi) {
  const double y = sine.frequency * phi[0] + sine.phase;
  const double y1 = sine.frequency * phi[1], y2 = sine.frequency * phi[2];
  const double y3 = sine.frequency * phi[3], y4 = sine.frequency * phi[4];
  const double S = sine.amplitude * std::sin(y), C = sine.amplitude * std::cos(y);
  const double y1_2 = y1 * y1;
  return {S, C * y1, C * y2 - S * y1_2, C * (y3 - y1_2 * y1) - 3.0 * S * y1 * y2,
          C * (y4 - 6.0 * y1_2 * y2) + S * (y1_2 * y1_2 - 4.0 * y1 * y3 - 3.0 * y2 * y2)};
}

Derivatives Along(const std::vector<Sinusoid>& axis, const Derivatives& phi) {
  Derivatives sum = {};
  for (const Sinusoid& sine : axis) {
    const Derivatives one = Along(sine, phi);
    for (size_t k = 0; k < sum.size(); ++k) sum[k] += one[k];
  }
  return sum;
}

// Figure of eight with vertical and yaw motion: 6.1 m/s, 44 deg.              model.md section 8
Axes Octo() {
  return {{{{4.6, 1.165, 0.0}}, {{1.25, 2.33, 0.0}}, {{0.6, 0.99, 0.0}}, {{1.2, 0.7, 0.0}}}};
}

// Fast and rich in frequencies: 8.4 m/s, 69 deg, rates of 2.5 rad/s and more.  model.md section 8
Axes Aggressive() {
  return {{{{3.19, 2.287, 0.0}, {0.62, 1.606, 0.0}},
           {{2.43, 2.287, 1.62}, {0.225, 3.365, 0.0}},
           {{0.35, 1.9, 0.0}, {0.1, 4.1, 0.0}},
           {{1.0, 1.1, 0.0}, {0.25, 2.7, 0.0}}}};
}

const std::map<std::string, Axes>& Catalogue() {
  static const std::map<std::string, Axes> catalogue = {
      {"hover", {}},
      {"octo", Octo()},
      {"circle", {{{{2.0, 2.0, kQuarter}}, {{2.0, 2.0, 0.0}}, {}, {}}}},
      {"vertical", {{{}, {}, {{1.5, 1.6, 0.0}}, {}}}},
      {"yaw", {{{}, {}, {}, {{1.745, 1.2, 0.0}}}}},
      {"aggressive", Aggressive()},
  };
  return catalogue;
}

std::string Listed(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

}  // namespace

const std::vector<std::string>& Trajectory::Names() {
  static const std::vector<std::string> names = {"hover",    "octo", "circle",
                                                 "vertical", "yaw",  "aggressive"};
  return names;
}

Trajectory::Trajectory(const std::string& name, double ground_s)
    : name_(name),
      ground_s_(ground_s),
      start_s_(ground_s > 0.0 ? ground_s + kClimb_s : 0.0),
      centre_z_(kHeight_m) {
  const auto it = Catalogue().find(name);
  if (it == Catalogue().end()) {
    throw std::invalid_argument("there is no trajectory '" + name +
                                "'; known are: " + Listed(Names()));
  }
  axes_ = it->second;
}

double Trajectory::ramp_s() const { return kRamp_s; }

FlatReference Trajectory::At(double time_s) const {
  const Derivatives phi = PathTime(time_s - start_s_);
  std::array<Derivatives, 4> along;
  for (size_t i = 0; i < along.size(); ++i) along[i] = Along(axes_[i], phi);
  if (time_s >= start_s_) {
    along[2][0] += centre_z_;
  } else {
    const Derivatives climb = SmoothStep(time_s - ground_s_, kClimb_s);
    const double start_z = centre_z_ + along[2][0];
    for (size_t k = 0; k < climb.size(); ++k) along[2][k] = start_z * climb[k];
  }

  const auto order = [&along](size_t k) {
    return Eigen::Vector3d(along[0][k], along[1][k], along[2][k]);
  };
  return {order(0), order(1), order(2), order(3), order(4), along[3][0], along[3][1], along[3][2]};
}

}  // namespace odmc
