#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/follow_flight.h"
#include "odmc/analysis/prediction.h"
#include "odmc/analysis/recorded_point.h"
#include "odmc/analysis/replay.h"
#include "odmc/analysis/torque_bands.h"
#include "odmc/inspection/stream_inspection.h"
#include "odmc/text/finding.h"

namespace odmc {

/// The recording in numbers.
struct FlightFigures {
  std::string file;
  double duration_s = 0.0;
  double on_ground_s = 0.0;
  long keyframes = 0;  ///< airborne ones
  long dropped = 0;    ///< samples refused: not finite, out of order
};

/// Time of one update [ms]; empty where no update counts.
struct TimingFigures {
  std::optional<double> median, p95, p99, max;
  long updates = 0;
};

/// How a model predicts what its estimate has not seen: every block of a flight left out in turn.
struct LeftOutPrediction {
  double block_s = 0.0;
  PredictionFigures figures;  ///< of all blocks; inertia_over_nominal empty: each has its own
};

/// A calibrated flight, with everything its report shows.
struct Calibration {
  FlightFigures flight;
  ParameterSet parameters;
  /// By how much each parameter's sigma is larger than the window's, see Snapshot::inflation.
  Eigen::VectorXd inflation;
  ReplayResult replay;
  Prediction prediction;
  TorqueBands bands;
  RecordedPoint point;
  TakenPoint taken_point;  ///< what was taken of it
  /// Inertia that was taken from bands, where they know it better than the estimator by itself.
  std::map<std::string, ParameterSetting> by_bands;
  Eigen::Vector3d nominal_inertia = Eigen::Vector3d::Ones();  ///< of the vehicle file [kg m²]
  std::optional<LeftOutPrediction> left_out;                  ///< where it was asked for
  std::vector<std::optional<double>> convergence_s;           ///< per parameter
  TimingFigures wall, cpu;                                    ///< of the updates after the start
  TimingFigures wall_start;                                   ///< of those in it
  int states_in_window = 0;
  int threads = 1;
  Stamp first_stamp = 0;                 ///< of the first odometry sample
  double start_s = 0.0;                  ///< of the replay's clock, after the first odometry sample
  std::vector<Finding> findings;         ///< what costs trust, and remarks
  std::vector<TimeOffset> time_offsets;  ///< of the streams, as recorded
  std::vector<std::string> warnings;     ///< the findings' sentences among them
};

/// A flight predicted with given parameters.
struct Evaluation {
  FlightFigures flight;
  std::vector<std::string> followed;  ///< parameters that are learned on the flight itself
  Prediction prediction;
  TorqueBands bands;
  Eigen::Vector3d nominal_inertia = Eigen::Vector3d::Ones();  ///< of the vehicle file [kg m²]
  std::vector<Finding> findings;                              ///< what costs trust, and remarks
  std::vector<TimeOffset> time_offsets;                       ///< of the streams, as recorded
  std::vector<std::string> warnings;  ///< the findings' sentences among them
};

/// Runs the estimator over `log`, then predicts `recording` with what it found.
/// @param recording the flight as recorded: `log` itself, unless noise was added to what the
///   estimator sees; the measured force must not show that noise
/// @param file_vehicle the vehicle file as it is (nominal inertia and mounts)
/// @param progress called with the share done (0 to 1), may be empty
/// @param predicted takes the prediction's samples, which are then not kept; empty: they are
/// @throws std::invalid_argument if the flight never leaves the ground or nothing is to be
/// estimated
Calibration Calibrate(const FlightLog& log, const FlightLog& recording, const Vehicle& file_vehicle,
                      const DynamicModel& model, const EstimatorOptions& options,
                      const std::function<void(double)>& progress = {},
                      const PredictionSink& predicted = {});

/// Adds what the streams of the recording say about each other to a result that has findings,
/// time_offsets and warnings.
template <typename Result>
void AddInspection(const StreamInspection& inspection, Result* result) {
  result->time_offsets = inspection.offsets;
  for (const Finding& finding : inspection.findings) {
    result->findings.push_back(finding);
    result->warnings.push_back(Sentence(finding));
  }
}

/// Of a longer flight its last minute shows what errors of its streams do to the estimate.
constexpr double kLongestDoubt_s = 60.0;

/// By how much the parameters would be others without each of the errors: replays the flight from
/// `from` on with them, and once without each.
/// @param values what the whole of `log` teaches with them, if known: saves a replay
/// @param give_up asked now and then: true ends it there; may be empty
/// @returns one for each error, none if it was given up
std::vector<Eigen::VectorXd> ChangesWithout(const std::vector<StreamDoubt>& doubts,
                                            const FlightLog& log, Stamp from,
                                            const DynamicModel& model,
                                            const EstimatorOptions& options,
                                            const ModelValues* values = nullptr,
                                            const std::function<bool()>& give_up = {});

/// Adds what parameters may be wrong by, each change at once and independent of the others, to
/// sigmas and covariance.
/// @param changes num_parameters()×1 each
/// @returns by what factor each sigma has grown
Eigen::VectorXd Widen(const std::vector<Eigen::VectorXd>& changes, ParameterSet* set);

/// One remark for each error that makes up a quarter or more of a parameter's variance, where such
/// errors make up most of it.
/// @param changes num_parameters()×1 each, one for each of `doubts`
/// @param widened  sigmas with the changes in them
std::vector<Finding> DoubtRemarks(const std::vector<StreamDoubt>& doubts,
                                  const std::vector<Eigen::VectorXd>& changes,
                                  const ParameterSet& widened);

/// Adds to sigmas and covariance what may be wrong with the streams: the flight (of a long one the
/// last minute) is replayed once without each error, and the change of the parameters squared
/// counts on top. A remark says where that is most of a sigma.
void WidenForDoubts(const FlightLog& log, const DynamicModel& model,
                    const EstimatorOptions& options, const std::vector<StreamDoubt>& doubts,
                    Calibration* calibration);

/// Runs the estimator once for each block of `block_s`, without that block, and predicts the block
/// with what the rest of the flight shows.
/// @param log, recording, file_vehicle as in Calibrate()
/// @throws std::invalid_argument if the flight is shorter than two blocks, or if the vehicle never
///   flies outside one of them
LeftOutPrediction PredictLeftOut(const FlightLog& log, const FlightLog& recording,
                                 const Vehicle& file_vehicle, const DynamicModel& model,
                                 const EstimatorOptions& options, double block_s);

/// How CalibrateInspected() goes about it.
struct CalibrateOptions {
  EstimatorOptions estimator = OfflineOptions();
  double leave_out_s = 0.0;           ///< of PredictLeftOut(); 0: nothing is left out
  std::optional<ParameterSet> start;  ///< what the model's values and priors were taken from
};

/// All that is made of one flight: Calibrate(), with what its streams say about each other in
/// findings and sigmas (of SI units, in the frames of the vehicle file), what is left out predicted
/// where that is asked for, and a warning where the start is another mass's.
/// @param log, recording, file_vehicle, progress, predicted as in Calibrate()
/// @param inspection of the recording, which was mended by it
/// @throws std::invalid_argument as Calibrate() and PredictLeftOut()
Calibration CalibrateInspected(const FlightLog& log, const FlightLog& recording,
                               const StreamInspection& inspection, const Vehicle& file_vehicle,
                               const DynamicModel& model, const CalibrateOptions& options,
                               const std::function<void(double)>& progress = {},
                               const PredictionSink& predicted = {});

/// Predicts a flight with `parameters` as they are; no fitting.
/// @param predicted as in Calibrate()
/// @param followed parameters that are learned on the flight itself: FollowFlight()
Evaluation Evaluate(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
                    const ParameterSet& parameters, const PredictionSink& predicted = {},
                    const FollowedParameters& followed = {});

/// From the first airborne sample until the parameter stays within the larger of 5 % of its final
/// value and its final sigma [s]; empty where not observable.
std::vector<std::optional<double>> Convergence(const EstimateHistory& history,
                                               const std::vector<bool>& observable);

/// Every update of a flight is in one of two parts: its start, in which nothing leaves the window
/// and much is solved as a whole, and the rest.
enum class TimingPart { kStart, kRest };
constexpr double kTimingStart_s = 3.0;  ///< after take-off

/// @param clock member of UpdateTiming, wall_ms or cpu_ms
TimingFigures SummariseTiming(const ReplayResult& replay, double UpdateTiming::*clock,
                              TimingPart part = TimingPart::kRest);

/// Median number of states in the window after the start.
int StatesInWindow(const ReplayResult& replay);

/// What a recording and its replay lack: samples dropped, gaps, jumps.
std::vector<std::string> FlightWarnings(const FlightLog& log, const ReplayResult& replay);

/// Forces scale with the mass: warns where parameters were fitted with another one than the
/// vehicle file's.
void WarnOfOtherMass(const ParameterSet& parameters, const Vehicle& vehicle,
                     std::vector<std::string>* warnings);

/// True if an estimate's sign is one that physics does not allow, by more than chance (three
/// sigma).
/// @param sigma 0 where frozen
bool IsSignUnphysical(const ParameterSpec& spec, double value, double sigma);

/// What a reader of the figures must know: coefficients of unphysical sign (beyond three sigma),
/// inertia over nominal outside 0.5 to 2, rotor torque gain outside 0.85 to 1.15, torque worse than
/// predicting zero.
/// @param sigma num_parameters()×1, 0 where frozen
std::vector<std::string> ModelWarnings(const DynamicModel& model, const ModelValues& values,
                                       const Eigen::VectorXd& sigma,
                                       const PredictionFigures& figures);

}  // namespace odmc
