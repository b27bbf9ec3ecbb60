"""A GPS constellation of the bench's own, so that a demo needs no file from outside.

The 24 slots of the standard constellation [1]_ and six spares, with eccentricities, inclination
offsets, harmonic corrections, clocks and group delays drawn from a seed in the ranges that real
satellites show. What is drawn is not a forecast of any real satellite.

References
----------
.. [1] "GPS Standard Positioning Service Performance Standard", 4th ed., 2008, table A.2-1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from deepseis_core.constants import GPS_EARTH_RATE, NS_PER_S, S_PER_WEEK
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import quantise
from deepseis_core.types import Ephemeris

SLOTS_DEG: Final[tuple[tuple[float, tuple[float, ...]], ...]] = (
    (272.847, (268.126, 161.786, 11.676, 41.806, 102.0)),
    (332.847, (80.956, 173.336, 309.976, 204.376, 22.0)),
    (32.847, (111.876, 11.796, 339.666, 241.556, 176.0)),
    (92.847, (135.226, 265.446, 35.156, 167.356, 321.0)),
    (152.847, (197.046, 302.596, 66.066, 333.686, 138.0)),
    (212.847, (238.886, 345.226, 105.206, 135.346, 50.0)),
)
"""Right ascension of each plane's node, and the arguments of latitude in it, the last a spare,
at 1993-07-01 00:00 UTC [degrees]."""

SEMI_MAJOR_AXIS: Final = 26_559_710.0
"""Semi-major axis of the slots [m]."""

MEAN_MOTION: Final = 1.458_506e-4
"""Mean motion with the secular effect of the Earth's oblateness [rad/s]: the ground track
repeats after a sidereal day."""

NODE_RATE: Final = -8.1e-9
"""Rate of right ascension of the nodes [rad/s]."""

FRAME_S: Final = 30
FIT_PERIOD: Final = 7200
"""Reference times are multiples of this [s]."""

KLOBUCHAR_ALPHA: Final = (12 * 2.0**-30, 2 * 2.0**-27, -1 * 2.0**-24, -2 * 2.0**-24)
KLOBUCHAR_BETA: Final = (48 * 2.0**11, 8 * 2.0**14, -1 * 2.0**16, -6 * 2.0**16)
"""Ionosphere of an ordinary day: 11 ns at night, about 35 ns at noon at mid latitude."""

_SLOT_EPOCH: Final = GpsTime.from_utc_calendar(1993, 7, 1)


def nominal_constellation(time: GpsTime, *, seed: int = 1) -> list[Ephemeris]:
    """Make the broadcast ephemerides of 30 healthy satellites, G01 to G30.

    Parameters
    ----------
    time : GpsTime
        The reference time is the multiple of two hours nearest to it.
    seed : int, optional
        Of orbits and clocks.

    Returns
    -------
    list of Ephemeris
        In the resolution of the navigation message: a receiver decodes exactly these.

    Examples
    --------
    >>> sky = nominal_constellation(GpsTime(2399, 346258 * 10**9))
    >>> len(sky), sky[0].satellite, sky[0].toe
    (30, 'G01', 345600.0)
    """
    rng = np.random.default_rng(seed)
    toe = round(time.tow_s() / FIT_PERIOD) * FIT_PERIOD
    week, toe = time.week + toe // S_PER_WEEK, toe % S_PER_WEEK
    since = GpsTime(week, toe * NS_PER_S).diff_ns(_SLOT_EPOCH) / 1e9
    prns = 1 + rng.permutation(30)
    sky = []
    for plane, (node, latitudes) in enumerate(SLOTS_DEG):
        for slot, latitude in enumerate(latitudes):
            prn = int(prns[5 * plane + slot])
            argument = np.deg2rad(latitude) + MEAN_MOTION * since
            sky.append(_ephemeris(rng, prn, week, toe, np.deg2rad(node), argument, since))
    sent = float(time.tow_ns // NS_PER_S // FRAME_S * FRAME_S)
    sky = [replace(quantise(item), transmit_tow=sent) for item in sky]
    return sorted(sky, key=lambda item: item.satellite)


def _ephemeris(
    rng: np.random.Generator,
    prn: int,
    week: int,
    toe: int,
    node: float,
    argument: float,
    since: float,
) -> Ephemeris:
    """Draw what tells a real satellite from its slot."""
    eccentricity = rng.uniform(0.001, 0.015)
    perigee = rng.uniform(-np.pi, np.pi)
    mean_anomaly = argument - perigee - 2.0 * eccentricity * np.sin(argument - perigee)
    harmonics = rng.uniform(-1.0, 1.0, 6) * (6e-6, 8e-6, 250.0, 80.0, 2e-7, 2e-7)
    issue = int(rng.integers(1, 240))
    node_at_week = node + NODE_RATE * since - _sidereal_angle(since - toe)
    return Ephemeris(
        satellite=f"G{prn:02d}",
        week=week,
        toe=float(toe),
        toc=float(toe),
        af0=rng.uniform(-5e-4, 5e-4),
        af1=rng.uniform(-8e-12, 8e-12),
        af2=0.0,
        tgd=rng.uniform(-1.4e-8, 6e-9),
        sqrt_a=float(np.sqrt(SEMI_MAJOR_AXIS)),
        eccentricity=eccentricity,
        i0=np.deg2rad(55.0 + rng.uniform(-1.0, 1.0)),
        omega0=_wrap(node_at_week),
        omega=_wrap(perigee),
        m0=_wrap(mean_anomaly),
        delta_n=rng.uniform(4.0e-9, 5.5e-9),
        omega_dot=NODE_RATE + rng.uniform(-4e-10, 4e-10),
        i_dot=rng.uniform(-4e-10, 4e-10),
        cuc=harmonics[0],
        cus=harmonics[1],
        crc=harmonics[2],
        crs=harmonics[3],
        cic=harmonics[4],
        cis=harmonics[5],
        iode=issue,
        iodc=issue,
        iono_alpha=KLOBUCHAR_ALPHA,
        iono_beta=KLOBUCHAR_BETA,
    )


def _sidereal_angle(since_slot_epoch: float) -> float:
    """Greenwich sidereal angle: 278.8 degrees at the slots' epoch, then the Earth's rate."""
    return np.deg2rad(278.8) + GPS_EARTH_RATE * since_slot_epoch


def _wrap(angle: float) -> float:
    """Bring an angle into -pi .. pi."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
