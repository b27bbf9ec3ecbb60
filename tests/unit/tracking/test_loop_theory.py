import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.signal import lfilter

from deepseis_core.constants import L1_HZ
from deepseis_core.imu_grades import STANDARD_GRAVITY, ImuGrade, grade_named
from deepseis_sim.oscillator import OSCILLATORS, Oscillator, OscillatorConfig
from deepseis_tracking import loop_theory as theory
from deepseis_tracking.loop_theory import PHASE_PER_METRE
from deepseis_tracking.loop_theory_analog import AnalogLoop
from deepseis_tracking.loop_theory_discrete import DiscreteLoop
from deepseis_tracking.loop_theory_imu import (
    ImuErrorTheory,
    NavigationErrors,
    Strain,
    calibrated,
    delay_error,
    free_inertial_error,
)
from deepseis_tracking.loop_theory_limits import (
    best_bandwidth,
    jammed_cn0_dbhz,
    jammer_range,
    jammer_to_signal_db,
    least_bandwidth,
    sensitivity,
)
from deepseis_tracking.loop_theory_simulation import circle, simulate_loop

G = STANDARD_GRAVITY
SHAPES = [(1, 0.7), (2, 0.5**0.5), (2, 1.0), (3, 0.7)]


# Closed forms


def test_thermal_noise_is_that_of_the_acceptance_table() -> None:
    found = np.degrees(theory.thermal_noise(3.0, [45.0, 41.0], 0.02))
    assert_allclose(found, [0.56, 0.89], atol=0.005)  # half the last digit


def test_order_3_stress_is_that_of_the_doppler_aided_paper() -> None:
    printed = PHASE_PER_METRE * 0.4828 * 98.0 / 25.0**3
    assert_allclose(theory.dynamic_stress(3, 25.0, 98.0), printed, rtol=2e-4)  # its digits


def test_vibration_by_integration_of_its_spectrum() -> None:
    # Order 2, damping 0.707: |1 - H|^2 = f^4 / (f^4 + fn^4); phase density (f1 Kg)^2 Gg / f^2.
    wn = float(theory.natural_frequency(2, 8.0))
    fn = wn / (2.0 * np.pi)
    integral = quad(lambda f: f**2 / (f**4 + fn**4), 0.0, np.inf)[0]
    expected = L1_HZ * 1e-9 * np.sqrt(0.05 * integral)
    assert_allclose(theory.vibration_noise(8.0), expected, rtol=0.002)  # 2.67 has three digits


def test_allan_noise_by_integration_of_a_one_sided_density() -> None:
    loop, (h_0, h_1, h_2) = AnalogLoop.for_bandwidth(2, 1.5), theory.OCXO

    def density(f: float) -> float:
        return (h_0 + h_1 / f + h_2 / f**2) / f**2 * float(loop.error_gain(f)) ** 2

    variance = L1_HZ**2 * (quad(density, 0.0, 1.0)[0] + quad(density, 1.0, np.inf)[0])
    one_sided, printed = (
        float(theory.allan_noise(1.5, convention=how)) for how in ("one-sided", "as-printed")
    )
    assert one_sided == pytest.approx(np.sqrt(variance), rel=0.005)  # 1.89 for 1 / 0.5303
    assert one_sided == pytest.approx(np.sqrt(2.0) * printed)


def test_the_ocxo_is_the_bench_s() -> None:
    law = OSCILLATORS["ocxo"]
    assert (law.h_0, law.h_minus_1, law.h_minus_2) == theory.OCXO
    tau = np.array([0.02, 1.0, 30.0])
    assert_allclose(theory.allan_deviation(tau), law.allan_deviation(tau))
    deg = np.degrees(theory.allan_noise_order_3(18.0, 1e-10))
    assert deg == pytest.approx(160.0 * 1e-10 * L1_HZ / 18.0)


def test_totals() -> None:
    assert theory.conventional_total(3.0, 4.0, 12.0, 6.0) == pytest.approx(13.0 + 2.0)
    assert theory.aided_total(2.0, 4.0, 5.0, 6.0) == pytest.approx(9.0)


# Analog loops


