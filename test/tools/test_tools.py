"""Tests of the command-line tools: test_tools.py FOLDER_OF_TOOLS."""

import csv
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import unittest
from typing import Any, Dict, List

import yaml

import log_writers

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
TOOLS = os.path.join(ROOT, 'build', 'devel', 'lib', 'odmc')
VEHICLE = os.path.join(ROOT, 'config', 'vehicles', 'generic.yaml')
NAMES = ('benchmark', 'calibrate', 'calibrate_actuator', 'close_loop', 'convert', 'evaluate', 'experiment',
         'inspect', 'list_effects', 'new_vehicle', 'recovery', 'score_attribution', 'simulate', 'simulate_undeclared')


def run(tool: str, *arguments: str) -> subprocess.CompletedProcess:
    """Runs a tool, output as text."""
    return subprocess.run([os.path.join(TOOLS, tool), *arguments], capture_output=True, text=True,
                          check=False, timeout=600)


def read_json(*path: str) -> Dict[str, Any]:
    """A JSON file, without NaN."""
    def refuse(text: str) -> None:
        raise AssertionError(f'{text} in {path}')
    with open(os.path.join(*path), encoding='utf-8') as file:
        return json.load(file, parse_constant=refuse)


def read_table(*path: str) -> List[Dict[str, str]]:
    """Rows of a CSV file."""
    with open(os.path.join(*path), encoding='utf-8') as file:
        return list(csv.DictReader(file))


