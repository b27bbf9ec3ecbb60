import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from deepseis_bringup.simulation import figures as sim_figures
from deepseis_bringup.simulation import page as sim_page
from deepseis_bringup.simulation import signal as sim_signal
from deepseis_bringup.simulation.envelope import Envelope
from deepseis_bringup.simulation.pictures import Pictures
from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.types import IfBlock, ImuSample, LdvVelocity, Pvt, Truth
from deepseis_sim.artificial_earthquake import Artificial
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import Item
from deepseis_sim.recording import FrontEnd
from deepseis_sim.scenario import Scenario, load_scenario, summary_of
from deepseis_sim.sky import Obstruction, SkyConfig

RATE, IF_HZ = 1.0e6, 0.1e6
BEGIN, END, DURATION = 4.0, 14.0, 16.0
NAMES = ("G03", "G11", "G22")
ELEVATION, AZIMUTH = np.deg2rad([70.0, 30.0, 15.0]), np.deg2rad([10.0, 100.0, 250.0])
AMPLITUDE, OMEGA = 0.05, 2.0 * np.pi  # [m] at 1 Hz: 0.2 g


class FakeSky:
    def directions(self, time):
        return tuple(np.tile(angles, (len(time), 1)) for angles in (ELEVATION, AZIMUTH))

    def cn0_dbhz(self, time):
        cn0 = np.tile([48.0, 42.0, -np.inf], (len(time), 1))
        cn0[(time > 6.0) & (time < 9.0), 1] = -np.inf
        return cn0


class FakeBench:
    """A bench whose ground swings east, and its streams."""

    def __init__(self, moving=True, signal=True, **changes):
        self.scenario = Scenario(
            **{
                **{"title": "A swing", "duration": DURATION, "signal": signal},
                **{"truth_rate_hz": 200, "motion": (), "sky": SkyConfig(obstructions=WALLS)},
                **changes,
            }
        )
        self.moving, self.sky, self.start = moving, FakeSky(), GpsTime(2400, 0)
        self.motion = SimpleNamespace(span=(BEGIN, END) if moving else (0.0, 0.0))
        self.site = SimpleNamespace(C_e_enu=np.eye(3)[[2, 0, 1]])
        self.model = SimpleNamespace(
            satellites=[SimpleNamespace(satellite=name) for name in NAMES],
            antenna=lambda t: self.antenna_ecef + self.states(t)[0] @ self.site.C_e_enu.T,
        )
        self.antenna_ecef = np.array([4e6, 3e6, 4e6])
        self.sample_rate_hz, self.stands_in, self.base = RATE, False, None
        self.front_end = FrontEnd(IfFormat.from_text("iq8"), RATE, IF_HZ)

    def clock(self, t):
        return 1e-4 + 1e-7 * t + 1e-9 * np.sin(t)

    def states(self, t):
        on = self.moving * ((t > BEGIN) & (t < END))
        phase = OMEGA * (t - BEGIN)
        east = [
            AMPLITUDE * on * np.sin(phase),
            AMPLITUDE * OMEGA * on * np.cos(phase),
            -AMPLITUDE * OMEGA**2 * on * np.sin(phase),
        ]
        return [np.stack([x, 0 * t, 0 * t], axis=1) for x in east]

    def nearing(self, t):
        """Doppler of the motion [Hz], shape (m, n): v.u / lambda."""
        flat = np.cos(ELEVATION) * np.sin(AZIMUTH)
        return self.states(t)[1][:, :1] * flat / L1_WAVELENGTH

    def orbit(self, t):
        return 1000.0 - 0.5 * t[:, None] * np.arange(1, 4) + 2e-4 * t[:, None] ** 2

    def truth(self, begin, end):
        t = np.arange(round(begin * 200), round(end * 200)) / 200
        p, v, a = (x @ self.site.C_e_enu.T for x in self.states(t))
        s = t[::2]
        index, none = np.round(t * RATE).astype(np.int64), np.zeros((s.size, 3))
        doppler = self.orbit(s) + self.nearing(s)
        cn0 = self.sky.cn0_dbhz(s).astype(np.float32)
        still = np.tile([0.0, 0.0, 0.0, 1.0], (t.size, 1))
        return Truth(
            int(index[-1]), index, self.antenna_ecef + p, v, a, still, index[::2], NAMES,
            none, none, none, doppler, cn0, self.clock(s),
        )  # fmt: skip

    def items(self):
        for begin in np.arange(0.0, DURATION, 0.25):
            yield Item(round(begin * 1e9), "truth", self.truth(begin, begin + 0.25))
        yield from (self.imu(n) for n in range(1, round(50 * DURATION)))
        if self.scenario.signal:
            yield from (self.block(n) for n in range(round(50 * DURATION)))

    def imu(self, number):
        t = number / 50
        force = self.states(np.array([t]))[2][0] + [0.0, 0.0, STANDARD_GRAVITY]
        sample = ImuSample(round(t * RATE), np.array([1e-3, 0.0, -2e-3]), force, 0.0, 0.0)
        return Item(round(t * 1e9), "imu/data_raw", sample)

    def block(self, number):
        """Noise, and a tone 0.2 MHz above L1."""
        start, noise = number * 20_000, np.random.default_rng(number)
        n = start + np.arange(20_000)
        i, q = 30.0 * noise.standard_normal((2, n.size))
        tone = 20.0 * np.exp(2j * np.pi * (IF_HZ + 0.2e6) / RATE * n)
        levels = [np.clip(np.round(x), -127, 127).astype(np.int8) for x in
                  (i + tone.real, q + tone.imag)]  # fmt: skip
        data = self.front_end.format.pack(*levels)
        block = IfBlock(start, n.size, RATE, IF_HZ, "iq8", data)
        return Item(number * 20_000_000, "if/samples", block)


