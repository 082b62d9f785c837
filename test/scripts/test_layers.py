#!/usr/bin/python3
"""The include graph against the table of docs/layers.md, and whether files include what they use."""

import functools
import os
import re
import unittest
from typing import Dict, Iterator, List, Optional, Set, Tuple

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
TABLE = os.path.join(ROOT, 'docs', 'layers.md')
ROOTS = (os.path.join(ROOT, 'include', 'odmc'), os.path.join(ROOT, 'src'))
INCLUDE = re.compile(r'^\s*#\s*include\s+(["<])([^">]+)[">]', re.MULTILINE)
# Headers of others by their first folder or whole name; standard ones have neither folder nor suffix.
PARTIES = {'Eigen': 'Eigen', 'unsupported': 'Eigen', 'boost': 'boost', 'yaml-cpp': 'yaml-cpp',
           'ceres': 'ceres', 'nlohmann': 'nlohmann', 'CLI': 'CLI11', 'opencv2': 'opencv2',
           'urdf_model': 'urdf', 'urdf_parser': 'urdf', 'pybind11': 'pybind11'}
SYSTEM = re.compile(r'[a-z_]+(\.h)?$|sys/|netinet/|linux/')

# What CMakeLists.txt precompiles, by what uses it. With precompiled headers the compiler misses no include.
USES = {
    'Eigen/Cholesky': r'\.(ldlt|llt)\(|\bL[DL]*LT<',
    'Eigen/Core': r'Eigen::',
    'Eigen/Geometry': r'Eigen::(Quaterniond?|AngleAxisd?|Isometry3d|Translation3d)\b|\.cross\(',
    'Eigen/LU': r'\.determinant\(|[pP]artialPivLU',
    'Eigen/QR': r'[hH]ouseholderQ[rR]|ompleteOrthogonalDecomposition',
    'algorithm': r'std::(sort|stable_sort|min|max|clamp|find_if|find|any_of|all_of|none_of|count_if|count|copy|fill|'
                 r'transform|lower_bound|upper_bound|nth_element|remove_if|reverse|m[axin]+_element|unique|rotate)\(',
    'array': r'std::array<',
    'cmath': r'std::(sqrt|cbrt|abs|sin|cos|tan|atan2|atan|asin|acos|exp|log|log10|log2|pow|floor|ceil|round|lround|'
             r'isfinite|isnan|hypot|fmod|tanh|erf|erfc|copysign|remainder)\(',
    'cstdint': r'std::u?int(8|16|32|64)_t\b',
    'cstdio': r'std::(printf|fprintf|snprintf|sscanf|puts|fputs|fopen|fclose|fflush|remove|FILE)\b',
    'deque': r'std::deque<',
    'filesystem': r'std::filesystem\b',
    'fstream': r'std::[io]?fstream\b',
    'functional': r'std::(function<|hash<|greater<|less<|bind\(|c?ref\()',
    'gtest/gtest.h': r'\bTEST(_F|_P)?\(',
    'limits': r'std::numeric_limits',
    'map': r'std::(multi)?map<',
    'memory': r'std::(unique_ptr|shared_ptr|weak_ptr|make_unique|make_shared)\b',
    'optional': r'std::(optional|nullopt|make_optional)\b',
    'ros/node_handle.h': r'ros::(Private)?NodeHandle\b',
    'set': r'std::(multi)?set<',
    'stdexcept': r'std::(runtime_error|invalid_argument|logic_error|out_of_range|domain_error|length_error)\b',
    'string': r'std::(string|to_string|stod|stoi|getline)\b',
    'string_view': r'std::string_view',
    'variant': r'std::(variant|visit|get_if|holds_alternative|monostate)\b',
    'vector': r'std::vector<',
}
# What headers are known to bring with them.
BRINGS = {
    'Eigen/Cholesky': ['Eigen/Core'],
    'Eigen/Dense': ['Eigen/Cholesky', 'Eigen/Core', 'Eigen/Geometry', 'Eigen/LU', 'Eigen/QR'],
    'Eigen/Eigenvalues': ['Eigen/Cholesky', 'Eigen/Core', 'Eigen/Geometry', 'Eigen/LU'],
    'Eigen/Geometry': ['Eigen/Cholesky', 'Eigen/Core', 'Eigen/LU', 'Eigen/QR'],
    'Eigen/LU': ['Eigen/Core'],
    'Eigen/QR': ['Eigen/Cholesky', 'Eigen/Core'],
    'Eigen/SVD': ['Eigen/Cholesky', 'Eigen/Core', 'Eigen/QR'],
    'filesystem': ['string'], 'fstream': ['string'], 'iostream': ['string'], 'sstream': ['string'],
    'gtest/gtest.h': ['limits', 'map', 'memory', 'set', 'string', 'vector'],
    'ros/ros.h': ['ros/node_handle.h'],
    'stdexcept': ['string'], 'string': ['string_view'],
}


