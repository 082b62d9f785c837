"""Generated pages of scripts/site: each node, installed program and campaign script has one, from what it says itself."""

import importlib.machinery
import importlib.util
import os
import sys
import tempfile
import unittest
from typing import Dict, List

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
sys.path.insert(0, os.path.join(ROOT, 'scripts'))
sys.dont_write_bytecode = True
import odmc_node_help  # noqa: E402  pylint: disable=wrong-import-position

LOADER = importlib.machinery.SourceFileLoader('site_script', os.path.join(ROOT, 'scripts', 'site'))
SPEC = importlib.util.spec_from_loader('site_script', LOADER)
site = importlib.util.module_from_spec(SPEC)
LOADER.exec_module(site)


class SiteTest(unittest.TestCase):
    """Pages are written into a folder of the test's own."""

    def setUp(self) -> None:
        if not os.path.exists(os.path.join(site.TOOLS, 'calibrate')):
            self.skipTest('the tools are not built')
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        site.PAGES = folder.name

    def pages(self, entries: List[Dict[str, str]]) -> Dict[str, str]:
        """Text of each page by the name it has in the navigation."""
        texts = {}
        for entry in entries:
            for name, path in entry.items():
                with open(os.path.join(site.PAGES, path), encoding='utf-8') as file:
                    texts[name] = file.read()
        return texts

    def test_a_page_of_each_node_explains_every_parameter(self) -> None:
        pages = self.pages(site.node_pages())
        self.assertEqual(set(pages), {'controller_node', 'estimator_node', 'simulator_node'})
        for name, text in pages.items():
            said = odmc_node_help.help_of(os.path.join(site.TOOLS, name))
            rows = {cells[0].strip('`'): cells for cells in
                    (line.strip('| ').split(' | ') for line in text.split('\n') if line.startswith('| `'))}
            for entry in said.subscribes + said.publishes + said.services:
                self.assertIn(entry.name, rows)
            for key, default in {**said.parameters, **said.config}.items():
                self.assertEqual(rows[key][1], f'`{default}`')
                self.assertTrue(rows[key][2], f'{name}: {key} is not explained')

    def test_every_installed_program_has_a_page(self) -> None:
        pages = self.pages(site.tool_pages())
        for name in ('calibrate', 'simulate_undeclared', 'fleet', 'render_report', 'render_experiment'):
            self.assertIn(f'`rosrun odmc {name}`', pages[name])
        self.assertIn('| `--vehicle', pages['calibrate'])
        self.assertNotIn('make_test_bag', pages)

    def test_every_campaign_script_has_a_page(self) -> None:
        pages = self.pages(site.study_pages())
        self.assertEqual(set(pages), set(site.STUDIES))
        for name, text in pages.items():
            self.assertIn(f'usage: {name}', text)


if __name__ == '__main__':
    unittest.main()
