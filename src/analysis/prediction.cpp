#include "odmc/analysis/prediction.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

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

}  // namespace

double DifferenceStep(const ModelParameter& parameter, double value) {
  constexpr double kStep = 1e-3;
  const ParameterSpec& spec = parameter.spec;
  if (spec.transform == ParameterTransform::kLog) return kStep * value;
  return kStep * (spec.in_world ? spec.scale : std::max(std::abs(value), spec.scale));
}

PredictionSample PredictSample(const FilteredMotion& motion, const Vector3d& load_pull_W,
                               const Vehicle& vehicle, const DynamicModel& model,
                               const ModelValues& values, bool with_effects,
                               const BodyProperties* known) {
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
  out.measured_specific_force = motion.specific_force_I;
  out.speed_m_s = motion.v_WS.norm();

  // Predicted: the model in its own body frame B, then taken to F.
  const BodyProperties body =
      known != nullptr ? *known : model.Properties(values, nullptr, motion.t_s);
  const FlightState flight = FlightStateOf(motion, load_pull_W, body);
  const Matrix3d& R_WB = flight.R_WB;
  const Vector3d& w_B = flight.w_WB_B;
  out.height_m = flight.p_WB.z();
  out.climb_m_s = (R_WB * flight.v_AB_B + body.wind_W).z();
  out.v_AB_B = flight.v_AB_B;
  out.w_WB_B = w_B;
  const Vector3d w_dot_B = body.R_BS * motion.w_dot_S;
  Vector3d F, tau;
  model.EvaluateWrench(flight, values, body.p_BBcm, &F, &tau);

  const Matrix3d R_FB = R_FS * body.R_BS.transpose();
  // From Bcm to the origin of F: So is p_BS from Bo, and Fo lies at R p_SF from So.
  const Vector3d p_BcmFo = body.p_BS + R_FB.transpose() * p_SF_F - body.p_BBcm;
  const Vector3d tilt = R_WB.transpose() * (body.g_W + g_up);
  const Vector3d steady = F / body.mass + w_B.cross(w_B.cross(p_BcmFo)) + tilt;
  out.predicted_force = R_FB * (vehicle.mass_kg * (steady + w_dot_B.cross(p_BcmFo)));
  // Products of inertia are not in the measured torque, so they are in the predicted one.
  Matrix3d products = body.I_BBcm_B;
  products.diagonal().setZero();
  out.predicted_torque = R_FB * (tau - products * w_dot_B - w_B.cross(products * w_B));
  const Vector3d predicted_w_dot_B =
      body.I_BBcm_B.inverse() * (tau - w_B.cross(body.I_BBcm_B * w_B));
  out.predicted_angular_acceleration = R_FB * predicted_w_dot_B;
  out.predicted_swing_force =
      R_FB * (vehicle.mass_kg * (steady + predicted_w_dot_B.cross(p_BcmFo)));
  const Vector3d arm = body.p_BI - body.p_BBcm;
  out.predicted_specific_force =
      body.R_BI.transpose() * (F / body.mass + w_dot_B.cross(arm) + w_B.cross(w_B.cross(arm)));
  if (!with_effects) return out;
  out.effects = model.EvaluateEffects(flight, values, body.p_BBcm);
  out.rotor_torque = R_FB * RotorTorque(out.effects);
  return out;
}

bool PredictionFigures::GivesAway() const {
  constexpr double kShown = 0.01;  // of the error
  if (!force_rmse_N || !predicted_swing_force_rmse_N) return false;
  const Vector3d more = *predicted_swing_force_rmse_N - *force_rmse_N;
  return (more.cwiseAbs().array() >= kShown * force_rmse_N->array()).any();
}

void PredictionSummary::AxisSums::Add(const Vector3d& measured, const Vector3d& predicted) {
  error2 += (measured - predicted).cwiseAbs2();
  value += measured;
  value2 += measured.cwiseAbs2();
}

Vector3d PredictionSummary::AxisSums::Rmse(double n) const { return (error2 / n).cwiseSqrt(); }

Vector3d PredictionSummary::AxisSums::Zero(double n) const { return (value2 / n).cwiseSqrt(); }

Vector3d PredictionSummary::AxisSums::Explained(double n) const {
  const Vector3d variance = (value2 / n - (value / n).cwiseAbs2()).cwiseMax(1e-300);
  return Vector3d::Ones() - (error2 / n).cwiseQuotient(variance);
}

