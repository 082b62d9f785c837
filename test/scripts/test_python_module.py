"""The Python module odmc gives the tools' figures and derivatives that finite differences have, says what is wrong with bad input
in one sentence, and lives beside the messages."""

import csv
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import unittest
from typing import Any, Dict, List

import numpy as np

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
DEVEL = os.path.join(ROOT, 'build', 'devel')
TOOLS = os.path.join(DEVEL, 'lib', 'odmc')
MODULES = os.path.join(DEVEL, 'lib', 'python3', 'dist-packages')
VEHICLE = os.path.join(ROOT, 'config', 'vehicles', 'generic.yaml')

sys.path.insert(0, MODULES)
BUILT = importlib.util.find_spec('odmc') is not None and importlib.util.find_spec('odmc._native') is not None
if BUILT:
    import odmc
CLOCKS = ('timing_ms', 'timing_cpu_ms', 'timing_start_ms')


def run(tool: str, *arguments: str) -> None:
    """Runs a tool, which must succeed."""
    subprocess.run([os.path.join(TOOLS, tool), *arguments], check=True, capture_output=True)


def read_csv(file: str) -> Dict[str, List[str]]:
    """Columns of a CSV file, as text."""
    with open(file, encoding='utf-8') as lines:
        rows = list(csv.reader(lines))
    return dict(zip(rows[0], map(list, zip(*rows[1:]))))


def read_json(*parts: str) -> Dict[str, Any]:
    """A JSON file."""
    with open(os.path.join(*parts), encoding='utf-8') as file:
        return json.load(file)


@unittest.skipUnless(BUILT, 'the Python module is not built')
class ModuleCase(unittest.TestCase):
    """A simulated flight of 8 s, in a folder of its own."""

    folder: tempfile.TemporaryDirectory

    @classmethod
    def setUpClass(cls) -> None:
        cls.folder = tempfile.TemporaryDirectory(prefix='odmc_python_')
        cls.addClassCleanup(cls.folder.cleanup)
        cls.csv = os.path.join(cls.folder.name, 'octo.csv')
        run('simulate', '--vehicle', VEHICLE, '--trajectory', 'octo', '--duration', '8', '--seed', '3', '--log-rate', '200',
            '--out', cls.csv)

    def assert_columns(self, table: 'odmc.Table', file: str, digits: int) -> None:
        """Every column of the table stands in a CSV file that was written with so many digits."""
        columns = read_csv(file)
        self.assertGreater(table.rows, 100)
        for name, values in table.items():
            written = np.array([float(text) for text in columns[name]])
            np.testing.assert_allclose(values, written, rtol=10.0 ** -(digits - 1), atol=1e-300, err_msg=name)


