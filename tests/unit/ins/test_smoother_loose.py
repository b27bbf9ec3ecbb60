"""The loosely coupled filter smoothed: better, and by as much as its covariance says."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from unit.ins import loose_runs as runs
from unit.ins import test_tight
from unit.ins import tight_runs as sky

from deepseis_core import rotation
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import grade_named
from deepseis_core.kalman import chi_square_band
from deepseis_ins import error_state as es
from deepseis_ins import measurements as ms
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.smoother import FixedLagSmoother, smooth
from deepseis_ins.smoother_loose import errors_between, smoothed_nav
from deepseis_ins.strapdown import NavState
from deepseis_sim.motions import Circle

STILL, SECONDS, RUNS, GNSS_HZ = 14, 30, 16, 2
CIRCLE = Circle(radius=0.5, frequency_hz=1.0, start=float(STILL), duration=100.0)  # 2 g


def told(unit):
    """Constraints each second while still, then GNSS."""

    def measurements(loose, time, C_ref, rng):
        if time < STILL:
            if abs(time - round(time)) < 1e-9:
                yield from runs.constraints(loose, C_ref, rng)
        else:
            yield from runs.gnss(unit, loose, time, rng)

    return measurements


@pytest.fixture(scope="module")
def ideal():
    return runs.ideal_increments(CIRCLE, SECONDS)


def flown(grade, ideal, seed, **options):
    unit = runs.Unit(grade, CIRCLE, SECONDS, seed, ideal)
    return runs.fly(
        unit, SECONDS, told(unit), seed=seed, rate_hz=GNSS_HZ, smoothing=True, **options
    )


@pytest.mark.parametrize("grade", ["span-fsas", "stim300"])
def test_smoothed_errors_are_smaller_and_as_large_as_it_says(ideal, grade):
    """At three times of 16 units each, one of them in the still; scale factors considered.

    The bands hold all six means of a grade together with 95 %.
    """
    squares = {"all": [], "position": []}
    left, forward = [], []
    times = [12, 18, 24]
    for seed in range(300, 300 + RUNS):
        run = flown(grade, ideal, seed)
        got = smooth(run.steps)
        first = len(run.steps) - len(run.step_errors)
        start = SECONDS - len(run.step_errors) / GNSS_HZ
        for time in times:
            k = round((time - start) * GNSS_HZ) - 1
            error = run.step_errors[k] - got.error[first + k, :15]
            P = got.P[first + k, :15, :15]
            squares["all"].append(error @ np.linalg.solve(P, error))
            squares["position"].append(error[:3] @ np.linalg.solve(P[:3, :3], error[:3]))
            if time > STILL:
                left.append(error)
                forward.append(run.step_errors[k])
    for dof, name in ((15, "all"), (3, "position")):
        low, high = chi_square_band(dof, RUNS, 1.0 - 0.05 / 6)
        for k in range(len(times)):
            assert low < np.mean(squares[name][k :: len(times)]) < high, (name, times[k])
    gain = np.sqrt(np.mean(np.square(left), axis=0) / np.mean(np.square(forward), axis=0))
    assert gain[es.POS].max() < 0.85
    assert gain[es.VEL][:2].max() < 0.8
    # Zero velocity before and a bias learnt: down, seconds of GNSS add little.
    assert gain[es.VEL][2] < 1.05


def new_filter(**given):
    start = NavState(runs.LAT, runs.LON, runs.HEIGHT, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    sds = {"attitude_sd": [1e-3] * 3, "position_sd": [1.0] * 3, "velocity_sd": [0.01] * 3}
    return LooseFilter(LooseConfig(), grade_named("stim300"), start, **(sds | given))


def increments(count, seed=1):
    rng = np.random.default_rng(seed)
    theta, vel = rng.normal(0.0, 1e-3, (count, 3)), rng.normal(0.0, 0.05, (count, 3))
    vel[:, 2] -= 9.8 * 0.005
    return theta, vel


def work(loose, count, seed=1, each=lambda _k: None):
    """Half a second at a time: a turn's and a position's measurement; a new reference half-way."""
    theta, vel = increments(100 * count, seed)
    rng = np.random.default_rng(seed)
    for k in range(count):
        loose.propagate(theta[100 * k : 100 * k + 100], vel[100 * k : 100 * k + 100], 0.005)
        C = rotation.matrix_from_quat(loose.nav.quat_nb)
        if k == count // 2:
            C = loose.refer_attitude(None if seed % 2 else C, 1e-3)
        loose.update(ms.zero_angle(loose.nav, C, 1e-3))
        shift = rng.normal(0.0, 0.1, 3)
        loose.update(ms.Measurement(shift, np.eye(3, 15), 0.01 * np.eye(3), "position", es.POS))
        each(k)


@pytest.mark.parametrize("seed", [1, 2])
def test_transitions_carry_what_the_covariance_carries(seed):
    """What noise adds must be noise of the 15 states alone, and no less than nothing.

    But at the step where the reference is a new one: the attitude at its end, with the noise in
    it (seed 1), or a survey with an error of its own (seed 2).
    """
    loose, steps = new_filter(smoothing=True), []
    work(loose, 12, seed, lambda _k: steps.extend(loose.take_steps()))
    for k, (last, step) in enumerate(pairwise(steps)):
        scale = np.sqrt(np.diag(step.before))
        noise = step.before - step.transition @ last.after @ step.transition.T
        noise /= np.where(scale > 0.0, scale, 1.0)[:, None] * np.where(scale > 0.0, scale, 1.0)
        constants = slice(18, 36) if k == 5 else slice(15, 36)
        assert_allclose(noise[constants], 0.0, atol=1e-12)
        assert np.linalg.eigvalsh(noise)[0] > -1e-12


def test_writing_down_changes_nothing():
    plain, telling = new_filter(), new_filter(smoothing=True)
    for each in (plain, telling):
        work(each, 6)
    assert_array_equal(plain.P, telling.P)
    assert_array_equal(plain.nav.quat_nb, telling.nav.quat_nb)
    with pytest.raises(InputError, match="smoothing=True"):
        plain.take_steps()


def test_steps_without_measurements_do_not_matter():
    """Steps at every measurement, or taken all at once, or with others between."""
    all_at_once, between = new_filter(smoothing=True), new_filter(smoothing=True)
    work(all_at_once, 8)
    expected = smooth(all_at_once.take_steps())
    steps, kept = [], []
    theta, vel = increments(800)
    rng = np.random.default_rng(1)
    for k in range(8):
        for first in range(100 * k, 100 * k + 100, 20):
            between.propagate(theta[first : first + 20], vel[first : first + 20], 0.005)
            if first % 100 < 80:
                steps += between.take_steps()
        C = rotation.matrix_from_quat(between.nav.quat_nb)
        if k == 4:
            C = between.refer_attitude()
        between.update(ms.zero_angle(between.nav, C, 1e-3))
        shift = rng.normal(0.0, 0.1, 3)
        between.update(ms.Measurement(shift, np.eye(3, 15), 0.01 * np.eye(3), "position", es.POS))
        steps += between.take_steps()
        kept.append(len(steps) - 1)
    got = smooth(steps)
    scale = np.sqrt(np.diagonal(expected.P, axis1=1, axis2=2))[:, :15]
    assert len(expected.error) == 8
    # Covariance steps of 0.05 s both times, cut differently: second order in their length.
    assert_allclose((got.error[kept, :15] - expected.error[:, :15]) / scale, 0.0, atol=2e-3)
    ratio = np.diagonal(got.P[kept], axis1=1, axis2=2)[:, :15] / scale**2
    assert_allclose(ratio, 1.0, rtol=2e-3)


def test_undo_takes_back_what_was_written():
    loose, straight = new_filter(smoothing=True), new_filter(smoothing=True)
    work(loose, 4)
    before = loose.snapshot()
    work(loose, 3, seed=5)
    loose.restore(before)
    work(straight, 4)
    for each in (loose, straight):
        work(each, 3, seed=7)
    got, expected = smooth(loose.take_steps()), smooth(straight.take_steps())
    assert_array_equal(got.error, expected.error)
    assert_array_equal(got.P, expected.P)


def test_smoothed_states_join_where_the_filter_jumps(ideal):
    """Behind a lag: at IMU rate the smoothed track has no steps, the filter's has, of centimetres.

    Taking the error of the one side off before a measurement, and of the other after it, gives
    the same state.
    """
    unit = runs.Unit("span-fsas", CIRCLE, SECONDS, 9, ideal)
    rng = np.random.default_rng(9)
    loose, _ = runs.started(unit, rng, smoothing=True)
    C_ref = rotation.matrix_from_quat(loose.nav.quat_nb)
    tell, smoother = told(unit), FixedLagSmoother(3.0)
    before, after, late = {}, {}, []
    for first in range(0, 22 * runs.RATE, 100):
        loose.propagate(unit.theta[first : first + 100], unit.vel[first : first + 100], 0.005)
        time = (first + 100) / runs.RATE
        before[time] = loose.nav
        for measurement in tell(loose, time, C_ref, rng):
            loose.update(measurement())
        after[time] = loose.nav
        for step in loose.take_steps():
            late += smoother.push(time, step)
    assert late[-1].time == 19.0
    jumps = []
    for each in late:
        if each.time <= STILL:
            continue
        one = smoothed_nav(before[each.time], each.error_before)
        two = smoothed_nav(after[each.time], each.error)
        for name in ("latitude", "longitude"):
            assert abs(getattr(one, name) - getattr(two, name)) * 6.4e6 < 1e-6
        assert abs(one.height - two.height) < 1e-6
        assert_allclose(one.vel_n, two.vel_n, atol=1e-6)
        jumps.append(abs(before[each.time].height - after[each.time].height))
    assert max(jumps) > 0.01
    ends = errors_between(late[-2].error, late[-1].error_before, np.array([0.0, 1.0]), 0.5)
    assert_allclose(ends, [late[-2].error[:15], late[-1].error_before[:15]], atol=1e-15)


def test_the_tight_filter_is_smoothed_alike(ideal):
    """17 states of 16 units in the middle of the motion; the error is smaller, as it says."""
    packed, middle = sky.visible(), 20
    squares, left, forward = [], [], []
    for seed in range(RUNS):
        unit = runs.Unit("span-fsas", CIRCLE, SECONDS, seed, ideal)
        tight = test_tight.started(unit, seed, smoothing=True)
        receiver, steps = sky.Receiver(CIRCLE, packed, seed), []
        for second in range(SECONDS):
            part = slice(second * runs.RATE, (second + 1) * runs.RATE)
            tight.propagate(unit.theta[part], unit.vel[part], 1.0 / runs.RATE)
            tight.update_ranges(receiver.at(second + 1.0))
            steps += tight.take_steps()
            if second + 1 == middle:
                clock = tight.clock_bias - receiver.bias, tight.clock_drift - receiver.drift
                error, place = (
                    np.array([*unit.error(tight, float(middle)), *clock]),
                    len(steps) - 1,
                )
        got = smooth(steps)
        after = error - got.error[place, :17]
        squares.append(after @ np.linalg.solve(got.P[place, :17, :17], after))
        left.append(after), forward.append(error)
    low, high = chi_square_band(17, RUNS)
    assert low < np.mean(squares) < high
    gain = np.sqrt(np.mean(np.square(left), axis=0) / np.mean(np.square(forward), axis=0))
    assert np.linalg.norm(gain[:3]) < 0.9 * np.sqrt(3.0)
