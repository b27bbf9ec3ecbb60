"""Without gyroscopes: mechanisation, Jacobians, consistency, knowledge of stillness."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are

from deepseis_core.errors import InputError
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import grade_named
from deepseis_core.kalman import chi_square_band
from deepseis_core.rotation import matrix_from_euler
from deepseis_ins.gyrofree import GyroFreeConfig, GyroFreeFilter
from deepseis_ins.gyrofree_model import DRIFT, POS, discretise_exactly
from deepseis_ins.gyrofree_offline import StationRecord, track
from deepseis_ins.smoother import smooth
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motions import Circle
from deepseis_sim.position_errors import PositionErrorConfig, PositionErrors
from deepseis_sim.site import Site

SITE = Site([0.62, 2.44, 50.0])
LAT, _, HEIGHT = SITE.origin_geodetic
GRADE = grade_named("accelerometers")
STILL, SECONDS, RUNS = 40, 100, 24
CIRCLE = Circle(radius=0.12, frequency_hz=1.0, start=float(STILL), duration=200.0)
ERRORS = PositionErrorConfig(correlation_time=(60.0, 60.0, 60.0))
WHITE = np.diag(np.square(ERRORS.white_sd))
TOTAL = WHITE + np.diag(np.square(ERRORS.drift_sd))
TWELVE = GyroFreeConfig(
    drift_sd=ERRORS.drift_sd, drift_correlation_time=ERRORS.correlation_time, position_sd=0.05
)
NINE = GyroFreeConfig(position_sd=0.05)
TILTED = matrix_from_euler([0.02, -0.03, 1.1])


def new(config=TWELVE, C=None, **options):
    return GyroFreeFilter(
        config, GRADE, np.eye(3) if C is None else C, latitude=LAT, height=HEIGHT, **options
    )


def shake(seconds, rate_hz):
    """Return increments of the bench for a circle of 2 g, without errors."""
    motion = Circle(radius=0.5, frequency_hz=1.0, start=2.0, duration=200.0)
    got = ImuSynthesizer(motion, SITE, float(rate_hz)).increments(0, seconds * rate_hz)
    return motion, got


@pytest.mark.parametrize(("rate_hz", "tolerance"), [(100, 1e-5), (200, 1.5e-6)])
def test_without_errors_the_motion_comes_back(rate_hz, tolerance):
    """The bench integrates the same physics otherwise; 30 s at 2 g.

    What is left is the third derivative of the acceleration between samples: 8 times less at
    twice the rate and more.
    """
    motion, got = shake(30, rate_hz)
    filter_ = new()
    out = filter_.propagate(got.delta_vel, 1.0 / rate_hz)
    truth = motion.at(got.time_end)
    assert_allclose(out.position, truth.position, rtol=0, atol=tolerance)
    assert_allclose(out.velocity, truth.velocity, rtol=0, atol=tolerance)


def test_any_cut_of_the_increments_gives_the_same_state():
    _, got = shake(4, 200)
    whole, cut = new(C=TILTED), new(C=TILTED)
    whole.propagate(got.delta_vel, 0.005)
    for first in range(0, 800, 37):
        cut.propagate(got.delta_vel[first : first + 37], 0.005)
    assert_array_equal(cut.position, whole.position)
    assert_array_equal(cut.velocity, whole.velocity)
    assert_allclose(cut.P, whole.P, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("error", range(12))
def test_every_column_of_the_transition_is_that_of_a_perturbed_mechanisation(error):
    """States are linear here: differences of any size serve."""
    _, got = shake(6, 200)
    first, rest = got.delta_vel[:800], got.delta_vel[800:]
    one, other = new(C=TILTED, smoothing=True), new(C=TILTED)
    size = 0.3
    for each in (one, other):
        each.propagate(first, 0.005)
    one.take_steps()
    push = np.zeros(12)
    push[error] = size
    other._feed_back(-push)  # the estimate is now in error by it
    for each in (one, other):
        each.propagate(rest, 0.005)
    (step,) = one.take_steps()
    moved = np.hstack(
        [
            other.position - one.position,
            other.velocity - one.velocity,
            one.accel_bias - other.accel_bias,
            one.drift - other.drift,
        ]
    )
    assert_allclose(moved, step.transition[:, error] * size, rtol=2e-6, atol=2e-8)


def test_the_noise_of_an_interval_is_the_integral_of_its_differential_equation():
    filter_ = new()
    F, Q, t = filter_._F, filter_._Q, 7.0
    n = len(F)

    def rate(_t, flat):
        P = flat.reshape(n, n)
        return (F @ P + P @ F.T + Q).ravel()

    end = solve_ivp(rate, (0.0, t), np.zeros(n * n), rtol=1e-10, atol=1e-22).y[:, -1]
    Phi, noise = discretise_exactly(F, Q, t)
    scale = np.sqrt(np.diag(noise))
    assert_allclose((noise - end.reshape(n, n)) / scale / scale[:, None], 0.0, atol=1e-6)
    two = discretise_exactly(F, Q, 0.5 * t)[0]
    assert_allclose(two @ two, Phi, rtol=1e-9, atol=1e-15)


@pytest.fixture(scope="module")
def ideal():
    return ImuSynthesizer(CIRCLE, SITE, 100.0).increments(0, 100 * SECONDS)


class Flight:
    """One unit with its errors and its GNSS, filtered; errors of the states at the epochs."""

    def __init__(self, config, ideal, seed, *, gnss_hz=1, held=False, R=WHITE):
        unit = ImuErrors(GRADE, 100.0, seed)
        got = unit.apply(0, ideal.delta_theta, ideal.delta_vel)
        truth = unit.truth(0, 100 * SECONDS)
        gnss = PositionErrors(ERRORS, gnss_hz, seed)
        # The drift of the epoch before the first is not used: a process of its own.
        error, drift = gnss(0, gnss_hz * SECONDS), gnss.drift(0, gnss_hz * SECONDS)
        rng = np.random.default_rng([seed, 3])
        filter_ = new(config, smoothing=True)
        filter_._feed_back(np.hstack([0.05 * rng.normal(size=3), 0.01 * rng.normal(size=3),
                                      np.zeros(config.states - 6)]))  # fmt: skip
        if held:
            filter_ = new(config, smoothing=True)
        self.innovations, self.steps, self.errors = [], [], []
        span = 100 // gnss_hz
        C_bias = truth.accel_matrix @ [0.0, 0.0, 9.7975]
        for k in range(gnss_hz * SECONDS):
            filter_.propagate(got.delta_vel[k * span : k * span + span], 0.01)
            n = k * span + span
            at = CIRCLE.at(np.array([n / 100.0]))
            if held and n / 100.0 < STILL and n % 100 == 0:
                filter_.hold_still()
            told = filter_.update_position(at.position[0] + error[k], R)
            self.innovations.append(told.normalised_squared)
            self.steps += filter_.take_steps()
            bias = truth.accel_bias[n - 1] + C_bias
            self.errors.append(
                np.hstack(
                    [
                        filter_.position - at.position[0],
                        filter_.velocity - at.velocity[0],
                        bias - filter_.accel_bias,
                        drift[k] - filter_.drift,
                    ]
                )[: config.states]
            )
        self.gnss = error


def square(error, P, part):
    return error[part] @ np.linalg.solve(P[part, part], error[part])


@pytest.mark.parametrize(
    ("gnss_hz", "held", "count"), [(1, False, RUNS), (1, True, RUNS), (10, False, 10)]
)
def test_errors_innovations_and_smoothed_errors_are_as_large_as_it_says(
    ideal, gnss_hz, held, count
):
    """Many units; twelve states at two times forward and smoothed, and all innovations.

    The bands hold all five means of a case together with 95 %. What is held still moves less here
    than it may, so only the drift is looked at there.
    """
    flown = [Flight(TWELVE, ideal, 500 + s, gnss_hz=gnss_hz, held=held) for s in range(count)]
    smoothed = [smooth(flight.steps) for flight in flown]
    for time in (STILL - 5, SECONDS - 20):
        k, part = time * gnss_hz - 1, DRIFT if held and time < STILL else slice(0, 12)
        low, high = chi_square_band(part.stop - part.start, count, 1.0 - 0.05 / 5)
        forward, after = [], []
        for flight, got in zip(flown, smoothed, strict=True):
            forward.append(square(flight.errors[k], flight.steps[k].after, part))
            after.append(square(flight.errors[k] - got.error[k], got.P[k], part))
        assert low < np.mean(forward) < high, time
        assert low < np.mean(after) < high, time
    squares = np.concatenate([flight.innovations for flight in flown])
    low, high = chi_square_band(3, squares.size, 1.0 - 0.05 / 5)
    assert low < squares.mean() < high


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def test_each_piece_of_knowledge_helps(ideal):
    """Drift as white (the paper), drift modelled, smoothed, known still before: in this order."""
    seeds = range(600, 600 + RUNS)
    moving = slice(STILL, SECONDS)
    results = {"gnss": [], "nine": [], "twelve": [], "smoothed": [], "held": []}
    for seed in seeds:
        nine = Flight(NINE, ideal, seed, R=TOTAL)
        twelve = Flight(TWELVE, ideal, seed)
        held = Flight(TWELVE, ideal, seed, held=True)
        results["gnss"].append(twelve.gnss[moving])
        for name, flight in (("nine", nine), ("twelve", twelve)):
            results[name].append(np.array(flight.errors)[moving, POS])
        for name, flight in (("smoothed", twelve), ("held", held)):
            left = np.array(flight.errors) - smooth(flight.steps).error
            results[name].append(left[moving, POS])
    error = {name: rms(np.concatenate(each)) for name, each in results.items()}
    assert np.all(error["nine"] < error["gnss"])
    # Little while forward: the future tells noise from drift better than the past.
    assert np.linalg.norm(error["twelve"]) < np.linalg.norm(error["nine"])
    assert np.all(error["smoothed"] < error["twelve"])
    assert np.all(error["held"] < error["smoothed"])


def test_while_still_gnss_tells_its_drift_and_nothing_else():
    """Known as a filter of one state would know it, a drift seen through white noise."""
    filter_ = new()
    at_rest = np.tile([0.0, 0.0, 9.7975 / 100.0], (100, 1))
    shift = np.array([0.01, -0.02, 0.03])
    for _ in range(200):
        filter_.propagate(at_rest, 0.01)
        filter_.hold_still()
        filter_.update_position(shift, WHITE)
    assert_allclose(filter_.position, 0.0, atol=1e-4)
    assert_allclose(filter_.drift, shift, rtol=0.25)
    for axis in range(3):
        r, decay = ERRORS.white_sd[axis] ** 2, np.exp(-1.0 / 60.0)
        drive = ERRORS.drift_sd[axis] ** 2 * (1.0 - decay**2)
        before = solve_discrete_are([[decay]], [[1.0]], [[drive]], [[r]])[0, 0]
        assert filter_.sd[DRIFT][axis] == pytest.approx(
            np.sqrt(before * r / (before + r)), rel=0.01
        )


def test_an_outlier_changes_nothing_and_a_real_step_is_believed():
    filter_ = new(GyroFreeConfig(rejections_before_recovery=3))
    at_rest = np.tile([0.0, 0.0, 9.7975 / 100.0], (100, 1))
    for _ in range(20):
        filter_.propagate(at_rest, 0.01)
        filter_.update_position(np.zeros(3), TOTAL)
    before = filter_.position, filter_.P
    assert not filter_.update_position([1.0, 0.0, 0.0], TOTAL).accepted
    assert_array_equal(filter_.position, before[0])
    assert_array_equal(filter_.P, before[1])
    filter_.update_position(np.zeros(3), TOTAL)
    told = [filter_.update_position([1.0, 0.0, 0.0], TOTAL) for _ in range(4)]
    assert [each.accepted for each in told] == [False, False, True, True]
    assert told[2].recovered
    assert filter_.position[0] == pytest.approx(1.0, abs=0.02)


def test_a_bias_far_off_is_found_in_the_end():
    """0.2 m/s^2, seven times the grade's: GNSS is rejected, then believed, and the bias learnt."""
    filter_ = new(NINE)
    at_rest = np.tile([0.2 / 100.0, 0.0, 9.7975 / 100.0], (100, 1))
    told = []
    for _ in range(120):
        filter_.propagate(at_rest, 0.01)
        told.append(filter_.update_position(np.zeros(3), TOTAL))
    assert any(each.recovered for each in told)
    assert all(each.accepted for each in told[60:])
    assert filter_.accel_bias[0] == pytest.approx(0.2, abs=0.003)
    assert_allclose(filter_.position, 0.0, atol=0.02)


