// Samples that stream in leave the heap alone once every buffer has found its size.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "odmc/estimator/change_detector.h"
#include "odmc/estimator/consistency.h"
#include "odmc/estimator/gates.h"
#include "odmc/estimator/load_observer.h"
#include "odmc/estimator/noise_estimation.h"
#include "odmc/estimator/phase_watch.h"
#include "odmc/factors/parameter_layout.h"
#include "odmc/math/so3.h"
#include "odmc/preintegration/imu_interval.h"
#include "odmc/preintegration/rotor_interval.h"
#include "odmc/preintegration/rotor_rate_smoother.h"
#include "odmc/sensing/synchroniser.h"
#include "support/allocation_counter.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

// ---- The counter -------------------------------------------------------------------------------

/// Keeps the compiler from leaving out what nobody looks at.
template <typename T>
void LookAt(const T& value) {
  asm volatile("" : : "g"(&value) : "memory");
}

/// Allocations of `work`, which runs in this thread.
template <typename Work>
long AllocationsOf(const Work& work) {
  const AllocationCounter counter;
  work();
  return counter.count();
}

TEST(AllocationCounter, SeesEveryWayToTheHeap) {
  EXPECT_EQ(AllocationsOf([] { LookAt(*std::make_unique<int>(1)); }), 1);
  EXPECT_EQ(AllocationsOf([] { LookAt(std::vector<int>(10)); }), 1);
  EXPECT_EQ(AllocationsOf([] { LookAt(std::string(100, 'x')); }), 1);
  EXPECT_EQ(AllocationsOf([] { LookAt(Eigen::VectorXd(Eigen::VectorXd::Zero(10))); }), 1);
  struct alignas(64) Aligned {
    double x[8];
  };
  EXPECT_EQ(AllocationsOf([] { LookAt(std::vector<Aligned>(3)); }), 1);
  EXPECT_EQ(AllocationsOf([] {
              void* p = std::malloc(10);
              LookAt(p);
              p = std::realloc(p, 10000);
              LookAt(p);
              std::free(p);
              p = std::calloc(10, 10);
              LookAt(p);
              std::free(p);
              p = std::aligned_alloc(64, 128);
              LookAt(p);
              std::free(p);
            }),
            4);
}

TEST(AllocationCounter, LeavesOutTheStackOtherThreadsAndWhatWasBefore) {
  LookAt(std::vector<int>(10));
  EXPECT_EQ(AllocationsOf([] { LookAt(Vector3d(Vector3d::Zero())); }), 0);
  EXPECT_EQ(AllocationsOf([] { LookAt(std::string("short")); }), 0);
  EXPECT_EQ(AllocationsOf([] { LookAt(RotorVector(RotorVector::Zero(8))); }), 0);
  AllocationCounter counter;
  long of_thread = 0;
  std::thread thread([&] { of_thread = AllocationsOf([] { LookAt(std::vector<int>(10)); }); });
  const long after_start = counter.count();
  thread.join();
  EXPECT_EQ(of_thread, 1);
  EXPECT_EQ(counter.count(), after_start);
}

// ---- The streams -------------------------------------------------------------------------------

constexpr Stamp kTick = 500'000;  // 0.5 ms
constexpr int kOdometryTicks = 5, kRotorTicks = 5, kImuTicks = 4;

Vehicle VehicleWithLoad() {
  Vehicle vehicle = NominalVehicle();
  vehicle.effects.push_back("suspended_load");
  return vehicle;
}

/// Samples at 400 Hz (odometry, rotors) and 500 Hz (IMU), keyframes at 100 Hz, and everything
/// that sees them before an interval is turned into factors or after one has left the window.
class Pipeline {
 public:
  void Fly(double duration_s) {
    for (const long end = tick_ + FromSeconds(duration_s) / kTick; tick_ < end; ++tick_) {
      AddSamples();
      while (const auto keyframe = synchroniser_.NextKeyframe()) Take(*keyframe);
    }
  }

  long intervals() const { return intervals_; }
  long smoothed() const { return smoothed_; }
  long steps() const { return steps_; }
  long blocks() const { return blocks_; }
  double speed_noise() const { return rotor_noise_.Sigma(); }
  OdometryNoise odometry_noise() const { return odometry_noise_.Noise(); }

 private:
  double Noise(double sigma) { return sigma * gaussian_(engine_); }
  Vector3d Noise3(double sigma) { return {Noise(sigma), Noise(sigma), Noise(sigma)}; }

  void AddSamples() {
    const Stamp stamp = FromSeconds(100.0) + tick_ * kTick;
    const double t = ToSeconds(stamp);
    const Vector3d rate(std::sin(3.0 * t), 0.5 * std::cos(2.0 * t), 0.8);
    if (tick_ % kImuTicks == 0) {
      ImuSample imu;
      imu.stamp = stamp;
      imu.gyro_I = rate + Noise3(0.01);
      imu.specific_force_I = Vector3d(0.0, 0.0, 9.81) + Noise3(0.1);
      synchroniser_.Add(imu);
    }
    if (tick_ % kRotorTicks == 0) {
      RotorSample rotors;
      rotors.stamp = stamp;
      rotors.speed = RotorVector::Constant(4, 1100.0 + 50.0 * std::sin(5.0 * t) + Noise(3.0));
      synchroniser_.Add(rotors);
      rotor_noise_.Add(t, rotors.speed);
    }
    if (tick_ % kOdometryTicks == 0) {
      q_WS_ = q_WS_ * Exp(rate * ToSeconds(kOdometryTicks * kTick));
      OdometrySample odometry;
      odometry.stamp = stamp;
      odometry.p_WS = Vector3d(std::sin(t), std::cos(t), 1.0) + Noise3(0.002);
      odometry.q_WS = q_WS_ * Exp(Noise3(0.001));
      odometry.v_WS = Vector3d(std::cos(t), -std::sin(t), 0.0) + Noise3(0.01);
      odometry.w_WS_S = rate + Noise3(0.02);
      synchroniser_.Add(odometry);
      odometry_noise_.Add(odometry);
    }
    synchroniser_.Add(BatterySample{stamp, 16.0});
  }

