"""Rotations: quaternions, matrices, rotation vectors, Euler angles, and the two sets of axes.

Quaternions are (x, y, z, w) as on topics, unit, and mean what the matrix of the same name means:
``quat_nb`` and ``C_nb`` take components in body axes ``b`` to components in ``n``. Products run
alike: ``C_na @ C_ab`` belongs to ``quat_multiply(quat_na, quat_ab)``. A rotation vector
[rad] is that of the right-handed turn that brings axes ``n`` to axes ``b``.

Functions take any leading shape and broadcast. The functions named ``*_kernel`` do the same for
one rotation inside other kernels.

References
----------
P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems",
2nd ed., section 2.2 and appendix E.6.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from deepseis_core.types import FloatArray

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]

_GIMBAL_LOCK = 1e-12  # [-] cosine of pitch below which roll and heading cannot be told apart
_C_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FLIP_BODY = np.array([1.0, -1.0, -1.0])


def _array(value: ArrayLike) -> FloatArray:
    return np.asarray(value, np.float64)


def skew(vector: ArrayLike) -> FloatArray:
    """Return the matrices ``[v x]``, shape (..., 3, 3), with ``[v x] u = v x u``."""
    x, y, z = np.moveaxis(_array(vector), -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


# Quaternions


def quat_multiply(left: ArrayLike, right: ArrayLike) -> FloatArray:
    """Return the products, shape (..., 4): first ``right``, then ``left``."""
    ax, ay, az, aw = np.moveaxis(_array(left), -1, 0)
    bx, by, bz, bw = np.moveaxis(_array(right), -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def quat_conjugate(quat: ArrayLike) -> FloatArray:
    """Return the opposite rotations, shape (..., 4)."""
    return _array(quat) * np.array([-1.0, -1.0, -1.0, 1.0])


def quat_normalise(quat: ArrayLike) -> FloatArray:
    """Return quaternions of unit length with w >= 0: one of the two that mean the same."""
    q = _array(quat)
    return q / np.copysign(np.linalg.norm(q, axis=-1), q[..., 3])[..., None]


def quat_rotate(quat_ab: ArrayLike, vector_b: ArrayLike) -> FloatArray:
    """Return vectors, shape (..., 3), with components along ``b`` as components along ``a``."""
    q, v = _array(quat_ab), _array(vector_b)
    turn = 2.0 * np.cross(q[..., :3], v)
    return v + q[..., 3:] * turn + np.cross(q[..., :3], turn)


def matrix_from_quat(quat: ArrayLike) -> FloatArray:
    """Return the matrices, shape (..., 3, 3), of unit quaternions."""
    x, y, z, w = np.moveaxis(_array(quat), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_from_matrix(matrix: ArrayLike) -> FloatArray:
    """Return the quaternions, shape (..., 4), w >= 0, of rotation matrices.

    Shepperd's method: of the four rows of ``4 q q^T`` the one with the largest diagonal element
    is normalised, so that nothing is divided by a small number.
    """
    C = _array(matrix)
    xx, yy, zz = C[..., 0, 0], C[..., 1, 1], C[..., 2, 2]
    xy, xz, yz = (C[..., i, j] + C[..., j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    xw, yw, zw = (C[..., i, j] - C[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    rows = [
        [1 + xx - yy - zz, xy, xz, xw],
        [xy, 1 - xx + yy - zz, yz, yw],
        [xz, yz, 1 - xx - yy + zz, zw],
        [xw, yw, zw, 1 + xx + yy + zz],
    ]
    outer = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    return quat_normalise(np.take_along_axis(outer, largest[..., None, None], -2)[..., 0, :])


# Rotation vectors


def quat_from_rotvec(rotvec: ArrayLike) -> FloatArray:
    """Return the quaternions, shape (..., 4), of rotation vectors [rad], shape (..., 3)."""
    vector = _array(rotvec)
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    # np.sinc keeps its precision down to zero.
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=-1)


def rotvec_from_quat(quat: ArrayLike) -> FloatArray:
    """Return the rotation vectors [rad], shape (..., 3), of length up to pi."""
    q = quat_normalise(quat)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    tiny = sine < 1e-8  # then angle / sine is 2 to double precision
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    return q[..., :3] * np.where(tiny, 2.0, angle / np.where(tiny, 1.0, sine))


def matrix_from_rotvec(rotvec: ArrayLike) -> FloatArray:
    """Return the matrices, shape (..., 3, 3), of rotation vectors [rad], shape (..., 3)."""
    return matrix_from_quat(quat_from_rotvec(rotvec))


def rotvec_from_matrix(matrix: ArrayLike) -> FloatArray:
    """Return the rotation vectors [rad], shape (..., 3), of matrices, shape (..., 3, 3)."""
    return rotvec_from_quat(quat_from_matrix(matrix))


# Euler angles: roll, pitch, heading of body forward-right-down against north-east-down


def matrix_from_euler(euler: ArrayLike) -> FloatArray:
    """Return ``C_nb``, shape (..., 3, 3), of roll, pitch, heading [rad], shape (..., 3).

    The body is turned by the heading about down, clockwise from north as seen from above, then
    by the pitch about its right (nose up positive), then by the roll about its forward axis
    (right side down positive).
    """
    roll, pitch, heading = np.moveaxis(_array(euler), -1, 0)
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    sh, ch = np.sin(heading), np.cos(heading)
    rows = [
        [cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh],
        [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_from_matrix(C_nb: ArrayLike) -> FloatArray:
    """Return roll, pitch, heading [rad], shape (..., 3), of ``C_nb``, shape (..., 3, 3).

    Pitch lies within +-pi/2, the others within +-pi. Nose straight up or down the roll is zero:
    only its sum with the heading means anything there.
    """
    C = _array(C_nb)
    cos_pitch = np.hypot(C[..., 0, 0], C[..., 1, 0])
    locked = cos_pitch < _GIMBAL_LOCK
    roll = np.where(locked, 0.0, np.arctan2(C[..., 2, 1], C[..., 2, 2]))
    heading = np.where(
        locked,
        np.arctan2(-C[..., 0, 1], C[..., 1, 1]),
        np.arctan2(C[..., 1, 0], C[..., 0, 0]),
    )
    return np.stack([roll, np.arctan2(-C[..., 2, 0], cos_pitch), heading], axis=-1)


def quat_from_euler(euler: ArrayLike) -> FloatArray:
    """Return ``quat_nb``, shape (..., 4), of roll, pitch, heading [rad], shape (..., 3)."""
    return quat_from_matrix(matrix_from_euler(euler))


def euler_from_quat(quat_nb: ArrayLike) -> FloatArray:
    """Return roll, pitch, heading [rad], shape (..., 3), of ``quat_nb``, shape (..., 4)."""
    return euler_from_matrix(matrix_from_quat(quat_nb))


# The axes of topics: east-north-up and forward-left-up (REP-103)


def enu_from_ned(vector: ArrayLike) -> FloatArray:
    """Exchange north, east, down and east, north, up of vectors, shape (..., 3); either way."""
    return _array(vector)[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def flu_from_frd(vector: ArrayLike) -> FloatArray:
    """Exchange forward-right-down and forward-left-up of vectors, shape (..., 3); either way."""
    return _array(vector) * _FLIP_BODY


def enu_flu_from_ned_frd(C_ned_frd: ArrayLike) -> FloatArray:
    """Return ``C_enu_flu`` of ``C_ned_frd``, shape (..., 3, 3).

    Examples
    --------
    A body that heads north and stands level:

    >>> enu_flu_from_ned_frd(np.eye(3)) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    return (_C_ENU_NED @ _array(C_ned_frd)) * _FLIP_BODY


