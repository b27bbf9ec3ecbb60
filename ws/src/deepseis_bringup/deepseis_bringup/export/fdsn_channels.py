"""FDSN codes of what a station measures and derives: band, source, component, location.

References
----------
FDSN Source Identifiers, "Channel codes" (band by sample rate, source N accelerometer, J rotation
rate, X derived, Y non-specific). Locations are the operator's to choose; ours are in `LOCATIONS`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.types import DisplacementSource, FloatArray, Station

NETWORK: Final = "XX"
"""FDSN's code for networks without one."""

LOCATIONS: Final[Mapping[int, int]] = {
    DisplacementSource.GNSS: 10,
    DisplacementSource.AIDED: 20,
    DisplacementSource.FUSED: 30,
}
"""Location of what is derived: displacement +0, velocity +1, acceleration +2; smoothed: +5."""

SMOOTHED: Final = 5
IMU_LOCATION: Final = "00"
COUNTS: Final[Mapping[str, float]] = {"M": 1e6, "M/S": 1e6, "M/S**2": 1e6, "RAD/S": 1e8}
"""Counts per SI unit (docs/decisions/0016-counts-in-miniseed.md)."""

ALIGNED_DEG: Final = 5.0
"""Axes nearer than this to north, east, up carry their letters (FDSN)."""


@dataclass(frozen=True)
class Place:
    """Where the channels stand: codes, and geodetic latitude, longitude [deg], height [m]."""

    network: str
    station: str
    latitude_deg: float
    longitude_deg: float
    height: float

    def __post_init__(self) -> None:
        """Refuse codes that miniSEED 2 cannot hold."""
        for what, code, size in (("network", self.network, 2), ("station", self.station, 5)):
            if not re.fullmatch(f"[A-Z0-9]{{1,{size}}}", code):
                raise InputError(
                    f"{what} code {code!r}",
                    f"is not 1 to {size} capital letters and digits",
                    f"--{what}",
                )


def place_of_station(station: Station, network: str = "", code: str = "") -> Place:
    """Return the place of a station message; codes given take the place of its own.

    A station without a network code is in XX, FDSN's code for those.
    """
    latitude, longitude, height = geodetic_from_ecef(station.monument_ecef).tolist()
    return Place(
        network or station.network or NETWORK,
        code or station.name.upper(),
        round(float(np.degrees(latitude)), 8),
        round(float(np.degrees(longitude)), 8),
        round(float(height), 4),
    )


@dataclass(frozen=True)
class ChannelCode:
    """One channel: its codes, its unit, the axis along which it is positive.

    ``counts`` per unit; ``azimuth_deg`` clockwise from north and ``dip_deg`` down from the
    horizontal, as StationXML has them.
    """

    location: str
    band: str
    source: str
    component: str
    rate_hz: float
    unit: str
    azimuth_deg: float
    dip_deg: float
    description: str

    @property
    def code(self) -> str:
        """The three letters."""
        return self.band + self.source + self.component

    @property
    def counts(self) -> float:
        """Counts per unit."""
        return COUNTS[self.unit]

    def at_rate(self, rate_hz: float) -> ChannelCode:
        """Return the same at another rate."""
        return replace(self, rate_hz=rate_hz, band=band_code(rate_hz))


def band_code(rate_hz: float) -> str:
    """Return the band of a sensor whose response reaches down to zero frequency.

    Examples
    --------
    >>> "".join(band_code(rate) for rate in (0.1, 1, 5, 50, 100, 200, 400, 2000))
    'VLMBHHCF'
    """
    bounds = ((1000, "F"), (250, "C"), (80, "H"), (10, "B"), (1.0001, "M"), (0.5, "L"))
    if not 0.05 <= rate_hz < 5000:
        raise InputError(f"sample rate {rate_hz:g} Hz", "has no band code here", "0.05 to 5000 Hz")
    return next((letter for bound, letter in bounds if rate_hz >= bound), "V")