WALLS = (
    Obstruction(azimuth_from_deg=330.0, azimuth_to_deg=20.0, elevation_to_deg=25.0, loss_db=8.0),
    Obstruction(keep=2, from_s=6.0, to_s=9.0),
)
SUMMARY = {"motion_stands_in": False, "imu_grade": "span-fsas", "imu_clipped_samples": 7}
SUMMARY |= {"messages.truth": 64, "baseline_m": 2920.0, "scenario": "a<b"}


def collected(bench):
    pictures = Pictures(bench)
    for item in bench.items():
        pictures.add(item)
    return pictures


@pytest.fixture(scope="module")
def swing():
    return collected(FakeBench())


def titles(pictures):
    groups = sim_page.sections(pictures, sim_page.Colours(NAMES))
    return {name: [figure.title for figure in figures] for name, figures in groups if figures}


def drawings(html):
    (found,) = re.findall(r'<script type="application/json" id="figures">(.*?)</script>', html)
    return json.loads(found)


def test_an_envelope_keeps_the_extremes_of_every_bin_however_it_is_cut():
    noise = np.random.default_rng(1)
    t = np.sort(noise.uniform(0.0, 10.0, 40_000))
    y = noise.standard_normal((t.size, 2))
    whole, parts = Envelope(2.0, 8.0, 2), Envelope(2.0, 8.0, 2)
    whole.add(t, y)
    for cut in np.array_split(np.arange(t.size), 777):
        parts.add(t[cut], y[cut])
    times, values = whole.record(1)
    assert_allclose(parts.record(1), (times, values), rtol=0)
    edges = np.linspace(2.0, 8.0, 1501)
    for k in (0, 700, 1499):
        inside = y[(t >= edges[k]) & (t < edges[k + 1]), 1]
        assert {inside.min(), inside.max()} <= set(values)
    assert np.all(np.diff(times) > 0)
    assert times[0] >= 2.0
    assert times[-1] <= 8.0
    assert set(values) <= set(y[:, 1])
    assert whole.peak(0) == np.abs(y[(t >= 2.0) & (t <= 8.0), 0]).max()


def test_single_values_and_rows_make_the_same_envelope_and_holes_stay_empty():
    t = np.arange(0.0, 10.0, 0.01)
    y = np.sin(t)
    y[(t > 4.0) & (t < 6.0)] = -np.inf
    one, other = Envelope(0.0, 10.0, 1), Envelope(0.0, 10.0, 1)
    one.add(t, y[:, None])
    for moment, value in zip(t, y, strict=True):
        other.push(moment, np.array([value]))
    assert_allclose(one.record(0), other.record(0), rtol=0)
    times, values = one.record(0)
    assert not np.any((times > 4.0) & (times < 6.0))
    assert np.isfinite(values).all()
    assert np.isnan(Envelope(0.0, 1.0, 1).peak(0))


