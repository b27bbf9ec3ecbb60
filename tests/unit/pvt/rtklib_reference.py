"""RTKLIB's single-point positioning on a RINEX file, epoch by epoch.

RTKLIB takes observations less than ``DTTOL`` (25 ms) apart for one epoch, so above 40 Hz its own
loop merges epochs: here they are taken apart by their exact times and solved one by one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import pyrtklib as rtk


@dataclass(frozen=True)
class Epoch:
    """One epoch: GPS week, seconds of week, observations by satellite, RTKLIB's solution."""

    week: int
    tow: float
    values: dict[str, tuple[float, float, float, float, int]]
    position_ecef: np.ndarray | None
    velocity_ecef: np.ndarray | None
    clock_bias: float


def epochs(
    obs_path: Path, nav_path: Path, *, elevation_mask_deg: float = 10.0, atmosphere: bool = True
) -> Iterator[Epoch]:
    """Yield every epoch: C1C, L1C, D1C, S1C, LLI of GPS satellites and the solution."""
    obs, nav, station = rtk.obs_t(), rtk.nav_t(), rtk.sta_t()
    assert rtk.readrnx(str(obs_path), 1, "", obs, nav, station) > 0
    assert rtk.readrnx(str(nav_path), 1, "", obs, nav, station) > 0
    rtk.uniqnav(nav)
    options = settings(elevation_mask_deg, atmosphere)
    start = 0
    for _, group in groupby(range(obs.n), key=lambda i: exact_time(obs.data[i])):
        count = len(list(group))
        yield solve(obs, start, count, nav, options)
        start += count


def settings(elevation_mask_deg: float, atmosphere: bool) -> rtk.prcopt_t:
    """Return RTKLIB's options for GPS single-point positioning."""
    options = rtk.prcopt_default
    options.mode, options.navsys, options.nf = rtk.PMODE_SINGLE, rtk.SYS_GPS, 1
    options.ionoopt = rtk.IONOOPT_BRDC if atmosphere else rtk.IONOOPT_OFF
    options.tropopt = rtk.TROPOPT_SAAS if atmosphere else rtk.TROPOPT_OFF
    options.elmin = np.radians(elevation_mask_deg)
    # Code noise 0.3 m and 0.3 m/sqrt(sin(elevation)).
    options.eratio[0], options.err[1], options.err[2] = 100.0, 0.003, 0.003
    return options


def exact_time(observation: rtk.obsd_t) -> int:
    """Return the time of an observation in units of 100 ns, as RINEX has it."""
    return observation.time.time * 10_000_000 + round(observation.time.sec * 1e7)


def solve(obs: rtk.obs_t, start: int, count: int, nav: rtk.nav_t, options: rtk.prcopt_t) -> Epoch:
    """Return one epoch's solution by ``pntpos``."""
    solution, message = rtk.sol_t(), rtk.Arr1Dchar(256)
    azel, status = rtk.Arr1Ddouble(2 * count), rtk.Arr1Dssat_t(rtk.MAXSAT)
    first = obs.data[start]
    found = rtk.pntpos(first, count, nav, options, solution, azel, status[0], message)
    values = {}
    for i in range(start, start + count):
        d, name = obs.data[i], rtk.Arr1Dchar(8)
        rtk.satno2id(d.sat, name)
        values[name.ptr] = (d.P[0], d.L[0], d.D[0], d.SNR[0] * rtk.SNR_UNIT, d.LLI[0])
    week = rtk.Arr1Dint(1)
    when = obs.data[start].time
    tow = rtk.time2gpst(when, week)
    state = np.array([solution.rr[i] for i in range(6)]) if found else None
    return Epoch(
        week=week[0],
        tow=tow,
        values=values,
        position_ecef=None if state is None else state[:3],
        velocity_ecef=None if state is None else state[3:],
        clock_bias=solution.dtr[0] * 299792458.0,
    )
