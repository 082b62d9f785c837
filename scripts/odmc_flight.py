"""What the converters share: streaming CSV, bags, messages, rotations and checks on the data.

Conventions are those of the package: world W with z up, body B with x forward, y left, z up (FLU),
Hamilton quaternions (w, x, y, z in tuples here) that take vectors from B to W, SI, stamps in
integer nanoseconds.
"""

import argparse
import csv
import io
import math
import os
import re
import sys
import time
from typing import Callable, Dict, Iterable, Iterator, List, Optional, Sequence, Tuple, TypeVar

import numpy as np

Result = TypeVar('Result')
Accepted = TypeVar('Accepted')
Vector = Sequence[float]
Quaternion = Sequence[float]  # w, x, y, z
Sample = Tuple[int, List[float]]  # stamp [ns], values

# Standard topics of a flight in a bag.
ODOMETRY = 'odometry'
IMU = 'imu'
ROTOR_SPEEDS = 'rotor_speeds'
BATTERY = 'battery_state'
MOTOR_COMMAND = 'motor_command'

WORLD_FRAME = 'world'
BODY_FRAME = 'base_link'

PLAIN_SECONDS = re.compile(r'(-?)(\d{1,10})(?:\.(\d{0,9}))?$', re.ASCII)
UNIT_NORM_TOLERANCE = 0.05
GRAVITY = 9.81
CHECK_BASELINE_S = 0.05


class FlightError(Exception):
    """Bad input; the text is for the user and names file, line and column where there are some."""


# ---- Running a tool ----------------------------------------------------------------------------


def run_tool(main: Callable[[], None]) -> None:
    """Runs a tool: exit status 0 on success, 1 on bad input (argparse exits with 2)."""
    try:
        main()
    except BrokenPipeError:
        sys.exit(1)
    except (FlightError, OSError) as error:
        print(f'error: {error}', file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)


def note(text: str) -> None:
    """A sentence for the user, on stderr."""
    print(text, file=sys.stderr)


def count_note(count: int, what: str) -> None:
    """Tells about `count` things that were left out, if there were any."""
    if count:
        note(f'warning: {count} {what}')


class Progress:
    """A bar on stderr, drawn only on a terminal and at most ten times a second."""

    def __init__(self, label: str, total: float) -> None:
        self._label = label
        self._total = max(total, 1.0)
        self._shown = sys.stderr.isatty()
        self._next_s = 0.0

    def update(self, done: float) -> None:
        """Draws the bar at `done` of the total."""
        if not self._shown or time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + 0.1
        self._draw(min(done / self._total, 1.0))

    def close(self) -> None:
        """Draws the full bar and ends the line."""
        if self._shown:
            self._draw(1.0)
            sys.stderr.write('\n')

    def _draw(self, share: float) -> None:
        filled = int(30 * share)
        bar = '#' * filled + '.' * (30 - filled)
        sys.stderr.write(f'\r{self._label} [{bar}] {100 * share:3.0f} %')
        sys.stderr.flush()


# ---- Stamps ------------------------------------------------------------------------------------


def from_seconds(seconds: float) -> int:
    """Stamp of `seconds`, rounded as odmc::FromSeconds does."""
    return int(seconds * 1e9 + (-0.5 if seconds < 0.0 else 0.5))


def plain_stamp(text: str) -> Optional[int]:
    """Stamp of seconds in plain decimals, exactly; nothing for any other notation."""
    match = PLAIN_SECONDS.match(text)
    if match is None:
        return None
    sign, whole, fraction = match.groups(default='')
    stamp = int(whole) * 10**9 + int(fraction.ljust(9, '0'))
    return -stamp if sign else stamp


def format_seconds(stamp: int) -> str:
    """`stamp` in seconds, all nanoseconds kept, at least six decimals."""
    sign = '-' if stamp < 0 else ''
    whole, fraction = divmod(abs(stamp), 10**9)
    digits = f'{fraction:09d}'
    while len(digits) > 6 and digits.endswith('0'):
        digits = digits[:-1]
    return f'{sign}{whole}.{digits}'


# ---- CSV ---------------------------------------------------------------------------------------


