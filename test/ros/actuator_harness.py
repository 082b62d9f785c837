"""What the rostests share in which the estimator knows the actuator."""

import os

import yaml

import node_harness
from odmc.msg import DynamicParameters

ACTUATOR = os.path.join(node_harness.PACKAGE, "test", "ros", "test_actuator.yaml")
SECONDS = 12
TOLERANCE = 0.02  # of k_f


class ActuatorTest(node_harness.NodeTest):
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
        # On a busy machine a reading may overtake the command it is compared with.
        self.check_offline(expected["offline"], 2.0 if kind == "dead_sensor" else 0.1)
        return parameters, diagnostics, expected

    def check_k_f(self, truth):
        with open(self.file("parameters.yaml"), encoding="utf-8") as file:
            k_f = yaml.safe_load(file)["parameters"]["thrust.k_f"]
        share = k_f["value"] / truth["thrust.k_f"] - 1.0
        print("k_f %.5g +- %.2g, off by %.2f %%" % (k_f["value"], k_f["sigma"], 100.0 * share))
        self.assertLess(abs(share), TOLERANCE)
