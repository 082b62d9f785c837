#include "odmc/model/dynamic_model.h"

#include <algorithm>
#include <cassert>
#include <stdexcept>

namespace odmc {
namespace {

/// The spec of `effect`'s parameter after the vehicle file had its say.
ModelParameter Configured(const Effect& effect, const ParameterSpec& spec, const Vehicle& vehicle) {
  ModelParameter p;
  p.full_name = effect.name() + "." + spec.name;
  p.effect = effect.name();
  p.spec = spec;
  p.estimated = !spec.frozen_by_default;
  const auto it = vehicle.parameters.find(p.full_name);
  if (it == vehicle.parameters.end()) return p;
  const ParameterSetting& setting = it->second;
  if (setting.value) p.spec.prior_value = *setting.value;
  if (setting.sigma) p.spec.prior_sigma = *setting.sigma;
  if (setting.estimated) p.estimated = *setting.estimated;
  if (spec.transform == ParameterTransform::kLog && setting.value) {
    if (!(*setting.value > 0.0)) {
      throw std::invalid_argument("parameters." + p.full_name + ".value must be positive");
    }
    if (!setting.sigma) p.spec.prior_sigma *= *setting.value / spec.prior_value;
    p.spec.scale = *setting.value;
  }
  if (!(p.spec.prior_sigma > 0.0)) {
    throw std::invalid_argument("parameters." + p.full_name + ".sigma must be positive");
  }
  return p;
}

}  // namespace

DynamicModel::DynamicModel(const Vehicle& vehicle, const std::vector<std::string>& effects,
                           const EffectRegistry& registry)
    : vehicle_(vehicle), effect_names_(effects) {
  std::string error;
  if (!vehicle.IsValid(&error)) throw std::invalid_argument(error);
  for (const std::string& name : effects) {
    if (std::count(effects.begin(), effects.end(), name) > 1) {
      throw std::invalid_argument("effect '" + name + "' is listed twice");
    }
    effects_.push_back(registry.Make(name, vehicle));
    first_.push_back(num_parameters());
    for (const ParameterSpec& spec : effects_.back()->parameters()) {
      parameters_.push_back(Configured(*effects_.back(), spec, vehicle));
    }
  }
  if (num_parameters() > kMaxModelParameters) {
    throw std::invalid_argument("the model has more than " + std::to_string(kMaxModelParameters) +
                                " parameters");
  }
  for (const auto& effect : effects_) {
    std::vector<int> index;
    std::vector<double> fallback;
    for (const std::string& full_name : effect->borrowed()) {
      index.push_back(IndexOf(full_name));
      fallback.push_back(0.0);
      if (index.back() >= 0) continue;
      const size_t dot = full_name.find('.');
      const auto lender = registry.Make(full_name.substr(0, dot), vehicle);
      for (const ParameterSpec& spec : lender->parameters()) {
        if (spec.name == full_name.substr(dot + 1)) {
          fallback.back() = Configured(*lender, spec, vehicle).spec.prior_value;
        }
      }
    }
    borrowed_index_.push_back(index);
    borrowed_default_.push_back(fallback);
  }
  FindShapedColumns();
  for (int i = 0; i < num_effects(); ++i) {
    varies_ = varies_ || effects_[i]->depends_on_time();
    takes_rotor_rates_ = takes_rotor_rates_ || effects_[i]->description().from_rotor_rates;
    for (const ParameterSpec& spec : effects_[i]->parameters()) {
      if (spec.process_sigma.empty()) continue;
      const std::string prefix = effects_[i]->name() + ".";
      processes_.push_back({IndexOf(prefix + spec.name), IndexOf(prefix + spec.process_sigma),
                            IndexOf(prefix + spec.process_time_constant)});
      varies_ = true;
    }
  }
}

void DynamicModel::FindShapedColumns() {
  std::vector<bool> shaped(num_parameters(), false);
  for (int i = 0; i < num_effects(); ++i) {
    if (!effects_[i]->shapes_body()) continue;
    for (size_t k = 0; k < effects_[i]->parameters().size(); ++k) shaped[first_[i] + k] = true;
    for (const int lender : borrowed_index_[i]) {
      if (lender >= 0) shaped[lender] = true;
    }
  }
  for (int k = 0; k < num_parameters(); ++k) {
    if (!shaped[k]) continue;
    if (k == 0 || !shaped[k - 1]) shaped_columns_.push_back({k, 0});
    ++shaped_columns_.back().count;
  }
}

int DynamicModel::IndexOf(std::string_view full_name) const {
  for (int i = 0; i < num_parameters(); ++i) {
    if (parameters_[i].full_name == full_name) return i;
  }
  return -1;
}

ModelValues DynamicModel::InitialValues() const {
  ModelValues values(num_parameters());
  for (int i = 0; i < num_parameters(); ++i) values[i] = parameters_[i].spec.prior_value;
  return values;
}

Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxEffectParameters, 1> DynamicModel::ValuesOf(
    int i, const ModelValues& values) const {
  const int num_own = static_cast<int>(effects_[i]->parameters().size());
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxEffectParameters, 1> own(
      effects_[i]->num_values());
  own.head(num_own) = values.segment(first_[i], num_own);
  for (size_t k = 0; k < borrowed_index_[i].size(); ++k) {
    own[num_own + static_cast<int>(k)] =
        borrowed_index_[i][k] >= 0 ? values[borrowed_index_[i][k]] : borrowed_default_[i][k];
  }
  return own;
}

BodyProperties DynamicModel::Properties(const ModelValues& values, BodyPropertiesJacobian* J,
                                        double time_s) const {
  assert(values.size() == num_parameters());
  BodyProperties body = BodyProperties::Nominal(vehicle_);
  if (J != nullptr) J->setZero(kNumBodyPropertyRows, num_parameters());
  BodyPropertyJacobian own;
  for (int i = 0; i < num_effects(); ++i) {
    if (!effects_[i]->shapes_body()) continue;
    effects_[i]->Shape(time_s, ValuesOf(i, values), &body, J != nullptr ? &own : nullptr);
    if (J == nullptr) continue;
    const int num_own = static_cast<int>(effects_[i]->parameters().size());
    J->middleCols(first_[i], num_own) += own.leftCols(num_own);
    for (size_t k = 0; k < borrowed_index_[i].size(); ++k) {
      if (borrowed_index_[i][k] >= 0) {
        J->col(borrowed_index_[i][k]) += own.col(num_own + static_cast<int>(k));
      }
    }
  }
  return body;
}

void DynamicModel::EvaluateWrench(const FlightState& state, const ModelValues& values,
                                  const Eigen::Vector3d& p_BBcm, Eigen::Vector3d* f_B,
                                  Eigen::Vector3d* tau_Bcm_B, ModelWrenchJacobians* J) const {
  Wrench wrench;
  WrenchJacobians jacobians;
  // Takes rows f_B, f_points_B, tau_Bo_B to rows f_B, tau_Bcm_B.
  Eigen::Matrix<double, 6, 9> shift;
  if (J != nullptr) {
    shift.setZero();
    shift.block<3, 3>(0, 0).setIdentity();
    shift.block<3, 3>(3, 3) = -Hat(p_BBcm);
    shift.block<3, 3>(3, 6).setIdentity();
    J->d_values.setZero(6, num_parameters());
  }
  for (int i = 0; i < num_effects(); ++i) {
    if (!effects_[i]->adds_wrench()) continue;
    effects_[i]->AddWrench(state, ValuesOf(i, values), &wrench,
                           J != nullptr ? &jacobians : nullptr);
    if (J == nullptr) continue;
    const int num_own = static_cast<int>(effects_[i]->parameters().size());
    J->d_values.middleCols(first_[i], num_own).noalias() +=
        shift * jacobians.d_parameters.leftCols(num_own);
    for (size_t k = 0; k < borrowed_index_[i].size(); ++k) {
      if (borrowed_index_[i][k] >= 0) {
        J->d_values.col(borrowed_index_[i][k]) +=
            shift * jacobians.d_parameters.col(num_own + static_cast<int>(k));
      }
    }
  }
  *f_B = wrench.f_B;
  *tau_Bcm_B = wrench.TorqueAbout(p_BBcm);
  if (J == nullptr) return;
  J->d_state.noalias() = shift * jacobians.d_state;
  J->d_p_BBcm.topRows<3>().setZero();
  J->d_p_BBcm.bottomRows<3>() = Hat(wrench.f_points_B);
}

std::vector<EffectWrench> DynamicModel::EvaluateEffects(const FlightState& state,
                                                        const ModelValues& values,
                                                        const Eigen::Vector3d& p_BBcm) const {
  std::vector<EffectWrench> result;
  for (int i = 0; i < num_effects(); ++i) {
    if (!effects_[i]->adds_wrench()) continue;
    Wrench wrench;
    effects_[i]->AddWrench(state, ValuesOf(i, values), &wrench);
    result.push_back({effects_[i]->name(), wrench.f_B, wrench.TorqueAbout(p_BBcm)});
  }
  return result;
}

}  // namespace odmc
