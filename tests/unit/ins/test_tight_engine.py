"""Fusion with ranges of single satellites on the bench: aiding, blockage, undoing, solution."""

from dataclasses import fields, replace

import numpy as np
import pytest
from fusion_bench import EVERYTHING, FusionBench, as_bytes, watermarks

from deepseis_core.errors import InputError
from deepseis_core.selection import HIGHEST
from deepseis_core.types import InsFilter, PvtStatus
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_output import INNOVATIONS
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.tight_engine import SATELLITES

TIGHT = FusionConfig(coupling="tight")
LAST = 30.0


@pytest.fixture(scope="module")
def bench():
    return FusionBench("sine-2hz", "span-fsas", f"duration={LAST}")


@pytest.fixture(scope="module")
def loose(bench):
    return bench.run(bench.engine())


@pytest.fixture(scope="module")
def tight(bench):
    return bench.run(bench.engine(TIGHT))


def kept(observations, satellites, begin, end, rate):
    """Return observations with nothing but some satellites in an interval [s]."""

    def cut(epoch):
        if not begin <= epoch.sample_index / rate < end:
            return epoch
        there = np.array([name in satellites for name in epoch.satellites])
        parts = {
            item.name: value[there]
            for item in fields(epoch)
            if isinstance(value := getattr(epoch, item.name), np.ndarray)
        }
        names = tuple(name for name in epoch.satellites if name in satellites)
        return replace(epoch, satellites=names, **parts)

    return [cut(epoch) for epoch in observations]


def without(pvts, begin, end, rate):
    """Return positions with nothing in an interval [s]."""
    return [
        replace(pvt, status=PvtStatus.NONE) if begin <= pvt.sample_index / rate < end else pvt
        for pvt in pvts
    ]


def position_error(bench, outputs):
    """Return times [s] and errors, east, north, up, shape (m, 3) [m]."""
    solutions = [s.solution for s in outputs.spans if len(s.solution.sample_index)]
    samples = np.concatenate([s.sample_index for s in solutions])
    position = np.concatenate([s.position_enu for s in solutions])
    time = samples / bench.sample_rate_hz
    return time, position - bench.bench.motion.at(time - bench.bench.clock(time)).position


def test_its_aiding_is_as_good_as_that_of_positions(bench, loose, tight):
    """The same Doppler measurements move both; what loops of 8 Hz make of it is 0.1 deg at most.

    With 1 deg of noise in them that adds half a percent.
    """
    begin, _ = bench.bench.motion.span
    moving = tight.between(begin, LAST - 0.1)  # the last IMU sample ends behind the run
    phase = [np.std(x.between(begin, LAST).phase_error(8.0)[:, 500:]) for x in (loose, tight)]
    assert phase[1] < 0.1
    assert phase[1] < 1.5 * phase[0]
    assert all(item.aiding.valid for item in tight.between(8.0, LAST).spans)
    # Its sigma is honest: normalised errors near 1, and none without bound.
    assert 0.2 < np.std(moving.error()) / np.sqrt(np.mean(moving.sd() ** 2)) < 1.5


def test_position_does_not_jump_to_what_single_points_say(bench, tight):
    """Slow errors of the satellites, metres of air, are learnt at rest and taken off."""
    time, error = position_error(bench, tight)
    assert np.abs(error[time > bench.bench.motion.span[0]]).max() < 0.2


@pytest.mark.parametrize("count", [pytest.param(3, marks=pytest.mark.slow), 2])
def test_fewer_than_four_satellites_hold_the_velocity(bench, count):
    """From the onset on only some satellites: no position at all, the loops are aided on."""
    begin, _ = bench.bench.motion.span
    rate = bench.sample_rate_hz
    names = bench.inputs.observations[50].satellites[:count]
    seen = kept(bench.inputs.observations, names, begin + 1.0, LAST, rate)
    pvts = without(bench.inputs.pvt, begin + 1.0, LAST, rate)
    engines = [bench.engine(c, observations=seen, pvt=pvts) for c in (TIGHT, FusionConfig())]
    some, _ = (bench.run(engine) for engine in engines)
    assert all(item.aiding.valid for item in some.between(begin, LAST).spans)
    sds = [engine.delayed.filter.sd[3:6].max() for engine in engines]
    assert sds[0] < sds[1]  # they help, as far as they go
    late = some.between(LAST - 2.0, LAST)
    assert np.std(late.error()) < 2.0 * np.sqrt(np.mean(late.sd() ** 2))
    _, off = position_error(bench, some)
    sd = engines[0].delayed.covariances()[0][:3, :3]
    assert np.all(np.abs(off[-1]) < 4.0 * np.sqrt(np.diag(sd)[[1, 0, 2]]))


