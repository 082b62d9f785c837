#!/usr/bin/env python3
"""The estimator dies in flight and comes back."""

import subprocess
import sys

import rospy
import rostest

import flight_harness
import node_harness

MOST_M = 0.4  # off the reference, at any time


class EstimatorKilledTest(flight_harness.FlightTest):
    def test_flies_on_and_follows_again(self):
        self.fly("trajectory:=octo", "top_speed_m_s:=4", "ground_s:=1.5", "real_time_factor:=0.9")
        self.wait_for_handover("following")
        self.wait_until_s(self.now_s() + 4.0)
        subprocess.check_call(["rosnode", "kill", "/estimator"], stdout=subprocess.DEVNULL)
        killed = self.now_s()
        held = self.wait_for_handover("holding")
        self.wait_until_s(held + 2.0)
        holding = self.last("status")
        self.assertEqual(holding.handover_state, "holding")
        self.assertEqual(holding.mode, "tracking")
        level, message, _ = node_harness.last_status(self.diagnostics, "/controller", "controller")
        self.assertIn("stale", message)

        # Its private parameters are still there.
        self.start_node("estimator", vehicle=node_harness.PACKAGE + "/config/vehicles/generic.yaml")
        again = self.wait_for_handover("following")
        self.wait_until_s(again + 2.0)

        print("killed at %.1f s, holding from %.1f s, following again from %.1f s; RMSE %.3f m, "
              "while it was dead %.3f m, real-time factor %s" % (
                  killed, held, again, self.rmse(self.take_off_s() + 2.0), self.rmse(killed, again),
                  self.real_time_factor()))
        self.assertLess(held - killed, 4.0)
        self.assertLess(max(self.errors(self.take_off_s() + 2.0)), MOST_M)
        self.assertLess(self.rmse(killed, again), 0.10)
        self.check_finite()
        self.check_no_failsafe()


if __name__ == "__main__":
    rospy.init_node("estimator_killed_test", disable_rostime=True)
    rostest.rosrun("odmc", "estimator_killed_test", EstimatorKilledTest, sys.argv)
