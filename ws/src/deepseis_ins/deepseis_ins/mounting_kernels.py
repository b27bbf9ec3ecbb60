"""Attitude carried on by gyroscopes alone."""

from __future__ import annotations

from numba import njit

from deepseis_core.rotation import quat_from_rotvec_kernel, quat_multiply_kernel
from deepseis_core.types import FloatArray


@njit(cache=True, nogil=True)
def attitude_kernel(
    first: FloatArray, delta_theta: FloatArray, dt: FloatArray, earth_n: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Fill ``out``, (n + 1, 4), with the attitude before each interval and after the last.

    ``q' = q(-w dt) q q(dtheta)``, w the Earth's rate in n, (3,) [rad/s]; x, y, z, w.
    """
    out[0] = first
    q = (first[0], first[1], first[2], first[3])
    for k in range(delta_theta.shape[0]):
        x, y, z = delta_theta[k, 0], delta_theta[k, 1], delta_theta[k, 2]
        q = quat_multiply_kernel(q, quat_from_rotvec_kernel(x, y, z))
        x, y, z = -earth_n[0] * dt[k], -earth_n[1] * dt[k], -earth_n[2] * dt[k]
        q = quat_multiply_kernel(quat_from_rotvec_kernel(x, y, z), q)
        norm = (q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2) ** 0.5
        q = (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)
        out[k + 1, 0], out[k + 1, 1], out[k + 1, 2], out[k + 1, 3] = q
