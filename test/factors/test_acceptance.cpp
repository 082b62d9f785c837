// Acceptance tests of model.md section 13 that need a simulated flight.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/factors/state_factors.h"
#include "odmc/preintegration/rotor_interval.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/window/ceres_window_solver.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

constexpr int kStride = 4;  // 400 Hz log, keyframes at 100 Hz

/// A flight of the nominal vehicle on `trajectory`, and what the factors need of it.
struct Flight {
  Flight(const std::string& trajectory, double duration_s, const SimulationNoise& noise)
      : vehicle(NominalVehicle()), model(vehicle, vehicle.effects), truth(DefaultTruth(model)) {
    SimulationOptions options;
    options.trajectory = trajectory;
    options.duration_s = duration_s;
    flight = Simulate(model, truth, options, noise);
  }

  State StateAt(size_t k) const {
    const OdometrySample& z = flight.log.odometry[k];
    return {z.p_WS, z.q_WS, *z.v_WS, *z.w_WS_S};
  }

  DynamicsMeasurement MeasurementFrom(size_t k) const {
    const Stamp from = flight.log.odometry[k].stamp, to = flight.log.odometry[k + kStride].stamp;
    // Only the samples around the interval, for speed.
    const size_t first = k > 1 ? k - 1 : 0;
    const size_t last = std::min(flight.log.rotors.size(), k + kStride + 2);
    Ring<RotorSample> near;
    for (size_t i = first; i < last; ++i) near.push_back(flight.log.rotors[i]);
    const auto interval = ReduceRotors(near, from, to, 0.02);
    DynamicsMeasurement measurement;
    measurement.dt = ToSeconds(to - from);
    measurement.time_s = ToSeconds(from) + 0.5 * measurement.dt;
    if (interval) measurement.rotors = interval->mean;
    return measurement;
  }

  size_t size() const { return flight.log.odometry.size(); }

  Vehicle vehicle;
  DynamicModel model;
  ModelValues truth;
  SimulatedFlight flight;
};

SimulationNoise ExactRecording() {
  SimulationNoise noise = SimulationNoise::None();
  noise.feedback_rate_rad_s = 0.01;  // the pilot's own, as in model.md section 8
  return noise;
}

// model.md section 13, test 5, first half.
TEST(FormM, ResidualOfExactStatesIsBelowAMillinewton) {
  for (const char* trajectory : {"octo", "aggressive"}) {
    const Flight flight(trajectory, 20.0, ExactRecording());
    double force = 0.0, torque = 0.0;
    int count = 0;
    const Vector3d inertia(2.5e-3, 2.1e-3, 4.3e-3);
    for (size_t k = 0; k + kStride < flight.size(); k += kStride, ++count) {
      const DynamicsMeasurement z = flight.MeasurementFrom(k);
      const auto e = DynamicsResidual(z, flight.StateAt(k), flight.StateAt(k + kStride),
                                      flight.model, flight.truth);
      force += e.segment<3>(kRowVelocity).squaredNorm() / (z.dt * z.dt);
      torque += inertia.cwiseProduct(e.segment<3>(kRowAngular)).squaredNorm() / (z.dt * z.dt);
    }
    const double force_rms = std::sqrt(force / (3.0 * count));
    const double torque_rms = std::sqrt(torque / (3.0 * count));
    std::printf("%-10s residual %.3f mN, %.5f mN m\n", trajectory, 1e3 * force_rms,
                1e3 * torque_rms);
    EXPECT_LT(force_rms, 1e-3) << trajectory;
    EXPECT_LT(torque_rms, 1e-5) << trajectory;
  }
}

/// Gauss-Newton on the parameters alone, states fixed at the recorded ones.
ModelValues FitParameters(const Flight& flight, const ModelValues& start) {
  const ParameterLayout layout(flight.model, start);
  DynamicsNoise noise;
  noise.nominal_inertia = flight.vehicle.inertia_kg_m2;
  std::vector<std::unique_ptr<DynamicsFactor>> factors;
  for (size_t k = 0; k + kStride < flight.size(); k += kStride) {
    factors.push_back(std::make_unique<DynamicsFactor>(flight.MeasurementFrom(k), noise, true,
                                                       &flight.model, &layout));
  }
  const int n = layout.num_estimated();
  Eigen::VectorXd eta = layout.Encode(start);
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  for (int iteration = 0; iteration < 12; ++iteration) {
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd g = Eigen::VectorXd::Zero(n);
    size_t k = 0;
    for (const auto& factor : factors) {
      std::array<double, kStateSize> x0, x1;
      flight.StateAt(k).ToBlock(x0.data());
      flight.StateAt(k + kStride).ToBlock(x1.data());
      k += kStride;
      const double* blocks[] = {x0.data(), x1.data(), eta.data()};
      Eigen::Matrix<double, 6, 1> r;
      RowMajor J(6, n);
      double* jacobians[] = {nullptr, nullptr, J.data()};
      if (!factor->Evaluate(blocks, r.data(), jacobians)) return start;
      H.noalias() += J.transpose() * J;
      g.noalias() += J.transpose() * r;
    }
    const Eigen::VectorXd step = H.ldlt().solve(-g);
    eta += step * std::min(1.0, 0.5 / step.tail(n).cwiseAbs().maxCoeff());
    if (step.norm() < 1e-12) break;
  }
  return layout.Decode(eta.data());
}

