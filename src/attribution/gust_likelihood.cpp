#include "odmc/attribution/gust_likelihood.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

#include "odmc/analysis/parallel.h"
#include "odmc/attribution/place_field.h"
#include "odmc/math/descent.h"
#include "odmc/math/farthest_rows.h"
#include "odmc/math/gaussian.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kTimeConstants_s[] = {0.3, 0.7, 1.5, 3.0, 6.0};
constexpr int kLeastSamples = 40;        // 3.2 s
constexpr double kLeastCurvature = 1.0;  // the natural size alone
constexpr double kSizes[] = {0.35, 0.6, 1.0, 1.6, 2.5};
constexpr int kProcess = 7;                 // unknowns of Hypothesis beside the drag
constexpr double kMostLateral = 3.0;        // of the logarithm of a ratio that is normal a priori
constexpr double kVertical[] = {0.1, 1.0};  // third axis over the others
constexpr double kNoiseShares[] = {0.02, 0.1, 0.4, 1.0};  // of the quick part's variance
// The filter's window is 0.1 s: samples so far apart share less than 2 % of their noise's variance,
// neighbours half of it where they are derivatives.
constexpr double kApart_s = 0.08;
// The filter rounds what changes within its window off, and air turns no corners, either: over
// short times both look like a process that is slower than it is. Samples an eighth to a quarter of
// the correlation time apart tell it nearly as well as all do: its standard error is 7 to 14 %
// larger.
constexpr double kUnrounded_s = 0.24;
constexpr double kApartOfTimeConstant = 0.2;

/// Samples in use, so far apart that each has noise of its own.
std::vector<int> SamplesApart(const ThinnedFlight& flight, double apart_s) {
  std::vector<int> apart;
  double last_s = -std::numeric_limits<double>::infinity();
  for (int i = 0; i < flight.size(); ++i) {
    const double t_s = flight.sample(i).t_s;
    if (flight.held_out(i) || t_s < last_s + apart_s - 1e-6) continue;
    last_s = t_s;
    apart.push_back(i);
  }
  return apart;
}

/// A first-order process w of standard deviation `sigma` by axis and correlation time
/// `time_constant_s`, seen as H_i w in white noise beside a steady force, by a Kalman filter that
/// looks at some samples.
/// @param looked_at numbers of these, ascending
/// @param steady derivative of the force by the steady one, each of whose components is of unit
///   variance a priori; empty: there is none
/// @param states estimates of w at every sample from all it has looked at by then, may be null
/// @returns the residual's log-likelihood
double Follow(const ThinnedFlight& flight, const std::vector<int>& looked_at,
              const ResidualModel::Wrenches& y, const std::vector<Matrix3d>& H,
              const std::vector<Matrix3d>& steady, const Vector3d& noise_variance,
              const Vector3d& sigma, double time_constant_s,
              std::vector<Vector3d>* states = nullptr) {
  using Vector6d = Eigen::Matrix<double, 6, 1>;
  using Matrix6d = Eigen::Matrix<double, 6, 6>;
  using Seeing = Eigen::Matrix<double, 3, 6>;
  Vector6d x = Vector6d::Zero();  // w, the steady force
  const Matrix3d wide = sigma.cwiseAbs2().asDiagonal();
  Matrix6d P = Matrix6d::Identity();
  P.topLeftCorner<3, 3>() = wide;
  const Matrix3d noise = noise_variance.asDiagonal();
  double sum = 0.0, last_s = flight.sample(0).t_s;
  int next = 0;  // sample whose state is not told yet
  const auto tell_up_to = [&](int end) {
    for (; states != nullptr && next < end; ++next) {
      const double dt = flight.sample(next).t_s - last_s;
      states->push_back(std::exp(-dt / time_constant_s) * x.head<3>());
    }
  };
  for (const int i : looked_at) {
    tell_up_to(i);
    const double dt = std::max(0.0, flight.sample(i).t_s - last_s);
    last_s = flight.sample(i).t_s;
    const double decay = std::exp(-dt / time_constant_s);
    x.head<3>() *= decay;
    P.topLeftCorner<3, 3>() *= decay * decay;
    P.topLeftCorner<3, 3>() += (1.0 - decay * decay) * wide;
    P.topRightCorner<3, 3>() *= decay;
    P.bottomLeftCorner<3, 3>() *= decay;
    Seeing seen;
    seen.leftCols<3>() = H[i];
    if (steady.empty()) {
      seen.rightCols<3>().setZero();
    } else {
      seen.rightCols<3>() = steady[i];
    }
    const Vector3d e = y.row(i).head<3>().transpose() - seen * x;
    const Seeing seen_P = seen * P;
    const Eigen::LLT<Matrix3d> S(Matrix3d(seen_P * seen.transpose() + noise));
    const Vector3d white = S.matrixL().solve(e);
    const Seeing gain = S.matrixL().solve(seen_P);
    sum -= 0.5 * white.squaredNorm() + S.matrixLLT().diagonal().array().log().sum();
    x += gain.transpose() * white;
    P -= gain.transpose() * gain;
  }
  tell_up_to(flight.size());
  return sum;
}

