#!/usr/bin/env python3
"""Six seconds on the ground, then take-off to hover."""

import sys

import rospy
import rostest

import flight_harness
import node_harness

GROUND_S = 6.0
STANDS_M = 0.01
IDLE_RAD_S = 400.0  # 1164 rad/s at hover


class StartOnGroundTest(flight_harness.FlightTest):
    def test_idles_learns_nothing_and_takes_off(self):
        self.fly("trajectory:=hover", "ground_s:=%.1f" % GROUND_S, also=("rotors",))
        self.wait_until_s(GROUND_S)  # the clock starts at 1 s
        self.check_ground()
        self.wait_until_s(GROUND_S + 1.5)
        self.wait_until_s(self.take_off_s() + 6.0)

        self.check_finite()
        self.check_no_failsafe()
        self.assertLess(max(self.errors(self.take_off_s() + 5.0)), 0.15)
        self.assertGreater(self.last("truth").pose.pose.position.z, 0.5)
        self.assertEqual(self.last("status").mode, "tracking")
        self.assertTrue(self.last("parameters").airborne)

    def check_ground(self):
        heights = [m.pose.pose.position.z for m in self.topics["truth"].messages]
        self.assertLess(max(abs(z) for z in heights), STANDS_M)
        for name in ("command", "rotors"):
            fastest = max(max(m.angular_velocity_rad_s) for m in self.topics[name].messages)
            self.assertLess(fastest, IDLE_RAD_S, name)
        modes = {m.mode for m in self.topics["status"].messages}
        self.assertEqual(modes, {"idle"})
        for message in self.topics["parameters"].messages:
            self.assertFalse(message.airborne)
        self.assertEqual(len(self.topics["accepted"]), 0)
        _, _, values = node_harness.last_status(self.diagnostics, "/estimator")
        self.assertEqual(values["keyframes"], "0", values)
        self.assertGreater(int(values["ground_keyframes"]), 100, values)


if __name__ == "__main__":
    rospy.init_node("start_on_ground_test", disable_rostime=True)
    rostest.rosrun("odmc", "start_on_ground_test", StartOnGroundTest, sys.argv)
