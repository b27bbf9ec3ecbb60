"""Errors of carrier tracking loops in closed form: what design and tests compare with.

Results are one-sigma phase errors [rad] unless said otherwise; C/N0 is given in dB-Hz, the loop's
one-sided noise bandwidth ``Bn`` in Hz, the integration ``T`` in s. Arguments broadcast as NumPy's.
These are the formulas of analog loops. Full transfer functions are in `loop_theory_analog` and
`loop_theory_imu`, the loop that is really used (discrete, at 20 ms) in `loop_theory_discrete`,
limits (least C/N0, best bandwidth, jammers) in `loop_theory_limits`.

References
----------
[T] the thesis, chapter 3.3; [D] the Doppler-aided paper, section 1; corrected where the print is
wrong, as each docstring says.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.constants import L1_HZ, L1_WAVELENGTH
from deepseis_core.types import FloatArray

PHASE_PER_METRE: Final = 2.0 * np.pi / L1_WAVELENGTH
"""[rad/m]"""

OCXO: Final = (2.51e-26, 2.51e-23, 2.51e-22)
"""h_0 [1/Hz], h_-1 [-], h_-2 [Hz] of the thesis' oscillator, below T 3.4."""

THRESHOLD: Final = np.radians(15.0)
"""Of the three-sigma rule: a third of 45 deg, half the pull-in range of atan (T 3.6, 3.7)."""

Convention = Literal["one-sided", "as-printed"]
"""Of the oscillator's h: see `allan_noise`."""


def linear(decibels: ArrayLike) -> FloatArray:
    """Return a power ratio, or C/N0 [Hz] from dB-Hz."""
    return np.asarray(10.0 ** (np.asarray(decibels, np.float64) / 10.0))


def thermal_noise(bandwidth_hz: ArrayLike, cn0_dbhz: ArrayLike, period: float) -> FloatArray:
    """Return the phase error by thermal noise, T 3.2 and D 2.

    ``sqrt(Bn / CN0 (1 + 1 / (2 T CN0)))``.

    Examples
    --------
    >>> round(float(np.degrees(thermal_noise(3.0, 45.0, 0.02))), 2)
    0.56
    """
    cn0 = linear(cn0_dbhz)
    return np.sqrt(np.asarray(bandwidth_hz) / cn0 * (1.0 + 0.5 / (period * cn0)))


def discriminator_noise(
    cn0_dbhz: ArrayLike, period: float, *, bandwidth_hz: ArrayLike = 0.0
) -> FloatArray:
    """Return the noise of the discriminator's output: what a plot of it shows.

    Open loop ``s_d = sqrt(1 / (2 CN0 T) (1 + 1 / (2 T CN0)))``; in a closed loop the replica's
    own error, of the noise of earlier integrations, adds: ``sqrt(s_d^2 + s_t^2)``. For the
    discrete loop that is exact if ``Bn`` is its realised bandwidth.

    Parameters
    ----------
    bandwidth_hz : array_like
        Of the loop; 0 is open.

    Examples
    --------
    >>> round(float(np.degrees(discriminator_noise(45.0, 0.02, bandwidth_hz=8.0))), 2)
    1.85
    """
    single = thermal_noise(0.5 / period, cn0_dbhz, period)
    return np.hypot(single, thermal_noise(bandwidth_hz, cn0_dbhz, period))


def vibration_noise(
    bandwidth_hz: ArrayLike, g_sensitivity: float = 1e-9, density: float = 0.05
) -> FloatArray:
    """Return the phase error of an order-2 loop by an oscillator that is shaken at random, T 3.3.

    ``sqrt(pi^2 f1^2 Kg^2 Gg / (2.67 Bn))``; of an oscillator on the moving body only.

    Parameters
    ----------
    g_sensitivity : float
        ``Kg`` [1/g].
    density : float
        ``Gg``, one-sided and white [g^2/Hz].
    """
    variance = (np.pi * L1_HZ * g_sensitivity) ** 2 * density / 2.67
    return np.sqrt(variance / np.asarray(bandwidth_hz))


def allan_noise(
    bandwidth_hz: ArrayLike, h: Sequence[float] = OCXO, convention: Convention = "one-sided"
) -> FloatArray:
    """Return the phase error of an order-2 loop by the oscillator's own noise, T 3.4.

    ``sqrt(4 pi^2 f1^2 (pi^2 h_-2 / (sqrt2 wL^3) + pi h_-1 / (4 wL^2) + h_0 / (4 sqrt2 wL)))``
    with ``wL = 1.89 Bn``, damping 0.707. The print lost the exponent of the first wL and has
    ``2 pi^2`` for ``4 pi^2``.

    Parameters
    ----------
    h : sequence of three float
        ``h_0, h_-1, h_-2`` of fractional frequency, ``S_y = h_0 + h_-1 / f + h_-2 / f^2``.
    convention : str
        "one-sided": S_y holds for f > 0 alone, as in IEEE Std 1139 and the Allan variance
        ``h_0 / (2 tau) + 2 ln 2 h_-1 + ...``; the error of a simulated oscillator agrees with it.
        "as-printed": the thesis' factor, half that variance.

    Examples
    --------
    >>> round(float(np.degrees(allan_noise(3.0, convention="as-printed"))), 2)
    1.28
    """
    h_0, h_1, h_2 = h
    natural = 1.89 * np.asarray(bandwidth_hz, np.float64)
    parts = np.pi**2 * h_2 / (np.sqrt(2.0) * natural**3) + np.pi * h_1 / (4.0 * natural**2)
    parts += h_0 / (4.0 * np.sqrt(2.0) * natural)
    factor = {"one-sided": 4.0, "as-printed": 2.0}[convention]
    return np.pi * L1_HZ * np.sqrt(factor * parts)


