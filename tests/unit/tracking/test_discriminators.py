"""Discriminators: slope, range, blindness to data."""

import numpy as np
import pytest

from deepseis_tracking import discriminators


@pytest.mark.parametrize("amplitude", [1.0, -1.0, 30.0, -0.2])
def test_costas_has_unit_slope_and_does_not_see_the_data_bit(amplitude):
    for cycles in np.linspace(-0.24, 0.24, 13):
        i = amplitude * np.cos(2 * np.pi * cycles)
        q = amplitude * np.sin(2 * np.pi * cycles)
        assert discriminators.costas_atan(i, q) == pytest.approx(cycles, abs=1e-12)


def test_costas_of_nothing_is_zero_and_of_pure_quadrature_a_quarter():
    assert discriminators.costas_atan(0.0, 0.0) == 0.0
    assert discriminators.costas_atan(0.0, 2.0) == 0.25
    assert discriminators.costas_atan(0.0, -2.0) == -0.25


def test_pure_atan2_reaches_half_a_cycle():
    for cycles in np.linspace(-0.49, 0.49, 9):
        i, q = np.cos(2 * np.pi * cycles), np.sin(2 * np.pi * cycles)
        assert discriminators.pure_atan2(i, q) == pytest.approx(cycles, abs=1e-12)


@pytest.mark.parametrize("bit", [1.0, -1.0])
@pytest.mark.parametrize("hz", [-200.0, -3.0, 0.0, 12.5, 240.0])
def test_frequency_error_is_exact_within_a_quarter_cycle_a_step(hz, bit):
    dt = 1e-3
    last = np.exp(2j * np.pi * 0.13)
    now = bit * np.exp(2j * np.pi * (0.13 + hz * dt))
    found = discriminators.frequency_error(now.real, now.imag, last.real, last.imag, dt)
    assert found == pytest.approx(hz, abs=1e-8)


@pytest.mark.parametrize("spacing", [0.1, 0.5, 1.0])
def test_dll_envelope_is_exact_inside_the_linear_region(spacing):
    for error in np.linspace(-0.49, 0.49, 21) * spacing:
        early = 1 - abs(error - spacing / 2)
        late = 1 - abs(error + spacing / 2)
        found = discriminators.dll_envelope(early, late, spacing)
        assert found == pytest.approx(error, abs=1e-12)


def test_dll_envelope_without_power_is_zero():
    assert discriminators.dll_envelope(0.0, 0.0, 0.5) == 0.0
