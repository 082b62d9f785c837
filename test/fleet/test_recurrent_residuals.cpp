// What comes back in flight after flight: bins, the test over flights, its rate of false alarms.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <string>

#include "odmc/fleet/recurrent_residuals.h"

namespace odmc {
namespace test {
namespace {

constexpr double kWeight_N = 7.4, kNoise_N = 0.1, kRate = 0.05;

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double Normal() { return normal_(engine_); }

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
};

PredictionSample SampleAt(double t_s, double speed_m_s) {
  PredictionSample s;
  s.t_s = t_s;
  s.v_AB_B = {speed_m_s, 0.0, 0.0};
  s.w_WB_B.setZero();
  s.measured_force = s.predicted_force = Eigen::Vector3d(0.0, 0.0, kWeight_N);
  s.measured_torque = s.predicted_torque = Eigen::Vector3d::Zero();
  s.effects = {{"thrust", {0.0, 0.0, kWeight_N}, Eigen::Vector3d::Zero()}};
  return s;
}

/// 20 s up to 8 m/s and back. All the flight is off by what scatters between flights, a share of
/// the noise.
FlightResiduals Fly(Random* random, const std::function<double(double)>& missed_N, double scatter) {
  constexpr double kStep_s = 0.02, kDuration_s = 20.0;
  FlightResiduals flight;
  const Eigen::Vector3d off =
      scatter * kNoise_N * Eigen::Vector3d::NullaryExpr([&] { return random->Normal(); });
  for (double t_s = 0.0; t_s < kDuration_s; t_s += kStep_s) {
    const double speed = 4.0 - 4.0 * std::cos(2.0 * M_PI * t_s / kDuration_s);
    PredictionSample s = SampleAt(t_s, speed);
    s.measured_force +=
        off + kNoise_N * Eigen::Vector3d::NullaryExpr([&] { return random->Normal(); });
    s.measured_force.z() += missed_N(speed);
    flight.Add(s, kWeight_N);
  }
  return flight;
}

std::vector<FlightResiduals> FlyAll(int count, Random* random,
                                    const std::function<double(int, double)>& missed_N,
                                    double scatter = 0.3) {
  std::vector<FlightResiduals> flights;
  for (int i = 0; i < count; ++i) {
    flights.push_back(Fly(
        random, [&](double speed) { return missed_N(i, speed); }, scatter));
  }
  return flights;
}

/// Those that count, the least likely first.
std::vector<RecurrentResidual> Found(const std::vector<FlightResiduals>& flights) {
  std::vector<const FlightResiduals*> all;
  for (const FlightResiduals& f : flights) all.push_back(&f);
  ResidualChannels error = ResidualChannels::Zero();
  error.head<3>().setConstant(kNoise_N);
  std::vector<RecurrentResidual> found = FindRecurrentResiduals(all, error);
  found.erase(std::remove_if(found.begin(), found.end(),
                             [](const auto& r) { return !(r.p_value < kRate); }),
              found.end());
  return found;
}

double Nothing(int, double) { return 0.0; }

TEST(RecurrentResiduals, NamesChannelBinAndSizeOfWhatComesBack) {
  Random random(1);
  const auto lift = [](int, double speed) { return speed >= 6.0 ? -0.2 : 0.0; };
  const std::vector<RecurrentResidual> found = Found(FlyAll(10, &random, lift));
  ASSERT_FALSE(found.empty());
  for (const RecurrentResidual& r : found) {
    EXPECT_STREQ(kResidualChannelNames[static_cast<size_t>(r.channel)], "force_z_N");
    EXPECT_EQ(r.same_sign, r.flights);
    EXPECT_LT(r.mean, 0.0);
    EXPECT_EQ(r.flights, 10);
  }
  const auto by_speed = std::find_if(found.begin(), found.end(),
                                     [](const RecurrentResidual& r) { return r.quantity == 0; });
  ASSERT_NE(by_speed, found.end());
  EXPECT_GE(by_speed->from, 6.0);
  EXPECT_LE(by_speed->to, 8.0 + 1e-9);
  EXPECT_NEAR(by_speed->mean, -0.2, 4.0 * by_speed->sigma);
}

TEST(RecurrentResiduals, KeepTheirRateOfFalseAlarms) {
  constexpr int kFleets = 300;
  Random random(2);
  int alarms = 0;
  for (int fleet = 0; fleet < kFleets; ++fleet) {
    alarms += !Found(FlyAll(6, &random, Nothing)).empty();
  }
  // Three sigma of a binomial of 5 %.
  EXPECT_LT(alarms, kRate * kFleets + 3.0 * std::sqrt(kRate * (1.0 - kRate) * kFleets));
}

TEST(RecurrentResiduals, OneFlightThatIsFarOffIsNotARecurrence) {
  Random random(3);
  const auto once = [](int flight, double) { return flight == 4 ? 2.0 : 0.0; };
  EXPECT_TRUE(Found(FlyAll(10, &random, once)).empty());
}

TEST(RecurrentResiduals, WhatIsSmallBesideTheErrorIsNoNews) {
  Random random(4);
  const auto little = [](int, double) { return 0.9 * kLeastResidualShare * kNoise_N; };
  EXPECT_TRUE(Found(FlyAll(40, &random, little, 0.0)).empty());
}

TEST(RecurrentResiduals, FourFlightsAreTooFew) {
  Random random(5);
  const auto lift = [](int, double) { return 1.0; };
  EXPECT_TRUE(Found(FlyAll(4, &random, lift)).empty());
}

TEST(RecurrentResiduals, ALongWideFlightTakesBoundedMemoryAndLosesNothing) {
  Random random(6);
  FlightResiduals flight;
  double t_s = 0.0;
  for (int k = 0; k < 20000; ++k, t_s += 0.01) {
    PredictionSample s = SampleAt(t_s, 30.0 * random.Normal());
    s.measured_force.x() += 1.0;
    flight.Add(s, kWeight_N);
  }
  for (int quantity = 0; quantity < kResidualQuantities; ++quantity) {
    double seconds = 0.0, impulse = 0.0;
    EXPECT_LE(flight.of(quantity).bins().size(), 32u);
    for (const auto& [index, sum] : flight.of(quantity).bins()) {
      seconds += sum.seconds;
      impulse += sum.residual[0];
    }
    EXPECT_NEAR(seconds, 199.99, 1e-6)
        << kResidualQuantityTable[static_cast<size_t>(quantity)].name;
    EXPECT_NEAR(impulse, 199.99, 1e-6);
  }
}

TEST(RecurrentResiduals, WiderBinsHaveEvenEdges) {
  ResidualBins bins;
  for (const double at : {-2.5, -0.5, 0.5, 1.5, 2.5}) bins.Add(at, {1.0, ResidualChannels::Ones()});
  bins.CoarsenTo(1);
  ASSERT_EQ(bins.bins().size(), 4u);
  EXPECT_EQ(bins.bins().at(-2).seconds, 1.0);
  EXPECT_EQ(bins.bins().at(-1).seconds, 1.0);
  EXPECT_EQ(bins.bins().at(0).seconds, 2.0);
  EXPECT_EQ(bins.bins().at(1).seconds, 1.0);
}

}  // namespace
}  // namespace test
}  // namespace odmc
