"""Whole flights: what comes before, after and during an unspoiled one. Every scene is flown,
carried or dropped by the rules of motion.py and rigid_body.py and shown by the recording's own
sensors; none of it is a jump."""

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np

from . import rotation
from .bases import Base
from .motion import (DT, Motion, at_rest, go, hover, lagged, moved_by_hand, ramp, start, stop,
                     supported, times, wander)
from .recording import Recording
from .rigid_body import Body, Plane, World, foot, open_loop, recovering
from .sensors import joined

IDLE = 0.08  # thrust over weight
UP_S, DOWN_S = 0.06, 0.12  # time constants of rotor speed
LIFT_OFF_S = 0.3


@dataclass
class Scene:
    """A recording and when in it, after its first pose, the fault acts [s]."""
    rec: Recording
    span: Tuple[float, float]


# ---- Where a scene goes ------------------------------------------------------------------------


def after(base: Base, motion: Motion, calm_s: float, rng: np.random.Generator) -> Scene:
    """A motion that goes on from the end; its first calm_s are flight."""
    end = float(base.rec.t[-1])
    rec = joined([base.rec, base.sensors.show(motion, rng).shifted(end)])
    return Scene(rec, (end + calm_s, end + motion.duration))


def before(base: Base, motion: Motion, fault_s: float, rng: np.random.Generator) -> Scene:
    """A motion that leads to the beginning; its first fault_s are the fault."""
    shown = base.sensors.show(motion, rng)
    rec = joined([shown, base.rec.shifted(motion.duration + base.sensors.period)])
    return Scene(rec, (0.0, fault_s))


def amid(base: Base, at: float, motion: Motion, span: Tuple[float, float],
         rng: np.random.Generator) -> Scene:
    """A motion put into the flight at a time; it ends in the state it began with."""
    first, second = base.rec.cut(-1.0, at), base.rec.cut(np.nextafter(at, 1e9), 1e9)
    rec = joined([first, base.sensors.show(motion, rng).shifted(at),
                  second.shifted(motion.duration)])
    return Scene(rec, (at + span[0], at + span[1]))


