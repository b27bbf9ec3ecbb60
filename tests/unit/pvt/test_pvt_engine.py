import dataclasses
import random
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.pvt.conftest import circle
from unit.pvt.tracked_signals import (
    KLOBUCHAR,
    L1_HZ,
    STATION,
    TOW,
    WEEK,
    C,
    Receiver,
    Sky,
    ephemeris,
    message,
    visible,
)

from deepseis_core.miss_log import MissLog, MissScript
from deepseis_core.types import PvtStatus, TrackingMode
from deepseis_pvt.observables import ObservablesConfig
from deepseis_pvt.pvt_engine import PvtConfig, PvtEngine
from deepseis_pvt.spp import SppConfig

RATE = 4e6
AIRLESS = SppConfig(ionosphere=False, troposphere=False)


def engine(satellites=None, *, preload=True, rate_hz=50, spp=AIRLESS, **config):
    """Return an engine, knowing all ephemerides or none."""
    made = PvtEngine(
        PvtConfig(**config),
        RATE,
        satellites or visible(),
        observables=ObservablesConfig(rate_hz=rate_hz),
        spp=spp,
    )
    for name in visible() if preload else ():
        made.push_ephemeris(ephemeris(int(name[1:])))
    return made


def run(made, messages):
    """Push messages block by block; return all epochs."""
    out = []
    for batch in zip(*messages.values(), strict=True):
        for one in batch:
            made.push_epochs(one)
        out += made.advance()
    return out


def positions(epochs):
    """Return the solutions there are."""
    return [p for _, p in epochs if p is not None and p.status == PvtStatus.SINGLE]


def same(one, other):
    """Tell whether two lists of epochs are identical to the last bit."""
    return repr(flat(one)) == repr(flat(other))


def flat(epochs):
    """Return all fields, arrays as bytes."""
    values = [v for pair in epochs for v in pair if v is not None]
    return [
        tuple(f.tobytes() if isinstance(f, np.ndarray) else f for f in vars(v).values())
        for v in values
    ]


def test_a_still_antenna_is_found_to_a_tenth_of_a_millimetre(still):
    found = positions(run(engine(), still))
    assert len(found) == 15
    for p in found:
        assert_allclose(p.position_ecef, STATION, rtol=0, atol=1e-4)
        assert_allclose(p.velocity_ecef, 0.0, rtol=0, atol=1e-4)
        assert_allclose(p.clock_drift, 3e-7 * C, rtol=0, atol=1e-4)
        assert len(p.satellites) == 10


def test_a_moving_antenna_is_followed_through_the_atmosphere(moving):
    made = engine(rate_hz=100, spp=SppConfig(elevation_mask_deg=5.0), pvt_rate_hz=50)
    made.push_klobuchar(KLOBUCHAR[:4], KLOBUCHAR[4:])
    found = positions(run(made, moving))
    assert len(found) >= 50
    for p in found:
        t = p.tow_ns / 1e9 - TOW
        speed = (circle(t + 1e-4) - circle(t - 1e-4)) / 2e-4
        # A linear code replica over 20 ms of 19 m/s^2, 3.8 mm, times the PDOP.
        assert_allclose(p.position_ecef, circle(t), rtol=0, atol=0.008)
        # The atmosphere's own rate is no one's model: 10 m/90 s at the lowest satellites.
        assert_allclose(p.velocity_ecef, speed, rtol=0, atol=0.02)


def test_the_grid_is_whole_and_on_gps_time(still):
    epochs = run(engine(), still)
    tow = [o.tow_ns for o, _ in epochs]
    assert tow[0] == TOW * 10**9 + 100_000_000  # the first fix is 30 ns before
    assert set(np.diff(tow)) == {20_000_000}
    assert all((p is not None) == (o.tow_ns % 100_000_000 == 0) for o, p in epochs)
    assert all(o.week == WEEK for o, _ in epochs)


def test_valid_through_reaches_to_the_next_epoch(still):
    epochs = run(engine(), still)
    for (o, _), (after, _) in pairwise(epochs):
        assert o.valid_through == after.sample_index - 1
    found = positions(epochs)
    for p, after in pairwise(found):
        assert p.valid_through == after.sample_index - 1


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_arrival_does_not_matter(still, seed):
    expected = run(engine(), still)
    made, rng, out = engine(), random.Random(seed), []
    queues = {name: list(batch) for name, batch in still.items()}
    while any(queues.values()):
        name = rng.choice([n for n, q in queues.items() if q])
        made.push_epochs(queues[name].pop(0))
        if rng.random() < 0.5:
            out += made.advance()
    assert same(out + made.advance(), expected)


