#pragma once

#include <ceres/cost_function.h>
#include <ceres/loss_function.h>

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <type_traits>
#include <vector>

#include "odmc/factors/manifolds.h"
#include "odmc/factors/parameter_layout.h"
#include "odmc/factors/state.h"
#include "odmc/math/ring.h"

namespace odmc {

class AccelerometerFactor;
class BiasWalkFactor;
class BlockPriorFactor;
class DynamicsFactor;
class GyroFactor;
class GyroPreintegrationFactor;
class KinematicFactor;
class OdometryFactor;

/// What a factor says, so that others can find the ones they need.
enum class FactorKind {
  kOdometry,
  kKinematic,
  kDynamics,
  kAccelerometer,
  kGyro,
  kGyroPreintegration,
  kBiasPrior,
  kBiasWalk,
  kOther  ///< a cost function that nobody looks for
};
constexpr int kNumFactorKinds = static_cast<int>(FactorKind::kOther) + 1;

/// The kind of a type of cost function.
template <typename T>
struct FactorKindOf;
template <FactorKind kind>
using IsFactorKind = std::integral_constant<FactorKind, kind>;
template <>
struct FactorKindOf<OdometryFactor> : IsFactorKind<FactorKind::kOdometry> {};
template <>
struct FactorKindOf<KinematicFactor> : IsFactorKind<FactorKind::kKinematic> {};
template <>
struct FactorKindOf<DynamicsFactor> : IsFactorKind<FactorKind::kDynamics> {};
template <>
struct FactorKindOf<AccelerometerFactor> : IsFactorKind<FactorKind::kAccelerometer> {};
template <>
struct FactorKindOf<GyroFactor> : IsFactorKind<FactorKind::kGyro> {};
template <>
struct FactorKindOf<GyroPreintegrationFactor> : IsFactorKind<FactorKind::kGyroPreintegration> {};
template <>
struct FactorKindOf<BlockPriorFactor> : IsFactorKind<FactorKind::kBiasPrior> {};
template <>
struct FactorKindOf<BiasWalkFactor> : IsFactorKind<FactorKind::kBiasWalk> {};

/// A cost function and the variables it touches. Its blocks are, in order: state0, state1, bias0,
/// bias1 (those that are set), then eta if `parameters`, then the anchor if `anchored`.
struct Factor {
  FactorKind kind;
  std::unique_ptr<ceres::CostFunction> cost;
  const ceres::LossFunction* loss = nullptr;  ///< not owned; null: none
  std::int64_t state0 = -1, state1 = -1;      ///< keyframe ids
  std::int64_t bias0 = -1, bias1 = -1;        ///< bias ids
  bool parameters = false;
  bool anchored = false;  ///< its last block is the window's anchor
  /// Grows whenever the cost function is changed in place; solvers that keep linearizations then
  /// evaluate it anew.
  int revision = 0;

  /// The cost function if it is a `T`, else null. The kind tells: it is the only cast.
  template <typename T>
  T* As() const {
    return kind == FactorKindOf<T>::value ? static_cast<T*>(cost.get()) : nullptr;
  }
};

/// Pointers to the blocks of one factor, as Ceres takes them.
struct FactorBlocks {
  std::array<const double*, 6> pointers{};
  int count = 0;

  const double* const* data() const { return pointers.data(); }
  bool operator!=(const FactorBlocks& other) const { return pointers != other.pointers; }
};

/// One state in the window. Owns the factors whose oldest state it is.
struct Keyframe {
  std::int64_t id = 0;
  Stamp stamp = 0;
  std::array<double, kStateSize> x;
  std::int64_t bias = -1;  ///< bias in force at this keyframe, -1 without IMU
  bool linked = false;     ///< false: starts a chain (nothing ties it to the keyframe before)
  bool in_prior = false;   ///< the prior touches it; `x_lin` is then its linearization point
  std::array<double, kStateSize> x_lin;
  std::vector<Factor> factors;

  /// Calls `use(factor, cost)` for each of the factors whose cost function is a `T`.
  template <typename T, typename Use>
  void ForEach(const Use& use) {
    for (Factor& factor : factors) {
      if (T* const cost = factor.As<T>()) use(&factor, cost);
    }
  }
  template <typename T, typename Use>
  void ForEach(const Use& use) const {
    for (const Factor& factor : factors) {
      if (const T* const cost = factor.As<T>()) use(factor, *cost);
    }
  }
};

/// One IMU bias (gyro, accelerometer) in force over a few keyframes.
struct Bias {
  std::int64_t id = 0;
  std::array<double, 6> x;
  bool in_prior = false;
  std::array<double, 6> x_lin;
};

/// What the states that left say about what remains, in square-root form: residual = b + A d, with
/// d the stacked differences to the linearization points of [oldest keyframe (12), its bias (6),
/// parameters (n)], those that are set.
struct Prior {
  bool has_state = false;
  bool has_bias = false;
  Eigen::MatrixXd A;
  Eigen::VectorXd b;
  ParameterVector eta_lin;  ///< linearization point of the parameters

  int state_columns() const { return has_state ? kStateTangentSize : 0; }
  int bias_columns() const { return has_bias ? 6 : 0; }
};

/// States, factors and prior of the sliding window: what it holds, not how it is solved.
/// Thread-compatible.
class Window {
 public:
  /// @param layout must outlive the window
  explicit Window(const ParameterLayout* layout);

  /// Appends a keyframe. @returns its id
  std::int64_t AddKeyframe(Stamp stamp, const State& initial, bool linked, std::int64_t bias);

  /// Appends a bias. @returns its id
  std::int64_t AddBias(const Eigen::Matrix<double, 6, 1>& initial);

