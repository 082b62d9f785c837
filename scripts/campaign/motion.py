"""Motion that a vehicle can have: pieces of flight along polynomials, of standing, and of being
carried, each with the specific force and the rotor speeds that belong to it."""

from dataclasses import dataclass
from typing import Callable, List, Optional, Tuple

import numpy as np

from . import rotation
from .airframe import G, UP, Airframe

DT = 0.002
MAX_ACCELERATION = 5.0  # of added flight [m/s^2]
MAX_TILT = 0.6  # [rad]


@dataclass
class State:
    """Where a piece begins or ends: position and its derivatives in the world, heading and rate."""
    p: np.ndarray
    v: np.ndarray
    a: np.ndarray
    j: np.ndarray
    heading: float = 0.0
    heading_rate: float = 0.0


def at_rest(p: np.ndarray, heading: float, v_z: float = 0.0) -> State:
    """Hovering, or moving up or down evenly."""
    return State(np.array(p, float), np.array([0.0, 0.0, v_z]), np.zeros(3), np.zeros(3), heading)


@dataclass
class Motion:
    """Rows every DT: p, v of the body's origin (world), q_WB, specific force at the origin (body)
    and squared rotor speeds."""
    p: np.ndarray
    v: np.ndarray
    q: np.ndarray
    force: np.ndarray
    squares: np.ndarray

    @property
    def duration(self) -> float:
        """Length [s]; one row stands for DT."""
        return len(self.p) * DT

    @property
    def t(self) -> np.ndarray:
        """Time of each row, the first DT after what was before [s]."""
        return DT * (1.0 + np.arange(len(self.p)))

    @property
    def rates(self) -> np.ndarray:
        """Body rates [rad/s]."""
        return rotation.rates(self.q, DT)

    def then(self, *others: 'Motion') -> 'Motion':
        """This and others one after the other."""
        parts = (self,) + others
        return Motion(*[np.concatenate([getattr(m, n) for m in parts])
                        for n in ('p', 'v', 'q', 'force', 'squares')])

    def end(self) -> State:
        """The last row as a resting state."""
        return at_rest(self.p[-1], float(rotation.heading(self.q[-1])))


def times(duration: float) -> np.ndarray:
    """DT, 2 DT, ... up to a duration."""
    return DT * (1.0 + np.arange(max(int(round(duration / DT)), 2)))


def polynomial(begin: List[np.ndarray], end: List[np.ndarray], T: float) -> np.ndarray:
    """Coefficients, lowest first, of the polynomial with these derivatives (0th, 1st, ...) at 0
    and at T; one column per axis."""
    n = len(begin) + len(end)
    rows = [derivative_row(0.0, n, k) for k in range(len(begin))]
    rows += [derivative_row(T, n, k) for k in range(len(end))]
    return np.linalg.solve(np.array(rows), np.array(begin + end, float))


def derivative_row(t: float, n: int, k: int) -> np.ndarray:
    """k-th derivative of 1, t, t^2, ... at t."""
    row = np.zeros(n)
    for i in range(k, n):
        row[i] = np.prod(np.arange(i - k + 1, i + 1)) * t ** (i - k)
    return row


def values(coefficients: np.ndarray, t: np.ndarray, k: int = 0) -> np.ndarray:
    """k-th derivative of a polynomial, one column per axis."""
    for _ in range(k):
        coefficients = coefficients[1:] * np.arange(1, len(coefficients))[:, None]
    return np.vander(t, len(coefficients), increasing=True) @ coefficients


def fly(frame: Airframe, p: np.ndarray, v: np.ndarray, a: np.ndarray,
        heading: np.ndarray) -> Motion:
    """Attitude, force and rotor speeds of a flight along p by the vehicle's own coefficients."""
    q = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(p), 4))
    for _ in range(4):  # drag depends on the attitude
        air = rotation.rotate(q, frame.air_force(rotation.rotate(rotation.inverse(q), v)))
        wanted = frame.mass * (a + G) - air
        up = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
        q = rotation.multiply(rotation.from_up(up), rotation.turn(heading))
    thrust = np.sum(wanted * rotation.rotate(q, UP), axis=1)
    w = rotation.rates(q, DT)
    torque = np.gradient(w, DT, axis=0) * frame.inertia + np.cross(w, w * frame.inertia) - frame.damping * w
    force = rotation.rotate(rotation.inverse(q), a + G)
    return Motion(p, v, q, force, frame.squares(thrust, torque))


def effort(motion: Motion, a: np.ndarray, T: float) -> float:
    """What a piece of flight asks for: acceleration and tilt over what an ordinary pilot likes, how
    far rotors go down, and time."""
    tilt = np.arccos(np.clip(rotation.rotate(motion.q, UP)[:, 2], -1.0, 1.0)).max()
    acceleration = np.linalg.norm(a, axis=1).max()
    asked = float(max(acceleration / MAX_ACCELERATION, tilt / MAX_TILT, 1.0)
                  + (5.0 if motion.squares.min() <= 0.0 else 0.0) + T / 8.0)
    return asked if np.isfinite(asked) else np.inf


def turn_to(begin: State, end_heading: Optional[float], T: float, t: np.ndarray) -> np.ndarray:
    """Heading from a state's to a given one, the short way round."""
    end = begin.heading + 0.3 * begin.heading_rate * T
    if end_heading is not None:
        end = begin.heading + (end_heading - begin.heading + np.pi) % (2.0 * np.pi) - np.pi
    c = polynomial([np.array([begin.heading]), np.array([begin.heading_rate]), np.zeros(1)],
                   [np.array([end]), np.zeros(1), np.zeros(1)], T)
    return values(c, t)[:, 0]


