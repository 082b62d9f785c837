#pragma once

#include <vector>

#include "odmc/model/dynamic_model.h"

namespace odmc {

/// Small vector of the optimiser's parameters that never allocates.
using ParameterVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxModelParameters, 1>;

/// How the model's estimated parameters lie in the optimiser: one block `eta` of only the estimated
/// entries, scaled so that they are of order one (model.md section 7). One block for all keeps the
/// window's normal equations in few large pieces. Frozen parameters keep the value they had when
/// the layout was made.
class ParameterLayout {
 public:
  /// @param values model values to start from: start of the estimated ones, value of the frozen
  /// ones
  ParameterLayout(const DynamicModel& model, const ModelValues& values);

  int num_estimated() const { return static_cast<int>(model_index_.size()); }
  /// Index in DynamicModel::parameters() of entry `i` of eta.
  int model_index(int i) const { return model_index_[i]; }
  const std::vector<int>& model_indices() const { return model_index_; }

  /// eta of model values (only its estimated entries are read).
  ParameterVector Encode(const ModelValues& values) const;

  /// Model values at eta (num_estimated() numbers; null if there are none).
  ModelValues Decode(const double* eta) const;

  /// Entry of eta that holds model parameter `index`, -1 if it is frozen.
  int EntryOf(int index) const;

  /// True if entry `i` of eta is the logarithm of its value.
  bool is_log(int i) const { return is_log_[i]; }

  /// One entry's value, and its derivative there.
  double ToValue(int i, double eta) const;
  double ChainFactor(int i, double value) const { return is_log_[i] ? value : scale_[i]; }

  /// d value / d eta of each entry at model values.
  ParameterVector ChainFactors(const ModelValues& values) const;

  /// Prior of entry `i` in eta: centre and sigma.
  double PriorCentre(int i) const { return prior_centre_[i]; }
  double PriorSigma(int i) const { return prior_sigma_[i]; }

 private:
  double ToEta(int i, double value) const;

  std::vector<int> model_index_;
  std::vector<double> scale_;
  std::vector<bool> is_log_;
  std::vector<double> prior_centre_, prior_sigma_;
  ModelValues base_;
};

}  // namespace odmc
