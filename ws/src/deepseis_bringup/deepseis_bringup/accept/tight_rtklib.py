"""RTKLIB's single-point positions on the epochs of a drive: the peer."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyrtklib as rtk

from deepseis_bringup.accept.tight_drive import Drive, Observed
from deepseis_core.constants import L1_WAVELENGTH, NS_PER_S
from deepseis_core.rinex_nav import write_rinex_nav
from deepseis_core.types import FloatArray


def rtklib_positions(drive: Drive, mask_deg: float) -> FloatArray:
    """Return ECEF positions of all epochs, shape (m, 3) [m]; NaN where RTKLIB finds none.

    GPS L1 code, broadcast orbits, Saastamoinen; Klobuchar where the drive has its parameters.
    """
    o = drive.observed
    nav, options = _navigation(o), _options(mask_deg, ionosphere=o.klobuchar is not None)
    out = np.full((len(o.time), 3), np.nan)
    for k in range(len(o.time)):
        seen = np.flatnonzero(np.isfinite(o.pseudorange[k]))
        if seen.size < 4:
            continue
        position = _solve(o, k, seen.tolist(), nav, options)
        if position is not None:
            out[k] = position
    return out


def _navigation(o: Observed) -> rtk.nav_t:
    nav, nothing, station = rtk.nav_t(), rtk.obs_t(), rtk.sta_t()
    ionosphere = {}
    if o.klobuchar is not None:
        ionosphere = {
            "iono_alpha": tuple(o.klobuchar[:4].tolist()),
            "iono_beta": tuple(o.klobuchar[4:].tolist()),
        }
    with TemporaryDirectory() as folder:
        path = Path(folder) / "orbits.rnx"
        write_rinex_nav(path, o.ephemerides, **ionosphere)
        rtk.readrnx(str(path), 1, "", nothing, nav, station)
    rtk.uniqnav(nav)
    return nav


def _options(mask_deg: float, *, ionosphere: bool) -> rtk.prcopt_t:
    """Return options of single points, in a structure of our own: defaults are one for all."""
    options, default = rtk.prcopt_t(), rtk.prcopt_default
    options.maxgdop, options.maxinno = default.maxgdop, default.maxinno
    options.err[0], options.err[4] = 100.0, 1.0
    options.mode, options.navsys, options.nf = rtk.PMODE_SINGLE, rtk.SYS_GPS, 1
    options.ionoopt = rtk.IONOOPT_BRDC if ionosphere else rtk.IONOOPT_OFF
    options.tropopt = rtk.TROPOPT_SAAS
    options.elmin = np.radians(mask_deg)
    options.eratio[0], options.err[1], options.err[2] = 100.0, 0.003, 0.003
    return options


def _solve(
    o: Observed, k: int, seen: list[int], nav: rtk.nav_t, options: rtk.prcopt_t
) -> FloatArray | None:
    data = rtk.Arr1Dobsd_t(len(seen))
    time = rtk.gpst2time(o.week, float(o.tow_ns[k]) / NS_PER_S)
    for row, i in enumerate(seen):
        d = data[row]
        d.time, d.sat, d.rcv = time, rtk.satno(rtk.SYS_GPS, int(o.names[i][1:])), 1
        d.P[0], d.code[0] = float(o.pseudorange[k, i]), rtk.CODE_L1C
        d.D[0] = -float(o.range_rate[k, i]) / L1_WAVELENGTH
        d.SNR[0] = round(float(o.cn0_dbhz[k, i]) / rtk.SNR_UNIT)
    solution, message = rtk.sol_t(), rtk.Arr1Dchar(256)
    azel, status = rtk.Arr1Ddouble(2 * len(seen)), rtk.Arr1Dssat_t(rtk.MAXSAT)
    if not rtk.pntpos(data.ptr, len(seen), nav, options, solution, azel, status[0], message):
        return None
    return np.array([solution.rr[i] for i in range(3)])
