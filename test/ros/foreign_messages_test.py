#!/usr/bin/env python3
"""Rotor speeds in messages of packages that are not installed, live: the same parameters as from
odmc/RotorSpeeds of the same flight; and an odometry that comes as transforms and twists."""

import sys

import rospy
import rostest
import yaml

import node_harness
from odmc.msg import DynamicParameters

SECONDS = 12
MADE_UP = ["rotor_topic:=/garage/motors", "rotor_topic_field:=arms[].esc.erpm",
           "rotor_speed_unit:=erpm", "pole_pairs:=6", "rotor_order:=[2, 4, 1, 3]"]


class ForeignMessagesTest(node_harness.NodeTest):
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
        _, _, inputs = node_harness.last_status(self.diagnostics, "/estimator", "inputs")
        self.assertGreater(int(inputs["rotor_speeds_received"]), 150 * SECONDS)
        self.assertEqual(inputs["rotor_speeds_refused"], "0")
        return expected["offline"]

    def warnings(self):
        return node_harness.last_status(self.diagnostics, "/estimator")[2]["warnings"]

    def test_actuators(self):
        # The same numbers, but for their sign: as near as the node comes to the offline run.
        self.check_offline(self.replay("actuators", "rotor_topic:=/motor_speed"), 0.1)

    def test_esc_status(self):
        # Whole rpm: of +-0.5 rpm a flight offline makes 0.025 sigma.
        self.check_offline(self.replay("esc_status", "rotor_topic:=/mavros/esc_status"), 0.15)

    def test_a_type_of_our_own(self):
        self.check_offline(self.replay("made_up_stamped", *MADE_UP), 0.1)
        self.assertNotIn("arrival", self.warnings())

    def test_time_of_arrival(self):
        """Without a stamp: /clock tells the time of arrival to 10 ms, so k_f is all that is asked."""
        self.replay("made_up", *MADE_UP)
        self.assertIn("rotor_speeds: garage_quad/Motors has no stamp: took the time of arrival",
                      self.warnings())
        with open(self.file("parameters.yaml"), encoding="utf-8") as file:
            k_f = yaml.safe_load(file)["parameters"]["thrust.k_f"]["value"]
        truth = self.make_bag(1, "made_up")[1]["truth"]["thrust.k_f"]
        print("k_f off by %.2f %%" % (100.0 * (k_f / truth - 1.0)))
        self.assertLess(abs(k_f / truth - 1.0), 0.03)

    def test_transforms_with_twists_beside_them(self):
        offline = self.replay("pose_twist", "pose_topic:=/vicon/quad", "twist_topic:=/velocity")
        self.check_offline(offline, 0.1)
        status = node_harness.last_status(self.diagnostics, "/estimator")
        self.assertTrue(status[2]["twist_frame"].startswith("world"), status[2]["twist_frame"])

    def test_what_cannot_be_read_is_said(self):
        bag, _ = self.make_bag(3, "made_up")
        diagnostics = node_harness.diagnostics()
        self.start_node("lost", "__ns:=unknown", "odometry:=/odometry",
                        "rotor_speeds:=/garage/motors")
        self.wait_for_node("/unknown/parameters")
        self.play(bag)

        def refusal():
            status = node_harness.last_status(diagnostics, "/unknown/lost", "inputs")
            return status[2].get("rotor_speeds_refused_because", "") if status else ""

        self.assertTrue(node_harness.wait_until(lambda: refusal() != "", 10.0))
        self.assertIn("garage_quad/Motors is not known: say which of its fields holds rotor speeds "
                      "(rotor_topic_field", refusal())


if __name__ == "__main__":
    rospy.init_node("foreign_messages_test", disable_rostime=True)
    rostest.rosrun("odmc", "foreign_messages_test", ForeignMessagesTest, sys.argv)
