"""One faulty flight of each class of fault_campaign, calibrated: none may be wrong without a word,
and none beside something unrelated. Needs the built tools; no recordings."""

import os
import shlex
import sys
import tempfile
import unittest
from typing import Any, Dict, List

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
sys.path.insert(0, os.path.join(ROOT, 'scripts'))

from campaign import bases, catalogue, running, scoring  # noqa: E402

TOOLS = os.path.join(ROOT, 'build', 'devel', 'lib', 'odmc')
BASES = ('sim_octo', 'sim_aggressive', 'sim_circle')


def run() -> List[Dict[str, Any]]:
    """One case of each class, the flights in turn."""
    simulate = shlex.split(os.path.join(TOOLS, 'simulate'))
    command = [os.path.join(TOOLS, 'calibrate')]
    with tempfile.TemporaryDirectory(prefix='whole_flights_') as folder:
        loaded = {name: bases.load(name, simulate, folder) for name in BASES}
    made = catalogue.cases(bases.names(), loaded)
    cases = []
    for index, fault in enumerate(catalogue.faults()):
        mine = [case for case in made if case.fault.name == fault.name]
        turn = [case for case in mine if case.base == BASES[index % len(BASES)]]
        cases.append((turn or mine)[0])
    unspoiled = {name: running.run_unspoiled(command, base).report for name, base in loaded.items()}
    setting = running.Setting(command, 1, None, loaded, unspoiled, cases)
    return running.run_all(setting, 2)


class WholeFlightsTest(unittest.TestCase):
    """A class a line."""

    rows: List[Dict[str, Any]] = []

    @classmethod
    def setUpClass(cls) -> None:
        if not os.path.exists(os.path.join(TOOLS, 'calibrate')):
            raise unittest.SkipTest('calibrate is not built')
        cls.rows = run()

    def test_every_class_is_there(self) -> None:
        self.assertEqual([row['class'] for row in self.rows],
                         [fault.name for fault in catalogue.faults()])
        self.assertEqual([row for row in self.rows if 'not_made' in row], [])

    def test_none_is_wrong_without_its_cause(self) -> None:
        bad = (scoring.SILENT, scoring.VAGUE, scoring.CRASHED, scoring.TIMEOUT)
        for row in self.rows:
            with self.subTest(row['case']):
                self.assertNotIn(row.get('outcome'), bad, row)

    def test_most_are_right_or_named(self) -> None:
        good = scoring.GOOD
        share = sum(row.get('outcome') in good for row in self.rows) / len(self.rows)
        self.assertGreaterEqual(share, 0.92)


if __name__ == '__main__':
    unittest.main()
