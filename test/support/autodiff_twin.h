#pragma once

#include <ceres/jet.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <string>
#include <vector>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/factors/imu_factors.h"
#include "odmc/factors/state_factors.h"
#include "odmc/window/window.h"

/// \file
/// Every residual a second time, written from model.md in its own notation and for any scalar, to
/// be differentiated automatically. Shares data with the package, and no formula.
namespace odmc {
namespace test {
namespace twin {

template <typename T>
using V3 = Eigen::Matrix<T, 3, 1>;
template <typename T>
using M3 = Eigen::Matrix<T, 3, 3>;
template <typename T>
using VX = Eigen::Matrix<T, Eigen::Dynamic, 1>;
template <typename T>
using Q4 = Eigen::Quaternion<T>;

/// Exp of a rotation vector; the first-order form at zero, where only derivatives matter.
template <typename T>
Q4<T> Exp(const V3<T>& a) {
  using std::cos;
  using std::sin;
  using std::sqrt;
  const T square = a.dot(a);
  if (square < T(1e-24)) {
    return Q4<T>(T(1.0), T(0.5) * a.x(), T(0.5) * a.y(), T(0.5) * a.z());
  }
  const T angle = sqrt(square);
  const T k = sin(T(0.5) * angle) / angle;
  return Q4<T>(cos(T(0.5) * angle), k * a.x(), k * a.y(), k * a.z());
}

template <typename T>
V3<T> Log(const Q4<T>& q) {
  using std::atan2;
  using std::sqrt;
  const T sign = q.w() < T(0.0) ? T(-1.0) : T(1.0);
  const V3<T> v = q.vec() * sign;
  const T w = q.w() * sign;
  const T square = v.dot(v);
  if (square < T(1e-24)) return v * (T(2.0) / w);
  const T n = sqrt(square);
  return v * (T(2.0) * atan2(n, w) / n);
}

/// One keyframe: p, R, v, omega of model.md section 1 for the odometry's sensor.
template <typename T>
struct Motion {
  V3<T> p;
  Q4<T> q;
  V3<T> v, omega;
};

/// The dynamic parameters of model.md section 1, and both sensors' places in the body.
template <typename T>
struct Parameters {
  T k_f = T(0.0), k_m = T(0.0), k_h = T(0.0);
  T delay = T(0.0), J_r = T(0.0);  // model.md 12.16, 12.7
  V3<T> d = V3<T>::Zero(), b = V3<T>::Zero(), c = V3<T>::Zero(), I = V3<T>::Zero();
  V3<T> gravity = V3<T>::Zero();  // third entry stays zero
  V3<T> p_BS = V3<T>::Zero(), r_BS = V3<T>::Zero(), p_BI = V3<T>::Zero(), r_BI = V3<T>::Zero();
};

/// Physical values by name; names the model lacks leave the neutral value in place.
template <typename T>
Parameters<T> ParametersFrom(const DynamicModel& model, const VX<T>& values) {
  Parameters<T> out;
  const Vehicle& vehicle = model.vehicle();
  const auto mount = [](const SensorMount& m, V3<T>* p, V3<T>* r) {
    *p = m.p_BS.cast<T>();
    const Eigen::AngleAxisd turn(m.q_BS);
    *r = (turn.angle() * turn.axis()).eval().template cast<T>();
  };
  out.I = vehicle.inertia_kg_m2.cast<T>();
  mount(vehicle.odometry, &out.p_BS, &out.r_BS);
  if (vehicle.imu) mount(*vehicle.imu, &out.p_BI, &out.r_BI);
  const auto read = [&](const std::string& name, T* to) {
    const int k = model.IndexOf(name);
    if (k >= 0) *to = values[k];
  };
  read("thrust.k_f", &out.k_f);
  read("rotor_torque.k_m", &out.k_m);
  read("hvt.k_h", &out.k_h);
  read("rotor_delay.delay", &out.delay);
  read("rotor_reaction.J_r", &out.J_r);
  read("gravity.x", &out.gravity[0]);
  read("gravity.y", &out.gravity[1]);
  for (int i = 0; i < 3; ++i) {
    const std::string axis(1, "xyz"[i]);
    read("drag.d_" + axis, &out.d[i]);
    read("viscous_torque.b_" + axis, &out.b[i]);
    read("centre_of_gravity." + axis, &out.c[i]);
    read("inertia." + axis, &out.I[i]);
    read("odometry_extrinsics.p" + axis, &out.p_BS[i]);
    read("odometry_extrinsics.r" + axis, &out.r_BS[i]);
    read("imu_extrinsics.p" + axis, &out.p_BI[i]);
    read("imu_extrinsics.r" + axis, &out.r_BI[i]);
  }
  return out;
}

/// Values of the model at the optimiser's eta; frozen ones from `frozen`.      model.md section 7
template <typename T>
VX<T> Decode(const DynamicModel& model, const ModelValues& frozen, const VX<T>& eta) {
  using std::exp;
  VX<T> values(model.num_parameters());
  int next = 0;
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    if (!p.estimated) {
      values[k] = T(frozen[k]);
    } else if (p.spec.transform == ParameterTransform::kLog) {
      values[k] = T(p.spec.scale) * exp(eta[next++]);
    } else {
      values[k] = T(p.spec.scale) * eta[next++];
    }
  }
  return values;
}

/// Force, torque and rates over an interval, at the point where the form evaluates them.
template <typename T>
struct Interval {
  M3<T> B;              ///< B_m or B_0
  V3<T> P[2], V[2];     ///< centre of gravity
  V3<T> w[2], w_point;  ///< body rates
  V3<T> F, tau;
};

template <typename T>
Interval<T> IntervalOf(const DynamicsMeasurement& z, const Vehicle& vehicle, const Motion<T>& x0,
                       const Motion<T>& x1, const Parameters<T>& a) {
  const bool euler = z.form == DynamicsForm::kEuler;
  const Q4<T> E = Exp(a.r_BS).conjugate();  // R_b^I
  const V3<T> ell = -(E * a.p_BS);          // p_b^I
  const V3<T> q = ell + E * a.c;
  Interval<T> k;
  Q4<T> B[2];
  V3<T> Vb[2];
  const Motion<T>* x[2] = {&x0, &x1};
  for (int i = 0; i < 2; ++i) {
    k.P[i] = x[i]->p + x[i]->q * q;
    k.V[i] = x[i]->v + x[i]->q * V3<T>(x[i]->omega.cross(q));
    Vb[i] = x[i]->v + x[i]->q * V3<T>(x[i]->omega.cross(ell));
    B[i] = x[i]->q * E;
    k.w[i] = E.conjugate() * x[i]->omega;
  }
  V3<T> Vb_point;
  if (euler) {
    k.B = B[0].toRotationMatrix();
    k.w_point = k.w[0];
    Vb_point = Vb[0];
  } else {
    const V3<T> phi = Log<T>(B[0].conjugate() * B[1]);
    k.B = (B[0] * Exp<T>(phi * T(0.5))).toRotationMatrix();
    k.w_point = T(0.5) * (k.w[0] + k.w[1]);
    Vb_point = T(0.5) * (Vb[0] + Vb[1]);
  }
  const V3<T> u = k.B.transpose() * Vb_point;
  const V3<T> e3(T(0.0), T(0.0), T(1.0));
  k.F = a.d.cwiseProduct(u) + e3 * (a.k_h * (u.x() * u.x() + u.y() * u.y()));
  k.tau = a.b.cwiseProduct(k.w_point);
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    const T sigma = T(z.rotors.speed_squared[j]) + a.delay * T(z.rotors.speed_squared_rate[j]);
    const V3<T> f = e3 * (a.k_f * sigma);
    const V3<T> arm = vehicle.rotors[j].p_BP.cast<T>() - a.c;
    const T spin(vehicle.rotors[j].spin);
    k.F += f;
    k.tau += arm.cross(f) + e3 * (spin * a.k_m * sigma);
    k.tau += e3 * (spin * a.J_r * T(z.rotors.acceleration[j]));
  }
  return k;
}

template <typename T>
V3<T> GravityAxis(const Parameters<T>& a) {
  return Exp(a.gravity) * V3<T>(T(0.0), T(0.0), T(1.0));  // R_G e3
}

/// e_p (Form E), e_v, e_alpha of model.md 4.1, 4.2, 4.4, in their own units (9×1).
template <typename T>
VX<T> Dynamics(const DynamicsMeasurement& z, const Vehicle& vehicle, const Motion<T>& x0,
               const Motion<T>& x1, const Parameters<T>& a, V3<T>* inertia) {
  const Interval<T> k = IntervalOf(z, vehicle, x0, x1, a);
  V3<T> held = a.I;  // what rows of axes that are held take
  for (int i = 0; i < 3; ++i) {
    if (z.inertia_fixed[i]) held[i] = T(z.fixed_inertia[i]);
  }
  *inertia = held;  // each row's own
  const T dt(z.dt), m(vehicle.mass_kg), g(vehicle.gravity_m_s2);
  const V3<T> up = GravityAxis(a);
  VX<T> e = VX<T>::Zero(9);
  if (z.form == DynamicsForm::kEuler) {
    const V3<T> a_p = k.P[1] - k.P[0] - k.V[0] * dt + up * (T(0.5) * g * dt * dt);
    e.template segment<3>(0) = (k.B.transpose() * a_p) * m - k.F * (T(0.5) * dt * dt);
  }
  e.template segment<3>(3) =
      (k.B.transpose() * V3<T>(k.V[1] - k.V[0] + up * (g * dt))) * m - k.F * dt;
  for (int i = 0; i < 3; ++i) {
    const V3<T> I = z.inertia_fixed[i] ? held : a.I;
    const V3<T> momentum = I.cwiseProduct(k.w_point);
    const V3<T> e_omega =
        I.cwiseProduct(k.w[1] - k.w[0]) + k.w_point.cross(momentum) * dt - k.tau * dt;
    e[6 + i] = e_omega[i] / I[i];
  }
  return e;
}

/// The whitened factor: inverse Cholesky factor of the covariance of model.md section 5, the torque
/// rows by fixed and rotor noise (the latter through the live inertia).
template <typename T>
VX<T> WhitenedDynamics(const DynamicsMeasurement& z, const DynamicsNoise& noise, bool with_torque,
                       const Vehicle& vehicle, const Motion<T>& x0, const Motion<T>& x1,
                       const Parameters<T>& a) {
  using std::sqrt;
  V3<T> I;
  const VX<T> e = Dynamics(z, vehicle, x0, x1, a, &I);
  const bool euler = z.form == DynamicsForm::kEuler;
  const int velocity = euler ? 3 : 0;
  VX<T> r(velocity + 3 + (with_torque ? 3 : 0));
  // Rotor accelerations with noise, rotor by rotor: along z, and about Bo.
  T force_variance(0.0);
  V3<T> torque_variance = V3<T>::Zero();
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    const Rotor& rotor = vehicle.rotors[j];
    const double rate = noise.rotor_rate_rad_s2, square_rate = 2.0 * z.rotors.speed[j] * rate;
    const T f = a.delay * a.k_f * T(square_rate);
    const T couple = T(rotor.spin) * (a.delay * a.k_m * T(square_rate) + a.J_r * T(rate));
    const V3<T> tau(T(rotor.p_BP.y()) * f, T(-rotor.p_BP.x()) * f, couple);
    force_variance += f * f;
    torque_variance += tau.cwiseProduct(tau);
  }
  for (int i = 0; i < 3; ++i) {
    const double rotor = i == 2 ? noise.rotor_force_N : 0.0;
    const T sigma = sqrt(T(noise.force_N[i] * noise.force_N[i] + rotor * rotor) +
                         (i == 2 ? force_variance : T(0.0)));
    if (euler) {
      // L of [[dt^4/3, dt^3/2], [dt^3/2, dt^2]] by hand.
      const double L11 = z.dt * z.dt / std::sqrt(3.0), L21 = 0.5 * std::sqrt(3.0) * z.dt;
      const double L22 = 0.5 * z.dt;
      const T first = e[i] / (T(L11) * sigma);
      r[i] = first;
      r[3 + i] = (e[3 + i] / sigma - first * T(L21)) / T(L22);
    } else {
      r[i] = e[3 + i] / (T(z.dt) * sigma);
    }
    if (!with_torque) continue;
    const double fixed = noise.torque_Nm[i] / noise.nominal_inertia[i];
    const T live = (T(noise.rotor_torque_Nm[i] * noise.rotor_torque_Nm[i]) + torque_variance[i]) /
                   (I[i] * I[i]);
    r[velocity + 3 + i] = e[6 + i] / (T(z.dt) * sqrt(T(fixed * fixed) + live));
  }
  return r;
}

