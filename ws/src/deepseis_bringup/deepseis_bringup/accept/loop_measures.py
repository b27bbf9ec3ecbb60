"""How well tracking loops held a simulated signal's carrier: by truth and by themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.report.run_columns import ColumnBuilder, Columns
from deepseis_bringup.report.run_truth import nco_phase
from deepseis_core.types import FloatArray, TrackingEpochs, TrackingFlag, TrackingMode

FIELDS: Final = (
    *("sample_index", "sample_count", "carrier_phase_cycles", "carrier_doppler_hz"),
    *("carrier_doppler_rate", "carrier_doppler_accel", "carrier_error_cycles", "cn0_dbhz"),
    *("phase_lock_indicator", "flags"),
)


class Tracks:
    """Integrations of all satellites of a run, collected as they come."""

    def __init__(self) -> None:
        self._builders: dict[str, ColumnBuilder] = {}

    def add(self, epochs: TrackingEpochs) -> None:
        """Take the integrations of a block."""
        builder = self._builders.setdefault(
            epochs.satellite, ColumnBuilder(["mode", "block_sample_index"], (), FIELDS)
        )
        builder.add(0, epochs)

    def finish(self) -> dict[str, Columns]:
        """Return the columns of every satellite."""
        return {name: builder.finish() for name, builder in sorted(self._builders.items())}


@dataclass(frozen=True)
class CarrierTruth:
    """What a truth file knows of the carriers; arrays (m,) and (m, satellites)."""

    satellites: tuple[str, ...]
    t: FloatArray
    phase_cycles: FloatArray
    cn0_dbhz: FloatArray
    elevation: FloatArray

    @property
    def present(self) -> NDArray[np.bool_]:
        """Whether there is a signal, shape (m, satellites)."""
        return np.isfinite(self.cn0_dbhz)

    @classmethod
    def read(cls, path: str | Path) -> CarrierTruth:
        """Read the ``truth.npz`` of a simulated input bag."""
        with np.load(path, allow_pickle=False) as file:
            return cls(
                tuple(str(name) for name in file["satellites"]),
                file["t_s"],
                file["carrier_phase_cycles"],
                file["satellite_cn0_dbhz"].astype(np.float64),
                file["elevation"],
            )


@dataclass(frozen=True)
class LoopFigures:
    """One satellite's loop in one span of time; angles [deg].

    ``discriminator_rms``, ``discriminator_max`` are of the loop's own output; ``error_rms`` is of
    the NCO's phase against truth, ``own_rms`` of the part that is not common to all satellites;
    NaN where the phase was not locked. ``slips`` counts integrations that say they slipped.
    """

    satellite: str
    elevation_deg: float
    cn0_dbhz: float
    discriminator_rms: float
    discriminator_max: float
    error_rms: float
    own_rms: float
    locked: float
    slips: int


def phase_errors(
    tracks: Mapping[str, Columns],
    truth: CarrierTruth,
    sample_rate_hz: float,
    *,
    locked: bool = True,
) -> FloatArray:
    """Return NCO phase less truth [cycles], shape (m, satellites).

    NaN while not locked, or with ``locked=False`` only where nothing is tracked. The half cycle
    that is put in, and flagged, once the data's polarity is first known is left out.
    """
    samples = truth.t * sample_rate_hz
    error = np.full(truth.phase_cycles.shape, np.nan)
    for k, satellite in enumerate(truth.satellites):
        if satellite in tracks:
            nco = nco_phase(tracks[satellite], samples, sample_rate_hz, settled=locked)
            error[:, k] = nco - _half_cycle(tracks[satellite], samples) - truth.phase_cycles[:, k]
    return error


def _half_cycle(track: Columns, samples: FloatArray) -> FloatArray:
    """Return the half cycle [cycles] at sample instants, from its first flag on."""
    flagged = np.flatnonzero(track["flags"].astype(np.int64) & int(TrackingFlag.HALF_CYCLE))
    if not flagged.size:
        return np.zeros(len(samples))
    return np.where(samples >= track["sample_index"][flagged[0]], 0.5, 0.0)


def measure(
    tracks: Mapping[str, Columns],
    truth: CarrierTruth,
    sample_rate_hz: float,
    span: tuple[float, float],
    still: tuple[float, float],
) -> list[LoopFigures]:
    """Return the figures of every satellite in a span of time.

    Parameters
    ----------
    tracks : mapping of str to Columns
        Integrations by satellite.
    truth : CarrierTruth
    sample_rate_hz : float
    span : tuple of float
        Beginning and end [s].
    still : tuple of float
        Span in which the phase's constant is told [s]; a slip after it is an error.
    """
    error = phase_errors(tracks, truth, sample_rate_hz)
    error[~truth.present] = np.nan  # a satellite that has set
    before = _within(truth.t, still)
    inside = _within(truth.t, span)
    seen = [k for k in range(len(truth.satellites)) if np.isfinite(error[before, k]).any()]
    error[:, seen] -= np.nanmean(error[before][:, seen], axis=0)
    common = _common(error[inside], truth.cn0_dbhz[inside])
    return [
        _figures(name, k, tracks, truth, sample_rate_hz, span, error[inside], common)
        for k, name in enumerate(truth.satellites)
        if name in tracks
    ]


def _figures(
    name: str,
    k: int,
    tracks: Mapping[str, Columns],
    truth: CarrierTruth,
    sample_rate_hz: float,
    span: tuple[float, float],
    error: FloatArray,
    common: tuple[FloatArray, FloatArray],
) -> LoopFigures:
    track = tracks[name]
    middle = (track["sample_index"] + track["sample_count"] / 2) / sample_rate_hz
    measured = _within(middle, span) & ~_gone(truth, k, track, sample_rate_hz)
    chosen = measured & (track.per_row("mode") >= int(TrackingMode.TRACK))
    shown = 360.0 * track["carrier_error_cycles"][chosen].astype(np.float64)
    inside = _within(truth.t, span)
    mean, shares = common
    own = error[:, k] - mean
    flags = track["flags"][measured].astype(np.int64)
    present = truth.present[inside, k]
    return LoopFigures(
        name,
        float(np.degrees(truth.elevation[k])),
        _mean_db(truth.cn0_dbhz[inside, k]),
        _rms(shown),
        float(np.abs(shown).max(initial=0.0)) if shown.size else float("nan"),
        360.0 * _rms(error[:, k]),
        360.0 * _rms(own) / float(np.sqrt(shares[k])) if shares[k] > 0 else float("nan"),
        float(np.isfinite(error[present, k]).mean()) if present.any() else 0.0,
        int(((flags & int(TrackingFlag.SLIP)) > 0).sum()),
    )


def _gone(truth: CarrierTruth, k: int, track: Columns, sample_rate_hz: float) -> NDArray[np.bool_]:
    """Tell of each integration whether there was no signal at its end."""
    end = (track["sample_index"] + track["sample_count"]) / sample_rate_hz
    at = np.clip(np.searchsorted(truth.t, end), 0, len(truth.t) - 1)
    return np.asarray(~truth.present[at, k])


def locked_without_signal(
    tracks: Mapping[str, Columns], truth: CarrierTruth, sample_rate_hz: float
) -> float:
    """Return the longest time for which a phase is called locked although its signal is gone [s].

    NaN if no satellite sets.
    """
    longest = float("nan")
    for k, satellite in enumerate(truth.satellites):
        if satellite not in tracks or not (truth.present[:-1, k] & ~truth.present[1:, k]).any():
            continue
        track = tracks[satellite]
        locked = (track["flags"].astype(np.int64) & int(TrackingFlag.PHASE_LOCK)) > 0
        wrong = _gone(truth, k, track, sample_rate_hz) & locked
        held = float(track["sample_count"][wrong].sum()) / sample_rate_hz
        longest = held if not longest >= held else longest
    return longest


def _common(error: FloatArray, cn0_dbhz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the part common to the satellites, and each one's share of variance left without it.

    The mean is weighted by C/N0, as a loop's noise goes.
    """
    weight = np.where(np.isfinite(error), 10.0 ** (np.nan_to_num(cn0_dbhz, neginf=-99) / 10.0), 0)
    total = weight.sum(axis=1)
    safe = np.where(total > 0.0, total, 1.0)
    mean = (np.nan_to_num(error) * weight).sum(axis=1) / safe
    shares = 1.0 - (weight / safe[:, None]).mean(axis=0)
    return np.where(total > 0.0, mean, np.nan), shares


def _within(t: FloatArray, span: tuple[float, float]) -> NDArray[np.bool_]:
    return np.asarray((t >= span[0]) & (t < span[1]))


def _rms(values: NDArray[Any]) -> float:
    kept = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(kept**2))) if kept.size else float("nan")


def _mean_db(values: FloatArray) -> float:
    kept = values[np.isfinite(values)]
    return float(10.0 * np.log10(np.mean(10.0 ** (kept / 10.0)))) if kept.size else float("nan")


def thermal_deg(bandwidth_hz: float, cn0_dbhz: float, integration_s: float = 0.02) -> float:
    """Return the phase jitter of a loop by noise alone [deg] (thesis 3.2)."""
    cn0 = 10.0 ** (cn0_dbhz / 10.0)
    variance = bandwidth_hz / cn0 * (1.0 + 1.0 / (2.0 * integration_s * cn0))
    return float(np.degrees(np.sqrt(variance)))


def pooled(values: Iterable[float]) -> float:
    """Return the root mean square of several satellites' figures; NaN if one is missing."""
    array = np.array(list(values))
    return float(np.sqrt(np.mean(array**2))) if array.size else float("nan")
