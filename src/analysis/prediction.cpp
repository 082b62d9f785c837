#include "odmc/analysis/prediction.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "odmc/math/savitzky_golay.h"
#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kFilterWidth_s = 0.1;

/// Rows of the matrix of filtered channels.
enum Channel : int { kPosition = 0, kQuaternion = 3, kVelocity = 7, kRate = 10, kRotors = 13 };

/// The recording as one matrix at the odometry's stamps: one column a sample.
struct Channels {
  std::vector<double> t_s;
  std::vector<Stamp> stamps;
  Eigen::MatrixXd data;
  std::vector<bool> covered;  // rotor speeds are there
  bool has_velocity = true, has_rate = true;
};

Channels Collect(const FlightLog& log, int num_rotors) {
  Channels c;
  const int n = static_cast<int>(log.odometry.size());
  c.data = Eigen::MatrixXd::Zero(kRotors + num_rotors, n);
  c.covered.assign(n, false);
  Eigen::Quaterniond last = Eigen::Quaterniond::Identity();
  size_t r = 0;
  for (int i = 0; i < n; ++i) {
    const OdometrySample& s = log.odometry[i];
    c.stamps.push_back(s.stamp);
    c.t_s.push_back(ToSeconds(s.stamp - log.odometry.front().stamp));
    c.data.block<3, 1>(kPosition, i) = s.p_WS;
    Eigen::Vector4d q = s.q_WS.coeffs();
    if (i > 0 && q.dot(last.coeffs()) < 0.0) q = -q;
    last.coeffs() = q;
    c.data.block<4, 1>(kQuaternion, i) = q;
    c.has_velocity = c.has_velocity && s.v_WS.has_value();
    c.has_rate = c.has_rate && s.w_WS_S.has_value();
    if (s.v_WS) c.data.block<3, 1>(kVelocity, i) = *s.v_WS;
    if (s.w_WS_S) c.data.block<3, 1>(kRate, i) = *s.w_WS_S;
    while (r + 1 < log.rotors.size() && log.rotors[r + 1].stamp <= s.stamp) ++r;
    if (log.rotors.empty() || log.rotors[r].stamp > s.stamp) continue;
    RotorVector squared = log.rotors[r].speed.array().square();
    if (log.rotors[r].stamp < s.stamp) {
      if (r + 1 >= log.rotors.size()) continue;
      const double span = ToSeconds(log.rotors[r + 1].stamp - log.rotors[r].stamp);
      if (span > 0.5 * kFilterWidth_s) continue;
      const double x = ToSeconds(s.stamp - log.rotors[r].stamp) / span;
      const RotorVector speed = (1.0 - x) * log.rotors[r].speed + x * log.rotors[r + 1].speed;
      squared = speed.array().square();
    }
    c.data.block(kRotors, i, num_rotors, 1) = squared;
    c.covered[i] = true;
  }
  return c;
}

/// Smoothed motion of the sensor at one sample.
struct Motion {
  Matrix3d R_WS;
  Vector3d v_WS, a_WS;    // velocity and acceleration of So in W
  Vector3d w_S, w_dot_S;  // angular rate and acceleration in S
};

Motion MotionAt(const Channels& c, const LocalPolynomial& fit) {
  Motion motion;
  const Eigen::Quaterniond q(Eigen::Vector4d(fit.value.segment<4>(kQuaternion).normalized()));
  motion.R_WS = q.toRotationMatrix();
  motion.v_WS = c.has_velocity ? fit.value.segment<3>(kVelocity) : fit.first.segment<3>(kPosition);
  motion.a_WS = c.has_velocity ? fit.first.segment<3>(kVelocity) : fit.second.segment<3>(kPosition);
  if (c.has_rate) {
    motion.w_S = fit.value.segment<3>(kRate);
    motion.w_dot_S = fit.first.segment<3>(kRate);
  } else {
    // w = 2 vec(q* dq/dt), dw/dt = 2 vec(q* d²q/dt²).
    const Eigen::Quaterniond first(Eigen::Vector4d(fit.first.segment<4>(kQuaternion)));
    const Eigen::Quaterniond second(Eigen::Vector4d(fit.second.segment<4>(kQuaternion)));
    motion.w_S = 2.0 * (q.conjugate() * first).vec();
    motion.w_dot_S = 2.0 * (q.conjugate() * second).vec();
  }
  return motion;
}

