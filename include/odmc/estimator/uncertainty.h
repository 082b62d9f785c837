#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <string>
#include <vector>

#include "odmc/estimator/consistency.h"
#include "odmc/estimator/noise_estimation.h"
#include "odmc/estimator/regressor_noise.h"
#include "odmc/estimator/snapshot.h"
#include "odmc/estimator/thirds_consistency.h"
#include "odmc/window/marginalization.h"
#include "odmc/window/window.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// How well the parameters are known: the window's covariance, widened by what it does not see
/// (serial correlation, noise of the states, the scale of modelled rotor speeds), and what the
/// flight does not show. Thread-compatible.
class Uncertainty {
 public:
  /// Both must outlive it.
  Uncertainty(const DynamicModel* model, const ParameterLayout* layout);

  /// Parameters count as observable against the priors of this model, which has the same
  /// parameters.
  void JudgeBy(const DynamicModel& declared);
  /// Back to the priors.
  void Reset();

  /// Entries of eta that walk together with the flight: what it said of them is judged about the
  /// value of its time.
  /// @param rate relative [1/√s]
  void SetWalking(const std::vector<int>& entries, double rate);
  /// An interval of `dt` has left the window: what has left says less of them, as they have walked
  /// on. Now and then, for all of it that is owed.
  void LetWalk(double dt, WindowSolver* solver, Window* window);

  /// Of eta, after the last update, not widened (n).
  const Eigen::VectorXd& sigma_eta() const { return sigma_eta_; }

  /// What the window is like when an update has solved it.
  struct Conditions {
    ProcessNoiseEstimator::Levels noise;  ///< of what is not modelled, in use
    double flown_s = 0.0;
    double rotor_scale_sigma = 0.0;  ///< of modelled rotor speeds, relative
  };
  /// Fills the snapshot's covariances, sigmas and what is observable.
  /// @pre its values are set
  void Fill(const Window& window, const Conditions& conditions, WindowSolver* solver,
            Snapshot* snapshot);

  /// Scratch of the keyframe that leaves.
  LeavingFactors* leaving() { return &leaving_; }
  /// An interval of `dt` has left with what leaving() says; `eta` is the estimate.
  /// @param yaw_inertia_held its torque about z was that of the file's inertia
  void AccumulateMarginalized(double dt, const ParameterVector& eta, bool yaw_inertia_held);

  /// By how much the information of each parameter changes with the sizes of what is not modelled.
  ParameterVector ScaleOf(const ProcessNoiseEstimator::Change& change);
  /// The solver has scaled the past by a new noise level. @param root what it returned
  void Rescale(const Eigen::MatrixXd& root);

  /// By how much the information of each parameter is to shrink when the vehicle has changed.
  Eigen::VectorXd ScaleAfterChange() const;
  /// The solver has scaled the past so.
  void Forget(const Eigen::MatrixXd& root);

  /// Parameters about which the thirds of the flight disagree beyond sampling error.
  std::vector<ThirdsDifference> CompareThirds(const Window& window);

 private:
  void RefreshInflation();
  void TellUnobservable();
  void FillParameters(Snapshot* snapshot) const;
  void AddScaleError(double rotor_scale_sigma, Snapshot* snapshot) const;
  void AddHeldInertiaError(Snapshot* snapshot) const;
  int EstimatedEntry(const char* name) const;  // of eta, -1 if there is none

  const DynamicModel* model_;
  const ParameterLayout* layout_;
  Consistency consistency_;
  RegressorNoise regressor_noise_;
  Eigen::VectorXd consistency_inflation_, noise_inflation_, inflation_;  // the last: both
  Eigen::VectorXd prior_sigma_eta_;  // by which parameters count as observable
  Eigen::VectorXd sigma_eta_;        // of the last update, not inflated
  Eigen::VectorXd force_information_, torque_information_;  // what has informed each parameter
  double held_yaw_information_ = 0.0;  // of k_m, from intervals whose yaw inertia was held
  std::vector<std::string> unobservable_;
  struct {
    Eigen::MatrixXd in_priors;  // covariance in units of the priors' sigmas
    Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen;
  } directions_;
  Eigen::MatrixXd covariance_;  // of eta, of the last update
  LeavingFactors leaving_;
  std::vector<int> walking_;     // entries of eta
  double walk_rate_ = 0.0;       // [1/√s]
  double walk_owed_s_ = 0.0;     // of flight that has left since they last walked
  Eigen::MatrixXd before_walk_;  // information of the past
};

}  // namespace odmc
