#include "odmc/fleet/random_effects.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr int kMostIterations = 500;
constexpr double kSettled = 1e-4;         // nats of a step of the scatter
constexpr double kLeastVariance = 1e-14;  // in units of the priors' variances
constexpr double kFree = 1e4;             // variance of what is a flight's own, in the same
// Rate of the prior of a scatter, exponential in units of the parameter's prior sigma. That sigma
// is by what vehicles differ; one vehicle's flights differ by half of it once in a hundred
// parameters. Few flights would else explain what they disagree on by scatter of all that acts
// alike, and the mean of each would go to its prior, away from what they agree on.
const double kScatterRate = -2.0 * std::log(0.01);

/// One flight in units of the priors' sigmas, from the priors' centres.
struct Scaled {
  MatrixXd root;          // n×n
  VectorXd rhs;           // n×1
  MatrixXd design;        // n×q
  VectorXd own_variance;  // n×1: kFree for outliers, else 0
};

std::vector<Scaled> Scale(const std::vector<FlightFactor>& factors, const FleetModel& model) {
  const FlightFactor& first = factors.front();
  const Index n = first.size();
  const auto q = n + static_cast<Index>(model.changes.size());
  std::vector<Scaled> all;
  for (size_t i = 0; i < factors.size(); ++i) {
    const FlightFactor& f = factors[i];
    if (f.names != first.names) {
      throw std::invalid_argument(f.flight + ": has other parameters than " + first.flight);
    }
    Scaled s;
    s.root = f.root * first.prior_sigma.asDiagonal();
    s.rhs = f.rhs - f.root * first.prior_value;
    s.design = MatrixXd::Zero(n, q);
    s.design.leftCols(n).setIdentity();
    for (size_t c = 0; c < model.changes.size(); ++c) {
      s.design(model.changes[c].parameter, n + static_cast<Index>(c)) = model.changes[c].by[i];
    }
    s.own_variance = VectorXd::Zero(n);
    all.push_back(std::move(s));
  }
  for (const auto& [flight, parameter] : model.outliers) {
    all[static_cast<size_t>(flight)].own_variance[parameter] = kFree;
  }
  return all;
}

/// W D, where D is the identity beside the columns of changes.
MatrixXd TimesDesign(const MatrixXd& weight, const MatrixXd& design) {
  const Index n = design.rows(), changes = design.cols() - n;
  MatrixXd seen(n, design.cols());
  seen.leftCols(n) = weight;
  if (changes > 0) seen.rightCols(changes).noalias() = weight * design.rightCols(changes);
  return seen;
}

/// All of one evaluation at given variances.
struct LikelihoodAt {
  VectorXd beta;
  MatrixXd covariance;
  std::vector<MatrixXd> weight;  // n×n, Rᵀ V⁻¹ R
  std::vector<VectorXd> pull;    // n×1, Rᵀ V⁻¹ (rhs - R D beta)
  double log_likelihood = 0.0;
};

LikelihoodAt Evaluate(const std::vector<Scaled>& flights, const VectorXd& variance) {
  const Index n = variance.size(), q = flights.front().design.cols();
  LikelihoodAt e;
  MatrixXd information = MatrixXd::Identity(q, q);  // the prior's
  VectorXd b = VectorXd::Zero(q);
  double log_determinant = 0.0;
  std::vector<VectorXd> weighted;  // Rᵀ V⁻¹ rhs
  std::vector<double> squares;
  for (const Scaled& f : flights) {
    const VectorXd t = variance + f.own_variance;
    MatrixXd V = f.root * t.asDiagonal() * f.root.transpose();
    V.diagonal().array() += 1.0;
    const Eigen::LLT<MatrixXd> llt(V);
    MatrixXd both(n, n + 1);
    both << f.root, f.rhs;
    llt.matrixL().solveInPlace(both);
    log_determinant += 2.0 * MatrixXd(llt.matrixL()).diagonal().array().log().sum();
    const auto R = both.leftCols(n);
    e.weight.push_back(R.transpose() * R);
    weighted.push_back(R.transpose() * both.col(n));
    squares.push_back(both.col(n).squaredNorm());
    const MatrixXd seen = TimesDesign(e.weight.back(), f.design);
    information.topRows(n) += seen;
    b.head(n) += weighted.back();
    if (q == n) continue;
    const auto changes = f.design.rightCols(q - n).transpose();
    information.bottomRows(q - n).noalias() += changes * seen;
    b.tail(q - n).noalias() += changes * weighted.back();
  }
  const Eigen::LLT<MatrixXd> llt(information);
  e.beta = llt.solve(b);
  e.covariance = llt.solve(MatrixXd::Identity(q, q));
  log_determinant += 2.0 * MatrixXd(llt.matrixL()).diagonal().array().log().sum();
  double chi_squared = e.beta.squaredNorm();
  for (size_t i = 0; i < flights.size(); ++i) {
    const VectorXd mean = flights[i].design * e.beta;
    e.pull.push_back(weighted[i] - e.weight[i] * mean);
    chi_squared += squares[i] - mean.dot(weighted[i] + e.pull.back());
  }
  e.log_likelihood = -0.5 * (log_determinant + chi_squared);
  return e;
}

