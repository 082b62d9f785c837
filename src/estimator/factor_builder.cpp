#include "odmc/estimator/factor_builder.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "odmc/factors/imu_factors.h"
#include "odmc/factors/state_factors.h"

namespace odmc {
namespace {

using Eigen::Vector3d;
using Vector6d = Eigen::Matrix<double, 6, 1>;

Vector3d PriorInertia(const DynamicModel& model) {
  Vector3d inertia = model.vehicle().inertia_kg_m2;
  for (int i = 0; i < 3; ++i) {
    const int k = model.IndexOf(std::string("inertia.") + "xyz"[i]);
    if (k >= 0) inertia[i] = model.parameters()[k].spec.prior_value;
  }
  return inertia;
}

Vector6d Stacked(double gyro, double accelerometer) {
  Vector6d both;
  both << Vector3d::Constant(gyro), Vector3d::Constant(accelerometer);
  return both;
}

}  // namespace

FactorBuilder::FactorBuilder(const DynamicModel* model, const EstimatorOptions* options,
                             bool with_torque, const ParameterLayout* layout, Window* window)
    : model_(model),
      options_(options),
      with_torque_(with_torque),
      form_(options->dynamics_form == "euler" ? DynamicsForm::kEuler : DynamicsForm::kMidpoint),
      layout_(layout),
      window_(window) {
  if (options->huber_width > 0.0) {
    loss_ = std::make_unique<ceres::HuberLoss>(options->huber_width);
  }
}

void FactorBuilder::TakeBack() {
  pending_.clear();
  if (window_->biases().empty()) bias_since_.reset();
  rotor_rates_.Restart();
}

void FactorBuilder::Reset() {
  pending_.clear();
  bias_since_.reset();
  rotor_rates_.Restart();
  rotor_scale_sigma_ = 0.0;
}

void FactorBuilder::AddKeyframe(const OdometrySample& sample,
                                const std::optional<KeyframeInterval>& interval,
                                const FrontEnd& front_end, const ModelNoise& model_noise,
                                long keyframes, LearningSchedule* schedule) {
  const std::int64_t bias = CurrentBias(sample.stamp, front_end.has_imu());
  const State initial = front_end.InitialState(sample, interval ? &*interval : nullptr, *window_);
  const std::int64_t id = window_->AddKeyframe(sample.stamp, initial, interval.has_value(), bias);
  for (Factor& factor : pending_) window_->AddFactor(std::move(factor));
  pending_.clear();
  if (!interval) {
    schedule->BreakChain();
    rotor_rates_.Restart();
  }

  const bool with_gyro = interval && interval->imu && interval->imu->has_gyro;
  Factor odometry =
      window_->MakeFactor<OdometryFactor>(sample, front_end.noise().odometry(), !with_gyro);
  odometry.state0 = id;
  window_->AddFactor(std::move(odometry));
  if (!interval) return;
  SeeRotorScale(interval->rotors, keyframes);
  AddIntervalFactors(*interval, id, front_end.start(), model_noise, RotorSpeedNoise(front_end),
                     schedule);
  SmoothRotorRates(*interval, id, front_end);
}

std::int64_t FactorBuilder::CurrentBias(Stamp stamp, bool has_imu) {
  if (!has_imu) return -1;
  const bool is_first = window_->biases().empty();
  const bool due = !bias_since_ || ToSeconds(stamp - *bias_since_) >= options_->bias_interval_s;
  if (!due && !is_first) return window_->biases().back().id;
  bias_since_ = stamp;
  return AddBias(is_first);
}

std::int64_t FactorBuilder::AddBias(bool is_first) {
  Vector6d initial = Vector6d::Zero();
  if (!is_first) initial = Eigen::Map<const Vector6d>(window_->biases().back().x.data());
  const std::int64_t id = window_->AddBias(initial);
  if (is_first) {
    const Vector6d sigma =
        Stacked(options_->gyro_bias_sigma_rad_s, options_->accelerometer_bias_sigma_m_s2);
    Factor factor;
    factor.kind = FactorKindOf<BlockPriorFactor>::value;
    factor.cost = std::make_unique<BlockPriorFactor>(initial, sigma);
    factor.bias0 = id;
    pending_.push_back(std::move(factor));
  } else {
    const double root_s = std::sqrt(options_->bias_interval_s);
    const Vector6d sigma =
        Stacked(options_->gyro_bias_walk * root_s, options_->accelerometer_bias_walk * root_s);
    Factor factor = window_->MakeFactor<BiasWalkFactor>(sigma);
    factor.bias0 = id - 1;
    factor.bias1 = id;
    // Belongs to the last keyframe with the old bias, which leaves together with it.
    window_->AddFactor(std::move(factor));
  }
  return id;
}

double FactorBuilder::RotorSpeedNoise(const FrontEnd& front_end) const {
  return options_->rotor_speed_noise_rad_s > 0.0 ? options_->rotor_speed_noise_rad_s
                                                 : front_end.noise().rotor_speed();
}

DynamicsNoise FactorBuilder::NoiseOf(const KeyframeInterval& interval,
                                     const ProcessNoiseEstimator& process,
                                     double sigma_speed) const {
  const Vehicle& vehicle = model_->vehicle();
  const ModelValues values = window_->values();
  DynamicsNoise noise;
  noise.force_N = process.ForceSigma(interval.dt);
  noise.torque_Nm = process.TorqueSigma(interval.dt);
  noise.nominal_inertia = model_->Properties(values).I_BBcm_B.diagonal();
  // d(k_f Ω²) = 2 k_f Ω dΩ, averaged over the samples of the interval.       model.md section 5
  const int k_f = model_->IndexOf("thrust.k_f"), k_m = model_->IndexOf("rotor_torque.k_m");
  const double per_sample =
      sigma_speed / std::sqrt(static_cast<double>(interval.rotors.num_samples));
  double force_variance = 0.0;
  Vector3d torque_variance = Vector3d::Zero();
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    // A model's error lasts longer than an interval: more samples do not make it smaller.
    const double sigma = std::hypot(per_sample, interval.rotors.model_sigma[j]);
    const double slope = 2.0 * interval.rotors.mean.speed[j] * sigma;
    const double force = k_f >= 0 ? values[k_f] * slope : 0.0;
    const double couple = k_m >= 0 ? values[k_m] * slope : 0.0;
    force_variance += force * force;
    const Vector3d& p_BP = vehicle.rotors[j].p_BP;
    torque_variance +=
        Vector3d(p_BP.y() * force, p_BP.x() * force, couple).array().square().matrix();
  }
  noise.rotor_force_N = std::sqrt(force_variance);
  noise.rotor_torque_Nm = torque_variance.cwiseSqrt();
  noise.rotor_rate_rad_s2 = std::sqrt(2.0) * sigma_speed / interval.dt;  // of both ends
  return noise;
}

