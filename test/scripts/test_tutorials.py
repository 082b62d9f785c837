#!/usr/bin/python3
"""scripts/tutorials: which lines are commands, what counts as a difference, and that a document is renewed in place."""

import importlib.machinery
import importlib.util
import os
import sys
import tempfile
import unittest
from typing import Any

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
DOCUMENT = """# A tutorial

    $ echo 'gain 1.25'; echo 'rate 3e-06'
    cat file
    gain 1.5
    rate 2e-06

    trust: good

    $ echo second
    second

Text, and a block of no command:

    key: value
"""


def load() -> Any:
    """The script as a module, without leaving its bytecode beside it."""
    loader = importlib.machinery.SourceFileLoader('tutorials', os.path.join(ROOT, 'scripts', 'tutorials'))
    spec = importlib.util.spec_from_loader('tutorials', loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode = True
    loader.exec_module(module)
    return module


TUTORIALS = load()


class TutorialsTest(unittest.TestCase):
    """A made-up tutorial in a folder of its own."""

    def renew(self, file: str) -> Any:
        """The document where the second command prints this."""
        with tempfile.TemporaryDirectory() as folder:
            with open(os.path.join(folder, 'file'), 'w', encoding='utf-8') as out:
                out.write(file)
            return TUTORIALS.renewed(DOCUMENT, folder)

    def test_figures_are_renewed_but_make_no_difference(self) -> None:
        now, found = self.renew('\ntrust: good\n')
        self.assertEqual(found, [])
        self.assertEqual(now, DOCUMENT.replace('gain 1.5', 'gain 1.25').replace('rate 2e', 'rate 3e'))

    def test_other_words_are_a_difference(self) -> None:
        now, found = self.renew('\ntrust: poor\n')
        self.assertEqual(found, ['cat file', '- trust: good', '+ trust: poor'])
        self.assertIn('    trust: poor\n\n    $ echo second\n    second\n\nText', now)

    def test_errors_are_shown_last(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            self.assertEqual(TUTORIALS.run(['$ echo bad >&2; echo fine'], folder), ['fine', 'bad'])


if __name__ == '__main__':
    unittest.main()
