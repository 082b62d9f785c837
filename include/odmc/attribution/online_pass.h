#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "odmc/analysis/prediction.h"
#include "odmc/analysis/replay.h"
#include "odmc/attribution/attribution_options.h"
#include "odmc/attribution/residual.h"
#include "odmc/estimator/options.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// What a prediction misses at one sample: of force [N] and torque [N m], in the vehicle file's
/// body axes.
struct WrenchError {
  double t_s, speed_m_s;
  Eigen::Vector3d force, torque;
};

/// One pass of the online estimator, which does not see the blocks held out, with what its last
/// estimate misses of everything.
struct OnlinePass {
  ReplayResult replay;  ///< without its history and timing
  ParameterSet parameters;
  std::vector<WrenchError> errors;
  PredictionFigures held_out;  ///< on blocks held out
};

/// Smallest and largest ratio of errors, after over before, of any axis; 1 where there is none.
struct ErrorRatios {
  double least = 1.0, largest = 1.0;
};

/// @param felt true if the force that an accelerometer feels counts, too (a velocity's derivative
/// may be mostly noise)
ErrorRatios RatiosOf(const PredictionFigures& before, const PredictionFigures& after,
                     bool felt = false);

/// Mean logarithm of the errors of force and angular acceleration.
double LogError(const PredictionFigures& figures);

/// True if a run that stays near the fit takes the place of one that does not. Where the two
/// contradict each other, the one that predicts worse is wrong. Else the free run only says less,
/// and the other has to predict as well: their figures differ by `least_ratio` without a cause.
bool TakesPlace(const PredictionFigures& near_fit, const PredictionFigures& free, bool contradicts,
                const AttributionOptions& options);

/// True if effects make the model worse as a whole, and some axis beyond chance: its error doubles
/// (1 / `telling_ratio`).
bool Ruins(const PredictionFigures& without, const PredictionFigures& with,
           const AttributionOptions& options);

/// @param file_vehicle the vehicle file as it is: measured forces and torques come from it
/// @param progress gets the share done
/// @returns nothing if the vehicle never flies as the model has it
std::optional<OnlinePass> RunOnline(const FlightLog& log, const Vehicle& file_vehicle,
                                    const DynamicModel& model, const EstimatorOptions& options,
                                    const BlockSplit& blocks,
                                    const std::function<void(double)>& progress);

}  // namespace odmc
