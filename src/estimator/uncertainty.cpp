#include "odmc/estimator/uncertainty.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace odmc {
namespace {

constexpr double kWalkEvery_s = 0.1;       // of flight that has left the window
constexpr double kObservableShare = 0.5;   // of the prior's sigma
constexpr double kSigmaAfterChange = 0.3;  // least sigma then, of the prior's

Eigen::VectorXd PriorSigmas(const ParameterLayout& layout) {
  Eigen::VectorXd sigma(layout.num_estimated());
  for (int i = 0; i < sigma.size(); ++i) sigma[i] = layout.PriorSigma(i);
  return sigma;
}

/// "0.8 imu.pz - 0.6 centre_of_gravity.z": the entries that make up most of a direction.
std::string Words(const DynamicModel& model, const ParameterLayout& layout,
                  const Eigen::VectorXd& direction) {
  std::string text;
  for (int i = 0; i < direction.size(); ++i) {
    if (std::abs(direction[i]) < 0.3) continue;
    const bool minus = direction[i] < 0.0;
    text += text.empty() ? (minus ? "-" : "") : (minus ? " - " : " + ");
    text += model.parameters()[layout.model_index(i)].full_name;
  }
  return text;
}

}  // namespace

Uncertainty::Uncertainty(const DynamicModel* model, const ParameterLayout* layout)
    : model_(model),
      layout_(layout),
      consistency_(layout->num_estimated()),
      regressor_noise_(layout->num_estimated()),
      consistency_inflation_(Eigen::VectorXd::Ones(layout->num_estimated())),
      noise_inflation_(consistency_inflation_),
      inflation_(consistency_inflation_),
      prior_sigma_eta_(PriorSigmas(*layout)),
      sigma_eta_(prior_sigma_eta_),
      force_information_(Eigen::VectorXd::Zero(layout->num_estimated())),
      torque_information_(Eigen::VectorXd::Zero(layout->num_estimated())) {}

void Uncertainty::JudgeBy(const DynamicModel& declared) {
  prior_sigma_eta_ = PriorSigmas(ParameterLayout(declared, declared.InitialValues()));
}

void Uncertainty::Reset() {
  const int n = layout_->num_estimated();
  consistency_ = Consistency(n);
  consistency_.SetWalking(walking_);
  regressor_noise_ = RegressorNoise(n);
  consistency_inflation_ = noise_inflation_ = inflation_ = Eigen::VectorXd::Ones(n);
  sigma_eta_ = PriorSigmas(*layout_);
  force_information_.setZero();
  torque_information_.setZero();
  held_yaw_information_ = 0.0;
  unobservable_.clear();
  walk_owed_s_ = 0.0;
}

void Uncertainty::SetWalking(const std::vector<int>& entries, double rate) {
  walking_ = entries;
  walk_rate_ = rate;
  consistency_.SetWalking(entries);
}

void Uncertainty::LetWalk(double dt, WindowSolver* solver, Window* window) {
  walk_owed_s_ += dt;
  if (walking_.empty() || walk_owed_s_ < kWalkEvery_s) return;
  const ModelValues values = window->values();
  const ParameterVector chain = layout_->ChainFactors(values);
  ParameterVector relative = ParameterVector::Zero(layout_->num_estimated());
  for (const int i : walking_) relative[i] = values[layout_->model_index(i)] / chain[i];
  before_walk_ = solver->PastInformation(*window);
  solver->LetPastWalk(relative, walk_rate_ * walk_rate_ * walk_owed_s_, window);
  walk_owed_s_ = 0.0;
  consistency_.Walked(before_walk_, solver->PastInformation(*window));
}

