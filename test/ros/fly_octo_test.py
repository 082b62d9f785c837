#!/usr/bin/env python3
"""A whole flight under the controller: from the ground, along the octo, with the estimate, and down."""

import os
import sys
import tempfile

import rospy
import rostest

import flight_harness
import node_harness

SETTLED_S = 2.0  # after take-off
LANDED_M = 0.06  # of the body's origin above the ground, feet at -0.05


class FlyOctoTest(flight_harness.FlightTest):
    def test_tracks_with_the_estimate_and_lands(self):
        self.fly("trajectory:=octo", "top_speed_m_s:=4", "duration_s:=20", "ground_s:=1.5",
                 "real_time_factor:=0.9", also=("rates", "path", "point", "wrench"))

        def is_over():
            reference, status = self.last("reference"), self.last("status")
            flew = self.take_off_s() < self.now_s()
            return flew and reference.standing and status.mode == "idle"

        self.assertTrue(node_harness.wait_until(is_over, 90.0), "the flight never ended")
        self.wait_until_s(self.now_s() + 0.5)

        self.check_finite()
        self.check_no_failsafe()
        self.check_tracking()
        self.check_estimate()
        height = self.last("truth").pose.pose.position.z
        self.assertLess(abs(height), LANDED_M, "it did not land")
        speed = self.last("truth").twist.twist.linear
        self.assertLess(abs(speed.x) + abs(speed.y) + abs(speed.z), 0.05)
        self.check_inputs()

    def test_flies_by_throttle(self):
        package = node_harness.PACKAGE
        with open(os.path.join(package, "config", "vehicles", "generic.yaml")) as file:
            text = file.read()
        line = "# actuator: ../actuators/generic.yaml"
        self.assertIn(line, text)
        actuator = os.path.join(package, "config", "actuators", "generic.yaml")
        with tempfile.TemporaryDirectory() as folder:
            vehicle = os.path.join(folder, "generic.yaml")
            with open(vehicle, "w") as file:
                file.write(text.replace(line, "actuator: " + actuator))
            self.fly("vehicle_file:=" + vehicle, "trajectory:=octo", "top_speed_m_s:=3",
                     "duration_s:=10", "ground_s:=1.5", "real_time_factor:=0.9", also=("motors",))
            self.assertTrue(node_harness.wait_until(lambda: self.take_off_s() < self.now_s(), 40.0))
            start = self.take_off_s() + SETTLED_S
            self.wait_until_s(start + 7.0)
        self.check_finite()
        self.check_no_failsafe()
        print("by throttle: RMSE %.3f m" % self.rmse(start))
        self.assertLess(self.rmse(start), 0.10)
        throttles = [m.throttle for m in list(self.topics["motors"].messages)[-500:]]
        self.assertTrue(all(0.05 < x < 1.0 for t in throttles for x in t))
        # The simulator follows these and no rotor speeds: it counts one command per message.
        status = node_harness.last_status(self.diagnostics, "/simulator", "simulator")
        self.assertEqual(status[2]["commands_refused"], "0")
        sent = len(self.topics["motors"].messages)
        self.assertLess(int(status[2]["commands"]), 1.2 * sent)
        status = node_harness.last_status(self.diagnostics, "/controller", "controller")
        self.assertGreater(int(status[2]["battery_state_received"]), 50)
        self.assertEqual(status[2]["battery_state_refused"], "0")

    def check_tracking(self):
        start = self.take_off_s() + SETTLED_S
        states = [(s.header.stamp.to_sec(), s.handover_state) for s in self.topics["status"].messages]
        following = [time for time, state in states if state == "following"]
        self.assertGreater(len(following), 0, "the controller never followed the estimate")
        with_estimate = self.rmse(max(start, following[0] + 3.0), self.take_off_s() + 23.0)
        print("RMSE %.3f m, with the estimate %.3f m; following from %.1f s on; real-time factor %s"
              % (self.rmse(start), with_estimate, following[0], self.real_time_factor()))
        self.assertLess(self.rmse(start), 0.10)
        # 0.08 m with the vehicle file's values.
        self.assertLess(with_estimate, 0.04)
        self.assertNotIn("rolled_back", [state for _, state in states])

    def check_estimate(self):
        accepted = node_harness.by_name(self.last("accepted"))
        truth = node_harness.by_name(self.last("true_parameters"))
        self.assertLess(abs(accepted["thrust.k_f"].value / truth["thrust.k_f"].value - 1.0), 0.03)
        for parameter in truth.values():
            self.assertEqual(parameter.sigma, 0.0)

    def check_inputs(self):
        status = node_harness.last_status(self.diagnostics, "/controller", "controller")
        for key in ("odometry", "imu", "rotor_speeds", "references", "estimates"):
            self.assertEqual(status[2][key + "_refused"], "0", status)
        self.assertEqual(status[2]["not_finite_commands"], "0")
        self.assertEqual(status[2]["clock_resets"], "0")
        path = self.last("path")
        self.assertAlmostEqual(path.points[1].time_from_start.to_sec(), 0.05)


if __name__ == "__main__":
    rospy.init_node("fly_octo_test", disable_rostime=True)
    rostest.rosrun("odmc", "fly_octo_test", FlyOctoTest, sys.argv)
