#!/usr/bin/env python3
"""What each node's --help says against the node: topics with types, services, private parameters."""

import os
import re
import subprocess
import sys

import rosgraph
import rospy
import rosservice
import rostest
import yaml

import node_harness

sys.path.insert(0, os.path.join(node_harness.PACKAGE, "scripts"))
import odmc_node_help  # noqa: E402

ACTUATOR = os.path.join(node_harness.PACKAGE, "test", "ros", "test_actuator.yaml")
# What every node of roscpp has; /clock is subscribed by all, and published by the simulator.
OF_ROS = {"/rosout", "/clock", "~get_loggers", "~set_logger_level"}


class NodeHelpTest(node_harness.NodeTest):
    def vehicle(self):
        """With an actuator, since some topics are only there with one."""
        with open(node_harness.VEHICLE, encoding="utf-8") as file:
            vehicle = yaml.safe_load(file)
        vehicle["actuator"] = ACTUATOR
        path = self.file("vehicle.yaml")
        with open(path, "w", encoding="utf-8") as file:
            yaml.safe_dump(vehicle, file)
        return path

    def names_at_master(self, node):
        """Publications, subscriptions and services of a node, as its --help writes names."""

        def as_said(name):
            return "~" + name[len(node) + 1:] if name.startswith(node + "/") else name

        state = rosgraph.Master("/node_help_test").getSystemState()
        return [{as_said(name) for name, nodes in part if node in nodes} - OF_ROS for part in state]

    def check(self, kind, service):
        node = "/tested_" + kind
        said = odmc_node_help.help_of(node_harness.program(kind))
        process = self.start(node_harness.program(kind), "__name:=" + node[1:],
                             "_vehicle_file:=" + self.vehicle())
        rospy.wait_for_service(node + "/" + service, timeout=20.0)
        published, subscribed, services = self.names_at_master(node)
        told = [{name if name.startswith(("/", "~")) else "/" + name for name in (e.name for e in entries)
                 if "*" not in name} - OF_ROS for entries in (said.publishes, said.subscribes, said.services)]
        self.assertEqual(told, [published, subscribed, services])
        types = dict(rosgraph.Master("/node_help_test").getTopicTypes())
        for entry in said.publishes:
            name = rospy.resolve_name(entry.name.replace("~", node + "/"))
            if "*" not in name:
                self.assertEqual([types[name]], entry.types, name)
        for entry in said.services:
            self.assertEqual([rosservice.get_service_type(entry.name.replace("~", node + "/"))], entry.types)
        self.end(process)
        self.assertEqual(self.known_parameters(kind), [*said.parameters, *said.config])

    def known_parameters(self, kind):
        """A node that is given an unknown parameter says which it knows."""
        command = [node_harness.program(kind), "__name:=wrong_" + kind, "_vehicle_file:=" + self.vehicle(),
                   "_no_such_key:=1"]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
                              timeout=20.0)
        self.assertNotEqual(done.returncode, 0)
        known = re.search(r"Known are: ([\w, ]+)", done.stdout)
        self.assertTrue(known, done.stdout)
        return known.group(1).split(", ")

    def test_controller(self):
        self.check("controller_node", "use_estimate")

    def test_estimator(self):
        self.check("estimator_node", "freeze")

    def test_simulator(self):
        self.check("simulator_node", "pause")


if __name__ == "__main__":
    rospy.init_node("node_help_test", disable_rostime=True)
    rostest.rosrun("odmc", "node_help_test", NodeHelpTest, sys.argv)
