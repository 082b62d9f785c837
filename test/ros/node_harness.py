"""What the rostests of estimator_node share: bags, processes, collected messages."""

import json
import math
import os
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

import diagnostic_msgs.msg
import rospkg
import rospy
import yaml

from odmc.msg import DynamicParameters

PACKAGE = rospkg.RosPack().get_path("odmc")
VEHICLE = os.path.join(PACKAGE, "test", "ros", "test_quad.yaml")
CONFIG = os.path.join(PACKAGE, "test", "ros", "test_estimator.yaml")


def is_finite(message):
    """True if every number in a message is finite; looks into nested messages and lists."""
    if isinstance(message, float):
        return math.isfinite(message)
    if isinstance(message, (list, tuple)):
        return all(is_finite(item) for item in message)
    if hasattr(message, "__slots__"):
        return all(is_finite(getattr(message, slot)) for slot in message.__slots__)
    return True


def wait_until(condition, seconds):
    """Polls in wall time: simulated time may stand."""
    end = time.time() + seconds
    while time.time() < end:
        if condition():
            return True
        time.sleep(0.05)
    return bool(condition())


class Collector:
    """Keeps every message of one topic."""

    def __init__(self, topic, kind):
        self.messages = []
        self._subscriber = rospy.Subscriber(topic, kind, self.messages.append, queue_size=10000)

    def __len__(self):
        return len(self.messages)

    @property
    def last(self):
        return self.messages[-1]


def program(name):
    """Path of an executable of the build under test; rosrun passes over one below build/."""
    find = ["catkin_find", "--first-only", "--libexec", "odmc", name]
    return subprocess.check_output(find, text=True).strip()


class NodeTest(unittest.TestCase):
    """A test with a folder and processes of its own."""

    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="odmc_rostest_")
        self._processes = []

    def tearDown(self):
        for process in self._processes:
            if process.poll() is None:
                process.kill()
                process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def file(self, name):
        return os.path.join(self.folder, name)

    def make_bag(self, seconds, kind="plain"):
        """Simulates a flight; returns the bag and what make_test_bag says about it."""
        bag = self.file(kind + ".bag")
        text = subprocess.check_output([program("make_test_bag"), bag, str(seconds), kind])
        return bag, json.loads(text)

    def start(self, *command):
        process = subprocess.Popen(list(command), start_new_session=True)
        self._processes.append(process)
        return process

    def start_node(self, name, *arguments, vehicle=VEHICLE):
        """estimator_node without rosrun between, so that signals and exit codes are its own."""
        process = self.start(program("estimator_node"), "__name:=" + name, "_vehicle_file:=" + vehicle, *arguments)
        return process

    def wait_for_node(self, topic):
        """Until somebody publishes `topic`."""

        def is_published():
            return any(name == topic for name, _ in rospy.get_published_topics())

        self.assertTrue(wait_until(is_published, 20.0), topic + " never came up")

    def play(self, bag, rate=1.0, delay=1.0, wait=True, queue=100):
        process = self.start("rosbag", "play", "--quiet", "--clock", "--delay", str(delay),
                             "--rate", str(rate), "--queue", str(queue), bag)
        if wait:
            self.assertEqual(process.wait(timeout=120), 0)
        return process

    def end(self, process, seconds=8.0, by=signal.SIGINT):
        """Ends a process, as Ctrl-C does if not told otherwise; returns its exit code."""
        process.send_signal(by)
        return process.wait(timeout=seconds)

    def check_parameters(self, messages):
        """Every number finite, units given, stamps forward."""
        self.assertGreater(len(messages), 0, "no parameters were published")
        for message in messages:
            self.assertIsInstance(message, DynamicParameters)
            self.assertTrue(is_finite(message), "not finite: %s" % message)
            self.assertEqual(len(message.covariance), len(message.parameters) ** 2)
            for parameter in message.parameters:
                self.assertTrue(parameter.unit, parameter.name + " has no unit")

    def check_offline(self, offline, sigmas=0.1):
        """parameters.yaml of the node against the offline tool's estimate of the same bag."""
        with open(self.file("parameters.yaml"), encoding="utf-8") as file:
            saved = yaml.safe_load(file)
        worst = 0.0
        for name, parameter in offline.items():
            live = saved["parameters"][name]
            if parameter["sigma"] == 0.0:
                self.assertAlmostEqual(live["value"], parameter["value"], delta=1e-12)
                continue
            apart = abs(live["value"] - parameter["value"]) / parameter["sigma"]
            worst = max(worst, apart)
            self.assertLess(apart, sigmas, "%s: %g live, %g offline" % (name, live["value"],
                                                                     parameter["value"]))
        print("live and offline differ by %.4f sigma at most" % worst)
        self.assertEqual(saved["provenance"]["tool"], "estimator_node")


def by_name(message):
    return {p.name: p for p in message.parameters}


def diagnostics():
    return Collector("/diagnostics", diagnostic_msgs.msg.DiagnosticArray)


def status_of(array, name, part="estimator"):
    """One diagnostic of one node, as (level, message, {key: value}); None if absent."""
    for status in array.status:
        if status.name == name + ": " + part:
            return status.level, status.message, {v.key: v.value for v in status.values}
    return None


def level(status):
    """genpy reads the level (type byte) as an int or as a byte string, by version."""
    return status[0] if isinstance(status[0], int) else status[0][0]


def last_status(collector, name, part="estimator"):
    for array in reversed(collector.messages):
        status = status_of(array, name, part)
        if status is not None:
            return status
    return None
