#include "odmc/fleet/joint_calibration.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <stdexcept>

#include "odmc/analysis/parallel.h"
#include "odmc/attribution/close_loop.h"
#include "odmc/inspection/stream_doubt.h"

namespace odmc {
namespace {

constexpr double kSince2001_s = 1e9;  // a stamp that is a date, not a time since power-on

/// The vehicle with values to start from. Its priors stay as wide as they are.
Vehicle StartedAt(const Vehicle& vehicle, const ParameterSet& start) {
  Vehicle started = vehicle;
  const DynamicModel model(vehicle, vehicle.effects);
  for (const ModelParameter& p : model.parameters()) {
    const ParameterEstimate* from = start.Find(p.full_name);
    if (!p.estimated || from == nullptr) continue;
    started.parameters[p.full_name].value = from->value;
    started.parameters[p.full_name].sigma = p.spec.prior_sigma;
  }
  return started;
}

/// A flight's estimate with the shared parameters at other values.
ParameterSet ParametersWith(const FlightFactor& factor, const Eigen::VectorXd& values) {
  ParameterSet set = factor.estimate;
  for (ParameterEstimate& p : set.parameters) {
    const auto it = std::find(factor.names.begin(), factor.names.end(), p.full_name);
    if (it != factor.names.end()) p.value = values[it - factor.names.begin()];
  }
  return set;
}

/// The priors of the vehicle file, which a factor made from other starts does not have.
void SetPriors(const DynamicModel& model, FlightFactor* factor) {
  for (int k = 0; k < factor->size(); ++k) {
    const ModelParameter& p =
        model.parameters()[model.IndexOf(factor->names[static_cast<size_t>(k)])];
    factor->prior_value[k] = p.spec.prior_value;
    factor->prior_sigma[k] = p.spec.prior_sigma;
  }
}

/// True if the joint estimate of a flight's parameters lies where its pass did not look: far from
/// where it was linearized, in a parameter that the flight shows.
bool IsFar(const FlightFactor& factor, const Eigen::VectorXd& at, double share) {
  for (int k = 0; k < factor.size(); ++k) {
    const double shown = factor.root.col(k).norm() * factor.prior_sigma[k];
    const bool moved = std::abs(at[k] - factor.linearized_at[k]) > share * factor.prior_sigma[k];
    if (shown > 1.0 && moved) return true;
  }
  return false;
}

std::optional<ModelValues> ValuesOf(const FlightLog& log, const DynamicModel& model,
                                    const EstimatorOptions& options) {
  Estimator estimator(&model, options, !log.rotor_rms_only);
  const std::optional<Snapshot> last = Replay(log, &estimator).last;
  if (!last) return std::nullopt;
  return last->values;
}

/// What the lines between readings of the rotor speeds may have done to an estimate. Where speeds
/// are rough (commands answer noise) the error goes with the distance of readings: twice that adds
/// as much again. Smooth ones would have a third of it.
std::optional<Eigen::VectorXd> ErrorOfRotorReadings(const FlightLog& log, const ModelValues& with,
                                                    const DynamicModel& model,
                                                    const EstimatorOptions& options) {
  FlightLog sparse = log;
  LeaveOutEverySecond("rotor_speeds", &sparse);
  const auto coarser = ValuesOf(sparse, model, options);
  if (!coarser) return std::nullopt;
  return Eigen::VectorXd(*coarser - with);
}

/// By how much a flight's estimate is off, error by error: those of the streams, of the step
/// between keyframes, and of the rotor speeds between their readings.
std::vector<Eigen::VectorXd> ErrorsOf(const InspectedFlight& flight, const DynamicModel& model,
                                      const EstimatorOptions& options) {
  const auto with = ValuesOf(flight.log, model, options);
  if (!with) return {};
  std::vector<Eigen::VectorXd> errors =
      ChangesWithout(flight.inspection.doubts, flight.log, 0, model, options, &*with);
  // The error of a step goes with its square: of half the step a quarter is left.
  EstimatorOptions finer = options;
  finer.keyframe_rate_hz *= 2.0;
  if (const auto at_half = ValuesOf(flight.log, model, finer)) {
    errors.emplace_back(4.0 / 3.0 * (*at_half - *with));
  }
  const auto is_counted = [](const StreamDoubt& doubt) {
    return doubt.stream == "rotor_speeds" && doubt.sparse_s > 0.0;
  };
  const std::vector<StreamDoubt>& doubts = flight.inspection.doubts;
  if (std::any_of(doubts.begin(), doubts.end(), is_counted)) return errors;
  if (const auto error = ErrorOfRotorReadings(flight.log, *with, model, options)) {
    errors.push_back(*error);
  }
  return errors;
}

/// Before a flight is named for what it says, what its rotor readings may have done to it counts.
/// @returns whether any flight was named
bool WidenOutliers(const FlightSource& source, const Vehicle& vehicle,
                   const JointCalibrationOptions& options, FleetCalibration* fleet) {
  const std::vector<int> used = fleet->used();
  std::set<int> named;
  for (const OutlierFlight& outlier : fleet->joint.outliers) {
    named.insert(used[static_cast<size_t>(outlier.flight)]);
  }
  const std::vector<int> flights(named.begin(), named.end());
  const DynamicModel model(vehicle, vehicle.effects);
  ForEachOf(static_cast<int>(flights.size()), options.jobs, [&](int k) {
    FleetFlight& flight = fleet->flights[static_cast<size_t>(flights[static_cast<size_t>(k)])];
    FlightFactor& factor = flight.factor;
    const FlightLog log = source(flight.file).log;
    const auto with = ValuesOf(log, model, options.estimator);
    if (!with) return;
    const auto error = ErrorOfRotorReadings(log, *with, model, options.estimator);
    if (!error) return;
    Eigen::VectorXd shared(factor.size());
    for (int i = 0; i < factor.size(); ++i) {
      shared[i] = (*error)[model.IndexOf(factor.names[static_cast<size_t>(i)])];
    }
    AddErrorToFactor(shared, &factor);
  });
  return !flights.empty();
}

/// What may be wrong with the streams of all flights alike (the delay of a sensor, the scale of a
/// speed, the step between keyframes) does not average out. Its size is taken from a few flights,
/// spread over the history.
void AddSharedDoubts(const FlightSource& source, const Vehicle& vehicle,
                     const JointCalibrationOptions& options, FleetCalibration* fleet) {
  const std::vector<int> used = fleet->used();
  const int looks = std::min(options.doubted_flights, static_cast<int>(used.size()));
  const DynamicModel model(vehicle, vehicle.effects);
  const auto n = static_cast<Eigen::Index>(fleet->parameters.parameters.size());
  std::vector<Eigen::MatrixXd> squares(static_cast<size_t>(looks), Eigen::MatrixXd::Zero(n, n));
  ForEachOf(looks, options.jobs, [&](int k) {
    const auto at = static_cast<size_t>(k) * used.size() / static_cast<size_t>(looks);
    const std::string& file = fleet->flights[static_cast<size_t>(used[at])].file;
    for (const Eigen::VectorXd& error : ErrorsOf(source(file), model, options.estimator)) {
      squares[static_cast<size_t>(k)] += error * error.transpose();
    }
  });
  Eigen::MatrixXd mean = Eigen::MatrixXd::Zero(n, n);
  for (const Eigen::MatrixXd& of : squares) mean += of / static_cast<double>(looks);
  for (Eigen::Index i = 0; i < n; ++i) {
    ParameterEstimate& p = fleet->parameters.parameters[static_cast<size_t>(i)];
    if (!p.estimated) {
      mean.row(i).setZero();
      mean.col(i).setZero();
    } else {
      p.sigma = std::sqrt(p.sigma * p.sigma + mean(i, i));
    }
  }
  fleet->parameters.covariance += mean;
}

/// A flight predicted with the vehicle's parameters at other values.
PredictionFigures FiguresWith(const FleetFlight& flight, const Eigen::VectorXd& values,
                              const FlightSource& source, const Vehicle& file_vehicle,
                              const Vehicle& vehicle, const PredictionSink& predicted) {
  const ParameterSet others = ParametersWith(flight.factor, values);
  Vehicle as_expected = vehicle;
  ApplyParameters(others, &as_expected);
  const DynamicModel model(as_expected, as_expected.effects);
  return Evaluate(source(flight.file).log, file_vehicle, model, others, predicted)
      .prediction.figures;
}

/// In the order they were flown: by date, where all recordings have one.
void Order(std::vector<FleetFlight>* flights) {
  const bool dated = std::all_of(flights->begin(), flights->end(), [](const FleetFlight& f) {
    return !f.failure.empty() || f.factor.start_s > 0.0;
  });
  if (!dated) return;
  std::stable_sort(flights->begin(), flights->end(), [](const auto& a, const auto& b) {
    return a.factor.start_s < b.factor.start_s;
  });
}

std::vector<FlightFactor> FactorsOf(const FleetCalibration& fleet) {
  std::vector<FlightFactor> factors;
  for (const int i : fleet.used()) factors.push_back(fleet.flights[static_cast<size_t>(i)].factor);
  return factors;
}

/// Parameters of effects that change with what people change between flights.
std::vector<std::string> OftenChanged(const DynamicModel& model) {
  std::vector<std::string> names;
  for (int i = 0; i < model.num_effects(); ++i) {
    if (!model.effect(i).changes_between_flights()) continue;
    for (const ModelParameter& p : model.parameters()) {
      if (p.effect == model.effect(i).name()) names.push_back(p.full_name);
    }
  }
  return names;
}

/// @param model with which the flights were calibrated
void Combine(const DynamicModel& model, const JointOptions& given, FleetCalibration* fleet) {
  const std::vector<FlightFactor> factors = FactorsOf(*fleet);
  if (factors.empty()) {
    std::string why = "no flight can be used";
    for (const FleetFlight& flight : fleet->flights) why += "\n" + flight.failure;
    throw std::invalid_argument(why);
  }
  JointOptions options = given;
  options.times.clear();
  for (const FlightFactor& f : factors) {
    if (f.start_s > 0.0) options.times.push_back(f.start_s);
  }
  if (options.times.size() != factors.size()) options.times.clear();
  fleet->joint = EstimateJointly(factors, options);
  fleet->parameters = ToParameterSet(fleet->joint, factors, model);
}

/// Root mean square of what flights are predicted wrong by.
ResidualChannels ErrorOf(const std::vector<const FleetFlight*>& flights) {
  ResidualChannels squares = ResidualChannels::Zero();
  for (const FleetFlight* flight : flights) {
    const PredictionFigures& f = flight->left_out;
    if (f.force_rmse_N) squares.head<3>() += f.force_rmse_N->cwiseAbs2();
    if (f.torque_rmse_Nm) squares.tail<3>() += f.torque_rmse_Nm->cwiseAbs2();
  }
  return (squares / static_cast<double>(std::max<size_t>(1, flights.size()))).cwiseSqrt();
}

/// Of all flights but those that were another vehicle's, so to speak.
std::vector<RecurrentResidual> RecurrentOf(const FleetCalibration& fleet) {
  const std::vector<int> used = fleet.used();
  std::vector<const FleetFlight*> flights;
  for (size_t k = 0; k < used.size(); ++k) {
    const auto& outliers = fleet.joint.outliers;
    const bool is_outlier =
        std::any_of(outliers.begin(), outliers.end(),
                    [&](const OutlierFlight& o) { return o.flight == static_cast<int>(k); });
    if (!is_outlier) flights.push_back(&fleet.flights[static_cast<size_t>(used[k])]);
  }
  std::vector<const FlightResiduals*> residuals;
  for (const FleetFlight* flight : flights) residuals.push_back(&flight->residuals);
  return FindRecurrentResiduals(residuals, ErrorOf(flights));
}

}  // namespace

std::vector<int> FleetCalibration::used() const {
  std::vector<int> indices;
  for (size_t i = 0; i < flights.size(); ++i) {
    if (flights[i].failure.empty()) indices.push_back(static_cast<int>(i));
  }
  return indices;
}

FleetFlight FleetFlightOf(const Calibration& calibration, const DynamicModel& model,
                          const std::vector<std::string>& own) {
  FleetFlight flight;
  flight.file = calibration.flight.file;
  flight.factor = FactorOf(model, calibration.parameters, calibration.inflation, own);
  flight.factor.duration_s = calibration.flight.duration_s;
  const double start_s = ToSeconds(calibration.first_stamp);
  flight.factor.start_s = start_s > kSince2001_s ? start_s : 0.0;
  flight.own_fit = calibration.prediction.figures;
  flight.not_flown = NotLookedAt(calibration.replay);
  flight.phases = calibration.replay.phases;
  flight.warnings = calibration.warnings;
  flight.passes = 1;
  return flight;
}

FleetFlight CalibrateFlight(const std::string& file, const FlightSource& source,
                            const Vehicle& file_vehicle, const Vehicle& vehicle,
                            const JointCalibrationOptions& options, const ParameterSet* start) {
  FleetFlight flight;
  flight.file = file;
  try {
    const InspectedFlight inspected = source(file);
    const FlightLog& log = inspected.log;
    const Vehicle started = start != nullptr ? StartedAt(vehicle, *start) : vehicle;
    const DynamicModel model(started, started.effects);
    Calibration calibration = Calibrate(log, log, file_vehicle, model, options.estimator, {},
                                        [](const PredictionSample&) {});
    AddInspection(inspected.inspection, &calibration);
    calibration.parameters.provenance["flight"] = file;
    AddTrust(calibration.findings, &calibration.parameters);
    flight = FleetFlightOf(calibration, model, options.own);
    flight.file = file;
    SetPriors(DynamicModel(vehicle, vehicle.effects), &flight.factor);
  } catch (const std::exception& e) {
    flight.failure = e.what();
    if (flight.failure.find(file) == std::string::npos) {
      flight.failure = file + ": " + flight.failure;
    }
  }
  return flight;
}

namespace {

/// Many flights of a vehicle on their way to one estimate. The steps are called in this order.
class FleetSession {
 public:
  FleetSession(const FlightSource& source, const Vehicle& file_vehicle, const Vehicle& vehicle,
               const JointCalibrationOptions& options)
      : source_(source),
        file_vehicle_(file_vehicle),
        vehicle_(vehicle),
        model_(vehicle, vehicle.effects),
        options_(options),
        joint_(options.joint) {
    joint_.often_changed = OftenChanged(model_);
    fleet_.false_alarm_rate = options.joint.false_alarm_rate;
  }