/// Per parameter: squares of the pulls, and what noise makes of them (the traces).
struct Balance {
  VectorXd squares, expected;
};

Balance BalanceOf(const std::vector<Scaled>& flights, const LikelihoodAt& e, Index n) {
  Balance balance = {VectorXd::Zero(n), VectorXd::Zero(n)};
  for (size_t i = 0; i < flights.size(); ++i) {
    const MatrixXd seen = TimesDesign(e.weight[i], flights[i].design);
    const MatrixXd spread = seen * e.covariance;
    for (Index k = 0; k < n; ++k) {
      if (flights[i].own_variance[k] > 0.0) continue;
      balance.squares[k] += e.pull[i][k] * e.pull[i][k];
      balance.expected[k] += e.weight[i](k, k) - spread.row(k).dot(seen.row(k));
    }
  }
  return balance;
}

/// A start for the variances: what the flights' own values scatter by, those that show something.
VectorXd FirstVariance(const std::vector<FlightFactor>& factors) {
  const FlightFactor& first = factors.front();
  VectorXd variance(first.size());
  for (int k = 0; k < first.size(); ++k) {
    double weights = 0.0, mean = 0.0, squares = 0.0;
    for (const FlightFactor& f : factors) {
      const double w = std::pow(f.sigma[k], -2);
      weights += w;
      mean += w * f.value[k];
    }
    mean /= weights;
    for (const FlightFactor& f : factors) {
      squares += std::pow(f.sigma[k], -2) * std::pow(f.value[k] - mean, 2);
    }
    variance[k] = std::clamp(squares / weights / std::pow(first.prior_sigma[k], 2), 1e-8, 1.0);
  }
  return variance;
}

VectorXd DegreesOfFreedom(const std::vector<Scaled>& flights, const LikelihoodAt& e,
                          const MatrixXd& variance_covariance) {
  const Index n = variance_covariance.rows(), q = e.beta.size();
  // How the covariance of beta follows each variance.
  MatrixXd gradient = MatrixXd::Zero(q, n);
  for (size_t i = 0; i < flights.size(); ++i) {
    const MatrixXd reach = e.covariance * flights[i].design.transpose() * e.weight[i];  // q×n
    for (Index k = 0; k < n; ++k) {
      if (flights[i].own_variance[k] == 0.0) gradient.col(k) += reach.col(k).cwiseAbs2();
    }
  }
  VectorXd freedom(q);
  for (Index a = 0; a < q; ++a) {
    const double variance = gradient.row(a) * variance_covariance * gradient.row(a).transpose();
    freedom[a] = variance > 0.0 ? 2.0 * std::pow(e.covariance(a, a), 2) / variance : kInfinity;
  }
  return freedom;
}

/// Logarithm of the scatter's prior.
double LogPrior(const VectorXd& variance) { return -kScatterRate * variance.cwiseSqrt().sum(); }