/// Columns of a linear model, each by the filter of such a process: what each row brings that the
/// rows before do not foresee, over its standard deviation. So noise and process become white.
/// @param columns force in the body at the samples looked at (3 rows a sample)
/// @param log_det sum of the logarithms of those standard deviations
MatrixXd Whitened(const ThinnedFlight& flight, const std::vector<int>& looked_at,
                  const MatrixXd& columns, const std::vector<Matrix3d>& H,
                  const Vector3d& noise_variance, const Vector3d& sigma, double time_constant_s,
                  double* log_det) {
  MatrixXd white(columns.rows(), columns.cols());
  MatrixXd w = MatrixXd::Zero(3, columns.cols());
  const Matrix3d noise = noise_variance.asDiagonal();
  const Matrix3d wide = sigma.cwiseAbs2().asDiagonal();
  Matrix3d P = wide;
  double last_s = flight.sample(looked_at.front()).t_s;
  Index row = 0;
  *log_det = 0.0;
  for (const int i : looked_at) {
    const double decay = std::exp((last_s - flight.sample(i).t_s) / time_constant_s);
    last_s = flight.sample(i).t_s;
    w *= decay;
    P = decay * decay * P + (1.0 - decay * decay) * wide;
    const Matrix3d seen_P = H[i] * P;
    const Eigen::LLT<Matrix3d> S(Matrix3d(seen_P * H[i].transpose() + noise));
    const Matrix3d gain = S.matrixL().solve(seen_P);
    white.middleRows<3>(row) = S.matrixL().solve(columns.middleRows<3>(row) - H[i] * w);
    *log_det += S.matrixLLT().diagonal().array().log().sum();
    w += gain.transpose() * white.middleRows<3>(row);
    P -= gain.transpose() * gain;
    row += 3;
  }
  return white;
}

/// How the force answers wind, at every sample.
std::vector<Matrix3d> Response(int n, const WindDerivatives& d_wind) {
  std::vector<Matrix3d> H(n);
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < 3; ++k) H[i].col(k) = d_wind[k].row(i).head<3>().transpose();
  }
  return H;
}

/// Variance of the residual's quick part: what is left of its variance without the covariance of
/// samples that share no filter window. (Not from differences of neighbours: the noise of a
/// differentiated measurement turns its sign from one to the next.)
/// @param time_constant_s of the slow part, where it is known
Vector3d QuickVariance(const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                       Vector3d* total,
                       double time_constant_s = std::numeric_limits<double>::infinity()) {
  constexpr int kFirstLag = 3, kLastLag = 6;  // of 40 ms; the filter's window is 0.1 s
  Vector3d slow = Vector3d::Zero();
  total->setZero();
  int samples = 0, pairs = 0, run = 0;
  for (int i = 0; i < flight.size(); ++i) {
    if (flight.held_out(i)) {
      run = -1;
      continue;
    }
    run = flight.next(i) ? run + 1 : 0;
    ++samples;
    const Vector3d y = residual.row(i).head<3>();
    *total += y.cwiseAbs2();
    for (int lag = kFirstLag; lag <= std::min(run, kLastLag); ++lag, ++pairs) {
      const double apart_s = flight.sample(i).t_s - flight.sample(i - lag).t_s;
      slow += std::exp(std::min(1.0, apart_s / time_constant_s)) *
              y.cwiseProduct(residual.row(i - lag).head<3>().transpose());
    }
  }
  *total /= std::max(1, samples);
  slow = (slow / std::max(1, pairs)).cwiseMax(0.0);
  return (*total - slow).cwiseMax(0.05 * *total).cwiseMax(1e-12);
}