  /// Calibrates each flight that is not known, and combines all.
  void CalibrateEach(const std::vector<std::string>& files, const std::vector<FleetFlight>& known,
                     const std::function<void(double)>& progress) {
    std::map<std::string, const FleetFlight*> by_file;
    for (const FleetFlight& flight : known) by_file[flight.file] = &flight;
    fleet_.flights.resize(files.size());
    ForEachOf(
        static_cast<int>(files.size()), options_.jobs,
        [&](int i) {
          const auto at = static_cast<size_t>(i);
          const auto it = by_file.find(files[at]);
          fleet_.flights[at] =
              it != by_file.end()
                  ? *it->second
                  : CalibrateFlight(files[at], source_, file_vehicle_, vehicle_, options_);
        },
        progress);
    Order(&fleet_.flights);
    Combine(model_, joint_, &fleet_);
  }

  /// Calibrates anew, from the joint estimate, the flights that were linearized far from it.
  /// @returns false if there is none
  bool Relinearize() {
    std::vector<int> far;
    const std::vector<int> used = fleet_.used();
    std::vector<ParameterSet> starts(fleet_.flights.size());
    for (size_t k = 0; k < used.size(); ++k) {
      const FleetFlight& flight = fleet_.flights[static_cast<size_t>(used[k])];
      const Eigen::VectorXd& at = fleet_.joint.fit.of_flight[k];
      if (!IsFar(flight.factor, at, options_.relinearize_share)) continue;
      far.push_back(used[k]);
      starts[static_cast<size_t>(used[k])] = ParametersWith(flight.factor, at);
    }
    if (far.empty()) return false;
    ForEachOf(static_cast<int>(far.size()), options_.jobs, [&](int k) {
      const auto at = static_cast<size_t>(far[static_cast<size_t>(k)]);
      FleetFlight& flight = fleet_.flights[at];
      FleetFlight anew =
          CalibrateFlight(flight.file, source_, file_vehicle_, vehicle_, options_, &starts[at]);
      if (!anew.failure.empty()) return;  // what is known stays
      flight.factor = std::move(anew.factor);
      ++flight.passes;
    });
    Combine(model_, joint_, &fleet_);
    return true;
  }

