#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "odmc/analysis/prediction.h"
#include "odmc/attribution/attribution_options.h"
#include "odmc/attribution/gust_likelihood.h"
#include "odmc/attribution/model_point.h"
#include "odmc/attribution/ranked_effect.h"
#include "odmc/model/parameter_set.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// The case for gusts, and the values of the drag that goes with them.
struct GustCase {
  RankedEffect ranked;
  GustTest test;
  double functions = 0.0;  ///< what functions of the state gain of the force [nats]
  /// Of their variance, what is a force, by a second sensor; the rest is an error of the first, as
  /// an attitude that leans slowly. 1 where there is no second one.
  double acting_share = 1.0;
  std::map<std::string, ParameterSetting> known;  ///< what it is known of others, by full name
  /// Their wrench at every sample as foreseen 0.12 s before (N×6); empty where gusts gain nothing.
  ResidualModel::Wrenches foreseen;
};

/// How much of a force that one sensor shows another shows, too: the regression of `again` on
/// `foreseen`, both without their means, over all rows and columns.
struct SecondSensorShare {
  double share = 0.0;  ///< 1: all of it
  double sigma = 0.0;  ///< by blocks of the flight

  /// What acts of the first sensor's force, its posterior mean: all of it or, as likely a priori,
  /// any share between none and all.
  double ActingShare() const;
};

/// @param foreseen force by the one sensor (N×2) [N]
/// @param again  by the other
/// @returns nothing for no rows, or a flight of fewer than six blocks
std::optional<SecondSensorShare> ShareInSecondSensor(const ThinnedFlight& flight,
                                                     const Eigen::MatrixX2d& foreseen,
                                                     const Eigen::MatrixX2d& again);

/// The case for gusts behind what a model leaves; they vary, so that no fixed regressor shows them.
/// @param left what the model leaves of the wrench (N×6)
/// @param declared the online estimate without effects added
/// @param functions what functions of the state gain of the force beside that model [nats]
/// @param jobs hypotheses fitted at a time
GustCase RankGusts(const ResidualModel& residual, const ModelPoint& point,
                   const ResidualModel::Wrenches& left, const ParameterSet& declared,
                   double functions, const AttributionOptions& options, int jobs = 1);

/// True if gusts beat noise by more than functions of the state do, and no rival explains the same
/// clearly better: a free force (wind through nearly equal drag along all axes is nearly one, and
/// of the two only wind is known to act on vehicles), one of which a part follows the place, or
/// knocks. Of what one sensor shows of them, what a second one does not show does not count.
bool IsGusty(const GustCase& gusts, const AttributionOptions& options);

/// Gusts as a Kalman filter predicts them, each from before the sample's own filter window. (The
/// estimator's window takes a parameter for constant over its length and lags by half of that.)
/// @pre the model has the effect `gust`
ValueVariation PredictedGusts(const FlightLog& log, const Vehicle& file_vehicle,
                              const DynamicModel& model, const ModelValues& estimate,
                              const std::vector<std::pair<Stamp, Stamp>>& ground_spans,
                              bool with_torque);

}  // namespace odmc
