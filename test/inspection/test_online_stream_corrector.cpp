#include <gtest/gtest.h>

#include "odmc/inspection/online_stream_corrector.h"

namespace odmc {
namespace {

StreamInspection Found(const std::string& stream, double late_s, double sigma_s) {
  StreamInspection inspection;
  TimeOffset offset;
  offset.stream = stream;
  offset.against = "body_rates";
  offset.lag.lag_s = offset.compensated_s = late_s;
  offset.lag.scatter_s = sigma_s;
  inspection.offsets.push_back(offset);
  inspection.findings.push_back(OffsetFinding(offset, true));
  return inspection;
}

RotorSample Rotors(double t_s) {
  RotorSample sample;
  sample.stamp = FromSeconds(t_s);
  return sample;
}

TEST(OnlineStreamCorrector, TakesAnOffsetOffRotorSpeedsAndLeavesItUntilItIsAnother) {
  OnlineStreamCorrector mender;
  RotorSample sample = Rotors(10.0);
  mender.Mend(&sample);
  EXPECT_EQ(sample.stamp, FromSeconds(10.0));
  EXPECT_TRUE(mender.Adopt(Found("rotor_speeds", 0.030, 0.001)));
  mender.Mend(&sample);
  EXPECT_EQ(sample.stamp, FromSeconds(9.970));
  EXPECT_FALSE(mender.Adopt(Found("rotor_speeds", 0.034, 0.001)));  // within 5 ms
  EXPECT_FALSE(mender.Adopt(Found("rotor_speeds", 0.045, 0.006)));  // within three sigma
  EXPECT_FALSE(mender.Adopt({}));                                   // a calm minute
  EXPECT_DOUBLE_EQ(mender.OffsetOf("rotor_speeds"), 0.030);
  EXPECT_TRUE(mender.Adopt(Found("rotor_speeds", 0.045, 0.001)));
  EXPECT_DOUBLE_EQ(mender.OffsetOf("rotor_speeds"), 0.045);
}

TEST(OnlineStreamCorrector, WhatWasDroppedIsUsedAgainWhereItIsReadmitted) {
  StreamInspection wrong;
  wrong.drop_velocity = true;
  OnlineStreamCorrector mender;
  EXPECT_TRUE(mender.Adopt(wrong));
  const auto has_velocity = [&] {
    OdometrySample sample;
    sample.v_WS = Eigen::Vector3d::UnitX();
    mender.Mend(&sample);
    return sample.v_WS.has_value();
  };
  EXPECT_FALSE(has_velocity());
  EXPECT_FALSE(mender.Adopt({}));
  EXPECT_FALSE(has_velocity());
  mender.Readmit();
  EXPECT_TRUE(has_velocity());
}

TEST(OnlineStreamCorrector, AnOffsetThatItCannotTakeOffCostsTrust) {
  OnlineStreamCorrector mender;
  EXPECT_FALSE(mender.Adopt(Found("velocity", 0.030, 0.001)));
  ASSERT_EQ(mender.findings().size(), 1u);
  EXPECT_EQ(mender.findings()[0].leaves, Trust::kDoubtful);
  EXPECT_EQ(mender.findings()[0].what.find("taken off"), std::string::npos);
  EXPECT_NE(mender.findings()[0].what.find("30.0 ms late"), std::string::npos);
}

// Rates share the poses' stamps and stay 9 ms late: rotor speeds, whose stamps are right, go with
// them, so that cause and answer are at one time.
TEST(OnlineStreamCorrector, RotorSpeedsAreBroughtToTheTimeOfRatesThatStayLate) {
  StreamInspection inspection = Found("body_rates", 0.009, 0.001);
  inspection.offsets.push_back(Found("rotor_speeds", 0.0, 0.001).offsets.front());
  OnlineStreamCorrector mender;
  EXPECT_TRUE(mender.Adopt(inspection));
  EXPECT_DOUBLE_EQ(mender.OffsetOf("rotor_speeds"), -0.009);
  RotorSample sample = Rotors(10.0);
  mender.Mend(&sample);
  EXPECT_EQ(sample.stamp, FromSeconds(10.009));
  inspection.offsets.back().against = "velocity";  // its time was not that of the rates
  OnlineStreamCorrector other;
  EXPECT_FALSE(other.Adopt(inspection));
}

TEST(OnlineStreamCorrector, GyroAndAccelerometerShareTheirStamps) {
  OnlineStreamCorrector mender;
  EXPECT_TRUE(mender.Adopt(Found("gyro", -0.020, 0.001)));
  ImuSample sample;
  sample.stamp = FromSeconds(1.0);
  mender.Mend(&sample);
  EXPECT_EQ(sample.stamp, FromSeconds(1.020));
}

TEST(OnlineStreamCorrector, DropsWhatIsWrongAndKeepsItDropped) {
  OnlineStreamCorrector mender;
  StreamInspection inspection;
  inspection.drop_velocity = inspection.drop_gyro = true;
  EXPECT_TRUE(mender.Adopt(inspection));
  EXPECT_FALSE(mender.Adopt(inspection));
  EXPECT_FALSE(mender.Adopt({}));
  OdometrySample odometry;
  odometry.v_WS = odometry.w_WS_S = Eigen::Vector3d::Ones();
  mender.Mend(&odometry);
  EXPECT_FALSE(odometry.v_WS.has_value());
  EXPECT_TRUE(odometry.w_WS_S.has_value());
  ImuSample imu;
  imu.gyro_I = imu.specific_force_I = Eigen::Vector3d::Ones();
  mender.Mend(&imu);
  EXPECT_FALSE(imu.gyro_I.has_value());
  EXPECT_TRUE(imu.specific_force_I.has_value());
}

}  // namespace
}  // namespace odmc
