"""Tests of `convert` on the data sets' own formats: run with /usr/bin/python3 -m unittest discover -s test/scripts.

The tools are those of build/devel/lib/odmc, or of $ODMC_TOOLS."""

import csv
import math
import os
import random
import subprocess
import sys
import tempfile
import unittest
from typing import Callable, Dict, List

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
CONVERT = os.path.join(os.environ.get('ODMC_TOOLS') or os.path.join(ROOT, 'build', 'devel', 'lib', 'odmc'), 'convert')
DATA = os.path.join(ROOT, 'test', 'data')
sys.path.insert(0, DATA)

import make_samples as samples  # noqa: E402

Row = Dict[str, object]


def read_rows(path: str) -> List[Dict[str, str]]:
    """Rows of a CSV file by name."""
    with open(path, encoding='utf-8', newline='') as file:
        return list(csv.DictReader(file))


def messages(path: str, topic: str) -> List:
    """All messages of a topic."""
    import rosbag
    with rosbag.Bag(path) as bag:
        return [message for _, message, _ in bag.read_messages(topics=['/' + topic])]


class ConverterTest(unittest.TestCase):
    """A folder of its own for each test, and ways to run the tools in it."""

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def path(self, name: str) -> str:
        """A file in the test's folder."""
        return os.path.join(self.folder, name)

    def write(self, name: str, rows: List[Row]) -> str:
        """Writes rows, returns the path."""
        samples.write_rows(self.path(name), rows)
        return self.path(name)

    def run_tool(self, *arguments: str) -> subprocess.CompletedProcess:
        """Runs `convert` as a user does, without a sourced setup.bash."""
        environment = {'PATH': '/usr/bin:/bin', 'HOME': self.folder}
        return subprocess.run([CONVERT, *arguments], env=environment, text=True, capture_output=True, check=False, timeout=60)

    def convert(self, *arguments: str) -> str:
        """A conversion that must succeed; returns what it said on stderr."""
        result = self.run_tool(*arguments)
        self.assertEqual(result.returncode, 0, result.stderr)
        return result.stderr

    def refused(self, *arguments: str) -> str:
        """A conversion that must be refused and leave no output; returns the error."""
        result = self.run_tool(*arguments)
        self.assertEqual(result.returncode, 1, result.stdout + result.stderr)
        self.assertIn('error: ', result.stderr)
        self.assertNotIn('Traceback', result.stderr)
        self.assertFalse(os.path.exists(arguments[1]))
        return result.stderr

    def assert_vectors(self, found: List[float], expected: List[float], tolerance: float) -> None:
        """Equal within a tolerance."""
        for a, b in zip(found, expected):
            self.assertAlmostEqual(a, b, delta=tolerance)


