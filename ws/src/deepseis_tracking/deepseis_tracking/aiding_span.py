"""Aiding of one satellite, joined over the last blocks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepseis_core.types import Aiding, FloatArray
from deepseis_tracking.channel_state import AID
from deepseis_tracking.nco import aid_growth

KEPT_S = 1.2
"""Of the past: longer than from the acquisition's samples to the hand-over, a slot later [s]."""

STEPPED = "stepped"
REASONS = ("invalid", "uncertain", STEPPED, "late", "diverged")
"""Why aiding of a channel ends, or goes on without the step that it made."""
ISOLATED = 5.0
"""A step is kept out that is so many times as large as what is left of those before: corrections
with every message undo a drift, and without them the loop would see it."""
STEPS_S = 0.04
"""Memory of steps [s]: those of PVT, 0.1 s apart, are single ones, of 50 Hz they are not."""
SWING_HZ_S2 = 2000.0
"""Beyond a hole steps are told from a motion that swings so [Hz/s^2]: 3 g at 2 Hz."""


class AidLimits(NamedTuple):
    """Of the sigma, beyond which aiding is not used, and of steps, which are kept out [Hz]."""

    sd_hz: float
    step_hz: float


class AidingSpan:
    """Knots of one satellite, the last ones known.

    Parameters
    ----------
    sample_rate_hz : float
        [Hz]

    Attributes
    ----------
    record : ndarray of AID, shape (1,)
        As the compiled channel takes it.
    knots, rates : ndarray
        Doppler [Hz] and its rate [Hz/s] at the uniform knots.
    offset_hz : float
        What has been added to the predictions since they became valid: less the steps that they
        made [Hz].
    """

    def __init__(self, sample_rate_hz: float) -> None:
        self.sample_rate_hz = sample_rate_hz
        self.record = np.zeros(1, AID)
        self.record["step"], self.record["through"] = 1, -1
        self.record["clock_hz"] = np.nan
        self.knots: FloatArray = np.zeros(0)
        self.rates: FloatArray = np.zeros(0)
        self.offset_hz = self._steps_hz = 0.0

    @property
    def valid(self) -> bool:
        """Whether it may be used."""
        return bool(self.record["valid"][0])

    @valid.setter
    def valid(self, valid: bool) -> None:
        self.record["valid"] = valid

    @property
    def through(self) -> int:
        """Last sample that aiding has been given for."""
        return int(self.record["through"][0])

    def growth(self, begin: int, end: int) -> float:
        """Growth of the Doppler between two samples [Hz]; 0 where they are not both known."""
        aid = self.record[0]
        if not len(self.knots) or begin < aid["first"]:
            return 0.0
        return float(aid_growth(float(begin), float(end), aid, self.rates, self.sample_rate_hz))

    def take(self, aiding: Aiding, satellite: str, limits: AidLimits) -> str:
        """Append the satellite's knots of a message.

        A single step of the prediction corrects what it had been wrong by, and the loop has held
        that already: the step is kept out, whatever form the aiding has.

        Parameters
        ----------
        aiding : Aiding
        satellite : str
        limits : AidLimits

        Returns
        -------
        str
            What became of aiding that was valid, one of `REASONS`; "" where it just goes on.
        """
        was_valid = self.valid
        if reason := _fault(aiding, satellite, limits):
            self.valid = False
            return reason if was_valid else ""
        row = aiding.satellites.index(satellite)
        knots, stepped = aiding.carrier_doppler_hz[row], False
        if not was_valid:
            self.offset_hz = self._steps_hz = 0.0
        else:
            step = float(knots[0]) + self.offset_hz - self._predicted(aiding.knot_sample_index)
            stepped = self._is_single(step, aiding, limits.step_hz)
            self.offset_hz -= step if stepped else 0.0
        self._append(aiding, knots + self.offset_hz, aiding.carrier_doppler_rate[row])
        self.record["through"] = aiding.valid_through
        self.record["clock_hz"] = aiding.clock_drift_hz
        self.valid = True
        return STEPPED if stepped else ""

    def _is_single(self, step: float, aiding: Aiding, limit_hz: float) -> bool:
        """Tell whether a step is one to be kept out, and remember it."""
        single = abs(step) > limit_hz + self._swing_hz(aiding.knot_sample_index)
        single = single and abs(step) > ISOLATED * self._steps_hz
        seconds = (aiding.valid_through - self.through) / self.sample_rate_hz
        self._steps_hz = max(abs(step), self._steps_hz * math.exp(-seconds / STEPS_S))
        return single

    def _swing_hz(self, sample: int) -> float:
        """Return by what a straight Doppler may be off at a knot beyond the last [Hz]."""
        aid, last = self.record[0], len(self.knots) - 1
        hole = max(0, sample - int(aid["first"]) - last * int(aid["step"])) / self.sample_rate_hz
        return 0.5 * SWING_HZ_S2 * hole**2

    def _predicted(self, sample: int) -> float:
        """Doppler that the knots at hand have for a knot of the same grid [Hz]."""
        if not len(self.knots):
            return 0.0
        aid = self.record[0]
        place = (sample - int(aid["first"])) / int(aid["step"])
        near = min(max(round(place), 0), len(self.knots) - 1)
        span = (place - near) * int(aid["step"]) / self.sample_rate_hz
        return float(self.knots[near] + span * self.rates[near])

    def _append(self, aiding: Aiding, knots: FloatArray, rates: FloatArray) -> None:
        """Join knots on to those at hand, if they lie on the same grid without a hole."""
        first, step = aiding.knot_sample_index, aiding.knot_step_samples
        old_first, old_step = int(self.record["first"][0]), int(self.record["step"][0])
        count = len(self.knots)
        overlap = old_first + count * old_step - first if count else -1
        if step == old_step and overlap % step == 0 and 0 <= overlap <= count * step:
            old = count - overlap // step
            keep = round(KEPT_S * self.sample_rate_hz / step)
            low = max(0, old - keep)
            knots = np.concatenate([self.knots[low:old], knots])
            rates = np.concatenate([self.rates[low:old], rates])
            first = old_first + low * step
        self.knots, self.rates = knots, rates
        self.record["first"], self.record["step"] = first, step


def _fault(aiding: Aiding, satellite: str, limits: AidLimits) -> str:
    """Return why a satellite's aiding cannot be used, or ""."""
    if not aiding.valid or satellite not in aiding.satellites:
        return "invalid"
    if aiding.knot_count < 1 or aiding.knot_step_samples < 1:
        return "invalid"
    row = aiding.satellites.index(satellite)
    for table in (aiding.carrier_doppler_hz, aiding.carrier_doppler_rate):
        if not np.isfinite(table[row]).all():
            return "invalid"
    return "" if aiding.doppler_sd_hz[row] <= limits.sd_hz else "uncertain"
