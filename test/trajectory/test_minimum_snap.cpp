#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "odmc/trajectory/minimum_snap.h"
#include "support/error_text.h"

namespace odmc {
namespace {

const std::vector<Waypoint> kTour = {{{0.0, 0.0, 1.5}, 0.5},
                                     {{3.0, 1.0, 2.0}, {}},
                                     {{4.0, -2.0, 3.0}, 3.0},
                                     {{1.0, -3.0, 2.5}, -3.0},
                                     {{-1.0, 0.5, 1.2}, {}}};
const std::vector<double> kTimes = {1.3, 1.1, 1.7, 0.9};

constexpr int kOrders = 4;  // position, speed, acceleration, jerk
using Coefficients = Eigen::Matrix<double, 8, 3>;
using Ends = Eigen::Matrix<double, kOrders, 3>;  // a derivative a row

// Row of derivative `order` of a polynomial of degree 7 at `t`.
Eigen::Matrix<double, 1, 8> RowAt(double t, int order) {
  Eigen::Matrix<double, 1, 8> row;
  for (int power = 0; power < 8; ++power) {
    double factor = 1.0;
    for (int k = 0; k < order; ++k) factor *= power - k;
    row[power] = power < order ? 0.0 : factor * std::pow(t, power - order);
  }
  return row;
}

// The polynomial of degree 7 with these derivatives at 0 and at T, or, since every polynomial of
// degree 7 is one, any segment of any path of that degree.
Coefficients Between(const Ends& start, const Ends& end, double T) {
  Eigen::Matrix<double, 8, 8> conditions;
  Coefficients values;
  for (int order = 0; order < kOrders; ++order) {
    conditions.row(order) = RowAt(0.0, order);
    conditions.row(kOrders + order) = RowAt(T, order);
  }
  values << start, end;
  return conditions.partialPivLu().solve(values);
}

// Integral of squared snap; Simpson's rule is far more exact here than needed.
double CostOf(const Coefficients& polynomial, double T) {
  constexpr int kPieces = 2000;
  double sum = 0.0;
  for (int i = 0; i <= kPieces; ++i) {
    const double weight = i == 0 || i == kPieces ? 1.0 : (i % 2 == 1 ? 4.0 : 2.0);
    sum += weight * (RowAt(T * i / kPieces, 4) * polynomial).squaredNorm();
  }
  return sum * T / kPieces / 3.0;
}

std::vector<double> KnotTimes(const std::vector<double>& times_s) {
  std::vector<double> knots = {0.0};
  for (const double time_s : times_s) knots.push_back(knots.back() + time_s);
  return knots;
}

std::vector<Ends> EndsOf(const MinimumSnap& path) {
  std::vector<Ends> ends;
  for (const double t : KnotTimes(path.segment_times_s())) {
    const FlatReference r = path.At(std::min(t, path.duration_s()));
    ends.emplace_back();
    ends.back() << r.p_WB.transpose(), r.v_WB.transpose(), r.a_WB.transpose(), r.j_WB.transpose();
  }
  return ends;
}

double CostOf(const std::vector<Ends>& ends, const std::vector<double>& times_s) {
  double sum = 0.0;
  for (size_t i = 0; i < times_s.size(); ++i) {
    sum += CostOf(Between(ends[i], ends[i + 1], times_s[i]), times_s[i]);
  }
  return sum;
}

double CostAt(const std::vector<double>& times_s) {
  return MinimumSnap::WithTimes(kTour, times_s).cost();
}

void ExpectSame(const FlatReference& a, const FlatReference& b, double tolerance) {
  EXPECT_LT((a.p_WB - b.p_WB).norm(), tolerance);
  EXPECT_LT((a.v_WB - b.v_WB).norm(), tolerance);
  EXPECT_LT((a.a_WB - b.a_WB).norm(), tolerance);
  EXPECT_LT((a.j_WB - b.j_WB).norm(), tolerance);
  EXPECT_LT((a.s_WB - b.s_WB).norm(), 10.0 * tolerance);
  EXPECT_NEAR(a.yaw, b.yaw, tolerance);
  EXPECT_NEAR(a.d_yaw, b.d_yaw, tolerance);
  EXPECT_NEAR(a.dd_yaw, b.dd_yaw, tolerance);
}

Feasibility FeasibilityOf(const MinimumSnap& path, const FlightLimits& limits) {
  return CheckFeasibility([&](double t) { return path.At(t); }, 0.0, path.duration_s(), limits,
                          9.81);
}

TEST(MinimumSnap, BetweenTwoWaypointsIsTheKnownPolynomial) {
  const Eigen::Vector3d from(1.0, 2.0, 3.0), way(4.0, -2.0, 1.0);
  const MinimumSnap path = MinimumSnap::WithTimes({{from, {}}, {from + way, {}}}, {2.0});
  for (double t = 0.0; t <= 2.0; t += 0.1) {
    const double s = t / 2.0;
    const double step = std::pow(s, 4) * (35.0 - 84.0 * s + 70.0 * s * s - 20.0 * s * s * s);
    EXPECT_LT((path.At(t).p_WB - from - step * way).norm(), 1e-9) << t;
  }
  // 100800 way² / T⁷, integrated by hand.
  EXPECT_NEAR(path.cost(), 100800.0 * way.squaredNorm() / 128.0, 1e-6);
}

TEST(MinimumSnap, PassesItsWaypoints) {
  const MinimumSnap path(kTour);
  const std::vector<double> knots = KnotTimes(path.segment_times_s());
  ASSERT_EQ(knots.size(), kTour.size());
  for (size_t i = 0; i < knots.size(); ++i) {
    EXPECT_LT((path.At(knots[i]).p_WB - kTour[i].p_WB).norm(), 1e-9) << i;
  }
  EXPECT_NEAR(path.At(knots[0]).yaw, 0.5, 1e-9);
  EXPECT_NEAR(path.At(knots[2]).yaw, 3.0, 1e-9);
}

TEST(MinimumSnap, TurnsTheShortWay) {
  const MinimumSnap path(kTour);
  const double time_s = KnotTimes(path.segment_times_s())[3];
  EXPECT_NEAR(path.At(time_s).yaw, -3.0 + 2.0 * M_PI, 1e-9);
}

TEST(MinimumSnap, LooksAheadWhereNoWaypointHasAYaw) {
  std::vector<Waypoint> tour = kTour;
  for (Waypoint& waypoint : tour) waypoint.yaw.reset();
  const MinimumSnap free = MinimumSnap::WithTimes(tour, kTimes);
  tour[2].yaw = 1.0;
  const MinimumSnap one = MinimumSnap::WithTimes(tour, kTimes);
  for (double t = 0.0; t < 5.0; t += 0.1) {
    EXPECT_NEAR(free.At(t).yaw, 0.0, 1e-12);
    EXPECT_NEAR(one.At(t).yaw, 1.0, 1e-9);
    EXPECT_NEAR(one.At(t).d_yaw, 0.0, 1e-9);
  }
}

TEST(MinimumSnap, RestsAtBothEnds) {
  const MinimumSnap path(kTour);
  for (const double t : {-1.0, 0.0, path.duration_s() - 1e-12, path.duration_s() + 1.0}) {
    const FlatReference r = path.At(t);
    EXPECT_LT(r.v_WB.norm() + r.a_WB.norm() + r.j_WB.norm(), 1e-7) << t;
    EXPECT_LT(std::abs(r.d_yaw) + std::abs(r.dd_yaw), 1e-7) << t;
    EXPECT_LT((r.p_WB - (t <= 0.0 ? kTour.front() : kTour.back()).p_WB).norm(), 1e-9) << t;
  }
  EXPECT_EQ(path.At(-1.0).s_WB.norm(), 0.0);
}

TEST(MinimumSnap, IsContinuousToSnapAtItsWaypoints) {
  const MinimumSnap path = MinimumSnap::WithTimes(kTour, kTimes);
  const std::vector<double> knots = KnotTimes(kTimes);
  for (size_t i = 1; i + 1 < knots.size(); ++i) {
    ExpectSame(path.At(knots[i] - 1e-9), path.At(knots[i] + 1e-9), 1e-5);
  }
}

TEST(MinimumSnap, GivesTheDerivativesOfItsPosition) {
  const MinimumSnap path(kTour);
  const double h = 1e-4;
  for (double t = 0.05; t < path.duration_s() - h; t += 0.0731) {
    const FlatReference a = path.At(t - h), b = path.At(t), c = path.At(t + h);
    EXPECT_LT((b.v_WB - (c.p_WB - a.p_WB) / (2 * h)).norm(), 1e-5) << t;
    EXPECT_LT((b.a_WB - (c.v_WB - a.v_WB) / (2 * h)).norm(), 1e-4) << t;
    EXPECT_LT((b.j_WB - (c.a_WB - a.a_WB) / (2 * h)).norm(), 1e-3) << t;
    EXPECT_LT((b.s_WB - (c.j_WB - a.j_WB) / (2 * h)).norm(), 0.2) << t;
    EXPECT_NEAR(b.d_yaw, (c.yaw - a.yaw) / (2 * h), 1e-5) << t;
    EXPECT_NEAR(b.dd_yaw, (c.d_yaw - a.d_yaw) / (2 * h), 1e-3) << t;
  }
}

// Any path of degree 7 through the waypoints that is smooth to jerk is some other choice of speed,
// acceleration and jerk there. None is cheaper, and the cost grows with the square of the change.
TEST(MinimumSnap, CostsLessThanAnyPathNearIt) {
  const MinimumSnap path = MinimumSnap::WithTimes(kTour, kTimes);
  const std::vector<Ends> best = EndsOf(path);
  EXPECT_NEAR(CostOf(best, kTimes), path.cost(), 1e-6 * path.cost());
  std::mt19937 generator(5);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<Ends> change(best.size(), Ends::Zero());
    for (size_t i = 1; i + 1 < best.size(); ++i) {
      for (int k = 1; k < kOrders; ++k) {
        for (int axis = 0; axis < 3; ++axis) change[i](k, axis) = normal(generator);
      }
    }
    const auto cost = [&](double size) {
      std::vector<Ends> ends = best;
      for (size_t i = 0; i < ends.size(); ++i) ends[i] += size * change[i];
      return CostOf(ends, kTimes);
    };
    EXPECT_GT(cost(0.1), path.cost());
    EXPECT_GT(cost(-0.1), path.cost());
    // No slope: what is left is even in the size.
    EXPECT_LT(std::abs(cost(0.1) - cost(-0.1)), 1e-4 * (cost(0.1) + cost(-0.1) - 2 * path.cost()));
  }
}

double YawCost(const std::function<double(double)>& dd_yaw, double duration_s) {
  double sum = 0.0;
  for (double t = 0.0; t < duration_s; t += 1e-3) sum += 1e-3 * std::pow(dd_yaw(t), 2);
  return sum;
}

TEST(MinimumSnap, LetsYawGoWhereItIsFree) {
  std::vector<Waypoint> tour = kTour;
  const MinimumSnap free = MinimumSnap::WithTimes(tour, kTimes);
  const auto cost = [](const MinimumSnap& path) {
    return YawCost([&](double t) { return path.At(t).dd_yaw; }, path.duration_s());
  };
  const double free_yaw = free.At(kTimes[0]).yaw;
  for (const double change : {-0.2, 0.2}) {
    tour[1].yaw = free_yaw + change;
    EXPECT_GT(cost(MinimumSnap::WithTimes(tour, kTimes)), cost(free));
  }
  tour[1].yaw = free_yaw;
  EXPECT_NEAR(cost(MinimumSnap::WithTimes(tour, kTimes)), cost(free), 1e-6 * cost(free));
}

TEST(MinimumSnap, AllocatesTimeBetterThanItsFirstGuess) {
  const MinimumSnap path(kTour);
  std::vector<double> first = TrapezoidTimes(kTour);
  const double first_total = KnotTimes(first).back();
  for (double& time_s : first) time_s *= path.duration_s() / first_total;
  EXPECT_LT(path.cost(), 0.99 * CostAt(first));
}

TEST(MinimumSnap, AllocatesTimeAsWellAsAnyNearby) {
  const MinimumSnap path(kTour);
  const std::vector<double> best = path.segment_times_s();
  for (size_t i = 0; i < best.size(); ++i) {
    for (const double moved_s : {-0.05, 0.05}) {
      std::vector<double> times = best;
      times[i] += moved_s;
      times[(i + 1) % times.size()] -= moved_s;
      EXPECT_GT(CostAt(times), path.cost()) << i;
    }
  }
}

TEST(MinimumSnap, SplitsAStraightFlightInTheMiddle) {
  const MinimumSnap path({{{0, 0, 1}, {}}, {{2, 0, 1}, {}}, {{4, 0, 1}, {}}});
  const std::vector<double> times = path.segment_times_s();
  EXPECT_NEAR(times[0], times[1], 1e-3 * times[0]);
}

// Each limit in turn is the one that binds.
TEST(MinimumSnap, IsAsFastAsItsLimitsAllow) {
  const FlightLimits wide = {50.0, 10.0, 0.01, 50.0, 50.0};
  const auto reached = [](const FlightLimits& limits, const std::vector<Waypoint>& tour = kTour) {
    const Feasibility found = FeasibilityOf(MinimumSnap(tour, limits), limits);
    EXPECT_TRUE(found.ok()) << found.violations.front();
    return found;
  };
  FlightLimits limits = wide;
  limits.max_speed_m_s = 3.0;
  EXPECT_NEAR(reached(limits).max_speed_m_s, 3.0, 0.01);
  limits = wide;
  limits.max_thrust_over_weight = 1.5;
  EXPECT_NEAR(reached(limits).max_thrust_over_weight, 1.5, 0.005);
  limits = wide;
  limits.min_thrust_over_weight = 0.7;
  const std::vector<Waypoint> up_and_down = {
      {{0.0, 0.0, 1.0}, {}}, {{0.3, 0.0, 4.0}, {}}, {{0.0, 0.0, 1.0}, {}}};
  EXPECT_NEAR(reached(limits, up_and_down).min_thrust_over_weight, 0.7, 0.007);
  limits = wide;
  limits.max_body_rate_rad_s = 1.5;
  EXPECT_NEAR(reached(limits).max_body_rate_rad_s, 1.5, 0.015);
  limits = wide;
  limits.max_yaw_rate_rad_s = 0.7;
  EXPECT_NEAR(reached(limits).max_yaw_rate_rad_s, 0.7, 0.007);
}

TEST(MinimumSnap, HasTheSameShapeAtEveryScale) {
  std::vector<Waypoint> far = kTour;
  std::vector<double> slow = kTimes;
  for (Waypoint& waypoint : far) waypoint.p_WB *= 1e3;
  for (double& time_s : slow) time_s *= 1e3;
  const MinimumSnap near_path = MinimumSnap::WithTimes(kTour, kTimes);
  const MinimumSnap far_path = MinimumSnap::WithTimes(far, slow);
  for (double t = 0.0; t < 5.0; t += 0.1) {
    EXPECT_LT((far_path.At(1e3 * t).p_WB / 1e3 - near_path.At(t).p_WB).norm(), 1e-9) << t;
  }
}

TEST(MinimumSnap, PlansALongTour) {
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> place(-5.0, 5.0);
  std::vector<Waypoint> tour;
  for (int i = 0; i < 40; ++i) {
    tour.push_back({{place(generator), place(generator), 6.0 + place(generator)}, {}});
  }
  const MinimumSnap path(tour);
  EXPECT_TRUE(FeasibilityOf(path, {}).ok());
  const std::vector<double> knots = KnotTimes(path.segment_times_s());
  for (size_t i = 0; i < tour.size(); ++i) {
    EXPECT_LT((path.At(knots[i]).p_WB - tour[i].p_WB).norm(), 1e-6) << i;
  }
}

TEST(MinimumSnap, SaysWhichWaypointIsWrong) {
  ODMC_EXPECT_ERROR(MinimumSnap({kTour[0]}), "at least two waypoints, not 1");
  std::vector<Waypoint> tour = kTour;
  tour[3].p_WB = tour[2].p_WB;
  ODMC_EXPECT_ERROR(MinimumSnap(tour), "waypoints[3] is at the same place as waypoints[2]");
  tour[3].p_WB.y() = std::numeric_limits<double>::quiet_NaN();
  ODMC_EXPECT_ERROR(MinimumSnap(tour), "waypoints[3] has a number that is not finite");
  tour = kTour;
  tour[0].yaw = std::numeric_limits<double>::infinity();
  ODMC_EXPECT_ERROR(MinimumSnap(tour), "waypoints[0] has a number that is not finite");
}

TEST(MinimumSnap, SaysWhichLimitOrTimeIsWrong) {
  FlightLimits limits;
  limits.max_speed_m_s = 0.0;
  ODMC_EXPECT_ERROR(MinimumSnap(kTour, limits), "max_speed_m_s must be positive, not 0");
  limits = FlightLimits();
  limits.max_body_rate_rad_s = -1.0;
  ODMC_EXPECT_ERROR(MinimumSnap(kTour, limits), "max_body_rate_rad_s must be positive, not -1");
  limits = FlightLimits();
  limits.max_thrust_over_weight = 1.0;
  ODMC_EXPECT_ERROR(MinimumSnap(kTour, limits), "max_thrust_over_weight must be above 1");
  limits = FlightLimits();
  limits.min_thrust_over_weight = 1.0;
  ODMC_EXPECT_ERROR(MinimumSnap(kTour, limits), "min_thrust_over_weight must be below 1");
  ODMC_EXPECT_ERROR(MinimumSnap(kTour, FlightLimits(), 0.0), "gravity must be positive");
  ODMC_EXPECT_ERROR(MinimumSnap::WithTimes(kTour, {1.0, 1.0}),
                    "5 waypoints need 4 segment times, not 2");
  ODMC_EXPECT_ERROR(MinimumSnap::WithTimes(kTour, {1.0, 1.0, -1.0, 1.0}),
                    "segment_times_s[2] must be");
}

TEST(Feasibility, IsThatOfACircle) {
  const double r = 2.0, w = 2.0, g = 9.81;
  const auto circle = [&](double t) {
    const Eigen::Vector3d out(std::cos(w * t), std::sin(w * t), 0.0);
    const Eigen::Vector3d along(-std::sin(w * t), std::cos(w * t), 0.0);
    FlatReference reference;
    reference.p_WB = r * out;
    reference.v_WB = r * w * along;
    reference.a_WB = -r * w * w * out;
    reference.j_WB = -r * w * w * w * along;
    reference.s_WB = r * w * w * w * w * out;
    return reference;
  };
  const Feasibility found = CheckFeasibility(circle, 0.0, 4.0, {3.9, 1.2, 0.2, 6.0, 1.0}, g);
  const double tilt = std::atan2(r * w * w, g);
  EXPECT_NEAR(found.max_speed_m_s, 4.0, 1e-9);
  EXPECT_NEAR(found.max_acceleration_m_s2, 8.0, 1e-9);
  EXPECT_NEAR(found.max_tilt_rad, tilt, 1e-9);
  EXPECT_NEAR(found.max_thrust_over_weight, 1.0 / std::cos(tilt), 1e-9);
  EXPECT_NEAR(found.min_thrust_over_weight, 1.0 / std::cos(tilt), 1e-9);
  // A tilt of fixed size whose direction turns at w, without turning about body z itself.
  EXPECT_NEAR(found.max_body_rate_rad_s, 2.0 * w * std::sin(0.5 * tilt), 1e-6);
  ASSERT_EQ(found.violations.size(), 2u);
  EXPECT_EQ(found.violations[0], "the speed reaches 4 m/s, at most 3.9 is allowed");
  EXPECT_TRUE(testing_support::Contains(found.violations[1], "the thrust over weight reaches"));
  EXPECT_FALSE(found.ok());
}

TEST(Feasibility, NamesAReferenceThatIsNotFinite) {
  const auto at = [](double t) {
    FlatReference reference;
    if (t > 0.5) reference.j_WB.x() = std::numeric_limits<double>::quiet_NaN();
    return reference;
  };
  EXPECT_TRUE(CheckFeasibility(at, 0.0, 0.5, {}, 9.81).ok());
  const Feasibility found = CheckFeasibility(at, 0.0, 1.0, {}, 9.81);
  ASSERT_EQ(found.violations.size(), 1u);
  EXPECT_TRUE(testing_support::Contains(found.violations[0], "is not finite at 0.505 s"));
  ODMC_EXPECT_ERROR(CheckFeasibility(at, 1.0, 0.0, {}, 9.81), "end after its start");
}

TEST(Feasibility, AsksNothingOfAStandingVehicle) {
  const auto at = [](double) {
    FlatReference reference;
    reference.v_WB.x() = 100.0;
    reference.standing = true;
    return reference;
  };
  EXPECT_TRUE(CheckFeasibility(at, 0.0, 1.0, {}, 9.81).ok());
}

}  // namespace
}  // namespace odmc
