#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <tf2_msgs/TFMessage.h>

#include <cmath>

#include "odmc/ros/flight_bag.h"
#include "odmc/ros/message_values.h"
#include "odmc/ros/tf_odometry.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using testing_support::Contains;

constexpr Stamp kStart = 5000000000, kMs = 1000000;

struct Pose {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();

  Pose operator*(const Pose& other) const { return {p + q * other.p, q * other.q}; }
  Pose Inverse() const { return {-(q.conjugate() * p), q.conjugate()}; }
};

geometry_msgs::TransformStamped Transform(const std::string& parent, const std::string& child,
                                          Stamp stamp, const Pose& pose) {
  geometry_msgs::TransformStamped m;
  m.header.frame_id = parent;
  m.header.stamp = ToRos(stamp);
  m.child_frame_id = child;
  m.transform.translation = ToVector3(pose.p);
  m.transform.rotation.x = pose.q.x();
  m.transform.rotation.y = pose.q.y();
  m.transform.rotation.z = pose.q.z();
  m.transform.rotation.w = pose.q.w();
  return m;
}

Pose Turned(double x, double y, double z, double angle, const Eigen::Vector3d& axis) {
  return {Eigen::Vector3d(x, y, z),
          Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis.normalized()))};
}

/// Of the body in the world.
Pose BodyAt(int i) {
  return Turned(std::sin(0.05 * i), 0.01 * i, 1.0 + 0.2 * std::cos(0.03 * i), 0.02 * i,
                {0.3, -0.2, 1.0});
}

const Pose kMapOdom = Turned(3.0, -2.0, 0.1, 0.7, {0.0, 0.0, 1.0});
const Pose kBodyCamera = Turned(0.1, 0.02, -0.03, 1.1, {1.0, 1.0, 0.0});

Stamp StampAt(int i) { return kStart + 10000003 * static_cast<Stamp>(i); }

void ExpectPose(const OdometrySample& sample, const Pose& pose) {
  EXPECT_LT((sample.p_WS - pose.p).norm(), 1e-12);
  EXPECT_LT(sample.q_WS.angularDistance(pose.q), 1e-7);
}

TEST(TfOdometry, IsTheTransformAtItsStamps) {
  TfOdometry tf("world", "base_link");
  for (int i = 0; i < 100; ++i) {
    const auto poses = tf.Add({Transform("/world", "/base_link", StampAt(i), BodyAt(i))}, false);
    ASSERT_EQ(poses.size(), 1u);
    EXPECT_EQ(poses[0].sample.stamp, StampAt(i));
    ExpectPose(poses[0].sample, BodyAt(i));
    EXPECT_TRUE(poses[0].is_pose);
    EXPECT_EQ(poses[0].frame_id, "world");
    EXPECT_FALSE(poses[0].linear);
  }
}

TEST(TfOdometry, DropsWhatComesAgain) {
  TfOdometry tf("world", "base_link");
  const auto one = Transform("world", "base_link", StampAt(3), BodyAt(3));
  EXPECT_EQ(tf.Add({one, one}, false).size(), 1u);
  EXPECT_TRUE(tf.Add({one}, false).empty());
  EXPECT_TRUE(tf.Add({Transform("world", "base_link", StampAt(2), BodyAt(2))}, false).empty());
  EXPECT_EQ(tf.repeated(), 3);
}

// map -> odom static, odom -> base_link moves, base_link -> camera static; other branches beside.
TEST(TfOdometry, LeadsOverFramesBetween) {
  TfOdometry tf("map", "camera");
  EXPECT_TRUE(tf.Add({Transform("map", "odom", 0, kMapOdom),
                      Transform("base_link", "camera", 0, kBodyCamera)},
                     true)
                  .empty());
  for (int i = 0; i < 50; ++i) {
    EXPECT_TRUE(
        tf.Add({Transform("base_link", "gimbal", StampAt(i) + kMs, BodyAt(i))}, false).empty());
    const auto poses = tf.Add({Transform("odom", "base_link", StampAt(i), BodyAt(i))}, false);
    ASSERT_EQ(poses.size(), 1u);
    ExpectPose(poses[0].sample, kMapOdom * BodyAt(i) * kBodyCamera);
  }
}

