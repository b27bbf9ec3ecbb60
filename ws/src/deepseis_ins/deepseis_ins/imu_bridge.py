"""What stands in for rows of IMU increments that are missing, and how far off it may be.

Over a few intervals a straight line between neighbours, or the last row that goes on, is nearer
to the truth than a mean over seconds. How near depends on how the ground shakes: a line over T is
off by about ``a'' T^3 / 12``. So it is not assumed but tried: on the rows before, as if as many
had been missing there, everywhere.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.types import FloatArray

LEAST_TRIALS: Final = 20
"""With fewer nothing is known."""


def line(last: FloatArray, following: FloatArray, count: int) -> FloatArray:
    """Return ``count`` rows on a straight line between two, shape (count, m).

    Examples
    --------
    >>> line(np.zeros(1), np.array([4.0]), 3).ravel()
    array([1., 2., 3.])
    """
    share = np.arange(1, count + 1)[:, None] / (count + 1.0)
    return np.asarray(last + share * (following - last))


def line_off2(
    rows: FloatArray, usable: NDArray[np.bool_], count: int, jump: FloatArray
) -> FloatArray | None:
    """Return the mean square of what the sum of ``count`` rows is off by if a line stands in.

    Parameters
    ----------
    rows : ndarray, shape (k, m)
        Before those that are missing.
    usable : ndarray, shape (k,)
        Which of them are what was measured, or near it.
    count : int
    jump : ndarray, shape (m,)
        By what the row after the missing ones differs from the one before. If it is more than
        twice what is usual the ground has begun to shake more, and the line is off by more.

    Returns
    -------
    ndarray, shape (m,), or None
        None: there are too few rows to tell.

    Examples
    --------
    Rows that bend by 2 from one to the next but one: a line over one missing is off by 1.

    >>> bent = np.cumsum(np.arange(40.0) * 2.0)[:, None]
    >>> np.round(line_off2(bent, np.ones(40, bool), 1, np.zeros(1)), 9)
    array([1.])
    """
    whole = _whole(usable, count + 2)
    if np.count_nonzero(whole) < LEAST_TRIALS:
        return None
    before, after = rows[: -count - 1], rows[count + 1 :]
    sums = np.cumsum(rows, axis=0)
    off = sums[count:-1] - sums[: -count - 1] - 0.5 * count * (before + after)
    off2 = np.mean(off[whole] ** 2, axis=0)
    usual2 = np.mean((after - before)[whole] ** 2, axis=0)
    at_most = np.full(off2.shape, 0.25 * count**2)  # where nothing has changed so far
    share = np.divide(off2, usual2, out=at_most, where=usual2 > 0.0)
    return np.asarray(share * np.maximum(usual2, 0.25 * jump**2))


def held_off2(rows: FloatArray, usable: NDArray[np.bool_], count: int) -> FloatArray | None:
    """Return the same if the last row goes on; arguments as of `line_off2`.

    Examples
    --------
    >>> held_off2(np.arange(40.0)[:, None], np.ones(40, bool), 2)
    array([9.])
    """
    whole = _whole(usable, count + 1)
    if np.count_nonzero(whole) < LEAST_TRIALS:
        return None
    sums = np.cumsum(rows, axis=0)
    off = sums[count:] - sums[:-count] - count * rows[:-count]
    return np.asarray(np.mean(off[whole] ** 2, axis=0))


def _whole(usable: NDArray[np.bool_], width: int) -> NDArray[np.bool_]:
    """Return which windows of ``width`` rows, by their first, hold nothing that is not usable."""
    spoilt = np.concatenate([[0], np.cumsum(~usable)])
    return np.asarray(spoilt[width:] == spoilt[:-width])