  void Doubt() {
    if (WidenOutliers(source_, vehicle_, options_, &fleet_)) Combine(model_, joint_, &fleet_);
    AddSharedDoubts(source_, vehicle_, options_, &fleet_);
  }

  /// Predicts each flight by the others, and looks for what recurs in the errors.
  void PredictLeftOut(const std::function<void(double)>& progress) {
    const std::vector<int> used = fleet_.used();
    if (!options_.predict_left_out || used.size() < 2) return;
    const std::vector<Eigen::VectorXd> expected =
        ExpectedOfLeftOut(FactorsOf(fleet_), fleet_.joint.model, fleet_.joint.fit);
    const double weight_N = file_vehicle_.mass_kg * file_vehicle_.gravity_m_s2;
    ForEachOf(
        static_cast<int>(used.size()), options_.jobs,
        [&](int k) {
          FleetFlight& flight = fleet_.flights[static_cast<size_t>(used[static_cast<size_t>(k)])];
          flight.left_out = FiguresWith(
              flight, expected[static_cast<size_t>(k)], source_, file_vehicle_, vehicle_,
              [&](const PredictionSample& sample) { flight.residuals.Add(sample, weight_N); });
        },
        progress);
    fleet_.recurrent = RecurrentOf(fleet_);
  }

  FleetCalibration TakeResult() { return std::move(fleet_); }