DynamicsMeasurement FactorBuilder::MeasurementOf(const KeyframeInterval& interval, std::int64_t id,
                                                 Stamp start) const {
  DynamicsMeasurement measurement;
  measurement.dt = interval.dt;
  measurement.load = interval.load;
  measurement.time_s = ToSeconds(window_->keyframe(id).stamp - start) - 0.5 * interval.dt;
  measurement.rotors = form_ == DynamicsForm::kEuler ? interval.rotors.start : interval.rotors.mean;
  measurement.form = form_;
  measurement.fixed_inertia = PriorInertia(*model_);
  if (window_->anchor_entry() >= 0) measurement.anchor_index = model_->IndexOf("thrust.k_f");
  return measurement;
}

void FactorBuilder::AddToInterval(Factor factor, std::int64_t id, bool bias, bool parameters) {
  factor.state0 = id - 1;
  factor.state1 = id;
  factor.bias0 = bias ? window_->keyframe(id - 1).bias : -1;
  factor.parameters = parameters;
  const bool is_dynamics = factor.As<DynamicsFactor>() != nullptr;
  if (is_dynamics || factor.As<AccelerometerFactor>() != nullptr) factor.loss = loss_.get();
  factor.anchored = is_dynamics && window_->anchor_entry() >= 0;
  window_->AddFactor(std::move(factor));
}

/// Torque of the model per thrust coefficient [rad² m/s²], about z per torque coefficient
/// [rad²/s²]: what the coefficients are at the moment is not in it. Of the rotors alone where the
/// model has none.
Vector3d FactorBuilder::TorqueSeen(const KeyframeInterval& interval, const IntervalModel& k) const {
  const Vector3d& w = k.flight.w_WB_B;
  const Vector3d torque = k.tau_B - w.cross(k.body.I_BBcm_B * w);
  Vector3d seen = RotorTorqueDirection(model_->vehicle(), interval.rotors.mean.speed_squared);
  const auto value = [&](const char* name) {
    const int index = model_->IndexOf(name);
    return index >= 0 ? window_->values()[index] : 0.0;
  };
  const double k_f = value("thrust.k_f"), k_m = value("rotor_torque.k_m");
  if (k_f > 0.0) seen.head<2>() = torque.head<2>() / k_f;
  if (k_m > 0.0) seen.z() = torque.z() / k_m;
  return seen;
}

