#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>

#include "odmc/ros/displays.h"
#include "odmc/ros/message_values.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

using visualization_msgs::Marker;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const DisplayScene kScene = {"map", "base_link", "flying", "accepted"};

/// A quadrotor that heads along world y, its odometry's sensor off its origin.
class Displays : public ::testing::Test {
 protected:
  Displays() : vehicle_(test::NominalVehicle()), model_(vehicle_, vehicle_.effects) {
    const auto n = static_cast<size_t>(model_.num_parameters());
    snapshot_.stamp = 5000000000;
    snapshot_.airborne = true;
    snapshot_.values = DefaultTruth(model_);
    snapshot_.sigma = Eigen::VectorXd::Constant(model_.num_parameters(), 0.25);
    snapshot_.observable.assign(n, true);
    snapshot_.body = model_.Properties(snapshot_.values);
    snapshot_.body.p_BBcm = Eigen::Vector3d(0.01, -0.02, 0.005);
    snapshot_.state.q_WS = Eigen::Quaterniond(std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5));
    snapshot_.state.p_WS = Eigen::Vector3d(1.0, 2.0, 3.0);
    snapshot_.state.v_WS = Eigen::Vector3d(0.5, 4.0, -1.0);
    snapshot_.state.w_WS_S.setZero();
    snapshot_.residual_force_B = Eigen::Vector3d(0.3, 0.0, -0.4);
    snapshot_.residual_torque_B = Eigen::Vector3d(0.0, 0.01, 0.0);
  }

  /// Markers by namespace; of the vehicle, its arms.
  std::map<std::string, Marker> ByName() const {
    std::map<std::string, Marker> markers;
    for (const Marker& m : DisplayMarkers(model_, snapshot_, kScene).markers) {
      if (m.id == 0) {
        EXPECT_TRUE(markers.emplace(m.ns, m).second) << m.ns << " twice";
      }
      EXPECT_EQ(m.header.stamp, ros::Time(5.0));
      EXPECT_EQ(m.pose.orientation.w, 1.0) << "RViz asks for a rotation";
    }
    return markers;
  }

  /// Where the body is: not the sensor, which the state is of.
  Eigen::Vector3d BodyPosition() const {
    const Eigen::Matrix3d R_WB =
        snapshot_.state.q_WS.toRotationMatrix() * snapshot_.body.R_BS.transpose();
    return snapshot_.state.p_WS - R_WB * snapshot_.body.p_BS;
  }

  static void ExpectPoint(const geometry_msgs::Point& m, const Eigen::Vector3d& p) {
    EXPECT_LT((ToEigen(m) - p).norm(), 1e-12)
        << ToEigen(m).transpose() << " is not " << p.transpose();
  }

  Vehicle vehicle_;
  DynamicModel model_;
  Snapshot snapshot_;
};

TEST_F(Displays, ShowTheWrenchInTheBodyFrame) {
  const auto markers = ByName();
  const double arm = vehicle_.ArmLength(), weight_N = 0.75 * 9.81;
  for (const char* name : {"residual_force", "residual_torque", "centre_of_gravity", "vehicle"}) {
    EXPECT_EQ(markers.at(name).header.frame_id, "base_link") << name;
    EXPECT_EQ(markers.at(name).action, Marker::ADD) << name;
  }
  const Marker& force = markers.at("residual_force");
  ASSERT_EQ(force.points.size(), 2u);
  ExpectPoint(force.points[0], snapshot_.body.p_BBcm);
  // A twentieth of the weight is an arm long.
  ExpectPoint(force.points[1],
              snapshot_.body.p_BBcm + arm / (0.05 * weight_N) * Eigen::Vector3d(0.3, 0.0, -0.4));
  const Marker& torque = markers.at("residual_torque");
  ASSERT_EQ(torque.points.size(), 2u);
  ExpectPoint(torque.points[1], snapshot_.body.p_BBcm + arm / (0.001 * weight_N * arm) *
                                                            Eigen::Vector3d(0.0, 0.01, 0.0));
  ExpectPoint(markers.at("centre_of_gravity").pose.position, snapshot_.body.p_BBcm);
}

TEST_F(Displays, ShowMotionAndPhaseInTheWorld) {
  snapshot_.body.wind_W = Eigen::Vector3d(0.0, 2.0, 0.0);
  const auto markers = ByName();
  for (const char* name : {"velocity", "wind", "phase"}) {
    EXPECT_EQ(markers.at(name).header.frame_id, "map") << name;
  }
  const Marker& velocity = markers.at("velocity");
  ASSERT_EQ(velocity.points.size(), 2u);
  ExpectPoint(velocity.points[0], BodyPosition());
  ExpectPoint(velocity.points[1], BodyPosition() + 0.1 * Eigen::Vector3d(0.5, 4.0, -1.0));
  const Marker& wind = markers.at("wind");
  ASSERT_EQ(wind.points.size(), 2u);
  EXPECT_LT((ToEigen(wind.points[1]) - ToEigen(wind.points[0]) - Eigen::Vector3d(0, 0.2, 0)).norm(),
            1e-12);
  EXPECT_EQ(markers.at("phase").text, "flying, accepted");
  EXPECT_GT(markers.at("phase").pose.position.z, BodyPosition().z());
}

