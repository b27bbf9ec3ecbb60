"""GPS LNAV subframes: ephemerides to bits and back.

Bits are numbered as in the standard, 1 to 300 of a subframe. As a signal, logic 0 is +1.

References
----------
IS-GPS-200, 20.3.3: subframes 1 to 3 tables 20-I and 20-III, page 18 figure 20-1 sheet 8.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepseis_core.constants import NS_PER_S, S_PER_WEEK
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav_words import (
    HANDOVER,
    IONO_FIELDS,
    IONO_PAGE_ID,
    PAGE_FIELDS,
    PREAMBLE,
    SUBFRAME_BITS,
    SUBFRAME_FIELDS,
    SUBFRAME_S,
    BitArray,
    add_parity,
    get_fields,
    put_raw,
    remove_parity,
    unsigned,
)
from deepseis_core.types import Ephemeris

# Upper bounds of user range accuracy 0 to 14 and nominal values [m] (20.3.3.3.1.3).
_URA_BOUND = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24, 48, 96, 192, 384, 768, 1536, 3072, 6144)
_URA_NOMINAL = (2, 2.8, 4, 5.7, 8, 11.3, *(float(2**n) for n in range(4, 14)))


@dataclass(frozen=True)
class UtcParameters:
    """Broadcast relation of GPS time to UTC (subframe 4 page 18); weeks are full weeks."""

    a0: float = 0.0
    a1: float = 0.0
    tot: float = 0.0
    week_t: int = 0
    leap_s: int = 18
    week_lsf: int = 0
    day_lsf: int = 1
    leap_lsf_s: int = 18

    @classmethod
    def at(cls, week: int, tow_s: int) -> UtcParameters:
        """Return those of a time [weeks, s of week]: no offset, nothing announced.

        Examples
        --------
        >>> UtcParameters.at(1626, 432_000).leap_s  # 2011-03-11
        15
        """
        leap_s = GpsTime(week, tow_s * NS_PER_S).leap_seconds()
        return cls(week_t=week, leap_s=leap_s, week_lsf=week, leap_lsf_s=leap_s)

    def told(self) -> tuple[GpsTime, int]:
        """Return GPS minus UTC [s], and a moment for which it is told.

        An announced leap second goes before what holds now: of that the last reference time may
        lie on its other side.

        Examples
        --------
        >>> UtcParameters(week_t=2400, leap_s=18, leap_lsf_s=18).told()
        (GpsTime(week=2400, tow_ns=0), 18)
        >>> when, leap_s = UtcParameters(leap_s=17, week_lsf=1929, day_lsf=7, leap_lsf_s=18).told()
        >>> when.to_utc_ns() - 1_483_228_800 * 10**9, leap_s  # a minute of GPS time later
        (42000000000, 18)
        """
        if self.leap_lsf_s != self.leap_s:
            after_ns = (self.day_lsf * 86_400 + 60) * NS_PER_S
            return GpsTime(self.week_lsf, after_ns), self.leap_lsf_s
        return GpsTime(self.week_t, round(self.tot * NS_PER_S)), self.leap_s


def ura_index(accuracy: float) -> int:
    """Return the user range accuracy index of an accuracy [m]."""
    return sum(bound < accuracy for bound in _URA_BOUND)


def transmit_week(ephemeris: Ephemeris, tow_s: float) -> int:
    """Return the week in which ``tow_s`` [s] lies within half a week of the ephemeris' toe."""
    return ephemeris.week + round((ephemeris.toe - tow_s) / S_PER_WEEK)