/// What is left of a flight with the drag changed, and how a slowly varying quantity acts on it.
struct Seen {
  ResidualModel::Wrenches y;
  std::vector<Matrix3d> H;
};

/// A slowly varying quantity w that acts as H w, the drag beside it unknown. Drag and size of w
/// multiply each other, so that all is fitted together: x holds the drag's changes, and the
/// logarithms of w's size along its first axis (over its natural one), of its correlation time [s],
/// of its third and its second axis' size over that of the first, and of the noise's variance along
/// each axis (over the quick part's).
class Hypothesis {
 public:
  /// @param H how w acts with the drag as it is
  /// @param steady how a steady force beside it acts, in units of its natural size
  /// @param by_drag true for wind: the drag's change changes H, and w is as large along the second
  ///   axis as along the first
  /// @param size natural standard deviation of w
  /// @param prior of its correlation time
  Hypothesis(const ThinnedFlight* flight, const std::vector<int>* looked_at,
             const ResidualModel::Wrenches* residual, std::vector<Matrix3d> H,
             const std::vector<Matrix3d>* steady, const std::vector<DragCoefficient>* drag,
             bool by_drag, const Vector3d& noise, double size, const TimeConstantPrior& prior)
      : flight_(flight),
        looked_at_(looked_at),
        residual_(residual),
        H_(std::move(H)),
        steady_(steady),
        noise_(noise),
        size_(size),
        prior_(prior),
        drag_(drag),
        num_drag_(static_cast<Index>(drag->size())),
        x_(VectorXd::Zero(num_drag_ + kProcess)),
        least_(x_),
        most_(x_) {
    for (Index k = 0; k < num_drag_; ++k) {
      least_[k] = (*drag)[k].least;
      most_[k] = (*drag)[k].most;
    }
    const Vector3d one = Vector3d::Ones();
    const double lateral = by_drag ? 0.0 : kMostLateral;
    least_.tail<kProcess>() << std::log(0.1), std::log(0.2), std::log(0.03), -lateral,
        std::log(1e-3) * one;
    most_.tail<kProcess>() << std::log(10.0), std::log(10.0), std::log(2.0), lateral,
        std::log(2.0) * one;
    if (!by_drag) return;
    for (const DragCoefficient& c : *drag) dH_.push_back(Response(flight->size(), c.d_wind));
  }

  /// Makes the residual most likely.
  void Fit() {
    FitFromHere();
    const VectorXd start = DragToStartFrom();
    if (dH_.empty() || start.isZero()) return;
    Hypothesis other = *this;
    other.x_.head(num_drag_) = start;
    other.FitFromHere();
    if (other.likelihood_ > likelihood_) *this = std::move(other);
  }

  /// The same fitted to other samples, from this drag on.
  Hypothesis LookingAt(const std::vector<int>* looked_at) const {
    Hypothesis other = *this;
    other.looked_at_ = looked_at;
    other.FitFromHere();
    return other;
  }

  /// Log-likelihood of the fit, the drag's change a priori normal with its natural size and the
  /// correlation time as its prior says.
  double likelihood() const { return likelihood_; }
  double sigma() const { return size_ * std::exp(x_[num_drag_]); }
  double vertical_sigma() const { return SizeOf(x_).z(); }
  double time_constant_s() const { return std::exp(x_[num_drag_ + 1]); }
  Vector3d size() const { return SizeOf(x_); }
  Vector3d noise_variance() const { return NoiseOf(x_); }
  VectorXd drag_change() const { return x_.head(num_drag_); }

  /// Standard errors of what was fitted, from the likelihood's curvature; each at most 1.
  struct Errors {
    VectorXd drag;
    double sigma, vertical_sigma, time_constant;  ///< over their values
  };
  Errors StandardErrors() const {
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(SlopeAt(x_, likelihood_).curvature);
    const VectorXd variance =
        eigen.eigenvalues().cwiseAbs().cwiseMax(kLeastCurvature).cwiseInverse();
    const MatrixXd covariance =
        eigen.eigenvectors() * variance.asDiagonal() * eigen.eigenvectors().transpose();
    const VectorXd error = covariance.diagonal().cwiseSqrt();
    const Index size = num_drag_, time_constant = num_drag_ + 1, ratio = num_drag_ + 2;
    const double vertical =
        covariance(size, size) + covariance(ratio, ratio) + 2.0 * covariance(size, ratio);
    return {error.head(num_drag_), error[size], std::min(1.0, std::sqrt(std::max(0.0, vertical))),
            error[time_constant]};
  }