class NeurobemTest(ConverterTest):
    """The NeuroBEM data set's own CSV."""

    SAMPLE = os.path.join(DATA, 'neurobem_sample.csv')

    def edited(self, edit: Callable[[Row], object]) -> str:
        """The sample with every row changed."""
        rows: List[Row] = [dict(row) for row in read_rows(self.SAMPLE)]
        for row in rows:
            edit(row)
        return self.write('edited.csv', rows)

    def assert_flight(self, bag: str) -> None:
        """The bag holds the sample's flight."""
        odometry, rotors = messages(bag, 'odometry'), messages(bag, 'rotor_speeds')
        self.assertEqual((len(odometry), len(rotors)), (40, 40))
        for i in (0, 17, 39):
            t, m = i / 40.0, odometry[i]
            self.assertEqual(m.header.stamp.to_nsec(), 10**9 + i * 25000000)
            self.assert_vectors(samples.get_xyz(m.pose.pose.position), samples.position(t), 1e-5)
            self.assert_vectors(samples.get_quaternion(m.pose.pose.orientation), samples.attitude(t),
                                1e-5)
            self.assert_vectors(samples.get_xyz(m.twist.twist.linear),
                                samples.velocity(t), 2e-5)
            self.assert_vectors(samples.get_xyz(m.twist.twist.angular), samples.body_rates(t), 2e-5)
            self.assert_vectors(rotors[i].angular_velocity_rad_s,
                                [samples.rotor_speed(t, k) for k in range(1, 5)], 0.01)

    def test_sample_is_read(self) -> None:
        said = self.convert(self.SAMPLE, self.path('f.bag'))
        self.assertEqual(said, '')
        self.assert_flight(self.path('f.bag'))
        self.assertEqual(len(messages(self.path('f.bag'), 'battery_state')), 40)

    def test_columns_in_any_order(self) -> None:
        rows = read_rows(self.SAMPLE)
        names = list(rows[0])
        random.Random(5).shuffle(names)
        source = self.write('shuffled.csv', [{name: row[name] for name in names} for row in rows])
        self.convert(source, self.path('f.bag'))
        self.assert_flight(self.path('f.bag'))

    def test_swapped_quaternion_order_is_detected(self) -> None:
        def swap(row: Row) -> None:
            row['quat x'], row['quat y'], row['quat z'], row['quat w'] = (
                row['quat w'], row['quat x'], row['quat y'], row['quat z'])
        said = self.convert(self.edited(swap), self.path('f.bag'))
        self.assertIn('w first where x is named', said)
        self.assert_flight(self.path('f.bag'))

    def test_conjugated_quaternion_is_detected(self) -> None:
        said = self.convert(self.edited(
            lambda row: row.update({'quat w': -float(row['quat w'])})), self.path('f.bag'))
        self.assertIn('conjugated', said)

    def test_world_velocity_is_detected(self) -> None:
        def turn(row: Row) -> None:
            v = samples.velocity(float(row['t']))
            row.update({f'vel {axis}': value for axis, value in zip('xyz', v)})
        said = self.convert(self.edited(turn), self.path('f.bag'))
        self.assertIn('world frame', said)
        self.assert_flight(self.path('f.bag'))

    def test_velocity_of_no_frame_is_refused(self) -> None:
        error = self.refused(self.edited(
            lambda row: row.update({'vel x': row['vel y'], 'vel y': row['vel x']})),
            self.path('f.bag'))
        self.assertIn('velocity frame: nothing fits', error)
        self.assertRegex(error, r'body: \d.*world: \d')

    def test_rates_that_fit_no_order_are_refused(self) -> None:
        error = self.refused(self.edited(
            lambda row: row.update({'ang vel x': row['ang vel y'], 'ang vel y': row['ang vel z'],
                                    'ang vel z': row['ang vel x']})), self.path('f.bag'))
        self.assertIn('quaternion order: nothing fits', error)

    def test_world_with_z_down_is_refused(self) -> None:
        def turn(row: Row) -> None:
            half_turn = samples.multiply((0.0, 1.0, 0.0, 0.0),
                                    [float(row[f'quat {axis}']) for axis in 'wxyz'])
            row.update({f'quat {axis}': value for axis, value in zip('wxyz', half_turn)})
            row.update({f'pos {axis}': -float(row[f'pos {axis}']) for axis in 'yz'})
        self.assertIn('not z up', self.refused(self.edited(turn),
                                               self.path('f.bag')))

    def test_missing_columns_are_named(self) -> None:
        for name in ('t', 'quat w', 'mot 3', 'vel z'):
            error = self.refused(self.edited(lambda row: row.pop(name)),
                                 self.path('f.bag'))
            self.assertIn(f'column {name} is missing', error)

    def test_truncated_file_loses_its_last_row_with_a_warning(self) -> None:
        with open(self.SAMPLE, encoding='utf-8') as file:
            text = file.read()
        with open(self.path('cut.csv'), 'w', encoding='utf-8') as file:
            file.write(text[:-60])
        said = self.convert(self.path('cut.csv'), self.path('f.bag'))
        self.assertIn('cut.csv: dropped 1 rows that do not have as many cells as the header', said)
        self.assertEqual(len(messages(self.path('f.bag'), 'odometry')), 39)

    def test_accelerometer_on_request_and_only_if_it_is_one(self) -> None:
        self.convert(self.SAMPLE, self.path('f.bag'), '--accelerometer')
        self.assertEqual(len(messages(self.path('f.bag'), 'imu')), 40)
        other = self.edited(lambda row: row.update({'acc z': float(row['acc z']) - 9.81}))
        error = self.refused(other, self.path('g.bag'), '--accelerometer')
        self.assertIn('acc: nothing fits', error)


