from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import allantools  # type: ignore[import-untyped]
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import bilinear, lfilter

from deepseis_core.constants import L1_HZ
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.types import FloatArray
from deepseis_sim import oscillator
from deepseis_sim.motion import Kinematics
from deepseis_sim.oscillator import OSCILLATORS, Oscillator, OscillatorConfig

G = STANDARD_GRAVITY
QUIET = OscillatorConfig(kind="perfect", bias=0.0, drift=0.0)
NOISY = OscillatorConfig(bias=0.0, drift=0.0)


@dataclass
class Circle:
    """Still, then a level circle with a fixed heading, in body axes turned by ``heading``."""

    radius: float = 0.5
    frequency_hz: float = 1.0
    heading: float = 0.0
    rotates: bool = False
    span: tuple[float, float] = (0.0, 100.0)

    def at(self, time: FloatArray) -> Kinematics:
        w, r = 2.0 * np.pi * self.frequency_hz, self.radius * (time[:, None] >= 0.0)
        phase = w * time[:, None]
        c, s, zero = np.cos(phase), np.sin(phase), 0.0 * phase
        cosine, sine = np.cos(self.heading), np.sin(self.heading)
        return Kinematics(
            np.hstack([r * (1.0 - c), r * s, zero]),
            np.hstack([r * w * s, r * w * (c - 1.0), zero]),
            np.hstack([r * w**2 * c, -r * w**2 * s, zero]),
            np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]),
        )


@dataclass
class Rocking:
    """Tilts forward and back about the left axis and heaves."""

    rotates: bool = True
    span: tuple[float, float] = (0.0, 100.0)

    def at(self, time: FloatArray) -> Kinematics:
        moving = time >= 0.0
        w = 2.0 * np.pi * 0.7
        tilt = 0.2 * np.sin(w * time) ** 3 * moving
        heave = 3.0 * np.sin(2.0 * w * time) ** 3 * moving
        C = np.zeros((time.size, 3, 3))
        C[:, 0, 0] = C[:, 2, 2] = np.cos(tilt)
        C[:, 0, 2], C[:, 2, 0], C[:, 1, 1] = np.sin(tilt), -np.sin(tilt), 1.0
        zero = np.zeros((time.size, 3))
        return Kinematics(zero, zero, np.outer(heave, [0.0, 0.0, 1.0]), C, zero)


@pytest.mark.parametrize("kind", ["ocxo", "tcxo", "rubidium"])
def test_allan_deviation_is_that_of_the_power_law(kind: str) -> None:
    clock = Oscillator(replace(NOISY, kind=kind), 3)
    phase = clock(0.01 * np.arange(1e6))
    tau, measured, _, _ = allantools.oadev(
        phase, rate=100.0, data_type="phase", taus=[0.01, 0.1, 1.0, 10.0, 100.0]
    )
    # 10000 s: one sigma is some 1 / sqrt(2 x 10000 / tau), 7 % at 100 s.
    ratio = measured / OSCILLATORS[kind].allan_deviation(tau)
    assert np.all(np.abs(ratio - 1.0) < [0.01, 0.01, 0.03, 0.1, 0.25]), ratio


@pytest.mark.parametrize(
    ("name", "level", "tau", "expected"),
    [
        ("h_0", 2e-20, 4.0, np.sqrt(2e-20 / 8.0)),
        ("h_minus_1", 1e-20, 4.0, np.sqrt(1e-20 * 2.0 * np.log(2.0))),
        ("h_minus_2", 3e-20, 4.0, np.sqrt(3e-20 * 4.0 * 2.0 * np.pi**2 / 3.0)),
    ],
)
def test_each_noise_alone(name: str, level: float, tau: float, expected: float) -> None:
    value: dict[str, Any] = {name: level}
    clock = Oscillator(replace(NOISY, kind="custom", **value), 5)
    phase = clock(0.1 * np.arange(1e5))
    _, measured, _, _ = allantools.oadev(phase, rate=10.0, data_type="phase", taus=[tau])
    assert measured[0] == pytest.approx(expected, rel=0.06)


def test_allan_deviation_over_many_oscillators_and_minutes() -> None:
    tau = 200.0
    seen = [np.diff(Oscillator(NOISY, seed)(tau * np.arange(3.0)), 2) for seed in range(60)]
    measured = np.sqrt(np.mean(np.square(seen)) / 2.0) / tau
    expected = OSCILLATORS["ocxo"].allan_deviation(np.array(tau))
    assert measured == pytest.approx(float(expected), rel=3.0 / np.sqrt(120.0))


