"""The loosely coupled filter: consistent, bounded while still, undone exactly, not fooled."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from unit.ins import loose_runs as runs

from deepseis_core import rotation
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import grade_named
from deepseis_core.kalman import chi_square_band
from deepseis_ins import error_state as es
from deepseis_ins import measurements as ms
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.strapdown import NavState, propagate
from deepseis_sim.motions import Circle, Still

STILL, SECONDS, RUNS = 40, 65, 20
CIRCLE = Circle(radius=0.5, frequency_hz=1.0, start=float(STILL), duration=100.0)  # 2 g
GRADES = ("span-fsas", "mti-g", "stim300")


@pytest.fixture(scope="module")
def circle():
    return runs.ideal_increments(CIRCLE, SECONDS)


@pytest.fixture(scope="module")
def rest():
    return runs.ideal_increments(Still(), 900)


def quake(gnss_hz, outage=(1e9, 1e9)):
    """Constraints each second while still, then GNSS."""

    def measurements(unit):
        def told(loose, time, C_ref, rng):
            if time < STILL:
                if abs(time - round(time)) < 1e-9:
                    yield from runs.constraints(loose, C_ref, rng)
            elif not outage[0] < time < outage[1]:
                yield from runs.gnss(unit, loose, time, rng)

        return told

    return measurements


def ensemble(grade, ideal, gnss_hz, *, told=None, count=RUNS, **options):
    """Fly so many units; other units and other noise for every grade and rate."""
    out, first = [], 1000 * GRADES.index(grade) + 100 * gnss_hz if grade in GRADES else 0
    for seed in range(first, first + count):
        unit = runs.Unit(grade, CIRCLE, SECONDS, seed, ideal, told=told)
        told_when = quake(gnss_hz, **options)(unit)
        out.append(runs.fly(unit, SECONDS, told_when, seed=seed, rate_hz=gnss_hz))
    return out


def mean_square(pairs, part=slice(None)):
    """Return the mean of normalised squared errors."""
    return np.mean([x[part] @ np.linalg.solve(P[part, part], x[part]) for x, P in pairs])


def joint_band(dof, count, claims):
    """Return a band for each of so many means that holds all of them with 95 %."""
    return chi_square_band(dof, count, 1.0 - 0.05 / claims)


@pytest.mark.parametrize("gnss_hz", [1, 10])
@pytest.mark.parametrize("grade", GRADES)
def test_errors_and_innovations_are_as_large_as_the_filter_says(circle, grade, gnss_hz):
    """Still with both constraints, then 2 g: all 15 states, four kinds of innovation.

    Means over 20 units; errors at the end of the still and at the end, when every unit has one
    independent error. The bands hold all six means of a case together with 95 %.
    """
    flown = ensemble(grade, circle, gnss_hz)
    low, high = joint_band(15, RUNS, 6)
    for time in (STILL - 1, SECONDS):
        assert low < mean_square([run.at(time) for run in flown]) < high
    for name in ("zero_velocity", "zero_angle", "position", "velocity"):
        squares = np.concatenate([run.squares(name) for run in flown])
        low, high = joint_band(3, squares.size, 6)
        assert low < squares.mean() < high, name


def test_considering_scale_factors_keeps_the_filter_honest_where_they_matter(circle):
    """Half a per cent wrong under 2 g: 15 mm/s of velocity, against GNSS good to 20 mm/s.

    A filter that does not consider them finds innovations outside their band.
    """
    true = replace(grade_named("span-fsas"), accel_scale_ppm=5000.0)
    blind = replace(true, accel_scale_ppm=0.0, accel_bias=0.05)  # gravity's share as a bias
    squares = {}
    for name, told in (("considers", true), ("does not", blind)):
        flown = ensemble(true, circle, 10, told=told, count=10)
        squares[name] = np.concatenate([run.squares("velocity") for run in flown])
    low, high = chi_square_band(3, squares["considers"].size)
    assert low < squares["considers"].mean() < high
    assert squares["does not"].mean() > high


@pytest.mark.parametrize("grade", GRADES)
def test_an_outage_of_25_seconds_errs_as_it_says(circle, grade):
    """No GNSS in the quake: nine errors of 20 units within 3.9 sigma, and of the right size.

    3.9 sigma is what the largest of 180 normal numbers exceeds once in 60 times.
    """
    flown = ensemble(grade, circle, 1, outage=(STILL - 1.0, 1e9))
    ends = [run.at(SECONDS) for run in flown]
    for run, (x, P) in zip(flown, ends, strict=True):
        assert np.all(np.abs(x[:9]) < 3.9 * np.sqrt(np.diag(P)[:9]))
        assert np.all(np.diag(P)[:6] > np.diag(run.at(STILL - 1)[1])[:6])
    low, high = joint_band(3, RUNS, 3)
    for part in (es.POS, es.VEL, es.ATT):
        assert low < mean_square(ends, part) < high


STATIC = {
    "loose": lambda unit: lambda loose, t, C, rng: runs.gnss(unit, loose, t, rng),
    "zupt": lambda unit: lambda loose, t, C, rng: runs.constraints(loose, C, rng, angle=False),
    "zupt+zero-angle": lambda unit: lambda loose, t, C, rng: runs.constraints(loose, C, rng),
}


def test_fifteen_minutes_at_rest_are_those_of_the_thesis(rest):
    """Figures 3.12 to 3.14: GNSS bounds position, ZUPT velocity, zero angle the heading too.

    Given attitude 0.03 deg; 0.1 deg/sqrt(h) let it drift, and only zero angle holds it. It stays
    at the survey's 0.03 deg and does not pretend to know what no repetition tells.
    """
    heading, velocity, squares = {}, {}, {}
    for name, told in STATIC.items():
        units = [runs.Unit("span-fsas", Still(), 900, seed, rest) for seed in range(4)]
        flown = [runs.fly(u, 900, told(u), seed=k, every=60) for k, u in enumerate(units)]
        heading[name] = [np.degrees(np.sqrt(P[8, 8])) for P in flown[0].covariances]
        velocity[name] = np.sqrt(np.diag(flown[0].covariances[-1])[es.VEL]).max()
        squares[name] = mean_square([run.at(900) for run in flown])
    low, high = joint_band(15, 4, 3)
    assert all(low < square < high for square in squares.values()), squares
    assert heading["loose"][-1] > 0.045
    assert heading["zupt"][-1] > 0.045
    assert np.all(np.diff(heading["zupt+zero-angle"]) <= 0.0)
    assert 0.02 < heading["zupt+zero-angle"][-1] < 0.031
    assert velocity["zupt"] < 0.2 * velocity["loose"]


def new_filter(config=None, grade="span-fsas", **given):
    start = NavState(runs.LAT, runs.LON, runs.HEIGHT, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    sds = {"attitude_sd": [1e-3] * 3, "position_sd": [1.0] * 3, "velocity_sd": [0.01] * 3}
    return LooseFilter(config or LooseConfig(), grade_named(grade), start, **(sds | given))


def increments(count, seed=1):
    rng = np.random.default_rng(seed)
    theta = rng.normal(0.0, 1e-4, (count, 3))
    vel = rng.normal(0.0, 1e-2, (count, 3))
    vel[:, 2] -= 9.8 * 0.005
    return theta, vel


def state(loose):
    nav = loose.nav
    return np.hstack(
        [nav.latitude, nav.longitude, nav.height, nav.vel_n, nav.quat_nb, loose.gyro_bias,
         loose.accel_bias, loose.P.ravel(), loose.sd]
    )  # fmt: skip


def test_any_cut_of_the_increments_gives_the_same_bytes():
    theta, vel = increments(437)
    whole, cut, rng = new_filter(), new_filter(), np.random.default_rng(3)
    whole.propagate(theta, vel, 0.005)
    first = 0
    while first < 437:
        count = int(rng.integers(1, 30))
        cut.propagate(theta[first : first + count], vel[first : first + count], 0.005)
        cut.P, cut.sd  # noqa: B018  looking changes nothing
        first += count
    assert_array_equal(state(cut), state(whole))


def test_without_updates_it_is_the_mechanisation():
    theta, vel = increments(300)
    loose, dt = new_filter(gyro_bias=[1e-3, 0, 0], accel_bias=[0, 0.02, 0]), 0.005
    start = loose.nav
    got = loose.propagate(theta, vel, 0.005)
    # The estimate of a bias fades in hours.
    _, expected = propagate(start, theta - [1e-3 * dt, 0, 0], vel - [0, 0.02 * dt, 0], dt)
    assert_allclose(got.vel_n, expected.vel_n, atol=1e-6)
    assert_array_equal(
        got.geodetic[-1], [loose.nav.latitude, loose.nav.longitude, loose.nav.height]
    )


def test_undo_is_exact():
    """Restored in the middle of a step of the covariance, it goes on as if nothing had been."""
    theta, vel = increments(600)
    loose, other = new_filter(), new_filter()
    loose.propagate(theta[:203], vel[:203], 0.005)
    before = loose.snapshot()
    loose.update(ms.zero_velocity(loose.nav, 1e-3))
    loose.update(ms.zero_angle(loose.nav, np.eye(3), 1e-3))
    loose.propagate(theta[203:400], vel[203:400], 0.005)
    loose.refer_attitude()
    loose.restore(before)
    other.propagate(theta[:203], vel[:203], 0.005)
    assert_array_equal(state(loose), state(other))
    for each in (loose, other):
        each.propagate(theta[203:], vel[203:], 0.005)
        each.update(ms.zero_angle(each.nav, np.eye(3), 1e-3))
    assert_array_equal(state(loose), state(other))


def far_off(loose, metres):
    place = SITE_ECEF + runs.C_NE.T @ [metres, 0.0, 0.0]
    return ms.gnss_position(loose.nav, place, np.eye(3), np.zeros(3))


SITE_ECEF = runs.SITE.origin_ecef


def test_the_gate_rejects_one_outlier_and_nothing_changes():
    loose = new_filter()
    before = state(loose)
    got = loose.update(far_off(loose, 50.0))
    assert not got.accepted
    assert got.normalised_squared == pytest.approx(50.0**2 / 2.0, rel=1e-3)
    assert_array_equal(state(loose), before)
    assert loose.update(far_off(loose, 1.0)).accepted


def test_after_many_rejections_the_filter_believes():
    """It really is 50 m off: position is given up, attitude and biases are not."""
    loose = new_filter(LooseConfig(rejections_before_recovery=5))
    attitude = loose.sd[es.ATT]
    results = [loose.update(far_off(loose, 50.0)) for _ in range(8)]
    assert [r.accepted for r in results] == [False] * 4 + [True] * 4
    assert [r.recovered for r in results] == [False] * 4 + [True] + [False] * 3
    M = 6.36e6
    assert (loose.nav.latitude - runs.LAT) * M == pytest.approx(50.0, abs=2.0)
    assert_allclose(loose.sd[es.ATT], attitude, rtol=1e-6)


def test_good_measurements_between_outliers_start_the_count_anew():
    loose = new_filter(LooseConfig(rejections_before_recovery=3))
    for _ in range(4):
        assert not loose.update(far_off(loose, 50.0)).accepted
        assert not loose.update(far_off(loose, 50.0)).accepted
        assert loose.update(far_off(loose, 0.0)).accepted


def test_repeated_zero_angle_tells_nothing_new_about_a_survey():
    """An hour of it once a second leaves the sd of a survey where it was."""
    loose = new_filter(attitude_sd=[1e-3] * 3)
    rest = np.zeros((200, 3)), np.tile([0.0, 0.0, -9.7977 * 0.005], (200, 1))
    for _ in range(100):
        loose.propagate(*rest, 0.005)
        loose.update(ms.zero_angle(loose.nav, np.eye(3), 1e-4))
    assert_allclose(loose.sd[es.ATT], 1e-3, rtol=0.01)


def test_a_second_survey_is_believed_as_far_as_it_goes():
    """Attitude 1 mrad, survey 1 mrad, independent: together 0.7 mrad, for ever."""
    loose = new_filter(grade="navigation", attitude_sd=[1e-3] * 3)
    C = loose.refer_attitude(rotation.matrix_from_rotvec([0.0, 0.0, 2e-3]), 1e-3)
    for _ in range(50):
        loose.update(ms.zero_angle(loose.nav, C, 1e-5))
    assert_allclose(loose.sd[es.ATT], 1e-3 / np.sqrt(2.0), rtol=1e-3)
    assert rotation.euler_from_quat(loose.nav.quat_nb)[2] == pytest.approx(1e-3, rel=1e-3)


def test_covariance_stays_symmetric_and_positive():
    loose, (theta, vel) = new_filter(grade="mti-g"), increments(2000)
    for first in range(0, 2000, 7):
        loose.propagate(theta[first : first + 7], vel[first : first + 7], 0.005)
        loose.update(ms.zero_velocity(loose.nav, 1e-5))
        P = loose.P
        assert_array_equal(P, P.T)
        sd = np.sqrt(np.diag(P))
        assert np.linalg.eigvalsh(P / np.outer(sd, sd)).min() > -1e-9


def test_widening_and_a_new_state_serve_a_gap():
    loose = new_filter()
    before = loose.sd
    loose.widen(velocity_sd=0.1, attitude_sd=[0.0, 0.0, 0.01])
    assert_allclose(loose.sd[es.VEL] ** 2, before[es.VEL] ** 2 + 0.01)
    assert_allclose(loose.sd[8] ** 2, before[8] ** 2 + 1e-4)
    loose.replace_nav(replace(loose.nav, height=60.0, previous_dt=0.0))
    assert loose.nav.height == 60.0
    assert_array_equal(loose.omega_ib_b, 0.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: new_filter(LooseConfig(covariance_step=0.0)), "covariance_step"),
        (lambda: new_filter(grade="accelerometers"), "gyroscopes"),
        (lambda: new_filter(position_sd=[-1.0, 1.0, 1.0]), "position"),
        (lambda: new_filter(attitude_sd=np.full((3, 3), np.nan)), "attitude"),
        (lambda: new_filter(gyro_bias=[0.0, np.nan, 0.0]), "gyro bias"),
        (lambda: new_filter().propagate(np.zeros((2, 3)), np.zeros((3, 3)), 0.01), "shapes"),
        (
            lambda: new_filter().propagate(np.full((2, 3), np.inf), np.ones((2, 3)), 0.1),
            "finite",
        ),
        (lambda: new_filter().propagate(np.zeros((2, 3)), np.zeros((2, 3)), 0.0), "positive"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_measurement_that_is_no_number_is_refused_and_changes_nothing():
    loose = new_filter()
    before, good = state(loose), ms.zero_velocity(loose.nav, 0.01)
    for bad in (replace(good, z=np.full(3, np.nan)), replace(good, R=np.full((3, 3), np.nan))):
        with pytest.raises(InputError):
            loose.update(bad)
    assert_array_equal(state(loose), before)
