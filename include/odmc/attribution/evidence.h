#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "odmc/attribution/flexible_features.h"
#include "odmc/attribution/flight_regression.h"
#include "odmc/attribution/model_point.h"

namespace odmc {

/// One way in which a candidate effect may act: its settings, linearized somewhere.
struct EffectVariant {
  EffectCandidate candidate;
  /// Columns of its parameters, in the order of Evidence's columns. The coefficient of a column is
  /// the parameter itself, not a step.
  std::vector<int> columns;
  int offset = -1;         ///< column of what it does beyond its linearization; -1: nothing
  double log_prior = 0.0;  ///< of its settings among those of the effect's candidates
  double linearization_penalty = 0.0;  ///< Evidence::CountWhatIsBorneOut() [nats]
};

/// Variants that act together, by their numbers in Evidence; of an effect at most one.
using VariantSet = std::set<int>;

/// Parameters of a model as a set of variants finds them.
struct EffectFit {
  double log_evidence = 0.0;  ///< of the residual under the set, the same constant left out [nats]
  std::vector<int> columns;   ///< in Evidence
  Eigen::VectorXd coefficients;  ///< n
  Eigen::MatrixXd covariance;    ///< n×n
};

/// What a physical sign says of a coefficient: log of its prior density over that of a symmetric
/// one, integrated over what is known of it [nats]. The sign is right with probability 1 -
/// `kOutlierPriorShare`, or for certain.
double LogSignOdds(PhysicalSign sign, bool is_certain, double value, double sigma);

/// The residual wrench of one flight, or of several of one vehicle, under the declared model as a
/// linear regression with Gaussian priors: what every decision of attribution is made by. The
/// evidence of a set of effects is the marginal likelihood of the residual with all coefficients
/// integrated out, those of the declared model among them:
///
///   log p(y|S) = -1/2 (y'y - b'H^-1 b) - 1/2 log|H| + 1/2 log|P|,  H = X'X + P,  b = X'y + P m,
///
/// X and y whitened by each flight's noise (FlightRegression), P and m the priors (O'Hagan,
/// Bayesian Inference, 1994, ch. 9). X is what the foreseen parts W of all columns together say of
/// them, W (W'W)^-1 W' X_all (two-stage least squares): each column is foreseen by instruments of
/// its own, and what those of one say of another must not be left to its coefficient.
/// Prior knowledge enters as densities. A coefficient whose physical sign is known has it with
/// probability 1 - `kOutlierPriorShare`; its size is normal with the catalogue's sigma, or with
/// probability `kOutlierPriorShare` with five times that. So what is strange costs some nats and is
/// never ruled out.
///
/// Of several flights the vehicle's parameters are shared, and each flight has its own of what
/// BelongsToFlight(). Blocks held out enter nothing but HeldOutGain().
class Evidence {
 public:
  static constexpr double kOutlierPriorShare = 0.05;

  /// @param flights at least one
  /// @param point the declared model and the values about which it is linearized
  /// @param jobs flights looked at at a time, or ways of effects to act
  Evidence(const std::vector<FlightWithInstruments>& flights, const ModelPoint& point,
           int jobs = 1);

  /// The function of FlexibleFeatures that gains most beside a set.
  struct FlexibleGain {
    std::optional<int> channel;  ///< that follows it; none: a force fixed in the world
    int feature = 0;
    double nats = 0.0;  ///< less the price of the choice among so many

