#include "odmc/attribution/residual.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

namespace odmc {
namespace {

constexpr double kStart_s = 1.0;
constexpr int kBlocksOfAStretch = 2;         // held out, of a long flight
constexpr double kGyroMountSigma_rad = 0.1;  // of what the vehicle file says of it

/// The rotation nearest to a matrix.
Eigen::Matrix3d RotationNearest(const Eigen::Matrix3d& M) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d d = Eigen::Vector3d::Ones();
  d.z() = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0;
  return svd.matrixU() * d.asDiagonal() * svd.matrixV().transpose();
}

/// Mean of samples [first, first + count); what not all of them have is left out.
FilteredMotion MeanOf(const std::vector<FilteredMotion>& samples, size_t first, size_t count) {
  FilteredMotion mean = samples[first];
  for (size_t i = first + 1; i < first + count; ++i) {
    const FilteredMotion& s = samples[i];
    mean.t_s += s.t_s;
    mean.R_WS += s.R_WS;
    mean.p_WS += s.p_WS;
    mean.v_WS += s.v_WS;
    mean.a_WS += s.a_WS;
    mean.w_S += s.w_S;
    mean.w_dot_S += s.w_dot_S;
    mean.rotors.speed_squared += s.rotors.speed_squared;
    mean.rotors.speed += s.rotors.speed;
    mean.rotors.acceleration += s.rotors.acceleration;
    mean.rotors.speed_squared_rate += s.rotors.speed_squared_rate;
    if (s.specific_force_I && mean.specific_force_I) {
      *mean.specific_force_I += *s.specific_force_I;
    } else {
      mean.specific_force_I.reset();
    }
    if (s.gyro && mean.gyro) {
      mean.gyro->w_I += s.gyro->w_I;
      mean.gyro->w_dot_I += s.gyro->w_dot_I;
    } else {
      mean.gyro.reset();
    }
  }
  if (count == 1) return mean;
  const double share = 1.0 / static_cast<double>(count);
  mean.t_s *= share;
  mean.R_WS = RotationNearest(mean.R_WS);
  for (Eigen::Vector3d* v : {&mean.p_WS, &mean.v_WS, &mean.a_WS, &mean.w_S, &mean.w_dot_S}) {
    *v *= share;
  }
  for (RotorVector* v : {&mean.rotors.speed_squared, &mean.rotors.speed, &mean.rotors.acceleration,
                         &mean.rotors.speed_squared_rate}) {
    *v *= share;
  }
  if (mean.specific_force_I) *mean.specific_force_I *= share;
  if (mean.gyro) mean.gyro = {share * mean.gyro->w_I, share * mean.gyro->w_dot_I};
  return mean;
}

}  // namespace

ThinnedFlight::ThinnedFlight(FlightMotion flight, const BlockSplit& blocks,
                             const Eigen::Matrix3d& R_BS, double most_s, Thinning thinning)
    : flight_(std::move(flight)), blocks_(blocks), R_BS_(R_BS) {
  const size_t stride =
      flight_.step_s > 0.0
          ? static_cast<size_t>(std::max(1L, std::lround(kStep_s / flight_.step_s)))
          : 1;
  step_s_ = static_cast<double>(stride) * flight_.step_s;
  const std::vector<FilteredMotion>& all = flight_.samples;
  const double in_use_s =
      blocks_.share_in_use() * (static_cast<double>(all.size()) * flight_.step_s - kStart_s);
  takes_means_ = thinning == Thinning::kMean && in_use_s >= kLeastForMeans_s && stride > 1;
  const size_t meant = takes_means_ ? stride : 1;
  size_t run = 0;  // samples without a gap, with this one
  for (size_t i = 0; i < all.size(); ++i) {
    // The start's transients are quicker than the filter.
    if (all[i].t_s < all.front().t_s + kStart_s) continue;
    run = all[i].follows ? run + 1 : 1;
    if (run < meant || (run - meant) % stride != 0) continue;
    const size_t first = i + 1 - meant;
    samples_.push_back(MeanOf(all, first, meant));
    index_.push_back(first + meant / 2);
    next_.push_back(run > meant);
  }
  if (most_s > 0.0 && size() * step_s_ > most_s) TakeStretches(most_s);
}

void ThinnedFlight::TakeStretches(double most_s) {
  // Blocks in use and held out are taken alike.
  const double stretch_s =
      kBlocksOfAStretch * std::max(1, blocks_.hold_out_every) * blocks_.block_s;
  const double period_s = stretch_s * size() * step_s_ / most_s;
  std::vector<FilteredMotion> samples;
  std::vector<size_t> index;
  std::vector<bool> next;
  bool cut = false;
  for (int i = 0; i < size(); ++i) {
    if (std::fmod(sample(i).t_s, period_s) >= stretch_s) {
      cut = true;
      continue;
    }
    samples.push_back(sample(i));
    index.push_back(index_[static_cast<size_t>(i)]);
    next.push_back(next_[static_cast<size_t>(i)] && !cut);
    cut = false;
  }
  samples_ = std::move(samples);
  index_ = std::move(index);
  next_ = std::move(next);
}