  /// Mean fourth power of w over its mean square squared, as the filter sees w.
  double Peakedness() const { return PeakednessOf(SeenAt(x_)); }

  /// Chance that such a process, which is normal, looks as peaked: by drawing it anew. Beyond all
  /// draws the logarithm of the peakedness is taken as normal.
  double ChanceOfPeakedness(double peakedness) const {
    constexpr int kDraws = 299;
    Gaussian random(kDraws, 0);
    Seen drawn = SeenAt(x_);
    const Vector3d size = SizeOf(x_), noise = NoiseOf(x_).cwiseSqrt();
    VectorXd logs(kDraws);
    for (double& log : logs) {
      Vector3d w = size.cwiseProduct(random.Next3());
      double last_s = flight_->sample(0).t_s;
      for (const int i : *looked_at_) {
        const double decay = std::exp((last_s - flight_->sample(i).t_s) / time_constant_s());
        last_s = flight_->sample(i).t_s;
        w = decay * w + std::sqrt(1.0 - decay * decay) * size.cwiseProduct(random.Next3());
        drawn.y.row(i).head<3>() = drawn.H[i] * w + noise.cwiseProduct(random.Next3());
      }
      log = std::log(PeakednessOf(drawn));
    }
    const double log_peakedness = std::log(peakedness);
    const auto peakier = (logs.array() >= log_peakedness).count();
    const double by_draws = static_cast<double>(1 + peakier) / (1 + kDraws);
    if (peakier > 0) return by_draws;
    const double variance = (logs.array() - logs.mean()).square().sum() / (kDraws - 1);
    const double z = (log_peakedness - logs.mean()) / std::sqrt(variance);
    return std::clamp(0.5 * std::erfc(z / std::sqrt(2.0)), 1e-300, by_draws);
  }

 private:
  struct Slope {
    VectorXd slope;
    MatrixXd curvature;
  };

  double PeakednessOf(const Seen& seen) const {
    std::vector<Vector3d> states;
    Follow(*flight_, *looked_at_, seen.y, seen.H, *steady_, NoiseOf(x_), SizeOf(x_),
           time_constant_s(), &states);
    double square = 0.0, fourth = 0.0;
    for (const Vector3d& w : states) {
      square += w.squaredNorm();
      fourth += w.squaredNorm() * w.squaredNorm();
    }
    return fourth * static_cast<double>(states.size()) / std::max(1e-300, square * square);
  }

  void FitFromHere() {
    FitProcess();
    Climb();
  }

  /// A change that gives some drag to each axis that has next to none: wind cannot act there, and
  /// so nothing would tell that there should be more.
  VectorXd DragToStartFrom() const {
    constexpr double kNextToNone = 0.05, kSome = 0.3;  // natural sizes
    VectorXd change = VectorXd::Zero(num_drag_);
    for (Index k = 0; k < num_drag_; ++k) {
      if ((*drag_)[k].natural_size <= 0.0) continue;
      if (most_[k] < kNextToNone) change[k] = -kSome;
      if (least_[k] > -kNextToNone) change[k] = kSome;
    }
    return change;
  }

  Seen SeenAt(const VectorXd& x) const {
    Seen seen{*residual_, H_};
    for (Index k = 0; k < num_drag_; ++k) {
      seen.y -= x[k] * (*drag_)[k].d_wrench;
      if (dH_.empty()) continue;
      for (size_t i = 0; i < H_.size(); ++i) seen.H[i] += x[k] * dH_[k][i];
    }
    return seen;
  }

