#include "odmc/attribution/contained_effects.h"

#include <Eigen/QR>
#include <cmath>

namespace odmc {
namespace {

constexpr double kContained = 1e-3;  // share of the amplitude that the other effect may leave

/// What an effect's coefficients do to the wrench on all flights, one below the other (6N×n).
Eigen::MatrixXd ColumnsOf(const std::vector<FlightWithInstruments>& flights,
                          const ModelPoint& point, const std::string& effect) {
  const DynamicModel model(point.vehicle, point.vehicle.effects);
  std::vector<int> coefficients;
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[static_cast<size_t>(i)];
    if (p.effect == effect && p.estimated && !p.spec.initial_state) coefficients.push_back(i);
  }
  Eigen::Index rows = 0;
  const auto rows_of = [](const FlightWithInstruments& flight) {
    return kNumChannels * static_cast<Eigen::Index>(flight.residual->flight().size());
  };
  for (const FlightWithInstruments& flight : flights) rows += rows_of(flight);
  Eigen::MatrixXd columns(rows, static_cast<Eigen::Index>(coefficients.size()));
  Eigen::Index row = 0;
  for (size_t f = 0; f < flights.size(); ++f) {
    const ModelValues values = ValuesOf(model, point.OfFlight(f).values);
    const Eigen::Index n = rows_of(flights[f]);
    for (size_t k = 0; k < coefficients.size(); ++k) {
      const ResidualModel::Wrenches d =
          flights[f].residual->Derivative(model, values, coefficients[k]);
      columns.col(static_cast<Eigen::Index>(k)).segment(row, n) = d.reshaped();
    }
    row += n;
  }
  return columns;
}

}  // namespace

std::vector<std::string> ContainedEffects(const std::vector<FlightWithInstruments>& flights,
                                          const ModelPoint& point,
                                          const std::vector<std::string>& effects,
                                          const std::string& other) {
  std::vector<std::string> contained;
  const Eigen::MatrixXd by_other = ColumnsOf(flights, point, other);
  if (by_other.cols() == 0) return contained;
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(by_other);
  for (const std::string& effect : effects) {
    const Eigen::MatrixXd columns = ColumnsOf(flights, point, effect);
    if (columns.cols() == 0 || columns.isZero()) continue;
    const Eigen::MatrixXd left = columns - by_other * qr.solve(columns);
    const auto limit = kContained * columns.colwise().norm().array();
    if ((left.colwise().norm().array() <= limit).all()) contained.push_back(effect);
  }
  return contained;
}

}  // namespace odmc
