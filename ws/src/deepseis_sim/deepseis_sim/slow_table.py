"""Something that changes slowly with time: evaluated on a grid, a cubic between."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from deepseis_core.types import FloatArray


class SlowTable:
    """Interpolates a costly smooth function; holds only the part of the grid last asked for.

    A value depends on its time alone, not on what was asked before.

    Parameters
    ----------
    function : callable
        Array, always of one shape, at the grid's point of a number.
    step : float
        From a point to the next [s]; number zero is at time zero.

    Examples
    --------
    >>> table = SlowTable(lambda number: np.array([float(number) ** 2]), 2.0)
    >>> table(np.array([4.0, 5.0])).ravel().tolist()
    [4.0, 6.25]
    """

    def __init__(self, function: Callable[[int], FloatArray], step: float) -> None:
        self._function, self._step = function, step
        self._points: dict[int, FloatArray] = {}

    def __call__(self, time: FloatArray) -> FloatArray:
        """Return the values at times, shape (m,), stacked on the first axis."""
        cell = np.floor(time / self._step).astype(np.int64)
        low, high = int(cell.min()), int(cell.max())
        known, wanted = self._points, range(low - 1, high + 3)
        self._points = {k: known[k] if k in known else self._function(k) for k in wanted}
        table = np.array([self._points[k] for k in wanted])
        share = time / self._step - cell
        share = share.reshape(-1, *[1] * (table.ndim - 1))
        return _catmull_rom([table[cell - low + k] for k in range(4)], share)


def _catmull_rom(points: Sequence[FloatArray], s: FloatArray) -> FloatArray:
    """Interpolate between the second (s = 0) and the third (s = 1) of four equidistant values."""
    p0, p1, p2, p3 = points
    cubic = 3.0 * (p1 - p2) + p3 - p0
    return p1 + 0.5 * s * (p2 - p0 + s * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + s * cubic))
