"""Loops under 2 g as the papers had them, and weak signals kept by narrow aided ones.

The first part is the test bench's own signal: what a conventional loop shows is the thesis'
(tables 5.3, 5.4), so the bench is an honest one; what an aided loop shows is noise alone. The
second part is the signal of an independent simulator, made 10 dB weaker by noise.
"""

from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from phase_truth import MOVING, RATE, Station, Track, Truth, collect, thermal_limit

from deepseis_core.baseband import Baseband
from deepseis_core.types import IfBlock, TrackingEpochs
from deepseis_frontend.if_file import open_if_file
from deepseis_ins.truth_aider import TruthAider, TruthAiderConfig
from deepseis_ins.truth_motion import Trajectory
from deepseis_sim.bench import Bench
from deepseis_sim.scenario import load_scenario
from deepseis_tracking.acquisition import AcquisitionConfig
from deepseis_tracking.acquisition_engine import AcquisitionEngine, RetryConfig
from deepseis_tracking.channel import TrackingConfig
from deepseis_tracking.engine import SlotConfig, TrackingEngine

LOW = "G07"
"""27 degrees high: the discriminator of the thesis' satellite fits to one of about 30."""
CHOSEN = ("G02", "G07", "G18", "G21")
ONSET, STILL, MOTION = 10.0, (4.0, 10.0), (11.5, 25.5)


def tracked(
    blocks: Iterable[IfBlock],
    satellites: tuple[str, ...],
    loops: TrackingConfig,
    aider: TruthAider | None = None,
    noncoherent_count: int = 25,
) -> dict[str, Track]:
    """Track with the real acquisition; aiding comes just in time."""
    slots = SlotConfig(satellites=list(satellites))
    search = AcquisitionEngine(
        satellites,
        AcquisitionConfig(search_interferers=False, noncoherent_count=noncoherent_count),
        slots,
        RetryConfig(),
    )
    search.expect_trackers(["channels"])
    channels = TrackingEngine(satellites, loops, slots, wait_aiding=aider is not None)
    epochs: list[TrackingEpochs] = []
    for block in blocks:
        search.push_block(block)
        channels.push_block(block)
        while aider and aider.next_sample < block.sample_index + block.sample_count:
            aiding = aider.advance()
            assert aiding is not None
            channels.push_aiding(aiding)
        for result in search.advance() or []:
            channels.push_result(result)
        channels.acquisition_valid(search.valid_through, search.result_count)
        output = channels.advance()
        assert output is not None, channels.waiting_for()
        epochs += output.epochs
        for satellite, sample in output.requests:
            search.push_request(satellite, sample, "channels")
        search.tracker_valid("channels", channels.done_through, channels.request_count)
    return collect(epochs)


class Shaken:
    """A scenario of the bench, in memory: 10 s still, then 16 s of circles."""

    def __init__(self, name: str) -> None:
        changes = [f"motion.0.start={ONSET}", "motion.0.duration=17.0", "duration=26.0"]
        sky = ["sky.zenith_cn0_dbhz=46", "sky.low_cn0_dbhz=45"]  # as the thesis' satellites
        settings = [*changes, *sky, "base=null"]
        self.bench = Bench(load_scenario(name, short=True, settings=settings))
        self.blocks = [
            item.value
            for span in self.bench.spans()
            for item in self.bench.items(*span)
            if item.topic == "if/samples"
        ]
        names = [item.satellite for item in self.bench.model.satellites]
        self.rows = [names.index(name) for name in CHOSEN]
        self.cn0 = np.array([self.bench.model.satellites[k].cn0_dbhz for k in self.rows])

    def aider(self) -> TruthAider:
        """Aiding by the true motion, on the receiver's clock."""
        bench, t = self.bench, np.arange(-0.1, 26.5, 1e-3)
        antenna = bench.model.antenna(t - bench.clock(t))[:, :3]
        ephemerides = [item.ephemeris for item in bench.model.satellites]
        aider = TruthAider(
            TruthAiderConfig(), Trajectory(t, antenna), bench.start, ephemerides, CHOSEN,
            wait_pvt=False,
        )  # fmt: skip
        aider.source_valid(1 << 60)
        return aider

    def phase_errors(self, tracks: dict[str, Track], span: tuple[float, float]) -> np.ndarray:
        """NCO phase minus truth [cycles], means removed, shape (m, n)."""
        t = np.arange(*span, 0.01)
        truth = self.bench.model.carrier_phase_cycles(t)[:, self.rows]
        error = np.stack([tracks[name].phase_at(t) for name in CHOSEN], axis=1) - truth
        return error - error.mean(axis=0)