class CsvFile:
    """A CSV file with one header row, read row by row; columns are found by name."""

    def __init__(self, path: str) -> None:
        self.path = path
        try:
            self._raw = open(path, 'rb')
        except OSError as error:
            raise FlightError(f'{path}: {error.strerror}') from error
        self.size = os.fstat(self._raw.fileno()).st_size
        self._reader = csv.reader(io.TextIOWrapper(self._raw, 'utf-8-sig', newline=''))
        header = self._next_cells()
        if header is None:
            raise FlightError(f'{path}: the file is empty')
        self.columns = [clean_name(name) for name in header]
        self.rows = 0
        self._refused: Dict[str, Tuple[int, int]] = {}
        self._refuse_doubles()

    def _refuse_doubles(self) -> None:
        for name in self.columns:
            if name and self.columns.count(name) > 1:
                raise FlightError(f"{self.path}:1: column '{name}' appears more than once")

    def _next_cells(self) -> Optional[List[str]]:
        try:
            return next(self._reader)
        except StopIteration:
            return None
        except (UnicodeDecodeError, csv.Error) as error:
            raise FlightError(f'{self.path}:{self.line + 1}: not a CSV file ({error})') from error

    @property
    def line(self) -> int:
        """Line number of the row read last, from 1."""
        return self._reader.line_num

    def position(self) -> int:
        """Bytes read so far."""
        return self._raw.tell()

    def has(self, names: Iterable[str]) -> bool:
        """True if all of these columns are there."""
        return all(name in self.columns for name in names)

    def require(self, names: Iterable[str]) -> None:
        """Refuses the file unless all of these columns are there."""
        missing = [name for name in names if name not in self.columns]
        if missing:
            raise FlightError(f"{self.path}:1: missing column{'s' * (len(missing) > 1)} "
                              + ', '.join(f"'{name}'" for name in missing)
                              + '; found ' + ', '.join(self.columns))

    def samples(self, names: Sequence[str], finite: Optional[int] = None) -> Iterator[Sample]:
        """Stamp (of column t) and the named columns of every usable row; an empty cell is NaN.

        Left out and counted: rows without a time, not later than the row before, with fewer cells
        than the header, or with one of the first `finite` columns (default: all) not finite.
        """
        self.require(['t', *names])
        index = [self.columns.index(name) for name in names]
        time_index = self.columns.index('t')
        last: Optional[int] = None
        while (cells := self._next_cells()) is not None:
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(self.columns):
                self._refuse('fewer or more cells than the header')
                continue
            stamp = self._stamp(cells[time_index])
            values = self._values(cells, index, names)
            if stamp is None:
                self._refuse('no finite t')
            elif last is not None and stamp <= last:
                self._refuse('t not later than in the row before')
            elif not all(map(math.isfinite, values[:finite])):
                self._refuse('not finite')
            else:
                last = stamp
                self.rows += 1
                yield stamp, values

    def _values(self, cells: List[str], index: List[int], names: Sequence[str]) -> List[float]:
        try:
            return [float(cells[i]) for i in index]
        except ValueError:
            return [self._number(cells[i], name) for i, name in zip(index, names)]

    def _stamp(self, cell: str) -> Optional[int]:
        stamp = plain_stamp(cell.strip())
        if stamp is not None:
            return stamp
        seconds = self._number(cell, 't')
        return from_seconds(seconds) if abs(seconds) < 9e9 else None

    def _refuse(self, reason: str) -> None:
        count, first = self._refused.get(reason, (0, self.line))
        self._refused[reason] = (count + 1, first)

    def report(self) -> None:
        """Tells what was left out."""
        for reason, (count, first) in self._refused.items():
            count_note(count, f'rows of {self.path} left out: {reason} (first: line {first})')

    def _number(self, cell: str, name: str) -> float:
        if not cell.strip():
            return math.nan
        try:
            return float(cell)
        except ValueError:
            raise FlightError(f"{self.path}:{self.line}: column '{name}': cannot read "
                              f"'{cell[:40]}' as a number") from None

    def close(self) -> None:
        """Closes the file."""
        self._raw.close()


def clean_name(name: str) -> str:
    """A header name without blanks around it and without a leading comment sign."""
    return name.strip().lstrip('#').strip()


def is_unit(quaternion: Quaternion) -> bool:
    """True within the tolerance that the package's own readers have."""
    norm = math.sqrt(sum(value * value for value in quaternion))
    return abs(norm - 1.0) <= UNIT_NORM_TOLERANCE


