"""A simulated recording on disk: raw IF, its descriptor, the truth, the navigation data.

=============== =====================================================================
file            content
=============== =====================================================================
``if.bin``      samples, packed as the format says
``if.bin.yaml`` format, sample rate, IF, UTC of sample 0 by the receiver's clock
``truth.npz``   every 10 ms of receiver time (:func:`truth_rows`), and what stays the same
``nav.rnx``     the ephemerides used, RINEX 3.05
=============== =====================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.rinex_nav import write_rinex_nav
from deepseis_core.types import FloatArray
from deepseis_sim.if_synthesis import IfSynthesizer, SignalSegments
from deepseis_sim.jammer import JammerConfig
from deepseis_sim.multipath import MultipathConfig
from deepseis_sim.signal_model import SignalModel
from deepseis_sim.truth_file import TruthFile

Progress = Callable[[float], None]
"""Told the seconds of signal made so far."""

TRUTH_STEP: Final = 0.01
CHUNK_SEGMENTS: Final = 20
_TRUTH_CHUNK: Final = 100


@dataclass(frozen=True)
class FrontEnd:
    """How the signal is sampled."""

    format: IfFormat
    sample_rate_hz: float = 4.0e6
    intermediate_frequency_hz: float = 0.0


@dataclass(frozen=True)
class SimulatedRecording:
    """Where a recording lies and what it holds."""

    if_path: Path
    descriptor_path: Path
    truth_path: Path
    nav_path: Path
    sample_count: int
    satellites: tuple[str, ...]


class IfStream:
    """IF samples of a signal model, in order, in bounded memory.

    Parameters
    ----------
    model : SignalModel
    front_end : FrontEnd
    seed : int, optional
        Of the noise.
    jammers : sequence of JammerConfig, optional
    multipath : MultipathConfig, optional
    agc_s : float, optional
        Time constant of the automatic gain (`agc`) [s]; zero: a fixed gain, set for noise and
        satellites.

    Raises
    ------
    InputError
        Where a jammer makes no sense for this front end.
    """

    def __init__(
        self,
        model: SignalModel,
        front_end: FrontEnd,
        *,
        seed: int = 0,
        jammers: Sequence[JammerConfig] = (),
        multipath: MultipathConfig | None = None,
        agc_s: float = 0.0,
    ) -> None:
        self.model, self.multipath = model, multipath
        self.synthesizer = IfSynthesizer(
            front_end.format,
            front_end.sample_rate_hz,
            front_end.intermediate_frequency_hz,
            model.signal_prn(multipath),
            seed=seed,
            mean_cn0_dbhz=[item.cn0_dbhz for item in model.satellites],
            jammers=jammers,
            agc_s=agc_s,
            carriers_hz=lambda time: model.carriers_hz(time, multipath),
        )

    def segments(self, first: int, count: int) -> SignalSegments:
        """Lay out the phases of segments of the synthesizer's length."""
        return self.model.segments(first, count, self.synthesizer.segment_span, self.multipath)

    def packed(self, start: int, count: int) -> NDArray[np.uint8]:
        """Make the samples ``start .. start + count`` in the front end's bytes.

        Spans may follow one another in any way; ``start`` is a multiple of the format's
        ``samples_per_unit``.
        """
        length = self.synthesizer.segment_samples
        first, end = start // length, -(-(start + count) // length)
        return self.synthesizer.packed(self.segments(first, end - first), start, count)

    def chunks(
        self, sample_count: int, *, chunk_segments: int = CHUNK_SEGMENTS
    ) -> Iterator[tuple[int, bytes]]:
        """Yield first sample index and packed bytes of successive chunks."""
        length = self.synthesizer.segment_samples
        for first in range(0, -(-sample_count // length), chunk_segments):
            start = first * length
            count = min(chunk_segments * length, sample_count - start)
            yield start, self.packed(start, count).tobytes()


def truth_rows(model: SignalModel, time: FloatArray) -> dict[str, FloatArray]:
    """Return the truth at receiver seconds since the start, shape (m,).

    Returns
    -------
    dict
        ``t_s`` (m,); ``carrier_phase_cycles``, ``carrier_doppler_hz`` (what a carrier NCO that
        follows without error shows), ``range`` (geometric, with the Earth's rotation),
        ``pseudorange`` [m], all (m, n_satellites); ``clock_bias`` [s], (m,); ``antenna_ecef``
        [m], (m, 3).
    """
    delays, doppler = model.delays_and_doppler(time)
    return {
        "t_s": time,
        "carrier_phase_cycles": delays.carrier_phase_cycles + model.initial_phase_cycles,
        "carrier_doppler_hz": doppler,
        "range": delays.range,
        "pseudorange": delays.pseudorange,
        "clock_bias": delays.receiver_clock,
        "antenna_ecef": np.array(model.antenna(time - delays.receiver_clock)[:, :3]),
    }


def write_recording(
    model: SignalModel,
    front_end: FrontEnd,
    duration: float,
    folder: str | Path,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> SimulatedRecording:
    """Make a recording; what is not finished is not left behind.

    Parameters
    ----------
    model : SignalModel
    front_end : FrontEnd
    duration : float
        [s]
    folder : path
        Made if need be; files of the same names in it are replaced.
    seed : int, optional
        Of the noise.
    progress : callable, optional
        Called after every chunk with the seconds made.

    Raises
    ------
    InputError
        Where the folder or a file cannot be written, or no satellite is visible.
    """
    if not model.satellites:
        raise InputError("sky", "no satellite is visible", "check position, time and mask")
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".unfinished.", dir=folder) as place:
            made = _write_files(model, front_end, duration, Path(place), seed, progress)
            for path in made:
                path.replace(folder / path.name)
    except OSError as error:
        raise InputError(error.filename or folder, error.strerror or str(error)) from None
    if progress:
        progress(duration)
    if_path, descriptor_path, truth_path, nav_path = (folder / path.name for path in made)
    return SimulatedRecording(
        if_path,
        descriptor_path,
        truth_path,
        nav_path,
        round(duration * front_end.sample_rate_hz),
        tuple(item.satellite for item in model.satellites),
    )


def _write_files(
    model: SignalModel,
    front_end: FrontEnd,
    duration: float,
    place: Path,
    seed: int,
    progress: Progress | None,
) -> tuple[Path, Path, Path, Path]:
    """Write IF, descriptor, truth and navigation data into a folder."""
    if_path, truth_path, nav_path = place / "if.bin", place / "truth.npz", place / "nav.rnx"
    stream = IfStream(model, front_end, seed=seed)
    with if_path.open("wb") as file:
        for start, data in stream.chunks(round(duration * front_end.sample_rate_hz)):
            file.write(data)
            if progress:
                progress(start / front_end.sample_rate_hz)
    _write_truth(model, duration, truth_path)
    write_rinex_nav(
        nav_path,
        [item.ephemeris for item in model.satellites],
        leap_seconds=model.start.leap_seconds(),
        date=_date(model),
    )
    return if_path, _write_descriptor(if_path, model, front_end), truth_path, nav_path


def _write_truth(model: SignalModel, duration: float, path: Path) -> None:
    rows = int(np.floor(duration / TRUTH_STEP + 1e-6)) + 1
    with TruthFile(path) as truth:
        for first in range(0, rows, _TRUTH_CHUNK):
            number = np.arange(first, min(first + _TRUTH_CHUNK, rows))
            truth.append(**truth_rows(model, number / round(1 / TRUTH_STEP)))
        truth.put(
            prn=np.array([item.prn for item in model.satellites]),
            satellites=np.array([item.satellite for item in model.satellites]),
            elevation=np.array([item.elevation for item in model.satellites]),
            azimuth=np.array([item.azimuth for item in model.satellites]),
            cn0_dbhz=np.array([item.cn0_dbhz for item in model.satellites]),
            start_week=model.start.week,
            start_tow_ns=model.start.tow_ns,
        )


def _write_descriptor(if_path: Path, model: SignalModel, front_end: FrontEnd) -> Path:
    """Write what `deepseis_frontend.if_descriptor` reads."""
    path = Path(f"{if_path}.yaml")
    lines = [
        f'format: "{front_end.format.to_text()}"',
        f"sample_rate_hz: {front_end.sample_rate_hz!r}  # [Hz]",
        f"intermediate_frequency_hz: {front_end.intermediate_frequency_hz!r}  # [Hz]",
        f"start_utc_ns: {model.start.to_utc_ns()}  # [ns since 1970] of sample 0",
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _date(model: SignalModel) -> str:
    """Date the navigation file by the signal's start: same seed, same bytes."""
    year, month, day, hour, minute, ns = model.start.to_calendar()
    return f"{year:04d}{month:02d}{day:02d} {hour:02d}{minute:02d}{ns // 10**9:02d} UTC"
