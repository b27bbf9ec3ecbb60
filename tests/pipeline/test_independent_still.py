"""A signal nobody here made, antenna still: carrier phase at the thermal limit, aided or not."""

import dataclasses

import numpy as np
import pytest
from phase_truth import INTEGRATION, STILL, PhaseErrors, Station, Truth, collect

from deepseis_core.types import TrackingFlag

FIRST, LAST = 4.0, 39.9
SETTLED = 2.0
"""Pull-in, bit synchronisation and the lock detectors are done [s]."""


@pytest.fixture(scope="module")
def folder(shared_data):
    return shared_data / "if_captures" / "independent_sim"


@pytest.fixture(scope="module")
def truth(folder):
    return Truth(folder, STILL)


def tracked(folder, truth, **station):
    station = Station(folder, STILL, truth.satellites, **station)
    tracks = collect(station.run())
    assert not station.channels.blocks, f"waits for {station.channels.waiting_for()}"
    return station, tracks, PhaseErrors(truth, tracks, FIRST, LAST)


@pytest.mark.parametrize(("aided", "bandwidth_hz"), [(False, 15.0), (True, 8.0)])
def test_every_satellite_is_within_a_fifth_of_the_thermal_limit(
    folder, truth, aided, bandwidth_hz
):
    _, tracks, errors = tracked(folder, truth, aided=aided)
    assert errors.ratio(bandwidth_hz, FIRST, LAST).max() <= 1.2
    for name in truth.satellites:
        assert tracks[name].unlocked_after(SETTLED) == 0
        assert tracks[name].aided_after(SETTLED) == float(aided)
    # Half a cycle would be a slip; 10 s means of 1.4 deg at 8 Hz scatter by less than 0.1 deg.
    assert np.abs(errors.step((5, 15), (25, 35))).max() < 0.01


def test_switching_aiding_off_and_on_leaves_no_mark(folder, truth):
    def change(aiding):
        off = 10.0 <= aiding.valid_from / 4e6 < 20.0
        return dataclasses.replace(aiding, valid=False) if off else aiding

    _, tracks, errors = tracked(folder, truth, aided=True, change=change)
    for name in truth.satellites:
        assert tracks[name].unlocked_after(SETTLED) == 0
        assert 0.7 < tracks[name].aided_after(SETTLED) < 0.8
    assert errors.ratio(8.0, FIRST, 10.0).max() <= 1.2
    # Order 3, 2 ms, 50 Hz while it is away.
    assert errors.ratio(50.0, 11.0, 20.0).max() <= 1.2
    assert errors.ratio(8.0, 21.0, LAST).max() <= 1.2
    # Each switch within its own noise: the mean of 0.2 s after it, 4 sigma of the noise alone.
    for moment in (10.0, 20.0):
        step = errors.step((moment - 2, moment), (moment, moment + 0.2))
        assert np.all(np.abs(step) < 4 * errors.rms(11.0, 20.0))


def test_late_aiding_is_extrapolated_and_flagged(folder, truth):
    def change(aiding):
        late = aiding.valid_from // 80_000 % 25 == 24
        return None if late else aiding

    station, tracks, errors = tracked(folder, truth, aided=True, change=change)
    blocks = station.channels.counters["blocks"]
    assert station.channels.counters["aid_missed"] == blocks // 25
    assert errors.ratio(8.0, FIRST, LAST).max() <= 1.2
    for name in truth.satellites:
        assert tracks[name].unlocked_after(SETTLED) == 0
        age = tracks[name].column("aid_age_s")
        flagged = (tracks[name].column("flags") & TrackingFlag.AID_MISSED) != 0
        assert np.array_equal(flagged, age > 0)
        assert 0.9 * blocks / 25 < flagged.sum() <= blocks / 25
        assert age.max() <= INTEGRATION + 1e-5