    /// As "force_z by "sideways speed"".
    std::string Text(const FlexibleFeatures& features) const;
  };
  /// Which functions are looked at.
  struct FlexibleChoice {
    bool with_world = true;  ///< forces fixed in the world, too
    /// What an effect does to the whitened residual, by flight: no function that copies it.
    const std::vector<Eigen::VectorXd>* effect = nullptr;
  };
  FlexibleGain BestFlexible(const VariantSet& set, const FlexibleFeatures& features,
                            const FlexibleChoice& choice) const;
  /// What a force gains beside a set that is fixed in the world and follows the place in any way: a
  /// Gaussian process over position with squared-exponential kernels, its widths and sizes of
  /// octaves that are as likely as one another. Chance gains as much with a probability of
  /// exp(-nats) at most. Position answers no force within a sample: it needs no instruments.
  double GainOfThePlace(const VariantSet& set) const;
  /// Adds it as a variant of an effect without name. @returns its number
  int AddFlexible(const FlexibleGain& gain, const FlexibleFeatures& features);

  /// Adds a way for an effect to act, linearized about zero or, for what must not be zero, the
  /// catalogue's value. @returns its number, -1 if it does nothing on these flights
  int Add(const EffectCandidate& candidate) { return AddAll({candidate}).front(); }
  /// The same of several. @returns a number for each
  std::vector<int> AddAll(const std::vector<EffectCandidate>& candidates);
  /// Values of a variant's coefficients by name, of each flight.
  using VariantValues = std::vector<std::map<std::string, double>>;
  /// Where a variant is linearized.
  VariantValues LinearizedAt(int variant) const;
  /// Where a fit finds a variant, within its bounds and what is likely.
  VariantValues FoundBy(const EffectFit& fit, int variant) const;
  /// Linearizes variants anew. @param at by variant
  void Relinearize(const std::map<int, VariantValues>& at);
  /// How far what a fit finds of a variant is from where that is linearized, at most [sigma].
  double StepInSigmas(int variant, const EffectFit& fit) const;
  /// Logarithm of the evidence for a variant with the coefficients, and their prior density, where
  /// it is linearized: there the linearization is what the model does. About a maximum a fit's
  /// evidence is less, by the volume that its coefficients leave open; if it is more, the fit
  /// relies on a model that is not linear so far away.
  double LogEvidenceWhereLinearized(int variant) const;
  /// What a fit claims for a variant beyond LogEvidenceWhereLinearized() does not count from here
  /// on.
  void CountWhatIsBorneOut(int variant);
  void SetLogPrior(int variant, double log_prior) { variants_[variant].log_prior = log_prior; }

  /// Variants without a part in the noise's estimate, instead of those before. An effect that is
  /// tried in several ways would else take some of the noise with it in each.
  void SetAside(const VariantSet& variants);
  /// Estimates each flight's noise, see FlightRegression::EstimateNoise(). To be called before
  /// anything below, and again after Add() and Relinearize().
  void EstimateNoise();

  const std::vector<EffectVariant>& variants() const { return variants_; }
  const ModelPoint& point() const { return point_; }
  int num_flights() const { return static_cast<int>(flights_.size()); }
  int num_columns() const { return static_cast<int>(columns_.size()); }

  EffectFit Solve(const VariantSet& set) const;
  /// The evidence alone, relative to that of the declared model.
  double GainInNats(const VariantSet& set) const;

  /// What a single variant that is not (yet) among the columns would gain at most [nats]: by the
  /// noise, and as if that were white.
  struct GainBound {
    double serial = 0.0, white = 0.0;
  };
  GainBound GainBoundOf(const EffectCandidate& candidate) const;

  /// What a variant of a fitted set does, by channel, over the noise [nats]; of instants at which
  /// it is wild, as a load that is dropped, as much as counts of such noise.
  std::array<double, kNumChannels> EnergyOf(int variant, const EffectFit& fit) const;
  /// What a fit's variant does to the whitened residual, by flight.
  std::vector<Eigen::VectorXd> DoneBy(int variant, const EffectFit& fit) const;