def read_layers(table: str) -> List[Tuple[str, List[str], Set[str]]]:
    """Layer, rooms in order and allowed parties, by the rows of the first table."""
    rows = [line.strip().strip('|').split('|') for line in table.splitlines() if line.startswith('|')]
    layers = []
    for row in rows[2:]:
        if len(row) != 4:
            break
        rooms = re.findall(r'`(\w+)`', row[1])
        layers.append((row[0].strip(), rooms, {p.strip() for p in row[3].split(',')}))
    return layers


def sources() -> Iterator[str]:
    """Paths of all headers and sources of the package."""
    for root in ROOTS:
        for folder, _, files in os.walk(root):
            for name in sorted(files):
                if name.endswith(('.h', '.cpp')):
                    yield os.path.join(folder, name)


@functools.lru_cache(maxsize=None)
def includes(path: str) -> List[str]:
    """What a file includes, as it is written."""
    with open(path, encoding='utf-8') as file:
        return [match[1] for match in INCLUDE.findall(file.read())]


def room_of(path: str) -> str:
    """Room of a file of the package."""
    root = next(r for r in ROOTS if path.startswith(r + os.sep))
    return os.path.relpath(path, root).split(os.sep)[0]


def resolve(path: str, include: str) -> Optional[str]:
    """File of the package that an include names; None where it names a foreign one."""
    for folder in (os.path.dirname(path), *(os.path.join(ROOT, f) for f in ('include', 'src/tools', 'test'))):
        file = os.path.normpath(os.path.join(folder, include))
        if os.path.isfile(file):
            return file
    return None


def party_of(include: str) -> str:
    """Whose header it is; '' for the standard library's and the system's."""
    if SYSTEM.match(include):
        return ''
    first = include.split('/')[0]
    return PARTIES.get(first, 'ROS')


def offences(layers: List[Tuple[str, List[str], Set[str]]],
             files: Dict[str, List[str]]) -> List[str]:
    """Sentences on includes that the table does not allow."""
    order = [room for _, rooms, _ in layers for room in rooms]
    allowed = {room: parties for _, rooms, parties in layers for room in rooms}
    found = []
    for path, names in files.items():
        room, short = room_of(path), os.path.relpath(path, ROOT)
        if room not in order:
            found.append(f'{short}: the room {room} is not in docs/layers.md')
            continue
        for name in names:
            target = resolve(path, name)
            if target is None:
                party = party_of(name)
                if party and party not in allowed[room]:
                    found.append(f'{short} includes {name}: {room} may not use {party}')
                continue
            other = room_of(target)
            if other not in order or order.index(other) > order.index(room):
                found.append(f'{short} includes {name}: {room} stands before {other}')
            if other == 'bench' and room not in ('bench', 'tools'):
                found.append(f'{short} includes {name}: bench is for tools alone')
    return found


def closure(path: str) -> Set[str]:
    """All files of the package that a file brings with it."""
    seen: Set[str] = set()
    todo = [path]
    while todo:
        for name in includes(todo.pop()):
            target = resolve(path, name)
            if target and target not in seen:
                seen.add(target)
                todo.append(target)
    return seen


def missing(path: str, text: str) -> List[str]:
    """Headers of USES that a file uses and neither includes nor gets from another of the package."""
    have: Set[str] = {match[1] for match in INCLUDE.findall(text)}
    for own in [file for file in (resolve(path, name) for name in sorted(have)) if file]:
        for file in {own} | closure(own):
            have.update(includes(file))
    todo = list(have)
    while todo:
        brought = set(BRINGS.get(todo.pop(), ())) - have
        have |= brought
        todo += brought
    code = re.sub(r'//.*', '', text)
    return [header for header, use in USES.items() if header not in have and re.search(use, code)]


