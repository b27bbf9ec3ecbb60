"""NMEA 0183: the GGA sentence of a position, as NTRIP casters and chart programs take it."""

from __future__ import annotations

import math
from functools import reduce
from operator import xor
from typing import Final

from deepseis_core.constants import NS_PER_S
from deepseis_core.geodesy import geodetic_from_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Pvt, PvtStatus

QUALITY: Final = {
    PvtStatus.NONE: 0,
    PvtStatus.SINGLE: 1,
    PvtStatus.FLOAT: 5,
    PvtStatus.FIX: 4,
}


def sentence(body: str) -> str:
    r"""Return a sentence with its checksum and line end.

    Examples
    --------
    >>> sentence("GPGLL,5057.970,N,00146.110,E,142451,A")
    '$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n'
    """
    return f"${body}*{reduce(xor, body.encode('ascii')):02X}\r\n"


def gga(pvt: Pvt, *, geoid_separation: float = 0.0) -> str:
    r"""Return the GGA sentence of a position.

    Parameters
    ----------
    pvt : Pvt
    geoid_separation : float, optional
        Geoid above the ellipsoid there [m]. The altitude is the ellipsoidal height less this, so
        altitude plus separation is right even where the geoid is not known.

    Examples
    --------
    >>> import numpy as np
    >>> none = Pvt(0, 2190, 525_618 * 10**9, 0, 0, np.full(3, np.nan), np.full(3, np.nan),
    ...     0.0, 0.0, np.zeros(9), np.zeros(9))
    >>> gga(none)
    '$GPGGA,020000.00,,,,,0,00,,,M,,M,,*4A\r\n'
    """
    clock = utc_clock(GpsTime(pvt.week, pvt.tow_ns))
    quality = QUALITY[PvtStatus(pvt.status)]
    if not quality:
        return sentence(f"GPGGA,{clock},,,,,0,00,,,M,,M,,")
    latitude, longitude, height = geodetic_from_ecef(pvt.position_ecef).tolist()
    hdop = f"{min(pvt.hdop, 99.9):.1f}" if math.isfinite(pvt.hdop) else ""
    fields = (
        "GPGGA",
        clock,
        degrees_minutes(math.degrees(latitude), 2),
        "N" if latitude >= 0 else "S",
        degrees_minutes(math.degrees(longitude), 3),
        "E" if longitude >= 0 else "W",
        str(quality),
        f"{min(len(pvt.satellites), 99):02d}",
        hdop,
        f"{height - geoid_separation:.3f}",
        "M",
        f"{geoid_separation:.3f}",
        "M",
        "",
        "",
    )
    return sentence(",".join(fields))


def utc_clock(time: GpsTime) -> str:
    """Return hhmmss.ss of UTC, rounded to the nearest; a leap second is 235960.

    Examples
    --------
    >>> leap = GpsTime.from_utc_calendar(2016, 12, 31, 23, 59, 60 * 10**9)
    >>> utc_clock(leap), utc_clock(leap.add_ns(996 * 10**6))
    ('235960.00', '000000.00')
    """
    hundredths = 10_000_000
    rounded = GpsTime(0, (time.total_ns + hundredths // 2) // hundredths * hundredths)
    unix_ns = rounded.to_utc_ns()
    leap = GpsTime.from_utc_ns(unix_ns) != rounded
    seconds, ns = divmod(unix_ns - NS_PER_S * leap, NS_PER_S)
    minutes, second = divmod(seconds % 86_400, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}{minute:02d}{second + leap:02d}.{ns // hundredths:02d}"


def degrees_minutes(angle_deg: float, digits: int) -> str:
    """Return an angle's size as degrees and minutes to 1e-7; minutes never round to 60.

    Examples
    --------
    >>> degrees_minutes(-0.99999999999, 3), degrees_minutes(35.5, 2)
    ('00100.0000000', '3530.0000000')
    """
    whole, rest = divmod(round(abs(angle_deg) * 60e7), 60 * 10**7)
    return f"{whole:0{digits}d}{rest // 10**7:02d}.{rest % 10**7:07d}"
