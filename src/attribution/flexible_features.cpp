#include "odmc/attribution/flexible_features.h"

#include <algorithm>
#include <cmath>

#include "odmc/estimator/gates.h"
#include "odmc/math/farthest_rows.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;

const char* const kNames[] = {"forward speed", "sideways speed", "climb speed", "speed",
                              "roll rate",     "pitch rate",     "yaw rate",    "tilt x",
                              "tilt y",        "heading x",      "heading y",   "thrust",
                              "roll torque",   "pitch torque",   "yaw torque",  "place x",
                              "place y",       "height",         "time"};
constexpr Index kSignals = static_cast<Index>(std::size(kNames));

Eigen::Matrix<double, kSignals, 1> SignalsOf(const FilteredMotion& s, const Vehicle& vehicle) {
  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  const Eigen::Matrix3d R_BW = R_BS * s.R_WS.transpose();
  Eigen::Matrix<double, kSignals, 1> signals;
  signals << R_BW * s.v_WS, s.v_WS.norm(), R_BS * s.w_S, R_BW(0, 2), R_BW(1, 2), R_BW(0, 0),
      R_BW(0, 1), s.rotors.speed_squared.sum(),
      RotorTorqueDirection(vehicle, s.rotors.speed_squared), s.p_WS, s.t_s;
  return signals;
}

/// Takes a column's mean off, over all flights, and its size.
void Standardize(Index column, std::vector<MatrixXd>* all, std::vector<MatrixXd>* likely) {
  double sum = 0.0, squares = 0.0, n = 0.0;
  for (const MatrixXd& of : *all) {
    sum += of.col(column).sum();
    n += static_cast<double>(of.rows());
  }
  const double mean = sum / std::max(1.0, n);
  for (const MatrixXd& of : *all) squares += (of.col(column).array() - mean).square().sum();
  const double size = std::sqrt(squares / std::max(1.0, n));
  const double scale = size > 0.0 ? 1.0 / size : 0.0;
  for (std::vector<MatrixXd>* some : {all, likely}) {
    for (MatrixXd& of : *some) of.col(column) = scale * (of.col(column).array() - mean).matrix();
  }
}

constexpr Index kPlace = 15;  // the first of the three signals
const char* const kConstant = "nothing (it is constant)";

/// Places that cover where was flown: what stands in one of them acts near it.
class Places {
 public:
  /// @param signals by flight, as they are
  explicit Places(const std::vector<MatrixXd>& signals) {
    Index n = 0;
    for (const MatrixXd& of : signals) n += of.rows();
    MatrixXd places(n, 3);
    Index row = 0;
    for (const MatrixXd& of : signals) {
      places.middleRows(row, of.rows()) = of.middleCols<3>(kPlace);
      row += of.rows();
    }
    const FarthestRows farthest(places, kMost, kLeastDistance);
    width_ = kWidth * farthest.extent;
    if (!(width_ > 0.0)) return;
    for (const Index k : farthest.rows) centres_.emplace_back(places.row(k));
  }

  Index count() const { return static_cast<Index>(centres_.size()); }

  /// Samples × places. @param signals as they are
  MatrixXd NearnessTo(const MatrixXd& signals) const {
    MatrixXd near(signals.rows(), count());
    for (Index k = 0; k < count(); ++k) {
      const MatrixXd away =
          signals.middleCols<3>(kPlace).rowwise() - centres_[static_cast<size_t>(k)];
      near.col(k) = (-0.5 / (width_ * width_) * away.rowwise().squaredNorm().array()).exp();
    }
    return near;
  }

  std::vector<std::string> names() const {
    std::vector<std::string> names;
    for (const Eigen::RowVector3d& at : centres_) {
      names.push_back("nearness to (" + Rounded(at.x()) + ", " + Rounded(at.y()) + ", " +
                      Rounded(at.z()) + ") m");
    }
    return names;
  }

 private:
  static constexpr size_t kMost = 24;
  static constexpr double kLeastDistance = 0.1, kWidth = 0.15;  // of the extent

  std::vector<Eigen::RowVector3d> centres_;
  double width_ = 0.0;
};

}  // namespace