def ned_frd_from_enu_flu(C_enu_flu: ArrayLike) -> FloatArray:
    """Return ``C_ned_frd`` of ``C_enu_flu``, shape (..., 3, 3)."""
    # Both exchanges of axes are their own inverses.
    return enu_flu_from_ned_frd(C_enu_flu)


def rep103_from_euler(euler: ArrayLike) -> FloatArray:
    """Exchange roll, pitch, heading and the Euler angles of ``C_enu_flu``; either way.

    REP-103 has the same roll, the pitch positive nose down, and a yaw counterclockwise from
    east: ``(roll, -pitch, pi/2 - heading)``, yaw or heading within +-pi.

    Parameters
    ----------
    euler : array_like, shape (..., 3)
        Roll, pitch and heading, or roll, pitch and yaw [rad].
    """
    roll, pitch, heading = np.moveaxis(_array(euler), -1, 0)
    yaw = np.remainder(1.5 * np.pi - heading, 2.0 * np.pi) - np.pi
    return np.stack([roll, -pitch, yaw], axis=-1)


def enu_flu_from_euler(euler: ArrayLike) -> FloatArray:
    """Return ``C_enu_flu``, shape (..., 3, 3), of roll, pitch, heading [rad], shape (..., 3)."""
    return enu_flu_from_ned_frd(matrix_from_euler(euler))


# One rotation, for use inside kernels


@njit(cache=True, nogil=True)
def quat_multiply_kernel(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the product of two quaternions: first ``b``, then ``a``."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@njit(cache=True, nogil=True)
def quat_change_kernel(x: float, y: float, z: float) -> Quaternion:
    """Return the quaternion of a rotation vector [rad] less that of no rotation.

    A small rotation keeps all its digits, which are lost where its w = 1 - 1e-14 is rounded.
    """
    square = 0.25 * (x * x + y * y + z * z)
    if square < 1e-4:  # the series' next terms are below 3e-21: IMU increments stay here
        half_sinc = 0.5 - square / 12.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
        w = -square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0))
    else:
        half = math.sqrt(square)
        half_sinc = 0.5 * math.sin(half) / half
        w = -2.0 * math.sin(0.5 * half) ** 2
    return x * half_sinc, y * half_sinc, z * half_sinc, w


@njit(cache=True, nogil=True)
def quat_from_rotvec_kernel(x: float, y: float, z: float) -> Quaternion:
    """Return the quaternion of a rotation vector [rad]."""
    a, b, c, w = quat_change_kernel(x, y, z)
    return a, b, c, 1.0 + w


@njit(cache=True, nogil=True)
def quat_rotate_kernel(q: Quaternion, v: Vector) -> Vector:
    """Return a vector turned by a unit quaternion."""
    x, y, z, w = q
    tx = 2.0 * (y * v[2] - z * v[1])
    ty = 2.0 * (z * v[0] - x * v[2])
    tz = 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )
