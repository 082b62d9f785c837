// model.md section 13, test 1: every Jacobian block of every factor against automatic
// differentiation of a second implementation, at 20 random states.
#include <gtest/gtest.h>

#include <cstdio>
#include <memory>
#include <optional>
#include <stdexcept>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/factors/imu_factors.h"
#include "odmc/factors/state_factors.h"
#include "odmc/math/so3.h"
#include "odmc/window/window.h"
#include "support/autodiff_twin.h"
#include "support/jacobian_check.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

constexpr int kNumStates = 20;
constexpr double kJacobianTolerance = 1e-8;
constexpr double kResidualTolerance = 1e-10;

enum class Freedom { kAll, kPartly, kNone };

std::vector<std::string> Effects() {
  std::vector<std::string> effects = PaperEffects();
  effects.push_back("odometry_extrinsics");
  effects.push_back("imu_extrinsics");
  return effects;
}

/// The nominal vehicle with both sensors away from the centre and turned.
Vehicle TurnedVehicle() {
  Vehicle vehicle = NominalVehicle();
  vehicle.odometry.q_BS = Exp(Vector3d(0.3, -0.2, 0.9));
  vehicle.imu.emplace();
  vehicle.imu->p_BS = {0.05, 0.03, -0.02};
  vehicle.imu->q_BS = Exp(Vector3d(-0.4, 0.5, 1.2));
  vehicle.imu->estimate = true;
  // Rotors at different heights, so that no term of the torque cancels.
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    vehicle.rotors[j].p_BP += Vector3d(0.004 * j, -0.003 * j, 0.01 * j);
  }
  return vehicle;
}

/// @param rates with the effects that take rotor accelerations
DynamicModel MakeModel(Freedom freedom, bool rates) {
  Vehicle vehicle = TurnedVehicle();
  std::vector<std::string> effects = Effects();
  if (rates) effects.insert(effects.end(), {"rotor_delay", "rotor_reaction"});
  const DynamicModel named(vehicle, effects);
  const std::vector<std::string> frozen = {
      "rotor_torque.k_m",       "drag.d_y", "inertia.y",         "gravity.x",
      "odometry_extrinsics.rz", "hvt.k_h",  "imu_extrinsics.px", "centre_of_gravity.z"};
  for (const ModelParameter& p : named.parameters()) {
    const bool is_frozen = std::count(frozen.begin(), frozen.end(), p.full_name) > 0;
    vehicle.parameters[p.full_name].estimated =
        freedom == Freedom::kAll || (freedom == Freedom::kPartly && !is_frozen);
  }
  return DynamicModel(vehicle, effects);
}

/// Physical values around the nominal ones, every one different from zero.
ModelValues RandomValues(const DynamicModel& model, Random* random) {
  ModelValues values = model.InitialValues();
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ParameterSpec& spec = model.parameters()[k].spec;
    values[k] = spec.transform == ParameterTransform::kLog
                    ? spec.prior_value * std::exp(random->Next(0.4))
                    : spec.prior_value + spec.scale * random->Next(1.5);
  }
  return values;
}

/// Two states `dt` apart with rates to 10 rad/s and speeds to 10 m/s that do not fit each other.
std::vector<State> RandomStates(double dt, Random* random) {
  State s0, s1;
  s0.p_WS = random->Next3(5.0);
  s0.q_WS = Exp(random->Next3(1.5));
  s0.v_WS = random->Next3(10.0 / std::sqrt(3.0));
  s0.w_WS_S = random->Next3(10.0 / std::sqrt(3.0));
  s1.p_WS = s0.p_WS + dt * s0.v_WS + random->Next3(0.01);
  s1.q_WS = s0.q_WS * Exp(dt * s0.w_WS_S + random->Next3(0.05));
  s1.v_WS = s0.v_WS + random->Next3(1.0);
  s1.w_WS_S = s0.w_WS_S + random->Next3(1.0);
  return {s0, s1};
}