class ToolsTest(ModuleCase):
    """The module gives what the tools give."""

    def test_calibrate(self) -> None:
        out = os.path.join(self.folder.name, 'calibrate')
        run('calibrate', self.csv, '--vehicle', VEHICLE, '--out', out, '--no-report', '--free', 'rotor_torque.k_m',
            '--without', 'hvt', '--keyframe-rate', '50', '--set', 'huber_width=5', '--position-noise', '0.01', '--seed', '4',
            '--leave-out', '3')
        result = odmc.calibrate(self.csv, VEHICLE, free=['rotor_torque.k_m'], without=['hvt'], keyframe_rate_hz=50.0,
                                options={'huber_width': 5}, position_noise_m=0.01, seed=4, leave_out_s=3.0)
        theirs, ours = read_json(out, 'report.json'), dict(result.report)
        for clock in CLOCKS:
            theirs.pop(clock), ours.pop(clock)
        self.assertEqual(ours, theirs)
        self.assertIn('prediction_left_out', ours)
        with open(os.path.join(out, 'parameters.yaml'), encoding='utf-8') as file:
            self.assertEqual(result.parameters.native.text(), file.read())
        self.assert_columns(result.prediction, os.path.join(out, 'prediction.csv'), 9)
        history = read_csv(os.path.join(out, 'history.csv'))
        flown = np.array(history['airborne'], dtype=float) == 1.0
        for name, values in result.history.items():
            np.testing.assert_allclose(values, np.array(history[name], dtype=float)[flown], rtol=1e-8, err_msg=name)

    def test_evaluate_with_parameters_of_a_file(self) -> None:
        truth = os.path.join(self.folder.name, 'octo_truth.yaml')
        out = os.path.join(self.folder.name, 'evaluate')
        run('evaluate', self.csv, '--vehicle', VEHICLE, '--parameters', truth, '--out', out, '--no-report')
        result = odmc.evaluate(self.csv, VEHICLE, truth)
        self.assertEqual(result.report, read_json(out, 'report.json'))
        self.assert_columns(result.prediction, os.path.join(out, 'prediction.csv'), 9)
        error = result.prediction.vectors('measured_force_', '_N') - result.prediction.vectors('predicted_force_', '_N')
        np.testing.assert_allclose(result.force_rmse_N, np.sqrt(np.mean(error ** 2, axis=0)), rtol=1e-9)
        with self.assertRaisesRegex(ValueError, 'drag.d_q cannot follow the flight: the vehicle has no such parameter'):
            odmc.evaluate(self.csv, VEHICLE, truth, follow=['drag.d_q'])

    def test_close_loop(self) -> None:
        out = os.path.join(self.folder.name, 'close_loop')
        run('close_loop', self.csv, '--vehicle', VEHICLE, '--without', 'drag', '--block', '2', '--most-effects', '1',
            '--rule-out', 'wind,gust', '--decision', 'false_alarm_rate=0.02', '--out', out, '--no-report')
        loop = odmc.close_loop(self.csv, VEHICLE, without=['drag'], block_s=2.0, most_effects=1, rule_out=['wind', 'gust'],
                               decision={'false_alarm_rate': 0.02})
        self.assertFalse({'wind', 'gust'} & {ranked['name'] for ranked in loop.report['ranking']})
        self.assertEqual(loop.report, read_json(out, 'report.json'))
        self.assertEqual((loop.verdict, [effect['name'] for effect in loop.effects]), ('effect', ['drag']))
        self.assertIn('drag.d_x', loop.parameters)
        self.assert_columns(loop.residuals, os.path.join(out, 'residual.csv'), 5)
        before, after = loop.force_rmse_N
        self.assertTrue(np.all(after < before))

    def test_simulate(self) -> None:
        flight, truth = odmc.simulate(VEHICLE, trajectory='octo', duration_s=8.0, seed=3, log_rate_hz=200.0)
        written = odmc.read_flight(self.csv, VEHICLE)
        for stream in ('odometry', 'rotors', 'battery'):
            for name, values in getattr(flight, stream).items():
                np.testing.assert_array_equal(values, getattr(written, stream)[name], err_msg=name)
        read = odmc.load_parameters(os.path.join(self.folder.name, 'octo_truth.yaml'))
        np.testing.assert_array_equal(truth.vector, read.vector)


