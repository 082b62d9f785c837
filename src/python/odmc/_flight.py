"""Recorded flights as arrays."""

import dataclasses
import functools
import os
from typing import Any, Dict, Iterator, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from . import _native
from ._vehicle import VehicleLike, as_vehicle

_VECTORS = ('p_WS', 'q_WS', 'v_WS', 'w_WS_S', 'gyro_I', 'specific_force_I')
MessageOptions = Mapping[str, Union[int, str, Sequence[int]]]


class Stream(Mapping[str, np.ndarray]):
    """One stream of a flight: arrays by name, a row for each sample; also as attributes (stream.p_WS).

    t_s (n,) counts from the flight's first odometry sample, stamp_ns (n,) is the stamp itself. What a stream never
    has is None; where single samples lack it, their row is NaN.
    """

    def __init__(self, name: str, arrays: Dict[str, Optional[np.ndarray]], start_ns: int) -> None:
        stamps = arrays['stamp_ns']
        assert stamps is not None
        self._name = name
        self._arrays: Dict[str, Optional[np.ndarray]] = {'t_s': 1e-9 * (stamps - start_ns).astype(float), **arrays}

    def __getitem__(self, name: str) -> Any:
        return self._arrays[name]

    def __getattr__(self, name: str) -> Any:
        if name.startswith('_') or name not in self._arrays:
            raise AttributeError(f"the stream '{self._name}' has no '{name}'; it has {', '.join(self._arrays)}")
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self._arrays['stamp_ns'])  # type: ignore[arg-type]

    def to_pandas(self) -> Any:
        """The stream as a pandas.DataFrame, vectors as columns p_WS_x.. or speed_rad_s_1..; needs pandas."""
        import pandas
        columns = {}
        for name, values in self._arrays.items():
            if values is None:
                continue
            if values.ndim == 1:
                columns[name] = values
                continue
            ends = 'xyzw' if name in _VECTORS else '12345678'
            for k in range(values.shape[1]):
                columns[f'{name}_{ends[k]}'] = values[:, k]
        return pandas.DataFrame(columns)

    def __repr__(self) -> str:
        return f'<odmc.Stream {self._name}: {self.samples} samples of {", ".join(self._arrays)}>'


@dataclasses.dataclass(frozen=True)
class Inspection:
    """What the streams of a flight say about each other and the vehicle file."""

    findings: Tuple[str, ...]  #: one sentence each, what is wrong and where
    refusal: str  #: why nothing sensible can be learned from it; empty: it can
    mended: 'Flight'  #: the flight as calibrate() uses it


