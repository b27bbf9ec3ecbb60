"""RTCM 3 messages 1005 and 1006 (reference point) and 1019 (GPS ephemeris).

References
----------
RTCM 10403.3, tables 3.5-6, 3.5-7 and 3.5-21.
"""

from __future__ import annotations

from typing import Final

from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.lnav import ura_index
from deepseis_core.lnav_words import SUBFRAME_FIELDS, Field
from deepseis_core.rtcm_frame import Bits, frame
from deepseis_core.types import Ephemeris

# Fields of 1019 behind the satellite, in its order; names, sizes and units are those of LNAV.
_ORDER_1019: Final = (
    *("week", "ura", "l2_code", "i_dot", "iode", "toc", "af2", "af1", "af0", "iodc", "crs"),
    *("delta_n", "m0", "cuc", "eccentricity", "cus", "sqrt_a", "toe", "cic", "omega0", "cis"),
    *("i0", "crc", "omega", "omega_dot", "tgd", "health", "l2p_flag", "fit_interval_flag"),
)
_LNAV: Final[dict[str, Field]] = {
    field.name: field for fields in SUBFRAME_FIELDS.values() for field in fields
}


def reference_point(
    station_id: int, position_ecef: ArrayLike, antenna_height: float | None = None
) -> bytes:
    """Return message 1005, or 1006 where the antenna's height is given.

    Parameters
    ----------
    station_id : int
        0 to 4095.
    position_ecef : array_like, shape (3,)
        Of the antenna's reference point, in both messages [m].
    antenna_height : float, optional
        Of that point above the monument [m], 0 to 6.5535.
    """
    x, y, z = (round(float(value) * 1e4) for value in list(position_ecef))  # type: ignore[arg-type]
    bits = Bits().unsigned(1005 if antenna_height is None else 1006, 12)
    bits.unsigned(station_id, 12)
    bits.unsigned(0, 6)  # realisation year of ITRF: not stated
    bits.unsigned(0b100, 3)  # GPS; no GLONASS, no Galileo
    bits.unsigned(0, 1)  # a real station
    bits.signed(x, 38)
    bits.unsigned(1, 1)  # all observations by one oscillator
    bits.unsigned(0, 1)
    bits.signed(y, 38)
    bits.unsigned(0, 2)  # quarter cycles: not stated
    bits.signed(z, 38)
    if antenna_height is not None:
        bits.unsigned(round(antenna_height * 1e4), 16)
    return frame(bits)


def gps_ephemeris(ephemeris: Ephemeris) -> bytes:
    """Return message 1019: the numbers that the satellite itself sent, unchanged.

    Raises
    ------
    InputError
        A value does not fit, or the satellite is not one of GPS.
    """
    e = ephemeris
    bits = Bits().unsigned(1019, 12).unsigned(gps_number(e.satellite), 6)
    for name in _ORDER_1019:
        field = _LNAV[name]
        if name == "ura":
            number = ura_index(e.accuracy)
        elif name == "week":
            number = e.week % 1024
        else:
            number = round(getattr(e, name) / field.unit)
        if field.signed:
            bits.signed(number, field.size)
        else:
            bits.unsigned(number, field.size)
    return frame(bits)


def gps_number(satellite: str) -> int:
    """Return the number of a GPS satellite, 1 to 32.

    Examples
    --------
    >>> gps_number("G07")
    7
    """
    number = int(satellite[1:]) if satellite[:1] == "G" and satellite[1:].isdigit() else 0
    if not 1 <= number <= 32:
        raise InputError("RTCM", f"{satellite!r} is not a GPS satellite")
    return number
