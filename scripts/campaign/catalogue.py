"""The classes of faults: which cases each makes of a base flight, what names its cause, and what is
right. Variants rotate with the base flight where a class has more than a campaign needs."""

import re
import zlib
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Optional, Tuple

import numpy as np

from . import scenes, signals
from .bases import Base
from .recording import ATTITUDE, FORCE, VELOCITY, Recording

Span = Tuple[float, float]


@dataclass
class Spoiled:
    """What a case runs calibrate on; the span is when the fault acts [s after the first pose]."""
    rec: Recording
    vehicle: Dict[str, Any]
    span: Optional[Span] = None


Make = Callable[[Base, np.random.Generator], Spoiled]


@dataclass
class Fault:
    """A class. `checks` and `words` (a pattern) in a finding, a new warning or the error name its
    cause. `right` says what counts as right where that isn't obvious. k_f and drag
    must be `scale` times the unspoiled ones; parameters of `also` must not change either."""
    name: str
    title: str
    checks: Tuple[str, ...]
    words: str
    right: str = ''
    also: Tuple[str, ...] = ()
    variants: List[Tuple[str, Make, float]] = field(default_factory=list)
    needs: Callable[[Base], bool] = lambda base: True
    per_base: int = 0  # variants of a base flight; 0: all

    def add(self, variant: str, make: Make, scale: float = 1.0) -> None:
        """One more variant."""
        self.variants.append((variant, make, scale))


@dataclass
class Case:
    """One faulty recording."""
    name: str
    fault: Fault
    base: str
    make: Make
    scale: float

    def spoil(self, base: Base, seed: int) -> Spoiled:
        """Makes it; the same for the same seed."""
        return self.make(base, np.random.default_rng([seed, zlib.crc32(self.name.encode())]))


def has_velocity(base: Base) -> bool:
    """The recording has velocities."""
    return base.rec.has(VELOCITY)


def has_rates(base: Base) -> bool:
    """The recording has angular rates."""
    return bool(signals.each_rate(base.rec))


def has_force(base: Base) -> bool:
    """The recording has an accelerometer."""
    return base.rec.has(FORCE)


def scene(make: Callable[..., scenes.Scene], *arguments: Any) -> Make:
    """A scene as a case."""
    def made(base: Base, rng: np.random.Generator) -> Spoiled:
        shown = make(base, *arguments, rng)
        return Spoiled(shown.rec, base.vehicle, shown.span)
    return made


def change(do: Callable[[Recording, np.random.Generator], Optional[Span]]) -> Make:
    """A change of a copy of the recording as a case."""
    def made(base: Base, rng: np.random.Generator) -> Spoiled:
        rec = base.rec.copy()
        span = do(rec, rng)
        return Spoiled(rec, base.vehicle, span)
    return made


def text(fault: signals.TextFault) -> Make:
    """A fault of the file's text as a case."""
    def do(rec: Recording, _: np.random.Generator) -> None:
        rec.text_fault = fault
    return change(do)


def file(do: Callable[[Dict[str, Any]], None]) -> Make:
    """A wrong vehicle file as a case."""
    def made(base: Base, _: np.random.Generator) -> Spoiled:
        vehicle = base.vehicle_copy()
        do(vehicle)
        return Spoiled(base.rec, vehicle)
    return made


GROUND = ('contact',)
GROUND_WORDS = r'on the ground|standing|stood|landed|landing|touch|idl(?:e|ing)|ground phase'


