#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <vector>

#include "odmc/attribution/residual.h"

namespace odmc {

/// What could be known of a regressor before the sample it is used for: its regression on the
/// flight's motion and rotors, and on itself, 0.12 s and more ago; and on what it would be in the
/// motion that these foresee, since products of states are foreseen as products.
///
/// Under feedback the noise of the present is in the rotors a moment later, and so it is within the
/// filter's window; noise of rotor speeds is in every torque. A regression on such columns takes
/// both for physics. What the past says of them has neither (instrumental variables; Young,
/// Recursive Estimation and Time-Series Analysis, 2011, ch. 7-9). What the past does not foresee is
/// no evidence for or against anything.
///
/// Each fold of blocks of time is foreseen by the coefficients of the others (Angrist, Imbens and
/// Krueger, J. Appl. Econometrics 1999), and shrunk to what that was worth.
class Instruments {
 public:
  static constexpr int kFolds = 5;
  /// Samples without a gap before one that has a past.
  static constexpr int kReach = 8;

  Instruments(const ThinnedFlight& flight, const Vehicle& file_vehicle);

  /// True if the sample has a past.
  bool Sees(int i) const { return sees_[static_cast<size_t>(i)]; }

  /// The flight in the motion that was foreseen.
  const ThinnedFlight& likely_flight() const { return likely_flight_; }

  /// The part that was foreseen (N×6); what has no past is zero.
  /// @param likely the same column in likely_flight(), or zero where that is not known
  ResidualModel::Wrenches Foreseen(const ResidualModel::Wrenches& column,
                                   const ResidualModel::Wrenches& likely) const;
  /// The same of any columns (N×k).
  Eigen::MatrixXd Foreseen(const Eigen::MatrixXd& columns, const Eigen::MatrixXd& likely) const;

  /// Fold of a sample.
  static int FoldAt(double t_s);

 private:
  /// Rows of a fold: first those in use, then those held out.
  struct Fold {
    Eigen::Index first = 0, in_use = 0, size = 0;
  };

  struct Batch;
  struct Sums;
  struct Weights;

  /// The columns that are not zero (N×k), with what is their own.
  Batch BatchOf(const Eigen::MatrixXd& columns, const Eigen::MatrixXd& likely) const;
  Sums SumsOf(const Batch& batch) const;
  /// Least squares over all folds but one.
  Weights WeightsWithout(size_t fold, const Sums& sums) const;
  /// Each fold as the others foresee it.
  Eigen::MatrixXd ValueByFolds(const Batch& batch, const Sums& sums) const;
  /// What a value foresees of the column itself, of which `square` is the sum of squares: the
  /// factor, 0 to 1, by which it comes nearest; 0 where that is next to nothing.
  double WorthOf(const Eigen::Ref<const Eigen::VectorXd>& value,
                 const Eigen::Ref<const Eigen::VectorXd>& itself, double square) const;
  /// A few columns at once; those that are zero stay zero.
  Eigen::MatrixXd ForeseenBatch(const Eigen::MatrixXd& columns,
                                const Eigen::MatrixXd& likely) const;
  std::vector<FilteredMotion> LikelyMotion(const ThinnedFlight& flight) const;

  std::vector<bool> sees_;
  std::vector<int> rows_;  // samples with a past, fold by fold
  std::array<Fold, kFolds> folds_;
  Eigen::MatrixXd z_;                                 // rows × instruments, of unit size
  std::vector<Eigen::LLT<Eigen::MatrixXd>> without_;  // sums of the other folds
  ThinnedFlight likely_flight_;
};

}  // namespace odmc
