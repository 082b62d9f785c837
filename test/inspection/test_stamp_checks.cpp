#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "odmc/inspection/stamp_checks.h"

namespace odmc {
namespace {

constexpr double kPeriod_s = 0.005;

/// Twenty seconds of rotor speeds with these stamps.
FlightLog Stamped(const std::vector<double>& t_s) {
  FlightLog log;
  for (const double t : t_s) {
    RotorSample sample;
    sample.stamp = FromSeconds(t);
    sample.speed = RotorVector::Constant(4, 500.0);
    log.rotors.push_back(sample);
  }
  return log;
}

std::vector<double> Even() {
  std::vector<double> t_s;
  for (int i = 0; i < 4000; ++i) t_s.push_back(kPeriod_s * i);
  return t_s;
}

/// RMS of the stamps about even ones that are late by `late_s`.
double ErrorOf(const FlightLog& log, double late_s) {
  double square = 0.0;
  for (size_t i = 0; i < log.rotors.size(); ++i) {
    const double e = ToSeconds(log.rotors[i].stamp) - kPeriod_s * static_cast<double>(i) - late_s;
    square += e * e / static_cast<double>(log.rotors.size());
  }
  return std::sqrt(square);
}

TEST(EvenOutStamps, BurstsGetEvenStampsWithTheirMeanDelay) {
  std::vector<double> t_s = Even();
  for (double& t : t_s) t = 0.04 * (std::floor(t / 0.04 + 1e-9) + 1.0) + 0.05 * std::fmod(t, 0.04);
  FlightLog log = Stamped(t_s);
  const std::vector<Finding> findings = EvenOutStamps(&log);
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].check, "rotor_jitter");
  const double late_s = 0.04 - 0.5 * (0.04 - kPeriod_s) + 0.05 * 0.5 * (0.04 - kPeriod_s);
  EXPECT_LT(ErrorOf(log, late_s), 0.0015);
  for (size_t i = 1; i < log.rotors.size(); ++i) {
    ASSERT_GT(log.rotors[i].stamp, log.rotors[i - 1].stamp);
  }
}

TEST(EvenOutStamps, JitterIsAveragedOut) {
  std::vector<double> t_s = Even();
  std::mt19937 engine(3);
  std::uniform_real_distribution<double> jitter(-0.01, 0.01);
  for (double& t : t_s) t += 0.02 + jitter(engine);
  std::sort(t_s.begin(), t_s.end());
  FlightLog log = Stamped(t_s);
  EXPECT_EQ(EvenOutStamps(&log).size(), 1u);
  EXPECT_LT(ErrorOf(log, 0.02), 0.001);
}

TEST(EvenOutStamps, LostSamplesGapsAndOtherRatesAreLeftAlone) {
  std::vector<double> t_s = Even();
  std::mt19937 engine(4);
  std::uniform_real_distribution<double> lost(0.0, 1.0);
  t_s.erase(std::remove_if(t_s.begin(), t_s.end(),
                           [&](double t) { return lost(engine) < 0.2 || (t > 7.0 && t < 9.0); }),
            t_s.end());
  for (double& t : t_s) t = t < 12.0 ? t : 12.0 + 1.5 * (t - 12.0);
  const FlightLog before = Stamped(t_s);
  FlightLog log = before;
  EXPECT_TRUE(EvenOutStamps(&log).empty());
  for (size_t i = 0; i < log.rotors.size(); ++i) {
    ASSERT_EQ(log.rotors[i].stamp, before.rotors[i].stamp);
  }
}

}  // namespace
}  // namespace odmc
