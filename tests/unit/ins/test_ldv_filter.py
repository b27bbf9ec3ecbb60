"""A vehicle's filter: slow errors of GNSS and the lever arm as states; honest over many units."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.ins import loose_runs as runs
from unit.ins.test_ldv import CIRCLE, LEVER, TRUE, measured

from deepseis_core import rotation
from deepseis_core.imu_grades import grade_named
from deepseis_core.kalman import chi_square_band
from deepseis_ins import error_state as es
from deepseis_ins import ldv, ldv_filter
from deepseis_ins import measurements as ms
from deepseis_ins.ldv_filter import LdvFilter, Unknowns
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.smoother import smooth
from deepseis_ins.strapdown import NavState

UNITS, SECONDS, COVERED, RATE_HZ = 8, 24, 14, 2
SD, GROWTH = (2.0, 5e-3, 0.1), (0.05, 5e-4)
UNKNOWNS = Unknowns(SD, GROWTH)
ANGLES = np.array([2e-3, 5e-3, 5e-3])


class Driven:
    """A unit's run with slow errors of GNSS that wander, and a lever arm not known."""

    def __init__(self, seed, ideal):
        self.rng = np.random.default_rng([seed, 21])
        self.unit = runs.Unit("span-fsas", CIRCLE, SECONDS, seed, ideal)
        self.slow = np.repeat(SD[:2], 3) * self.rng.standard_normal(6)
        lever = SD[2] * self.rng.standard_normal(3)
        self.error = ANGLES * self.rng.standard_normal(3)
        self.hat = replace(TRUE.corrected(-self.error), lever_arm_b=LEVER + lever)
        self.filter, self.beyond = None, []
        make = partial(LdvFilter, unknowns=UNKNOWNS)
        self.run = runs.fly(
            self.unit, SECONDS, self.told, seed=seed, rate_hz=RATE_HZ, make=make, smoothing=True
        )

    def told(self, loose, time, _C_ref, noise):
        if self.filter is None:
            self.filter = loose
            loose.refer_constants(ANGLES)
        else:
            self.beyond.append(self.errors_beyond())
        walk = np.repeat(GROWTH, 3) * np.sqrt(1.0 / RATE_HZ)
        self.slow = self.slow + walk * self.rng.standard_normal(6)
        if time <= COVERED and abs(time - round(time)) < 1e-9:
            parts = ldv_filter.POSITION_OFF, ldv_filter.VELOCITY_OFF
            for make, part in zip(runs.gnss(self.unit, loose, time, noise), parts, strict=True):
                yield partial(self.of_gnss, make, part)
        yield lambda: self.of_ldv(loose, time, noise)

    def of_gnss(self, make, part):
        found = ldv_filter.of_gnss(make(), part)
        return replace(found, z=found.z - self.slow[part])

    def of_ldv(self, loose, time, noise):
        found = measured(self.unit, loose, time, self.hat, noise)
        C = rotation.matrix_from_quat(loose.nav.quat_nb)
        swing = ldv.lever_sensitivity(C, loose.omega_ib_b, loose.nav.latitude)
        return ldv_filter.sensitive(found, ldv_filter.LEVER, swing)

    def errors_beyond(self):
        """Return the errors of what is known of GNSS and the lever arm, shape (9,)."""
        lever = self.hat.lever_arm_b - LEVER - self.filter._beyond[ldv_filter.LEVER]
        return np.hstack([self.filter.gnss_errors - self.slow, lever])

    def at_end(self):
        """Return the errors of all 27 that are estimated, and their covariance."""
        x, _ = self.run.at(SECONDS)
        beyond = self.errors_beyond()
        estimate, _ = self.filter.take_constants()
        self.filter._complete()
        P = self.filter._joined()[:27, :27]
        return np.hstack([x, beyond, self.error - estimate]), P


@pytest.fixture(scope="module")
def driven():
    ideal = runs.ideal_increments(CIRCLE, SECONDS)
    return [Driven(seed, ideal) for seed in range(UNITS)]