def test_the_motion_comes_out_in_east_north_up(swing):
    peaks = [record.peak(0) for record in (swing.position, swing.velocity, swing.acceleration)]
    assert_allclose(peaks, AMPLITUDE * OMEGA ** np.arange(3), rtol=2e-3)  # 200 samples a second
    assert swing.position.peak(1) < 1e-8 > swing.position.peak(2)  # rounding of 6e6 m
    assert swing.window == (2.0, 16.0)
    track = swing.track
    assert_allclose(np.abs(track[:, 1]).max(), AMPLITUDE, rtol=2e-3)
    assert_allclose(sim_figures.speed(track).max(), AMPLITUDE * OMEGA, rtol=0.01)


def test_the_response_at_resonance_is_that_of_theory(swing):
    spectra = swing.response()
    curve = spectra[0].sa_pseudo
    # after n cycles of resonance a steady 1 / (2 xi) is built up but for exp(-2 pi xi n)
    expected = AMPLITUDE * OMEGA**2 / (2 * 0.05) * (1 - np.exp(-2 * np.pi * 0.05 * 10))
    assert_allclose(curve.max(), expected, rtol=0.03)
    assert spectra[1].sa_pseudo.max() < 1e-9


def test_the_doppler_of_the_motion_is_the_velocity_towards_the_satellites(swing):
    for k in range(3):
        t, change = sim_signal._without_orbit(swing, k)
        expected = swing.bench.nearing(t)[:, k]
        assert_allclose(change, expected, atol=1e-3)  # Hz, of 1.6; the orbit makes 1000


def test_a_tone_stands_where_it_is_in_the_spectrum(swing):
    f, power = swing.if_spectrum()
    assert abs(f[np.argmax(power)] - 0.2e6) <= RATE / 4096
    # a tone of 20^2 over noise of 2 * 30^2 in a segment of 4096: 29.6 dB; Hann takes 1.8
    assert power.max() == pytest.approx(27.8, abs=1.5)
    assert f[0] == pytest.approx(-0.6e6)
    assert f[-1] < 0.4e6


def test_the_ideal_quantiser_has_the_shares_of_the_normal_distribution():
    two_bits = sim_signal.ideal_shares(np.array([-3, -1, 1, 3]), True, 0.9957)
    outer = norm.sf(0.9957)
    assert_allclose(two_bits, [outer, 0.5 - outer, 0.5 - outer, outer], rtol=1e-12)
    fine = sim_signal.ideal_shares(np.arange(-127, 128), False, 0.03076)
    assert_allclose(fine.sum(), 1.0)
    assert_allclose(fine[127], norm.cdf(0.01538) - norm.cdf(-0.01538))


def test_the_histogram_counts_all_samples(swing):
    figure = sim_signal.histogram(swing)
    levels, counts = swing.level_counts()
    assert counts.sum() == 2 * 100_000
    assert np.abs(levels).max() <= 127
    assert len(figure.panels[0].data) == 2


def test_the_page_has_what_the_run_has_data_for(swing):
    found = titles(swing)
    assert found["Motion"] == [
        "Acceleration", "Velocity", "Displacement", "Trajectory, in plan", "Response spectrum"
    ]  # fmt: skip
    assert found["Sensors"] == ["Specific force", "Angular rate"]
    assert found["Sky and signal"] == [
        *("Sky", "Signal strength", "Doppler of the motion"),
        *("Spectrum of the samples", "Quantiser", "Clocks"),
    ]


def test_what_stands_still_has_no_motion_and_what_has_no_signal_no_samples():
    found = titles(collected(FakeBench(moving=False, signal=False)))
    assert "Motion" not in found
    assert found["Sky and signal"] == ["Sky", "Signal strength", "Doppler of the motion", "Clocks"]


def test_a_run_without_imu_or_values_is_drawn_too(tmp_path):
    pictures = Pictures(FakeBench(imu=None))
    html = sim_page.page(pictures, {}, tmp_path, "empty")
    assert "Specific force" not in html
    assert drawings(html)