@pytest.mark.slow
def test_raw_or_smoothed_all_or_four_all_hold(bench):
    begin, end = bench.bench.motion.span
    for config in (
        RangeConfig(smooth_ranges=False, range_selection=HIGHEST),
        RangeConfig(ranges_hz=1.0),
    ):
        found = bench.run(bench.engine(TIGHT, ranges=config)).between(begin, end)
        assert np.std(found.error()) < 8e-3
        assert all(item.aiding.valid for item in found.spans)


def test_the_solution_says_what_the_filter_knows(bench, tight):
    last = [s.solution for s in tight.spans if len(s.solution.sample_index)][-1]
    n = len(last.sample_index)
    assert last.filter == InsFilter.TIGHT
    assert last.state_sd.shape == (n, 17)
    seconds = last.sample_index / bench.sample_rate_hz
    true = 299_792_458.0 * bench.bench.clock(seconds)
    # The ranges' mean slow error is in the clock: metres of air.
    assert np.abs(last.clock_bias - true).max() < 15.0
    rate = np.diff(true) / np.diff(seconds)
    assert np.abs(last.clock_drift[1:] - rate).max() < 0.1
    begin, _ = bench.bench.motion.span
    moving = [s.solution for s in tight.between(begin, LAST).spans]
    rows = np.concatenate([s.innovation for s in moving])
    assert rows.shape[1] == INNOVATIONS + 2 * SATELLITES
    ranges, rates = rows[:, INNOVATIONS:-SATELLITES], rows[:, -SATELLITES:]
    seen = np.isfinite(rates).sum(axis=1)
    assert len(rows) > 9.0 * (LAST - begin)
    assert seen.min() >= 8
    assert np.array_equal(np.isfinite(ranges), np.isfinite(rates))
    assert np.mean(np.concatenate([s.innovation_accepted for s in moving])) > 0.95


def test_pieces_in_any_order_give_the_same_bytes(bench, tight):
    """Everything comes just in time, observations after positions, and it is all the same."""
    engine = bench.empty_engine(TIGHT)
    waiting = {name: list(getattr(bench.inputs, name)) for name in ("imu", "pvt", "observations")}
    pushes = {
        "imu": engine.push_imu, "pvt": engine.push_pvt, "observations": engine.push_observations,
    }  # fmt: skip
    for state in bench.inputs.motion:
        engine.push_motion(state)
    engine.motion_valid(EVERYTHING)
    for expected in tight.spans[:1050]:
        end = engine.next_sample + engine.block
        for name in ("imu", "observations", "pvt"):
            while waiting[name] and waiting[name][0].sample_index <= end:
                pushes[name](waiting[name].pop(0))
        for valid in watermarks(engine):
            if valid != engine.motion_valid:
                valid(end)
        assert as_bytes(engine.advance()) == as_bytes(expected)


@pytest.mark.slow
def test_what_is_undone_is_done_again_the_same(bench, tight):
    """Motion that is noticed late, and everything measured meanwhile, is worked through anew."""
    engine = bench.engine(TIGHT)
    for expected in tight.spans[:1000]:
        assert as_bytes(engine.advance()) == as_bytes(expected)
    errors = engine.delayed.errors
    engine.delayed.rewind(engine.next_sample - round(2.0 * bench.sample_rate_hz))
    assert engine.delayed.errors is not errors
    for expected in tight.spans[1000:1100]:
        output = engine.advance()
        assert np.array_equal(output.aiding.carrier_doppler_hz, expected.aiding.carrier_doppler_hz)


def test_an_oscillator_on_the_body_is_refused(bench):
    with pytest.raises(InputError, match="coupling: loose"):
        bench.empty_engine(replace(TIGHT, oscillator_on_body=True))