def calm_moment(base: Base) -> float:
    """A time in the middle half of the flight at which it is slow and level."""
    t, (p, q) = base.rec.t, base.frame.body_poses(base.rec)
    tilt = np.arccos(np.clip(rotation.rotate(q, [0.0, 0.0, 1.0])[:, 2], -1.0, 1.0))
    step = max(len(t) // 400, 1)
    speed = np.linalg.norm(np.gradient(p[::step], t[::step], axis=0), axis=1)
    cost = speed + 4.0 * tilt[::step]
    whole = t[-1] - t[0]
    cost[(t[::step] < t[0] + 0.3 * whole) | (t[::step] > t[0] + 0.75 * whole)] = 1e9
    return float(t[::step][np.argmin(cost)])


# ---- Pieces ------------------------------------------------------------------------------------


def squares(base: Base, thrust: np.ndarray) -> np.ndarray:
    """Squared speeds of thrusts over weight, all rotors together."""
    return thrust[:, None] * base.frame.hover_squares


def standing(base: Base, last: Motion, thrust: np.ndarray) -> Motion:
    """Stands where a motion ended, with thrust over weight by row."""
    return supported(last.q[-1], last.p[-1], squares(base, thrust))


def steady(value: float, duration: float) -> np.ndarray:
    """Thrust over weight that stays."""
    return np.full(len(times(duration)), value)


def ground(base: Base, **world) -> World:
    """A world with a floor."""
    return World([Plane(np.array([0.0, 0.0, base.floor]), np.array([0.0, 0.0, 1.0]))], **world)


def descent(base: Base, begin: Motion, sink: float = 0.25, above: float = 0.0) -> Motion:
    """From hover down to the floor, sinking evenly at its end."""
    end = begin.end()
    last = at_rest(np.array([end.p[0], end.p[1], base.floor + foot(base.frame) + above]),
                   end.heading, -sink)
    return go(base.frame, end, last, pace=0.6)


def approach(base: Base, sink: float = 0.25, above: float = 0.0) -> Motion:
    """Brakes at the end of the recording, hovers, comes down to the floor or to above it."""
    braked = stop(base.frame, base.sensors.state(True))
    still = braked.then(hover(base.frame, braked.end(), 0.4))
    return still.then(descent(base, still, sink, above))


def touch(base: Base, begin: Motion, points: List, duration: float, **world) -> Motion:
    """Touches down with rotors at thrust over weight by (t, value)."""
    body = Body(base.frame, begin, ground(base, **world), UP_S)
    return body.run(duration, open_loop(lambda t: float(ramp(t, points))))


def take_off(base: Base, rest: Motion) -> Motion:
    """Lifts off from rest (its last thrust is the weight) and flies to the recording's start."""
    into = start(base.frame, base.sensors.state(False))
    begin = rest.end()
    target = at_rest(into.p[0], float(rotation.heading(into.q[0])))
    return go(base.frame, begin, target).then(into)


def resting_place(base: Base, rng: np.random.Generator, height: float = 0.0) -> Motion:
    """One row at rest near the place under the recording's start."""
    s = base.sensors.state(False)
    p = np.array([s.p[0] + rng.uniform(-0.3, 0.3), s.p[1] + rng.uniform(-0.3, 0.3),
                  base.floor + foot(base.frame) + height])
    return supported(rotation.turn(np.array(s.heading)), p,
                     np.zeros((1, base.frame.count)) + base.frame.hover_squares)


# ---- On the ground -----------------------------------------------------------------------------


def stand_after(base: Base, level: float, duration: float, rng: np.random.Generator) -> Scene:
    """Lands; thrust falls to a level within 0.1 s and stays there until the recording ends."""
    flown = approach(base)
    settle = touch(base, flown, [(0.05, 1.0), (0.15, level)], min(1.0, duration))
    rest = settle
    if duration > settle.duration + 0.01:
        rest = settle.then(standing(base, settle, steady(level, duration - settle.duration)))
    return after(base, flown.then(rest), flown.duration, rng)


def stand_before(base: Base, level: float, duration: float, spooled: bool,
                 rng: np.random.Generator) -> Scene:
    """Stands at a level, after a spool-up or from the first row on, then takes off."""
    points = [(0.0, level), (duration, level), (duration + LIFT_OFF_S, 1.0)]
    if spooled:
        points = [(0.0, 0.0), (0.3, 0.0), (0.31, IDLE), (1.0, IDLE), (1.2, level)] \
            + [(t + 1.2, x) for t, x in points[1:]]
    t = times(points[-1][0])
    thrust = np.maximum(ramp(t, points), 1e-6)
    thrust = lagged(thrust, thrust[0], 0.03, 0.06)
    thrust[-20:] = np.linspace(thrust[-20], 1.0, 20)
    place = resting_place(base, rng)
    rest = standing(base, place, thrust)
    return before(base, rest.then(take_off(base, rest)), rest.duration, rng)


def landing(base: Base, ramp_s: float, then: str, rng: np.random.Generator) -> Scene:
    """Lands; thrust goes down over a time, to half for a second, to idle or off."""
    flown = approach(base, sink=rng.uniform(0.15, 0.4))
    levels = {'half_idle': [0.5, 0.5, IDLE], 'idle': [IDLE] * 3, 'off': [0.0] * 3,
              'half_off': [0.5, 0.5, 0.0]}[then]
    points = [(0.0, 1.0), (0.1, 0.95), (0.1 + ramp_s, levels[0]), (1.1 + ramp_s, levels[1]),
              (1.3 + ramp_s, levels[2]), (9.0, levels[2])]
    settle = touch(base, flown, points, 0.6 + ramp_s)
    t = times(4.0) + settle.duration
    thrust = lagged(ramp(t, points), float(np.mean(settle.squares[-1])
                                           / np.mean(base.frame.hover_squares)), UP_S, DOWN_S)
    rest = settle.then(standing(base, settle, thrust))
    return after(base, flown.then(rest), flown.duration, rng)


def spool_up(base: Base, ramp_s: float, rng: np.random.Generator) -> Scene:
    """Stands with rotors off, idles, and raises thrust slowly until it lifts off."""
    points = [(0.0, 0.0), (1.5, 0.0), (1.51, IDLE), (4.0, IDLE), (4.0 + ramp_s, 1.0)]
    thrust = lagged(ramp(times(4.0 + ramp_s), points), 0.0, 0.1, 0.1)
    thrust[-20:] = np.linspace(thrust[-20], 1.0, 20)
    rest = standing(base, resting_place(base, rng), thrust)
    return before(base, rest.then(take_off(base, rest)), rest.duration, rng)


def parked(base: Base, level: float, is_after: bool, rng: np.random.Generator) -> Scene:
    """A minute on the ground at a level."""
    if is_after:
        return stand_after(base, level, 60.0, rng)
    return stand_before(base, level, 60.0, False, rng)


def touch_and_go(base: Base, level: float, duration: float, rng: np.random.Generator) -> Scene:
    """Lands in the middle of the flight, stands at a level, and goes on."""
    at = calm_moment(base)
    s = base.sensors.state(True, at)
    flown = stop(base.frame, s)
    flown = flown.then(descent(base, flown))
    landed = touch(base, flown, [(0.05, 1.0), (0.2, level)], 0.8)
    points = [(0.0, level), (duration, level), (duration + LIFT_OFF_S, 1.0)]
    thrust = ramp(times(points[-1][0]), points)
    thrust[-1] = 1.0
    level_q = rotation.turn(rotation.heading(landed.q[-1]))
    rest = supported(level_q, landed.p[-1], squares(base, thrust))
    whole = flown.then(landed, rest)
    up = go(base.frame, rest.end(), at_rest(s.p + [0.0, 0.0, 0.0], s.heading))
    into = back_to(base, s, up)
    return amid(base, at, whole.then(into), (flown.duration, whole.duration), rng)


def back_to(base: Base, s, up: Motion) -> Motion:
    """From a hover to a state of the recording; `up` leads to a hover near it."""
    into = start(base.frame, s)
    there = at_rest(into.p[0], float(rotation.heading(into.q[0])))
    return up.then(go(base.frame, up.end(), there), into)


# ---- In the hand -------------------------------------------------------------------------------


def walk(base: Base, begin: Motion, duration: float, level: float,
         rng: np.random.Generator, lift: float = 1.0) -> Motion:
    """Picked up from where a motion ended and carried about, at steps of 2 a second, tilted."""
    n = len(times(duration))
    t = DT * np.arange(n)
    raised = lift * smooth_step(t / 1.5)
    way = 0.9 * duration / np.pi
    turned = np.pi * smooth_step((t - 1.5) / max(duration - 2.5, 0.5))
    course = rng.uniform(0.0, 2.0 * np.pi)
    p = np.stack([way * np.sin(turned) * 0.5, way * (1.0 - np.cos(turned)) * 0.5, raised], axis=-1)
    p = rotation.rotate(rotation.turn(np.array(course)), p)
    p += wander(n, rng, [0.02, 0.02, 0.02], 1.7, 2.2, 1.5) + wander(n, rng, [0.02] * 3, 0.3, 0.8)
    tilt = wander(n, rng, [0.18, 0.18, 0.25], 0.2, 0.8, 1.5) \
        + wander(n, rng, [0.02, 0.02, 0.01], 2.0, 5.0)
    q = rotation.multiply(begin.q[-1], rotation.exp(tilt))
    return moved_by_hand(begin.p[-1] + p, q, squares(base, np.full(n, level)))


def smooth_step(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 with three derivatives zero at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x ** 4 * (35.0 - 84.0 * x + 70.0 * x ** 2 - 20.0 * x ** 3)


def carried_after(base: Base, level: float, duration: float, rng: np.random.Generator) -> Scene:
    """Lands, stands a second, is picked up and carried away with rotors at a level."""
    flown = approach(base)
    settle = touch(base, flown, [(0.05, 1.0), (0.3, level)], 0.8)
    rest = settle.then(standing(base, settle, lagged(
        steady(level, 1.0), float(np.mean(settle.squares[-1]) / np.mean(base.frame.hover_squares)),
        UP_S, DOWN_S)))
    rest = rest.then(walk(base, rest, duration, level, rng))
    return after(base, flown.then(rest), flown.duration, rng)


def carried_before(base: Base, level: float, duration: float, rng: np.random.Generator) -> Scene:
    """Carried to its place, put down, and takes off two seconds later."""
    n = len(times(duration))
    carried = walk(base, resting_place(base, rng), duration, level, rng)
    reverse = moved_by_hand(carried.p[::-1], carried.q[::-1], squares(base, np.full(n, level)))
    points = [(0.0, level), (1.5, max(level, IDLE)), (2.0, 1.0)]
    thrust = ramp(times(2.0), points)
    rest = reverse.then(standing(base, reverse, thrust))
    return before(base, rest.then(take_off(base, rest)), rest.duration, rng)


def hand_start(base: Base, level: float, duration: float, rng: np.random.Generator) -> Scene:
    """Held up, rotors spool up to a level, let go when they carry it."""
    points = [(0.0, 0.0), (1.0, 0.0), (1.1, IDLE), (1.8, level), (1.8 + duration, level),
              (2.0 + duration, 1.0)]
    thrust = lagged(ramp(times(points[-1][0]), points), 0.0, 0.05, 0.05)
    thrust[-20:] = np.linspace(thrust[-20], 1.0, 20)
    place = resting_place(base, rng, 1.3)
    n = len(thrust)
    p = place.p[-1] + wander(n, rng, [0.015, 0.015, 0.01], 0.5, 2.0)
    q = rotation.multiply(place.q[-1], rotation.exp(wander(n, rng, [0.05, 0.05, 0.03], 0.5, 4.0)))
    held = moved_by_hand(p, q, squares(base, thrust))
    return before(base, held.then(take_off(base, held)), held.duration, rng)


def thrown(base: Base, speed: float, rng: np.random.Generator) -> Scene:
    """Held with rotors off, thrown up while turning, falls free, spools up, recovers, flies on."""
    frame = base.frame
    place = resting_place(base, rng, 1.0)
    n, swing = len(times(1.0)), times(0.35)
    held = moved_by_hand(place.p[-1] + wander(n, rng, [0.01] * 3, 0.5, 2.0),
                         np.zeros((n, 4)) + place.q[-1], np.zeros((n, frame.count)))
    up = speed * smooth_step(swing / swing[-1])
    spin = smooth_step(swing / swing[-1])[:, None] * rng.uniform(-2.0, 2.0, 3)
    p = held.p[-1] + np.cumsum(up[:, None] * [0.15, 0.05, 1.0], axis=0) * DT
    q = rotation.multiply(held.q[-1], rotation.exp(np.cumsum(spin, axis=0) * DT))
    tossed = moved_by_hand(p, q, np.zeros((len(swing), frame.count)))
    flight = held.then(tossed)
    body = Body(frame, flight, World(), 0.03)
    height = float(p[-1, 2] + 0.3 * speed ** 2 / 9.81)
    flight = flight.then(body.run(3.0, recovering(height, speed / 9.81 * 0.7)))
    out = settled(base, flight, body)
    return before(base, flight.then(out, take_off(base, out)), held.duration + tossed.duration, rng)


def settled(base: Base, flight: Motion, body: Body) -> Motion:
    """Stops what is left of a recovery's motion."""
    begin = at_rest(flight.p[-1], float(rotation.heading(flight.q[-1])))
    begin.v = flight.v[-1].copy()
    begin.a = rotation.rotate(flight.q[-1], flight.force[-1]) - [0.0, 0.0, 9.81]
    begin.heading_rate = float(body.w[2])
    return stop(base.frame, begin)


# ---- Contact, crash, fall ----------------------------------------------------------------------


def lying(base: Base, fallen: Motion, duration: float, level: float = 0.0) -> Motion:
    """Lies where a motion ended, rotors running out to a level."""
    begin = float(np.mean(fallen.squares[-1]) / np.mean(base.frame.hover_squares))
    return standing(base, fallen, lagged(steady(level, duration), begin, UP_S, DOWN_S))


def crash_ground(base: Base, rng: np.random.Generator) -> Scene:
    """Flies into the floor aslant at half thrust; rotors go on for a moment, then stop."""
    braked = stop(base.frame, base.sensors.state(True))
    end = braked.end()
    begin = end.p + rng.uniform(-1.0, 1.0, 3) * [1.0, 1.0, 0.0]
    low = np.array([begin[0], begin[1], base.floor + 1.0])
    flown = braked.then(go(base.frame, end, at_rest(low, end.heading)))
    side = rng.standard_normal(base.frame.count)
    side -= side.mean()
    def control(body: Body) -> np.ndarray:
        level = 0.6 if body.t < 0.9 else 0.0
        wanted = level * base.frame.hover_squares
        return wanted * (1.0 + 0.05 * side) if body.t < 0.15 else wanted
    fallen = Body(base.frame, flown, ground(base, damping=0.25), UP_S).run(3.0, control)
    return after(base, flown.then(fallen, lying(base, fallen, 2.0)), flown.duration + 0.4, rng)


def crash_wall(base: Base, speed: float, rng: np.random.Generator) -> Scene:
    """Flies against a wall, falls, lies."""
    braked = stop(base.frame, base.sensors.state(True))
    end = braked.end()
    ahead = rotation.rotate(rotation.turn(np.array(rng.uniform(0, 6.28))), [1.0, 0.0, 0.0])
    fast = at_rest(end.p + ahead * speed, end.heading)
    fast.v = ahead * speed
    flown = braked.then(go(base.frame, end, fast))
    world = ground(base, damping=0.3)
    world.planes.append(Plane(flown.p[-1] + ahead * 2.0 * base.frame.arm, -ahead))
    off = 0.25
    body = Body(base.frame, flown, world, UP_S)
    fallen = body.run(3.5, open_loop(lambda t: 1.0 if t < off else 0.0))
    return after(base, flown.then(fallen, lying(base, fallen, 1.5)), flown.duration, rng)


def motor_stop(base: Base, which: str, rng: np.random.Generator) -> Scene:
    """All rotors, or one, stop in hover; it falls and lies."""
    braked = stop(base.frame, base.sensors.state(True))
    flown = braked.then(hover(base.frame, braked.end(), 1.0))
    lame = int(rng.integers(base.frame.count))
    def control(body: Body) -> np.ndarray:
        wanted = base.frame.hover_squares.copy()
        wanted[slice(None) if which == 'all' or body.t > 0.6 else lame] = 0.0
        return wanted
    fallen = Body(base.frame, flown, ground(base, damping=0.3), DOWN_S).run(3.0, control)
    return after(base, flown.then(fallen, lying(base, fallen, 2.0)), flown.duration, rng)


def bounce(base: Base, sink: float, level: float, rng: np.random.Generator) -> Scene:
    """A hard landing that bounces; then stands at a level, then off."""
    flown = approach(base, sink)
    points = [(0.0, 0.9), (0.4, 0.8), (0.8, level), (2.0, level), (2.2, 0.0)]
    body = Body(base.frame, flown, ground(base, contact_hz=8.0, damping=0.1), UP_S)
    fallen = body.run(2.5, open_loop(lambda t: float(ramp(t, points))))
    return after(base, flown.then(fallen, lying(base, fallen, 1.5)), flown.duration, rng)


def upside_down(base: Base, level: float, duration: float, rng: np.random.Generator) -> Scene:
    """Lands, tips over about its edge, lies on its back with rotors turning."""
    flown = approach(base)
    settle = touch(base, flown, [(0.05, 1.0), (0.2, 0.5)], 0.8)
    t = times(0.7)
    angle = np.pi * smooth_step(t / 0.7)
    edge = np.array([0.0, 1.15 * base.frame.arm / np.sqrt(2.0), -foot(base.frame)])
    over = rotation.exp(angle[:, None] * [-1.0, 0.0, 0.0])
    arm = edge - rotation.rotate(over, edge)
    level_q = rotation.turn(rotation.heading(settle.q[-1]))
    p = settle.p[-1] + rotation.rotate(level_q, arm)
    n = len(t)
    tipping = moved_by_hand(p, rotation.multiply(level_q, over),
                            squares(base, np.linspace(0.5, level, n)))
    rest = settle.then(tipping)
    rest = rest.then(standing(base, rest, steady(level, duration)))
    return after(base, flown.then(rest), flown.duration, rng)


def shoved(base: Base, strength: float, rng: np.random.Generator) -> Scene:
    """Something hits it in flight for 0.15 s (force over weight); it recovers and goes on."""
    at = calm_moment(base)
    s = base.sensors.state(True, at)
    flown = stop(base.frame, s)
    toward = rng.standard_normal(3)
    toward *= strength * base.frame.mass * 9.81 / np.linalg.norm(toward)
    body = Body(base.frame, flown,
                World(push=lambda t: toward * (np.sin(np.pi * t / 0.15) if t < 0.15 else 0.0)))
    hit = body.run(2.5, recovering(float(flown.p[-1, 2])))
    out = settled(base, flown.then(hit), body)
    into = back_to(base, s, go(base.frame, out.end(), at_rest(s.p, s.heading)))
    return amid(base, at, flown.then(hit, out, into), (flown.duration, flown.duration + 0.2), rng)


def leaning(base: Base, angle: float, duration: float, rng: np.random.Generator) -> Scene:
    """Leans against a wall in flight for a while: it stands still although it is tilted."""
    at = calm_moment(base)
    s = base.sensors.state(True, at)
    flown = stop(base.frame, s)
    n = len(times(duration))
    t = DT * np.arange(n)
    lean = angle * smooth_step(t / 0.5) * smooth_step((t[-1] - t) / 0.5)
    axis = rotation.rotate(rotation.turn(np.array(rng.uniform(0.0, 6.28))), [1.0, 0.0, 0.0])
    q = rotation.multiply(flown.q[-1], rotation.exp(lean[:, None] * axis))
    against = supported(q, flown.p[-1], squares(base, 1.0 / np.cos(lean)))
    against.squares = base.frame.squares(base.frame.mass * 9.81 / np.cos(lean), np.gradient(
        rotation.rates(q, DT), DT, axis=0) * base.frame.inertia)
    into = back_to(base, s, hover(base.frame, against.end(), 0.3))
    whole = flown.then(against)
    return amid(base, at, whole.then(into), (flown.duration, whole.duration), rng)


# ---- Nothing wrong -----------------------------------------------------------------------------


def more_flight(base: Base, where: str, rng: np.random.Generator) -> Scene:
    """Only flight is added: a control of the method."""
    if where == 'after':
        braked = stop(base.frame, base.sensors.state(True))
        more = braked.then(hover(base.frame, braked.end(), 3.0))
        return after(base, more, 0.0, rng)
    if where == 'low':
        flown = approach(base, sink=0.0, above=0.15)
        return after(base, flown.then(hover(base.frame, flown.end(), 1.5)), 0.0, rng)
    if where == 'before':
        into = start(base.frame, base.sensors.state(False))
        at = at_rest(into.p[0], float(rotation.heading(into.q[0])))
        return before(base, hover(base.frame, at, 3.0).then(into), 0.0, rng)
    moment = calm_moment(base)
    s = base.sensors.state(True, moment)
    braked = stop(base.frame, s)
    return amid(base, moment, braked.then(back_to(base, s, hover(base.frame, braked.end(), 2.0))),
                (0.0, 0.0), rng)
