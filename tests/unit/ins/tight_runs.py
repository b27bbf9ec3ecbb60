"""Ranges of simulated satellites for the tightly coupled filter, and its true errors."""

import numpy as np
from unit.ins import loose_runs as runs

from deepseis_core.constants import L1_HZ, NS_PER_S, SPEED_OF_LIGHT
from deepseis_core.ephemeris import pack, states_from_pseudoranges
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.rotation import flu_from_frd
from deepseis_ins.tight import Ranges
from deepseis_sim.sky import broadcast_ephemerides

START = GpsTime(2399, 415258 * NS_PER_S)
RANGE_SD, RATE_SD = 1.0, 0.05
CLOCK_NOISE = 0.1, 0.2  # of bias and drift, as TightConfig has by default


def visible(count=None, mask_deg=10.0, site=runs.SITE.origin_ecef):
    """Return packed ephemerides, the highest first."""
    packed = pack(broadcast_ephemerides("", START))
    elevation = line_of_sight(packed, START.week, START.tow_ns, site).elevation
    order = np.argsort(-elevation)
    return packed[order[elevation[order] > np.radians(mask_deg)]][:count]


def observed(packed, time, receiver, bias, drift):
    """Return pseudoranges, range rates and satellites of a receiver, ECEF (6,), without noise.

    ``time`` is GPS time since START [s]; clock bias [m] and drift [m/s]. No atmosphere.
    """
    ns = START.tow_ns + round(time * 1e9)
    sight = line_of_sight(packed, START.week, ns, receiver)
    pseudorange = sight.range + bias - SPEED_OF_LIGHT * sight.satellite_clock
    rate = -SPEED_OF_LIGHT / L1_HZ * sight.doppler_hz
    range_rate = (rate + drift) / (1.0 + drift / SPEED_OF_LIGHT)
    shown = ns + round(bias / SPEED_OF_LIGHT * 1e9)
    return pseudorange, range_rate, states_from_pseudoranges(packed, START.week, shown,
                                                             pseudorange)  # fmt: skip


def antenna(motion, time, lever_b):
    """Return position and velocity, ECEF, shape (6,)."""
    at = runs.SITE.ecef(motion.at(np.array([time])), flu_from_frd(lever_b))
    return np.hstack([at.position[0], at.velocity[0]])


class Receiver:
    """Noisy ranges with a clock that wanders as the filter is told."""

    def __init__(self, motion, packed, seed, *, lever_b=runs.LEVER, noise=CLOCK_NOISE):
        self.motion, self.packed, self.lever_b, self.noise = motion, packed, lever_b, noise
        self.rng = np.random.default_rng([seed, 11])
        self.bias, self.drift = 3.0e4 * self.rng.standard_normal(), 30.0
        self.time = 0.0

    def at(self, time, keep=None):
        """Return an epoch; times go on."""
        dt, rng = time - self.time, self.rng
        q_b, q_d = self.noise[0] ** 2, self.noise[1] ** 2
        cross = q_d * dt**2 / 2
        Q = np.array([[q_b * dt + q_d * dt**3 / 3, cross], [cross, q_d * dt]])
        wander = np.linalg.cholesky(Q + 1e-18 * np.eye(2)) @ rng.standard_normal(2)
        self.bias += dt * self.drift + wander[0]
        self.drift += wander[1]
        self.time = time
        packed = self.packed[:keep]
        receiver = antenna(self.motion, time, self.lever_b)
        pr, rate, satellites = observed(packed, time, receiver, self.bias, self.drift)
        n = len(pr)
        return Ranges(
            satellites,
            pr + RANGE_SD * rng.standard_normal(n),
            rate + RATE_SD * rng.standard_normal(n),
            np.full(n, RANGE_SD),
            np.full(n, RATE_SD),
        )