def test_all_errors_and_innovations_are_as_large_as_the_filter_says(driven):
    """NEES of 27 errors at the end, NIS of velocimeter and of GNSS: 95 % of all three."""
    share, ends = 1.0 - 0.05 / 4.0, [one.at_end() for one in driven]
    nees = np.mean([x @ np.linalg.solve(P, x) for x, P in ends])
    low, high = chi_square_band(27, UNITS, share)
    assert low < nees < high
    for name in (ldv.NAME, "position", "velocity"):
        squares = np.concatenate([one.run.squares(name) for one in driven])
        low, high = chi_square_band(3, squares.size, share)
        assert low < squares.mean() < high


def test_what_is_slow_stays_unknown_however_often_it_is_measured(driven):
    """The place was known to half a metre: so well is the positions' error known, and no better.

    A white error would be 0.13 m after 14 epochs.
    """
    for one in driven:
        sd = np.sqrt(np.diag(one.filter.whole_P))
        assert np.all(sd[15:18] > 0.9 * runs.POSITION_SD)


def test_a_lever_arm_is_found_as_it_swings():
    """Turns of 0.3 rad/s, velocities with 5 mm/s of noise: found within what the filter says."""
    rng, wrong = np.random.default_rng(3), np.array([0.06, -0.04, 0.08])
    filter_ = new(LdvFilter, unknowns=UNKNOWNS)
    for _ in range(400):
        swing = ldv.lever_sensitivity(runs.C_TRUE, 0.3 * rng.standard_normal(3), runs.LAT)
        plain = ms.zero_velocity(filter_.nav, 5e-3)
        off = swing @ wrong + 5e-3 * rng.standard_normal(3)
        z = plain.z + off  # the vehicle's own velocity is right: what is off is the sensor's
        filter_.update(ldv_filter.sensitive(replace(plain, z=z), ldv_filter.LEVER, swing))
    sd = filter_.lever_sd
    assert np.all(np.abs(filter_.take_lever() - wrong) < 4.0 * sd)
    assert sd.max() < 0.003
    assert_allclose(filter_.take_lever(), 0.0)


def new(make=LooseFilter, **more):
    level = rotation.quat_from_matrix(runs.C_TRUE)
    return make(
        LooseConfig(), grade_named("span-fsas"),
        NavState(runs.LAT, runs.LON, runs.HEIGHT, np.zeros(3), level),
        attitude_sd=[1e-3] * 3, position_sd=[1.0] * 3, velocity_sd=[0.1] * 3, **more,
    )  # fmt: skip


def carried(filter_):
    for _ in range(20):
        filter_.propagate(np.zeros((20, 3)), np.tile([0.0, 0.0, -0.0489], (20, 1)), 0.005)
        filter_.update(ms.zero_velocity(filter_.nav, 1e-3))
    return filter_


def test_without_anything_beyond_it_is_the_loose_filter():
    loose, ours = carried(new()), carried(new(LdvFilter, unknowns=UNKNOWNS))
    assert_allclose(ours.P, loose.P, rtol=1e-9, atol=1e-18)
    assert_allclose(ours.nav.quat_nb, loose.nav.quat_nb, rtol=0, atol=1e-15)
    assert_allclose(ours.gnss_errors, 0.0)
    expected = np.square(SD[0]) + 2.0 * np.square(GROWTH[0])  # two seconds of random walk
    assert_allclose(np.diag(ours.whole_P)[15:18], expected)


def test_undo_is_exact_and_looking_changes_nothing():
    def on(filter_):
        fix = ms.gnss_position(filter_.nav, runs.SITE.origin_ecef, np.eye(3), runs.LEVER)
        filter_.update(ldv_filter.of_gnss(fix, ldv_filter.POSITION_OFF))
        return filter_.whole_P, filter_.gnss_errors

    filter_ = carried(new(LdvFilter, unknowns=UNKNOWNS))
    kept = filter_.snapshot()
    expected = on(filter_)
    filter_.restore(kept)
    for a, b in zip(on(filter_), expected, strict=True):
        assert np.array_equal(a, b)