class Flight:
    """A recorded flight, in the conventions of this package whatever its format was. Never changes."""

    def __init__(self, native: _native.FlightLog) -> None:
        self._native = native
        stamps = native.odometry()['stamp_ns']
        self._start_ns = int(stamps[0]) if stamps is not None and len(stamps) else 0

    @property
    def file(self) -> str:
        """Its file's name, without the folder."""
        return self._native.file

    @property
    def warnings(self) -> Sequence[str]:
        """What the reader has to say, one sentence each."""
        return tuple(self._native.warnings)

    @property
    def dropped(self) -> int:
        """Samples that were refused: not finite, out of order."""
        return self._native.dropped

    @property
    def duration_s(self) -> float:
        """From the first to the last odometry sample."""
        t_s = self.odometry.t_s
        return float(t_s[-1]) if len(t_s) else 0.0

    @functools.cached_property
    def odometry(self) -> Stream:
        """t_s, stamp_ns, p_WS [m] (n, 3), q_WS (n, 4) as x, y, z, w, v_WS in W [m/s] and w_WS_S in S [rad/s] (n, 3)."""
        return Stream('odometry', self._native.odometry(), self._start_ns)

    @functools.cached_property
    def imu(self) -> Stream:
        """t_s, stamp_ns, gyro_I [rad/s], specific_force_I [m/s^2] (+9.8 on z at hover), both (n, 3) in I with bias."""
        return Stream('imu', self._native.imu(), self._start_ns)

    @functools.cached_property
    def rotors(self) -> Stream:
        """t_s, stamp_ns, speed_rad_s (n, rotors) >= 0; model_sigma_rad_s: sigma of those that come from the actuator
        model instead of the sensor, else 0."""
        return Stream('rotors', self._native.rotors(), self._start_ns)

    @functools.cached_property
    def commands(self) -> Stream:
        """t_s, stamp_ns, throttle (n, rotors), 0 to 1."""
        return Stream('commands', self._native.commands(), self._start_ns)

    @functools.cached_property
    def battery(self) -> Stream:
        """t_s, stamp_ns, voltage_V (n,)."""
        return Stream('battery', self._native.battery(), self._start_ns)

    def inspect(self, vehicle: VehicleLike) -> Inspection:
        """Compares the streams with each other and with the vehicle file, as the tool inspect does."""
        found = self._native.inspect(as_vehicle(vehicle).native)
        return Inspection(tuple(found['findings']), found['refusal'], Flight(found['mended']))

    def write(self, file: Union[str, 'os.PathLike[str]']) -> None:
        """Writes a .csv or .bag that every tool reads."""
        self._native.write(os.fspath(file))

    @property
    def native(self) -> _native.FlightLog:
        """For the package's own use."""
        return self._native

    def __repr__(self) -> str:
        counts = ', '.join(f'{name} {getattr(self, name).samples}'
                           for name in ('odometry', 'imu', 'rotors', 'commands', 'battery'))
        return f'<odmc.Flight {self.file}: {self.duration_s:.1f} s; samples: {counts}>'

    @staticmethod
    def from_arrays(vehicle: VehicleLike, *, t_s: np.ndarray, p_WS: np.ndarray, q_WS: np.ndarray,
                    rotor_t_s: np.ndarray, rotor_speed_rad_s: np.ndarray,
                    v_WS: Optional[np.ndarray] = None, w_WS_S: Optional[np.ndarray] = None,
                    imu_t_s: Optional[np.ndarray] = None, gyro_I: Optional[np.ndarray] = None,
                    specific_force_I: Optional[np.ndarray] = None,
                    battery_t_s: Optional[np.ndarray] = None, voltage_V: Optional[np.ndarray] = None,
                    name: str = 'arrays') -> 'Flight':
        """A flight from arrays of your own.

        Times are in s by one clock, each stream with its own. Shapes, frames and units as of the properties odometry
        (t_s, p_WS, q_WS, v_WS, w_WS_S), rotors, imu and battery; q_WS is x, y, z, w. NaN marks what a sample lacks.
        Samples out of order are dropped, as from a file. Raises ValueError naming the array whose shape is wrong, or
        what makes it no flight.
        """
        quad = as_vehicle(vehicle)

        def rows(what: str, array: Optional[np.ndarray], count: int, width: int) -> Optional[np.ndarray]:
            if array is None:
                return None
            array = np.ascontiguousarray(array, dtype=float)
            if array.shape != (count, width):
                raise ValueError(f'{what} is of shape {array.shape}; expected ({count}, {width})')
            return array

        def stamps(what: str, times: Optional[np.ndarray]) -> np.ndarray:
            times = np.asarray([] if times is None else times, dtype=float)
            if times.ndim != 1 or not np.all(np.isfinite(times)):
                raise ValueError(f'{what} is not a row of finite times')
            return np.round(times * 1e9).astype(np.int64)

        odometry_ns, rotor_ns = stamps('t_s', t_s), stamps('rotor_t_s', rotor_t_s)
        imu_ns, battery_ns = stamps('imu_t_s', imu_t_s), stamps('battery_t_s', battery_t_s)
        n = len(odometry_ns)
        voltage = np.asarray([] if voltage_V is None else voltage_V, dtype=float)
        if voltage.shape != battery_ns.shape:
            raise ValueError(f'voltage_V is of shape {voltage.shape}; expected {battery_ns.shape}')
        for what, array in (('gyro_I', gyro_I), ('specific_force_I', specific_force_I)):
            if array is not None and imu_t_s is None:
                raise ValueError(f'{what} needs imu_t_s')
        return Flight(_native.flight_of(
            name, quad.native, odometry_ns.tolist(), rows('p_WS', p_WS, n, 3), rows('q_WS', q_WS, n, 4),
            rows('v_WS', v_WS, n, 3), rows('w_WS_S', w_WS_S, n, 3), rotor_ns.tolist(),
            rows('rotor_speed_rad_s', rotor_speed_rad_s, len(rotor_ns), quad.num_rotors), imu_ns.tolist(),
            rows('gyro_I', gyro_I, len(imu_ns), 3), rows('specific_force_I', specific_force_I, len(imu_ns), 3),
            battery_ns.tolist(), voltage.tolist()))