def test_bad_settings_and_data_are_refused():
    with pytest.raises(InputError, match="three values each"):
        new(GyroFreeConfig(drift_sd=(0.01,)))
    with pytest.raises(InputError, match="rotation matrix"):
        new(C=2.0 * np.eye(3))
    filter_ = new()
    with pytest.raises(InputError, match="shape"):
        filter_.propagate(np.zeros((3, 2)), 0.01)
    with pytest.raises(InputError, match="positive intervals"):
        filter_.propagate(np.zeros((3, 3)), 0.0)
    with pytest.raises(InputError, match="not finite"):
        filter_.update_position([np.nan, 0.0, 0.0], WHITE)
    with pytest.raises(InputError, match="kept no steps"):
        filter_.take_steps()


def record(ideal, seed, **given):
    """Return a station's record of the circle and its truth at IMU rate."""
    unit = ImuErrors(GRADE, 100.0, seed)
    got = unit.apply(0, ideal.delta_theta, ideal.delta_vel)
    epochs = 100 * np.arange(SECONDS)
    at = CIRCLE.at(epochs / 100.0)
    positions = at.position + PositionErrors(ERRORS, 1.0, seed)(0, SECONDS)
    return StationRecord(got.delta_vel, 100.0, epochs, positions, WHITE, **given)


