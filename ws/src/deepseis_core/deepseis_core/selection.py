"""Which four satellites: the largest tetrahedron of line-of-sight unit vectors, or the least GDOP.

The end points A, B, C, D of four unit vectors span a tetrahedron of volume ([1]_, equations 14 to
16, whose normal vector h_p is lost in print)::

    V = |(A - B) . ((C - B) x (D - B))| / 6

The larger it is, the smaller GDOP tends to be: ``GDOP^2 = trace(adj(H^T H)) / (6 V)^2``, and only
the numerator varies little. No matrix is inverted. With the highest satellite fixed, C(n - 1, 3)
volumes are compared and not C(n, 4): 56 and not 126 of nine satellites.

References
----------
.. [1] Hu J., Shi X., "Application of carrier phase smoothing pseudorange in GPS/SINS tightly
   integrated navigation system", Navigation Positioning & Timing 5(5), 2018, section 1.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray

HIGHEST: Final = "highest"
VOLUME: Final = "volume"
GDOP: Final = "gdop"
ALL: Final = "all"
RULES: Final = (HIGHEST, VOLUME, GDOP, ALL)
"""Highest satellite fixed and the largest volume with three others; the largest volume of any
four; the least GDOP of any four; all in view."""

MASK_DEG: Final = 10.0
"""Elevation below which no satellite is taken ([1]_, section 1.3) [deg]."""


@dataclass(frozen=True)
class Selection:
    """Who was chosen in m epochs.

    Attributes
    ----------
    chosen : ndarray of bool, shape (m, n)
    gdop : ndarray, shape (m,)
        Of those chosen; infinite where fewer than four are in view.
    evaluations : ndarray of int, shape (m,)
        How many combinations were compared.
    """

    chosen: NDArray[np.bool_]
    gdop: FloatArray
    evaluations: NDArray[np.int64]


def select(
    unit: FloatArray,
    elevation: FloatArray,
    rule: str = HIGHEST,
    *,
    mask_deg: float = MASK_DEG,
) -> Selection:
    """Choose satellites in m epochs.

    Where four or fewer are above the mask, all of them are taken.

    Parameters
    ----------
    unit : ndarray, shape (m, n, 3)
        Unit vectors along the lines of sight, in any axes and of either sign; NaN: not there.
    elevation : ndarray, shape (m, n)
        [rad]
    rule : {"highest", "volume", "gdop", "all"}, optional
    mask_deg : float, optional
        Elevation mask [deg].

    Raises
    ------
    InputError
        Shapes differ, or there is no such rule.

    Examples
    --------
    One satellite at the zenith and four around the horizon; three of these with the zenith make
    the largest tetrahedron (any of the four will do):

    >>> azimuth = np.radians([0.0, 90.0, 180.0, 270.0])
    >>> ring = np.stack([np.sin(azimuth), np.cos(azimuth), np.full(4, 0.2)], 1) / 1.0198
    >>> sky = np.vstack([[0.0, 0.0, 1.0], ring])[None]
    >>> got = select(sky, np.arcsin(sky[..., 2]))
    >>> int(got.chosen.sum()), bool(got.chosen[0, 0]), int(got.evaluations[0])
    (4, True, 4)
    """
    unit = np.ascontiguousarray(unit, np.float64)
    elevation = np.ascontiguousarray(elevation, np.float64)
    if unit.ndim != 3 or unit.shape != (*elevation.shape, 3):
        raise InputError("selection", f"shapes are {unit.shape} and {elevation.shape}", "(m, n)")
    if rule not in RULES:
        raise InputError("selection", f"{rule!r} is no rule", f"one of {', '.join(RULES)}")
    out = Selection(
        np.zeros(elevation.shape, np.bool_),
        np.empty(len(unit)),
        np.zeros(len(unit), np.int64),
    )
    select_kernel(
        unit, elevation, np.radians(mask_deg), RULES.index(rule),
        out.chosen, out.gdop, out.evaluations,
    )  # fmt: skip
    return out


def combinations(satellites: int, rule: str = HIGHEST) -> int:
    """Return how many combinations a rule compares.

    Examples
    --------
    >>> combinations(9, HIGHEST), combinations(9, VOLUME)
    (56, 126)
    """
    if rule == ALL or satellites <= 4:
        return 0
    return comb(satellites - 1, 3) if rule == HIGHEST else comb(satellites, 4)


@njit(cache=True, nogil=True)
def volume_of(u, a, b, c, d):  # type: ignore[no-untyped-def]
    """Return six times the volume of the tetrahedron of four rows of u, shape (n, 3)."""
    x0, x1, x2 = u[a, 0] - u[b, 0], u[a, 1] - u[b, 1], u[a, 2] - u[b, 2]
    y0, y1, y2 = u[c, 0] - u[b, 0], u[c, 1] - u[b, 1], u[c, 2] - u[b, 2]
    z0, z1, z2 = u[d, 0] - u[b, 0], u[d, 1] - u[b, 1], u[d, 2] - u[b, 2]
    return abs(x0 * (y1 * z2 - y2 * z1) + x1 * (y2 * z0 - y0 * z2) + x2 * (y0 * z1 - y1 * z0))


@njit(cache=True, nogil=True)
def gdop_of(u, members):  # type: ignore[no-untyped-def]
    """Return the GDOP of some rows of u; infinite where they do not suffice."""
    L, X = np.zeros((4, 4)), np.empty(4)
    for m in members:
        for i in range(4):
            a = u[m, i] if i < 3 else 1.0
            for j in range(i + 1):
                L[i, j] += a * (u[m, j] if j < 3 else 1.0)
    for i in range(4):
        for j in range(i + 1):
            rest = L[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = rest / L[j, j]
            elif rest > 1e-12:
                L[i, i] = np.sqrt(rest)
            else:
                return np.inf
    # trace((L L^T)^-1) is the sum of the squares of L^-1.
    total = 0.0
    for column in range(4):
        for i in range(column, 4):
            rest = 1.0 if i == column else 0.0
            for k in range(column, i):
                rest -= L[i, k] * X[k]
            X[i] = rest / L[i, i]
            total += X[i] * X[i]
    return np.sqrt(total)


@njit(cache=True, nogil=True)
def _best(u, seen, rule, four):  # type: ignore[no-untyped-def]
    """Fill the best four of ``seen``, whose first is the highest; return the comparisons."""
    n, best, compared = seen.size, -1.0, 0
    trial = np.empty(4, np.int64)
    for i in range(1 if rule == 0 else n - 3):
        for j in range(i + 1, n - 2):
            for k in range(j + 1, n - 1):
                for m in range(k + 1, n):
                    trial[0], trial[1], trial[2], trial[3] = seen[i], seen[j], seen[k], seen[m]
                    if rule == 2:
                        merit = 1.0 / gdop_of(u, trial)
                    else:
                        merit = volume_of(u, trial[0], trial[1], trial[2], trial[3])
                    compared += 1
                    if merit > best:
                        best = merit
                        four[:] = trial
    return compared


@njit(cache=True, nogil=True)
def select_kernel(unit, elevation, mask, rule, chosen, gdop, evaluations):  # type: ignore[no-untyped-def]
    """Fill the fields of `Selection`; ``rule`` counts in `RULES`."""
    four = np.empty(4, np.int64)
    for k in range(unit.shape[0]):
        u, up = unit[k], elevation[k]
        ok = np.isfinite(u[:, 0] + u[:, 1] + u[:, 2]) & (up >= mask)
        seen = np.flatnonzero(ok)
        if seen.size <= 4 or rule == 3:
            taken = seen
        else:
            highest = np.argmax(up[seen])
            seen[0], seen[highest] = seen[highest], seen[0]
            evaluations[k] = _best(u, seen, rule, four)
            taken = four
        for i in taken:
            chosen[k, i] = True
        gdop[k] = gdop_of(u, taken)