/// e_k and e_theta at the sensor; Form E has e_theta at the first rate only.
template <typename T>
VX<T> Kinematic(double dt, DynamicsForm form, double sigma_position, double sigma_rotation,
                bool with_rotation, const Motion<T>& x0, const Motion<T>& x1) {
  const bool euler = form == DynamicsForm::kEuler;
  VX<T> r((euler ? 0 : 3) + (with_rotation ? 3 : 0));
  int row = 0;
  if (!euler) {
    r.template segment<3>(0) = (x1.p - x0.p - (x0.v + x1.v) * T(0.5 * dt)) / T(sigma_position);
    row = 3;
  }
  if (with_rotation) {
    const V3<T> turn = Log<T>(x0.q.conjugate() * x1.q);
    const V3<T> swept =
        euler ? V3<T>(x0.omega * T(dt)) : V3<T>((x0.omega + x1.omega) * T(0.5 * dt));
    r.template segment<3>(row) = (turn - swept) / T(sigma_rotation);
  }
  return r;
}

template <typename T>
VX<T> Odometry(const OdometrySample& z, const OdometryNoise& noise, bool with_rate,
               const Motion<T>& x) {
  const bool rate = with_rate && z.w_WS_S.has_value();
  VX<T> r(6 + (z.v_WS ? 3 : 0) + (rate ? 3 : 0));
  r.template segment<3>(0) = (x.p - z.p_WS.cast<T>()) / T(noise.position_m);
  r.template segment<3>(3) = Log<T>(z.q_WS.cast<T>().conjugate() * x.q) / T(noise.attitude_rad);
  int row = 6;
  if (z.v_WS) {
    r.template segment<3>(row) = (x.v - z.v_WS->cast<T>()) / T(noise.velocity_m_s);
    row += 3;
  }
  if (rate) r.template segment<3>(row) = (x.omega - z.w_WS_S->cast<T>()) / T(noise.rate_rad_s);
  return r;
}

