"""Faults of streams, stamps, frames, rows and vehicle files. Each takes a copy and changes it."""

from typing import Any, Dict, List, Sequence

import numpy as np

from . import rotation
from .recording import (ATTITUDE, FORCE, GYRO, POSITION, RATE, VELOCITY, Columns, Recording,
                        TextFault)

Vehicle = Dict[str, Any]


# ---- Rotor speeds ------------------------------------------------------------------------------


def window(rec: Recording, duration: float, rng: np.random.Generator) -> np.ndarray:
    """Rotor samples of a time in the middle of the flight."""
    t = rec.rotor_columns['t']
    latest = max(0.3 * t[-1], 0.9 * t[-1] - duration)
    begin = rng.uniform(0.3 * t[-1], latest)
    return (t >= begin) & (t < begin + duration)


def rotors_zero(rec: Recording, which: Sequence[int], chosen: np.ndarray) -> None:
    """These rotors read 0 in chosen samples."""
    for i in which:
        rec.rotor_columns[rec.rotor_names[i]][chosen] = 0.0


def rotor_scale(rec: Recording, which: int, factor: float) -> None:
    """One sensor reads too much or too little."""
    rec.rotor_columns[rec.rotor_names[which]] *= factor


def rotor_frozen(rec: Recording, which: int, begin: float, end: float) -> None:
    """One rotor's reading stays between two times."""
    c = rec.rotor_columns
    chosen = np.flatnonzero((c['t'] >= begin) & (c['t'] <= end))
    c[rec.rotor_names[which]][chosen] = c[rec.rotor_names[which]][chosen[0]]


def rotor_dropouts(rec: Recording, share: float, value: float, rng: np.random.Generator) -> None:
    """Single readings of all rotors, at random, are a value (0 or NaN)."""
    for name in rec.rotor_names:
        x = rec.rotor_columns[name]
        x[rng.random(len(x)) < share] = value


# ---- Time --------------------------------------------------------------------------------------


def delayed(t: np.ndarray, x: np.ndarray, by: float) -> np.ndarray:
    """What a signal that arrives `by` seconds late shows."""
    return np.interp(t - by, t, x)


def late(rec: Recording, names: Sequence[str], by: float) -> None:
    """Columns of NAME.csv show what was `by` seconds ago (before, if negative)."""
    if tuple(names) == ATTITUDE:
        rec.put(ATTITUDE, rotation.continuous(rec.get(ATTITUDE)))
    for name in names:
        rec.main[name] = delayed(rec.t, rec.main[name], by)
    if tuple(names) == ATTITUDE:
        q = rec.get(ATTITUDE)
        rec.put(ATTITUDE, q / np.linalg.norm(q, axis=1, keepdims=True))


def rotors_late(rec: Recording, by: float) -> None:
    """Rotor speeds show what was `by` seconds ago."""
    c = rec.rotor_columns
    if rec.rotor is not None:
        c['t'] += by
        return
    for name in rec.rotor_names:
        c[name] = delayed(c['t'], c[name], by)


def own_rotor_file(rec: Recording) -> Columns:
    """Moves the rotor speeds to a file of their own, if they aren't in one."""
    if rec.rotor is None:
        names = rec.rotor_names
        rec.rotor = {'t': rec.t.copy(), **{n: rec.main.pop(n) for n in names}}
    return rec.rotor


def jitter(columns: Columns, size: float, rng: np.random.Generator) -> None:
    """Stamps are off by this much (uniform, +-); they still grow."""
    t = columns['t'] + rng.uniform(-size, size, len(columns['t']))
    columns['t'] = np.sort(t)


def bursts(columns: Columns, period: float) -> None:
    """Stamps are those of arrival: samples wait and come together at the end of each period."""
    t = columns['t']
    arrival = (np.floor(t / period) + 1.0) * period
    columns['t'] = arrival + 2e-4 * np.concatenate([[0.0], rank_within(arrival)[1:]])


def rank_within(x: np.ndarray) -> np.ndarray:
    """0, 1, 2, ... within runs of equal values."""
    first = np.concatenate([[True], x[1:] != x[:-1]])
    begin = np.maximum.accumulate(np.where(first, np.arange(len(x)), 0))
    return np.arange(len(x)) - begin


