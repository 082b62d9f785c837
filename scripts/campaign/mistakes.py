"""Mistakes that people make with a recording or its vehicle file, one at a time, and what a sentence
must say to name each. The recording and the vehicle are spoiled in place."""

import re
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Sequence

import numpy as np

from . import rotation, signals
from .recording import ATTITUDE, FORCE, GYRO, POSITION, RATE, VELOCITY, Recording

Vehicle = Dict[str, Any]
Spoil = Callable[[Recording, Vehicle], None]
POLE_PAIRS = 7
LATE = r'stamped (3\d|4\d|5\d)(\.\d)? ms late'
RATES = r'^(body_rates|gyro|rates)'


@dataclass
class Mistake:
    """`named` is the pattern of a sentence "check: what; mend" that names the cause. `needs` are
    columns without which the mistake cannot be made: each entry any of its names."""
    name: str
    group: str
    title: str
    named: Callable[[Vehicle], str]
    spoil: Spoil
    needs: Sequence[Sequence[str]] = ()

    def applies(self, rec: Recording) -> bool:
        """Whether the recording has what it takes."""
        columns = set(rec.main) | set(rec.rotor_columns)
        return all(any(n in columns for n in names) for names in self.needs)

    def is_named(self, sentences: List[str], vehicle: Vehicle) -> bool:
        """Whether one of the sentences names it. @param vehicle the right one"""
        pattern = re.compile(self.named(vehicle), re.IGNORECASE)
        return any(pattern.search(s) for s in sentences)


def of_file(change: Callable[[Vehicle], None]) -> Spoil:
    """A mistake in the vehicle file."""
    return lambda rec, vehicle: change(vehicle)


def of_recording(change: Callable[[Recording], None]) -> Spoil:
    """A mistake in the recording."""
    return lambda rec, vehicle: change(rec)


# ---- Rotor speeds ------------------------------------------------------------------------------


def put_rotors(rec: Recording, speeds: np.ndarray) -> None:
    """Replaces the rotor speeds."""
    for i, name in enumerate(rec.rotor_names):
        rec.rotor_columns[name] = np.ascontiguousarray(speeds[:, i])


def order_text(order: Sequence[int]) -> str:
    """The order as inspect writes it."""
    return ', '.join(str(j + 1) for j in order)


def swapped(vehicle: Vehicle) -> List[int]:
    """The first two columns exchanged."""
    return [1, 0, *range(2, len(vehicle['rotors']))]


def rolled(vehicle: Vehicle) -> List[int]:
    """Every column one place on."""
    n = len(vehicle['rotors'])
    return [*range(1, n), 0]


def reordered(order: Callable[[Vehicle], List[int]]) -> Spoil:
    """Columns in another order than the file's rotors."""
    return lambda rec, vehicle: put_rotors(rec, rec.rotors()[:, order(vehicle)])


def spins_text(vehicle: Vehicle) -> str:
    """The spins as inspect writes them."""
    return ', '.join(r['spin'] for r in vehicle['rotors'])


def flip(which: Callable[[int], bool]) -> Spoil:
    """Other spins of some rotors."""
    def change(vehicle: Vehicle) -> None:
        signals.respin(vehicle, [j for j in range(len(vehicle['rotors'])) if which(j)])
    return of_file(change)


def rotor_unit(factor: float) -> Spoil:
    """Rotor speeds in another unit."""
    return of_recording(lambda rec: put_rotors(rec, factor * rec.rotors()))