@pytest.mark.parametrize("seed", range(3))
def test_a_replay_of_what_was_not_waited_for_gives_the_same_bytes(still, seed):
    """In the live run satellites hang for up to 0.3 s, and one has an ephemeris decoded then."""
    rng, log, out = random.Random(seed), MissLog(), []
    decoding = visible()[seed]
    decoded = dataclasses.replace(ephemeris(int(decoding[1:])), effective_sample_index=2_400_000)
    still = dict(still)
    still[decoding] = [
        dataclasses.replace(m, ephemeris_count=int(m.valid_through >= 1_999_999))
        for m in still[decoding]
    ]

    def made(script=None):
        new = PvtEngine(
            PvtConfig(), RATE, visible(), observables=ObservablesConfig(), spp=AIRLESS,
            script=script,
        )  # fmt: skip
        for name in visible():
            if name != decoding:
                new.push_ephemeris(ephemeris(int(name[1:])))
        return new

    def push(engine, name, one):
        if name == decoding and one.valid_through == 1_999_999:
            engine.push_ephemeris(decoded)
        engine.push_epochs(one)

    def work(engine, force=None):
        for epoch in engine.steps(force):
            count = engine.valid_through + 1 - engine.worked_through
            for what, through in engine.missed.items():
                log.note(what, engine.worked_through, count, through)
            if epoch is not None:
                out.append(epoch)

    live, place, hangs = made(), dict.fromkeys(still, 0), dict.fromkeys(still, 0)
    blocks = len(still[decoding])
    for number in range(blocks):
        for name, batch in still.items():
            if rng.random() < 0.03:
                hangs[name] = number + rng.randrange(15)
            while place[name] <= number and number >= hangs[name]:
                push(live, name, batch[place[name]])
                place[name] += 1
        work(live, force=(number - 3) * 80_000)
    for name, batch in still.items():
        for one in batch[place[name] :]:
            push(live, name, one)
    work(live, live.newest_sample())
    script = MissScript(f"{what} {runs}" for what, runs in log.take().items())
    assert live.statistics["forced"] > 10
    again = made(script)
    for name, batch in still.items():
        for one in batch:
            push(again, name, one)
    replayed = again.advance() + again.advance(again.newest_sample())
    assert same(replayed, out)
    assert again.statistics["forced"] == live.statistics["forced"]
    assert not same(run(engine(), still), out)


def test_work_waits_for_an_announced_ephemeris(still):
    late, effective = visible()[0], 2_400_000
    announced = {
        name: [
            dataclasses.replace(
                m, ephemeris_count=int(name == late and m.valid_through >= 1_999_999)
            )
            for m in batch
        ]
        for name, batch in still.items()
    }
    decoded = dataclasses.replace(ephemeris(int(late[1:])), effective_sample_index=effective)

    def without_late():
        made = engine(preload=False)
        for name in visible()[1:]:
            made.push_ephemeris(ephemeris(int(name[1:])))
        return made

    early = without_late()
    early.push_ephemeris(decoded)
    expected = run(early, announced)
    assert all(
        (late in p.satellites) == (p.sample_index >= effective) for p in positions(expected)
    )

    waiting = without_late()
    before = run(waiting, announced)
    assert max(o.sample_index for o, _ in before) <= 1_999_999
    waiting.push_ephemeris(decoded)
    assert same(before + waiting.advance(), expected)


def test_an_idle_satellite_holds_nothing_up_once_it_has_said_so(still):
    hidden = next(n for n in ("G01", "G02", "G03", "G04", "G05") if n not in visible())
    made = engine((*visible(), hidden))
    assert not run(made, still)
    idle = message(hidden, 0, 100_000_000, [], mode=TrackingMode.IDLE)
    made.push_epochs(idle)
    assert len(made.advance()) == len(run(engine(), still))


def test_a_satellite_that_vanishes_leaves_the_observations(still):
    gone = visible()[3]
    cut = {
        name: [
            message(name, m.block_sample_index, m.valid_through, [])
            if name == gone and m.block_sample_index >= 3_000_000
            else m
            for m in batch
        ]
        for name, batch in still.items()
    }
    epochs = run(engine(), cut)
    # The last epoch waits for 20 ms more of a satellite that is not tracked.
    assert len(epochs) == len(run(engine(), still)) - 1
    last = max(o.sample_index for o, _ in epochs if gone in o.satellites)
    assert 2_840_000 <= last < 3_000_000


def test_epochs_without_satellites_are_there_all_the_same(still):
    cut = {
        name: [
            m
            if m.block_sample_index < 3_000_000
            else message(name, m.block_sample_index, m.valid_through, [])
            for m in batch
        ]
        for name, batch in still.items()
    }
    epochs = run(engine(), cut)
    assert len(epochs) == len(run(engine(), still)) - 1
    empty = [(o, p) for o, p in epochs if not o.satellites]
    assert len(empty) > 30
    assert all(p.status == PvtStatus.NONE for _, p in empty if p is not None)


