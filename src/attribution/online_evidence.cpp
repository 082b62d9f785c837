#include "odmc/attribution/online_evidence.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "odmc/attribution/evidence.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kAgreeShare = 1.0 / 3.0;  // winds and drags bias each other by so much

/// True if parameters differ from zero together by `sigmas` (Wald's test; the limit
/// grows with their number).
bool IsSignificant(const Eigen::VectorXd& estimate, const Eigen::MatrixXd& covariance,
                   double sigmas) {
  Eigen::MatrixXd C = covariance;
  C.diagonal() *= 1.0 + 1e-9;
  return estimate.dot(C.ldlt().solve(estimate)) >
         sigmas * sigmas + 2.0 * (static_cast<double>(estimate.size()) - 1.0);
}

/// Indices in an online estimate of an effect's estimated parameters, initial states left out.
std::vector<Eigen::Index> EstimatesOf(const RankedEffect& effect, const ParameterSet& online,
                                      const DynamicModel& model) {
  std::vector<Eigen::Index> own;
  for (const ParameterEstimate& p : effect.parameters) {
    const ParameterEstimate* found = online.Find(p.full_name);
    if (found == nullptr || !found->estimated) continue;
    if (model.parameters()[model.IndexOf(p.full_name)].spec.initial_state) continue;
    own.push_back(found - online.parameters.data());
  }
  return own;
}

/// Those of them that tell an effect's size.
std::vector<Eigen::Index> SizesOf(const RankedEffect& effect, const ParameterSet& online,
                                  const DynamicModel& model) {
  std::vector<Eigen::Index> own = EstimatesOf(effect, online, model);
  own.erase(std::remove_if(own.begin(), own.end(),
                           [&](Eigen::Index i) {
                             const auto& p = online.parameters[static_cast<size_t>(i)];
                             return !IsSizeParameter(model.vehicle(), p.full_name);
                           }),
            own.end());
  return own;
}

/// Candidates that act by the rotors' accelerations, whose signs physics gives or not.
std::vector<std::string> FromRotorRates(const Vehicle& vehicle,
                                        const std::vector<EffectCandidate>& candidates,
                                        bool with_sign) {
  std::vector<std::string> names;
  for (const EffectCandidate& candidate : candidates) {
    const auto effect = EffectRegistry::Default().Make(candidate.effect, vehicle);
    const std::vector<ParameterSpec>& parameters = effect->parameters();
    const bool is_signed = std::all_of(parameters.begin(), parameters.end(),
                                       [](const auto& p) { return p.sign != PhysicalSign::kAny; });
    if (!effect->description().from_rotor_rates || is_signed != with_sign) continue;
    if (std::count(names.begin(), names.end(), candidate.effect) == 0) {
      names.push_back(candidate.effect);
    }
  }
  return names;
}

Eigen::VectorXd ValuesOf(const ParameterSet& set) {
  Eigen::VectorXd values(static_cast<Eigen::Index>(set.parameters.size()));
  for (size_t i = 0; i < set.parameters.size(); ++i) {
    values[static_cast<Eigen::Index>(i)] = set.parameters[i].value;
  }
  return values;
}

}  // namespace

std::vector<std::string> QuickEffects(const Vehicle& vehicle,
                                      const std::vector<EffectCandidate>& candidates) {
  return FromRotorRates(vehicle, candidates, true);
}

std::vector<std::string> RotorTimingEffects(const Vehicle& vehicle,
                                            const std::vector<EffectCandidate>& candidates) {
  return FromRotorRates(vehicle, candidates, false);
}