RotorState RandomRotors(const Vehicle& vehicle, Random* random) {
  RotorVector speed(vehicle.num_rotors());
  for (int j = 0; j < speed.size(); ++j) speed[j] = 1100.0 + random->Next(300.0);
  RotorState rotors = RotorState::Steady(speed);
  rotors.speed_squared *= 1.01;  // the mean of the square is not the square of the mean
  return rotors;
}

/// One random setting for every factor under test.
struct Setting {
  Setting(Freedom freedom, unsigned seed, bool rates = false)
      : random(seed),
        model(MakeModel(freedom, rates)),
        start(RandomValues(model, &random)),
        layout(model, start) {
    dt = 0.01 + 0.01 * (random.Next() + 1.0);
    at.states = RandomStates(dt, &random);
    ModelValues values = start;
    const ModelValues other = RandomValues(model, &random);
    for (int i = 0; i < layout.num_estimated(); ++i) {
      values[layout.model_index(i)] = other[layout.model_index(i)];
    }
    at.eta = layout.Encode(values);
    measurement.dt = dt;
    measurement.rotors = RandomRotors(model.vehicle(), &random);
    if (rates) {
      measurement.rotors.acceleration = random.NextVector(model.vehicle().num_rotors(), 900.0);
      measurement.rotors.speed_squared_rate =
          2.1 * measurement.rotors.speed.cwiseProduct(measurement.rotors.acceleration);
      noise.rotor_rate_rad_s2 = 180.0;
    }
    noise.force_N = {0.11, 0.07, 0.23};
    noise.torque_Nm = {0.002, 0.003, 0.0015};
    noise.rotor_force_N = 0.05;
    noise.rotor_torque_Nm = {0.004, 0.003, 0.001};
    noise.nominal_inertia = model.vehicle().inertia_kg_m2;
    bias = random.NextVector(6, 0.3);
    imu_noise.gyro_rad_s = 0.013;
    imu_noise.preintegration_rad = 4e-4;
  }

  BlockValues With(int states, bool with_bias, bool with_eta) const {
    BlockValues values;
    values.states.assign(at.states.begin(), at.states.begin() + states);
    if (with_bias) values.biases = {bias};
    if (with_eta) values.eta = at.eta;
    return values;
  }

  twin::Parameters<Jet> ParametersOf(const BlockJets& x) const {
    const twin::VX<Jet> values = twin::Decode<Jet>(model, start, x.eta);
    return twin::ParametersFrom<Jet>(model, values);
  }

  Random random;
  DynamicModel model;
  ModelValues start;
  ParameterLayout layout;
  double dt = 0.01;
  BlockValues at;
  DynamicsMeasurement measurement;
  DynamicsNoise noise;
  Eigen::VectorXd bias;
  ImuNoise imu_noise;
};

/// A cost function with its variables and its twin.
struct Case {
  std::shared_ptr<Setting> setting;
  std::unique_ptr<ceres::CostFunction> cost;
  BlockValues at;
  TwinFunction twin_residual;
};

enum class Kind {
  kDynamicsMidpoint,
  kDynamicsMidpointForceOnly,
  kDynamicsMidpointInertiaFixed,
  kDynamicsEuler,
  kDynamicsEulerForceOnly,
  kDynamicsMidpointRotorRates,
  kDynamicsEulerRotorRates,
  kKinematic,
  kKinematicWithoutRotation,
  kKinematicEuler,
  kOdometry,
  kOdometryVelocityOnly,
  kOdometryPoseOnly,
  kGyroPreintegration,
  kGyro,
  kAccelerometer,
  kParameterPrior,
  kBiasPrior,
  kBiasWalk,
  kMarginal,
  kMarginalWithoutBias,
};