// model.md section 13, test 5, second half.
TEST(FormM, LeastSquaresOnExactStatesGivesBackTheTruth) {
  const Flight flight("octo", 30.0, ExactRecording());
  ModelValues start = flight.truth;
  for (int k = 0; k < start.size(); ++k) {
    if (flight.model.parameters()[k].estimated) start[k] *= k % 2 == 0 ? 1.3 : 0.7;
  }
  const ModelValues fit = FitParameters(flight, start);
  for (int k = 0; k < fit.size(); ++k) {
    const ModelParameter& p = flight.model.parameters()[k];
    const double error = fit[k] - flight.truth[k];
    std::printf("%-22s %+.4e of %+.4e\n", p.full_name.c_str(), error, flight.truth[k]);
    if (p.effect == "gravity") {
      EXPECT_LT(std::abs(error), 1e-5) << p.full_name;
    } else if (p.full_name == "centre_of_gravity.z") {
      EXPECT_LT(std::abs(error), 0.2e-3) << p.full_name;
    } else {
      EXPECT_LT(std::abs(error / flight.truth[k]), 2e-3) << p.full_name;
    }
  }
}

// model.md section 13, test 7. In units of dt² and dt, where the numbers are exact.
TEST(FormE, CovarianceIsPositiveDefiniteAndThePapersIsNot) {
  for (const double dt : {0.0025, 0.01, 0.05}) {
    const Eigen::Matrix2d P = EulerTranslationCovariance(dt);
    const Eigen::Vector2d units(1.0 / (dt * dt), 1.0 / dt);
    Eigen::Matrix2d scaled = units.asDiagonal() * P * units.asDiagonal();
    EXPECT_EQ(Eigen::LLT<Eigen::Matrix2d>(P).info(), Eigen::Success);
    EXPECT_NEAR(scaled.determinant(), 1.0 / 12.0, 1e-12);
    // Schur complement dt^4/12: what is left of the position given the velocity.
    EXPECT_NEAR(P(0, 0) - P(0, 1) * P(0, 1) / P(1, 1), std::pow(dt, 4) / 12.0, 1e-20);
  }
  Eigen::Matrix2d printed;
  printed << 0.25, 0.5, 0.5, 1.0;
  EXPECT_NE(Eigen::LLT<Eigen::Matrix2d>(printed).info(), Eigen::Success);
  Eigen::Matrix<double, 6, 6> joint;
  const Vector3d P_T(0.04, 0.0225, 0.16);
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) {
      joint.block<3, 3>(3 * i, 3 * j) = printed(i, j) * Eigen::Matrix3d(P_T.asDiagonal());
    }
  }
  EXPECT_NE((Eigen::LLT<Eigen::Matrix<double, 6, 6>>(joint).info()), Eigen::Success);
}

/// Whole flight in one window, states and parameters estimated jointly.
struct Batch {
  ModelValues values;
  bool usable = false;
};

/// DynamicsFactor with its rotational rows back in newton-metres over the nominal inertia, the
/// paper's weighting: e_omega / I_0 instead of e_alpha.
class TorqueUnitFactor final : public ceres::CostFunction {
 public:
  TorqueUnitFactor(std::unique_ptr<DynamicsFactor> factor, const DynamicModel& model,
                   const ParameterLayout& layout)
      : factor_(std::move(factor)), layout_(&layout) {
    set_num_residuals(6);
    *mutable_parameter_block_sizes() = factor_->parameter_block_sizes();
    for (int i = 0; i < layout.num_estimated(); ++i) {
      for (int axis = 0; axis < 3; ++axis) {
        const int k = model.IndexOf(std::string("inertia.") + "xyz"[axis]);
        if (layout.model_index(i) == k) entry_[axis] = i;
        model_index_[axis] = k;
      }
    }
  }

  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override {
    if (!factor_->Evaluate(blocks, residual, jacobians)) return false;
    const ModelValues values = layout_->Decode(blocks[2]);
    for (int axis = 0; axis < 3; ++axis) {
      const double ratio = values[model_index_[axis]] / factor_->noise().nominal_inertia[axis];
      residual[3 + axis] *= ratio;
      if (jacobians == nullptr) continue;
      const auto& sizes = parameter_block_sizes();
      for (size_t b = 0; b < sizes.size(); ++b) {
        if (jacobians[b] == nullptr) continue;
        for (int k = 0; k < sizes[b]; ++k) jacobians[b][(3 + axis) * sizes[b] + k] *= ratio;
      }
      // d(ratio)/d(eta) = ratio for a logarithmic parameter.
      if (jacobians[2] != nullptr) {
        jacobians[2][(3 + axis) * sizes[2] + entry_[axis]] += residual[3 + axis];
      }
    }
    return true;
  }

