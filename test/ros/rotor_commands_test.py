#!/usr/bin/env python3
"""Rotor speeds from commands and battery voltage, without a sensor."""

import sys

import rospy
import rostest

import actuator_harness
import node_harness
from odmc.msg import DynamicParameters


class RotorCommandsTest(actuator_harness.ActuatorTest):
    def test_commands_stand_in_for_a_missing_sensor(self):
        parameters, diagnostics, _ = self.replay("commands", "rotor_speed_from:=commands")
        self.assertGreater(len(parameters), 50)
        status = node_harness.last_status(diagnostics, "/estimator", "rotors")
        self.assertEqual((node_harness.level(status), status[1]), (0, "speeds come from commands"))
        self.assertEqual(status[2]["rotor_speed_from"], "commands")
        _, _, inputs = node_harness.last_status(diagnostics, "/estimator", "inputs")
        self.assertEqual(inputs["rotor_speeds_received"], "0")
        self.assertGreater(int(inputs["motor_commands_received"]), 150 * actuator_harness.SECONDS)

    def test_a_clock_that_steps_back_does_not_end_it(self):
        bag, _ = self.make_bag(5, "commands")
        parameters = node_harness.Collector("/again/parameters", DynamicParameters)
        diagnostics = node_harness.diagnostics()
        self.start_node("commanded", "__ns:=again", "odometry:=/odometry",
                        "motor_commands:=/motor_commands", "battery_state:=/battery_state",
                        "_rotor_speed_from:=commands", "_actuator:=" + actuator_harness.ACTUATOR,
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


if __name__ == "__main__":
    rospy.init_node("rotor_commands_test", disable_rostime=True)
    rostest.rosrun("odmc", "rotor_commands_test", RotorCommandsTest, sys.argv)
