#include "frame_checks.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Matrix3Xd;
using Eigen::Vector3d;

constexpr double kSpan_s = 0.05, kForceSpan_s = 0.1;
constexpr double kGravity_m_s2 = 9.81;
constexpr double kLeastUpright = 0.7;  // of the mean specific force, along the body's z

double Rms(const Matrix3Xd& x) {
  return x.cols() == 0 ? 0.0 : std::sqrt(x.squaredNorm() / static_cast<double>(x.cols()));
}

/// Samples that make up `span_s` at the usual step.
size_t StrideOf(const std::vector<double>& t_s, double span_s) {
  std::vector<double> steps;
  for (size_t i = 1; i < t_s.size(); ++i) steps.push_back(t_s[i] - t_s[i - 1]);
  if (steps.empty()) return 1;
  const double step = MiddleOf(std::move(steps));
  return static_cast<size_t>(std::max(1.0, std::round(span_s / step)));
}

/// Integral of a signal from its first sample on.
class Integral {
 public:
  explicit Integral(const TimedVectors& signal) : signal_(signal), sum_(3, signal.values.cols()) {
    sum_.col(0).setZero();
    for (Eigen::Index i = 1; i < sum_.cols(); ++i) {
      const double dt = signal.t_s[static_cast<size_t>(i)] - signal.t_s[static_cast<size_t>(i) - 1];
      sum_.col(i) = sum_.col(i - 1) + 0.5 * dt * (signal.values.col(i) + signal.values.col(i - 1));
    }
  }
  Vector3d At(double t_s) const {
    const auto& t = signal_.t_s;
    if (t_s <= t.front()) return (t_s - t.front()) * signal_.values.col(0);
    if (t_s >= t.back()) {
      const Eigen::Index last = sum_.cols() - 1;
      return sum_.col(last) + (t_s - t.back()) * signal_.values.col(last);
    }
    const auto after = std::upper_bound(t.begin(), t.end(), t_s);
    const Eigen::Index i = after - t.begin() - 1;
    const double dt = t_s - t[static_cast<size_t>(i)];
    const double share = dt / (*after - t[static_cast<size_t>(i)]);
    const Vector3d a = signal_.values.col(i), b = signal_.values.col(i + 1);
    return sum_.col(i) + dt * (a + 0.5 * share * (b - a));
  }

 private:
  const TimedVectors& signal_;
  Matrix3Xd sum_;
};

}  // namespace

Eigen::Quaterniond QuaternionReading::Of(const Eigen::Vector4d& named) const {
  const double sign = is_conjugated ? -1.0 : 1.0;
  return {named[order[0]], sign * named[order[1]], sign * named[order[2]], sign * named[order[3]]};
}

const std::vector<QuaternionReading>& QuaternionReadings() {
  static const std::vector<QuaternionReading> readings = {
      {"as named", {0, 1, 2, 3}, false},
      {"as named, conjugated", {0, 1, 2, 3}, true},
      {"w first where x is named", {1, 2, 3, 0}, false},
      {"w first where x is named, conjugated", {1, 2, 3, 0}, true},
      {"w last where z is named", {3, 0, 1, 2}, false},
      {"w last where z is named, conjugated", {3, 0, 1, 2}, true},
  };
  return readings;
}

const QuaternionReading& ReadingNamed(const std::string& name) {
  for (const QuaternionReading& reading : QuaternionReadings()) {
    if (name == reading.name) return reading;
  }
  throw std::logic_error("no reading of a quaternion: " + name);
}

CheckSpans SpansOf(const std::vector<double>& t_s) {
  CheckSpans spans;
  spans.stride = StrideOf(t_s, kSpan_s);
  for (size_t i = 0; i + spans.stride < t_s.size(); i += spans.stride) {
    spans.from_s.push_back(t_s[i]);
    spans.to_s.push_back(t_s[i + spans.stride]);
  }
  return spans;
}

Matrix3Xd MeansOver(const TimedVectors& signal, const CheckSpans& spans) {
  Matrix3Xd means(3, static_cast<Eigen::Index>(spans.from_s.size()));
  if (signal.t_s.empty()) return Matrix3Xd::Zero(3, means.cols());
  const Integral integral(signal);
  for (size_t i = 0; i < spans.from_s.size(); ++i) {
    means.col(static_cast<Eigen::Index>(i)) =
        (integral.At(spans.to_s[i]) - integral.At(spans.from_s[i])) /
        (spans.to_s[i] - spans.from_s[i]);
  }
  return means;
}

