#include "odmc/inspection/rotor_scale.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <string>

#include "odmc/math/statistics.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// What sound vehicles differ by, in sigmas. From 55 flights of seven vehicles of 35 g to 0.9 kg,
// whose readings are right: shares that balance leave 1.3 % of the reaction torques about yaw, 1.5
// % of the arm about roll and 3 % about pitch; effects of single rotors scatter by 7 % in this
// band. Loads shift the centre of gravity farther.
constexpr double kThrustScatter = 0.02;  // of motors and propellers among themselves
constexpr double kYawImbalance = 0.013;  // of the reaction torques: leaning rotors, spread of k_m
constexpr double kOffCentre = 0.05;      // over the arm, of the centre of gravity
constexpr double kSteadyTorque = 0.01;   // over weight times arm: air, turning
constexpr double kEffectScatter = 0.07;  // over the arm
constexpr double kGain = 0.5;            // nominal over true inertia
constexpr double kAnyScale = 10.0;       // prior of the rotor that is suspected
// Chi-square with one degree of freedom above 3.5² has a probability of 5e-4; four rotors are
// looked at: one sound flight in 500 is accused, if both witnesses were as Gaussian as that. They
// are not (a rotor that leans by three degrees unbalances yaw by a tenth), so each must say so by
// itself, too.
constexpr double kSignificant = 3.5;
constexpr double kWitness = 2.0;
constexpr double kRunnerUp = 6.0;    // chi-square by which another rotor must explain less
constexpr double kHarmful = 0.03;    // error of k_f that is worth a doubt
constexpr double kReadsZero = 0.05;  // share over a fair one

// One vehicle in ten has a reading or a propeller that is off, by some 15 % of the speed.
constexpr double kBadOnesAre = 0.1, kBadThrust = 0.3;
constexpr double kNoThrust = 0.01;  // changes nothing worth a replay

/// Which observations to use.
enum class Witness { kEffects, kSteady, kBoth };

/// Linear observations of what may be off: gains of roll and pitch, centre of gravity along x and y
/// (over the arm), thrust of each rotor over what its reading says, minus one.
class Balance {
 public:
  Balance(const RotorResponse& response, const Vehicle& vehicle, Witness witness)
      : response_(response), witness_(witness), n_(response.share.size()) {
    normal_ = MatrixXd::Zero(4 + n_, 4 + n_);
    right_ = VectorXd::Zero(4 + n_);
    VectorXd roll(n_), pitch(n_), spin(n_);
    for (Eigen::Index j = 0; j < n_; ++j) {
      const Rotor& rotor = vehicle.rotors[static_cast<size_t>(j)];
      roll[j] = rotor.p_BP.y();
      pitch[j] = -rotor.p_BP.x();
      spin[j] = rotor.spin;
    }
    AddAxis(0, response.lags.front().roll, roll / roll.cwiseAbs().mean());
    AddAxis(1, response.lags.front().pitch, pitch / pitch.cwiseAbs().mean());
    AddYaw(spin);
  }

  struct Fit {
    double chi = 0.0;
    double scale = 0.0, sigma = 0.0;  // of the suspected rotor's thrust, minus one
  };

  /// @param suspect rotor whose thrust is free; below 0: none
  Fit Solve(Eigen::Index suspect) const {
    VectorXd prior = VectorXd::Constant(4 + n_, kThrustScatter);
    prior.head<4>() << kGain, kGain, kOffCentre, kOffCentre;
    if (suspect >= 0) prior[4 + suspect] = kAnyScale;
    MatrixXd all = normal_;
    all.diagonal() += prior.cwiseAbs2().cwiseInverse();
    const Eigen::LLT<MatrixXd> factor(all);
    const VectorXd x = factor.solve(right_);
    Fit fit;
    fit.chi = square_ - right_.dot(x);
    if (suspect >= 0) {
      fit.scale = x[4 + suspect];
      const VectorXd unit = VectorXd::Unit(4 + n_, 4 + suspect);
      fit.sigma = std::sqrt(factor.solve(unit)[4 + suspect]);
    }
    return fit;
  }

  double degrees() const { return degrees_; }

 private:
  void Add(Witness from, const MatrixXd& rows, const VectorXd& seen, const MatrixXd& information) {
    if (witness_ != Witness::kBoth && witness_ != from) return;
    normal_ += rows.transpose() * information * rows;
    right_ += rows.transpose() * information * seen;
    square_ += seen.dot(information * seen);
    degrees_ += static_cast<double>(seen.size());
  }

