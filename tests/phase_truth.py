"""An independent simulator's signal through the channels; their carrier phase against its truth.

`Station` is the graph without ROS: source, acquisition, channels, PVT and truth aiding, with the
same dependences between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import Aiding, TrackingEpochs, TrackingFlag
from deepseis_frontend.if_file import open_if_file
from deepseis_ins.truth_aider import TruthAider, TruthAiderConfig
from deepseis_ins.truth_motion import TruthMotion
from deepseis_pvt.pvt_engine import PvtConfig, PvtEngine
from deepseis_tracking.acquisition import AcquisitionConfig
from deepseis_tracking.acquisition_engine import AcquisitionEngine, RetryConfig
from deepseis_tracking.channel import TrackingConfig
from deepseis_tracking.engine import BlockOutput, SlotConfig, TrackingEngine

RATE = 4e6
INTEGRATION = 0.02
ONE_BIT_LOSS_DB = 2.0
ONSET = 10.0
"""The antenna of the moving recording leaves its place [s]."""
NAV = "brdc0010.22n"


@dataclass(frozen=True)
class Recording:
    """One recording of ``if_captures/independent_sim`` (see the README there)."""

    samples: str
    truth: str
    start: GpsTime


STILL = Recording(
    "still_40s_4MHz_1bit_iq.bin", "still_truth.npz", GpsTime.from_calendar(2022, 1, 1, 2)
)
MOVING = Recording(
    "circle_12cm_2hz_30s_4MHz_1bit_iq.bin",
    "circle_12cm_2hz_truth.npz",
    GpsTime.from_calendar(2022, 1, 1, 2, 0, 30 * 10**9),
)
STATION = ecef_from_geodetic(np.array([np.radians(35.681298), np.radians(139.766247), 10.0]))


def thermal_limit(bandwidth_hz: float, cn0_dbhz: np.ndarray) -> np.ndarray:
    """Phase jitter of a loop by noise alone [cycles] (thesis 3.2)."""
    cn0 = 10 ** (np.asarray(cn0_dbhz) / 10)
    variance = bandwidth_hz / cn0 * (1 + 1 / (2 * INTEGRATION * cn0))
    return np.sqrt(variance) / (2 * np.pi)


class Truth:
    """Carrier phases of the satellites above 10 degrees, and C/N0 behind the 1-bit quantiser."""

    def __init__(self, folder: Path, recording: Recording, mask_deg: float = 10.0) -> None:
        with np.load(folder / recording.truth) as z:
            high = z["el_deg"] > mask_deg
            self.t = z["t_s"]
            self.satellites = tuple(f"G{prn:02d}" for prn in z["prn"][high])
            self.phase = z["carrier_phase_cycles"][:, high]
            self.doppler = z["carrier_doppler_hz"][:, high]
            self.cn0 = z["cn0_dbhz_before_quantising"][high] - ONE_BIT_LOSS_DB


@dataclass
class Track:
    """Integrations of one satellite, in order."""

    parts: list[TrackingEpochs] = field(default_factory=list)

    def column(self, name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in self.parts])

    def phase_at(self, t: np.ndarray) -> np.ndarray:
        """NCO phase at times since sample 0 [cycles], NaN where there is none.

        The half cycle that is added, and flagged, once the data's polarity is known is left out.
        """
        start, count = self.column("sample_index"), self.column("sample_count")
        sample = t * RATE
        k = np.searchsorted(start, sample + 1e-6, side="right") - 1
        inside = (k >= 0) & (sample < (start + count)[k])
        tau = (sample - start[k]) / RATE
        turned = np.cumsum((self.column("flags") & TrackingFlag.HALF_CYCLE) != 0) % 2
        phase = (self.column("carrier_phase_cycles") - 0.5 * turned)[k]
        f0, f1 = self.column("carrier_doppler_hz")[k], self.column("carrier_doppler_rate")[k]
        f2 = self.column("carrier_doppler_accel")[k]
        phase = phase + tau * (f0 + tau * (f1 / 2 + tau * f2 / 3))
        return np.where(inside, phase, np.nan)

    def _after(self, name: str, t: float) -> np.ndarray:
        return self.column(name)[self.column("sample_index") > t * RATE]

    def unlocked_after(self, t: float) -> int:
        """Count integrations after ``t`` that lack phase lock or carry the slip flag."""
        flags = self._after("flags", t)
        bad = ((flags & TrackingFlag.PHASE_LOCK) == 0) | ((flags & TrackingFlag.SLIP) != 0)
        return int(np.sum(bad))

    def flagged(self, flag: TrackingFlag) -> int:
        return int(np.sum((self.column("flags") & flag) != 0))

    def aided_after(self, t: float) -> float:
        """Share of the time after ``t`` in aided integrations."""
        aided = np.isfinite(self._after("aid_doppler_hz", t))
        return float(np.average(aided, weights=self._after("sample_count", t)))


def collect(epochs: Iterable[TrackingEpochs]) -> dict[str, Track]:
    """Sort integrations by satellite."""
    tracks: dict[str, Track] = {}
    for item in epochs:
        tracks.setdefault(item.satellite, Track()).parts.append(item)
    return tracks


class PhaseErrors:
    """NCO phase minus truth [cycles], shape (m, n), at the truth's epochs in ``[low, high)``.

    ``raw`` has only the unknown start of each satellite removed, ``error`` also the mean over
    the satellites at every epoch: the part common to all.
    """

    def __init__(self, truth: Truth, tracks: dict[str, Track], low: float, high: float) -> None:
        rows = (truth.t >= low) & (truth.t < high)
        self.t, self.cn0 = truth.t[rows], truth.cn0
        nco = np.stack([tracks[name].phase_at(self.t) for name in truth.satellites], axis=1)
        raw = nco - truth.phase[rows]
        self.raw = raw - raw[0]
        self.error = self.raw - self.raw.mean(axis=1, keepdims=True)

    def _span(self, low: float, high: float) -> np.ndarray:
        return self.error[(self.t >= low) & (self.t < high)]

    def rms(self, low: float, high: float) -> np.ndarray:
        """Standard deviation over a span of time [cycles]."""
        return self._span(low, high).std(axis=0)

    def ratio(self, bandwidth_hz: float, low: float, high: float) -> np.ndarray:
        """Standard deviation over the thermal limit."""
        return self.rms(low, high) / thermal_limit(bandwidth_hz, self.cn0)

    def step(self, before: tuple[float, float], after: tuple[float, float]) -> np.ndarray:
        """Change of the mean error from one span to another [cycles]: half a cycle is a slip."""
        return self._span(*after).mean(axis=0) - self._span(*before).mean(axis=0)


@dataclass
class Station:
    """One recording through the station's engines in one process.

    ``change`` may alter a span of aiding, or drop it (then it counts as missed).
    """

    folder: Path
    recording: Recording
    satellites: tuple[str, ...]
    loops: TrackingConfig = field(default_factory=TrackingConfig)
    aided: bool = False
    aider: TruthAiderConfig = field(default_factory=TruthAiderConfig)
    change: Callable[[Aiding], Aiding | None] = lambda aiding: aiding

    def run(self, length: float | None = None, start: float = 0.0) -> Iterator[TrackingEpochs]:
        """Yield the integrations of every block."""
        path = self.folder / self.recording.samples
        given = {"format": "independent_sim", "sample_rate_hz": RATE}
        file = open_if_file(path, start=start, length=length, **given)
        slots = SlotConfig(satellites=list(self.satellites))
        self.search = AcquisitionEngine(self.satellites, AcquisitionConfig(), slots, RetryConfig())
        self.search.expect_trackers(["channels"])
        self.channels = TrackingEngine(self.satellites, self.loops, slots, wait_aiding=self.aided)
        self.pvt = PvtEngine(PvtConfig(), RATE, self.satellites)
        aider = self.make_aider()
        for block in file.blocks():
            self.search.push_block(block)
            self.channels.push_block(block)
            if self.aided:
                aider.source_valid(block.sample_index + block.sample_count - 1)
                aider.pvt_valid(self.pvt.valid_through)
            yield from self._work(aider if self.aided else None)

    def make_aider(self) -> TruthAider:
        """Aiding of this recording."""
        truth = TruthMotion(self.folder / self.recording.truth, STATION)
        ephemerides = read_rinex_nav(self.folder / NAV).ephemerides
        start = self.recording.start
        return TruthAider(self.aider, truth.trajectory, start, ephemerides, self.satellites)

    def _work(self, aider: TruthAider | None) -> Iterator[TrackingEpochs]:
        """Let everybody work until nobody can go on."""
        busy = True
        while busy:
            missed = False
            while aider is not None and (aiding := aider.advance()) is not None:
                changed = self.change(aiding)
                missed = changed is None
                if changed is not None:
                    self.channels.push_aiding(changed)
            output = self.channels.advance(force=missed)
            busy = self._search() or output is not None
            if output is not None:
                self._take(output)
                yield from output.epochs
            if aider is not None:
                aider.pvt_valid(self.pvt.valid_through)

    def _search(self) -> bool:
        results = self.search.advance()
        for result in results or []:
            self.channels.push_result(result)
        self.channels.acquisition_valid(self.search.valid_through, self.search.result_count)
        return results is not None

    def _take(self, output: BlockOutput) -> None:
        """Hand on what the channels gave."""
        for satellite, sample in output.requests:
            self.search.push_request(satellite, sample, "channels")
        through = self.channels.done_through
        self.search.tracker_valid("channels", through, self.channels.request_count)
        for ephemeris in output.ephemerides:
            self.pvt.push_ephemeris(ephemeris)
        for epochs in output.epochs:
            self.pvt.push_epochs(epochs)
        self.pvt.advance()