class BlackbirdTest(ConverterTest):
    """The Blackbird data set's own bags and exports."""

    def setUp(self) -> None:
        super().setUp()
        self.messages = samples.blackbird_messages()

    def bag(self) -> str:
        """A bag as the data set has them."""
        samples.write_blackbird_bag(self.path('source.bag'), self.messages)
        return self.path('source.bag')

    def assert_flight(self, bag: str) -> None:
        """The bag holds the sample's flight in ENU and FLU."""
        odometry, imu = messages(bag, 'odometry'), messages(bag, 'imu')
        self.assertEqual(len(odometry), 40)
        for i in (0, 21, 39):
            t, m = i / 40.0, odometry[i]
            self.assert_vectors(samples.get_xyz(m.pose.pose.position), samples.position(t), 1e-5)
            q = samples.get_quaternion(m.pose.pose.orientation)
            sign = math.copysign(1.0, q[0])
            self.assert_vectors([sign * x for x in q], samples.attitude(t), 1e-5)
            self.assertEqual([m.twist.covariance[0], m.twist.covariance[21]], [-1, -1])
            if imu:
                self.assert_vectors(samples.get_xyz(imu[i].angular_velocity), samples.body_rates(t), 1e-4)
                self.assert_vectors(samples.get_xyz(imu[i].linear_acceleration),
                                    samples.specific_force(t), 1e-4)
        for m in messages(bag, 'rotor_speeds'):
            t = (m.header.stamp.to_nsec() - samples.START_S * 10**9) * 1e-9
            self.assert_vectors(m.angular_velocity_rad_s,
                                [samples.rotor_speed(t, k) for k in range(1, 5)], 1e-3)

    def test_bag_is_read(self) -> None:
        self.convert(self.bag(), self.path('f.bag'))
        self.assert_flight(self.path('f.bag'))
        commands = messages(self.path('f.bag'), 'motor_commands')
        self.assertEqual(len(commands), 20)
        self.assert_vectors(commands[0].throttle, [0.21, 0.22, 0.23, 0.24], 1e-12)
        self.assertEqual(len(messages(self.path('f.bag'), 'rotor_speeds')), 28)

    def test_exports_give_the_same_as_the_bag(self) -> None:
        self.convert(self.bag(), self.path('a.bag'))
        self.convert(os.path.join(DATA, 'blackbird'), self.path('b.bag'))
        self.assert_flight(self.path('b.bag'))
        for topic in ('odometry', 'imu', 'rotor_speeds', 'motor_commands'):
            a, b = messages(self.path('a.bag'), topic), messages(self.path('b.bag'), topic)
            for first, second in zip(a, b):
                first.header.seq = second.header.seq = 0
            self.assertEqual(a, b)

    def test_ground_truth_file_stands_in_for_the_state(self) -> None:
        folder = self.path('export')
        samples.write_blackbird_exports(folder, self.messages)
        os.remove(os.path.join(folder, 'blackbird_slash_state.csv'))
        truth = os.path.join(folder, 'groundTruthPoses.csv')
        samples.write_ground_truth(truth, self.messages)
        self.convert(folder, self.path('f.bag'))
        self.assert_flight(self.path('f.bag'))
        with open(truth, encoding='utf-8') as file:
            rows = [line.strip().split(',') for line in file]
        with open(truth, 'w', encoding='utf-8') as file:  # with a header, in another order
            file.write('# timestamp, qw, qx, qy, qz, x, y, z\n')
            file.writelines(','.join([r[0], *r[4:], *r[1:4]]) + '\n' for r in rows)
        self.convert(folder, self.path('g.bag'))
        self.assert_flight(self.path('g.bag'))

    def test_swapped_quaternion_order_is_detected(self) -> None:
        for message in self.messages['/blackbird/state']:
            o = message.pose.orientation
            o.x, o.y, o.z, o.w = o.w, o.x, o.y, o.z
        said = self.convert(self.bag(), self.path('f.bag'))
        self.assertIn('w first where x is named', said)
        self.assert_flight(self.path('f.bag'))

    def test_other_yaw_of_the_imu_is_detected(self) -> None:
        for message in self.messages['/blackbird/imu']:
            for v in (message.angular_velocity, message.linear_acceleration):
                v.x, v.y = -v.x, -v.y
        said = self.convert(self.bag(), self.path('f.bag'))
        self.assertIn('IMU yawed 270 deg', said)
        self.assert_flight(self.path('f.bag'))

    def test_poses_that_are_not_ned_are_refused(self) -> None:
        for i, message in enumerate(self.messages['/blackbird/state']):
            q = samples.attitude(i / 40.0)
            message.pose.orientation.w = q[0]
            samples.set_xyz(message.pose.orientation, q[1:])
        for message in self.messages['/blackbird/imu']:  # the same turn, so that rates agree
            for v in (message.angular_velocity, message.linear_acceleration):
                v.x, v.y, v.z = -v.x, v.y, -v.z
        self.assertIn('not NED', self.refused(self.bag(), self.path('f.bag')))

    def test_gyro_in_degrees_is_refused_with_residuals(self) -> None:
        for message in self.messages['/blackbird/imu']:
            w = samples.get_xyz(message.angular_velocity)
            samples.set_xyz(message.angular_velocity, [math.degrees(x) for x in w])
        error = self.refused(self.bag(), self.path('f.bag'))
        self.assertIn('attitude against gyro: nothing fits', error)

    def test_rotor_stamps_far_apart_are_left_out_and_counted(self) -> None:
        import genpy
        for i in (5, 6):
            message = self.messages['/blackbird/rotor_rpm'][i]
            message.sample_stamp[2] = message.sample_stamp[2] - genpy.Duration(0, 20000000)
            message.rpm[2] = samples.rotor_speed(i / 30.0 - 0.023, 3) * 30.0 / math.pi
        said = self.convert(self.bag(), self.path('f.bag'))
        self.assertIn('2 rotor messages left out: their stamps differ by more than 10 ms', said)
        self.assert_flight(self.path('f.bag'))
        self.assertEqual(len(messages(self.path('f.bag'), 'rotor_speeds')), 26)

    def test_flight_without_imu_is_read(self) -> None:
        del self.messages['/blackbird/imu']
        said = self.convert(self.bag(), self.path('f.bag'))
        self.assertIn('no IMU', said)
        self.assertEqual(len(messages(self.path('f.bag'), 'odometry')), 40)

    def test_missing_streams_and_columns_are_named(self) -> None:
        del self.messages['/blackbird/rotor_rpm']
        self.assertIn('/blackbird/rotor_rpm', self.refused(self.bag(),
                                                           self.path('f.bag')))
        folder = self.path('export')
        samples.write_blackbird_exports(folder, samples.blackbird_messages())
        path = os.path.join(folder, 'blackbird_slash_imu.csv')
        with open(path, encoding='utf-8') as file:
            text = file.read()
        with open(path, 'w', encoding='utf-8') as file:
            file.write(text.replace('angular_velocity,x', 'angular_velocity,lost'))
        error = self.refused(folder, self.path('f.bag'))
        self.assertIn("missing column 'angular_velocity.x'", error)

    def test_truncated_export_loses_its_last_row_with_a_warning(self) -> None:
        folder = self.path('export')
        samples.write_blackbird_exports(folder, self.messages)
        path = os.path.join(folder, 'blackbird_slash_state.csv')
        with open(path, encoding='utf-8') as file:
            text = file.read()
        with open(path, 'w', encoding='utf-8') as file:
            file.write(text[:-60])
        said = self.convert(folder, self.path('f.bag'))
        self.assertIn('blackbird_slash_state.csv: dropped 1 rows with fewer or more cells', said)
        self.assertEqual(len(messages(self.path('f.bag'), 'odometry')), 39)


if __name__ == '__main__':
    unittest.main()
