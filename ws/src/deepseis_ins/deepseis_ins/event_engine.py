"""Events: peaks of ground motion as they grow, and a magnitude from the displacement's.

Fed with the fused ground motion as it comes, it reports at the onset, then every `report_s` of
samples while the event lasts, and once at its end. Where the earthquake was is told before the
run, or in the middle of it, when somebody knows (`EventEngine.locate`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Displacement, DisplacementSource, FloatArray, SeismicEvent, Stamp
from deepseis_ins import pgd_magnitude as pgd
from deepseis_ins.onset import OnsetConfig, OnsetDetector, Trigger

NS = 1_000_000_000


@dataclass(frozen=True)
class EventConfig:
    """Settings of `EventEngine`."""

    report_s: float = setting(0.2, "time between reports [s]", low=0.02, high=0.5)
    reference_s: float = setting(
        2.0, "displacements are from the mean over this before the onset [s]", low=0.05, high=60.0
    )
    lead_s: float = setting(
        0.5, "before the onset, left out of that and searched for peaks [s]", low=0.0, high=10.0
    )
    hypocentre: list[float] = setting(
        [], "latitude, longitude [deg], depth [km]; empty: not known, no magnitude", live=True
    )
    hypocentre_valid_s: float = setting(
        600.0, "one given in mid-run is of events so long before and after that [s]",
        low=1.0, high=86_400.0,
    )  # fmt: skip
    least_significance: float = setting(
        5.0, "sigmas of a displacement that gives a magnitude [-]", low=0.0
    )


@dataclass(frozen=True)
class Report:
    """A report and the UTC of its last sample [ns]."""

    event: SeismicEvent
    utc_ns: int


class EventEngine:
    """Follows ground motion and reports events.

    Parameters
    ----------
    config : EventConfig
    onset : OnsetConfig
    station : str
        Its name, for the events' names.
    station_ecef : ndarray, shape (3,)
        [m]
    """

    def __init__(
        self, config: EventConfig, onset: OnsetConfig, station: str, station_ecef: FloatArray
    ) -> None:
        try:
            check(config)
        except ValueError as error:
            raise InputError("events", str(error)) from None
        self.config, self.onset, self.station = config, onset, station
        self.station_ecef = station_ecef
        self.distance = pgd.hypocentral_distance(station_ecef, config.hypocentre)
        self._distance_before, self._located_until_ns = self.distance, -1
        self.detector: OnsetDetector | None = None
        self.event: SeismicEvent | None = None
        self.events = 0
        self._origin: FloatArray = np.zeros(3)
        self._before: deque[FloatArray] = deque()
        self._kept = 0  # rows in it
        self._reported_ns, self._newest_ns, self._sd = 0, 0, 0.0
        self._last: tuple[Report, float] | None = None  # that ended; the displacement's sigma

    def push(self, motion: Displacement) -> list[Report]:
        """Take ground motion in order; that of other sources than the fused one is left out."""
        if motion.source != DisplacementSource.FUSED or motion.smoothed or not len(motion.tow_ns):
            return []
        if self.detector is None:
            self.detector = OnsetDetector(self.onset, 1.0 / motion.interval)
        # Flat as they come in a message, or not.
        shape = len(motion.tow_ns), 3
        parts = motion.displacement, motion.velocity, motion.acceleration
        rows = np.hstack([np.reshape(part, shape) for part in parts])
        _, triggers = self.detector.push(rows[:, 6:])
        self._sd = float(np.linalg.norm(np.reshape(motion.displacement_sd, shape)[-1]))
        start_ns = GpsTime(motion.week, int(motion.tow_ns[0])).to_utc_ns()
        utc_ns = start_ns + (motion.tow_ns - motion.tow_ns[0])
        return self._follow(rows, utc_ns.tolist(), triggers, motion.interval)

    def locate(self, hypocentre: list[float]) -> list[Report]:
        """Take where an earthquake was, as soon as it is known.

        It is that of the event in progress or of the last one, which is reported anew, and of
        what begins soon after: `EventConfig.hypocentre_valid_s`.

        Parameters
        ----------
        hypocentre : list of float
            Latitude, longitude [deg], depth [km]; empty: it was wrong, back to the settings'.

        Raises
        ------
        InputError
            That is no place in the Earth.
        """
        distance = pgd.hypocentral_distance(self.station_ecef, hypocentre)
        within_ns = round(self.config.hypocentre_valid_s * NS)
        self._located_until_ns = self._newest_ns + within_ns if hypocentre else -1
        self.distance = distance if hypocentre else self._distance_before
        if self.event is not None:
            self.event = _placed(self.event, self.distance)
            return self._report(self._newest_ns, ended=False)
        if self._last is None or self._newest_ns - self._last[0].utc_ns > within_ns:
            return []
        last, sd = self._last
        report = Report(self._rated(_placed(last.event, self.distance), sd), last.utc_ns)
        self._last = report, sd
        return [report]

    def _follow(
        self, rows: FloatArray, utc_ns: list[int], triggers: list[Trigger], interval: float
    ) -> list[Report]:
        reports, done = [], 0
        self._newest_ns = utc_ns[-1]
        for trigger in triggers:
            self._take(rows[done : trigger.row + 1], interval)
            done = trigger.row + 1
            if trigger.began:
                self._begin(utc_ns[trigger.row], trigger.ratio, interval)
            reports += self._report(utc_ns[trigger.row], ended=not trigger.began)
        self._take(rows[done:], interval)
        if self.event is not None and utc_ns[-1] - self._reported_ns >= self.config.report_s * NS:
            reports += self._report(utc_ns[-1], ended=False)
        return reports

    def _take(self, rows: FloatArray, interval: float) -> None:
        if not len(rows):
            return
        if self.event is not None:
            self._grow(rows)
            return
        self._before.append(rows)
        self._kept += len(rows)
        needed = (self.config.reference_s + self.config.lead_s) / interval
        while self._kept - len(self._before[0]) > needed:
            self._kept -= len(self._before.popleft())

    def _begin(self, utc_ns: int, ratio: float, interval: float) -> None:
        """Begin an event, with what led up to it."""
        rows = np.concatenate(list(self._before))
        lead = min(round(self.config.lead_s / interval), len(rows) - 1)
        self._origin = rows[: len(rows) - lead, :3].mean(axis=0)
        self._before.clear()
        self._kept = 0
        self.events += 1
        if utc_ns > self._located_until_ns:
            self.distance = self._distance_before
        sec, nanosec = divmod(utc_ns, NS)
        name = (
            f"{self.station or 'station'}-{np.datetime64(utc_ns, 'ns').astype('datetime64[ms]')}"
        )
        self.event = SeismicEvent(
            event_id=name, onset=Stamp(sec, nanosec), ended=False, onset_ratio=ratio,
            peak_displacement=0.0, peak_velocity=0.0, peak_acceleration=0.0,
            hypocentral_distance=self.distance,
        )  # fmt: skip
        self._grow(rows[len(rows) - lead :])

    def _grow(self, rows: FloatArray) -> None:
        event = self.event
        if event is None or not len(rows):
            return
        moved = rows - np.concatenate([self._origin, np.zeros(6)])
        peaks = np.sqrt((moved.reshape(-1, 3, 3) ** 2).sum(axis=2)).max(axis=0).tolist()
        self.event = replace(
            event,
            peak_displacement=max(event.peak_displacement, peaks[0]),
            peak_velocity=max(event.peak_velocity, peaks[1]),
            peak_acceleration=max(event.peak_acceleration, peaks[2]),
        )

    def _report(self, utc_ns: int, *, ended: bool) -> list[Report]:
        if self.event is None:
            return []
        event = self._rated(replace(self.event, ended=ended), self._sd)
        report = Report(event, utc_ns)
        self._reported_ns = utc_ns
        self.event = None if ended else event
        if ended:
            self._last = report, self._sd
        return [report]

    def _rated(self, event: SeismicEvent, sd: float) -> SeismicEvent:
        """Return an event with its magnitude, if its displacement [m] stands out of its sigma."""
        peak = event.peak_displacement
        if peak <= self.config.least_significance * sd:
            return event
        return replace(
            event,
            magnitude=pgd.magnitude(peak, event.hypocentral_distance),
            magnitude_sd=pgd.magnitude_sd(peak, sd, event.hypocentral_distance),
        )


def _placed(event: SeismicEvent, distance: float) -> SeismicEvent:
    """Return an event at another distance [m], without a magnitude."""
    unknown = float("nan")
    return replace(event, hypocentral_distance=distance, magnitude=unknown, magnitude_sd=unknown)