def ground_faults() -> List[Fault]:
    """Before, after and between."""
    after = Fault('stand_after', 'standing with rotors turning, after a flight', GROUND,
                  GROUND_WORDS, per_base=6)
    before = Fault('stand_before', 'the same before a flight', GROUND, GROUND_WORDS, per_base=6)
    grid = [(level, s) for s in (0.5, 1.0, 3.0, 10.0)
            for level in (0.38, 0.45, 0.5, 0.6, 0.75, 0.85, 0.95)]
    for level, s in grid:
        after.add(f'{level:g}_for_{s:g}s', scene(scenes.stand_after, level, s))
        before.add(f'{level:g}_for_{s:g}s', scene(scenes.stand_before, level, s, False))
        before.add(f'spooled_{level:g}_for_{s:g}s', scene(scenes.stand_before, level, s, True))
    landing = Fault('landing', 'landing, then standing', GROUND, GROUND_WORDS, per_base=5)
    for then in ('half_idle', 'idle', 'off', 'half_off'):
        for ramp_s in (0.1, 0.3, 0.6, 1.0):
            landing.add(f'{then}_in_{ramp_s:g}s', scene(scenes.landing, ramp_s, then))
    spool = Fault('spool_up', 'spool-up before take-off', GROUND, GROUND_WORDS, per_base=2)
    for ramp_s in (0.5, 1.5, 4.0):
        spool.add(f'{ramp_s:g}s', scene(scenes.spool_up, ramp_s))
    parked = Fault('parked', 'parked for a minute, rotors turning', GROUND, GROUND_WORDS,
                   per_base=1)
    for level in (0.1, 0.3, 0.45):
        for is_after in (False, True):
            parked.add(f'{level:g}_{"after" if is_after else "before"}',
                       scene(scenes.parked, level, is_after))
    go = Fault('touch_and_go', 'touch and go', GROUND, GROUND_WORDS, per_base=2)
    for level, s in ((0.5, 0.5), (0.7, 0.5), (0.6, 1.5), (0.85, 1.0), (0.3, 2.0)):
        go.add(f'{level:g}_for_{s:g}s', scene(scenes.touch_and_go, level, s))
    return [after, before, landing, spool, parked, go]


def hand_faults() -> List[Fault]:
    """In the hand, thrown."""
    hand = ('contact',)
    words = r'\bhand\b|carried|\bheld\b|contact'
    carried = Fault('carried', 'carried by hand', hand, words, per_base=4)
    for level in (0.0, 0.08, 0.2, 0.4):
        for s in (5.0, 12.0):
            carried.add(f'after_{level:g}_for_{s:g}s', scene(scenes.carried_after, level, s))
            carried.add(f'before_{level:g}_for_{s:g}s', scene(scenes.carried_before, level, s))
    start = Fault('hand_start', 'hand-held start', hand, words, per_base=2)
    for level, s in ((0.3, 2.0), (0.5, 1.0), (0.6, 3.0), (0.8, 1.0), (0.9, 2.0)):
        start.add(f'{level:g}_for_{s:g}s', scene(scenes.hand_start, level, s))
    throw = Fault('thrown', 'thrown start', hand, words + '|thr[eo]wn?|fall',
                  per_base=2)
    for speed in (2.5, 3.5, 4.5):
        throw.add(f'{speed:g}m_s', scene(scenes.thrown, speed))
    return [carried, start, throw]


def contact_faults() -> List[Fault]:
    """Crash, fall, bounce, collision."""
    checks = GROUND + ('crash',)
    words = GROUND_WORDS + r'|crash|impact|contact|upside|\bfell\b|fall|collision|\bhit\b|tumbl'
    crash = Fault('crash', 'crash', checks, words)
    crash.add('ground', scene(scenes.crash_ground))
    crash.add('wall', scene(scenes.crash_wall, 2.0))
    motors = Fault('motor_stop', 'motor stop in flight, then fall', checks + ('rotor_scale',),
                   words)
    motors.add('all', scene(scenes.motor_stop, 'all'))
    motors.add('one', scene(scenes.motor_stop, 'one'))
    bounce = Fault('bounce', 'bounce', checks, words, per_base=1)
    bounce.add('soft', scene(scenes.bounce, 0.7, 0.5))
    bounce.add('hard', scene(scenes.bounce, 1.3, 0.3))
    down = Fault('upside_down', 'upside down on the ground, rotors turning', checks, words,
                 per_base=2)
    for level, s in ((0.1, 5.0), (0.4, 2.0), (0.7, 1.0)):
        down.add(f'{level:g}_for_{s:g}s', scene(scenes.upside_down, level, s))
    collision = Fault('collision', 'hit by something in flight', checks, words, per_base=1)
    collision.add('1g', scene(scenes.shoved, 1.0))
    collision.add('3g', scene(scenes.shoved, 3.0))
    wall = Fault('wall', 'leaning against a wall in flight', checks, words, per_base=1)
    wall.add('5deg', scene(scenes.leaning, 0.09, 2.0))
    wall.add('12deg', scene(scenes.leaning, 0.21, 3.0))
    return [crash, motors, bounce, down, collision, wall]


def zero_for(count: int, duration: float) -> Make:
    """`count` rotors read 0 for a time."""
    def do(rec: Recording, rng: np.random.Generator) -> Span:
        chosen = signals.window(rec, duration, rng)
        which = rng.permutation(len(rec.rotor_names))[:count or None]
        signals.rotors_zero(rec, which, chosen)
        t = rec.rotor_columns['t'][chosen]
        return float(t[0]), float(t[-1])
    return change(do)


