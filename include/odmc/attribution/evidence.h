#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "odmc/attribution/candidates.h"
#include "odmc/attribution/flexible_features.h"
#include "odmc/attribution/instruments.h"
#include "odmc/attribution/residual.h"
#include "odmc/attribution/stage.h"

namespace odmc {

/// One way in which a candidate effect may act on a flight: its settings, linearized somewhere.
struct Variant {
  Candidate candidate;
  /// Columns of its parameters, in the order of Evidence's columns. The coefficient of a column is
  /// the parameter itself, not a step.
  std::vector<int> columns;
  int offset = -1;         ///< column of what it does beyond its linearization; -1: nothing
  double log_prior = 0.0;  ///< of its settings among those that were tried for the effect
};

/// Variants that act together, by their numbers in Evidence; of an effect at most one.
using VariantSet = std::set<int>;

/// Parameters of a model as a set of variants finds them.
struct EffectFit {
  double log_evidence = 0.0;    ///< of the residual under the set, the same constant left out [nats]
  std::vector<int> columns;     ///< in Evidence
  Eigen::VectorXd coefficients;  ///< n
  Eigen::MatrixXd covariance;    ///< n×n
};

/// The residual wrench of a flight under the declared model as a linear regression with Gaussian
/// priors and noise that is autoregressive in each channel: what every decision of attribution is
/// made by. The evidence of a set of effects is the marginal likelihood of the residual with all
/// coefficients integrated out, those of the declared model among them:
///
///   log p(y|S) = -1/2 (y'y - b'H^-1 b) - 1/2 log|H| + 1/2 log|P|,  H = X'X + P,  b = X'y + P m,
///
/// X and y whitened by the noise, P and m the priors (O'Hagan, Bayesian Inference, 1994, ch. 9). X
/// is what the foreseen parts W of all columns together say of them, W (W'W)^-1 W' X_all (two-stage
/// least squares): each column is foreseen by instruments of its own, and what those of one say of
/// another must not be left to its coefficient.
/// Prior knowledge enters as densities. A coefficient whose physical sign is known has it with
/// probability 1 - `kStrange`; its size is normal with the catalogue's sigma, or with
/// probability `kStrange` with five times that. So what is strange costs some nats and is never
/// ruled out.
///
/// The noise is one for all models: that of the residual of everything together, which holds no
/// effect of the catalogue (its order of 8 at 25 Hz spans the filter's window three times over).
/// Blocks held out enter nothing but HeldOutGain().
class Evidence {
 public:
  static constexpr double kStrange = 0.05;

  /// @param residual of the flight; outlives this
  /// @param instruments of the same flight; outlive this
  /// @param stage the declared model and the values about which it is linearized
  Evidence(const ResidualModel* residual, const Instruments* instruments, const Stage& stage);

  /// The function of FlexibleFeatures that gains most beside a set, in one channel.
  struct FlexibleGain {
    int channel = 0, feature = 0;
    double nats = 0.0;  ///< less the price of the choice among so many
  };
  FlexibleGain BestFlexible(const VariantSet& set, const FlexibleFeatures& features) const;
  /// Adds it as a variant of an effect without name. @returns its number
  int AddFlexible(const FlexibleGain& gain, const FlexibleFeatures& features);

  /// Adds a way for an effect to act, linearized about `at` (full names; zero or, for what must not
  /// be zero, the catalogue's value where it has no entry). @returns its number, -1 if it does
  /// nothing on this flight
  int Add(const Candidate& candidate, const std::map<std::string, double>& at = {});
  /// Linearizes a variant anew. Parameters that do nothing there stay, without a derivative.
  void Relinearize(int variant, const std::map<std::string, double>& at);
  void SetLogPrior(int variant, double log_prior) { variants_[variant].log_prior = log_prior; }

  /// Estimates the noise from the residual of all that was added, and whitens with it. To be
  /// called before anything below, and again after Add() and Relinearize(), when it begins with the
  /// noise as it was.
  void EstimateNoise();

  const std::vector<Variant>& variants() const { return variants_; }
  const Stage& stage() const { return stage_; }
  /// Number of samples (times channels) that count.
  int num_rows() const { return static_cast<int>(rows_.size()) * num_channels_; }
  int num_columns() const { return static_cast<int>(columns_.size()); }

  EffectFit Solve(const VariantSet& set) const;
  /// The evidence alone, relative to that of the declared model.
  double Gain(const VariantSet& set) const;

  /// What a single variant that is not (yet) among the columns would gain at most [nats]: by the
  /// noise, and as if that were white.
  struct Promise {
    double serial = 0.0, white = 0.0;
  };
  Promise PromiseOf(const Candidate& candidate, const std::map<std::string, double>& at = {}) const;

  /// What a variant of a fitted set does, by channel, over the noise [nats].
  std::array<double, kNumChannels> EnergyOf(int variant, const EffectFit& fit) const;

  /// What the parameters that two fits share do differently, over the noise [nats]: what an effect
  /// does and changes of the others cancel.
  double GivenUp(const EffectFit& with, const EffectFit& without) const;

  /// By how much `set` predicts blocks of time better than `over`, each by the others [nats].
  double PredictiveGain(const VariantSet& set, const VariantSet& over) const;

  /// Log-likelihood of the samples held out under `set`, its coefficients as the others say, beyond
  /// that of the declared model [nats].
  double HeldOutGain(const VariantSet& set) const;

