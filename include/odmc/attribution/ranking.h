#pragma once

#include <array>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/attribution/candidates.h"
#include "odmc/attribution/regression.h"
#include "odmc/attribution/residual.h"
#include "odmc/attribution/spectrum.h"
#include "odmc/model/parameter_set.h"

namespace odmc {

/// A candidate's case on a flight.
struct RankedEffect {
  std::string name;
  double score = 0.0;                      ///< gain in cross-validated log-likelihood
  bool sound = true;                       ///< signs, sizes and significance make physical sense
  std::string objection;                   ///< if not sound: why
  std::map<std::string, double> settings;  ///< frozen parameters it was tried with, full names
  std::vector<ParameterEstimate> parameters;
  Eigen::MatrixXd covariance;  ///< of the estimated ones, initial states left out

  /// nullptr if it has no such parameter
  const ParameterEstimate* Find(const std::string& full_name) const {
    for (const ParameterEstimate& p : parameters) {
      if (p.full_name == full_name) return &p;
    }
    return nullptr;
  }
};

/// Structure of one channel of the residual.
struct ChannelStructure {
  std::string name, unit;
  double rmse = 0.0;
  Whiteness whiteness;
  std::vector<double> autocorrelation;       ///< at lags of 40 ms
  std::map<std::string, double> dependence;  ///< share of variance by a quadratic in each quantity
};

/// Natural sizes (prior sigmas) beyond which a coefficient is too large.
constexpr double kTooLarge = 4.0;

/// True if coefficients (n, in natural sizes) are each bearable but together as unlikely as a
/// single one that is too large: an effect of many coefficients takes in much when all are large.
bool AreTooLargeTogether(const std::vector<double>& sizes);

using Candidates = std::vector<Candidate>;  // tried together

/// A number in three digits, for sentences.
std::string Text(double value);

/// The vehicle with candidates added, what they were tried with frozen.
Vehicle With(const Vehicle& vehicle, const Candidate& candidate);
Vehicle With(const Vehicle& vehicle, const Candidates& candidates);

/// True if the worst channel gets clearly worse: by more than a little, and by more than a share of
/// what the best one gains or by much.
bool IsClearlyWorse(double worst, double best);

/// A model with the values and columns of what it lets free.
struct Stage {
  Vehicle vehicle;
  std::map<std::string, double> values;  // by full name
};

/// A model as the online estimator found it. Only the estimator accounts for the noise of the rotor
/// speeds, where a regression makes an inertia large, to damp it, and bends the others with it
/// through the gyroscopic moment: about axes that the flight does not shake it is held, at the
/// estimate or, where there is none, at its prior.
/// @param observable per parameter of the model, of the estimate
Stage StageOf(const DynamicModel& model, const ModelValues& values,
              const std::vector<bool>& observable, const ResidualModel& residual);

/// The model's initial values, but what is known.
ModelValues ValuesOf(const DynamicModel& model, const std::map<std::string, double>& known);

/// Regression of the residual of a model on what it lets free.
class Regressor {
 public:
  struct Result {
    WrenchFit fit;
    std::vector<std::string> names;
    std::map<std::string, double> values;  // of what was let free, after the fit
  };

  /// Fits the base, and moves the stage's values there.
  Regressor(const ResidualModel* residual, Stage* stage);

  const Result& base() const { return base_; }

  /// The derivatives by a candidate's own parameters.
  WrenchColumns ColumnsOf(const Stage& stage, const Candidate& candidate) const;

  /// What columns could gain at most, seen quickly; `serial` as for QuickGain.
  double Promise(const WrenchColumns& columns, bool serial = true) const;

  /// Fits with candidates on top.
  Result FitWith(const Stage& stage, const Candidates& candidates) const;

 private:
  /// Linearizes about what came out of the round before: what moments do is divided by an inertia
  /// that is itself sought, and some parameters scale what others do.
  Result Fit(const Stage& stage, const Candidates& candidates, int rounds,
             WrenchRegression* regression) const;

  /// Moves the values along a fit's step, as far as the residual really shrinks: products of
  /// parameters bend the way.
  /// @returns what that gained [nats]
  double Advance(const DynamicModel& model, const WrenchRegression& regression,
                 Result* result) const;

  /// A regression of this flight without columns.
  WrenchRegression Rows() const;

  /// The accelerometer's bias, along each axis.
  void AddBiases(double mass_kg, WrenchRegression* regression, Result* result) const;

  static void AddColumn(const WrenchColumns& column, double prior_sigma, double prior_offset,
                        WrenchRegression* regression);

  const ResidualModel* residual_;
  WrenchRegression regression_;  // of the base
  Result base_;
  std::unique_ptr<QuickGain> quick_, quick_white_;
};

/// True if parameters differ from zero together by kSignificant sigmas (Wald's test; the limit
/// grows with their number).
bool IsSignificant(const Eigen::VectorXd& estimate, const Eigen::MatrixXd& covariance);

/// Rotors answer disturbances through the controller, so that a little of any torque noise lines up
/// with their acceleration: sizes that this alone can make count for nothing.
bool IsNegligible(const RankedEffect& ranked);

/// A candidate at its best setting, and what it did.
struct Tried {
  Candidate candidate;
  WrenchColumns columns;
  Regressor::Result result;
  RankedEffect ranked;
};

/// Every candidate effect at its best setting, best first.
/// @param give_up asked between candidates; once true, nothing comes back
std::vector<Tried> TryAll(const Stage& stage, const std::vector<Candidate>& candidates,
                          const Regressor& regressor, const WrenchFit& base, int num_channels,
                          const std::function<bool()>& give_up = {});

/// True if what `special` does is a special case of what `general` does (its derivatives lie in the
/// span of the other's, as an isotropic coefficient's in that of one for each axis), and the
/// general one's estimate does not speak against it (Wald's test). On this flight the two cannot be
/// told apart, however much the score prefers the one.
bool IsSpecialCase(const Tried& special, const Tried& general);

/// Two effects that only help together.
struct Pair {
  std::array<RankedEffect, 2> ranked;  // scores: what each adds to the other
  Regressor::Result result;
  double score = 0.0;
};

/// The best pair of which each part adds at least `least` nats to the other, if there is one.
std::optional<Pair> TryPairs(const Stage& stage, const std::vector<Tried>& tried,
                             const Regressor& regressor, const WrenchFit& base, int num_channels,
                             double least);

/// Structure of every channel of a residual.
std::vector<ChannelStructure> Structure(const ThinnedFlight& flight,
                                        const ResidualModel::Wrenches& residual, int num_channels);

/// Largest share of a structured channel's structured variance (p < whiteness_p) that a fit
/// explains: all of it where noise accounts for what remains (p > noise_p). 1 if no channel is
/// structured.
double ExplainedStructure(const std::vector<ChannelStructure>& before,
                          const std::vector<ChannelStructure>& after, double whiteness_p,
                          double noise_p);

}  // namespace odmc
