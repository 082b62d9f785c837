#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "odmc/window/window.h"

namespace odmc {

/// Linear least-squares system |b + [E R] x|² with the columns to eliminate first.
struct LinearSystem {
  Eigen::MatrixXd A;  ///< rows × (eliminated + remaining)
  Eigen::VectorXd b;
  int num_eliminated = 0;
};

/// Square-root elimination: what the system says about the remaining columns. Rank-revealing twice:
/// eliminated directions nobody measured take no rows with them, and the result has as many rows as
/// it has information (rank), at most the number of remaining columns. Squares no condition number.
/// @param tolerance relative size below which a diagonal of R counts as zero
LinearSystem Eliminate(const LinearSystem& system, double tolerance = 1e-10);

/// Where the variables lie around one keyframe when the window is eliminated oldest state first:
/// [its state (12), its bias if no later keyframe has it (6) | next state (12), bias in force there
/// (6), parameters (n)]. What eliminating the first part says about the second is handed to the
/// next keyframe.
struct FrontColumns {
  int leaving_bias = -1, next_state = -1, kept_bias = -1, parameters = -1;  ///< first, -1: none
  int num_eliminated = 0, total = 0;
  std::int64_t id = -1, bias = -1;  ///< the keyframe and its bias

  /// @param keyframe id of a keyframe of the window
  FrontColumns(const Window& window, std::int64_t keyframe);

  /// First column of one of the front's states or biases.
  int StateColumn(std::int64_t keyframe) const { return keyframe == id ? 0 : next_state; }
  int BiasColumn(std::int64_t which) const {
    return which == bias && leaving_bias >= 0 ? leaving_bias : kept_bias;
  }
};

/// Adds a factor's Jacobian to the rows of a front from `row` on.
void PlaceRows(const Factor& factor, const LinearFactor& linear, const FrontColumns& columns,
               int row, Eigen::MatrixXd* A);

/// What left the window with one keyframe, for statistics.
struct LeavingFactors {
  /// Sum of Jᵀ r over the leaving factors that touch parameters, with respect to eta (n).
  Eigen::VectorXd score;
  /// Squared whitened derivatives of the leaving dynamics factor's force and torque rows (n each).
  Eigen::VectorXd force_information, torque_information;
};

/// Takes the oldest keyframe (and its bias, if no other keyframe has it) out of the window and puts
/// what it said into the prior: linearize → eliminate → make prior. Jacobians are taken at the
/// points the prior already has; parameters the prior touches keep their point until they have
/// moved by more than `relinearize` (per entry of eta), when the prior is moved as a whole.
/// @returns false if a factor could not be evaluated; what that factor said is lost, the rest is
/// kept
bool MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                       LeavingFactors* leaving = nullptr);

/// Scales what the prior says about the parameters alone, by `scale` on the information about each
/// (n, > 0); what it says about the state given the parameters stays, and so does its optimum. Used
/// when the noise of everything that left turns out to be larger or smaller than thought.
///
/// Each direction of parameters that the prior knows (singular vector, of eta) is scaled by the
/// weighted geometric mean of its parameters' scales. Directions must not turn: where force and
/// torque know a combination together, scaling parameter by parameter would make up information
/// about what nobody has seen.
/// @returns the symmetric root of the scale (n×n), for others that keep information: T I T
Eigen::MatrixXd RescalePrior(const Eigen::Ref<const Eigen::VectorXd>& scale, Window* window);

/// How much RescalePrior() stretches each direction of parameters: the weighted geometric mean of
/// its parameters' scales, square root.
/// @param directions orthonormal columns (n×n)
void DirectionScales(const Eigen::MatrixXd& directions,
                     const Eigen::Ref<const Eigen::VectorXd>& scale, Eigen::VectorXd* roots);

/// How rows R about parameters fade along a direction d in which these have moved by a variance
/// since: with v = R d, R - gain v vᵀ R is a root of the information ((RᵀR)⁻¹ + variance d dᵀ)⁻¹
/// (by Woodbury's identity), so that the optimum stays.
/// @param square |v|²
/// @returns gain; nothing where the rows know nothing along d, or nothing has moved
std::optional<double> FadingGain(double square, double variance);

/// Lets the parameters have moved together since the prior was made, from eta to eta + n d with n
/// of this variance (a step of a random walk): what the prior says about the parameters alone fades
/// along d. What it says of the state given the parameters stays.
/// @param direction d (n)
void LetPriorWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
                  Window* window);

/// A step of a first-order Gauss-Markov process about zero: x becomes decay x + n.
struct ProcessStep {
  double decay = 1.0;     ///< 0 < decay <= 1
  double variance = 0.0;  ///< of n
};

/// Lets parameter `index` of eta have made a step of a process since the prior was made: what the
/// prior says about it fades, and its optimum decays with what it pulls along.
void LetPriorVary(int index, const ProcessStep& step, Prior* prior);

}  // namespace odmc
