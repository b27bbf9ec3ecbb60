"""What a motion that is noticed late has hidden, and how much of the rest before is believed."""

from __future__ import annotations

from typing import Final

LEAST_HIDDEN: Final = 5e-4
"""A motion that can have hidden no more than this has been noticed in time [m]."""
YOUNG: Final = 0.5
"""Of a rest shorter than twice the doubtful time so much is not believed [-]."""


def hidden_motion(walk: float, late: float) -> tuple[float, float]:
    """Return how far and how fast the ground may be where a motion is said to begin [m, m/s].

    One sigma of an axis, for accelerometers of white noise ``walk`` [m/s/sqrt(s)] that have needed
    ``late`` seconds to find the motion. A mean acceleration is found once it is 6 sigma of a
    window's noise, ``6 walk / sqrt(late)``; half of that times ``late`` squared is as far as the
    ground goes meanwhile, and as much may have been before. Looked for backwards, a motion begins
    where two sigma of velocity are left.

    Examples
    --------
    >>> [f"{1e3 * value:.2f}" for value in hidden_motion(2e-3, 2.0)]
    ['16.97', '5.66']
    >>> [f"{1e3 * value:.2f}" for value in hidden_motion(5e-4, 0.02)]
    ['0.00', '0.14']
    """
    return 3.0 * walk * late**1.5, 2.0 * walk * late**0.5


def doubtful(doubt: float, rest: float) -> float:
    """Return how much of a rest that ends is not believed: ``doubt``, of a young one half [s].

    Examples
    --------
    >>> doubtful(15.0, 600.0), doubtful(15.0, 4.0)
    (15.0, 2.0)
    """
    return min(doubt, YOUNG * rest)