class ToolsTest(unittest.TestCase):
    """One short simulated flight, as a bag and as CSV, for all."""

    folder: tempfile.TemporaryDirectory
    of_imu_flight: Dict[str, Any] = {}

    @classmethod
    def setUpClass(cls) -> None:
        cls.folder = tempfile.TemporaryDirectory()
        for name in ('flight.bag', 'flight.csv'):
            done = run('simulate', '--vehicle', VEHICLE, '--trajectory', 'octo', '--out',
                       cls.path('new/folder', name), '--seed', '3', '--duration', '7')
            assert done.returncode == 0, done.stderr

    @classmethod
    def tearDownClass(cls) -> None:
        cls.folder.cleanup()

    @classmethod
    def path(cls, *names: str) -> str:
        """A file in the test's folder."""
        return os.path.join(cls.folder.name, *names)

    @classmethod
    def flight(cls, ending: str = 'csv') -> str:
        """The simulated flight."""
        return cls.path('new/folder', f'flight.{ending}')

    def write(self, name: str, text: str) -> str:
        """A file with this text."""
        with open(self.path(name), 'w', encoding='utf-8') as file:
            file.write(text)
        return self.path(name)

    def expect(self, status: int, what: str, tool: str, *arguments: str) -> None:
        """The exit status, and one sentence on stderr that says what."""
        done = run(tool, *arguments)
        self.assertEqual(done.returncode, status, done.stderr)
        self.assertIn(what, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        self.assertTrue(done.stderr.startswith('error: '), done.stderr)

    def test_help_explains_all(self) -> None:
        for name in NAMES:
            done = run(name, '--help')
            self.assertEqual(done.returncode, 0, name)
            self.assertIn('Exit status', done.stdout, name)
            self.assertEqual(done.stderr, '', name)

    def test_usage_ends_with_status_two(self) -> None:
        out = ('--out', self.path('out'))
        vehicle = ('--vehicle', VEHICLE)
        self.expect(2, '--vehicle', 'calibrate', self.flight(), *out)
        self.expect(2, 'FLIGHT', 'calibrate', *vehicle, *out)
        common = (self.flight(), *vehicle, *out)
        self.expect(2, '--nonsense', 'calibrate', *common, '--nonsense')
        self.expect(2, 'magic', 'calibrate', *common, '--effects', 'thrust,magic')
        self.expect(2, 'excludes', 'calibrate', *common, '--effects', 'drag', '--without', 'drag')
        self.expect(2, 'windw_s', 'calibrate', *common, '--set', 'windw_s=1')
        self.expect(2, 'a number', 'calibrate', *common, '--set', 'window_s=long')
        self.expect(2, 'window_s', 'calibrate', *common, '--set', 'window_s=-1')
        self.expect(2, 'odo', 'calibrate', *common, '--topic', 'odo:=/x')
        self.expect(2, '--end', 'calibrate', *common, '--start', '5', '--end', '4')
        self.expect(2, "above zero, not 'nan'", 'calibrate', *common, '--end', 'nan')
        self.expect(2, "above zero, not '0'", 'recovery', *vehicle, *out, '--trajectory', 'octo',
                    '--seeds', '0')
        self.expect(2, 'position_noise_m', 'calibrate', *common, '--set', 'position_noise_m=nan')
        self.expect(2, 'an integer', 'calibrate', *common, '--set', 'max_iterations=1e99')
        self.expect(2, '--rotor-speed-unit is for bags', 'calibrate', *common,
                    '--rotor-speed-unit', 'rpm')
        self.expect(2, '--rotor-order is for bags', 'calibrate', *common, '--rotor-order', '2,1,4,3')
        self.expect(2, '--rotor-topic-field is for bags', 'calibrate', *common,
                    '--rotor-topic-field', 'esc_status[].rpm')
        self.expect(2, '--rotor-stamp-field is for bags', 'calibrate', *common,
                    '--rotor-stamp-field', 'esc_status[].timestamp')
        self.expect(2, '--odometry-tf-child is for bags', 'calibrate', *common,
                    '--odometry-tf-child', 'base_link')
        self.expect(2, "'1,1,2' is no order of rotors", 'calibrate', *common, '--rotor-order',
                    '1,1,2')
        self.expect(2, '.bag or .csv', 'simulate', *vehicle, '--trajectory', 'octo', '--seed', '1',
                    '--out', self.path('x.txt'))
        self.expect(2, 'zigzag', 'simulate', *vehicle, '--trajectory', 'zigzag', '--seed', '1',
                    '--out', self.path('x.csv'))
        self.expect(2, '--vehicle', 'benchmark', self.flight(), *out)
        self.expect(2, 'magic', 'benchmark', *out, '--solver', 'incremental,magic')
        self.expect(2, '--solver', 'benchmark', *out, '--set', 'solver=ceres')
        self.expect(2, '--windows', 'benchmark', *out, '--set', 'window_s=1')
        self.expect(2, '--full-solve-every', 'benchmark', *out, '--full-solve-every', '-1')

    def test_bad_input_ends_with_status_one(self) -> None:
        out = ('--out', self.path('out'), '--no-report')
        self.expect(1, 'missing.csv', 'calibrate', self.path('missing.csv'), '--vehicle', VEHICLE,
                    *out)
        self.expect(1, 'missing.yaml', 'calibrate', self.flight(), '--vehicle',
                    self.path('missing.yaml'), *out)
        self.expect(1, 'empty.csv', 'calibrate', self.write('empty.csv', ''), '--vehicle', VEHICLE,
                    *out)
        with open(self.flight('bag'), 'rb') as bag:
            start = bag.read(20000)
        with open(self.path('short.bag'), 'wb') as bag:
            bag.write(start)
        self.expect(1, 'short.bag', 'calibrate', self.path('short.bag'), '--vehicle', VEHICLE, *out)
        self.expect(1, 'nothing to estimate', 'calibrate', self.flight(), '--vehicle', VEHICLE,
                    '--parameters', self.path('new/folder/flight_truth.yaml'), *out)
        self.expect(1, 'between --start and --end', 'calibrate', self.flight(), '--vehicle',
                    VEHICLE, '--start', '100', *out)
        self.expect(1, 'blocks of', 'calibrate', self.flight(), '--vehicle', VEHICLE,
                    '--leave-out', '1e-12', *out)
        os.symlink('/dev/full', self.path('full.bag'))
        self.expect(1, 'full.bag: cannot be written', 'simulate', '--vehicle', VEHICLE,
                    '--trajectory', 'octo', '--seed', '1', '--duration', '5', '--out',
                    self.path('full.bag'))
        blocked = self.write('file', 'not a folder')
        self.expect(1, 'folder', 'calibrate', self.flight(), '--vehicle', VEHICLE, '--out', blocked)

    def test_never_flying_is_said(self) -> None:
        rows = ['t,px,py,pz,qw,qx,qy,qz,rotor1,rotor2,rotor3,rotor4']
        rows += [f'{i * 0.01:.2f},{1e-4 * (i % 3)},0,0,1,0,0,0,10,10,10,10' for i in range(300)]
        flight = self.write('standing.csv', '\n'.join(rows) + '\n')
        self.expect(1, 'never airborne', 'calibrate', flight, '--vehicle', VEHICLE, '--out',
                    self.path('out'))
        self.expect(1, "lack 'thrust'", 'calibrate', self.flight(), '--vehicle', VEHICLE, '--effects',
                    'drag,gravity', '--out', self.path('out'))
        done = run('evaluate', flight, '--vehicle', VEHICLE, '--parameters',
                   self.path('new/folder/flight_truth.yaml'), '--out', self.path('standing'),
                   '--no-report')
        self.assertEqual(done.returncode, 0, done.stderr)
        report = read_json(self.path('standing'), 'report.json')
        self.assertIsNone(report['prediction']['force_rmse_N'])
        self.assertTrue(report['warnings'])

    def warnings_of(self, flight: str, *arguments: str) -> str:
        """What calibrate warns of, one line each."""
        done = run('calibrate', flight, '--vehicle', VEHICLE, '--no-report', '--out',
                   self.path('warned'), *arguments)
        self.assertEqual(done.returncode, 0, done.stderr)
        report = read_json(self.path('warned'), 'report.json')
        return '\n'.join(report['warnings'])

    def changed(self, name: str, column: str, change: Any, rows: Any = None) -> str:
        """The flight with one column changed, in these rows or all."""
        table = read_table(self.flight())
        for i, row in enumerate(table):
            if rows is None or i in rows:
                row[column] = str(change(float(row[column])))
        with open(self.path(name), 'w', encoding='utf-8', newline='') as file:
            writer = csv.DictWriter(file, table[0].keys())
            writer.writeheader()
            writer.writerows(table)
        return self.path(name)

    def test_bad_readings_are_named_and_not_used(self) -> None:
        flight = self.changed('spike.csv', 'rotor2', lambda w: 65535.0, [1000])
        self.assertIn('1 sample of rotor speeds beyond what a sensor reads, 2.500 s',
                      self.warnings_of(flight))
        flight = self.changed('leap.csv', 'rotor2', lambda w: 9000.0, [1000])
        self.assertIn('1 sample of rotor speeds leaping away from both neighbours, 2.500 s',
                      self.warnings_of(flight))
        leapt = read_json(self.path('warned'), 'report.json')['prediction']['force_rmse_N']
        self.assertNotIn('leaping', self.warnings_of(self.flight()))
        clean = read_json(self.path('warned'), 'report.json')['prediction']['force_rmse_N']
        for axis in range(3):
            self.assertAlmostEqual(leapt[axis], clean[axis], delta=0.01 * clean[axis])

    def test_wrong_units_and_masses_are_said(self) -> None:
        flight = self.changed('rpm.csv', 'rotor1', lambda w: 9.549 * w)
        for name in ('rotor2', 'rotor3', 'rotor4'):
            table = read_table(flight)
            for row in table:
                row[name] = str(9.549 * float(row[name]))
            with open(flight, 'w', encoding='utf-8', newline='') as file:
                writer = csv.DictWriter(file, table[0].keys())
                writer.writeheader()
                writer.writerows(table)
        done = run('calibrate', flight, '--vehicle', VEHICLE, '--no-report', '--out', self.path('refused'))
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn('rpm.csv: the rotor speeds are not in rad/s but in rpm', done.stderr)
        self.assertIn('check the unit of the rotor speeds', self.warnings_of(flight, '--force'))
        self.warnings_of(self.flight())
        with open(VEHICLE, encoding='utf-8') as file:
            heavy = file.read().replace('mass_kg: 0.75', 'mass_kg: 1.5')
        done = run('calibrate', self.flight(), '--vehicle', self.write('heavy.yaml', heavy),
                   '--parameters', self.path('warned/parameters.yaml'), '--no-report', '--out',
                   self.path('heavy'))
        self.assertIn('belong to a mass of 0.75 kg, the vehicle file says 1.5 kg', done.stdout)

    def test_bag_and_csv_calibrate_to_the_same(self) -> None:
        reports = []
        for ending in ('bag', 'csv'):
            done = run('calibrate', self.flight(ending), '--vehicle', VEHICLE, '--out',
                       self.path(ending, 'deep'), '--no-report')
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(done.stderr, '')
            reports.append(read_json(self.path(ending, 'deep'), 'report.json'))
        bag, table = (report['parameters'] for report in reports)
        self.assertEqual(list(bag), list(table))
        for name, entry in bag.items():
            for key in ('value', 'sigma'):
                self.assertLessEqual(abs(entry[key] - table[name][key]),
                                     1e-6 * (abs(entry['value']) + entry['sigma']), name)

    def test_convert_keeps_everything(self) -> None:
        for source, out in ((self.flight(), 'c.bag'), (self.path('c.bag'), 'c.csv'), (self.flight('bag'), 'd.bag')):
            done = run('convert', source, self.path(out))
            self.assertEqual(done.returncode, 0, done.stderr)
        for one, other in zip(read_table(self.flight()), read_table(self.path('c.csv')), strict=True):
            self.assertAlmostEqual(float(one.pop('vbat') or 0), float(other.pop('vbat') or 0), 5)  # a float32 in a bag
            self.assertEqual(one, other)
        with open(self.flight('bag'), 'rb') as one, open(self.path('d.bag'), 'rb') as other:
            self.assertEqual(one.read(), other.read())

    def test_convert_keeps_commands_and_moves_the_start(self) -> None:
        rows = read_table(self.flight())
        for k, row in enumerate(rows):
            row.update({f'pwm{j}_us': str(1000 + (k + 50 * j) % 1000) for j in range(1, 5)})
        source = self.path('commands.csv')
        with open(source, 'w', encoding='utf-8', newline='') as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        run('convert', source, self.path('commands.bag'))
        done = run('convert', self.path('commands.bag'), self.path('back.csv'), '--start-time', '5', '--start', '1')
        self.assertEqual(done.returncode, 0, done.stderr)
        back = read_table(self.path('back.csv'))
        self.assertEqual(float(back[0]['t']), 5.0)
        first = next(r for r in rows if float(r['t']) >= float(rows[0]['t']) + 1.0)
        for j in range(1, 5):  # a bag holds throttles
            self.assertAlmostEqual(float(back[0][f'throttle{j}']), (float(first[f'pwm{j}_us']) - 1000) / 1000, 6)

    def test_convert_says_what_is_wrong_and_lists_flights(self) -> None:
        self.expect(2, 'OUT must end in .bag, .csv, .ulg, .bin or .bbl', 'convert', self.flight(), self.path('x.txt'))
        self.expect(2, 'OUT is FLIGHT itself', 'convert', self.flight(), self.flight())
        self.expect(1, 'cannot be opened; a flight is', 'convert', self.path('none.x'), self.path('x.csv'))
        os.makedirs(self.path('listed'))
        for name in ('flight10.csv', 'flight2.bag', 'flight2_mocap.csv', 'firmware.bin', 'LOG1.BFL', 'notes.txt'):
            self.write(os.path.join('listed', name), 'x')
        done = run('convert', self.path('listed'), '--list')
        self.assertEqual([os.path.basename(name) for name in done.stdout.splitlines()],
                         ['LOG1.BFL', 'flight2.bag', 'flight10.csv'])

    def test_autopilot_logs_of_a_flight_calibrate_as_its_csv(self) -> None:
        with open(VEHICLE, encoding='utf-8') as file:
            vehicle = self.write('with_imu.yaml', file.read().replace('# imu: {frame: sensor', 'imu: {frame: sensor'))
        source = self.path('imu.csv')
        done = run('simulate', '--vehicle', vehicle, '--trajectory', 'aggressive', '--out', source, '--seed', '4',
                   '--duration', '10', '--noise', self.write('noise.yaml', 'imu: true\n'))
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = [{name: float(cell) for name, cell in row.items()} for row in read_table(source)]
        log_writers.write_ulog(rows, self.path('flight.ulg'))
        log_writers.write_dataflash(rows, self.path('log.bin'))
        without_rates = self.path('without_rates.csv')
        with open(without_rates, 'w', encoding='utf-8', newline='') as file:
            writer = csv.DictWriter(file, [name for name in rows[0] if name not in ('wx', 'wy', 'wz')], extrasaction='ignore')
            writer.writeheader()
            writer.writerows(rows)
        for flight, log in ((source, 'flight.ulg'), (without_rates, 'log.bin')):
            results = []
            for file_name in (flight, self.path(log)):
                done = run('calibrate', file_name, '--vehicle', vehicle, '--no-report', '--out', self.path('log'))
                self.assertEqual(done.returncode, 0, done.stderr)
                results.append(read_json(self.path('log'), 'report.json')['parameters'])
            for name, parameter in results[0].items():
                if parameter['sigma']:
                    difference = abs(parameter['value'] - results[1][name]['value'])
                    self.assertLess(difference, 0.1 * parameter['sigma'], f'{log}: {name}')

    def imu_flight(self) -> List[str]:
        """A simulated flight with an IMU as a bag, and its vehicle file; made once."""
        source, vehicle = self.path('with_imu.bag'), self.path('with_imu_of_bag.yaml')
        if not os.path.exists(source):
            with open(VEHICLE, encoding='utf-8') as file:
                self.write('with_imu_of_bag.yaml', file.read().replace('# imu: {frame: sensor', 'imu: {frame: sensor'))
            done = run('simulate', '--vehicle', vehicle, '--trajectory', 'aggressive', '--out', source, '--seed', '5',
                       '--duration', '12', '--noise', self.write('noise.yaml', 'imu: true\n'))
            self.assertEqual(done.returncode, 0, done.stderr)
        return [source, vehicle]

    def parameters_of_imu_flight(self) -> Dict[str, Any]:
        """What calibrate finds of it; asked once."""
        if not ToolsTest.of_imu_flight:
            source, vehicle = self.imu_flight()
            ToolsTest.of_imu_flight = self.parameters_of(source, '--vehicle', vehicle)
        return ToolsTest.of_imu_flight

    def parameters_of(self, *arguments: str) -> Dict[str, Any]:
        """What calibrate finds."""
        done = run('calibrate', *arguments, '--no-report', '--out', self.path('found'))
        self.assertEqual(done.returncode, 0, done.stderr)
        return read_json(self.path('found'), 'report.json')['parameters']

    def assert_near(self, one: Dict[str, Any], other: Dict[str, Any], sigmas: float) -> None:
        """All estimates within so many of the first one's sigmas."""
        for name, parameter in one.items():
            if parameter['sigma']:
                self.assertLess(abs(parameter['value'] - other[name]['value']), sigmas * parameter['sigma'], name)

    def test_flights_written_as_logs_calibrate_as_they_do(self) -> None:
        source, vehicle = self.imu_flight()
        for ending in ('ulg', 'bin', 'bbl'):
            done = run('convert', source, self.path(f'written.{ending}'))
            self.assertEqual(done.returncode, 0, done.stderr)
        whole = self.parameters_of_imu_flight()
        self.assert_near(whole, self.parameters_of(self.path('written.ulg'), '--vehicle', vehicle), 0.1)
        # The other two have no body rates beside the gyro, and blackbox counts whole rad/s, mm and cm/s.
        rows = self.path('no_rates.csv')
        self.assertEqual(run('convert', self.path('written.bin'), rows).returncode, 0)
        without = self.parameters_of(self.path('written.bin'), '--vehicle', vehicle)
        self.assert_near(whole, without, 3.0)
        self.assert_near(whole, self.parameters_of(self.path('written.bbl'), '--vehicle', vehicle), 3.0)

    def test_a_log_without_poses_gets_them_from_another_recording(self) -> None:
        source, vehicle = self.imu_flight()
        log, poses = self.path('LOG1.bbl'), self.path('poses.csv')
        self.assertEqual(run('convert', source, log, '--without', 'poses').returncode, 0)
        done = run('convert', source, self.path('whole.csv'))
        self.assertEqual(done.returncode, 0, done.stderr)
        table = read_table(self.path('whole.csv'))
        start_s = float(table[0]['t'])
        with open(poses, 'w', encoding='utf-8', newline='') as file:
            names = ['t', *(name for name in table[0] if name[0] in 'pqv' and len(name) == 2)]
            writer = csv.DictWriter(file, names, extrasaction='ignore')
            writer.writeheader()
            for row in table:
                row['t'] = f"{float(row['t']) + 123.456:.9f}"  # another clock
                writer.writerow(row)
        out = ('--vehicle', vehicle, '--out', self.path('x'), '--no-report')
        self.expect(1, '--odometry FILE takes it from a recording', 'calibrate', log, *out)
        self.expect(2, 'goes with --odometry FILE', 'calibrate', log, '--odometry-offset', '1', *out)
        whole = self.parameters_of_imu_flight()
        found = self.parameters_of(log, '--odometry', poses, '--vehicle', vehicle)
        self.assert_near(whole, found, 3.0)
        text = '\n'.join(read_json(self.path('found'), 'report.json')['warnings'])
        offset, sigma_ms = map(float, re.search(r'([-0-9.]+) s added to their stamps \(sigma ([0-9.]+) ms', text).groups())
        true = 1.0 - math.floor(start_s) - 123.456  # the log's clock starts within the second after 1 s
        self.assertLess(abs(offset - true), min(0.002, 4e-3 * sigma_ms + 1e-4), text)
        told = self.parameters_of(log, '--odometry', poses, '--odometry-offset', f'{true:.6f}', '--vehicle', vehicle)
        self.assert_near(told, found, 1.0)
        os.makedirs(self.path('recordings'), exist_ok=True)
        self.expect(1, 'has no recording of the name of', 'calibrate', log, '--odometry', self.path('recordings'), *out)
        os.rename(poses, self.path('recordings/LOG1.csv'))
        again = self.parameters_of(log, '--odometry', self.path('recordings'), '--vehicle', vehicle)
        self.assertEqual(again, found)
        os.makedirs(self.path('logs'))
        os.rename(log, self.path('logs/LOG1.bbl'))
        done = subprocess.run([os.path.join(ROOT, 'scripts', 'fleet'), self.path('logs'), '--vehicle', vehicle, '--odometry',
                               self.path('recordings'), '--out', self.path('fleet'), '--no-verdicts', '--jobs', '1'],
                              capture_output=True, text=True, check=False, timeout=600,
                              env={**os.environ, 'ODMC_TOOLS': TOOLS})
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        log = self.path('logs/LOG1.bbl')
        for tool, more in (('inspect', ()), ('evaluate', ('--parameters', self.path('found/parameters.yaml')))):
            done = run(tool, log, '--odometry', self.path('recordings'), '--vehicle', vehicle, '--out', self.path(tool),
                       '--no-report', *more)
            self.assertEqual(done.returncode, 0, done.stderr)

    def test_actuators_are_calibrated_from_logs(self) -> None:
        rows = ['t,gx,gy,gz,throttle1,throttle2,throttle3,throttle4,rotor1,rotor2,rotor3,rotor4,vbat']
        speeds = [300.0] * 4
        for i in range(12000):
            t = 0.002 * i
            throttles = [0.45 + 0.25 * math.sin(1.3 * t + j) + 0.15 * math.copysign(1.0, math.sin(4.1 * t + 2 * j))
                         for j in range(4)]
            speeds = [w + 0.002 / 0.03 * (150.0 + 1500.0 * u - w) for w, u in zip(speeds, throttles)]
            cells = [f'{t:.6f}', '0.1', '0', '0', *(f'{u:.6f}' for u in throttles), *(f'{w:.4f}' for w in speeds),
                     f'{16.0 - 0.02 * t:.4f}']
            rows.append(','.join(cells))
        source = self.write('bench.csv', '\n'.join(rows) + '\n')
        out = ('--out', self.path('actuator'), '--no-report')
        done = run('calibrate_actuator', source, '--command-unit', 'fraction', '--speed-unit', 'rad_s', *out)
        self.assertEqual(done.returncode, 0, done.stderr)
        expected = read_json(self.path('actuator'), 'report.json')
        for name in ('bench.ulg', 'bench.bin', 'bench.bbl'):
            self.assertEqual(run('convert', source, self.path(name)).returncode, 0)
            done = run('calibrate_actuator', self.path(name), *out)
            self.assertEqual(done.returncode, 0, done.stderr)
            report = read_json(self.path('actuator'), 'report.json')
            self.assertEqual(len(report['motors']), 4)
            # To what a log rounds: whole rpm, whole microseconds of pulse length, electrical rpm in hundreds.
            self.assertAlmostEqual(report['lag_s'], expected['lag_s'], delta=1e-3)
            for key in ('S_1', 'time_constant_s', 'delay_s'):
                value = expected['parameters'][key]['value']
                self.assertAlmostEqual(report['parameters'][key]['value'], value, delta=0.005 * abs(value), msg=f'{name}: {key}')
        self.expect(2, '--command-unit is required for CSV files and bags', 'calibrate_actuator', source, *out)
        self.expect(1, 'the vehicle has 6 rotors', 'calibrate_actuator', self.path('bench.ulg'), '--rotors', '6', *out)

    def test_a_blackbox_log_calibrates_as_the_csv_made_from_it(self) -> None:
        data = os.path.join(os.environ.get('ODMC_DATA_DIR') or os.path.join(ROOT, '..', 'shared', 'data'), 'indiflight')
        log = os.path.join(data, 'raw', 'LOG00267.BFL')
        if not os.path.exists(log):
            self.skipTest('no recorded data')
        results = []
        for arguments in ((os.path.join(data, 'LOG00267.csv'),), (log, '--start', '0.9615', '--end', '31.119')):
            done = run('calibrate', *arguments, '--vehicle', os.path.join(data, 'vehicle.yaml'), '--no-report', '--out',
                       self.path('log'))
            self.assertEqual(done.returncode, 0, done.stderr)
            results.append(read_json(self.path('log'), 'report.json')['parameters'])
        for name, parameter in results[0].items():
            if parameter['sigma']:
                difference = abs(parameter['value'] - results[1][name]['value'])
                self.assertLess(difference, 0.1 * parameter['sigma'], name)

    def test_close_loop_names_nothing_that_ruins_a_prediction(self) -> None:
        data = os.path.join(os.environ.get('ODMC_DATA_DIR') or os.path.join(ROOT, '..', 'shared', 'data'), 'imrc_cf21_brushless')
        if not os.path.isdir(data):
            self.skipTest('no recorded data')
        vehicle = ['--vehicle', os.path.join(ROOT, 'config', 'vehicles', 'imrc_cf21_brushless.yaml'), '--no-report']
        done = run('calibrate', os.path.join(data, 'eckart00.csv'), *vehicle, '--out', self.path('taught'))
        self.assertEqual(done.returncode, 0, done.stderr)
        done = run('close_loop', os.path.join(data, 'eckart15.csv'), *vehicle, '--out', self.path('loop'),
                   '--parameters', os.path.join(self.path('taught'), 'parameters.yaml'))
        self.assertEqual(done.returncode, 0, done.stderr)
        # In a closed room; an online run that leaves the fit's valley finds 2 m/s.
        report = read_json(self.path('loop'), 'report.json')
        self.assertTrue(report['effects'])
        for effect in report['effects']:
            for name, parameter in effect['parameters'].items():
                if name.startswith('wind.'):
                    self.assertLess(abs(parameter['value']), 0.5)
        for before, after in zip(report['force_rmse_before'], report['force_rmse_after']):
            self.assertLess(after, 2.0 * before)

    def test_calibrate_leaves_blocks_out(self) -> None:
        out = self.path('left_out')
        done = run('calibrate', '--vehicle', VEHICLE, '--out', out, '--leave-out', '2.5',
                   self.flight())
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('blocks of 2.5 s left out in turn', done.stdout)
        report = read_json(out, 'report.json')
        seen, unseen = report['prediction'], report['prediction_left_out']
        self.assertEqual(unseen['block_s'], 2.5)
        for a, b in zip(seen['force_rmse_N'], unseen['force_rmse_N']):
            self.assertAlmostEqual(b / a, 1.0, delta=0.3)
        with open(os.path.join(out, 'report.html'), encoding='utf-8') as file:
            self.assertIn('Blocks left out of the estimate in turn', file.read())
        self.expect(1, 'are no two blocks of 100 s to leave out', 'calibrate', self.flight(),
                    '--vehicle', VEHICLE, '--out', out, '--leave-out', '100')

    def test_calibrate_evaluate_and_report(self) -> None:
        out = self.path('whole')
        done = run('calibrate', '--vehicle', VEHICLE, '--out', out, '--freeze', 'inertia.z',
                   self.flight())
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stderr, '')
        self.assertIn('rotor torque gain', done.stdout)
        self.assertIn('inertia over nominal', done.stdout)
        self.assertEqual(set(os.listdir(out)),
                         {'flight.json', 'history.csv', 'parameters.yaml', 'phases.csv', 'prediction.csv',
                          'report.html', 'report.json', 'timing.csv'})
        report = read_json(out, 'report.json')
        self.assertEqual(set(report['flight']),
                         {'file', 'duration_s', 'on_ground_s', 'keyframes', 'dropped'})
        self.assertEqual(set(report['parameters']), set(report['convergence_s']))
        thrust = report['parameters']['thrust.k_f']
        self.assertEqual((thrust['state'], thrust['observable']), ('estimated', True))
        self.assertAlmostEqual(thrust['value'] / 1.5e-6, 1.0, delta=0.02)
        self.assertEqual(report['parameters']['rotor_torque.k_m']['state'], 'frozen')
        self.assertEqual(report['parameters']['inertia.z']['state'], 'frozen')
        self.assertIsNone(report['convergence_s']['rotor_torque.k_m'])
        self.assertEqual(report['timing_ms']['threads'], 1)
        self.assertGreater(report['timing_ms']['updates'], 100)
        history = read_table(out, 'history.csv')
        self.assertAlmostEqual(float(history[-1]['thrust.k_f']), thrust['value'],
                               delta=1e-8 * thrust['value'])
        self.check_evaluation(out, report)

    def check_evaluation(self, out: str, report: Dict[str, Any]) -> None:
        """Evaluating the same flight with the result gives the same figures."""
        done = run('evaluate', self.flight(), '--vehicle', VEHICLE, '--parameters',
                   os.path.join(out, 'parameters.yaml'), '--out', self.path('evaluated'))
        self.assertEqual(done.returncode, 0, done.stderr)
        again = read_json(self.path('evaluated'), 'report.json')
        self.assertEqual(set(again['flight']), set(report['flight']))
        self.assertIsNone(report['prediction']['accelerometer_force_rmse_N'])  # there is none
        for key, values in report['prediction'].items():
            if values is None:
                self.assertIsNone(again['prediction'][key], key)
                continue
            for one, other in zip(values, again['prediction'][key]):
                self.assertTrue(math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12), key)
        self.assertTrue(os.path.isfile(self.path('evaluated', 'report.html')))
        self.assertEqual(again['followed'], [])
        self.check_following(os.path.join(out, 'parameters.yaml'))

    def check_following(self, parameters: str) -> None:
        """What follows the flight is named, and cannot be what the model lacks."""
        arguments = ('evaluate', self.flight(), '--vehicle', VEHICLE, '--parameters', parameters, '--no-report')
        done = run(*arguments, '--out', self.path('followed'), '--follow', 'centre_of_gravity.x,centre_of_gravity.y',
                   '--k-f-walk-rate', '0.004')
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('centre_of_gravity.x, centre_of_gravity.y, thrust.k_f: learned on this flight', done.stdout)
        self.assertEqual(read_json(self.path('followed'), 'report.json')['followed'],
                         ['centre_of_gravity.x', 'centre_of_gravity.y', 'thrust.k_f'])
        done = run(*arguments, '--out', self.path('followed'), '--follow', 'centre_of_gravity.q')
        self.assertNotEqual(done.returncode, 0)
        self.assertIn('centre_of_gravity.q cannot follow the flight: the vehicle has no such parameter', done.stderr)

    def test_simulation_has_its_truth_beside_it(self) -> None:
        truth = read_table(self.path('new/folder'), 'flight_truth.csv')
        flight = read_table(self.flight())
        self.assertEqual(len(truth), len(flight))
        self.assertAlmostEqual(float(truth[-1]['px']), float(flight[-1]['px']), delta=0.1)
        again = self.path('again.csv')
        done = run('simulate', '--vehicle', VEHICLE, '--trajectory', 'octo', '--out', again,
                   '--seed', '3', '--duration', '7', '--parameters',
                   self.path('new/folder/flight_truth.yaml'))
        self.assertEqual(done.returncode, 0, done.stderr)
        with open(again, encoding='utf-8') as one, open(self.flight(), encoding='utf-8') as other:
            self.assertEqual(one.read(), other.read())

    def test_recovery_reports_every_parameter(self) -> None:
        done = run('recovery', '--vehicle', VEHICLE, '--trajectory', 'octo', '--seeds', '2',
                   '--jobs', '2', '--duration', '4', '--out', self.path('recovery'), '--effects',
                   'thrust,drag,rotor_torque', '--no-report', '--start-thrust-factor', '2')
        self.assertEqual(done.returncode, 0, done.stderr)
        recovery = read_json(self.path('recovery'), 'report.json')['recovery']
        self.assertEqual((recovery['trajectory'], recovery['seeds']), ('octo', 2))
        self.assertEqual(set(recovery['parameters']),
                         {'thrust.k_f', 'drag.d_x', 'drag.d_y', 'drag.d_z'})
        for entry in recovery['parameters'].values():
            self.assertLessEqual({'median_error', 'median_relative_error',
                                  'median_error_over_sigma', 'coverage_3sigma'}, set(entry))

    def test_benchmark_measures_each_solver_and_window(self) -> None:
        out = self.path('benchmark')
        done = run('benchmark', '--windows', '0.2,0.4', '--solver', 'incremental,ceres',
                   '--keyframe-rate', '50', '--duration', '5', '--full-solve-every', '40',
                   '--out', out)
        self.assertEqual((done.returncode, done.stderr), (0, ''))
        self.assertEqual(set(os.listdir(out)), {'report.json', 'benchmark.png'})
        rows = read_json(out, 'report.json')['benchmark']
        self.assertEqual([(row['solver'], row['window_s'], row['states']) for row in rows],
                         [('incremental', 0.2, 10), ('incremental', 0.4, 20), ('ceres', 0.2, 10),
                          ('ceres', 0.4, 20)])
        for row in rows:
            self.check_benchmark(row)
        for key in ('aligned_share', 'sweeping_share'):
            self.assertTrue(0.0 <= rows[0]['incremental'][key] <= 1.0, key)
        self.assertGreater(rows[0]['incremental']['eliminated_median'], 0.0)
        self.assertIsNone(rows[2]['incremental'])

    def check_benchmark(self, row: Dict[str, Any]) -> None:
        """One solver at one window length."""
        self.assertEqual((row['keyframe_rate_hz'], row['threads']), (50.0, 1))
        self.assertGreater(row['updates'], 50)
        self.assertGreater(row['real_time_factor'], 0.0)
        stages = row['stages_wall_ms']
        self.assertEqual(list(stages), ['read', 'build', 'solve', 'snapshot', 'marginalize'])
        for times in (row['wall_ms'], row['cpu_ms'], *stages.values()):
            self.assertTrue(0.0 < times['median'] <= times['p95'] <= times['p99'] <= times['max'])
        self.assertLess(stages['solve']['median'], row['wall_ms']['median'])
        difference = row['comparison']
        self.assertGreaterEqual(difference['compared'], 3)
        self.assertEqual(difference['failed'], 0)
        self.assertLessEqual(difference['p95_parameter_difference_sigma'],
                             difference['largest_parameter_difference_sigma'])
        self.assertLess(difference['largest_sigma_difference'], 1.0)
        self.assertIn('.', difference['parameter'])
        self.assertIn('.', difference['sigma_parameter'])
        self.assertTrue(0.0 < difference['parameter_at_s'] < 5.0)

    def test_benchmark_compares_only_when_asked(self) -> None:
        out = self.path('benchmark_quick')
        done = run('benchmark', self.flight(), '--vehicle', VEHICLE, '--solver', 'ceres',
                   '--windows', '0.2', '--full-solve-every', '0', '--no-report', '--out', out)
        self.assertEqual((done.returncode, done.stderr), (0, ''))
        self.assertEqual(os.listdir(out), ['report.json'])
        row, = read_json(out, 'report.json')['benchmark']
        self.assertEqual((row['solver'], row['comparison']), ('ceres', None))

    def bench(self) -> str:
        """Steps of one motor: first-order lag of 30 ms, 700 rad/s at 20 %, 2000 per throttle."""
        rows, speed = ['t,pwm_us,rotor1,vbat,thrust_N'], 700.0
        for i in range(2400):
            throttle = 0.2 + 0.1 * (i // 400 % 3)
            rows.append(f'{0.005 * i:.3f},{1000 + 1000 * throttle:.0f},{speed:.2f},16.0,'
                        f'{1.5e-6 * speed * speed:.5f}')
            speed += (300 + 2000 * throttle - speed) * (1 - math.exp(-0.005 / 0.03))
        return self.write('bench.csv', '\n'.join(rows) + '\n')

    def test_calibrate_actuator_reports_what_a_bench_gives(self) -> None:
        out = self.path('actuator')
        done = run('calibrate_actuator', self.bench(), '--command-unit', 'us', '--speed-unit',
                   'rad_s', '--rotor-inertia', '1e-5', '--out', out)
        self.assertEqual(done.returncode, 0, done.stderr)
        report = read_json(out, 'report.json')
        self.assertEqual(set(report['parameters']), {'k_f', 'k_m', 'S_0', 'S_1', 'S_2', 'U_a',
                                                     'time_constant_s', 'delay_s'})
        self.assertAlmostEqual(report['parameters']['time_constant_s']['value'], 0.03, delta=0.002)
        self.assertAlmostEqual(report['parameters']['k_f']['value'], 1.5e-6, delta=1e-8)
        self.assertIn('time_constant_s', report['identifiable'])
        self.assertLess(report['steady_error_percent'], 1.0)
        self.assertLess(report['response_error_percent'], 3.0)
        for name in ('actuator.yaml', 'free_run.csv', 'report.html', 'actuator.png'):
            self.assertTrue(os.path.getsize(os.path.join(out, name)) > 300, name)

    def test_calibrate_actuator_says_what_is_wrong(self) -> None:
        declared = ['--command-unit', 'us', '--speed-unit', 'rad_s', '--out', self.path('bad')]
        bench = self.bench()
        self.expect(1, 'bench.csv: column nix (the rotor speed', 'calibrate_actuator', bench,
                    '--speed', 'nix', *declared)
        self.expect(2, '--pole-pairs', 'calibrate_actuator', bench, '--command-unit', 'us',
                    '--speed-unit', 'erpm', '--out', self.path('bad'))
        self.expect(1, 'no command in fraction',
                    'calibrate_actuator', bench, '--command-unit', 'fraction', '--speed-unit',
                    'rad_s', '--out', self.path('bad'))
        self.expect(1, 'has no commands to take rotor speeds from', 'calibrate', self.flight(),
                    '--vehicle', VEHICLE, '--rotor-speed-from', 'commands', '--out',
                    self.path('bad'))

    def test_escape_sequences_are_not_echoed(self) -> None:
        evil = '\x1b[2Jevil'
        with open(self.flight(), encoding='utf-8') as file:
            header, *rows = file.read().splitlines()
        flight = self.write(f'{evil}.csv', '\n'.join([f'{header},{evil}'] +
                                                     [f'{row},1' for row in rows]))
        out = self.path('evil')
        done = run('calibrate', flight, '--vehicle', VEHICLE, '--out', out)
        self.assertEqual(done.returncode, 0, done.stderr)
        with open(os.path.join(out, 'report.json'), encoding='utf-8') as file:
            report = file.read()
        with open(os.path.join(out, 'report.html'), encoding='utf-8') as file:
            page = file.read()
        for text in (done.stdout, done.stderr, report, page):
            self.assertNotIn('\x1b', text)
            self.assertNotIn('\\u001b', text)
        self.assertIn('unknown columns ignored: \\x1b[2Jevil', done.stdout)
        self.expect(1, '\\x1b[2Jnone.csv: cannot be opened', 'calibrate', '\x1b[2Jnone.csv',
                    '--vehicle', VEHICLE, '--out', out)

    def test_flat_frame_is_used_with_a_warning(self) -> None:
        with open(VEHICLE, encoding='utf-8') as file:
            flat = file.read().replace('[0.0025, 0.0025, 0.0043]', '[0.002, 0.002, 0.0043]')
        vehicle = self.write('flat.yaml', flat)
        flight = self.path('flat.csv')
        done = run('simulate', '--vehicle', vehicle, '--trajectory', 'octo', '--seed', '1',
                   '--duration', '5', '--out', flight)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('warning: the vehicle file\'s inertia breaks the triangle', done.stderr)
        done = run('calibrate', flight, '--vehicle', vehicle, '--no-report', '--out',
                   self.path('flat'))
        self.assertEqual(done.returncode, 0, done.stderr)
        warnings = read_json(self.path('flat'), 'report.json')['warnings']
        self.assertTrue(any('triangle inequality' in w for w in warnings), warnings)

    def test_values_that_no_vehicle_has_are_refused(self) -> None:
        with open(self.path('new/folder/flight_truth.yaml'), encoding='utf-8') as file:
            text = file.read()
        for key, value in (('thrust.k_f', '1.0e+300'), ('inertia.x', '2.5')):
            wrong = re.sub(key + r': {value: [^,]*', f'{key}: {{value: {value}', text)
            self.expect(1, f'wrong.yaml: parameters.{key}.value: ', 'calibrate', self.flight(),
                        '--vehicle', VEHICLE, '--parameters', self.write('wrong.yaml', wrong),
                        '--out', self.path('wrong'))
        with open(VEHICLE, encoding='utf-8') as file:
            vehicle = self.write('zero.yaml', file.read() + 'actuator: /dev/zero\n')
        self.expect(1, 'actuator: /dev/zero: is no regular file', 'calibrate', self.flight(),
                    '--vehicle', vehicle, '--out', self.path('wrong'))

    def test_clock_that_was_set_is_named(self) -> None:
        flight = self.changed('set.csv', 't', lambda t: t + 1.7e9, range(1000, 5000))
        self.expect(1, 'set.csv: time leaps by 1700000000 s, 2.498 s after the first pose',
                    'calibrate', flight, '--vehicle', VEHICLE, '--out', self.path('set'))
        done = run('calibrate', flight, '--vehicle', VEHICLE, '--no-report', '--end', '2.4',
                   '--out', self.path('set'))
        self.assertEqual(done.returncode, 0, done.stderr)

    def grows_by(self, durations: Any, *command: str) -> float:
        """Bytes of peak memory per sample, between flights of two lengths at 400 Hz."""
        peaks = []
        for duration in durations:
            arguments = [a.replace('DURATION', str(duration)) for a in command]
            with subprocess.Popen([os.path.join(TOOLS, arguments[0]), *arguments[1:]],
                                  stdout=subprocess.DEVNULL) as process:
                _, status, usage = os.wait4(process.pid, 0)
                process.returncode = status
            self.assertEqual(status, 0, command)
            peaks.append(1024.0 * usage.ru_maxrss)
        return (peaks[1] - peaks[0]) / (400.0 * (durations[1] - durations[0]))

    def test_memory_grows_with_the_log_only(self) -> None:
        # A sample of the log has 300 bytes (pose, rotors, battery). Truth, predictions and history
        # have 2000, kept by none of the tools.
        flight = self.path('long_DURATION.csv')
        durations = (20, 120)
        self.assertLess(self.grows_by(durations, 'simulate', '--vehicle', VEHICLE, '--trajectory',
                                      'octo', '--duration', 'DURATION', '--seed', '1', '--out',
                                      flight), 600.0)
        self.assertLess(self.grows_by(durations, 'calibrate', flight, '--vehicle', VEHICLE,
                                      '--no-report', '--out', self.path('long')), 900.0)

    def new_vehicle(self, name: str, *arguments: str) -> Dict[str, Any]:
        """A vehicle file that new_vehicle wrote; every number a number for YAML 1.1, too."""
        out = self.path(name)
        done = run('new_vehicle', '--out', out, '--force', *arguments)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn(f'{out} written', done.stdout)
        with open(out, encoding='utf-8') as file:
            vehicle = yaml.safe_load(file)
        numbers = [vehicle['mass_kg'], *vehicle['inertia_kg_m2'], vehicle['parameters']['thrust.k_f']['value'],
                   *(x for rotor in vehicle['rotors'] for x in rotor['position_m'])]
        self.assertTrue(all(isinstance(number, float) for number in numbers), numbers)
        return vehicle

    @staticmethod
    def corners(vehicle: Dict[str, Any]) -> List[Any]:
        """Of each rotor: is it in front, is it left, how does it turn?"""
        return [(float(r['position_m'][0]) > 0.0, float(r['position_m'][1]) > 0.0, r['spin']) for r in vehicle['rotors']]

    def test_new_vehicle_finds_rotors_and_thrust_in_every_format(self) -> None:
        flight = self.path('lively.csv')
        done = run('simulate', '--vehicle', VEHICLE, '--trajectory', 'aggressive', '--out', flight, '--seed', '4',
                   '--duration', '20')
        self.assertEqual(done.returncode, 0, done.stderr)
        bag = self.path('lively.bag')
        self.assertEqual(run('convert', flight, bag).returncode, 0)
        with open(VEHICLE, encoding='utf-8') as file:
            truth = yaml.safe_load(file)
        k_f = float(truth['parameters']['thrust.k_f']['value'])
        for recording in (flight, bag):
            found = self.new_vehicle('found.yaml', '--from', recording, '--mass', '0.75')
            self.assertEqual(self.corners(found), self.corners(truth), recording)
            self.assertAlmostEqual(found['parameters']['thrust.k_f']['value'] / k_f, 1.0, delta=0.02)
        with open(self.path('found.yaml'), encoding='utf-8') as file:
            text = file.read()
        for word in ('# asked: ', '# order found: ', ' Spins found: ', '# found: ', '# guessed: '):
            self.assertIn(word, text)
        done = run('calibrate', flight, '--vehicle', self.path('found.yaml'), '--no-report', '--out', self.path('cal_found'))
        self.assertEqual(done.returncode, 0, done.stderr)
        own = run('calibrate', flight, '--vehicle', VEHICLE, '--no-report', '--out', self.path('cal_own'))
        self.assertEqual(own.returncode, 0, own.stderr)
        by_found, by_own = (read_json(self.path(name), 'report.json')['parameters']['thrust.k_f']['value']
                            for name in ('cal_found', 'cal_own'))
        self.assertAlmostEqual(by_found / by_own, 1.0, delta=0.03)

    def test_new_vehicle_takes_autopilot_logs(self) -> None:
        data = os.path.join(os.environ.get('ODMC_DATA_DIR') or os.path.join(ROOT, '..', 'shared', 'data'), 'indiflight')
        log = os.path.join(data, 'raw', 'LOG00267.BFL')
        if not os.path.exists(log):
            self.skipTest('no recorded data')
        found = self.new_vehicle('indi.yaml', '--from', log, '--mass', '0.428', '--arm', '0.0455,0.0635')
        with open(os.path.join(data, 'vehicle.yaml'), encoding='utf-8') as file:
            truth = yaml.safe_load(file)
        self.assertEqual(self.corners(found), self.corners(truth))
        self.assertAlmostEqual(found['parameters']['thrust.k_f']['value'] / 2.66e-7, 1.0, delta=0.03)
        self.assertAlmostEqual(found['rotors'][0]['position_m'][1], -0.0635, places=6)
        with open(self.path('indi.yaml'), encoding='utf-8') as file:
            self.assertIn("motors 1, 2, 3, 4 of betaflight's quad_x", ' '.join(file.read().replace('#', ' ').split()))

    def test_new_vehicle_takes_a_drawing(self) -> None:
        def rotor(number: int, xyz: str, axis: str) -> str:
            return (f"<link name='rotor_{number}'><visual><geometry><cylinder radius='0.07' length='0.01'/></geometry></visual>"
                    f"</link><joint name='rotor_{number}_joint' type='continuous'><origin xyz='{xyz}'/>"
                    f"<parent link='base_link'/><child link='rotor_{number}'/><axis xyz='{axis}'/></joint>")
        urdf = self.write('quad.urdf', "<robot name='quad'><link name='base_link'><inertial><mass value='0.71'/>"
                          "<inertia ixx='2e-3' iyy='2.5e-3' izz='4e-3' ixy='0' ixz='0' iyz='0'/></inertial></link>"
                          + rotor(0, '0.1 -0.1 0.02', '0 0 1') + rotor(1, '-0.1 0.1 0.02', '0 0 1')
                          + rotor(2, '0.1 0.1 0.02', '0 0 -1') + rotor(3, '-0.1 -0.1 0.02', '0 0 -1') + '</robot>')
        vehicle = self.new_vehicle('drawn.yaml', '--urdf', urdf)
        self.assertEqual(vehicle['mass_kg'], 0.71)
        self.assertEqual(vehicle['rotors'][0]['position_m'], [0.1, -0.1, 0.02])
        self.assertEqual([r['spin'] for r in vehicle['rotors']], ['ccw', 'ccw', 'cw', 'cw'])
        heavier = self.new_vehicle('drawn.yaml', '--urdf', urdf, '--mass', '1.42')
        self.assertAlmostEqual(heavier['inertia_kg_m2'][0], 4e-3, places=9)

    def test_new_vehicle_says_what_is_wrong(self) -> None:
        out = ('--out', self.path('wrong.yaml'))
        common = ('--from', self.flight(), *out)
        self.expect(2, '--from FLIGHT or --urdf FILE', 'new_vehicle', '--mass', '1', *out)
        self.expect(2, '--mass', 'new_vehicle', *common)
        self.expect(2, "above zero, not '-1'", 'new_vehicle', *common, '--mass', '-1')
        common += ('--mass', '0.75')
        self.expect(2, 'quad_y', 'new_vehicle', *common, '--frame', 'quad_y')
        self.expect(2, 'naza', 'new_vehicle', *common, '--autopilot', 'naza')
        self.expect(2, "'x'", 'new_vehicle', *common, '--arm', 'x')
        self.expect(2, 'M or X,Y', 'new_vehicle', *common, '--arm', '1,2,3')
        self.expect(2, 'X,Y,Z', 'new_vehicle', *common, '--inertia', '1,2')
        self.expect(2, "not 'left'", 'new_vehicle', *common, '--spins', 'left,cw,cw,cw')
        self.expect(2, '--places', 'new_vehicle', *common, '--places', '1,1,2,3')
        self.expect(1, '3 entries, the vehicle 4 rotors', 'new_vehicle', *common, '--places', '1,2,3')
        self.expect(1, 'implausible', 'new_vehicle', *common, '--inertia', '5,5,5')
        self.expect(1, 'missing.csv', 'new_vehicle', '--from', self.path('missing.csv'), '--mass', '1', *out)
        self.expect(1, 'rotor5', 'new_vehicle', *common, '--frame', 'hexa_x')
        self.assertFalse(os.path.exists(self.path('wrong.yaml')))
        self.write('there.yaml', 'name: mine\n')
        self.expect(1, 'there already', 'new_vehicle', '--from', self.flight(), '--mass', '0.75', '--out',
                    self.path('there.yaml'))
        with open(self.path('there.yaml'), encoding='utf-8') as file:
            self.assertEqual(file.read(), 'name: mine\n')

    def test_inspect_needs_no_vehicle(self) -> None:
        out = self.path('inspected')
        done = run('inspect', self.flight(), '--out', out)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('rotors that would fit, as a quad_x', done.stdout)
        report = read_json(out, 'report.json')
        self.assertEqual(len(report['rotors']['places']), 4)
        self.assertNotIn('value', report['parameters']['thrust.k_f'])
        with open(os.path.join(out, 'report.html'), encoding='utf-8') as file:
            self.assertIn('Rotors that would fit, as a quad_x', file.read())
        done = run('inspect', self.flight(), '--vehicle', VEHICLE, '--out', out)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('value', read_json(out, 'report.json')['parameters']['thrust.k_f'])
        self.expect(2, '4, 6 or 8', 'inspect', self.flight(), '--rotors', '5')

    def test_catalogue_names_every_effect(self) -> None:
        for flags in ((), ('--markdown',)):
            done = run('list_effects', *flags)
            self.assertEqual(done.returncode, 0)
            for name in ('thrust.k_f', 'hvt.k_h', 'imu_extrinsics.rz', 'gravity.x'):
                self.assertIn(name, done.stdout)


if __name__ == '__main__':
    if len(sys.argv) > 1 and os.path.isdir(sys.argv[1]):
        TOOLS = sys.argv.pop(1)
    unittest.main()