RankedEffect RankedByEstimate(const std::string& effect, const ParameterSet& online,
                              const DynamicModel& model, size_t candidates, double log_prior_odds) {
  RankedEffect ranked;
  ranked.name = effect;
  ranked.score = -std::numeric_limits<double>::infinity();
  std::vector<Eigen::Index> own;
  double log_prior = 0.0, signs = 0.0;
  for (size_t i = 0; i < online.parameters.size(); ++i) {
    const ParameterEstimate& p = online.parameters[i];
    const int k = model.IndexOf(p.full_name);
    if (k < 0 || model.parameters()[k].effect != effect) continue;
    ranked.parameters.push_back(p);
    if (!p.estimated || !(p.sigma > 0.0)) continue;
    const ParameterSpec& spec = model.parameters()[k].spec;
    own.push_back(static_cast<Eigen::Index>(i));
    log_prior +=
        std::log(spec.prior_sigma) + 0.5 * std::pow(spec.prior_value / spec.prior_sigma, 2);
    signs += LogSignOdds(spec.sign, spec.certain_sign, p.value, p.sigma);
  }
  const auto n = static_cast<Eigen::Index>(own.size());
  if (n == 0 || online.covariance.rows() == 0) return ranked;
  Eigen::VectorXd estimate(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    estimate[k] = online.parameters[static_cast<size_t>(own[static_cast<size_t>(k)])].value;
  }
  ranked.covariance = online.covariance(own, own);
  const Eigen::LLT<Eigen::MatrixXd> llt(ranked.covariance);
  if (llt.info() != Eigen::Success) return ranked;
  const Eigen::VectorXd sigmas = llt.matrixL().solve(estimate);
  ranked.score = 0.5 * sigmas.squaredNorm() - log_prior + signs;
  for (Eigen::Index k = 0; k < n; ++k) ranked.score += std::log(llt.matrixLLT()(k, k));
  if (!std::isfinite(ranked.score)) ranked.score = -std::numeric_limits<double>::infinity();
  ranked.p_value = std::min(1.0, static_cast<double>(candidates) * std::exp(-ranked.score));
  ranked.probability = 1.0 / (1.0 + std::exp(-ranked.score - log_prior_odds));
  return ranked;
}

std::optional<RankedEffect> RankedByBands(const std::string& effect,
                                          const std::map<std::string, ParameterSetting>& known,
                                          const ParameterSet& online, const DynamicModel& model,
                                          size_t candidates, double log_prior_odds) {
  ParameterSet banded;
  for (const ParameterEstimate& p : online.parameters) {
    const int k = model.IndexOf(p.full_name);
    if (k < 0 || model.parameters()[k].effect != effect) continue;
    const auto found = known.find(p.full_name);
    if (found == known.end() || !found->second.value || !found->second.sigma) return std::nullopt;
    banded.parameters.push_back(p);
    banded.parameters.back().value = *found->second.value;
    banded.parameters.back().sigma = *found->second.sigma;
  }
  if (banded.parameters.empty()) return std::nullopt;
  const auto n = static_cast<Eigen::Index>(banded.parameters.size());
  banded.covariance = Eigen::MatrixXd::Zero(n, n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const double sigma = banded.parameters[static_cast<size_t>(k)].sigma;
    banded.covariance(k, k) = sigma * sigma;
  }
  return RankedByEstimate(effect, banded, model, candidates, log_prior_odds);
}

void AddAlternativeSpread(const RankedEffect& beside, RankedEffect* effect) {
  const auto n = static_cast<Eigen::Index>(effect->parameters.size());
  Eigen::VectorXd change(n);
  effect->spread_of.clear();
  for (Eigen::Index k = 0; k < n; ++k) {
    const ParameterEstimate& p = effect->parameters[static_cast<size_t>(k)];
    effect->spread_of.push_back(p.full_name);
    const ParameterEstimate* other = beside.Find(p.full_name);
    change[k] = other != nullptr ? other->value - p.value : 0.0;
  }
  effect->spread = change * change.transpose();
}

void AddScaleSpread(const std::map<std::string, ParameterSetting>& names, double sigma,
                    RankedEffect* effect) {
  const auto n = static_cast<Eigen::Index>(effect->parameters.size());
  Eigen::VectorXd change = Eigen::VectorXd::Zero(n);
  std::vector<std::string> all;
  for (Eigen::Index k = 0; k < n; ++k) {
    all.push_back(effect->parameters[static_cast<size_t>(k)].full_name);
    const auto known = names.find(all.back());
    if (known != names.end() && known->second.value) change[k] = sigma * *known->second.value;
  }
  if (change.isZero(0.0)) return;
  if (effect->spread_of != all) {
    effect->spread = Eigen::MatrixXd::Zero(n, n);
    effect->spread_of = all;
  }
  effect->spread += change * change.transpose();
}

void AddSpread(const RankedEffect& effect, ParameterSet* online) {
  std::vector<Eigen::Index> from, to;
  for (size_t k = 0; k < effect.spread_of.size(); ++k) {
    const ParameterEstimate* p = online->Find(effect.spread_of[k]);
    if (p == nullptr || !p->estimated) continue;
    from.push_back(static_cast<Eigen::Index>(k));
    to.push_back(p - online->parameters.data());
  }
  if (from.empty() || online->covariance.rows() == 0) return;
  online->covariance(to, to) += effect.spread(from, from);
  for (const Eigen::Index i : to) {
    online->parameters[static_cast<size_t>(i)].sigma = std::sqrt(online->covariance(i, i));
  }
}

