"""Lower rates by zero-phase FIR filters: flat below, nothing folded back, edges left out.

Each stage is a symmetric FIR filter centred on the samples that it keeps, so nothing is delayed;
a sample is given only where the whole filter has data, so nothing is made up at gaps and ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import firwin, kaiserord

from deepseis_bringup.export.sample_runs import Run
from deepseis_core.constants import NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, IntArray

REJECTION_DB = 92.0
"""Of each stage, 2.5e-5: below 1e-4 in all, in pass band and stop band, with up to four."""

FACTORS = (10, 8, 7, 6, 5, 4, 3, 2)


@dataclass(frozen=True)
class Stage:
    """One FIR filter and what it keeps: every ``factor``-th sample of ``rate_hz`` [Hz]."""

    rate_hz: float
    factor: int
    taps: FloatArray

    @property
    def half(self) -> int:
        """Samples of either side that an output needs."""
        return len(self.taps) // 2


def design_stages(rate_hz: float, out_hz: float, pass_fraction: float) -> tuple[Stage, ...]:
    """Design the filters from one rate to a lower one.

    Parameters
    ----------
    rate_hz, out_hz : float
        Their ratio is a whole number.
    pass_fraction : float
        Flat to 1e-4 up to this fraction of the output's Nyquist frequency; from that frequency
        on, what folds is below 1e-4.

    Raises
    ------
    InputError
        The ratio is not whole, or has a prime factor above 10.
    """
    ratio = round(rate_hz / out_hz)
    what = f"decimation from {rate_hz:g} to {out_hz:g} Hz"
    if ratio < 2 or abs(rate_hz / out_hz - ratio) > 1e-9 * ratio:
        raise InputError(what, "the ratio is not a whole number of 2 or more")
    nyquist = out_hz / 2
    stages, rate = [], rate_hz
    while ratio > 1:
        factor = next((f for f in FACTORS if ratio % f == 0), 0)
        if not factor:
            raise InputError(what, f"the factor {ratio} cannot be split into stages")
        stop = rate / factor - nyquist
        stages.append(Stage(rate, factor, _taps(rate, pass_fraction * nyquist, stop)))
        rate, ratio = rate / factor, ratio // factor
    return tuple(stages)


def _taps(rate_hz: float, pass_hz: float, stop_hz: float) -> FloatArray:
    """Return a Kaiser low pass of odd length whose coefficients add up to one."""
    count, beta = kaiserord(REJECTION_DB, (stop_hz - pass_hz) / (rate_hz / 2))
    count += 1 - count % 2
    taps = firwin(count, (pass_hz + stop_hz) / 2, window=("kaiser", beta), fs=rate_hz)
    return np.asarray(taps / math.fsum(taps))


class _Line:
    """One stage with the samples that it still needs; ``base`` is the index of the first."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.reset()

    def reset(self) -> None:
        """Forget everything: what comes next does not follow on what was."""
        self.base = self.centre = 0
        self.times: IntArray = np.zeros(0, np.int64)
        self.values: FloatArray = np.zeros((0, 0))
        self.started = False

    def push(self, times: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return what can be said now; empty while the filter is not full."""
        stage = self.stage
        if not len(times):
            return times, values
        if not self.started:
            self.started, self.centre = True, _first_centre(int(times[0]), stage)
            self.values = values[:0]
        self.times = np.concatenate([self.times, times])
        self.values = np.concatenate([self.values, values])
        end = self.base + len(self.times) - stage.half
        centres = np.arange(self.centre, end, stage.factor) - self.base
        kept, out = self.times[centres], np.zeros((0, values.shape[1]))
        if len(centres):
            windows = sliding_window_view(self.values, len(stage.taps), axis=0)
            out = windows[centres - stage.half] @ stage.taps
            self.centre += stage.factor * len(centres)
        begin = min(max(self.centre - stage.half - self.base, 0), len(self.times))
        self.times, self.values = self.times[begin:], self.values[begin:]
        self.base += begin
        return kept, out


def _first_centre(start_ns: int, stage: Stage) -> int:
    """Return the first index with data on both sides, nearest to the grid of the kept samples.

    The grid has a sample at every whole GPS (and UTC) second where the rate is whole.
    """
    interval = NS_PER_S / stage.rate_hz
    kept = interval * stage.factor
    phase = round((-start_ns % kept) / interval) % stage.factor
    return phase + -(-max(stage.half - phase, 0) // stage.factor) * stage.factor


class Decimator:
    """Applies the stages to runs as they come, any chunking.

    Parameters
    ----------
    rate_hz, out_hz, pass_fraction : float
        As for `design_stages`.
    """

    def __init__(self, rate_hz: float, out_hz: float, pass_fraction: float) -> None:
        self.out_hz = out_hz
        self.stages = design_stages(rate_hz, out_hz, pass_fraction)
        self._lines = [_Line(stage) for stage in self.stages]
        self._said = False

    @property
    def reach_s(self) -> float:
        """Length of data that an output needs on either side [s]."""
        return sum(stage.half / stage.rate_hz for stage in self.stages)

    def push(self, run: Run) -> Run | None:
        """Return the kept samples that this run completes; None where there are none."""
        if not run.continues:
            self._said = False
            for line in self._lines:
                line.reset()
        times, values = run.gps_ns, run.values
        for line in self._lines:
            times, values = line.push(times, values)
        if not len(times):
            return None
        continues, self._said = self._said, True
        return Run(times, values, self.out_hz, continues)
