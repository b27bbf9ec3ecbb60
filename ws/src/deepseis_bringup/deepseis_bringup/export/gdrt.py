"""GDRT: GFZ's displacement messages in real time, one UDP packet for each whole second.

SeisComP's ``gdrt_plugin`` makes channels ``LB?`` of them. A message is a line of text::

    > DSEI 20220101020000.00  0 17  3  1   0.00 09000000 X Y Z XX YY ZZ XY XZ YZ none !

station (4 letters), UTC, solution type, observations, positioning, processing, ambiguity ratio,
satellites of GPS, GLONASS, Galileo, BDS, ECEF position [m], its variances and covariances [m^2].

References
----------
GFZ, "gdrt_plugin" of the GNSS additions to SeisComP, table of its description.
"""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_bringup.export.utc_pieces import UtcMoment
from deepseis_core.constants import NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.types import Displacement, DisplacementSource, FloatArray, IntArray

NO_CORRECTIONS: Final = 0  # solution type: broadcast orbits
GPS: Final = 1  # observation types are added
SEISMIC: Final = 16
KINEMATIC: Final = 3
REAL_TIME: Final = 1


@dataclass(frozen=True)
class GdrtPosition:
    """What a message says: ECEF position [m] and covariance [m^2] at a GPS time [ns]."""

    gps_ns: int
    position_ecef: FloatArray
    covariance_ecef: FloatArray
    fused: bool
    satellites: int


def message(station_id: str, position: GdrtPosition) -> bytes:
    """Return a message; time to 10 ms, as the format has it."""
    p = position
    when = UtcMoment.of_gps_ns((p.gps_ns + 5_000_000) // 10_000_000 * 10_000_000).iso(2)
    time = when.translate(str.maketrans("", "", "-:TZ"))
    types = (NO_CORRECTIONS, GPS + SEISMIC * p.fused, KINEMATIC, REAL_TIME)
    numbers = (
        *p.position_ecef.tolist(),
        *np.diag(p.covariance_ecef).tolist(),
        *p.covariance_ecef[[0, 0, 1], [1, 2, 2]].tolist(),
    )
    fields = (
        f"> {station_id} {time}",
        *(f"{number:2d}" for number in types),
        f"{0:6.2f}",
        f"{min(p.satellites, 99):02d}000000",
        *(f"{number:14.4f}" for number in numbers),
        "none !",
    )
    return " ".join(fields).encode("ascii")


class GdrtSender:
    """Sends a station's motion at whole seconds; what the network loses is lost.

    Values are those of the epoch nearest to the second, not filtered: a filter would have to wait
    for what follows.

    Parameters
    ----------
    address : tuple of str and int
        Where the plugin listens.
    station_id : str
        Four letters or digits.
    origin_ecef : ndarray, shape (3,)
        What displacements are from [m].
    say : callable
        Told once what goes wrong.
    source : DisplacementSource
        Which motion is sent.
    """

    def __init__(
        self,
        address: tuple[str, int],
        station_id: str,
        origin_ecef: FloatArray,
        say: Callable[[str], None],
        source: int = DisplacementSource.FUSED,
    ) -> None:
        if len(station_id) != 4 or not (station_id.isascii() and station_id.isalnum()):
            raise InputError(f"GDRT station {station_id!r}", "is not four letters or digits")
        self.address, self.station_id, self.say = address, station_id, say
        self.origin_ecef, self.source = origin_ecef, source
        self.satellites = self.sent = self.failed = 0
        latitude, longitude, _ = geodetic_from_ecef(origin_ecef)
        self._C_e_enu = rotation_enu_ecef(latitude, longitude).T
        self._second = -1
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def take(self, value: Displacement, gps_ns: IntArray) -> None:
        """Take a batch of motion at true GPS times [ns]; send what lies at a whole second."""
        if value.source != self.source or value.smoothed:
            return
        half = round(value.interval * NS_PER_S / 2)
        seconds = (gps_ns + half) // NS_PER_S
        motion = np.reshape(value.displacement, (-1, 3))
        sd = np.reshape(value.displacement_sd, (-1, 3)).astype(np.float64)
        near = np.abs(gps_ns - seconds * NS_PER_S) <= half
        for k in np.flatnonzero(near & (seconds > self._second)).tolist():
            if seconds[k] > self._second and np.isfinite(motion[k]).all():
                self._second = int(seconds[k])
                self._send(int(gps_ns[k]), motion[k], np.nan_to_num(sd[k]))

    def _send(self, gps_ns: int, motion: FloatArray, sd: FloatArray) -> None:
        C = self._C_e_enu
        position = GdrtPosition(
            gps_ns,
            self.origin_ecef + C @ motion,
            C @ np.diag(sd**2) @ C.T,
            self.source == DisplacementSource.FUSED,
            self.satellites,
        )
        try:
            self._socket.sendto(message(self.station_id, position), self.address)
            self.sent += 1
        except OSError as error:
            if not self.failed:
                self.say(f"gdrt {self.address[0]}:{self.address[1]}: {error}")
            self.failed += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
