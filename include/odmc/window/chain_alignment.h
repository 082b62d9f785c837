#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "odmc/window/chain.h"
#include "odmc/window/chain_solution.h"
#include "odmc/window/window.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// One number for every column of a whole window: states (12 each), biases (6 each), parameters.
struct WindowColumns {
  std::vector<Eigen::Matrix<double, kStateTangentSize, 1>> states;
  std::vector<Eigen::Matrix<double, 6, 1>> biases;
  Eigen::VectorXd parameters;

  void SetZero(const Window& window);
  /// f(entry of a, entry of b) summed.
  template <typename Function>
  static double Sum(const WindowColumns& a, const WindowColumns& b, const Function& f);
};

/// Solves a whole window along its chain, by Levenberg-Marquardt with the rules of Ceres: all
/// fronts are linearized at the estimate and eliminated, damping as further rows, and a step is
/// taken where the true cost falls by it.
class ChainAlignment {
 public:
  /// @param chain, solution must outlive it
  ChainAlignment(Chain* chain, ChainSolution* solution) : chain_(chain), solution_(solution) {}

  /// Moves the window's states, biases and parameters to the optimum of its factors and prior, with
  /// the anchor where it is. The chain is left as it comes.
  /// @param past of the chain; the chain is that of ReadChain(), the solution was Reset()
  SolveReport Solve(const RootTriangle& past, const SolverOptions& options, Window* window);

 private:
  enum class Step { kTaken, kRefused, kTooShort };

  std::optional<double> Linearise(const Window& window);
  double SumFactors(const Window& window);
  void SumFactor(const Window& window, const Factor& factor, const ChainFront& front,
                 const ChainFront::KeptFactor& kept, const double* residual);
  double SumPast(const Window& window);
  double SumPriors(const Window& window);
  void AddRow(const double* row, int count, double residual, double* diagonal, double* gradient);

  void Eliminate(const Window& window);
  void DampState(const WindowColumns& diagonal, size_t front);
  void DampBias(const Window& window, std::int64_t bias);
  double Damping(double diagonal) const;

  Step TakeStep(double* cost, Window* window);
  void ReadStep(const Window& window);
  void Save(const Window& window);
  void Restore(Window* window) const;
  double SavedNorm() const;

  Chain* chain_;
  ChainSolution* solution_;
  const RootTriangle* past_ = nullptr;
  double radius_ = 0.0, shrink_ = 0.0;  // of the trust region, and what a refused step does to it
  RowBlock prior_message_;              // of the oldest front, its state counted from prior_point_
  std::array<double, kStateSize> prior_point_;
  WindowColumns diagonal_, gradient_;  // of the normal equations
  WindowColumns step_;
  RowBlock damping_;
  // Where the step started, to go back to.
  std::vector<std::array<double, kStateSize>> saved_states_;
  std::vector<std::array<double, 6>> saved_biases_;
  ParameterVector saved_eta_;
};

}  // namespace odmc
