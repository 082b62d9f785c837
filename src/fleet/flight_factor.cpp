#include "odmc/fleet/flight_factor.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace odmc {
namespace {

/// By how much the directions of `eigen`, the covariance in units of the priors' sigmas, are known
/// worse: the mean over what each parameter contributes of the factor on the variance that the
/// flight's noise makes. (The share of a variance that is the prior's is not known worse.) Widened
/// along the parameters, what a flight knows well of a sum of two would be known of another sum.
Eigen::VectorXd InflationAlong(const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>& eigen,
                               const Eigen::VectorXd& inflation) {
  const Eigen::MatrixXd shares = eigen.eigenvectors().cwiseAbs2();  // parameter, direction
  const Eigen::VectorXd &variance = eigen.eigenvalues(), total = shares * variance;
  const Eigen::VectorXd flown = (1.0 - (shares * variance.cwiseAbs2()).array() / total.array())
                                    .max(0.0)
                                    .matrix();  // of the variance, without the prior's share
  const Eigen::VectorXd widened = (inflation.cwiseAbs2() + flown).array() - 1.0;
  const Eigen::VectorXd sum = shares.transpose() * widened.cwiseMax(flown);
  const Eigen::VectorXd weight = shares.transpose() * flown;
  return (weight.array() > 0.0).select(sum.cwiseQuotient(weight).cwiseSqrt(), 1.0);
}

}  // namespace

void SetLikelihood(const Eigen::VectorXd& value, const Eigen::MatrixXd& covariance,
                   const Eigen::VectorXd& inflation, const Eigen::VectorXd& prior_value,
                   const Eigen::VectorXd& prior_sigma, FlightFactor* factor) {
  constexpr double kNothing = 1e-9;  // information that is rounding, beside the prior's of 1
  constexpr double kSigmas = 3.0;
  // In units of the priors' sigmas, from their centres: the prior's information is the identity.
  const Eigen::Index n = value.size();
  const Eigen::VectorXd inverse = prior_sigma.cwiseInverse();
  const Eigen::MatrixXd scaled = inverse.asDiagonal() * covariance * inverse.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(0.5 * (scaled + scaled.transpose()));
  if (eigen.info() != Eigen::Success || (n > 0 && !(eigen.eigenvalues().minCoeff() > 0.0))) {
    throw std::invalid_argument(factor->flight + ": the covariance is not positive definite");
  }
  const Eigen::MatrixXd& V = eigen.eigenvectors();
  const Eigen::VectorXd moved = V.transpose() * (value - prior_value).cwiseProduct(inverse);
  Eigen::VectorXd root_gained = Eigen::VectorXd::Zero(n), centre = moved;
  for (Eigen::Index i = 0; i < n; ++i) {
    const double information = 1.0 / eigen.eigenvalues()[i], gained = information - 1.0;
    if (gained <= kNothing) continue;
    root_gained[i] = std::sqrt(gained);
    // A direction that the flight hardly shows can move the estimate by so much; what moves it
    // further is the shape of the problem, not the data.
    const double most = gained < 1.0 ? kSigmas * root_gained[i] : std::abs(moved[i]);
    centre[i] = information / gained * std::clamp(moved[i], -most, most);
  }
  const Eigen::MatrixXd root =
      root_gained.cwiseQuotient(InflationAlong(eigen, inflation)).asDiagonal() * V.transpose() *
      inverse.asDiagonal();
  const Eigen::VectorXd z = prior_value + prior_sigma.cwiseProduct(V * centre);
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(root);
  factor->root = qr.matrixQR().triangularView<Eigen::Upper>();
  factor->rhs = factor->root * z;
  factor->value = value;
  factor->sigma = covariance.diagonal().cwiseSqrt().cwiseProduct(inflation);
  factor->prior_value = prior_value;
  factor->prior_sigma = prior_sigma;
}

// root x - rhs is noise of covariance 1 + root e eᵀ rootᵀ then; it is whitened anew.
void AddErrorToFactor(const Eigen::VectorXd& error, FlightFactor* factor) {
  const Eigen::Index n = factor->size();
  const Eigen::VectorXd seen = factor->root * error;
  const Eigen::LLT<Eigen::MatrixXd> llt(Eigen::MatrixXd::Identity(n, n) + seen * seen.transpose());
  llt.matrixL().solveInPlace(factor->root);
  llt.matrixL().solveInPlace(factor->rhs);
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(factor->root);
  factor->rhs = qr.householderQ().transpose() * factor->rhs;
  factor->root = qr.matrixQR().triangularView<Eigen::Upper>();
  factor->sigma = (factor->sigma.cwiseAbs2() + error.cwiseAbs2()).cwiseSqrt();
}

FlightFactor FactorOf(const DynamicModel& model, const ParameterSet& estimate,
                      const Eigen::VectorXd& inflation, const std::vector<std::string>& own) {
  const auto is_own = [&](const ModelParameter& p) {
    return BelongsToFlight(model, p) || std::count(own.begin(), own.end(), p.full_name) > 0 ||
           std::count(own.begin(), own.end(), p.effect) > 0;
  };
  FlightFactor factor;
  factor.estimate = estimate;
  const auto flight = estimate.provenance.find("flight");
  if (flight != estimate.provenance.end()) factor.flight = flight->second;
  std::vector<Eigen::Index> at;
  std::vector<double> value, prior_value, prior_sigma;
  for (const ModelParameter& p : model.parameters()) {
    const ParameterEstimate* found = estimate.Find(p.full_name);
    if (!p.estimated || is_own(p) || found == nullptr || !found->estimated) continue;
    at.push_back(found - estimate.parameters.data());
    factor.names.push_back(p.full_name);
    factor.units.push_back(p.spec.unit);
    value.push_back(found->value);
    prior_value.push_back(p.spec.prior_value);
    prior_sigma.push_back(p.spec.prior_sigma);
  }
  const auto vector = [](const std::vector<double>& of) {
    return Eigen::VectorXd::Map(of.data(), static_cast<Eigen::Index>(of.size())).eval();
  };
  factor.linearized_at = vector(value);
  const Eigen::VectorXd widened = inflation(at);
  const Eigen::VectorXd narrow = widened.cwiseInverse();
  SetLikelihood(vector(value),
                narrow.asDiagonal() * estimate.covariance(at, at) * narrow.asDiagonal(), widened,
                vector(prior_value), vector(prior_sigma), &factor);
  return factor;
}

}  // namespace odmc
