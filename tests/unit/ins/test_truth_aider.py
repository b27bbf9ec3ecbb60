"""When aiding from the truth is given, and what errors on purpose do to it."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from phase_truth import RATE, STATION
from unit.ins.test_aiding import BLOCK, START, satellite, shaken

from deepseis_ins.truth_aider import TruthAider, TruthAiderConfig
from deepseis_ins.truth_motion import Trajectory

DELAY = 5 * BLOCK
TIME = np.arange(0.0, 3.0, 0.002)
SHAKEN = Trajectory(TIME, shaken(TIME, 2.0, 19.0)[:, :3])


def aider(*, wait_pvt: bool = True, **settings: float) -> TruthAider:
    config = TruthAiderConfig(elevation_mask_deg=-90.0, **settings)
    names = ["G01", "G02", "G31"]
    made = [satellite(1), satellite(2), satellite(3)]
    return TruthAider(config, SHAKEN, START, made, names, wait_pvt=wait_pvt)


def given(made: TruthAider) -> list[int]:
    spans = []
    while (aiding := made.advance()) is not None:
        spans.append(aiding.valid_from)
    return spans


def test_a_span_waits_for_its_samples_and_for_pvt_up_to_the_delay():
    made = aider()
    assert made.waiting_for() == "samples"
    made.source_valid(10 * BLOCK - 1)
    # Spans that end less than D after the start need no PVT, which has nothing to say yet.
    assert given(made) == [k * BLOCK for k in range(5)]
    assert made.waiting_for() == "pvt"
    made.pvt_valid(BLOCK - 2)
    assert given(made) == []
    made.pvt_valid(BLOCK - 1)
    assert given(made) == [5 * BLOCK]
    made.pvt_valid(100 * BLOCK)
    assert given(made) == [k * BLOCK for k in range(6, 10)]
    assert made.valid_through == 10 * BLOCK - 1


def test_a_short_last_block_gets_its_span():
    made = aider()
    made.source_valid(BLOCK + 4)
    assert given(made) == [0, BLOCK]


def test_starting_within_a_recording_needs_no_pvt_from_before():
    made = aider(start_s=1.0)
    made.source_valid(51 * BLOCK - 1)
    assert given(made) == [50 * BLOCK]


def test_in_realtime_the_truth_does_not_wait_for_pvt():
    made = aider(wait_pvt=False)
    made.source_valid(20 * BLOCK - 1)
    assert len(given(made)) == 20


def test_only_satellites_asked_for_and_with_ephemeris_are_aided():
    assert aider().span(0, BLOCK).satellites == ("G01", "G02")


def test_satellites_below_the_mask_or_with_an_old_ephemeris_are_left_alone():
    made = aider()
    made.ephemerides[0] = dataclasses.replace(satellite(1), toe=500_000.0)
    assert made.span(0, BLOCK).satellites == ("G02",)
    config = TruthAiderConfig(elevation_mask_deg=90.0)
    none = TruthAider(config, SHAKEN, START, [satellite(1)], ["G01"]).span(0, BLOCK)
    assert (none.valid, none.satellites) == (False, ())


def test_delay_on_purpose_moves_the_motion_but_not_the_satellites():
    late = aider(delay_samples=BLOCK).span(10 * BLOCK, BLOCK)
    still = Trajectory([0.0], [STATION])
    quiet = TruthAider(
        TruthAiderConfig(elevation_mask_deg=-90.0), still, START, [satellite(1), satellite(2)],
        ["G01", "G02"],
    )  # fmt: skip
    motion = late.carrier_doppler_hz - quiet.span(10 * BLOCK, BLOCK).carrier_doppler_hz
    early = aider().span(9 * BLOCK, BLOCK)
    earlier = early.carrier_doppler_hz - quiet.span(9 * BLOCK, BLOCK).carrier_doppler_hz
    # In 20 ms the line of sight turns by 3e-6 rad, and the motion is 8 Hz.
    assert_allclose(motion, earlier, rtol=0, atol=1e-4)


def test_scale_on_purpose_scales_the_motions_doppler():
    none, half, full = (aider(motion_scale=s).span(0, BLOCK) for s in (0.0, 0.5, 1.0))
    full_motion = full.carrier_doppler_hz - none.carrier_doppler_hz
    half_motion = half.carrier_doppler_hz - none.carrier_doppler_hz
    assert np.abs(full_motion).max() > 1.0
    assert_allclose(half_motion, 0.5 * full_motion, rtol=0, atol=1e-4)


@pytest.mark.parametrize("first", [0, 7, 2999])
def test_a_span_is_the_same_whatever_was_asked_before(first):
    made = aider()
    made.span(first * BLOCK, BLOCK)
    assert_array_equal(
        made.span(40 * BLOCK, BLOCK).carrier_doppler_hz,
        aider().span(40 * BLOCK, BLOCK).carrier_doppler_hz,
    )


def test_rate_is_the_nominal_one():
    assert aider().predictor.sample_rate_hz == RATE