class FlightTest(ModuleCase):
    """Flights as arrays."""

    def test_formats_hold_the_same_flight(self) -> None:
        flight = odmc.read_flight(self.csv, VEHICLE)
        columns = read_csv(self.csv)
        np.testing.assert_array_equal(flight.odometry.p_WS[:, 1], np.array(columns['py'], dtype=float))
        np.testing.assert_array_equal(flight.odometry.q_WS[:, 3], np.array(columns['qw'], dtype=float))
        np.testing.assert_array_equal(flight.rotors.speed_rad_s[:, 2], np.array(columns['rotor3'], dtype=float))
        bag = os.path.join(self.folder.name, 'octo.bag')
        flight.write(bag)
        again = odmc.read_flight(bag, VEHICLE)
        for name in ('p_WS', 'q_WS', 'v_WS', 'w_WS_S'):
            np.testing.assert_array_equal(again.odometry[name], flight.odometry[name])
        log = os.path.join(self.folder.name, 'octo.bbl')
        run('convert', self.csv, log)
        logged = odmc.read_flight(log, VEHICLE, odometry=self.csv)
        self.assertGreater(logged.rotors.samples, 100)
        self.assertIsNotNone(logged.imu.gyro_I)

    def test_cut_and_streams(self) -> None:
        flight = odmc.read_flight(self.csv, VEHICLE, start_s=2.0, end_s=5.0)
        self.assertAlmostEqual(flight.duration_s, 3.0, delta=0.011)
        self.assertEqual((flight.imu.samples, flight.imu.gyro_I, flight.commands.samples), (0, None, 0))
        self.assertEqual(flight.odometry.stamp_ns.dtype, np.int64)
        with self.assertRaisesRegex(AttributeError, "odometry.*no 'p_WB'; it has t_s"):
            self.assertIsNone(flight.odometry.p_WB)

    def test_arrays_make_the_same_flight(self) -> None:
        flight = odmc.read_flight(self.csv, VEHICLE)
        o, r, b = flight.odometry, flight.rotors, flight.battery
        ours = odmc.Flight.from_arrays(VEHICLE, t_s=o.t_s, p_WS=o.p_WS, q_WS=o.q_WS, v_WS=o.v_WS, w_WS_S=o.w_WS_S,
                                       rotor_t_s=r.t_s, rotor_speed_rad_s=r.speed_rad_s, battery_t_s=b.t_s,
                                       voltage_V=b.voltage_V, name=flight.file)
        options = {'keyframe_rate_hz': 50.0}
        theirs = odmc.calibrate(flight, VEHICLE, **options)
        result = odmc.calibrate(ours, VEHICLE, **options)
        np.testing.assert_array_equal(result.parameters.vector, theirs.parameters.vector)
        np.testing.assert_array_equal(result.parameters.covariance, theirs.parameters.covariance)
        holes = o.v_WS.copy()
        holes[100] = np.nan
        holed = odmc.Flight.from_arrays(VEHICLE, t_s=o.t_s, p_WS=o.p_WS, q_WS=o.q_WS, v_WS=holes, rotor_t_s=r.t_s,
                                        rotor_speed_rad_s=r.speed_rad_s)
        self.assertTrue(np.all(np.isnan(holed.odometry.v_WS[100])) and np.all(np.isfinite(holed.odometry.v_WS[101])))
        self.assertIsNone(holed.odometry.w_WS_S)
        with self.assertRaisesRegex(ValueError, r'p_WS is of shape \(3, 2\); expected \(1601, 3\)'):
            odmc.Flight.from_arrays(VEHICLE, t_s=o.t_s, p_WS=np.zeros((3, 2)), q_WS=o.q_WS, rotor_t_s=r.t_s,
                                    rotor_speed_rad_s=r.speed_rad_s)

    def test_inspection_names_a_planted_mistake(self) -> None:
        flight = odmc.read_flight(self.csv, VEHICLE)
        o, r = flight.odometry, flight.rotors
        self.assertEqual(flight.inspect(VEHICLE).refusal, '')
        swapped = odmc.Flight.from_arrays(VEHICLE, t_s=o.t_s, p_WS=o.p_WS, q_WS=o.q_WS, v_WS=o.v_WS, w_WS_S=o.w_WS_S,
                                          rotor_t_s=r.t_s, rotor_speed_rad_s=r.speed_rad_s[:, [1, 0, 2, 3]])
        self.assertNotEqual(swapped.inspect(VEHICLE).refusal, '')
        with self.assertRaisesRegex(ValueError, r'^arrays: .*\(force=True goes on all the same\)$'):
            odmc.calibrate(swapped, VEHICLE)

    def test_pandas(self) -> None:
        try:
            import pandas  # noqa: F401
        except ImportError:
            self.skipTest('pandas is not installed')
        flight = odmc.read_flight(self.csv, VEHICLE, end_s=5.0)
        frame = flight.rotors.to_pandas()
        self.assertEqual(list(frame.columns[:4]), ['t_s', 'stamp_ns', 'speed_rad_s_1', 'speed_rad_s_2'])
        self.assertEqual(frame['speed_rad_s_2'][7], flight.rotors.speed_rad_s[7, 1])
        self.assertIn('q_WS_w', flight.odometry.to_pandas().columns)
        result = odmc.evaluate(flight, VEHICLE, os.path.join(self.folder.name, 'octo_truth.yaml'))
        self.assertEqual(result.prediction.to_pandas().shape, (result.prediction.rows, len(result.prediction)))
        self.assertEqual(result.parameters.to_pandas().loc['thrust.k_f', 'value'], result.parameters['thrust.k_f'].value)


def rotation(vector: np.ndarray) -> np.ndarray:
    """exp of a rotation vector (3,)."""
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * hat + (1 - np.cos(angle)) * hat @ hat


