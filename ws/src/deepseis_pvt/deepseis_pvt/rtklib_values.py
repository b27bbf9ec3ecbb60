"""Our values as RTKLIB's structures, and back (pyrtklib)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib as rtklib

from deepseis_core.errors import InputError
from deepseis_core.types import Ephemeris, FloatArray, Lli, Observations

ROVER, BASE = 1, 2
"""RTKLIB's numbers of the receivers."""


def gpst(week: int, seconds: float) -> Any:
    """Return GPS time as RTKLIB's; seconds of week."""
    return rtklib.gpst2time(week, seconds)


def ephemeris_of(value: Ephemeris, into: Any) -> None:
    """Fill RTKLIB's ephemeris (``eph_t``)."""
    toc_week = value.week + round((value.toe - value.toc) / 604800.0)
    sent_week = value.week + round((value.toe - value.transmit_tow) / 604800.0)
    into.sat = rtklib.satid2no(value.satellite)
    into.iode, into.iodc, into.svh, into.week = value.iode, value.iodc, value.health, value.week
    into.sva = _accuracy_index(value.accuracy)
    into.code, into.flag = value.l2_code, value.l2p_flag
    into.toe, into.toes = gpst(value.week, value.toe), value.toe
    into.toc, into.ttr = gpst(toc_week, value.toc), gpst(sent_week, value.transmit_tow)
    into.A, into.e, into.i0 = value.sqrt_a**2, value.eccentricity, value.i0
    into.OMG0, into.omg, into.M0 = value.omega0, value.omega, value.m0
    into.deln, into.OMGd, into.idot = value.delta_n, value.omega_dot, value.i_dot
    into.crc, into.crs, into.cuc, into.cus = value.crc, value.crs, value.cuc, value.cus
    into.cic, into.cis = value.cic, value.cis
    into.f0, into.f1, into.f2 = value.af0, value.af1, value.af2
    into.fit = 4.0 if value.fit_interval_flag == 0 else 6.0
    into.tgd[0] = value.tgd


def _accuracy_index(metres: float) -> int:
    """Return the URA index of an accuracy (IS-GPS-200, 20.3.3.3.1.3).

    Examples
    --------
    >>> _accuracy_index(2.0), _accuracy_index(2.4), _accuracy_index(3.4), _accuracy_index(1e9)
    (0, 0, 1, 15)
    """
    limits = [2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0, 384.0, 768.0, 1536.0]
    limits += [3072.0, 6144.0]
    return int(np.searchsorted(limits, metres))


class Navigation:
    """Orbits for RTKLIB.

    Attributes
    ----------
    nav : nav_t
        RTKLIB's.
    """

    def __init__(self) -> None:
        self.nav = rtklib.nav_t()
        self._held: Any = None

    def set(self, ephemerides: Sequence[Ephemeris], klobuchar: FloatArray | None) -> None:
        """Take the ephemerides and the ionosphere in force."""
        held = rtklib.Arr1Deph_t(max(1, len(ephemerides)))
        for place, value in enumerate(ephemerides):
            ephemeris_of(value, held[place])
        self._held = held  # RTKLIB has the address only
        self.nav.eph, self.nav.n, self.nav.nmax = held, len(ephemerides), len(ephemerides)
        for i in range(8):
            self.nav.ion_gps[i] = 0.0 if klobuchar is None else float(klobuchar[i])


def fill_observations(
    values: Observations, receiver: int, into: Any, first: int, slipped: Iterable[str] = ()
) -> int:
    """Fill RTKLIB's observations (``obsd_t``) of an epoch, GPS L1; return how many.

    Satellites whose phases may be half a cycle off are left out: RTKLIB would fix them as well.
    So are those without a pseudorange or C/N0.

    Parameters
    ----------
    values : Observations
        Of one receiver.
    receiver : int
        ``ROVER`` or ``BASE``.
    into : Arr1Dobsd_t
        From place ``first`` on.
    slipped : iterable of str
        Satellites whose phases are known to have slipped, whatever their marks say.
    """
    o, slips, count = values, set(slipped), 0
    time = gpst(o.week, o.tow_ns * 1e-9)
    whole = np.isfinite(o.pseudorange + o.cn0_dbhz).tolist()
    # A phase or Doppler that is not there is zero to RTKLIB.
    carriers = [
        np.where(np.isfinite(field), field, 0.0).tolist()
        for field in (o.carrier_phase_cycles, o.carrier_doppler_hz)
    ]
    rows = zip(
        whole, o.satellites, o.pseudorange.tolist(), *carriers, o.cn0_dbhz.tolist(),
        o.lli.tolist(), strict=True,
    )  # fmt: skip
    for is_whole, name, code, carrier, doppler, cn0, lli in rows:
        number = rtklib.satid2no(name)
        if not is_whole or number <= 0 or lli & Lli.HALF_CYCLE:
            continue
        d = into[first + count]
        d.time, d.sat, d.rcv = time, number, receiver
        d.P[0], d.L[0], d.D[0] = code, carrier, doppler
        d.SNR[0] = round(max(cn0, 0.0) / rtklib.SNR_UNIT)
        d.LLI[0] = lli | (int(Lli.SLIP) if name in slips else 0)
        d.code[0] = rtklib.CODE_L1C
        count += 1
    return count


def read_observations(
    path: str | Path, receiver: int, nav: Any
) -> tuple[Any, dict[int, list[int]]]:
    """Read a RINEX file's observations, and which of them belong to which epoch.

    Returns
    -------
    tuple
        ``obs_t``, and places by time [100 ns]: exact, where RTKLIB takes up to 25 ms for one; in
        order of RTKLIB's numbers of satellites, as ``rtkpos`` needs them.

    Raises
    ------
    InputError
        There are none.
    """
    obs = rtklib.obs_t()
    if not Path(path).is_file():
        raise InputError(path, "does not exist")
    if rtklib.readrnx(str(path), receiver, "", obs, nav, rtklib.sta_t()) <= 0 or obs.n == 0:
        raise InputError(path, "holds no observations that RTKLIB can read")
    groups = groupby(range(obs.n), key=lambda i: exact_time(obs.data[i].time))
    return obs, {time: sorted(group, key=lambda i: int(obs.data[i].sat)) for time, group in groups}


def read_navigation(path: str | Path, nav: Any) -> None:
    """Add a RINEX navigation file's orbits.

    Raises
    ------
    InputError
        It has none.
    """
    if not Path(path).is_file():
        raise InputError(path, "does not exist")
    before = nav.n + nav.ng
    if rtklib.readrnx(str(path), 0, "", rtklib.obs_t(), nav, rtklib.sta_t()) <= 0:
        raise InputError(path, "holds no orbits that RTKLIB can read")
    rtklib.uniqnav(nav)
    if nav.n + nav.ng <= before:
        raise InputError(path, "adds no orbits")


def exact_time(time: Any) -> int:
    """Return RTKLIB's time in units of 100 ns, as RINEX has it."""
    return int(time.time) * 10_000_000 + round(time.sec * 1e7)


def satellite_name(number: int) -> str:
    """Return a satellite's name by RTKLIB's number."""
    name = rtklib.Arr1Dchar(8)
    rtklib.satno2id(number, name)
    return str(name.ptr)
