"""An accelerogram's motion with the displacement that GNSS saw: nothing of it is lost.

Integrated twice, an accelerogram keeps nothing of what lies below its high-pass, a permanent
offset least of all. Displacements of GNSS at the same place have just that, and are noisy above.
The accelerogram gives what lies above a crossover, GNSS what lies below, through filters whose
gains add up to one and that delay nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.accelerogram import Accelerogram
from deepseis_sim.integration import band_pass, padding
from deepseis_sim.motions_shapes import rise_by
from deepseis_sim.uniform_spline import UniformSpline

QUIET_S: Final = 10.0
"""At most: the displacement's zero is its mean over this before the used part [s]."""


@dataclass(frozen=True)
class Merged:
    """Motion of a place, and where it ends up.

    Attributes
    ----------
    motion : UniformSpline
        Displacement less the smooth rise to ``offset`` over the used part [m].
    offset : ndarray, shape (3,)
        Displacement from the beginning to the end of the used part, east, north, up [m].
    """

    motion: UniformSpline
    offset: FloatArray


def below(displacement: FloatArray, rate_hz: float, crossover_hz: float, order: int) -> FloatArray:
    """Return what `band_pass` from the crossover on leaves of displacements, (m, k) [m].

    Outside its span the displacement stays what it is at its ends.
    """
    pad = 2 * padding(rate_hz, crossover_hz, order)
    held = np.pad(displacement, ((pad, pad), (0, 0)), mode="edge")
    # A level is below every crossover; without it the filter sees no step at the beginning.
    held = held - displacement[0]
    low = held - band_pass(held, rate_hz, crossover_hz, 0.0, order=order)
    return low[pad : len(held) - pad] + displacement[0]


def delay_between(record: Accelerogram, displacement: Accelerogram) -> float:
    """Return how much later than the displacement the record begins [s]; 0 if it is not known."""
    if record.start_utc_ns is None or displacement.start_utc_ns is None:
        return 0.0
    return 1e-9 * (record.start_utc_ns - displacement.start_utc_ns)


def merge(
    above: UniformSpline,
    displacement: Accelerogram,
    delay_s: float,
    crossover_hz: float,
    order: int,
    used: tuple[float, float],
) -> Merged:
    """Add what lies below the crossover to a motion that has nothing of it.

    Parameters
    ----------
    above : UniformSpline
        The accelerogram integrated, from the crossover on (`integration.ground_motion`).
    displacement : Accelerogram
        Its ``acceleration`` holds displacement [m]; that is how such files are read.
    delay_s : float
        Time of the accelerogram's first sample after the displacement's [s].
    crossover_hz, order : float, int
        Of the filter that made ``above``.
    used : tuple of float
        Begin and end of the used part, record's time [s].
    """
    rate, samples = displacement.rate_hz, displacement.acceleration
    times = np.arange(len(samples)) / rate - delay_s
    if times[0] > used[0] or times[-1] < used[1]:
        span = (
            f"{times[0]:g} to {times[-1]:g} s of the record; used are {used[0]:g} to {used[1]:g}"
        )
        raise InputError("recorded", f"the displacement covers {span}")
    quiet = (times >= used[0] - QUIET_S) & (times <= max(used[0], times[0] + QUIET_S))
    samples = samples - samples[quiet].mean(axis=0)
    grid: FloatArray = above.start + above.step * np.arange(above.knots.shape[0], dtype=np.float64)
    through = CubicSpline(times, samples)(np.clip(grid, times[0], times[-1]))
    low = below(through, 1.0 / above.step, crossover_hz, order)
    whole = _sum(above, UniformSpline.from_positions(above.start, above.step, low), 1.0)
    ends = whole.evaluate(np.array(used))[0]
    offset = ends[1] - ends[0]
    rise = rise_by(grid, used[0], used[1] - used[0])[0][:, np.newaxis] * offset
    return Merged(
        _sum(whole, UniformSpline.from_positions(above.start, above.step, rise), -1.0), offset
    )


def _sum(one: UniformSpline, other: UniformSpline, factor: float) -> UniformSpline:
    """Add splines of the same knots: a quintic is linear in what they hold."""
    return UniformSpline(one.start, one.step, one.knots + factor * other.knots)
