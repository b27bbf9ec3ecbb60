"""Misses as they are written down and read again."""

import numpy as np

from deepseis_core.miss_log import EVER, Inputs, MissLog, MissScript

BLOCK = 80_000


def script_of(log):
    return MissScript(f"{what} {runs}" for what, runs in log.take().items())


def test_what_was_noted_block_by_block_is_read_block_by_block():
    random, log, expected = np.random.default_rng(3), MissLog(), {}
    through = dict.fromkeys(("imu", "pvt", "G05"), -1)
    for number in range(500):
        sample = number * BLOCK
        for what in through:
            if random.random() < 0.5:  # it comes nearer, by no whole blocks
                through[what] = sample - int(random.integers(1, 3 * BLOCK))
            if random.random() < 0.3:
                log.note(what, sample, BLOCK, through[what])
                expected[what, sample] = through[what]
    script = script_of(log)
    assert bool(script)
    for number in range(500):
        sample = number * BLOCK
        for what in through:
            assert script.through(what, sample) == expected.get((what, sample))
            later = [v for (name, at), v in expected.items() if name == what and at >= sample]
            assert script.limit(what, sample) == (later[0] if later else EVER)


def test_a_dead_input_is_one_run_however_long_it_is_dead():
    log = MissLog()
    for number in range(10_000):
        log.note("trackers", number * BLOCK, BLOCK, 4711)
    assert log.take() == {"trackers": f"0-{10_000 * BLOCK - 1}@4711"}


def test_a_replay_waits_for_what_was_there_and_reports_no_more():
    log = MissLog()
    log.note("imu", 2 * BLOCK, BLOCK, 100_000)
    inputs = Inputs(script_of(log))
    needed = {"imu": 3 * BLOCK}
    assert inputs.lacking(2 * BLOCK, needed, {"imu": 99_999}) == ["imu"]
    for there in (100_000, EVER):
        assert inputs.lacking(2 * BLOCK, needed, {"imu": there}) == []
        assert inputs.missed(2 * BLOCK, needed, {"imu": there}) == {"imu": 100_000}
    assert inputs.lacking(3 * BLOCK, {"imu": 4 * BLOCK}, {"imu": 3 * BLOCK}) == ["imu"]
    assert inputs.missed(3 * BLOCK, {"imu": 4 * BLOCK}, {"imu": EVER}) == {}