# ---- Odometry ----------------------------------------------------------------------------------


def velocity_of_body(rec: Recording) -> None:
    """The velocity is written in the body frame."""
    rec.put(VELOCITY, rotation.rotate(rotation.inverse(rec.get(ATTITUDE)), rec.get(VELOCITY)))


def velocity_of_point(rec: Recording, lever: np.ndarray) -> None:
    """The velocity is that of another point of the vehicle; the position is not."""
    names = GYRO if not rec.has(RATE) else RATE
    rec.put(VELOCITY, rec.get(VELOCITY) + rotation.rotate(
        rec.get(ATTITUDE), np.cross(rec.get(names), lever)))


def stuck(rec: Recording, names: Sequence[str], begin: float, end: float) -> None:
    """Columns keep their value between two times."""
    chosen = np.flatnonzero((rec.t >= begin) & (rec.t <= end))
    for name in names:
        rec.main[name][chosen] = rec.main[name][chosen[0]]


def conjugated(rec: Recording) -> None:
    """Attitudes take vectors from the world into the body."""
    rec.put(ATTITUDE, rotation.inverse(rec.get(ATTITUDE)))


def xyzw(rec: Recording) -> None:
    """Attitudes are stored x, y, z, w under the names w, x, y, z."""
    rec.put(ATTITUDE, rec.get(('qx', 'qy', 'qz', 'qw')))


def body_leans(rec: Recording, angle: float, direction: float) -> None:
    """The body frame of the poses leans against the rotors' plane; rates follow it."""
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    turn = rotation.exp(angle * axis)
    rec.put(ATTITUDE, rotation.multiply(rec.get(ATTITUDE), turn))
    if rec.has(RATE):
        rec.put(RATE, rotation.rotate(rotation.inverse(turn), rec.get(RATE)))


def rate_names(rec: Recording) -> Sequence[str]:
    """The columns of angular rates."""
    return GYRO if rec.has(GYRO) else RATE


def each_rate(rec: Recording) -> List[Sequence[str]]:
    """All triples of columns with rates."""
    return [n for n in (RATE, GYRO) if rec.has(n)]


# ---- Frames of the world -----------------------------------------------------------------------


def turn_world(rec: Recording, turn: np.ndarray) -> None:
    """Poses and velocities are given in a world that is turned."""
    rec.put(POSITION, rotation.rotate(turn, rec.get(POSITION)))
    rec.put(ATTITUDE, rotation.multiply(turn, rec.get(ATTITUDE)))
    if rec.has(VELOCITY):
        rec.put(VELOCITY, rotation.rotate(turn, rec.get(VELOCITY)))


def world_ned(rec: Recording, body_too: bool) -> None:
    """The world is north, east, down; with body_too the body is forward, right, down."""
    half = np.sqrt(0.5)
    turn_world(rec, np.array([0.0, half, half, 0.0]))
    if not body_too:
        return
    flip = np.array([0.0, 1.0, 0.0, 0.0])
    rec.put(ATTITUDE, rotation.multiply(rec.get(ATTITUDE), flip))
    for names in each_rate(rec) + ([FORCE] if rec.has(FORCE) else []):
        rec.put(names, rotation.rotate(flip, rec.get(names)))


# ---- IMU ---------------------------------------------------------------------------------------


def force_in_world(rec: Recording) -> None:
    """The accelerometer's columns are in the world frame."""
    rec.put(FORCE, rotation.rotate(rec.get(ATTITUDE), rec.get(FORCE)))


def force_without_gravity(rec: Recording) -> None:
    """Gravity was taken out of the accelerometer's columns."""
    up = rotation.rotate(rotation.inverse(rec.get(ATTITUDE)), np.array([0.0, 0.0, 9.81]))
    rec.put(FORCE, rec.get(FORCE) - up)


def scaled(rec: Recording, names: Sequence[str], factor: float) -> None:
    """Columns times a factor."""
    for name in names:
        rec.main[name] = rec.main[name] * factor


# ---- Rows --------------------------------------------------------------------------------------


