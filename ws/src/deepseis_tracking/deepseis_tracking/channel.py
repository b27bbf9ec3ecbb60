"""One satellite's channel: settings, hand-over, integrations, navigation message."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from deepseis_core.config import check, setting
from deepseis_core.constants import CA_LENGTH, CA_RATE_CPS, L1_HZ
from deepseis_core.lnav_decoder import EphemerisEvent, Event, LnavDecoder, SubframeEvent
from deepseis_core.loop_noise import FALLBACK_BANDWIDTH_HZ
from deepseis_core.types import (
    AcquisitionResult,
    Aiding,
    Ephemeris,
    TrackingEpochs,
    TrackingFlag,
    TrackingMode,
)
from deepseis_tracking import channel_kernel
from deepseis_tracking.aiding_span import REASONS, AidingSpan, AidLimits
from deepseis_tracking.baseband_window import BasebandWindow
from deepseis_tracking.channel_state import CONFIG, EPOCH, EPOCH_FIELDS, STATE
from deepseis_tracking.loop_filter import LoopGains, design_loop
from deepseis_tracking.nco import aid_at
from deepseis_tracking.replica import ReplicaBank
from deepseis_tracking.sent_time import MS_PER_WEEK, SentTime

IDLE = int(TrackingMode.IDLE)
_KEPT = (
    *("carrier_phase", "pending_flags", "noise"),
    *("aid_held", "aid_failures", "aid_wait_s", "fallback_count"),
)
"""Of the state, from one signal to the next."""


@dataclass(frozen=True)
class TrackingConfig:
    """Settings of the tracking loops."""

    pll_order: int = setting(2, "conventional PLL order [-]", low=1, high=3)
    pll_bandwidth_hz: float = setting(
        15.0, "conventional PLL noise bandwidth [Hz]", low=0.5, high=50
    )
    aided_order: int = setting(2, "aided PLL order [-]", low=1, high=3)
    aided_bandwidth_hz: float = setting(8.0, "aided PLL noise bandwidth [Hz]", low=0.3, high=50)
    fallback_ms: int = setting(
        2, "integration while aiding that has been there is away; 0: no such loop [ms]",
        low=0, high=20,
    )  # fmt: skip
    fallback_order: int = setting(3, "PLL order in that time [-]", low=1, high=3)
    fallback_bandwidth_hz: float = setting(
        FALLBACK_BANDWIDTH_HZ, "PLL noise bandwidth in that time [Hz]", low=0.5, high=100
    )
    loop_design: str = setting(
        "realised",
        "bandwidth is that of the discrete loop, or the analog constants as printed [-]",
        choices=("realised", "analog"),
    )
    dll_bandwidth_hz: float = setting(
        1.0, "carrier-aided DLL noise bandwidth [Hz]", low=0.05, high=10
    )
    spacing_chips: float = setting(0.5, "early to late [chips]", low=0.05, high=1.5)
    integration_ms: int = setting(20, "coherent integration after bit sync [ms]", low=1, high=20)
    pull_in_bandwidth_hz: float = setting(18.0, "PLL bandwidth at 1 ms [Hz]", low=5, high=60)
    pull_in_ms: int = setting(250, "FLL-assisted pull-in [ms]", low=20, high=2000)
    bit_sync_limit_ms: int = setting(
        5000, "start over if bit edges are not clear by then [ms]", low=500
    )
    code_lock_dbhz: float = setting(27.0, "C/N0 that declares code lock [dB-Hz]", low=10, high=40)
    loss_dbhz: float = setting(23.0, "C/N0 that counts as lost [dB-Hz]", low=10, high=40)
    loss_s: float = setting(1.0, "give the signal up after so long below loss_dbhz [s]", low=0.1)
    bridge_s: float = setting(
        2.0, "loops go on behind a gap of samples up to so long [s]", low=0, high=10
    )
    relock_s: float = setting(
        1.5, "pull in again after so long without phase lock; 0: never [s]", low=0, high=1e6
    )
    weak_dbhz: float = setting(
        34.0, "C/N0 below which the NCO runs free in pull-in [dB-Hz]", low=0, high=60
    )
    weak_pull_in_ms: int = setting(
        1000, "stretch of such a pull-in, for Doppler and bit edges [ms]", low=200, high=5000
    )
    lock_threshold: float = setting(
        0.7, "cos(2 phase error) that declares phase lock [-]", low=0, high=1
    )
    unlock_threshold: float = setting(0.35, "... and that ends it [-]", low=0, high=1)
    aiding_form: str = setting(
        "velocity",
        "what is added to the loop: predicted Doppler, or its growth by the rates [-]",
        choices=("velocity", "acceleration"),
    )
    aid_policy: str = setting(
        "continue",
        "velocity form: the loop goes on, or is cleared at each aid epoch [-]",
        choices=("continue", "reset"),
    )
    aid_epoch_ms: int = setting(1000, "aid epoch of the policy reset [ms]", low=1, high=100_000)
    aid_sd_limit_hz: float = setting(
        5.0, "aiding whose one sigma is larger is not used [Hz]", low=0
    )
    aid_step_limit_hz: float = setting(
        0.25, "policy continue: a larger step from one message to the next is kept out [Hz]", low=0
    )
    max_extrapolation_s: float = setting(
        0.05, "aiding is extrapolated so far, then dropped [s]", low=0
    )
    feedback_delay_ms: int = setting(
        100, "delay D after which an ephemeris takes effect [ms]", low=0
    )


class Channel:
    """One satellite from hand-over to observables.

    Parameters
    ----------
    satellite : str
        RINEX name.
    sample_rate_hz : float
        Sampling rate [Hz].
    config : TrackingConfig
        Settings.
    reference_week : int
        Full GPS week near the recording, to resolve the broadcast week's rollover.

    Raises
    ------
    ValueError
        A setting is out of range, or no stable loop has the bandwidth asked for.
    """

    def __init__(
        self,
        satellite: str,
        sample_rate_hz: float,
        config: TrackingConfig | None = None,
        reference_week: int = 2200,
    ) -> None:
        self.satellite, self.config = satellite, config or TrackingConfig()
        self.sample_rate_hz = sample_rate_hz
        _check(self.config)
        self.bank = ReplicaBank(satellite, sample_rate_hz)
        self.states = np.zeros(1, STATE)
        self.state = self.states[0]
        self.configs = self._numbers()
        self.out = np.zeros(64, EPOCH)
        self.aligned = np.zeros((64, 3), np.int64)
        self.history = np.zeros((self.config.weak_pull_in_ms, 2))
        self.aiding = AidingSpan(sample_rate_hz)
        self.aid_dropped = dict.fromkeys(REASONS, 0)
        self.ephemeris_count = 0
        self.reference_week = reference_week
        self.decoder = LnavDecoder(satellite, reference_week)
        self.subframes = 0
        self.half_cycle = 0.0
        self._turned = False
        self._bit = 0.0
        self._bit_offset = -1
        self.polarity_turns = 0
        self.lost = 0
        self.just_dropped = False
        self._sent: SentTime | None = None
        self._found_again = False

    def _numbers(self) -> NDArray[np.void]:
        config, numbers = self.config, np.zeros(1, CONFIG)
        n = numbers[0]
        period = config.integration_ms * 1e-3
        realised = config.loop_design == "realised"

        def gains(loop: LoopGains) -> tuple[float, float, float]:
            return loop.k1, loop.k2, loop.k3

        n["sample_rate"] = self.sample_rate_hz
        n["spacing"] = self.bank.real_spacing_chips(config.spacing_chips)
        n["tap_offset"] = self.bank.tap_offset(config.spacing_chips)
        n["pull_in_epochs"], n["bit_sync_epochs"] = config.pull_in_ms, config.bit_sync_limit_ms
        n["pull_gains"] = gains(design_loop(2, config.pull_in_bandwidth_hz, 1e-3))
        n["fll_gain"] = 4 * 4.0 * 1e-3
        n["track_gains"] = gains(
            design_loop(config.pll_order, config.pll_bandwidth_hz, period, realised=realised)
        )
        n["aided_gains"] = gains(
            design_loop(config.aided_order, config.aided_bandwidth_hz, period, realised=realised)
        )
        short = _fallback_periods(config)
        n["fallback_periods"] = short
        if short:
            n["fallback_gains"] = gains(
                design_loop(config.fallback_order, config.fallback_bandwidth_hz, short * 1e-3)
            )
        n["dll_gain"] = design_loop(1, config.dll_bandwidth_hz, period).k1
        n["dll_fast_gain"] = design_loop(1, 4.0, 1e-3).k1
        n["lock_threshold"], n["unlock_threshold"] = config.lock_threshold, config.unlock_threshold
        n["code_lock_dbhz"], n["loss_dbhz"] = config.code_lock_dbhz, config.loss_dbhz
        n["loss_s"], n["periods"] = config.loss_s, config.integration_ms
        n["relock_s"], n["weak_dbhz"] = config.relock_s, config.weak_dbhz
        n["acceleration_form"] = config.aiding_form == "acceleration"
        if config.aid_policy == "reset":
            n["reset_samples"] = max(1, round(config.aid_epoch_ms * 1e-3 * self.sample_rate_hz))
        return numbers

    @property
    def mode(self) -> int:
        """What the channel is doing: a ``TrackingMode`` as a number."""
        return int(self.state["mode"])

    def hand_over(self, result: AcquisitionResult, sample_index: int) -> None:
        """Start pulling in at the first code period after ``sample_index``."""
        state = self.state
        kept = {name: self.states[name][0] for name in _KEPT}
        self.states[:] = np.zeros(1, STATE)
        for name, value in kept.items():
            state[name] = value
        doppler = result.carrier_doppler_hz
        if self.aiding.valid and state["aid_held"] == 0:
            doppler += self.aiding.growth(result.sample_index, sample_index)
        rate = CA_RATE_CPS * (1 + result.carrier_doppler_hz / L1_HZ) / self.sample_rate_hz
        gap = sample_index - result.sample_index
        phase = (result.code_phase_chips + gap * rate) % CA_LENGTH
        wait = math.ceil((CA_LENGTH - phase) / rate)
        state["mode"] = TrackingMode.PULL_IN
        state["next_sample"] = sample_index + wait
        state["code_phase"] = phase + wait * rate - CA_LENGTH
        state["carrier_phase"] = math.floor(state["carrier_phase"])
        state["slope_hz"] = state["nco_hz"] = doppler
        state["weak"] = result.cn0_dbhz < self.config.weak_dbhz
        state["bit_offset"] = state["transmit_ms"] = -1
        state["narrow_wide"] = -1.0
        state["cn0"] = result.cn0_dbhz
        state["code_lock"] = 1
        state["power"] = 10 ** (result.cn0_dbhz / 10)
        self._found_again = self._sent is not None
        state["pending_flags"] |= int(TrackingFlag.SLIP)
        self.decoder = LnavDecoder(self.satellite, self.reference_week)
        self.half_cycle, self._turned = 0.0, False

    def _remember(self) -> None:
        """Keep when the present code period was sent, while a lock and a subframe tell.

        A satellite found again gets its time and bit edges from that once its code is pulled in.
        """
        state = self.state
        now, code_phase = int(state["next_sample"]), float(state["code_phase"])
        if self.mode >= TrackingMode.TRACK and state["phase_lock"] and state["transmit_ms"] >= 0:
            self._sent = SentTime(now, code_phase, int(state["transmit_ms"]))
        elif self._found_again and self._sent and self.mode >= TrackingMode.BIT_SYNC:
            self._found_again = False
            doppler_hz = float(state["nco_hz"])
            sent_ms = self._sent.recall(now, code_phase, doppler_hz, self.sample_rate_hz)
            if sent_ms >= 0:
                state["transmit_ms"] = sent_ms
                state["bit_offset"] = (state["period_count"] - sent_ms) % 20

    def bridge(self, sample_index: int) -> bool:
        """Go on behind missing samples, where it is known well enough where the signal is there.

        Parameters
        ----------
        sample_index : int
            First sample that is there again.

        Returns
        -------
        bool
            False: too much is missing, or no subframe has confirmed the bit edges; see `drop`.
        """
        state, aiding = self.state, self.aiding
        missing_s = (sample_index - int(state["next_sample"])) / self.sample_rate_hz
        known = self.mode >= TrackingMode.TRACK and state["transmit_ms"] >= 0
        if not (known and 0.0 <= missing_s <= self.config.bridge_s):
            return False
        doppler_hz = float(state["nco_hz"])
        if self.mode == TrackingMode.TRACK_AIDED and self.config.aiding_form == "velocity":
            start, rate_hz = float(state["next_sample"]), self.sample_rate_hz
            record = aiding.record[0]
            doppler_hz += aid_at(start, record, aiding.knots, aiding.rates, rate_hz)
            doppler_hz += float(state["clock_hz"])
        channel_kernel.bridge(self.states, self.configs, sample_index, doppler_hz)
        return True

    def rehearse(self) -> None:
        """Compile, or load, what a gap of samples needs, and a satellite that is found again."""
        aiding, state = self.aiding, self.state
        aiding.knots, aiding.rates = np.zeros(1), np.zeros(1)
        aiding.growth(0, 1)
        state["mode"], state["transmit_ms"] = TrackingMode.TRACK_AIDED, 0
        self.bridge(0)

    def drop(self, flag: TrackingFlag) -> None:
        """Give the signal up, e.g. because samples are missing."""
        if self.mode != IDLE:
            self.lost += 1
            self.just_dropped = True
            self.state["mode"] = IDLE
            self.state["pending_flags"] |= int(flag | TrackingFlag.SLIP)

    def aid(self, aiding: Aiding) -> None:
        """Take the aiding of the next block."""
        # With the policy reset aiding is the base: the loop has nothing of its own to hold.
        goes_on = self.config.aid_policy == "continue"
        step_hz = self.config.aid_step_limit_hz if goes_on else np.inf
        limits = AidLimits(self.config.aid_sd_limit_hz, step_hz)
        reason = self.aiding.take(aiding, self.satellite, limits)
        if reason:
            self.aid_dropped[reason] += 1

    def aid_missing(self, through: int) -> None:
        """No aiding came in time for samples up to ``through``: extrapolate, or drop it."""
        age = (through - self.aiding.through) / self.sample_rate_hz
        if self.aiding.valid and age > self.config.max_extrapolation_s:
            self.aiding.valid = False
            self.aid_dropped["late"] += 1

    def advance(
        self, window: BasebandWindow, block_sample_index: int, valid_through: int
    ) -> tuple[TrackingEpochs, list[Ephemeris]]:
        """Run every integration that ends in the window.

        Parameters
        ----------
        window : BasebandWindow
            Samples up to the end of the block.
        block_sample_index : int
            First sample of the block.
        valid_through : int
            What to promise if the channel is idle.

        Returns
        -------
        TrackingEpochs, list of Ephemeris
            The block's integrations, and ephemerides completed in it.
        """
        self.state["noise"] = window.noise
        self._bit_offset = int(self.state["bit_offset"])
        was_active = self.mode != IDLE
        aiding = self.aiding
        count = channel_kernel.advance(
            self.states,
            self.configs,
            window.i,
            window.q,
            window.start,
            window.end,
            self.bank.rows,
            self.bank.chips_per_sample,
            aiding.record,
            aiding.knots,
            aiding.rates,
            self.history,
            self.out,
            self.aligned,
        )
        rows = self.out[:count].copy()
        diverged = rows["flags"] & int(TrackingFlag.AID_DIVERGED)
        self.aid_dropped["diverged"] += int(np.count_nonzero(diverged))
        self._bit_offset = max(self._bit_offset, int(self.state["bit_offset"]))
        self._remember()
        ephemerides = self._navigation(rows)
        if self.mode == IDLE:
            self.lost += was_active
        else:
            valid_through = int(self.state["next_sample"]) - 1
        columns = {name: rows[name] for name in EPOCH_FIELDS}
        epochs = TrackingEpochs(
            satellite=self.satellite,
            block_sample_index=block_sample_index,
            valid_through=valid_through,
            ephemeris_count=self.ephemeris_count,
            mode=self.mode,
            **columns,
        )
        return epochs, ephemerides

    def _navigation(self, rows: NDArray[np.void]) -> list[Ephemeris]:
        """Feed data bits to the decoder and apply what it finds to the channel's state."""
        if self.half_cycle:
            rows["carrier_phase_cycles"] += self.half_cycle
        if self._turned and len(rows):
            rows["flags"][0] |= TrackingFlag.HALF_CYCLE
            self._turned = False
        found: list[Ephemeris] = []
        count = len(rows)
        prompts = rows["prompt_i"].tolist()
        for k, (period, periods, aligned) in enumerate(self.aligned[:count].tolist()):
            if not aligned:
                continue
            since_edge = period - self._bit_offset
            part = since_edge % 20
            self._bit = prompts[k] + (self._bit if part else 0.0)
            if part + periods < 20:
                continue
            for event in self.decoder.push([self._bit], since_edge // 20):
                found += self._apply(event, int(rows["sample_index"][k] + rows["sample_count"][k]))
        return found

    def _apply(self, event: Event, end_sample: int) -> list[Ephemeris]:
        """Put a decoder's event into the channel's state."""
        if isinstance(event, SubframeEvent):
            state = self.state
            self.subframes += 1
            self.polarity_turns += event.half_cycle
            start_period = event.bit_index * 20 + self._bit_offset
            elapsed = int(state["period_count"]) - start_period
            state["transmit_ms"] = (event.tow_ms + elapsed) % MS_PER_WEEK
            state["polarity"] = 1
            half_cycle = 0.5 if event.polarity < 0 else 0.0
            self._turned = self._turned or half_cycle != self.half_cycle
            self.half_cycle = half_cycle
        if not isinstance(event, EphemerisEvent):
            return []
        self.ephemeris_count += 1
        delay = int(self.config.feedback_delay_ms * 1e-3 * self.sample_rate_hz)
        return [replace(event.ephemeris, effective_sample_index=end_sample + delay)]


def _fallback_periods(config: TrackingConfig) -> int:
    """Return the longest integration of `fallback` that divides a normal one [ms]."""
    longest = min(config.fallback_ms, config.integration_ms)
    return max((k for k in range(1, longest + 1) if config.integration_ms % k == 0), default=0)


def _check(config: TrackingConfig) -> None:
    """Raise ValueError where settings are out of range or exclude each other."""
    check(config)
    if 20 % config.integration_ms:
        raise ValueError(f"integration_ms = {config.integration_ms} does not divide 20")
    if config.aid_policy == "reset" and config.aiding_form != "velocity":
        raise ValueError("aid_policy = reset needs aiding_form = velocity")