def finite(values: List[float]) -> bool:
    """True where there are values and all are finite."""
    return bool(values) and all(map(math.isfinite, values))


class UnitCheck:
    """Leaves out poses whose quaternion is not unit; refuses a flight where most are not."""

    def __init__(self, place: str) -> None:
        self._place = place
        self._count = self._refused = 0
        self._first = ''

    def accept(self, quaternion: Quaternion, where: str) -> bool:
        """True if the quaternion is unit."""
        self._count += 1
        if is_unit(quaternion):
            return True
        norm = math.sqrt(sum(value * value for value in quaternion))
        self._first = self._first or f'{where}, norm {norm:.4g}'
        self._refused += 1
        return False

    def report(self, tell: bool = True) -> None:
        """Tells what was left out, or refuses."""
        if 2 * self._refused > self._count:
            raise FlightError(f'{self._place}: the quaternions are not unit: {self._refused} of '
                              f'{self._count} are off by more than 5 % (first: {self._first})')
        if tell:
            count_note(self._refused, f'poses of {self._place} left out: the quaternion is not unit '
                       f'(first: {self._first})')


# ---- Rotations ---------------------------------------------------------------------------------


def normalized(q: Quaternion) -> Tuple[float, ...]:
    """`q` with unit norm."""
    norm = math.sqrt(sum(value * value for value in q))
    return tuple(value / norm for value in q)


def multiply(a: Quaternion, b: Quaternion) -> Tuple[float, float, float, float]:
    """Hamilton product."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw)


def rotation_matrix(q: Quaternion) -> List[List[float]]:
    """R of `q`, which need not be of exact unit norm."""
    w, x, y, z = normalized(q)
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]


def to_world(q_WB: Quaternion, v_B: Vector) -> List[float]:
    """R_WB v_B."""
    R = rotation_matrix(q_WB)
    return [sum(R[i][j] * v_B[j] for j in range(3)) for i in range(3)]


def to_body(q_WB: Quaternion, v_W: Vector) -> List[float]:
    """R_WB^T v_W."""
    R = rotation_matrix(q_WB)
    return [sum(R[j][i] * v_W[j] for j in range(3)) for i in range(3)]


# ---- Messages ----------------------------------------------------------------------------------


def own_directory() -> str:
    """The folder of this file, links resolved."""
    return os.path.dirname(os.path.realpath(__file__))


def message_file(name: str) -> str:
    """Path of one of the package's message definitions: source tree or installed."""
    here = own_directory()
    for folder in ('../msg', '../../share/odmc/msg', 'msg', '../../../share/odmc/msg'):
        path = os.path.normpath(os.path.join(here, folder, f'{name}.msg'))
        if os.path.isfile(path):
            return path
    raise FlightError(f'msg/{name}.msg is not found near {here}; source the setup.bash of odmc')


def dynamic_rotor_speeds_class() -> type:
    """odmc/RotorSpeeds made from its definition, for scripts run without a sourced setup.bash."""
    import genpy.dynamic
    from std_msgs.msg import Header
    with open(message_file('RotorSpeeds'), encoding='utf-8') as file:
        text = file.read()
    text += '=' * 80 + '\nMSG: std_msgs/Header\n' + Header._full_text  # pylint: disable=W0212
    return genpy.dynamic.generate_dynamic('odmc/RotorSpeeds', text)['odmc/RotorSpeeds']


def rotor_speeds_class() -> type:
    """odmc/RotorSpeeds: the generated class where it can be imported."""
    try:
        from odmc.msg import RotorSpeeds
        return RotorSpeeds
    except ImportError:
        return dynamic_rotor_speeds_class()