def encode_subframe(
    ephemeris: Ephemeris,
    tow_s: int,
    *,
    week: int | None = None,
    utc: UtcParameters | None = None,
    page_18_always: bool = False,
) -> BitArray:
    """Encode the subframe that starts at a time of week.

    Its number follows from the time (a frame of five starts every 30 s). Subframes 4 and 5 carry
    the dummy almanac, but page 18 of subframe 4 the ionosphere and UTC if ``ephemeris`` has the
    Klobuchar parameters.

    Parameters
    ----------
    ephemeris : Ephemeris
    tow_s : int
        Start of the subframe, GPS seconds of week [s], a multiple of 6.
    week : int, optional
        GPS week of transmission [weeks]; else the one nearest to toe.
    utc : UtcParameters, optional
        For page 18; else no offset and the leap seconds of that time.
    page_18_always : bool, optional
        Send page 18 in every frame rather than once in 12.5 minutes.

    Returns
    -------
    ndarray of uint8, shape (300,)
        Logic bits in the order of transmission.
    """
    if tow_s % SUBFRAME_S:
        raise ValueError(f"a subframe starts at a multiple of 6 s, not at {tow_s} s of week")
    tow_s %= S_PER_WEEK
    subframe_id, page = tow_s // SUBFRAME_S % 5 + 1, tow_s // 30 % 25 + 1
    bits = np.zeros(SUBFRAME_BITS, np.uint8)
    put_raw(bits, unsigned("preamble", 0, (1, 8)), PREAMBLE)
    next_tow_count = (tow_s // SUBFRAME_S + 1) % (S_PER_WEEK // SUBFRAME_S)
    put_raw(bits, HANDOVER[0], next_tow_count)
    put_raw(bits, HANDOVER[1], subframe_id)
    week = transmit_week(ephemeris, tow_s) if week is None else week
    if subframe_id <= 3:
        _put_ephemeris(bits, ephemeris, subframe_id, week)
    elif subframe_id == 4 and ephemeris.iono_alpha and (page_18_always or page == 18):
        _put_iono(bits, ephemeris, utc or UtcParameters.at(week, tow_s))
    else:
        _put_dummy(bits)
    return add_parity(bits)


def _put_ephemeris(bits: BitArray, ephemeris: Ephemeris, subframe_id: int, week: int) -> None:
    values = dataclasses.asdict(ephemeris)
    values["week"] = week % 1024
    values["ura"] = ura_index(ephemeris.accuracy)
    for field in SUBFRAME_FIELDS[subframe_id]:
        put_raw(bits, field, round(values[field.name] / field.unit))


def _put_iono(bits: BitArray, ephemeris: Ephemeris, utc: UtcParameters) -> None:
    values = dataclasses.asdict(utc)
    for name, coefficients in (("alpha", ephemeris.iono_alpha), ("beta", ephemeris.iono_beta)):
        values |= {f"{name}{i}": value for i, value in enumerate(coefficients)}
    values["tot"] %= S_PER_WEEK
    values["week_t"] %= 256
    values["week_lsf"] %= 256
    put_raw(bits, PAGE_FIELDS[0], 1)
    put_raw(bits, PAGE_FIELDS[1], IONO_PAGE_ID)
    for field in IONO_FIELDS:
        put_raw(bits, field, round(values[field.name] / field.unit))


def _put_dummy(bits: BitArray) -> None:
    """Fill words 3 to 10 as for a satellite that does not exist: ID 0, ones and zeros in turn."""
    bits[60::2] = 1
    put_raw(bits, PAGE_FIELDS[0], 1)
    put_raw(bits, PAGE_FIELDS[1], 0)


def encode_frame_bits(
    ephemeris: Ephemeris,
    start_tow_s: int,
    n_subframes: int,
    *,
    week: int | None = None,
    utc: UtcParameters | None = None,
    page_18_always: bool = False,
) -> BitArray:
    """Encode consecutive subframes; see `encode_subframe`.

    Returns
    -------
    ndarray of uint8, shape (300 * n_subframes,)
        Logic bits, 20 ms each, the first at ``start_tow_s`` of ``week``.
    """
    first_week = transmit_week(ephemeris, start_tow_s) if week is None else week
    frames = []
    for i in range(n_subframes):
        carry, tow_s = divmod(start_tow_s + SUBFRAME_S * i, S_PER_WEEK)
        options: dict[str, Any] = {
            "week": first_week + carry,
            "utc": utc,
            "page_18_always": page_18_always,
        }
        frames.append(encode_subframe(ephemeris, tow_s, **options))
    return np.concatenate(frames) if frames else np.zeros(0, np.uint8)


def quantise(ephemeris: Ephemeris) -> Ephemeris:
    """Return the ephemeris as a receiver decodes it: every field on its broadcast grid."""
    tow_s = int(ephemeris.toe) // 30 * 30
    week = transmit_week(ephemeris, tow_s)
    frames = {
        i + 1: remove_parity(encode_subframe(ephemeris, tow_s + 6 * i, week=week))[0]
        for i in range(3)
    }
    decoded = decode_ephemeris(frames, ephemeris.satellite, tow_s, week)
    return dataclasses.replace(
        decoded,
        week=ephemeris.week,
        transmit_tow=ephemeris.transmit_tow,
        effective_sample_index=ephemeris.effective_sample_index,
        iono_alpha=ephemeris.iono_alpha,
        iono_beta=ephemeris.iono_beta,
    )


_INTEGERS = ("iodc", "health", "l2_code", "l2p_flag", "fit_interval_flag")


def decode_ephemeris(
    frames: dict[int, BitArray], satellite: str, tow_s: float, week: int
) -> Ephemeris:
    """Build an ephemeris from the data bits of subframes 1, 2 and 3.

    Parameters
    ----------
    frames : dict of int to ndarray of uint8, shape (300,)
        Data bits (`remove_parity`) of subframes 1, 2, 3, of one issue of data.
    satellite : str
        Name, e.g. "G05".
    tow_s : float
        Start of subframe 1 [s of week].
    week : int
        Full week of transmission [weeks].
    """
    values: dict[str, Any] = {}
    for subframe_id in (1, 2, 3):
        values |= get_fields(frames[subframe_id], SUBFRAME_FIELDS[subframe_id])
    integers: dict[str, Any] = {name: int(values.pop(name)) for name in (*_INTEGERS, "iode")}
    accuracy = _URA_NOMINAL[int(values.pop("ura"))]
    values.pop("week")
    toe_week = week - round((values["toe"] - tow_s) / S_PER_WEEK)
    return Ephemeris(
        satellite=satellite,
        week=toe_week,
        accuracy=float(accuracy),
        transmit_tow=float(tow_s),
        **integers,
        **values,
    )
