"""Faults put into inputs: what is touched, what is not, and that nothing of the signal is left."""

from __future__ import annotations

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_core.types import IfBlock, ImuSample
from deepseis_sim.faults import AMOUNTS, Fault, FaultyInputs

RATE = 200.0


def samples(count: int) -> list[tuple[ImuSample, float]]:
    random = np.random.default_rng(5)
    found = []
    for k in range(count):
        force = random.normal(0.0, 10.0, 3)
        sample = ImuSample(round((k + 1) * 20_000), np.zeros(3), force, 1e-6, 1e-6)
        found.append((sample, (k + 1) / RATE))
    return found


def left(fault: Fault, count: int = 2000) -> list[tuple[float, ImuSample, ImuSample | None]]:
    inputs = FaultyInputs([fault])
    return [(end, sample, inputs.imu(sample, end)) for sample, end in samples(count)]


def test_a_gap_takes_what_ends_within_and_no_more() -> None:
    for end, sample, found in left(Fault("imu-gap", 2.0, 1.0)):
        assert (found is None) == (2.0 <= end < 3.0)
        assert found is None or found is sample


def test_clipping_holds_the_force_at_its_limit() -> None:
    for end, sample, found in left(Fault("imu-clip", 2.0, 1.0, 5.0)):
        assert found is not None
        force, was = found.linear_acceleration, sample.linear_acceleration
        if 2.0 <= end < 3.0:
            assert np.abs(force).max() <= 5.0
            assert np.array_equal(force[np.abs(was) < 5.0], was[np.abs(was) < 5.0])
            assert np.array_equal(np.sign(force), np.sign(was))
        else:
            assert found is sample


def test_the_share_that_is_missing_is_as_drawn_and_the_same_again() -> None:
    fault = Fault("imu-sparse", 0.0, 10.0, 0.3)
    missing = [found is None for _, _, found in left(fault)]
    # Binomial: three sigma of 2000 draws.
    assert np.mean(missing) == pytest.approx(0.3, abs=3 * np.sqrt(0.3 * 0.7 / 2000))
    assert missing == [found is None for _, _, found in left(fault)]


def test_without_a_signal_the_levels_stay_and_the_satellite_does_not() -> None:
    random = np.random.default_rng(1)
    n = 80_000
    code = random.choice([-1, 1], n)
    noise = random.normal(0.0, 30.0, (n, 2))
    data = np.clip(np.round(noise + 5.0 * code[:, None]), -127, 127).astype(np.int8)
    block = IfBlock(0, n, 4e6, 0.0, "iq8", data.view(np.uint8).ravel())
    inputs = FaultyInputs([Fault("no-signal", 0.0, 1.0)])
    found = inputs.block(block, 0.0)
    assert found is not None
    mixed = found.data.view(np.int8).reshape(-1, 2).astype(np.float64)
    assert np.array_equal(np.sort(found.data), np.sort(block.data))
    before = float(data.astype(np.float64)[:, 0] @ code) / (30.0 * np.sqrt(n))
    after = float(mixed[:, 0] @ code) / (30.0 * np.sqrt(n))
    assert before > 40.0  # 5 / 30 sqrt(80000) = 47 sigma
    assert abs(after) < 4.0
    assert inputs.block(block, 1.0) is block


def test_blocks_of_a_gap_are_missing_and_counted() -> None:
    fault = Fault("if-gap", 0.1, 0.06)
    inputs = FaultyInputs([fault])
    data = np.zeros(4, np.uint8)
    found = [
        inputs.block(IfBlock(k * 80_000, 4, 4e6, 0.0, "iq4", data), k * 0.02) for k in range(20)
    ]
    assert [k for k, item in enumerate(found) if item is None] == [5, 6, 7]
    assert inputs.touched == {str(fault): 3}


@pytest.mark.parametrize("kind", AMOUNTS)
def test_the_written_form_reads_back(kind: str) -> None:
    fault = Fault(kind, 1.5, 2.25, 0.5 if AMOUNTS[kind] else 0.0)
    assert Fault.parse(str(fault)) == fault


@pytest.mark.parametrize(
    "text",
    ["imu-gap", "imu-gap:1", "imu-gap:1:0", "imu-gap:-1:1", "imu-gap:1:1:1", "imu-clip:1:1",
     "imu-sparse:1:1:1.5", "imu-gap:nan:1", "flood:1:1", "imu-gap:a:b"],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        Fault.parse(text)