def go(frame: Airframe, begin: State, end: State, pace: float = 1.5) -> Motion:
    """Flies from one state to another, all derivatives up to jerk continuous, at a mean speed of at
    most `pace` [m/s]."""
    T = max(0.8, np.linalg.norm(end.p - begin.p) / pace,
            np.linalg.norm(end.v - begin.v) / 3.0)
    return easiest([gone(frame, begin, end, T * f) for f in (1.0, 1.25, 1.6, 2.0, 2.5)])


def gone(frame: Airframe, begin: State, end: State, T: float) -> Tuple[float, Motion]:
    """go() in a given time, with its effort."""
    c = polynomial([begin.p, begin.v, begin.a, begin.j], [end.p, end.v, end.a, end.j], T)
    t = times(T)
    a = values(c, t, 2)
    made = fly(frame, values(c, t), values(c, t, 1), a, turn_to(begin, end.heading, T, t))
    return effort(made, a, T), made


def stop(frame: Airframe, begin: State) -> Motion:
    """Brakes to hover, wherever that is."""
    T = max(0.7, np.linalg.norm(begin.v) / 6.0)
    return easiest([stopped(frame, begin, T * f) for f in (1.0, 1.25, 1.6, 2.0, 2.5, 3.2)])


def stopped(frame: Airframe, begin: State, T: float) -> Tuple[float, Motion]:
    """stop() in a given time, with its effort."""
    c = polynomial([begin.v, begin.a, begin.j], [np.zeros(3)] * 3, T)
    t = times(T)
    whole = np.concatenate([np.zeros((1, 3)), c / (1.0 + np.arange(len(c)))[:, None]])
    a = values(c, t, 1)
    made = fly(frame, begin.p + values(whole, t), values(c, t), a, turn_to(begin, None, T, t))
    return effort(made, a, T), made


def easiest(tried: List[Tuple[float, Motion]]) -> Motion:
    """The piece of least effort."""
    return min(tried, key=lambda pair: pair[0])[1]


def start(frame: Airframe, end: State) -> Motion:
    """From hover, wherever that is, to a state: `stop` run backwards in time."""
    back = State(end.p, -end.v, end.a, -end.j, end.heading, -end.heading_rate)
    reverse = stop(frame, back)
    p, v = reverse.p[::-1], -reverse.v[::-1]
    a = np.gradient(v, DT, axis=0)
    return fly(frame, p, v, a, np.unwrap(rotation.heading(reverse.q))[::-1])


def hover(frame: Airframe, at: State, duration: float) -> Motion:
    """Stays."""
    n = len(times(duration))
    zero = np.zeros((n, 3))
    return fly(frame, zero + at.p, zero, zero, np.full(n, at.heading))


def supported(q: np.ndarray, p: np.ndarray, squares: np.ndarray) -> Motion:
    """Rests at p, held by something: what is felt is gravity, whatever the rotors do."""
    n = len(squares)
    q = np.broadcast_to(q, (n, 4))
    force = rotation.rotate(rotation.inverse(q), np.broadcast_to(G, (n, 3)))
    return Motion(np.zeros((n, 3)) + p, np.zeros((n, 3)), q, force, squares)


def moved_by_hand(p: np.ndarray, q: np.ndarray, squares: np.ndarray) -> Motion:
    """Follows p and q in a hand: what is felt is acceleration and gravity."""
    v = np.gradient(p, DT, axis=0)
    a = np.gradient(v, DT, axis=0)
    return Motion(p, v, q, rotation.rotate(rotation.inverse(q), a + G), squares)


Throttle = Callable[[np.ndarray], np.ndarray]  # thrust over weight at times [s]


def lagged(wanted: np.ndarray, begin: float, up_s: float, down_s: float) -> np.ndarray:
    """Thrust over weight of rotors whose speed follows by time constants of first order."""
    speed, made = np.sqrt(begin), np.empty(len(wanted))
    for i, target in enumerate(np.sqrt(wanted)):
        speed += DT / (up_s if target > speed else down_s) * (target - speed)
        made[i] = speed * speed
    return made


def ramp(t: np.ndarray, points: List) -> np.ndarray:
    """Piecewise linear in time through (t, value)."""
    return np.interp(t, [x for x, _ in points], [y for _, y in points])


def wander(n: int, rng: np.random.Generator, sizes: List[float], low: float, high: float,
           fade_s: float = 0.6) -> np.ndarray:
    """Unrest of a hand: sums of sines between two frequencies [Hz], faded in and out, one column
    per size (standard deviation)."""
    t = DT * np.arange(n)
    window = np.clip(np.minimum(t, t[-1] - t) / min(fade_s, 0.5 * t[-1]), 0.0, 1.0)
    window = window ** 3 * (10.0 - 15.0 * window + 6.0 * window ** 2)
    made = np.zeros((n, len(sizes)))
    for i, size in enumerate(sizes):
        for f in rng.uniform(low, high, 5):
            made[:, i] += size * np.sqrt(2.0 / 5.0) * np.sin(2.0 * np.pi * f * t
                                                            + rng.uniform(0.0, 2.0 * np.pi))
    return made * window[:, None]
