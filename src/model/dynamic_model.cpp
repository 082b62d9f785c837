#include "odmc/model/dynamic_model.h"

#include <algorithm>
#include <cassert>
#include <numeric>
#include <stdexcept>

#include "odmc/model/plausibility.h"

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
  const SettingDoubt doubt = DoubtOf(p.full_name, spec, setting, vehicle);
  if (!doubt.key.empty()) {
    throw std::invalid_argument("parameters." + p.full_name + "." + doubt.key + ": " +
                                doubt.sentence);
  }
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

/// What a borrowed parameter is where its lender is absent.
double DefaultOf(const std::string& full_name, const Vehicle& vehicle,
                 const EffectRegistry& registry) {
  const size_t dot = full_name.find('.');
  const auto lender = registry.Make(full_name.substr(0, dot), vehicle);
  for (const ParameterSpec& spec : lender->parameters()) {
    if (spec.name != full_name.substr(dot + 1)) continue;
    return Configured(*lender, spec, vehicle).spec.prior_value;
  }
  return 0.0;
}

/// By index in the model, where an effect's own parameters begin at `first`.
std::optional<PendulumParameters> PendulumOf(const Effect& effect, int first) {
  const auto own = effect.pendulum();
  if (!own) return {};
  return PendulumParameters{own->length + first, own->damping + first, own->place + first,
                            own->swing + first};
}

std::vector<DynamicModel::ProcessParameter> ProcessesOf(const Effect& effect,
                                                        const DynamicModel& model) {
  const std::string prefix = effect.name() + ".";
  std::vector<DynamicModel::ProcessParameter> processes;
  for (const ParameterSpec& spec : effect.parameters()) {
    if (spec.process_sigma.empty()) continue;
    processes.push_back({model.IndexOf(prefix + spec.name),
                         model.IndexOf(prefix + spec.process_sigma),
                         model.IndexOf(prefix + spec.process_time_constant)});
  }
  return processes;
}

}  // namespace

DynamicModel::DynamicModel(const Vehicle& vehicle, const std::vector<std::string>& effects,
                           const EffectRegistry& registry)
    : vehicle_(vehicle), effect_names_(effects), nominal_(BodyProperties::Nominal(vehicle)) {
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
  for (int i = 0; i < num_effects(); ++i) {
    const auto& effect = effects_[i];
    std::vector<int> index(effect->parameters().size());
    std::iota(index.begin(), index.end(), first_[i]);
    std::vector<double> fallback;
    for (const std::string& full_name : effect->borrowed()) {
      index.push_back(IndexOf(full_name));
      fallback.push_back(index.back() >= 0 ? 0.0 : DefaultOf(full_name, vehicle, registry));
    }
    columns_.push_back(index);
    borrowed_default_.push_back(fallback);
  }
  for (int i = 0; i < num_effects(); ++i) {
    if (effects_[i]->adds_wrench()) wrench_effects_.push_back(i);
    if (effects_[i]->description().from_rotor_rates) rate_effects_.push_back(i);
    if (effects_[i]->shapes_body()) {
      shaping_effects_.push_back(i);
      shaping_borrows_ = shaping_borrows_ || !effects_[i]->borrowed().empty();
    }
    if (const auto own = PendulumOf(*effects_[i], first_[i])) pendulum_ = own;
    const std::vector<ProcessParameter> own_processes = ProcessesOf(*effects_[i], *this);
    processes_.insert(processes_.end(), own_processes.begin(), own_processes.end());
    varies_ = varies_ || effects_[i]->depends_on_time() || !own_processes.empty();
  }
  FindRows();
}

