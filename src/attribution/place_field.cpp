#include "odmc/attribution/place_field.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
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
constexpr size_t kWidths = 5;            // octaves
constexpr double kMostWidth = 0.5;       // of the extent
const std::vector<double> kSizes = {0.06, 0.12, 0.25, 0.5, 1.0, 2.0};  // of the residual force
constexpr Index kAxes = 3;

/// Logarithm of a mean of exponentials.
double LogMeanExp(const std::vector<double>& logs) {
  double most = -std::numeric_limits<double>::infinity(), sum = 0.0;
  for (const double x : logs) most = std::max(most, x);
  for (const double x : logs) sum += std::exp(x - most);
  return most + std::log(sum / static_cast<double>(logs.size()));
}

/// What changes within less than the vehicle averages out over it. And so near, place would be
/// where the force itself has moved a vehicle that hovers.
std::vector<double> WidthsOf(double vehicle_m, double extent_m) {
  std::vector<double> widths_m;
  if (!(vehicle_m > 0.0)) return widths_m;
  for (double width_m = vehicle_m; width_m <= kMostWidth * extent_m; width_m *= 2.0) {
    widths_m.push_back(width_m);
    if (widths_m.size() == kWidths) break;
  }
  return widths_m;
}

/// Columns of a constant and the field's features, axis by axis: those of the constant.
std::vector<Index> SteadyOf(Index count) { return {0, count, 2 * count}; }

/// Those of a force along some axes of the world, for any choice of these.
std::vector<std::vector<Index>> FieldsOf(Index count) {
  std::vector<std::vector<Index>> fields;
  for (unsigned choice = 1; choice < 1u << kAxes; ++choice) {
    fields.emplace_back();
    for (Index axis = 0; axis < kAxes; ++axis) {
      if ((choice >> axis & 1u) == 0) continue;
      for (Index k = 1; k < count; ++k) fields.back().push_back(axis * count + k);
    }
  }
  return fields;
}

MatrixXd PlacesOf(const ThinnedFlight& flight) {
  MatrixXd places(flight.size(), kAxes);
  for (int i = 0; i < flight.size(); ++i) places.row(i) = flight.sample(i).p_WS.transpose();
  return places;
}

/// Forces of these sizes along each axis of the world, as one channel of the body has them.
/// @param sizes samples × functions @returns samples × 3 functions, axis by axis
MatrixXd AlongWorld(const ThinnedFlight& flight, int channel, const MatrixXd& sizes) {
  MatrixXd turned(sizes.rows(), kAxes * sizes.cols());
  for (Index i = 0; i < sizes.rows(); ++i) {
    const Eigen::RowVector3d axes = flight.R_WB(static_cast<int>(i)).col(channel).transpose();
    for (Index k = 0; k < kAxes; ++k) {
      turned.row(i).segment(k * sizes.cols(), sizes.cols()) = axes[k] * sizes.row(i);
    }
  }
  return turned;
}

/// Gains of a field beside a force that is the same everywhere, which is none.
class Beside {
 public:
  Beside(const MatrixXd& A, const VectorXd& b, const std::vector<Index>& steady)
      : A_(A), b_(b), steady_(steady) {
    MatrixXd of_steady = A(steady, steady);
    of_steady.diagonal().array() += 1.0;
    llt_.compute(of_steady);
  }

  double Gain(const std::vector<Index>& field) const {
    const MatrixXd between = A_(steady_, field);
    return GainOfRandomCoefficients(
        MatrixXd(A_(field, field)) - between.transpose() * llt_.solve(between),
        VectorXd(b_(field)) - between.transpose() * llt_.solve(VectorXd(b_(steady_))), kSizes);
  }

 private:
  const MatrixXd& A_;
  const VectorXd& b_;
  std::vector<Index> steady_;
  Eigen::LLT<MatrixXd> llt_;
};

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
  MatrixXd all(0, kAxes);
  for (size_t f = 0; f < flights_.size(); ++f) {
    places.push_back(PlacesOf(flights_[f].flight()));
    errors.push_back(ErrorsOf(f, set, fit));
    all.conservativeResize(all.rows() + places[f].rows(), Eigen::NoChange);
    all.bottomRows(places[f].rows()) = places[f];
  }
  const FarthestRows farthest(all, kCentres, kLeastDistance);
  const double vehicle_m = 2.0 * flights_.front().residual().file_vehicle().ArmLength();
  const std::vector<double> widths_m = WidthsOf(vehicle_m, farthest.extent);
  if (widths_m.empty()) return 0.0;
  const MatrixXd centres = all(farthest.rows, Eigen::all);
  const double unit = ForceSigma();
  std::vector<std::vector<double>> nats(widths_m.size());
  ForEachOf(static_cast<int>(widths_m.size()), jobs_, [&](int w) {
    const Index count = centres.rows() + 1, columns = kAxes * count;
    MatrixXd A = MatrixXd::Zero(columns, columns);
    FlexibleSums sums(static_cast<Index>(fit.columns.size()), columns);
    for (size_t f = 0; f < flights_.size(); ++f) {
      MatrixXd size(places[f].rows(), count);
      size << VectorXd::Ones(size.rows()),
          FieldFeatures(places[f], centres, widths_m[static_cast<size_t>(w)]);
      for (int c = 0; c < static_cast<int>(kAxes); ++c) {
        const MatrixXd turned = AlongWorld(flights_[f].flight(), c, size);
        A.selfadjointView<Eigen::Lower>().rankUpdate(
            AddTo(&sums, f, c, turned, unit, fit, errors[f], nullptr).transpose());
      }
    }
    A.triangularView<Eigen::StrictlyUpper>() = A.transpose();
    A -= sums.cross.transpose() * fit.covariance * sums.cross;
    const Beside beside(A, sums.g, SteadyOf(count));
    for (const std::vector<Index>& field : FieldsOf(count)) {
      nats[static_cast<size_t>(w)].push_back(beside.Gain(field));
    }
  });
  std::vector<double> each;
  for (const std::vector<double>& of_width : nats) {
    each.insert(each.end(), of_width.begin(), of_width.end());
  }
  return LogMeanExp(each);
}

}  // namespace odmc