class Includes(unittest.TestCase):
    """Every file compiles without the precompiled headers."""

    def test_files_include_what_they_use(self) -> None:
        """No file uses a header that only the precompiled ones bring."""
        tests = [os.path.join(folder, name) for folder, _, names in os.walk(os.path.join(ROOT, 'test'))
                 for name in names if name.endswith(('.h', '.cpp'))]
        found = []
        for path in [*sources(), *tests]:
            with open(path, encoding='utf-8') as file:
                found += [f'{os.path.relpath(path, ROOT)} lacks <{h}>' for h in missing(path, file.read())]
        self.assertEqual([], found)

    def test_a_missing_include_is_seen(self) -> None:
        """Each line of a source with includes taken away is found, and comments are not."""
        path = os.path.join(ROOTS[1], 'nowhere', 'nothing.cpp')
        text = '#include <vector>\nstd::vector<double> a; // std::map<int, int>\n'
        self.assertEqual([], missing(path, text))
        self.assertEqual(['vector'], missing(path, text.replace('#include', '//')))
        self.assertEqual(['cmath', 'map'], missing(path, text + 'std::map<int, double> b = std::abs(a);'))
        self.assertEqual(['Eigen/Cholesky'], missing(path, '#include <Eigen/Core>\nA.ldlt().solve(b);'))

    def test_every_precompiled_header_is_known(self) -> None:
        """What CMake precompiles is in USES, but what one header of ROS or nothing but types is."""
        with open(os.path.join(ROOT, 'CMakeLists.txt'), encoding='utf-8') as file:
            text = file.read()
        common = re.search(r'set\(common_headers ([^)]*)\)', text)
        self.assertIsNotNone(common)
        names = re.findall(r'<([^>]+)>', common[1] if common else '')
        self.assertGreater(len(names), 10)
        self.assertEqual([], [name for name in names if name not in USES and name != 'utility'])


class Layers(unittest.TestCase):
    """Every include is one that the table allows."""

    def setUp(self) -> None:
        with open(TABLE, encoding='utf-8') as file:
            self.layers = read_layers(file.read())
        self.files = {path: includes(path) for path in sources()}

    def test_table_names_every_room_once(self) -> None:
        """The table and the folders have the same rooms."""
        rooms = [room for _, rooms, _ in self.layers for room in rooms]
        self.assertEqual(len(rooms), len(set(rooms)))
        self.assertEqual(set(rooms), {room_of(path) for path in self.files})

    def test_no_include_goes_upwards(self) -> None:
        """No room includes one behind it, and no layer a foreign header that is not its own."""
        self.assertEqual([], offences(self.layers, self.files))

    def test_upward_includes_are_seen(self) -> None:
        """Planted offences of each kind are found."""
        file = os.path.join(ROOTS[1], 'model', 'motor.cpp')
        for name, says in (('odmc/estimator/estimator.h', 'model stands before estimator'),
                           ('ceres/ceres.h', 'model may not use ceres'),
                           ('ros/ros.h', 'model may not use ROS'),
                           ('../inspection/motion_windows.h', 'model stands before inspection')):
            found = offences(self.layers, {file: [name]})
            self.assertEqual(1, len(found), name)
            self.assertIn(says, found[0])
        node = os.path.join(ROOTS[1], 'fleet', 'joint_report.cpp')
        self.assertTrue(offences(self.layers, {node: ['odmc/bench/recovery.h']}))

    def test_core_and_discovery_know_no_solver(self) -> None:
        """Ceres is included in estimation only."""
        users = {room_of(p) for p, names in self.files.items() if any(n.startswith('ceres') for n in names)}
        estimation = next(rooms for name, rooms, _ in self.layers if name == 'estimation')
        self.assertTrue(users)
        self.assertLessEqual(users, set(estimation))

    def test_samples_come_without_the_vehicle(self) -> None:
        """Whoever reads streams need not know the model."""
        header = os.path.join(ROOTS[0], 'sensing', 'samples.h')
        brought = {os.path.relpath(p, ROOTS[0]) for p in closure(header)}
        self.assertIn('math/rotor_vector.h', brought)
        self.assertFalse([p for p in brought if p.startswith('model')], brought)

    def test_bench_headers_are_not_installed(self) -> None:
        """CMake leaves the headers of bench out, and installs no library of it."""
        with open(os.path.join(ROOT, 'CMakeLists.txt'), encoding='utf-8') as file:
            text = file.read()
        self.assertRegex(text, r'install\(DIRECTORY include/odmc/[^)]*PATTERN bench EXCLUDE')
        self.assertNotRegex(text, r'install\(TARGETS[^)]*odmc_bench')


if __name__ == '__main__':
    unittest.main()