  double Likelihood(const Seen& seen, const VectorXd& x) const {
    return Follow(*flight_, *looked_at_, seen.y, seen.H, *steady_, NoiseOf(x), SizeOf(x),
                  std::exp(x[num_drag_ + 1])) -
           0.5 * x.head(num_drag_).squaredNorm() - 0.5 * std::pow(x[num_drag_ + 3], 2) -
           0.5 * std::pow((x[num_drag_ + 1] - std::log(prior_.median_s)) / prior_.log_sigma, 2);
  }
  Vector3d SizeOf(const VectorXd& x) const {
    const double size = size_ * std::exp(x[num_drag_]);
    return {size, size * std::exp(x[num_drag_ + 3]), size * std::exp(x[num_drag_ + 2])};
  }
  Vector3d NoiseOf(const VectorXd& x) const {
    return noise_.cwiseProduct(Vector3d(x.tail<3>().array().exp()));
  }
  double Likelihood(const VectorXd& x) const { return Likelihood(SeenAt(x), x); }

  /// The best of a few sizes and correlation times.
  void FitProcess() {
    const Seen seen = SeenAt(x_);
    VectorXd x = x_;
    likelihood_ = -std::numeric_limits<double>::infinity();
    for (const double time_constant_s : kTimeConstants_s) {
      for (const double size : kSizes) {
        for (const double noise : kNoiseShares) {
          for (const double vertical : kVertical) {
            x.tail<kProcess>() << std::log(size), std::log(time_constant_s), std::log(vertical),
                0.0, Vector3d::Constant(std::log(noise));
            const double found = Likelihood(seen, x);
            if (!(found > likelihood_)) continue;
            likelihood_ = found;
            x_ = x;
          }
        }
      }
    }
  }

  /// Newton's method within the bounds, from differences.
  void Climb() {
    DescentOptions options;
    options.most_steps = 12;
    options.shorter = 0.4;
    options.shortest = 0.003;
    options.least_gain = 0.05;  // nats
    options.least = least_;
    options.most = most_;
    const CostAt best = Descend(
        {x_, -likelihood_}, options,
        [this](const CostAt& at) { return NewtonStep(at.x, -at.cost); },
        [this](const VectorXd& x) { return -Likelihood(x); });
    x_ = best.x;
    likelihood_ = -best.cost;
  }

  Slope SlopeAt(const VectorXd& at, double likelihood) const {
    constexpr double kDifference = 0.05;
    const Index n = at.size();
    VectorXd slope(n), up(n);
    MatrixXd curvature(n, n);
    const auto moved = [&](Index j, double by_j, Index k, double by_k) {
      VectorXd x = at;
      x[j] += by_j;
      x[k] += by_k;
      return Likelihood(x);
    };
    const double h = kDifference;
    for (Index k = 0; k < n; ++k) {
      up[k] = moved(k, h, k, 0.0);
      const double down = moved(k, -h, k, 0.0);
      slope[k] = (up[k] - down) / (2.0 * h);
      curvature(k, k) = (up[k] + down - 2.0 * likelihood) / (h * h);
      for (Index j = 0; j < k; ++j) {
        curvature(j, k) = curvature(k, j) =
            (moved(j, h, k, h) - up[j] - up[k] + likelihood) / (h * h);
      }
    }
    return {slope, curvature};
  }

  /// Uphill, against the curvature by its size; along what is at its bound and pushes outwards
  /// not at all.
  VectorXd NewtonStep(const VectorXd& x, double likelihood) const {
    auto [slope, curvature] = SlopeAt(x, likelihood);
    for (Index k = 0; k < x.size(); ++k) {
      const bool outwards =
          (x[k] >= most_[k] && slope[k] > 0.0) || (x[k] <= least_[k] && slope[k] < 0.0);
      if (!outwards) continue;
      slope[k] = 0.0;
      curvature.row(k).setZero();
      curvature.col(k).setZero();
    }
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(curvature);
    return eigen.eigenvectors() *
           (eigen.eigenvectors().transpose() * slope)
               .cwiseQuotient(eigen.eigenvalues().cwiseAbs().cwiseMax(kLeastCurvature));
  }

  const ThinnedFlight* flight_;
  const std::vector<int>* looked_at_;
  const ResidualModel::Wrenches* residual_;
  std::vector<Matrix3d> H_;
  const std::vector<Matrix3d>* steady_;
  std::vector<std::vector<Matrix3d>> dH_;
  Vector3d noise_;
  double size_;
  TimeConstantPrior prior_;
  const std::vector<DragCoefficient>* drag_;
  Index num_drag_;
  VectorXd x_, least_, most_;
  double likelihood_ = 0.0;
};

