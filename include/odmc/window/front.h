#pragma once

#include <Eigen/Core>

#include "odmc/window/window.h"

namespace odmc {

/// Where the variables lie around one keyframe when the chain is eliminated oldest state first:
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

/// Normal equations are kept as the upper triangle of [H g; gᵀ rᵀr], the gradient g in the column
/// behind the variables'. A front's are in its FrontColumns; a message, what all before one
/// keyframe says, in the columns [its state (12), its bias (6) if it has one, parameters (n)].

/// Adds a factor's |r + J d|² to a front.
void AddToFront(const Factor& factor, const LinearFactor& linear, const FrontColumns& columns,
                Eigen::MatrixXd* front);

/// Adds what the keyframes before said.
void AddToFront(const Eigen::MatrixXd& message, const FrontColumns& columns,
                Eigen::MatrixXd* front);

/// The window's prior at the present estimate as the message to its oldest keyframe.
Eigen::MatrixXd PriorMessage(const Window& window);

/// A front after its elimination: U d_E = -(W [d_R; 1]), E eliminated, R the rest.
struct EliminatedFront {
  Eigen::MatrixXd U;  ///< upper Cholesky factor (E×E)
  Eigen::MatrixXd W;  ///< E×(R+1), the gradient last
};

/// Eliminates the front's first columns by Cholesky.
/// @param message what remains: the message to the next keyframe, or of the parameters alone
/// @returns false if they have a direction without information
bool EliminateFront(const Eigen::MatrixXd& front, const FrontColumns& columns,
                    EliminatedFront* eliminated, Eigen::MatrixXd* message);

}  // namespace odmc
