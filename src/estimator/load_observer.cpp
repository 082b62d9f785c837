#include "odmc/estimator/load_observer.h"

#include <algorithm>

namespace odmc {
namespace {

// Differences of measured velocities are noisy. The swing integrates them and does not care; the
// tension takes the vehicle's acceleration as it is and gets it smoothed.
constexpr double kSmoothing_s = 0.05;
constexpr double kNearby = 1e-4;  // of the swing

}  // namespace

LoadObserver::LoadObserver(const DynamicModel& model, bool with_derivatives)
    : model_(&model),
      parameters_(model.pendulum()),
      gravity_(model.vehicle().gravity_m_s2),
      with_derivatives_(with_derivatives) {}

LoadPull LoadObserver::Advance(const SensorMotion& from, const SensorMotion& to, double dt,
                               const ModelValues& values, const BodyProperties* body) {
  LoadPull pull;
  pull.pull_W = Eigen::Vector3d(0.0, 0.0, -gravity_);
  if (!parameters_ || !(dt > 0.0)) return pull;
  if (dt > kForgotten_s) {
    Reset();
    return pull;
  }
  if (!pendulum_) Start(values);
  std::optional<BodyProperties> own;
  if (body == nullptr) body = &own.emplace(model_->Properties(values));
  const Eigen::Vector3d p_BP = values.segment<3>(parameters_->place);
  const Eigen::Vector3d p_SP_S = body->R_BS.transpose() * (p_BP - body->p_BS);
  const auto velocity_W = [&](const SensorMotion& sensor) {
    return Eigen::Vector3d(sensor.v_WS + sensor.R_WS * sensor.w_S.cross(p_SP_S));
  };
  const Eigen::Vector3d acceleration_W = (velocity_W(to) - velocity_W(from)) / dt;
  smooth_acceleration_W_ +=
      std::min(1.0, dt / kSmoothing_s) * (acceleration_W - smooth_acceleration_W_);
  AdvanceAll(acceleration_W, 0.5 * dt);
  pull.pull_W = pendulum_->Pull(smooth_acceleration_W_);
  pull.swing = start_;
  for (size_t i = 0; i < nearby_.size(); i += 2) {
    pull.d_swing.col(static_cast<int>(i) / 2) =
        (nearby_[i].Pull(smooth_acceleration_W_) - nearby_[i + 1].Pull(smooth_acceleration_W_)) /
        (2.0 * kNearby);
  }
  AdvanceAll(acceleration_W, 0.5 * dt);
  return pull;
}

void LoadObserver::Reset() {
  is_first_recording_ = false;
  pendulum_.reset();
  nearby_.clear();
}

void LoadObserver::Start(const ModelValues& values) {
  smooth_acceleration_W_.setZero();
  start_ =
      is_first_recording_ ? Swing(values.segment<4>(parameters_->swing)) : Swing(Swing::Zero());
  const auto with = [&](const Swing& swing) {
    return Pendulum(values[parameters_->length], values[parameters_->damping], gravity_, swing);
  };
  pendulum_ = with(start_);
  if (!with_derivatives_ || !is_first_recording_) return;
  for (int i = 0; i < 4; ++i) {
    nearby_.push_back(with(start_ + kNearby * Swing::Unit(i)));
    nearby_.push_back(with(start_ - kNearby * Swing::Unit(i)));
  }
}

void LoadObserver::AdvanceAll(const Eigen::Vector3d& acceleration_W, double dt) {
  pendulum_->Advance(acceleration_W, dt);
  for (Pendulum& pendulum : nearby_) pendulum.Advance(acceleration_W, dt);
}

}  // namespace odmc
