"""The tightly coupled filter: rows, consistency, fewer than four satellites, outliers, clock."""

import time as clock
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from unit.ins import loose_runs as runs
from unit.ins import tight_runs as sky
from unit.ins.test_measurements import LEVER, NAV, OMEGA, antenna, wrong

from deepseis_core import geodesy, rotation
from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import grade_named
from deepseis_core.kalman import chi_square_band
from deepseis_ins import alignment
from deepseis_ins import measurements as ms
from deepseis_ins import tight_kernels as kernels
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.nav_array import pack as pack_nav
from deepseis_ins.strapdown import NavState
from deepseis_ins.tight import Ranges, TightConfig, TightFilter
from deepseis_sim.motions import Circle, Still

AIRLESS = TightConfig(troposphere=False)
CLOCK = np.array([1.2e4, -37.0])


def rows(nav, omega, clock, satellites, measured, rates):
    """Return z and H of the kernel."""
    n = len(measured)
    z, H, R = np.empty(2 * n), np.empty((2 * n, 17)), np.empty(2 * n)
    kernels.rows_kernel(
        pack_nav(nav), omega, LEVER, 0.0, clock, satellites, measured, rates,
        np.ones(2 * n), np.zeros(kernels.AIR_SIZE), z, H, R,
    )  # fmt: skip
    return z, H


@pytest.fixture(scope="module")
def truth():
    """Return what is measured at NAV, by the propagation that the signal is made with."""
    position, velocity = antenna(NAV, OMEGA)
    packed = sky.visible(8, site=position)
    pr, rate, satellites = sky.observed(packed, 0.0, np.hstack([position, velocity]), *CLOCK)
    return satellites, pr, rate


def test_the_truth_predicts_what_is_measured(truth):
    satellites, pr, rate = truth
    z, _ = rows(NAV, OMEGA, CLOCK, satellites, pr, rate)
    # Receiver time is rounded to 0.5 ns here: 2 um of orbit; clock time against GPS time, 40 us at
    # the satellites' acceleration of 0.6 m/s^2.
    assert_allclose(z[:8], 0.0, atol=1e-5)
    assert_allclose(z[8:], 0.0, atol=3e-5)


