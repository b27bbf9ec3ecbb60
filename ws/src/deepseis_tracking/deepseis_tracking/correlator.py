"""Early, prompt and late integrate-and-dump over one code period.

Float sums are reassociated by the compiler: the order is fixed when the kernel is compiled, so
the same processor type and lock file give the same bytes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

CARRIER_GROUP = 256
"""Samples that share one carrier table; the groups are joined by a rotation in double."""

_FAST = {"reassoc", "contract", "nsz"}


@njit(cache=True, nogil=True, fastmath=_FAST)
def fill_carrier(
    cosine: NDArray[np.float32], minus_sine: NDArray[np.float32], count: int, step_cycles: float
) -> None:
    """Fill ``exp(-2j pi step k)``, k = 0..count-1, by doubling (log2(count) roundings)."""
    cosine[0] = 1.0
    minus_sine[0] = 0.0
    angle = 2.0 * math.pi * step_cycles
    real, imag = math.cos(angle), -math.sin(angle)
    done = 1
    while done < count:
        real_32, imag_32 = np.float32(real), np.float32(imag)
        for k in range(min(done, count - done)):
            cosine[done + k] = cosine[k] * real_32 - minus_sine[k] * imag_32
            minus_sine[done + k] = minus_sine[k] * real_32 + cosine[k] * imag_32
        real, imag = real * real - imag * imag, 2.0 * real * imag
        done *= 2


@njit(cache=True, nogil=True, fastmath=_FAST)
def correlate_period(
    baseband_i: NDArray[np.int8],
    baseband_q: NDArray[np.int8],
    start: int,
    count: int,
    rows: NDArray[np.int8],
    tap_rows: NDArray[np.int64],
    tap_columns: NDArray[np.int64],
    phase_cycles: float,
    step_cycles: float,
    cosine: NDArray[np.float32],
    minus_sine: NDArray[np.float32],
    out: NDArray[np.float64],
) -> None:
    """Wipe the carrier off and correlate with three code taps.

    Parameters
    ----------
    baseband_i, baseband_q : ndarray of int8 or int16
        Complex baseband.
    start, count : int
        First sample and number of samples.
    rows : ndarray of int8, shape (phase_steps, width)
        Replicas (`deepseis_tracking.replica`).
    tap_rows, tap_columns : ndarray of int64, shape (3,)
        Row and first column of the early, prompt and late tap.
    phase_cycles, step_cycles : float
        Carrier phase at the first sample and its advance a sample [cycles].
    cosine, minus_sine : ndarray of float32, shape (>= CARRIER_GROUP,)
        Work space.
    out : ndarray, shape (6,)
        Early, prompt, late as I, Q pairs, *added to*.
    """
    fill_carrier(cosine, minus_sine, min(CARRIER_GROUP, count), step_cycles)
    group_angle = 2.0 * math.pi * step_cycles * CARRIER_GROUP
    group_real, group_imag = math.cos(group_angle), -math.sin(group_angle)
    phase = 2.0 * math.pi * (phase_cycles - math.floor(phase_cycles))
    real, imag = math.cos(phase), -math.sin(phase)
    done = 0
    while done < count:
        size = min(CARRIER_GROUP, count - done)
        first = start + done
        x_group = baseband_i[first : first + size]
        y_group = baseband_q[first : first + size]
        early = rows[tap_rows[0], tap_columns[0] + done : tap_columns[0] + done + size]
        prompt = rows[tap_rows[1], tap_columns[1] + done : tap_columns[1] + done + size]
        late = rows[tap_rows[2], tap_columns[2] + done : tap_columns[2] + done + size]
        carrier_r, carrier_i = cosine[:size], minus_sine[:size]
        zero = np.float32(0.0)
        ei, eq, pi, pq, li, lq = zero, zero, zero, zero, zero, zero
        for k in range(size):
            x, y = np.float32(x_group[k]), np.float32(y_group[k])
            u = x * carrier_r[k] - y * carrier_i[k]
            v = x * carrier_i[k] + y * carrier_r[k]
            code_e, code_p = np.float32(early[k]), np.float32(prompt[k])
            code_l = np.float32(late[k])
            ei += u * code_e
            eq += v * code_e
            pi += u * code_p
            pq += v * code_p
            li += u * code_l
            lq += v * code_l
        out[0] += ei * real - eq * imag
        out[1] += ei * imag + eq * real
        out[2] += pi * real - pq * imag
        out[3] += pi * imag + pq * real
        out[4] += li * real - lq * imag
        out[5] += li * imag + lq * real
        real, imag = real * group_real - imag * group_imag, real * group_imag + imag * group_real
        done += size