const char* NameOf(Kind kind) {
  static const char* names[] = {"DynamicsMidpoint",
                                "DynamicsMidpointForceOnly",
                                "DynamicsMidpointInertiaFixed",
                                "DynamicsEuler",
                                "DynamicsEulerForceOnly",
                                "DynamicsMidpointRotorRates",
                                "DynamicsEulerRotorRates",
                                "Kinematic",
                                "KinematicWithoutRotation",
                                "KinematicEuler",
                                "Odometry",
                                "OdometryVelocityOnly",
                                "OdometryPoseOnly",
                                "GyroPreintegration",
                                "Gyro",
                                "Accelerometer",
                                "ParameterPrior",
                                "BiasPrior",
                                "BiasWalk",
                                "Marginal",
                                "MarginalWithoutBias"};
  return names[static_cast<int>(kind)];
}

Case MakeDynamics(std::shared_ptr<Setting> s, DynamicsForm form, bool with_torque, bool fixed) {
  s->measurement.form = form;
  if (fixed) {
    s->measurement.inertia_fixed = {true, false, true};
    s->measurement.fixed_inertia = {2.2e-3, 1.0, 4.0e-3};
  }
  Case c;
  c.setting = s;
  c.cost = std::make_unique<DynamicsFactor>(s->measurement, s->noise, with_torque, &s->model,
                                            &s->layout);
  c.at = s->With(2, false, true);
  c.twin_residual = [s, with_torque](const BlockJets& x) {
    return twin::WhitenedDynamics<Jet>(s->measurement, s->noise, with_torque, s->model.vehicle(),
                                       x.x[0], x.x[1], s->ParametersOf(x));
  };
  return c;
}

Case MakeKinematic(std::shared_ptr<Setting> s, DynamicsForm form, bool with_rotation) {
  Case c;
  c.setting = s;
  c.cost = std::make_unique<KinematicFactor>(s->dt, form, 5e-4, 7e-4, with_rotation);
  c.at = s->With(2, false, false);
  c.twin_residual = [s, form, with_rotation](const BlockJets& x) {
    return twin::Kinematic<Jet>(s->dt, form, 5e-4, 7e-4, with_rotation, x.x[0], x.x[1]);
  };
  return c;
}

Case MakeOdometry(std::shared_ptr<Setting> s, bool velocity, bool rate) {
  OdometrySample z;
  const State& x = s->at.states[0];
  z.p_WS = x.p_WS + s->random.Next3(0.1);
  z.q_WS = x.q_WS * Exp(s->random.Next3(0.8));
  z.q_WS.coeffs() *= -1.0;  // the same rotation by the other sign
  if (velocity) z.v_WS = x.v_WS + s->random.Next3(0.3);
  if (rate) z.w_WS_S = x.w_WS_S + s->random.Next3(0.3);
  OdometryNoise noise;
  noise.rate_rad_s = 0.02;
  Case c;
  c.setting = s;
  c.cost = std::make_unique<OdometryFactor>(z, noise, true);
  c.at = s->With(1, false, false);
  c.twin_residual = [z, noise](const BlockJets& b) {
    return twin::Odometry<Jet>(z, noise, true, b.x[0]);
  };
  return c;
}

Case MakeGyroPreintegration(std::shared_ptr<Setting> s) {
  ImuInterval z;
  z.dt = s->dt;
  z.has_gyro = true;
  z.delta_q = Exp(s->random.Next3(0.2));
  z.d_bias = -s->dt * Eigen::Matrix3d::Identity() + s->random.NextMatrix(3, 3, 0.1 * s->dt);
  z.bias_lin = s->random.Next3(0.2);
  Case c;
  c.setting = s;
  c.cost = std::make_unique<GyroPreintegrationFactor>(z, s->imu_noise, &s->model, &s->layout);
  c.at = s->With(2, true, true);
  c.twin_residual = [s, z](const BlockJets& x) {
    return twin::GyroPreintegration<Jet>(z, s->imu_noise, x.x[0], x.x[1], x.bias[0],
                                         s->ParametersOf(x));
  };
  return c;
}