  /// Effects and balance about one axis. @param lever in units of the arm
  void AddAxis(Eigen::Index axis, const BandRegression& seen, const VectorXd& lever) {
    const MatrixXd one = MatrixXd::Identity(n_, n_);
    // The regression's unit of length is what the gain says. Its median over the rotors: the one
    // that is off must not shift it, the observations are linear about it.
    std::vector<double> gains;
    for (Eigen::Index j = 0; j < n_; ++j) {
      constexpr double kFarOut = 0.5;  // of the arm: by the others the ratio says little
      if (std::abs(lever[j]) > kFarOut) gains.push_back(seen.value[j] / lever[j]);
    }
    const double gain = Median(gains);
    const MatrixXd covariance =
        (seen.information + 1e-9 * seen.information.trace() * one).inverse();
    if (gain > 0.0) {
      MatrixXd rows = MatrixXd::Zero(n_, 4 + n_);
      rows.col(axis) = lever;
      rows.col(2 + axis).setConstant(-1.0);
      rows.rightCols(n_) = lever.asDiagonal();
      const MatrixXd spread = covariance / (gain * gain) + kEffectScatter * kEffectScatter * one;
      Add(Witness::kEffects, rows, seen.value / gain - lever, spread.inverse());
    }
    MatrixXd row = MatrixXd::Zero(1, 4 + n_);
    row(0, 2 + axis) = -1.0;
    row.rightCols(n_) = lever.cwiseProduct(response_.share).transpose();
    AddSteady(row, lever, kSteadyTorque);
  }

  void AddYaw(const VectorXd& spin) {
    MatrixXd row = MatrixXd::Zero(1, 4 + n_);
    row.rightCols(n_) = spin.cwiseProduct(response_.share).transpose();
    AddSteady(row, spin, kYawImbalance);
  }

  void AddSteady(const MatrixXd& row, const VectorXd& lever, double sigma) {
    const double variance = sigma * sigma + lever.dot(response_.share_spread * lever);
    Add(Witness::kSteady, row, VectorXd::Constant(1, -lever.dot(response_.share)),
        MatrixXd::Constant(1, 1, 1.0 / variance));
  }

  const RotorResponse& response_;
  Witness witness_;
  Eigen::Index n_;
  MatrixXd normal_;
  VectorXd right_;
  double square_ = 0.0, degrees_ = 0.0;
};

/// How strongly one witness alone says that rotor `j` is off, with the sign of its thrust [sigmas].
double Says(const Balance& balance, Eigen::Index j) {
  const Balance::Fit fit = balance.Solve(j);
  const double misfit = std::max(1.0, fit.chi / std::max(1.0, balance.degrees()));
  const double size = std::sqrt(std::max(0.0, balance.Solve(-1).chi - fit.chi) / misfit);
  return std::copysign(size, fit.scale);
}

/// What each rotor's reading may be off by, one of them at most.
std::vector<StreamDoubt> Doubts(const std::vector<Balance::Fit>& fits, double degrees) {
  std::vector<RareError> errors;
  double odds = 1.0;
  for (const Balance::Fit& fit : fits) {
    const double misfit = std::sqrt(std::max(1.0, fit.chi / degrees));
    const double sigma = std::hypot(fit.sigma * misfit, kThrustScatter);
    const double prior = kBadOnesAre / static_cast<double>(fits.size());
    errors.push_back(RareErrorPosterior(fit.scale, sigma, prior, kBadThrust));
    odds += errors.back().probability / (1.0 - errors.back().probability + 1e-12);
  }
  std::vector<StreamDoubt> doubts;
  for (size_t j = 0; j < errors.size(); ++j) {
    RareError& error = errors[j];
    error.probability = error.probability / (1.0 - error.probability + 1e-12) / odds;
    const double thrust = 1.0 + std::copysign(std::min(error.rms(), 0.9), error.mean);
    if (std::abs(thrust - 1.0) < kNoThrust) continue;
    doubts.push_back({"rotor_speeds", 0.0, 1.0 / std::sqrt(thrust), static_cast<int>(j)});
  }
  return doubts;
}

