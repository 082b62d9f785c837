// Rotors by blade elements and momentum: the inner solve, the integrals over the blade, the signs.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <limits>

#include "odmc/effects/blade_inflow.h"
#include "odmc/effects/effects.h"
#include "odmc/model/dynamic_model.h"
#include "support/jacobian_check.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

constexpr double kRho = 1.225, kRadius = 0.0635, kOmega = 1100.0, kK_f = 1.5e-6;
constexpr double kTip = kOmega * kRadius;

// ---- The inner solve ---------------------------------------------------------------------------

BladeFlow<double> Flow(double in_plane, double axial) {
  // A rotor that hovers at 7.6 m/s, near the one below.
  return {in_plane * in_plane, axial, kTip, 0.7, 0.42, 0.52};
}

double Excess(const BladeFlow<double>& flow, double v) {
  return 2.0 * v * std::sqrt(DiscSpeedSquared(flow, v)) - BladeThrust(flow, v);
}

TEST(InducedVelocity, IsFoundInAMillionRandomFlows) {
  Random random(1);
  int most = 0;
  double worst = 0.0, sum = 0.0;
  constexpr int kFlows = 1000000;
  for (int i = 0; i < kFlows; ++i) {
    const double in_plane = 40.0 * std::pow(10.0, 3.0 * std::min(0.0, random.Next() - 0.2));
    const double tip = i % 10 == 0 ? 0.0 : 1e3 * std::pow(10.0, -3.0 * std::abs(random.Next()));
    const BladeFlow<double> flow{in_plane * in_plane,
                                 random.Next(i % 3 == 0 ? 0.1 : 40.0),
                                 tip,
                                 0.05 * std::pow(10.0, 2.0 * std::abs(random.Next())),
                                 random.Next(1.0),
                                 random.Next(1.5)};
    int steps = 0;
    const double v = InducedVelocity(flow, &steps);
    ASSERT_TRUE(std::isfinite(v));
    // A root in v, not only a small excess: the excess over its slope is v's own rounding.
    const double error = std::abs(Excess(flow, v)) / InflowSlope(flow, v);
    ASSERT_GT(InflowSlope(flow, v), 0.0);
    worst = std::max(worst, error / (1e-3 + std::abs(v)));
    most = std::max(most, steps);
    sum += steps;
  }
  EXPECT_LT(worst, 1e-9);
  EXPECT_LE(most, 60);
  EXPECT_LT(sum / kFlows, 10.0);
}

TEST(InducedVelocity, HasOneSolutionOnly) {
  // What the blades' thrust is less than is a rising function of v: of the momentum's thrust alone.
  for (double in_plane = 0.0; in_plane < 12.0; in_plane += 0.5) {
    for (double axial = -20.0; axial < 20.0; axial += 0.5) {
      const BladeFlow<double> flow = Flow(in_plane, axial);
      double last = -std::numeric_limits<double>::infinity();
      for (double v = -30.0; v < 30.0; v += 0.05) {
        const double thrust = 2.0 * v * std::sqrt(DiscSpeedSquared(flow, v));
        ASSERT_GE(thrust, last - 1e-9) << in_plane << " " << axial << " " << v;
        last = thrust;
      }
    }
  }
}

TEST(InducedVelocity, IsGlauertsInClimbAndInFastFlight) {
  for (const auto& [in_plane, axial] :
       {std::pair{0.0, 0.0}, {0.0, 6.0}, {5.0, 2.0}, {15.0, 0.0}, {12.0, 5.0}}) {
    const BladeFlow<double> flow = Flow(in_plane, axial);
    const double v = InducedVelocity(flow);
    const double glauert = 2.0 * v * std::hypot(in_plane, axial + v);
    EXPECT_NEAR(glauert, BladeThrust(flow, v), 1e-5 * glauert) << in_plane << " " << axial;
  }
  // In fast descent, too: a glide at 15 m/s.
  const BladeFlow<double> glide = Flow(15.0, -3.0);
  const double v = InducedVelocity(glide);
  EXPECT_NEAR(2.0 * v * std::hypot(15.0, v - 3.0), BladeThrust(glide, v),
              0.01 * BladeThrust(glide, v));
}

/// Induced velocity over that of hover at the same thrust, for an axial speed over the same.
double Measured(double x) {
  return 1.0 - 1.125 * x - 1.372 * x * x - 1.718 * x * x * x - 0.655 * x * x * x * x;
}

