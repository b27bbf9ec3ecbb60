"""Kernel of a vehicle's kinematics: road, speed programme, lean and vibration into one body."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepseis_core.types import FloatArray
from deepseis_sim.speed_programme import travel


@njit(cache=True, nogil=True)
def road_point(nodes: FloatArray, step: float, s: float, out: FloatArray) -> None:
    """Write a road's position and its first three derivatives by length into ``out`` (4, 3).

    The quintic through the nodes' position and first two derivatives, which is the spline that
    the nodes were taken from.
    """
    k = min(max(int(s / step), 0), nodes.shape[0] - 2)
    x = s / step - k
    for axis in range(3):
        p0, p1 = nodes[k, axis], nodes[k + 1, axis]
        d0, d1 = nodes[k, 3 + axis] * step, nodes[k + 1, 3 + axis] * step
        q0, q1 = nodes[k, 6 + axis] * step * step, nodes[k + 1, 6 + axis] * step * step
        e0 = p1 - p0 - d0 - 0.5 * q0
        e1 = d1 - d0 - q0
        e2 = q1 - q0
        c3 = 10.0 * e0 - 4.0 * e1 + 0.5 * e2
        c4 = -15.0 * e0 + 7.0 * e1 - e2
        c5 = 6.0 * e0 - 3.0 * e1 + 0.5 * e2
        out[0, axis] = p0 + x * (d0 + x * (0.5 * q0 + x * (c3 + x * (c4 + x * c5))))
        out[1, axis] = (d0 + x * (q0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))) / step
        second = q0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))
        out[2, axis] = second / step**2
        out[3, axis] = (6.0 * c3 + x * (24.0 * c4 + x * 60.0 * c5)) / step**3


@njit(cache=True, nogil=True)
def _level_frame(
    r: FloatArray,
    tilt_east: float,
    tilt_north: float,
    f: FloatArray,
    df: FloatArray,
    C: FloatArray,
    w: FloatArray,
) -> tuple[float, float]:
    """Write the axes of a body that follows the road without lean, and their turn per metre.

    Forward along the road, left horizontal by the local vertical. Returns the lateral curvature
    (positive to the left) [1/m] and its derivative [1/m^2]. ``f`` and ``df`` (3,) are room.
    """
    # The spline's derivative is a unit vector to 1e-5 only; the attitude must be orthogonal.
    stretch = math.sqrt(r[1, 0] ** 2 + r[1, 1] ** 2 + r[1, 2] ** 2)
    for axis in range(3):
        f[axis] = r[1, axis] / stretch
    growth = (f[0] * r[2, 0] + f[1] * r[2, 1] + f[2] * r[2, 2]) / stretch
    for axis in range(3):
        df[axis] = r[2, axis] / stretch - growth * f[axis]
    n0, n1 = tilt_east * r[0, 0], tilt_north * r[0, 1]
    m0, m1 = tilt_east * r[1, 0], tilt_north * r[1, 1]
    # left = n x f / |n x f| with the vertical n = (n0, n1, 1) and its derivative m = (m0, m1, 0)
    a0, a1, a2 = n1 * f[2] - f[1], f[0] - n0 * f[2], n0 * f[1] - n1 * f[0]
    b0 = m1 * f[2] + n1 * df[2] - df[1]
    b1 = df[0] - m0 * f[2] - n0 * df[2]
    b2 = m0 * f[1] + n0 * df[1] - m1 * f[0] - n1 * df[0]
    size = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    l0, l1, l2 = a0 / size, a1 / size, a2 / size
    along = l0 * b0 + l1 * b1 + l2 * b2
    k0, k1, k2 = (b0 - along * l0) / size, (b1 - along * l1) / size, (b2 - along * l2) / size
    u0 = f[1] * l2 - f[2] * l1
    u1 = f[2] * l0 - f[0] * l2
    u2 = f[0] * l1 - f[1] * l0
    C[0, 0], C[1, 0], C[2, 0] = f[0], f[1], f[2]
    C[0, 1], C[1, 1], C[2, 1] = l0, l1, l2
    C[0, 2], C[1, 2], C[2, 2] = u0, u1, u2
    w[0] = u0 * k0 + u1 * k1 + u2 * k2
    w[1] = -(u0 * df[0] + u1 * df[1] + u2 * df[2])
    w[2] = l0 * df[0] + l1 * df[1] + l2 * df[2]
    bending = (l0 * r[3, 0] + l1 * r[3, 1] + l2 * r[3, 2]) / stretch - 2.0 * growth * w[2]
    return w[2], bending + k0 * df[0] + k1 * df[1] + k2 * df[2]


@njit(cache=True, nogil=True)
def _turn(C: FloatArray, w: FloatArray, axis: int, angle: float, rate: float) -> None:
    """Turn a body about one of its own axes; its attitude and rate in place."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    sine, cosine = math.sin(angle), math.cos(angle)
    for row in range(3):
        a, b = C[row, i], C[row, j]
        C[row, i], C[row, j] = cosine * a + sine * b, cosine * b - sine * a
    a, b = w[i], w[j]
    w[i], w[j] = cosine * a + sine * b, cosine * b - sine * a
    w[axis] += rate