def frozen_for(share: float) -> Make:
    """A rotor's reading stays for a share of the flight."""
    def do(rec: Recording, rng: np.random.Generator) -> Span:
        span = 0.9 * rec.t[-1] * (1.0 - share), 0.9 * rec.t[-1]
        signals.rotor_frozen(rec, int(rng.integers(len(rec.rotor_names))), *span)
        return span
    return change(do)


def rotor_faults() -> List[Fault]:
    """Readings of rotor speeds."""
    words = r'rotor.*(?:zero|reads? 0|dead|stuck|frozen|missing|drop|silent|sensor)'
    everything = Fault('rotors_zero', 'all rotors read 0 for a while',
                       ('rotor_scale',), words, per_base=4)
    for s in (0.1, 0.3, 1.0, 2.0, 3.0):
        everything.add(f'{s:g}s', zero_for(0, s))
    one = Fault('rotor_zero', 'one rotor reads 0', ('rotor_scale',), words,
                per_base=2)
    for s in (0.2, 2.0, 1e6):
        one.add(f'{s:g}s' if s < 1e5 else 'always', zero_for(1, s))
    scale = Fault('rotor_scale', 'one sensor high or low',
                  ('rotor_scale', 'weight'), r'rotor \d.*(?:high|low|much|little|scale|%)',
                  per_base=3)
    for percent in (-20, -10, -5, 5, 10, 20):
        scale.add(f'{percent:+d}%', change(lambda rec, rng, f=1.0 + percent / 100.0:
                                          signals.rotor_scale(rec, int(rng.integers(4)), f)))
    stuck = Fault('rotor_frozen', 'frozen rotor reading', ('rotor_scale',), words, per_base=1)
    stuck.add('10%', frozen_for(0.1))
    stuck.add('50%', frozen_for(0.5))
    drop = Fault('rotor_dropouts', 'single rotor readings drop out',
                 ('rotor_scale',), words + '|not finite|leap|beyond',
                 per_base=2)
    for share, value in ((0.01, 0.0), (0.1, 0.0), (0.05, np.nan)):
        drop.add(f'{100 * share:g}%_{value:g}', change(
            lambda rec, rng, s=share, v=value: signals.rotor_dropouts(rec, s, v, rng)))
    return [everything, one, scale, stuck, drop]


def odometry_faults() -> List[Fault]:
    """Velocity, attitude, rates."""
    velocity = ('velocity_offset', 'velocity')
    words = r'velocit'
    late = Fault('velocity_late', 'velocity late', velocity, words, needs=has_velocity, per_base=3)
    for ms in (-50, 20, 50, 100):
        late.add(f'{ms}ms', change(
            lambda rec, rng, s=ms / 1000.0: signals.late(rec, VELOCITY, s)))
    scale = Fault('velocity_scale', 'velocity scaled', velocity, words, needs=has_velocity,
                  per_base=2)
    for factor in (0.8, 0.9, 1.1):
        scale.add(f'{factor:g}', change(
            lambda rec, rng, f=factor: signals.scaled(rec, VELOCITY, f)))
    frame = Fault('velocity_frame', 'velocity of another frame or point', velocity, words,
                  needs=has_velocity, per_base=2)
    frame.add('body', change(lambda rec, rng: signals.velocity_of_body(rec)))
    frame.add('ned', change(lambda rec, rng: signals.scaled(rec, ('vy', 'vz'), -1.0)))
    frame.add('point_0.3m', change(lambda rec, rng: signals.velocity_of_point(
        rec, np.array([0.3, 0.0, 0.1])) if has_rate(rec) else None))
    stuck = Fault('velocity_stuck', 'velocity zero or stuck', velocity, words, needs=has_velocity,
                  per_base=2)
    stuck.add('vx=0', change(lambda rec, rng: signals.scaled(rec, ('vx',), 0.0)))
    stuck.add('vz=0', change(lambda rec, rng: signals.scaled(rec, ('vz',), 0.0)))
    stuck.add('stuck_2s', change(lambda rec, rng: signals.stuck(
        rec, VELOCITY, 0.5 * rec.t[-1], 0.5 * rec.t[-1] + 2.0)))
    return [late, scale, frame, stuck] + attitude_faults()


