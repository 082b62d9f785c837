#include "odmc/attribution/gust_test.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kTimeConstants_s[] = {0.3, 0.7, 1.5, 3.0, 6.0};
constexpr double kSizes[] = {0.35, 0.6, 1.0, 1.6, 2.5};

/// Log-likelihood of the residual as white noise plus H_i x, x a first-order process of standard
/// deviation `sigma` and correlation time `time_constant_s`.
double Likelihood(const ThinnedFlight& flight, const ResidualModel::Wrenches& y,
                  const std::vector<Matrix3d>& H, const Vector3d& noise_variance, double sigma,
                  double time_constant_s, Matrix3d* second_moment = nullptr) {
  Vector3d x = Vector3d::Zero();
  Matrix3d P = sigma * sigma * Matrix3d::Identity();
  const Matrix3d noise = noise_variance.asDiagonal();
  double sum = 0.0;
  for (int i = 0; i < flight.size(); ++i) {
    const double dt = i == 0 ? 0.0 : std::max(0.0, flight.sample(i).t_s - flight.sample(i - 1).t_s);
    const double decay = std::exp(-dt / time_constant_s);
    x *= decay;
    P = decay * decay * P + (1.0 - decay * decay) * sigma * sigma * Matrix3d::Identity();
    const Vector3d e = y.row(i).head<3>().transpose() - H[i] * x;
    const Matrix3d S = H[i] * P * H[i].transpose() + noise;
    const Matrix3d S_inverse = S.inverse();
    sum -= 0.5 * (e.dot(S_inverse * e) + std::log(S.determinant()));
    const Matrix3d K = P * H[i].transpose() * S_inverse;
    x += K * e;
    P = ((Matrix3d::Identity() - K * H[i]) * P).eval();
    if (second_moment != nullptr) *second_moment += x * x.transpose();
  }
  return sum;
}

struct Best {
  double likelihood = -std::numeric_limits<double>::infinity();
  double sigma = 0.0, time_constant_s = 0.0;
};

Best Search(const ThinnedFlight& flight, const ResidualModel::Wrenches& y,
            const std::vector<Matrix3d>& H, const Vector3d& noise, double natural) {
  Best best;
  for (const double time_constant_s : kTimeConstants_s) {
    for (const double size : kSizes) {
      const double sigma = size * natural;
      const double likelihood = Likelihood(flight, y, H, noise, sigma, time_constant_s);
      if (likelihood > best.likelihood) best = {likelihood, sigma, time_constant_s};
    }
  }
  return best;
}

}  // namespace

GustTest TestGusts(const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                   const std::array<ResidualModel::Wrenches, 3>& d_wind) {
  GustTest test;
  const int n = flight.size();
  if (n < 100) return test;
  std::vector<Matrix3d> wind(n), world(n), body(n, Matrix3d::Identity());
  double response = 0.0;
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < 3; ++k) wind[i].col(k) = d_wind[k].row(i).head<3>().transpose();
    world[i] = flight.sample(i).R_WS.transpose();
    response += wind[i].squaredNorm() / (3.0 * n);
  }
  response = std::sqrt(response);
  if (!(response > 0.0)) return test;
  // White part: from differences of neighbours, where slow forces cancel.
  Vector3d white = Vector3d::Zero(), total = Vector3d::Zero();
  int pairs = 0;
  for (int i = 0; i < n; ++i) {
    total += residual.row(i).head<3>().transpose().cwiseAbs2() / n;
    if (!flight.next(i)) continue;
    white += 0.5 * (residual.row(i) - residual.row(i - 1)).head<3>().transpose().cwiseAbs2();
    ++pairs;
  }
  white = (white / std::max(1, pairs)).cwiseMax(0.05 * total).cwiseMax(1e-12);
  const double natural = std::sqrt(std::max(1e-12, (total - white).cwiseMax(0.0).mean()));
  const Best gust = Search(flight, residual, wind, white, natural / response);
  const Best free_world = Search(flight, residual, world, white, natural);
  const Best free_body = Search(flight, residual, body, white, natural);
  const double none = Likelihood(flight, residual, body, total, 0.0, 1.0);
  Matrix3d moment = Matrix3d::Zero();
  Likelihood(flight, residual, wind, white, gust.sigma, gust.time_constant_s, &moment);
  const Vector3d spread = Eigen::SelfAdjointEigenSolver<Matrix3d>(moment).eigenvalues();
  test.one_sidedness = spread.sum() > 0.0 ? spread[2] / spread.sum() : 1.0;
  test.gain = gust.likelihood - none;
  test.over_others = gust.likelihood - std::max(free_world.likelihood, free_body.likelihood);
  test.sigma_m_s = gust.sigma;
  test.time_constant_s = gust.time_constant_s;
  return test;
}

}  // namespace odmc
