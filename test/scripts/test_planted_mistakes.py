"""scripts/planted_mistakes on simulated flights: what inspect names, and that it says nothing of unchanged ones."""

import json
import os
import stat
import subprocess
import sys
import tempfile
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
sys.path.insert(0, os.path.join(ROOT, 'scripts'))

from campaign import mistakes  # noqa: E402

TOOL = os.path.join(ROOT, 'scripts', 'planted_mistakes')
KINDS = ['order_swapped', 'one_spin', 'rpm', 'erpm', 'hz', 'clipped', 'rotor_clock', 'ned_frd', 'conjugated', 'xyzw',
         'position_mm', 'pose_jump', 'velocity_body', 'velocity_late', 'rates_degrees', 'force_g', 'force_world',
         'mass_high', 'inertia_g_cm2', 'arms_ten', 'stamps_ms', 'holes', 'battery_mv']


def plant(flights, *more):
    """Rows of cases.json, and the tables."""
    with tempfile.TemporaryDirectory() as out:
        done = subprocess.run([TOOL, '--simulated', '--flights', flights, '--mistakes', ','.join(KINDS), '--out', out,
                               *more], stdout=subprocess.PIPE, stderr=subprocess.PIPE, check=False)
        if done.returncode != 0:
            raise AssertionError(done.stdout.decode() + done.stderr.decode())
        with open(os.path.join(out, 'cases.json'), encoding='utf-8') as file:
            return json.load(file), done.stdout.decode()


class PlantedMistakesTest(unittest.TestCase):
    """Two vehicles, 20 to 25 s of flight each."""

    def test_all_are_named_and_unchanged_flights_get_no_finding(self):
        rows, tables = plant('sim_octo,sim_circle')
        self.assertEqual(len(rows), 2 * len(KINDS))
        missed = [f"{r['mistake']}@{r['flight']}: {r['sentences']}" for r in rows if not r['named']]
        self.assertEqual(missed, [])
        self.assertIn('- sim_octo: nothing\n', tables)
        self.assertIn('- sim_circle: nothing\n', tables)

    def test_a_program_that_says_nothing_names_nothing(self):
        with tempfile.TemporaryDirectory() as folder:
            mute = os.path.join(folder, 'mute')
            with open(mute, 'w', encoding='utf-8') as file:
                file.write('#!/bin/sh\nwhile [ "$1" != --out ]; do shift; done\n'
                           'echo \'{"duration_s": 20, "findings": [], "notes": []}\' > "$2/report.json"\n')
            os.chmod(mute, os.stat(mute).st_mode | stat.S_IXUSR)
            rows, _ = plant('sim_octo', '--inspect', mute)
        self.assertFalse(any(r['named'] for r in rows))

    def test_another_cause_is_not_the_name(self):
        rotor = {'spin': 'cw'}
        vehicle = {'rotors': [rotor, rotor, rotor, rotor]}
        kinds = {m.name: m for m in mistakes.everything()}
        said = ['rotor_order: rotor speeds fit the order 2, 1, 3, 4 with 40 nats more']
        self.assertTrue(kinds['order_swapped'].is_named(said, vehicle))
        self.assertFalse(kinds['order_rolled'].is_named(said, vehicle))
        said = ['attitude: it fits as a conjugated quaternion (world to body)']
        self.assertTrue(kinds['conjugated'].is_named(said, vehicle))
        self.assertFalse(kinds['xyzw'].is_named(said, vehicle))
        said = ['rotor_unit: the rotor speeds are not in rad/s but in erpm of 7 pole pairs (14 poles)']
        self.assertTrue(kinds['erpm'].is_named(said, vehicle))
        self.assertFalse(kinds['rpm'].is_named(said, vehicle))


if __name__ == '__main__':
    unittest.main()