def allan_noise_order_3(bandwidth_hz: ArrayLike, allan_deviation: ArrayLike) -> FloatArray:
    """Return the phase error of an order-3 loop by the oscillator, an empirical rule, D 4.

    ``160 deg sigma_A(tau) f1 / Bn``, f1 in Hz, tau about ``1 / Bn``.
    """
    ratio = np.asarray(allan_deviation) * L1_HZ / np.asarray(bandwidth_hz)
    return np.radians(160.0) * ratio


def allan_deviation(tau: ArrayLike, h: Sequence[float] = OCXO) -> FloatArray:
    """Return sigma_A at averaging times [s] for one-sided h (IEEE Std 1139)."""
    tau = np.asarray(tau, np.float64)
    flicker, walk = 2.0 * np.log(2.0) * h[1], 2.0 * np.pi**2 / 3.0 * h[2]
    return np.sqrt(h[0] / (2.0 * tau) + flicker + walk * tau)


def natural_frequency(
    order: int, bandwidth_hz: ArrayLike, damping: float = 0.5**0.5
) -> FloatArray:
    """Return ``wn`` [rad/s] of an analog loop, T table 2.1 and T 3.3.3.

    Order 1: ``4 Bn``. Order 2: ``8 zeta / (4 zeta^2 + 1) Bn``, that is Bn / 0.53 at damping 0.707
    and 8 Bn / 5 at damping 1. Order 3 (a3 = 1.1, b3 = 2.4): ``Bn / 0.7845``.

    Examples
    --------
    >>> [round(float(natural_frequency(2, 15.0, z)), 2) for z in (0.5, 1.0)]
    [30.0, 24.0]
    """
    a, b = 1.1, 2.4
    share = {
        1: 0.25,
        2: (4.0 * damping**2 + 1.0) / (8.0 * damping),
        3: (a * b**2 + a**2 - b) / (4.0 * (a * b - 1.0)),
    }[order]
    return np.asarray(bandwidth_hz, np.float64) / share


def dynamic_stress(
    order: int, bandwidth_hz: ArrayLike, derivative: ArrayLike, damping: float = 0.5**0.5
) -> FloatArray:
    """Return the steady phase error under a constant N-th derivative of range, T 3.5.

    ``(2 pi / lambda) (d^N R / dt^N) / wn^N`` of the loop of order N; for order 3 that is D 5,
    ``0.4828 (d^3 R / dt^3) / Bn^3``. Under motion that changes in less than ``1 / wn`` it is
    neither a bound nor a mean: `AnalogLoop.error` is exact.

    Parameters
    ----------
    derivative : array_like
        Along the line of sight [m/s^order].

    Examples
    --------
    >>> stress = dynamic_stress(3, 25.0, 10 * 9.80665)
    >>> round(float(np.degrees(stress)), 2)
    5.73
    """
    wn = natural_frequency(order, bandwidth_hz, damping)
    return PHASE_PER_METRE * np.asarray(derivative) / wn**order


def velocity_step_peak(natural: ArrayLike, velocity: ArrayLike) -> FloatArray:
    """Return the peak error of a critically damped order-2 loop after a velocity step, T 3.22.

    The error is ``(2 pi / lambda) dv t exp(-wn t)``, its peak ``(2 pi / lambda) dv / (e wn)`` at
    ``1 / wn``. The print takes its square root, which is no phase. For other loops:
    `AnalogLoop.velocity_step_peak`.

    Parameters
    ----------
    natural : array_like
        ``wn`` [rad/s].
    velocity : array_like
        Error of the aiding along the line of sight [m/s].
    """
    return PHASE_PER_METRE * np.asarray(velocity) / (np.e * np.asarray(natural))


def conventional_total(
    thermal: ArrayLike, vibration: ArrayLike, allan: ArrayLike, stress: ArrayLike
) -> FloatArray:
    """Return the total of a loop without aiding, to be kept below `THRESHOLD`, T 3.7 and D 1.

    ``sqrt(s_t^2 + s_rv^2 + s_A^2) + th_e / 3``.
    """
    return root_sum_square(thermal, vibration, allan) + np.asarray(stress) / 3.0


def aided_total(
    thermal: ArrayLike, vibration: ArrayLike, allan: ArrayLike, aiding: ArrayLike
) -> FloatArray:
    """Return the total of an aided loop, T 3.21 and D 6: the aiding's error in place of stress."""
    return root_sum_square(thermal, vibration, allan, aiding)


def root_sum_square(*parts: ArrayLike) -> FloatArray:
    """Add independent errors."""
    return np.sqrt(sum(np.square(np.asarray(part, np.float64)) for part in parts))
