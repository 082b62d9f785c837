"""test/example_package finds odmc in the devel space, builds against it with and without catkin, and calibrates a
simulated flight. $ODMC_PREFIX names another prefix (an installed odmc)."""

import os
import re
import subprocess
import tempfile
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
EXAMPLE = os.path.join(ROOT, 'test', 'example_package')
DEVEL = os.path.join(ROOT, 'build', 'devel')
TOOLS = os.path.join(DEVEL, 'lib', 'odmc')
VEHICLE = os.path.join(ROOT, 'config', 'vehicles', 'generic.yaml')


class ExamplePackageTest(unittest.TestCase):
    """One build with catkin, one without."""

    def setUp(self) -> None:
        if not os.path.exists(os.path.join(DEVEL, 'share', 'odmc', 'cmake', 'odmcConfig.cmake')):
            self.skipTest('odmc is not built')
        self.folder = tempfile.TemporaryDirectory(prefix='odmc_example_')
        self.addCleanup(self.folder.cleanup)

    def run_command(self, *command: str) -> str:
        done = subprocess.run(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
                              env={'PATH': '/usr/bin:/bin', 'HOME': self.folder.name}, timeout=600)
        self.assertEqual(done.returncode, 0, done.stdout)
        return done.stdout

    def build(self, *options: str) -> str:
        """Builds the example and returns its program."""
        build = os.path.join(self.folder.name, 'build')
        self.run_command('cmake', '-S', EXAMPLE, '-B', build, f'-DCMAKE_PREFIX_PATH={os.environ.get("ODMC_PREFIX", DEVEL)}',
                         '-DPYTHON_EXECUTABLE=/usr/bin/python3', *options)
        self.run_command('cmake', '--build', build)
        for place in ('odmc_example', 'devel/lib/odmc_example/odmc_example', 'devel/lib/odmc_example'):
            if os.path.isfile(os.path.join(build, place)):
                return os.path.join(build, place)
        return self.fail('the build made no odmc_example')

    def test_plain_cmake_builds_and_calibrates(self) -> None:
        program = self.build()
        flight = os.path.join(self.folder.name, 'octo.csv')
        self.run_command(os.path.join(TOOLS, 'simulate'), '--vehicle', VEHICLE, '--trajectory', 'octo', '--duration', '8',
                         '--seed', '1', '--out', flight)
        said = self.run_command(program, flight, VEHICLE)
        found = re.search(r'^thrust\.k_f +(\S+) \+- (\S+)', said, flags=re.MULTILINE)
        self.assertIsNotNone(found, said)
        self.assertAlmostEqual(float(found.group(1)), 1.5e-6, delta=0.05e-6)
        self.assertGreater(float(found.group(2)), 0.0)

    def test_catkin_builds(self) -> None:
        program = self.build('-DODMC_EXAMPLE_CATKIN=ON')
        done = subprocess.run([program], stderr=subprocess.PIPE, text=True, check=False)
        self.assertEqual((done.returncode, done.stderr), (2, 'usage: odmc_example FLIGHT VEHICLE.yaml\n'))


class VersionTest(unittest.TestCase):
    """The version stands in package.xml; all else follows."""

    def test_tools_cmake_and_changelog_have_it(self) -> None:
        with open(os.path.join(ROOT, 'package.xml'), encoding='utf-8') as file:
            version = re.search(r'<version>(\d+\.\d+\.\d+)</version>', file.read()).group(1)
        with open(os.path.join(ROOT, 'CHANGELOG.rst'), encoding='utf-8') as file:
            released = re.findall(r'^(\d+\.\d+\.\d+) \(\d{4}-\d{2}-\d{2}\)\n-+$', file.read(), flags=re.MULTILINE)
        self.assertEqual(released[0], version)
        config = os.path.join(DEVEL, 'share', 'odmc', 'cmake', 'odmcConfig-version.cmake')
        if not os.path.exists(config):
            self.skipTest('odmc is not built')
        with open(config, encoding='utf-8') as file:
            self.assertIn(f'"{version}"', file.read())


if __name__ == '__main__':
    unittest.main()
