#!/usr/bin/env python3
"""Start, feed, end half-way; and starts that must be refused."""

import math
import os
import shutil
import signal
import subprocess
import sys
import time

import rospy
import rostest
import yaml

import node_harness
from odmc.msg import DynamicParameters


class ShutdownTest(node_harness.NodeTest):
    def test_ends_cleanly_half_way(self):
        bag, _ = self.make_bag(8)
        parameters = node_harness.Collector("/parameters", DynamicParameters)
        node = self.start_node("estimator", "_output_dir:=" + self.file("out/deep"))
        self.wait_for_node("/parameters")
        player = self.play(bag, wait=False)
        self.assertTrue(node_harness.wait_until(lambda: len(parameters) > 20, 20.0))
        begin = time.time()
        self.assertEqual(self.end(node), 0)
        self.assertLess(time.time() - begin, 4.0)
        self.end(player)
        self.check_parameters(parameters.messages)
        with open(self.file("out/deep/parameters.yaml"), encoding="utf-8") as file:
            saved = yaml.safe_load(file)
        for name, parameter in saved["parameters"].items():
            self.assertTrue(math.isfinite(parameter["value"]), name)
            self.assertIsInstance(parameter["sigma"], float, name)

    def fly(self, name, folder, *arguments):
        """A node that has estimated for a while, and what plays to it."""
        bag, _ = self.make_bag(8)
        parameters = node_harness.Collector("/" + name + "/parameters", DynamicParameters)
        node = self.start_node(name, "__ns:=" + name, "_output_dir:=" + self.file(folder),
                               "odometry:=/odometry", "imu:=/imu", "rotor_speeds:=/rotor_speeds",
                               *arguments)
        self.wait_for_node("/" + name + "/parameters")
        player = self.play(bag, wait=False)
        self.assertTrue(node_harness.wait_until(lambda: len(parameters) > 20, 20.0))
        return node, player

    def test_saves_when_terminated_but_not_over_an_accepted_result(self):
        os.makedirs(self.file("kept"))
        kept = self.file("kept/parameters.yaml")
        accepted = ("effects: [thrust]\nparameters:\n  thrust.k_f: {value: 1.5e-06, sigma: 1e-9}\n"
                    "provenance: {accepted: \"true\"}\n")
        with open(kept, "w", encoding="utf-8") as file:
            file.write(accepted)
        node, player = self.fly("terminated", "kept", "_accept_relative_sigma:=1e-9")
        self.assertEqual(self.end(node, by=signal.SIGTERM), 0)
        self.end(player)
        with open(kept, encoding="utf-8") as file:
            self.assertEqual(file.read(), accepted)
        with open(self.file("kept/parameters_not_accepted.yaml"), encoding="utf-8") as file:
            saved = yaml.safe_load(file)
        self.assertEqual(saved["provenance"]["accepted"], "false")
        self.assertIn("drag.d_x", saved["parameters"])

    def test_says_so_where_it_cannot_save(self):
        node, player = self.fly("unsaved", "gone")
        shutil.rmtree(self.file("gone"))
        self.assertEqual(self.end(node), 1)
        self.end(player)

    def test_ends_before_anything_came(self):
        node = self.start_node("idle", "__ns:=idle")
        self.wait_for_node("/idle/parameters")
        self.assertEqual(self.end(node), 0)

    def refusal(self, *arguments, vehicle=node_harness.VEHICLE):
        """What a node says that does not start."""
        command = [node_harness.program("estimator_node"), "__name:=refused", "_vehicle_file:=" + vehicle,
                   *arguments]
        result = subprocess.run(command, stderr=subprocess.STDOUT, stdout=subprocess.PIPE,
                                timeout=20, text=True, check=False)
        rospy.delete_param("/refused")
        self.assertEqual(result.returncode, 1, result.stdout)
        return result.stdout

    def test_refuses_what_it_does_not_understand(self):
        said = self.refusal("_windw_s:=1.0")
        self.assertIn("/refused/windw_s is not known", said)
        self.assertIn("window_s", said)
        self.assertIn("window_s must be a number, not 'long'", self.refusal("_window_s:=long"))
        self.assertIn("window_s must be in", self.refusal("_window_s:=-1"))
        self.assertIn("twist_frame must be auto", self.refusal("_twist_frame:=wrld"))
        self.assertIn("on_time_reset must be", self.refusal("_on_time_reset:=reset"))
        self.assertIn("nowhere.yaml", self.refusal(vehicle="/nowhere.yaml"))
        self.assertIn("no vehicle", self.refusal(vehicle=""))

    def test_takes_numbers_that_yaml_1_1_reads_as_text(self):
        rospy.set_param("/exponent/function_tolerance", "1e-6")
        rospy.set_param("/exponent/max_iterations", "2")
        node = self.start_node("exponent", "parameters:=exponent_parameters")
        self.wait_for_node("/exponent_parameters")
        self.assertEqual(self.end(node), 0)


if __name__ == "__main__":
    rospy.init_node("shutdown_test", disable_rostime=True)
    rostest.rosrun("odmc", "shutdown_test", ShutdownTest, sys.argv)
