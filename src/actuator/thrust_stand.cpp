#include "odmc/actuator/thrust_stand.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "odmc/math/statistics.h"

namespace odmc {
namespace {

constexpr double kHuber = 3.0;
constexpr double kOutlier_sigmas = 8.0;

// One reading: load = coefficient * squares + offset of its run.
struct Reading {
  double squares;  // sum over the rotors [rad²/s²]
  double load;
  int run;
  long level;  // readings at one command hang together
};

std::vector<Reading> ReadingsOf(const std::vector<BenchRun>& runs,
                                const std::vector<double> BenchRun::*load) {
  std::vector<Reading> readings;
  long level = 0;
  for (size_t k = 0; k < runs.size(); ++k) {
    const BenchRun& run = runs[k];
    ++level;
    for (size_t i = 0; i < (run.*load).size(); ++i) {
      if (i > 0 && run.throttle.front()[i] != run.throttle.front()[i - 1]) ++level;
      double squares = 0.0;
      for (const auto& speed : run.speed_rad_s) squares += speed[i] * speed[i];
      const double value = (run.*load)[i];
      if (std::isfinite(squares) && std::isfinite(value))
        readings.push_back({squares, value, static_cast<int>(k), level});
    }
  }
  return readings;
}

std::optional<StandFit> Fit(const std::vector<BenchRun>& runs,
                            const std::vector<double> BenchRun::*load, bool with_offset) {
  const std::vector<Reading> readings = ReadingsOf(runs, load);
  const int n = with_offset ? 1 + static_cast<int>(runs.size()) : 1;
  if (static_cast<int>(readings.size()) < 3 + n) return std::nullopt;
  double size = 0.0;  // of the squares, so that both columns are of order one
  for (const Reading& r : readings) size = std::max(size, r.squares);
  const auto row_of = [&](const Reading& r) {
    Eigen::VectorXd row = Eigen::VectorXd::Zero(n);
    row[0] = r.squares / size;
    if (with_offset) row[1 + r.run] = 1.0;
    return row;
  };
  Eigen::VectorXd x = Eigen::VectorXd::Zero(n);
  Eigen::MatrixXd A(n, n);
  std::vector<double> weights(readings.size(), 1.0), errors(readings.size());
  double sigma = 0.0;
  for (int round = 0; round < 10; ++round) {
    A.setZero();
    Eigen::VectorXd b = Eigen::VectorXd::Zero(n);
    for (size_t i = 0; i < readings.size(); ++i) {
      const Eigen::VectorXd row = row_of(readings[i]);
      A += weights[i] * row * row.transpose();
      b += weights[i] * row * readings[i].load;
    }
    x = A.completeOrthogonalDecomposition().solve(b);
    for (size_t i = 0; i < readings.size(); ++i)
      errors[i] = row_of(readings[i]).dot(x) - readings[i].load;
    sigma = std::max(RobustSigma(errors), 1e-12);
    for (size_t i = 0; i < readings.size(); ++i)
      weights[i] = std::min(1.0, kHuber * sigma / std::max(std::abs(errors[i]), 1e-300));
  }
  // Errors at one command are of one kind: they count as one when it comes to the sigma.
  Eigen::MatrixXd B = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(n);
  StandFit fit;
  double squares = 0.0;
  for (size_t i = 0; i < readings.size(); ++i) {
    sum += weights[i] * errors[i] * row_of(readings[i]);
    if (i + 1 == readings.size() || readings[i + 1].level != readings[i].level) {
      B += sum * sum.transpose();
      sum.setZero();
    }
    if (std::abs(errors[i]) > kOutlier_sigmas * sigma) {
      ++fit.outliers;
      continue;
    }
    squares += errors[i] * errors[i];
    ++fit.rows;
  }
  const Eigen::MatrixXd inverse =
      A.completeOrthogonalDecomposition().solve(Eigen::MatrixXd::Identity(n, n));
  // As few levels as unknowns leave no error between levels: then that of independent readings.
  const Eigen::MatrixXd hanging = inverse * B * inverse, white = sigma * sigma * inverse;
  const auto sigma_of = [&](int k) { return std::sqrt(std::max(hanging(k, k), white(k, k))); };
  fit.coefficient = {x[0] / size, sigma_of(0) / size};
  for (int k = 1; k < n; ++k) fit.offsets.push_back({x[k], sigma_of(k)});
  fit.rmse = fit.rows > 0 ? std::sqrt(squares / static_cast<double>(fit.rows)) : 0.0;
  return fit;
}

}  // namespace

std::optional<StandFit> FitThrust(const std::vector<BenchRun>& runs) {
  return Fit(runs, &BenchRun::thrust_N, false);
}

std::optional<StandFit> FitTorque(const std::vector<BenchRun>& runs) {
  return Fit(runs, &BenchRun::torque_Nm, true);
}

}  // namespace odmc