def test_positions_that_jump_prove_their_own_error_wrong():
    """50 m at once: satellites came and went, the vehicle did not."""
    filter_ = carried(new(LdvFilter, unknowns=replace(UNKNOWNS, sd=(0.1, 5e-3, 0.1))))
    up = runs.SITE.origin_ecef / np.linalg.norm(runs.SITE.origin_ecef)
    before, P = filter_.nav, 0.1**2 * np.eye(3)
    seen = []
    for _ in range(12):
        fix = ms.gnss_position(filter_.nav, runs.SITE.origin_ecef + 50.0 * up, P, np.zeros(3))
        seen.append(filter_.update(ldv_filter.of_gnss(fix, ldv_filter.POSITION_OFF)))
    assert [item.recovered for item in seen].count(True) == 1
    assert abs(filter_.nav.height - before.height) < 0.5
    assert filter_.gnss_errors[2] == pytest.approx(-50.0, abs=1.0)


def test_a_lever_arms_sensitivity_is_what_perturbation_gives():
    C, omega = runs.C_TRUE, np.array([0.1, -0.2, 0.4])
    over = omega - C.T @ ldv.earth_rate(runs.LAT)
    swing = ldv.lever_sensitivity(C, omega, runs.LAT)
    for k in range(3):
        unit = np.eye(3)[k]
        predicted, slip = C @ np.cross(over, unit), np.cross(over, unit)[1]
        assert_allclose(swing[:, k], predicted - C @ [0.0, slip, 0.0], atol=1e-15)


def test_smoothed_errors_are_smaller_and_as_large_as_it_says(driven):
    """24 errors of 8 units at two times while there is GNSS and one after; bands of 95 % of all.

    What is beyond the 15 states is smoothed with them.
    """
    times, squares = (4.0, 10.0, 18.0), []
    left, forward = [], []
    for one in driven:
        got = smooth(one.run.steps)
        # The first step is the start, where the constants were told.
        first = len(one.run.steps) - len(one.run.step_errors)
        for time in times:
            k = round(time * RATE_HZ) - 1
            error = np.hstack([one.run.step_errors[k], one.beyond[k]])
            after, P = error - got.error[first + k, :24], got.P[first + k, :24, :24]
            squares.append(after @ np.linalg.solve(P, after))
            left.append(after)
            forward.append(error)
    low, high = chi_square_band(24, UNITS, 1.0 - 0.05 / len(times))
    for k, time in enumerate(times):
        assert low < np.mean(squares[k :: len(times)]) < high, time
    gain = np.sqrt(np.mean(np.square(left), axis=0) / np.mean(np.square(forward), axis=0))
    assert gain[es.VEL].max() < 0.85
    assert gain[es.ACCEL][2] < 0.7


def test_transitions_carry_what_the_covariance_carries():
    """What noise adds is noise of the 15 states and of the slow errors alone, and not negative."""
    filter_, steps = new(LdvFilter, unknowns=UNKNOWNS, smoothing=True), []
    for k in range(8):
        turn = np.tile([2e-3, -1e-3, 3e-3], (40, 1))
        filter_.propagate(turn, np.tile([0.02, 0.01, -0.0489], (40, 1)), 0.005)
        swing = ldv.lever_sensitivity(runs.C_TRUE, filter_.omega_ib_b, runs.LAT)
        plain = ms.zero_velocity(filter_.nav, 5e-3)
        filter_.update(ldv_filter.sensitive(plain, ldv_filter.LEVER, swing))
        if k % 3 == 0:
            fix = ms.gnss_position(filter_.nav, runs.SITE.origin_ecef, np.eye(3), runs.LEVER)
            filter_.update(ldv_filter.of_gnss(fix, ldv_filter.POSITION_OFF))
        steps += filter_.take_steps()
    grown = np.repeat(np.square(GROWTH), 3) * 0.2
    for last, step in pairwise(steps):
        noise = step.before - step.transition @ last.after @ step.transition.T
        assert_allclose(np.diag(noise)[15:21], grown, rtol=1e-6)
        assert_allclose(noise[21:], 0.0, atol=1e-15)
        scale = np.sqrt(np.maximum(np.diag(step.before), 1e-30))
        assert np.linalg.eigvalsh(noise / np.outer(scale, scale))[0] > -1e-12