/// Moves the variances, from where they are, to those that balance squares, noise and prior (whose
/// tangent is taken: it bounds the root from above, so that no step makes it worse).
/// @param e at `variance`, follows it
/// @returns the number of steps
int FitVariance(const std::vector<Scaled>& flights, VectorXd* variance, LikelihoodAt* e) {
  const Index n = variance->size();
  int iterations = 0;
  for (; iterations < kMostIterations; ++iterations) {
    const Balance balance = BalanceOf(flights, *e, n);
    VectorXd next = *variance;
    for (Index k = 0; k < n; ++k) {
      if (balance.expected[k] <= 0.0 || (*variance)[k] <= kLeastVariance) continue;
      const double expected = balance.expected[k] + kScatterRate / std::sqrt((*variance)[k]);
      next[k] = std::clamp((*variance)[k] * std::sqrt(balance.squares[k] / expected),
                           kLeastVariance, 1.0);
    }
    LikelihoodAt better = Evaluate(flights, next);
    const double gained =
        better.log_likelihood + LogPrior(next) - e->log_likelihood - LogPrior(*variance);
    if (gained < 0.0 && iterations > 0) break;
    *variance = std::move(next);
    *e = std::move(better);
    if (std::abs(gained) < kSettled) break;
  }
  return iterations;
}

/// Fisher's information of the variances.
MatrixXd VarianceInformation(const std::vector<Scaled>& flights, const LikelihoodAt& e, Index n) {
  MatrixXd information = MatrixXd::Zero(n, n);
  for (size_t i = 0; i < flights.size(); ++i) {
    MatrixXd seen = e.weight[i] - e.weight[i] * flights[i].design * e.covariance *
                                      flights[i].design.transpose() * e.weight[i];
    for (Index k = 0; k < n; ++k) {
      if (flights[i].own_variance[k] == 0.0) continue;
      seen.row(k).setZero();
      seen.col(k).setZero();
    }
    information += 0.5 * seen.cwiseAbs2();
  }
  return information;
}

/// Sigma of a root, from its square and the square's sigma; where the square is small beside that,
/// the root of its sigma.
double SigmaOfRoot(double square, double sigma) {
  const double root = std::sqrt(std::max(0.0, square));
  return std::min(sigma / std::max(2.0 * root, 1e-300), std::sqrt(sigma));
}

/// Fills in means with changes, from units of the priors' sigmas to the parameters' own.
void SetMeans(const LikelihoodAt& e, const FlightFactor& first, const FleetModel& model,
              RandomEffects* fit) {
  const Index n = first.size(), q = e.beta.size();
  VectorXd scale(q);
  scale.head(n) = first.prior_sigma;
  for (Index c = n; c < q; ++c) {
    scale[c] = first.prior_sigma[model.changes[static_cast<size_t>(c - n)].parameter];
  }
  fit->beta = e.beta.cwiseProduct(scale);
  fit->beta.head(n) += first.prior_value;
  fit->covariance = scale.asDiagonal() * e.covariance * scale.asDiagonal();
}

/// The same of what each flight has for itself.
void SetFlights(const std::vector<Scaled>& flights, const LikelihoodAt& e, const VectorXd& variance,
                const FlightFactor& first, RandomEffects* fit) {
  for (size_t i = 0; i < flights.size(); ++i) {
    const VectorXd own = (variance + flights[i].own_variance).cwiseProduct(e.pull[i]);
    fit->own.push_back(own.cwiseProduct(first.prior_sigma));
    const VectorXd mean = flights[i].design * e.beta;
    fit->of_flight.push_back(first.prior_value + (mean + own).cwiseProduct(first.prior_sigma));
  }
}

}  // namespace