bool SizeDiffersFromZero(const RankedEffect& effect, const ParameterSet& online,
                         const DynamicModel& model, double sigmas) {
  const std::vector<Eigen::Index> own = SizesOf(effect, online, model);
  return own.empty() || IsSignificant(ValuesOf(online)(own), online.covariance(own, own), sigmas);
}

bool SizeMayBeZero(const RankedEffect& effect, const ParameterSet& online,
                   const Eigen::VectorXd& change, const DynamicModel& model,
                   const AttributionOptions& options) {
  const std::vector<Eigen::Index> own = SizesOf(effect, online, model);
  const Eigen::VectorXd changes = change(own);
  if (own.empty() || changes.isZero(0.0)) return false;
  const Eigen::VectorXd size = ValuesOf(online)(own);
  const Eigen::MatrixXd covariance = online.covariance(own, own);
  const Eigen::VectorXd weighted = covariance.ldlt().solve(changes);
  const double nearest = std::clamp(-size.dot(weighted) / changes.dot(weighted), -1.0, 1.0);
  return !IsSignificant(size + nearest * changes, covariance, options.significant_sigmas);
}

bool ContradictsFit(const RankedEffect& effect, const ParameterSet& online) {
  constexpr double kSigmas = 3.0;
  return std::any_of(
      effect.parameters.begin(), effect.parameters.end(), [&](const ParameterEstimate& p) {
        const ParameterEstimate* there = online.Find(p.full_name);
        if (!p.estimated || !p.observable || there == nullptr || !there->estimated) return false;
        return std::abs(there->value - p.value) > kSigmas * std::hypot(there->sigma, p.sigma);
      });
}

std::string EstimatesText(const RankedEffect& effect, const ParameterSet& online,
                          const DynamicModel& model) {
  std::string text;
  for (const Eigen::Index i : EstimatesOf(effect, online, model)) {
    const ParameterEstimate& p = online.parameters[static_cast<size_t>(i)];
    text += (text.empty() ? " " : ", ") + p.full_name + " = " + Rounded(p.value) + " +- " +
            Rounded(p.sigma);
  }
  return text;
}

double NatsAgainst(const RankedEffect& effect, const ParameterSet& online,
                   const DynamicModel& model) {
  const std::vector<Eigen::Index> own = EstimatesOf(effect, online, model);
  const auto n = static_cast<Eigen::Index>(own.size());
  if (n == 0) return 0.0;  // all of it is held: it has nothing to say
  if (effect.covariance.rows() != n) return std::numeric_limits<double>::infinity();
  Eigen::VectorXd difference(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const ParameterEstimate& p =
        online.parameters[static_cast<size_t>(own[static_cast<size_t>(k)])];
    difference[k] = p.value - effect.Find(p.full_name)->value;
  }
  Eigen::MatrixXd C = online.covariance(own, own) + effect.covariance;
  C.diagonal() *= 1.0 + 1e-9;
  return 0.5 * difference.dot(C.ldlt().solve(difference));
}

std::string Disagreement(const RankedEffect& effect, const ParameterSet& online,
                         const DynamicModel& model, const AttributionOptions& options) {
  const std::vector<Eigen::Index> own = EstimatesOf(effect, online, model);
  const auto n = static_cast<Eigen::Index>(own.size());
  if (n == 0 || effect.covariance.rows() != n) return "";
  Eigen::MatrixXd covariance = online.covariance(own, own) + effect.covariance;
  Eigen::VectorXd difference(n);
  Eigen::Index worst = 0;
  double most = 0.0;
  for (Eigen::Index i = 0; i < n; ++i) {
    const ParameterEstimate& p = online.parameters[own[static_cast<size_t>(i)]];
    const double fitted = effect.Find(p.full_name)->value;
    difference[i] = p.value - fitted;
    const double share = kAgreeShare * std::max(std::abs(p.value), std::abs(fitted));
    covariance(i, i) += share * share;
    const double sigmas = std::abs(difference[i]) / std::sqrt(covariance(i, i));
    if (sigmas < most) continue;
    most = sigmas;
    worst = i;
  }
  if (!IsSignificant(difference, covariance, options.significant_sigmas)) return "";
  const ParameterEstimate& p = online.parameters[own[static_cast<size_t>(worst)]];
  return "it finds " + p.full_name + " = " + Rounded(p.value) + ", the fit that chose the effect " +
         Rounded(p.value - difference[worst]);
}

}  // namespace odmc
