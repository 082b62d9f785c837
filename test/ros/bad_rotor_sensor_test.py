#!/usr/bin/env python3
"""A rotor's sensor dies in flight: it is named, and its commands stand in. And bad parameters."""

import subprocess
import sys

import rospy
import rostest

import actuator_harness
import node_harness


class BadRotorSensorTest(actuator_harness.ActuatorTest):
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
        _, _, values = node_harness.last_status(diagnostics, "/estimator")
        self.assertIn(dead["rotor"], values["bad_rotor_sensors"])

    def test_bad_values_are_named(self):
        node = node_harness.program("estimator_node")
        vehicle = "_vehicle_file:=" + node_harness.VEHICLE
        for arguments, sentence in (
                (["_rotor_speed_from:=magic"],
                 "rotor_speed_from must be sensor or commands, not 'magic'"),
                (["_rotor_speed_from:=commands"],
                 "parameter rotor_speed_from is commands, but the actuator is not known"),
                (["_actuator:=/no/such.yaml"], "parameter actuator: /no/such.yaml")):
            run = subprocess.run([node, vehicle, "__name:=refusing"] + arguments, text=True,
                                 capture_output=True, timeout=20, check=False)
            self.assertNotEqual(run.returncode, 0, arguments)
            self.assertIn(sentence, run.stdout + run.stderr)
            # Private parameters stay on the server.
            for argument in arguments:
                rospy.delete_param("/refusing/" + argument[1:].split(":=")[0])


if __name__ == "__main__":
    rospy.init_node("bad_rotor_sensor_test", disable_rostime=True)
    rostest.rosrun("odmc", "bad_rotor_sensor_test", BadRotorSensorTest, sys.argv)
