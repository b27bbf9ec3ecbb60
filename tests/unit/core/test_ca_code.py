"""C/A codes against the table of the standard, and their correlation properties."""

import numpy as np
import pytest

from deepseis_core.ca_code import ca_code, ca_codes

# First ten chips, octal, PRN 1 to 32: IS-GPS-200, table 3-Ia.
FIRST_TEN = (
    *(0o1440, 0o1620, 0o1710, 0o1744, 0o1133, 0o1455, 0o1131, 0o1454),
    *(0o1626, 0o1504, 0o1642, 0o1750, 0o1764, 0o1772, 0o1775, 0o1776),
    *(0o1156, 0o1467, 0o1633, 0o1715, 0o1746, 0o1763, 0o1063, 0o1706),
    *(0o1743, 0o1761, 0o1770, 0o1774, 0o1127, 0o1453, 0o1625, 0o1712),
)


@pytest.mark.parametrize("prn", range(1, 33))
def test_first_ten_chips_are_those_of_the_standard(prn):
    logic = (1 - ca_code(prn)[:10].astype(int)) // 2
    assert int("".join(map(str, logic)), 2) == FIRST_TEN[prn - 1]


def test_codes_are_balanced_and_correlate_only_in_the_three_values_of_a_gold_family():
    spectra = np.fft.fft(ca_codes().astype(float))
    assert set(np.unique(ca_codes())) == {-1, 1}
    # 512 chips of logic 1 and 511 of logic 0: sum -1.
    assert set(ca_codes().sum(axis=1).tolist()) == {-1}
    for a in range(0, 32, 5):
        correlation = np.rint(np.fft.ifft(spectra[a].conj() * spectra).real).astype(int)
        assert correlation[a, 0] == 1023
        correlation[a, 0] = -1
        assert set(np.unique(correlation)) == {-65, -1, 63}


def test_codes_are_shared_and_cannot_be_written():
    assert ca_code(1).dtype == np.int8
    with pytest.raises(ValueError, match="read-only"):
        ca_code(1)[0] = 1
    with pytest.raises(ValueError, match="PRN 33"):
        ca_code(33)
