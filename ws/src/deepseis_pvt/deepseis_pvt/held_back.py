"""A replay of misses: what trackers say comes no earlier than it came in the run replayed."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable

from deepseis_core.miss_log import MissScript
from deepseis_core.types import Ephemeris, TrackingEpochs
from deepseis_pvt.track_store import TrackStore


class HeldBack:
    """Holds back what had not come when an epoch was worked through without it.

    Parameters
    ----------
    script : MissScript
        Of the run that is replayed; its inputs are satellites.
    store : TrackStore
        Gets the integrations.

    Attributes
    ----------
    end : int
        Sample after the last integration that has been held.
    """

    def __init__(self, script: MissScript, store: TrackStore) -> None:
        self.script, self.store = script, store
        self.end = 0
        self._epochs: dict[str, deque[TrackingEpochs]] = defaultdict(deque)
        self._ephemerides: dict[str, deque[Ephemeris]] = defaultdict(deque)
        self._handed: dict[str, int] = defaultdict(int)

    def push_epochs(self, epochs: TrackingEpochs) -> None:
        """Take the integrations of one satellite and IF block."""
        self._epochs[epochs.satellite].append(epochs)
        if len(epochs.sample_index):
            self.end = max(self.end, int(epochs.sample_index[-1]) + int(epochs.sample_count[-1]))

    def push_ephemeris(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris that a channel has decoded."""
        self._ephemerides[ephemeris.satellite].append(ephemeris)

    def hand_on(self, sample: int, worked_through: int, take: Callable[[Ephemeris], None]) -> None:
        """Hand on what had come before the epoch at a sample, or the next that lacked anything.

        Parameters
        ----------
        sample : int
            Of the next epoch.
        worked_through : int
            Of the last one.
        take : callable
            Gets ephemerides: each once the integrations that announce it have been handed on.
        """
        for satellite, waiting in self._epochs.items():
            limit = self.script.limit(satellite, sample)
            while waiting and waiting[0].valid_through <= limit:
                self.store.push(waiting.popleft(), worked_through)
        for satellite, decoded in self._ephemerides.items():
            while decoded and self._handed[satellite] < self.store.announced(satellite):
                self._handed[satellite] += 1
                take(decoded.popleft())