/// Log-likelihood of a force that swings steadily at one frequency, fixed in the world (`in_world`)
/// or in the body, in white noise: the best frequency, with a nat for each coefficient and for the
/// choice among the frequencies taken off.
double SteadySwing(const ThinnedFlight& flight, const std::vector<int>& used,
                   const ResidualModel::Wrenches& residual, bool in_world) {
  constexpr double kSlowest_Hz = 0.2, kFastest_Hz = 5.0;
  constexpr int kCoefficients = 9;  // along each axis a cosine, a sine and a mean
  const auto n = static_cast<Index>(used.size());
  Eigen::Matrix<double, Eigen::Dynamic, 3> y(n, 3);
  Eigen::Matrix<double, Eigen::Dynamic, 3> X(n, 3);
  for (Index row = 0; row < n; ++row) {
    const int i = used[static_cast<size_t>(row)];
    const Vector3d f = residual.row(i).head<3>();
    y.row(row) = (in_world ? Vector3d(flight.R_WB(i) * f) : f).transpose();
  }
  const double duration_s = flight.sample(used.back()).t_s - flight.sample(used.front()).t_s;
  const double step_Hz = 0.5 / duration_s;
  double best = -std::numeric_limits<double>::infinity();
  int tried = 0;
  for (double f = kSlowest_Hz; f < kFastest_Hz; f += step_Hz, ++tried) {
    for (Index row = 0; row < n; ++row) {
      const double phase = 2.0 * EIGEN_PI * f * flight.sample(used[static_cast<size_t>(row)]).t_s;
      X.row(row) << std::cos(phase), std::sin(phase), 1.0;
    }
    const Matrix3d fit = (X.transpose() * X).ldlt().solve(X.transpose() * y);
    const Vector3d variance = (y - X * fit).colwise().squaredNorm().transpose() / n;
    const double likelihood = -0.5 * n * (3.0 + variance.array().max(1e-12).log().sum());
    best = std::max(best, likelihood);
  }
  return best - kCoefficients - std::log(std::max(1, tried));
}

/// Log-likelihood of a linear model in white noise of variance 1 whose coefficients have these
/// prior standard deviations, but for what all such models share.
double LogLikelihood(const MatrixXd& gram, const VectorXd& Xy, double yy, const VectorXd& sigma) {
  MatrixXd H = gram;
  H.diagonal() += sigma.cwiseAbs2().cwiseInverse();
  const Eigen::LLT<MatrixXd> llt(H);
  const double log_det = 2.0 * MatrixXd(llt.matrixL()).diagonal().array().log().sum() +
                         2.0 * sigma.array().log().sum();
  return 0.5 * Xy.dot(llt.solve(Xy)) - 0.5 * yy - 0.5 * log_det;
}

/// A force that follows the place, fixed in the world, beside one that varies by itself: what the
/// place makes the residual more likely. A tether or an updraft gains some tens of nats and more,
/// also where it has a part that no smooth function of the place has. Gusts gain next to nothing.
class PlaceTest {
 public:
  /// @param by_itself the hypothesis of the other force alone, fitted; H how it acts
  /// @param natural standard deviation of what varies slowly [N]
  PlaceTest(const ThinnedFlight& flight, const std::vector<int>& used,
            const ResidualModel::Wrenches& residual, const std::vector<DragCoefficient>& drag,
            const std::vector<Matrix3d>& steady, const std::vector<Matrix3d>& H,
            const Hypothesis& by_itself, double natural)
      : flight_(&flight), used_(&used), H_(&H), by_itself_(&by_itself), natural_(natural) {
    const auto n = static_cast<Index>(used.size());
    const auto num_drag = static_cast<Index>(drag.size());
    places_.resize(n, 3);
    shared_.resize(3 * n, num_drag + 4);
    for (Index k = 0; k < n; ++k) {
      const int i = used[static_cast<size_t>(k)];
      places_.row(k) = flight.sample(i).p_WS.transpose();
      for (Index d = 0; d < num_drag; ++d) {
        shared_.block<3, 1>(3 * k, d) =
            drag[static_cast<size_t>(d)].d_wrench.row(i).head<3>().transpose();
      }
      shared_.block<3, 3>(3 * k, num_drag) = steady[static_cast<size_t>(i)];
      shared_.block<3, 1>(3 * k, num_drag + 3) = residual.row(i).head<3>().transpose();
    }
  }