// A filter corrects map -> odom at 10 Hz; the body's link is waited for until both are known.
TEST(TfOdometry, TakesLinksAboveAtTheStampOfTheBody) {
  TfOdometry tf("map", "base_link");
  const auto map_odom = [](Stamp stamp) {
    return Turned(0.5 * ToSeconds(stamp - kStart), 0.0, 0.0, 0.0, {0.0, 0.0, 1.0});
  };
  std::vector<OdometryInput> poses;
  const auto take = [&](const std::vector<OdometryInput>& ready) {
    poses.insert(poses.end(), ready.begin(), ready.end());
  };
  for (int i = 0; i < 100; ++i) {
    const Stamp stamp = kStart + i * 10 * kMs;
    if (i % 10 == 0) take(tf.Add({Transform("map", "odom", stamp, map_odom(stamp))}, false));
    take(tf.Add({Transform("odom", "base_link", stamp, BodyAt(i))}, false));
  }
  ASSERT_EQ(poses.size(), 91u) << "the last nine wait";
  for (size_t i = 0; i < poses.size(); ++i) {
    const Stamp stamp = kStart + static_cast<Stamp>(i) * 10 * kMs;
    EXPECT_EQ(poses[i].sample.stamp, stamp);
    ExpectPose(poses[i].sample, map_odom(stamp) * BodyAt(static_cast<int>(i)));
  }
  for (int i = 100; i < 200; ++i) {
    take(tf.Add({Transform("odom", "base_link", kStart + i * 10 * kMs, BodyAt(i))}, false));
  }
  EXPECT_EQ(poses.size(), 91u);
  EXPECT_GT(tf.unmatched(), 50) << "waited for no longer than half a second";
}

// Some sources publish the world in the body.
TEST(TfOdometry, LeadsBackwards) {
  TfOdometry tf("odom", "base_link");
  for (int i = 0; i < 20; ++i) {
    const auto poses =
        tf.Add({Transform("base_link", "odom", StampAt(i), BodyAt(i).Inverse())}, false);
    ASSERT_EQ(poses.size(), 1u);
    ExpectPose(poses[0].sample, BodyAt(i));
  }
}

TEST(TfOdometry, BeginsAnewWithTheClock) {
  TfOdometry tf("map", "base_link");
  tf.Add({Transform("map", "odom", 0, kMapOdom)}, true);
  for (int i = 0; i < 200; ++i) {
    tf.Add({Transform("odom", "base_link", StampAt(i), BodyAt(i))}, false);
  }
  const auto poses = tf.Add({Transform("odom", "base_link", kStart, BodyAt(7))}, false);
  ASSERT_EQ(poses.size(), 1u);
  EXPECT_EQ(poses[0].sample.stamp, kStart);
  ExpectPose(poses[0].sample, kMapOdom * BodyAt(7));
}

TEST(TfOdometry, SaysWhatIsMissing) {
  TfOdometry tf("map", "base_link");
  EXPECT_EQ(tf.Describe(), "tf does not lead from map to base_link; it has nothing");
  EXPECT_TRUE(tf.Add({Transform("odom", "base_link", StampAt(1), BodyAt(1))}, false).empty());
  EXPECT_EQ(tf.Describe(), "tf does not lead from map to base_link; it has odom -> base_link");
}

TEST(TfOdometry, RefusesWhatIsNoTransform) {
  TfOdometry tf("map", "base_link");
  auto m = Transform("map", "base_link", StampAt(1), BodyAt(1));
  m.transform.rotation.w = std::nan("");
  EXPECT_TRUE(tf.Add({m}, false).empty());
  m = Transform("map", "base_link", 0, BodyAt(1));
  EXPECT_TRUE(tf.Add({m}, false).empty()) << "no stamp";
  m = Transform("base_link", "base_link", StampAt(1), BodyAt(1));
  EXPECT_TRUE(tf.Add({m}, false).empty());
  EXPECT_EQ(tf.Add({Transform("map", "base_link", StampAt(2), BodyAt(2))}, false).size(), 1u);
}

