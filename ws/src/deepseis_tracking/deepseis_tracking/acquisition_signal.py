"""Conditioning of the samples and replica spectra for the code search.

All spectra have one bin a kHz (one code period), ``size`` bins, FFT order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

CODE_LENGTH = 1023
CODE_RATE_CPS = 1.023e6
CARRIER_PER_CHIP = 1540.0
"""Carrier cycles per chip: code Doppler is carrier Doppler over this."""

Complex64Array = NDArray[np.complex64]
RealArray = NDArray[np.floating[Any]]
SampleArray = NDArray[np.int8] | NDArray[np.int16]

SPUR_POWER = 200.0
"""A spectral line this far above the median is a spur: C/A lines reach a few tens."""


def replica_spectrum(chips: NDArray[np.int8], size: int) -> Complex64Array:
    """Return the Fourier series of the C/A waveform, without aliasing.

    Chip ``i`` is a rectangle over code phase ``[i, i + 1)``; the coefficient of harmonic ``k``
    is the discrete spectrum of the chips times ``sinc(k/1023) exp(-j pi k/1023)``.

    Parameters
    ----------
    chips : ndarray of int8, shape (1023,)
        The code, +1 and -1.
    size : int
        Bins kept, one a kHz.
    """
    harmonic = np.fft.fftfreq(size, 1 / size).astype(np.int64)
    discrete = np.fft.fft(chips.astype(np.float64)) / CODE_LENGTH
    pulse = np.sinc(harmonic / CODE_LENGTH) * np.exp(-1j * np.pi * harmonic / CODE_LENGTH)
    return (discrete[harmonic % CODE_LENGTH] * pulse).astype(np.complex64)


@dataclass(frozen=True)
class Conditioned:
    """Band-limited signal at the working rate; element 0 is the first sample given."""

    signal: Complex64Array
    rate_hz: float
    is_real: bool


def condition(
    baseband_i: SampleArray, baseband_q: SampleArray, sample_rate_hz: float, size: int
) -> Conditioned:
    """Resample to ``size`` samples a millisecond by one FFT, with narrow spurs cut out.

    Bins outside the working band are dropped (or zeros added where the input is slower), which
    removes the image of a real front end too. A duration that is no whole number of samples is
    rounded; ``rate_hz`` is the rate that this gives.
    """
    count = len(baseband_i)
    samples = np.empty(count, np.complex64)
    samples.real, samples.imag = baseband_i, baseband_q
    out_count = round(count / sample_rate_hz * size * 1000)
    spectrum = fft.fft(samples, overwrite_x=True, workers=1)
    half = min(count, out_count) // 2
    kept = np.zeros(out_count, np.complex64)
    kept[:half], kept[-half:] = spectrum[:half], spectrum[-half:]
    _cut_spurs(kept, half)
    signal = fft.ifft(kept, overwrite_x=True, workers=1)
    rate_hz = out_count * sample_rate_hz / count
    return Conditioned(signal, rate_hz, not np.any(baseband_q))


def _cut_spurs(spectrum: Complex64Array, half: int) -> None:
    """Zero the bins that stand far above the median of the band (DC offset, clock harmonics)."""
    for part in (spectrum[:half], spectrum[-half:]):
        power = part.real**2 + part.imag**2
        part[power > SPUR_POWER * np.median(power) / np.log(2)] = 0


def code_slip(doppler_hz: float, rate_hz: float, size: int, times: RealArray) -> RealArray:
    """Return by how much the code has gained on the working grid at ``times`` [chips].

    The grid takes ``size`` samples for one period; the code runs at ``1.023e6 + doppler/1540``.
    """
    grid_rate = CODE_LENGTH * rate_hz / size
    return (CODE_RATE_CPS - grid_rate + doppler_hz / CARRIER_PER_CHIP) * times


@njit(cache=True, nogil=True)
def fold(signal, rate_hz, doppler_hz, size, coherent, out):  # type: ignore[no-untyped-def]
    """Mix by ``-doppler_hz`` and add the periods of each coherent block into one period."""
    step = np.exp(-2j * np.pi * doppler_hz / rate_hz)
    for block in range(out.shape[0]):
        out[block, :] = 0
        for period in range(coherent):
            first = (block * coherent + period) * size
            phasor = np.exp(-2j * np.pi * np.fmod(doppler_hz / rate_hz * first, 1.0))
            for i in range(size):
                out[block, i] += signal[first + i] * np.complex64(phasor)
                phasor *= step


@njit(cache=True, nogil=True)
def shift_and_align(spectra, shift, chip_slip, out):  # type: ignore[no-untyped-def]
    """Move the spectra down by ``shift`` bins and the code back by ``chip_slip`` chips a row."""
    rows, size = spectra.shape
    for row in range(rows):
        angle = -2 * np.pi * chip_slip[row] / 1023.0
        step = np.exp(1j * angle)
        phasor = np.exp(-1j * angle * (size // 2))
        for i in range(size):
            k = i - size // 2
            out[row, k % size] = spectra[row, (k + shift) % size] * np.complex64(phasor)
            phasor *= step


@njit(cache=True, nogil=True)
def accumulate(correlation, first, stride, guard, power):  # type: ignore[no-untyped-def]
    """Sum squared magnitudes over every ``stride``-th row from ``first``.

    Returns the index of the largest cell, its power, and the mean of the cells more than
    ``guard`` away from it.
    """
    rows, size = correlation.shape
    power[:] = 0
    for row in range(first, rows, stride):
        for i in range(size):
            value = correlation[row, i]
            power[i] += value.real * value.real + value.imag * value.imag
    peak = np.argmax(power)
    total = 0.0
    for i in range(size):
        total += power[i]
    for i in range(peak - guard, peak + guard + 1):
        total -= power[i % size]
    return peak, power[peak], total / (size - 2 * guard - 1)