  /// What the parameters that two fits share do differently, over the noise [nats]: what an effect
  /// does and changes of the others cancel.
  double GivenUp(const EffectFit& with, const EffectFit& without) const;
  /// What two fits do differently by what of their regressors was not foreseen, over the noise
  /// [nats]. Where an effect and changes of other parameters cancel, this is what is left of the
  /// regressors' noise.
  struct Unforeseen {
    double nats = 0.0;
    /// Of it, what the fit of all foreseen parts to so few samples keeps: columns over samples of
    /// each flight.
    double kept_share = 0.0;
  };
  Unforeseen UnforeseenChange(const VariantSet& set, const VariantSet& without) const;

  /// What was known of the declared model's parameters before the flight says of what a fit finds
  /// of them: log of the prior's density over that at its middle [nats].
  double BeliefIn(const EffectFit& fit) const;

  /// By how much `set` predicts parts better than `over`, each by the others [nats]: blocks of time
  /// of a single flight, whole flights of several.
  double PredictiveGain(const VariantSet& set, const VariantSet& over) const;
  /// The same by flight: log-likelihood of each flight given all others. @pre several flights
  std::vector<double> GainByFlight(const VariantSet& set, const VariantSet& over) const;
  /// What one flight alone says of a set's coefficients, those of the vehicle among them.
  EffectFit SolveOfFlight(int flight, const VariantSet& set) const;

  /// Log-likelihood of the samples held out under `set`, its coefficients as the others say, beyond
  /// that under `over` [nats]. Predicted by whole regressors, whose noise costs some of it, and by
  /// what of them was foreseen, which is a part of them: the larger of the two.
  double HeldOutGain(const VariantSet& set, const VariantSet& over = {}) const;

  /// By how much `a` predicts the samples in use better than `b`, and the standard error of that as
  /// blocks of time tell it (Vuong, Econometrica 1989).
  struct Lead {
    double nats = 0.0, sigma = 0.0;
  };
  Lead LeadOf(const VariantSet& a, const VariantSet& b) const;

  /// Largest gains that single variants reach where nothing acts: `count` surrogates of the noise,
  /// the whitened residual of everything, shifted in time against the regressors by random amounts
  /// beyond its correlation, its sign random, of each flight by itself. Each is given to every
  /// variant beside `beside`.
  /// @returns the largest gain of each surrogate, sorted
  std::vector<double> SurrogateGains(const VariantSet& beside, int count, unsigned seed) const;

  /// The model with `set`, and the values of all parameters as a fit finds them.
  ModelPoint Moved(const VariantSet& set, const EffectFit& fit) const;

  /// Residual (N×6) of a set in the linear model, biases taken off; by flight.
  std::vector<ResidualModel::Wrenches> ResidualsOf(const VariantSet& set,
                                                   const EffectFit& fit) const;

  /// A column of the linear model of all flights.
  struct Column : ResidualCoefficient {
    int flight = -1;  ///< whose own it is; -1: shared
  };
  const Column& column(int k) const { return columns_[static_cast<size_t>(k)]; }

