"""What the rostests of flight under the controller share: launch/simulation.launch and what it publishes."""

import math
import os
import subprocess

import geometry_msgs.msg
import nav_msgs.msg
import sensor_msgs.msg
import trajectory_msgs.msg

import node_harness
from node_harness import Collector, is_finite, wait_until
from odmc.msg import (ControllerStatus, DynamicParameters, FlatOutput, MotorCommands, RateThrust,
                      RotorSpeeds)

TRUTH = os.path.join(node_harness.PACKAGE, "test", "ros", "true_quad.yaml")
TOPICS = {
    "truth": ("/truth/odometry", nav_msgs.msg.Odometry),
    "true_parameters": ("/truth/parameters", DynamicParameters),
    "reference": ("/reference", FlatOutput),
    "command": ("/command/rotor_speeds", RotorSpeeds),
    "status": ("/controller_status", ControllerStatus),
    "parameters": ("/parameters", DynamicParameters),
    "accepted": ("/parameters_accepted", DynamicParameters),
}
# Python is busy enough with these; a test may ask for others.
OTHERS = {
    "wrench": ("/truth/wrench", geometry_msgs.msg.WrenchStamped),
    "wind": ("/truth/wind", geometry_msgs.msg.Vector3Stamped),
    "point": ("/command_trajectory", trajectory_msgs.msg.MultiDOFJointTrajectory),
    "path": ("/planned_trajectory", trajectory_msgs.msg.MultiDOFJointTrajectory),
    "odometry": ("/odometry", nav_msgs.msg.Odometry),
    "imu": ("/imu", sensor_msgs.msg.Imu),
    "rotors": ("/rotor_speeds", RotorSpeeds),
    "motors": ("/motor_commands", MotorCommands),
    "rates": ("/command/rate_thrust", RateThrust),
}


class FlightTest(node_harness.NodeTest):
    """A flight of launch/simulation.launch, with its messages."""

    launch = None

    def fly(self, *arguments, also=()):
        topics = dict(TOPICS, **{name: OTHERS[name] for name in also})
        self.topics = {name: Collector(*what) for name, what in topics.items()}
        self.diagnostics = node_harness.diagnostics()
        self.launch = self.start(
            "roslaunch", "odmc", "simulation.launch", "keyframe_rate_hz:=40",
            "residual_watch_period_s:=0", "estimator_config:=" + node_harness.CONFIG,
            "truth_file:=" + TRUTH, *arguments)

    def tearDown(self):
        # roslaunch ends its nodes only if it is asked to.
        if self.launch is not None and self.launch.poll() is None:
            try:
                self.end(self.launch, 20.0)
            except subprocess.TimeoutExpired:
                pass
        super().tearDown()

    def last(self, name):
        messages = self.topics[name].messages
        return messages[-1] if messages else None

    def now_s(self):
        """Simulated time, as the truth has it."""
        truth = self.last("truth")
        return truth.header.stamp.to_sec() if truth else 0.0

    def wait_until_s(self, time_s, wall_s=60.0):
        self.assertTrue(wait_until(lambda: self.now_s() >= time_s, wall_s),
                        "time stands at %.1f s" % self.now_s())

    def wait_for_handover(self, state, wall_s=50.0):
        def is_there():
            status = self.last("status")
            return status is not None and status.handover_state == state

        self.assertTrue(wait_until(is_there, wall_s), "never %s: %s" % (state, self.last("status")))
        return self.last("status").header.stamp.to_sec()

    def take_off_s(self):
        """When the reference leaves the ground."""
        for message in list(self.topics["reference"].messages):
            if not message.standing:
                return message.header.stamp.to_sec()
        return math.inf

    def errors(self, from_s, to_s=math.inf):
        """Distances of truth from reference, at the same stamps, while a reference is flown."""
        reference = {m.header.stamp.to_nsec(): m for m in list(self.topics["reference"].messages)}
        distances = []
        for truth in list(self.topics["truth"].messages):
            there = reference.get(truth.header.stamp.to_nsec())
            time_s = truth.header.stamp.to_sec()
            if there is None or there.standing or not from_s <= time_s < to_s:
                continue
            p, q = truth.pose.pose.position, there.position
            distances.append(math.sqrt((p.x - q.x)**2 + (p.y - q.y)**2 + (p.z - q.z)**2))
        return distances

    def rmse(self, from_s, to_s=math.inf):
        """Root mean square of errors()."""
        distances = self.errors(from_s, to_s)
        self.assertGreater(len(distances), 50)
        return math.sqrt(sum(d * d for d in distances) / len(distances))

    def check_finite(self):
        """Every number of every message that was kept."""
        for name, collector in self.topics.items():
            self.assertGreater(len(collector), 0, name + " was never published")
            for message in list(collector.messages):
                self.assertTrue(is_finite(message), "%s is not finite: %s" % (name, message))

    def check_no_failsafe(self):
        for status in list(self.topics["status"].messages):
            self.assertNotEqual(status.mode, "failsafe", status)

    def real_time_factor(self):
        status = node_harness.last_status(self.diagnostics, "/simulator", "simulator")
        return status[2]["real_time_factor"] if status else "unknown"
