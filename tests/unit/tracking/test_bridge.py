"""Loops go on behind a gap of samples: code and time are known there, the phase is found anew."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from unit.tracking.one_signal import BLOCK, RATE, Signal, aiding_of, circle, column

from deepseis_core.constants import CA_LENGTH
from deepseis_core.types import TrackingFlag, TrackingMode
from deepseis_tracking.baseband_window import BasebandWindow
from deepseis_tracking.channel import Channel, TrackingConfig

FIRST = 4.2
"""The gap begins [s]; the circle of 2 g at 2 Hz turns from 3.5 s on."""


def run(signal, missing, seconds, *, aided=True, config=None, gone=False):
    """Track, with blocks missing from `FIRST` on; return channel, epochs, what bridge says."""
    channel = Channel("G07", RATE, config or TrackingConfig())
    channel.hand_over(signal.result(), 0)
    window, aiding, epochs, bridged = BasebandWindow(BLOCK + 60_000), aiding_of(signal), [], None
    begin, end = round(FIRST / 0.02), round((FIRST + missing) / 0.02)
    for index in [*range(begin), *range(end, round(seconds / 0.02))]:
        i, q = signal.block(index)
        if gone and index >= end:
            rng = np.random.default_rng(index)
            i, q = (np.rint(20.0 * rng.normal(size=BLOCK)).astype(np.int8) for _ in range(2))
        joined = window.push(i, q, index * BLOCK)
        if not joined:
            bridged = channel.bridge(index * BLOCK)
        if aided and joined:
            channel.aid(aiding(index))
        elif aided:
            channel.aid_missing((index + 1) * BLOCK - 1)
        epochs.append(channel.advance(window, index * BLOCK, -1)[0])
        if index == 150:  # as if a subframe had told it
            channel.state["transmit_ms"] = 77_000 + channel.state["period_count"]
    return channel, epochs, bridged


@pytest.mark.parametrize(("missing", "aided"), [(0.42, True), (1.9, True), (0.42, False)])
def test_behind_a_gap_time_and_code_are_right_at_once_and_the_phase_soon(missing, aided):
    signal = Signal(46.0, motion=circle)
    # Alone a loop needs the wide design for 2 g.
    config = (
        None if aided else TrackingConfig(pll_order=3, pll_bandwidth_hz=40.0, integration_ms=2)
    )
    channel, epochs, bridged = run(
        signal, missing, FIRST + missing + 1.5, aided=aided, config=config
    )
    assert bridged
    assert channel.mode >= TrackingMode.TRACK
    start = column(epochs, "sample_index") / RATE
    flags, transmit = column(epochs, "flags"), column(epochs, "transmit_ms")
    assert not ((start >= FIRST) & (start < FIRST + missing)).any()
    (first,) = np.flatnonzero(flags & TrackingFlag.GAP)
    assert flags[first] & TrackingFlag.SLIP
    assert FIRST + missing <= start[first] < FIRST + missing + 0.0011
    # From the first millisecond on: sent when the signal says, but for the noise of the code.
    known = transmit >= 0
    sent = transmit * CA_LENGTH + column(epochs, "code_phase_chips")
    off = (sent - signal.code_chips(start))[known]
    before, after = off[start[known] < FIRST], off[start[known] > FIRST]
    assert np.abs(after - np.median(before)).max() < 0.1  # half of early to late: 0.25
    locked = start[(start > FIRST) & (flags & TrackingFlag.PHASE_LOCK > 0)]
    unlocked = start[(start > FIRST) & (flags & TrackingFlag.PHASE_LOCK == 0)]
    assert locked[0] < FIRST + missing + 0.1
    assert unlocked.max(initial=0.0) < FIRST + missing + 0.7


def test_a_signal_that_is_not_there_any_more_is_given_up_as_soon_as_ever():
    signal = Signal(46.0, motion=circle)
    channel, epochs, bridged = run(signal, 0.5, FIRST + 2.2, gone=True)
    assert bridged
    assert channel.mode == TrackingMode.IDLE
    last = column(epochs, "sample_index")[-1] / RATE
    assert last < FIRST + 0.5 + TrackingConfig().loss_s + 0.5


def test_a_long_gap_or_bits_that_no_subframe_confirms_are_not_bridged():
    signal = Signal(46.0, motion=circle)
    short = TrackingConfig(bridge_s=0.2)
    assert run(signal, 0.3, FIRST + 0.36, config=short)[2] is False
    channel, _, _ = run(signal, 0.0, FIRST)
    channel.state["transmit_ms"] = -1
    assert not channel.bridge(round(FIRST * RATE) + 1000)
    channel.state["mode"] = TrackingMode.IDLE
    assert not channel.bridge(round(FIRST * RATE) + 1000)


@pytest.mark.parametrize("chips_off", [0.0, 300.0])
def test_a_satellite_found_again_knows_its_time_if_the_code_is_where_it_should_be(chips_off):
    signal = Signal(46.0)
    channel, epochs, _ = run(signal, 0.0, FIRST, aided=False)
    start, transmit = column(epochs, "sample_index"), column(epochs, "transmit_ms")
    chips = signal.code_chips(start / RATE)
    ahead = transmit - (chips - column(epochs, "code_phase_chips")) / CA_LENGTH
    channel.drop(TrackingFlag.SLIP)
    signal = Signal(46.0)
    signal.start_chips += chips_off
    first, last = 300, 325  # blocks: 1.8 s later, half a second
    at = first * BLOCK
    found = replace(
        signal.result(), sample_index=at, code_phase_chips=signal.code_chips(at / RATE) % 1023
    )
    channel.hand_over(found, at)
    window, later = BasebandWindow(BLOCK + 60_000), []
    for index in range(first, last):
        window.push(*signal.block(index), index * BLOCK)
        later.append(channel.advance(window, index * BLOCK, -1)[0])
    transmit, flags = column(later, "transmit_ms"), column(later, "flags")
    start = column(later, "sample_index") / RATE
    pulling_in = start < at / RATE + 0.25
    assert (transmit[pulling_in] < 0).all(), "not before the code is pulled in"
    if chips_off:
        assert (transmit < 0).all()
        return
    known = start > at / RATE + 0.28
    assert (flags[known] & TrackingFlag.BIT_SYNC > 0).all()
    right = (signal.code_chips(start) - column(later, "code_phase_chips"))[known] / CA_LENGTH
    assert transmit[known] - right == pytest.approx(ahead[-1], abs=1e-3)
    state = channel.state
    assert (state["transmit_ms"] - state["period_count"] + state["bit_offset"]) % 20 == 0
    assert channel.mode == TrackingMode.TRACK, "0.35 s: no bit synchronisation anew"


REHEARSED = """
from unit.tracking.one_signal import Signal, circle
from unit.tracking.test_bridge import FIRST, run
from deepseis_tracking import channel_kernel, nco
from deepseis_tracking.channel import TrackingConfig
from deepseis_tracking.engine import SlotConfig, TrackingEngine
kernels = channel_kernel.bridge, nco.aid_at, nco.aid_growth
TrackingEngine(["G07"], TrackingConfig(), SlotConfig()).compile()
before = [set(kernel.signatures) for kernel in kernels]
assert all(before), before
assert run(Signal(46.0, motion=circle), 0.3, FIRST + 0.4)[2]
assert [set(kernel.signatures) for kernel in kernels] == before
"""


def test_nothing_is_compiled_at_the_first_gap():
    """In a process of its own: here all has been compiled already."""
    tests = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", REHEARSED], check=True, timeout=120, cwd=tests)
