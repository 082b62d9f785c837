#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "odmc/attribution/candidates.h"
#include "odmc/attribution/instruments.h"
#include "odmc/attribution/model_point.h"
#include "odmc/attribution/residual.h"
#include "odmc/attribution/serial_noise.h"

namespace odmc {

/// A coefficient of the residual's regression: a parameter's change from where it is linearized.
struct ResidualCoefficient {
  std::string name;         ///< full name
  std::string effect;       ///< empty for a bias, and for what of a parameter is this flight's own
  double about = 0.0;       ///< value = about + coefficient
  double prior_mean = 0.0;  ///< of the coefficient
  double prior_sigma = 1.0;
  PhysicalSign sign = PhysicalSign::kAny;
  bool certain_sign = false;
  bool initial_state = false;
  bool belongs_to_flight = false;  ///< of several flights each has its own
  double linearized_at = 0.0;      ///< the coefficient, where its regressor is the derivative
};

/// What a coefficient does on a flight.
struct Regressor : ResidualCoefficient {
  ResidualModel::Wrenches d_wrench;  ///< N×6
  ResidualModel::Wrenches likely;    ///< N×6: as it would be in the likely motion
  ResidualModel::Wrenches foreseen;  ///< N×6: what of it was known before
};

/// What of an innovation's square counts (Huber, Robust Statistics, 1981): all up to five sigma,
/// beyond as if it grew in proportion.
/// @param innovation [sigma]
double WildShare(double innovation);

/// The residual wrench of one flight as a linear regression whitened by the noise of that flight:
/// the sums of squares and products from which Evidence makes every decision. The noise is
/// autoregressive in each channel, and one for all models: that of the residual of everything
/// together that is not SetAside(), which holds no effect of the catalogue.
class FlightRegression {
 public:
  /// Regressors of one way for an effect to act, by their numbers.
  struct Added {
    std::vector<int> columns;
    int offset = -1;  ///< of what it does beyond its linearization; -1: nothing
  };

  /// @param residual, instruments of the same flight; outlive this
  /// @param point the declared model and the values about which it is linearized
  /// @param jobs columns looked at at a time
  FlightRegression(const ResidualModel* residual, const Instruments* instruments,
                   const ModelPoint& point, int jobs = 1);

  /// A candidate's columns, not yet among the others.
  struct Seen {
    std::vector<Regressor> columns;
    std::optional<Regressor> offset;
    bool IsFinite() const;  ///< false where the model has no value, as with no mass left
  };
  /// A way for an effect to act, linearized about zero or, for what must not be zero, the
  /// catalogue's value. No columns where it does nothing.
  Seen ActingColumns(const EffectCandidate& candidate) const;
  Added Append(const std::string& effect, Seen seen);
  /// The same linearized about `at` (full names; as above where it has no entry). Parameters that
  /// do nothing there stay, without a derivative.
  Seen LinearizedAt(const EffectCandidate& candidate,
                    const std::map<std::string, double>& at) const {
    return See(candidate, at, kAll);
  }
  /// Puts what LinearizedAt() found in the place of what Append() made of the same candidate.
  void Replace(Seen seen, Added* added);

  /// Columns without a part in the noise's estimate, as what is tried in several ways would else
  /// take its share of it in each. New ones have a part.
  void SetAside(const Added& added);
  void SetNothingAside() { aside_.clear(); }
  /// Estimates the noise from the residual of all that was added, and whitens with it. To be
  /// called before anything below, and again after Append() and Replace(), when it begins with the
  /// noise as it was.
  void EstimateNoise();

  const ResidualModel& residual() const { return *residual_; }
  const ThinnedFlight& flight() const { return residual_->flight(); }
  /// With every value of the model.
  const ModelPoint& point() const { return point_; }
  int num_base() const { return num_base_; }
  int num_channels() const { return num_channels_; }
  int num_columns() const { return static_cast<int>(columns_.size()); }
  const Regressor& column(int k) const { return columns_[static_cast<size_t>(k)]; }
  /// Samples that count, by their numbers in the flight.
  const std::vector<int>& rows() const { return rows_; }

  /// Measured residual (N×6) of the declared model.
  const ResidualModel::Wrenches& y() const { return y_; }

  /// Whitened columns, the residual last; one channel's rows after the other's.
  const Eigen::MatrixXd& white() const { return white_; }
  /// The same of the samples held out: by what of the columns was foreseen, or by whole columns.
  enum Part { kForeseen, kWhole };
  const Eigen::MatrixXd& held_out_white(Part part) const { return held_out_white_[part]; }
  /// Their sums of products; of folds of blocks of time.
  const Eigen::MatrixXd& gram() const { return gram_; }
  const Eigen::MatrixXd& fold_gram(int fold) const { return fold_gram_[fold]; }
  /// The same sums of what of the whitened columns was not foreseen: noise, and all that is quick.
  const Eigen::MatrixXd& unforeseen_gram() const { return unforeseen_gram_; }

  /// Sums of products of the declared model's columns, a candidate's, and the residual less what
  /// the candidate does beyond its linearization: by the noise, and as if that were white.
  struct QuickSums {
    std::vector<ResidualCoefficient> columns;  ///< the candidate's; empty if it does nothing
    Eigen::MatrixXd serial, white;
  };
  QuickSums QuickSumsOf(const EffectCandidate& candidate,
                        const std::map<std::string, double>& at) const;

  /// A function of the flight's samples in one channel, whitened.
  /// @param scale its unit [N or N m]
  Eigen::VectorXd WhitenedFeature(int channel, const Eigen::VectorXd& foreseen, double scale) const;
  /// Adds a function, whitened, as a column. @param whitened the channels after one another
  int AddFeature(const Eigen::VectorXd& whitened, const std::string& name);

