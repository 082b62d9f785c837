#include "odmc/attribution/flexible_features.h"

#include <cmath>

#include "odmc/estimator/gates.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;

const char* const kNames[] = {
    "forward speed", "sideways speed", "climb speed", "speed",         "roll rate",
    "pitch rate",    "yaw rate",       "tilt x",      "tilt y",        "heading x",
    "heading y",     "thrust",         "roll torque", "pitch torque",  "yaw torque",
    "place x",       "place y",        "height",      "time"};
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

}  // namespace

FlexibleFeatures::FlexibleFeatures(const ThinnedFlight& flight, const Vehicle& file_vehicle,
                                   const Instruments& instruments) {
  const Index n = flight.size();
  // As they are, and in the likely motion; standardized alike.
  MatrixXd signals(n, kSignals), likely_signals(n, kSignals);
  for (int i = 0; i < flight.size(); ++i) {
    signals.row(i) = SignalsOf(flight.sample(i), file_vehicle).transpose();
    likely_signals.row(i) =
        SignalsOf(instruments.likely_flight().sample(i), file_vehicle).transpose();
  }
  const auto standardize = [n](auto column, auto likely) {
    const double mean = column.mean();
    column.array() -= mean;
    likely.array() -= mean;
    const double size = column.norm() / std::sqrt(static_cast<double>(n));
    column *= size > 0.0 ? 1.0 / size : 0.0;
    likely *= size > 0.0 ? 1.0 / size : 0.0;
  };
  for (Index k = 0; k < kSignals; ++k) standardize(signals.col(k), likely_signals.col(k));
  MatrixXd all(n, 1 + kSignals + kSignals * (kSignals + 1) / 2), likely(n, all.cols());
  all.col(0).setOnes();
  likely.col(0).setOnes();
  names.push_back("nothing (it is constant)");
  Index at = 1;
  for (Index k = 0; k < kSignals; ++k, ++at) {
    all.col(at) = signals.col(k);
    likely.col(at) = likely_signals.col(k);
    names.emplace_back(kNames[k]);
  }
  for (Index k = 0; k < kSignals; ++k) {
    for (Index l = k; l < kSignals; ++l, ++at) {
      all.col(at) = signals.col(k).cwiseProduct(signals.col(l));
      likely.col(at) = likely_signals.col(k).cwiseProduct(likely_signals.col(l));
      standardize(all.col(at), likely.col(at));
      names.push_back(std::string(kNames[k]) + " times " + kNames[l]);
    }
  }
  foreseen = instruments.Foreseen(all, likely);
}

}  // namespace odmc