@pytest.mark.parametrize(("order", "damping"), SHAPES)
def test_an_analog_loop_has_the_bandwidth_it_was_made_for(order: int, damping: float) -> None:
    loop = AnalogLoop.for_bandwidth(order, 8.0, damping)
    assert loop.noise_bandwidth_hz == pytest.approx(8.0)

    def closed(f: float) -> float:
        s = 2j * np.pi * f
        return float(abs(1.0 - s**order / np.polyval(loop.poles, s)) ** 2)

    assert quad(closed, 0.0, np.inf, limit=500)[0] == pytest.approx(8.0, rel=1e-6)


def test_velocity_step_peaks() -> None:
    critical = AnalogLoop.for_bandwidth(2, 15.0, 1.0)
    closed = float(theory.velocity_step_peak(24.0, 0.01))
    assert critical.velocity_step_peak(0.01) == pytest.approx(closed, rel=1e-5)
    # Damping 0.707: exp(-a t) sin(a t) / a with a = wn / sqrt 2, greatest at a t = pi / 4.
    usual = AnalogLoop.for_bandwidth(2, 15.0)
    a = usual.natural_frequency / np.sqrt(2.0)
    expected = PHASE_PER_METRE * 0.01 * np.exp(-np.pi / 4.0) * np.sin(np.pi / 4.0) / a
    assert usual.velocity_step_peak(0.01) == pytest.approx(expected, rel=1e-5)
    first = AnalogLoop.for_bandwidth(1, 15.0)
    assert first.velocity_step_peak(0.01) == pytest.approx(first.steady_error(0.01), rel=1e-6)


@pytest.mark.parametrize(("order", "damping"), SHAPES)
def test_errors_settle_on_the_dynamic_stress(order: int, damping: float) -> None:
    loop = AnalogLoop.for_bandwidth(order, 8.0, damping)
    time = np.linspace(0.0, 90.0 / loop.natural_frequency, 20001)
    stress = float(theory.dynamic_stress(order, 8.0, 3.0, damping))
    assert loop.steady_error(3.0) == pytest.approx(stress)
    for derivative in range(order + 1):
        moved = 3.0 * time ** (order - derivative) / [1.0, 1.0, 2.0, 6.0][order - derivative]
        settled = loop.error(time, moved, derivative)[-1]
        # Straight lines between the samples of a parabola miss by its curvature.
        assert settled == pytest.approx(stress, rel=1e-3)


@pytest.mark.parametrize(("order", "damping"), SHAPES)
def test_errors_under_a_sinusoid(order: int, damping: float) -> None:
    loop = AnalogLoop.for_bandwidth(order, 8.0, damping)
    time = np.linspace(0.0, 10.0, 40001)
    error = loop.error(time, 0.1 * np.sin(2.0 * np.pi * 2.0 * time))
    expected = float(loop.sinusoid_error(0.1, 2.0))
    assert np.abs(error[-5000:]).max() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("order", "bandwidth", "damping"), [(4, 8.0, 1.0), (2, 0.0, 1.0), (2, 8.0, 0.0)]
)
def test_loops_that_cannot_be_are_refused(order: int, bandwidth: float, damping: float) -> None:
    with pytest.raises(ValueError, match="no loop of"):
        AnalogLoop.for_bandwidth(order, bandwidth, damping)