  /// The whitened residual of everything, as it may have been before the fit took a part of it.
  /// @param normal num_noise_columns() standard normal numbers
  Eigen::VectorXd NoiseDraw(const Eigen::VectorXd& normal) const;
  /// Number of columns that had a part in the noise's estimate.
  int num_noise_columns() const { return static_cast<int>(fitted_root_.cols()); }

 private:
  /// Of effects with an onset, by KeyOf(). Copies of a regression share what they have seen.
  struct SeenBefore {
    std::mutex mutex;
    std::map<std::string, Seen> by_key;  // guarded by the mutex
  };
  enum What {
    kAll,     ///< every parameter
    kActing,  ///< those that do something
    kQuick,   ///< of these not what moves by itself, and without noise
  };
  Seen See(const EffectCandidate& candidate, const std::map<std::string, double>& at,
           What what) const;
  /// Takes from columns what they do before an instant.
  void BeginAt(double from_s, Seen* seen) const;
  /// What was seen by a key before; else what `see` returns, kept for the next time.
  Seen SeenBeforeOr(const std::string& key, const std::function<Seen()>& see) const;
  Seen SeeFully(const EffectCandidate& candidate, const DynamicModel& model,
                const ModelValues& values, What what) const;
  void AddBase();
  void AddNuisances();
  /// Samples in use, each channel over the residual's size, one channel after the other.
  Eigen::VectorXd Stacked(const ResidualModel::Wrenches& column) const;
  /// What of a candidate's column is foreseen. The part that the declared model has too is foreseen
  /// as its columns are: what tells a column from them may be a hundredth of it, less than the
  /// error of foreseeing the whole.
  ResidualModel::Wrenches Foreseen(const Regressor& column) const;
  Eigen::VectorXd Whitened(const ResidualModel::Wrenches& column, const std::vector<int>& rows,
                           const Eigen::MatrixXd& weight) const;
  /// Samples that count over the residual's size, not whitened.
  Eigen::VectorXd Raw(const ResidualModel::Wrenches& column) const;
  /// Calls `use` with each stretch of a channel's rows of one fold: the fold, first row, number.
  void ForEachStretch(int channel,
                      const std::function<void(int, Eigen::Index, Eigen::Index)>& use) const;
  void SumUp();
  /// Columns, whitened.
  struct WhiteColumns {
    Eigen::MatrixXd foreseen, whole;
    Eigen::MatrixXd projected;  ///< what all foreseen ones say of each whole one
  };
  WhiteColumns WhitenedOf(const std::vector<int>& which) const;
  /// Coefficients beside their priors, and the root of their covariance.
  struct ColumnFit {
    Eigen::VectorXd x;
    Eigen::MatrixXd root;
  };
  /// @param white the columns, whitened
  ColumnFit FitOf(const std::vector<int>& which, const Eigen::MatrixXd& white,
                  const Eigen::VectorXd& white_y) const;
  void BeginWithWhiteNoise();
  /// @param fit of what of `which` is foreseen
  /// @param of_whole coefficients of the whole columns
  /// @param draws errors that those of the fit may have
  void ReestimateNoise(const std::vector<int>& which, const ColumnFit& fit,
                       const Eigen::VectorXd& of_whole, const Eigen::MatrixXd& draws);
  /// Whitens all columns. @param in_use those with a part in the noise's estimate
  void WhitenAll(const std::vector<int>& all, const std::vector<int>& in_use);
  void WhitenHeldOut();
  int FoldOf(Eigen::Index row) const;

  const ResidualModel* residual_;
  const Instruments* instruments_;
  ResidualModel likely_;  // of the likely motion
  ModelPoint point_;
  int jobs_;
  int num_channels_;
  std::shared_ptr<SeenBefore> seen_before_ = std::make_shared<SeenBefore>();
  ResidualModel::Wrenches y_, likely_y_;
  std::array<double, kNumChannels> plain_sigma_{};  // of y
  std::vector<Regressor> columns_;  // of the base, then of what was added; offsets among these
  int num_base_ = 0;
  Eigen::MatrixXd base_;  // 6N × base: Stacked()
  // The same, its wrenches as they are, one channel after the other.
  Eigen::MatrixXd base_whole_, base_likely_, base_foreseen_;
  Eigen::VectorXd base_size_;
  Eigen::LDLT<Eigen::MatrixXd> base_gram_;  // of base_ over its size
  Eigen::MatrixXd raw_base_, raw_gram_;     // Raw() of what is foreseen of the base
  std::vector<int> rows_, held_out_rows_;   // samples whose predecessors are there
  std::array<SerialNoise, kNumChannels> noise_;
  std::set<int> aside_;  // columns without a part in it
  // For which it was estimated, and what was aside; -1: not yet.
  int noise_columns_ = -1;
  std::set<int> noise_aside_;
  Eigen::MatrixXd weight_, held_out_weight_;       // of samples, by channel: wild ones count less
  Eigen::MatrixXd white_;                          // rows × columns (X), y last
  std::array<Eigen::MatrixXd, 2> held_out_white_;  // of these, by Part
  Eigen::MatrixXd gram_, unforeseen_gram_;
  std::vector<Eigen::MatrixXd> fold_gram_;  // of folds of blocks of time
  Eigen::VectorXd innovation_;              // whitened residual of everything
  // How much of it the fit of everything may have taken: whitened columns in use, and the root of
  // the covariance of their coefficients.
  Eigen::MatrixXd fitted_, fitted_root_;
};

}  // namespace odmc