def test_a_record_is_smoothed_at_imu_rate_without_steps(ideal):
    """The filter's track jumps at every epoch; the smoothed one goes with its own velocity."""
    got = track(new(smoothing=True), record(ideal, 11))
    inside = slice(1000, 9800)
    truth = CIRCLE.at(got.time)
    smoothed = got.smoothed
    gained = np.diff(smoothed.position[inside], axis=0)
    # Trapezium of the velocity: dt^3 / 12 of the third derivative, 30 m/s^3 at 0.12 m, 1 Hz.
    mean = 0.5 * (smoothed.velocity[inside][1:] + smoothed.velocity[inside][:-1])
    assert np.abs(gained - 0.01 * mean).max() < 1.2 * 0.01**3 / 12 * 0.12 * (2 * np.pi) ** 3 + 2e-6
    jumps = np.diff(got.forward.position[inside] - truth.position[inside], axis=0)
    assert np.abs(jumps).max() > 1e-3
    errors = [rms((each.position - truth.position)[inside]) for each in (got.forward, smoothed)]
    assert np.all(errors[1] < errors[0])
    fast = [rms((each.velocity - truth.velocity)[inside]) for each in (got.forward, smoothed)]
    assert np.all(fast[1] < 0.8 * fast[0])


def test_a_record_with_holes_in_gnss_is_bridged(ideal):
    """20 s without GNSS: smoothing takes away most of what the hole adds to the drift."""
    errors = []
    for seed in range(20, 32):
        whole = record(ideal, seed)
        keep = (whole.epochs < 5000) | (whole.epochs >= 7000)
        part = StationRecord(
            whole.delta_vel_b, 100.0, whole.epochs[keep], whole.positions[keep], WHITE
        )
        got = track(new(smoothing=True), part)
        hole = slice(5000, 6900)
        truth = CIRCLE.at(got.time).position[hole]
        errors.append([each.position[hole] - truth for each in (got.forward, got.smoothed)])
    squares = [np.square(rms(np.concatenate(each))) for each in zip(*errors, strict=True)]
    added = [np.sqrt(np.maximum(each - np.square(ERRORS.drift_sd), 0.0)) for each in squares]
    assert np.all(added[1] < 0.5 * added[0])


def test_a_record_that_makes_no_sense_is_refused(ideal):
    whole = record(ideal, 1)
    for epochs, text in (
        ([], "no epoch"),
        ([5, 3], "not in order"),
        ([0, 10_001], "not in order"),
    ):
        bad = StationRecord(whole.delta_vel_b, 100.0, np.array(epochs), whole.positions, WHITE)
        with pytest.raises(InputError, match=text):
            track(new(smoothing=True), bad)
    bad = StationRecord(whole.delta_vel_b, 100.0, np.array([1, 2]), np.zeros((3, 3)), WHITE)
    with pytest.raises(InputError, match="have shape"):
        track(new(smoothing=True), bad)
