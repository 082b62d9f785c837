#!/usr/bin/env python3
"""The services of simulator, controller and estimator, in one flight."""

import os
import sys

import rospy
import rostest
import yaml
from std_srvs.srv import SetBool, Trigger

import flight_harness
import node_harness


def call(service, *data):
    rospy.wait_for_service(service, timeout=10.0)
    answer = rospy.ServiceProxy(service, SetBool if data else Trigger)(*data)
    print("%s: %s %s" % (service, answer.success, answer.message))
    return answer


class ServicesTest(flight_harness.FlightTest):
    def test_services_do_what_they_say(self):
        self.fly("trajectory:=octo", "top_speed_m_s:=3", "ground_s:=1.5", "real_time_factor:=0.9",
                 "output_dir:=" + self.folder)
        rospy.wait_for_service("/estimator/accept", timeout=20.0)
        self.assertFalse(call("/estimator/accept").success, "nothing was estimated yet")
        self.wait_for_handover("following")
        self.check_freeze_and_save()
        self.check_controller()
        self.check_reset()
        self.check_simulator()
        self.check_finite()
        self.check_no_failsafe()
        self.assertLess(max(self.errors(self.take_off_s() + 2.0)), 0.5)

    def check_freeze_and_save(self):
        self.assertTrue(call("/estimator/freeze", True).success)
        self.wait_until_s(self.now_s() + 1.0)
        before = self.last("parameters")
        self.wait_until_s(self.now_s() + 3.0)
        after = self.last("parameters")
        self.assertGreater(after.header.stamp, before.header.stamp)
        self.assertEqual([p.value for p in before.parameters], [p.value for p in after.parameters])
        self.assertTrue(after.airborne)
        self.assertEqual(self.last("status").handover_state, "following", "frozen is not silent")
        saved = call("/estimator/save")
        self.assertTrue(saved.success)
        self.assertEqual(os.path.dirname(saved.message), self.folder)
        with open(saved.message, encoding="utf-8") as file:
            self.assertIn("thrust.k_f", yaml.safe_load(file)["parameters"])
        self.assertTrue(call("/estimator/accept").success)
        self.assertTrue(call("/estimator/freeze", False).success)

    def check_controller(self):
        self.assertTrue(call("/controller/use_estimate", False).success)
        self.wait_for_handover("nominal")
        self.wait_until_s(self.now_s() + 1.5)
        self.assertEqual(self.last("status").handover_state, "nominal")
        self.assertTrue(call("/controller/use_estimate", True).success)
        self.wait_for_handover("following")
        self.assertTrue(call("/controller/reset_parameters").success)

    def check_reset(self):
        learned = node_harness.by_name(self.last("parameters"))["thrust.k_f"].sigma
        self.assertTrue(call("/estimator/reset").success)
        stamp = self.last("parameters").header.stamp

        def is_new():
            return self.last("parameters").header.stamp > stamp

        self.assertTrue(node_harness.wait_until(is_new, 10.0))
        first = next(m for m in self.topics["parameters"].messages if m.header.stamp > stamp)
        self.assertGreater(node_harness.by_name(first)["thrust.k_f"].sigma, 2.0 * learned)

    def check_simulator(self):
        rospy.set_param("/simulator/payload_kg", 1e9)
        self.assertFalse(call("/simulator/attach_payload").success, "a mountain")
        rospy.delete_param("/simulator/payload_kg")
        said = call("/simulator/attach_payload")
        self.assertTrue(said.success and " kg hang at" in said.message, said.message)
        rospy.set_param("/simulator/payload_kg", 0.05)
        self.assertTrue(call("/simulator/attach_payload").success)
        self.assertTrue(node_harness.wait_until(lambda: self.mass() == "0.8", 5.0), self.mass())
        self.assertTrue(call("/simulator/drop_payload").success)
        rospy.set_param("/simulator/damage_share", 0.05)
        self.assertTrue(call("/simulator/damage_propeller").success)
        self.assertTrue(call("/simulator/repair").success)
        rospy.set_param("/simulator/damage_rotor", 9)
        self.assertFalse(call("/simulator/damage_propeller").success)
        rospy.set_param("/simulator/cog_shift_m", [0.003, 0.0, 0.0])
        self.assertTrue(call("/simulator/shift_cog").success)
        rospy.set_param("/simulator/jump_m", "three")
        answer = call("/simulator/jump_odometry")
        self.assertFalse(answer.success)
        self.assertIn("/simulator/jump_m", answer.message)
        rospy.set_param("/simulator/jump_m", [0.05, 0.0, 0.0])
        self.assertTrue(call("/simulator/jump_odometry").success)
        self.assertTrue(call("/simulator/pause", True).success)
        node_harness.wait_until(lambda: False, 0.5)
        stands_at = self.now_s()
        node_harness.wait_until(lambda: False, 1.0)
        self.assertEqual(self.now_s(), stands_at)
        self.assertTrue(call("/simulator/pause", False).success)
        self.wait_until_s(stands_at + 1.0)

    def mass(self):
        status = node_harness.last_status(self.diagnostics, "/simulator", "simulator")
        return status[2]["mass_kg"] if status else ""


if __name__ == "__main__":
    rospy.init_node("services_test", disable_rostime=True)
    rostest.rosrun("odmc", "services_test", ServicesTest, sys.argv)