def without_rows(rec: Recording, chosen: np.ndarray) -> None:
    """Rows of NAME.csv are missing."""
    rec.main = {k: v[~chosen] for k, v in rec.main.items()}


def in_gaps(t: np.ndarray, count: int, length: float, rng: np.random.Generator) -> np.ndarray:
    """Which samples lie in some gaps."""
    begins = rng.uniform(t[0] + 1.0, t[-1] - 1.0 - length, count)
    return np.any([(t >= b) & (t < b + length) for b in begins], axis=0)


def jump(rec: Recording, begin: float, end: float, by: np.ndarray) -> None:
    """Positions are off by a vector between two times."""
    chosen = (rec.t >= begin) & (rec.t < end)
    for name, x in zip(POSITION, by):
        rec.main[name][chosen] += x


def yaw_jump(rec: Recording, begin: float, angle: float) -> None:
    """The world turns about z under the vehicle, from a time on."""
    chosen = rec.t >= begin
    turned = rec.copy()
    turn_world(turned, rotation.turn(np.array(angle)))
    for name in POSITION + ATTITUDE + VELOCITY:
        if name in rec.main:
            rec.main[name][chosen] = turned.main[name][chosen]


def duplicated(share: float) -> TextFault:
    """Some rows come twice."""
    def fault(lines: List[str], rng: np.random.Generator) -> List[str]:
        made = lines[:1]
        for line in lines[1:]:
            made += [line, line] if rng.random() < share else [line]
        return made
    return fault


def shuffled(block: int) -> TextFault:
    """Rows are out of order, within blocks of so many rows (0: all)."""
    def fault(lines: List[str], rng: np.random.Generator) -> List[str]:
        made, size = lines[:1], block or len(lines)
        for i in range(1, len(lines), size):
            part = lines[i:i + size]
            made += [part[k] for k in rng.permutation(len(part))]
        return made
    return fault


def truncated(share: float) -> TextFault:
    """The file ends in the middle of a row."""
    def fault(lines: List[str], rng: np.random.Generator) -> List[str]:
        kept = lines[:max(int(share * len(lines)), 3)]
        kept[-1] = kept[-1][:int(rng.integers(12, max(len(kept[-1]) // 2, 13)))]
        return kept
    return fault


def not_numbers(share: float, text: str) -> TextFault:
    """Some cells (not the stamp) are a text."""
    def fault(lines: List[str], rng: np.random.Generator) -> List[str]:
        made = lines[:1]
        for line in lines[1:]:
            if rng.random() < share:
                cells = line.split(',')
                cells[int(rng.integers(1, len(cells)))] = text
                line = ','.join(cells)
            made.append(line)
        return made
    return fault


# ---- Vehicle files -----------------------------------------------------------------------------


def reorder(vehicle: Vehicle, order: Sequence[int]) -> None:
    """Rotors in the file in a wrong order (spins go with their places)."""
    vehicle['rotors'] = [vehicle['rotors'][i] for i in order]


def respin(vehicle: Vehicle, flipped: Sequence[int]) -> None:
    """Wrong spins of some rotors."""
    for i in flipped:
        rotor = vehicle['rotors'][i]
        rotor['spin'] = 'ccw' if rotor['spin'] == 'cw' else 'cw'


def scale_arms(vehicle: Vehicle, factor: float) -> None:
    """Wrong rotor positions."""
    for rotor in vehicle['rotors']:
        rotor['position_m'] = [factor * float(x) for x in rotor['position_m']]


def scale_parameter(vehicle: Vehicle, name: str, factor: float) -> None:
    """A wrong start value, with a prior that is as much wrong."""
    entry = vehicle.setdefault('parameters', {}).setdefault(name, {})
    for key in ('value', 'sigma'):
        if key in entry:
            entry[key] = factor * float(entry[key])


def scale_inertia(vehicle: Vehicle, factor: float) -> None:
    """A wrong nominal inertia."""
    vehicle['inertia_kg_m2'] = [factor * float(x) for x in vehicle['inertia_kg_m2']]
    for axis in 'xyz':
        if f'inertia.{axis}' in vehicle.get('parameters', {}):
            scale_parameter(vehicle, f'inertia.{axis}', factor)