@njit(cache=True, nogil=True)
def _shake(lines: FloatArray, time: float, out: FloatArray) -> None:
    """Write heave [m], its first two derivatives, pitch [rad] and its rate into ``out`` (5,)."""
    out[:] = 0.0
    for k in range(lines.shape[0]):
        w = lines[k, 0]
        s, c = math.sin(w * time), math.cos(w * time)
        heave = lines[k, 1] * c + lines[k, 2] * s
        out[0] += heave
        out[1] += w * (lines[k, 2] * c - lines[k, 1] * s)
        out[2] -= w * w * heave
        out[3] += lines[k, 3] * c + lines[k, 4] * s
        out[4] += w * (lines[k, 4] * c - lines[k, 3] * s)


@njit(cache=True, nogil=True)
def fill_kinematics(
    time: FloatArray,
    phases: FloatArray,
    nodes: FloatArray,
    step: float,
    tilt: tuple[float, float],
    lean: float,
    lines: FloatArray,
    fade: float,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    attitude: FloatArray,
    rate: FloatArray,
) -> None:
    """Write the kinematics at times [s] (m,); see `deepseis_sim.vehicle_path.VehicleMotion`."""
    r, C, w, shake = np.empty((4, 3)), np.empty((3, 3)), np.empty(3), np.zeros(5)
    f, df = np.empty(3), np.empty(3)
    phase = 0
    for i in range(time.size):
        phase, s, v, a, jerk = travel(phases, phase, time[i])
        road_point(nodes, step, s, r)
        curvature, bending = _level_frame(r, tilt[0], tilt[1], f, df, C, w)
        for axis in range(3):
            position[i, axis] = r[0, axis]
            velocity[i, axis] = v * r[1, axis]
            acceleration[i, axis] = a * r[1, axis] + v * v * r[2, axis]
            w[axis] *= v
        if lines.shape[0] and v > 0.0:
            _shake(lines, time[i], shake)
            # gain v^2 / (v^2 + fade^2), its slope and curvature by speed, then by time
            room = v * v + fade * fade
            g = v * v / room
            slope = 2.0 * v * fade**2 / room**2
            dg = slope * a
            ddg = slope * jerk + 2.0 * fade**2 * (fade**2 - 3.0 * v * v) / room**3 * a * a
            position[i, 2] += g * shake[0]
            velocity[i, 2] += g * shake[1] + dg * shake[0]
            acceleration[i, 2] += g * shake[2] + 2.0 * dg * shake[1] + ddg * shake[0]
            _turn(C, w, 1, g * shake[3], g * shake[4] + dg * shake[3])
        lean_rate = lean * (bending * v * v * v + 2.0 * curvature * v * a)
        _turn(C, w, 0, lean * curvature * v * v, lean_rate)
        attitude[i] = C
        rate[i] = w
