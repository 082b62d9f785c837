#!/usr/bin/env python3
"""Rotor speeds from commands: without a sensor, and in place of one that dies in flight."""

import os
import subprocess
import sys

import rospy
import rostest
import yaml

import node_harness
from odmc.msg import DynamicParameters

ACTUATOR = os.path.join(node_harness.PACKAGE, "test", "ros", "test_actuator.yaml")
SECONDS = 12
TOLERANCE = 0.02  # of k_f


class RotorSourceTest(node_harness.NodeTest):
    def replay(self, kind, *arguments):
        """Plays such a bag by replay.launch; returns what was collected and make_test_bag's word."""
        bag, expected = self.make_bag(SECONDS, kind)
        parameters = node_harness.Collector("/parameters", DynamicParameters)
        diagnostics = node_harness.diagnostics()
        launch = self.start(
            "roslaunch", "odmc", "replay.launch", "bag:=" + bag, "bag_rate:=2",
            "vehicle_file:=" + node_harness.VEHICLE, "config:=" + node_harness.CONFIG,
            "actuator:=" + ACTUATOR, "output_dir:=" + self.folder, *arguments)
        launch.wait(timeout=40)
        self.check_parameters(parameters.messages)
        self.check_k_f(expected["truth"])
        return parameters, diagnostics, expected

    def check_k_f(self, truth):
        with open(self.file("parameters.yaml"), encoding="utf-8") as file:
            k_f = yaml.safe_load(file)["parameters"]["thrust.k_f"]
        share = k_f["value"] / truth["thrust.k_f"] - 1.0
        print("k_f %.5g +- %.2g, off by %.2f %%" % (k_f["value"], k_f["sigma"], 100.0 * share))
        self.assertLess(abs(share), TOLERANCE)

    def test_commands_stand_in_for_a_missing_sensor(self):
        parameters, diagnostics, _ = self.replay("commands", "rotor_speed_from:=commands")
        self.assertGreater(len(parameters), 50)
        status = node_harness.last_status(diagnostics, "/estimator", "rotors")
        self.assertEqual((node_harness.level(status), status[1]), (0, "speeds come from commands"))
        self.assertEqual(status[2]["rotor_speed_from"], "commands")
        _, _, inputs = node_harness.last_status(diagnostics, "/estimator", "inputs")
        self.assertEqual(inputs["rotor_speeds_received"], "0")
        self.assertGreater(int(inputs["motor_commands_received"]), 150 * SECONDS)

    def test_a_dead_sensor_is_named_and_replaced(self):
        _, diagnostics, expected = self.replay("dead_sensor")
        statuses = [node_harness.status_of(array, "/estimator", "rotors")
                    for array in diagnostics.messages]
        statuses = [status for status in statuses if status is not None]
        self.assertIn((0, "sensors agree with commands"),
                      [(node_harness.level(s), s[1]) for s in statuses])
        last = statuses[-1]
        print("diagnostics: %s %s" % (last[1], last[2]))
        self.assertEqual(node_harness.level(last), 1)
        dead = expected["dead_sensor"]
        self.assertIn(dead["rotor"] + ": its sensor", last[1])
        self.assertEqual(last[2]["bad_sensors"], dead["rotor"])
        self.assertEqual(last[2]["faults"], "1")
        since_s = float(last[2][dead["rotor"] + "_since_s"])
        self.assertAlmostEqual(since_s, dead["since_s"], delta=0.5)
        level, message, values = node_harness.last_status(diagnostics, "/estimator")
        self.assertIn(dead["rotor"], values["bad_rotor_sensors"])

    def test_a_clock_that_steps_back_does_not_end_it(self):
        bag, _ = self.make_bag(5, "commands")
        parameters = node_harness.Collector("/again/parameters", DynamicParameters)
        diagnostics = node_harness.diagnostics()
        self.start_node("commanded", "__ns:=again", "odometry:=/odometry",
                        "motor_commands:=/motor_commands", "battery_state:=/battery_state",
                        "_rotor_speed_from:=commands", "_actuator:=" + ACTUATOR,
                        "_twist_frame:=world", "_keyframe_rate_hz:=50")
        self.wait_for_node("/again/parameters")
        self.play(bag, rate=2.0)
        node_harness.wait_until(lambda: False, 1.0)
        count = len(parameters)
        self.play(bag, rate=2.0)
        node_harness.wait_until(lambda: False, 1.5)
        self.check_parameters(parameters.messages)
        stamps_s = [m.header.stamp.to_sec() for m in parameters.messages[count + 2:]]
        self.assertTrue(stamps_s, "nothing after the clock stepped back")
        self.assertGreater(max(stamps_s) - min(stamps_s), 2.0)
        _, _, values = node_harness.last_status(diagnostics, "/again/commanded")
        self.assertEqual(values["clock_resets"], "1")

    def test_bad_values_are_named(self):
        find = ["catkin_find", "--first-only", "--libexec", "odmc", "estimator_node"]
        program = subprocess.check_output(find, text=True).strip()
        vehicle = "_vehicle_file:=" + node_harness.VEHICLE
        for arguments, sentence in (
                (["_rotor_speed_from:=magic"],
                 "rotor_speed_from must be sensor or commands, not 'magic'"),
                (["_rotor_speed_from:=commands"],
                 "parameter rotor_speed_from is commands, but the actuator is not known"),
                (["_actuator:=/no/such.yaml"], "parameter actuator: /no/such.yaml")):
            run = subprocess.run([program, vehicle, "__name:=refusing"] + arguments, text=True,
                                 capture_output=True, timeout=20, check=False)
            self.assertNotEqual(run.returncode, 0, arguments)
            self.assertIn(sentence, run.stdout + run.stderr)
            # Private parameters stay on the server.
            for argument in arguments:
                rospy.delete_param("/refusing/" + argument[1:].split(":=")[0])


if __name__ == "__main__":
    rospy.init_node("rotor_source_test", disable_rostime=True)
    rostest.rosrun("odmc", "rotor_source_test", RotorSourceTest, sys.argv)
