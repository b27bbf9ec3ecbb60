"""Jammers: a carrier (CW) or band-limited Gaussian noise beside the satellites' signals.

Power is given over the noise's density, J/N0 [dB-Hz]: with the satellites' C/N0 that gives the
jammer-to-signal ratio ``J/S = J/N0 - C/N0`` [dB] (:meth:`JammerConfig.jammer_to_signal_db`). The
frequency is that by the receiver's clock: an oscillator's error shifts the satellites against it.

Band-limited noise is white noise at ``fs / D`` put through a low-pass of ``D * TAPS`` taps, D a
power of two, then moved to its frequency. Both the noise and the carrier's fixed-point phase are
functions of the absolute sample, so that no sample depends on where a chunk begins. At the nominal
bandwidth's edges the power's density is a quarter of that within (6 dB down); outside it falls
within a quarter of the bandwidth to 60 dB down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from deepseis_core.baseband import phase_increment
from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import Float32Array, FloatArray
from deepseis_sim.jammer_kernel import LARGEST_FACTOR, TAPS, Jammers

JAMMER_STREAM: Final = 7401
"""Stream of the random numbers of jammers."""


@dataclass(frozen=True)
class JammerConfig:
    """Settings of one jammer.

    Its level is ``j_to_n0_dbhz``, plus ``offsets_db`` at ``times_s`` with straight lines between
    (and the first and last value beyond), while it is on.
    """

    kind: str = setting("cw", "a carrier, or noise in a band", choices=("cw", "band"))
    frequency_offset_hz: float = setting(0.0, "middle frequency, from L1 [Hz]")
    bandwidth_hz: float = setting(1e6, "bandwidth of the noise [Hz]", low=1.0)
    j_to_n0_dbhz: float = setting(
        80.0, "power over the noise's density [dB-Hz]", low=-50.0, high=150.0
    )
    start_s: float = setting(0.0, "it goes on [s]", low=0.0)
    stop_s: float = setting(0.0, "it goes off; 0: never [s]", low=0.0)
    times_s: tuple[float, ...] = setting((), "moments of the level's profile [s]")
    offsets_db: tuple[float, ...] = setting((), "level at these moments, added [dB]")

    def level_dbhz(self, time: FloatArray) -> FloatArray:
        """Return J/N0 at seconds since the start [dB-Hz]; minus infinity: off."""
        level = np.full(time.shape, self.j_to_n0_dbhz)
        if self.times_s:
            level += np.interp(time, self.times_s, self.offsets_db)
        stop = self.stop_s if self.stop_s > 0.0 else np.inf
        return np.where((time >= self.start_s) & (time < stop), level, -np.inf)

    def jammer_to_signal_db(self, cn0_dbhz: float) -> float:
        """Return J/S against a satellite of a C/N0, the profile left out [dB]."""
        return self.j_to_n0_dbhz - cn0_dbhz

    def check(self, sample_rate_hz: float, intermediate_frequency_hz: float, real: bool) -> None:
        """Refuse what makes no sense, or what a front end's filter would not let in.

        Raises
        ------
        InputError
        """
        ordered = all(a < b for a, b in pairwise(self.times_s))
        if len(self.times_s) != len(self.offsets_db) or not ordered:
            raise InputError("jammer", "times_s must rise, with one of offsets_db each")
        if self.stop_s and self.stop_s <= self.start_s:
            raise InputError("jammer", "goes off before it goes on")
        width = self.bandwidth_hz if self.kind == "band" else 0.0
        # The band that is sampled: fs around a multiple of fs, or one between those of fs / 2.
        room = sample_rate_hz / 2.0 if real else sample_rate_hz
        zones = intermediate_frequency_hz / room
        middle = (math.floor(zones) + 0.5 if real else round(zones)) * room
        offset = self.frequency_offset_hz + intermediate_frequency_hz - middle
        if not abs(offset) + width / 2.0 <= room / 2.0:
            raise InputError("jammer", "lies outside of the sampled band", "check its frequency")
        if self.kind == "band" and width < narrowest_band_hz(sample_rate_hz):
            lowest = narrowest_band_hz(sample_rate_hz)
            raise InputError("jammer", f"has a band narrower than {lowest:.6g} Hz", "use kind: cw")


def narrowest_band_hz(sample_rate_hz: float) -> float:
    """Return the least bandwidth that the filters make."""
    return 0.25 * sample_rate_hz / LARGEST_FACTOR


def band_taps(bandwidth_hz: float, sample_rate_hz: float) -> tuple[int, Float32Array]:
    """Design the low-pass of a band.

    Parameters
    ----------
    bandwidth_hz, sample_rate_hz : float

    Returns
    -------
    factor : int
        Samples for each value of the slower noise, a power of two.
    taps : ndarray of float32, shape (factor, TAPS)
        Row p: what sample ``m * factor + p`` takes of values m, m - 1, ... A windowed sinc; unit
        noise goes in, noise of unit mean variance comes out.
    """
    factor = 1
    while factor < LARGEST_FACTOR and sample_rate_hz / (2 * factor) >= 2.0 * bandwidth_hz:
        factor *= 2
    count = factor * TAPS
    n = np.arange(count) - (count - 1) / 2.0
    taps = np.sinc(bandwidth_hz / sample_rate_hz * n) * np.kaiser(count, 6.0)
    taps *= np.sqrt(factor / np.sum(taps**2))
    return factor, np.ascontiguousarray(taps.reshape(TAPS, factor).T.astype(np.float32))


class JammerBank:
    """The jammers of a front end, made ready for the kernel.

    Parameters
    ----------
    jammers : sequence of JammerConfig
    sample_rate_hz, intermediate_frequency_hz : float
    mirrored : bool
        Whether the front end mirrors the spectrum.
    real : bool
        Whether samples are real.
    seed : int

    Raises
    ------
    InputError
        Where a jammer makes no sense for this front end.
    """

    def __init__(
        self,
        jammers: Sequence[JammerConfig],
        sample_rate_hz: float,
        intermediate_frequency_hz: float,
        *,
        mirrored: bool = False,
        real: bool = False,
        seed: int = 0,
    ) -> None:
        sign = -1.0 if mirrored else 1.0
        seen = [replace(j, frequency_offset_hz=sign * j.frequency_offset_hz) for j in jammers]
        for item in seen:
            item.check(sample_rate_hz, intermediate_frequency_hz, real)
        self._jammers, count = seen, len(seen)
        self._one = np.sqrt((4.0 if real else 2.0) / sample_rate_hz)
        self._factor, self._increment = np.zeros(count, np.int64), np.zeros(count, np.uint64)
        self._taps = np.zeros((count, LARGEST_FACTOR, TAPS), np.float32)
        random = np.zeros((count, 2), np.uint64)
        for k, item in enumerate(seen):
            frequency = item.frequency_offset_hz + intermediate_frequency_hz
            self._increment[k] = phase_increment(frequency, sample_rate_hz)
            sequence = np.random.SeedSequence([seed & (2**64 - 1), JAMMER_STREAM, k])
            random[k] = sequence.generate_state(2, np.uint64)
            if item.kind == "band":
                factor, taps = band_taps(item.bandwidth_hz, sample_rate_hz)
                self._factor[k], self._taps[k, :factor] = factor, taps
        self._seed, self._phase = random[:, 0].copy(), random[:, 1].copy()

    def power_hz(self, time: FloatArray) -> FloatArray:
        """Return the power of all over the noise's density at seconds (m,) [Hz]."""
        total = np.zeros(time.shape)
        for item in self._jammers:
            total += 10.0 ** (item.level_dbhz(time) / 10.0)
        return total

    def at(self, time: FloatArray) -> Jammers:
        """Return the kernel's input for segments with their middle at seconds (m,)."""
        amplitude = np.zeros((len(self._jammers), time.size))
        for row, item in zip(amplitude, self._jammers, strict=True):
            # A carrier of amplitude A has the power of noise of variance A^2 / 2 a component.
            row[:] = self._one * 10.0 ** (item.level_dbhz(time) / 20.0)
            row /= np.sqrt(2.0) if item.kind == "band" else 1.0
        return Jammers(
            self._increment, self._phase, amplitude, self._factor, self._taps, self._seed
        )