Case MakeGyro(std::shared_ptr<Setting> s) {
  const Vector3d z = s->random.Next3(5.0);
  Case c;
  c.setting = s;
  c.cost = std::make_unique<GyroFactor>(z, s->imu_noise, &s->model, &s->layout);
  c.at = s->With(1, true, true);
  c.twin_residual = [s, z](const BlockJets& x) {
    return twin::Gyro<Jet>(z, s->imu_noise, x.x[0], x.bias[0], s->ParametersOf(x));
  };
  return c;
}

Case MakeAccelerometer(std::shared_ptr<Setting> s) {
  const Vector3d z = Vector3d(0.0, 0.0, 9.8) + s->random.Next3(3.0);
  const Vector3d sigma(0.2, 0.3, 0.5);
  Case c;
  c.setting = s;
  c.cost = std::make_unique<AccelerometerFactor>(s->measurement, z, sigma, &s->model, &s->layout);
  c.at = s->With(2, true, true);
  c.twin_residual = [s, z, sigma](const BlockJets& x) {
    return twin::Accelerometer<Jet>(s->measurement, z, sigma, s->model.vehicle(), x.x[0], x.x[1],
                                    x.bias[0], s->ParametersOf(x));
  };
  return c;
}

Case MakePrior(std::shared_ptr<Setting> s, bool parameters) {
  const int n = parameters ? s->layout.num_estimated() : 6;
  const Eigen::VectorXd mean = s->random.NextVector(n),
                        sigma = (s->random.NextVector(n, 0.5).array() + 1.0).matrix();
  Case c;
  c.setting = s;
  c.cost = std::make_unique<BlockPriorFactor>(mean, sigma);
  c.at = s->With(0, !parameters, parameters);
  c.twin_residual = [mean, sigma, parameters](const BlockJets& x) {
    return twin::BlockPrior<Jet>(mean, sigma, parameters ? x.eta : x.bias[0]);
  };
  return c;
}

Case MakeWalk(std::shared_ptr<Setting> s) {
  const Eigen::Matrix<double, 6, 1> sigma =
      (s->random.NextVector(6, 0.5).array() + 1.0).matrix() * 0.01;
  Case c;
  c.setting = s;
  c.cost = std::make_unique<BiasWalkFactor>(sigma);
  c.at.biases = {s->bias, s->random.NextVector(6, 0.3)};
  c.twin_residual = [sigma](const BlockJets& x) {
    return twin::BiasWalk<Jet>(sigma, x.bias[0], x.bias[1]);
  };
  return c;
}

Case MakeMarginal(std::shared_ptr<Setting> s, bool with_bias) {
  auto window = std::make_shared<Window>(&s->layout);
  const Eigen::Matrix<double, 6, 1> bias = s->bias;
  if (with_bias) window->AddBias(bias);
  window->AddKeyframe(0, s->at.states[0], true, with_bias ? 0 : -1);
  Keyframe& keyframe = window->keyframes().front();
  keyframe.in_prior = true;
  Prior& prior = window->prior();
  prior.has_state = true;
  prior.has_bias = with_bias;
  const int n = s->layout.num_estimated();
  prior.A = s->random.NextMatrix(15, 12 + (with_bias ? 6 : 0) + n);
  prior.b = s->random.NextVector(15);
  prior.eta_lin = s->random.NextVector(n);
  Eigen::VectorXd bias_lin = bias;
  if (with_bias) {
    bias_lin += s->random.NextVector(6, 0.1);
    std::copy(bias_lin.data(), bias_lin.data() + 6, window->biases().front().x_lin.begin());
    window->biases().front().in_prior = true;
  }
  Case c;
  c.setting = s;
  c.at = s->With(1, with_bias, true);
  // The state has moved well away from its linearization point.
  State& x = c.at.states[0];
  x.q_WS = x.q_WS * Exp(s->random.Next3(0.4));
  x.p_WS += s->random.Next3();
  x.v_WS += s->random.Next3();
  x.w_WS_S += s->random.Next3();
  const State lin = s->at.states[0];
  c.cost = std::make_unique<MarginalizationFactor>(window.get());
  c.twin_residual = [window, lin, bias_lin](const BlockJets& b) {
    const twin::Motion<double> point{lin.p_WS, lin.q_WS, lin.v_WS, lin.w_WS_S};
    const twin::VX<Jet> bias_jets = b.bias.empty() ? twin::VX<Jet>() : b.bias[0];
    return twin::Marginal<Jet>(window->prior(), point, b.x[0], bias_lin, bias_jets, b.eta);
  };
  return c;
}

