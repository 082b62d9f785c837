"""A rigid body with rotors and contacts, for what polynomials can't say: touch-down, bounce,
crash, fall and recovery from a throw."""

from dataclasses import dataclass, field
from typing import Callable, List, Optional

import numpy as np

from . import rotation
from .airframe import Airframe
from .motion import DT, Motion

STEP = 0.0005
PER_ROW = int(round(DT / STEP))
Push = Callable[[float], np.ndarray]  # force on the body in the world [N] at a time


@dataclass
class Plane:
    """A wall or the floor: points with (x - point) . normal < 0 are inside it."""
    point: np.ndarray
    normal: np.ndarray


@dataclass
class World:
    """What the vehicle can touch, how springy and damped the contact is, and what pushes."""
    planes: List[Plane] = field(default_factory=list)
    contact_hz: float = 14.0
    damping: float = 0.5
    friction: float = 0.6
    push: Optional[Push] = None


def skin(frame: Airframe) -> np.ndarray:
    """Points that touch: four feet below and four above, in the body."""
    reach = 1.15 * frame.arm / np.sqrt(2.0)
    height = foot(frame)
    return np.array([[x * reach, y * reach, z * height]
                     for z in (-1, 1) for x in (-1, 1) for y in (-1, 1)])


def foot(frame: Airframe) -> float:
    """Height of the body's origin over the floor when it stands [m]."""
    return 0.3 * frame.arm


class Body:
    """State of the body; rows of a Motion come out of run()."""

    def __init__(self, frame: Airframe, motion: Motion, world: World, lag_s: float = 0.03) -> None:
        self.frame, self.world, self.lag_s = frame, world, lag_s
        self.p, self.v = motion.p[-1].copy(), motion.v[-1].copy()
        self.q, self.w = motion.q[-1].copy(), motion.rates[-1].copy()
        self.speeds = np.sqrt(motion.squares[-1])
        self.points = skin(frame)
        self.allocation = frame.allocation()
        self.weight_per_point = frame.mass * (2.0 * np.pi * world.contact_hz) ** 2 / 4.0
        self.damper = 2.0 * world.damping * frame.mass * 2.0 * np.pi * world.contact_hz / 4.0
        self.t = 0.0

    def contact(self, R: np.ndarray):
        """Force (world) and torque (body) of all that is touched."""
        force, torque = np.zeros(3), np.zeros(3)
        arms = self.points @ R.T
        for plane in self.world.planes:
            depth = (plane.point - self.p - arms) @ plane.normal
            for i in np.flatnonzero(depth > 0.0):
                v = self.v + R @ np.cross(self.w, self.points[i])
                normal_v = v @ plane.normal
                push = max(self.weight_per_point * depth[i] - self.damper * normal_v, 0.0)
                slide = v - normal_v * plane.normal
                f = push * (plane.normal - self.world.friction * slide
                            / (np.sqrt(slide @ slide) + 0.05))
                force += f
                torque += np.cross(self.points[i], R.T @ f)
        return force, torque

    def step(self, wanted: np.ndarray) -> np.ndarray:
        """One STEP with wanted squared speeds; returns the specific force in the body."""
        frame = self.frame
        self.speeds += STEP / self.lag_s * (np.sqrt(np.maximum(wanted, 0.0)) - self.speeds)
        R = rotation.matrix(self.q)
        wrench = self.allocation @ (self.speeds ** 2 - self.trim_squares())
        body_force = frame.air_force(R.T @ self.v)
        body_force[2] += frame.k_f * np.sum(self.speeds ** 2)
        touch, touch_torque = self.contact(R)
        pushed = touch if self.world.push is None else touch + self.world.push(self.t)
        felt = (body_force + R.T @ pushed) / frame.mass
        torque = (wrench[1:] + touch_torque + frame.damping * self.w -
                  np.cross(self.w, frame.inertia * self.w))
        self.w = self.w + STEP * torque / frame.inertia
        self.v = self.v + STEP * (R @ felt - [0.0, 0.0, 9.81])
        self.p = self.p + STEP * self.v
        self.q = rotation.multiply(self.q, rotation.exp(self.w * STEP))
        self.t += STEP
        return felt

    def trim_squares(self) -> np.ndarray:
        """Squared speeds without torque at the present thrust: the trim is the zero of torque."""
        return self.frame.trim * np.mean(self.speeds ** 2)

    def run(self, duration: float, control: Callable[['Body'], np.ndarray]) -> Motion:
        """Motion over a time under a control law that gives wanted squared speeds."""
        rows: List[List[np.ndarray]] = [[], [], [], [], []]
        for _ in range(max(int(round(duration / DT)), 2)):
            wanted = control(self)
            felt = np.mean([self.step(wanted) for _ in range(PER_ROW)], axis=0)
            for row, x in zip(rows, (self.p, self.v, self.q, felt, self.speeds ** 2)):
                row.append(x.copy())
        return Motion(*[np.array(r) for r in rows])


def open_loop(throttle: Callable[[float], float]) -> Callable[[Body], np.ndarray]:
    """All rotors together at a thrust over weight."""
    return lambda body: throttle(body.t) * body.frame.hover_squares


def recovering(height: float, arm_at: float = 0.0) -> Callable[[Body], np.ndarray]:
    """Levels, brakes and holds a height, from arm_at on; rotors off before."""
    def control(body: Body) -> np.ndarray:
        frame = body.frame
        if body.t < arm_at:
            return np.zeros(frame.count)
        lateral = np.clip(-2.0 * body.v, -4.0, 4.0)
        lift = np.clip(9.81 + 6.0 * (height - body.p[2]) - 4.0 * body.v[2], 3.0, 18.0)
        wanted = np.array([lateral[0], lateral[1], lift])
        R = rotation.matrix(body.q)
        error = np.cross(R[:, 2], wanted / np.linalg.norm(wanted))
        error = (R.T @ error) * [1.0, 1.0, 0.0]
        acceleration = 120.0 * error - 16.0 * body.w * [1.0, 1.0, 0.3]
        thrust = frame.mass * max(wanted @ R[:, 2], 2.0)
        squares = frame.squares(np.array(thrust), frame.inertia * acceleration)
        return np.clip(squares, 0.02 * frame.hover_squares, 2.5 * frame.hover_squares)
    return control
