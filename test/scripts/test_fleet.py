"""scripts/fleet on small simulated fleets: joint result, reports, resume, crashes, expectations, a Dask cluster."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

import yaml

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
FLEET = os.path.join(ROOT, 'scripts', 'fleet')
TOOLS = os.path.join(ROOT, 'build', 'devel', 'lib', 'odmc')
VEHICLE = os.path.join(ROOT, 'config', 'vehicles', 'generic.yaml')
FLIGHTS = 4

try:
    import distributed
except ImportError:
    distributed = None


def fleet(folder, out, *more, tools=TOOLS):
    """Exit status, stdout, stderr."""
    done = subprocess.run([FLEET, folder, '--vehicle', VEHICLE, '--out', out, '--no-verdicts', *more],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, check=False,
                          env={**os.environ, 'ODMC_TOOLS': tools})
    return done.returncode, done.stdout.decode(), done.stderr.decode()


def parameters(out):
    """The vehicle's, as text."""
    with open(os.path.join(out, 'vehicles', 'generic', 'parameters.yaml'), encoding='utf-8') as file:
        return file.read()


def simulate(path, seed, *more):
    """A flight of 8 s. @returns what is true of it."""
    subprocess.run([os.path.join(TOOLS, 'simulate'), '--duration', '8', '--seed', str(seed), '--vehicle', VEHICLE, '--out',
                    path, *more], check=True, stdout=subprocess.DEVNULL)
    beside = path[:-len('.csv')] + '_truth'
    with open(beside + '.yaml', encoding='utf-8') as file:
        truth = yaml.safe_load(file)
    os.remove(beside + '.yaml')
    os.remove(beside + '.csv')
    return truth


def page_of(out):
    """fleet.html."""
    with open(os.path.join(out, 'fleet.html'), encoding='utf-8') as file:
        return file.read()


