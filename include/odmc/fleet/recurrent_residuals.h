#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/prediction.h"

namespace odmc {

/// Residual force, then residual torque, measured minus predicted, about x, y, z [N, N m].
constexpr int kResidualChannels = 6;
using ResidualChannels = Eigen::Matrix<double, kResidualChannels, 1>;
extern const std::array<const char*, kResidualChannels> kResidualChannelNames;

/// What residuals are sorted by.
struct ResidualQuantity {
  const char* name;  ///< with its unit
  double step;       ///< width of the finest bins; wider ones double it
};
constexpr int kResidualQuantities = 11;
extern const std::array<ResidualQuantity, kResidualQuantities> kResidualQuantityTable;

/// Residuals over time in bins [k w, (k + 1) w) of one quantity, w = step 2^level.
class ResidualBins {
 public:
  /// What falls into one bin.
  struct Sum {
    double seconds = 0.0;
    ResidualChannels residual = ResidualChannels::Zero();  ///< times seconds

    void Add(const Sum& other);
    ResidualChannels Mean() const { return residual / seconds; }
  };

  /// Doubles the width of all bins where there come to be more of them than a flight may have.
  void Add(double in_steps, const Sum& sum);
  /// In the wider bins of the two; as many as there are.
  void Add(ResidualBins other);
  void CoarsenTo(int level);
  int level() const { return level_; }
  const std::map<long, Sum>& bins() const { return bins_; }

 private:
  int level_ = 0;
  std::map<long, Sum> bins_;
};

/// Residuals of one flight by every quantity. Bounded memory, however long the flight.
class FlightResiduals {
 public:
  void Add(const PredictionSample& sample, double weight_N);
  const ResidualBins& of(int quantity) const { return bins_[static_cast<size_t>(quantity)]; }

 private:
  std::optional<double> first_s_;  ///< of flight
  double last_s_ = 0.0;
  std::array<ResidualBins, kResidualQuantities> bins_;
};

/// One channel in one bin over all flights.
struct RecurrentResidual {
  int quantity = 0, channel = 0;
  double from = 0.0, to = 0.0;  ///< the bin
  double mean = 0.0;            ///< of the flights' means [N, N m]
  double sigma = 0.0;           ///< of `mean`
  double scatter = 0.0;         ///< standard deviation of the flights' means
  double share_of_error = 0.0;  ///< |mean| over the channel's error on flights left out
  int flights = 0;              ///< that have been there
  int same_sign = 0;            ///< of these, with the sign of `mean`
  double p_value = 1.0;         ///< all bins and channels accounted for (Holm)
};

/// Flights that must have been in a bin, and for how long, for it to be looked at.
constexpr int kLeastResidualFlights = 5;
constexpr double kLeastResidual_s = 0.5;
/// Of a channel's error on flights left out: a mean that is smaller is no news, without it the
/// squared error in the bin would be less by 1 %.
constexpr double kLeastResidualShare = 0.1;

/// Looks at every channel in every bin for a mean that is off by more than the least share in the
/// same direction on most flights: Student's t over the flights' means, each counting once. Bins
/// of a quantity are as narrow as eight that hold 95 % of all flight time can be.
/// @param error of each channel on flights left out, rms
/// @returns all of them, the least likely by chance first
std::vector<RecurrentResidual> FindRecurrentResiduals(
    const std::vector<const FlightResiduals*>& flights, const ResidualChannels& error);

}  // namespace odmc