  /// By how much `a` predicts the samples in use better than `b`, and the standard error of that as
  /// blocks of time tell it (Vuong, Econometrica 1989).
  struct Lead {
    double nats = 0.0, sigma = 0.0;
  };
  Lead LeadOf(const VariantSet& a, const VariantSet& b) const;

  /// Largest gains that single variants reach where nothing acts: `count` surrogates of the noise,
  /// the whitened residual of everything, shifted in time against the regressors by random amounts
  /// beyond its correlation, its sign random. Each is given to every variant beside `beside`.
  /// @returns the largest gain of each surrogate, sorted
  std::vector<double> SurrogateGains(const VariantSet& beside, int count, unsigned seed) const;

  /// Values of all parameters of the model with `set`, by full name.
  std::map<std::string, double> Values(const VariantSet& set, const EffectFit& posterior) const;

  /// Residual (N×6) of a set in the linear model, biases taken off.
  ResidualModel::Wrenches ResidualOf(const VariantSet& set, const EffectFit& posterior) const;

  struct Column {
    std::string name;  ///< full name; of a bias "accelerometer bias"
    std::string effect;
    double about = 0.0;       ///< value = about + coefficient
    double prior_mean = 0.0;  ///< of the coefficient
    double prior_sigma = 1.0;
    PhysicalSign sign = PhysicalSign::kAny;
    bool certain_sign = false;
    bool initial_state = false;
    ResidualModel::Wrenches d_wrench;  ///< N×6
    ResidualModel::Wrenches likely;    ///< N×6: as it would be in the likely motion
    ResidualModel::Wrenches foreseen;  ///< N×6: what of it was known before
  };
  const Column& column(int k) const { return columns_[k]; }

 private:
  static constexpr int kOrder = 8;

  struct Noise {
    Eigen::Matrix<double, kOrder, 1> coefficients = Eigen::Matrix<double, kOrder, 1>::Zero();
    double variance = 1.0;
  };

  /// A candidate's columns, not yet among the others.
  struct Seen {
    std::vector<Column> columns;
    std::optional<Column> offset;
  };
  enum What {
    kAll,        ///< every parameter
    kActing,     ///< those that do something
    kAtAGlance,  ///< of these not what moves by itself, and without noise
  };
  Seen See(const Candidate& candidate, const std::map<std::string, double>& at, What what) const;
  Seen SeeFully(const Candidate& candidate, const DynamicModel& model, const ModelValues& values,
                What what) const;
  void AddBase();
  /// Samples in use, each channel over the residual's size, one channel after the other.
  Eigen::VectorXd Stacked(const ResidualModel::Wrenches& column) const;
  /// What of a candidate's column is foreseen. The part that the declared model has too is foreseen
  /// as its columns are: what tells a column from them may be a hundredth of it, less than the
  /// error of foreseeing the whole.
  ResidualModel::Wrenches Foreseen(const Column& column) const;
  void AddNuisances();
  Eigen::VectorXd Whitened(const ResidualModel::Wrenches& column, const std::vector<int>& rows,
                           const Eigen::MatrixXd& weight) const;
  void SumUp(bool by_folds = true);
  Eigen::VectorXd WhitenedFeature(int channel, const Eigen::VectorXd& foreseen) const;
  void WhitenAll();
  /// Puts what all foreseen columns say of each whole one in the place of its foreseen part.
  void Project();
  /// @param e N×K: second moments are summed over the columns
  Noise FitNoise(const Eigen::MatrixXd& e) const;
  EffectFit SolveWith(const Eigen::MatrixXd& gram, const std::vector<int>& columns,
                      const VariantSet& set) const;
  int FoldOf(Eigen::Index row) const;
  std::vector<int> ColumnsOf(const VariantSet& set) const;
  Eigen::VectorXd ErrorsOf(const Eigen::MatrixXd& white, const VariantSet& set,
                           const EffectFit& posterior) const;
  double SignTerm(const std::vector<int>& columns, const Eigen::VectorXd& coefficients,
                  const Eigen::VectorXd& sigma) const;

  const ResidualModel* residual_;
  const Instruments* instruments_;
  ResidualModel likely_;  // of the likely motion
  Stage stage_;
  int num_channels_;
  ResidualModel::Wrenches y_, likely_y_;
  std::array<double, kNumChannels> plain_sigma_{};  // of y
  std::vector<Column> columns_;  // of the base, then of the variants; offsets among these
  int num_base_ = 0;
  Eigen::MatrixXd base_;      // 6N × base: Stacked()
  Eigen::VectorXd base_size_;
  Eigen::LDLT<Eigen::MatrixXd> base_gram_;  // of base_ over its size
  std::vector<Variant> variants_;
  mutable std::map<std::string, Seen> seen_;  // of effects with an onset, by effect
  std::vector<int> rows_, held_out_rows_;  // samples whose predecessors are there
  std::array<Noise, kNumChannels> noise_;
  int noise_columns_ = -1;  // for which it was estimated; -1: not yet
  Eigen::MatrixXd weight_, held_out_weight_;  // of samples, by channel: wild ones count less
  Eigen::MatrixXd white_, held_out_white_;    // rows × columns (X), y last
  Eigen::MatrixXd gram_;
  std::vector<Eigen::MatrixXd> fold_gram_;  // of folds of blocks of time
  Eigen::VectorXd innovation_;  // whitened residual of everything
  // How much of it the fit of everything may have taken: whitened columns, and the root of the
  // covariance of their coefficients.
  Eigen::MatrixXd fitted_, fitted_root_;
};

}  // namespace odmc
