#!/usr/bin/env python3
"""The clock steps back: the same bag twice."""

import sys

import rospy
import rostest

import node_harness
from odmc.msg import DynamicParameters


class TimeResetTest(node_harness.NodeTest):
    def test_restart_keeps_parameters_and_stop_stops(self):
        bag, expected = self.make_bag(8)
        collectors = {
            name: node_harness.Collector("/%s/parameters" % name, DynamicParameters)
            for name in ("restarts", "stops")}
        diagnostics = node_harness.diagnostics()
        rate = "_keyframe_rate_hz:=40"
        self.start_node("restarting", "__ns:=restarts", "odometry:=/odometry", "imu:=/imu",
                        "rotor_speeds:=/rotor_speeds", rate)
        self.start_node("stopping", "__ns:=stops", "odometry:=/odometry", "imu:=/imu",
                        "rotor_speeds:=/rotor_speeds", "_on_time_reset:=stop", rate)
        for name in collectors:
            self.wait_for_node("/%s/parameters" % name)
        self.play(bag, rate=2.0)
        node_harness.wait_until(lambda: False, 1.5)
        first = {name: collector.last for name, collector in collectors.items()}
        counts = {name: len(collector) for name, collector in collectors.items()}
        self.play(bag, rate=2.0)
        node_harness.wait_until(lambda: False, 2.5)

        for collector in collectors.values():
            self.check_parameters(collector.messages)
        self.check_restarted(collectors["restarts"], counts["restarts"], first["restarts"],
                             expected["truth"])
        level, message, values = node_harness.last_status(diagnostics, "/restarts/restarting")
        self.assertEqual(values["clock_resets"], "1", values)
        self.assertEqual(values["not_finite_estimates"], "0")

        self.assertLessEqual(len(collectors["stops"]), counts["stops"] + 1)
        status = node_harness.last_status(diagnostics, "/stops/stopping")
        self.assertEqual(node_harness.level(status), 2, status)
        self.assertIn("stepped back", status[1])

    def check_restarted(self, collector, count, before, truth):
        self.assertGreater(len(collector), count + 20, "nothing after the clock stepped back")
        again = collector.messages[count + 2]
        k_f_before = node_harness.by_name(before)["thrust.k_f"]
        k_f_again = node_harness.by_name(again)["thrust.k_f"]
        # Not the start value of the file: what was learned stays.
        self.assertLess(abs(k_f_again.value - k_f_before.value), 0.02 * k_f_before.value)
        last = node_harness.by_name(collector.last)["thrust.k_f"]
        self.assertLess(abs(last.value - truth["thrust.k_f"]), 0.02 * truth["thrust.k_f"])
        self.assertLess(last.sigma, k_f_before.sigma)


if __name__ == "__main__":
    rospy.init_node("time_reset_test", disable_rostime=True)
    rostest.rosrun("odmc", "time_reset_test", TimeResetTest, sys.argv)