class Messages:
    """Builds the messages of a flight. Missing quantities are marked as the topics' users expect."""

    def __init__(self) -> None:
        try:
            import genpy
            from nav_msgs.msg import Odometry
            from sensor_msgs.msg import BatteryState, Imu, JointState
        except ImportError as error:
            raise FlightError(f'{error}; install python3-rosbag python3-nav-msgs '
                              'python3-sensor-msgs') from error
        self._time = genpy.Time
        self._odometry, self._imu = Odometry, Imu
        self._battery, self._joint_state = BatteryState, JointState
        self._rotor_speeds = rotor_speeds_class()

    def stamp(self, stamp: int):
        """ROS time of a stamp; the time 0 means "none" in ROS and is refused."""
        if not 0 < stamp < 2**32 * 10**9:
            raise FlightError(f'the stamp {format_seconds(stamp)} s does not fit a ROS time; '
                              'see --start-time')
        return self._time(*divmod(stamp, 10**9))

    def odometry(self, stamp: int, p_WB: Vector, q_WB: Quaternion, v_WB: Optional[Vector],
                 w_WB_B: Optional[Vector]):
        """nav_msgs/Odometry with the twist in the body frame, as ROS defines it.

        twist.covariance[0] is -1 without linear, [21] is -1 without angular velocity.
        """
        message = self._odometry()
        message.header.stamp = self.stamp(stamp)
        message.header.frame_id = WORLD_FRAME
        message.child_frame_id = BODY_FRAME
        pose, twist = message.pose.pose, message.twist.twist
        set_xyz(pose.position, p_WB)
        pose.orientation.w = q_WB[0]
        set_xyz(pose.orientation, q_WB[1:])
        covariance = [0.0] * 36
        if v_WB is None:
            covariance[0] = -1.0
        else:
            set_xyz(twist.linear, to_body(q_WB, v_WB))
        if w_WB_B is None:
            covariance[21] = -1.0
        else:
            set_xyz(twist.angular, w_WB_B)
        message.twist.covariance = covariance
        return message

    def imu(self, stamp: int, frame: str, gyro: Optional[Vector],
            specific_force: Optional[Vector]):
        """sensor_msgs/Imu; covariance[0] is -1 for what was not measured, always so for attitude."""
        message = self._imu()
        message.header.stamp = self.stamp(stamp)
        message.header.frame_id = frame
        message.orientation.w = 1.0
        message.orientation_covariance = unknown_covariance(False)
        message.angular_velocity_covariance = unknown_covariance(gyro is not None)
        message.linear_acceleration_covariance = unknown_covariance(specific_force is not None)
        if gyro is not None:
            set_xyz(message.angular_velocity, gyro)
        if specific_force is not None:
            set_xyz(message.linear_acceleration, specific_force)
        return message

    def rotor_speeds(self, stamp: int, speeds: Vector, rms_only: bool):
        """odmc/RotorSpeeds [rad/s]."""
        message = self._rotor_speeds()
        message.header.stamp = self.stamp(stamp)
        message.header.frame_id = BODY_FRAME
        message.angular_velocity_rad_s = list(speeds)
        message.rms_only = rms_only
        return message

    def battery(self, stamp: int, voltage: float):
        """sensor_msgs/BatteryState with the voltage; the rest is NaN, as the message wants it."""
        message = self._battery()
        message.header.stamp = self.stamp(stamp)
        message.voltage = voltage
        for field in ('current', 'charge', 'capacity', 'design_capacity', 'percentage'):
            setattr(message, field, math.nan)
        message.present = True
        return message

    def motor_command(self, stamp: int, names: Sequence[str], values: Vector):
        """Raw motor commands as sensor_msgs/JointState: `position` carries the source's numbers."""
        message = self._joint_state()
        message.header.stamp = self.stamp(stamp)
        message.name = list(names)
        message.position = list(values)
        return message


def set_xyz(target, values: Vector) -> None:
    """Sets x, y, z of a message."""
    target.x, target.y, target.z = values[0], values[1], values[2]


def get_xyz(source) -> List[float]:
    """x, y, z of a message."""
    return [source.x, source.y, source.z]


def get_quaternion(source) -> List[float]:
    """w, x, y, z of a message."""
    return [source.w, source.x, source.y, source.z]


def unknown_covariance(measured: bool) -> List[float]:
    """Zeros: not known; -1 first: not measured (sensor_msgs/Imu)."""
    return [0.0 if measured else -1.0] + [0.0] * 8


# ---- Bags --------------------------------------------------------------------------------------


