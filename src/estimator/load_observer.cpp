#include "odmc/estimator/load_observer.h"

#include <algorithm>

namespace odmc {
namespace {

// Differences of measured rates are noisy. The swing integrates them and does not care; what the
// cable's point accelerates by against the centre of mass is smoothed.
constexpr double kSmoothing_s = 0.05;
constexpr double kNearby = 1e-4;       // of the swing
constexpr double kForgotten_s = 20.0;  // a gap this long leaves nothing of the swing before it

}  // namespace

LoadObserver::LoadObserver(const DynamicModel& model, bool with_derivatives)
    : model_(&model),
      parameters_(model.pendulum()),
      gravity_(model.vehicle().gravity_m_s2),
      with_derivatives_(with_derivatives) {}

LoadPull LoadObserver::Advance(const SensorMotion& from, const SensorMotion& to, double dt,
                               const ModelValues& values) {
  LoadPull pull;
  if (!parameters_ || !(dt > 0.0)) return pull;
  if (dt > kForgotten_s) {
    Reset();
    return pull;
  }
  if (!pendulum_) Start(values);
  const BodyProperties body = model_->Properties(values);
  const Eigen::Vector3d p_BP = values.segment<3>(parameters_->place);
  const Eigen::Vector3d p_SP_S = body.R_BS.transpose() * (p_BP - body.p_BS);
  const Eigen::Vector3d p_CP_S = body.R_BS.transpose() * (p_BP - body.p_BBcm);
  // Of a point of the body, as far as it turns about another one.
  const auto turning_W = [](const SensorMotion& sensor, const Eigen::Vector3d& p_S) {
    return Eigen::Vector3d(sensor.R_WS * sensor.w_S.cross(p_S));
  };
  const Eigen::Vector3d acceleration_W =
      (to.v_WS + turning_W(to, p_SP_S) - from.v_WS - turning_W(from, p_SP_S)) / dt;
  const Eigen::Vector3d of_turning_W = (turning_W(to, p_CP_S) - turning_W(from, p_CP_S)) / dt;
  smooth_of_turning_W_ += std::min(1.0, dt / kSmoothing_s) * (of_turning_W - smooth_of_turning_W_);
  AdvanceAll(acceleration_W, 0.5 * dt);
  const Eigen::Vector4d hangs = HangsBy(*pendulum_);
  pull.cable_W = hangs.head<3>();
  pull.own_m_s2 = hangs[3];
  pull.swing = start_;
  for (size_t i = 0; i < nearby_.size(); i += 2) {
    pull.d_swing.col(static_cast<int>(i) / 2) =
        (HangsBy(nearby_[i]) - HangsBy(nearby_[i + 1])) / (2.0 * kNearby);
  }
  AdvanceAll(acceleration_W, 0.5 * dt);
  return pull;
}

void LoadObserver::Reset() {
  is_first_recording_ = false;
  pendulum_.reset();
  nearby_.clear();
}

Eigen::Vector4d LoadObserver::HangsBy(const Pendulum& pendulum) const {
  Eigen::Vector4d hangs;
  hangs << pendulum.direction_W(), pendulum.Tension(smooth_of_turning_W_);
  return hangs;
}

void LoadObserver::Start(const ModelValues& values) {
  smooth_of_turning_W_.setZero();
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