TEST(InducedVelocity, FollowsTheMeasuredCurveInTheVortexRingState) {
  // Leishman 2006, eq. 2.96, a fit to measurements that scatter by some 0.2.
  double sum = 0.0;
  int n = 0;
  for (double axial = -2.0; axial > -13.0; axial -= 0.5) {
    const BladeFlow<double> flow = Flow(0.0, axial);
    const double v = InducedVelocity(flow);
    const double hover = std::sqrt(0.5 * BladeThrust(flow, v));
    const double x = axial / hover;
    if (x < -1.9) break;
    const double miss = v / hover - Measured(x);
    EXPECT_LT(std::abs(miss), 0.25) << x;
    sum += miss * miss;
    ++n;
  }
  ASSERT_GT(n, 10);
  EXPECT_LT(std::sqrt(sum / n), 0.15);
  // The windmill beyond.
  constexpr double kDescent = 32.0;
  const BladeFlow<double> windmill = Flow(0.0, -kDescent);
  const double v = InducedVelocity(windmill);
  const double hover = std::sqrt(0.5 * BladeThrust(windmill, v));
  const double half = 0.5 * kDescent / hover;
  ASSERT_GT(half, 1.0);
  EXPECT_NEAR(v / hover, half - std::sqrt(half * half - 1.0), 1e-4);
}

TEST(InducedVelocity, MovesWithoutAJump) {
  for (const double in_plane : {0.0, 0.5, 2.0, 6.0}) {
    double last = InducedVelocity(Flow(in_plane, -30.0));
    for (double axial = -30.0; axial < 30.0; axial += 1e-3) {
      const double v = InducedVelocity(Flow(in_plane, axial));
      ASSERT_LT(std::abs(v - last), 0.02) << in_plane << " " << axial;
      last = v;
    }
  }
}

TEST(InducedVelocity, OfARotorThatPushesDownIsTheSameUpsideDown) {
  BladeFlow<double> flow = Flow(3.0, -4.0);
  BladeFlow<double> mirrored = flow;
  mirrored.axial = 4.0;
  mirrored.pitch *= -1.0;
  mirrored.pitch_at_half *= -1.0;
  EXPECT_NEAR(InducedVelocity(flow), -InducedVelocity(mirrored), 1e-12);
}

// ---- One rotor ---------------------------------------------------------------------------------

Vehicle OneRotor(double spin) {
  Vehicle vehicle = NominalVehicle();
  vehicle.rotors = {{Vector3d::Zero(), spin, kRadius}};
  return vehicle;
}

/// lift, twist, profile drag, flapping, lag, wake, k_f.
using Values = Eigen::Matrix<double, 7, 1>;
Values Typical() { return (Values() << 0.8, -0.35, 0.006, 0.0, 0.0, 1.0, kK_f).finished(); }

struct Result {
  Vector3d force, torque;
};

Result AtRotor(const Vector3d& air, const Values& values, double spin = 1.0) {
  const auto effect = MakeBladeElement(OneRotor(spin));
  FlightState state;
  state.v_AB_B = air;
  state.rotors = RotorState::Steady(RotorVector::Constant(1, kOmega));
  Wrench wrench;
  effect->AddWrench(state, values, &wrench);
  return {wrench.f_B, wrench.tau_Bo_B};
}

/// The blades, element by element around the turn, at an induced velocity of `mean`: forces and
/// moments on the hub of a rotor that turns clockwise seen from above and flies along x.
struct Blade {
  double lift, twist, drag, pitch, wake;
  bool small_angles = true;

  Result Integrate(const Vector3d& air, double mean) const {
    constexpr int kRadii = 400, kTurns = 180;
    const double mu = air.x() / kTip, inflow = (air.z() + mean) / kTip;
    // Skew of the wake from the axis, and Pitt and Peters' gradient of the inflow.
    const double skew = std::tan(0.5 * std::atan2(mu, std::abs(inflow)));
    const double gradient = wake * 15.0 * M_PI / 32.0 * skew * mean / kTip;
    Result sum{Vector3d::Zero(), Vector3d::Zero()};
    for (int i = 0; i < kRadii; ++i) {
      const double r = (i + 0.5) / kRadii;
      for (int k = 0; k < kTurns; ++k) {
        // Seen from above the blade is at the tail at 0 and, clockwise, to the left at 90 degrees.
        const double psi = 2.0 * M_PI * (k + 0.5) / kTurns;
        const Vector3d along(-std::cos(psi), std::sin(psi), 0.0);  // from hub to tip
        const Vector3d moving(std::sin(psi), std::cos(psi), 0.0);  // where the blade goes
        const double u_t = r + mu * std::sin(psi);
        const double u_p = inflow + gradient * r * std::cos(psi);
        const double theta = pitch + twist * (r - 0.75);
        double normal, chordwise;
        if (small_angles) {
          normal = lift * (theta * u_t * u_t - u_t * u_p);
          chordwise = lift * (theta * u_t * u_p - u_p * u_p) + drag * u_t * u_t;
        } else {
          const double phi = std::atan2(u_p, u_t), square = u_t * u_t + u_p * u_p;
          const double l = square * lift * (theta - phi), d = square * drag;
          normal = l * std::cos(phi) - d * std::sin(phi);
          chordwise = l * std::sin(phi) + d * std::cos(phi);
        }
        const double element =
            0.5 * kRho * M_PI * std::pow(kRadius, 2) * kTip * kTip / kRadii / kTurns;
        const Vector3d f = element * (normal * Vector3d::UnitZ() - chordwise * moving);
        sum.force += f;
        sum.torque += (r * kRadius * along).cross(f);
      }
    }
    return sum;
  }
};

