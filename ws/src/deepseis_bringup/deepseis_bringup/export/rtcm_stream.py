"""A station as a base for others: its values as a stream of RTCM 3 messages.

1077 at the epochs of the chosen rate; 1005, or 1006 where the antenna stands above its monument,
every 10 s; 1019 of every satellite when it is new and every 30 s. Messages of an epoch go out
together, the observations last.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from deepseis_bringup.export.rtcm_msm import msm7
from deepseis_bringup.export.rtcm_station import gps_ephemeris, reference_point
from deepseis_core.config import setting
from deepseis_core.constants import NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Ephemeris, Observations, Station

REFERENCE_NS: Final = 10 * NS_PER_S
EPHEMERIDES_NS: Final = 30 * NS_PER_S
HIGHEST: Final = 6.5535
"""Greatest height of an antenna that message 1006 can hold [m]."""


@dataclass(frozen=True)
class RtcmConfig:
    """What is sent."""

    rtcm_rate_hz: float = setting(
        1.0, "epochs sent a second; the time between them has whole ms [Hz]", low=0.01, high=100.0
    )
    rtcm_station_id: int = setting(0, "number of the station in messages [-]", low=0, high=4095)


class RtcmStream:
    """Turns values, as they come, into messages.

    Parameters
    ----------
    config : RtcmConfig

    Raises
    ------
    InputError
        The rate's interval has no whole milliseconds.
    """

    def __init__(self, config: RtcmConfig) -> None:
        self.config = config
        self._interval_ns = round(1e3 / config.rtcm_rate_hz) * 1_000_000
        if abs(self._interval_ns * config.rtcm_rate_hz / NS_PER_S - 1.0) > 1e-9:
            rate = f"rtcm_rate_hz {config.rtcm_rate_hz:g}"
            raise InputError(rate, "its epochs are not whole milliseconds apart")
        self._reference = b""
        self._ephemerides: dict[str, bytes] = {}
        self._said: dict[int, int] = {}

    def take_station(self, station: Station) -> None:
        """Learn where the antenna is."""
        antenna = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
        up = float(station.antenna_lever_arm[2])
        height = up if 0.0 < up <= HIGHEST else None
        self._reference = reference_point(self.config.rtcm_station_id, antenna, height)

    def take_ephemeris(self, ephemeris: Ephemeris) -> bytes:
        """Return the message of an ephemeris, empty if it was said before."""
        message = gps_ephemeris(ephemeris)
        if self._ephemerides.get(ephemeris.satellite) == message:
            return b""
        self._ephemerides[ephemeris.satellite] = message
        return message

    def take_observations(self, observations: Observations) -> bytes:
        """Return the messages of an epoch; empty between the epochs of the rate."""
        if observations.tow_ns % self._interval_ns:
            return b""
        now = GpsTime(observations.week, observations.tow_ns).total_ns
        return b"".join(
            [
                self._reference if self._is_due(REFERENCE_NS, now) else b"",
                *(self._ephemerides.values() if self._is_due(EPHEMERIDES_NS, now) else ()),
                msm7(self.config.rtcm_station_id, observations),
            ]
        )

    def greeting(self) -> bytes:
        """Return what does not change from epoch to epoch, for whoever has just come."""
        return b"".join([self._reference, *list(self._ephemerides.values())])

    def _is_due(self, interval_ns: int, now: int) -> bool:
        """Tell whether something that comes at an interval is to be said now."""
        count = now // interval_ns
        if self._said.get(interval_ns) == count:
            return False
        self._said[interval_ns] = count
        return True
