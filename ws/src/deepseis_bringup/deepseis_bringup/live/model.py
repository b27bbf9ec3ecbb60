"""What the live page knows: traces, satellites, events, the filter, diagnostics, latency.

Fed with the values of topics as they come; all that it holds is bounded.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_bringup.live.satellites import SatelliteTable, number
from deepseis_bringup.live.trace import Trace
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.latency import Arrivals
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    FloatArray,
    InsFilter,
    InsSolution,
    IntArray,
    MotionKind,
    MotionState,
    Observations,
    PrecisePosition,
    Pvt,
    PvtStatus,
    SeismicEvent,
    Station,
    TrackingEpochs,
)

MOTION: Final = tuple(f"{quantity}{axis}" for quantity in "avd" for axis in "ENU")
"""Channels of ground motion: acceleration, velocity, displacement, each east, north, up."""
INNOVATIONS: Final = ("pN", "pE", "pD", "vN", "vE", "vD", "range", "rate")
"""Channels of the filter's innovations over their sigmas: position, velocity; of a tight filter
the greatest of all satellites' ranges and range rates."""
VECTORS: Final = 6
"""Innovations of position and velocity; those of satellites follow."""
EVENTS: Final = 20
"""Events kept."""
DIAGNOSTICS: Final = 100
"""Names kept of ``/diagnostics``."""
STATE_SD: Final = {"position": 0, "velocity": 3, "attitude": 6, "gyro": 9, "accelerometer": 12}
"""Where the sigmas of three states begin in ``state_sd``."""
GYRO_UNIT, ACCEL_UNIT = math.degrees(3600.0), 1e6 / STANDARD_GRAVITY
"""deg/h in a rad/s; micro-g in a m/s^2."""


