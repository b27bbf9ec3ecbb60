"""Hatch filter: what theory says of noise, slips, ionosphere; the same however it is cut."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_core import hatch
from deepseis_core.constants import L1_HZ, L1_WAVELENGTH
from deepseis_core.errors import InputError
from deepseis_core.hatch import HatchConfig, HatchFilter, smooth
from deepseis_core.types import Lli, Observations


def arcs(epochs, satellites, seed=1, noise=0.3):
    """Return code, phase and ranges of satellites that move as satellites do."""
    rng = np.random.default_rng(seed)
    t = np.arange(epochs)[:, None]
    ranges = 2.2e7 + 500.0 * rng.standard_normal(satellites) * t + 0.05 * t**2
    code = ranges + noise * rng.standard_normal((epochs, satellites))
    return code, ranges + 77.0 * rng.standard_normal(satellites), ranges


def none(code):
    return np.zeros(code.shape, bool)


def plain(code, phase, window):
    """Return equation 24 of the paper, literally."""
    s, out = code[0], [code[0]]
    for k in range(1, len(code)):
        M = min(k + 1, window)
        s = code[k] / M + (M - 1) / M * (s + phase[k] - phase[k - 1])
        out.append(s)
    return np.array(out)


@pytest.mark.parametrize("window", [20, 100])
def test_it_is_the_papers_equation(window):
    code, phase, _ = arcs(300, 3)
    got = smooth(code, phase, none(code), HatchConfig(window=window))
    # Rounding of 2e7 m, 4e-9, in some hundred steps.
    assert_allclose(got.pseudorange, plain(code, phase, window), rtol=0, atol=1e-6)
    assert_array_equal(got.count[:, 0], np.minimum(np.arange(300) + 1, window))


def test_noise_left_is_what_theory_says():
    """1/M on the ramp and 1/(2 M - 1) after it; 4000 satellites give 2.2 % of a variance."""
    code, phase, ranges = arcs(300, 4000)
    got = smooth(code, phase, none(code), HatchConfig(window=50))
    error = got.pseudorange - ranges
    assert_allclose(got.variance_factor[[0, 9, 49], 0], [1.0, 0.1, 0.02], rtol=1e-9)
    assert_allclose(got.variance_factor[-1, 0], 1.0 / 99.0, rtol=1e-3)
    for k in (0, 9, 49, 299):
        expected = 0.3**2 * got.variance_factor[k, 0]
        assert np.mean(error[k] ** 2) == pytest.approx(expected, rel=4 * np.sqrt(2 / 4000))


def test_the_error_left_is_slow():
    """Neighbours correlate by (M - 1) / M: behind this filter no range is white."""
    code, phase, ranges = arcs(400, 2000)
    error = (smooth(code, phase, none(code), HatchConfig(window=20)).pseudorange - ranges)[200:]
    correlation = np.mean(error[:-1] * error[1:]) / np.mean(error**2)
    assert correlation == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("slip", [3.5, -3.5, 1000.0])
def test_a_slip_of_the_phase_begins_a_new_arc(slip):
    code, phase, ranges = arcs(200, 2)
    phase[120:, 0] += slip
    got = smooth(code, phase, none(code))
    # 3.5 m less 0.3 sqrt(2) m of noise, four sigma: one in 10^4 misses.
    assert got.slipped[120, 0]
    assert got.slipped.sum() == 1
    assert got.count[120].tolist() == [1, 100]
    assert got.pseudorange[120, 0] == code[120, 0]
    assert np.abs(got.pseudorange - ranges).max() < 6 * 0.3


def test_marks_of_the_receiver_and_gaps_begin_a_new_arc():
    code, phase, _ = arcs(60, 3)
    lost = none(code)
    lost[20, 0] = True
    code[30, 1] = np.nan
    phase[40, 2] = np.nan
    got = smooth(code, phase, lost)
    assert got.count[20].tolist() == [1, 21, 21]
    assert got.count[30].tolist() == [11, 0, 31]
    assert np.isnan(got.pseudorange[30, 1])
    assert got.count[[31, 40, 41]].tolist() == [[12, 1, 32], [21, 10, 1], [22, 11, 1]]
    assert got.pseudorange[40, 2] == code[40, 2]
    assert not got.slipped.any()


def test_noise_is_not_taken_for_slips_where_its_size_is_known():
    """Code noise of 1.5 m: 3 m is 1.4 sigma of the difference, 16 % of epochs."""
    code, phase, _ = arcs(1000, 10, noise=1.5)
    blind = smooth(code, phase, none(code)).slipped.mean()
    assert blind == pytest.approx(0.157, abs=0.02)
    assert not smooth(code, phase, none(code), pseudorange_sd=1.5).slipped.any()


def test_the_ionosphere_makes_it_lag_unless_it_is_given():
    """2 mm/s: code late, phase early. A window of M lags by 2 (M - 1) times that."""
    code, phase, _ = arcs(2000, 1, noise=0.0)
    delay = 5.0 + 0.002 * np.arange(2000)[:, None]
    code, phase = code + delay, phase - delay
    lag = smooth(code, phase, none(code)).pseudorange - code
    assert lag[-1, 0] == pytest.approx(-2 * 99 * 0.002, rel=1e-3)
    free = smooth(code, phase, none(code), ionosphere=delay).pseudorange - code
    assert_allclose(free, 0.0, atol=1e-6)


def test_two_phases_tell_the_ionosphere_but_for_a_constant():
    delay, ranges = np.array([3.0, 4.0, 6.0]), np.array([2.1e7, 2.2e7, 2.3e7])
    ratio = (L1_HZ / hatch.L2_HZ) ** 2
    l1 = (ranges - delay) / L1_WAVELENGTH + 12.0
    l2 = (ranges - ratio * delay) / (L1_WAVELENGTH * L1_HZ / hatch.L2_HZ) - 5.0
    assert_allclose(np.diff(hatch.ionosphere_from_phases(l1, l2)), [1.0, 2.0], atol=1e-6)


def test_any_cut_of_the_epochs_gives_the_same_bytes():
    code, phase, _ = arcs(200, 4)
    phase[77:, 1] += 10.0
    whole = smooth(code, phase, none(code))
    state, parts = hatch.new_state(4), []
    for first, last in ((0, 1), (1, 78), (78, 78), (78, 200)):
        part = slice(first, last)
        parts.append(smooth(code[part], phase[part], none(code)[part], state=state).pseudorange)
    assert_array_equal(np.vstack(parts), whole.pseudorange)


def epoch(code, phase, names, lli=0):
    """Return an epoch of observations; what is not used here is zero."""
    n, zero = len(names), np.zeros(len(names), np.float32)
    return Observations(
        0, 0.0, 2399, 0, 0, 1.0, names, code, phase / L1_WAVELENGTH, np.zeros(n), zero,
        np.full(n, lli, np.uint8), zero, zero, zero, zero, zero, np.zeros(n, np.uint16),
    )  # fmt: skip


def test_observations_as_they_come_are_the_same_whatever_their_order():
    code, phase, _ = arcs(50, 3)
    whole, one, names = smooth(code, phase, none(code)), HatchFilter(), ("G01", "G02", "G03")
    for k in range(50):
        order = np.roll(np.arange(3), k)
        got = one.smooth(epoch(code[k][order], phase[k][order], tuple(names[i] for i in order)))
        # Metres to cycles and back.
        assert_allclose(got.pseudorange, whole.pseudorange[k][order], rtol=0, atol=1e-6)
    assert one.smooth(epoch(code[9], phase[9], names, Lli.SLIP)).count.tolist() == [1, 1, 1]


def test_a_satellite_that_was_away_begins_anew():
    code, phase, _ = arcs(3, 2)
    one = HatchFilter()
    one.smooth(epoch(code[0], phase[0], ("G01", "G02")))
    one.smooth(epoch(code[1][:1], phase[1][:1], ("G01",)))
    assert one.smooth(epoch(code[2], phase[2], ("G01", "G02"))).count.tolist() == [3, 1]


def test_bad_input_is_refused():
    code, phase, _ = arcs(3, 2)
    with pytest.raises(InputError, match="window"):
        smooth(code, phase, none(code), HatchConfig(window=0))
    with pytest.raises(InputError, match="shapes"):
        smooth(code, phase[:2], none(code))
    with pytest.raises(InputError, match="state"):
        smooth(code, phase, none(code), state=hatch.new_state(3))