Blade BladeOf(const Values& values) {
  const double coefficient = kK_f / (kRho * M_PI * std::pow(kRadius, 4));
  const double pitch = 3.0 * (2.0 * coefficient / values[0] + 0.5 * std::sqrt(0.5 * coefficient));
  return {values[0], values[1], values[2], pitch, values[5], true};
}

double InducedAt(const Values& values, const Vector3d& air) {
  const Blade blade = BladeOf(values);
  return InducedVelocity({air.head<2>().squaredNorm(), air.z(), kTip, values[0], blade.pitch,
                          blade.pitch - 0.25 * values[1]});
}

TEST(BladeElement, IsTheIntegralOverABlade) {
  const Values values = Typical();
  const Blade blade = BladeOf(values);
  const Result still = blade.Integrate(Vector3d::Zero(), InducedAt(values, Vector3d::Zero()));
  EXPECT_NEAR(still.force.z(), kK_f * kOmega * kOmega, 1e-4 * still.force.z());
  for (const Vector3d& air : {Vector3d(6, 0, 0), Vector3d(14, 0, 4), Vector3d(10, 0, -6),
                              Vector3d(0, 0, 5), Vector3d(3, 0, -3), Vector3d(18, 0, 0)}) {
    const Result blades = blade.Integrate(air, InducedAt(values, air));
    const Result effect = AtRotor(air, values);
    const double thrust = still.force.z();
    EXPECT_NEAR(effect.force.z(), (blades.force - still.force).z(), 2e-4 * thrust)
        << air.transpose();
    EXPECT_NEAR(effect.force.x(), blades.force.x(), 2e-4 * thrust) << air.transpose();
    // The effect smooths |w| in the skew over 0.5 m/s.
    const double moment = thrust * kRadius;
    EXPECT_NEAR(effect.torque.x(), blades.torque.x(), 2e-4 * moment) << air.transpose();
    EXPECT_NEAR(effect.torque.y(), blades.torque.y(), 2e-3 * moment) << air.transpose();
    EXPECT_NEAR(effect.torque.z(), (blades.torque - still.torque).z(), 1e-3 * moment)
        << air.transpose();
  }
}

// Angles are not small at the root of a propeller: within a tenth of the static thrust all the
// same.
TEST(BladeElement, IsNearTheIntegralWithAnglesAsTheyAre) {
  const Values values = Typical();
  Blade blade = BladeOf(values);
  blade.small_angles = false;
  const Result still = blade.Integrate(Vector3d::Zero(), InducedAt(values, Vector3d::Zero()));
  for (const Vector3d& air : {Vector3d(6, 0, 0), Vector3d(14, 0, 4), Vector3d(10, 0, -6)}) {
    const Result blades = blade.Integrate(air, InducedAt(values, air));
    const Result effect = AtRotor(air, values);
    const double thrust = still.force.z();
    EXPECT_NEAR(effect.force.z(), (blades.force - still.force).z(), 0.1 * thrust)
        << air.transpose();
    EXPECT_NEAR(effect.force.x(), blades.force.x(), 0.05 * thrust) << air.transpose();
  }
}

TEST(BladeElement, IsNothingInStillAir) {
  Values values = Typical();
  values[3] = 0.2, values[4] = 0.3;
  const Result still = AtRotor(Vector3d::Zero(), values);
  EXPECT_LT(still.force.norm(), 1e-5 * kK_f * kOmega * kOmega);
  EXPECT_LT(still.torque.norm(), 1e-5 * kK_f * kOmega * kOmega * kRadius);
}

