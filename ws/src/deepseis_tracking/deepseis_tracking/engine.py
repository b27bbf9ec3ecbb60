"""The satellites of one process, block by block in order of validity.

Time is cut into *slots* (default 0.5 s). The acquisition's results take effect at the start of a
slot, never in between, so a channel without a signal can promise to be idle through the slot's
end with one message, and the channels look at the acquisition's watermark once a slot.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from deepseis_core.baseband import Baseband
from deepseis_core.config import setting
from deepseis_core.counted import CountedInput
from deepseis_core.errors import InputError
from deepseis_core.miss_log import EVER, Inputs, MissScript
from deepseis_core.types import (
    AcquisitionResult,
    Aiding,
    Ephemeris,
    IfBlock,
    TrackingEpochs,
    TrackingFlag,
    TrackingMode,
)
from deepseis_tracking.aiding_span import REASONS
from deepseis_tracking.baseband_window import BasebandWindow
from deepseis_tracking.channel import Channel, TrackingConfig

ALL_SATELLITES = [f"G{prn:02d}" for prn in range(1, 33)]
STALE_S = 2.0
"""A code phase found so long ago may have drifted away: 10 Hz are 0.013 chips [s]."""


@dataclass(frozen=True)
class SlotConfig:
    """What the channels and the acquisition must agree on."""

    satellites: list[str] = setting(ALL_SATELLITES, "satellites of the station, RINEX names [-]")
    slot_ms: int = setting(
        500, "acquisition results take effect at multiples of this [ms]", low=20
    )
    latency_slots: int = setting(1, "slots from the search's start to the hand-over [-]", low=1)
    reference_week: int = setting(
        2200, "full GPS week within ten years of the signal [weeks]", low=0
    )


def check_satellites(names: list[str]) -> tuple[str, ...]:
    """Put satellite names in order.

    Raises
    ------
    InputError
        A name is not G01 to G32.
    """
    for name in names:
        if name not in ALL_SATELLITES:
            raise InputError(f"satellite {name!r}", "is not a GPS satellite", "G01 to G32")
    return tuple(sorted(set(names)))


@dataclass
class BlockOutput:
    """What one IF block gave."""

    block: IfBlock
    epochs: list[TrackingEpochs] = field(default_factory=list)
    ephemerides: list[Ephemeris] = field(default_factory=list)
    requests: list[tuple[str, int]] = field(default_factory=list)
    missed: dict[str, int] = field(default_factory=dict)
    """What was not waited for, and through which sample it was there."""


class TrackingEngine:
    """Channels of some satellites over one stream of IF blocks.

    Parameters
    ----------
    satellites : sequence of str
        RINEX names; one channel each.
    config : TrackingConfig
        Loop settings.
    slots : SlotConfig
        Slot length.
    wait_acquisition, wait_aiding : bool
        Whether the graph has these members: then no block is worked through before they have
        spoken for it.
    script : MissScript, optional
        What the run that is replayed did not wait for.
    """

    def __init__(
        self,
        satellites: tuple[str, ...],
        config: TrackingConfig,
        slots: SlotConfig,
        *,
        wait_acquisition: bool = True,
        wait_aiding: bool = False,
        script: MissScript | None = None,
    ) -> None:
        self._inputs = Inputs(script)
        self.satellites, self.config, self.slots = satellites, config, slots
        self.wait_acquisition, self.wait_aiding = wait_acquisition, wait_aiding
        self.channels: dict[str, Channel] = {}
        self.blocks: deque[IfBlock] = deque()
        self.results: list[AcquisitionResult] = []
        self.acquisition = CountedInput()
        self.aiding: deque[Aiding] = deque()
        self.aiding_through = -1
        self.request_count = 0
        self.window = BasebandWindow(0)
        self.baseband: Baseband | None = None
        self.slot = -1
        self.done_through = -1
        self.joined_at = self._stale_through = -1
        counted = "blocks", "gaps", "bridged", "aid_missed", "late_results"
        self.counters = dict.fromkeys(counted, 0)

    def compile(self) -> None:
        """Compile the kernels (or load them from the cache) before samples arrive."""
        channel = Channel(self.satellites[0], 4e6, self.config, self.slots.reference_week)
        window = BasebandWindow(0)
        blank = np.zeros(64, np.int8)
        window.push(blank, blank, 0)
        channel.advance(window, 0, 0)
        channel.rehearse()

    def join(self, sample: int, sample_rate_hz: float) -> None:
        """Begin at a sample of a running graph: all channels are idle, and say so.

        All satellites are asked for anew; of what was found before, which a late reader gets too,
        only the newest is of use. Counts of results are not waited for.
        """
        self.joined_at = sample
        self.acquisition.trust()
        self._stale_through = sample - round(STALE_S * sample_rate_hz)

    def push_block(self, block: IfBlock) -> None:
        """Take the next IF block; blocks come in order."""
        self.blocks.append(block)

    def push_result(self, result: AcquisitionResult) -> None:
        """Take an acquisition result."""
        self.acquisition.received()
        if result.detected and result.satellite in self.satellites:
            self.results.append(result)

    def push_aiding(self, aiding: Aiding) -> None:
        """Take the aiding of a span; spans come in order. Messages carry the tables flat."""
        aiding = _shaped(aiding)
        self.aiding.append(aiding)
        self.aiding_through = max(self.aiding_through, aiding.valid_through)

    def acquisition_valid(self, through: int, result_count: int) -> None:
        """Note that all ``result_count`` results up to ``through`` have been published."""
        self.acquisition.announced(result_count, through)

    def _slot_of(self, block: IfBlock) -> int:
        return block.sample_index // self._slot_samples(block)

    def _slot_samples(self, block: IfBlock) -> int:
        return round(self.slots.slot_ms * 1e-3 * block.sample_rate_hz)

    def next_through(self) -> int:
        """Return the last sample of the next block; never, if there is none."""
        if not self.blocks:
            return EVER
        return self.blocks[0].sample_index + self.blocks[0].sample_count - 1

    def waiting_for(self) -> str:
        """Name what the next block waits for: acquisition, aiding, samples or nothing."""
        if not self.blocks:
            return "samples"
        block = self.blocks[0]
        lacking = self._inputs.lacking(block.sample_index, self._needed(block), self._there())
        return next(iter(lacking), "")

    def _needed(self, block: IfBlock) -> dict[str, int]:
        """Return how far each input has to be there for a block."""
        needed = {}
        if self.wait_acquisition and self._slot_of(block) != self.slot >= 0:
            needed["acquisition"] = self._slot_of(block) * self._slot_samples(block)
        if self.wait_aiding and not self._follows_a_gap(block):
            needed["aiding"] = block.sample_index + block.sample_count - 1
        return needed

    def _follows_a_gap(self, block: IfBlock) -> bool:
        """Tell a block before which samples are missing.

        Its channels begin anew, so they have no use for aiding; and who makes the aiding waits for
        observations, which cannot go on through the gap before this block is done.
        """
        return 0 <= self.done_through < block.sample_index - 1

    def _there(self) -> dict[str, int]:
        return {"acquisition": self.acquisition.valid_through, "aiding": self.aiding_through}

    @property
    def is_tracking(self) -> bool:
        """Whether any channel has a signal."""
        return any(channel.mode != TrackingMode.IDLE for channel in self.channels.values())

    def advance(self, *, force: bool = False) -> BlockOutput | None:
        """Work through one block if its inputs are there.

        Parameters
        ----------
        force : bool
            Do not wait any longer (a deadline has passed): aiding is extrapolated or dropped.

        Returns
        -------
        BlockOutput or None
            None when there is nothing to do yet.
        """
        missing = self.waiting_for()
        if missing == "samples" or (missing and not force):
            return None
        block = self.blocks.popleft()
        missed = self._inputs.missed(block.sample_index, self._needed(block), self._there())
        output = BlockOutput(block, missed=missed)
        slot = self._slot_of(block)
        new_slot, self.slot = slot != self.slot, slot
        self._prepare(block)
        if 0 <= self.joined_at == block.sample_index:
            output.requests += [(satellite, block.sample_index) for satellite in self.channels]
            self.request_count += len(self.channels)
        if new_slot:
            # Not before the samples at hand: the stream may begin, or go on, within a slot.
            start = slot * self._slot_samples(block)
            self._hand_over(max(start, block.sample_index), missed.get("acquisition", EVER))
        end = block.sample_index + block.sample_count
        if self._follows_a_gap(block):
            for channel in self.channels.values():
                channel.aid_missing(end - 1)
        else:
            self._take_aiding(end - 1, missed.get("aiding"))
        slot_end = (slot + 1) * self._slot_samples(block) - 1
        for satellite, channel in self.channels.items():
            active = channel.mode != TrackingMode.IDLE
            if not (active or new_slot or channel.just_dropped):
                continue
            epochs, ephemerides = channel.advance(self.window, block.sample_index, slot_end)
            output.epochs.append(epochs)
            output.ephemerides += ephemerides
            if channel.mode == TrackingMode.IDLE and (active or channel.just_dropped):
                output.requests.append((satellite, end))
                self.request_count += 1
            channel.just_dropped = False
        self.done_through = end - 1
        return output

    def _prepare(self, block: IfBlock) -> None:
        """Baseband of the block; where samples are missing channels go on, or are dropped."""
        if self.baseband is None:
            self.baseband = Baseband.for_block(block)
            history = block.sample_count + int(0.025 * block.sample_rate_hz)
            self.window = BasebandWindow(history)
            for satellite in self.satellites:
                self.channels[satellite] = Channel(
                    satellite, block.sample_rate_hz, self.config, self.slots.reference_week
                )
        self.counters["blocks"] += 1
        i, q = self.baseband.convert(block)
        if not self.window.push(i, q, block.sample_index):
            self.counters["gaps"] += 1
            for channel in self.channels.values():
                if channel.bridge(block.sample_index):
                    self.counters["bridged"] += 1
                else:
                    channel.drop(TrackingFlag.GAP)

    def _hand_over(self, start: int, known: int) -> None:
        """Give results that are due, and known by then, to idle channels."""
        last = min(start, known)
        due = [r for r in self.results if r.effective_sample_index <= last]
        due = [r for r in due if r.effective_sample_index > self._stale_through]
        self.results = [r for r in self.results if r.effective_sample_index > last]
        for result in sorted(due, key=lambda r: (r.effective_sample_index, r.satellite)):
            channel = self.channels[result.satellite]
            if channel.mode == TrackingMode.IDLE:
                self.counters["late_results"] += result.effective_sample_index < start
                channel.hand_over(result, max(result.effective_sample_index, start))

    def _take_aiding(self, last_sample: int, missed: int | None) -> None:
        known = EVER if missed is None else missed
        while (
            self.aiding
            and self.aiding[0].valid_from <= last_sample
            and self.aiding[0].valid_through <= known
        ):
            aiding = self.aiding.popleft()
            for channel in self.channels.values():
                channel.aid(aiding)
        if missed is not None:
            self.counters["aid_missed"] += 1
            for channel in self.channels.values():
                channel.aid_missing(last_sample)

    def health(self) -> tuple[bool, str, dict[str, object]]:
        """Whether something was lost, one line, and all counters."""
        tracked = [n for n, c in self.channels.items() if c.mode >= TrackingMode.TRACK]
        channels = self.channels.values()
        values: dict[str, object] = dict(self.counters)
        values["lost"] = sum(c.lost for c in channels)
        dropped = {reason: sum(c.aid_dropped[reason] for c in channels) for reason in REASONS}
        values |= {f"aid_{reason}": count for reason, count in dropped.items()}
        values["fallbacks"] = sum(int(c.state["fallback_count"]) for c in channels)
        values["in_fallback"] = sum(int(c.state["fallback"]) for c in channels)
        values["polarity_turns"] = sum(c.polarity_turns for c in channels)
        values["subframes"] = sum(c.subframes for c in channels)
        values["subframes_failed"] = sum(c.decoder.failed_count for c in channels)
        for name, channel in self.channels.items():
            if channel.mode != TrackingMode.IDLE:
                values[f"{name}_cn0_dbhz"] = f"{float(channel.state['cn0']):.1f}"
        wrong = self._leap_seconds(values)
        lost = bool(self.counters["gaps"] or self.counters["aid_missed"] or dropped["diverged"])
        text = f"tracking {len(tracked)}: {' '.join(tracked)}"
        return lost or bool(wrong), text + wrong, values

    def _leap_seconds(self, values: dict[str, object]) -> str:
        """Compare what the satellites tell with the table; return a complaint."""
        heard = [c.decoder.utc.told() for c in self.channels.values() if c.decoder.utc]
        if not heard:
            return ""
        when, told = max(heard)
        values["leap_seconds"] = told
        known = when.leap_seconds()
        if told == known:
            return ""
        return (
            f"; GPS - UTC is {told} s by the satellites, {known} s by the table: update DeepSeis"
        )


def _shaped(aiding: Aiding) -> Aiding:
    """Give the tables their shape, a row a satellite; one whose sizes do not fit is invalid."""
    shape = (len(aiding.satellites), aiding.knot_count)
    doppler, rate = np.asarray(aiding.carrier_doppler_hz), np.asarray(aiding.carrier_doppler_rate)
    sd = np.asarray(aiding.doppler_sd_hz)
    fits = doppler.size == rate.size == shape[0] * shape[1] and sd.size == shape[0]
    if not fits:
        return replace(aiding, valid=False)
    return replace(
        aiding,
        carrier_doppler_hz=doppler.reshape(shape),
        carrier_doppler_rate=rate.reshape(shape),
    )
