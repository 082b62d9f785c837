#include "odmc/analysis/prediction.h"

#include <Eigen/LU>
#include <algorithm>

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// What the rotors alone put on the body as torque.
Vector3d RotorTorque(const std::vector<EffectWrench>& effects) {
  Vector3d torque = Vector3d::Zero();
  for (const EffectWrench& e : effects) {
    if (e.effect == "thrust" || e.effect == "rotor_torque") torque += e.tau_Bcm_B;
  }
  return torque;
}

/// What the model sees of a sample.
FlightState FlightStateOf(const FilteredMotion& motion, const Vector3d& load_pull_W,
                          const BodyProperties& body) {
  FlightState flight;
  flight.time_s = motion.t_s;
  flight.R_WB = motion.R_WS * body.R_BS.transpose();
  flight.w_WB_B = body.R_BS * motion.w_S;
  flight.p_WB = motion.p_WS - flight.R_WB * body.p_BS;
  const Vector3d v_WB = motion.v_WS - flight.R_WB * flight.w_WB_B.cross(body.p_BS);
  flight.v_AB_B = flight.R_WB.transpose() * (v_WB - body.wind_W);
  flight.rotors = motion.rotors;
  flight.load.pull_W = load_pull_W;
  return flight;
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

}  // namespace

PredictionSample PredictSample(const FilteredMotion& motion, const Vector3d& load_pull_W,
                               const Vehicle& vehicle, const DynamicModel& model,
                               const ModelValues& values, bool with_effects) {
  PredictionSample out;
  out.t_s = motion.t_s;
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
  const BodyProperties body = model.Properties(values, nullptr, motion.t_s);
  const FlightState flight = FlightStateOf(motion, load_pull_W, body);
  const Matrix3d& R_WB = flight.R_WB;
  const Vector3d& w_B = flight.w_WB_B;
  const Vector3d w_dot_B = body.R_BS * motion.w_dot_S;
  Vector3d F, tau;
  model.EvaluateWrench(flight, values, body.p_BBcm, &F, &tau);

  const Matrix3d R_FB = R_FS * body.R_BS.transpose();
  // From Bcm to the origin of F: So is p_BS from Bo, and Fo lies at R p_SF from So.
  const Vector3d p_BcmFo = body.p_BS + R_FB.transpose() * p_SF_F - body.p_BBcm;
  const Vector3d swing = w_dot_B.cross(p_BcmFo) + w_B.cross(w_B.cross(p_BcmFo));
  const Vector3d tilt = R_WB.transpose() * (body.g_W + g_up);
  const Vector3d specific = F / body.mass + swing + tilt;
  out.predicted_force = R_FB * (vehicle.mass_kg * specific);
  // Products of inertia are not in the measured torque, so they are in the predicted one.
  Matrix3d products = body.I_BBcm_B;
  products.diagonal().setZero();
  out.predicted_torque = R_FB * (tau - products * w_dot_B - w_B.cross(products * w_B));
  out.predicted_angular_acceleration =
      R_FB * (body.I_BBcm_B.inverse() * (tau - w_B.cross(body.I_BBcm_B * w_B)));
  if (!with_effects) return out;
  out.effects = model.EvaluateEffects(flight, values, body.p_BBcm);
  out.rotor_torque = R_FB * RotorTorque(out.effects);
  return out;
}

Vector3d PredictSpecificForce(const FilteredMotion& motion, const Vector3d& load_pull_W,
                              const DynamicModel& model, const ModelValues& values) {
  const BodyProperties body = model.Properties(values, nullptr, motion.t_s);
  const FlightState flight = FlightStateOf(motion, load_pull_W, body);
  Vector3d F, tau;
  model.EvaluateWrench(flight, values, body.p_BBcm, &F, &tau);
  const Vector3d& w = flight.w_WB_B;
  const Vector3d arm = body.p_BI - body.p_BBcm;
  const Vector3d swing = (body.R_BS * motion.w_dot_S).cross(arm) + w.cross(w.cross(arm));
  return body.R_BI.transpose() * (F / body.mass + swing);
}

PredictionFigures SummarisePrediction(const std::vector<PredictionSample>& samples,
                                      bool with_torque, const Vehicle& vehicle,
                                      const DynamicModel& model, const ModelValues& values) {
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

Prediction Predict(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
                   const ModelValues& values,
                   const std::vector<std::pair<Stamp, Stamp>>& ground_spans,
                   const ValueVariation& vary) {
  Prediction prediction;
  const FlightMotion flight = FilterFlight(log, file_vehicle.num_rotors(), ground_spans);
  const std::vector<Vector3d> pulls = LoadPulls(flight, model, values);
  prediction.samples.reserve(flight.samples.size());
  for (size_t i = 0; i < flight.samples.size(); ++i) {
    ModelValues present = values;
    if (vary) vary(flight.samples[i].t_s, &present);
    prediction.samples.push_back(
        PredictSample(flight.samples[i], pulls[i], file_vehicle, model, present, true));
  }
  prediction.figures =
      SummarisePrediction(prediction.samples, !log.rotor_rms_only, file_vehicle, model, values);
  prediction.figures.left_out_gaps = flight.left_out_gaps;
  prediction.figures.left_out_ground = flight.left_out_ground;
  return prediction;
}

}  // namespace odmc
