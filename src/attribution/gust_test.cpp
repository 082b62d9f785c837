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

/// A first-order process x of standard deviation `sigma` and correlation time `time_constant_s`,
/// seen as H_i x in white noise, by a Kalman filter.
/// @param states estimates from all samples up to and with each one, may be null
/// @returns the residual's log-likelihood
double Follow(const ThinnedFlight& flight, const ResidualModel::Wrenches& y,
              const std::vector<Matrix3d>& H, const Vector3d& noise_variance, double sigma,
              double time_constant_s, std::vector<Vector3d>* states = nullptr) {
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
    if (states != nullptr) states->push_back(x);
  }
  return sum;
}

/// How the force answers wind, at every sample.
std::vector<Matrix3d> Response(int n, const std::array<ResidualModel::Wrenches, 3>& d_wind) {
  std::vector<Matrix3d> H(n);
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < 3; ++k) H[i].col(k) = d_wind[k].row(i).head<3>().transpose();
  }
  return H;
}

/// Variance of the residual's quick part: what is left of its variance without the covariance of
/// samples that share no filter window. (Not from differences of neighbours: the noise of a
/// differentiated measurement turns its sign from one to the next.)
Vector3d QuickVariance(const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                       Vector3d* total) {
  constexpr int kFirstLag = 3, kLastLag = 6;  // of 40 ms; the filter's window is 0.1 s
  Vector3d slow = Vector3d::Zero();
  total->setZero();
  int pairs = 0, run = 0;
  for (int i = 0; i < flight.size(); ++i) {
    run = flight.next(i) ? run + 1 : 0;
    const Vector3d y = residual.row(i).head<3>();
    *total += y.cwiseAbs2() / flight.size();
    for (int lag = kFirstLag; lag <= std::min(run, kLastLag); ++lag, ++pairs) {
      slow += y.cwiseProduct(residual.row(i - lag).head<3>().transpose());
    }
  }
  slow = (slow / std::max(1, pairs)).cwiseMax(0.0);
  return (*total - slow).cwiseMax(0.05 * *total).cwiseMax(1e-12);
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
      const double likelihood = Follow(flight, y, H, noise, sigma, time_constant_s);
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
  const std::vector<Matrix3d> wind = Response(n, d_wind);
  std::vector<Matrix3d> world(n), body(n, Matrix3d::Identity());
  double response = 0.0;
  for (int i = 0; i < n; ++i) {
    world[i] = flight.sample(i).R_WS.transpose();
    response += wind[i].squaredNorm() / (3.0 * n);
  }
  response = std::sqrt(response);
  if (!(response > 0.0)) return test;
  Vector3d total;
  const Vector3d quick = QuickVariance(flight, residual, &total);
  const double natural = std::sqrt(std::max(1e-12, (total - quick).cwiseMax(0.0).mean()));
  const Best gust = Search(flight, residual, wind, quick, natural / response);
  const Best free_world = Search(flight, residual, world, quick, natural);
  const Best free_body = Search(flight, residual, body, quick, natural);
  const double none = Follow(flight, residual, body, total, 0.0, 1.0);
  std::vector<Vector3d> states;
  Follow(flight, residual, wind, quick, gust.sigma, gust.time_constant_s, &states);
  Matrix3d moment = Matrix3d::Zero();
  for (const Vector3d& x : states) moment += x * x.transpose();
  const Vector3d spread = Eigen::SelfAdjointEigenSolver<Matrix3d>(moment).eigenvalues();
  test.one_sidedness = spread.sum() > 0.0 ? spread[2] / spread.sum() : 1.0;
  test.gain = gust.likelihood - none;
  test.over_others = gust.likelihood - std::max(free_world.likelihood, free_body.likelihood);
  test.sigma_m_s = gust.sigma;
  test.time_constant_s = gust.time_constant_s;
  return test;
}

std::vector<Vector3d> PredictGusts(const ThinnedFlight& flight,
                                   const ResidualModel::Wrenches& residual,
                                   const std::array<ResidualModel::Wrenches, 3>& d_wind,
                                   double sigma_m_s, double time_constant_s, int ahead) {
  const int n = flight.size();
  std::vector<Vector3d> states, predicted(n, Vector3d::Zero());
  Vector3d total;
  const Vector3d quick = QuickVariance(flight, residual, &total);
  Follow(flight, residual, Response(n, d_wind), quick, sigma_m_s, time_constant_s, &states);
  for (int i = ahead; i < n; ++i) {
    const double dt = flight.sample(i).t_s - flight.sample(i - ahead).t_s;
    predicted[i] = std::exp(-dt / time_constant_s) * states[i - ahead];
  }
  return predicted;
}

}  // namespace odmc