/// Log(dR(b)^T R_I0^T R_I1): model.md 4.2, e_theta with the preintegrated gyro.
template <typename T>
VX<T> GyroPreintegration(const ImuInterval& z, const ImuNoise& noise, const Motion<T>& x0,
                         const Motion<T>& x1, const VX<T>& bias, const Parameters<T>& a) {
  const Q4<T> R_SI = Exp(a.r_BS).conjugate() * Exp(a.r_BI);
  const Q4<T> I0 = x0.q * R_SI, I1 = x1.q * R_SI;
  const V3<T> moved = bias.template head<3>() - z.bias_lin.cast<T>();
  const Q4<T> dR = z.delta_q.cast<T>() * Exp<T>(z.d_bias.cast<T>() * moved);
  return Log<T>(dR.conjugate() * (I0.conjugate() * I1)) / T(noise.preintegration_rad);
}

template <typename T>
VX<T> Gyro(const Eigen::Vector3d& z, const ImuNoise& noise, const Motion<T>& x, const VX<T>& bias,
           const Parameters<T>& a) {
  const V3<T> w_B = Exp(a.r_BS) * x.omega;
  const V3<T> e = Exp(a.r_BI).conjugate() * w_B + bias.template head<3>() - z.cast<T>();
  return e / T(noise.gyro_rad_s);
}