  /// Adds a factor; it belongs to its oldest keyframe, a factor of biases only to the newest one.
  /// @pre its variables are in the window
  void AddFactor(Factor factor);

  /// Says that a factor's cost function was changed in place.
  void Touch(Factor* factor);

  /// The oldest keyframe whose factors were touched since the last call; -1: none.
  std::int64_t TakeTouched();

  /// Takes keyframe `id` and all newer ones off, with every factor and bias that only they need.
  /// @pre the solver has released the window; `id` is not the oldest
  void DropNewestKeyframes(std::int64_t id);

  /// Takes the oldest keyframe off; its cost functions become spares.
  void DropOldestKeyframe();

  /// A factor with a cost function `T`, one that is no longer needed set anew where there is any:
  /// nothing is allocated then. Its variables are still to be named.
  template <typename T, typename... Arguments>
  Factor MakeFactor(const Arguments&... arguments) {
    Factor factor;
    factor.kind = FactorKindOf<T>::value;
    factor.cost = TakeSpare(factor.kind);
    if (factor.cost == nullptr) {
      factor.cost = std::make_unique<T>(arguments...);
    } else {
      factor.As<T>()->Set(arguments...);
    }
    return factor;
  }

  const ParameterLayout& layout() const { return *layout_; }
  Ring<Keyframe>& keyframes() { return keyframes_; }
  const Ring<Keyframe>& keyframes() const { return keyframes_; }
  Ring<Bias>& biases() { return biases_; }
  const Ring<Bias>& biases() const { return biases_; }
  Keyframe& keyframe(std::int64_t id) { return keyframes_[id - keyframes_.front().id]; }
  Bias& bias(std::int64_t id) { return biases_[id - biases_.front().id]; }
  const Keyframe& keyframe(std::int64_t id) const { return keyframes_[id - keyframes_.front().id]; }
  const Bias& bias(std::int64_t id) const { return biases_[id - biases_.front().id]; }

  /// The estimated parameters in the optimiser's units.
  ParameterVector& eta() { return eta_; }
  const ParameterVector& eta() const { return eta_; }
  ModelValues values() const { return layout_->Decode(eta_.data()); }

  /// Names the entry of eta whose value anchored factors take in a block of their own, which no
  /// solve moves but all of them let follow (see DynamicsMeasurement); -1: none.
  void SetAnchorEntry(int entry) { anchor_entry_ = entry; }
  int anchor_entry() const { return anchor_entry_; }
  double& anchor() { return anchor_; }
  double anchor() const { return anchor_; }
  /// Puts the anchor at the present estimate.
  void MoveAnchor() {
    if (anchor_entry_ >= 0) anchor_ = eta_[anchor_entry_];
  }

  /// Prior of each parameter apart from what the flight said: centre and sigma, in eta.
  const Eigen::VectorXd& parameter_centre() const { return parameter_centre_; }
  const Eigen::VectorXd& parameter_sigma() const { return parameter_sigma_; }

  Prior& prior() { return prior_; }
  const Prior& prior() const { return prior_; }

  /// Pointers to a factor's blocks at the current estimate, or at the linearization points of what
  /// the prior touches.
  FactorBlocks Blocks(const Factor& factor, bool at_linearization) const;
  /// Pointers to change them.
  std::vector<double*> MutableBlocks(const Factor& factor);
  std::vector<double*> PriorBlocks();

 private:
  std::unique_ptr<ceres::CostFunction> TakeSpare(FactorKind kind);

  const ParameterLayout* layout_;
  Ring<Keyframe> keyframes_;
  Ring<Bias> biases_;
  std::array<std::vector<std::unique_ptr<ceres::CostFunction>>, kNumFactorKinds> spares_;
  ParameterVector eta_;
  Eigen::VectorXd parameter_centre_, parameter_sigma_;
  Prior prior_;
  std::int64_t next_keyframe_ = 0, next_bias_ = 0;
  std::int64_t touched_ = -1;
  int anchor_entry_ = -1;
  double anchor_ = 0.0;
};

/// A factor's residual and minimal Jacobian at one point, whitened and with the robust loss applied
/// (as Ceres does, first order). Columns: state0, state1 (12 each), bias0, bias1 (6), parameters
/// (n).
struct LinearFactor {
  Eigen::VectorXd r;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic> J;
  int state0 = -1, state1 = -1, bias0 = -1, bias1 = -1, parameters = -1;  ///< first columns, or -1
};

/// Linearizes `factor`. With `first_estimates`, Jacobians are taken at the linearization points of
/// what the prior touches and the residual at the current estimate.
/// @returns false if it cannot be evaluated
bool Linearize(const Window& window, const Factor& factor, bool first_estimates,
               LinearFactor* linear);

/// Half the square of a factor's residual at the present estimate, robust loss applied; nothing if
/// it cannot be evaluated.
std::optional<double> CostOf(const Window& window, const Factor& factor);

/// Ceres view of a Prior, with blocks state (13), bias (6), eta (n), those that are set.
class MarginalizationFactor final : public ceres::CostFunction {
 public:
  /// `window` must outlive the factor and keep its prior meanwhile.
  explicit MarginalizationFactor(const Window* window);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

 private:
  const Window* window_;
};

/// How far the current estimate is from where the prior was linearized, in the prior's columns.
Eigen::VectorXd PriorOffset(const Window& window);

/// Residual of the window's prior at its current estimate. Its Jacobian is prior().A, but for the
/// state's columns, which are PriorStateJacobian().
Eigen::VectorXd PriorResidual(const Window& window);

/// Jacobian of the prior's residual by the oldest state at its current estimate (rows×12).
/// @pre prior().has_state
Eigen::MatrixXd PriorStateJacobian(const Window& window);

}  // namespace odmc