void PredictionSummary::Add(const PredictionSample& s) {
  ++samples_;
  force_.Add(s.measured_force, s.predicted_force);
  swing_force_.Add(s.measured_force, s.predicted_swing_force);
  torque_.Add(s.measured_torque, s.predicted_torque);
  acceleration_.Add(s.measured_angular_acceleration, s.predicted_angular_acceleration);
  if (s.measured_specific_force) {
    const Vector3d error = *s.measured_specific_force - s.predicted_specific_force;
    ++felt_;
    felt_error_ += error;
    felt_error2_ += error.cwiseAbs2();
  }
  const Vector3d wanted = s.measured_torque - (s.predicted_torque - s.rotor_torque);
  rotor_other_ += s.rotor_torque.cwiseProduct(wanted);
  rotor_rotor_ += s.rotor_torque.cwiseAbs2();
}

PredictionFigures PredictionSummary::Figures(bool with_torque, const Vehicle& vehicle,
                                             const DynamicModel& model,
                                             const ModelValues& values) const {
  PredictionFigures figures;
  figures.samples = samples_;
  if (samples_ == 0) return figures;
  const double n = static_cast<double>(samples_);
  figures.force_rmse_N = force_.Rmse(n);
  figures.zero_force_rmse_N = force_.Zero(n);
  figures.force_explained = force_.Explained(n);
  if (2 * felt_ > samples_) {
    const auto felt = static_cast<double>(felt_);
    const Vector3d bias = felt_error_ / felt;
    figures.accelerometer_force_rmse_N =
        vehicle.mass_kg * (felt_error2_ / felt - bias.cwiseAbs2()).cwiseMax(0.0).cwiseSqrt();
  }
  if (!with_torque) return figures;
  figures.predicted_swing_force_rmse_N = swing_force_.Rmse(n);
  figures.torque_rmse_Nm = torque_.Rmse(n);
  figures.zero_torque_rmse_Nm = torque_.Zero(n);
  figures.torque_explained = torque_.Explained(n);
  if ((rotor_rotor_.array() > 0.0).all()) {
    figures.rotor_torque_gain = rotor_other_.cwiseQuotient(rotor_rotor_);
  }
  figures.angular_acceleration_rmse_rad_s2 = acceleration_.Rmse(n);
  figures.inertia_over_nominal =
      model.Properties(values).I_BBcm_B.diagonal().cwiseQuotient(vehicle.inertia_kg_m2);
  return figures;
}

PredictionFigures SummarisePrediction(const std::vector<PredictionSample>& samples,
                                      bool with_torque, const Vehicle& vehicle,
                                      const DynamicModel& model, const ModelValues& values) {
  PredictionSummary summary;
  for (const PredictionSample& sample : samples) summary.Add(sample);
  return summary.Figures(with_torque, vehicle, model, values);
}

PredictionFigures PredictEach(const FlightLog& log, const Vehicle& file_vehicle,
                              const DynamicModel& model, const ModelValues& values,
                              const StampSpans& ground_spans, const ValueVariation& vary,
                              const PredictionSink& use) {
  PredictionSummary summary;
  LoadForceEvaluator load(model);
  const auto predict = [&](const FilteredMotion& motion) {
    ModelValues present = values;
    if (vary) vary(motion.t_s, &present);
    const Vector3d pull_W = load.PullAt(motion, values);
    const PredictionSample sample =
        PredictSample(motion, pull_W, file_vehicle, model, present, true);
    summary.Add(sample);
    use(sample);
  };
  const MotionCounts counts = FilterEach(log, file_vehicle.num_rotors(), ground_spans, predict);
  PredictionFigures figures = summary.Figures(!log.rotor_rms_only, file_vehicle, model, values);
  figures.left_out_gaps = counts.left_out_gaps;
  figures.left_out_ground = counts.left_out_ground;
  return figures;
}

Prediction Predict(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
                   const ModelValues& values, const StampSpans& ground_spans,
                   const ValueVariation& vary) {
  Prediction prediction;
  prediction.figures =
      PredictEach(log, file_vehicle, model, values, ground_spans, vary,
                  [&](const PredictionSample& sample) { prediction.samples.push_back(sample); });
  return prediction;
}

}  // namespace odmc
