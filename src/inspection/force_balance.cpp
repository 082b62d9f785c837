#include "odmc/inspection/force_balance.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "motion_windows.h"
#include "odmc/math/statistics.h"

namespace odmc {
namespace {

using Eigen::Matrix3Xd;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kCalm_rad_s = 3.0;  // as CheckThrust(): sensors beside the centre feel w² r
constexpr int kLeastWindows = 4 * kWindowsPerBlock;
constexpr int kIterations = 8;
constexpr double kDegrees = 4.0;  // of Student's t over a block
// Priors: a vehicle that falls at 10 m/s by drag has 1 m/s² per m/s; thrust grows by half at 10
// m/s.
constexpr double kDrag = 1.0, kThrustOfSpeed = 0.05;
constexpr double kUsualNoise = 0.3;  // of a window [m/s²], beside these priors
constexpr int kRegressors = 5;       // sum of squares, velocity, squared velocity

struct Rows {
  MatrixXd x;    // windows×5
  MatrixXd y;    // windows×3: specific force in S
  double scale;  // of the sum of squares, so that the regressor is near one
};

Rows RowsOf(const MotionWindows& w, double gravity_m_s2) {
  Rows rows{MatrixXd(w.size(), kRegressors), MatrixXd(w.size(), 3), 0.0};
  const VectorXd sums = w.rotors.colwise().sum().transpose();
  rows.scale = Median(std::vector<double>(sums.data(), sums.data() + sums.size()));
  for (int i = 0; i < w.size(); ++i) {
    const Eigen::Matrix3d R_SW = w.q_WS[static_cast<size_t>(i)].conjugate().toRotationMatrix();
    const Vector3d v_S = R_SW * Vector3d(w.displacement_m_s.col(i));
    const Vector3d up_W = gravity_m_s2 * Vector3d::UnitZ();
    rows.x.row(i) << sums[i] / rows.scale, v_S.transpose(), v_S.squaredNorm();
    rows.y.row(i) = (R_SW * (Vector3d(w.acceleration_W.col(i)) + up_W)).transpose();
  }
  return rows;
}

/// Least squares with a weight for every block of windows.
class Fit {
 public:
  explicit Fit(const Rows& rows)
      : rows_(rows), blocks_((rows.x.rows() - 1) / kWindowsPerBlock + 1) {
    weight_ = VectorXd::Ones(blocks_);
    VectorXd precision = VectorXd::Zero(kRegressors);
    precision.segment<3>(1).setConstant(std::pow(kUsualNoise / kDrag, 2));
    precision[4] = std::pow(kUsualNoise / kThrustOfSpeed, 2);
    prior_ = precision.asDiagonal();
    for (int i = 0; i < kIterations; ++i) {
      Solve();
      Weigh();
    }
  }

  /// Force per unit of the first regressor, and the rest; 5×3.
  const MatrixXd& coefficients() const { return coefficients_; }

  /// Variances of the first coefficient's three components, by the scatter of blocks.
  Vector3d Variances() const {
    const MatrixXd inverse = normal_.ldlt().solve(MatrixXd::Identity(kRegressors, kRegressors));
    const double degrees = std::max(1.0, static_cast<double>(blocks_ - kRegressors));
    Vector3d variances = Vector3d::Zero();
    for (Eigen::Index b = 0; b < blocks_; ++b) {
      const MatrixXd score = weight_[b] * (inverse * XOf(b).transpose() * LeftOf(b));
      variances += score.row(0).transpose().cwiseAbs2();
    }
    return variances * static_cast<double>(blocks_) / degrees;
  }

 private:
  Eigen::Index SizeOf(Eigen::Index b) const {
    return std::min<Eigen::Index>(kWindowsPerBlock, rows_.x.rows() - b * kWindowsPerBlock);
  }
  MatrixXd XOf(Eigen::Index b) const { return rows_.x.middleRows(b * kWindowsPerBlock, SizeOf(b)); }
  MatrixXd YOf(Eigen::Index b) const { return rows_.y.middleRows(b * kWindowsPerBlock, SizeOf(b)); }
  MatrixXd LeftOf(Eigen::Index b) const { return YOf(b) - XOf(b) * coefficients_; }

  void Solve() {
    normal_ = prior_;
    MatrixXd right = MatrixXd::Zero(kRegressors, 3);
    for (Eigen::Index b = 0; b < blocks_; ++b) {
      normal_ += weight_[b] * XOf(b).transpose() * XOf(b);
      right += weight_[b] * XOf(b).transpose() * YOf(b);
    }
    coefficients_ = normal_.ldlt().solve(right);
  }

  void Weigh() {
    std::vector<double> squares;
    for (Eigen::Index b = 0; b < blocks_; ++b) {
      squares.push_back(LeftOf(b).squaredNorm() / static_cast<double>(SizeOf(b)));
    }
    const double typical = Median(squares) + 1e-12;
    for (Eigen::Index b = 0; b < blocks_; ++b) {
      weight_[b] = (kDegrees + 1.0) / (kDegrees + squares[static_cast<size_t>(b)] / typical);
    }
  }

  const Rows& rows_;
  Eigen::Index blocks_;
  VectorXd weight_;
  MatrixXd prior_, normal_, coefficients_;
};

}  // namespace

std::optional<ForceBalance> BalanceForces(const MotionSignals& signals, double gravity_m_s2,
                                          const std::vector<bool>& flight) {
  if (!signals.rotors) return std::nullopt;
  const MotionWindows w = CalmOnes(WindowsOf(signals, flight), kCalm_rad_s);
  if (w.size() < kLeastWindows) return std::nullopt;
  const Rows rows = RowsOf(w, gravity_m_s2);
  if (!(rows.scale > 0.0)) return std::nullopt;
  const Fit fit(rows);
  const Vector3d thrust = fit.coefficients().row(0).transpose();  // at the typical speeds
  const double size = thrust.norm();
  if (!(size > 0.0) || !std::isfinite(size)) return std::nullopt;
  ForceBalance balance;
  balance.windows = w.size();
  balance.k_f_over_mass = size / rows.scale;
  balance.thrust_axis_S = thrust / size;
  const Vector3d variances = fit.Variances();
  const Vector3d along = balance.thrust_axis_S.cwiseAbs2();
  balance.relative_sigma = std::sqrt(along.dot(variances)) / size;
  balance.lean_rad = std::acos(std::clamp(balance.thrust_axis_S.z(), -1.0, 1.0));
  balance.lean_sigma_rad = std::sqrt(std::max(variances.x(), variances.y())) / size;
  balance.hover_speed_rad_s = std::sqrt(gravity_m_s2 / balance.k_f_over_mass /
                                        static_cast<double>(signals.rotors->channels()));
  return balance;
}

}  // namespace odmc
