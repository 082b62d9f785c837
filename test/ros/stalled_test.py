#!/usr/bin/env python3
"""The node stands still for a second, thrice (a busy onboard computer): afterwards it reads all of one
topic before the next. Nothing is lost, and the estimate is that of the offline tool."""

import signal
import sys
import time

import rospy
import rostest

import node_harness

STALLS, STALL_S, BETWEEN_S = 3, 1.0, 1.5
BEFORE_S = 4.0  # of start and flight
ALL_MESSAGES = 100000  # rosbag keeps what the node does not take yet


class StalledTest(node_harness.NodeTest):
    def test_loses_nothing(self):
        bag, expected = self.make_bag(15)
        diagnostics = node_harness.diagnostics()
        node = self.start_node("estimator", "_output_dir:=" + self.folder,
                               "_max_update_time_s:=1.0")
        self.wait_for_node("/parameters")
        play = self.play(bag, wait=False, queue=ALL_MESSAGES)
        time.sleep(BEFORE_S)
        for _ in range(STALLS):
            node.send_signal(signal.SIGSTOP)
            time.sleep(STALL_S)
            node.send_signal(signal.SIGCONT)
            time.sleep(BETWEEN_S)
        self.assertEqual(play.wait(timeout=60), 0)
        node_harness.wait_until(lambda: False, 2.0)
        values = node_harness.last_status(diagnostics, "/estimator")[2]
        self.assertEqual(self.end(node), 0)
        self.assertEqual(int(values["uncovered_keyframes"]), 0, values)
        self.assertEqual(int(values["gaps"]), 0, values)
        self.check_offline(expected["offline"])


if __name__ == "__main__":
    rospy.init_node("stalled_test", disable_rostime=True)
    rostest.rosrun("odmc", "stalled_test", StalledTest, sys.argv)