def discriminator(track: Track, span: tuple[float, float]) -> tuple[float, float]:
    """Root mean square and largest value of the discriminator's output [deg]."""
    t = track.column("sample_index") / RATE
    error = 360 * track.column("carrier_error_cycles")[(t >= span[0]) & (t < span[1])]
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


@pytest.fixture(scope="module", params=["sine-1hz", "sine-2hz"])
def shaken(request) -> Shaken:
    return Shaken(request.param)


THESIS = {
    ("sine-1hz", 15.0): (28.96, 47.90),
    ("sine-1hz", 8.0): (46.31, 89.96),
    ("sine-2hz", 15.0): (26.39, 44.46),
    ("sine-2hz", 8.0): (51.73, 89.90),
}


@pytest.mark.parametrize("bandwidth", [15.0, 8.0])
def test_conventional_loops_show_what_the_thesis_shows(shaken, bandwidth):
    """Its constants as printed, and no way back to pull-in: its loops were left to themselves."""
    loops = TrackingConfig(pll_bandwidth_hz=bandwidth, loop_design="analog", relock_s=0.0)
    tracks = tracked(shaken.blocks, (LOW,), loops)
    rms, largest = discriminator(tracks[LOW], MOTION)
    expected = THESIS[shaken.bench.scenario.name, bandwidth]
    assert largest == pytest.approx(expected[1], rel=0.15)
    if bandwidth == 15.0:
        assert rms == pytest.approx(expected[0], rel=0.15)
    else:  # lost: 46.3 and 46.8 over 100 s, but how it slips in 14 s is chance
        assert rms > 0.85 * expected[0]
    assert discriminator(tracks[LOW], STILL)[0] < 5.0


@pytest.mark.parametrize("form", ["velocity", "acceleration"])
@pytest.mark.parametrize("bandwidth", [8.0, 3.0])
def test_aided_loops_show_noise_alone(shaken, bandwidth, form):
    loops = TrackingConfig(aided_bandwidth_hz=bandwidth, aiding_form=form)
    tracks = tracked(shaken.blocks, CHOSEN, loops, shaken.aider())
    for name in CHOSEN:
        assert tracks[name].unlocked_after(STILL[0]) == 0
        assert tracks[name].aided_after(STILL[0]) == 1.0
        rms, largest = discriminator(tracks[name], MOTION)
        # 14 s of 20 ms, 6 s still: an r.m.s. scatters by 3 and 4 %, 4 sigma of the ratio
        assert rms / discriminator(tracks[name], STILL)[0] < 1.2
        if bandwidth == 8.0:  # at 3 Hz the oscillator stands out: 4 sigma of it at 19.9 s
            assert largest < 4.5 * rms
    errors = shaken.phase_errors(tracks, MOTION)
    apart = errors - errors.mean(axis=1, keepdims=True)  # the oscillator moves all
    limit = thermal_limit(bandwidth, shaken.cn0)
    ratio = apart.std(axis=0) / np.sqrt(1 - 1 / len(CHOSEN)) / limit
    # 12 satellites are noise to each other: 0.65 dB, that is 1.08. 2 Bn 14 s degrees of freedom.
    scatter = 1 / np.sqrt(2 * 2 * bandwidth * 14.0 * len(CHOSEN))
    assert np.sqrt(np.mean(ratio**2)) < 1.1 + 3 * scatter


