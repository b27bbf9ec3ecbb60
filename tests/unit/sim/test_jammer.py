"""Jammers: their power and spectrum, as a spectrum analyser would show them, and the gain."""

import itertools

import numpy as np
import pytest
from scipy import signal, stats

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_sim.agc import FollowingGain
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.if_synthesis import OPTIMUM_STEP, IfSynthesizer, SignalSegments
from deepseis_sim.jammer import JammerConfig, band_taps
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.recording import FrontEnd, IfStream
from deepseis_sim.signal_model import SignalModel, still

RATE = 4e6


def nothing(count):
    """Segments without satellites."""
    return SignalSegments(
        0,
        np.zeros((0, count, 4)),
        np.zeros((0, count, 4)),
        np.zeros((0, count), np.int64),
        np.zeros((0, count)),
        np.zeros((0, 1), np.uint8),
    )


def samples(jammer, text="iq16", intermediate_hz=0.0, count=400_000, noise=False, start=0, **more):
    """Return I + jQ (or real samples) in units of the noise's standard deviation."""
    synthesizer = IfSynthesizer(
        IfFormat.from_text(text), RATE, intermediate_hz, [], noise=noise, jammers=[jammer], **more
    )
    table = nothing(-(-(start + count) // synthesizer.segment_samples))
    i, q = synthesizer.levels(table, start, count)
    i, q = i * synthesizer.step(0, 1)[0], q * synthesizer.step(0, 1)[0]
    return i if synthesizer.format.is_real else i + 1j * q


@pytest.mark.parametrize(("text", "share"), [("iq16", 1.0), ("real16", 2.0)])
@pytest.mark.parametrize("kind", ["cw", "band"])
def test_power_over_the_noises_density_is_what_was_asked(kind, text, share):
    jammer = JammerConfig(kind=kind, j_to_n0_dbhz=66.0, frequency_offset_hz=1e5, bandwidth_hz=5e5)
    x = samples(jammer, text, 1e6 if text == "real16" else 0.0)
    # N0 is 2 / fs: two components of variance 1 in fs, or one in fs / 2. A real signal of
    # amplitude A has the power A^2 / 2, a complex one A^2.
    power = np.mean(np.abs(x) ** 2)
    j_to_n0 = power / (2 / RATE)
    # 400 000 samples of a band of 0.5 MHz: 50 000 independent ones, 0.45 % or 0.02 dB, 4 sigma.
    assert 10 * np.log10(j_to_n0) == pytest.approx(66.0, abs=0.1)


@pytest.mark.parametrize(
    ("text", "intermediate_hz", "seen_hz"),
    [("iq16", 0.0, 3e5), ("iq16 inverted", 0.0, -3e5), ("real16", 1e6, 1.3e6),
     ("real16 inverted", 1e6, 0.7e6), ("iq16", -5e5, -2e5)],
)  # fmt: skip
def test_a_carrier_stands_at_its_frequency_and_is_exact_in_every_sample(
    text, intermediate_hz, seen_hz
):
    jammer = JammerConfig(frequency_offset_hz=3e5, j_to_n0_dbhz=70.0)
    x = samples(jammer, text, intermediate_hz)
    n = np.arange(x.size)
    turn = seen_hz / RATE * n
    rows = np.exp(2j * np.pi * turn)
    if np.isrealobj(x):
        rows = np.stack([rows.real, rows.imag])
        fitted = np.linalg.lstsq(rows.T, x, rcond=None)[0] @ rows
    else:
        fitted = (x @ rows.conj()) / n.size * rows
    # A phase that crept would show: rounding to 16 bits is 0.29 / 4096 of a standard deviation.
    assert np.abs(x - fitted).max() < 2 / 4096
    assert np.abs(fitted).max() > 1.0


def test_a_carrier_of_odd_frequency_does_not_creep_in_an_hour():
    frequency = 123_456.7
    jammer = JammerConfig(frequency_offset_hz=frequency, j_to_n0_dbhz=70.0)
    early = samples(jammer, count=5000)
    segment = 39 * 1024
    late_start = 360_000 * segment
    synthesizer = IfSynthesizer(
        IfFormat.from_text("iq16"), RATE, 0.0, [], noise=False, jammers=[jammer]
    )
    table = SignalSegments(
        360_000, *(getattr(nothing(1), name) for name in (
            "carrier_phase_cycles", "code_phase_chips", "code_period", "cn0_dbhz", "bits")),
    )  # fmt: skip
    i, q = synthesizer.levels(table, late_start, 5000)
    late = (i + 1j * q) * synthesizer.step(0, 1)[0]
    # Whole numbers: 123456.7 / 4e6 cycles a sample, as the fraction the double stands for.
    from fractions import Fraction

    turned = Fraction(frequency) / 4_000_000 * late_start % 1
    expected = early * np.exp(2j * np.pi * float(turned))
    assert np.abs(late - expected).max() < 2 / 4096


@pytest.mark.parametrize("bandwidth_hz", [20e3, 200e3, 1e6, 3e6])
def test_a_band_is_flat_within_and_sixty_decibels_down_outside(bandwidth_hz):
    middle = 0.0 if bandwidth_hz > 2e6 else -4e5
    jammer = JammerConfig(
        kind="band", bandwidth_hz=bandwidth_hz, frequency_offset_hz=middle, j_to_n0_dbhz=72.0
    )
    x = samples(jammer, count=2_000_000)
    size = 2048 if bandwidth_hz < 1e5 else 512
    frequency, density = signal.welch(
        x, RATE, ("kaiser", 12.0), size, return_onesided=False, detrend=False
    )
    expected = 10**7.2 * (2 / RATE) / bandwidth_hz
    offset = np.abs(frequency - middle)
    blur = 4 * RATE / size
    inside = offset < 0.35 * bandwidth_hz - 0.5 * blur
    outside = offset > 0.75 * bandwidth_hz + blur
    mean = density[inside].mean() / expected if inside.any() else 1.0
    # All of the power is there; sloping edges leave a narrow band up to 8 % more within.
    assert 10 * np.log10(mean) == pytest.approx(0.2, abs=0.25)
    if outside.any():
        assert 10 * np.log10(density[outside].max() / expected) < -57.0


def test_band_noise_is_gaussian_and_its_own():
    jammer = JammerConfig(kind="band", bandwidth_hz=1e6, j_to_n0_dbhz=66.0)
    x = samples(jammer, count=2_000_000)[::13]
    part = np.concatenate([x.real, x.imag]) / np.sqrt((np.abs(x) ** 2).mean() / 2)
    assert stats.kstest(part, "norm").pvalue > 1e-4
    assert abs((x**2).mean()) < 4 * (np.abs(x) ** 2).mean() * np.sqrt(2 / x.size)  # circular
    bare = samples(jammer, count=100_000, noise=True) - samples(jammer, count=100_000)
    other = samples(jammer, count=100_000, seed=1)
    same = samples(jammer, count=100_000)
    for a, b in ((bare, same), (other, same)):
        # 25 000 independent values each
        together = abs((a * b.conj()).mean()) / np.sqrt(
            (np.abs(a) ** 2).mean() * (np.abs(b) ** 2).mean()
        )
        assert together < 4 / np.sqrt(25_000)


@pytest.mark.parametrize("bandwidth_hz", [16e3, 300e3, 2e6])
def test_the_low_pass_keeps_the_variance(bandwidth_hz):
    factor, taps = band_taps(bandwidth_hz, RATE)
    gain = (taps.astype(float) ** 2).sum(axis=1)
    assert gain.mean() == pytest.approx(1.0, rel=1e-5)
    # White noise of one rate through a polyphase filter: cyclostationary by its images, -57 dB.
    assert np.ptp(gain) < 0.01
    assert RATE / factor >= 2 * bandwidth_hz or factor == 1


def received(text="iq2", **more):
    time = GpsTime(2399, 346258 * 10**9)
    place = ecef_from_geodetic([0.6, 2.4, 10.0])
    seen = visible_satellites(nominal_constellation(time), time, place)
    front_end = FrontEnd(IfFormat.from_text(text), RATE, 1e6 if "real" in text else 0.0)
    return IfStream(SignalModel(seen, time, still(place)), front_end, seed=5, **more)


JAMMERS = (
    JammerConfig(frequency_offset_hz=2e5, start_s=0.013),
    JammerConfig(kind="band", bandwidth_hz=3e5, times_s=(0.0, 0.1), offsets_db=(-20.0, 10.0)),
    JammerConfig(kind="band", bandwidth_hz=1.2e6, stop_s=0.07),
)


@pytest.mark.parametrize("text", ["iq2", "real8"])
@pytest.mark.parametrize("agc_s", [0.0, 0.05])
def test_any_chunking_gives_the_same_bytes(text, agc_s):
    whole = received(text, jammers=JAMMERS, agc_s=agc_s).packed(0, 440_000)
    stream = received(text, jammers=JAMMERS, agc_s=agc_s)
    cuts = [0, 1000, 39_936, 41_000, 80_000, 240_000, 439_000, 440_000]
    parts = [stream.packed(a, b - a) for a, b in itertools.pairwise(cuts)]
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    again = stream.packed(80_000, 160_000)  # and going back
    assert again.tobytes() == parts[4].tobytes()


def test_a_jammer_that_is_off_leaves_every_sample_as_it_was():
    off = JammerConfig(kind="band", start_s=5.0)
    plain = received().packed(0, 100_000)
    assert received(jammers=[off]).packed(0, 100_000).tobytes() == plain.tobytes()


def test_the_profile_is_straight_in_decibels():
    jammer = JammerConfig(
        j_to_n0_dbhz=60.0, start_s=1.0, stop_s=9.0, times_s=(2.0, 4.0), offsets_db=(0.0, 30.0)
    )
    level = jammer.level_dbhz(np.array([0.5, 1.0, 3.0, 4.0, 8.9, 9.0]))
    np.testing.assert_allclose(level, [-np.inf, 60.0, 75.0, 90.0, 90.0, -np.inf])
    assert jammer.jammer_to_signal_db(45.0) == 15.0


def test_a_fixed_gain_clips_and_a_following_one_does_not():
    strong = JammerConfig(kind="band", bandwidth_hz=2e6, j_to_n0_dbhz=90.0)  # J / N = 24 dB
    clipped, followed = (
        received("iq4", jammers=[strong], agc_s=agc_s).synthesizer for agc_s in (0.0, 0.05)
    )
    table = received("iq4").segments(0, 12)
    share = [np.mean(np.abs(s.levels(table, 0, 400_000)[0]) == 15) for s in (clipped, followed)]
    # Levels of +-15 begin at 7 steps: 7 x 0.3352 = 2.35 standard deviations of a normal variable.
    assert share[0] > 0.8
    assert share[1] == pytest.approx(2 * stats.norm.sf(7 * 0.3352), abs=0.003)


def test_the_gain_follows_a_step_with_its_time_constant():
    power = 10**6.6 / RATE
    jammer = JammerConfig(j_to_n0_dbhz=66.0, start_s=0.2)
    synthesizer = IfSynthesizer(
        IfFormat.from_text("iq8"), RATE, 0.0, [], jammers=[jammer], agc_s=0.1
    )
    span = synthesizer.segment_span
    followed = (synthesizer.step(0, 100) / OPTIMUM_STEP[8]) ** 2
    number = np.arange(100)
    on = np.flatnonzero((number + 0.5) * span >= 0.2)[0]
    expected = 1 + power * np.where(number >= on, 1 - np.exp(-(number - on + 1) * span / 0.1), 0.0)
    np.testing.assert_allclose(followed, expected, rtol=1e-9)


def test_the_gain_does_not_depend_on_what_was_asked_before():
    def power(time):
        return 2.0 + np.sin(time)

    whole = FollowingGain(power, 0.01, 0.3)(0, 3000)
    gain = FollowingGain(power, 0.01, 0.3)
    for first, count in ((2500, 100), (2590, 40), (100, 3), (101, 5), (0, 1), (2999, 1)):
        np.testing.assert_array_equal(gain(first, count), whole[first : first + count])


@pytest.mark.parametrize(
    ("settings", "text", "reason"),
    [
        ({"frequency_offset_hz": 2.1e6}, "iq8", "outside of the sampled band"),
        ({"kind": "band", "bandwidth_hz": 3e6, "frequency_offset_hz": 6e5}, "iq8", "outside"),
        ({"frequency_offset_hz": -1.1e6}, "real8", "outside"),
        ({"kind": "band", "bandwidth_hz": 1e3}, "iq8", "narrower than 15625 Hz"),
        ({"times_s": (0.0, 1.0), "offsets_db": (0.0,)}, "iq8", "one of offsets_db each"),
        ({"times_s": (1.0, 1.0), "offsets_db": (0.0, 1.0)}, "iq8", "must rise"),
        ({"start_s": 2.0, "stop_s": 1.0}, "iq8", "before it goes on"),
        ({"frequency_offset_hz": np.nan}, "iq8", "outside"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, text, reason):
    with pytest.raises(InputError, match=reason):
        received(text, jammers=[JammerConfig(**settings)])
