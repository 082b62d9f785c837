"""The vehicle a recording shows: what is needed to add motion to it that it could have flown."""

from typing import Any, Dict, Optional

import numpy as np

from . import rotation
from .recording import ATTITUDE, POSITION, VELOCITY, Recording

G = np.array([0.0, 0.0, 9.81])
UP = np.array([0.0, 0.0, 1.0])


def quaternion(frame: Optional[Dict[str, Any]]) -> np.ndarray:
    """q_BS of a sensor's entry in a vehicle file, as w, x, y, z."""
    x, y, z, w = (frame or {}).get('q_BS_xyzw', [0.0, 0.0, 0.0, 1.0])
    q = np.array([w, x, y, z], float)
    return q / np.linalg.norm(q)


def place(frame: Optional[Dict[str, Any]]) -> np.ndarray:
    """p_BS of a sensor's entry [m]."""
    return np.array((frame or {}).get('p_BS_m', [0.0, 0.0, 0.0]), float)


class Airframe:
    """Mass, geometry and coefficients of a vehicle file, with k_f and drag as its recording shows
    them (by an own least-squares fit: faulty recordings don't depend on the tool under test)."""

    def __init__(self, vehicle: Dict[str, Any]) -> None:
        self.mass = float(vehicle['mass_kg'])
        self.inertia = np.array(vehicle['inertia_kg_m2'][:3], float)
        self.positions = np.array([r['position_m'] for r in vehicle['rotors']], float)
        self.spins = np.array([1.0 if r['spin'] == 'cw' else -1.0 for r in vehicle['rotors']])
        p = vehicle.get('parameters', {})
        self.k_f = float(p.get('thrust.k_f', {}).get('value', 1e-6))
        self.k_m = float(p.get('rotor_torque.k_m', {}).get('value', 0.013 * self.k_f))
        self.drag = np.zeros(3)
        self.k_h = 0.0
        self.trim = np.ones(len(self.spins))  # of squared speeds, mean 1
        self.q_BS, self.p_BS = quaternion(vehicle.get('odometry')), place(vehicle.get('odometry'))
        self.q_BI, self.p_BI = quaternion(vehicle.get('imu')), place(vehicle.get('imu'))

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.spins)

    @property
    def arm(self) -> float:
        """Mean distance of the rotors from the middle [m]."""
        return float(np.mean(np.linalg.norm(self.positions[:, :2], axis=1)))

    @property
    def hover_squares(self) -> np.ndarray:
        """Squared speeds in hover, as the recording trims them."""
        return self.trim * self.mass * 9.81 / (self.count * self.k_f)

    def allocation(self) -> np.ndarray:
        """Squared speeds to thrust and torque, 4 x n."""
        x, y = self.positions[:, 0], self.positions[:, 1]
        return np.stack([self.k_f * np.ones(self.count), self.k_f * y, -self.k_f * x,
                         self.k_m * self.spins])

    def squares(self, thrust: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Squared speeds of each row of thrust [N] and torque [N m]; never negative."""
        torque_only = np.concatenate([np.zeros(thrust.shape + (1,)), torque], axis=-1)
        extra = torque_only @ np.linalg.pinv(self.allocation()).T
        return np.maximum(thrust[..., None] / (self.count * self.k_f) * self.trim + extra, 0.0)

    def air_force(self, v_B: np.ndarray) -> np.ndarray:
        """Drag and lift of speed [N] in the body."""
        force = self.drag * v_B
        force[..., 2] += self.k_h * (v_B[..., 0] ** 2 + v_B[..., 1] ** 2)
        return force

    def body_poses(self, rec: Recording):
        """p_WB and q_WB of a recording's poses, which are those of frame S."""
        q = rotation.multiply(rec.get(ATTITUDE), rotation.inverse(self.q_BS))
        return rec.get(POSITION) - rotation.rotate(q, self.p_BS), q

    def fit(self, rec: Recording) -> None:
        """Finds k_f, drag, lift of speed and trim on a recording."""
        t, (p, q) = rec.t, self.body_poses(rec)
        grid = np.arange(t[0], t[-1], 0.01)
        sampled = [np.interp(grid, t, x) for x in p.T]
        v = np.stack([np.interp(grid, t, x) for x in rec.get(VELOCITY).T] if rec.has(VELOCITY)
                     else [np.gradient(smooth(x, 9), 0.01) for x in sampled], axis=-1)
        a = np.stack([np.gradient(smooth(x, 9), 0.01) for x in v.T], axis=-1)
        q_grid = np.stack([np.interp(grid, t, x) for x in rotation.continuous(q).T], axis=-1)
        q_grid /= np.linalg.norm(q_grid, axis=1, keepdims=True)
        squares = np.stack([smooth(x, 9) for x in (rec.rotors_at(grid) ** 2).T], axis=-1)
        turn_back = rotation.inverse(q_grid)
        self.regress(rotation.rotate(turn_back, a + G) * self.mass, rotation.rotate(turn_back, v),
                     squares)

    def regress(self, force: np.ndarray, v: np.ndarray, squares: np.ndarray) -> None:
        """Least squares of force [N] on velocity and squared speeds, all in the body."""
        inner = slice(20, -20)
        force, v, squares = force[inner], v[inner], squares[inner]
        for i in range(2):
            self.drag[i] = np.sum(force[:, i] * v[:, i]) / (np.sum(v[:, i] ** 2) + 1e-9)
        lateral = v[:, 0] ** 2 + v[:, 1] ** 2
        columns = np.stack([squares.sum(axis=1), v[:, 2], lateral], axis=-1)
        ridge = np.diag([0.0, 1.0 * np.sqrt(len(v)), 1.0 * np.sqrt(len(v))])
        solved = np.linalg.lstsq(np.concatenate([columns, ridge]),
                                 np.concatenate([force[:, 2], np.zeros(3)]), rcond=None)[0]
        self.k_f, self.drag[2], self.k_h = solved
        mean = squares.mean(axis=0)
        self.trim = mean / mean.mean()


def smooth(x: np.ndarray, width: int) -> np.ndarray:
    """Moving average over an odd number of samples, ends held."""
    padded = np.pad(x, width // 2, mode='edge')
    return np.convolve(padded, np.ones(width) / width, mode='valid')