def _one_of(name: str, value: str, allowed: Sequence[str]) -> str:
    if value not in allowed:
        raise ValueError(f"{name} is '{value}'; there are {', '.join(allowed)}")
    return value


def read_flight(file: Union[str, 'os.PathLike[str]'], vehicle: VehicleLike, *, start_s: float = 0.0,
                end_s: Optional[float] = None, pose: str = 'ekf', topics: Optional[Mapping[str, str]] = None,
                twist_frame: str = 'auto', messages: Optional[MessageOptions] = None, pole_pairs: Optional[int] = None,
                odometry: Union[str, 'os.PathLike[str]'] = '', odometry_offset_s: Optional[float] = None,
                accelerometer: bool = False, rotor_speed_from: str = 'sensor',
                actuator: Union[str, 'os.PathLike[str]'] = '') -> Flight:
    """Reads a recorded flight as the tools do: a rosbag, a CSV file, an autopilot's log (docs/flights.md, docs/logs.md).

    vehicle: an odmc.Vehicle or a vehicle file; it says how many rotors there are and where sensors sit.
    start_s, end_s: cuts the flight, in s since the recording's start.
    pose: 'ekf', the recording's odometry, or 'mocap', NAME_mocap.csv beside a CSV file or the bag's pose topic.
    topics: of a bag by role, {'odometry': '/vio/odom'}. twist_frame: 'auto', 'body' or 'world'.
    messages: how a bag's messages are read, {'rotor_speed_unit': 'rpm', 'rotor_topic_field': 'esc_status[].rpm',
        'rotor_order': [2, 4, 1, 3], ...} (docs/messages.md); pole_pairs: of the motors, where speeds are electrical.
    odometry: recording of the poses by another clock; odometry_offset_s: to be added to its stamps, else it is found.
    accelerometer: of NeuroBEM's files, whose acc columns may not be measured.
    rotor_speed_from: 'sensor' or 'commands', then by `actuator` (actuator.yaml) or the vehicle's.

    Raises ValueError naming the file, what is wrong and where.
    """
    if not start_s >= 0.0:
        raise ValueError(f'start_s is {start_s}; expected a time of zero or more')
    if end_s is not None and not end_s > 0.0:
        raise ValueError(f'end_s is {end_s}; expected a time above zero')
    if pole_pairs is not None and not pole_pairs > 0:
        raise ValueError(f'pole_pairs is {pole_pairs}; expected a number above zero')
    return Flight(_native.read_flight(
        file=os.fspath(file), vehicle=as_vehicle(vehicle).native, start_s=start_s, end_s=0.0 if end_s is None else end_s,
        mocap=_one_of('pose', pose, ('ekf', 'mocap')) == 'mocap',
        topics=[f'{role}:={topic}' for role, topic in (topics or {}).items()],
        twist_frame=_one_of('twist_frame', twist_frame, ('auto', 'body', 'world')),
        messages={key: value if isinstance(value, (int, str)) else list(value) for key, value in (messages or {}).items()},
        pole_pairs=pole_pairs, odometry=os.fspath(odometry), odometry_offset_s=odometry_offset_s,
        accelerometer=accelerometer,
        from_commands=_one_of('rotor_speed_from', rotor_speed_from, ('sensor', 'commands')) == 'commands',
        actuator=os.fspath(actuator)))
