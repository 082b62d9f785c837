"""scripts/check_docs finds what is wrong in a document, and nothing in one that is right."""

import os
import re
import subprocess
import sys
import tempfile
import unittest
from typing import List

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
TOOLS = os.path.join(ROOT, 'build', 'devel', 'lib', 'odmc')

RIGHT = '''# A page

`rosrun odmc calibrate flight.bag --vehicle my_quad.yaml --out out`, `--leave-out`, `config/vehicles/generic.yaml`,
`config/vehicles/my_quad.yaml`, `TOOL --no-such-option`, [here](#a-page).

    $ rosrun odmc inspect f.bag --vehicle my_quad.yaml

```
./scripts/fleet flights --vehicle my_quad.yaml \\
  --out fleet            # --not-an-option, as this is a comment
roslaunch odmc estimator.launch odom_topic:=/odom
cmake -S . -B build --fresh
```

<!-- test/example_package/CMakeLists.txt [plain] -->
```
find_package(odmc 1.0 REQUIRED)
```
'''
WRONG = '''# A page

`rosrun odmc calibrat flight.bag`, `calibrate f.bag --vehicl F`, `config/vehicles/nix.yaml`, `--no-such-option`,
[gone](gone.md), [no heading](#nowhere).

    $ rosrun odmc inspect f.bag --vehcle my_quad.yaml

```
./scripts/fleet flights \\
  --ot fleet
roslaunch odmc estimator.launch odm_topic:=/odom
roslaunch odmc estimater.launch
build/devel/lib/odmc/calibrater f.bag
```

Two things:
- one
- the other

<!-- test/example_package/CMakeLists.txt [plain] -->
```
find_package(odmc 0.9 REQUIRED)
```

```cpp
int i;
```
'''


# Each mistake in docs/node.md: what stands there, what is put in its place, and what is said of it.
NODE_MISTAKES = (
    ('| `phase` | `std_msgs/String`', '| `phases` | `std_msgs/String`', 'estimator_node: publishes phases'),
    ('| `state` | `nav_msgs/Odometry`', '| `state` | `nav_msgs/Path`', 'estimator_node: publishes state has no type nav_msgs/Path'),
    ('| `~freeze` | `std_srvs/SetBool`', '| `~freeze` | `std_srvs/Trigger`', 'std_srvs/SetBool is not named'),
    ('| `imu` | `sensor_msgs/Imu` | optional |\n', '', 'estimator_node: subscribes imu, which is not in the table'),
    ('| `queue_size` |', '| `queue_length` |', 'estimator_node: has no parameter queue_length'),
    ('| `command_lag_s` |', '| `publishes_clock` |', 'simulator_node: parameter command_lag_s is explained neither'),
    ('| parameter | |\n| --- | --- |\n', '| parameter | |\n| --- | --- |\n| `config` | a file |\n',
     'is explained in estimator.launch'),
    ('`controller_node`, which links', 'It, which links', 'controller_node: no section begins with'),
)


def check(text: str, name: str = 'page.md') -> List[str]:
    """What check_docs says of one document: 'LINE: what' each."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, name)
        with open(path, 'w', encoding='utf-8') as file:
            file.write(text)
        done = subprocess.run([sys.executable, os.path.join(ROOT, 'scripts', 'check_docs'), path], check=False, text=True,
                              stdout=subprocess.PIPE)
    lines = [line.split(name + ':')[1] for line in done.stdout.splitlines() if name + ':' in line]
    assert bool(lines) == (done.returncode == 1), done
    return lines


class CheckDocsTest(unittest.TestCase):
    """One right and one wrong page."""

    def setUp(self) -> None:
        if not os.path.exists(os.path.join(TOOLS, 'calibrate')):
            self.skipTest('the tools are not built')

    def test_nothing_is_wrong_with_a_right_page(self) -> None:
        self.assertEqual(check(RIGHT), [])

    def test_every_mistake_is_named_with_its_line(self) -> None:
        self.assertEqual(sorted(check(WRONG)), sorted([
            '3: rosrun odmc calibrat: there is no such tool',
            '3: calibrate has no option --vehicl',
            '3: config/vehicles/nix.yaml does not exist',
            '3: no tool has an option --no-such-option',
            '4: link to gone.md, which does not exist',
            '4: link to #nowhere, which has no such heading',
            '6: inspect has no option --vehcle',
            '9: fleet has no option --ot',
            '11: estimator.launch has no argument odm_topic',
            '12: roslaunch odmc estimater.launch: there is no such launch file',
            '13: build/devel/lib/odmc/calibrater: there is no such tool',
            '20: not what stands at [plain] in test/example_package/CMakeLists.txt',
            '25: code that is no extract of a compiled file',
            '17: a list that no empty line parts from the paragraph']))

    def test_the_figures_of_the_readme_are_those_of_the_results(self) -> None:
        with open(os.path.join(ROOT, 'README.md'), encoding='utf-8') as file:
            document = re.sub(r'\[([^]]*)\]\([^)]*\)', r'\1', file.read())  # links lead nowhere from the copy
        self.assertEqual(check(document, 'README.md'), [])
        for figure, wrong in (('0.454 N', '0.4549 N'), ('0.185, ', '0.1851, '), ('99.4 %', '99.45 %')):
            self.assertEqual(document.count(figure), 1, figure)
            number = document[:document.index(figure)].count('\n') + 1
            self.assertEqual(check(document.replace(figure, wrong), 'README.md'),
                             [f'{number}: {wrong.split(" ")[0].rstrip(",")} is not in docs/results.md'])

    def test_the_tables_of_nodes_are_compared_with_their_help(self) -> None:
        with open(os.path.join(ROOT, 'docs', 'node.md'), encoding='utf-8') as file:
            document = re.sub(r'\[([^]]*)\]\([^)]*\)', r'\1', file.read())  # links lead nowhere from the copy
        self.assertEqual(check(document, 'node.md'), [])
        for right, wrong, said in NODE_MISTAKES:
            self.assertEqual(document.count(right), 1 if '| ---' not in right else 2, right)
            found = check(document.replace(right, wrong, 1), 'node.md')
            self.assertTrue(any(said in line for line in found), f'{said}: {found}')


if __name__ == '__main__':
    unittest.main()
