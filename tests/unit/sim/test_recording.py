"""Files of a simulated recording: same seed same bytes, and the signal is where the truth says."""

import tracemalloc

import numpy as np
import pytest
import yaml
from scipy.interpolate import CubicSpline

from deepseis_core.ca_code import ca_code
from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.lnav_decoder import LnavDecoder, SubframeEvent
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_sim.if_synthesis import IfSynthesizer
from deepseis_sim.recording import FrontEnd, IfStream
from deepseis_sim.signal_model import SignalModel
from deepseis_sim.still_recording import StillConfig, simulate_still, still_model

SHORT = StillConfig(duration=0.3)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return simulate_still(SHORT, tmp_path_factory.mktemp("still"))


def replica(model, k, time, knot=0.0):
    """Return code times carrier of satellite k by the model's formulas, data left out.

    Without ``knot`` every sample is evaluated; with it, one in so many seconds and a spline (a
    still antenna's phase is smooth: exact to rounding).
    """
    at = time if not knot else np.arange(time[0] - 4 * knot, time[-1] + 4 * knot, knot)
    delays = model.delays(at)
    phase = delays.carrier_phase_cycles[:, k] + model.initial_phase_cycles[k]
    sent = at - delays.pseudorange[:, k] / SPEED_OF_LIGHT
    if knot:
        phase = CubicSpline(at, phase)(time)
        sent = time + CubicSpline(at, sent - at)(time)
    chips = np.floor(1.023e6 * (sent % 1e-3)).astype(int) % 1023
    return ca_code(model.satellites[k].prn)[chips] * np.exp(-2j * np.pi * (phase % 1.0))


def test_same_seed_same_bytes_in_every_file(recording, tmp_path):
    again = simulate_still(SHORT, tmp_path)
    for name in ("if_path", "descriptor_path", "truth_path", "nav_path"):
        assert getattr(again, name).read_bytes() == getattr(recording, name).read_bytes()
    other = simulate_still(StillConfig(duration=0.3, seed=2), tmp_path)
    assert other.if_path.read_bytes() != recording.if_path.read_bytes()


def test_only_the_four_files_are_left(recording):
    names = sorted(path.name for path in recording.if_path.parent.iterdir())
    assert names == ["if.bin", "if.bin.yaml", "nav.rnx", "truth.npz"]


@pytest.mark.parametrize("chunk_segments", [1, 7])
def test_chunks_of_any_size_give_the_same_bytes(recording, chunk_segments):
    stream = IfStream(still_model(SHORT), FrontEnd(IfFormat.from_text("iq2")), seed=1)
    data = b"".join(part for _, part in stream.chunks(1_200_000, chunk_segments=chunk_segments))
    assert data == recording.if_path.read_bytes()


@pytest.mark.parametrize("chunk", [80_000, 333_332])
def test_spans_that_know_no_segments_give_the_same_bytes(recording, chunk):
    stream = IfStream(still_model(SHORT), FrontEnd(IfFormat.from_text("iq2")), seed=1)
    starts = range(0, 1_200_000, chunk)
    data = [stream.packed(at, min(chunk, 1_200_000 - at)).tobytes() for at in starts]
    assert b"".join(data) == recording.if_path.read_bytes()


def test_descriptor_tells_format_rate_and_utc_of_the_start(recording):
    values = yaml.safe_load(recording.descriptor_path.read_text())
    assert values == {
        "format": "iq2 coding=sign_magnitude order=lsb_first",
        "sample_rate_hz": 4.0e6,
        "intermediate_frequency_hz": 0.0,
        "start_utc_ns": 1767226240000000000,  # 2026-01-01 00:10:40 UTC = 00:10:58 GPS
    }
    assert recording.if_path.stat().st_size == 600_000


def test_navigation_file_holds_the_ephemerides_that_were_used(recording):
    ephemerides = read_rinex_nav(recording.nav_path).ephemerides
    used = [item.ephemeris for item in still_model(SHORT).satellites]
    assert [item.satellite for item in ephemerides] == list(recording.satellites)
    for ours, theirs in zip(used, ephemerides, strict=True):
        # 13 digits: 1e-12 of 26 000 km are 0.03 mm.
        assert theirs.sqrt_a == pytest.approx(ours.sqrt_a, rel=1e-12)
        assert theirs.m0 == pytest.approx(ours.m0, abs=1e-11)


def test_truth_has_a_row_every_ten_milliseconds(recording):
    model = still_model(SHORT)
    with np.load(recording.truth_path) as truth:
        np.testing.assert_allclose(truth["t_s"], np.arange(31) / 100, rtol=0, atol=1e-12)
        phase = model.carrier_phase_cycles(truth["t_s"])
        np.testing.assert_array_equal(truth["carrier_phase_cycles"], phase)
        assert truth["carrier_doppler_hz"].shape == truth["range"].shape == phase.shape
        assert truth["antenna_ecef"].shape == (31, 3)
        assert truth["prn"].tolist() == [int(name[1:]) for name in recording.satellites]
        assert int(truth["start_week"]) == 2399


