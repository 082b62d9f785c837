#include "motion_windows.h"

#include <cmath>

namespace odmc {
namespace {

using Eigen::Matrix3Xd;
using Eigen::MatrixXd;
using Eigen::Vector3d;

/// The streams that are there.
std::vector<const SampledSignal*> Streams(const MotionSignals& s) {
  std::vector<const SampledSignal*> all = {&s.position};
  for (const auto* stream : {&s.velocity, &s.rates, &s.gyro, &s.accelerometer, &s.rotors}) {
    if (*stream) all.push_back(&**stream);
  }
  return all;
}

std::vector<double> Middles(const MotionSignals& s, const std::vector<bool>& flight) {
  std::vector<double> middles;
  const std::vector<const SampledSignal*> streams = Streams(s);
  for (double t = 1.5 * kWindow_s; t + 1.5 * kWindow_s < s.position.last_s(); t += kWindow_s) {
    bool covered = IsInFlight(flight, t);
    for (const SampledSignal* stream : streams) {
      covered = covered && stream->Covers(t - 1.5 * kWindow_s, t + 1.5 * kWindow_s);
    }
    if (covered) middles.push_back(t);
  }
  return middles;
}

MatrixXd Means(const std::optional<SampledSignal>& signal, const std::vector<double>& t_s) {
  if (!signal) return {};
  MatrixXd means(signal->channels(), static_cast<Eigen::Index>(t_s.size()));
  for (size_t i = 0; i < t_s.size(); ++i) {
    means.col(static_cast<Eigen::Index>(i)) =
        signal->Mean(t_s[i] - 0.5 * kWindow_s, t_s[i] + 0.5 * kWindow_s);
  }
  return means;
}

Matrix3Xd Means3(const std::optional<SampledSignal>& signal, const std::vector<double>& t_s) {
  if (!signal) return Matrix3Xd(3, 0);
  return Means(signal, t_s);
}

}  // namespace

MotionWindows CalmOnes(const MotionWindows& w, double most_rad_s) {
  std::vector<Eigen::Index> calm;
  MotionWindows some;
  for (int i = 0; i < w.size(); ++i) {
    if (w.q0[i].angularDistance(w.q1[i]) > most_rad_s * kWindow_s) continue;
    calm.push_back(i);
    some.t_s.push_back(w.t_s[i]);
    some.q_WS.push_back(w.q_WS[i]);
    some.q0.push_back(w.q0[i]);
    some.q1.push_back(w.q1[i]);
  }
  const auto pick = [&](const MatrixXd& all) {
    if (all.cols() == 0) return all;
    MatrixXd picked(all.rows(), static_cast<Eigen::Index>(calm.size()));
    for (size_t k = 0; k < calm.size(); ++k) {
      picked.col(static_cast<Eigen::Index>(k)) = all.col(calm[k]);
    }
    return picked;
  };
  some.displacement_m_s = pick(w.displacement_m_s);
  some.acceleration_W = pick(w.acceleration_W);
  some.velocity = pick(w.velocity);
  some.rates = pick(w.rates);
  some.gyro = pick(w.gyro);
  some.accelerometer = pick(w.accelerometer);
  some.rotors = pick(w.rotors);
  return some;
}

MotionWindows WindowsOf(const MotionSignals& s, const std::vector<bool>& flight) {
  MotionWindows w;
  w.t_s = Middles(s, flight);
  const double h = kWindow_s;
  w.displacement_m_s.resize(3, w.size());
  w.acceleration_W.resize(3, w.size());
  for (int i = 0; i < w.size(); ++i) {
    const double t = w.t_s[i];
    w.q_WS.push_back(s.q_WS(t));
    w.q0.push_back(s.q_WS(t - 0.5 * h));
    w.q1.push_back(s.q_WS(t + 0.5 * h));
    w.displacement_m_s.col(i) = (s.position.At(t + 0.5 * h) - s.position.At(t - 0.5 * h)) / h;
    const Vector3d before = s.position.Mean(t - 1.5 * h, t - 0.5 * h);
    const Vector3d now = s.position.Mean(t - 0.5 * h, t + 0.5 * h);
    const Vector3d after = s.position.Mean(t + 0.5 * h, t + 1.5 * h);
    w.acceleration_W.col(i) = (before - 2.0 * now + after) / (h * h);
  }
  w.velocity = Means3(s.velocity, w.t_s);
  w.rates = Means3(s.rates, w.t_s);
  w.gyro = Means3(s.gyro, w.t_s);
  w.accelerometer = Means3(s.accelerometer, w.t_s);
  w.rotors = Means(s.rotors, w.t_s);
  return w;
}

}  // namespace odmc
