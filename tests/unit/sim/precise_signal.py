"""A received carrier and code from IS-GPS-200 in extended precision: nothing of ours is in it.

Orbit and clock are the user algorithms of table 20-IV and section 20.3.3.3.3, the flight is solved
by fixed-point iteration with the satellite turned by the Earth's rotation meanwhile. Extended
double has 64 bits: a phase of 1e8 cycles keeps 1e-11.
"""

import numpy as np

REAL = np.longdouble
C = REAL(299792458)
GM = REAL("3.986005e14")
EARTH_RATE = REAL("7.2921151467e-5")
RELATIVITY = REAL("-4.442807633e-10")
L1 = REAL(1575420000)
CHIPS = REAL(1023000)


def eccentric(mean, e):
    anomaly = mean
    for _ in range(30):
        anomaly = mean + e * np.sin(anomaly)
    return anomaly


def satellite(eph, t):
    """Return ECEF [m], shape (3, m), and clock offset [s] at seconds of week (longdouble)."""
    sqrt_a, e = REAL(eph.sqrt_a), REAL(eph.eccentricity)
    tk = t - REAL(eph.toe)
    n = np.sqrt(GM) / sqrt_a**3 + REAL(eph.delta_n)
    ek = eccentric(REAL(eph.m0) + n * tk, e)
    nu = np.arctan2(np.sqrt(1 - e * e) * np.sin(ek), np.cos(ek) - e)
    phi = nu + REAL(eph.omega)
    s2, c2 = np.sin(2 * phi), np.cos(2 * phi)
    u = phi + REAL(eph.cus) * s2 + REAL(eph.cuc) * c2
    r = sqrt_a**2 * (1 - e * np.cos(ek)) + REAL(eph.crs) * s2 + REAL(eph.crc) * c2
    i = REAL(eph.i0) + REAL(eph.cis) * s2 + REAL(eph.cic) * c2 + REAL(eph.i_dot) * tk
    node = REAL(eph.omega0) + (REAL(eph.omega_dot) - EARTH_RATE) * tk - EARTH_RATE * REAL(eph.toe)
    x, y = r * np.cos(u), r * np.sin(u)
    place = np.stack(
        [
            x * np.cos(node) - y * np.cos(i) * np.sin(node),
            x * np.sin(node) + y * np.cos(i) * np.cos(node),
            y * np.sin(i),
        ]
    )
    tc = t - REAL(eph.toc)
    clock = REAL(eph.af0) + REAL(eph.af1) * tc + REAL(eph.af2) * tc**2
    clock += RELATIVITY * e * sqrt_a * np.sin(ek) - REAL(eph.tgd)
    return place, clock


def received(eph, tow, antenna, time, bias=0.0, drift=0.0):
    """Return carrier phase [cycles] (initial phase zero) and time sent by the satellite's clock.

    ``time`` [s], longdouble, is the receiver's since second ``tow`` of the week; ``antenna`` gives
    ECEF (3, m) at true seconds since then; time sent counts from ``tow`` as well.
    """
    clock = REAL(bias) + REAL(drift) * time
    true = time - clock
    place = antenna(true)
    flight = np.full(true.shape, REAL("0.07"))
    for _ in range(6):
        (x, y, z), offset = satellite(eph, REAL(tow) + true - flight)
        turn = EARTH_RATE * flight
        turned = np.stack(
            [x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn), z]
        )
        flight = np.sqrt(((turned - place) ** 2).sum(axis=0)) / C
    return L1 * (offset - flight - clock), true - flight + offset
