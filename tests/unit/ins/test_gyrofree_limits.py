"""The limit from spectra against smoothers' covariances and against simulated processes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import welch

from deepseis_core.imu_grades import grade_named
from deepseis_core.noise_processes import GaussMarkovNoise
from deepseis_ins import gyrofree_limits as limits
from deepseis_ins.gyrofree import GyroFreeConfig, GyroFreeFilter
from deepseis_ins.smoother import smooth

GRADE = grade_named("accelerometers")
CASES = [(0.0047, 0.0057, 300.0), (0.0107, 0.0150, 300.0), (0.005, 0.02, 20.0), (0.01, 0.0, 300.0)]


@pytest.mark.parametrize(
    ("white", "drift", "time", "rate_hz"), [*((*case, 1) for case in CASES), (*CASES[2], 50)]
)
def test_the_smoother_reaches_the_limit_and_no_more(white, drift, time, rate_hz):
    """Covariance in the middle of a long record, with the displacement free at the start.

    The record ends: what of 1500 s about the middle is not seen, of a drift of 300 s, is some per
    mille.
    """
    config = GyroFreeConfig(
        drift_sd=(max(drift, 1e-9),) * 3, drift_correlation_time=(time,) * 3, position_sd=100.0
    )
    filter_ = GyroFreeFilter(config, GRADE, np.eye(3), latitude=0.6, smoothing=True)
    steps, at_rest = [], np.array([[0.0, 0.0, 9.7963 / rate_hz]])
    for _ in range(round(min(3000, 10 * time)) * rate_hz):
        filter_.propagate(at_rest, 1.0 / rate_hz)
        filter_.update_position(np.zeros(3), white**2 * np.eye(3))
        steps += filter_.take_steps()
    middle = np.sqrt(smooth(steps).P[len(steps) // 2, 0, 0])
    expected = limits.best_sd(limits.GnssErrors(white, drift, time, float(rate_hz)), GRADE)
    assert middle == pytest.approx(expected, rel=5e-3)


def test_the_density_of_the_drift_is_that_of_the_simulated_process():
    gnss = limits.GnssErrors(0.0, 0.01, 30.0, 1.0)
    made = GaussMarkovNoise(3, 71, [0.01], [30.0], 1.0)(0, 2**18)[:, 0]
    f, density = welch(made, 1.0, nperseg=2**12)
    some = slice(1, 2**11)
    # 127 averages: 9 % each; a mean of 20 bins 2 %.
    ratio = (density[some] / gnss.drift_density(f[some]))[:2040].reshape(-1, 20).mean(axis=1)
    assert_allclose(ratio, 1.0, atol=0.12)
    assert ratio.mean() == pytest.approx(1.0, abs=0.01)
    f = np.geomspace(1e-8, 0.5, 20_000)
    assert np.sqrt(np.trapezoid(gnss.density(f), f)) == pytest.approx(0.01, rel=1e-3)


def test_below_the_crossing_accelerometers_are_worse_than_the_drift():
    gnss = limits.GnssErrors(0.0047, 0.0057, 300.0, 1.0)
    crossing = limits.crossing_hz(gnss, GRADE)
    for f, worse in ((0.5 * crossing, True), (2.0 * crossing, False)):
        at = np.array([f])
        position = limits.accelerometer_density(at, GRADE)[0]
        assert bool(position > gnss.drift_density(at)[0]) is worse


def test_what_regrows_is_what_the_process_forgets():
    drawn = GaussMarkovNoise(5, 71, np.ones(4000), np.full(4000, 300.0), 1.0)(0, 121)
    left = drawn - drawn[0] * np.exp(-np.arange(121) / 300.0)[:, None]
    measured = np.sqrt(np.mean(left[1:] ** 2))
    assert measured == pytest.approx(limits.regrown_rms(1.0, 300.0, 120.0), rel=0.02)