Case MakeCase(Kind kind, Freedom freedom, unsigned seed) {
  const bool rates =
      kind == Kind::kDynamicsMidpointRotorRates || kind == Kind::kDynamicsEulerRotorRates;
  const auto s = std::make_shared<Setting>(freedom, seed, rates);
  constexpr auto kM = DynamicsForm::kMidpoint, kE = DynamicsForm::kEuler;
  switch (kind) {
    case Kind::kDynamicsMidpoint:
      return MakeDynamics(s, kM, true, false);
    case Kind::kDynamicsMidpointForceOnly:
      return MakeDynamics(s, kM, false, false);
    case Kind::kDynamicsMidpointInertiaFixed:
      return MakeDynamics(s, kM, true, true);
    case Kind::kDynamicsEuler:
      return MakeDynamics(s, kE, true, false);
    case Kind::kDynamicsEulerForceOnly:
      return MakeDynamics(s, kE, false, false);
    case Kind::kDynamicsMidpointRotorRates:
      return MakeDynamics(s, kM, true, false);
    case Kind::kDynamicsEulerRotorRates:
      return MakeDynamics(s, kE, true, false);
    case Kind::kKinematic:
      return MakeKinematic(s, kM, true);
    case Kind::kKinematicWithoutRotation:
      return MakeKinematic(s, kM, false);
    case Kind::kKinematicEuler:
      return MakeKinematic(s, kE, true);
    case Kind::kOdometry:
      return MakeOdometry(s, true, true);
    case Kind::kOdometryVelocityOnly:
      return MakeOdometry(s, true, false);
    case Kind::kOdometryPoseOnly:
      return MakeOdometry(s, false, false);
    case Kind::kGyroPreintegration:
      return MakeGyroPreintegration(s);
    case Kind::kGyro:
      return MakeGyro(s);
    case Kind::kAccelerometer:
      return MakeAccelerometer(s);
    case Kind::kParameterPrior:
      return MakePrior(s, true);
    case Kind::kBiasPrior:
      return MakePrior(s, false);
    case Kind::kBiasWalk:
      return MakeWalk(s);
    case Kind::kMarginal:
      return MakeMarginal(s, true);
    case Kind::kMarginalWithoutBias:
      return MakeMarginal(s, false);
  }
  return {};
}

constexpr Kind kKinds[] = {Kind::kDynamicsMidpoint,
                           Kind::kDynamicsMidpointForceOnly,
                           Kind::kDynamicsMidpointInertiaFixed,
                           Kind::kDynamicsEuler,
                           Kind::kDynamicsEulerForceOnly,
                           Kind::kDynamicsMidpointRotorRates,
                           Kind::kDynamicsEulerRotorRates,
                           Kind::kKinematic,
                           Kind::kKinematicWithoutRotation,
                           Kind::kKinematicEuler,
                           Kind::kOdometry,
                           Kind::kOdometryVelocityOnly,
                           Kind::kOdometryPoseOnly,
                           Kind::kGyroPreintegration,
                           Kind::kGyro,
                           Kind::kAccelerometer,
                           Kind::kParameterPrior,
                           Kind::kBiasPrior,
                           Kind::kBiasWalk,
                           Kind::kMarginal,
                           Kind::kMarginalWithoutBias};

bool TouchesParameters(Kind kind) {
  return kind <= Kind::kDynamicsEulerRotorRates ||
         (kind >= Kind::kGyroPreintegration && kind <= Kind::kParameterPrior) ||
         kind >= Kind::kMarginal;
}