/// What the rotors alone put on the body as torque.
Vector3d RotorTorque(const std::vector<EffectWrench>& effects) {
  Vector3d torque = Vector3d::Zero();
  for (const EffectWrench& e : effects) {
    if (e.effect == "thrust" || e.effect == "rotor_torque") torque += e.tau_Bcm_B;
  }
  return torque;
}

/// Predicts and measures one sample.
PredictionSample SampleAt(const Motion& motion, const RotorState& rotors, double t_s,
                          const Vector3d& position_W, const Vehicle& vehicle,
                          const DynamicModel& model, const ModelValues& values) {
  PredictionSample out;
  out.t_s = t_s;
  // Measured: by the vehicle file's mount F of the body frame.
  const Matrix3d R_FS = vehicle.odometry.q_BS.toRotationMatrix();
  const Vector3d p_SF_F = -vehicle.odometry.p_BS;
  const Matrix3d R_FW = R_FS * motion.R_WS.transpose();
  const Vector3d w_F = R_FS * motion.w_S, w_dot_F = R_FS * motion.w_dot_S;
  const Vector3d a_F = R_FW * motion.a_WS + w_dot_F.cross(p_SF_F) + w_F.cross(w_F.cross(p_SF_F));
  const Vector3d g_up(0.0, 0.0, vehicle.gravity_m_s2);
  const Vector3d I0 = vehicle.inertia_kg_m2;
  out.measured_force = vehicle.mass_kg * (a_F + R_FW * g_up);
  out.measured_torque = I0.cwiseProduct(w_dot_F) + w_F.cross(I0.cwiseProduct(w_F));
  out.measured_angular_acceleration = w_dot_F;
  out.speed_m_s = motion.v_WS.norm();

  // Predicted: the model in its own body frame B, then taken to F.
  const BodyProperties body = model.Properties(values);
  const Matrix3d R_WB = motion.R_WS * body.R_BS.transpose();
  const Vector3d w_B = body.R_BS * motion.w_S, w_dot_B = body.R_BS * motion.w_dot_S;
  FlightState flight;
  flight.time_s = t_s;
  flight.R_WB = R_WB;
  flight.p_WB = position_W - R_WB * body.p_BS;
  flight.w_WB_B = w_B;
  const Vector3d v_WB = motion.v_WS - R_WB * w_B.cross(body.p_BS);
  flight.v_AB_B = R_WB.transpose() * (v_WB - body.wind_W);
  flight.rotors = rotors;
  Vector3d F, tau;
  model.EvaluateWrench(flight, values, body.p_BBcm, &F, &tau);
  out.effects = model.EvaluateEffects(flight, values, body.p_BBcm);

  const Matrix3d R_FB = R_FS * body.R_BS.transpose();
  // From Bcm to the origin of F: So is p_BS from Bo, and Fo lies at R p_SF from So.
  const Vector3d p_BcmFo = body.p_BS + R_FB.transpose() * p_SF_F - body.p_BBcm;
  const Vector3d swing = w_dot_B.cross(p_BcmFo) + w_B.cross(w_B.cross(p_BcmFo));
  const Vector3d tilt = R_WB.transpose() * (body.g_W + g_up);
  const Vector3d specific = F / body.mass + swing + tilt;
  out.predicted_force = R_FB * (vehicle.mass_kg * specific);
  out.predicted_torque = R_FB * tau;
  out.rotor_torque = R_FB * RotorTorque(out.effects);
  out.predicted_angular_acceleration =
      R_FB * (body.I_BBcm_B.inverse() * (tau - w_B.cross(body.I_BBcm_B * w_B)));
  return out;
}

/// Means over samples, axis by axis.
struct AxisSums {
  Vector3d error2 = Vector3d::Zero(), value = Vector3d::Zero(), value2 = Vector3d::Zero();
  void Add(const Vector3d& measured, const Vector3d& predicted) {
    error2 += (measured - predicted).cwiseAbs2();
    value += measured;
    value2 += measured.cwiseAbs2();
  }
  Vector3d Rmse(double n) const { return (error2 / n).cwiseSqrt(); }
  Vector3d Zero(double n) const { return (value2 / n).cwiseSqrt(); }
  Vector3d Explained(double n) const {
    const Vector3d variance = (value2 / n - (value / n).cwiseAbs2()).cwiseMax(1e-300);
    return Vector3d::Ones() - (error2 / n).cwiseQuotient(variance);
  }
};