@pytest.mark.parametrize("state", range(17))
def test_rows_are_the_derivatives_of_the_prediction(truth, state):
    satellites, pr, rate = truth
    size = (1.0, 1.0, 1e-3, 1e-3, 1e-2, 100.0)[min(state // 3, 5)]

    def predicted(sign):
        x = np.zeros(17)
        x[state] = sign * size
        return rows(wrong(NAV, x), OMEGA + x[9:12], CLOCK + x[15:], satellites, pr, rate)[0]

    slope = (predicted(1.0) - predicted(-1.0)) / (2.0 * size)
    _, H = rows(NAV, OMEGA, CLOCK, satellites, pr, rate)
    # Of the range rate v/c is left out: 3e-6. Rounding of a range, 4e-9 m, over the size. What
    # frame and line of sight do together: (1 m / 6400 km) of a velocity of 4 m/s.
    assert_allclose(H[:, state], slope, rtol=1e-5, atol=1e-6 if state > 2 else 2e-6)


def started(unit, seed, *, tight=AIRLESS, motion=None, **given):
    """Return a filter in error as it is told, as `loose_runs.started` has it."""
    rng = np.random.default_rng([seed, 5])
    phi = runs.ATTITUDE_SD * rng.standard_normal(3)
    r = runs.POSITION_SD * rng.standard_normal(3)
    place = geodesy.geodetic_from_ecef(runs.SITE.origin_ecef + runs.C_NE.T @ r)
    quat = rotation.quat_from_matrix(rotation.matrix_from_rotvec(-phi) @ runs.C_TRUE)
    return TightFilter(
        LooseConfig(), unit.grade, NavState(*place, np.zeros(3), quat), tight=tight,
        lever_arm_b=runs.LEVER, attitude_sd=[runs.ATTITUDE_SD] * 3,
        position_sd=runs.POSITION_SD, velocity_sd=[1e-6] * 3, **given,
    )  # fmt: skip


SECONDS, RUNS = 50, 20
MOTION = Circle(radius=0.5, frequency_hz=1.0, start=10.0, duration=100.0)  # 2 g


@pytest.fixture(scope="module")
def ideal():
    return runs.ideal_increments(MOTION, SECONDS)


def fly(ideal, seed, keep, packed, grade="span-fsas"):
    """Return the error of all 17 states at the end, its covariance, and squares of rows."""
    unit = runs.Unit(grade, MOTION, SECONDS, seed, ideal)
    tight, receiver = started(unit, seed), sky.Receiver(MOTION, packed, seed)
    squares = []
    for second in range(SECONDS):
        part = slice(second * runs.RATE, (second + 1) * runs.RATE)
        tight.propagate(unit.theta[part], unit.vel[part], 1.0 / runs.RATE)
        got = tight.update_ranges(receiver.at(second + 1.0, keep(second + 1)))
        if second:  # the first starts the clock with itself
            squares += got.normalised_squared.tolist()
    error = [*unit.error(tight, float(SECONDS)), tight.clock_bias - receiver.bias,
             tight.clock_drift - receiver.drift]  # fmt: skip
    return np.array(error), tight.tight_P, squares


@pytest.mark.parametrize(
    "keep", [lambda t: None, lambda t: 3 if t > 20 else None], ids=["all", "three from 20 s on"]
)
def test_errors_and_innovations_are_as_large_as_the_filter_says(ideal, keep):
    """17 states of 20 units under 2 g; every range and range rate. 95 % for both together."""
    packed = sky.visible()
    assert len(packed) >= 8
    flown = [fly(ideal, seed, keep, packed) for seed in range(RUNS)]
    normalised = [x @ np.linalg.solve(P, x) for x, P, _ in flown]
    low, high = chi_square_band(17, RUNS, 0.975)
    assert low < np.mean(normalised) < high
    squares = np.concatenate([s for _, _, s in flown])
    low, high = chi_square_band(1, squares.size, 0.975)
    assert low < squares.mean() < high


def at_rest(tight=AIRLESS, grade="span-fsas", **given):
    start = NavState(runs.LAT, runs.LON, runs.HEIGHT, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    sds = {"attitude_sd": [1e-3] * 3, "position_sd": [3.0] * 3, "velocity_sd": [0.01] * 3}
    return TightFilter(
        LooseConfig(), grade_named("span-fsas"), start, tight=tight, **(sds | given)
    )


def still_epochs(count, seed=3, noise=sky.CLOCK_NOISE):
    receiver = sky.Receiver(Still(), sky.visible(), seed, lever_b=np.zeros(3), noise=noise)
    return [receiver.at(k + 1.0) for k in range(count)]


def lowest(epoch, count):
    """Return an epoch of its lowest satellites, which are far from each other."""
    names = ("satellites", "pseudorange", "range_rate", "pseudorange_sd", "range_rate_sd")
    return replace(
        epoch, **{name: getattr(epoch, name)[len(epoch.pseudorange) - count :] for name in names}
    )


def rest(tight, seconds=1):
    n = 200 * seconds
    g = geodesy.normal_gravity(runs.LAT, runs.HEIGHT)
    omega = alignment.earth_rate(runs.LAT)
    tight.propagate(np.tile(omega / 200, (n, 1)), np.tile([0.0, 0.0, -g / 200], (n, 1)), 0.005)


def test_three_satellites_hold_what_none_lose():
    """STIM300, a good clock, three minutes under three, two or no satellites.

    An ordinary clock's wander is as unknown as a coordinate: three satellites cannot tell both.
    """
    steady, sizes = replace(AIRLESS, clock_bias_noise=1e-4, clock_drift_noise=1e-4), {}
    epochs = still_epochs(200, noise=(1e-4, 1e-4))
    for count in (3, 2, 0):
        tight = at_rest(steady, grade="stim300")
        for k, epoch in enumerate(epochs):
            rest(tight)
            tight.update_ranges(epoch if k < 20 else lowest(epoch, count))
        sizes[count] = float(np.sqrt(np.trace(tight.P[:3, :3])))
    print(sizes)
    assert sizes[3] < sizes[2] < sizes[0]
    assert sizes[3] < 0.2 * sizes[0]


def test_one_reflection_does_not_pass_and_the_rest_does():
    tight, epochs = at_rest(), still_epochs(5)
    for epoch in epochs[:4]:
        rest(tight)
        assert tight.update_ranges(epoch).accepted.all()
    rest(tight)
    bad = epochs[4].pseudorange.copy()
    bad[2] += 30.0
    got = tight.update_ranges(replace(epochs[4], pseudorange=bad))
    assert_array_equal(np.flatnonzero(~got.accepted), [2])


def test_an_outlier_among_wide_uncertainty_is_found_by_the_others():
    """The prior is good to 100 m, so 60 m pass it; not once the other ranges have been heard."""
    tight, epochs = at_rest(position_sd=[100.0] * 3), still_epochs(2)
    rest(tight)
    tight.update_ranges(replace(epochs[0], pseudorange=epochs[0].pseudorange + np.nan))
    bad = epochs[0].pseudorange.copy()
    bad[0] += 60.0
    got = tight.update_ranges(replace(epochs[0], pseudorange=bad))
    n = len(bad)
    assert abs(got.z[0]) < 4.0 * got.sd[0]
    assert_array_equal(np.flatnonzero(~got.accepted[:n]), [0])


def test_a_milliseconds_jump_of_the_receivers_clock_moves_nothing_else():
    tight, epochs = at_rest(), still_epochs(3)
    other = at_rest()
    for each in (tight, other):
        for epoch in epochs[:2]:
            rest(each)
            each.update_ranges(epoch)
        rest(each)
    jumped = replace(epochs[2], pseudorange=epochs[2].pseudorange - SPEED_OF_LIGHT * 1e-3)
    assert tight.update_ranges(jumped).accepted.all()
    other.update_ranges(epochs[2])
    assert tight.clock_bias == pytest.approx(other.clock_bias - SPEED_OF_LIGHT * 1e-3, abs=1e-6)
    assert_allclose(tight.nav.vel_n, other.nav.vel_n, atol=1e-9)
    assert_allclose(tight.tight_P, other.tight_P, rtol=1e-6, atol=1e-12)


def test_without_ranges_it_is_the_loose_filter():
    """The same increments and constraints: state and covariance to the bit, or rounding."""
    start = NavState(runs.LAT, runs.LON, runs.HEIGHT, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    sds = {"attitude_sd": [1e-3] * 3, "position_sd": [3.0] * 3, "velocity_sd": [0.01] * 3}
    loose, tight = LooseFilter(LooseConfig(), grade_named("span-fsas"), start, **sds), at_rest()
    for each in (loose, tight):
        for _ in range(5):
            rest(each)
            each.update(ms.zero_velocity(each.nav, 1e-3))
            each.update(ms.zero_angle(each.nav, np.eye(3), 1e-3))
    assert_allclose(tight.P, loose.P, rtol=1e-9, atol=1e-20)
    assert_allclose(tight.nav.vel_n, loose.nav.vel_n, atol=1e-15)
    assert_allclose(tight.tight_P[:15, :15], loose.P, rtol=1e-9, atol=1e-20)
    assert np.isnan(tight.clock_bias)


def test_undo_is_exact_and_looking_changes_nothing():
    tight, epochs = at_rest(), still_epochs(4)
    rest(tight)
    tight.update_ranges(epochs[0])
    rest(tight)
    before, P = tight.snapshot(), tight.tight_P
    for epoch in epochs[1:]:
        tight.update_ranges(epoch)
        rest(tight)
    tight.restore(before)
    assert_array_equal(tight.tight_P, P)
    assert tight.clock_bias == tight.clock_bias
    with pytest.raises(InputError, match="snapshot"):
        tight.restore(LooseFilter.snapshot(at_rest()))


def test_a_wrong_position_is_given_up_after_many_epochs():
    """200 m off and sure of 0.1 m: most ranges are rejected, then the filter believes them."""
    config = replace(AIRLESS, epochs_before_recovery=5)
    tight, epochs = at_rest(config, position_sd=[0.1] * 3), still_epochs(30)
    tight.replace_nav(replace(tight.nav, latitude=tight.nav.latitude + 200.0 / 6.36e6))
    recovered = []
    for epoch in epochs:
        rest(tight)
        recovered.append(tight.update_ranges(epoch).recovered)
    assert any(recovered)
    assert (tight.nav.latitude - runs.LAT) * 6.36e6 == pytest.approx(0.0, abs=5.0)


def test_bad_ranges_are_refused():
    tight, epochs = at_rest(), still_epochs(1)
    good = epochs[0]
    for bad in (
        replace(good, range_rate=good.range_rate[:2]),
        replace(good, pseudorange_sd=0.0 * good.pseudorange_sd),
        replace(good, satellites=good.satellites[:, :5]),
    ):
        with pytest.raises(InputError, match="ranges"):
            tight.update_ranges(bad)


def test_nothing_in_view_is_no_error():
    got = at_rest().update_ranges(Ranges(np.zeros((0, 12)), *[np.zeros(0)] * 4))
    assert got.accepted.size == 0


def test_an_hour_of_200_hz_and_ten_satellites_takes_seconds(capsys):
    """Goal: 3 s an hour. Measured over 60 s of it on whatever the machine leaves, the best of 3.

    Ten times the goal is what a loaded machine is allowed.
    """
    receiver = sky.Receiver(Still(), sky.visible(mask_deg=0.0)[:10], 3, lever_b=np.zeros(3))
    epochs = [receiver.at(k + 1.0) for k in range(60)]
    assert len(epochs[0].pseudorange) == 10
    took = []
    for _ in range(3):
        tight = at_rest()
        rest(tight)
        begin = clock.process_time()
        for epoch in epochs:
            rest(tight)
            tight.update_ranges(epoch)
        took.append(clock.process_time() - begin)
    with capsys.disabled():
        print(f" [an hour: {60.0 * min(took):.2f} s]", end="")
    assert 60.0 * min(took) < 30.0
