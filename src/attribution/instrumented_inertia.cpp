#include "odmc/attribution/instrumented_inertia.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <cmath>
#include <map>
#include <vector>

#include "odmc/estimator/gates.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

// Of samples of 40 ms: no closer than the filter's window of 0.1 s, no further than a manoeuvre.
constexpr int kLags[] = {-6, -5, -4, -3, 3, 4, 5, 6};
constexpr int kReach = 6;
constexpr double kLeastF = 10.0;
constexpr double kBlock_s = 1.0;

}  // namespace

std::array<std::optional<InertiaEstimate>, 3> InstrumentedInertia(const ThinnedFlight& flight,
                                                                  const Vehicle& vehicle,
                                                                  double k_f, double k_m) {
  // Samples with neighbours on both sides, none of them held out.
  std::vector<int> rows;
  int run = 0;
  for (int i = 0; i < flight.size(); ++i) {
    run = flight.held_out(i) ? 0 : flight.next(i) && run > 0 ? run + 1 : 1;
    if (run > 2 * kReach) rows.push_back(i - kReach);
  }
  std::array<std::optional<InertiaEstimate>, 3> result;
  const auto n = static_cast<Index>(rows.size());
  constexpr Index kOwn = 8;
  const Index instruments = 2 * static_cast<Index>(std::size(kLags));
  if (n < 4 * (instruments + kOwn)) return result;

  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  const auto acceleration = [&](int i) {
    return Eigen::Vector3d(R_BS * flight.sample(i).w_dot_S);
  };
  const auto torque = [&](int i) {
    const Eigen::Vector3d direction =
        RotorTorqueDirection(vehicle, flight.sample(i).rotors.speed_squared);
    return Eigen::Vector3d(k_f * direction.x(), k_f * direction.y(), k_m * direction.z());
  };
  for (int axis = 0; axis < 3; ++axis) {
    const int next = (axis + 1) % 3, last = (axis + 2) % 3;
    MatrixXd others(n, kOwn), far(n, instruments);
    VectorXd a(n), tau(n);
    for (Index k = 0; k < n; ++k) {
      const int i = rows[static_cast<size_t>(k)];
      const FilteredMotion& s = flight.sample(i);
      const Eigen::Vector3d w = R_BS * s.w_S, v = R_BS * (s.R_WS.transpose() * s.v_WS);
      const double thrust = k_f * s.rotors.speed_squared.sum();
      a[k] = acceleration(i)[axis];
      tau[k] = torque(i)[axis];
      others.row(k) << 1.0, w[axis], thrust, w[next] * w[last], v.x(), v.y(), v.z(),
          s.rotors.acceleration.size() > 0 ? s.rotors.acceleration.sum() : 0.0;
      Index at = 0;
      for (const int lag : kLags) {
        far(k, at++) = acceleration(i + lag)[axis];
        far(k, at++) = torque(i + lag)[axis];
      }
    }
    // What the other regressors say is taken out of all.
    for (Index c = 0; c < others.cols(); ++c) {
      const double size = others.col(c).norm();
      if (size > 0.0) others.col(c) /= size;
    }
    const Eigen::ColPivHouseholderQR<MatrixXd> qr(others);
    const MatrixXd Q = MatrixXd(qr.householderQ() * MatrixXd::Identity(n, qr.rank()));
    const auto without = [&Q](auto x) { return MatrixXd(x - Q * (Q.transpose() * x)); };
    const VectorXd a_own = without(a), tau_own = without(tau);
    const MatrixXd z = without(far);
    const VectorXd seen = z * z.colPivHouseholderQr().solve(a_own);
    const double explained = seen.squaredNorm(),
                 rest = std::max(a_own.squaredNorm() - explained, 1e-300);
    const double F = explained / static_cast<double>(instruments) /
                     (rest / static_cast<double>(n - instruments - kOwn));
    if (F < kLeastF) continue;
    const double bread = seen.dot(a_own);
    if (!(bread > 0.0)) continue;
    const double inertia = seen.dot(tau_own) / bread;
    std::map<int, double> blocks;
    for (Index k = 0; k < n; ++k) {
      const double t_s = flight.sample(rows[static_cast<size_t>(k)]).t_s;
      blocks[static_cast<int>(t_s / kBlock_s)] += seen[k] * (tau_own[k] - inertia * a_own[k]);
    }
    double meat = 0.0;
    for (const auto& block : blocks) meat += block.second * block.second;
    if (inertia > 0.0) result[axis] = InertiaEstimate{inertia, std::sqrt(meat) / bread};
  }
  return result;
}

}  // namespace odmc
