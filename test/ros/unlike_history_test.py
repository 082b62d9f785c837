#!/usr/bin/env python3
"""Three nodes hover with one vehicle. One starts from a fleet's history of it and has nothing to say; the
others from that of a vehicle with 6 % more thrust, and say so within seconds: one of them must find out
for itself that hover does not tell the frame of the odometry's velocity."""

import sys

import rospy
import rostest
import yaml

import node_harness

SCATTER, SIGMA = 0.01, 0.003  # of a value
SCATTER_M, TILT_RAD = 5e-4, 0.003
MORE_THRUST = 1.06
SOON_S = 6.0  # of hover; what of it the node needs is measured in test_unlike_history
TOPICS = ("odometry:=/odometry", "imu:=/imu", "rotor_speeds:=/rotor_speeds")


def known(name, parameter, factor):
    """A parameter as a fleet's parameters.yaml has it."""
    value = factor * parameter["value"]
    entry = {"value": value, "sigma": TILT_RAD, "unit": parameter["unit"], "state": "estimated"}
    if parameter["sigma"] == 0.0:
        return {"value": value, "state": "frozen"}
    if not name.startswith("gravity."):
        entry["scatter"] = SCATTER_M if parameter["unit"] == "m" else SCATTER * abs(value)
        entry["sigma"] = SIGMA / SCATTER * entry["scatter"]
    return entry


class UnlikeHistoryTest(node_harness.NodeTest):
    def write_history(self, name, expected, k_f_factor):
        """What `fleet` says of a vehicle, with its true values."""
        parameters = {}
        for key, value in expected["truth"].items():
            entry = dict(expected["offline"][key], value=value)
            parameters[key] = known(key, entry, k_f_factor if key == "thrust.k_f" else 1.0)
        path = self.file(name + ".yaml")
        with open(path, "w", encoding="utf-8") as file:
            yaml.safe_dump({"effects": expected["effects"], "parameters": parameters,
                            "provenance": {"flights": "20"}}, file)
        return path

    def test_names_another_vehicle_and_is_silent_of_the_same(self):
        bag, expected = self.make_bag(12, "hover")
        diagnostics = node_harness.diagnostics()
        parameters = {}
        for name, factor, frame in (("same", 1.0, "world"), ("other", MORE_THRUST, "world"),
                                    ("unsure", MORE_THRUST, "auto")):
            topic = "/%s/parameters" % name
            parameters[name] = node_harness.Collector(topic, node_harness.DynamicParameters)
            self.start_node(name, "__ns:=" + name, "_twist_frame:=" + frame, "_parameters_file:=" +
                            self.write_history(name, expected, factor), *TOPICS)
            self.wait_for_node(topic)
        self.play(bag)
        node_harness.wait_until(lambda: False, 2.5)

        for name in parameters:
            self.check_parameters(parameters[name].messages)
        for _, _, values in self.every_status(diagnostics, "/same/same"):
            self.assertEqual(values["unlike_history"], "", values)
        for name in ("other", "unsure"):
            self.check_named(diagnostics, "/%s/%s" % (name, name))

    def check_named(self, diagnostics, name):
        told = [s for s in self.every_status(diagnostics, name) if s[2]["unlike_history"]]
        self.assertGreater(len(told), 0, "%s said nothing; its last status: %s" %
                           (name, node_harness.last_status(diagnostics, name)))
        level, message, values = told[0]
        print("%s: after %s s in the air: %s" % (name, values["airborne_s"], message))
        self.assertEqual(level, 1)
        self.assertIn("thrust.k_f is ", message)
        self.assertIn("% below what earlier flights suggest", message)
        self.assertIn("chance in ", message)
        self.assertNotIn("nan", message)
        self.assertLess(float(values["airborne_s"]), SOON_S)
        last = node_harness.last_status(diagnostics, name)
        self.assertIn("thrust.k_f", last[2]["unlike_history"])

    @staticmethod
    def every_status(collector, name):
        found = [node_harness.status_of(array, name) for array in collector.messages]
        return [(node_harness.level(s),) + s[1:] for s in found if s is not None]


if __name__ == "__main__":
    rospy.init_node("unlike_history_test", disable_rostime=True)
    rostest.rosrun("odmc", "unlike_history_test", UnlikeHistoryTest, sys.argv)
