#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "odmc/window/root_triangle.h"
#include "odmc/window/window.h"

namespace odmc {

/// Residuals of one factor, at most.
constexpr int kMostFactorRows = 32;

/// Rows over some columns, with room for more; never gives memory back.
struct RowBlock {
  std::vector<double> data;
  int stride = 0;
  int count = 0;

  double* row(int i) { return data.data() + i * stride; }
  const double* row(int i) const { return data.data() + i * stride; }
  /// Becomes `rows` rows of zeros.
  void SetZero(int rows, int row_stride);
  /// Appends rows of zeros.
  void Extend(int rows);
  /// Later, so many rows need nothing from the heap.
  void Reserve(int rows, int row_stride);
  void CopyFrom(const RowBlock& other);
};

/// Scratch of one solver, shared by all fronts.
struct FrontScratch {
  RowBlock own, pair;
  std::vector<double> gradient, difference, passing;
  std::vector<double> taken;  ///< by the border, that the last correction left to the next message
  std::vector<double> jacobians, residual;
};

/// One keyframe's part of the chain, for the incremental solver: its factors' linearizations, the
/// message that came in, and what its elimination left. Rows are of |A x + b|²; states count from
/// their linearization points, biases and parameters from zero.
///
///   message       state (12) | bias, parameters, rhs (BorderColumns)
///   own           rows of its factors of this state alone, same columns
///   pair          rows of the others: state (12), bias that leaves (6, where one does) | next
///                 state (12), border
///   conditional   triangle over the eliminated columns, same columns as pair
///   rest          what elimination left for the root: border. The first rest_before rows come
///                 before a bias leaves, the others after.
///   leaving_bias  the root's rows of the bias that leaves here, before this front's pair
///   corrected     a row per factor, columns as pair: gradient that corrections found beyond that
///                 of its rows
class ChainFront {
 public:
  /// Starts anew for a keyframe of the window.
  void Reset(const Window& window, std::int64_t keyframe);

  std::int64_t id = -1;
  std::array<double, kStateSize> point;  ///< linearization point of the state
  int point_version = 0;

  /// State's and next state's points at which the conditional was made.
  std::array<double, kStateSize> conditional_point, next_point;
  int conditional_version = -1, next_version = -1;

  /// Solution: state's difference to its linearization point of version `delta_version`.
  std::array<double, kStateTangentSize> delta;
  int delta_version = -1;

  RowBlock message, own, pair, conditional, rest, leaving_bias, corrected;
  /// Gradient by the border that corrections added to `rest` since it was left.
  std::vector<double> rest_gradient;
  /// Gradient by state and border that came with the message since this was eliminated (18 + n).
  /// The root has what is about the border.
  std::vector<double> waiting;
  /// Gradient by the bias that leaves here, found at older fronts; the root knows this bias no
  /// more.
  std::array<double, 6> arrived{};
  bool waits = false;
  int rest_before = 0;
  bool bias_leaves = false;
  bool eliminated = false;  ///< false: the newest

  int pivots() const { return kStateTangentSize + (bias_leaves ? 6 : 0); }
  int border() const { return pivots() + kStateTangentSize; }

  /// Moves the state's linearization point to the present estimate, its message to be made anew.
  void MovePoint(const Window& window);

  /// The same where the message stays: it is linearized there as well.
  void MovePointWithMessage(const Window& window, FrontScratch* scratch);

  /// Evaluates the factors whose linearization is out of date: changed, or of a state whose point
  /// moved, or at another point of the parameters.
  /// @param parameter_point where parameters are linearized; its version tells that it moved
  /// @param absorbed factors of this state alone are in its triangle already and stay
  /// @returns false if a factor cannot be evaluated
  bool Linearise(const Window& window, const ChainFront* next,
                 const ParameterVector& parameter_point, int point_version_of_parameters,
                 bool absorbed, FrontScratch* scratch);

  /// Rotates the factors of this state alone into its message; what they say of the rest goes to
  /// `rest` and to the root.
  /// @param triangle becomes the state's triangle (12 rows, columns as message)
  void AbsorbOwn(RowBlock* triangle, RootTriangle* root, FrontScratch* scratch);

  /// Eliminates the state (and its bias, where it leaves), given its triangle.
  /// @param next its message is set
  void Eliminate(const RowBlock& triangle, RootTriangle* root, ChainFront* next,
                 FrontScratch* scratch);

  /// Has factors evaluated anew whose robust weight at the present estimate, by their
  /// linearization, differs from that of their rows by more than a factor of `most`.
  /// @returns true if there are any
  bool FollowWeights(const Window& window, const ChainFront& next, double most);

  /// Corrects gradients without a new elimination: factors with parameters are evaluated at the
  /// present estimate, with the robust weight they have there and their Jacobian by the parameters.
  /// What the gradient differs by from that of their rows goes through the conditional (seminormal
  /// equations): what is left of the border to the root, what is left of the next state waits there
  /// for its turn. Steps then end where the true gradient vanishes; old Jacobians only make them a
  /// little wrong.
  /// @param found gradient for the root, by the bias in force and the parameters: added to (6 + n);
  /// where the bias leaves, what was found of it is taken
  void Correct(const Window& window, ChainFront* next, FrontScratch* scratch, double* found);

  /// Passes on what waits, without an evaluation.
  void PassOn(ChainFront* next, FrontScratch* scratch, double* found);

  /// What the state differs by from its linearization point (12).
  void Offset(const Window& window, double* d) const;

  /// Gives what elimination left to the root of all that has left the window.
  void LeaveTo(RootTriangle* past, FrontScratch* scratch) const;

  /// Where a factor's rows are, and at what points they were evaluated.
  struct KeptFactor {
    bool in_pair = false;
    int row = 0, rows = 0;
    int revision = -1;
    int state0 = -1, state1 = -1, parameters = -1;  ///< versions of their points
    bool sound = false;
    bool corrected = false;  ///< its row of `corrected` is not zero
    double weight = 1.0;     ///< of its rows: root of the robust loss' slope
  };
  const std::vector<KeptFactor>& kept() const { return kept_; }

  /// Residual of a kept factor by its linearization at the present estimate, weighted.
  /// @param own, next what the states differ by from their points (12 each)
  /// @param residual kept.rows numbers
  void LinearResidual(const Window& window, const Factor& factor, const KeptFactor& kept,
                      const double* own, const double* next, double* residual) const;

 private:
  void MakeRoomForLeavingBias();
  bool Evaluate(const Window& window, const Factor& factor, const ChainFront* next,
                const ParameterVector& parameter_point, KeptFactor* kept, FrontScratch* scratch);
  bool CorrectFactor(const Window& window, size_t k, const double* own, const double* next,
                     FrontScratch* scratch);

  void StartGradient(FrontScratch* scratch) const;
  void SubstituteGradient(ChainFront* next, FrontScratch* scratch, double* found);

  int n_ = 0;
  std::int64_t bias_ = -1;
  std::vector<KeptFactor> kept_;
};

}  // namespace odmc
