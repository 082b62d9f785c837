#include "odmc/attribution/place_field.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <vector>

#include "odmc/analysis/parallel.h"
#include "odmc/attribution/evidence.h"
#include "odmc/math/farthest_rows.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr size_t kCentres = 120;
constexpr double kLeastDistance = 0.02;  // of the extent, between centres
constexpr std::array<double, 5> kWidths = {0.03, 0.06, 0.12, 0.25, 0.5};  // of the extent
const std::vector<double> kSizes = {0.06, 0.12, 0.25, 0.5, 1.0, 2.0};     // of the residual force
constexpr Index kAxes = 3;

/// Logarithm of a mean of exponentials.
double LogMeanExp(const std::vector<double>& logs) {
  double most = -std::numeric_limits<double>::infinity(), sum = 0.0;
  for (const double x : logs) most = std::max(most, x);
  for (const double x : logs) sum += std::exp(x - most);
  return most + std::log(sum / static_cast<double>(logs.size()));
}

}  // namespace

MatrixXd FieldFeatures(const MatrixXd& places, const MatrixXd& centres, double width_m) {
  const auto kernel = [width_m](const auto& a, const auto& b) {
    return std::exp(-0.5 * (a - b).squaredNorm() / (width_m * width_m));
  };
  const Index count = centres.rows();
  MatrixXd K(count, count), phi(places.rows(), count);
  for (Index a = 0; a < count; ++a) {
    for (Index b = 0; b < count; ++b) K(a, b) = kernel(centres.row(a), centres.row(b));
    for (Index k = 0; k < places.rows(); ++k) phi(k, a) = kernel(places.row(k), centres.row(a));
  }
  K.diagonal().array() += 1e-6;
  return K.llt().matrixL().solve(phi.transpose()).transpose() * MatrixXd::Identity(count, count);
}

double GainOfRandomCoefficients(const MatrixXd& A, const VectorXd& b,
                                const std::vector<double>& sizes) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(A);
  const Eigen::ArrayXd along = (eigen.eigenvectors().transpose() * b).array().square();
  std::vector<double> nats;
  for (const double size : sizes) {
    const double variance = size * size;
    const Eigen::ArrayXd one_more = 1.0 + variance * eigen.eigenvalues().array().max(0.0);
    nats.push_back(0.5 * (variance * (along / one_more).sum() - one_more.log().sum()));
  }
  return LogMeanExp(nats);
}

double Evidence::GainOfThePlace(const VariantSet& set) const {
  const EffectFit fit = Solve(set);
  std::vector<MatrixXd> places;
  std::vector<VectorXd> errors;
  Index samples = 0;
  for (size_t f = 0; f < flights_.size(); ++f) {
    const ThinnedFlight& flight = flights_[f].flight();
    places.emplace_back(flight.size(), kAxes);
    for (int i = 0; i < flight.size(); ++i) places[f].row(i) = flight.sample(i).p_WS.transpose();
    samples += flight.size();
    errors.push_back(ErrorsOf(f, set, fit));
  }
  MatrixXd all(samples, kAxes);
  Index at = 0;
  for (const MatrixXd& of : places) {
    all.middleRows(at, of.rows()) = of;
    at += of.rows();
  }
  const FarthestRows farthest(all, kCentres, kLeastDistance);
  if (!(farthest.extent > 0.0)) return 0.0;
  const MatrixXd centres = all(farthest.rows, Eigen::all);
  const double unit = ForceSigma();
  std::vector<double> nats(kWidths.size());
  ForEachOf(static_cast<int>(kWidths.size()), jobs_, [&](int w) {
    const Index count = centres.rows() + 1, columns = kAxes * count;
    MatrixXd A = MatrixXd::Zero(columns, columns);
    FlexibleSums sums(static_cast<Index>(fit.columns.size()), columns);
    for (size_t f = 0; f < flights_.size(); ++f) {
      MatrixXd size(places[f].rows(), count);
      size << VectorXd::Ones(size.rows()),
          FieldFeatures(places[f], centres, kWidths[static_cast<size_t>(w)] * farthest.extent);
      const ThinnedFlight& flight = flights_[f].flight();
      for (int c = 0; c < static_cast<int>(kAxes); ++c) {
        MatrixXd turned(size.rows(), columns);
        for (Index i = 0; i < size.rows(); ++i) {
          const Eigen::RowVector3d axes = flight.R_WB(static_cast<int>(i)).col(c).transpose();
          for (Index k = 0; k < kAxes; ++k) {
            turned.row(i).segment(k * count, count) = axes[k] * size.row(i);
          }
        }
        A.selfadjointView<Eigen::Lower>().rankUpdate(
            AddTo(&sums, f, c, turned, unit, fit, errors[f], nullptr).transpose());
      }
    }
    A.triangularView<Eigen::StrictlyUpper>() = A.transpose();
    A -= sums.cross.transpose() * fit.covariance * sums.cross;
    // A force that is the same everywhere is no field.
    std::vector<Index> steady, field;
    for (Index k = 0; k < columns; ++k) (k % count == 0 ? steady : field).push_back(k);
    const MatrixXd of_steady = MatrixXd(A(steady, steady)) + MatrixXd::Identity(kAxes, kAxes);
    const Eigen::LLT<MatrixXd> llt(of_steady);
    const MatrixXd between = A(steady, field);
    nats[static_cast<size_t>(w)] = GainOfRandomCoefficients(
        MatrixXd(A(field, field)) - between.transpose() * llt.solve(between),
        VectorXd(sums.g(field)) - between.transpose() * llt.solve(VectorXd(sums.g(steady))),
        kSizes);
  });
  return LogMeanExp(nats);
}

}  // namespace odmc
