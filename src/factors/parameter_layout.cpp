#include "odmc/factors/parameter_layout.h"

#include <algorithm>
#include <cmath>

namespace odmc {

ParameterLayout::ParameterLayout(const DynamicModel& model, const ModelValues& values)
    : base_(values) {
  const auto& parameters = model.parameters();
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = parameters[k];
    if (!p.estimated) continue;
    const int i = num_estimated();
    model_index_.push_back(k);
    scale_.push_back(p.spec.scale);
    is_log_.push_back(p.spec.transform == ParameterTransform::kLog);
    prior_centre_.push_back(ToEta(i, p.spec.prior_value));
    prior_sigma_.push_back(is_log_[i] ? p.spec.prior_sigma / p.spec.prior_value
                                      : p.spec.prior_sigma / p.spec.scale);
  }
}

double ParameterLayout::ToEta(int i, double value) const {
  return is_log_[i] ? std::log(value / scale_[i]) : value / scale_[i];
}

double ParameterLayout::ToValue(int i, double eta) const {
  // e^±20 is beyond any physical range; the bound keeps a wild step finite.
  return scale_[i] * (is_log_[i] ? std::exp(std::clamp(eta, -20.0, 20.0)) : eta);
}

int ParameterLayout::EntryOf(int index) const {
  const auto found = std::find(model_index_.begin(), model_index_.end(), index);
  return found == model_index_.end() ? -1 : static_cast<int>(found - model_index_.begin());
}

ParameterVector ParameterLayout::Encode(const ModelValues& values) const {
  ParameterVector eta(num_estimated());
  for (int i = 0; i < num_estimated(); ++i) eta[i] = ToEta(i, values[model_index_[i]]);
  return eta;
}

ModelValues ParameterLayout::Decode(const double* eta) const {
  ModelValues values = base_;
  for (int i = 0; i < num_estimated(); ++i) values[model_index_[i]] = ToValue(i, eta[i]);
  return values;
}

ParameterVector ParameterLayout::ChainFactors(const ModelValues& values) const {
  ParameterVector factors(num_estimated());
  for (int i = 0; i < num_estimated(); ++i) {
    factors[i] = ChainFactor(i, values[model_index_[i]]);
  }
  return factors;
}

}  // namespace odmc