def test_the_clock_jumps_by_whole_milliseconds_in_time_code_and_phase():
    drift = 4e-4  # absurd, so that half a millisecond comes within the test
    receiver = Receiver(Sky(), clock_drift=drift)
    messages = {name: receiver.messages(name, 2.4) for name in visible()}
    made = engine()
    epochs = run(made, messages)
    assert made.statistics["clock_jumps"] == 1
    assert made.statistics["slips"] == 10  # the first epoch of each arc only
    samples = np.diff([o.sample_index + o.sample_fraction for o, _ in epochs])
    jump = int(np.argmax(samples))
    assert_allclose(samples[jump], 80_000 + 4000, atol=1e-6)
    assert_allclose(np.delete(samples, jump), 80_000, atol=1e-6)
    for p in positions(epochs):
        assert_allclose(p.position_ecef, STATION, rtol=0, atol=1e-3)
        assert abs(p.clock_bias) < 0.6e-3 * C
    for name in visible():
        k = visible().index(name)
        code = np.array([o.pseudorange[k] for o, _ in epochs])
        phase = np.array([o.carrier_phase_cycles[k] for o, _ in epochs])
        # Code and phase stay together; both move by a millisecond at the jump.
        assert np.ptp(code - phase * C / L1_HZ) < 1e-3
        assert_allclose(np.diff(code)[jump] - np.diff(code)[jump - 1], -1e-3 * C, rtol=2e-3)


def test_the_week_turns_over_without_a_seam():
    until = 604800 - TOW
    receiver = Receiver(Sky(), start=until - 0.5)
    names = [f"G{prn:02d}" for prn in range(1, 33)]
    names = [name for name in names if Sky().elevation(name, until) > 0.2]
    messages = {name: receiver.messages(name, 1.0) for name in names}
    made = engine(names, preload=False, max_ephemeris_age=100_000.0)
    for name in names:
        made.push_ephemeris(ephemeris(int(name[1:])))
    epochs = run(made, messages)
    weeks = [o.week for o, _ in epochs]
    assert set(weeks) == {WEEK, WEEK + 1}
    assert epochs[weeks.index(WEEK + 1)][0].tow_ns == 0
    assert made.statistics["slips"] == len(names)
    for p in positions(epochs):
        assert_allclose(p.position_ecef, STATION, rtol=0, atol=1e-3)


def test_statuses_before_the_first_fix_are_none_at_all(still):
    few = {name: still[name] for name in visible()[:3]}
    made = engine(tuple(few))
    assert run(made, few) == []
    assert made.statistics["attempts"] > 10
    assert made.worked_through > 5_000_000


def test_a_deadline_goes_on_without_the_late_and_counts_it(still):
    late = visible()[0]
    made = engine()
    rest = {name: batch for name, batch in still.items() if name != late}
    assert run(made, rest) == []
    epochs = made.advance(force_through=4_000_000)
    assert len(positions(epochs)) == 10
    assert all(late not in o.satellites for o, _ in epochs)
    for one in still[late]:
        made.push_epochs(one)
    after = made.advance()
    assert made.statistics["late"] > 40
    assert all(late in o.satellites for o, _ in after)
    assert made.statistics["forced"] > 40


def test_memory_stays_bounded(still):
    made = engine()
    run(made, still)
    assert made.store.ints.shape[1] <= 64
    made.book.forget(10**12, 10**19)
    assert not any(made.book._known.values())


def test_satellites_not_decoded_yet_are_ranged_after_the_first_fix(still):
    silent = visible()[5]
    mute = {
        name: [
            dataclasses.replace(m, transmit_ms=np.full(len(m.transmit_ms), -1))
            if name == silent
            else m
            for m in batch
        ]
        for name, batch in still.items()
    }
    expected = positions(run(engine(), still))
    found = positions(run(engine(), mute))
    assert [p.satellites for p in found] == [p.satellites for p in expected]
    off = positions(run(engine(predict_transmit_time=False), mute))
    assert all(silent not in p.satellites for p in off)


def test_rates_that_do_not_divide_are_refused():
    with pytest.raises(ValueError, match="divisor"):
        engine(pvt_rate_hz=7)
    with pytest.raises(ValueError, match="divisor"):
        engine(rate_hz=30)


def test_an_engine_that_joins_makes_no_attempts_at_what_is_past():
    engine = PvtEngine(PvtConfig(), 4e6, ["G01"])
    engine.join(3_600 * 4_000_000 + 5)
    assert engine.valid_through == 3_600 * 4_000_000 + 400_000 - 1
