"""Tests of `deepseis_ins.motion_state`, sample by sample (numba).

Each axis follows its mean by a Kalman filter of a random walk in white noise (T. Kailath,
"An innovations approach to least-squares estimation", IEEE Trans. AC-13, 1968): while the station
is still the innovations, over their deviation, are independent unit normal values from the second
sample on, however young the mean is and however the bias drifts. Sums of them over the last n
samples, and sums of their squares, are compared with limits: the generalised likelihood ratio
test of a change in the mean (A. S. Willsky and H. L. Jones, IEEE Trans. AC-21, 1976, equation 20
without the fading of the signature), and a chi-square test for what swings faster.

Innovations are clipped, a triad's by its length: one wild sample alone passes no limit, two do.

`Counters` and `Rings` are arrays; ``count`` runs over the samples since the last reset.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

NOTHING: Final = 0
"""Events: the data are used up, motion begins, the station has been quiet, data are missing."""
MOTION: Final = 1
QUIET: Final = 2
LOST: Final = 3

COUNT: Final = 0
"""Counters: samples since the reset, missing in a row, the same in a row, last good sample."""
MISSING: Final = 1
REPEATED: Final = 2
LAST: Final = 3
COUNTERS: Final = 4

MEAN: Final = 0
"""Kinds of tests: of the mean of an axis and a triad, of the energy of an axis and a triad."""
TRIAD: Final = 1
ENERGY: Final = 2
TRIAD_ENERGY: Final = 3

_FAR = 1e100  # its square is a number
_NO_MEAN = 1e18  # times a sample's variance: the first sample becomes the mean


@njit(cache=True, nogil=True)
def reset(counters, ring, variance):  # type: ignore[no-untyped-def]
    """Forget the mean and all samples."""
    counters[COUNT] = 0
    ring[0, :] = 0.0
    variance[:] = -1.0


@njit(cache=True, nogil=True)
def _innovate(row, scale, drive, clip, baseline, variance, before, after):  # type: ignore[no-untyped-def]
    """Follow the means, and add this sample's innovations to the sums.

    ``variance`` is that of the mean over the one of a sample, -1 if there is no mean.
    """
    for t in range(2):
        norm = 0.0
        for j in range(3 * t, 3 * t + 3):
            after[j] = 0.0
            if not math.isfinite(row[j]):
                continue
            if variance[j] < 0.0:
                baseline[j], variance[j] = row[j], _NO_MEAN
            value = (row[j] - baseline[j]) * scale[j] / math.sqrt(1.0 + variance[j] + drive[j])
            after[j] = min(max(value, -_FAR), _FAR)
            norm += after[j] * after[j]
        shrink = clip / math.sqrt(norm) if norm > clip * clip else 1.0
        for j in range(3 * t, 3 * t + 3):
            value = after[j] * shrink
            after[j] = before[j] + value
            after[6 + j] = before[6 + j] + value * value
            if math.isfinite(row[j]):
                predicted = variance[j] + drive[j]
                variance[j] = predicted / (1.0 + predicted)
                baseline[j] += variance[j] * value * math.sqrt(1.0 + predicted) / scale[j]


@njit(cache=True, nogil=True)
def _test(  # type: ignore[no-untyped-def]
    count, ring, lengths, strides, mean, triad,
    energy_lengths, energy_strides, energy, triad_energy, found,
):  # fmt: skip
    """Compare all windows that end now with their limits; shortest first.

    ``found`` receives kind, number of the length, axis or triad. Strides are powers of two that
    do not shrink: where one does not divide the count, none of the rest does.
    """
    size = ring.shape[0] - 1
    now = count & size
    for s in range(lengths.shape[0]):
        n = lengths[s]
        if n > count or count & (strides[s] - 1) != 0:
            break
        then = (count - n) & size
        for t in range(2):
            j = 3 * t
            x = ring[now, j] - ring[then, j]
            y = ring[now, j + 1] - ring[then, j + 1]
            z = ring[now, j + 2] - ring[then, j + 2]
            x, y, z = x * x, y * y, z * z
            if x + y + z > triad[s, t]:
                found[0], found[1], found[2] = TRIAD, s, t
                return True
            if x > mean[s, j] or y > mean[s, j + 1] or z > mean[s, j + 2]:
                found[0], found[1], found[2] = MEAN, s, j
                if x <= mean[s, j]:
                    found[2] = j + 1 if y > mean[s, j + 1] else j + 2
                return True
    for s in range(energy_lengths.shape[0]):
        n = energy_lengths[s]
        if n > count or count & (energy_strides[s] - 1) != 0:
            break
        then = (count - n) & size
        for t in range(2):
            total = 0.0
            for j in range(3 * t, 3 * t + 3):
                squares = ring[now, 6 + j] - ring[then, 6 + j]
                total += squares
                if squares > energy[s, j]:
                    found[0], found[1], found[2] = ENERGY, s, j
                    return True
            if total > triad_energy[s, t]:
                found[0], found[1], found[2] = TRIAD_ENERGY, s, t
                return True
    return False


@njit(cache=True, nogil=True)
def advance(  # type: ignore[no-untyped-def]
    x, start, first_number, mode, scale, drive, clip, longest_gap, frozen, quiet,
    lengths, strides, mean, triad, energy_lengths, energy_strides, energy, triad_energy,
    counters, baseline, variance, previous, ring, numbers, found,
):  # fmt: skip
    """Go on from row ``start`` of ``x`` to the next event; return the row after it, and which.

    Parameters
    ----------
    x : ndarray, shape (m, 6)
        Rates and specific forces; a row without the latter is missing.
    mode : int
        1: still, the strict limits ``[1]`` hold, and motion and loss are events. 0: moving, the
        sensitive limits ``[0]`` hold, what passes them starts the wait anew, and quiet is an
        event. -1: not known, as 0, and motion is an event too.
    longest_gap, frozen, quiet : int
        Samples that may be missing or equal in a row; samples for quiet.
    """
    level = 1 if mode == 1 else 0
    size = ring.shape[0] - 1
    for i in range(start, x.shape[0]):
        row = x[i]
        whole, same = True, True
        for j in range(3, 6):
            whole = whole and math.isfinite(row[j])
            same = same and row[j] == previous[j - 3]
        if not whole:
            counters[MISSING] += 1
            if counters[MISSING] == longest_gap + 1:
                reset(counters, ring, variance)
                if mode == 1:
                    found[0] = 0
                    return i + 1, LOST
            continue
        counters[MISSING], counters[LAST] = 0, first_number + i
        previous[:] = row[3:]
        counters[REPEATED] = counters[REPEATED] + 1 if same else 0
        if counters[REPEATED] >= frozen:
            reset(counters, ring, variance)
            if mode == 1:
                found[0] = counters[REPEATED]
                return i + 1, LOST
            continue
        counters[COUNT] += 1
        count = counters[COUNT]
        _innovate(
            row, scale, drive, clip[level], baseline, variance,
            ring[(count - 1) & size], ring[count & size],
        )  # fmt: skip
        numbers[count & size] = first_number + i
        if _test(
            count, ring, lengths, strides, mean[level], triad[level],
            energy_lengths, energy_strides, energy[level], triad_energy[level], found,
        ):  # fmt: skip
            if mode != 0:
                return i + 1, MOTION
            reset(counters, ring, variance)
        elif mode != 1 and count >= quiet:
            return i + 1, QUIET
    return x.shape[0], NOTHING


@njit(cache=True, nogil=True)
def look_back(  # type: ignore[no-untyped-def]
    count, first, ring, lengths, mean, triad, energy_lengths, energy, triad_energy, found
):
    """Move the start of a motion back while windows before it are suspicious; return its count.

    ``first`` is the first sample of the window that noticed it.
    """
    size = ring.shape[0] - 1
    oldest = max(0, count - size)
    always = np.ones(lengths.size + energy_lengths.size, np.int64)
    moved = True
    while moved:
        moved = False
        end = first - 1
        held = min(end - oldest, size)
        if held < 1:
            break
        shorter = lengths[lengths <= held]
        shorter_energy = energy_lengths[energy_lengths <= held]
        if shorter.size == 0:
            break
        if _test(
            end, ring, shorter, always, mean, triad,
            shorter_energy, always, energy, triad_energy, found,
        ):  # fmt: skip
            n = shorter_energy[found[1]] if found[0] >= ENERGY else shorter[found[1]]
            first, moved = end - n + 1, True
    return first
