"""Tests of fault_campaign: run with /usr/bin/python3 -m unittest discover -s test/scripts.

Faults are put into an invented flight, so that no recording is needed."""

import json
import os
import re
import stat
import subprocess
import sys
import tempfile
import unittest
from typing import Any, Dict, List, Optional, Tuple

import numpy as np

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
sys.path.insert(0, os.path.join(ROOT, 'scripts'))

from campaign import bases, catalogue, motion, rotation, running, scenes, scoring  # noqa: E402
from campaign import signals, tables  # noqa: E402
from campaign.airframe import Airframe, G  # noqa: E402
from campaign.recording import (ATTITUDE, FORCE, POSITION, RATE, VELOCITY, Recording,  # noqa: E402
                                read)

TOOL = os.path.join(ROOT, 'scripts', 'fault_campaign')
DATA = os.environ.get('ODMC_DATA_DIR') or os.path.join(ROOT, '..', 'shared', 'data')
NAMES = bases.names()
DRAG = np.array([-0.3, -0.25, -0.2])
VEHICLE: Dict[str, Any] = {
    'name': 'invented', 'mass_kg': 0.75, 'gravity_m_s2': 9.81,
    'inertia_kg_m2': [0.0025, 0.0025, 0.0043],
    'rotors': [{'position_m': [0.09, 0.09, 0.0], 'spin': 'cw'},
               {'position_m': [0.09, -0.09, 0.0], 'spin': 'ccw'},
               {'position_m': [-0.09, -0.09, 0.0], 'spin': 'cw'},
               {'position_m': [-0.09, 0.09, 0.0], 'spin': 'ccw'}],
    'parameters': {'thrust.k_f': {'value': 1.5e-6, 'sigma': 5e-7},
                   'rotor_torque.k_m': {'value': 1.95e-8}}}


def invented_recording(noise: float = 1.0) -> Recording:
    """A dozen seconds of loops, rising and sinking, by the rules of motion.py."""
    frame = Airframe(VEHICLE)
    frame.drag = DRAG.copy()
    t = motion.times(12.0)
    f, size, mean = np.array([1.1, 1.9, 2.3]), np.array([2.0, 1.0, 0.4]), np.array([0, 0, 1.5])
    phase = t[:, None] * f
    flown = motion.fly(frame, mean + size * np.sin(phase), size * f * np.cos(phase),
                       -size * f ** 2 * np.sin(phase), 0.3 * t)
    rng = np.random.default_rng(5)
    main = {'t': t[::2] - t[0]}
    sizes = {POSITION: 0.001, VELOCITY: 0.01, RATE: 0.01, FORCE: 0.1}
    for names, x in ((POSITION, flown.p), (ATTITUDE, flown.q), (VELOCITY, flown.v),
                     (RATE, flown.rates), (FORCE, flown.force)):
        for i, name in enumerate(names):
            white = rng.standard_normal(len(t[::2]))
            main[name] = x[::2, i] + noise * sizes.get(names, 0.0) * white
    for i, x in enumerate(np.sqrt(flown.squares[::2]).T):
        main[f'rotor{i + 1}'] = x + noise * rng.standard_normal(len(x))
    return Recording(main)


def invented_base(name: str = 'invented') -> bases.Base:
    """The invented flight as a base flight."""
    return bases.Base(name, invented_recording(), VEHICLE)