SEVEN_DEG = 19.0
WEAKER_DB = 8.0
"""Behind the quantiser to 1 bit, which has taken 2 dB already."""


class Weak:
    """The independent recording with noise added: 29 to 36 dB-Hz."""

    def __init__(self, folder) -> None:
        self.truth = Truth(folder, MOVING, SEVEN_DEG)
        self.cn0 = self.truth.cn0 - WEAKER_DB
        self.station = Station(folder, MOVING, self.truth.satellites)
        file = open_if_file(folder / MOVING.samples, format="independent_sim", sample_rate_hz=RATE)
        self.blocks = list(self.noisy(file.blocks()))

    def noisy(self, blocks: Iterable[IfBlock]) -> Iterator[IfBlock]:
        """Add noise so that 1 bit's signal is ``WEAKER_DB`` weaker against all of it."""
        sd = np.sqrt(10 ** (WEAKER_DB / 10) - 1)
        baseband: Baseband | None = None
        for number, block in enumerate(blocks):
            baseband = baseband or Baseband.for_block(block)
            parts = np.stack(baseband.convert(block), axis=1)
            random = np.random.default_rng([29, number])
            noise = random.standard_normal(parts.shape, dtype=np.float32)
            levels = np.rint(12 * (parts / np.abs(parts).max() + np.float32(sd) * noise))
            data = np.clip(levels, -127, 127).astype(np.int8)
            yield IfBlock(
                block.sample_index, block.sample_count, RATE, 0.0, "iq8",
                data.reshape(-1).view(np.uint8),
            )  # fmt: skip

    def tracked(self, *, start: float = 0.0) -> dict[str, Track]:
        """Track from a time on with aided loops of 3 Hz."""
        station = Station(
            self.station.folder, MOVING, self.truth.satellites,
            aider=TruthAiderConfig(start_s=start),
        )  # fmt: skip
        aider = station.make_aider()
        aider.source_valid(1 << 60)
        aider.pvt_valid(1 << 60)
        blocks = [block for block in self.blocks if block.sample_index >= start * RATE]
        loops = TrackingConfig(aided_bandwidth_hz=3.0)
        return tracked(blocks, self.truth.satellites, loops, aider, noncoherent_count=100)

    def errors(self, tracks: dict[str, Track], low: float, high: float) -> np.ndarray:
        """Standard deviation of phase minus truth [deg], all of it."""
        rows = (self.truth.t >= low) & (self.truth.t < high)
        nco = [tracks[name].phase_at(self.truth.t[rows]) for name in self.truth.satellites]
        return 360 * (np.stack(nco, axis=1) - self.truth.phase[rows]).std(axis=0)


@pytest.fixture(scope="module")
def weak(shared_data) -> Weak:
    return Weak(shared_data / "if_captures" / "independent_sim")


def test_all_seven_weak_satellites_are_kept_on_the_circle(weak):
    assert len(weak.truth.satellites) == 7
    assert weak.cn0.min() < 29.5
    tracks = weak.tracked()
    for name in weak.truth.satellites:
        # Doppler and bit edges take the weakest one 4 s: its data hardly change at first.
        assert tracks[name].unlocked_after(6.0) == 0
        assert tracks[name].aided_after(6.0) == 1.0
    limit = 360 * thermal_limit(3.0, weak.cn0)
    for low, high in ((6.0, 10.0), (11.0, 29.5)):
        # 6 Hz times the span degrees of freedom, 3 sigma
        assert (weak.errors(tracks, low, high) / limit).max() < 1.1 + 3 / np.sqrt(
            12 * (high - low)
        )
    assert weak.errors(tracks, 11.0, 29.5).max() < 4.0


def test_weak_satellites_are_found_and_locked_while_they_move(weak):
    tracks = weak.tracked(start=12.0)
    for name in weak.truth.satellites:
        assert tracks[name].unlocked_after(18.0) == 0
    assert weak.errors(tracks, 18.0, 29.5).max() < 4.0