RotorScale Compare(const std::vector<Balance::Fit>& fits, double chi_without, double degrees,
                   const VectorXd& share) {
  RotorScale result;
  result.tested = true;
  const auto less = [](const auto& a, const auto& b) { return a.chi < b.chi; };
  const auto best = std::min_element(fits.begin(), fits.end(), less);
  result.rotor = static_cast<int>(best - fits.begin());
  // Where even the best fits badly, something else is wrong, and less is said.
  const double misfit = std::max(1.0, best->chi / degrees);
  result.significance = std::sqrt(std::max(0.0, chi_without - best->chi) / misfit);
  for (size_t j = 0; j < fits.size(); ++j) {
    if (static_cast<int>(j) == result.rotor) continue;
    const bool close = (fits[j].chi - best->chi) / misfit < kRunnerUp;
    const bool closest =
        !result.or_rotor || fits[j].chi < fits[static_cast<size_t>(*result.or_rotor)].chi;
    if (close && closest) result.or_rotor = static_cast<int>(j);
  }
  const double thrust = std::max(0.01, 1.0 + best->scale);  // over what the reading says
  result.factor = 1.0 / std::sqrt(thrust);
  result.sigma = 0.5 * result.factor * best->sigma * std::sqrt(misfit) / thrust;
  const double sum = 1.0 + share[result.rotor] * (thrust - 1.0);  // true over read
  result.k_f_shift = sum - 1.0;
  return result;
}

}  // namespace

RotorScale FindRotorScale(const RotorResponse& response, const Vehicle& vehicle) {
  RotorScale result;
  if (response.blocks == 0) return result;
  const auto n = response.share.size();
  Eigen::Index least = 0;
  if (response.share.minCoeff(&least) < kReadsZero / static_cast<double>(n)) {
    result.tested = result.reads_zero = true;
    result.rotor = static_cast<int>(least);
    return result;
  }
  const Balance balance(response, vehicle, Witness::kBoth);
  std::vector<Balance::Fit> fits;
  for (Eigen::Index j = 0; j < n; ++j) fits.push_back(balance.Solve(j));
  result = Compare(fits, balance.Solve(-1).chi, balance.degrees(), response.share);
  result.doubts = Doubts(fits, balance.degrees());
  const double sign = result.factor < 1.0 ? 1.0 : -1.0;
  result.effects_say = sign * Says(Balance(response, vehicle, Witness::kEffects), result.rotor);
  result.steady_says = sign * Says(Balance(response, vehicle, Witness::kSteady), result.rotor);
  return result;
}

std::vector<Finding> ScaleFindings(const RotorScale& scale, const Vehicle& vehicle) {
  if (!scale.tested) return {};
  const std::string rotor = "rotor" + std::to_string(scale.rotor + 1);
  if (scale.reads_zero) {
    // With four rotors nothing else can carry its share; more rotors can.
    const Trust leaves = vehicle.num_rotors() <= 4 ? Trust::kBad : Trust::kDoubtful;
    return {{"rotor_scale", leaves,
             rotor + " reads almost zero while the vehicle flies on the others",
             "its sensor is dead, or the rotor"}};
  }
  if (scale.significance < kSignificant || scale.effects_say < kWitness ||
      scale.steady_says < kWitness) {
    return {};
  }
  const double percent = 100.0 * (scale.factor - 1.0);
  Finding finding{"rotor_scale", Trust::kGood, ""};
  if (std::abs(scale.k_f_shift) > kHarmful) finding.leaves = Trust::kDoubtful;
  finding.what =
      rotor + (scale.or_rotor ? " (or rotor" + std::to_string(*scale.or_rotor + 1) + ")" : "") +
      " reads " + Format("%.0f", std::abs(percent)) + " +- " + Format("%.0f", 100.0 * scale.sigma) +
      " % too " + (percent > 0.0 ? "high" : "low") + " beside the others (" +
      Format("%.1f", scale.significance) + " sigma), or its propeller gives " +
      Format("%.0f", 100.0 * std::abs(1.0 / (scale.factor * scale.factor) - 1.0)) + " % " +
      (percent > 0.0 ? "less" : "more") + " thrust than theirs";
  finding.mend = "check its sensor and propeller; k_f is off by " +
                 Format("%+.0f", 100.0 * scale.k_f_shift) + " %";
  return {finding};
}

}  // namespace odmc