PredictionFigures Summarise(const std::vector<PredictionSample>& samples, bool with_torque,
                            const Vehicle& vehicle, const DynamicModel& model,
                            const ModelValues& values) {
  PredictionFigures figures;
  figures.samples = static_cast<long>(samples.size());
  if (samples.empty()) return figures;
  AxisSums force, torque, acceleration;
  Vector3d rotor_other = Vector3d::Zero(), rotor_rotor = Vector3d::Zero();
  for (const PredictionSample& s : samples) {
    force.Add(s.measured_force, s.predicted_force);
    torque.Add(s.measured_torque, s.predicted_torque);
    acceleration.Add(s.measured_angular_acceleration, s.predicted_angular_acceleration);
    const Vector3d wanted = s.measured_torque - (s.predicted_torque - s.rotor_torque);
    rotor_other += s.rotor_torque.cwiseProduct(wanted);
    rotor_rotor += s.rotor_torque.cwiseAbs2();
  }
  const double n = static_cast<double>(samples.size());
  figures.force_rmse_N = force.Rmse(n);
  figures.zero_force_rmse_N = force.Zero(n);
  figures.force_explained = force.Explained(n);
  if (!with_torque) return figures;
  figures.torque_rmse_Nm = torque.Rmse(n);
  figures.zero_torque_rmse_Nm = torque.Zero(n);
  figures.torque_explained = torque.Explained(n);
  if ((rotor_rotor.array() > 0.0).all()) {
    figures.rotor_torque_gain = rotor_other.cwiseQuotient(rotor_rotor);
  }
  figures.angular_acceleration_rmse_rad_s2 = acceleration.Rmse(n);
  figures.inertia_over_nominal =
      model.Properties(values).I_BBcm_B.diagonal().cwiseQuotient(vehicle.inertia_kg_m2);
  return figures;
}

bool OnGround(Stamp stamp, const std::vector<std::pair<Stamp, Stamp>>& spans) {
  return std::any_of(spans.begin(), spans.end(), [stamp](const auto& span) {
    return stamp >= span.first && stamp <= span.second;
  });
}

}  // namespace

Prediction Predict(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
                   const ModelValues& values,
                   const std::vector<std::pair<Stamp, Stamp>>& ground_spans) {
  Prediction prediction;
  const int num_rotors = file_vehicle.num_rotors();
  const Channels c = Collect(log, num_rotors);
  const int n = static_cast<int>(c.t_s.size());
  if (n < 5) return prediction;
  std::vector<double> steps;
  for (int i = 1; i < n; ++i) steps.push_back(c.t_s[i] - c.t_s[i - 1]);
  const double step_s = Median(steps);
  const SavitzkyGolay filter(SavitzkyGolay::NearestOddCount(kFilterWidth_s, step_s));
  const int half = filter.count() / 2;
  const double longest_s = 1.5 * std::max(kFilterWidth_s, filter.count() * step_s);
  for (int i = half; i + half < n; ++i) {
    if (OnGround(c.stamps[i], ground_spans)) {
      ++prediction.figures.left_out_ground;
      continue;
    }
    bool whole = c.t_s[i + half] - c.t_s[i - half] < longest_s;
    for (int k = i - half; whole && k <= i + half; ++k) whole = c.covered[k];
    for (int k = i - half; whole && k < i + half; ++k) {
      whole = c.t_s[k + 1] - c.t_s[k] < std::max(3.5 * step_s, 0.02);
    }
    if (!whole) {
      ++prediction.figures.left_out_gaps;
      continue;
    }
    const LocalPolynomial fit = filter.At(c.t_s, c.data, i);
    RotorState rotors;
    rotors.speed_squared = fit.value.tail(num_rotors).cwiseMax(0.0);
    rotors.speed = rotors.speed_squared.cwiseSqrt();
    rotors.speed_squared_rate = fit.first.tail(num_rotors);
    rotors.acceleration =
        rotors.speed_squared_rate.cwiseQuotient((2.0 * rotors.speed).cwiseMax(1.0));
    prediction.samples.push_back(SampleAt(MotionAt(c, fit), rotors, c.t_s[i],
                                          fit.value.segment<3>(kPosition), file_vehicle, model,
                                          values));
  }
  const PredictionFigures left_out = prediction.figures;
  prediction.figures =
      Summarise(prediction.samples, !log.rotor_rms_only, file_vehicle, model, values);
  prediction.figures.left_out_gaps = left_out.left_out_gaps;
  prediction.figures.left_out_ground = left_out.left_out_ground;
  return prediction;
}

}  // namespace odmc