RandomEffects FitRandomEffects(const std::vector<FlightFactor>& factors, const FleetModel& model,
                               const VectorXd* known_scatter) {
  const FlightFactor& first = factors.front();
  const Index n = first.size();
  const std::vector<Scaled> flights = Scale(factors, model);
  VectorXd variance = known_scatter != nullptr
                          ? known_scatter->cwiseQuotient(first.prior_sigma).cwiseAbs2().eval()
                          : FirstVariance(factors);
  if (factors.size() < 2) variance.setZero();
  LikelihoodAt e = Evaluate(flights, variance);
  RandomEffects fit;
  const bool fits = known_scatter == nullptr && factors.size() > 1;
  if (fits) fit.iterations = FitVariance(flights, &variance, &e);

  const MatrixXd information = VarianceInformation(flights, e, n);
  MatrixXd variance_covariance = MatrixXd::Zero(n, n);
  VectorXd variance_sigma = VectorXd::Constant(n, kInfinity);
  for (Index k = 0; k < n; ++k) {
    if (information(k, k) <= 0.0 || !fits) continue;
    variance_covariance(k, k) = 1.0 / information(k, k);
    variance_sigma[k] = std::sqrt(variance_covariance(k, k));
  }
  fit.degrees_of_freedom = DegreesOfFreedom(flights, e, variance_covariance);
  SetMeans(e, first, model, &fit);
  fit.scatter = variance.cwiseMax(0.0).cwiseSqrt().cwiseProduct(first.prior_sigma);
  fit.scatter_sigma.resize(n);
  for (Index k = 0; k < n; ++k) {
    fit.scatter_sigma[k] = first.prior_sigma[k] * SigmaOfRoot(variance[k], variance_sigma[k]);
  }
  SetFlights(flights, e, variance, first, &fit);
  fit.log_likelihood = e.log_likelihood;
  return fit;
}

std::vector<VectorXd> ExpectedOfLeftOut(const std::vector<FlightFactor>& factors,
                                        const FleetModel& model, const RandomEffects& fit) {
  const FlightFactor& first = factors.front();
  const std::vector<Scaled> flights = Scale(factors, model);
  const Index q = fit.beta.size();
  const VectorXd variance = fit.scatter.cwiseQuotient(first.prior_sigma).cwiseAbs2();
  std::vector<MatrixXd> information;
  std::vector<VectorXd> pull;
  MatrixXd all = MatrixXd::Identity(q, q);
  VectorXd b = VectorXd::Zero(q);
  for (const Scaled& f : flights) {
    MatrixXd V = f.root * (variance + f.own_variance).asDiagonal() * f.root.transpose();
    V.diagonal().array() += 1.0;
    const Eigen::LLT<MatrixXd> llt(V);
    const MatrixXd seen = f.root * f.design;
    information.push_back(seen.transpose() * llt.solve(seen));
    pull.push_back(seen.transpose() * llt.solve(f.rhs));
    all += information.back();
    b += pull.back();
  }
  std::vector<VectorXd> expected;
  for (size_t i = 0; i < flights.size(); ++i) {
    const MatrixXd rest = all - information[i];
    const VectorXd beta = rest.ldlt().solve(b - pull[i]);
    expected.push_back(first.prior_value +
                       (flights[i].design * beta).cwiseProduct(first.prior_sigma));
  }
  return expected;
}

std::vector<FlightDeparture> DeparturesOf(int parameter, const std::vector<FlightFactor>& factors,
                                          const FleetModel& model, const RandomEffects& fit) {
  const FlightFactor& first = factors.front();
  const std::vector<Scaled> flights = Scale(factors, model);
  const Index n = first.size();
  const double unit = first.prior_sigma[parameter];
  VectorXd scaled_beta = fit.beta;
  scaled_beta.head(n) -= first.prior_value;
  for (Index c = 0; c < scaled_beta.size(); ++c) {
    const int of =
        c < n ? static_cast<int>(c) : model.changes[static_cast<size_t>(c - n)].parameter;
    scaled_beta[c] /= first.prior_sigma[of];
  }
  std::vector<FlightDeparture> departures;
  for (const Scaled& f : flights) {
    VectorXd t = fit.scatter.cwiseQuotient(first.prior_sigma).cwiseAbs2() + f.own_variance;
    t[parameter] = 0.0;
    MatrixXd V = f.root * t.asDiagonal() * f.root.transpose();
    V.diagonal().array() += 1.0;
    const Eigen::LLT<MatrixXd> llt(V);
    const VectorXd column = f.root.col(parameter);
    const VectorXd weighted = llt.solve(column);
    const double information = weighted.dot(column);
    FlightDeparture d = {0.0, kInfinity};
    constexpr double kLeast = 0.1;  // of the prior's: what shows less is not looked at
    if (information > kLeast) {
      d.value = unit * weighted.dot(f.rhs - f.root * (f.design * scaled_beta)) / information;
      d.sigma = unit / std::sqrt(information);
    }
    departures.push_back(d);
  }
  return departures;
}

}  // namespace odmc