// ---- Bags --------------------------------------------------------------------------------------

class TfBag : public ::testing::Test {
 protected:
  std::string File() const { return folder_.File("tf.bag"); }

  /// A flight with odometry, and the same as tf: map -> odom -> base_link -> camera.
  void Write() const {
    FlightLog log;
    for (int i = 0; i < 200; ++i) {
      const Pose pose = kMapOdom * BodyAt(i) * kBodyCamera;
      OdometrySample sample;
      sample.stamp = StampAt(i);
      sample.p_WS = pose.p;
      sample.q_WS = pose.q;
      sample.v_WS = Eigen::Vector3d(0.1 * i, 0.0, 0.0);
      log.odometry.push_back(sample);
      log.rotors.push_back({sample.stamp, RotorVector::Constant(4, 700.0)});
    }
    WriteFlightBag(log, File());
    rosbag::Bag bag(File(), rosbag::bagmode::Append);
    tf2_msgs::TFMessage m;
    for (int i = 0; i < 200; ++i) {
      m.transforms = {Transform("odom", "base_link", StampAt(i), BodyAt(i)),
                      Transform("base_link", "gimbal", StampAt(i), BodyAt(i))};
      bag.write("/tf", ToRos(StampAt(i)), m);
      bag.write("/tf", ToRos(StampAt(i) + 1), m);  // a second publisher says the same
    }
    // Recorded after the rest: it holds always.
    m.transforms = {Transform("map", "odom", 0, kMapOdom),
                    Transform("base_link", "camera", 0, kBodyCamera)};
    bag.write("/tf_static", ToRos(StampAt(199)), m);
    bag.close();
  }

  static BagOptions Frames(const std::string& parent, const std::string& child) {
    BagOptions options;
    options.odometry_tf_parent = parent;
    options.odometry_tf_child = child;
    return options;
  }

  testing_support::TemporaryFolder folder_;
};

TEST_F(TfBag, EqualsTheOdometry) {
  Write();
  const FlightLog odometry = ReadFlightBag(File(), 4, {});
  const FlightLog tf = ReadFlightBag(File(), 4, Frames("map", "camera"));
  ASSERT_EQ(tf.odometry.size(), odometry.odometry.size());
  for (size_t i = 0; i < tf.odometry.size(); ++i) {
    const OdometrySample &a = tf.odometry[i], &b = odometry.odometry[i];
    EXPECT_EQ(a.stamp, b.stamp);
    EXPECT_LT((a.p_WS - b.p_WS).norm(), 1e-12);
    EXPECT_LT(a.q_WS.angularDistance(b.q_WS), 1e-7);
    EXPECT_FALSE(a.v_WS) << "tf has no velocity";
  }
  EXPECT_EQ(tf.rotors.size(), odometry.rotors.size());
  EXPECT_EQ(tf.dropped, 0) << "repeated transforms are no loss";
}

TEST_F(TfBag, SaysWhatIsWrong) {
  Write();
  ODMC_EXPECT_ERROR(ReadFlightBag(File(), 4, Frames("world", "base_link")),
                    "tf.bag: tf does not lead from world to base_link; it has odom -> base_link, "
                    "base_link -> camera");
  ODMC_EXPECT_ERROR(ReadFlightBag(File(), 4, Frames("world", "")), "odometry_tf_child is missing");
  ODMC_EXPECT_ERROR(ReadFlightBag(File(), 4, Frames("map", "map")), "are the same frame, map");
  BagOptions both = Frames("map", "base_link");
  both.topics["odometry"] = "/odometry";
  ODMC_EXPECT_ERROR(ReadFlightBag(File(), 4, both), "--topic odometry is not read");
}

}  // namespace
}  // namespace odmc