# The discrete loop


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_fast_discrete_loop_is_an_analog_one(order: int) -> None:
    discrete = DiscreteLoop.design(order, 8.0, 1e-4, realised=False)
    damping = 1.414 / 2.0
    analog = AnalogLoop(discrete.gains.natural_frequency, {
        1: (1.0, 1.0), 2: (1.0, 2.0 * damping, 1.0), 3: (1.0, 2.4, 1.1, 1.0),
    }[order])  # fmt: skip
    frequency = np.array([0.3, 2.0, 15.0, 100.0])
    # T wn = 0.0015 to 0.003: the delay of half an integration.
    ratio = np.abs(discrete.error_response(frequency)) / analog.error_gain(frequency)
    assert_allclose(ratio, 1.0, atol=0.005)
    assert discrete.steady_error(1.0) == pytest.approx(analog.steady_error(1.0), rel=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("frequency", [0.7, 2.0, 11.0])
def test_the_discrete_response_is_what_a_loop_does(order: int, frequency: float) -> None:
    loop, amplitude = DiscreteLoop.design(order, 8.0, 0.02), 1e-4
    motion = circle(amplitude, frequency, 0.0, 20.0, 0.02, parts=40)
    expected = float(loop.sinusoid_error(amplitude, frequency))
    run = simulate_loop(loop.gains, 0.02, motion, np.inf)
    linear = loop.motion_error(motion.mean(axis=1))
    for error in (run.error[500:], run.discriminator[500:], linear[500:]):
        found = np.sqrt(2.0 * np.mean(error**2))  # 10 s hold whole periods
        assert found == pytest.approx(expected, rel=0.002)  # 40 parts of an integration, atan


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_discrete_loop_settles_on_its_stress(order: int) -> None:
    loop = DiscreteLoop.design(order, 5.0, 0.02)
    time = (np.arange(1500)[:, None] + (np.arange(20) + 0.5) / 20.0) * 0.02
    range_m = 1e-4 * time**order / [1.0, 1.0, 2.0, 6.0][order]
    settled = loop.motion_error(range_m.mean(axis=1))[-1]
    assert settled == pytest.approx(loop.steady_error(1e-4), rel=1e-6)


@pytest.mark.parametrize(("order", "bandwidth"), [(2, 8.0), (2, 3.0), (3, 8.0)])
def test_thermal_noise_of_a_loop_that_is_run(order: int, bandwidth: float) -> None:
    loop = DiscreteLoop.design(order, bandwidth, 0.02)
    assert loop.noise_bandwidth_hz == pytest.approx(bandwidth, rel=1e-6)
    run = simulate_loop(loop.gains, 0.02, np.zeros((200_000, 1)), 45.0, seed=3)
    # Correlated over 1 / (2 Bn T) integrations: 4 sigma is some 2 %.
    assert run.error.std() == pytest.approx(float(loop.thermal_noise(45.0)), rel=0.025)
    shown = float(loop.discriminator_noise(45.0))
    assert run.discriminator.std() == pytest.approx(shown, rel=0.01)
    assert run.kept == 200_000


@pytest.mark.parametrize("bandwidth", [3.0, 8.0])
def test_oscillator_noise_of_a_loop_that_is_run(bandwidth: float) -> None:
    clock = Oscillator(OscillatorConfig(bias=0.0, drift=0.0), 21)
    bias = clock(np.arange(4 * 150_000.0) * 0.005 + 0.0025).reshape(-1, 4)
    loop = DiscreteLoop.design(2, bandwidth, 0.02)
    run = simulate_loop(loop.gains, 0.02, bias * 299792458.0, np.inf)
    expected = loop.oscillator_noise()
    assert run.error[500:].std() == pytest.approx(expected, rel=0.05)
    analog = float(theory.allan_noise(bandwidth))
    assert expected > 1.2 * analog  # so much is lost by 20 ms


def test_oscillator_noise_of_a_fast_loop_is_the_closed_form() -> None:
    found = DiscreteLoop.design(2, 2.0, 1e-3).oscillator_noise()
    # wn T = 0.004 and the damping 1.414 / 2; 1.89 for 1 / 0.53
    assert found == pytest.approx(float(theory.allan_noise(2.0)), rel=0.02)
    assert DiscreteLoop.design(1, 2.0, 1e-3).oscillator_noise() == np.inf


@pytest.mark.parametrize(
    ("radius", "frequency", "bandwidth", "rms", "greatest"),
    [  # T tables 5.3 and 5.4
        (0.5, 1.0, 15.0, 28.96, 47.90),
        (0.5, 1.0, 8.0, 46.31, 89.96),
        (0.12, 2.0, 15.0, 26.39, 44.46),
        (0.12, 2.0, 8.0, 51.73, 89.90),
    ],
)
def test_the_thesis_conventional_loops(
    radius: float, frequency: float, bandwidth: float, rms: float, greatest: float
) -> None:
    loop = DiscreteLoop.design(2, bandwidth, 0.02, realised=False)
    motion = circle(radius, frequency, np.radians(26.0), 102.0, 0.02)
    run = simulate_loop(loop.gains, 0.02, motion, 45.0, seed=1)
    # The acceptance table's 15 %: elevation, C/N0 and the loop's details are not in print.
    assert np.degrees(run.rms(100)) == pytest.approx(rms, rel=0.15)
    assert np.degrees(run.greatest(100)) == pytest.approx(greatest, rel=0.15)
    assert (run.kept < 100) == (bandwidth == 8.0)
    assert (run.kept == run.error.size) == (bandwidth == 15.0)


def test_unstable_loops_and_bad_ranges() -> None:
    unstable = DiscreteLoop.design(2, 25.0, 0.02, realised=False)
    assert unstable.sinusoid_error(0.1, 1.0) == np.inf
    assert unstable.oscillator_noise() == np.inf
    with pytest.raises(ValueError, match="no order-2 loop has"):
        DiscreteLoop.design(2, 5000.0, 0.02)
    with pytest.raises(ValueError, match="are needed"):
        simulate_loop(unstable.gains, 0.02, np.zeros(5), 45.0)


def test_really_15_hz_lose_lock_on_the_thesis_circles() -> None:
    loop = DiscreteLoop.design(2, 15.0, 0.02)
    run = simulate_loop(loop.gains, 0.02, circle(0.5, 1.0, 0.45, 20.0, 0.02), 45.0)
    assert np.degrees(loop.sinusoid_error(0.5, 1.0, 0.45)) > 90.0
    assert run.kept < 100


# Errors of the IMU


def imu(
    grade: ImuGrade, velocity: float = 0.0, pitch: float = 0.0, heading: float = 0.0
) -> ImuErrorTheory:
    loop = AnalogLoop.for_bandwidth(2, 15.0, 1.0)
    navigation = NavigationErrors(velocity, pitch, heading)
    return ImuErrorTheory(loop, grade, navigation, Strain(2.0 * G, 2.0 * G))


def test_each_constant_alone_settles_or_peaks_where_it_should() -> None:
    time = np.linspace(0.0, 2.0, 2001)
    grade = ImuGrade(accel_bias=1e-2, accel_scale_ppm=300.0, gyro_bias_deg_per_h=3600.0)
    found = imu(grade, 0.01, np.radians(0.015), np.radians(0.15)).constants(time)
    per_acceleration = PHASE_PER_METRE / 24.0**2
    gyro = np.radians(1.0)
    steady = {
        "accelerometer bias": 1e-2,
        "accelerometer scale": 300e-6 * 2.0 * G,
        "initial pitch": G * np.radians(0.015),
        "initial heading": 2.0 * G * np.radians(0.15),
        # A ramp of acceleration: 2 zeta / wn late.
        "gyro bias, east axis": -G * gyro * (2.0 - 2.0 / 24.0),
        "gyro bias, down axis": -2.0 * G * gyro * (2.0 - 2.0 / 24.0),
        "gyro scale": 0.0,
        "initial velocity": 0.0,
    }
    for name, value in steady.items():
        assert_allclose(found[name][-1], -per_acceleration * value, rtol=1e-5, atol=1e-12)
    peak = np.abs(found["initial velocity"]).max()
    assert peak == pytest.approx(float(theory.velocity_step_peak(24.0, 0.01)), rel=1e-3)


def test_accelerometer_noise_settles_on_its_closed_form() -> None:
    grade = ImuGrade(accel_walk_per_sqrt_h=0.06)
    time = np.linspace(0.0, 1.0, 4001)
    found = imu(grade).noises(time)["accelerometer noise"][-1]
    # White acceleration q into 1 / (s^2 + 2 z wn s + wn^2): q / (4 z wn^3).
    expected = PHASE_PER_METRE * 0.001 / np.sqrt(4.0 * 24.0**3)
    assert found == pytest.approx(expected, rel=1e-3)


def test_gauss_markov_wander_and_gyro_noise_by_monte_carlo() -> None:
    rng, step, runs = np.random.default_rng(5), 1e-3, 2000
    grade = ImuGrade(
        accel_instability=0.01, accel_correlation_time=0.5, gyro_walk_deg_per_sqrt_h=3.0
    )
    theory_of = imu(grade)
    found = theory_of.noises(np.linspace(0.0, 1.0, 1001))
    loop = theory_of.loop
    white = rng.standard_normal((runs, 1001))
    wander = lfilter([1.0], [1.0, -np.exp(-step / 0.5)], white, axis=1)
    wander *= 0.01 * np.sqrt(1.0 - np.exp(-2.0 * step / 0.5))
    leverage = np.hypot(G, 2.0 * G)
    tilt = np.cumsum(rng.standard_normal((runs, 1001)), axis=1)
    tilt *= np.radians(3.0) / 60.0 * np.sqrt(step) * leverage
    triangle = np.eye(1, 1002, 1)[0]
    h = loop.error(step * np.arange(1002.0), triangle, 2)[1:]
    for name, drive in (("accelerometer wander", wander), ("gyro noise", tilt)):
        at_end = drive @ h[::-1]
        # 4 sigma of 2000 draws: 4 / sqrt(4000)
        assert at_end.std() == pytest.approx(found[name][-1], rel=0.065)


def test_a_steady_force_is_a_special_case_of_motion() -> None:
    time = np.linspace(0.0, 1.0, 1001)
    theory_of = imu(grade_named("mti-g"), 0.02, 0.001, 0.005)
    constant = theory_of.constants(time)
    force = np.full(time.size, 2.0 * G)
    for name, curve in theory_of.under_motion(time, force, force, np.full(time.size, -G)).items():
        assert_allclose(curve, constant[name], rtol=1e-6, atol=1e-9)


def test_thesis_figure_3_9_is_the_initial_velocity_s() -> None:
    time = np.linspace(0.0, 1.0, 1001)
    fsas = imu(calibrated(grade_named("span-fsas")), 0.01, np.radians(0.015), np.radians(0.15))
    constants, noises = fsas.constants(time), fsas.noises(time)
    peak = np.abs(constants["initial velocity"]).max()
    assert fsas.total(time).max() == pytest.approx(peak, rel=0.05)
    assert max(curve.max() for curve in noises.values()) < 0.02 * peak
    assert np.degrees(peak) == pytest.approx(0.29, abs=0.005)


def test_late_aiding() -> None:
    loop = AnalogLoop.for_bandwidth(2, 8.0)
    # Aiding that is a millisecond late leaves 2 pi f t0 of what the loop alone would leave.
    found = delay_error(loop, np.array([0.5]), 1e-3)[0]
    expected = 2.0 * np.pi * 0.5e-3 * float(loop.error_gain(0.5))
    assert found == pytest.approx(expected, rel=1e-5)


def test_a_better_imu_leaves_less() -> None:
    loop = AnalogLoop.for_bandwidth(3, 3.0)
    errors = [
        free_inertial_error(loop, grade_named(name), 1.0)
        for name in ("perfect", "navigation", "high-g", "stim300", "mti-g")
    ]
    assert errors[0] == 0.0
    assert np.all(np.diff(errors) > 0.0)


# Limits


def conventional(bandwidth: float, cn0: float) -> float:
    stress = theory.dynamic_stress(3, bandwidth, 10.0 * G)
    return float(
        theory.conventional_total(theory.thermal_noise(bandwidth, cn0, 1e-3), 0, 0, stress)
    )


def test_best_bandwidth_of_the_doppler_aided_paper_s_formulas() -> None:
    bandwidth, error = best_bandwidth(lambda b: conventional(b, 35.0))
    assert bandwidth == pytest.approx(31.0, abs=0.5)
    assert np.degrees(error) == pytest.approx(7.1, abs=0.05)
    assert np.degrees(conventional(25.0, 35.0)) == pytest.approx(7.4, abs=0.05)
    thermal = np.degrees(theory.thermal_noise(3.0, 35.0, 1e-3))
    assert thermal == pytest.approx(1.9, abs=0.05)


def test_sensitivities_of_its_table_1() -> None:
    aided = sensitivity(lambda c: float(theory.thermal_noise(3.0, c, 1e-3)))
    alone = sensitivity(lambda c: conventional(25.0, c))
    assert aided == pytest.approx(22.3, abs=0.05)
    assert alone == pytest.approx(28.8, abs=0.15)
    assert sensitivity(lambda c: 1.0) == np.inf
    assert least_bandwidth(lambda b: 1.0) == np.inf
    found = least_bandwidth(lambda b: conventional(b, 35.0))
    assert conventional(found, 35.0) == pytest.approx(theory.THRESHOLD, rel=1e-5)


def test_jamming_of_its_table_1() -> None:
    found = jammer_to_signal_db([22.3, 28.8], 41.0)
    assert_allclose(found, [37.74, 31.03], atol=0.05)
    assert_allclose(jammer_range(found) / 1e3, [621.61, 1345.91], rtol=0.001)  # 0.01 dB
    assert_allclose(jammed_cn0_dbhz(found, 41.0), [22.3, 28.8])
    wide = jammer_to_signal_db(25.0, 41.0, factor=2.0) - jammer_to_signal_db(25.0, 41.0)
    assert wide == pytest.approx(10.0 * np.log10(2.0))
