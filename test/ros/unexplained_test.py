#!/usr/bin/env python3
"""A flight with an effect that the vehicle file does not declare: the node names it, and adds it
where it may."""

import sys

import rospy
import rostest
import yaml

import node_harness
from odmc.msg import DynamicParameters, UnexplainedResidual

EFFECT = "quadratic_drag"
WATCH = ("_keyframe_rate_hz:=50", "_residual_watch_period_s:=2")
TOPICS = ("odometry:=/odometry", "imu:=/imu", "rotor_speeds:=/rotor_speeds")


class UnexplainedTest(node_harness.NodeTest):
    def test_names_the_effect_and_adds_it_where_it_may(self):
        bag, expected = self.make_bag(45, "undeclared")
        parameters, looks = {}, {}
        for name in ("watches", "adds"):
            parameters[name] = node_harness.Collector("/%s/parameters" % name, DynamicParameters)
            looks[name] = node_harness.Collector("/%s/unexplained" % name, UnexplainedResidual)
        diagnostics = node_harness.diagnostics()
        self.start_node("watching", "__ns:=watches", *TOPICS, *WATCH)
        adding = self.start_node("adding", "__ns:=adds", "_add_effects:=[wind, %s]" % EFFECT,
                                 "_output_dir:=" + self.folder, *TOPICS, *WATCH)
        for name in parameters:
            self.wait_for_node("/%s/parameters" % name)
        self.play(bag, rate=1.0)
        node_harness.wait_until(lambda: False, 2.5)

        for name in parameters:
            self.check_parameters(parameters[name].messages)
            for look in looks[name].messages:
                self.assertTrue(node_harness.is_finite(look), look)
        self.check_named(looks["watches"].messages)
        self.assertNotIn(EFFECT, parameters["watches"].last.effects)
        status = node_harness.last_status(diagnostics, "/watches/watching", "unexplained")
        self.assertEqual(status[2]["candidate"], EFFECT, status)
        self.assertIn(EFFECT + " would explain it", status[1])

        self.check_added(parameters["adds"].messages, expected["truth"])
        self.check_explained(looks["adds"].messages)
        status = node_harness.last_status(diagnostics, "/adds/adding", "unexplained")
        self.assertEqual(status[2]["added_effects"], EFFECT, status)
        self.assertEqual(self.end(adding), 0)
        with open(self.file("parameters.yaml"), encoding="utf-8") as file:
            saved = yaml.safe_load(file)
        self.assertIn(EFFECT, saved["effects"])
        self.assertEqual(saved["provenance"]["added_in_flight"], EFFECT)

    def check_named(self, looks):
        self.assertGreaterEqual(len(looks), 4)
        for look in looks:
            print("%5.1f s: share %.2f of %s, p %.1e, %s (%.1f nats) explains %.2f" % (
                look.flight_s, look.structured_share, look.channel, look.whiteness_p,
                look.candidate or "-", look.score, look.explained_share))
        naming = [look for look in looks if look.candidate == EFFECT]
        self.assertGreaterEqual(len(naming), len(looks) - 1)
        self.assertTrue(any(look.structured for look in naming))
        self.assertGreaterEqual(max(look.in_a_row for look in naming), 3)
        last = naming[-1]
        self.assertGreater(last.explained_share, 0.5)
        self.assertGreater(max(last.force_rmse_N), 0.02)
        self.assertEqual(last.header.frame_id, "base_link")
        self.assertEqual([p.name for p in last.parameters], [EFFECT + ".c_q"])
        self.assertEqual(len(last.added), 0)

    def check_added(self, messages, truth):
        having = [EFFECT in m.effects for m in messages]
        first = having.index(True)
        self.assertGreater(first, 0)
        self.assertTrue(all(having[first:]), "it went again")
        # Publishing goes on, and so does flight.
        gap = (messages[first].header.stamp - messages[first - 1].header.stamp).to_sec()
        self.assertLess(gap, 0.5)
        self.assertTrue(messages[first].airborne)
        c_q = node_harness.by_name(messages[-1])[EFFECT + ".c_q"]
        print("gap %.3f s; c_q %.4f +- %.4f, truth %.4f" % (
            gap, c_q.value, c_q.sigma, truth[EFFECT + ".c_q"]))
        self.assertAlmostEqual(c_q.value, truth[EFFECT + ".c_q"], delta=0.2 * c_q.value)
        self.assertTrue(c_q.observable)
        k_f = [node_harness.by_name(m)["thrust.k_f"] for m in messages[first - 1:first + 1]]
        self.assertLess(abs(k_f[1].value - k_f[0].value), 0.02 * k_f[0].value)
        self.assertTrue(k_f[1].observable, "what was learned counts")

    def check_explained(self, looks):
        added = [look for look in looks if EFFECT in look.effects]
        self.assertGreater(len(added), 0, "nothing was looked at after it was added")
        for look in added:
            print("added: share %.2f of %s, p %.1e, %s" % (
                look.structured_share, look.channel, look.whiteness_p, look.candidate or "-"))
            self.assertEqual(look.added, [EFFECT])
            self.assertNotEqual(look.candidate, EFFECT)
        # Nothing is left to explain; what a few seconds' share is by chance, p says.
        self.assertFalse(added[-1].structured)
        self.assertEqual(added[-1].candidate, "")


if __name__ == "__main__":
    rospy.init_node("unexplained_test", disable_rostime=True)
    rostest.rosrun("odmc", "unexplained_test", UnexplainedTest, sys.argv)