void Uncertainty::Fill(const Window& window, const Conditions& conditions, WindowSolver* solver,
                       Snapshot* snapshot) {
  if (solver->ParameterCovariance(window, sigma_eta_, &covariance_)) {
    sigma_eta_ = covariance_.diagonal().cwiseSqrt();
  } else {
    covariance_ = sigma_eta_.cwiseAbs2().asDiagonal();  // rounding has the better of it: as before
  }
  if (!solver->StateCovariance(window, &snapshot->state_covariance)) {
    snapshot->state_covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  if (consistency_.BlockIsFull()) {
    consistency_.CloseBlock(solver->PastInformation(window));
    consistency_inflation_ =
        consistency_.Inflation(window.eta(), covariance_, window.parameter_sigma());
    RefreshInflation();
  }
  if (regressor_noise_.IsDue(conditions.flown_s)) {
    regressor_noise_.Look(window, *model_, conditions.noise, snapshot->state_covariance,
                          conditions.flown_s);
    noise_inflation_ = regressor_noise_.Inflation(covariance_, prior_sigma_eta_);
    RefreshInflation();
  }
  FillParameters(snapshot);
  AddScaleError(conditions.rotor_scale_sigma, snapshot);
  AddHeldInertiaError(snapshot);
  const ParameterVector chain = layout_->ChainFactors(snapshot->values);
  snapshot->inflation.setOnes(model_->num_parameters());
  for (int i = 0; i < layout_->num_estimated(); ++i) {
    const int k = layout_->model_index(i);
    const double plain = sigma_eta_[i] * std::abs(chain[i]);
    if (plain > 0.0) snapshot->inflation[k] = std::max(1.0, snapshot->sigma[k] / plain);
  }
  snapshot->unobservable = unobservable_;
}

void Uncertainty::FillParameters(Snapshot* snapshot) const {
  const int m = model_->num_parameters(), n = layout_->num_estimated();
  snapshot->sigma.setZero(m);
  snapshot->covariance.setZero(m, m);
  snapshot->observable.assign(static_cast<size_t>(m), false);
  const ParameterVector chain = layout_->ChainFactors(snapshot->values);
  for (int i = 0; i < n; ++i) {
    const int k = layout_->model_index(i);
    const double sigma = sigma_eta_[i] * inflation_[i];
    snapshot->sigma[k] = sigma * std::abs(chain[i]);
    snapshot->observable[k] = sigma < kObservableShare * prior_sigma_eta_[i];
    for (int j = 0; j < n; ++j) {
      snapshot->covariance(k, layout_->model_index(j)) =
          covariance_(i, j) * inflation_[i] * inflation_[j] * chain[i] * chain[j];
    }
  }
}

/// What an error of scale in modelled rotor speeds does to the coefficients of their squares.
void Uncertainty::AddScaleError(double rotor_scale_sigma, Snapshot* snapshot) const {
  if (rotor_scale_sigma == 0.0) return;
  ModelValues error = ModelValues::Zero(model_->num_parameters());
  for (const char* name : {"thrust.k_f", "rotor_torque.k_m"}) {
    const int k = model_->IndexOf(name);
    if (k >= 0 && model_->parameters()[k].estimated)
      error[k] = 2.0 * snapshot->values[k] * rotor_scale_sigma;
  }
  snapshot->covariance.noalias() += error * error.transpose();
  snapshot->sigma = (snapshot->sigma.cwiseAbs2() + error.cwiseAbs2()).cwiseSqrt();
}

int Uncertainty::EstimatedEntry(const char* name) const {
  const int k = model_->IndexOf(name);
  return k >= 0 ? layout_->EntryOf(k) : -1;
}

/// Yaw shows the ratio of what turns the body to its inertia only. Where that was held at its
/// start value, an error of it is one of the others, the same for all, as far as they come from
/// such intervals; none is worse known than before the flight.
void Uncertainty::AddHeldInertiaError(Snapshot* snapshot) const {
  const int I_z = EstimatedEntry("inertia.z"), k_m = EstimatedEntry("rotor_torque.k_m");
  if (I_z < 0 || k_m < 0 || !(held_yaw_information_ > 0.0)) return;
  const ParameterVector chain = layout_->ChainFactors(snapshot->values);
  const auto prior_share = [&](int entry) {
    return prior_sigma_eta_[entry] *
           std::abs(chain[entry] / snapshot->values[layout_->model_index(entry)]);
  };
  const double share = held_yaw_information_ / torque_information_[k_m] *
                       std::min(prior_share(I_z), prior_share(k_m));
  ModelValues error = ModelValues::Zero(model_->num_parameters());
  for (const char* name : {"rotor_torque.k_m", "viscous_torque.b_z", "rotor_reaction.J_r"}) {
    const int entry = EstimatedEntry(name);
    if (entry < 0) continue;
    const int k = layout_->model_index(entry);
    error[k] = share * snapshot->values[k];
  }
  snapshot->covariance.noalias() += error * error.transpose();
  snapshot->sigma = (snapshot->sigma.cwiseAbs2() + error.cwiseAbs2()).cwiseSqrt();
  const int index = layout_->model_index(k_m);
  snapshot->observable[index] =
      snapshot->observable[index] &&
      snapshot->sigma[index] < kObservableShare * prior_sigma_eta_[k_m] * std::abs(chain[k_m]);
}

void Uncertainty::RefreshInflation() {
  inflation_ = consistency_inflation_.cwiseProduct(noise_inflation_);
  // Of what varies, the flight's scores say nothing about the present value.
  for (const DynamicModel::ProcessParameter& p : model_->processes()) {
    for (int i = 0; i < layout_->num_estimated(); ++i) {
      if (layout_->model_index(i) == p.index) inflation_[i] = 1.0;
    }
  }
  TellUnobservable();
}

/// Directions about which the flight says less than the priors, in units of the priors' sigmas.
void Uncertainty::TellUnobservable() {
  const int n = layout_->num_estimated();
  directions_.in_priors = covariance_;
  for (int i = 0; i < n; ++i) {
    const double scale = noise_inflation_[i] / prior_sigma_eta_[i];
    directions_.in_priors.row(i) *= scale;
    directions_.in_priors.col(i) *= scale;
  }
  unobservable_.clear();
  if (n == 0) return;
  directions_.eigen.compute(directions_.in_priors, Eigen::EigenvaluesOnly);
  if (directions_.eigen.eigenvalues()[n - 1] <= kObservableShare) return;
  directions_.eigen.compute(directions_.in_priors);
  for (int i = 0; i < n; ++i) {
    if (directions_.eigen.eigenvalues()[i] > kObservableShare) {
      unobservable_.push_back(Words(*model_, *layout_, directions_.eigen.eigenvectors().col(i)));
    }
  }
}

void Uncertainty::AccumulateMarginalized(double dt, const ParameterVector& eta,
                                         bool yaw_inertia_held) {
  consistency_.Add(dt, leaving_.score, eta);
  const int k_m = EstimatedEntry("rotor_torque.k_m");
  if (yaw_inertia_held && k_m >= 0) held_yaw_information_ += leaving_.torque_information[k_m];
  force_information_ += leaving_.force_information;
  torque_information_ += leaving_.torque_information;
}

// Each parameter by what has informed it, force rows, torque rows, or both.
ParameterVector Uncertainty::ScaleOf(const ProcessNoiseEstimator::Change& change) {
  force_information_ *= change.force;
  torque_information_ *= change.torque;
  held_yaw_information_ *= change.torque;
  const double log_force = std::log(change.force), log_torque = std::log(change.torque);
  ParameterVector scale(force_information_.size());
  for (int i = 0; i < scale.size(); ++i) {
    const double total = std::max(force_information_[i] + torque_information_[i], 1e-300);
    const double share = force_information_[i] / total;
    scale[i] = std::exp(share * log_force + (1.0 - share) * log_torque);
  }
  return scale;
}

void Uncertainty::Rescale(const Eigen::MatrixXd& root) {
  consistency_.Rescale(root);
  regressor_noise_.Rescale(root);
}

Eigen::VectorXd Uncertainty::ScaleAfterChange() const {
  Eigen::VectorXd scale(sigma_eta_.size());
  for (Eigen::Index i = 0; i < scale.size(); ++i) {
    const double ratio = sigma_eta_[i] / (kSigmaAfterChange * prior_sigma_eta_[i]);
    scale[i] = std::clamp(ratio * ratio, 1e-8, 1.0);
  }
  return scale;
}

void Uncertainty::Forget(const Eigen::MatrixXd& root) {
  consistency_.Rescale(root);
  regressor_noise_.Forget(root);
}

std::vector<ThirdsDifference> Uncertainty::CompareThirds(const Window& window) {
  std::vector<ThirdsDifference> differences;
  const std::vector<ThirdOfFlight> thirds = consistency_.Thirds(window.eta(), prior_sigma_eta_);
  if (thirds.size() < 3) return differences;
  const int n = layout_->num_estimated();
  const double threshold = LastLookThreshold(n);
  for (int i = 0; i < n; ++i) {
    if (std::find(walking_.begin(), walking_.end(), i) != walking_.end()) continue;
    const double inflation = inflation_[i] * inflation_[i];
    double weights = 0.0, mean = 0.0, chi_squared = 0.0;
    bool is_seen = true;
    for (const ThirdOfFlight& third : thirds) {
      const double variance = inflation * third.variance[i];
      is_seen =
          is_seen && variance > 0.0 && std::sqrt(variance) < kObservableShare * prior_sigma_eta_[i];
      weights += 1.0 / variance;
      mean += third.step[i] / variance;
    }
    if (!is_seen) continue;
    mean /= weights;
    for (const ThirdOfFlight& third : thirds) {
      const double off = third.step[i] - mean;
      chi_squared += off * off / (inflation * third.variance[i]);
    }
    if (!(chi_squared > threshold)) continue;
    ThirdsDifference difference;
    difference.index = layout_->model_index(i);
    difference.chi_squared = chi_squared;
    for (size_t t = 0; t < 3; ++t) {
      ParameterVector eta = window.eta();
      eta[i] += thirds[t].step[i];
      difference.values[t] = layout_->Decode(eta.data())[difference.index];
    }
    const Eigen::Map<const Eigen::Vector3d> values(difference.values.data());
    difference.spread = std::sqrt((values.array() - values.mean()).square().sum() / 6.0);
    differences.push_back(difference);
  }
  return differences;
}

}  // namespace odmc
