"""Acquisition of GPS L1 C/A: which satellites are there, at what code phase and Doppler."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_tracking import acquisition_codes as codes
from deepseis_tracking import acquisition_fine as fine
from deepseis_tracking import acquisition_signal as sig
from deepseis_tracking import acquisition_statistics as stat

PERIOD = 1e-3
"""Duration of one C/A code period [s]."""
GUARD = 4
"""Cells on either side of a peak kept out of the noise estimate."""
LEAK_DB = 21.6
"""Largest cross-correlation of C/A codes at any Doppler, below the stronger one [dB]."""
LEAK_SUM_DB = 6.0
"""Margin for leaks that add up and for noise on top of them [dB]."""
STRONG_DB = 8.0
"""Signals that far above the weakest detectable one are removed as possible sources [dB]."""
REMOVALS = 3
"""How often a satellite is removed if it is still there: lost samples shift its code phase."""
OTHERS_NARROWER_HZ = 3200.0
"""QZSS and SBAS have that much less Doppler than GPS."""
STRONGEST_DBHZ = 56.0
"""Nothing on L1 C/A comes in stronger [dB-Hz]: sets which detections may be leaks of others."""

_Rows = Mapping[str, NDArray[np.int64]]


@dataclass(frozen=True)
class AcquisitionConfig:
    """Settings of the search."""

    coherent_ms: int = setting(4, "coherent integration [ms]", low=1, high=10)
    noncoherent_count: int = setting(25, "non-coherent sums [-]", low=1, high=1000)
    doppler_span_hz: float = setting(
        5000.0, "half width of the Doppler search [Hz]", low=0.0, high=50e3
    )
    doppler_centre_hz: float = setting(
        0.0, "centre of the Doppler search: the oscillator's offset [Hz]", low=-50e3, high=50e3
    )
    false_alarm_probability: float = setting(
        1e-6, "per satellite over all cells [-]", low=1e-12, high=0.5
    )
    alternate_blocks: bool = setting(
        False, "sum odd and even blocks apart, take the better: 10 ms between data bits"
    )
    search_interferers: bool = setting(
        True, "look for who else could have caused a weak detection: other GPS, QZSS, SBAS"
    )
    samples_per_ms: int = setting(2048, "working rate [samples/ms]", low=2048, high=4096)


@dataclass(frozen=True)
class Detection:
    """One satellite found, or searched for in vain; fields as in ``AcquisitionResult``."""

    satellite: str
    detected: bool
    sample_index: int
    code_phase_chips: float
    carrier_doppler_hz: float
    doppler_sd_hz: float
    statistic: float
    threshold: float
    false_alarm_probability: float
    cn0_dbhz: float


@dataclass
class _Peak:
    """Largest cell so far of one satellite."""

    statistic: float = 0.0
    cell: int = 0
    doppler_hz: float = 0.0
    rows: int = 0


class Acquirer:
    """Parallel code-phase search over Doppler rows, then fine estimates.

    A stretch of ``coherent_ms * noncoherent_count`` ms is resampled once. In each Doppler row
    coherent blocks are folded into one code period, correlated with each code by FFT, and their
    squared magnitudes added with the code's own Doppler taken out.

    Parameters
    ----------
    sample_rate_hz : float
        Of the baseband samples.
    config : AcquisitionConfig, optional
        Settings.

    Examples
    --------
    >>> Acquirer(4e6).samples_needed
    400000
    """

    def __init__(self, sample_rate_hz: float, config: AcquisitionConfig | None = None) -> None:
        self.config = config or AcquisitionConfig()
        check(self.config)
        self.sample_rate_hz = sample_rate_hz
        duration = self.config.coherent_ms * self.config.noncoherent_count * PERIOD
        self.samples_needed = int(np.ceil(round(sample_rate_hz * duration, 6)))
        self._coherent_s = self.config.coherent_ms * PERIOD
        self._row_hz = 0.5 / self._coherent_s
        self._size = self.config.samples_per_ms
        self._replicas: dict[str, sig.Complex64Array] = {}
        self._product = np.empty((self.config.noncoherent_count, self._size), np.complex64)
        self._power = np.empty(self._size)

    def search(
        self,
        baseband_i: sig.SampleArray,
        baseband_q: sig.SampleArray,
        sample_index: int,
        satellites: Sequence[str] = codes.GPS,
        doppler_windows: Mapping[str, tuple[float, float]] | None = None,
    ) -> list[Detection]:
        """Search for satellites in the first ``samples_needed`` samples.

        Parameters
        ----------
        baseband_i, baseband_q : ndarray of int8 or int16
            Complex baseband at zero IF. ``baseband_q`` all zero marks a real signal: it holds
            every satellite at plus and minus its Doppler, and the one nearer to
            ``doppler_centre_hz`` is reported.
        sample_index : int
            Index of the first sample; code phases and Dopplers refer to it.
        satellites : sequence of str
            Names, "G01" to "G32".
        doppler_windows : mapping, optional
            (low, high) [Hz] of satellites whose Doppler is known better than the settings say.

        Returns
        -------
        list of Detection
            One for each satellite, in the order asked.
        """
        if min(len(baseband_i), len(baseband_q)) < self.samples_needed:
            raise InputError(
                "acquisition",
                f"needs {self.samples_needed} samples, got {len(baseband_i)}",
                "give a longer stretch or lower noncoherent_count",
            )
        stretch = slice(0, self.samples_needed)
        conditioned = sig.condition(
            baseband_i[stretch], baseband_q[stretch], self.sample_rate_hz, self._size
        )
        rows = {
            name: self._rows(name, doppler_windows, conditioned.is_real) for name in satellites
        }
        peaks = self._search_rows(conditioned, rows)
        found = {name: self._judge(conditioned, name, peak) for name, peak in peaks.items()}
        found |= self._confirm(conditioned, found, rows)
        return [replace(found[name], sample_index=sample_index) for name in satellites]

    def _rows(
        self,
        satellite: str,
        windows: Mapping[str, tuple[float, float]] | None,
        is_real: bool,
    ) -> NDArray[np.int64]:
        """Return the Doppler rows to search, in steps of half the coherent bandwidth."""
        centre, span = self.config.doppler_centre_hz, self.config.doppler_span_hz
        low, high = (windows or {}).get(satellite, (centre - span, centre + span))
        first, last = np.floor(low / self._row_hz), np.ceil(high / self._row_hz)
        rows = np.arange(int(first), int(last) + 1)
        if is_real:  # rows f and -f are the same numbers
            side = -1 if centre < 0 else 1
            rows = rows[(rows * side >= 0) | (-rows < rows[0]) | (-rows > rows[-1])]
        return rows

    def _replica(self, satellite: str) -> sig.Complex64Array:
        if satellite not in self._replicas:
            self._replicas[satellite] = sig.replica_spectrum(codes.code(satellite), self._size)
        return self._replicas[satellite]

    def _search_rows(self, conditioned: sig.Conditioned, rows: _Rows) -> dict[str, _Peak]:
        """Return the largest cell of each satellite over its rows."""
        config, size = self.config, self._size
        peaks = {name: _Peak(rows=len(own)) for name, own in rows.items()}
        matched = {name: np.conj(self._replica(name)) for name in rows}
        wanted = {name: frozenset(own.tolist()) for name, own in rows.items()}
        every = sorted(frozenset().union(*wanted.values()))
        blocks = np.empty((config.noncoherent_count, size), np.complex64)
        aligned, spectra = np.empty_like(blocks), np.empty_like(blocks)
        times = (np.arange(len(blocks)) + 0.5) * self._coherent_s
        rows_per_khz = 2 * config.coherent_ms
        current = -1
        for row in sorted(every, key=lambda r: (r % rows_per_khz, r)):
            shift, fraction = divmod(row, rows_per_khz)
            if fraction != current:
                sig.fold(
                    conditioned.signal, conditioned.rate_hz, fraction * self._row_hz, size,
                    config.coherent_ms, blocks,
                )  # fmt: skip
                spectra = fft.fft(blocks, axis=1, norm="forward", workers=1)
                current = fraction
            doppler_hz = row * self._row_hz
            slip = sig.code_slip(doppler_hz, conditioned.rate_hz, size, times)
            sig.shift_and_align(spectra, shift, slip, aligned)
            is_zero = conditioned.is_real and row == 0
            for name, peak in peaks.items():
                if row in wanted[name]:
                    weight = self._zero_row_weight(name, peak.rows) if is_zero else 1.0
                    self._correlate(aligned, matched[name], doppler_hz, weight, peak)
        return peaks

    def _zero_row_weight(self, satellite: str, row_count: int) -> float:
        """Return the weight of the row at 0 Hz of a real signal.

        Its correlations are real too, so that noise has half the degrees of freedom; the weight
        brings the threshold for those down to that of the other rows.
        """
        normal = self._threshold(satellite, row_count)
        return normal / self._threshold(satellite, row_count, 0.5)

    def _correlate(
        self,
        aligned: sig.Complex64Array,
        matched: sig.Complex64Array,
        doppler_hz: float,
        weight: float,
        peak: _Peak,
    ) -> None:
        """Search one Doppler row of one satellite, keeping the peak if it is larger."""
        np.multiply(aligned, matched, out=self._product)
        correlation = fft.ifft(self._product, axis=1, overwrite_x=True, norm="forward", workers=1)
        sets = 1 + self.config.alternate_blocks
        for first in range(sets):
            cell, power, mean = sig.accumulate(correlation, first, sets, GUARD, self._power)
            statistic = weight * power / mean
            if statistic > peak.statistic:
                peak.statistic, peak.cell, peak.doppler_hz = statistic, int(cell), doppler_hz

    def _threshold(self, satellite: str, row_count: int, freedom: float = 1.0) -> float:
        sets = 1 + self.config.alternate_blocks
        cells = stat.CELL_INDEPENDENCE * self._size * row_count * sets
        return stat.detection_threshold(
            self.config.false_alarm_probability,
            cells,
            self.config.noncoherent_count / sets * freedom,
            stat.reference_cells(self._replica(satellite)),
        )

    def _judge(self, conditioned: sig.Conditioned, satellite: str, peak: _Peak) -> Detection:
        """Compare a peak with its threshold and refine it if it passes."""
        threshold = self._threshold(satellite, peak.rows)
        replica, detected = self._replica(satellite), peak.statistic > threshold
        phase = -peak.cell * sig.CODE_LENGTH / self._size % sig.CODE_LENGTH
        cn0_hz = max(peak.statistic - 1, 1e-3) / self._coherent_s
        estimate = fine.FineEstimate(phase, peak.doppler_hz, self._row_hz / 2, cn0_hz)
        if detected:
            estimate = fine.refine(conditioned, replica, phase, peak.doppler_hz, self._row_hz)
        return Detection(
            satellite=satellite,
            detected=bool(detected),
            sample_index=0,
            code_phase_chips=estimate.code_phase_chips,
            carrier_doppler_hz=estimate.carrier_doppler_hz,
            doppler_sd_hz=estimate.doppler_sd_hz,
            statistic=peak.statistic,
            threshold=threshold,
            false_alarm_probability=self.config.false_alarm_probability,
            cn0_dbhz=float(10 * np.log10(estimate.cn0_hz)),
        )

    def _confirm(
        self, conditioned: sig.Conditioned, found: Mapping[str, Detection], rows: _Rows
    ) -> dict[str, Detection]:
        """Search again, with the strong satellites removed, for what they may have faked.

        C/A codes correlate with each other up to -21.6 dB, whatever their Doppler difference
        modulo 1 kHz. Detections that weak against the strongest signal must pass again in a
        signal from which all strong ones have been subtracted. Signals that were not asked for
        are searched as well where anything is weak enough to stem from them.
        """
        present = [item for item in found.values() if item.detected]
        weakest = min((item.cn0_dbhz for item in present), default=np.inf)
        if self.config.search_interferers and weakest < STRONGEST_DBHZ - LEAK_DB:
            present += self._interferers(conditioned, rows)
        top = max((item.cn0_dbhz for item in present), default=-np.inf)
        doubtful = {
            item.satellite: rows[item.satellite]
            for item in present
            if item.satellite in rows and item.cn0_dbhz < top - LEAK_DB + LEAK_SUM_DB
        }
        if not doubtful:
            return {}
        strong = [item for item in present if item.satellite not in doubtful]
        cleaned = self._remove(conditioned, strong)
        peaks = self._search_rows(cleaned, doubtful)
        return {name: self._judge(cleaned, name, peak) for name, peak in peaks.items()}

    def _interferers(self, conditioned: sig.Conditioned, asked: _Rows) -> list[Detection]:
        """Find who else is there: GPS not asked for, QZSS and SBAS (of less Doppler)."""
        centre = self.config.doppler_centre_hz
        span = max(self.config.doppler_span_hz - OTHERS_NARROWER_HZ, self._row_hz)
        windows = dict.fromkeys(codes.OTHERS, (centre - span, centre + span))
        names = [name for name in codes.GPS + codes.OTHERS if name not in asked]
        rows = {name: self._rows(name, windows, conditioned.is_real) for name in names}
        peaks = self._search_rows(conditioned, rows)
        judged = [self._judge(conditioned, name, peak) for name, peak in peaks.items()]
        return [item for item in judged if item.detected]

    def _remove(self, conditioned: sig.Conditioned, strong: list[Detection]) -> sig.Conditioned:
        """Subtract satellites that can leak; again at another code phase if samples were lost."""
        for _ in range(REMOVALS):
            least = {item.satellite: (item.threshold - 1) / self._coherent_s for item in strong}
            strong = [
                item
                for item in sorted(strong, key=lambda item: -item.cn0_dbhz)
                if item.cn0_dbhz > 10 * np.log10(least[item.satellite]) + STRONG_DB
            ]
            for item in strong:
                conditioned = fine.cancel(
                    conditioned,
                    self._replica(item.satellite),
                    item.code_phase_chips,
                    item.carrier_doppler_hz,
                )
            near = {
                item.satellite: round(item.carrier_doppler_hz / self._row_hz) + np.arange(-1, 2)
                for item in strong
            }
            peaks = self._search_rows(conditioned, near)
            again = [self._judge(conditioned, name, peak) for name, peak in peaks.items()]
            strong = [item for item in again if item.detected]
        return conditioned
