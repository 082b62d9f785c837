"""Rotations of many rows at once. Quaternions are Hamilton, (..., 4) as w, x, y, z, and take
vectors from the body into the world; rotation vectors are (..., 3), in radians."""

import numpy as np


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product a b."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, float), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, float), -1, 0)
    return np.stack([aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
                     aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw],
                    axis=-1)


def inverse(q: np.ndarray) -> np.ndarray:
    """Conjugate."""
    return np.asarray(q, float) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """R(q) v."""
    q, v = np.broadcast_arrays(np.asarray(q, float), pad(v))
    return multiply(multiply(q, v), inverse(q))[..., 1:]


def pad(v: np.ndarray) -> np.ndarray:
    """0, v."""
    v = np.asarray(v, float)
    return np.concatenate([np.zeros(v.shape[:-1] + (1,)), v], axis=-1)


def exp(vector: np.ndarray) -> np.ndarray:
    """Quaternion of a rotation vector."""
    vector = np.asarray(vector, float)
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), vector * 0.5 * np.sinc(angle / (2 * np.pi))], axis=-1)


def log(q: np.ndarray) -> np.ndarray:
    """Rotation vector of at most half a turn."""
    q = np.where(np.asarray(q)[..., :1] < 0.0, -np.asarray(q), q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, q[..., :1])
    return q[..., 1:] * np.where(length > 1e-12, angle / np.maximum(length, 1e-12), 2.0)


def matrix(q: np.ndarray) -> np.ndarray:
    """Rotation matrix of one quaternion."""
    return np.stack([rotate(q, e) for e in np.eye(3)], axis=-1)


def from_up(z: np.ndarray) -> np.ndarray:
    """The smallest rotation that takes e3 to each unit vector z."""
    z = np.asarray(z, float)
    q = np.stack([1.0 + z[..., 2], -z[..., 1], z[..., 0], np.zeros(z.shape[:-1])], axis=-1)
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def turn(angle: np.ndarray) -> np.ndarray:
    """Rotation about z."""
    angle = np.asarray(angle, float)
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, zero, np.sin(angle / 2)], axis=-1)


def heading(q: np.ndarray) -> np.ndarray:
    """Angle psi of q = from_up(z) turn(psi)."""
    rest = multiply(inverse(from_up(rotate(q, [0.0, 0.0, 1.0]))), q)
    return 2.0 * np.arctan2(rest[..., 3], rest[..., 0])


def continuous(q: np.ndarray) -> np.ndarray:
    """Same rotations, signs without leaps."""
    sign = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0.0, -1.0, 1.0))
    return q * np.concatenate([[1.0], sign])[:, None]


def rates(q: np.ndarray, dt: float) -> np.ndarray:
    """Body rates of evenly sampled attitudes, by central differences."""
    step = log(multiply(inverse(q[:-1]), q[1:])) / dt
    return np.concatenate([step[:1], 0.5 * (step[1:] + step[:-1]), step[-1:]])
