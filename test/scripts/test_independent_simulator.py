"""Flights of a simulator that shares no code with this package (../shared/data/independent_simulator), of the half to
develop on: what close_loop says of one on which nothing undeclared acts, of two effects and of a disturbance that is in
no catalogue. Needs the built tools and that data."""

import json
import os
import subprocess
import sys
import tempfile
import unittest
from typing import Any, Dict

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
sys.path.insert(0, os.path.join(ROOT, 'scripts'))

from campaign import bases  # noqa: E402

TOOLS = os.path.join(ROOT, 'build', 'devel', 'lib', 'odmc')
NOTHING, REACTION, ROTOR_DRAG, MAGNETIC = 21, 23, 51, 53


def run(folder: str) -> None:
    """@raises CalledProcessError"""
    subprocess.run([sys.executable, os.path.join(ROOT, 'scripts', 'independent_set'), folder, '--flights',
                    f'{NOTHING},{REACTION},{ROTOR_DRAG},{MAGNETIC}'], check=True, capture_output=True)
    subprocess.run([os.path.join(TOOLS, 'score_attribution'), folder, '--jobs', '2'], check=True, capture_output=True)


class IndependentSimulatorTest(unittest.TestCase):
    """A flight a test."""

    reports: Dict[int, Dict[str, Any]] = {}
    score: Dict[str, Any] = {}

    @classmethod
    def setUpClass(cls) -> None:
        if not os.path.exists(os.path.join(TOOLS, 'score_attribution')):
            raise unittest.SkipTest('score_attribution is not built')
        if not os.path.exists(os.path.join(bases.data_folder(), 'independent_simulator', 'truth.json')):
            raise unittest.SkipTest('no recorded data (ODMC_DATA_DIR)')
        with tempfile.TemporaryDirectory(prefix='independent_') as folder:
            run(folder)
            for number in (NOTHING, REACTION, ROTOR_DRAG, MAGNETIC):
                with open(os.path.join(folder, 'results', f'flight_{number:03d}.json'), encoding='utf-8') as file:
                    cls.reports[number] = json.load(file)
            with open(os.path.join(folder, 'score.json'), encoding='utf-8') as file:
                cls.score = json.load(file)

    def named(self, number: int) -> list:
        return [effect['name'] for effect in self.reports[number]['effects']]

    def test_nothing_is_named_where_nothing_acts(self) -> None:
        self.assertEqual(self.reports[NOTHING]['verdict'], 'none')

    def test_effects_are_named_and_no_others(self) -> None:
        self.assertEqual(self.named(REACTION), ['rotor_reaction'])
        self.assertEqual(self.named(ROTOR_DRAG), ['rotor_drag'])

    def test_coefficients_are_within_three_sigma(self) -> None:
        self.assertGreaterEqual(self.score['coefficients']['count'], 2)
        self.assertEqual(self.score['coefficients']['within_three_sigma'], 1.0)

    def test_a_foreign_disturbance_is_blamed_on_no_effect(self) -> None:
        self.assertEqual(self.reports[MAGNETIC]['verdict'], 'unexplained')
        self.assertEqual(self.named(MAGNETIC), [])


if __name__ == '__main__':
    unittest.main()
