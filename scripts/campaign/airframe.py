"""The vehicle a recording shows: what is needed to add motion to it that it could have flown."""

from typing import Any, Dict, Optional

import numpy as np

from . import rotation
from .recording import ATTITUDE, POSITION, VELOCITY, Recording

G = np.array([0.0, 0.0, 9.81])
UP = np.array([0.0, 0.0, 1.0])
STEP_S = 0.01  # of the fit
LATE_S = np.arange(-0.06, 0.0601, 0.004)  # rotor speeds against positions, tried
LIFT = 0.02  # prior sigma of lift of speed over mass [1/m]


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
        self.damping = np.zeros(3)  # of rates, below 0 [N m s]
        self.rotors_late_s = self.odometry_late_s = 0.0
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
        """Finds k_f, drag, lift of speed and trim on a recording, and how late rotor speeds are, or
        position and velocity, where two sigma show it."""
        t, (p, q) = rec.t, self.body_poses(rec)
        grid = np.arange(t[0], t[-1], STEP_S)
        v = np.stack([np.interp(grid, t, x) for x in rec.get(VELOCITY).T] if rec.has(VELOCITY)
                     else [np.gradient(smooth(np.interp(grid, t, x)), STEP_S) for x in p.T], -1)
        a = np.stack([np.gradient(smooth(x), STEP_S) for x in v.T], axis=-1)
        q = np.stack([np.interp(grid, t, x) for x in rotation.continuous(q).T], axis=-1)
        back = rotation.inverse(q / np.linalg.norm(q, axis=1, keepdims=True))
        force, v_B = rotation.rotate(back, a + G) * self.mass, rotation.rotate(back, v)
        def regress_at(late: float) -> float:
            squares = np.stack([smooth(x) for x in (rec.rotors_at(grid + late) ** 2).T], axis=-1)
            return self.regress(force, v_B, squares)
        tried = [(regress_at(late), late) for late in LATE_S]
        gain = 2.0 * len(grid) * STEP_S / 0.1 * np.log(regress_at(0.0) / min(tried)[0])
        late = min(tried)[1] if gain > 4.0 else 0.0
        self.rotors_late_s, self.odometry_late_s = max(late, 0.0), max(-late, 0.0)
        regress_at(late)

    def regress(self, force: np.ndarray, v: np.ndarray, squares: np.ndarray) -> float:
        """Least squares of force [N] on velocity and squared speeds, all in the body; returns the
        residual's RMS [N]. Vertical drag is held near the lateral one, lift of speed near none, as
        far as the flight leaves them open; residuals are taken to be alike for 0.1 s."""
        inner = slice(20, -20)
        force, v, squares = force[inner], v[inner], squares[inner]
        for i in range(2):
            self.drag[i] = np.sum(force[:, i] * v[:, i]) / (np.sum(v[:, i] ** 2) + 1e-9)
        lateral = v[:, 0] ** 2 + v[:, 1] ** 2
        scale = squares.sum(axis=1).mean()
        columns = np.stack([squares.sum(axis=1) / scale, v[:, 2], lateral], axis=-1)
        free = np.linalg.lstsq(columns, force[:, 2], rcond=None)[0]
        size = float(np.std(force[:, 2] - columns @ free))
        mean = 0.5 * float(self.drag[0] + self.drag[1])
        weights = np.sqrt(0.1 / STEP_S) * size / np.array([abs(mean) + 1e-9, LIFT * self.mass])
        prior = np.concatenate([np.zeros((2, 1)), np.diag(weights)], axis=1)
        solved = np.linalg.lstsq(np.concatenate([columns, prior]), np.concatenate(
            [force[:, 2], [weights[0] * mean, 0.0]]), rcond=None)[0]
        self.k_f, self.drag[2], self.k_h = solved[0] / scale, solved[1], solved[2]
        self.trim = squares.mean(axis=0) / squares.mean()
        return float(np.std(force[:, 2] - columns @ solved))


def smooth(x: np.ndarray, width: int = 9) -> np.ndarray:
    """Moving average over an odd number of samples, ends held."""
    padded = np.pad(x, width // 2, mode='edge')
    return np.convolve(padded, np.ones(width) / width, mode='valid')