def test_every_satellite_is_found_in_the_file_at_its_phase_and_cn0(recording):
    model, count = still_model(SHORT), 1_200_000
    packing = IfFormat.from_text("iq2")
    i, q = np.empty(count, np.int8), np.empty(count, np.int8)
    packing.unpack(np.fromfile(recording.if_path, np.uint8), i, q)
    time = np.arange(count) / 4e6
    # 2 bits cost 0.55 dB; the code of another satellite is noise of 6.6e-7 of its C/N0.
    others = 6.6e-7 * np.sum(10 ** (np.array([s.cn0_dbhz for s in model.satellites]) / 10))
    excess = []
    for k, item in enumerate(model.satellites):
        mixed = ((i + 1j * q) * replica(model, k, time, 0.02)).reshape(300, 10, 400).mean(axis=2)
        mixed *= np.sign(mixed.mean(axis=1).real)[:, None]  # the data bit, 5 sigma in 1 ms
        # 300 ms at 40 dB-Hz know the phase to 0.75 degree: 4 sigma.
        assert abs(np.rad2deg(np.angle(mixed.mean()))) < 3.0
        cn0 = 10 * np.log10(mixed.mean().real ** 2 / (2 * mixed.imag.var()) * 10_000)
        excess.append(cn0 - item.cn0_dbhz + 0.55 + 10 * np.log10(1 + others))
    # 0.3 s measure one satellite to 0.15 dB and the mean of nine to 0.05 dB.
    assert np.abs(excess).max() < 0.6
    assert abs(np.mean(excess)) < 0.2


def test_synthesised_phase_is_the_analytic_one_at_50_g():
    still = still_model(SHORT)

    def shaken(time):
        swing = 0.497 * np.sin(2 * np.pi * 5.0 * time)
        return still.antenna(time) + swing[:, None] * np.array([0.6, 0.0, 0.8])

    rate, count = 4e6, 800_000
    model = SignalModel(still.satellites[3:4], still.start, shaken, clock=still.clock)
    packing = IfFormat.from_text("iq16")
    synthesizer = IfSynthesizer(packing, rate, 0.0, [model.satellites[0].prn], noise=False)
    span = synthesizer.segment_samples / rate
    i, q = synthesizer.levels(model.segments(0, 21, span), 0, count)
    mixed = (i + 1j * q) * replica(model, 0, np.arange(count) / rate)
    prompt = mixed.reshape(-1, 400).mean(axis=1)
    error = np.angle(prompt**2) / 2 / (2 * np.pi)  # data bits squared away
    assert np.abs(error).max() < 0.001


def test_data_bits_decode_from_the_samples():
    rate = 1.1e6
    config = StillConfig(duration=8.2, sample_rate_hz=rate, tow=346253, clock_bias=0.0)
    model = still_model(config)
    alone = SignalModel(model.satellites[3:4], model.start, model.antenna)
    synthesizer = IfSynthesizer(
        IfFormat.from_text("iq8"), rate, 0.0, [alone.satellites[0].prn], seed=4
    )
    span = synthesizer.segment_samples / rate
    # The beginning of the first bit that begins in the recording.
    sent = -alone.delays(np.array([0.0])).pseudorange[0, 0] / SPEED_OF_LIGHT
    skip = -sent % 0.02
    bits = []
    for second in range(8):
        begin = round((second + skip) * rate)
        count = round((second + 1 + skip) * rate) - begin
        first = begin // synthesizer.segment_samples
        segments = alone.segments(first, int(1.05 / span) + 2, span)
        i, q = synthesizer.levels(segments, begin, count)
        mixed = (i + 1j * q) * replica(alone, 0, (begin + np.arange(count)) / rate, 0.02)
        bits.append(mixed[: 50 * (count // 50)].reshape(50, -1).sum(axis=1).real)
    events = LnavDecoder("G14", 2399).push(np.concatenate(bits), 0)
    subframes = [event for event in events if isinstance(event, SubframeEvent)]
    assert [(event.tow_ms, event.subframe_id) for event in subframes] == [(346254_000, 5)]
    assert subframes[0].polarity == 1
    assert subframes[0].bit_index == round((1.0 - sent - skip) * 50)


def test_memory_does_not_grow_with_the_length():
    model = still_model(SHORT)
    stream = IfStream(model, FrontEnd(IfFormat.from_text("iq8")), seed=1)
    peaks = []
    for count in (1_000_000, 6_000_000):
        tracemalloc.start()
        for _ in stream.chunks(count, chunk_segments=5):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_bad_settings_and_places_get_one_clear_line(tmp_path):
    with pytest.raises(InputError, match="sample_rate_hz"):
        simulate_still(StillConfig(sample_rate_hz=1e5), tmp_path)
    with pytest.raises(InputError, match="no satellite is visible"):
        simulate_still(StillConfig(elevation_mask_deg=89.9), tmp_path)
    with pytest.raises(InputError, match="IF format"):
        simulate_still(StillConfig(if_format="iq3"), tmp_path)
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(InputError, match="file"):
        simulate_still(SHORT, blocked)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_progress_is_told_to_the_end(tmp_path):
    seen = []
    simulate_still(SHORT, tmp_path, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 0.3
