#!/usr/bin/env python3
"""Rotor speeds that are stamped 40 ms late: the running node finds it, takes it off, says so, and
learns anew."""

import sys

import rospy
import rostest

import node_harness
from odmc.msg import DynamicParameters

SECONDS = 36
CHECKED = ("thrust.k_f", "drag.d_x", "drag.d_y", "drag.d_z")


class LateRotorsTest(node_harness.NodeTest):
    def test_the_offset_is_found_and_taken_off(self):
        bag, expected = self.make_bag(SECONDS, "late_rotors")
        parameters = node_harness.Collector("/parameters", DynamicParameters)
        diagnostics = node_harness.diagnostics()
        launch = self.start(
            "roslaunch", "odmc", "replay.launch", "bag:=" + bag, "bag_rate:=2",
            "vehicle_file:=" + node_harness.VEHICLE, "config:=" + node_harness.CONFIG,
            "output_dir:=" + self.folder)
        launch.wait(timeout=60)
        self.check_parameters(parameters.messages)
        _, _, values = node_harness.last_status(diagnostics, "/estimator")
        print("diagnostics: %s" % values["findings"])
        late_s = float(values["rotor_speeds_late_s"])
        self.assertLess(abs(late_s - expected["late_s"]), 0.01)
        self.assertIn("rotor speeds are stamped", values["findings"])
        self.assertEqual(parameters.last.trust, "good")
        last = node_harness.by_name(parameters.last)
        for name in CHECKED:
            error = last[name].value - expected["truth"][name]
            print("%-12s %.5g +- %.2g, off by %.5g" % (name, last[name].value, last[name].sigma,
                                                       error))
            self.assertLess(abs(error), 3.0 * last[name].sigma +
                            0.05 * abs(expected["truth"][name]), name)


if __name__ == "__main__":
    rospy.init_node("late_rotors_test", disable_rostime=True)
    rostest.rosrun("odmc", "late_rotors_test", LateRotorsTest, sys.argv)