  /// Nats by which the place makes it more likely, the choice of its force's size and width paid.
  double Gain(int jobs) const {
    const FarthestRows centres(places_, kCentres, 0.02);
    if (!(centres.extent > 0.0)) return 0.0;
    std::array<Found, std::size(kWidths)> found;
    ForEachOf(static_cast<int>(found.size()), jobs, [&](int i) {
      found[static_cast<size_t>(i)] = Try(centres, kWidths[i] * centres.extent);
    });
    Found best = found.front();
    for (const Found& f : found) {
      best = {std::max(best.with, f.with), std::max(best.without, f.without)};
    }
    return best.with - best.without -
           std::log(static_cast<double>(std::size(kWidths) * std::size(kSizes)));
  }

 private:
  static constexpr size_t kCentres = 40;
  static constexpr double kWidths[] = {0.1, 0.2, 0.4, 0.8, 1.6};  // of the flight's extent
  static constexpr double kSizes[] = {0.3, 1.0, 3.0};             // of the natural one
  static constexpr double kForceShares[] = {0.1, 0.3, 0.6, 1.0};  // of the other force's size

  /// Log-likelihoods with a force that follows the place and without one.
  struct Found {
    double with = -std::numeric_limits<double>::infinity();
    double without = -std::numeric_limits<double>::infinity();
  };

  Found Try(const FarthestRows& centres, double width_m) const {
    const MatrixXd features = FieldFeatures(places_, places_(centres.rows, Eigen::all), width_m);
    const Index field = 3 * features.cols(), all = field + shared_.cols() - 1;
    MatrixXd X(shared_.rows(), all + 1);
    for (Index k = 0; k < features.rows(); ++k) {
      const Matrix3d R_BW = flight_->R_WB((*used_)[static_cast<size_t>(k)]).transpose();
      for (Index axis = 0; axis < 3; ++axis) {
        X.block(3 * k, axis * features.cols(), 3, features.cols()) =
            R_BW.col(axis) * features.row(k);
      }
    }
    X.rightCols(shared_.cols()) = shared_;
    Found found;
    for (const double share : kForceShares) {
      double log_det = 0.0;
      const MatrixXd white =
          Whitened(*flight_, *used_, X, *H_, by_itself_->noise_variance(),
                   share * by_itself_->size(), by_itself_->time_constant_s(), &log_det);
      const MatrixXd gram = white.leftCols(all).transpose() * white.leftCols(all);
      const VectorXd Xy = white.leftCols(all).transpose() * white.col(all);
      const double yy = white.col(all).squaredNorm();
      const Index rest = all - field;
      found.without =
          std::max(found.without, LogLikelihood(gram.bottomRightCorner(rest, rest), Xy.tail(rest),
                                                yy, VectorXd::Ones(rest)) -
                                      log_det);
      for (const double size : kSizes) {
        VectorXd sigma = VectorXd::Constant(all, size * natural_);
        sigma.tail(rest).setOnes();
        found.with = std::max(found.with, LogLikelihood(gram, Xy, yy, sigma) - log_det);
      }
    }
    return found;
  }

  const ThinnedFlight* flight_;
  const std::vector<int>* used_;
  const std::vector<Matrix3d>* H_;
  const Hypothesis* by_itself_;
  double natural_;
  MatrixXd places_, shared_;  ///< shared_: drag, the steady force, last the residual
};

/// Samples far enough apart for a process of this correlation time, but some tens of them.
std::vector<int> SamplesApartFor(const ThinnedFlight& flight, double time_constant_s) {
  constexpr int kSome = 25;
  for (double apart_s = kApartOfTimeConstant * time_constant_s; apart_s > kUnrounded_s;
       apart_s -= ThinnedFlight::kStep_s) {
    std::vector<int> apart = SamplesApart(flight, apart_s);
    if (static_cast<int>(apart.size()) >= kSome) return apart;
  }
  return SamplesApart(flight, kUnrounded_s);
}

}  // namespace

