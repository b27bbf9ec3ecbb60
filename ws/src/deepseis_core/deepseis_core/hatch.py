"""Pseudoranges smoothed by the carrier's phase (Hatch filter), all satellites and epochs at once.

With the phase L in metres and the count M of epochs since the last reset, up to a window ([1]_,
equations 24 to 27)::

    s_k = P_k / M + (M - 1) / M (s_{k-1} + L_k - L_{k-1})

An arc begins anew where the phase may have slipped: where the receiver says so, after an epoch
without either observation, and where ``|L_k - L_{k-1} - (P_k - P_{k-1})|`` exceeds a threshold.
That threshold is 3 m in [1]_, whose receiver has code noise of some decimetres. With more noise it
would take noise for slips, so that six sigma of the difference count where they are more.

*Noise.* White code noise of variance v leaves ``v / M`` while M grows and ``v / (2 M - 1)`` after:
but correlated over M epochs. Its density at low frequencies is still that of the raw ranges, and a
filter behind this one must not take the smaller variance for white.

*Ionosphere.* It delays the code by I and advances the phase, so that s lags behind P by
``2 (M - 1)`` times its change in an epoch. With I given, of two frequencies
(`ionosphere_from_phases`) or of a model, the phase is corrected to the code's sign, and the window
may be as long as the arc (divergence-free smoothing, [2]_).

References
----------
.. [1] Hu J., Shi X., "Application of carrier phase smoothing pseudorange in GPS/SINS tightly
   integrated navigation system", Navigation Positioning & Timing 5(5), 2018, section 2.
.. [2] P. Y. C. Hwang, G. A. McGraw and J. R. Bader, "Enhanced differential GPS carrier-smoothed
   code processing using dual-frequency measurements", Navigation 46(2), 1999.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.config import check, setting
from deepseis_core.constants import L1_HZ, L1_WAVELENGTH
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, Lli, Observations

L2_HZ: Final = 1227.6e6
"""[Hz] IS-GPS-200, 3.3.1.1."""

SMOOTHED, CODE, PHASE, IONOSPHERE, COUNT, VARIANCE, SD = range(7)
"""Columns of a state: smoothed, raw code, phase, ionosphere [m]; epochs averaged; part of the code
noise's variance that is left [-]; code noise's sigma [m]."""
STATE_COLUMNS: Final = 7

SLIP_SIGMAS: Final = 6.0
"""A change of code minus phase by so many sigma of its noise is no noise."""


@dataclass(frozen=True)
class HatchConfig:
    """Settings of the smoothing."""

    window: int = setting(100, "epochs averaged at most (M)", low=1, high=100000)
    slip_threshold: float = setting(
        3.0, "change of code minus phase that is a slip [m]", low=0.0, high=1e4
    )


@dataclass(frozen=True)
class Smoothed:
    """Result; all of the shape of the pseudoranges.

    Attributes
    ----------
    pseudorange : ndarray
        Smoothed [m]; raw where there is no phase, NaN where there is no code.
    count : ndarray of int
        Epochs averaged (M); 1 where an arc begins, 0 where there is no code.
    variance_factor : ndarray
        Variance left over variance of the raw code noise [-].
    slipped : ndarray of bool
        The threshold was exceeded: code and phase of an unbroken arc disagree.
    """

    pseudorange: FloatArray
    count: NDArray[np.int64]
    variance_factor: FloatArray
    slipped: NDArray[np.bool_]


def new_state(satellites: int) -> FloatArray:
    """Return the state of satellites without an arc, shape (n, 7)."""
    state = np.zeros((satellites, STATE_COLUMNS))
    state[:, PHASE] = np.nan
    return state


def smooth(
    pseudorange: FloatArray,
    phase: FloatArray,
    lost: NDArray[np.bool_],
    config: HatchConfig | None = None,
    *,
    ionosphere: FloatArray | None = None,
    pseudorange_sd: FloatArray | float = 0.0,
    state: FloatArray | None = None,
) -> Smoothed:
    """Smooth m epochs of n satellites.

    Parameters
    ----------
    pseudorange, phase : ndarray, shape (m, n)
        Code and carrier phase, both growing with range [m]; NaN: none.
    lost : ndarray of bool, shape (m, n)
        The receiver says that the phase lost its continuity since the epoch before.
    config : HatchConfig, optional
    ionosphere : ndarray, shape (m, n), optional
        Delay of the code [m], whatever its constant; makes the smoothing divergence-free.
    pseudorange_sd : ndarray, shape (m, n), or float, optional
        Sigma of the code noise [m], for the threshold.
    state : ndarray, shape (n, 7), optional
        Of `new_state`, carried from call to call; changed in place. However epochs are cut into
        calls, the result is the same to the bit.

    Raises
    ------
    InputError
        Shapes differ, or a setting makes no sense.

    Examples
    --------
    Code that errs by a metre either way, phase that does not:

    >>> code = np.array([[1.0], [-1.0], [1.0], [-1.0]]) + 2e7
    >>> smooth(code, np.zeros((4, 1)), np.zeros((4, 1), bool)).pseudorange[:, 0] - 2e7
    array([1.        , 0.        , 0.33333333, 0.        ])
    """
    config = config or HatchConfig()
    try:
        check(config)
    except ValueError as error:
        raise InputError("Hatch filter", str(error)) from None
    code = np.ascontiguousarray(pseudorange, np.float64)
    if code.ndim != 2 or np.shape(phase) != code.shape or np.shape(lost) != code.shape:
        shapes = f"{code.shape}, {np.shape(phase)}, {np.shape(lost)}"
        raise InputError("Hatch filter", f"arrays have shapes {shapes}", "(epochs, satellites)")
    state = new_state(code.shape[1]) if state is None else state
    if state.shape != (code.shape[1], STATE_COLUMNS):
        raise InputError("Hatch filter", f"its state has shape {state.shape}", "of new_state")
    delay = np.zeros_like(code) if ionosphere is None else ionosphere
    out = Smoothed(
        np.empty_like(code),
        np.empty(code.shape, np.int64),
        np.empty_like(code),
        np.empty(code.shape, np.bool_),
    )
    smooth_kernel(
        code,
        np.ascontiguousarray(phase, np.float64),
        np.ascontiguousarray(lost, np.bool_),
        np.ascontiguousarray(np.broadcast_to(delay, code.shape), np.float64),
        np.ascontiguousarray(np.broadcast_to(pseudorange_sd, code.shape), np.float64),
        config.window,
        config.slip_threshold,
        state,
        out.pseudorange, out.count, out.variance_factor, out.slipped,
    )  # fmt: skip
    return out


@njit(cache=True, nogil=True)
def smooth_kernel(  # type: ignore[no-untyped-def]
    code, phase, lost, delay, sd, window, threshold, state, out, count, factor, slipped
):
    """Fill the fields of `Smoothed`; arguments of `smooth`."""
    for k in range(code.shape[0]):
        for i in range(code.shape[1]):
            arc = state[i]
            out[k, i], count[k, i], factor[k, i] = code[k, i], 0, 1.0
            slipped[k, i] = False
            if not np.isfinite(code[k, i]) or not np.isfinite(phase[k, i] + delay[k, i]):
                arc[PHASE] = np.nan
                count[k, i] = 1 if np.isfinite(code[k, i]) else 0
                continue
            advance = phase[k, i] - arc[PHASE] + 2.0 * (delay[k, i] - arc[IONOSPHERE])
            unbroken = np.isfinite(advance) and not lost[k, i]
            if unbroken:
                noise = SLIP_SIGMAS * np.sqrt(sd[k, i] ** 2 + arc[SD] ** 2)
                apart = abs(advance - (code[k, i] - arc[CODE]))
                slipped[k, i] = apart > max(threshold, noise)
            if unbroken and not slipped[k, i]:
                arc[COUNT] = min(arc[COUNT] + 1.0, float(window))
                share = 1.0 / arc[COUNT]
                predicted = arc[SMOOTHED] + advance
                arc[SMOOTHED] = predicted + share * (code[k, i] - predicted)
                arc[VARIANCE] = share**2 + (1.0 - share) ** 2 * arc[VARIANCE]
            else:
                arc[SMOOTHED], arc[COUNT], arc[VARIANCE] = code[k, i], 1.0, 1.0
            arc[CODE], arc[PHASE], arc[IONOSPHERE] = code[k, i], phase[k, i], delay[k, i]
            arc[SD] = sd[k, i]
            out[k, i], count[k, i], factor[k, i] = arc[SMOOTHED], int(arc[COUNT]), arc[VARIANCE]


def ionosphere_from_phases(l1_cycles: FloatArray, l2_cycles: FloatArray) -> FloatArray:
    """Return the ionosphere's delay of L1 [m] but for a constant of every arc.

    ``I = (L1 - L2) f2^2 / (f1^2 - f2^2)`` with phases in metres, the sign of RINEX. A slip of
    either phase changes the constant: both must reset the smoothing.
    """
    l2_wavelength = L1_WAVELENGTH * L1_HZ / L2_HZ
    ratio = L2_HZ**2 / (L1_HZ**2 - L2_HZ**2)
    return ratio * (L1_WAVELENGTH * l1_cycles - l2_wavelength * l2_cycles)


class HatchFilter:
    """Smooths observations epoch by epoch, as they come.

    Parameters
    ----------
    config : HatchConfig, optional
    """

    def __init__(self, config: HatchConfig | None = None) -> None:
        self.config = config or HatchConfig()
        self._rows: dict[str, FloatArray] = {}

    def smooth(
        self, observations: Observations, pseudorange_sd: FloatArray | float = 0.0
    ) -> Smoothed:
        """Return an epoch's result, shapes (n,), aligned on its satellites.

        Satellites that are not in the epoch begin anew when they come back.
        """
        names = observations.satellites
        state = new_state(len(names))
        for row, name in zip(state, names, strict=True):
            row[:] = self._rows.get(name, row)
        got = smooth(
            observations.pseudorange[None],
            L1_WAVELENGTH * observations.carrier_phase_cycles[None],
            (observations.lli[None] & Lli.SLIP) != 0,
            self.config,
            pseudorange_sd=np.broadcast_to(pseudorange_sd, (1, len(names))),
            state=state,
        )
        self._rows = dict(zip(names, state, strict=True))
        return Smoothed(got.pseudorange[0], got.count[0], got.variance_factor[0], got.slipped[0])