FlexibleFeatures::FlexibleFeatures(const std::vector<FlightWithInstruments>& flights) {
  const auto num_flights = flights.size();
  // As they are, and in the likely motion; standardized alike.
  std::vector<MatrixXd> signals(num_flights), likely_signals(num_flights);
  for (size_t f = 0; f < num_flights; ++f) {
    const ThinnedFlight& flight = flights[f].residual->flight();
    const ThinnedFlight& likely = flights[f].instruments->likely_flight();
    const Vehicle& vehicle = flights[f].residual->file_vehicle();
    signals[f].resize(flight.size(), kSignals);
    likely_signals[f].resize(flight.size(), kSignals);
    for (int i = 0; i < flight.size(); ++i) {
      signals[f].row(i) = SignalsOf(flight.sample(i), vehicle).transpose();
      likely_signals[f].row(i) = SignalsOf(likely.sample(i), vehicle).transpose();
    }
  }
  const Places places(signals);
  std::vector<MatrixXd> near(num_flights), likely_near(num_flights);
  for (size_t f = 0; f < num_flights; ++f) {
    near[f] = places.NearnessTo(signals[f]);
    likely_near[f] = places.NearnessTo(likely_signals[f]);
  }
  for (Index k = 0; k < kSignals; ++k) Standardize(k, &signals, &likely_signals);
  for (Index k = 0; k < places.count(); ++k) Standardize(k, &near, &likely_near);
  AddAlongBody(signals, likely_signals, flights);
  AddAlongWorld(signals, likely_signals, near, likely_near, places.names(), flights);
}

void FlexibleFeatures::AddAlongBody(const std::vector<MatrixXd>& signals,
                                    const std::vector<MatrixXd>& likely_signals,
                                    const std::vector<FlightWithInstruments>& flights) {
  const Index products = 1 + kSignals;
  std::vector<MatrixXd> all(signals.size()), likely(signals.size());
  for (size_t f = 0; f < signals.size(); ++f) {
    const Index n = signals[f].rows();
    all[f].resize(n, products + kSignals * (kSignals + 1) / 2);
    likely[f].resize(n, all[f].cols());
    all[f].leftCols(products) << Eigen::VectorXd::Ones(n), signals[f];
    likely[f].leftCols(products) << Eigen::VectorXd::Ones(n), likely_signals[f];
  }
  names.push_back(kConstant);
  for (const char* name : kNames) names.emplace_back(name);
  Index at = products;
  for (Index k = 0; k < kSignals; ++k) {
    for (Index l = k; l < kSignals; ++l, ++at) {
      for (size_t f = 0; f < signals.size(); ++f) {
        all[f].col(at) = signals[f].col(k).cwiseProduct(signals[f].col(l));
        likely[f].col(at) = likely_signals[f].col(k).cwiseProduct(likely_signals[f].col(l));
      }
      Standardize(at, &all, &likely);
      names.push_back(std::string(kNames[k]) + " times " + kNames[l]);
    }
  }
  for (size_t f = 0; f < signals.size(); ++f) {
    foreseen.push_back(flights[f].instruments->Foreseen(all[f], likely[f]));
  }
}

void FlexibleFeatures::AddAlongWorld(const std::vector<MatrixXd>& signals,
                                     const std::vector<MatrixXd>& likely_signals,
                                     const std::vector<MatrixXd>& near,
                                     const std::vector<MatrixXd>& likely_near,
                                     const std::vector<std::string>& names_of_places,
                                     const std::vector<FlightWithInstruments>& flights) {
  std::vector<std::string> sizes = {kConstant};
  for (Index k = kPlace; k < kPlace + 3; ++k) sizes.emplace_back(kNames[k]);
  sizes.insert(sizes.end(), names_of_places.begin(), names_of_places.end());
  for (const char* axis : {"x", "y", "z"}) {
    for (const std::string& size : sizes) world_names.push_back(size + "\" along world " + axis);
  }
  const auto count = static_cast<Index>(sizes.size());
  for (size_t f = 0; f < flights.size(); ++f) {
    const Index n = signals[f].rows();
    const Eigen::Matrix3d R_BS =
        flights[f].residual->file_vehicle().odometry.q_BS.toRotationMatrix();
    MatrixXd all(n, count), likely(n, count);
    all << Eigen::VectorXd::Ones(n), signals[f].middleCols<3>(kPlace), near[f];
    likely << Eigen::VectorXd::Ones(n), likely_signals[f].middleCols<3>(kPlace), likely_near[f];
    std::array<MatrixXd, 3> by_channel;
    for (int c = 0; c < 3; ++c) {
      MatrixXd turned(n, 3 * count), likely_turned(n, 3 * count);
      const auto turn = [&](const ThinnedFlight& flight, const MatrixXd& size, MatrixXd* to) {
        for (Index i = 0; i < n; ++i) {
          const Eigen::RowVector3d axes =
              R_BS.row(c) * flight.sample(static_cast<int>(i)).R_WS.transpose();
          for (int k = 0; k < 3; ++k) to->row(i).segment(k * count, count) = axes[k] * size.row(i);
        }
      };
      turn(flights[f].residual->flight(), all, &turned);
      turn(flights[f].instruments->likely_flight(), likely, &likely_turned);
      by_channel[static_cast<size_t>(c)] = flights[f].instruments->Foreseen(turned, likely_turned);
    }
    world_foreseen.push_back(std::move(by_channel));
  }
}

}  // namespace odmc