void DynamicModel::FindRows() {
  makes_wrench_.assign(num_parameters(), false);
  for (const int i : wrench_effects_) {
    for (const int k : columns_[i]) {
      if (k >= 0) makes_wrench_[k] = true;
    }
  }
  shaped_rows_.assign(num_parameters(), {});
  for (const int i : shaping_effects_) {
    const BodyPropertyRows rows = effects_[i]->shaped_rows();
    for (const int k : columns_[i]) {
      if (k < 0) continue;
      BodyPropertyRows& all = shaped_rows_[k];
      const int end = std::max(all.first + all.count, rows.first + rows.count);
      all.first = all.count == 0 ? rows.first : std::min(all.first, rows.first);
      all.count = end - all.first;
      shapes_mounts_ = shapes_mounts_ || end > kRowOdometryPosition;
    }
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

DynamicModel::EffectValues DynamicModel::ValuesOf(int i, const ModelValues& values) const {
  const int num_own = static_cast<int>(effects_[i]->parameters().size());
  const int num_values = static_cast<int>(columns_[i].size());
  EffectValues own(num_values);
  own.head(num_own) = values.segment(first_[i], num_own);
  for (int k = num_own; k < num_values; ++k) {
    const int lent = columns_[i][k];
    own[k] = lent >= 0 ? values[lent] : borrowed_default_[i][k - num_own];
  }
  return own;
}

bool DynamicModel::Takes(int i, int parameter) const {
  return std::find(columns_[i].begin(), columns_[i].end(), parameter) != columns_[i].end();
}

BodyProperties DynamicModel::Properties(const ModelValues& values, BodyPropertiesJacobian* J,
                                        double time_s) const {
  if (J != nullptr) J->setZero(kNumBodyPropertyRows, num_parameters());
  return ShapedProperties(values, time_s, J);
}

BodyProperties DynamicModel::ShapedProperties(const ModelValues& values, double time_s,
                                              BodyPropertiesJacobian* J) const {
  assert(values.size() == num_parameters());
  BodyProperties body = nominal_;
  if (J != nullptr) {
    J->resize(kNumBodyPropertyRows, num_parameters());
    for (int k = 0; k < num_parameters(); ++k) {
      double* const column = J->data() + kNumBodyPropertyRows * k;
      for (int i = 0; i < shaped_rows_[k].count; ++i) column[shaped_rows_[k].first + i] = 0.0;
    }
  }
  for (const int i : shaping_effects_) {
    const Effect& effect = *effects_[i];
    if (J == nullptr) {
      effect.Shape(time_s, ValuesOf(i, values), &body);
      continue;
    }
    if (!shaping_borrows_) {
      BodyPropertyJacobian own(J->data() + kNumBodyPropertyRows * first_[i], kNumBodyPropertyRows,
                               effect.num_values());
      effect.Shape(time_s, ValuesOf(i, values), &body, &own);
      continue;
    }
    // Apart, since what another effect borrowed may have left something in the same columns.
    const BodyPropertyRows rows = effect.shaped_rows();
    Eigen::Matrix<double, kNumBodyPropertyRows, kMaxEffectParameters> storage;
    BodyPropertyJacobian own(storage.data(), kNumBodyPropertyRows, effect.num_values());
    own.middleRows(rows.first, rows.count).setZero();
    effect.Shape(time_s, ValuesOf(i, values), &body, &own);
    for (int k = 0; k < effect.num_values(); ++k) {
      const int column = columns_[i][k];
      if (column < 0) continue;
      J->col(column).segment(rows.first, rows.count) += own.col(k).segment(rows.first, rows.count);
    }
  }
  return body;
}

void DynamicModel::AddEffect(int i, const FlightState& state, const ModelValues& values,
                             Wrench* wrench, WrenchJacobians* J) const {
  const Effect& effect = *effects_[i];
  if (effect.borrowed().empty()) {
    effect.AddWrench(state, values.segment(first_[i], effect.num_values()), wrench, J);
  } else {
    effect.AddWrench(state, ValuesOf(i, values), wrench, J);
  }
}

void DynamicModel::EvaluateSome(const std::vector<int>& effects, const FlightState& state,
                                const ModelValues& values, const Eigen::Vector3d& p_BBcm,
                                Eigen::Vector3d* f_B, Eigen::Vector3d* tau_Bcm_B,
                                ModelWrenchJacobians* J, const TorqueAnchor* anchor) const {
  Wrench wrench;
  if (J != nullptr) {
    J->d_state.setZero();
    J->by_pose = false;
    J->d_values.setZero(6, num_parameters());
  }
  const auto add = [&](int i, const ModelValues& at, bool force, bool torque, Wrench* sum) {
    if (J == nullptr) return AddEffect(i, state, at, sum, nullptr);
    WrenchJacobians own(p_BBcm, columns_[i], force, torque, J);
    AddEffect(i, state, at, sum, &own);
  };
  const bool apart = anchor != nullptr && values[anchor->index] != anchor->value;
  for (const int i : effects) {
    if (!apart || !Takes(i, anchor->index)) {
      add(i, values, true, true, &wrench);
      continue;
    }
    // Force by one value and torque by another: the effect twice, a half of each.
    ModelValues anchored = values;
    anchored[anchor->index] = anchor->value;
    Wrench for_force, for_torque;
    add(i, values, true, false, &for_force);
    add(i, anchored, false, true, &for_torque);
    wrench.f_B += for_force.f_B;
    wrench.f_points_B += for_torque.f_points_B;
    wrench.tau_Bo_B += for_torque.tau_Bo_B;
  }
  *f_B = wrench.f_B;
  *tau_Bcm_B = wrench.TorqueAbout(p_BBcm);
  if (J == nullptr) return;
  if (anchor != nullptr) {
    J->d_anchor = J->d_values.block<3, 1>(3, anchor->index);
    J->d_values.block<3, 1>(3, anchor->index).setZero();
  }
  J->d_p_BBcm.topRows<3>().setZero();
  J->d_p_BBcm.bottomRows<3>() = Hat(wrench.f_points_B);
}

void DynamicModel::EvaluateWrench(const FlightState& state, const ModelValues& values,
                                  const Eigen::Vector3d& p_BBcm, Eigen::Vector3d* f_B,
                                  Eigen::Vector3d* tau_Bcm_B, ModelWrenchJacobians* J,
                                  const TorqueAnchor* anchor) const {
  EvaluateSome(wrench_effects_, state, values, p_BBcm, f_B, tau_Bcm_B, J, anchor);
}

void DynamicModel::EvaluateRateEffects(const FlightState& state, const ModelValues& values,
                                       const Eigen::Vector3d& p_BBcm, Eigen::Vector3d* f_B,
                                       Eigen::Vector3d* tau_Bcm_B, ModelWrenchJacobians* J,
                                       const TorqueAnchor* anchor) const {
  EvaluateSome(rate_effects_, state, values, p_BBcm, f_B, tau_Bcm_B, J, anchor);
}

std::vector<EffectWrench> DynamicModel::EvaluateEffects(const FlightState& state,
                                                        const ModelValues& values,
                                                        const Eigen::Vector3d& p_BBcm) const {
  std::vector<EffectWrench> result;
  for (const int i : wrench_effects_) {
    Wrench wrench;
    AddEffect(i, state, values, &wrench, nullptr);
    result.push_back({effects_[i]->name(), wrench.f_B, wrench.TorqueAbout(p_BBcm)});
  }
  return result;
}

bool BelongsToFlight(const DynamicModel& model, const ModelParameter& parameter) {
  if (parameter.spec.initial_state) return true;
  for (int i = 0; i < model.num_effects(); ++i) {
    if (model.effect(i).name() == parameter.effect) return model.effect(i).belongs_to_flight();
  }
  return false;
}

}  // namespace odmc