def axes_codes(C_enu_axes: FloatArray) -> list[tuple[str, float, float]]:
    """Return component letter, azimuth and dip [deg] of three orthogonal axes.

    Parameters
    ----------
    C_enu_axes : ndarray, shape (3, 3)
        Takes components along the axes to east, north, up.

    Examples
    --------
    >>> axes_codes(np.eye(3))
    [('E', 90.0, 0.0), ('N', 0.0, 0.0), ('Z', 0.0, -90.0)]
    """
    axes = np.asarray(C_enu_axes).T
    limit = np.cos(np.radians(ALIGNED_DEG))
    aligned = [int(np.argmax(axis)) if axis.max() >= limit else -1 for axis in axes]
    horizontal = {0, 1} <= set(aligned)
    numbers = iter("123")
    found = []
    for axis, named in zip(axes, aligned, strict=True):
        number = next(numbers)
        letter = "ENZ"[named] if named == 2 or (named >= 0 and horizontal) else number
        level = np.hypot(axis[0], axis[1])
        azimuth = np.degrees(np.arctan2(axis[0], axis[1])) % 360.0 if level > 1e-9 else 0.0
        dip = np.degrees(np.arctan2(-axis[2], level))
        found.append((letter, round(float(azimuth), 4) % 360.0, round(float(dip), 4) + 0.0))
    return found


ENU_AXES: Final = (("E", 90.0, 0.0), ("N", 0.0, 0.0), ("Z", 0.0, -90.0))
_WORDS: Final = {
    DisplacementSource.GNSS: "GNSS alone",
    DisplacementSource.AIDED: "GNSS, loops aided by the INS",
    DisplacementSource.FUSED: "GNSS and INS fused",
}


@cache
def displacement_channels(
    source: int, smoothed: bool, rate_hz: float
) -> Mapping[str, tuple[ChannelCode, ...]]:
    """Return the channels of a ``Displacement``, by quantity; east, north, up each.

    Fused acceleration is an accelerometer's, turned and freed of gravity and bias: source N
    beside its displacement. All else is source X.
    """
    base = LOCATIONS[source] + SMOOTHED * smoothed
    inertial = source == DisplacementSource.FUSED
    rows = {
        "displacement": (base, "X", "M"),
        "velocity": (base + 1, "X", "M/S"),
        "acceleration": (base, "N", "M/S**2") if inertial else (base + 2, "X", "M/S**2"),
    }
    words = _WORDS[DisplacementSource(source)] + (", smoothed" if smoothed else "")
    return {
        quantity: tuple(
            ChannelCode(
                f"{location:02d}",
                band_code(rate_hz),
                kind,
                letter,
                rate_hz,
                unit,
                azimuth,
                dip,
                f"{quantity.capitalize()}, {words}",
            )
            for letter, azimuth, dip in ENU_AXES
        )
        for quantity, (location, kind, unit) in rows.items()
    }


def imu_channels(station: Station | None, rate_hz: float) -> dict[str, tuple[ChannelCode, ...]]:
    """Return the channels of the raw IMU, by quantity; forward, left, up of the sensor each.

    Without a station the axes' directions are not known: numbers, and azimuth and dip of a
    sensor that heads east and stands level.
    """
    axes = list(zip("123", (90.0, 0.0, 0.0), (0.0, 0.0, -90.0), strict=True))
    if station is not None:
        axes = axes_codes(matrix_from_quat(station.imu_orientation_xyzw))
    rows = {
        "acceleration": ("N", "M/S**2", "Specific force of the IMU, +g on its up axis at rest"),
        "rotation": ("J", "RAD/S", "Rotation rate of the IMU about the axis, right-handed"),
    }
    return {
        quantity: tuple(
            ChannelCode(
                IMU_LOCATION, band_code(rate_hz), kind, letter, rate_hz, unit, azimuth, dip, words
            )
            for letter, azimuth, dip in axes
        )
        for quantity, (kind, unit, words) in rows.items()
    }