 private:
  const FlightSource& source_;
  const Vehicle& file_vehicle_;
  const Vehicle& vehicle_;
  const DynamicModel model_;
  const JointCalibrationOptions& options_;
  JointOptions joint_;
  FleetCalibration fleet_;
};

}  // namespace

FleetCalibration CalibrateFleet(const std::vector<std::string>& files, const FlightSource& source,
                                const Vehicle& file_vehicle, const Vehicle& vehicle,
                                const JointCalibrationOptions& options,
                                const std::vector<FleetFlight>& known,
                                const std::function<void(double)>& progress) {
  constexpr double kShareOfPasses = 0.7;  // of the time
  const auto part = [&](double from, double to) {
    return [=](double share) {
      if (progress) progress(from + share * (to - from));
    };
  };
  FleetSession session(source, file_vehicle, vehicle, options);
  session.CalibrateEach(files, known, part(0.0, kShareOfPasses));
  for (int pass = 1; pass < options.most_passes; ++pass) {
    if (!session.Relinearize()) break;
  }
  session.Doubt();
  session.PredictLeftOut(part(kShareOfPasses, 1.0));
  return session.TakeResult();
}

std::vector<FleetFlight> PredictHeldOut(const std::vector<std::string>& files,
                                        const FlightSource& source, const Vehicle& file_vehicle,
                                        const Vehicle& vehicle,
                                        const JointCalibrationOptions& options,
                                        const FleetCalibration& fleet,
                                        const std::function<void(double)>& progress) {
  std::vector<FleetFlight> flights(files.size());
  ForEachOf(
      static_cast<int>(files.size()), options.jobs,
      [&](int i) {
        FleetFlight& flight = flights[static_cast<size_t>(i)];
        flight =
            CalibrateFlight(files[static_cast<size_t>(i)], source, file_vehicle, vehicle, options);
        if (!flight.failure.empty()) return;
        flight.left_out = FiguresWith(flight, fleet.joint.value, source, file_vehicle, vehicle,
                                      [](const PredictionSample&) {});
      },
      progress);
  return flights;
}

}  // namespace odmc