def test_a_loop_sees_twice_the_printed_variance() -> None:
    # Thesis 3.4 as printed has 2 pi^2 f1^2; a one-sided S_y gives 4 pi^2 f1^2 (order 2, zeta
    # 0.707, wL = 1.89 Bn). The loop is run, in baseband, over an hour of the oscillator.
    clock, rate_hz = Oscillator(NOISY, 21), 100.0
    cycles = L1_HZ * clock(np.arange(3.6e5) / rate_hz)
    wl, law = 1.89 * 1.5, OSCILLATORS["ocxo"]
    b, a = bilinear([1.0, 0.0, 0.0], [1.0, np.sqrt(2.0) * wl, wl**2], rate_hz)
    error = 2.0 * np.pi * lfilter(b, a, cycles)[2000:]
    parts = (
        np.pi**2 * law.h_minus_2 / (np.sqrt(2.0) * wl**3)
        + np.pi * law.h_minus_1 / (4.0 * wl**2)
        + law.h_0 / (4.0 * np.sqrt(2.0) * wl)
    )
    assert error.std() == pytest.approx(2.0 * np.pi * L1_HZ * np.sqrt(parts), rel=0.05)


def test_bias_and_drift_are_those_asked_for() -> None:
    clock = Oscillator(replace(QUIET, bias=1e-3, drift=-2e-7), 1)
    time = np.array([-5.0, 0.0, 7.0, 3600.0])
    np.testing.assert_allclose(clock(time), 1e-3 - 2e-7 * time, rtol=0, atol=1e-18)
    assert Oscillator(OscillatorConfig(), 9)(np.zeros(1))[0] == OscillatorConfig().bias


@pytest.mark.parametrize("motion", [None, Circle(), Rocking()])
def test_neither_order_nor_chunks_matter(motion: Any) -> None:
    config = OscillatorConfig(on_table=True, g_sensitivity=(1e-9, 2e-9, -1e-9))
    time = np.random.default_rng(1).permutation(np.linspace(-5.0, 60.0, 3001))
    whole = Oscillator(config, 4, motion)(time)
    clock = Oscillator(config, 4, motion)
    np.testing.assert_array_equal(
        np.concatenate([clock(t) for t in np.split(time, [5, 2000])]), whole
    )
    np.testing.assert_array_equal(clock(time[::-1])[::-1], whole)


def test_the_rate_has_no_jumps() -> None:
    clock = Oscillator(replace(NOISY, kind="tcxo"), 2)
    node = 0.01 * np.arange(1, 2000.0)
    h = 1e-5
    before, at, after = (clock(node + k * h) for k in (-1.0, 0.0, 1.0))
    jump = np.abs((after - at) - (at - before)).max() / h
    rate = np.abs(np.diff(clock(node))).max() / 0.01
    assert jump < 0.01 * rate  # h / cell of the rate's own change


@pytest.mark.parametrize(
    ("kind", "motion"),
    [("tcxo", Circle()), ("ocxo", Circle(0.12, 2.0)), ("ocxo", Rocking())],
)
def test_cubics_of_the_synthesis_follow_the_clock(kind: str, motion: Any) -> None:
    # As deepseis_sim.signal_model lays the carrier out: 10 ms, nodes at 0, 1/4, 3/4 and 1.
    config = OscillatorConfig(kind=kind, on_table=True, g_sensitivity=(2e-9, 2e-9, 2e-9))
    clock = Oscillator(config, 6, motion)
    nodes, between = np.array([0.0, 0.25, 0.75, 1.0]), np.linspace(0.0, 1.0, 21)
    weights = np.vander(between, 4) @ np.linalg.inv(np.vander(nodes, 4))
    begin = 0.01 * np.arange(3000.0, 3300.0)[:, None]
    exact = clock((begin + 0.01 * between).ravel()).reshape(-1, 21)
    known = clock((begin + 0.01 * nodes).ravel()).reshape(-1, 4)
    error = (known - known[:, :1]) @ weights.T - (exact - known[:, :1])
    assert np.abs(error).max() * L1_HZ < 1e-5  # cycles