ThinnedFlight ThinnedFlight::Moving(std::vector<FilteredMotion> samples) const {
  ThinnedFlight other = *this;
  other.flight_.samples = samples;
  other.samples_ = std::move(samples);
  std::iota(other.index_.begin(), other.index_.end(), size_t{0});
  return other;
}

ThinnedFlight ThinnedFlight::WithRotors(const std::vector<RotorState>& rotors) const {
  ThinnedFlight other = *this;
  for (size_t i = 0; i < rotors.size(); ++i) other.samples_[i].rotors = rotors[i];
  return other;
}

std::vector<std::vector<double>> ThinnedFlight::Runs(const Eigen::VectorXd& channel,
                                                     bool in_use_only) const {
  std::vector<std::vector<double>> runs;
  bool cut = false;
  for (int i = 0; i < size(); ++i) {
    if (in_use_only && held_out(i)) {
      cut = true;
      continue;
    }
    if (!next_[i] || cut || runs.empty()) runs.emplace_back();
    cut = false;
    runs.back().push_back(channel[i]);
  }
  return runs;
}

bool IsAnchoredByForce(const std::string& full_name) {
  return full_name == "thrust.k_f" || full_name == "thrust_drift.rate";
}

ResidualModel::ResidualModel(const ThinnedFlight* flight, const Vehicle* file_vehicle,
                             bool with_torque)
    : flight_(flight), file_vehicle_(file_vehicle), with_torque_(with_torque) {
  from_accelerometer_ = flight->size() > 0;
  from_gyro_ = with_torque && flight->size() > 0;
  for (int i = 0; i < flight->size(); ++i) {
    from_accelerometer_ = from_accelerometer_ && flight->sample(i).specific_force_I.has_value();
    from_gyro_ = from_gyro_ && flight->sample(i).gyro.has_value();
  }
}

std::vector<PredictionSample> ResidualModel::Predict(const DynamicModel& model,
                                                     const ModelValues& values) const {
  std::vector<PredictionSample> samples;
  samples.reserve(static_cast<size_t>(flight_->size()));
  std::vector<Eigen::Vector3d> pulls;
  if (model.pendulum()) pulls = LoadPulls(flight_->motion(), model, values);
  const Eigen::Vector3d hanging(0.0, 0.0, -file_vehicle_->gravity_m_s2);
  const BodyProperties body = model.Properties(values);
  for (int i = 0; i < flight_->size(); ++i) {
    const Eigen::Vector3d& pull = pulls.empty() ? hanging : pulls[flight_->index(i)];
    samples.push_back(PredictSample(flight_->sample(i), pull, *file_vehicle_, model, values, false,
                                    model.varies() ? nullptr : &body));
  }
  return samples;
}

Eigen::MatrixX3d ResidualModel::FeltForce(const std::vector<PredictionSample>& samples) const {
  const Eigen::Matrix3d R_BI = file_vehicle_->imu ? file_vehicle_->imu->q_BS.toRotationMatrix()
                                                  : Eigen::Matrix3d::Identity();
  Eigen::MatrixX3d force(flight_->size(), 3);
  for (int i = 0; i < flight_->size(); ++i) {
    force.row(i) = file_vehicle_->mass_kg * R_BI *
                   (*flight_->sample(i).specific_force_I -
                    samples[static_cast<size_t>(i)].predicted_specific_force);
  }
  return force;
}

Eigen::MatrixX3d ResidualModel::MotionForce(const std::vector<PredictionSample>& samples) {
  Eigen::MatrixX3d force(static_cast<Eigen::Index>(samples.size()), 3);
  for (size_t i = 0; i < samples.size(); ++i) {
    force.row(static_cast<Eigen::Index>(i)) =
        samples[i].measured_force - samples[i].predicted_force;
  }
  return force;
}

Eigen::MatrixX3d ResidualModel::MotionTorque(const std::vector<PredictionSample>& samples) const {
  Eigen::MatrixX3d torque(static_cast<Eigen::Index>(samples.size()), 3);
  for (size_t i = 0; i < samples.size(); ++i) {
    const PredictionSample& s = samples[i];
    torque.row(static_cast<Eigen::Index>(i)) = file_vehicle_->inertia_kg_m2.cwiseProduct(
        s.measured_angular_acceleration - s.predicted_angular_acceleration);
  }
  return torque;
}