void FactorBuilder::AddIntervalFactors(const KeyframeInterval& interval, std::int64_t id,
                                       Stamp start, const ModelNoise& model_noise,
                                       double rotor_speed_noise, LearningSchedule* schedule) {
  const bool with_gyro = interval.imu && interval.imu->has_gyro;
  const bool has_bias = window_->keyframe(id - 1).bias >= 0;
  AddToInterval(window_->MakeFactor<KinematicFactor>(
                    interval.dt, form_, options_->kinematic_position_m,
                    options_->kinematic_rotation_rad, !(with_gyro && has_bias)),
                id, false, false);

  DynamicsMeasurement measurement = MeasurementOf(interval, id, start);
  if (with_torque_) {
    const State s0 = State::FromBlock(window_->keyframe(id - 1).x.data());
    const State s1 = State::FromBlock(window_->keyframe(id).x.data());
    const IntervalModel k(measurement, s0, s1, *model_, window_->values(), false, false);
    schedule->gate().Add(interval.dt, k.m0.w_WB_B, k.m1.w_WB_B, TorqueSeen(interval, k),
                         interval.rotors.mean.speed_squared.sum());
    for (int i = 0; i < 3; ++i) measurement.inertia_fixed[i] = !schedule->InertiaIsFree(i);
  }
  const DynamicsNoise noise = NoiseOf(interval, model_noise.estimator(), rotor_speed_noise);
  AddToInterval(
      window_->MakeFactor<DynamicsFactor>(measurement, noise, with_torque_, model_, layout_), id,
      false, true);
  if (interval.imu && has_bias) {
    AddImuFactors(*interval.imu, measurement, noise.force_N, model_noise, id);
  }
}

void FactorBuilder::AddImuFactors(const ImuInterval& imu, const DynamicsMeasurement& measurement,
                                  const Vector3d& force_sigma_N, const ModelNoise& model_noise,
                                  std::int64_t id) {
  ImuNoise noise;
  noise.gyro_rad_s = options_->gyro_noise_rad_s;
  noise.specific_force_m_s2 = options_->accelerometer_noise_m_s2;
  noise.preintegration_rad = std::hypot(
      options_->gyro_noise_rad_s * measurement.dt / std::sqrt(static_cast<double>(imu.num_samples)),
      0.2 * options_->kinematic_rotation_rad);
  if (imu.has_gyro) {
    AddToInterval(window_->MakeFactor<GyroPreintegrationFactor>(imu, noise, model_, layout_), id,
                  true, true);
    Factor gyro = window_->MakeFactor<GyroFactor>(imu.gyro_at_end, noise, model_, layout_);
    gyro.state0 = id;
    gyro.bias0 = window_->keyframe(id).bias;
    gyro.parameters = true;
    window_->AddFactor(std::move(gyro));
  }
  if (imu.has_accelerometer) {
    AddToInterval(window_->MakeFactor<AccelerometerFactor>(
                      measurement, imu.mean_specific_force,
                      model_noise.AccelerometerSigma(force_sigma_N), model_, layout_),
                  id, true, true);
  }
}

/// Averages the rotors' accelerations of the newest intervals, as far as those after them go.
void FactorBuilder::SmoothRotorRates(const KeyframeInterval& interval, std::int64_t id,
                                     const FrontEnd& front_end) {
  if (!model_->takes_rotor_rates()) return;
  const double end_s = ToSeconds(window_->keyframe(id).stamp - front_end.start());
  rotor_rates_.Add(id, end_s - 0.5 * interval.dt, interval.dt, interval.rotors.mean,
                   interval.rotors.num_samples);
  rotor_rates_.ForChanged([&](std::int64_t changed, const RotorRateSmoother::Rates& rates) {
    if (changed - 1 < window_->keyframes().front().id) return;  // has left the window
    Keyframe& from = window_->keyframe(changed - 1);
    from.ForEach<DynamicsFactor>([&](Factor* factor, DynamicsFactor* dynamics) {
      dynamics->SetRotorRates(rates.acceleration, rates.speed_squared_rate,
                              rates.noise * RotorSpeedNoise(front_end));
      window_->Touch(factor);
    });
    from.ForEach<AccelerometerFactor>([&](Factor* factor, AccelerometerFactor* accelerometer) {
      accelerometer->SetRotorRates(rates.acceleration, rates.speed_squared_rate);
      window_->Touch(factor);
    });
  });
}

// A model's error is mostly one of scale, the same all flight long and for all modelled rotors.
void FactorBuilder::SeeRotorScale(const RotorInterval& rotors, long keyframes) {
  const double speed = rotors.mean.speed.sum();
  if (!(speed > 0.0)) return;
  const double share = std::min(rotors.model_sigma.sum() / speed, 1.0);
  rotor_scale_sigma_ += (share - rotor_scale_sigma_) / static_cast<double>(std::max(keyframes, 1L));
}

}  // namespace odmc