def test_velocimeter_and_given_positions_are_shown():
    scenario = load_scenario("gravity-lines")
    other = load_scenario("artificial")
    bench = FakeBench(ldv=scenario.ldv, positions=other.positions)
    pictures = collected(bench)
    for n in range(1, 100):
        t = np.array([n / 10])
        true = bench.model.antenna(t - bench.clock(t))[0]
        off = bench.site.C_e_enu @ [0.01, -0.02, 0.03]
        index, nan = round(t[0] * RATE), np.full((3, 3), np.nan)
        fix = Pvt(index, 2400, 0, index, 3, true + off, nan[0], 0.0, 0.0, nan, nan)
        beams = np.zeros(2)
        ldv = LdvVelocity(index, index, beams, beams, 12.5, -0.5, beams.astype(np.float32), 300.0)
        pictures.add(Item(index * 1000, "gnss/pvt", fix))
        pictures.add(Item(index * 1000, "ldv/velocity", ldv))
    assert titles(pictures)["Sensors"][2:] == ["Laser velocimeter", "Errors of the positions"]
    peaks = [pictures.fixes.peak(k) for k in range(3)]
    assert_allclose(peaks, [0.01, 0.02, 0.03], atol=1e-8)
    assert [pictures.ldv.peak(k) for k in range(2)] == [12.5, 0.5]


def test_the_page_stands_alone_and_is_small(swing, tmp_path):
    (tmp_path / "truth.npz").write_bytes(b"123")
    html = sim_page.page(swing, SUMMARY, tmp_path, "swing & co")
    own = re.sub(r"<script>.*?</script>", "", html, flags=re.DOTALL)
    assert not re.search(r"(src|href)=|https?://", own)
    assert len(own) < 400_000
    assert "NaN" not in own
    assert "swing &amp; co" in own
    assert "a&lt;b" in own
    assert all(name in own for name in ("truth.npz", "0.201", "2.92", "IMU samples clipped"))
    for panel in drawings(html):
        axes = {key.replace("axis", "") for key in panel["layout"] if "axis" in key}
        assert {trace.get("yaxis", "y") for trace in panel["data"]} <= axes | {"y"}


def test_the_verdict_says_what_was_made_and_that_a_motion_stands_in(swing, tmp_path):
    text = sim_page.verdict(swing, SUMMARY)
    assert text.startswith("16 s, in motion for 10 s from 4 s on; peak ground acceleration ")
    assert "0.201 g (east); 3 satellites; inertial unit of grade span-fsas at 200 Hz" in text
    assert "base station 2.9 km away." in text
    assert "stands in" not in sim_page.page(swing, SUMMARY, tmp_path, "x")
    html = sim_page.page(swing, SUMMARY | {"motion_stands_in": True}, tmp_path, "x")
    assert "stands in for it" in html


def test_obstructions_are_drawn_where_they_are_and_told(swing):
    figure = sim_signal.sky(swing, sim_page.Colours(NAMES))
    (sector,) = [trace for trace in figure.panels[0].data if trace["type"] == "barpolar"]
    assert sector["theta"] == [355.0]
    assert sector["width"] == [50.0]
    assert sector["base"] == [65.0]
    assert sector["r"] == [25.0]
    assert "Shaded: 8 dB of loss below 25°." in figure.caption
    assert "All but the 2 highest satellites: no signal, from 6 to 9 s." in figure.caption
    (hidden,) = [t for t in figure.panels[0].data if t.get("text") == ["G03", "G11"]]
    assert hidden["marker"]["color"] == [48.0, 42.0]


def test_a_made_earthquake_is_shown_beside_the_spectrum_it_was_made_for():
    bench = FakeBench(motion=(Artificial(start=BEGIN, pga=2.0),))
    figure = sim_figures.response(collected(bench))
    names = [trace["name"] for trace in figure.panels[0].data if trace.get("showlegend")]
    assert names == ["design, horizontal", "vertical", "east"]
    assert "±5 %" in figure.caption
    bench.stands_in = True  # another motion runs in its place
    assert "GB 50011" not in sim_figures.response(collected(bench)).caption


def test_a_run_of_the_bench_itself_makes_a_page(tmp_path):
    bench = Bench(load_scenario("sine-2hz", short=True, settings=["duration=1.0", "signal=false"]))
    pictures = Pictures(bench)
    for begin, end in bench.spans():
        for item in bench.items(begin, end):
            pictures.add(item)
    summary = {**summary_of(bench.scenario), **bench.figures(), **pictures.figures()}
    html = sim_page.page(pictures, summary, tmp_path, "sine-2hz")
    assert "1 s at rest" in html  # it would begin to move later
    assert len(drawings(html)) == 5  # too short for a Doppler
