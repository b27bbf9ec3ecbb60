"""Mechanisation without gyroscopes (numba); see `deepseis_ins.gyrofree`."""

from __future__ import annotations

import math

from numba import njit

POSITION = 0  # east, north, up [m]
VELOCITY = 3  # [m/s]
BIAS = 6  # of the accelerometers, along east, north, up [m/s^2]
DRIFT = 9  # of GNSS positions [m]
ACCELERATION = 12  # mean of the interval before [m/s^2]
INTERVAL = 15  # its length [s]; 0: there is none
SIZE = 16

GRAVITY = 0  # of the model: at the origin, up [m/s^2]
GRADIENT = 1  # three: change of gravity along east, north, up [1/s^2]
EARTH_RATE = 4  # three [rad/s]
BIAS_RATE = 7  # three: inverses of correlation times [1/s]
DRIFT_RATE = 10  # three
MODEL_SIZE = 13


@njit(cache=True, nogil=True)
def mechanise_kernel(x, model, C, delta_vel, dt, position, velocity, acceleration):  # type: ignore[no-untyped-def]
    """Carry the state over m intervals and fill what it is at the end of each, shapes (m, 3).

    Parameters
    ----------
    x
        State, shape (16,).
    model
        Shape (13,).
    C
        Body to east, north, up, shape (3, 3).
    delta_vel, dt
        Increments as measured, body [m/s], shape (m, 3), and intervals [s], shape (m,).
    """
    gained = [0.0, 0.0, 0.0]
    for i in range(delta_vel.shape[0]):
        t, h = dt[i], x[INTERVAL]
        for k in range(3):
            force = C[k, 0] * delta_vel[i, 0] + C[k, 1] * delta_vel[i, 1]
            force += C[k, 2] * delta_vel[i, 2]
            middle = x[POSITION + k] + 0.5 * t * x[VELOCITY + k]
            gained[k] = force + (model[GRADIENT + k] * middle - x[BIAS + k]) * t
        gained[2] += model[GRAVITY] * t
        east = x[VELOCITY] + 0.5 * gained[0]
        north = x[VELOCITY + 1] + 0.5 * gained[1]
        up = x[VELOCITY + 2] + 0.5 * gained[2]
        a, b, c = model[EARTH_RATE], model[EARTH_RATE + 1], model[EARTH_RATE + 2]
        gained[0] -= 2.0 * t * (b * up - c * north)
        gained[1] -= 2.0 * t * (c * east - a * up)
        gained[2] -= 2.0 * t * (a * north - b * east)
        for k in range(3):
            mean = gained[k] / t
            # Acceleration along a straight line through the means of two intervals.
            slope = (mean - x[ACCELERATION + k]) / (0.5 * (h + t)) if h > 0.0 else 0.0
            x[POSITION + k] += t * (x[VELOCITY + k] + 0.5 * gained[k] - slope * t * t / 12.0)
            x[VELOCITY + k] += gained[k]
            x[ACCELERATION + k] = mean
            x[BIAS + k] *= math.exp(-t * model[BIAS_RATE + k])
            x[DRIFT + k] *= math.exp(-t * model[DRIFT_RATE + k])
            position[i, k] = x[POSITION + k]
            velocity[i, k] = x[VELOCITY + k]
            acceleration[i, k] = mean
        x[INTERVAL] = t