class BagWriter:
    """Writes a bag under a temporary name and gives it its own only when all went well."""

    def __init__(self, path: str) -> None:
        import rosbag
        folder = os.path.dirname(path)
        if folder:
            os.makedirs(folder, exist_ok=True)
        self._path = path
        self._part = f'{path}.part'
        self._bag = rosbag.Bag(self._part, 'w')
        self.counts: Dict[str, int] = {}

    def write(self, topic: str, message) -> None:
        """Writes at the time of the header's stamp."""
        self._bag.write(topic, message, message.header.stamp)
        self.counts[topic] = self.counts.get(topic, 0) + 1

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(self, kind, value, trace) -> None:
        self._bag.close()
        if kind is None:
            os.replace(self._part, self._path)
        else:
            os.remove(self._part)

    def summary(self) -> str:
        """What was written, in a line."""
        counts = ', '.join(f'{count} {topic}' for topic, count in self.counts.items())
        return f'{self._path}: {counts}'


def open_bag(path: str):
    """Opens a bag for reading, or says in words why it cannot be."""
    import rosbag
    if not os.path.isfile(path):
        raise FlightError(f'{path}: no such file')
    try:
        return rosbag.Bag(path, 'r')
    except rosbag.ROSBagUnindexedException:
        raise FlightError(f'{path}: the bag has no index: truncated, or not closed by the '
                          'recorder (rosbag reindex may rescue it)') from None
    except (rosbag.ROSBagException, ValueError, KeyError, EOFError) as error:
        raise FlightError(f'{path}: not a readable bag ({error})') from None


def bag_topics(bag) -> Dict[str, str]:
    """Message type of every topic."""
    return {topic: info.msg_type for topic, info in bag.get_type_and_topic_info()[1].items()}


def read_topic(path: str, topic: str, progress: Optional[Progress] = None) -> Iterator:
    """Messages of one topic; a damaged record is an error naming the file."""
    import rosbag
    bag = open_bag(path)
    done = 0
    try:
        for _, message, _ in bag.read_messages(topics=[topic]):
            done += 1
            if progress is not None:
                progress.update(done)
            yield message
    except (rosbag.ROSBagException, ValueError, EOFError) as error:
        raise FlightError(f'{path}: topic {topic}, after {done} messages: {error}') from None
    finally:
        bag.close()


# ---- Checks on the data ------------------------------------------------------------------------

# Where the four numbers named w, x, y, z may really be, and which way they may turn.
QUATERNION_READINGS: Dict[str, Tuple[Tuple[int, int, int, int], bool]] = {
    'as named': ((0, 1, 2, 3), False),
    'as named, conjugated': ((0, 1, 2, 3), True),
    'w first where x is named': ((1, 2, 3, 0), False),
    'w first where x is named, conjugated': ((1, 2, 3, 0), True),
    'w last where z is named': ((3, 0, 1, 2), False),
    'w last where z is named, conjugated': ((3, 0, 1, 2), True),
}


def read_quaternion(named: Quaternion, reading: str) -> List[float]:
    """w, x, y, z from the numbers named w, x, y, z, under one of QUATERNION_READINGS."""
    order, conjugated = QUATERNION_READINGS[reading]
    w, x, y, z = (named[i] for i in order)
    return [w, -x, -y, -z] if conjugated else [w, x, y, z]


def read_quaternions(named: np.ndarray, reading: str) -> np.ndarray:
    """The same for many, n×4."""
    order, conjugated = QUATERNION_READINGS[reading]
    return named[:, order] * (np.array([1.0, -1.0, -1.0, -1.0]) if conjugated else 1.0)


def rotation_matrices(q: np.ndarray) -> np.ndarray:
    """n×3×3 of n×4."""
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    return np.array(rows).transpose(2, 0, 1)


def body_rates_between(q: np.ndarray, dt: np.ndarray, stride: int) -> np.ndarray:
    """Mean body rate from q[i] to q[i + stride], from Log(q_i* q_j) / dt."""
    a = q[:-stride:stride]
    b = q[stride::stride]
    aw, ax, ay, az = (a * [1.0, -1.0, -1.0, -1.0]).T
    bw, bx, by, bz = b.T
    w = aw * bw - ax * bx - ay * by - az * bz
    v = np.stack([aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
                  aw * bz + ax * by - ay * bx + az * bw], axis=1)
    v *= np.where(w < 0.0, -1.0, 1.0)[:, None]
    norm = np.linalg.norm(v, axis=1)
    angle = 2.0 * np.arctan2(norm, np.abs(w))
    scale = np.where(norm > 1e-12, angle / np.maximum(norm, 1e-12), 2.0)
    return v * (scale / dt)[:, None]