class FactorJacobians : public testing::TestWithParam<Kind> {
 protected:
  void Check(Freedom freedom) {
    double worst = 0.0;
    for (unsigned i = 0; i < kNumStates; ++i) {
      const Case c = MakeCase(GetParam(), freedom, 100 + i);
      const JacobianDifference d = CompareWithTwin(*c.cost, c.at, c.twin_residual);
      EXPECT_LT(d.residual, kResidualTolerance) << NameOf(GetParam()) << ", state " << i;
      EXPECT_LT(d.jacobian, kJacobianTolerance)
          << NameOf(GetParam()) << ", state " << i << ": " << d.where;
      worst = std::max(worst, d.jacobian);
    }
    std::printf("%-30s largest relative difference %.1e\n", NameOf(GetParam()), worst);
  }
};

TEST_P(FactorJacobians, AgreeWithAutomaticDifferentiationWithEverythingEstimated) {
  Check(Freedom::kAll);
}

TEST_P(FactorJacobians, AgreeWithAutomaticDifferentiationWithSomeParametersFrozen) {
  if (!TouchesParameters(GetParam())) return;  // nothing to freeze
  Check(Freedom::kPartly);
}

TEST_P(FactorJacobians, AgreeWithAutomaticDifferentiationWithoutParameters) {
  if (!TouchesParameters(GetParam()) || GetParam() == Kind::kParameterPrior) {
    return;  // nothing to free
  }
  Check(Freedom::kNone);
}

/// Does to a cost function's Jacobians what a slip of the pen does.
class Corrupted final : public ceres::CostFunction {
 public:
  enum class Slip { kFlip, kZero, kTranspose };

  /// @param block whose rows and columns (ambient) from `row` and `column` on are corrupted
  Corrupted(const ceres::CostFunction* cost, Slip slip, int block, int row, int column, int width)
      : cost_(cost), slip_(slip), block_(block), row_(row), column_(column), width_(width) {
    set_num_residuals(cost->num_residuals());
    *mutable_parameter_block_sizes() = cost->parameter_block_sizes();
  }

  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override {
    if (!cost_->Evaluate(blocks, residual, jacobians)) return false;
    if (jacobians == nullptr || jacobians[block_] == nullptr) return true;
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> J(
        jacobians[block_], num_residuals(), parameter_block_sizes()[block_]);
    auto part = J.block(row_, column_, 3, width_);
    if (slip_ == Slip::kFlip) part *= -1.0;
    if (slip_ == Slip::kZero) part.setZero();
    if (slip_ == Slip::kTranspose) part = part.transpose().eval();
    return true;
  }

 private:
  const ceres::CostFunction* cost_;
  Slip slip_;
  int block_, row_, column_, width_;
};