def has_rate(rec: Recording) -> bool:
    """The recording has rates."""
    return bool(signals.each_rate(rec))


def attitude_faults() -> List[Fault]:
    """Attitude against rates and rotors."""
    checks = ('attitude', 'velocity', 'gravity_lean')
    words = r'attitude|quaternion|xyzw|conjugat'
    convention = Fault('attitude_convention', 'attitude conjugated or xyzw', checks, words)
    convention.add('conjugated', change(lambda rec, rng: signals.conjugated(rec)))
    convention.add('xyzw', change(lambda rec, rng: signals.xyzw(rec)))
    lean = Fault('body_leans', 'attitude of a leaning body frame', checks, words + r'|lean|tilt',
                 right='gravity, centre of gravity and mounts may take it up; k_f and drag count')
    for degrees in (3.0, 8.0):
        lean.add(f'{degrees:g}deg', change(lambda rec, rng, a=np.radians(degrees):
                                           signals.body_leans(rec, a, rng.uniform(0.0, 6.28))))
    late = Fault('attitude_late', 'attitude late', checks + ('body_rates_offset', 'gyro_offset', 'accelerometer_offset'),
                 words + r'|pose.*\b(?:late|ms)\b', per_base=1)
    for ms in (20, 60):
        late.add(f'{ms}ms', change(lambda rec, rng, s=ms / 1000.0:
                                   signals.late(rec, ATTITUDE, s)))
    rates = Fault('rates', 'rates of another sign, frame or unit',
                  ('attitude', 'body_rates_offset', 'gyro_offset', 'accelerometer_offset'),
                  words + r'|\brates?\b|gyro|deg/s|beyond', needs=has_rates, per_base=2)
    rates.add('sign_x', change(lambda rec, rng: [signals.scaled(rec, n[:1], -1.0)
                                                 for n in signals.each_rate(rec)] and None))
    rates.add('swapped_xy', change(lambda rec, rng: swap_rates(rec)))
    rates.add('deg_s', change(lambda rec, rng: [signals.scaled(rec, n, 57.29578)
                                                for n in signals.each_rate(rec)] and None))
    return [convention, lean, late, rates]


def swap_rates(rec: Recording) -> None:
    """x and y of the rates change places."""
    for names in signals.each_rate(rec):
        rec.put(names, rec.get((names[1], names[0], names[2])))


def time_faults() -> List[Fault]:
    """Streams against each other, stamps."""
    late = Fault('rotors_late', 'rotor speeds late or early', ('rotor_speeds_offset',),
                 r'rotor.*\b(?:ms|late|early)\b', per_base=4)
    for ms in (-100, -50, -20, 10, 20, 50, 100):
        late.add(f'{ms}ms', change(lambda rec, rng, s=ms / 1000.0: signals.rotors_late(rec, s)))
    checks = ('rotor_jitter', 'rotor_speeds_offset', 'velocity_offset', 'gyro_offset', 'accelerometer_offset', 'body_rates_offset')
    words = r'stamp|jitter|burst|arriv'
    jitter = Fault('jitter', 'stamps that jitter', checks, words, per_base=2)
    for ms in (2, 5, 10):
        jitter.add(f'rotors_{ms}ms', change(lambda rec, rng, s=ms / 1000.0: signals.jitter(
            signals.own_rotor_file(rec), s, rng)))
        jitter.add(f'poses_{ms}ms', change(lambda rec, rng, s=ms / 1000.0: jitter_poses(
            rec, s, rng)))
    burst = Fault('bursts', 'stamps of arrival, in bursts', checks, words)
    burst.add('rotors_40ms', change(lambda rec, rng: signals.bursts(
        signals.own_rotor_file(rec), 0.04)))
    imu = Fault('imu_late', 'IMU late', ('gyro_offset', 'accelerometer_offset', 'body_rates_offset', 'attitude'),
                r'(?:IMU|rates|gyro).*\b(?:ms|late)\b', needs=has_rates, per_base=1)
    for ms in (20, 60):
        imu.add(f'{ms}ms', change(lambda rec, rng, s=ms / 1000.0: imu_late(rec, s)))
    return [late, jitter, burst, imu]


def jitter_poses(rec: Recording, size: float, rng: np.random.Generator) -> None:
    """Poses jitter; rotor speeds keep their stamps."""
    signals.own_rotor_file(rec)
    signals.jitter(rec.main, size, rng)


