"""The design spectrum of the Chinese building code: what the ground must do to a building.

GB 50011-2010, "Code for seismic design of buildings", clauses 5.1.2 to 5.1.5 and 5.3. The
*seismic influence coefficient* ``alpha(T)`` is the greatest acceleration, in units of gravity, of
a damped oscillator of natural period ``T``; figure 5.1.5 gives its shape, table 5.1.4-1 its
height ``alpha_max``, table 5.1.4-2 the *characteristic period* ``Tg`` at which its plateau ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray

STANDARD_GRAVITY: Final = 9.80665
"""[m/s^2], by definition (CGPM 1901): turns influence coefficients into accelerations."""

LONGEST_PERIOD: Final = 6.0
"""The end of the design spectrum [s] (clause 5.1.5)."""

RISE_END: Final = 0.1
"""Where the plateau begins [s]."""

REST_SHARE: Final = 0.45
"""``alpha(0) / alpha_max``: the peak acceleration of the ground itself is 0.45 alpha_max g."""

VERTICAL_SHARE: Final = 0.65
"""Vertical ``alpha_max`` over horizontal (clause 5.3)."""

RARE_PERIOD_SHIFT: Final = 0.05
"""What a rare earthquake adds to the characteristic period [s] (clause 5.1.4)."""

SITE_CLASSES: Final = ("I0", "I1", "II", "III", "IV")
INTENSITIES: Final = ("6", "7", "7.5", "8", "8.5", "9")
"""Of fortification; 7.5 and 8.5 stand for the code's 7 (0.15 g) and 8 (0.30 g)."""
LEVELS: Final = ("frequent", "rare")

# Table 5.1.4-2 [s]: rows are the design earthquake groups 1, 2, 3, columns the site classes.
_CHARACTERISTIC_PERIODS: Final = (
    (0.20, 0.25, 0.35, 0.45, 0.65),
    (0.25, 0.30, 0.40, 0.55, 0.75),
    (0.30, 0.35, 0.45, 0.65, 0.90),
)

# Table 5.1.4-1: rows are the levels, columns the intensities.
_ALPHA_MAX: Final = (
    (0.04, 0.08, 0.12, 0.16, 0.24, 0.32),
    (0.28, 0.50, 0.72, 0.90, 1.20, 1.40),
)


def maximum_coefficient(intensity: str, level: str = "frequent") -> float:
    """Return the greatest horizontal influence coefficient ``alpha_max`` (table 5.1.4-1).

    Parameters
    ----------
    intensity : str
        One of :data:`INTENSITIES`.
    level : str
        One of :data:`LEVELS`: exceeded within 50 years with a chance of 63 % or of 2 to 3 %.

    Examples
    --------
    >>> maximum_coefficient("8", "rare")
    0.9
    """
    row = _ALPHA_MAX[_index("earthquake level", level, LEVELS)]
    return row[_index("intensity", intensity, INTENSITIES)]


def characteristic_period(site_class: str, group: int, level: str = "frequent") -> float:
    """Return the characteristic period ``Tg`` [s] (table 5.1.4-2; rare ones are 0.05 s longer).

    Parameters
    ----------
    site_class : str
        One of :data:`SITE_CLASSES`, from rock to soft soil.
    group : int
        Design earthquake group, 1 to 3: from near to far.
    level : str
        One of :data:`LEVELS`.

    Examples
    --------
    >>> characteristic_period("II", 1)
    0.35
    """
    row = _CHARACTERISTIC_PERIODS[_index("design earthquake group", str(group), ("1", "2", "3"))]
    period = row[_index("site class", site_class, SITE_CLASSES)]
    rare = _index("earthquake level", level, LEVELS) == 1
    return round(period + RARE_PERIOD_SHIFT * rare, 3)


@dataclass(frozen=True)
class DesignSpectrum:
    """The seismic influence coefficient as a function of period.

    Attributes
    ----------
    alpha_max : float
        Height of the plateau at 5 % damping, in units of gravity.
    characteristic_period : float
        End of the plateau ``Tg`` [s].
    damping : float
        Damping ratio ``xi`` of the oscillators.
    """

    alpha_max: float
    characteristic_period: float
    damping: float = 0.05

    def __post_init__(self) -> None:
        """Check the figures."""
        if not 0.0 < self.alpha_max < np.inf:
            raise InputError("alpha_max", f"{self.alpha_max} is not a positive number")
        if not RISE_END <= self.characteristic_period <= LONGEST_PERIOD / 5.0:
            reason = f"{self.characteristic_period} s is not within 0.1 and 1.2 s"
            raise InputError("characteristic period", reason, "the code's are 0.2 to 0.95 s")
        if not 0.0 <= self.damping < 1.0:
            raise InputError("damping", f"{self.damping} is not a ratio within 0 and 1")

    @property
    def decay_exponent(self) -> float:
        """Exponent ``gamma`` of the falling curve (5.1.5-1)."""
        return 0.9 + (0.05 - self.damping) / (0.3 + 6.0 * self.damping)

    @property
    def slope_factor(self) -> float:
        """Slope ``eta1`` of the falling straight line [1/s], not below 0 (5.1.5-2)."""
        return max(0.02 + (0.05 - self.damping) / (4.0 + 32.0 * self.damping), 0.0)

    @property
    def damping_factor(self) -> float:
        """Height ``eta2`` of the plateau over that of 5 % damping, not below 0.55 (5.1.5-3)."""
        return max(1.0 + (0.05 - self.damping) / (0.08 + 1.6 * self.damping), 0.55)

    def coefficient(self, period: ArrayLike) -> FloatArray:
        """Return the influence coefficient ``alpha(T)``.

        Figure 5.1.5::

            [0.45 + (eta2 - 0.45) T / 0.1] alpha_max            0   <= T < 0.1 s
            eta2 alpha_max                                      0.1 <= T < Tg
            (Tg / T)^gamma eta2 alpha_max                       Tg  <= T < 5 Tg
            [eta2 0.2^gamma - eta1 (T - 5 Tg)] alpha_max        5 Tg <= T <= 6 s

        Parameters
        ----------
        period : array_like
            Natural period ``T`` of an oscillator, 0 to 6 s.

        Returns
        -------
        ndarray
            In units of gravity, of the shape of ``period``.
        """
        T = np.asarray(period, dtype=np.float64)
        if not np.all((T >= 0.0) & (T <= LONGEST_PERIOD)):
            reason = "the design spectrum is defined for periods of 0 to 6 s only"
            raise InputError("design spectrum", reason)
        Tg, gamma, eta2 = self.characteristic_period, self.decay_exponent, self.damping_factor
        rise = REST_SHARE + (eta2 - REST_SHARE) * T / RISE_END
        curve = eta2 * (Tg / np.maximum(T, Tg)) ** gamma
        line = eta2 * 0.2**gamma - self.slope_factor * (T - 5.0 * Tg)
        shape = np.select([T < RISE_END, T / Tg < 5.0], [rise, curve], line)
        return self.alpha_max * shape

    def acceleration(self, period: ArrayLike) -> FloatArray:
        """Return the spectral acceleration ``alpha(T) g`` [m/s^2]; see `coefficient`."""
        return STANDARD_GRAVITY * self.coefficient(period)


def _index(what: str, value: str, known: tuple[str, ...]) -> int:
    if value not in known:
        raise InputError(what, f"{value!r} is unknown", "one of " + ", ".join(known))
    return known.index(value)
