"""Fine Doppler, code phase and C/N0 of a satellite found, and its removal from the signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from deepseis_tracking import acquisition_signal as sig
from deepseis_tracking import acquisition_statistics as stat

BIT_MS = 20
PERIOD = 1e-3
DOPPLER_STEP_HZ = 6.25
CODE_STEP_CHIPS = 0.125
DOPPLER_FLOOR_HZ = 0.5
"""Interpolation error of the Doppler [Hz]."""


@dataclass(frozen=True)
class FineEstimate:
    """Refined parameters at the first sample of the stretch; C/N0 is linear [Hz]."""

    code_phase_chips: float
    carrier_doppler_hz: float
    doppler_sd_hz: float
    cn0_hz: float


def refine(
    conditioned: sig.Conditioned,
    replica: sig.Complex64Array,
    code_phase_chips: float,
    doppler_hz: float,
    half_width_hz: float,
) -> FineEstimate:
    """Refine a cell of the coarse search.

    The signal is despread by code periods that start at code epochs, where data bits change.
    Over the 20 possible bit edges and a Doppler grid the likelihood for unknown bit phases ::

        sum_b (|S_b(f)|**2 / (n_b sigma**2) - 1)

    is maximised, ``S_b`` being the coherent sum over bit ``b`` of ``n_b`` periods. Its maximum is
    C/N0 times the duration; with the same bits and Doppler the code phase is interpolated.
    """
    size = len(replica)
    start, phase = first_epoch(code_phase_chips, size)
    count = (len(conditioned.signal) - start) // size
    blocks = np.empty((count, size), np.complex64)
    part = sig.Conditioned(conditioned.signal[start:], conditioned.rate_hz, conditioned.is_real)
    sig.fold(part.signal, part.rate_hz, doppler_hz, size, 1, blocks)
    spectra = fft.fft(blocks, axis=1, overwrite_x=True, norm="forward", workers=1)
    times = (start + (np.arange(count) + 0.5) * size) / part.rate_hz
    slip = sig.code_slip(doppler_hz, part.rate_hz, size, times)
    aligned = np.empty_like(spectra)
    sig.shift_and_align(spectra, 0, slip, aligned)

    offsets = np.arange(-8, 9) * CODE_STEP_CHIPS
    prompts = aligned @ _delayed(replica, phase + offsets).conj().T
    noise = float(np.mean((np.abs(aligned) ** 2) @ (np.abs(replica) ** 2)))
    power, edge, frequency, phasors = _best_bits(prompts[:, len(offsets) // 2], half_width_hz)
    spans = bit_spans(count, edge)
    over_code = np.sum(np.abs(_bit_sums(prompts * phasors[:, None], edge)) ** 2 / spans, axis=0)
    delay = offsets[0] + CODE_STEP_CHIPS * _vertex(over_code)

    reference = stat.reference_cells(replica)
    excess = power - len(spans) * noise
    noise -= excess / count / reference  # the peak's own share of the mean over all cells
    cn0_hz = max((power / noise - len(spans)) / (count * PERIOD), 1.0)
    cn0_hz /= stat.band_fraction(replica)
    deviation = np.hypot(stat.doppler_crlb_hz(cn0_hz, spans[:, 0] * PERIOD), DOPPLER_FLOOR_HZ)
    resolution_hz = 1 / (PERIOD * float(spans.max()))
    if conditioned.is_real and abs(doppler_hz + frequency) < resolution_hz:
        deviation = resolution_hz / 2  # the lines at +f and -f run into each other
    return FineEstimate(
        float((code_phase_chips + delay) % sig.CODE_LENGTH),
        float(doppler_hz + frequency),
        float(deviation),
        float(cn0_hz),
    )


def first_epoch(code_phase_chips: float, size: int) -> tuple[int, float]:
    """Return the first sample at or after a code epoch, and the code phase there [chips]."""
    exact = (-code_phase_chips % sig.CODE_LENGTH) * size / sig.CODE_LENGTH
    start = int(np.ceil(exact))
    return start, (start - exact) * sig.CODE_LENGTH / size


def _delayed(replica: sig.Complex64Array, phases: sig.RealArray) -> sig.Complex64Array:
    """Return the replica at several code phases [chips], a row each."""
    size = len(replica)
    harmonic = np.fft.fftfreq(size, 1 / size)
    ramp = np.exp(2j * np.pi * np.outer(phases, harmonic) / sig.CODE_LENGTH)
    return (replica * ramp).astype(np.complex64)


def bit_edges(count: int, edge: int) -> NDArray[np.int64]:
    """Return the bounds of the data bits in ``count`` periods, one bit starting at ``edge``."""
    inner = np.arange(edge if edge else BIT_MS, count, BIT_MS)
    return np.concatenate(([0], inner, [count]))


def bit_spans(count: int, edge: int) -> NDArray[np.float64]:
    """Return the periods in each data bit, shape (bits, 1).

    Examples
    --------
    >>> bit_spans(50, 5).ravel()
    array([ 5., 20., 20.,  5.])
    """
    return np.diff(bit_edges(count, edge)).astype(np.float64)[:, None]


def _bit_sums(prompts: NDArray[Any], edge: int) -> NDArray[Any]:
    return np.add.reduceat(prompts, bit_edges(len(prompts), edge)[:-1], axis=0)


def _best_bits(
    prompt: sig.Complex64Array, half_width_hz: float
) -> tuple[float, int, float, NDArray[np.complex128]]:
    """Return the best ``sum |S_b|**2 / n_b``, its bit edge, Doppler and wipe-off phasors."""
    reach = int(np.ceil(half_width_hz / DOPPLER_STEP_HZ))
    grid = np.arange(-reach, reach + 1) * DOPPLER_STEP_HZ
    times = np.arange(len(prompt)) * PERIOD
    rotated = prompt[:, None] * np.exp(-2j * np.pi * np.outer(times, grid))
    mean_power = float(np.mean(np.abs(prompt) ** 2))
    best: tuple[float, int, float, float] = (-np.inf, 0, 0.0, 0.0)
    for edge in range(min(BIT_MS, len(prompt))):
        spans = bit_spans(len(prompt), edge)
        power = np.sum(np.abs(_bit_sums(rotated, edge)) ** 2 / spans, axis=0)
        score = float(power.max()) - len(spans) * mean_power
        if score > best[0]:
            frequency = grid[0] + DOPPLER_STEP_HZ * _vertex(power)
            best = (score, edge, frequency, float(power.max()))
    return best[3], best[1], best[2], np.exp(-2j * np.pi * times * best[2])


def _vertex(values: NDArray[np.float64]) -> float:
    """Return the fractional index of the maximum, by a parabola through its neighbours."""
    top = int(np.clip(np.argmax(values), 1, len(values) - 2))
    before, at, after = values[top - 1 : top + 2]
    curvature = before - 2 * at + after
    shift = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
    return top + float(np.clip(shift, -1.0, 1.0))


def cancel(
    conditioned: sig.Conditioned,
    replica: sig.Complex64Array,
    code_phase_chips: float,
    doppler_hz: float,
) -> sig.Conditioned:
    """Remove a satellite: subtract its replica, fitted to each code period by itself."""
    size = len(replica)
    start, phase = first_epoch(code_phase_chips, size)
    length = len(conditioned.signal)
    count = -(-(length + size - start) // size)
    padded = np.zeros(count * size, np.complex64)
    inside = slice(size - start, size - start + length)
    padded[inside] = conditioned.signal
    index = np.arange(len(padded)) - (size - start)
    mixer = np.exp(2j * np.pi * np.mod(doppler_hz / conditioned.rate_hz * index, 1))
    times = (index[::size] + size / 2) / conditioned.rate_hz
    slip = sig.code_slip(doppler_hz, conditioned.rate_hz, size, times)
    wave = fft.ifft(_delayed(replica, phase + slip), axis=1, norm="forward").ravel() * mixer
    wave[: inside.start], wave[inside.stop :] = 0, 0
    wave, blocks = wave.reshape(count, size), padded.reshape(count, size)
    energy = np.sum(np.abs(wave) ** 2, axis=1)
    fitted = np.sum(blocks * wave.conj(), axis=1) / np.maximum(energy, 1e-9)
    part = fitted[:, None] * wave
    if conditioned.is_real:
        part = 2 * part.real
    cleaned = (blocks - part).astype(np.complex64).ravel()[inside]
    return sig.Conditioned(cleaned, conditioned.rate_hz, conditioned.is_real)
