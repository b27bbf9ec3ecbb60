"""When to search for whom: the acquisition's side of the slots (see `engine`)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepseis_core.baseband import Baseband
from deepseis_core.config import setting
from deepseis_core.counted import CountedInput
from deepseis_core.errors import InputError
from deepseis_core.miss_log import EVER, Inputs, MissScript
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import AcquisitionResult, IfBlock
from deepseis_tracking.acquisition import Acquirer, AcquisitionConfig, Detection
from deepseis_tracking.acquisition_windows import Forecast
from deepseis_tracking.engine import SlotConfig


@dataclass(frozen=True)
class RetryConfig:
    """How soon a satellite is searched for again."""

    retry_lost_s: float = setting(1.0, "satellites lost within the last minute [s]", low=0.1)
    retry_s: float = setting(30.0, "all others not tracked [s]", low=0.5)


class AcquisitionEngine:
    """Searches at slot starts for satellites that nobody tracks.

    The search for the hand-over at slot ``k`` uses samples from the start of slot
    ``k - latency_slots`` on and requests made before that.

    Attributes
    ----------
    missed : dict of str to int
        Trackers that the last block did not wait for, and how far their requests are there.

    Raises
    ------
    InputError
        A search takes more signal than a slot has.
    """

    def __init__(
        self,
        satellites: tuple[str, ...],
        config: AcquisitionConfig,
        slots: SlotConfig,
        retry: RetryConfig,
        forecast: Forecast | None = None,
        script: MissScript | None = None,
    ) -> None:
        self._inputs, self.missed = Inputs(script), dict[str, int]()
        stretch_ms = config.coherent_ms * config.noncoherent_count
        if stretch_ms > slots.slot_ms:
            raise InputError(
                "acquisition",
                f"{stretch_ms} ms of signal do not fit into a slot of {slots.slot_ms} ms",
                "lower noncoherent_count or raise slot_ms",
            )
        self.forecast = forecast
        self.clock: SampleClock | None = None
        self._windows: dict[str, tuple[float, float]] | None = None
        self.satellites, self.config, self.slots, self.retry = satellites, config, slots, retry
        self.due_from: dict[str, int] = dict.fromkeys(satellites, 0)
        self.lost_at: dict[str, int] = {}
        self.blocks: deque[IfBlock] = deque()
        self.trackers: dict[str, CountedInput] = {}
        self.requests: list[tuple[str, int, str]] = []
        self._asked: dict[str, int] = {}
        self.valid_through = -1
        self.consumed_through = -1
        self.result_count = 0
        self.counters = {"searches": 0, "found": 0}
        self.slot = -1
        self._baseband: Baseband | None = None
        self._acquirer: Acquirer | None = None
        self._targets: list[str] = []
        self._collected: list[tuple[NDArray[np.int8], NDArray[np.int8]]] = []
        self._start = 0

    def expect_trackers(self, names: list[str], *, counting: bool = True) -> None:
        """Name the processes whose requests are to be waited for."""
        self.trackers = {name: CountedInput(counting=counting) for name in names}

    def push_block(self, block: IfBlock) -> None:
        """Take the next IF block."""
        self.blocks.append(block)

    def push_request(self, satellite: str, sample_index: int, tracker: str) -> None:
        """Take the request of a channel that became idle at a sample."""
        self.requests.append((satellite, sample_index, tracker))
        self._asked[tracker] = max(self._asked.get(tracker, 0), sample_index - 1)
        if tracker in self.trackers:
            self.trackers[tracker].received()

    def tracker_valid(self, tracker: str, through: int, request_count: int) -> None:
        """Note that a tracker process has made all its requests up to ``through``."""
        self.trackers.setdefault(tracker, CountedInput()).announced(request_count, through)

    def _there(self) -> dict[str, int]:
        return {name: tracker.valid_through for name, tracker in self.trackers.items()}

    def next_through(self) -> int:
        """Return the last sample of the next block; never, if there is none."""
        if not self.blocks:
            return EVER
        return self.blocks[0].sample_index + self.blocks[0].sample_count - 1

    def advance(self, *, force: bool = False) -> list[AcquisitionResult] | None:
        """Work through one block.

        Parameters
        ----------
        force : bool
            Do not wait for trackers any longer (a deadline has passed).

        Returns
        -------
        list of AcquisitionResult or None
            None: nothing to do yet. After a call that returned a list, `valid_through` and
            `consumed_through` tell what is settled.
        """
        if not self.blocks:
            return None
        block = self.blocks[0]
        slot_samples = round(self.slots.slot_ms * 1e-3 * block.sample_rate_hz)
        slot = block.sample_index // slot_samples
        needed = {}
        if slot != self.slot >= 0:
            needed = dict.fromkeys(self.trackers, slot * slot_samples - 1)
        if not force and self._inputs.lacking(block.sample_index, needed, self._there()):
            return None
        # A request that is there counts, though the watermark that speaks for it may be lost.
        spoken = {n: max(at, self._asked.get(n, -1)) for n, at in self._there().items()}
        self.missed = self._inputs.missed(block.sample_index, needed, spoken)
        self.blocks.popleft()
        results: list[AcquisitionResult] = []
        if slot != self.slot:
            results += self._finish(slot_samples)
            self.slot = slot
            self._begin(block, slot_samples)
        self._collect(block)
        if self._targets and self._enough():
            results += self._finish(slot_samples)
        self.consumed_through = block.sample_index + block.sample_count - 1
        # Results of a search begun in slot s take effect at slot s + latency.
        pending = slot + self.slots.latency_slots + (0 if self._targets else 1)
        self.valid_through = pending * slot_samples - 1
        self.result_count += len(results)
        return results

    def _begin(self, block: IfBlock, slot_samples: int) -> None:
        """Choose whom to search for in this slot."""
        rate = block.sample_rate_hz
        if self._baseband is None:
            self._baseband = Baseband.for_block(block)
            self._acquirer = Acquirer(rate, self.config)
        start = self.slot * slot_samples
        known = {name: self.missed.get(name, EVER - 1) + 1 for name in self.trackers}
        due = [r for r in self.requests if r[1] <= min(start, known.get(r[2], EVER))]
        self.requests = [r for r in self.requests if r not in due]
        for satellite, sample, _ in due:
            # A tracker started again asks for all; who was not tracked has a turn already.
            if satellite in self.satellites and satellite not in self.due_from:
                self.due_from[satellite] = sample
                self.lost_at[satellite] = sample
        self._targets = [s for s in self.satellites if self.due_from.get(s, start + 1) <= start]
        if self._targets and self.forecast is not None and self.clock is not None:
            self._windows = self.forecast.windows(self.clock.utc_ns(start))
        self._collected, self._start = [], block.sample_index
        for satellite in self._targets:
            recent = start - self.lost_at.get(satellite, -(1 << 60)) < 60 * rate
            wait = self.retry.retry_lost_s if recent else self.retry.retry_s
            self.due_from[satellite] = start + round(wait * rate)

    def _collect(self, block: IfBlock) -> None:
        if self._baseband is None or not self._targets:
            return
        if block.sample_index != self._start + sum(len(i) for i, _ in self._collected):
            self._collected, self._start = [], block.sample_index
        self._collected.append(self._baseband.convert(block))

    def _enough(self) -> bool:
        assert self._acquirer is not None
        return sum(len(i) for i, _ in self._collected) >= self._acquirer.samples_needed

    def _finish(self, slot_samples: int) -> list[AcquisitionResult]:
        """Search in what was collected; hand-over at the promised slot."""
        targets, self._targets = self._targets, []
        if not targets or self._acquirer is None:
            return []
        if not self._enough():  # samples are missing, or it joined within the slot
            self.due_from |= dict.fromkeys(targets, 0)
            return []
        i = np.concatenate([pair[0] for pair in self._collected])
        q = np.concatenate([pair[1] for pair in self._collected])
        self._collected = []
        self.counters["searches"] += len(targets)
        effective = (self.slot + self.slots.latency_slots) * slot_samples
        detections = self._search(i, q, targets)
        for detection in detections:
            if detection.detected:
                self.counters["found"] += 1
                self.due_from.pop(detection.satellite, None)
        return [_result(detection, effective) for detection in detections]

    def _search(
        self, i: NDArray[np.int8], q: NDArray[np.int8], targets: list[str]
    ) -> list[Detection]:
        """Search, within the forecast's windows where there is one."""
        assert self._acquirer is not None
        if self._windows is None:
            return self._acquirer.search(i, q, self._start, targets)
        seen = [satellite for satellite in targets if satellite in self._windows]
        windows = {satellite: self._windows[satellite] for satellite in seen}
        return self._acquirer.search(i, q, self._start, seen, windows) if seen else []


def _single(value: float) -> float:
    """Round to the message's precision: channels see the same with and without DDS between."""
    return float(np.float32(value))


def _result(detection: Detection, effective_sample_index: int) -> AcquisitionResult:
    return AcquisitionResult(
        satellite=detection.satellite,
        detected=detection.detected,
        sample_index=detection.sample_index,
        effective_sample_index=effective_sample_index,
        code_phase_chips=detection.code_phase_chips,
        carrier_doppler_hz=detection.carrier_doppler_hz,
        doppler_sd_hz=_single(detection.doppler_sd_hz),
        statistic=_single(detection.statistic),
        threshold=_single(detection.threshold),
        false_alarm_probability=detection.false_alarm_probability,
        cn0_dbhz=_single(detection.cn0_dbhz),
    )