  void Take(const OdometrySample& keyframe) {
    if (last_) Reduce(*last_, keyframe);
    last_ = keyframe;
    synchroniser_.Trim(keyframe.stamp);
  }

  void Reduce(const OdometrySample& from, const OdometrySample& to) {
    const auto rotors = ReduceRotors(synchroniser_.rotors(), from.stamp, to.stamp, 0.05);
    const auto imu =
        PreintegrateImu(synchroniser_.imu(), from.stamp, to.stamp, Vector3d::Zero(), 0.05);
    if (!rotors || !imu) return;
    phases_.Update(to, rotors, odometry_noise_.Noise(), intervals_ == 0);
    ++intervals_;
    const double dt = imu->dt;
    smoother_.Add(intervals_, ToSeconds(to.stamp - FromSeconds(100.0)), dt, rotors->mean,
                  rotors->num_samples);
    smoother_.ForChanged([this](std::int64_t, const RotorRateSmoother::Rates&) { ++smoothed_; });
    inertia_gate_.Add(dt, *from.w_WS_S, *to.w_WS_S,
                      RotorTorqueDirection(vehicle_, rotors->mean.speed_squared),
                      rotors->mean.speed_squared.sum());
    load_.Advance(MotionOf(from), MotionOf(to), dt, model_.InitialValues());
    LookAt(odometry_noise_.Noise());
    LookAt(rotor_noise_.Sigma());
    AddResidual(dt);
  }

  static SensorMotion MotionOf(const OdometrySample& sample) {
    return {*sample.v_WS, sample.q_WS.toRotationMatrix(), *sample.w_WS_S};
  }

  void AddResidual(double dt) {
    IntervalResidual residual;
    residual.dt = dt;
    const bool calm = intervals_ / 500 % 2 == 0;  // so that the sizes in use change now and then
    residual.force_N = Noise3(calm ? 0.5 : 5.0);
    residual.torque_Nm = Noise3(calm ? 0.01 : 0.1);
    process_noise_.Add(residual, true);
    if (process_noise_.Step()) {
      ++steps_;
      consistency_.Rescale(root_);
    }
    LookAt(process_noise_.ForceSigma(dt));
    LookAt(process_noise_.TorqueSigma(dt));
    change_detector_.Add(dt, residual.force_N, residual.torque_Nm);
    consistency_.Add(dt, score_, eta_);
    if (!consistency_.BlockIsFull()) return;
    consistency_.CloseBlock(root_);
    LookAt(consistency_.Inflation(eta_, root_, prior_sigma_)[0]);
    ++blocks_;
  }

  std::mt19937 engine_{7};
  std::normal_distribution<double> gaussian_;
  long tick_ = 0, intervals_ = 0, smoothed_ = 0, steps_ = 0, blocks_ = 0;
  Eigen::Quaterniond q_WS_ = Eigen::Quaterniond::Identity();
  std::optional<OdometrySample> last_;
  Vehicle vehicle_ = VehicleWithLoad();
  DynamicModel model_{vehicle_, vehicle_.effects};
  Synchroniser synchroniser_{100.0, 0.3};
  RotorRateSmoother smoother_;
  OdometryNoiseEstimator odometry_noise_{OdometryNoise{0.0, 0.0, 0.0, 0.0}};
  DifferenceNoise rotor_noise_;
  ProcessNoiseEstimator process_noise_{7.36, 0.145, 1.0};
  ChangeDetector change_detector_{7.36, vehicle_.inertia_kg_m2};
  PhaseWatch phases_{&model_, PhaseOptions(), false};
  InertiaGate inertia_gate_;
  LoadObserver load_{model_, true};
  Eigen::VectorXd score_ = Eigen::VectorXd::Ones(12);
  ParameterVector eta_ = ParameterVector::Ones(12);
  Eigen::VectorXd prior_sigma_ = Eigen::VectorXd::Ones(12);
  Eigen::MatrixXd root_ = 0.99 * Eigen::MatrixXd::Identity(12, 12);
  Consistency consistency_{12};
};

TEST(Streams, TakeNothingFromTheHeapOnceWarm) {
  Pipeline pipeline;
  pipeline.Fly(1.5);
  const long before = pipeline.intervals();
  EXPECT_EQ(AllocationsOf([&] { pipeline.Fly(5.0); }), 0);
  // All of it ran.
  EXPECT_EQ(pipeline.intervals() - before, 500);
  EXPECT_GT(pipeline.smoothed(), 5000);
  EXPECT_GT(pipeline.steps(), 1);
  EXPECT_GT(pipeline.blocks(), 20);
  EXPECT_NEAR(pipeline.odometry_noise().position_m, 0.002, 0.0005);
  EXPECT_NEAR(pipeline.odometry_noise().attitude_rad, 0.001, 0.00025);
  EXPECT_NEAR(pipeline.speed_noise(), 3.0, 0.75);
}

}  // namespace
}  // namespace test
}  // namespace odmc