TEST(BladeElement, HasTheSignsOfARotor) {
  Values values = Typical();
  values[3] = 0.2, values[4] = 0.3;
  EXPECT_LT(AtRotor({0, 0, 3}, values).force.z(), 0.0);   // climb takes thrust
  EXPECT_GT(AtRotor({0, 0, -2}, values).force.z(), 0.0);  // descent gives some
  EXPECT_GT(AtRotor({8, 0, 0}, values).force.z(), 0.0);   // so does forward flight
  const Result forward = AtRotor({8, 0, 0}, values), left = AtRotor({0, 8, 0}, values);
  EXPECT_LT(forward.force.x(), 0.0);   // drag
  EXPECT_LT(forward.torque.y(), 0.0);  // nose up
  // The advancing blade of a clockwise rotor is on the left.
  EXPECT_GT(forward.torque.x(), 0.0);
  EXPECT_LT(AtRotor({8, 0, 0}, values, -1.0).torque.x(), 0.0);
  // And no direction is preferred.
  EXPECT_NEAR(left.force.y(), forward.force.x(), 1e-12);
  EXPECT_NEAR(left.force.z(), forward.force.z(), 1e-12);
  EXPECT_NEAR(left.torque.x(), -forward.torque.y(), 1e-12);
  EXPECT_NEAR(left.torque.y(), forward.torque.x(), 1e-12);
}

TEST(BladeElement, DragsMoreInClimbThanInDescent) {
  const Values values = Typical();
  EXPECT_LT(AtRotor({10, 0, 4}, values).force.x(), AtRotor({10, 0, 0}, values).force.x());
  EXPECT_GT(AtRotor({10, 0, -4}, values).force.x(), AtRotor({10, 0, 0}, values).force.x());
}

// The shaft pays for the wake, T v, and for the work on the vehicle, F u; the rest is profile drag.
TEST(BladeElement, ShaftPaysForWakeAndFlight) {
  const Values values = Typical();
  const double static_torque =
      BladeOf(values).Integrate(Vector3d::Zero(), InducedAt(values, Vector3d::Zero())).torque.z();
  for (const Vector3d& air :
       {Vector3d(0, 0, 0), Vector3d(0, 0, 4), Vector3d(8, 0, 0), Vector3d(12, 0, 5)}) {
    const Result r = AtRotor(air, values);
    const double thrust = r.force.z() + kK_f * kOmega * kOmega;
    const double shaft = (r.torque.z() + static_torque) * kOmega;
    const double spent = thrust * (InducedAt(values, air) + air.z()) + r.force.x() * air.x();
    const double profile = kRho * M_PI * kRadius * kRadius * std::pow(kTip, 3) * values[2] / 8.0;
    EXPECT_NEAR(shaft - spent, profile, 0.6 * profile) << air.transpose();
    EXPECT_GT(shaft, spent) << air.transpose();
  }
}

TEST(BladeElement, StaysFiniteWithRotorsAtRest) {
  const auto effect = MakeBladeElement(NominalVehicle());
  FlightState state;
  state.v_AB_B = {12.0, 3.0, -8.0};
  for (const double speed : {0.0, 1e-9, 1.0, 50.0}) {
    state.rotors = RotorState::Steady(RotorVector::Constant(4, speed));
    Wrench wrench;
    effect->AddWrench(state, Typical(), &wrench);
    EXPECT_TRUE(wrench.f_B.allFinite() && wrench.tau_Bo_B.allFinite()) << speed;
    EXPECT_LT(wrench.f_B.norm(), 20.0) << speed;
  }
}

// With derivatives. The best of many batches: other work on the machine only adds.
TEST(BladeElement, TakesLessThanThreeMicrosecondsARotor) {
#ifdef ODMC_SANITIZED
  GTEST_SKIP() << "a sanitizer takes its own time";
#endif
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, {"thrust", "blade_element"});
  const ModelValues values = model.InitialValues();
  Random random(5);
  FlightState flight;
  flight.rotors = RotorState::Steady(RotorVector::Constant(4, kOmega));
  Vector3d f, tau;
  ModelWrenchJacobians J;
  double best = std::numeric_limits<double>::infinity();
  for (int batch = 0; batch < 40; ++batch) {
    constexpr int kCalls = 500;
    const std::clock_t start = std::clock();
    for (int i = 0; i < kCalls; ++i) {
      flight.v_AB_B = random.Next3(12.0);
      model.EvaluateWrench(flight, values, Vector3d::Zero(), &f, &tau, &J);
    }
    const double seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
    best = std::min(best, seconds / kCalls / vehicle.num_rotors());
  }
  RecordProperty("nanoseconds_per_rotor", static_cast<int>(1e9 * best));
  EXPECT_LT(best, 3e-6);
}

}  // namespace
}  // namespace test
}  // namespace odmc
