"""The measures of faults find what is put into a record, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from deepseis_bringup.accept.loop_measures import CarrierTruth
from deepseis_bringup.faults.measures import complaints, deviation, loss_of, wrong_cycles
from deepseis_bringup.faults.record import LOCK, RunRecord, Said
from deepseis_core.types import FloatArray, Lli, Observations

RATE = 4e6
TRUE = np.arange(0.0, 20.0, 0.01)


def truth() -> CarrierTruth:
    """A satellite whose phase is a parabola and a shaking of 2 g."""
    phase = 1500.0 * TRUE + 3.0 * TRUE**2 + 0.63 * np.sin(4 * np.pi * TRUE)
    column = phase[:, None]
    return CarrierTruth(("G01",), TRUE, column, np.full_like(column, 45.0), np.zeros(1))


def observed(
    steps: dict[float, float], marks: tuple[float, ...] = (), half: tuple[float, float] = (0, 0)
) -> RunRecord:
    """Observations with noise, steps [cycles] put in from times on, and marks."""
    known, random = truth(), np.random.default_rng(2)
    record = RunRecord(RATE, 0)
    nothing = np.zeros(1, np.float32)
    for t in np.arange(1.0, 19.0, 0.02):
        true = float(np.interp(t, TRUE, known.phase_cycles[:, 0]))
        off = sum(step for at, step in steps.items() if t >= at) + random.normal(0.0, 0.01)
        lli = int(Lli.SLIP) * any(at <= t < at + 0.02 for at in marks)
        lli |= int(Lli.HALF_CYCLE) * (half[0] <= t < half[1])
        record.observations.append(
            Observations(
                round(t * RATE), 0.0, 2000, round(t * 1e9), round(t * RATE), 0.02, ("G01",),
                np.zeros(1), np.array([1e8 - true + off]), np.zeros(1), nothing,
                np.array([lli], np.uint8), nothing, nothing, nothing, nothing, nothing,
                np.zeros(1, np.uint16),
            )
        )  # fmt: skip
    return record


def test_a_true_phase_has_nothing_wrong() -> None:
    (found,) = wrong_cycles(observed({}), truth(), 2.0, 18.0)
    assert (found.changes, found.epochs, found.marks) == (0, 0, 0)
    assert found.greatest < 0.06


@pytest.mark.parametrize("step", [1.0, 0.5, -1.0])
def test_a_slip_without_a_mark_is_found_once(step: float) -> None:
    (found,) = wrong_cycles(observed({10.0: step}), truth(), 2.0, 18.0)
    assert found.changes == 1
    assert found.epochs > 300
    assert min(abs(at - 10.0) for at in found.times) < 0.03


def test_a_slip_that_is_marked_is_none() -> None:
    (found,) = wrong_cycles(observed({10.0: 3.0}, marks=(10.0,)), truth(), 2.0, 18.0)
    assert (found.changes, found.epochs, found.marks) == (0, 0, 1)


def test_half_a_cycle_has_to_be_told_by_a_mark_of_its_own() -> None:
    (found,) = wrong_cycles(observed({12.0: 0.5}, marks=(12.0,)), truth(), 2.0, 18.0)
    assert found.epochs == pytest.approx(300, abs=1)
    (told,) = wrong_cycles(
        observed({12.0: 0.5}, marks=(12.0,), half=(12.0, 18.0)), truth(), 2.0, 18.0
    )
    assert told.epochs == 0


def test_a_short_arc_of_a_loop_under_stress_has_the_place_of_the_others() -> None:
    """It swings by 0.2 cycles about it, and is cut where it is farthest."""
    steps = {10.0: -0.2, 10.02: 0.1, 10.04: 0.1, 10.06: 0.1, 10.08: 0.1, 10.12: -0.2}
    (found,) = wrong_cycles(observed(steps, marks=(10.0, 10.12)), truth(), 2.0, 18.0)
    assert (found.changes, found.epochs) == (0, 0)
    assert 0.18 < found.greatest < 0.25


def test_a_mark_that_comes_late_leaves_epochs_that_are_wrong() -> None:
    (found,) = wrong_cycles(observed({10.0: 1.0}, marks=(10.2,)), truth(), 2.0, 18.0)
    assert found.epochs == pytest.approx(10, abs=1)


def test_what_may_be_half_a_cycle_off_says_so_itself() -> None:
    record = observed({10.0: 0.5, 10.4: -0.5}, half=(10.0, 10.4))
    (found,) = wrong_cycles(record, truth(), 2.0, 18.0)
    assert (found.changes, found.epochs) == (0, 0)


def test_a_whole_millisecond_of_the_clock_is_no_slip() -> None:
    (found,) = wrong_cycles(observed({10.0: 1575420.0}), truth(), 2.0, 18.0)
    assert (found.changes, found.epochs) == (0, 0)


def line(good: FloatArray) -> tuple[FloatArray, np.ndarray]:
    return np.arange(good.size) * 0.02, good.astype(np.bool_)


def test_what_is_missing_and_when_it_is_back() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    aiding = line((t < 10.0) | (t >= 11.5))
    lock = line((t < 10.1) | (t >= 12.0))
    found = loss_of(
        {"aiding": aiding, LOCK + "G01": lock, LOCK + "G02": line(np.ones(t.size))},
        10.0, 11.0, 18.0,
    )  # fmt: skip
    assert found.missing["aiding"] == pytest.approx(1.5, abs=0.03)
    assert found.back["aiding"] == pytest.approx(0.5, abs=0.03)
    assert found.back[LOCK + "G01"] == pytest.approx(1.0, abs=0.03)
    assert found.back[LOCK + "G02"] == 0.0
    assert (found.satellites, found.slowest) == (1, LOCK + "G01")


def test_what_flickers_is_back_when_it_stays() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    flickering = (t < 10.0) | ((t >= 11.1) & (t < 11.3)) | (t >= 11.7)
    found = loss_of({"aiding": line(flickering)}, 10.0, 11.0, 18.0)
    assert found.recovery == pytest.approx(0.7, abs=0.03)


def test_what_does_not_come_back_never_recovers() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    found = loss_of({"aiding": line(t < 10.0)}, 10.0, 11.0, 18.0)
    assert found.recovery == np.inf


def test_errors_of_a_displacement_with_what_it_says_itself() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    moved = np.full((t.size, 3), 0.5)
    moved[t >= 6.0, 2] += 0.03
    found = deviation(
        t, moved, np.full((t.size, 3), 0.01), lambda at: np.zeros((at.size, 3)), (1.0, 4.0),
        (5.0, 9.0),
    )  # fmt: skip
    assert found.greatest == pytest.approx(0.03)
    assert found.in_sigmas == pytest.approx(3.0)


def test_who_complains_is_who_did_not_before() -> None:
    said = [Said(1.0, "a", 1, "old"), Said(5.0, "a", 1, "old"), Said(5.2, "b", 2, "new"),
            Said(5.4, "b", 2, "newer"), Said(5.5, "c", 0, "fine")]  # fmt: skip
    assert complaints(said, 5.0, 8.0) == [said[2]]
