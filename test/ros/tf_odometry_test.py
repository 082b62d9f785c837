#!/usr/bin/env python3
"""Odometry from tf, live: the same parameters as from a topic of the same poses; and what the node
says where the frames do not hang together. Stamps that each ESC has of its own, live."""

import sys

import rospy
import rostest

import node_harness
from node_harness import last_status, wait_until
from odmc.msg import DynamicParameters

SECONDS = 12


class TfOdometryTest(node_harness.NodeTest):
    def replay(self, kind, *arguments):
        bag, expected = self.make_bag(SECONDS, kind)
        self.parameters = node_harness.Collector("/parameters", DynamicParameters)
        self.diagnostics = node_harness.diagnostics()
        launch = self.start(
            "roslaunch", "odmc", "replay.launch", "bag:=" + bag, "bag_rate:=2",
            "vehicle_file:=" + node_harness.VEHICLE, "config:=" + node_harness.CONFIG,
            "output_dir:=" + self.folder, *arguments)
        launch.wait(timeout=40)
        self.check_parameters(self.parameters.messages)
        return expected

    def inputs(self):
        return last_status(self.diagnostics, "/estimator", "inputs")[2]

    def test_poses_from_tf(self):
        expected = self.replay("tf", "odometry_tf_parent:=map", "odometry_tf_child:=base_link")
        self.check_offline(expected["offline"], 0.1)
        self.assertGreater(int(self.inputs()["tf_received"]), 150 * SECONDS)
        self.assertEqual(self.inputs()["tf_stamps"], "those of tf")
        self.assertNotIn("tf_refused_because", self.inputs())

    def test_frames_that_do_not_hang_together(self):
        bag, _ = self.make_bag(4, "tf")
        diagnostics = node_harness.diagnostics()
        self.start_node("lost", "__ns:=unknown", "rotor_speeds:=/rotor_speeds",
                        "_odometry_tf_parent:=earth", "_odometry_tf_child:=base_link")
        self.wait_for_node("/unknown/parameters")
        self.play(bag)

        def reason():
            status = last_status(diagnostics, "/unknown/lost", "inputs")
            return status[2].get("tf_refused_because", "") if status else ""

        self.assertTrue(wait_until(lambda: "odom -> base_link" in reason(), 10.0), reason())
        self.assertIn("tf does not lead from earth to base_link; it has", reason())
        status = last_status(diagnostics, "/unknown/lost")
        self.assertEqual(status[2]["waiting_for"], "tf from earth to base_link")

    def test_stamps_of_each_esc(self):
        """Telemetry that asks one ESC after the other and comes late, with stamps in microseconds
        of the ESCs' own clock."""
        expected = self.replay("esc_stamps", "rotor_topic:=/escs", "rotor_topic_field:=escs[].rpm",
                               "rotor_speed_unit:=rpm", "rotor_stamp_field:=escs[].timestamp",
                               "rotor_stamp_unit:=us")
        self.check_offline(expected["offline"], 0.1)
        self.check_offline(expected["plain"], 0.1)
        self.assertEqual(self.inputs()["rotor_speeds_stamps"],
                         "escs[].timestamp, a clock of its own laid on header.stamp")


if __name__ == "__main__":
    rospy.init_node("tf_odometry_test", disable_rostime=True)
    rostest.rosrun("odmc", "tf_odometry_test", TfOdometryTest, sys.argv)