 private:
  /// Gives flight `f`'s new columns their places, shared ones among `shared` (by name).
  void Place(size_t f, const std::vector<int>& local, std::map<std::string, int>* shared,
             std::vector<int>* columns);
  bool IsOwn(const ResidualCoefficient& coefficient) const;
  /// True if a parameter is a setting that a variant of the set fits.
  bool IsFitted(const VariantSet& set, const std::string& name) const;
  void Assemble();
  /// Adds a flight's sums of products to those of all.
  void AddTo(const Eigen::MatrixXd& local, size_t flight, Eigen::MatrixXd* gram) const;
  /// The sums without one fold: a fifth of a flight's blocks of time, or one of several flights.
  Eigen::MatrixXd GramWithout(int fold) const;
  int num_folds() const;
  EffectFit SolveWith(const Eigen::MatrixXd& gram, const std::vector<int>& columns,
                      const VariantSet& set) const;
  struct NormalEquations;
  /// Coefficients of all columns and of y that make the residual without what variants do beyond
  /// their linearization.
  Eigen::VectorXd WithoutOffsets(const VariantSet& set) const;
  NormalEquations EquationsOf(const Eigen::MatrixXd& gram, const std::vector<int>& columns,
                              const VariantSet& set) const;
  /// Its evidence without what is known of the set before.
  EffectFit FitOf(const NormalEquations& equations, const Eigen::VectorXd& prior_sigma) const;
  /// Widens the priors of variants whose coefficients a fit has strangely large.
  /// @returns how many these are
  int WidenStrange(const VariantSet& set, const NormalEquations& equations, const EffectFit& fit,
                   Eigen::VectorXd* prior_sigma) const;
  std::vector<int> ColumnsOf(const VariantSet& set) const;
  /// The coefficients of a flight's columns; offsets of `set` at one.
  Eigen::VectorXd LocalCoefficients(size_t flight, const EffectFit& fit,
                                    const VariantSet& set) const;
  Eigen::VectorXd ErrorsOf(size_t flight, const VariantSet& set, const EffectFit& fit) const;
  /// What gives a variant's gain beside others on any residual.
  struct GainTest;
  /// Of every variant whose effect is not among `beside`.
  std::vector<GainTest> GainTests(const VariantSet& beside) const;
  double GainOf(const GainTest& test, const Eigen::VectorXd& Xe) const;
  /// Products of all columns with surrogates of the noise, by column.
  Eigen::MatrixXd SurrogateProducts(std::mt19937* random) const;
  double HeldOutLoss(const VariantSet& set, FlightRegression::Part part) const;
  double SignTerm(const std::vector<int>& columns, const Eigen::VectorXd& coefficients,
                  const Eigen::VectorXd& sigma) const;
  Eigen::VectorXd PriorSigmas(const std::vector<int>& columns) const;
  /// What the gains of functions beside a fit come from.
  struct FlexibleSums {
    FlexibleSums(Eigen::Index columns, Eigen::Index functions)
        : cross(Eigen::MatrixXd::Zero(columns, functions)),
          g(Eigen::VectorXd::Zero(functions)),
          size(Eigen::VectorXd::Zero(functions)),
          along_effect(Eigen::VectorXd::Zero(functions)) {}

    Eigen::MatrixXd cross;         ///< fitted columns × functions
    Eigen::VectorXd g, size;       ///< products with the errors, and with themselves
    Eigen::VectorXd along_effect;  ///< products with what an effect does
  };
  /// Adds what a channel of a flight says. @param foreseen samples × functions, of unit size
  /// @param unit their natural size [N or N m] @returns the functions, whitened
  Eigen::MatrixXd AddTo(FlexibleSums* sums, size_t flight, int channel,
                        const Eigen::MatrixXd& foreseen, double unit, const EffectFit& fit,
                        const Eigen::VectorXd& errors, const Eigen::VectorXd* effect) const;
  /// Products of a flight's columns of a fit with a whitened vector.
  Eigen::VectorXd Products(size_t flight, const EffectFit& fit, const Eigen::VectorXd& white) const;
  /// @param seen of each flight @returns the variant's number, -1 if it does nothing
  int Append(const EffectCandidate& candidate, std::vector<FlightRegression::Seen> seen);
  void Replace(int variant, std::vector<FlightRegression::Seen> seen);
  double ForceSigma() const;  ///< of the residual force, by axis

  std::vector<FlightRegression> flights_;
  std::vector<std::vector<int>> place_;  // of each flight's columns among `columns_`
  // Of each flight's variants, its columns; by variant.
  std::vector<std::vector<FlightRegression::Added>> added_;
  ModelPoint point_;
  int jobs_;
  int num_channels_;
  std::array<double, kNumChannels> plain_sigma_{};  // of the residual of all flights
  std::vector<Column> columns_;  // of the base, then of the variants; offsets among these
  int num_base_ = 0;
  std::vector<EffectVariant> variants_;
  Eigen::MatrixXd gram_;
};

}  // namespace odmc
