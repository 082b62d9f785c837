#!/usr/bin/env python3
"""Odometry with its velocity in the body, in the world, in neither; the messages declare wrongly."""

import sys

import rospy
import rostest

import node_harness
from odmc.msg import DynamicParameters

KINDS = ("in_body", "in_world", "in_neither")


class TwistFrameTest(node_harness.NodeTest):
    def test_frame_is_found_from_the_motion(self):
        bag, expected = self.make_bag(10, "frames")
        diagnostics = node_harness.diagnostics()
        collectors, nodes = {}, {}
        for kind in KINDS:
            topic = "/%s/parameters" % kind
            collectors[kind] = node_harness.Collector(topic, DynamicParameters)
            nodes[kind] = self.start_node("estimator", "__ns:=" + kind,
                                          "rotor_speeds:=/rotor_speeds", "_keyframe_rate_hz:=40")
            self.wait_for_node(topic)
        self.play(bag, rate=1.5)
        node_harness.wait_until(lambda: False, 2.5)

        for kind in ("in_body", "in_world"):
            self.check_parameters(collectors[kind].messages)
            status = node_harness.last_status(diagnostics, "/%s/estimator" % kind)
            self.assertTrue(status[2]["twist_frame"].startswith(kind[3:]), status)
            self.check_truth(collectors[kind].last, expected["truth"])
            # What waited for the decision was not lost: the first second is estimated, too.
            self.assertGreater(int(status[2]["keyframes"]), 0.95 * 10 * 40, status)
        status = node_harness.last_status(diagnostics, "/in_neither/estimator")
        self.assertEqual(node_harness.level(status), 2, status)
        self.assertIn("fits neither frame", status[1])
        self.assertEqual(len(collectors["in_neither"]), 0)
        self.assertIsNone(nodes["in_neither"].poll(), "the node is to stay and say why")

    def check_truth(self, message, truth):
        parameters = node_harness.by_name(message)
        for name, share in (("thrust.k_f", 0.02), ("drag.d_x", 0.15), ("drag.d_y", 0.15)):
            limit = 3.0 * parameters[name].sigma + share * abs(truth[name])
            self.assertLess(abs(parameters[name].value - truth[name]), limit, name)


if __name__ == "__main__":
    rospy.init_node("twist_frame_test", disable_rostime=True)
    rostest.rosrun("odmc", "twist_frame_test", TwistFrameTest, sys.argv)