def test_two_g_at_one_hertz_swing_the_phase_by_181_degrees() -> None:
    config = replace(QUIET, on_table=True, g_sensitivity=(0.0, 1e-9, 0.0))
    time = np.linspace(0.0, 1.0, 1001)
    swing = 360.0 * L1_HZ * Oscillator(config, 1, Circle())(time)
    # Left (north) velocity w r (cos - 1): amplitude 1e-9 w r / g, 0.5 m at 1 Hz being 2.01 g.
    assert np.ptp(swing) / 2.0 == pytest.approx(181.7, abs=0.1)
    closed_form = 360.0 * L1_HZ * 1e-9 * 2.0 / (2.0 * np.pi * 1.0)
    assert closed_form == pytest.approx(180.5, abs=0.05)
    np.testing.assert_allclose(
        swing, 360.0 * L1_HZ * 1e-9 / G * Circle().at(time).velocity[:, 1], atol=1e-9
    )


def test_sensitivity_is_in_body_axes() -> None:
    config = replace(QUIET, on_table=True, g_sensitivity=(1e-9, 0.0, 0.0))
    time = np.linspace(0.0, 1.0, 101)
    north = Oscillator(config, 1, Circle(heading=np.pi / 2.0))(time)
    np.testing.assert_allclose(
        north, 1e-9 / G * Circle().at(time).velocity[:, 1], rtol=0, atol=1e-24
    )


def test_turning_and_level_bodies_agree_where_both_hold() -> None:
    config = replace(QUIET, on_table=True, g_sensitivity=(1e-9, -2e-9, 1e-9))
    time = np.sort(np.random.default_rng(1).uniform(0.0, 30.0, 2000))
    level = Oscillator(config, 1, Circle(0.12, 2.0))(time)
    turning = Oscillator(config, 1, Circle(0.12, 2.0, rotates=True))(time)
    assert np.abs(level - turning).max() * L1_HZ < 1e-6


def test_a_tilting_oscillator_feels_gravity_turn() -> None:
    gamma = np.array([1e-9, 0.0, -3e-9])
    config = replace(QUIET, on_table=True, g_sensitivity=tuple(gamma))
    clock, motion = Oscillator(config, 1, Rocking()), Rocking()

    def rate(t: float) -> float:
        state = motion.at(np.array([t]))
        force = state.C_enu_b[0].T @ (state.acceleration[0] + [0.0, 0.0, G])
        return float(gamma @ (force - [0.0, 0.0, G]) / G)

    for t in (0.3, 1.234, 11.3):
        expected = quad(rate, 0.0, t, limit=500, epsabs=1e-18, epsrel=1e-10)[0]
        assert clock(np.array([t]))[0] == pytest.approx(expected, abs=1e-6 / L1_HZ)


@pytest.mark.parametrize("on_table", [False, True])
def test_beside_the_table_or_without_motion_nothing_is_felt(on_table: bool) -> None:
    config = replace(QUIET, on_table=on_table, g_sensitivity=(1e-9, 1e-9, 1e-9))
    clock = Oscillator(config, 1, None if on_table else Circle())
    np.testing.assert_array_equal(clock(np.linspace(0.0, 5.0, 50)), 0.0)


def test_hours_need_little_memory_and_time() -> None:
    clock = Oscillator(OscillatorConfig(on_table=True, g_sensitivity=(1e-9, 0, 0)), 1, Rocking())
    start = perf_counter()
    clock(np.array([3600.0]))
    assert perf_counter() - start < 5.0
    kept = sum(state.nbytes for state in clock._noise._states)
    kept += sum(block.nbytes for block in clock._noise._recent.values())
    assert kept < 200_000


@pytest.mark.parametrize("time", [-oscillator.STEP * oscillator.LEAD, 2e6, np.nan, np.inf])
def test_times_out_of_reach_are_refused(time: float) -> None:
    with pytest.raises(InputError, match="it runs from"):
        Oscillator(OscillatorConfig(), 1)(np.array([0.0, time]))
    assert Oscillator(OscillatorConfig(), 1)(np.zeros(0)).shape == (0,)


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InputError, match="kind = 'quartz' is not one of"):
        Oscillator(OscillatorConfig(kind="quartz"), 1)
    with pytest.raises(InputError, match="g_sensitivity has 2 values"):
        Oscillator(OscillatorConfig(g_sensitivity=(1e-9, 0.0)), 1)
    with pytest.raises(InputError, match="h_0 = -1"):
        Oscillator(OscillatorConfig(kind="custom", h_0=-1.0), 1)
    with pytest.raises(InputError, match="not a finite number"):
        Oscillator(OscillatorConfig(drift=np.nan), 1)