def means_between(t: np.ndarray, x: np.ndarray, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
    """Mean of the signal x (n×k at times t) over each interval [t0, t1]."""
    steps = 0.5 * (x[1:] + x[:-1]) * np.diff(t)[:, None]
    integral = np.vstack([np.zeros(x.shape[1]), np.cumsum(steps, axis=0)])
    columns = [np.interp(t1, t, c) - np.interp(t0, t, c) for c in integral.T]
    return np.stack(columns, axis=1) / (t1 - t0)[:, None]


def intervals(t: np.ndarray) -> Tuple[int, np.ndarray, np.ndarray]:
    """Stride of about CHECK_BASELINE_S in samples, with start and end of each interval."""
    stride = max(1, int(round(CHECK_BASELINE_S / float(np.median(np.diff(t))))))
    return stride, t[:-stride:stride], t[stride::stride]


def rms(x: np.ndarray) -> float:
    """Root mean square of the rows' norms; 0 for none."""
    return float(np.sqrt(np.mean(np.sum(x * x, axis=1)))) if len(x) else 0.0


class ResidualTable:
    """Root mean square residuals of competing readings, summed up piece by piece."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._sums: Dict[str, float] = {}
        self._count = 0
        self._signal = 0.0

    def add(self, signal: np.ndarray, residuals: Dict[str, np.ndarray]) -> None:
        """Adds the rows of one piece."""
        self._count += len(signal)
        self._signal += float(np.sum(signal * signal))
        for name, rows in residuals.items():
            self._sums[name] = self._sums.get(name, 0.0) + float(np.sum(rows * rows))

    def rms(self) -> Dict[str, float]:
        """The residual of each reading."""
        return {name: math.sqrt(s / max(self._count, 1)) for name, s in self._sums.items()}

    def fitting(self, documented: str, relative: float, absolute: float, what: str) -> List[str]:
        """The readings that fit about as well as the best; the documented one first if it does.

        @throws FlightError with all residuals where none is below relative * signal + absolute.
        """
        if not self._count:
            return [documented]
        limit = relative * math.sqrt(self._signal / self._count) + absolute
        found = self.rms()
        best = min(found.values())
        if best > limit:
            listing = '; '.join(f'{name}: {value:.3g}' for name, value in found.items())
            raise FlightError(f'{what}: nothing fits the data. Residual rms [{self._unit}], '
                              f'limit {limit:.3g}: {listing}')
        close = min(limit, 1.5 * best + 0.1 * absolute)
        names = [name for name in sorted(found, key=lambda n: found[n]) if found[name] <= close]
        return sorted(names, key=lambda name: name != documented)

    def pick(self, documented: str, relative: float, absolute: float, what: str) -> str:
        """The first of fitting()."""
        return self.fitting(documented, relative, absolute, what)[0]


class FrameCheck:
    """Finds quaternion order and velocity frame of a flight from chunks of its samples."""

    def __init__(self) -> None:
        self.orders = ResidualTable('rad/s')
        self._frames = {name: ResidualTable('m/s') for name in QUATERNION_READINGS}

    def add(self, t: np.ndarray, p: np.ndarray, named_q: np.ndarray, v: Optional[np.ndarray],
            w: Optional[np.ndarray]) -> None:
        """Adds consecutive samples: t [s], p n×3, q n×4 as named w, x, y, z, v n×3, w n×3."""
        if len(t) < 3:
            return
        stride, t0, t1 = intervals(t)
        if not len(t0):
            return
        if w is not None:
            self._add_rates(t, named_q, w, stride)
        if v is not None:
            self._add_velocities(t, p, named_q, v, stride)

    def _add_rates(self, t: np.ndarray, named_q: np.ndarray, w: np.ndarray, stride: int) -> None:
        _, t0, t1 = intervals(t)
        t0 = t0[:len(t1)]
        mean = means_between(t, w, t0, t1)
        residuals = {}
        for name in QUATERNION_READINGS:
            q = read_quaternions(named_q, name)
            residuals[name] = body_rates_between(q, t1 - t0, stride) - mean
        self.orders.add(mean, residuals)

    def _add_velocities(self, t: np.ndarray, p: np.ndarray, named_q: np.ndarray, v: np.ndarray,
                        stride: int) -> None:
        _, t0, t1 = intervals(t)
        moved = (p[stride::stride] - p[:-stride:stride]) / (t1 - t0)[:, None]
        in_world = means_between(t, v, t0, t1) - moved
        for name, table in self._frames.items():
            R = rotation_matrices(read_quaternions(named_q, name))
            turned = np.einsum('nij,nj->ni', R, v)
            table.add(moved, {'body': means_between(t, turned, t0, t1) - moved,
                              'world': in_world})

    def quaternion_readings(self, documented: str = 'as named') -> List[str]:
        """Those of QUATERNION_READINGS that fit the rates, best first; refuses if none does."""
        return self.orders.fitting(documented, 0.3, 0.1, 'quaternion order')

    def velocity_frame(self, reading: str, documented: str) -> str:
        """'body' or 'world'; refuses if d(position)/dt fits neither."""
        return self._frames[reading].pick(documented, 0.2, 0.05, 'velocity frame')


def first_accepted(candidates: Sequence[Result], judge: Callable[[Result], Accepted]) -> Accepted:
    """What `judge` makes of the first candidate that it does not refuse; else the first refusal."""
    refusal: Optional[FlightError] = None
    for candidate in candidates:
        try:
            return judge(candidate)
        except FlightError as error:
            refusal = refusal or error
    assert refusal is not None
    raise refusal


class GravityCheck:
    """World z up and body z along the thrust: rotors push against gravity on average."""

    def __init__(self) -> None:
        self._sums: Dict[str, np.ndarray] = {}
        self._count = 0

    def add(self, t: np.ndarray, p: np.ndarray, readings: Dict[str, np.ndarray]) -> None:
        """Adds consecutive samples; the specific force is from the second difference of p."""
        if len(t) < 3:
            return
        stride = max(1, int(round(0.1 / float(np.median(np.diff(t))))))
        if len(t) <= 2 * stride:
            return
        first, middle, last = (x[a:b] for x, a, b in (
            (t, None, -2 * stride), (t, stride, -stride), (t, 2 * stride, None)))
        moved = p[stride:] - p[:-stride]
        slope = (moved[stride:] / (last - middle)[:, None]
                 - moved[:-stride] / (middle - first)[:, None])
        force = slope / (0.5 * (last - first))[:, None] + [0.0, 0.0, GRAVITY]
        self._count += len(force)
        for name, q in readings.items():
            in_body = np.einsum('nji,nj->i', rotation_matrices(q[stride:-stride]), force)
            self._sums[name] = self._sums.get(name, np.zeros(3)) + in_body

    def judge(self, reading: str) -> None:
        """Refuses a flight whose mean specific force is not up along the body's z."""
        if not self._count:
            return
        mean = self._sums[reading] / self._count
        if mean[2] < 0.7 * np.linalg.norm(mean):
            raise FlightError('the mean specific force in the body is '
                              f'({mean[0]:.2f}, {mean[1]:.2f}, {mean[2]:.2f}) m/s^2, not along +z: '
                              'the world is not z up or the body is not FLU')


def chunks(rows: Iterable[Sequence[float]], size: int = 4096) -> Iterator[np.ndarray]:
    """Rows gathered into arrays of at most `size` rows."""
    batch: List[Sequence[float]] = []
    for row in rows:
        batch.append(row)
        if len(batch) == size:
            yield np.array(batch)
            batch = []
    if batch:
        yield np.array(batch)


# ---- Arguments ---------------------------------------------------------------------------------


def parser(description: str, epilog: str = '') -> argparse.ArgumentParser:
    """An argument parser that keeps the line breaks of its texts."""
    return argparse.ArgumentParser(description=description, epilog=epilog,
                                   formatter_class=argparse.RawDescriptionHelpFormatter)


def add_start_time(arguments: argparse.ArgumentParser) -> None:
    """The option --start-time."""
    arguments.add_argument('--start-time', type=finite_number, default=1.0, metavar='S',
                           help='seconds added to every t, since a ROS time cannot be 0 '
                           '(default: %(default)s)')


def finite_number(text: str) -> float:
    """A finite number, for argparse."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f'{text} is not finite')
    return value
