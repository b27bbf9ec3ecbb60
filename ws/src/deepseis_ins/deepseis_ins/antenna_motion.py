"""The antenna's motion at the knots of a span, from the inertial solution at IMU epochs.

The mechanisation gives position, velocity and attitude at the epochs. A polynomial through the
velocities of neighbouring epochs, and another through the lever arms, both in ECEF, give ::

    r = r_imu + C l,    v = v_imu + d(C l)/dt,    a = dv_imu/dt + d^2(C l)/dt^2

as plain derivatives of ECEF coordinates: ``dv_imu/dt`` is the kinematic acceleration, specific
force with gravity added and Coriolis' acceleration taken off, and the derivatives of ``C l`` hold
``w x l``, its centripetal and its tangential part, and the Earth's turn. The velocity so found,
integrated over an interval, is what mechanisation and lever arm moved: noise of the gyros shows
in it, but does not add up in the phase.

No epoch lies beyond the end of a span (nothing later may count), so its last interval is
one-sided. With n points the velocity of a shaking A sin(wt) is then off by ``A (w T)^n / n!``
times the largest value of ``|s (s + 1) .. (s + n - 1)|`` for -1 < s < 0 at worst: 1, 3.6 and 17
for n = 4, 5 and 6 (`one_sided_error`). At 2 g and 10 Hz and 200 epochs a second that is 0.12,
0.03 and 0.006 mm/s, and a tenth or less of it where the points lie on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import factorial

import numpy as np

from deepseis_core.types import FloatArray, IntArray
from deepseis_ins.fusion_kernels import ecef_nodes_kernel
from deepseis_ins.strapdown import Trajectory

VELOCITY_POINTS = 6
"""Epochs that a polynomial of velocity goes through."""
LEVER_POINTS = 3
"""The same of the lever arm, which is derived once more: fewer, for the noise of the gyros."""
BEYOND_POINTS = 3
"""The same where a knot lies beyond the last epoch."""
_CACHED = 64


@dataclass(frozen=True)
class Nodes:
    """The IMU at n epochs, ECEF relative to ``origin``.

    Attributes
    ----------
    sample_index : ndarray of int64, shape (n,)
        Increasing.
    origin : ndarray, shape (3,)
        [m], some place near.
    position, velocity, lever_arm : ndarray, shape (n, 3)
        Position from the origin [m], its plain derivative [m/s], from IMU to antenna [m].
    """

    sample_index: IntArray
    origin: FloatArray
    position: FloatArray
    velocity: FloatArray
    lever_arm: FloatArray

    @classmethod
    def of(
        cls,
        sample_index: IntArray,
        trajectory: Trajectory,
        lever_arm_b: FloatArray,
        origin: FloatArray,
    ) -> Nodes:
        """Turn a trajectory into ECEF; ``lever_arm_b`` forward-right-down [m]."""
        n = len(sample_index)
        position, velocity, lever = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
        ecef_nodes_kernel(
            trajectory.geodetic, trajectory.vel_n, trajectory.quat_nb, lever_arm_b, origin,
            position, velocity, lever,
        )  # fmt: skip
        return cls(sample_index, origin, position, velocity, lever)


@dataclass
class KnotInterpolator:
    """Interpolates between epochs; keeps the weights of grids that come back.

    Parameters
    ----------
    sample_rate_hz : float
        [Hz]
    velocity_points, lever_points : int, optional
        Epochs in a polynomial.
    """

    sample_rate_hz: float
    velocity_points: int = VELOCITY_POINTS
    lever_points: int = LEVER_POINTS
    _kept: dict[tuple[int, bytes, bytes], FloatArray] = field(default_factory=dict, repr=False)

    def weights(self, nodes: IntArray, knots: IntArray, points: int) -> FloatArray:
        """Return what takes values at nodes to values, rates and second derivatives at knots.

        Parameters
        ----------
        nodes, knots : ndarray of int64, shapes (n,), (m,)
            Samples.
        points : int
            Nodes in a polynomial, at most.

        Returns
        -------
        ndarray, shape (3, m, n)
        """
        last = nodes[-1]
        key = points, (nodes - last).tobytes(), (knots - last).tobytes()
        found = self._kept.get(key)
        if found is None:
            if len(self._kept) >= _CACHED:
                self._kept.clear()
            time = (nodes - last) / self.sample_rate_hz
            found = polynomial_weights(time, (knots - last) / self.sample_rate_hz, points)
            self._kept[key] = found
        return found

    def antenna(self, nodes: Nodes, knots: IntArray) -> FloatArray:
        """Return the antenna at knots, shape (m, 9): columns of `aiding.DopplerPredictor`."""
        # Of the epochs before the first knot more than a polynomial's are of no use.
        used = np.searchsorted(nodes.sample_index, knots[0], "right") - self.velocity_points
        near = slice(max(0, int(used)), None)
        index = nodes.sample_index[near]
        W, D, _ = self.weights(index, knots, self.velocity_points)
        V, E, F = self.weights(index, knots, self.lever_points)
        velocity, lever = nodes.velocity[near], nodes.lever_arm[near]
        out = np.empty((len(knots), 9))
        out[:, 0:3] = nodes.origin + (W @ nodes.position[near] + V @ lever)
        out[:, 3:6] = W @ velocity + E @ lever
        out[:, 6:9] = D @ velocity + F @ lever
        return out

    def rate(self, sample_index: IntArray, values: FloatArray, knots: IntArray) -> FloatArray:
        """Return the rate of sums given at epochs, shape (n, k), at knots, shape (m, k)."""
        return self.weights(sample_index, knots, self.lever_points)[1] @ values


def polynomial_weights(nodes: FloatArray, knots: FloatArray, points: int) -> FloatArray:
    """Return weights of interpolation by piecewise polynomials and of its two derivatives.

    Parameters
    ----------
    nodes, knots : ndarray, shapes (n,), (m,)
        Times [s]; nodes increasing.
    points : int
        Nodes around a knot that its polynomial goes through, if there are so many; those of the
        end where there are none on one side, and `BEYOND_POINTS` beyond the end.

    Returns
    -------
    ndarray, shape (3, m, n)
        Of the value, its derivative [1/s] and second derivative [1/s^2].
    """
    out = np.zeros((3, len(knots), len(nodes)))
    for k, knot in enumerate(knots):
        inside = knot <= nodes[-1]
        count = min(points if inside else BEYOND_POINTS, len(nodes))
        interval = int(np.searchsorted(nodes, knot, "left"))
        first = int(np.clip(interval - count // 2, 0, len(nodes) - count))
        chosen = slice(first, first + count)
        scale = (nodes[chosen][-1] - nodes[chosen][0]) or 1.0
        powers = np.vander((nodes[chosen] - knot) / scale, count, increasing=True)
        # Row k of the inverse gives the polynomial's k-th coefficient at the knot.
        coefficients = np.linalg.inv(powers)
        for order in range(min(3, count)):
            out[order, k, chosen] = coefficients[order] * factorial(order) / scale**order
    return out


def one_sided_error(amplitude: float, frequency_hz: float, rate_hz: float, points: int) -> float:
    """Return how far a one-sided polynomial strays from a sine in its last interval, at worst.

    Examples
    --------
    2 g at 10 Hz by 4 and by 6 of 200 epochs a second [mm/s]:

    >>> [round(one_sided_error(1e3 * 19.6 / 62.8, 10.0, 200.0, n), 3) for n in (4, 6)]
    [0.127, 0.007]
    """
    s = np.linspace(-1.0, 0.0, 1001)
    product = np.prod([s + k for k in range(points)], axis=0)
    phase = 2.0 * np.pi * frequency_hz / rate_hz
    return float(amplitude * phase**points / factorial(points) * np.abs(product).max())
