"""Kernels that evaluate integrations at grid epochs: arrays in, given arrays filled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def locate(
    ints: IntArray, floats: FloatArray, head: IntArray, tail: IntArray, breaks: IntArray,
    sample: int, fraction: float, rate: float,
    row: IntArray, transmit_ms: IntArray, code_ms: FloatArray, tau: FloatArray,
) -> None:  # fmt: skip
    """Move each satellite's head to the row that holds a sample; evaluate its code phase there.

    ``breaks`` gathers the ``BREAK`` bits of all rows passed: 1 phase continuity lost, 2 polarity
    turned. ``observe`` clears it.
    """
    for i in range(len(head)):
        row[i] = -1
        h = head[i]
        while h < tail[i] and ints[i, h, 0] + ints[i, h, 1] <= sample:
            breaks[i] |= ints[i, h, 4]
            h += 1
        head[i] = h
        if h == tail[i] or ints[i, h, 0] > sample or not ints[i, h, 3] & 1:
            continue
        row[i] = h
        tau[i] = ((sample - ints[i, h, 0]) + fraction) / rate
        transmit_ms[i] = ints[i, h, 2]
        code_ms[i] = (floats[i, h, 0] + floats[i, h, 1] * tau[i]) / 1023.0


@njit(cache=True, nogil=True)
def reached(
    ints: IntArray, head: IntArray, tail: IntArray, published: IntArray, sample: int, margin: int
) -> bool:
    """Tell whether no row that holds ``sample`` can still arrive, for any satellite."""
    for i in range(len(head)):
        if published[i] >= sample + margin:
            continue
        t = tail[i]
        if t == head[i] or ints[i, t - 1, 0] + ints[i, t - 1, 1] <= sample:
            return False
    return True


@njit(cache=True, nogil=True)
def travel_time(
    row: IntArray, transmit_ms: IntArray, code_ms: FloatArray,
    receive_ms: int, receive_fraction: float, travel_ms: FloatArray,
) -> int:  # fmt: skip
    """Fill receive minus transmit time [ms]; drop rows whose travel time no satellite can have.

    ``receive_ms`` is the whole millisecond of week, ``receive_fraction`` the rest [ms]. Returns
    how many rows were dropped.
    """
    dropped = 0
    for i in range(len(row)):
        if row[i] < 0:
            continue
        whole = receive_ms - transmit_ms[i]
        if whole < -302400000:
            whole += 604800000
        travel_ms[i] = whole + (receive_fraction - code_ms[i])
        if transmit_ms[i] < 0:
            row[i] = -1
        elif travel_ms[i] < 50.0 or travel_ms[i] > 150.0:  # GPS at the ground: 63..90
            row[i] = -1
            dropped += 1
    return dropped


@njit(cache=True, nogil=True)
def observe(
    ints: IntArray, floats: FloatArray, row: IntArray, tau: FloatArray, travel_ms: FloatArray,
    breaks: IntArray, steered: int, spacing: float, rate: float, now: float,
    arc_cycles: FloatArray, arc_start: FloatArray, values: FloatArray, lli: NDArray[np.uint8],
) -> int:  # fmt: skip
    """Turn located rows into observables and keep the arcs. Returns the number of slips.

    Parameters
    ----------
    ints, floats : ndarray
        Rows of ``TrackStore``.
    row, tau, travel_ms : ndarray, shape (n,)
        Covering row or -1; time into it [s]; receive minus transmit time [ms].
    breaks : ndarray of int64, shape (n,)
        As ``locate`` gathered them; cleared for the satellites observed.
    steered : int
        Whole cycles by which clock corrections have moved all phases.
    spacing, rate, now : float
        Early-late spacing [chips]; sample rate [Hz]; time of the epoch since sample 0 [s].
    arc_cycles, arc_start : ndarray, shape (n,)
        State: integer of each arc [cycles], and when it started [s].
    values : ndarray, shape (n, 9)
        Filled: C1C [m], L1C [cycles], D1C [Hz], C/N0 [dB-Hz], lock time [s], carrier error and
        its sigma [cycles], code error and its sigma [chips].
    lli : ndarray of uint8, shape (n,)
        Filled: loss-of-lock bits.
    """
    slips = 0
    for i in range(len(row)):
        r = row[i]
        if r < 0:
            continue
        flags, t = ints[i, r, 3], tau[i]
        phase, f, f1, f2 = floats[i, r, 2], floats[i, r, 3], floats[i, r, 4], floats[i, r, 5]
        turned = phase + t * (f + t * (f1 / 2 + t * f2 / 3))
        code = travel_ms[i] * 299792.458
        happened = breaks[i] | ints[i, r, 4]
        if happened & 1:
            arc_cycles[i] = np.rint(code * (1575.42e6 / 299792458.0) + turned) - steered
        if happened:
            arc_start[i] = now
            slips += 1
        lli[i] = (1 if happened else 0) | (0 if flags & 8 else 2)
        # The row's break is told now; the head will pass it again at a later epoch.
        ints[i, r, 4] = 0
        breaks[i] = 0 if flags & 2 else 1
        values[i, 0] = code
        values[i, 1] = (arc_cycles[i] + steered) - turned if flags & 2 else np.nan
        values[i, 2] = f + t * (f1 + t * f2)
        values[i, 3] = floats[i, r, 8]
        values[i, 4] = now - arc_start[i]
        energy = 10.0 ** (floats[i, r, 8] / 10.0) * ints[i, r, 1] / rate
        values[i, 5] = floats[i, r, 6]
        values[i, 6] = np.sqrt((1.0 + 0.5 / energy) / (2.0 * energy)) / (2.0 * np.pi)
        values[i, 7] = floats[i, r, 7]
        squaring = 1.0 + 2.0 / ((2.0 - spacing) * energy)
        values[i, 8] = np.sqrt(spacing / (4.0 * energy) * squaring)
    return slips