GustTest TestGusts(const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                   const WindDerivatives& d_wind, const std::vector<DragCoefficient>& drag,
                   const TimeConstantPrior& prior, int jobs) {
  GustTest test;
  const int n = flight.size();
  const std::vector<int> apart = SamplesApart(flight, kApart_s);
  if (static_cast<int>(apart.size()) < kLeastSamples) return test;
  std::vector<Matrix3d> wind = Response(n, d_wind), world(n), body(n, Matrix3d::Identity());
  double response = 0.0;
  for (int i = 0; i < n; ++i) {
    world[i] = flight.R_WB(i).transpose();
    response += wind[i].squaredNorm() / (3.0 * n);
  }
  response = std::sqrt(response);
  if (!(response > 0.0)) return test;
  Vector3d total;
  const Vector3d quick = QuickVariance(flight, residual, &total);
  const double natural = std::sqrt(std::max(1e-12, (total - quick).cwiseMax(0.0).mean()));
  // A steady force is none of theirs: with its mean left in, what varies seems to vary more slowly.
  std::vector<Matrix3d> steady(world);
  for (Matrix3d& axes : steady) axes *= natural;
  Hypothesis gust(&flight, &apart, &residual, std::move(wind), &steady, &drag, true, quick,
                  natural / response, prior);
  Hypothesis free_world(&flight, &apart, &residual, world, &steady, &drag, false, quick, natural,
                        prior);
  Hypothesis free_body(&flight, &apart, &residual, std::move(body), &steady, &drag, false, quick,
                       natural, prior);
  Hypothesis none(&flight, &apart, &residual, std::vector<Matrix3d>(n, Matrix3d::Zero()), &steady,
                  &drag, false, total, natural, prior);
  const std::array<Hypothesis*, 4> hypotheses = {&gust, &free_world, &free_body, &none};
  ForEachOf(static_cast<int>(hypotheses.size()), jobs,
            [&](int i) { hypotheses[static_cast<size_t>(i)]->Fit(); });
  test.peakedness_p = gust.ChanceOfPeakedness(gust.Peakedness());
  test.gain = gust.likelihood() - none.likelihood();
  test.over_others = gust.likelihood() - std::max({free_world.likelihood(), free_body.likelihood(),
                                                   SteadySwing(flight, apart, residual, true),
                                                   SteadySwing(flight, apart, residual, false)});
  if (test.gain > 0.0) {
    const PlaceTest place(flight, apart, residual, drag, steady, world, free_world, natural);
    test.over_place = gust.likelihood() - free_world.likelihood() - place.Gain(jobs);
  }
  const std::vector<int> unrounded = SamplesApart(flight, kUnrounded_s);
  const Hypothesis unrounded_fit = gust.LookingAt(&unrounded);
  const std::vector<int> sparse = SamplesApartFor(flight, unrounded_fit.time_constant_s());
  const Hypothesis slow = unrounded_fit.LookingAt(&sparse);
  test.sigma_m_s = slow.sigma();
  test.vertical_sigma_m_s = slow.vertical_sigma();
  test.time_constant_s = slow.time_constant_s();
  const Hypothesis::Errors errors = slow.StandardErrors();
  test.sigma_error = errors.sigma;
  test.vertical_sigma_error = errors.vertical_sigma;
  test.time_constant_error = errors.time_constant;
  test.drag = gust.drag_change();
  test.drag_sigma = gust.StandardErrors().drag;
  return test;
}

std::vector<Vector3d> PredictGusts(const ThinnedFlight& flight,
                                   const ResidualModel::Wrenches& residual,
                                   const WindDerivatives& d_wind, const Vector3d& sigma_m_s,
                                   double time_constant_s, int ahead) {
  const int n = flight.size();
  if (n == 0) return {};
  std::vector<Vector3d> states, predicted(n, Vector3d::Zero());
  Vector3d total;
  const Vector3d quick = QuickVariance(flight, residual, &total, time_constant_s);
  std::vector<int> in_use;
  for (int i = 0; i < n; ++i) {
    if (!flight.held_out(i)) in_use.push_back(i);
  }
  Follow(flight, in_use, residual, Response(n, d_wind), {}, quick, sigma_m_s, time_constant_s,
         &states);
  for (int i = ahead; i < n; ++i) {
    const double dt = flight.sample(i).t_s - flight.sample(i - ahead).t_s;
    predicted[i] = std::exp(-dt / time_constant_s) * states[i - ahead];
  }
  return predicted;
}

}  // namespace odmc
