#include "odmc/attribution/residual.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

namespace odmc {
namespace {

constexpr double kStart_s = 1.0;
constexpr int kBlocksOfAStretch = 2;  // held out, of a long flight

}  // namespace

ThinnedFlight::ThinnedFlight(FlightMotion flight, const BlockSplit& blocks,
                             const Eigen::Matrix3d& R_BS, double most_s)
    : flight_(std::move(flight)), blocks_(blocks), R_BS_(R_BS) {
  const int stride = flight_.step_s > 0.0
                         ? std::max(1, static_cast<int>(std::lround(kStep_s / flight_.step_s)))
                         : 1;
  step_s_ = stride * flight_.step_s;
  int run = 0;
  for (size_t i = 0; i < flight_.samples.size(); ++i) {
    // The start's transients are quicker than the filter.
    if (flight_.samples[i].t_s < flight_.samples.front().t_s + kStart_s) continue;
    run = flight_.samples[i].follows && !index_.empty() ? run + 1 : 0;
    if (run % stride != 0) continue;
    index_.push_back(i);
    next_.push_back(run > 0);
  }
  if (most_s > 0.0 && size() * step_s_ > most_s) TakeStretches(most_s);
}

void ThinnedFlight::TakeStretches(double most_s) {
  // Blocks in use and held out are taken alike.
  const double stretch_s =
      kBlocksOfAStretch * std::max(1, blocks_.hold_out_every) * blocks_.block_s;
  const double period_s = stretch_s * size() * step_s_ / most_s;
  std::vector<size_t> index;
  std::vector<bool> next;
  bool cut = false;
  for (int i = 0; i < size(); ++i) {
    if (std::fmod(sample(i).t_s, period_s) >= stretch_s) {
      cut = true;
      continue;
    }
    index.push_back(index_[static_cast<size_t>(i)]);
    next.push_back(next_[static_cast<size_t>(i)] && !cut);
    cut = false;
  }
  index_ = std::move(index);
  next_ = std::move(next);
}

ThinnedFlight ThinnedFlight::Moving(std::vector<FilteredMotion> samples) const {
  ThinnedFlight other = *this;
  other.flight_.samples = std::move(samples);
  std::iota(other.index_.begin(), other.index_.end(), size_t{0});
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
  for (int i = 0; i < flight->size(); ++i) {
    from_accelerometer_ = from_accelerometer_ && flight->sample(i).specific_force_I.has_value();
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

void ResidualModel::BlendForces(const DynamicModel& model, const ModelValues& values) {
  if (!from_accelerometer_) return;
  const std::vector<PredictionSample> samples = Predict(model, values);
  const Eigen::MatrixX3d felt = FeltForce(samples), by_motion = MotionForce(samples);
  across_by_motion_ = IsMotionBetter(felt, by_motion);
  std::vector<bool> follows, counts;
  for (int i = 0; i < flight_->size(); ++i) {
    follows.push_back(flight_->next(i));
    counts.push_back(!flight_->held_out(i));
  }
  blend_.emplace(follows, counts, felt.col(kBlended), by_motion.col(kBlended));
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
  if (blend_) {
    residual.col(kBlended) =
        blend_->Blend(residual.col(kBlended), MotionForce(samples).col(kBlended));
  }
  for (int i = 0; i < flight_->size(); ++i) {
    const PredictionSample& s = samples[static_cast<size_t>(i)];
    residual.row(i).tail<3>() = file_vehicle_->inertia_kg_m2.cwiseProduct(
        s.measured_angular_acceleration - s.predicted_angular_acceleration);
  }
  if (!with_torque_) residual.rightCols<3>().setZero();
  return residual;
}

ResidualModel::Wrenches ResidualModel::AsFelt(Wrenches residual, const DynamicModel& model,
                                              const ModelValues& values) const {
  if (!blend_) return residual;
  const std::vector<PredictionSample> samples = Predict(model, values);
  const Eigen::VectorXd felt = FeltForce(samples).col(kBlended);
  const Eigen::VectorXd by_motion = MotionForce(samples).col(kBlended);
  const Eigen::VectorXd apart = felt - blend_->Blend(felt, by_motion);
  residual.col(kBlended).array() += apart.array() - apart.mean();
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
