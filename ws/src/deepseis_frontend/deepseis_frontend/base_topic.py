"""Another station in the same ROS domain as a live base: its epochs on our clock."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Final

from deepseis_core.constants import NS_PER_S
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations, Station
from deepseis_frontend.base_events import BaseEvent, BaseReference, utc_of
from deepseis_frontend.ntrip import Address

INTERVAL_S: Final = 0.1
"""Epochs of a base that are used: more of them carry no more news."""
LIMIT: Final = 600
"""Events kept for a signal that is not there yet; then the oldest are dropped."""
SET_BACK_S: Final = 60
"""An epoch so long before the last one is of another clock: the station was started anew [s]."""


class StationBase:
    """Takes what another station says of itself and gives it as a live base's events.

    Parameters
    ----------
    address : Address
        Its name.
    clock : SampleClock
        Of our IF samples; the other's are counted otherwise, GPS time is common.

    Attributes
    ----------
    about_utc_ns : int
        Where our signal is; not needed here.
    counts : dict of str to int
        Epochs, those that came out of order, and events dropped because nobody took them.
    """

    def __init__(self, address: Address, clock: SampleClock) -> None:
        self.address, self.about_utc_ns = address, clock.start_utc_ns
        self.counts = dict.fromkeys(("epochs", "repeated", "overrun"), 0)
        self._clock, self._newest = clock, -1
        self._place: BaseReference | None = None
        self._events: deque[BaseEvent] = deque()

    @property
    def connected(self) -> bool:
        """Whether it has said anything."""
        return self._place is not None

    @property
    def state(self) -> str:
        """What goes on, in words."""
        if self._place is None:
            return "the station has not been heard"
        return "listening" if self.counts["epochs"] else "no epoch yet"

    def push_station(self, station: Station, utc_ns: int) -> None:
        """Take where its antenna is, from a UTC on [ns since 1970]."""
        place = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
        if self._place is None or (place != self._place.position_ecef).any():
            self._place = BaseReference(utc_ns, place, station.name)
            self._keep(self._place)

    def push_epoch(self, epoch: Observations) -> None:
        """Take an epoch; of those between tenths of a second none is needed."""
        if epoch.tow_ns % round(INTERVAL_S * NS_PER_S):
            return
        utc_ns = utc_of(epoch)
        if self._newest - SET_BACK_S * NS_PER_S <= utc_ns <= self._newest:
            self.counts["repeated"] += 1
            return
        self._newest = utc_ns
        self.counts["epochs"] += 1
        sample = self._clock.sample_at(utc_ns)
        self._keep(
            replace(
                epoch,
                sample_index=sample,
                sample_fraction=0.0,
                valid_through=sample,
                interval=max(epoch.interval, INTERVAL_S),
            )
        )

    def take(self) -> list[BaseEvent]:
        """Return the events that have come since the last call, in order."""
        taken = list(self._events)
        self._events.clear()
        return taken

    def close(self) -> None:
        """End; there is nothing to be ended."""

    def _keep(self, event: BaseEvent) -> None:
        self._events.append(event)
        if len(self._events) > LIMIT:
            self._events.popleft()
            self.counts["overrun"] += 1
