#include "odmc/attribution/online_evidence.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "odmc/attribution/evidence.h"

namespace odmc {

std::vector<std::string> QuickEffects(const Vehicle& vehicle,
                                      const std::vector<Candidate>& candidates) {
  std::vector<std::string> names;
  for (const Candidate& candidate : candidates) {
    const auto effect = EffectRegistry::Default().Make(candidate.effect, vehicle);
    const std::vector<ParameterSpec>& parameters = effect->parameters();
    const bool is_signed = std::all_of(parameters.begin(), parameters.end(),
                                       [](const auto& p) { return p.sign != PhysicalSign::kAny; });
    if (!effect->description().from_rotor_rates || !is_signed) continue;
    if (std::count(names.begin(), names.end(), candidate.effect) == 0) {
      names.push_back(candidate.effect);
    }
  }
  return names;
}

RankedEffect RankedByEstimate(const std::string& effect, const ParameterSet& online,
                              const DynamicModel& model, size_t candidates) {
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
  return ranked;
}

}  // namespace odmc
