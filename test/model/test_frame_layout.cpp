#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>

#include "odmc/model/frame_layout.h"

namespace odmc {
namespace test {
namespace {

constexpr Autopilot kAll[] = {Autopilot::kPx4, Autopilot::kArduPilot, Autopilot::kBetaflight};

std::vector<Rotor> UnitRotors(const std::string& frame, Autopilot autopilot) {
  return RotorsAt(FrameLayout(frame, autopilot), 1.0, 1.0, 0.1);
}

/// "front left cw, ..." in the order of the motor numbers.
std::string Words(const std::string& frame, Autopilot autopilot) {
  std::string text;
  for (const FramePlace& place : FrameLayout(frame, autopilot)) {
    text += (text.empty() ? "" : "; ") + place.name + (place.spin > 0.0 ? " cw" : " ccw");
  }
  return text;
}

// As the autopilots' own pages draw them.
TEST(FrameLayout, NumbersAreTheAutopilots) {
  EXPECT_EQ(Words("quad_x", Autopilot::kPx4),
            "front right ccw; rear left ccw; front left cw; rear right cw");
  EXPECT_EQ(Words("quad_x", Autopilot::kArduPilot), Words("quad_x", Autopilot::kPx4));
  EXPECT_EQ(Words("quad_x", Autopilot::kBetaflight),
            "rear right cw; front right ccw; rear left ccw; front left cw");
  EXPECT_EQ(Words("quad_plus", Autopilot::kPx4), "right ccw; left ccw; front cw; rear cw");
  EXPECT_EQ(Words("quad_plus", Autopilot::kBetaflight), "rear cw; right ccw; left ccw; front cw");
  EXPECT_EQ(Words("hexa_x", Autopilot::kPx4),
            "right cw; left ccw; front left cw; rear right ccw; front right ccw; rear left cw");
  EXPECT_EQ(Words("hexa_x", Autopilot::kBetaflight),
            "rear right ccw; front right ccw; rear left cw; front left cw; right cw; left ccw");
  EXPECT_EQ(Words("hexa_plus", Autopilot::kArduPilot),
            "front cw; rear ccw; rear left cw; front right ccw; front left ccw; rear right cw");
  EXPECT_EQ(Words("hexa_plus", Autopilot::kBetaflight),
            "rear right ccw; front right cw; rear left ccw; front left cw; front ccw; rear cw");
  EXPECT_EQ(
      Words("octo_x", Autopilot::kPx4),
      "front right cw; rear left cw; right front ccw; rear right ccw; front left ccw; left rear "
      "ccw; left front cw; right rear cw");
  EXPECT_EQ(Words("octo_x", Autopilot::kBetaflight),
            "left front ccw; front right ccw; right rear ccw; rear left ccw; front left cw; right "
            "front cw; rear right cw; left rear cw");
  EXPECT_EQ(
      Words("octo_plus", Autopilot::kArduPilot),
      "front cw; rear cw; front right ccw; rear right ccw; front left ccw; rear left ccw; left "
      "cw; right cw");
  EXPECT_EQ(
      Words("octo_plus", Autopilot::kBetaflight),
      "front left ccw; front right ccw; rear right ccw; rear left ccw; front cw; right cw; rear "
      "cw; left cw");
  EXPECT_EQ(Words("y6", Autopilot::kPx4),
            "front right, upper cw; front right, lower ccw; rear, upper cw; rear, lower ccw; front "
            "left, upper cw; front left, lower ccw");
  EXPECT_EQ(Words("y6", Autopilot::kArduPilot),
            "front right, lower ccw; front left, upper cw; front left, lower ccw; rear, lower cw; "
            "front right, upper cw; rear, upper ccw");
  EXPECT_EQ(Words("y6", Autopilot::kBetaflight),
            "rear, upper ccw; front right, upper cw; front left, upper cw; rear, lower cw; front "
            "right, lower ccw; front left, lower ccw");
}

// A name is where the direction points: x forward, y left.
TEST(FrameLayout, DirectionsAreTheNames) {
  for (const std::string& frame : FrameNames()) {
    for (const Autopilot autopilot : kAll) {
      for (const FramePlace& place : FrameLayout(frame, autopilot)) {
        const auto has = [&](const char* word) {
          return place.name.find(word) != std::string::npos;
        };
        EXPECT_EQ(has("front"), place.direction.x() > 1e-6) << frame << place.name;
        EXPECT_EQ(has("rear"), place.direction.x() < -1e-6) << frame << place.name;
        EXPECT_EQ(has("left"), place.direction.y() > 1e-6) << frame << place.name;
        EXPECT_EQ(has("right"), place.direction.y() < -1e-6) << frame << place.name;
        EXPECT_EQ(has("upper"), place.direction.z() > 0.0) << frame << place.name;
        EXPECT_NEAR(place.direction.head<2>().norm(), 1.0, 1e-8);
      }
    }
  }
}

// Autopilots number the same vehicle: places and, but for Betaflight's mirrored ones, spins agree.
TEST(FrameLayout, AutopilotsDescribeOneFrame) {
  for (const std::string& frame : FrameNames()) {
    std::set<std::string> places, others;
    for (const FramePlace& place : FrameLayout(frame, Autopilot::kPx4)) places.insert(place.name);
    for (const Autopilot autopilot : kAll) {
      others.clear();
      for (const FramePlace& place : FrameLayout(frame, autopilot)) others.insert(place.name);
      EXPECT_EQ(places, others) << frame;
      EXPECT_EQ(others.size(), FrameLayout(frame, autopilot).size()) << frame;
    }
  }
}

// Whatever the numbers: thrusts and reaction torques balance, neighbours turn against each other.
TEST(FrameLayout, FramesHoverWithEqualSpeeds) {
  for (const std::string& frame : FrameNames()) {
    for (const Autopilot autopilot : kAll) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      std::map<double, double> by_angle;
      double spins = 0.0;
      for (const FramePlace& place : FrameLayout(frame, autopilot)) {
        sum += place.direction;
        spins += place.spin;
        by_angle[std::atan2(place.direction.y(), place.direction.x())] += place.spin;
      }
      EXPECT_LT(sum.head<2>().norm(), 1e-8) << frame;
      EXPECT_EQ(spins, 0.0) << frame;
      if (frame == "y6") {
        for (const auto& [angle, pair] : by_angle) EXPECT_EQ(pair, 0.0) << angle;
        continue;
      }
      double before = by_angle.rbegin()->second;
      for (const auto& [angle, spin] : by_angle) {
        EXPECT_EQ(spin, -before) << frame << " at " << angle;
        before = spin;
      }
    }
  }
}

TEST(FrameLayout, RotorsReachTheHalves) {
  for (const std::string& frame : FrameNames()) {
    const std::vector<Rotor> rotors = RotorsAt(FrameLayout(frame, Autopilot::kPx4), 0.2, 0.3, 0.05);
    Eigen::Vector3d most = Eigen::Vector3d::Zero();
    for (const Rotor& rotor : rotors) {
      most = most.cwiseMax(rotor.p_BP.cwiseAbs());
      EXPECT_EQ(rotor.radius_m, 0.05);
    }
    EXPECT_NEAR(most.x(), 0.2, 1e-9) << frame;
    EXPECT_NEAR(most.y(), 0.3, 1e-9) << frame;
  }
}

TEST(FrameLayout, FramesAreFoundByTheirRotors) {
  EXPECT_EQ(FramesOf(4), (std::vector<std::string>{"quad_x", "quad_plus"}));
  EXPECT_EQ(FramesOf(6), (std::vector<std::string>{"hexa_x", "hexa_plus", "y6"}));
  EXPECT_EQ(FramesOf(8), (std::vector<std::string>{"octo_x", "octo_plus"}));
  EXPECT_TRUE(FramesOf(5).empty());
}

TEST(FrameLayout, UnknownFramesAreRefused) {
  try {
    FrameLayout("quad_y", Autopilot::kPx4);
    FAIL();
  } catch (const std::invalid_argument& e) {
    EXPECT_NE(std::string(e.what()).find("'quad_y'; there are quad_x, quad_plus"),
              std::string::npos);
  }
}

// A flat frame and its mirror image; a Y6 may have each of its pairs either way round.
TEST(FrameLayout, UsualSpinsAreThoseThatAreBuilt) {
  const std::vector<unsigned> quad = UsualSpins(UnitRotors("quad_x", Autopilot::kPx4));
  EXPECT_EQ(quad, (std::vector<unsigned>{0b1100U, 0b0011U}));
  const std::vector<unsigned> y6 = UsualSpins(UnitRotors("y6", Autopilot::kPx4));
  EXPECT_EQ(y6.size(), 8u);
  for (const unsigned pattern : y6) {
    for (int pair = 0; pair < 3; ++pair) {
      const unsigned both = pattern >> (2 * pair) & 3U;
      EXPECT_TRUE(both == 1U || both == 2U) << pattern;
    }
  }
}

TEST(FrameLayout, CoaxialRotorsAreAboveEachOther) {
  const std::vector<Rotor> y6 = UnitRotors("y6", Autopilot::kPx4);
  EXPECT_TRUE(IsCoaxial(y6[0], y6[1]));
  EXPECT_FALSE(IsCoaxial(y6[0], y6[2]));
}

}  // namespace
}  // namespace test
}  // namespace odmc
