#!/usr/bin/env python3
"""launch/replay.launch on a simulated flight: what is published, against truth and offline run."""

import sys

import geometry_msgs.msg
import nav_msgs.msg
import rospy
import rostest
import sensor_msgs.msg

import node_harness
from odmc.msg import DynamicParameters

# Three sigma and these shares of the truth: what a flight of 20 s allows.
CHECKED = {"thrust.k_f": 0.01, "drag.d_x": 0.10, "drag.d_y": 0.10, "inertia.x": 0.25,
           "inertia.y": 0.25}


class ReplayTest(node_harness.NodeTest):
    def test_node_agrees_with_truth_and_offline_run(self):
        bag, expected = self.make_bag(20)
        topics = {
            "parameters": node_harness.Collector("/parameters", DynamicParameters),
            "accepted": node_harness.Collector("/parameters_accepted", DynamicParameters),
            "state": node_harness.Collector("/state", nav_msgs.msg.Odometry),
            "wrench": node_harness.Collector("/residual_wrench", geometry_msgs.msg.WrenchStamped),
            "image": node_harness.Collector("/live_image", sensor_msgs.msg.Image),
            "diagnostics": node_harness.diagnostics(),
        }
        launch = self.start(
            "roslaunch", "odmc", "replay.launch", "bag:=" + bag,
            "vehicle_file:=" + node_harness.VEHICLE, "config:=" + node_harness.CONFIG,
            "output_dir:=" + self.folder)
        launch.wait(timeout=60)

        self.check_parameters(topics["parameters"].messages)
        for name, collector in topics.items():
            self.assertGreater(len(collector), 0, name + " was never published")
            if name != "image":
                self.assertTrue(node_harness.is_finite(collector.last), name)
        self.check_rates(topics)
        self.check_truth(topics["parameters"].last, expected["truth"])
        self.check_units(topics["parameters"].last)
        self.check_accepted(topics["accepted"].last)
        self.check_image(topics["image"].last)
        self.check_diagnostics(topics["diagnostics"])
        self.check_offline(expected["offline"])

    def check_rates(self, topics):
        parameters = topics["parameters"].messages
        seconds = (parameters[-1].header.stamp - parameters[0].header.stamp).to_sec()
        rate = len(parameters) / seconds
        self.assertGreater(rate, 10.0)
        self.assertLess(rate, 21.0, "publish_rate_hz is 20")
        self.assertGreater(len(topics["state"]), 2 * len(parameters))

    def check_truth(self, message, truth):
        parameters = node_harness.by_name(message)
        for name, share in CHECKED.items():
            error = abs(parameters[name].value - truth[name])
            limit = 3.0 * parameters[name].sigma + share * abs(truth[name])
            print("%-20s %.5g +- %.2g, truth %.5g" % (name, parameters[name].value,
                                                      parameters[name].sigma, truth[name]))
            self.assertLess(error, limit, name)
            self.assertTrue(parameters[name].observable, name)

    def check_units(self, message):
        parameters = node_harness.by_name(message)
        self.assertEqual(parameters["thrust.k_f"].unit, "N s^2")
        self.assertEqual(parameters["drag.d_x"].unit, "N s/m")
        k_m = parameters["rotor_torque.k_m"]
        self.assertEqual((k_m.state, k_m.sigma), (k_m.FROZEN, 0.0))
        self.assertEqual(message.header.frame_id, "base_link")
        self.assertEqual(message.vehicle, "test_quad")
        self.assertTrue(message.airborne)

    def check_accepted(self, message):
        self.assertTrue(message.accepted)
        # Latched: whoever comes late has it, too. The node is gone by now, so ask the message.
        self.assertEqual(message._connection_header["latching"], "1")

    def check_image(self, image):
        self.assertEqual((image.encoding, image.step), ("bgr8", 3 * image.width))
        self.assertEqual(len(image.data), image.step * image.height)
        self.assertGreater(len(set(image.data)), 50, "the image is empty")

    def check_diagnostics(self, collector):
        level, message, values = node_harness.last_status(collector, "/estimator")
        print("diagnostics: %s" % message)
        for key in ("waiting_for", "update_ms_p99", "gaps", "unobservable", "position_noise_m",
                    "dropped_out_of_order", "on_ground"):
            self.assertIn(key, values)
        self.assertTrue(values["twist_frame"].startswith("world"), values["twist_frame"])
        self.assertGreater(float(values["update_ms_p99"]), 0.0)
        self.assertGreater(int(values["keyframes"]), 1000)
        self.assertLess(int(values["gaps"]), 5)


if __name__ == "__main__":
    rospy.init_node("replay_test", disable_rostime=True)
    rostest.rosrun("odmc", "replay_test", ReplayTest, sys.argv)