def imu_late(rec: Recording, by: float) -> None:
    """Rates, gyro and accelerometer late."""
    for names in signals.each_rate(rec) + ([FORCE] if rec.has(FORCE) else []):
        signals.late(rec, names, by)


def frame_faults() -> List[Fault]:
    """Accelerometer, gravity, world."""
    force = Fault('accelerometer', 'accelerometer in g, of another frame, without gravity',
                  ('accelerometer',), r'accelerom|specific force|in g\b',
                  needs=has_force)
    force.add('in_g', change(lambda rec, rng: signals.scaled(rec, FORCE, 1.0 / 9.81)))
    force.add('world', change(lambda rec, rng: signals.force_in_world(rec)))
    force.add('no_gravity', change(lambda rec, rng: signals.force_without_gravity(rec)))
    force.add('sign', change(lambda rec, rng: signals.scaled(rec, FORCE, -1.0)))
    lean = Fault('gravity_leans', 'gravity leans in the world frame', ('gravity_lean',),
                 r'gravity|level|lean', right='the estimate of gravity may take it up', per_base=2)
    for degrees in (2.0, 5.0, 10.0):
        lean.add(f'{degrees:g}deg', change(lambda rec, rng, a=np.radians(degrees): lean_world(
            rec, a, rng)))
    world = Fault('world_ned', 'world north, east, down', ('gravity_lean',),
                  r'\bNED\b|\bdown\b|upside|z up|gravity|FRD', per_base=1)
    world.add('world', change(lambda rec, rng: signals.world_ned(rec, False)))
    world.add('world_and_body', change(lambda rec, rng: signals.world_ned(rec, True)))
    return [force, lean, world]


def lean_world(rec: Recording, angle: float, rng: np.random.Generator) -> None:
    """The world leans by an angle towards a random side."""
    side = rng.uniform(0.0, 2.0 * np.pi)
    signals.turn_world(rec, signals.rotation.exp(angle * np.array([np.cos(side), np.sin(side), 0])))


TORQUE = ('inertia.x', 'inertia.y', 'inertia.z', 'centre_of_gravity.x', 'centre_of_gravity.y')


def vehicle_faults() -> List[Fault]:
    """Wrong vehicle files."""
    order = Fault('rotor_order', 'wrong rotor order', ('rotor_order',), r'order|positions',
                  right='k_f does not depend on the order: inertia and centre of gravity must '
                        'be right, too, or not observable', also=TORQUE, per_base=3)
    for o in ((1, 0, 2, 3), (3, 0, 1, 2), (2, 3, 0, 1), (0, 2, 1, 3), (3, 2, 1, 0), (1, 2, 0, 3)):
        order.add(''.join(str(i + 1) for i in o), file(lambda v, o=o: signals.reorder(v, o)))
    spin = Fault('rotor_spin', 'wrong spins', ('rotor_spin', 'rotor_order'), r'spin',
                 right='as for the order', also=TORQUE, per_base=2)
    for s in ((0, 1, 2, 3), (0,), (1, 2), (2, 3)):
        spin.add('flip_' + ''.join(str(i + 1) for i in s),
                 file(lambda v, s=s: signals.respin(v, s)))
    arm = Fault('arm', 'wrong rotor positions', ('inertia', 'inertia_bounds', 'vehicle_units', 'rotor_order'),
                r'inertia|arm|position|geometr',
                right='arm and inertia cannot be told apart: only k_f and drag count', per_base=2)
    for factor in (0.5, 2.0, 1000.0):
        arm.add(f'{factor:g}', file(lambda v, f=factor: signals.scale_arms(v, f)))
    return [order, spin, arm] + scale_faults()


def scale_faults() -> List[Fault]:
    """Mass, k_f, inertia, gravity."""
    mass = Fault('mass', 'wrong mass', ('weight',),
                 r'mass|k_f|prior|for [\d.]+ kg',
                 right='mass sets the scale of force: k_f and drag times the factor are right',
                 per_base=2)
    for factor in (1.2, 0.5, 1000.0):
        mass.add(f'{factor:g}', file(lambda v, f=factor: v.update(
            mass_kg=f * float(v['mass_kg']))), factor)
    k_f = Fault('k_f', 'wrong start of k_f', ('weight',), r'mass|k_f|prior',
                right='the estimate corrects it', per_base=2)
    for factor in (0.5, 2.0, 10.0, 1e-3):
        k_f.add(f'{factor:g}', file(lambda v, f=factor: signals.scale_parameter(
            v, 'thrust.k_f', f)))
    inertia = Fault('inertia', 'wrong nominal inertia', ('inertia', 'inertia_bounds'), r'inertia',
                    right='named, or the estimate corrects it (inertia within 3 sigma, too, '
                          'where observable)', also=TORQUE[:3], per_base=2)
    for factor in (0.1, 10.0, 1000.0):
        inertia.add(f'{factor:g}', file(lambda v, f=factor: signals.scale_inertia(v, f)))
    gravity = Fault('gravity', 'wrong gravity', ('gravity', 'weight', 'gravity_lean'),
                    r'gravity|mass|k_f')
    for g in (1.0, -9.81):
        gravity.add(f'{g:g}', file(lambda v, g=g: v.update(gravity_m_s2=g)))
    return [mass, k_f, inertia, gravity]