Eigen::MatrixX3d ResidualModel::GyroTorque(const std::vector<PredictionSample>& samples) const {
  const Eigen::Matrix3d R_BI = file_vehicle_->odometry.q_BS.toRotationMatrix() * R_SI_;
  Eigen::MatrixX3d torque(flight_->size(), 3);
  for (int i = 0; i < flight_->size(); ++i) {
    torque.row(i) = file_vehicle_->inertia_kg_m2.cwiseProduct(
        R_BI * flight_->sample(i).gyro->w_dot_I -
        samples[static_cast<size_t>(i)].predicted_angular_acceleration);
  }
  return torque;
}

// The rotation of greatest posterior density (Wahba's problem; Markley and Crassidis, Fundamentals
// of Spacecraft Attitude Determination and Control, 2014, ch. 5), the vehicle file's as prior: a
// flight that turns about one axis alone does not tell the rest.
Eigen::Matrix3d ResidualModel::GyroInOdometry() const {
  const Eigen::Matrix3d R_SB = file_vehicle_->odometry.q_BS.toRotationMatrix().transpose();
  const Eigen::Matrix3d R_prior =
      file_vehicle_->imu ? Eigen::Matrix3d(R_SB * file_vehicle_->imu->q_BS.toRotationMatrix())
                         : R_SB;
  const int n = flight_->size();
  Eigen::Vector3d mean_S = Eigen::Vector3d::Zero(), mean_I = Eigen::Vector3d::Zero();
  for (int i = 0; i < n; ++i) {
    mean_S += flight_->sample(i).w_S / n;
    mean_I += flight_->sample(i).gyro->w_I / n;
  }
  Eigen::Matrix3d R = R_prior;
  for (int round = 0; round < 2; ++round) {
    Eigen::Matrix3d products = Eigen::Matrix3d::Zero();
    double square = 0.0;
    for (int i = 0; i < n; ++i) {
      const Eigen::Vector3d w_S = flight_->sample(i).w_S - mean_S;
      const Eigen::Vector3d w_I = flight_->sample(i).gyro->w_I - mean_I;
      products += w_S * w_I.transpose();
      square += (w_S - R * w_I).squaredNorm();
    }
    const double variance = square / (3.0 * n);
    R = RotationNearest(products +
                        variance / (kGyroMountSigma_rad * kGyroMountSigma_rad) * R_prior);
  }
  return R;
}

ForceBlend ResidualModel::BlendOf(const Eigen::VectorXd& felt,
                                  const Eigen::VectorXd& by_motion) const {
  std::vector<bool> follows, counts;
  for (int i = 0; i < flight_->size(); ++i) {
    follows.push_back(flight_->next(i));
    counts.push_back(!flight_->held_out(i));
  }
  return {follows, counts, felt, by_motion};
}

void ResidualModel::BlendForces(const std::vector<PredictionSample>& samples) {
  const Eigen::MatrixX3d felt = FeltForce(samples), by_motion = MotionForce(samples);
  across_by_motion_ = IsMotionBetter(felt, by_motion);
  blend_[kAlongRotors] = BlendOf(felt.col(kAlongRotors), by_motion.col(kAlongRotors));
}

void ResidualModel::BlendTorques(const std::vector<PredictionSample>& samples) {
  R_SI_ = GyroInOdometry();
  const Eigen::MatrixX3d by_gyro = GyroTorque(samples), by_motion = MotionTorque(samples);
  for (size_t axis = 0; axis < 3; ++axis) {
    const auto c = static_cast<Eigen::Index>(axis);
    blend_[3 + axis] = BlendOf(by_gyro.col(c), by_motion.col(c));
  }
}

void ResidualModel::BlendSensors(const DynamicModel& model, const ModelValues& values) {
  if (!from_accelerometer_ && !from_gyro_) return;
  const std::vector<PredictionSample> samples = Predict(model, values);
  if (from_accelerometer_) BlendForces(samples);
  if (from_gyro_) BlendTorques(samples);
}

// Of two measurements of one force the one with less variance has less noise, unless an onboard
// filter smooths part of the force away. What the accelerometer feels is then more than the motion
// shows of it: the regression of the one on the other is steeper than one. With more than half of
// the accelerometer's variance the motion is not worth its errors of attitude, which are slow.
bool ResidualModel::IsMotionBetter(const Eigen::MatrixX3d& felt,
                                   const Eigen::MatrixX3d& by_motion) const {
  constexpr int kLeastBlocks = 6;
  constexpr double kSigmas = 3.0, kLess = 0.5;
  double felt_square = 0.0, square = 0.0, product = 0.0, count = 0.0;
  std::map<int, Eigen::Vector2d> blocks;  // product, square
  for (const Eigen::Index c : {0, 1}) {
    const Eigen::VectorXd f = felt.col(c).array() - felt.col(c).mean();
    const Eigen::VectorXd m = by_motion.col(c).array() - by_motion.col(c).mean();
    for (int i = 0; i < flight_->size(); ++i) {
      if (flight_->held_out(i)) continue;
      felt_square += f[i] * f[i];
      square += m[i] * m[i];
      product += f[i] * m[i];
      count += 1.0;
      const auto block = blocks.try_emplace(flight_->block(i), Eigen::Vector2d::Zero()).first;
      block->second += Eigen::Vector2d(f[i] * m[i], m[i] * m[i]);
    }
  }
  const auto n = static_cast<double>(blocks.size());
  if (n < kLeastBlocks || !(square > 0.0) || square > kLess * felt_square) return false;
  const double slope = product / square;
  double scatter = 0.0;
  for (const auto& entry : blocks) {
    scatter += std::pow(entry.second[0] - slope * entry.second[1], 2);
  }
  // Few blocks may agree by chance: noise of equal size at all samples is the least there is.
  const double by_blocks = std::sqrt(scatter * n / (n - 1.0)) / square;
  const double sigma = std::max(by_blocks, std::sqrt(felt_square / (square * count)));
  return slope - kSigmas * sigma <= 1.0;
}

