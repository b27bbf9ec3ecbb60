"""The correlator kernel against plain NumPy, and the replica bank against the code itself."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_LENGTH, CA_RATE_CPS
from deepseis_tracking.correlator import CARRIER_GROUP, correlate_period, fill_carrier
from deepseis_tracking.replica import MARGIN, ReplicaBank


def correlate_plainly(baseband, start, count, code, phase_cycles, step_cycles):
    k = np.arange(count)
    carrier = np.exp(-2j * np.pi * (phase_cycles + step_cycles * k))
    return (baseband[start : start + count] * carrier * code).sum()


@pytest.mark.parametrize("dtype", [np.int8, np.int16])
@pytest.mark.parametrize(
    ("phase", "step"), [(0.0, 0.0), (0.3, 1.1e-3), (-7.25, -2.5e-3), (1e9, 0.2)]
)
def test_kernel_equals_its_numpy_twin(dtype, phase, step):
    rng = np.random.default_rng(5)
    i, q = (rng.integers(-100, 100, 9000).astype(dtype) for _ in range(2))
    bank = ReplicaBank("G11", 4e6)
    tap_rows = np.array([3, 0, 31])
    tap_columns = np.array([MARGIN + 2, MARGIN, MARGIN - 2])
    work = np.empty(CARRIER_GROUP, np.float32), np.empty(CARRIER_GROUP, np.float32)
    out = np.zeros(6)
    correlate_period(i, q, 1234, 4001, bank.rows, tap_rows, tap_columns, phase, step, *work, out)
    for tap in range(3):
        code = bank.rows[tap_rows[tap], tap_columns[tap] : tap_columns[tap] + 4001]
        wanted = correlate_plainly(i + 1j * q, 1234, 4001, code, phase, step)
        # float32 sums of 4001 products of up to 100: rounding grows like sqrt(n) * 2^-24 * sum.
        assert abs(complex(out[2 * tap], out[2 * tap + 1]) - wanted) < 1e-5 * 4001 * 100


def test_carrier_table_keeps_its_phase_and_length():
    cosine, minus_sine = np.empty(CARRIER_GROUP, np.float32), np.empty(CARRIER_GROUP, np.float32)
    fill_carrier(cosine, minus_sine, CARRIER_GROUP, 0.0123)
    wanted = np.exp(-2j * np.pi * 0.0123 * np.arange(CARRIER_GROUP))
    assert_allclose(cosine + 1j * minus_sine, wanted, rtol=0, atol=1e-6)


@pytest.mark.parametrize("rate_hz", [2.048e6, 4e6, 4.092e6, 20.48e6])
def test_every_row_is_the_code_at_its_phase(rate_hz):
    bank = ReplicaBank("G29", rate_hz)
    steps, width = bank.rows.shape
    code = ca_code(29)
    for row in (0, 1, steps // 2, steps - 1):
        k = np.arange(width) - MARGIN
        phase = (k + row / steps) * CA_RATE_CPS / rate_hz
        # Chip edges that fall on a sample to within rounding may go either way.
        clear = np.abs(phase - np.round(phase)) > 1e-9
        wanted = code[np.floor(phase).astype(int) % CA_LENGTH]
        assert (bank.rows[row][clear] == wanted[clear]).all()


@pytest.mark.parametrize("spacing", [0.1, 0.25, 0.5, 1.0])
def test_the_spacing_that_taps_have_is_known(spacing):
    bank = ReplicaBank("G01", 4e6)
    step_chips = bank.chips_per_sample / bank.rows.shape[0]
    real = bank.real_spacing_chips(spacing)
    assert real == pytest.approx(2 * bank.tap_offset(spacing) * step_chips)
    assert abs(real - spacing) <= step_chips