 private:
  std::unique_ptr<DynamicsFactor> factor_;
  const ParameterLayout* layout_;
  std::array<int, 3> entry_{}, model_index_{};
};

Batch SolveBatch(const Flight& flight, double torque_scale, bool torque_units) {
  const SimulationNoise recorded;  // defaults: model.md section 9
  const ParameterLayout layout(flight.model, flight.truth);
  Window window(&layout);
  window.eta() = layout.Encode(flight.truth);
  OdometryNoise odometry_noise;
  odometry_noise.rate_rad_s = recorded.rate_rad_s;
  const auto add = [&window](FactorKind kind, std::unique_ptr<ceres::CostFunction> cost,
                             std::int64_t s0, std::int64_t s1, bool parameters) {
    Factor factor;
    factor.kind = kind;
    factor.cost = std::move(cost);
    factor.state0 = s0;
    factor.state1 = s1;
    factor.parameters = parameters;
    window.AddFactor(std::move(factor));
  };
  for (size_t k = 0; k < flight.size(); k += kStride) {
    const std::int64_t id =
        window.AddKeyframe(flight.flight.log.odometry[k].stamp, flight.StateAt(k), k > 0, -1);
    add(FactorKind::kOdometry,
        std::make_unique<OdometryFactor>(flight.flight.log.odometry[k], odometry_noise, true), id,
        -1, false);
    if (k == 0) continue;
    const DynamicsMeasurement z = flight.MeasurementFrom(k - kStride);
    add(FactorKind::kKinematic,
        std::make_unique<KinematicFactor>(z.dt, DynamicsForm::kMidpoint, 5e-4, 5e-4, true), id - 1,
        id, false);
    DynamicsNoise noise;
    noise.force_N = Vector3d::Constant(recorded.force_N);
    noise.torque_Nm = Vector3d::Constant(torque_scale * recorded.torque_Nm);
    noise.nominal_inertia = flight.vehicle.inertia_kg_m2;
    // Rotor-speed noise of the mean over four samples, through thrust and arm.
    const double per_rotor =
        2.0 * 1.5e-6 * z.rotors.speed.mean() * recorded.rotor_speed_rad_s / 2.0;
    noise.rotor_force_N = 2.0 * per_rotor;
    noise.rotor_torque_Nm = per_rotor * Vector3d(2.0 * 0.11, 2.0 * 0.095, 2.0 * 0.014);
    if (torque_units) noise.rotor_torque_Nm.setZero();
    auto dynamics = std::make_unique<DynamicsFactor>(z, noise, true, &flight.model, &layout);
    std::unique_ptr<ceres::CostFunction> cost;
    if (torque_units) {
      cost = std::make_unique<TorqueUnitFactor>(std::move(dynamics), flight.model, layout);
    } else {
      cost = std::move(dynamics);
    }
    add(torque_units ? FactorKind::kOther : FactorKind::kDynamics, std::move(cost), id - 1, id,
        true);
  }
  SolverOptions options;
  options.max_iterations = 12;
  options.max_time_s = 30.0;
  options.function_tolerance = 1e-7;
  CeresWindowSolver solver;
  Batch batch;
  batch.usable = solver.Solve(&window, options).usable;
  batch.values = window.values();
  return batch;
}

// model.md section 13, test 10: the artefact of section 9 is absent from e_alpha, present in
// e_omega.
TEST(NormalisedResidual, InertiaStaysWhenTheTorqueCovarianceGrowsTenfold) {
  const Flight flight("aggressive", 12.0, SimulationNoise());
  const Batch once = SolveBatch(flight, 1.0, false);
  const Batch tenfold = SolveBatch(flight, std::sqrt(10.0), false);
  ASSERT_TRUE(once.usable && tenfold.usable);
  const Batch paper = SolveBatch(flight, std::sqrt(10.0), true);
  ASSERT_TRUE(paper.usable);
  for (int axis = 0; axis < 2; ++axis) {
    const int k = flight.model.IndexOf(std::string("inertia.") + "xyz"[axis]);
    const double error = once.values[k] / flight.truth[k] - 1.0;
    const double shift = tenfold.values[k] / once.values[k] - 1.0;
    const double paper_error = paper.values[k] / flight.truth[k] - 1.0;
    std::printf(
        "inertia.%c: error %+.2f %%, moves by %+.2f %%; in torque units it is off by %+.1f %%\n",
        "xyz"[axis], 100.0 * error, 100.0 * shift, 100.0 * paper_error);
    EXPECT_LT(std::abs(error), 0.06);
    EXPECT_LT(std::abs(shift), 0.03);
    EXPECT_LT(paper_error, -0.05);
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