@unittest.skipUnless(BUILT, 'the Python module is not built')
class ModelTest(unittest.TestCase):
    """Wrenches and derivatives."""

    def state(self, random: np.random.Generator, n: int) -> 'odmc.State':
        """n flight states about a fast flight, near the ground for the effects that feel it."""
        return odmc.State(
            rotor_speed_rad_s=1100.0 + 80.0 * random.standard_normal((n, 4)), v_AB_B=3.0 * random.standard_normal((n, 3)),
            w_WB_B=random.standard_normal((n, 3)), p_WB=np.array([0.0, 0.0, 1.5]) + 0.3 * random.standard_normal((n, 3)),
            R_WB=np.array([rotation(0.3 * random.standard_normal(3)) for _ in range(n)]), time_s=np.linspace(0.0, 5.0, n),
            rotor_acceleration_rad_s2=100.0 * random.standard_normal((n, 4)))

    def test_derivatives_of_every_effect_are_finite_differences(self) -> None:
        random = np.random.default_rng(5)
        vehicle = odmc.load_vehicle(VEHICLE)
        checked = 0
        for effect in odmc.list_effects(vehicle):
            base = ['thrust', 'rotor_torque', 'centre_of_gravity']
            # The blade element is rotor thrust and torque in one.
            names = ['centre_of_gravity', effect.name] if effect.name == 'blade_element' else \
                [name for name in base if name != effect.name] + [effect.name]
            model = odmc.Model(vehicle.choose(effects=names))
            specs = model.parameters
            values = model.values() + 0.2 * random.standard_normal(len(specs)) * np.array(
                [min(p.prior_sigma, abs(p.prior_value) or p.prior_sigma) for p in specs])
            state = self.state(random, 4)
            found = model.wrench(state, values, derivatives=True)
            self.assertEqual(found.d_values.shape, (4, 6, len(specs)))
            for k, spec in enumerate(specs):
                step = 1e-4 * min(spec.prior_sigma, abs(values[k]) or spec.prior_sigma)
                numeric = self.difference(model, values, k, step, state)
                self.close(found.d_values[:, :, k], numeric, found, step, f'{effect.name} by {spec.name}')
                checked += 1
            for name, columns in odmc._model.STATE_COLUMNS.items():
                for axis in range(3):
                    numeric = self.state_difference(model, values, state, name, axis)
                    self.close(found.d_state[:, :, columns][:, :, axis], numeric, found, 1e-4,
                               f'{effect.name} by {name} {axis}')
        self.assertGreater(checked, 200)

    def close(self, analytic: np.ndarray, numeric: np.ndarray, found: 'odmc.Wrench', step: float, what: str) -> None:
        """Equal to the truncation of a central difference, and the rounding of the wrench over the step."""
        size = np.abs(np.concatenate([found.f_B, found.tau_Bcm_B], axis=1)).max()
        rounding = 100.0 * np.finfo(float).eps * size / step
        np.testing.assert_allclose(analytic, numeric, rtol=2e-5, atol=rounding + 2e-6 * np.abs(numeric).max(), err_msg=what)

    @staticmethod
    def both(wrench: 'odmc.Wrench') -> np.ndarray:
        return np.concatenate([wrench.f_B, wrench.tau_Bcm_B], axis=1)

    def difference(self, model: 'odmc.Model', values: np.ndarray, k: int, step: float, state: 'odmc.State') -> np.ndarray:
        moved = []
        for sign in (1.0, -1.0):
            other = values.copy()
            other[k] += sign * step
            moved.append(self.both(model.wrench(state, other)))
        return (moved[0] - moved[1]) / (2.0 * step)

    def state_difference(self, model: 'odmc.Model', values: np.ndarray, state: 'odmc.State', name: str, axis: int) -> np.ndarray:
        step, moved = 1e-4, []
        for sign in (1.0, -1.0):
            other = odmc.State(**vars(state))
            shift = np.zeros(3)
            shift[axis] = sign * step
            if name == 'theta_WB':
                other.R_WB = state.R_WB @ rotation(shift)
            else:
                setattr(other, name, getattr(state, name) + shift)
            moved.append(self.both(model.wrench(other, values)))
        return (moved[0] - moved[1]) / (2.0 * step)

    def test_effects_add_up_and_states_may_be_one_or_many(self) -> None:
        model, random = odmc.Model(VEHICLE), np.random.default_rng(6)
        values = model.values({'drag.d_x': -0.4, 'centre_of_gravity.x': 0.01})
        self.assertEqual(values[model.index('drag.d_x')], -0.4)
        state = self.state(random, 3)
        whole, parts = model.wrench(state, values), model.effect_wrenches(state, values)
        self.assertIn('drag', parts)
        self.assertNotIn('gravity', parts)
        np.testing.assert_allclose(sum(p.f_B for p in parts.values()), whole.f_B, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(sum(p.tau_Bcm_B for p in parts.values()), whole.tau_Bcm_B, rtol=1e-12, atol=1e-14)
        one = odmc.State(**{name: None if v is None else v[1] for name, v in vars(state).items() if name != 'load_pull_W'})
        alone = model.wrench(one, values, derivatives=True)
        self.assertEqual((alone.f_B.shape, alone.d_state.shape), ((3,), (6, 12)))
        np.testing.assert_array_equal(alone.f_B, whole.f_B[1])
        # Thrust of four rotors, by hand.
        k_f, c = values[model.index('thrust.k_f')], 0.01
        hover = model.wrench(odmc.State(np.full(4, 1000.0)), values)
        np.testing.assert_allclose(hover.f_B, [0.0, 0.0, 4e6 * k_f], rtol=1e-12)
        np.testing.assert_allclose(hover.tau_Bcm_B, [0.0, 4e6 * k_f * c, 0.0], rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(model.properties(values).p_BBcm, [c, 0.0, 0.0])

    def test_sentences(self) -> None:
        model = odmc.Model(VEHICLE)
        with self.assertRaisesRegex(ValueError, r"no parameter 'drag.d_w'; it has thrust.k_f"):
            model.values({'drag.d_w': 1.0})
        with self.assertRaisesRegex(ValueError, r'values are of shape \(2,\); expected \(17,\)'):
            model.wrench(odmc.State(np.zeros(4)), [1.0, 2.0])
        with self.assertRaisesRegex(ValueError, r'rotor_speed_rad_s is of shape \(3,\); expected \(4,\) or \(n, 4\)'):
            model.wrench(odmc.State(np.zeros(3)))
        with self.assertRaisesRegex(ValueError, r'rotor_speed_rad_s is of shape \(5, 4\); expected \(4,\) or \(2, 4\)'):
            model.wrench(odmc.State(np.zeros((5, 4)), v_AB_B=np.zeros((2, 3))))


class SentencesTest(ModuleCase):
    """Bad input: one sentence, with the names that Python users know."""

    def test_each(self) -> None:
        bag = os.path.join(self.folder.name, 'no.bag')
        cases = [
            (lambda: odmc.read_flight('/nowhere/flight.csv', VEHICLE), r'/nowhere/flight\.csv'),
            (lambda: odmc.load_vehicle(self.csv), re.escape(self.csv)),
            (lambda: odmc.calibrate(self.csv, VEHICLE, effects=['lift']), "'lift'|lift"),
            (lambda: odmc.calibrate(self.csv, VEHICLE, effects=['drag'], without=['hvt']), 'exclude each other'),
            (lambda: odmc.calibrate(self.csv, VEHICLE, options={'windows_s': 1}), r"^options windows_s=1: there is no option"),
            (lambda: odmc.calibrate(self.csv, VEHICLE, options={'huber_width': 'wide'}), '^options huber_width: expected a number'),
            (lambda: odmc.calibrate(self.csv, VEHICLE, window_s=-1.0), r'window_s is -1\.0'),
            (lambda: odmc.calibrate(self.csv, VEHICLE, effects=['thrust', 'mass_change', 'centre_of_gravity', 'inertia', 'gravity'],
                                    free=['mass_change.mass']), 'mass_change.mass and thrust.k_f cannot both'),
            (lambda: odmc.read_flight(self.csv, VEHICLE, topics={'imu': '/imu'}), '^topics is for bags'),
            (lambda: odmc.read_flight(self.csv, VEHICLE, messages={'rotor_speed_unit': 'rpm'}), '^rotor_speed_unit is for bags'),
            (lambda: odmc.read_flight(self.csv, VEHICLE, messages={'rotor_unit': 'rpm'}), "messages: there is no 'rotor_unit'"),
            (lambda: odmc.read_flight(bag, VEHICLE, messages={'pole_pairs': 'two'}), 'messages: pole_pairs is of another type'),
            (lambda: odmc.read_flight(self.csv, VEHICLE, start_s=3.0, end_s=2.0), 'end_s must lie after start_s'),
            (lambda: odmc.read_flight(self.csv, VEHICLE, pose='gps'), "pose is 'gps'; there are ekf, mocap"),
            (lambda: odmc.close_loop(self.csv, VEHICLE, decision={'alarm_rate': 1.0}), 'alarm_rate'),
            (lambda: odmc.close_loop(self.csv, VEHICLE, rule_out=['winds']), "ruled out: 'winds' is none"),
            (lambda: odmc.simulate(VEHICLE, trajectory='loop'), 'loop'),
            (lambda: odmc.read_flight(self.csv, VEHICLE).write('flight.mat'), r'flight\.mat: a flight.s file ends in'),
        ]
        for call, sentence in cases:
            with self.assertRaisesRegex(ValueError, sentence) as caught:
                call()
            self.assertNotIn('\n', str(caught.exception))
            self.assertNotRegex(str(caught.exception), r'--[a-z]')

    def test_an_earlier_estimate_of_another_vehicle_is_warned_of(self) -> None:
        start = odmc.load_parameters(os.path.join(self.folder.name, 'octo_truth.yaml'))
        self.assertEqual(start.provenance['tool'], 'simulate')
        chosen = odmc.load_vehicle(VEHICLE).choose(parameters=start, freeze=['drag'])
        model = odmc.Model(chosen)
        self.assertFalse(model.parameters[model.index('drag.d_x')].estimated)
        self.assertEqual(model.values()[model.index('drag.d_x')], start['drag.d_x'].value)


class ThreadsTest(ModuleCase):
    """Long functions leave the interpreter free."""

    def test_other_threads_run_and_progress_ends_it(self) -> None:
        shares: List[float] = []
        counted = 0
        done = threading.Event()

        def count() -> None:
            nonlocal counted
            while not done.wait(0.005):
                counted += 1
        thread = threading.Thread(target=count)
        thread.start()
        try:
            odmc.calibrate(self.csv, VEHICLE, progress=shares.append)
        finally:
            done.set()
            thread.join()
        self.assertGreater(counted, 20)
        self.assertGreater(len(shares), 10)
        self.assertEqual(shares, sorted(shares))

        def stop(share: float) -> None:
            if share > 0.3:
                raise KeyboardInterrupt
        with self.assertRaises(KeyboardInterrupt):
            odmc.calibrate(self.csv, VEHICLE, progress=stop)

    def test_calibrations_side_by_side_are_the_same(self) -> None:
        flight = odmc.read_flight(self.csv, VEHICLE, end_s=5.0)
        alone = odmc.calibrate(flight, VEHICLE, keyframe_rate_hz=50.0).parameters.vector
        found: List[np.ndarray] = []
        threads = [threading.Thread(target=lambda: found.append(
            odmc.calibrate(flight, VEHICLE, keyframe_rate_hz=50.0).parameters.vector)) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(len(found), 3)
        for vector in found:
            np.testing.assert_array_equal(vector, alone)


@unittest.skipUnless(BUILT, 'the Python module is not built')
class PackageTest(unittest.TestCase):
    """Messages, stubs, installation."""

    def python(self, code: str, folder: str, library: str = '') -> str:
        """Runs code with the packages of a folder."""
        paths = [folder, '/usr/lib/python3/dist-packages']
        done = subprocess.run([sys.executable, '-c', code], text=True, check=False,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              env={'PATH': '/usr/bin:/bin', 'PYTHONPATH': ':'.join(paths), 'LD_LIBRARY_PATH': library})
        self.assertEqual(done.returncode, 0, done.stdout)
        return done.stdout.strip()

    def both(self, folder: str, library: str = '') -> None:
        """Messages load nothing of the library; then both work together."""
        said = self.python(
            'import sys, odmc.msg\n'
            'assert "odmc._native" not in sys.modules\n'
            'from odmc import load_vehicle, Model\n'
            f'print(odmc.msg.RotorSpeeds.__slots__, load_vehicle("{VEHICLE}").num_rotors, len(Model("{VEHICLE}").parameters))\n'
            'print(odmc._native.__file__, odmc.__version__, odmc.nothing if hasattr(odmc, "nothing") else "")', folder, library)
        self.assertIn('4 17', said)
        self.assertIn(os.path.join(os.path.realpath(folder), 'odmc', '_native'), said)

    def test_messages_and_module_together(self) -> None:
        self.both(MODULES)

    def test_installed(self) -> None:
        with tempfile.TemporaryDirectory(prefix='odmc_install_') as prefix:
            done = subprocess.run(['cmake', '--install', os.path.join(ROOT, 'build'), '--prefix', prefix], text=True, check=False,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
            self.assertEqual(done.returncode, 0, done.stdout[-2000:])
            installed = os.path.join(prefix, 'lib', 'python3', 'dist-packages')
            for name in ('__init__.pyi', '_native.pyi', 'py.typed'):
                self.assertTrue(os.path.isfile(os.path.join(installed, 'odmc', name)), name)
            native = next(name for name in os.listdir(os.path.join(installed, 'odmc')) if name.endswith('.so'))
            with open(os.path.join(installed, 'odmc', native), 'rb') as file:
                self.assertNotIn(os.path.join(ROOT, 'build').encode(), file.read(), 'the build is in its library path')
            self.both(installed, os.path.join(prefix, 'lib'))

    def test_stubs_name_what_there_is(self) -> None:
        folder = os.path.join(ROOT, 'src', 'python', 'odmc')
        with open(os.path.join(folder, '__init__.pyi'), encoding='utf-8') as file:
            stubs = set(re.findall(r' as (\w+)$', file.read(), flags=re.MULTILINE))
        self.assertEqual(stubs | {'__version__'}, set(odmc.__all__))
        for name in odmc.__all__:
            self.assertTrue(name == '__version__' or getattr(odmc, name).__doc__, name)
        with open(os.path.join(folder, '_native.pyi'), encoding='utf-8') as file:
            text = file.read()
        native = odmc._native
        functions = {name for name in dir(native) if not name.startswith('_') and name != 'version'}
        self.assertEqual(set(re.findall(r'^(?:class|def) (\w+)', text, flags=re.MULTILINE)), functions)
        for name, body in re.findall(r'^class (\w+):\n((?: .*\n)+)', text, flags=re.MULTILINE):
            members = {m for m in dir(getattr(native, name)) if not m.startswith('_')}
            self.assertEqual(set(re.findall(r'def ([a-zA-Z]\w*)', body)), members, name)

    def test_the_tour_prints_and_draws_what_the_document_shows(self) -> None:
        with tempfile.TemporaryDirectory(prefix='odmc_tour_') as out:
            done = subprocess.run([sys.executable, os.path.join(ROOT, 'docs', 'tutorials', 'python_tour.py'), out],
                                  text=True, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                  env={**os.environ, 'PYTHONPATH': MODULES})
            self.assertEqual(done.returncode, 0, done.stdout)
            drawn = [name for name in os.listdir(out) if name.endswith('.png')]
        with open(os.path.join(ROOT, 'docs', 'python.md'), encoding='utf-8') as file:
            page = file.read()
        self.assertEqual(sorted(drawn), sorted(re.findall(r'\(pictures/(python_\w+\.png)\)', page)))

        def without_figures(text: str) -> List[str]:
            """Lines with # for every number: these may differ by machine."""
            return [re.sub(r'\s+', ' ', re.sub(r'-?\d[\d.]*(e[+-]\d+)?', '#', line)).strip() for line in text.splitlines()]
        shown = without_figures(page)
        for line in without_figures(done.stdout):
            if 'pandas is not installed' not in line:
                self.assertIn(line, shown)

    def test_types(self) -> None:
        if not shutil.which('mypy', path='/usr/bin'):
            self.skipTest('mypy is not installed')
        with tempfile.TemporaryDirectory(prefix='odmc_mypy_') as cache:
            done = subprocess.run(['/usr/bin/mypy', '--strict', '--allow-any-generics', '--no-warn-return-any',
                                   '--ignore-missing-imports', '--cache-dir', cache,
                                   os.path.join(ROOT, 'src', 'python', 'odmc')], text=True, check=False,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.assertEqual(done.returncode, 0, done.stdout)


if __name__ == '__main__':
    unittest.main()
