"""The design spectrum of GB 50011-2010 against worked examples and the code's other tables."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.errors import InputError
from deepseis_sim.design_spectrum import (
    INTENSITIES,
    LEVELS,
    SITE_CLASSES,
    STANDARD_GRAVITY,
    DesignSpectrum,
    characteristic_period,
    maximum_coefficient,
)


def test_published_worked_examples_are_reproduced():
    # intensity 7 frequent height, site II group 1 with the rare shift: Tg = 0.40 s; printed to 7
    # digits by the HiHand structural toolbox
    spectrum = DesignSpectrum(0.08, characteristic_period("II", 1, "rare"))
    assert_allclose(spectrum.coefficient(0.88), 0.0393468, rtol=0, atol=5e-8)
    # licensing examination: 7 (0.10 g) frequent, site II group 1, T = 1.4 s, damping 0.08: 0.02
    damped = DesignSpectrum(maximum_coefficient("7"), characteristic_period("II", 1), 0.08)
    assert_allclose(damped.coefficient(1.4), 0.02, rtol=0, atol=5e-3)


def test_the_ground_itself_peaks_where_the_codes_table_of_record_peaks_says():
    # table 5.1.2-2 [cm/s^2], rounded to 5 or 10: up to 4 % from 0.45 alpha_max g
    table = {"frequent": (18, 35, 55, 70, 110, 140), "rare": (125, 220, 310, 400, 510, 620)}
    for level in LEVELS:
        peaks = [
            DesignSpectrum(maximum_coefficient(name, level), 0.4).acceleration(0.0)
            for name in INTENSITIES
        ]
        assert_allclose(100.0 * np.array(peaks), table[level], rtol=0.04)


def test_characteristic_periods_grow_with_softness_and_distance():
    table = np.array([[characteristic_period(s, g) for s in SITE_CLASSES] for g in (1, 2, 3)])
    assert np.all(np.diff(table, axis=0) > 0)
    assert np.all(np.diff(table, axis=1) > 0)
    assert table[0, 0] == 0.20
    assert table[2, 4] == 0.90
    assert characteristic_period("III", 2, "rare") == 0.60


def test_five_percent_damping_gives_the_plain_curve():
    spectrum = DesignSpectrum(0.16, 0.35)
    figures = (spectrum.decay_exponent, spectrum.slope_factor, spectrum.damping_factor)
    assert_allclose(figures, (0.9, 0.02, 1.0), rtol=1e-15)
    # clause 5.1.5: 0.45, 0.45 + 5.5 T, plateau, curve, straight line of slope 0.02
    T = [0.0, 0.05, 0.1, 0.35, 0.7, 1.75, 2.75]
    shape = [0.45, 0.725, 1.0, 1.0, 0.5**0.9, 0.2**0.9, 0.2**0.9 - 0.02]
    assert_allclose(spectrum.coefficient(T), 0.16 * np.array(shape), rtol=1e-14)


@pytest.mark.parametrize("damping", [0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5])
def test_the_pieces_join(damping):
    spectrum = DesignSpectrum(1.0, 0.45, damping)
    for joint in (0.1, 0.45, 2.25):
        below, above = spectrum.coefficient([joint - 1e-9, joint + 1e-9])
        assert abs(above - below) < 1e-7  # slope below 10 per second


def test_heavy_damping_stops_at_the_codes_limits():
    heavy = DesignSpectrum(1.0, 0.35, 0.45)
    assert heavy.slope_factor == 0.0
    assert heavy.damping_factor == 0.55


def test_accelerations_are_coefficients_times_gravity():
    spectrum = DesignSpectrum(0.9, 0.4)
    T = np.linspace(0.0, 6.0, 50)
    assert_allclose(spectrum.acceleration(T), STANDARD_GRAVITY * spectrum.coefficient(T))


@pytest.mark.parametrize(
    "attempt",
    [
        lambda: maximum_coefficient("10"),
        lambda: maximum_coefficient("8", "often"),
        lambda: characteristic_period("V", 1),
        lambda: characteristic_period("II", 0),
        lambda: DesignSpectrum(0.0, 0.4),
        lambda: DesignSpectrum(float("nan"), 0.4),
        lambda: DesignSpectrum(0.9, 0.05),
        lambda: DesignSpectrum(0.9, 0.4, 1.0),
        lambda: DesignSpectrum(0.9, 0.4).coefficient([0.1, 6.1]),
        lambda: DesignSpectrum(0.9, 0.4).coefficient(float("nan")),
    ],
)
def test_what_the_code_does_not_know_is_refused_in_one_line(attempt):
    with pytest.raises(InputError) as error:
        attempt()
    assert "\n" not in str(error.value)