class LiveModel:
    """Takes values of topics, gives the page's state.

    Parameters
    ----------
    clock : callable, optional
        Seconds, for how long something has been silent.

    Attributes
    ----------
    traces : dict of str to Trace
        ``motion``, ``gnss`` (displacement from GNSS alone), ``innovation``, ``latency``; over
        seconds since ``origin_ns``.
    newest : tuple of int and int
        Newest sample that the page shows, and when the source had sent it [samples, ns].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self.origin_ns = 0
        self.traces = {
            "motion": Trace("motion", MOTION),
            "gnss": Trace("gnss", MOTION[6:]),
            "innovation": Trace("innovation", INNOVATIONS),
            "latency": Trace("latency", ("ms",)),
        }
        self.satellites = SatelliteTable()
        self.newest = (-1, 0)
        self.newest_utc_ns = 0
        self.ended = False
        self._arrivals = Arrivals(2000)
        self._heard: dict[str, float] = {}
        self._station: dict[str, Any] = {}
        self._motion_state: dict[str, Any] = {}
        self._pvt: dict[str, Any] = {}
        self._filter: dict[str, Any] = {}
        self._sigmas: dict[str, Any] = {}
        self._accepted = self._rejected = 0
        self._events: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._diagnostics: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._ns_a_sample = 0.0

    def _seconds(self, week: int, tow_ns: IntArray) -> FloatArray:
        """Return seconds since the origin, which the first time ever seen sets."""
        utc_ns = GpsTime(week, int(tow_ns[0])).to_utc_ns()
        if not self.origin_ns:
            self.origin_ns = utc_ns - utc_ns % 1_000_000_000
        self.newest_utc_ns = utc_ns + int(tow_ns[-1] - tow_ns[0])
        return 1e-9 * (utc_ns - self.origin_ns + (tow_ns - tow_ns[0]))

    def _hear(self, what: str) -> None:
        self._heard[what] = self.clock()

    def take_source(self, valid_through: int, sent_ns: int, *, ended: bool = False) -> None:
        """Take how far the source has sent, and by whose wall clock [samples, ns]."""
        self._hear("source")
        if valid_through < self.newest[0]:
            self._arrivals, self.newest = Arrivals(2000), (-1, 0)
        self._arrivals.note(valid_through, float(sent_ns))
        self.ended = ended

    def take_displacement(self, motion: Displacement, sent_ns: int = 0) -> None:
        """Take ground motion; smoothed motion comes late and is left out."""
        if motion.smoothed or not len(motion.tow_ns):
            return
        times = self._seconds(motion.week, motion.tow_ns)
        if motion.source == DisplacementSource.AIDED:
            return
        if motion.source == DisplacementSource.GNSS:
            self.traces["gnss"].push(times, _vectors(motion.displacement), motion.interval)
            return
        self._hear("motion")
        parts = (motion.acceleration, motion.velocity, motion.displacement)
        values = np.hstack([_vectors(part) for part in parts])
        self.traces["motion"].push(times, values, motion.interval)
        self._sigmas = {
            name: [number(value, 6) for value in _vectors(getattr(motion, name))[-1]]
            for name in ("acceleration_sd", "velocity_sd", "displacement_sd")
        }
        self._sigmas["rate_hz"] = number(1.0 / motion.interval, 3)
        self._show(motion.valid_through, sent_ns, float(times[-1]), motion.interval)

    def _show(self, sample: int, sent_ns: int, seconds: float, interval: float) -> None:
        """Note when the source had sent what is shown now."""
        source_ns = self._arrivals.of(sample)
        if source_ns is None or not sent_ns:
            return
        self.newest = (sample, int(source_ns))
        behind_ms = np.array([[1e-6 * (sent_ns - source_ns)]])
        batch = max(interval, 0.02)  # one value for each message
        self.traces["latency"].push(np.array([seconds]), behind_ms, batch)

    def take_precise(self, position: PrecisePosition, interval: float = 0.02) -> None:
        """Take a position from carrier phases: the only motion of a graph without an IMU."""
        if "motion" in self._heard:
            return
        times = self._seconds(position.week, np.array([position.tow_ns], np.int64))
        self.traces["gnss"].push(times, np.reshape(position.displacement_enu, (1, 3)), interval)

    def take_solution(self, solution: InsSolution) -> None:
        """Take the filter's state and its innovations."""
        self._hear("filter")
        self._filter["name"] = InsFilter(solution.filter).name.lower().replace("_", "-")
        size = solution.innovation_size
        if len(solution.innovation_accepted) and size >= VECTORS:
            self._accepted += int(np.count_nonzero(solution.innovation_accepted))
            self._rejected += int(np.count_nonzero(~solution.innovation_accepted))
            self._innovations(solution)
        if not len(solution.sample_index):
            return
        sd = np.reshape(solution.state_sd, (-1, solution.state_count))[-1]
        for name, begin in STATE_SD.items():
            if begin + 3 <= solution.state_count:
                unit = {"attitude": math.degrees(1.0), "gyro": GYRO_UNIT}.get(name, 1.0)
                unit = ACCEL_UNIT if name == "accelerometer" else unit
                self._filter[f"{name}_sd"] = [number(unit * v, 6) for v in sd[begin : begin + 3]]
        self._filter["gyro_bias_deg_h"] = _scaled(solution.gyro_bias, GYRO_UNIT)
        self._filter["accelerometer_bias_ug"] = _scaled(solution.accelerometer_bias, ACCEL_UNIT)

    def _innovations(self, solution: InsSolution) -> None:
        """Push normalised innovations at the times of their epochs, by the samples' rate."""
        index, tows = solution.sample_index, solution.tow_ns
        if len(index) > 1:
            self._ns_a_sample = float(tows[-1] - tows[0]) / float(index[-1] - index[0])
        if not len(index) or not self._ns_a_sample:
            return
        back = solution.innovation_sample_index - index[-1]
        tow_ns = tows[-1] + np.rint(back * self._ns_a_sample).astype(np.int64)
        newest = self.newest_utc_ns
        times = self._seconds(solution.week, tow_ns)
        self.newest_utc_ns = max(newest, self.newest_utc_ns)
        ratio = np.asarray(solution.innovation, float) / np.asarray(solution.innovation_sd, float)
        rows = np.reshape(ratio, (-1, solution.innovation_size))
        half = (solution.innovation_size - VECTORS) // 2
        ranges, rates = rows[:, VECTORS : VECTORS + half], rows[:, VECTORS + half :]
        rows = np.column_stack([rows[:, :VECTORS], _greatest(ranges), _greatest(rates)])
        self.traces["innovation"].push(times, rows, 0.02)

    def take_motion_state(self, value: MotionState, utc_ns: int) -> None:
        """Take whether the station is still, and how near the limits it is."""
        self._hear("motion state")
        ratio = np.sqrt(np.asarray(value.variance) / np.asarray(value.threshold))
        kind = MotionKind(value.state).name.lower()
        changed = self._motion_state.get("state") != kind
        since = utc_ns if changed else self._motion_state["since_ns"]
        self._motion_state = {
            "state": kind,
            "since_ns": since,
            "policy": value.policy,
            "ratio": [number(item, 3) for item in ratio],
        }

    def take_event(self, event: SeismicEvent, utc_ns: int) -> None:
        """Take what is known of an event by now."""
        self._events[event.event_id] = {
            "id": event.event_id,
            "onset_ms": event.onset.sec * 1000 + event.onset.nanosec // 1_000_000,
            "report_ms": utc_ns // 1_000_000,
            "ended": event.ended,
            "onset_ratio": number(event.onset_ratio, 1),
            "pga": number(event.peak_acceleration, 6),
            "pgv": number(event.peak_velocity, 6),
            "pgd": number(event.peak_displacement, 6),
            "magnitude": number(event.magnitude, 2),
            "magnitude_sd": number(event.magnitude_sd, 2),
            "distance_km": number(1e-3 * event.hypocentral_distance, 1),
        }
        while len(self._events) > EVENTS:
            self._events.popitem(last=False)

    def take_tracking(self, epochs: TrackingEpochs) -> None:
        """Take the integrations of a satellite."""
        self._hear("tracking")
        self.satellites.take_tracking(epochs, self.clock())

    def take_observations(self, epoch: Observations) -> None:
        """Take an epoch's slips."""
        self.satellites.take_observations(epoch)

    def take_pvt(self, pvt: Pvt) -> None:
        """Take a position."""
        self._hear("position")
        self.satellites.take_pvt(pvt)
        self.newest_utc_ns = max(
            self.newest_utc_ns, GpsTime(pvt.week, int(pvt.tow_ns)).to_utc_ns()
        )
        self._pvt = {
            "status": PvtStatus(pvt.status).name.lower(),
            "used": len(pvt.satellites),
            "rejected": list(pvt.rejected),
            "pdop": number(pvt.pdop, 2),
            "clock_drift_m_s": number(pvt.clock_drift, 3),
        }
        if pvt.status != PvtStatus.NONE and np.all(np.isfinite(pvt.position_ecef)):
            self._pvt |= _place(pvt.position_ecef, pvt.position_covariance_ecef)

    def take_station(self, station: Station) -> None:
        """Take what the station is."""
        self._station = {
            "name": station.name,
            "network": station.network,
            "imu": station.imu,
            "receiver": station.receiver,
            **_place(station.monument_ecef),
        }

    def take_diagnostic(self, name: str, level: int, text: str, values: Mapping[str, str]) -> None:
        """Take a status of ``/diagnostics``."""
        self._diagnostics[name] = {
            "name": name,
            "level": level,
            "text": text,
            "values": dict(list(values.items())[:40]),
            "heard": self.clock(),
        }
        while len(self._diagnostics) > DIAGNOSTICS:
            self._diagnostics.popitem(last=False)

    def state(self) -> dict[str, Any]:
        """Return all but the traces, as JSON can hold it."""
        # After the end it is always now: the last picture stays.
        now = max(self._heard.values()) if self.ended else self.clock()
        still = self._motion_state
        statuses = [
            {key: value for key, value in item.items() if key != "heard"}
            | {"silent_s": number(max(0.0, now - item["heard"]), 1)}
            for _, item in sorted(self._diagnostics.items())
        ]
        return {
            "station": self._station,
            "utc_ms": self.newest_utc_ns // 1_000_000,
            "ended": self.ended,
            "silent_s": {name: number(now - at, 1) for name, at in self._heard.items()},
            "motion": still and {**still, "since_ms": still["since_ns"] // 1_000_000},
            "events": list(self._events.values()),
            "pvt": self._pvt,
            "satellites": self.satellites.rows(now),
            "sigmas": self._sigmas,
            "filter": self._filter
            and {**self._filter, "accepted": self._accepted, "rejected": self._rejected},
            "diagnostics": statuses,
        }


def _vectors(values: ArrayLike) -> FloatArray:
    """Return vectors as rows: messages hold them row major."""
    return np.reshape(np.asarray(values, float), (-1, 3))


def _greatest(rows: FloatArray) -> FloatArray:
    """Return of each row the value of the greatest size; NaN where there is none."""
    out: FloatArray = np.full(len(rows), np.nan)
    for k, row in enumerate(rows):
        known = row[np.isfinite(row)]
        if len(known):
            out[k] = known[np.argmax(np.abs(known))]
    return out


def _scaled(values: FloatArray, unit: float) -> list[float | None]:
    """Return the newest of some vectors in another unit."""
    return [number(unit * value, 4) for value in _vectors(values)[-1]]


def _place(ecef: FloatArray, covariance: FloatArray | None = None) -> dict[str, Any]:
    """Return latitude, longitude [deg], height [m], and sigmas east, north, up [m]."""
    latitude, longitude, height = geodetic_from_ecef(np.asarray(ecef, float))
    found: dict[str, Any] = {
        "latitude_deg": number(math.degrees(latitude), 7),
        "longitude_deg": number(math.degrees(longitude), 7),
        "height_m": number(height, 2),
    }
    if covariance is not None:
        C = rotation_enu_ecef(latitude, longitude)
        P = C @ np.reshape(covariance, (3, 3)) @ C.T
        found["sd_enu_m"] = [number(math.sqrt(max(0.0, v)), 3) for v in np.diag(P)]
    return found