Matrix3Xd SlopesOver(const TimedVectors& signal, const CheckSpans& spans) {
  Matrix3Xd slopes(3, static_cast<Eigen::Index>(spans.from_s.size()));
  const auto stride = static_cast<Eigen::Index>(spans.stride);
  for (Eigen::Index i = 0; i < slopes.cols(); ++i) {
    const auto k = static_cast<size_t>(i);
    slopes.col(i) = (signal.values.col((i + 1) * stride) - signal.values.col(i * stride)) /
                    (spans.to_s[k] - spans.from_s[k]);
  }
  return slopes;
}

Matrix3Xd RatesOver(const TimedTurns& turns, const CheckSpans& spans) {
  Matrix3Xd rates(3, static_cast<Eigen::Index>(spans.from_s.size()));
  for (size_t i = 0; i < spans.from_s.size(); ++i) {
    const Eigen::Quaterniond a = turns.q[i * spans.stride].normalized(),
                             b = turns.q[(i + 1) * spans.stride].normalized();
    rates.col(static_cast<Eigen::Index>(i)) =
        Log(a.conjugate() * b) / (spans.to_s[i] - spans.from_s[i]);
  }
  return rates;
}

ReadingResiduals::ReadingResiduals(std::string unit, const Matrix3Xd& signal)
    : unit_(std::move(unit)), signal_rms_(Rms(signal)), is_empty_(signal.cols() == 0) {}

void ReadingResiduals::Add(const std::string& reading, const Matrix3Xd& residual) {
  rms_.emplace_back(reading, Rms(residual));
}

std::vector<std::string> ReadingResiduals::Fitting(const std::string& documented, double relative,
                                                   double absolute, const std::string& what) const {
  if (is_empty_) return {documented};
  const double limit = relative * signal_rms_ + absolute;
  auto sorted = rms_;
  std::stable_sort(sorted.begin(), sorted.end(),
                   [](const auto& a, const auto& b) { return a.second < b.second; });
  const double best = sorted.front().second;
  if (!(best <= limit)) {
    std::string listing;
    for (const auto& [name, value] : rms_) {
      listing += (listing.empty() ? "" : "; ") + name + ": " + Format("%.3g", value);
    }
    throw std::invalid_argument(what + ": nothing fits the data. Residual rms [" + unit_ +
                                "], limit " + Format("%.3g", limit) + ": " + listing);
  }
  const double close = std::min(limit, 1.5 * best + 0.1 * absolute);
  std::vector<std::string> names;
  for (const auto& [name, value] : sorted) {
    if (value > close) continue;
    names.insert(name == documented ? names.begin() : names.end(), name);
  }
  return names;
}

std::string FirstAccepted(const std::vector<std::string>& readings,
                          const std::function<void(const std::string& reading)>& judge) {
  std::string refusal;
  for (const std::string& reading : readings) {
    try {
      judge(reading);
      return reading;
    } catch (const std::invalid_argument& e) {
      if (refusal.empty()) refusal = e.what();
    }
  }
  throw std::invalid_argument(refusal);
}

void CheckThrustIsUp(const TimedVectors& position, const std::vector<Eigen::Quaterniond>& q_WB) {
  const std::vector<double>& t = position.t_s;
  const size_t stride = StrideOf(t, kForceSpan_s);
  if (t.size() <= 2 * stride) return;
  Vector3d sum = Vector3d::Zero();
  for (size_t i = stride; i + stride < t.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i), s = static_cast<Eigen::Index>(stride);
    const Vector3d later =
        (position.values.col(k + s) - position.values.col(k)) / (t[i + stride] - t[i]);
    const Vector3d earlier =
        (position.values.col(k) - position.values.col(k - s)) / (t[i] - t[i - stride]);
    const Vector3d force = (later - earlier) / (0.5 * (t[i + stride] - t[i - stride])) +
                           kGravity_m_s2 * Vector3d::UnitZ();
    sum += q_WB[i].normalized().conjugate() * force;
  }
  const Vector3d mean = sum / static_cast<double>(t.size() - 2 * stride);
  if (mean.z() >= kLeastUpright * mean.norm()) return;
  throw std::invalid_argument(
      Format("the mean specific force in the body is (%.2f, %.2f, %.2f) m/s^2, not along +z: the "
             "world is not z up or the body is not FLU",
             mean.x(), mean.y(), mean.z()));
}

}  // namespace odmc