def row_faults() -> List[Fault]:
    """Rows of the file."""
    words = r'row|line|gap|repeat|order|step|jump|finite|number|cut|truncat|cell|column|stamp|leap'
    gaps = Fault('gaps', 'gaps', (), words, per_base=1)
    for count, s in ((5, 0.1), (2, 1.0)):
        gaps.add(f'{count}x{s:g}s', change(lambda rec, rng, c=count, s=s: signals.without_rows(
            rec, signals.in_gaps(rec.t, c, s, rng))))
    rows = Fault('rows', 'rows twice, shuffled, cut, not numbers', (), words, per_base=4)
    rows.add('twice_20%', text(signals.duplicated(0.2)))
    rows.add('shuffled_4', text(signals.shuffled(4)))
    rows.add('shuffled_all', text(signals.shuffled(0)))
    rows.add('cut_60%', text(signals.truncated(0.6)))
    rows.add('nan_2%', text(signals.not_numbers(0.02, 'nan')))
    rows.add('words_0.1%', text(signals.not_numbers(0.001, 'error')))
    mocap = Fault('mocap', 'poses stay or jump', (), words + r'|pose|odometry', per_base=3)
    mocap.add('stay_0.5s', change(lambda rec, rng: signals.stuck(
        rec, [n for n in signals.POSITION + ATTITUDE + VELOCITY if n in rec.main],
        0.5 * rec.t[-1], 0.5 * rec.t[-1] + 0.5)))
    mocap.add('jump_0.3m', change(lambda rec, rng: signals.jump(
        rec, 0.6 * rec.t[-1], 1e9, rng.uniform(-0.3, 0.3, 3))))
    mocap.add('jump_0.1s', change(lambda rec, rng: signals.jump(
        rec, 0.5 * rec.t[-1], 0.5 * rec.t[-1] + 0.1, rng.uniform(-1.0, 1.0, 3))))
    mocap.add('yaw_20deg', change(lambda rec, rng: signals.yaw_jump(rec, 0.5 * rec.t[-1], 0.35)))
    return [gaps, rows, mocap]


def controls() -> List[Fault]:
    """Nothing wrong: what the method itself costs."""
    more = Fault('control', 'control: more flight, nothing wrong', (), r'(?!)')
    for where in ('after', 'before', 'amid', 'low'):
        more.add(where, scene(scenes.more_flight, where))
    return [more]


def faults() -> List[Fault]:
    """All classes."""
    made = (controls() + ground_faults() + hand_faults() + contact_faults() + rotor_faults()
            + odometry_faults() + time_faults() + frame_faults() + vehicle_faults() + row_faults())
    for fault in made:
        re.compile(fault.words)
    return made


def cases(names: List[str], bases: Dict[str, Base], everything: bool = False) -> List[Case]:
    """The cases of some base flights, by class; with `everything` also the variants a campaign
    leaves to other flights. `names` are all base flights: a flight's variants don't depend on which
    others are loaded."""
    made = []
    for fault in faults():
        for index, name in enumerate(names):
            if name not in bases or not fault.needs(bases[name]):
                continue
            for variant, make, scale in fault.variants if everything else chosen(fault, index):
                made.append(Case(f'{fault.name}/{variant}@{name}', fault, name, make, scale))
    return made


def chosen(fault: Fault, index: int) -> List[Tuple[str, Make, float]]:
    """The variants of a class for one base flight: all, or so many, evenly spread and shifted."""
    count, total = fault.per_base, len(fault.variants)
    if count == 0 or count >= total:
        return fault.variants
    picks = sorted({(int(k * total / count) + 5 * index) % total for k in range(count)})
    return [fault.variants[k] for k in picks]