def blocks(x: np.ndarray, count: int = 25) -> np.ndarray:
    """Means of blocks of rows (0.1 s)."""
    return x[:len(x) // count * count].reshape(-1, count, x.shape[1]).mean(axis=1)


class CheckNames(unittest.TestCase):
    """What may name a cause."""

    def test_checks_are_those_that_the_tools_have(self) -> None:
        with open(os.path.join(ROOT, 'docs', 'inspect.md'), encoding='utf-8') as file:
            table = file.read().partition('## What is checked')[2].partition('\n## ')[0]
        rows = [line.split('|')[1] for line in table.splitlines() if line.startswith('| `')]
        known = {name for row in rows for name in re.findall(r'`([a-z_]+)`', row)}
        self.assertGreater(len(known), 20)
        for fault in catalogue.faults():
            self.assertLessEqual(set(fault.checks) - {'contact', 'crash'}, known, fault.name)


class Physics(unittest.TestCase):
    """What is added could have been flown, dropped or carried."""

    @classmethod
    def setUpClass(cls) -> None:
        cls.base = invented_base()

    def scene(self, name: str) -> catalogue.Spoiled:
        """A case by its name."""
        all_cases = catalogue.cases(['invented'], {'invented': self.base}, everything=True)
        return next(c for c in all_cases if c.name == name + '@invented').spoil(self.base, 1)

    def check_consistent(self, rec: Recording, largest: float) -> None:
        """Velocity is position's derivative, rates attitude's, and the accelerometer feels
        acceleration and gravity; `largest` is for impacts [m/s^2]."""
        t, q = rec.t, rec.get(ATTITUDE)
        a = np.gradient(rec.get(VELOCITY), t, axis=0)
        felt = rotation.rotate(rotation.inverse(q), a + G)
        self.assertLess(np.abs(blocks(np.gradient(rec.get(POSITION), t, axis=0)
                                      - rec.get(VELOCITY))).max(), 0.15)
        w = rotation.log(rotation.multiply(rotation.inverse(q[:-1]), q[1:])) / np.diff(t)[:, None]
        self.assertLess(np.percentile(np.abs(blocks(w - rec.get(RATE)[1:])), 99), 0.1)
        self.assertLess(np.percentile(np.abs(blocks(felt - rec.get(FORCE))), 98), 0.5)
        self.assertLess(np.abs(blocks(felt - rec.get(FORCE))).max(), largest)

    def test_every_scene_is_consistent(self) -> None:
        for name, largest in (('control/after', 0.6), ('landing/half_idle_in_0.3s', 2.0),
                              ('stand_before/spooled_0.5_for_1s', 0.6),
                              ('carried/after_0.08_for_5s', 2.0),
                              ('carried/before_0.2_for_5s', 0.6),
                              ('hand_start/0.6_for_3s', 0.6), ('thrown/3.5m_s', 0.8),
                              ('touch_and_go/0.6_for_1.5s', 2.0), ('collision/1g', 0.8),
                              ('wall/12deg', 0.6), ('upside_down/0.4_for_2s', 4.0),
                              ('crash/wall', 60.0)):
            with self.subTest(name):
                self.check_consistent(self.scene(name).rec, largest)

    def test_nothing_jumps_where_pieces_meet(self) -> None:
        for name in ('control/amid', 'landing/idle_in_0.1s', 'thrown/2.5m_s',
                     'stand_before/0.6_for_3s', 'carried/before_0.08_for_5s'):
            with self.subTest(name):
                rec = self.scene(name).rec
                self.assertTrue(np.all(np.diff(rec.t) > 0.0))
                self.assertLess(np.diff(rec.t).max(), 0.01)
                self.assertLess(np.abs(np.diff(rec.get(POSITION), axis=0)).max(), 0.04)
                self.assertLess(np.abs(np.diff(rec.get(ATTITUDE), axis=0)).max(), 0.03)
                self.assertLess(np.abs(np.diff(rec.get(VELOCITY), axis=0)).max(), 0.2)

    def test_stands_still_on_the_ground_at_the_thrust_asked_for(self) -> None:
        case = self.scene('stand_after/0.5_for_3s')
        part = case.rec.cut(case.span[1] - 1.5, case.span[1])
        self.assertLess(np.ptp(part.get(POSITION), axis=0).max(), 0.01)
        np.testing.assert_allclose(part.get(FORCE).mean(axis=0), [0.0, 0.0, 9.81], atol=0.1)
        thrust = self.base.frame.k_f * np.sum(part.rotors() ** 2, axis=1).mean()
        self.assertAlmostEqual(thrust / (0.75 * 9.81), 0.5, delta=0.01)

    def test_falls_freely_when_the_motors_stop(self) -> None:
        case = self.scene('motor_stop/all')
        rows = case.rec.cut(case.span[0] + 0.3, case.span[0] + 0.4)
        self.assertLess(np.linalg.norm(rows.get(FORCE).mean(axis=0)), 1.0)
        end = case.rec.cut(case.span[1] - 0.5, case.span[1])
        self.assertAlmostEqual(np.linalg.norm(end.get(FORCE).mean(axis=0)), 9.81, delta=0.2)

    def test_recording_itself_is_kept(self) -> None:
        rec = self.scene('landing/off_in_0.3s').rec
        for name in self.base.rec.main:
            np.testing.assert_allclose(rec.main[name][:len(self.base.rec.t)],
                                       self.base.rec.main[name], atol=1e-12)

    def test_fit_finds_the_coefficients(self) -> None:
        self.assertAlmostEqual(self.base.frame.k_f / 1.5e-6, 1.0, delta=0.01)
        np.testing.assert_allclose(self.base.frame.drag[:2], DRAG[:2], rtol=0.05)

    def test_fit_finds_what_is_late(self) -> None:
        self.assertEqual((self.base.frame.rotors_late_s, self.base.frame.odometry_late_s), (0, 0))
        late = invented_recording(noise=0.2)
        signals.rotors_late(late, 0.02)
        self.assertAlmostEqual(bases.Base('late', late, VEHICLE).frame.rotors_late_s, 0.02, 2)
        late = invented_recording(noise=0.2)
        signals.late(late, POSITION + VELOCITY, 0.02)
        frame = bases.Base('late', late, VEHICLE).frame
        self.assertAlmostEqual(frame.odometry_late_s, 0.02, delta=0.005)
        self.assertAlmostEqual(frame.k_f / 1.5e-6, 1.0, delta=0.01)

    def test_noise_is_that_of_the_recording(self) -> None:
        after = self.scene('control/after').rec
        added = after.cut(float(self.base.rec.t[-1]), 1e9)
        for name, size in (('px', 0.001), ('vx', 0.01), ('wz', 0.01), ('az', 0.1)):
            still = added.main[name][-400:]
            self.assertAlmostEqual(np.std(np.diff(still)) / np.sqrt(2.0) / size, 1.0, delta=0.2)

    def test_same_seed_same_rows(self) -> None:
        cases = catalogue.cases(['invented'], {'invented': self.base}, everything=True)
        case = next(c for c in cases if c.fault.name == 'landing')
        first, again, other = (case.spoil(self.base, s).rec.main['px'] for s in (1, 1, 2))
        np.testing.assert_array_equal(first, again)
        self.assertFalse(len(first) == len(other) and np.array_equal(first, other))


class Signals(unittest.TestCase):
    """Faults of streams do what they say, and leave the base flight alone."""

    def setUp(self) -> None:
        self.rec = invented_recording(noise=0.0)

    def test_late(self) -> None:
        was = self.rec.main['vx'].copy()
        signals.late(self.rec, VELOCITY, 0.1)  # 25 rows
        np.testing.assert_allclose(self.rec.main['vx'][25:], was[:-25], atol=1e-6)

    def test_rotors_late_in_their_own_file(self) -> None:
        signals.own_rotor_file(self.rec)
        self.assertNotIn('rotor1', self.rec.main)
        signals.rotors_late(self.rec, 0.02)
        self.assertAlmostEqual(self.rec.rotor['t'][0], 0.02)

    def test_velocity_of_the_body(self) -> None:
        v, q = self.rec.get(VELOCITY), self.rec.get(ATTITUDE)
        signals.velocity_of_body(self.rec)
        np.testing.assert_allclose(rotation.rotate(q, self.rec.get(VELOCITY)), v, atol=1e-9)

    def test_ned_keeps_what_the_body_feels(self) -> None:
        thrust = self.rec.get(FORCE)
        signals.world_ned(self.rec, True)
        np.testing.assert_allclose(self.rec.get(FORCE) * [1.0, -1.0, -1.0], thrust, atol=1e-9)
        self.assertLess(self.rec.main['pz'].max(), 0.0)

    def test_accelerometer_without_gravity(self) -> None:
        signals.force_without_gravity(self.rec)
        a = np.gradient(self.rec.get(VELOCITY), self.rec.t, axis=0)
        got = rotation.rotate(self.rec.get(ATTITUDE), self.rec.get(FORCE))
        np.testing.assert_allclose(got[50:-50], a[50:-50], atol=0.05)

    def test_bursts_come_together(self) -> None:
        columns = {'t': np.arange(0.0, 0.5, 0.002)}
        signals.bursts(columns, 0.04)
        gaps = np.diff(columns['t'])
        self.assertTrue(np.all(gaps > 0.0))
        self.assertGreater(gaps.max(), 0.03)
        self.assertLess(np.median(gaps), 0.0005)

    def test_order_and_spins(self) -> None:
        vehicle = {'rotors': [dict(r) for r in VEHICLE['rotors']]}
        signals.reorder(vehicle, (3, 2, 1, 0))
        self.assertEqual(vehicle['rotors'][0], VEHICLE['rotors'][3])
        signals.respin(vehicle, (0,))
        self.assertEqual(vehicle['rotors'][0]['spin'], 'cw')

    def test_text_faults(self) -> None:
        rng = np.random.default_rng(1)
        lines = ['t,px'] + [f'{i},1.5' for i in range(100)]
        self.assertEqual(sorted(signals.shuffled(4)(lines, rng)), sorted(lines))
        self.assertNotEqual(signals.shuffled(4)(lines, rng), lines)
        self.assertGreater(len(signals.duplicated(0.2)(lines, rng)), 105)
        self.assertTrue(any('nan' in x for x in signals.not_numbers(0.2, 'nan')(lines, rng)))

    def test_written_as_read(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            signals.own_rotor_file(self.rec)
            path = self.rec.write(folder, np.random.default_rng(1))
            again = read(path, -1.0, 1e9)
        np.testing.assert_allclose(again.get(ATTITUDE), self.rec.get(ATTITUDE), atol=1e-7)
        np.testing.assert_allclose(again.rotors(), self.rec.rotors(), rtol=1e-6)


def report(k_f: float = 1.0, sigma: float = 0.002, drag: float = -0.3, warnings: List[str] = (),
           findings: List[Dict] = (), observable: bool = True) -> Dict[str, Any]:
    """A report.json with what is judged."""
    def parameter(value: float, sigma: float) -> Dict[str, Any]:
        return {'value': value, 'sigma': sigma, 'state': 'estimated', 'observable': observable}
    names = {scoring.K_F: parameter(k_f, sigma)}
    names.update({d: parameter(drag, 0.01) for d in scoring.DRAG})
    trust = 'doubtful' if any(f['leaves'] != 'good' for f in findings) else 'good'
    return {'parameters': names, 'warnings': list(warnings), 'findings': list(findings),
            'trust': trust, 'trust_reasons': []}


FAULT = catalogue.Fault('landing', 'landing', ('on_ground',), r'standing')


def outcome(spoiled: Optional[Dict], status: Optional[int] = 0, error: str = '',
            scale: float = 1.0) -> str:
    """The outcome of a run; unspoiled: report()."""
    run = scoring.Run(status, error, spoiled)
    unspoiled = report(warnings=['d = -0.3 is odd'])
    return scoring.judge(run, FAULT, scale, unspoiled, (5.0, 6.0)).outcome


class Scoring(unittest.TestCase):
    """Outcomes."""

    def test_right(self) -> None:
        self.assertEqual(outcome(report(1.005)), 'right')
        self.assertEqual(outcome(report(1.005, drag=-0.27)), 'right')

    def test_three_percent_and_three_sigma(self) -> None:
        self.assertEqual(outcome(report(1.02)), 'silent')  # 2 %, 7 sigma
        self.assertEqual(outcome(report(1.04, sigma=0.001)), 'silent')
        self.assertEqual(outcome(report(1.04, sigma=0.03)), 'grown')

    def test_drag(self) -> None:
        self.assertEqual(outcome(report(drag=-0.2)), 'silent')
        self.assertEqual(outcome(report(drag=-0.2, observable=False)), 'right')

    def test_only_new_warnings_count(self) -> None:
        self.assertEqual(outcome(report(1.2, warnings=['d = -0.7 is odd'])), 'silent')
        self.assertEqual(outcome(report(1.2, warnings=['k_h is odd'])), 'vague')
        self.assertEqual(outcome(report(1.2, warnings=['standing is odd'])), 'named')

    def test_finding_names_the_cause_at_its_time(self) -> None:
        finding = {'check': 'on_ground', 'leaves': 'doubtful', 'what': 'x'}
        self.assertEqual(outcome(report(1.2, findings=[finding])), 'named')
        near, far = dict(finding, from_s=5.5, to_s=9.0), dict(finding, from_s=8.0, to_s=9.0)
        self.assertEqual(outcome(report(1.2, findings=[near])), 'named')
        self.assertEqual(outcome(report(1.2, findings=[far])), 'vague')

    def test_a_doubt_names_nothing(self) -> None:
        doubt = {'check': 'stream_doubt', 'leaves': 'good', 'what': 'standing is not excluded'}
        self.assertEqual(outcome(report(1.2, findings=[doubt])), 'vague')

    def test_same_finding_with_other_figures_is_another(self) -> None:
        def late(ms: int) -> Dict[str, Any]:
            return report(1.2, findings=[{'check': 'on_ground', 'leaves': 'good',
                                          'what': f'{ms} ms late'}])
        for ms, named in ((8, False), (9, False), (58, True)):
            run = scoring.Run(0, '', late(ms))
            self.assertEqual(scoring.is_named(run, FAULT, late(8), None), named)

    def test_unrelated_finding(self) -> None:
        other = {'check': 'imu_offset', 'leaves': 'bad', 'what': 'the IMU is late'}
        self.assertEqual(outcome(report(1.2, findings=[other])), 'vague')
        run = scoring.Run(0, '', report(findings=[other]))
        self.assertTrue(scoring.judge(run, FAULT, 1.0, report(), None).unrelated)

    def test_refused(self) -> None:
        self.assertEqual(outcome(None, 1, 'error: it was standing'), 'refused')
        self.assertEqual(outcome(None, 1, 'error: no'), 'vague')
        self.assertEqual(outcome(None, 2, 'usage: standing'), 'vague')

    def test_crash_and_timeout(self) -> None:
        self.assertEqual(outcome(None, -11), 'crashed')
        self.assertEqual(outcome(None, 139), 'crashed')  # by a shell
        self.assertEqual(outcome(None, None), 'timeout')

    def test_scale(self) -> None:
        half = report(0.5, drag=-0.15)
        self.assertEqual(outcome(half, scale=0.5), 'right')
        self.assertEqual(outcome(half), 'silent')

    def test_gist(self) -> None:
        self.assertEqual(scoring.gist('gain is outside 0.85 to 1.15: x 0.6, y 0.2'),
                         scoring.gist('gain is outside 0.85 to 1.15: z -1.6e-3'))
        self.assertNotEqual(scoring.gist('drag.d_x = 1'), scoring.gist('drag.d_y = 1'))

    def test_summary_leaves_the_control_out(self) -> None:
        rows = [{'class': 'control', 'outcome': 'silent', 'base': 'a'},
                {'class': 'landing', 'outcome': 'right', 'base': 'a'}]
        self.assertIn('1 (100.0 %) right', tables.summary(rows)[0])


class Catalogue(unittest.TestCase):
    """The size of a campaign."""

    def test_cases(self) -> None:
        base = invented_base()
        cases = catalogue.cases(NAMES, {n: base for n in NAMES})
        names = [c.name for c in cases]
        self.assertEqual(len(set(names)), len(names))
        self.assertGreaterEqual(len({c.fault.name for c in cases}), 24)
        self.assertGreaterEqual(len(cases), 850)
        some = catalogue.cases(NAMES, {NAMES[3]: base})
        self.assertEqual([c.name for c in some], [n for n in names if n.endswith('@' + NAMES[3])])

    def test_only_what_a_recording_has(self) -> None:
        rec = invented_recording()
        rec.main = {k: v for k, v in rec.main.items() if k not in FORCE + VELOCITY}
        base = bases.Base('poor', rec, VEHICLE)
        classes = {c.fault.name for c in catalogue.cases(['poor'], {'poor': base})}
        self.assertTrue(classes.isdisjoint({'accelerometer', 'velocity_late', 'velocity_stuck'}))
        self.assertIn('rates', classes)


class Running(unittest.TestCase):
    """Programs that fail, hang or crash."""

    def setUp(self) -> None:
        self.folder = tempfile.mkdtemp()
        self.addCleanup(subprocess.run, ['rm', '-r', self.folder], check=True)

    def program(self, text: str) -> List[str]:
        """A shell script in place of calibrate."""
        path = os.path.join(self.folder, 'program')
        with open(path, 'w', encoding='utf-8') as file:
            file.write('#!/bin/bash\n' + text)
        os.chmod(path, os.stat(path).st_mode | stat.S_IXUSR)
        return [path]

    def test_statuses(self) -> None:
        run = running.calibrate(self.program('echo "error: no rows" >&2; exit 1\n'), self.folder)
        self.assertEqual((run.status, run.error, run.report), (1, 'error: no rows', None))
        crashed = running.calibrate(self.program('kill -SEGV $$\n'), self.folder)
        self.assertEqual(crashed.status, -11)

    def test_timeout_ends_children_too(self) -> None:
        was, running.TIMEOUT_S = running.TIMEOUT_S, 0.5
        self.addCleanup(setattr, running, 'TIMEOUT_S', was)
        mark = os.path.join(self.folder, 'mark')
        run = running.calibrate(self.program(f'(sleep 1.5; touch {mark}) & wait\n'), self.folder)
        self.assertIsNone(run.status)
        subprocess.run(['sleep', '1.5'], check=True)
        self.assertFalse(os.path.exists(mark))

    def test_campaign_of_a_stub(self) -> None:
        """Rows in order; a case that can't be made is said; folders are gone."""
        with open(os.path.join(self.folder, 'report.json'), 'w', encoding='utf-8') as file:
            json.dump(report(), file)
        command = self.program(f'mkdir -p $6; cp {self.folder}/report.json $6\n')
        base = invented_base()
        cases = [c for c in catalogue.cases(['invented'], {'invented': base})
                 if c.fault.name in ('k_f', 'mass', 'landing')]
        def fails(*_: Any) -> catalogue.Spoiled:
            raise ValueError('planted')
        cases.append(catalogue.Case('planted', FAULT, 'invented', fails, 1.0))
        kept = os.path.join(self.folder, 'kept')
        rows = running.run_all(running.Setting(command, 1, kept, {'invented': base},
                                               {'invented': report()}, cases), 2)
        self.assertEqual([r['case'] for r in rows], [c.name for c in cases])
        self.assertIn('planted', rows[-1]['not_made'])
        self.assertTrue(all(r['outcome'] == 'right' for r in rows if r['class'] in ('k_f',)))
        self.assertTrue(all(r['outcome'] == 'silent' for r in rows if r['class'] == 'mass'))
        self.assertEqual(len(os.listdir(kept)), len(cases) - 1)

    def test_a_campaign_that_was_cut_off_goes_on(self) -> None:
        """Cases that the journal has are not run again; those of another seed, or cut off, are."""
        with open(os.path.join(self.folder, 'report.json'), 'w', encoding='utf-8') as file:
            json.dump(report(), file)
        ran = os.path.join(self.folder, 'ran')
        command = self.program(f'echo once >>{ran}; mkdir -p $6; cp {self.folder}/report.json $6\n')
        base = invented_base()
        cases = [c for c in catalogue.cases(['invented'], {'invented': base}) if c.fault.name in ('k_f', 'mass')]
        journal = os.path.join(self.folder, 'journal.jsonl')

        def run(seed: int) -> Tuple[List[Dict[str, Any]], int]:
            open(ran, 'w', encoding='utf-8').close()
            setting = running.Setting(command, seed, None, {'invented': base}, {'invented': report()}, cases)
            rows = running.run_all(setting, 2, journal)
            with open(ran, encoding='utf-8') as file:
                return rows, len(file.readlines())

        rows, count = run(1)
        self.assertEqual(count, len(cases))
        with open(journal, encoding='utf-8') as file:
            lines = file.readlines()
        self.assertEqual(len(lines), len(cases))
        with open(journal, 'w', encoding='utf-8') as file:
            file.write(''.join(lines[:-1]) + lines[-1][:20])
        again, count = run(1)
        self.assertEqual(count, 1)
        self.assertEqual([r['case'] for r in again], [c.name for c in cases])
        self.assertEqual(again[:-1], rows[:-1])
        self.assertEqual(run(1)[1], 0)
        self.assertEqual(run(2)[1], len(cases))


@unittest.skipUnless(os.path.isdir(os.path.join(DATA, 'neurobem')), 'no recordings')
class Recordings(unittest.TestCase):
    """On a recording, as a user runs it."""

    def test_list(self) -> None:
        done = subprocess.run([TOOL, '--list', '--base', 'neurobem'], capture_output=True,
                              text=True, check=True)
        self.assertIn('@neurobem', done.stdout)
        self.assertNotIn('accelerometer', done.stdout)  # it has none

    def test_leaning_sensor_frame_rests_as_it_did(self) -> None:
        """polyu's poses lean by 8 degrees on the ground; so do those that are added."""
        base = bases.recorded('polyu')
        landed = scenes.stand_after(base, 0.5, 1.0, np.random.default_rng(1)).rec
        tilt = rotation.rotate(landed.get(ATTITUDE)[-1], np.array([0.0, 0.0, 1.0]))
        self.assertAlmostEqual(float(np.degrees(np.arccos(tilt[2]))), 9.6, delta=1.5)


if __name__ == '__main__':
    unittest.main()
