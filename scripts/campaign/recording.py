"""A recording as columns: read, cut, put together, written."""

import gzip
import os
from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

Columns = Dict[str, np.ndarray]
POSITION = ('px', 'py', 'pz')
ATTITUDE = ('qw', 'qx', 'qy', 'qz')
VELOCITY = ('vx', 'vy', 'vz')
RATE = ('wx', 'wy', 'wz')
GYRO = ('gx', 'gy', 'gz')
FORCE = ('ax', 'ay', 'az')
KNOWN = POSITION + ATTITUDE + VELOCITY + RATE + GYRO + FORCE + ('t', 'vbat')
TextFault = Callable[[List[str], np.random.Generator], List[str]]


class Recording:
    """Columns of NAME.csv (`main`) and, where rotor speeds have a file of their own, of
    NAME_rotor.csv (`rotor`). `text_fault` is done to the lines of NAME.csv when it is written."""

    def __init__(self, main: Columns, rotor: Optional[Columns] = None,
                 text_fault: Optional[TextFault] = None) -> None:
        self.main = main
        self.rotor = rotor
        self.text_fault = text_fault

    def copy(self) -> 'Recording':
        """A deep copy."""
        rotor = None if self.rotor is None else {k: v.copy() for k, v in self.rotor.items()}
        return Recording({k: v.copy() for k, v in self.main.items()}, rotor, self.text_fault)

    def has(self, names: Sequence[str]) -> bool:
        """Whether NAME.csv has all of these columns."""
        return all(n in self.main for n in names)

    def get(self, names: Sequence[str]) -> np.ndarray:
        """Columns of NAME.csv, side by side."""
        return np.stack([self.main[n] for n in names], axis=-1)

    def put(self, names: Sequence[str], values: np.ndarray) -> None:
        """Replaces columns of NAME.csv."""
        for i, name in enumerate(names):
            self.main[name] = np.ascontiguousarray(values[:, i])

    @property
    def t(self) -> np.ndarray:
        """Stamps of the poses [s]."""
        return self.main['t']

    @property
    def rotor_columns(self) -> Columns:
        """The columns the rotor speeds are taken from."""
        return self.main if self.rotor is None else self.rotor

    @property
    def rotor_names(self) -> List[str]:
        """rotor1, rotor2, ..."""
        return [f'rotor{i + 1}' for i in range(16) if f'rotor{i + 1}' in self.rotor_columns]

    def rotors(self) -> np.ndarray:
        """Rotor speeds [rad/s] at their own stamps, one column each."""
        return np.stack([self.rotor_columns[n] for n in self.rotor_names], axis=-1)

    def rotors_at(self, t: np.ndarray) -> np.ndarray:
        """Rotor speeds at any stamps."""
        c = self.rotor_columns
        return np.stack([np.interp(t, c['t'], c[n]) for n in self.rotor_names], axis=-1)

    def cut(self, start: float, end: float) -> 'Recording':
        """The part from start to end [s]; stamps are kept."""
        def part(columns: Columns) -> Columns:
            keep = (columns['t'] >= start) & (columns['t'] <= end)
            return {k: v[keep] for k, v in columns.items()}
        return Recording(part(self.main), None if self.rotor is None else part(self.rotor))

    def shifted(self, by: float) -> 'Recording':
        """Stamps later by so much."""
        made = self.copy()
        made.main['t'] += by
        if made.rotor is not None:
            made.rotor['t'] += by
        return made

    def then(self, other: 'Recording') -> 'Recording':
        """This one and another after it, as they are."""
        def join(a: Columns, b: Columns) -> Columns:
            return {k: np.concatenate([a[k], b[k]]) for k in a}
        rotor = None
        if self.rotor is not None and other.rotor is not None:
            rotor = join(self.rotor, other.rotor)
        return Recording(join(self.main, other.main), rotor)

    def write(self, folder: str, rng: np.random.Generator) -> str:
        """Writes flight.csv and, where needed, flight_rotor.csv; returns the path of the first."""
        path = os.path.join(folder, 'flight.csv')
        write_csv(path, self.main, self.text_fault, rng)
        if self.rotor is not None:
            write_csv(os.path.join(folder, 'flight_rotor.csv'), self.rotor, None, rng)
        return path


def lines_of(columns: Columns) -> List[str]:
    """The lines of a CSV file."""
    names = list(columns)
    form = ','.join('%.7f' if n == 't' else '%.8g' for n in names)
    rows = np.stack([columns[n] for n in names], axis=-1).tolist()
    return [','.join(names)] + [form % tuple(row) for row in rows]


def write_csv(path: str, columns: Columns, fault: Optional[TextFault],
              rng: np.random.Generator) -> None:
    """Writes columns, with a fault of the text if given."""
    lines = lines_of(columns)
    if fault is not None:
        lines = fault(lines, rng)
    with open(path, 'w', encoding='utf-8') as file:
        file.write('\n'.join(lines) + '\n')


def read_csv(path: str) -> Columns:
    """Columns of a CSV file, possibly packed by gzip."""
    opened = gzip.open if path.endswith('.gz') else open
    with opened(path, 'rt', encoding='utf-8') as file:
        names = file.readline().strip().split(',')
        rows = np.array([line.split(',') for line in file.read().split('\n') if line], float)
    return {n: np.ascontiguousarray(rows[:, i]) for i, n in enumerate(names)}


def is_known(name: str) -> bool:
    """Whether calibrate reads this column."""
    return name in KNOWN or any(name.startswith(p) and name[len(p):].isdigit()
                                for p in ('rotor', 'pwm', 'throttle'))


def read(path: str, start: float, end: float) -> Recording:
    """A recording and its rotor file from start to end; columns calibrate doesn't know are left."""
    rotor_path = path[:-4] + '_rotor.csv'
    def known(columns: Columns) -> Columns:
        return {k: v for k, v in columns.items() if is_known(k)}
    rotor = None
    if os.path.exists(rotor_path):
        rotor = {k: v for k, v in known(read_csv(rotor_path)).items() if not k.startswith('pwm')}
    main = known(read_csv(path))
    if rotor is not None:
        main = {k: v for k, v in main.items() if not k.startswith('rotor')}
    return Recording(main, rotor).cut(start, end)