TEST_F(Displays, HaveADiscForEveryRotor) {
  int discs = 0;
  for (const Marker& m : DisplayMarkers(model_, snapshot_, kScene).markers) {
    if (m.ns != "vehicle" || m.id == 0) continue;
    const Rotor& rotor = vehicle_.rotors.at(static_cast<size_t>(m.id) - 1);
    ExpectPoint(m.pose.position, rotor.p_BP);
    EXPECT_EQ(m.color.r > m.color.b, rotor.spin > 0.0) << "red: clockwise from above";
    EXPECT_DOUBLE_EQ(m.scale.x, 2.0 * rotor.radius_m);
    ++discs;
  }
  EXPECT_EQ(discs, 4);
}

TEST_F(Displays, TakeAwayWhatIsNotThere) {
  snapshot_.body.wind_W.setZero();
  snapshot_.residual_force_B = Eigen::Vector3d(kNan, 0.0, 0.0);
  snapshot_.body.p_BBcm.z() = std::numeric_limits<double>::infinity();
  snapshot_.state.v_WS.setZero();
  const auto markers = ByName();
  for (const char* name :
       {"wind", "residual_force", "residual_torque", "centre_of_gravity", "velocity"}) {
    EXPECT_EQ(markers.at(name).action, Marker::DELETE) << name;
    EXPECT_TRUE(markers.at(name).points.empty()) << name;
    EXPECT_TRUE(ToEigen(markers.at(name).pose.position).allFinite()) << name;
  }
}

TEST_F(Displays, PlotEveryParameterByName) {
  snapshot_.observable[1] = false;
  const sensor_msgs::JointState m = PlottedEstimates(model_, snapshot_, "base_link");
  const auto n = static_cast<size_t>(model_.num_parameters());
  ASSERT_EQ(m.name.size(), n);
  // PlotJuggler leaves out arrays of another length.
  ASSERT_EQ(m.position.size(), n);
  ASSERT_EQ(m.velocity.size(), n);
  ASSERT_EQ(m.effort.size(), n);
  for (size_t i = 0; i < n; ++i) {
    EXPECT_EQ(m.name[i], model_.parameters()[i].full_name);
    EXPECT_EQ(m.position[i], snapshot_.values[static_cast<Eigen::Index>(i)]);
    EXPECT_EQ(m.velocity[i], 0.25);
    EXPECT_EQ(m.effort[i], i == 1 ? 0.0 : 1.0);
  }
  EXPECT_EQ(m.header.frame_id, "base_link");
  EXPECT_EQ(m.header.stamp, ros::Time(5.0));
}

TEST_F(Displays, LeaveOutEstimatesThatAreNotFinite) {
  snapshot_.values[0] = kNan;
  snapshot_.sigma[2] = std::numeric_limits<double>::infinity();
  const sensor_msgs::JointState m = PlottedEstimates(model_, snapshot_, "base_link");
  ASSERT_EQ(m.name.size(), static_cast<size_t>(model_.num_parameters()) - 2);
  EXPECT_EQ(m.name[0], model_.parameters()[1].full_name);
  EXPECT_EQ(m.name[1], model_.parameters()[3].full_name);
  for (size_t i = 0; i < m.name.size(); ++i) {
    EXPECT_TRUE(std::isfinite(m.position[i]) && std::isfinite(m.velocity[i]));
  }
}

TEST(PlotTopic, IsANameOfRos) {
  EXPECT_EQ(PlotTopic("thrust.k_f"), "thrust/k_f");
  EXPECT_EQ(PlotTopic("a b.c-d"), "a_b/c_d");
}

TEST_F(Displays, PathKeepsTheNewestPosesOfTheBody) {
  PathTrail trail(10.0, 0.1);
  EXPECT_TRUE(trail.Message("map").poses.empty());
  for (int i = 0; i < 2000; ++i) {
    snapshot_.stamp = 1000000000 + 10000000 * static_cast<Stamp>(i);  // 20 s at 100 Hz
    snapshot_.state.p_WS.x() = 0.01 * i;
    trail.Add(snapshot_);
  }
  const nav_msgs::Path path = trail.Message("map");
  EXPECT_EQ(path.poses.size(), 101u);
  EXPECT_EQ(path.header.frame_id, "map");
  snapshot_.state.p_WS.x() = 19.9;
  ExpectPoint(path.poses.back().pose.position, BodyPosition());
  for (const auto& pose : path.poses) EXPECT_EQ(pose.header.frame_id, "map");
  snapshot_.stamp = 2000000000;
  trail.Add(snapshot_);
  EXPECT_EQ(trail.Message("map").poses.size(), 1u) << "the clock stepped back";
  snapshot_.stamp = 3000000000;
  snapshot_.state.p_WS.x() = kNan;
  trail.Add(snapshot_);
  EXPECT_EQ(trail.Message("map").poses.size(), 1u);
}

}  // namespace
}  // namespace odmc
