"""What the sensors of a recording would have shown of added motion: same streams, same stamps'
pattern, noise and offsets as measured on the recording itself."""

from typing import Dict, List, Sequence, Tuple

import numpy as np

from . import rotation
from .airframe import G, Airframe
from .motion import DT, Motion, State
from .recording import (ATTITUDE, FORCE, GYRO, POSITION, RATE, VELOCITY, Columns, Recording)

ACCELEROMETER_RANGE = 157.0  # 16 g [m/s^2]
GYRO_RANGE = 35.0  # 2000 deg/s [rad/s]


def noise_of(x: np.ndarray) -> Tuple[float, float]:
    """Standard deviation of what is left of a signal beside its average over seven samples (the
    median of blocks, so that manoeuvres don't count), and its correlation from sample to sample."""
    rest = x[3:-3] - np.convolve(x, np.ones(7) / 7.0, mode='valid')
    if len(rest) < 100:
        return 0.0, 0.0
    blocks = rest[:len(rest) // 50 * 50].reshape(-1, 50)
    sigma = float(np.median(blocks.std(axis=1))) * np.sqrt(7.0 / 6.0)
    variance = np.mean(blocks ** 2, axis=1) + 1e-300
    rho = float(np.median(np.mean(blocks[:, 1:] * blocks[:, :-1], axis=1) / variance)) + 1.0 / 6.0
    return sigma, float(np.clip(rho, 0.0, 0.45))


def coloured(n: int, sigma: float, rho: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of this size whose neighbours correlate by rho (moving average of two)."""
    c = 0.0 if rho < 1e-3 else (1.0 - np.sqrt(1.0 - 4.0 * rho * rho)) / (2.0 * rho)
    white = rng.standard_normal(n + 1)
    return sigma * (white[1:] + c * white[:-1]) / np.sqrt(1.0 + c * c)


class Sensors:
    """The sensors of one recording."""

    def __init__(self, rec: Recording, frame: Airframe) -> None:
        self.rec, self.frame = rec, frame
        self.noise = {n: noise_of(rec.main[n]) for n in rec.main if n != 't'}
        self.rotor_noise = [noise_of(x) for x in rec.rotors().T]
        self.period = float(np.median(np.diff(rec.t)))
        self.rotor_period = float(np.median(np.diff(rec.rotor_columns['t'])))
        self.lost = float(np.mean(np.diff(rec.t) > 1.5 * self.period))
        self.bias_gyro, self.bias_force = self.biases()
        self.commands = self.command_maps()

    def biases(self) -> Tuple[np.ndarray, np.ndarray]:
        """Offsets of gyro and accelerometer [rad/s, m/s^2] against the poses and the model."""
        gyro, force = np.zeros(3), np.zeros(3)
        t = self.rec.t
        p, q = self.frame.body_poses(self.rec)
        q = rotation.continuous(q)
        names = GYRO if self.rec.has(GYRO) else RATE
        if self.rec.has(names):
            step = rotation.log(rotation.multiply(rotation.inverse(q[:-20]), q[20:]))
            turned = rotation.rotate(self.imu(), step / (t[20:] - t[:-20])[:, None])
            gyro = np.median(self.rec.get(names)[10:-10] - turned, axis=0)
        if self.rec.has(FORCE):
            model = rotation.rotate(self.imu(), self.model_force(q))
            force = np.median(self.rec.get(FORCE) - model, axis=0)
        return np.clip(gyro, -0.1, 0.1), np.clip(force, -0.5, 0.5)

    def imu(self) -> np.ndarray:
        """Takes vectors of the body into the frame of the IMU's columns."""
        if self.rec.has(GYRO):
            return rotation.inverse(self.frame.q_BI)
        return np.array([1.0, 0.0, 0.0, 0.0])

    def model_force(self, q: np.ndarray) -> np.ndarray:
        """Specific force the model gives over the recording, body."""
        frame, t = self.frame, self.rec.t
        v = self.rec.get(VELOCITY) if self.rec.has(VELOCITY) else np.zeros((len(t), 3))
        force = frame.air_force(rotation.rotate(rotation.inverse(q), v))
        force[:, 2] += frame.k_f * np.sum(self.rec.rotors_at(t + frame.rotors_late_s) ** 2, axis=1)
        return force / frame.mass

    def command_maps(self) -> Dict[str, np.ndarray]:
        """Commands as second-order polynomials of the rotor's speed, by column."""
        maps = {}
        for name in self.rec.main:
            if name.startswith(('pwm', 'throttle')):
                i = int(name.lstrip('pwmthrole')) - 1
                speed = self.rec.rotors_at(self.rec.t)[:, i]
                maps[name] = np.polyfit(speed, self.rec.main[name], 2)
        return maps

    def state(self, at_end: bool, t: float = 0.0) -> State:
        """The recording's motion at its end, its start, or (t > 0) in the middle, as the model
        continues it: acceleration and jerk follow from attitude, thrust and rates."""
        stamps = self.rec.t
        when = t if t > 0.0 else (stamps[-1] if at_end else stamps[0])
        near = np.abs(stamps - when) <= 0.06
        p, q = self.frame.body_poses(self.rec)
        x = stamps[near] - when
        position = np.array([np.polyfit(x, c, 2)[-1] for c in p[near].T])
        if self.rec.has(VELOCITY):
            v = np.array([np.polyfit(x, c, 1)[-1] for c in self.rec.get(VELOCITY)[near].T])
        else:
            near = np.abs(stamps - when) <= 0.15
            v = np.array([np.polyfit(stamps[near] - when, c, 2)[-2] for c in p[near].T])
        return self.continued(position, v, q, when)

    def continued(self, p: np.ndarray, v: np.ndarray, q_all: np.ndarray, when: float) -> State:
        """State at a time from position, velocity and the attitudes around it."""
        frame, stamps = self.frame, self.rec.t
        q_all = rotation.continuous(q_all)
        near = np.flatnonzero(np.abs(stamps - when) <= 0.06)
        fit = [np.polyfit(stamps[near] - when, c, 2) for c in q_all[near].T]
        q = np.array([c[-1] for c in fit])
        q /= np.linalg.norm(q)
        w = 2.0 * rotation.multiply(rotation.inverse(q), np.array([c[-2] for c in fit]))[1:]
        R = rotation.matrix(q)
        late = frame.odometry_late_s
        around = when + frame.rotors_late_s + np.linspace(-0.02, 0.02, 9)
        rotors = np.mean(self.rec.rotors_at(around) ** 2, axis=0)
        thrust = frame.k_f * np.sum(rotors)
        air = R @ frame.air_force(R.T @ v)
        a = (R[:, 2] * thrust + air) / frame.mass - G
        j = R @ np.cross(w, [0.0, 0.0, 1.0]) * thrust / frame.mass
        return State(p + v * late, v + a * late, a, j, float(rotation.heading(q)), float(w[2]))

    def stamps(self, duration: float, rng: np.random.Generator) -> np.ndarray:
        """Stamps of poses over a duration, with packets lost as often as in the recording."""
        t = np.arange(self.period, duration, self.period)
        return t[rng.random(len(t)) >= self.lost]

    def show(self, motion: Motion, rng: np.random.Generator) -> Recording:
        """A recording of added motion, from 0 to its duration."""
        t = self.stamps(motion.duration, rng)
        main: Columns = {'t': t}
        self.add_odometry(main, motion, t, rng)
        load = np.clip(np.interp(t, motion.t, motion.squares.sum(axis=1)
                                 / self.frame.hover_squares.sum()), 0.0, 1.5)
        self.add_imu(main, motion, t, np.sqrt(0.04 + load ** 2), rng)
        rotor = self.add_rotors(main, motion, t, rng)
        for name in self.rec.main:
            if name not in main:  # battery voltage
                main[name] = np.full(len(t), np.median(self.rec.main[name][-200:]))
        return Recording({n: main[n] for n in self.rec.main}, rotor)

    def at(self, motion: Motion, x: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Rows of a motion at any times."""
        return np.stack([np.interp(t, motion.t, c) for c in x.T], axis=-1)

    def noisy(self, main: Columns, names: Sequence[str], x: np.ndarray, scale: np.ndarray,
              rng: np.random.Generator) -> None:
        """Puts columns with their noise, times a scale."""
        for i, name in enumerate(names):
            main[name] = x[:, i] + scale * coloured(len(x), *self.noise[name], rng)

    def add_odometry(self, main: Columns, motion: Motion, t: np.ndarray,
                     rng: np.random.Generator) -> None:
        """Pose and velocity of frame S."""
        frame = self.frame
        q = rotation.continuous(self.at(motion, rotation.continuous(motion.q), t))
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        w = self.at(motion, motion.rates, t)
        then = t - frame.odometry_late_s
        p = self.at(motion, motion.p, then) + rotation.rotate(q, frame.p_BS)
        p += np.minimum(then - motion.t[0], 0.0)[:, None] * motion.v[0]
        self.noisy(main, POSITION, p, np.ones(len(t)), rng)
        size = float(np.median([self.noise[n][0] for n in ATTITUDE[1:]]))
        shake = np.stack([coloured(len(t), 2.0 * size, self.noise['qx'][1], rng)
                          for _ in range(3)], axis=-1)
        q_S = rotation.multiply(rotation.multiply(q, frame.q_BS), rotation.exp(shake))
        for i, name in enumerate(ATTITUDE):
            main[name] = q_S[:, i]
        if self.rec.has(VELOCITY):
            v = self.at(motion, motion.v, then) + rotation.rotate(q, np.cross(w, frame.p_BS))
            self.noisy(main, VELOCITY, v, np.ones(len(t)), rng)

    def add_imu(self, main: Columns, motion: Motion, t: np.ndarray, shaking: np.ndarray,
                rng: np.random.Generator) -> None:
        """Rates, gyro and accelerometer; vibration goes with the rotors."""
        rates, turned = motion.rates, self.imu()
        if self.rec.has(RATE):
            bias = np.zeros(3) if self.rec.has(GYRO) else self.bias_gyro
            w = rotation.rotate(rotation.inverse(self.frame.q_BS), self.at(motion, rates, t))
            self.noisy(main, RATE, np.clip(w + bias, -GYRO_RANGE, GYRO_RANGE), shaking, rng)
        if self.rec.has(GYRO):
            w = rotation.rotate(turned, self.at(motion, rates, t)) + self.bias_gyro
            self.noisy(main, GYRO, np.clip(w, -GYRO_RANGE, GYRO_RANGE), shaking, rng)
        if self.rec.has(FORCE):
            lever = self.frame.p_BI if self.rec.has(GYRO) else np.zeros(3)
            felt = motion.force + np.cross(np.gradient(rates, DT, axis=0), lever) \
                + np.cross(rates, np.cross(rates, lever))
            felt = rotation.rotate(turned, self.at(motion, felt, t)) + self.bias_force
            self.noisy(main, FORCE, felt, shaking, rng)
            for name in FORCE:
                main[name] = np.clip(main[name], -ACCELEROMETER_RANGE, ACCELEROMETER_RANGE)

    def add_rotors(self, main: Columns, motion: Motion, t: np.ndarray, rng: np.random.Generator):
        """Rotor speeds in the file they belong to, and commands; returns the rotor file's."""
        stamps = t
        if self.rec.rotor is not None:
            stamps = np.arange(self.rotor_period, motion.duration, self.rotor_period)
        speeds = np.sqrt(self.at(motion, motion.squares, stamps - self.frame.rotors_late_s))
        hover = np.sqrt(self.frame.hover_squares)
        noise = np.stack([coloured(len(stamps), *n, rng) for n in self.rotor_noise], axis=-1)
        columns = dict(zip(self.rec.rotor_names, np.maximum(speeds + noise * speeds / hover, 0).T))
        for name, c in self.commands.items():
            speed = np.interp(t, stamps, columns['rotor' + name.lstrip('pwmthrole')])
            main[name] = np.maximum(np.polyval(c, np.maximum(speed, 0.0)) * (speed > 1.0), 0.0)
        if self.rec.rotor is None:
            main.update(columns)
            return None
        return {'t': stamps, **columns}


def signs_continued(rec: Recording) -> None:
    """Makes the signs of a recording's attitudes continuous."""
    rec.put(ATTITUDE, rotation.continuous(rec.get(ATTITUDE)))


def joined(parts: List[Recording]) -> Recording:
    """Recordings whose stamps follow each other, in one; stamps begin at 0."""
    whole = parts[0]
    for part in parts[1:]:
        whole = whole.then(part)
    signs_continued(whole)
    return whole.shifted(-float(whole.t[0]))