ResidualModel::Wrenches ResidualModel::Residual(const DynamicModel& model,
                                                const ModelValues& values) const {
  Wrenches residual(flight_->size(), kNumChannels);
  const std::vector<PredictionSample> samples = Predict(model, values);
  residual.leftCols<3>() = from_accelerometer_ ? FeltForce(samples) : MotionForce(samples);
  if (across_by_motion_) residual.leftCols<2>() = MotionForce(samples).leftCols<2>();
  if (is_blend(kAlongRotors)) {
    residual.col(kAlongRotors) = blend_[kAlongRotors]->Blend(
        residual.col(kAlongRotors), MotionForce(samples).col(kAlongRotors));
  }
  if (!with_torque_) {
    residual.rightCols<3>().setZero();
    return residual;
  }
  residual.rightCols<3>() = MotionTorque(samples);
  if (!is_blend(3)) return residual;
  const Eigen::MatrixX3d by_gyro = GyroTorque(samples);
  for (Eigen::Index c = 3; c < kNumChannels; ++c) {
    residual.col(c) = blend_[static_cast<size_t>(c)]->Blend(by_gyro.col(c - 3), residual.col(c));
  }
  return residual;
}

ResidualModel::Wrenches ResidualModel::AsFelt(Wrenches residual, const DynamicModel& model,
                                              const ModelValues& values) const {
  if (!is_blend(kAlongRotors)) return residual;
  const std::vector<PredictionSample> samples = Predict(model, values);
  const Eigen::VectorXd felt = FeltForce(samples).col(kAlongRotors);
  const Eigen::VectorXd by_motion = MotionForce(samples).col(kAlongRotors);
  const Eigen::VectorXd apart = felt - blend_[kAlongRotors]->Blend(felt, by_motion);
  residual.col(kAlongRotors).array() += apart.array() - apart.mean();
  return residual;
}

Eigen::MatrixX3d ResidualModel::ForceByMotion(const DynamicModel& model,
                                              const ModelValues& values) const {
  if (!from_accelerometer_) return Eigen::MatrixX3d(0, 3);
  Eigen::MatrixX3d force = MotionForce(Predict(model, values));
  if (across_by_motion_) force.leftCols<2>().setZero();
  return force;
}

Eigen::MatrixX2d ResidualModel::AcrossByOther(const DynamicModel& model,
                                              const ModelValues& values) const {
  if (!from_accelerometer_) return Eigen::MatrixX2d(0, 2);
  const std::vector<PredictionSample> samples = Predict(model, values);
  return (across_by_motion_ ? FeltForce(samples) : MotionForce(samples)).leftCols<2>();
}

ResidualModel::Wrenches ResidualModel::ResidualAt(const DynamicModel& model, ModelValues values,
                                                  int index, double step) const {
  values[index] += step;
  return Residual(model, values);
}

ResidualModel::Wrenches ResidualModel::Derivative(const DynamicModel& model,
                                                  const ModelValues& values, int index) const {
  const double step = DifferenceStep(model.parameters()[index], values[index]);
  Wrenches derivative =
      (ResidualAt(model, values, index, -step) - ResidualAt(model, values, index, step)) /
      (2.0 * step);
  if (IsAnchoredByForce(model.parameters()[index].full_name)) derivative.rightCols<3>().setZero();
  return derivative;
}

ResidualModel::Wrenches ResidualModel::Derivative(const DynamicModel& model,
                                                  const ModelValues& values, int index,
                                                  const Wrenches& residual) const {
  const double step = DifferenceStep(model.parameters()[index], values[index]);
  Wrenches derivative = (residual - ResidualAt(model, values, index, step)) / step;
  if (IsAnchoredByForce(model.parameters()[index].full_name)) derivative.rightCols<3>().setZero();
  return derivative;
}

}  // namespace odmc