class FleetTest(unittest.TestCase):
    """Four flights of 8 s of one vehicle, and a file that is none."""

    @classmethod
    def setUpClass(cls):
        cls.base = tempfile.mkdtemp(prefix='odmc_fleet_')
        cls.folder = os.path.join(cls.base, 'flights')
        os.makedirs(os.path.join(cls.folder, 'day2'))
        for k in range(FLIGHTS):
            name = os.path.join('day2' if k == 3 else '', f'flight{k}.csv')
            simulate(os.path.join(cls.folder, name), k + 1, '--trajectory', 'octo')
        with open(os.path.join(cls.folder, 'notes.csv'), 'w', encoding='utf-8') as file:
            file.write('wind,cloud\n3,4\n')
        cls.out = os.path.join(cls.base, 'out')
        cls.result = fleet(cls.folder, cls.out)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.base)

    def test_flights_together_find_the_vehicle(self):
        status, text, _ = self.result
        self.assertEqual(status, 0, self.result)
        self.assertIn('4 flights together', text)
        with open(os.path.join(self.out, 'vehicles', 'generic', 'report.json'), encoding='utf-8') as file:
            report = json.load(file)
        k_f = report['parameters']['thrust.k_f']
        self.assertLess(abs(k_f['value'] - 1.5e-6), 3.0 * k_f['sigma'])
        self.assertLess(k_f['sigma'], 0.01 * 1.5e-6)
        for flight in report['flights']:
            self.assertEqual(len(flight['left_out']['force_rmse_N']), 3)

    def test_what_is_no_flight_is_named_with_its_reason(self):
        self.assertIn('notes.csv', self.result[1])
        with open(os.path.join(self.out, 'fleet.json'), encoding='utf-8') as file:
            rows = json.load(file)['flights']
        self.assertEqual(len(rows), FLIGHTS + 1)
        row = next(r for r in rows if r['flight'].endswith('notes.csv'))
        self.assertFalse(row['used'])
        self.assertIn('column', row['why'])

    def test_the_page_holds_its_pictures(self):
        page = page_of(self.out)
        self.assertIn('data:image/png;base64,', page)
        self.assertNotIn('http://', page)
        self.assertNotIn('https://', page)

    def test_rows_say_how_to_get_a_report(self):
        command = f"calibrate {os.path.join(self.folder, 'flight0.csv')} --vehicle {VEHICLE} --out flight0_report"
        self.assertIn(command, page_of(self.out))

    def test_reports_are_linked_kept_and_move_with_the_folder(self):
        few = os.path.join(self.base, 'few')
        os.makedirs(few)
        for k in range(2):
            shutil.copy(os.path.join(self.folder, f'flight{k}.csv'), few)
        first = os.path.join(self.base, 'first')
        status, _, err = fleet(few, first)
        self.assertEqual(status, 0, err)
        status, _, err = fleet(few, first, '--reports')
        self.assertIn('2 flights, 2 to calibrate', err)
        moved = os.path.join(self.base, 'moved')
        os.rename(first, moved)
        links = re.findall(r'<a href="([^"]*)">', page_of(moved))
        self.assertEqual(len(set(links)), 2)
        for link in links:
            with open(os.path.join(moved, link), encoding='utf-8') as file:
                self.assertIn('thrust.k_f', file.read())
        os.remove(os.path.join(moved, links[0]))
        _, _, err = fleet(few, moved, '--reports')
        self.assertIn('2 flights, 1 to calibrate', err)
        self.assertEqual(re.findall(r'<a href="([^"]*)">', page_of(moved)), links)
        _, _, err = fleet(few, moved, '--reports')
        self.assertIn('2 flights, 0 to calibrate', err)

    def test_what_comes_back_in_every_flight_is_named(self):
        folder, truth = os.path.join(self.base, 'dragged'), os.path.join(self.base, 'dragged_truth.yaml')
        os.makedirs(folder)
        true = simulate(os.path.join(self.base, 'plain.csv'), 1, '--trajectory', 'octo')
        true['effects'].append('quadratic_drag')
        true['parameters']['quadratic_drag.c_q'] = {'value': 0.05, 'state': 'frozen'}
        with open(truth, 'w', encoding='utf-8') as file:
            yaml.safe_dump(true, file)
        for k in range(6):
            simulate(os.path.join(folder, f'flight{k}.csv'), k + 1, '--trajectory', 'aggressive', '--parameters', truth)
        out = os.path.join(self.base, 'recurrent')
        status, text, err = fleet(folder, out)
        self.assertEqual(status, 0, err)
        self.assertIn('recurrent: force_', text)
        with open(os.path.join(out, 'fleet.json'), encoding='utf-8') as file:
            recurrent = json.load(file)['vehicles']['generic']['recurrent_residuals']
        found = [b for b in recurrent['bins'] if b['p_value'] < recurrent['false_alarm_rate']]
        self.assertGreater(len(found), 0)
        for row in found:
            self.assertEqual(row['same_sign'], row['flights'], row)
        # The drag is quadratic, that of the model linear: forward at middle speed it holds back too much.
        forward = [b for b in found if b['channel'] == 'force_x_N' and b['quantity'] == 'air_speed_x_m_s' and b['from'] == 2.0]
        self.assertEqual(len(forward), 1, found)
        self.assertGreater(forward[0]['mean'], 0.05)
        page = page_of(out)
        self.assertIn('flights with that sign', page)
        self.assertIn('alt="recurrent residuals"', page)
        self.assertIn('Not looked for', page_of(self.out))  # four flights are too few

    def test_a_second_run_does_only_what_is_new(self):
        out = os.path.join(self.base, 'again')
        shutil.copytree(self.out, out)
        kept = sorted(os.listdir(os.path.join(out, 'flights')))
        torn = os.path.join(out, 'flights', kept[0])
        with open(torn, 'w', encoding='utf-8') as file:
            file.write('{"flight": {')  # as a full disk leaves it
        status, _, err = fleet(self.folder, out)
        self.assertEqual(status, 0, err)
        self.assertIn('5 flights, 1 to calibrate', err)
        self.assertEqual(parameters(out), parameters(self.out))
        status, _, err = fleet(self.folder, out)
        self.assertIn('5 flights, 0 to calibrate', err)

    def test_other_options_are_another_calibration(self):
        out = os.path.join(self.base, 'other')
        _, _, err = fleet(self.folder, out, '--', '--keyframe-rate', '20')
        self.assertIn('5 to calibrate', err)
        _, _, err = fleet(self.folder, out)
        self.assertIn('5 to calibrate', err)

    def test_another_build_is_another_calibration(self):
        lib = os.path.join(self.base, 'lib')
        tools = os.path.join(lib, 'odmc')
        os.makedirs(tools)
        os.symlink(os.path.join(TOOLS, 'convert'), os.path.join(tools, 'convert'))
        with open(os.path.join(tools, 'calibrate'), 'w', encoding='utf-8') as file:
            file.write(f'#!/bin/bash\nexec {TOOLS}/calibrate "$@"\n')
        os.chmod(os.path.join(tools, 'calibrate'), 0o755)
        few = os.path.join(self.base, 'day1')
        os.makedirs(few)
        shutil.copy(os.path.join(self.folder, 'flight0.csv'), few)
        out = os.path.join(self.base, 'builds')
        for content, expected in (('one', '1 to calibrate'), ('one', '0 to calibrate'), ('two', '1 to calibrate')):
            with open(os.path.join(lib, 'libodmc_estimation.so'), 'w', encoding='utf-8') as file:
                file.write(content)  # the tool itself stays as it is
            status, _, err = fleet(few, out, tools=tools)
            self.assertEqual(status, 0, err)
            self.assertIn(expected, err)

    def test_a_flight_that_crashes_the_tool_is_tried_twice_and_costs_itself_only(self):
        tools = os.path.join(self.base, 'tools')
        os.makedirs(tools)
        tried = os.path.join(self.base, 'tried')
        os.symlink(os.path.join(TOOLS, 'convert'), os.path.join(tools, 'convert'))
        with open(os.path.join(tools, 'calibrate'), 'w', encoding='utf-8') as file:
            file.write(f'#!/bin/bash\nif [[ $1 == *flight1.csv ]]; then echo x >> {tried}; kill -SEGV $$; fi\n'
                       f'exec {TOOLS}/calibrate "$@"\n')
        os.chmod(os.path.join(tools, 'calibrate'), 0o755)
        out = os.path.join(self.base, 'crashed')
        status, text, err = fleet(self.folder, out, tools=tools)
        self.assertEqual(status, 0, err)
        self.assertIn('3 flights together', text)
        self.assertIn('killed by signal 11 (2 tries)', text)
        with open(tried, encoding='utf-8') as file:
            self.assertEqual(file.read(), 'x\nx\n')

    def test_expectations_that_break_set_the_exit_status(self):
        expected = os.path.join(self.base, 'expected.yaml')
        with open(expected, 'w', encoding='utf-8') as file:
            file.write(parameters(self.out))
        status, _, err = fleet(self.folder, self.out, '--expect', expected)
        self.assertEqual(status, 0, err)
        with open(expected, 'w', encoding='utf-8') as file:
            file.write('effects: [thrust]\nparameters:\n'
                       '  thrust.k_f: {value: 1.6e-06, sigma: 1.0e-09, state: estimated}\n')
        status, text, _ = fleet(self.folder, self.out, '--expect', expected)
        self.assertEqual(status, 1)
        self.assertIn('broken: generic: thrust.k_f', text)

    def test_usage_errors_say_what_is_wrong(self):
        for arguments, word in ((['/nonexistent', '--vehicle', VEHICLE], 'no flight'),
                                ([self.folder, '--vehicle', '/nonexistent.yaml'], 'no such file'),
                                ([self.folder, '--vehicles', self.folder], 'no vehicle file')):
            done = subprocess.run([FLEET, *arguments, '--out', os.path.join(self.base, 'x')], stderr=subprocess.PIPE,
                                  check=False)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn(word, done.stderr.decode())

    @unittest.skipIf(distributed is None, 'python3-distributed is not installed')
    def test_a_cluster_that_loses_a_worker_gives_the_same(self):
        started = []

        def start(*arguments):
            started.append(subprocess.Popen([sys.executable, '-m', *arguments], stdout=subprocess.DEVNULL,
                                            stderr=subprocess.DEVNULL))
            return started[-1]

        port = 20000 + os.getpid() % 20000
        address = f'tcp://127.0.0.1:{port}'
        slow = os.path.join(self.base, 'slow')
        os.makedirs(slow)
        marks = os.path.join(self.base, 'marks')
        with open(os.path.join(slow, 'calibrate'), 'w', encoding='utf-8') as file:  # time to kill it in
            file.write(f'#!/bin/bash\nif [[ "$*" == *only-factor* ]]; then echo x >> {marks}; sleep 2; fi\n'
                       f'exec {TOOLS}/calibrate "$@"\n')
        os.chmod(os.path.join(slow, 'calibrate'), 0o755)
        try:
            start('distributed.cli.dask_scheduler', '--host', '127.0.0.1', '--port', str(port), '--no-dashboard')
            workers = [start('distributed.cli.dask_worker', address, '--nthreads', '1', '--no-nanny', '--no-dashboard')
                       for _ in range(2)]
            out = os.path.join(self.base, 'cluster')
            run = subprocess.Popen([FLEET, self.folder, '--vehicle', VEHICLE, '--out', out, '--no-verdicts', '--scheduler',
                                    address, '--worker-tools', slow], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
            for _ in range(600):
                if os.path.exists(marks) and os.path.getsize(marks) >= 4:
                    break
                time.sleep(0.1)
            workers[0].kill()  # both are at work
            text, err = run.communicate(timeout=120)
            self.assertEqual(run.returncode, 0, err.decode())
            self.assertIn('4 flights together', text.decode())
            self.assertEqual(parameters(out), parameters(self.out))
            with open(marks, encoding='utf-8') as file:
                self.assertGreater(len(file.read().split()), FLIGHTS + 1)  # one had to be done again
        finally:
            for process in started:
                process.kill()
                process.wait()


if __name__ == '__main__':
    unittest.main()