/// Plants one error into every part of the Jacobian that is not zero and counts those found.
void PlantEverywhere(Kind kind, int* planted, int* missed) {
  const Case c = MakeCase(kind, Freedom::kAll, 7);
  EXPECT_LT(CompareWithTwin(*c.cost, c.at, c.twin_residual).jacobian, kJacobianTolerance)
      << "before anything is planted";
  const BlockJets jets = Seed(c.at);
  const twin::VX<Jet> expected = c.twin_residual(jets);
  const std::vector<int> tangent = TangentSizes(c.at);
  const auto norm = [&expected](int row, int column, int width) {
    double sum = 0.0;
    for (int i = row; i < row + 3; ++i) {
      for (int k = column; k < column + width; ++k) sum += expected[i].v[k] * expected[i].v[k];
    }
    return std::sqrt(sum);
  };
  int first = 0;
  for (size_t block = 0; block < tangent.size(); ++block) {
    const bool is_state = block < c.at.states.size();
    const bool is_eta = block >= c.at.states.size() + c.at.biases.size();
    const int step = is_eta ? 1 : 3;
    for (int row = 0; row + 3 <= c.cost->num_residuals(); row += 3) {
      const double whole = norm(row, first, tangent[block]);
      for (int column = 0; column < tangent[block]; column += step) {
        // Ambient columns of this part; the quaternion has four.
        const bool rotation = is_state && column == 3;
        const int ambient = is_state && column > 3 ? column + 1 : column;
        const int width = rotation ? 4 : step;
        // Parts this far below their block are zeros of the model, not terms.
        if (norm(row, first + column, step) <= 1e-9 * whole) continue;
        for (const auto slip :
             {Corrupted::Slip::kFlip, Corrupted::Slip::kZero, Corrupted::Slip::kTranspose}) {
          if (slip == Corrupted::Slip::kTranspose) {
            // A diagonal block is its own transpose.
            const bool generic = kind == Kind::kDynamicsMidpoint && !rotation && width == 3;
            if (!generic) continue;
          }
          const Corrupted corrupted(c.cost.get(), slip, static_cast<int>(block), row, ambient,
                                    width);
          ++*planted;
          if (!(CompareWithTwin(corrupted, c.at, c.twin_residual).jacobian > 1e-6)) {
            ++*missed;
            ADD_FAILURE() << NameOf(kind) << ": slip " << static_cast<int>(slip) << " in block "
                          << block << ", rows from " << row << ", column " << column
                          << " goes unseen";
          }
        }
      }
    }
    first += tangent[block];
  }
}

TEST_P(FactorJacobians, PlantedErrorIsCaught) {
  int planted = 0, missed = 0;
  PlantEverywhere(GetParam(), &planted, &missed);
  EXPECT_GT(planted, 0);
  EXPECT_EQ(missed, 0);
  std::printf("%-30s %d errors planted, %d missed\n", NameOf(GetParam()), planted, missed);
}

TEST(PlantedError, NewtonMetresAreSeenBesideNewtons) {
  // Only the rows of e_alpha's damping, four decades below the largest entries of the block.
  const Case c = MakeCase(Kind::kDynamicsMidpoint, Freedom::kAll, 3);
  int entry = -1;
  for (int i = 0; i < c.setting->layout.num_estimated(); ++i) {
    const int k = c.setting->layout.model_index(i);
    if (c.setting->model.parameters()[k].full_name == "viscous_torque.b_z") entry = i;
  }
  ASSERT_GE(entry, 0);
  const Corrupted corrupted(c.cost.get(), Corrupted::Slip::kFlip, 2, 3, entry, 1);
  EXPECT_GT(CompareWithTwin(corrupted, c.at, c.twin_residual).jacobian, 0.1);
  EXPECT_LT(CompareWithTwin(*c.cost, c.at, c.twin_residual).jacobian, kJacobianTolerance);
}

TEST(DynamicsFactor, RefusesAnIntervalWithoutLength) {
  Setting s(Freedom::kAll, 1);
  s.measurement.dt = 0.0;
  EXPECT_THROW(DynamicsFactor(s.measurement, s.noise, true, &s.model, &s.layout),
               std::invalid_argument);
}

TEST(DynamicsFactor, RefusesStatesThatAreNotFinite) {
  const Case c = MakeCase(Kind::kDynamicsMidpoint, Freedom::kAll, 1);
  std::array<double, kStateSize> x0, x1;
  c.at.states[0].ToBlock(x0.data());
  c.at.states[1].ToBlock(x1.data());
  x1[8] = std::nan("");
  const double* blocks[] = {x0.data(), x1.data(), c.at.eta.data()};
  Eigen::VectorXd r(c.cost->num_residuals());
  EXPECT_FALSE(c.cost->Evaluate(blocks, r.data(), nullptr));
}

INSTANTIATE_TEST_SUITE_P(All, FactorJacobians, testing::ValuesIn(kKinds),
                         [](const testing::TestParamInfo<Kind>& kind) {
                           return std::string(NameOf(kind.param));
                         });

}  // namespace
}  // namespace test
}  // namespace odmc
