#!/usr/bin/env python3
"""A simulated flight as RViz and plotting tools see it: markers, path, parameters; and the layouts
of config/watching, which may name only what the node publishes."""

import os
import sys
import xml.etree.ElementTree

import geometry_msgs.msg
import nav_msgs.msg
import roslib.message
import rospy
import rostest
import sensor_msgs.msg
import std_msgs.msg
import tf2_msgs.msg
import visualization_msgs.msg
import yaml

import flight_harness
import node_harness
from node_harness import Collector, is_finite, wait_until

Marker = visualization_msgs.msg.Marker
LAYOUTS = os.path.join(node_harness.PACKAGE, "config", "watching")
BODY, WORLD = "base_link", "world"
FRAMES = {"vehicle": BODY, "centre_of_gravity": BODY, "residual_force": BODY,
          "residual_torque": BODY, "velocity": WORLD, "wind": WORLD, "phase": WORLD}


def published():
    return dict(rospy.get_published_topics())


def field_of(message, path):
    """The number at a/b/c of a message."""
    for step in path.split("/"):
        message = getattr(message, step)
    return message


def xyz(point):
    return (point.x, point.y, point.z)


class WatchingTest(flight_harness.FlightTest):
    def watch(self):
        self.displays = Collector("/estimator/displays", visualization_msgs.msg.MarkerArray)
        self.path = Collector("/estimator/path", nav_msgs.msg.Path)
        self.plot = Collector("/estimator/estimates_plot", sensor_msgs.msg.JointState)
        self.wrench = Collector("/residual_wrench", geometry_msgs.msg.WrenchStamped)
        self.state = Collector("/state", nav_msgs.msg.Odometry)
        self.tf = Collector("/tf", tf2_msgs.msg.TFMessage)

    def transforms(self):
        """How often the body's pose was published as a transform, by publisher and in all."""
        pairs = [(t.header.frame_id, t.child_frame_id, t.header.stamp)
                 for m in list(self.tf.messages) for t in m.transforms]
        return [p for p in pairs if p[:2] == (WORLD, BODY)]

    def test_a_flight(self):
        self.watch()
        self.fly("trajectory:=octo", "plot_topics:=true")
        self.wait_for_handover("following")
        self.assertTrue(wait_until(lambda: self.shown("flying, accepted"), 30.0),
                        "never shown as flying and accepted")
        self.assertTrue(wait_until(lambda: len(self.displays) > 60, 30.0))
        self.check_markers()
        self.check_path()
        self.check_plot()
        self.check_plotjuggler()
        self.check_rqt_multiplot()
        self.check_rviz()

    def shown(self, text):
        return any(marker.text == text for array in list(self.displays.messages)
                   for marker in array.markers)

    def check_markers(self):
        wrenches = {m.header.stamp: m.wrench for m in list(self.wrench.messages)}
        states = {m.header.stamp: m for m in list(self.state.messages)}
        compared = 0
        for array in list(self.displays.messages):
            self.assertTrue(is_finite(array), array)
            markers = {(m.ns, m.id): m for m in array.markers}
            self.assertEqual(len(markers), len(array.markers), "two markers of one name")
            self.assertEqual({name for name, _ in markers}, set(FRAMES))
            for (name, _), marker in markers.items():
                self.assertEqual(marker.header.frame_id, FRAMES[name], name)
            self.assertEqual(markers["wind", 0].action, Marker.DELETE, "the model has no wind")
            force, velocity = markers["residual_force", 0], markers["velocity", 0]
            stamp = force.header.stamp
            if force.action != Marker.ADD or stamp not in wrenches or stamp not in states:
                continue
            compared += 1
            self.check_along(xyz(wrenches[stamp].force), force)
            if velocity.action == Marker.ADD:
                tail, tip = velocity.points
                self.assertEqual(xyz(tail), xyz(states[stamp].pose.pose.position))
                self.check_length(states[stamp], tail, tip)
        print("%d arrays of markers, %d compared with the wrench" % (len(self.displays), compared))
        self.assertGreater(compared, 20)
        self.assertGreater(max(m.points[1].z for a in self.displays.messages for m in a.markers
                               if m.ns == "velocity" and m.action == Marker.ADD), 0.5, "in the air")

    def check_along(self, vector, arrow):
        """The arrow has the vector's direction, in the vector's own frame."""
        tail, tip = (xyz(p) for p in arrow.points)
        way = [b - a for a, b in zip(tail, tip)]
        ratio = sum(a * b for a, b in zip(way, vector)) / sum(v * v for v in vector)
        self.assertGreater(ratio, 0.0)
        for along, component in zip(way, vector):
            self.assertAlmostEqual(along, ratio * component, delta=1e-9)

    def check_length(self, state, tail, tip):
        """The velocity in the world is as large as that in the body."""
        speed = sum(v * v for v in xyz(state.twist.twist.linear))**0.5
        length = sum((b - a)**2 for a, b in zip(xyz(tail), xyz(tip)))**0.5
        self.assertAlmostEqual(length, 0.1 * speed, delta=1e-9)

    def check_path(self):
        path = self.path.last
        self.assertTrue(is_finite(path))
        self.assertEqual(path.header.frame_id, WORLD)
        self.assertGreater(len(path.poses), 20)
        stamps = [p.header.stamp for p in path.poses]
        self.assertEqual(stamps, sorted(set(stamps)))
        states = {m.header.stamp: m.pose.pose for m in list(self.state.messages)}
        compared = [p for p in path.poses if p.header.stamp in states]
        self.assertGreater(len(compared), 10)
        for pose in compared:
            self.assertEqual(pose.pose, states[pose.header.stamp])

    def check_plot(self):
        parameters = {m.header.stamp: m for m in list(self.topics["parameters"].messages)}
        compared = 0
        for plot in list(self.plot.messages):
            self.assertTrue(is_finite(plot), plot)
            self.assertEqual(plot.header.frame_id, BODY)
            message = parameters.get(plot.header.stamp)
            # The estimate of one stamp is published again when it was widened or accepted.
            if message is None or [p.name for p in message.parameters] != plot.name:
                continue
            compared += 1
            for p, value, sigma, shown in zip(message.parameters, plot.position, plot.velocity,
                                              plot.effort):
                self.assertEqual((p.value, p.sigma, float(p.observable)), (value, sigma, shown))
        print("%d estimates plotted, %d compared" % (len(self.plot), compared))
        self.assertGreater(compared, 20)
        types = published()
        for name in self.plot.last.name:
            for what in ("value", "sigma"):
                topic = "/estimator/plot/" + name.replace(".", "/") + "/" + what
                self.assertEqual(types.get(topic), "std_msgs/Float64", topic)
        values = Collector("/estimator/plot/thrust/k_f/value", std_msgs.msg.Float64)
        self.assertTrue(wait_until(lambda: len(values) > 3, 10.0))
        index = self.plot.last.name.index("thrust.k_f")
        plotted = {plot.position[index] for plot in list(self.plot.messages)}
        self.assertIn(values.messages[0].data, plotted)

    def message_of(self, topic):
        """An empty message of a topic's type, where the topic exists."""
        kind = published().get(topic)
        self.assertIsNotNone(kind, "nobody publishes " + topic)
        return kind, roslib.message.get_message_class(kind)()

    def check_plotjuggler(self):
        root = xml.etree.ElementTree.parse(os.path.join(LAYOUTS, "plotjuggler.xml")).getroot()
        self.assertEqual(root.tag, "root")
        curves = [curve.get("name") for curve in root.iter("curve")]
        self.assertGreater(len(curves), 20)
        for splitter in root.iter("DockSplitter"):
            self.assertEqual(len(splitter), int(splitter.get("count")))
            self.assertEqual(len(splitter.get("sizes").split(";")), len(splitter))
        for curve in curves:
            topic = max((t for t in published() if curve.startswith(t + "/")), key=len, default="")
            kind, message = self.message_of(topic or curve)
            rest = curve[len(topic) + 1:]
            if kind == "sensor_msgs/JointState":  # PlotJuggler: topic/name/position
                name, what = rest.rsplit("/", 1)
                self.assertIn(name, self.plot.last.name)
                self.assertIn(what, ("position", "velocity", "effort"))
            else:
                self.assertIsInstance(field_of(message, rest), float, curve)

    def check_rqt_multiplot(self):
        path = os.path.join(LAYOUTS, "rqt_multiplot.xml")
        root = xml.etree.ElementTree.parse(path).getroot()
        self.assertEqual(root.tag, "rqt_multiplot")
        axes = list(root.iter("y_axis"))
        curves = [axis for axis in axes if axis.find("field") is not None]
        self.assertGreater(len(curves), 10)
        for axis in curves:
            topic, kind = axis.find("topic").text, axis.find("type").text
            real, message = self.message_of(topic)
            self.assertEqual(kind, real, topic)
            self.assertIsInstance(field_of(message, axis.find("field").text), float, topic)

    def check_rviz(self):
        with open(os.path.join(LAYOUTS, "odmc.rviz"), encoding="utf-8") as file:
            config = yaml.safe_load(file)
        topics = {"rviz/MarkerArray": "visualization_msgs/MarkerArray", "rviz/Path": "nav_msgs/Path"}
        displays = config["Visualization Manager"]["Displays"]
        found = 0
        for display in displays:
            if display["Class"] in topics:
                topic = display.get("Marker Topic", display.get("Topic"))
                self.assertEqual(published().get(topic), topics[display["Class"]])
                found += 1
            if display["Class"] == "rviz/MarkerArray":
                self.assertEqual(set(display["Namespaces"]), set(FRAMES))
        self.assertEqual(found, 2)

    def replay(self, body_tf):
        self.watch()
        bag, _ = self.make_bag(8)
        launch = self.start("roslaunch", "odmc", "replay.launch", "bag:=" + bag, "bag_rate:=2",
                            "vehicle_file:=" + node_harness.VEHICLE,
                            "config:=" + node_harness.CONFIG, "body_tf:=" + body_tf)
        launch.wait(timeout=40)
        self.assertGreater(len(self.displays), 5)
        self.assertGreater(len(self.state), 50)

    def test_a_recording_without_tf(self):
        """Nobody says where the body is: the node does."""
        self.replay("auto")
        states = {m.header.stamp for m in self.state.messages}
        transforms = self.transforms()
        self.assertGreater(len(transforms), 50)
        for _, _, stamp in transforms[:-1]:
            self.assertIn(stamp, states)
        types = published()
        self.assertFalse([t for t in types if t.startswith("/estimator/plot/")], "not asked for")

    def test_tf_is_left_alone(self):
        self.replay("never")
        self.assertEqual(self.transforms(), [])


if __name__ == "__main__":
    rospy.init_node("watching_test", disable_rostime=True)
    rostest.rosrun("odmc", "watching_test", WatchingTest, sys.argv)