def one_rotor(which: int, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """What one rotor reads is something else."""
    def spoil(rec: Recording) -> None:
        speeds = rec.rotors()
        speeds[:, which] = change(speeds[:, which])
        put_rotors(rec, speeds)
    return of_recording(spoil)


def clipped(rec: Recording) -> None:
    """Nothing above a limit is read, which a fifth of the readings pass."""
    speeds = rec.rotors()
    put_rotors(rec, np.minimum(speeds, np.quantile(speeds, 0.8)))


def rotors_off(by: float) -> Spoil:
    """Rotor speeds are stamped by another clock."""
    def spoil(rec: Recording) -> None:
        signals.own_rotor_file(rec)['t'] += by
    return of_recording(spoil)


# ---- Poses, velocity, rates --------------------------------------------------------------------


def half_turn(of_world: bool) -> Spoil:
    """Attitudes turned by half a turn about z, of the world or of the body."""
    turn = rotation.turn(np.array(np.pi))
    def spoil(rec: Recording) -> None:
        q = rec.get(ATTITUDE)
        q = rotation.multiply(turn, q) if of_world else rotation.multiply(q, turn)
        rec.put(ATTITUDE, q)
    return of_recording(spoil)


def body_down(rec: Recording) -> None:
    """Attitudes of a body with x forward, y right, z down."""
    rec.put(ATTITUDE, rotation.multiply(rec.get(ATTITUDE), np.array([0.0, 1.0, 0.0, 0.0])))


def middle(rec: Recording) -> float:
    """A time in the middle of the recording."""
    return float(rec.t[len(rec.t) // 2])


def frozen(rec: Recording) -> None:
    """The pose and what comes with it stay for a second."""
    names = [n for n in POSITION + ATTITUDE + VELOCITY if n in rec.main]
    signals.stuck(rec, names, middle(rec), middle(rec) + 1.0)


def leaps(rec: Recording) -> None:
    """The position is 0.3 m off from the middle on."""
    signals.jump(rec, middle(rec), 1e9, np.array([0.3, -0.1, 0.1]))


def in_world(rec: Recording) -> None:
    """Body rates are written in the world frame."""
    for names in signals.each_rate(rec):
        rec.put(names, rotation.rotate(rec.get(ATTITUDE), rec.get(names)))


def rates_times(factor: float) -> Spoil:
    """Rates in another unit."""
    def spoil(rec: Recording) -> None:
        for names in signals.each_rate(rec):
            signals.scaled(rec, names, factor)
    return of_recording(spoil)


def rates_swapped(rec: Recording) -> None:
    """Rates about x and y exchanged."""
    for names in signals.each_rate(rec):
        rec.put(names, rec.get([names[1], names[0], names[2]]))


def inertial_late(rec: Recording) -> None:
    """All that the IMU measures is 40 ms late."""
    for names in [*signals.each_rate(rec), FORCE]:
        if rec.has(names):
            signals.late(rec, names, 0.04)


# ---- Stamps ------------------------------------------------------------------------------------


def each_table(rec: Recording) -> List[Dict[str, np.ndarray]]:
    """The tables of a recording."""
    return [rec.main] if rec.rotor is None else [rec.main, rec.rotor]


def milliseconds(rec: Recording) -> None:
    """Stamps in milliseconds."""
    for columns in each_table(rec):
        columns['t'] = 1e3 * columns['t']


def coarse_stamps(rec: Recording) -> None:
    """Several samples bear one stamp: that of a clock with steps of three periods."""
    step = 3.0 * float(np.median(np.diff(rec.t)))
    rec.main['t'] = np.floor(rec.t / step) * step


def holes(rec: Recording) -> None:
    """Three times half a second of poses is missing."""
    t = rec.t - rec.t[0]
    chosen = np.zeros(len(t), bool)
    for share in (0.3, 0.5, 0.7):
        chosen |= (t > share * t[-1]) & (t < share * t[-1] + 0.5)
    signals.without_rows(rec, chosen)


def arrival(rec: Recording) -> None:
    """Poses are stamped when they come, four periods' worth at once."""
    signals.own_rotor_file(rec)
    signals.bursts(rec.main, 4.0 * float(np.median(np.diff(rec.t))))


# ---- The list ----------------------------------------------------------------------------------


def says(pattern: str) -> Callable[[Vehicle], str]:
    """The same pattern for every vehicle."""
    return lambda vehicle: pattern


RPM = 30.0 / np.pi
ROTOR1 = (('rotor1',),)
HAS_V, HAS_A, HAS_W = ((VELOCITY[0],),), ((FORCE[0],),), ((RATE[0], GYRO[0]),)


def rotor_mistakes() -> List[Mistake]:
    """Those of rotor speeds."""
    def add(name: str, title: str, named: Any, spoil: Spoil) -> Mistake:
        pattern = named if callable(named) else says(named)
        return Mistake(name, 'rotors', title, pattern, spoil, ROTOR1)
    return [
        add('order_swapped', 'two columns exchanged',
            lambda v: '^rotor_order: .*order ' + order_text(swapped(v)), reordered(swapped)),
        add('order_rolled', 'every column one place on',
            lambda v: '^rotor_order: .*order ' + order_text(rolled(v)), reordered(rolled)),
        add('one_spin', 'one spin wrong', lambda v: '^rotor_spin: .*' + spins_text(v),
            flip(lambda j: j == 1)),
        add('all_spins', 'all spins wrong', lambda v: '^rotor_spin: .*' + spins_text(v),
            flip(lambda j: True)),
        add('rpm', 'rpm for rad/s', r'rotor speeds.*\brpm\b', rotor_unit(RPM)),
        add('erpm', f'eRPM of {POLE_PAIRS} pole pairs', rf'rotor speeds.*\be-?rpm\b.*\b{POLE_PAIRS}\b',
            rotor_unit(RPM * POLE_PAIRS)),
        add('hz', 'turns per second', r'rotor speeds.*(\bHz\b|turns per second)',
            rotor_unit(0.5 / np.pi)),
        add('krpm', 'thousands of rpm', r'rotor speeds.*\bkrpm\b', rotor_unit(1e-3 * RPM)),
        add('one_dead', 'one rotor reads zero', r'rotor1\b.*(\bzero|reads 0)', one_rotor(0, lambda x: 0.0 * x)),
        add('one_stuck', 'one rotor reads its mean',
            r'rotor2\b.*(stuck at one value|does not change)',
            one_rotor(1, lambda x: np.full_like(x, x.mean()))),
        add('one_scaled', 'one rotor reads 20 % too much', r'rotor3\b.*(too high|reads 1\.\d+ times)',
            one_rotor(2, lambda x: 1.2 * x)),
        add('clipped', 'readings end at a limit', r'rotor.*(clipped|limit)', of_recording(clipped)),
        add('rotors_late', 'rotor speeds 40 ms late', 'rotor speeds are ' + LATE,
            of_recording(lambda rec: signals.rotors_late(rec, 0.04))),
        add('rotor_clock', 'rotor speeds stamped by another clock',
            r'rotor speeds.*(clock|do not overlap|from \S+ to)', rotors_off(1000.0)),
    ]


def pose_mistakes() -> List[Mistake]:
    """Those of poses and what comes with them."""
    def add(name: str, title: str, named: str, spoil: Any, needs: Any = ()) -> Mistake:
        return Mistake(name, 'poses', title, says(named), spoil, needs)
    return [
        add('ned_frd', 'world NED, body FRD', r'^attitude: .*NED, FRD',
            of_recording(lambda rec: signals.world_ned(rec, True))),
        add('ned', 'world NED', r'^attitude: .*\(NED\)',
            of_recording(lambda rec: signals.world_ned(rec, False))),
        add('frd', 'body FRD', r'^attitude: .*\(FRD\)', of_recording(body_down)),
        add('conjugated', 'conjugated quaternion', r'^attitude: .*conjugated',
            of_recording(signals.conjugated)),
        add('xyzw', 'quaternion as x, y, z, w', r'^attitude: .*x, y, z, w',
            of_recording(signals.xyzw)),
        add('half_norm', 'quaternion of norm 0.5', r'not unit',
            of_recording(lambda rec: signals.scaled(rec, ATTITUDE, 0.5))),
        add('world_turned', 'attitude 180 degrees off about the world\'s z',
            r'world.*turned by 180', half_turn(True)),
        add('body_turned', 'attitude 180 degrees off about the body\'s z',
            r'(body|sensor).*turned by 180', half_turn(False)),
        add('position_mm', 'position in mm', r'position.*(\bmm\b|millimet)',
            of_recording(lambda rec: signals.scaled(rec, POSITION, 1e3))),
        add('frozen_pose', 'pose stays for 1 s', r'^frozen_pose', of_recording(frozen)),
        add('pose_jump', 'position leaps by 0.33 m', r'(pose|position).*(jump|leap)s?\b',
            of_recording(leaps)),
        add('velocity_body', 'velocity in the body frame', r'^velocity: .*body frame',
            of_recording(signals.velocity_of_body), HAS_V),
        add('velocity_ned', 'velocity with y right, z down', r'^velocity: .*axes x, -y, -z',
            of_recording(lambda rec: signals.scaled(rec, VELOCITY[1:], -1.0)), HAS_V),
        add('velocity_kmh', 'velocity in km/h', r'^velocity: .*(3\.6|km/h)',
            of_recording(lambda rec: signals.scaled(rec, VELOCITY, 3.6)), HAS_V),
        add('velocity_late', 'velocity 50 ms late', r'velocity is stamped (4\d|5\d|6\d)(\.\d)? ms late',
            of_recording(lambda rec: signals.late(rec, VELOCITY, 0.05)), HAS_V),
    ]


def imu_mistakes() -> List[Mistake]:
    """Those of rates and accelerometer."""
    def add(name: str, title: str, named: str, spoil: Any, needs: Any) -> Mistake:
        return Mistake(name, 'rates and IMU', title, says(named), spoil, needs)
    return [
        add('rates_world', 'rates in the world frame', RATES + ': .*world frame',
            of_recording(in_world), HAS_W),
        add('rates_degrees', 'rates in deg/s', r'(body[_ ]rates|gyro)\b.*(degrees|deg/s)',
            rates_times(180.0 / np.pi), HAS_W),
        add('rates_swapped', 'rates about x and y exchanged', RATES + ': .*axes y, x, z',
            of_recording(rates_swapped), HAS_W),
        add('imu_late', 'rates and accelerometer 40 ms late',
            '(gyro is|accelerometer is|body rates are) ' + LATE, of_recording(inertial_late), HAS_W),
        add('force_g', 'accelerometer in g', r'^accelerometer: .*\bin g\b',
            of_recording(lambda rec: signals.scaled(rec, FORCE, 1.0 / 9.80665)), HAS_A),
        add('force_world', 'accelerometer in the world frame', r'^accelerometer: .*world frame',
            of_recording(signals.force_in_world), HAS_A),
        add('force_without_gravity', 'accelerometer without gravity',
            r'^accelerometer: .*without gravity', of_recording(signals.force_without_gravity), HAS_A),
        add('force_sign', 'accelerometer of the other sign', r'^accelerometer: .*axes -x, -y, -z',
            of_recording(lambda rec: signals.scaled(rec, FORCE, -1.0)), HAS_A),
    ]


def file_mistakes() -> List[Mistake]:
    """Those of the vehicle file."""
    def add(name: str, title: str, named: str, change: Callable[[Vehicle], None]) -> Mistake:
        return Mistake(name, 'vehicle file', title, says(named), of_file(change), ROTOR1)
    def mass(factor: float) -> Callable[[Vehicle], None]:
        return lambda v: v.update(mass_kg=factor * v['mass_kg'])
    def k_f(factor: float) -> Callable[[Vehicle], None]:
        return lambda v: signals.scale_parameter(v, 'thrust.k_f', factor)
    return [
        add('mass_high', 'mass 20 % too high', r'^weight: .*mass_kg', mass(1.2)),
        add('mass_low', 'mass 20 % too low', r'^weight: .*mass_kg', mass(0.8)),
        add('k_f_third', 'k_f a third', r'^weight: .*thrust\.k_f', k_f(1.0 / 3.0)),
        add('k_f_triple', 'k_f three times', r'^weight: .*thrust\.k_f', k_f(3.0)),
        add('inertia_g_cm2', 'inertia in g cm^2', r'inertia.*g cm',
            lambda v: signals.scale_inertia(v, 1e7)),
        add('arms_mm', 'rotor positions in mm', r'position.*(\bmm\b|millimet)',
            lambda v: signals.scale_arms(v, 1e3)),
        add('arms_ten', 'rotor positions ten times', r'(position|arm).*\b10 times',
            lambda v: signals.scale_arms(v, 10.0)),
    ]


def stamp_mistakes() -> List[Mistake]:
    """Those of stamps, and of the battery."""
    def add(name: str, title: str, named: str, spoil: Callable[[Recording], None],
            needs: Any = ()) -> Mistake:
        return Mistake(name, 'stamps', title, says(named), of_recording(spoil), needs)
    return [
        add('stamps_ms', 'stamps in ms', r'column t\b.*second', milliseconds),
        add('stamps_repeat', 'several samples with one stamp', r'repeat|same stamp|one stamp',
            coarse_stamps),
        add('holes', 'three times half a second missing', r'^(gaps|holes): |missing.*0\.5', holes),
        add('arrival', 'poses stamped in bursts of four', r'^pose_jitter: ', arrival),
        add('battery_mv', 'battery in mV', r'batter.*(\bmV\b|millivolt)',
            lambda rec: signals.scaled(rec, ('vbat',), 1e3), (('vbat',),)),
    ]


def everything() -> List[Mistake]:
    """All mistakes."""
    return (rotor_mistakes() + pose_mistakes() + imu_mistakes() + file_mistakes()
            + stamp_mistakes())