/// Eq. (C) of model.md: E F / m - omega_dot x q - omega x (omega x q), all in the IMU's axes, q the
/// centre of gravity in the IMU frame.
template <typename T>
VX<T> Accelerometer(const DynamicsMeasurement& z, const Eigen::Vector3d& reading,
                    const Eigen::Vector3d& sigma, const Vehicle& vehicle, const Motion<T>& x0,
                    const Motion<T>& x1, const VX<T>& bias, const Parameters<T>& a) {
  const Interval<T> k = IntervalOf(z, vehicle, x0, x1, a);
  const Q4<T> E = Exp(a.r_BI).conjugate();
  const V3<T> q = E * V3<T>(a.c - a.p_BI);
  const V3<T> omega = E * k.w_point;
  const V3<T> omega_dot = E * V3<T>((k.w[1] - k.w[0]) / T(z.dt));
  const V3<T> felt =
      E * V3<T>(k.F / T(vehicle.mass_kg)) - omega_dot.cross(q) - omega.cross(V3<T>(omega.cross(q)));
  const V3<T> e = felt + bias.template tail<3>() - reading.cast<T>();
  return e.cwiseQuotient(sigma.cast<T>());
}

template <typename T>
VX<T> BlockPrior(const Eigen::VectorXd& mean, const Eigen::VectorXd& sigma, const VX<T>& x) {
  return (x - mean.cast<T>()).cwiseQuotient(sigma.cast<T>());
}

template <typename T>
VX<T> BiasWalk(const Eigen::VectorXd& sigma, const VX<T>& b0, const VX<T>& b1) {
  return (b1 - b0).cwiseQuotient(sigma.cast<T>());
}

/// b + A [x - x_lin; bias - bias_lin; eta - eta_lin], rotations by Log(q_lin^-1 q).
template <typename T>
VX<T> Marginal(const Prior& prior, const Motion<double>& lin, const Motion<T>& x,
               const Eigen::VectorXd& bias_lin, const VX<T>& bias, const VX<T>& eta) {
  VX<T> d(prior.A.cols());
  int row = 0;
  if (prior.has_state) {
    d.template segment<3>(0) = x.p - lin.p.cast<T>();
    d.template segment<3>(3) = Log<T>(lin.q.cast<T>().conjugate() * x.q);
    d.template segment<3>(6) = x.v - lin.v.cast<T>();
    d.template segment<3>(9) = x.omega - lin.omega.cast<T>();
    row = 12;
  }
  if (prior.has_bias) {
    d.template segment<6>(row) = bias - bias_lin.cast<T>();
    row += 6;
  }
  for (int i = 0; i < prior.eta_lin.size(); ++i) d[row + i] = eta[i] - T(prior.eta_lin[i]);
  VX<T> r = prior.b.cast<T>();
  for (int i = 0; i < prior.A.rows(); ++i) {
    for (int j = 0; j < prior.A.cols(); ++j) r[i] += T(prior.A(i, j)) * d[j];
  }
  return r;
}

}  // namespace twin
}  // namespace test
}  // namespace odmc
