"""The IF kernel against a plain NumPy twin, and what a receiver would measure in its output."""

import dataclasses
import itertools

import numpy as np
import pytest

from deepseis_core.ca_code import ca_code
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_sim.if_synthesis import IfSynthesizer, SignalSegments

RATE = 4.0e6
DOPPLER = np.array([3210.7, -2870.3])
JERKY = np.array([900.0, -2577.0])  # Doppler rate [Hz/s]; the second is 50 g
PHASE_0, CODE_0 = np.array([0.3, 0.81]), np.array([5000.25, 20111.6])
PRN = (7, 30)


def segments(synthesizer, count, cn0_dbhz=45.0):
    """Two satellites with constant Doppler rate, and data bits that alternate in pairs."""
    span = synthesizer.segment_samples / synthesizer.sample_rate_hz
    start = span * np.arange(count)
    phase = np.zeros((2, count, 4))
    phase[..., 0] = PHASE_0[:, None] + DOPPLER[:, None] * start + JERKY[:, None] * start**2 / 2
    phase[..., 1] = (DOPPLER[:, None] + JERKY[:, None] * start) * span
    phase[..., 2] = JERKY[:, None] * span**2 / 2
    code = (phase - PHASE_0[:, None, None] * np.array([1.0, 0, 0, 0])) / 1540.0
    code[..., 0] += CODE_0[:, None] + 1.023e6 * start
    code[..., 1] += 1.023e6 * span
    period = np.floor(code[..., 0] / 1023).astype(np.int64)
    code[..., 0] -= 1023 * period
    bits = np.array([[0, 1, 1, 0] * 20, [1, 1, 0, 0] * 20], np.uint8)
    return SignalSegments(0, phase, code, period, np.full((2, count), cn0_dbhz), bits)


def signal(time, k):
    """Return carrier phase [cycles] and chips times data of satellite k, from the formulas."""
    turned = DOPPLER[k] * time + JERKY[k] * time**2 / 2
    chips = np.floor(CODE_0[k] + 1.023e6 * time + turned / 1540.0).astype(np.int64)
    bits = ([0, 1, 1, 0], [1, 1, 0, 0])[k]
    data = 1 - 2 * np.array(bits)[chips // (1023 * 20) % 4]
    return PHASE_0[k] + turned, ca_code(PRN[k])[chips % 1023] * data


def only(table, k):
    """Silence the other satellite."""
    cn0_dbhz = table.cn0_dbhz.copy()
    cn0_dbhz[1 - k] = -np.inf
    return dataclasses.replace(table, cn0_dbhz=cn0_dbhz)


def despread(i, q, rate, k, intermediate_hz=0.0, per_second=1000):
    """Average a satellite's signal over each millisecond or part of it."""
    time = np.arange(i.size) / rate
    phase, chips = signal(time, k)
    replica = chips * np.exp(-2j * np.pi * (phase + intermediate_hz * time))
    per = round(rate / per_second)
    return ((i + 1j * q) * replica)[: i.size // per * per].reshape(-1, per).mean(axis=1)


@pytest.mark.parametrize("rate", [1.3e6, 4.0e6, 16.368e6])
def test_kernel_equals_the_formulas_but_for_rounding(rate):
    synthesizer = IfSynthesizer(IfFormat.from_text("iq16"), rate, 0.0, PRN, noise=False)
    i, q = synthesizer.levels(segments(synthesizer, 3), 0, round(0.02 * rate))
    time = np.arange(i.size) / rate
    twin = 0.0
    for k in range(2):
        phase, chips = signal(time, k)
        twin = twin + chips * np.exp(2j * np.pi * phase)
    scale = synthesizer.amplitude(np.array(45.0)) / synthesizer.step(0, 1)[0]
    difference = np.abs((i + 1j * q) / scale - twin)
    # A chip's edge may fall on the other side of a sample (code phase is good to 1e-5 chip):
    # such samples are few. All else differs by the chord of the phase, 2577 Hz/s, in a tile.
    edges = difference > 0.5
    assert edges.mean() < 2e-4
    chord = 2577.0 * (1024 / rate) ** 2 / 8
    assert difference[~edges].max() < 2 * np.pi * 1.2 * chord + 2e-3 + 2.0 / scale


@pytest.mark.parametrize("rate", [2.0e6, 4.0e6])
def test_carrier_phase_follows_the_polynomial_to_a_thousandth_of_a_cycle(rate):
    synthesizer = IfSynthesizer(IfFormat.from_text("iq16"), rate, 0.0, PRN, noise=False)
    i, q = synthesizer.levels(only(segments(synthesizer, 12), 1), 0, round(0.1 * rate))
    prompt = despread(i, q, rate, 1)
    assert np.abs(np.angle(prompt)).max() / (2 * np.pi) < 0.001


@pytest.mark.parametrize(
    ("text", "loss_db"),
    [("iq16", 0.0), ("iq8", 0.0), ("iq4", 0.05), ("iq2", 0.55), ("iq1", 1.96), ("real8", 0.0)],
)
def test_cn0_is_what_was_asked_minus_the_loss_of_the_quantiser(text, loss_db):
    rate, intermediate_hz = (4.0e6, 0.0) if text.startswith("iq") else (8.0e6, 2.1e6)
    synthesizer = IfSynthesizer(IfFormat.from_text(text), rate, intermediate_hz, PRN, seed=3)
    cn0 = []
    for k in range(2):
        table = only(segments(synthesizer, 51), k)
        i, q = synthesizer.levels(table, 0, round(0.5 * rate))
        q = 0.0 if synthesizer.format.is_real else q
        prompt = despread(i.astype(float), q, rate, k, intermediate_hz, 10_000)
        power, noise = np.abs(prompt.mean()) ** 2, prompt.imag.var() + prompt.real.var()
        cn0.append(10 * np.log10(power / noise * 10_000))
    # 5000 correlators give the noise's power to 0.06 dB, 0.5 s the carrier's to 0.05 dB; the
    # mean of two satellites has half the variance: 0.2 dB are 3.6 standard deviations.
    assert np.mean(cn0) == pytest.approx(45.0 - loss_db, abs=0.2)


def test_two_bits_have_the_shares_of_the_optimum_threshold():
    synthesizer = IfSynthesizer(IfFormat.from_text("iq2"), RATE, 0.0, PRN, seed=5)
    i, _ = synthesizer.levels(segments(synthesizer, 11, 20.0), 0, 400_000)
    # With thresholds at 0.9957 sigma 68.1 % of the samples are small; 4 sigma of 400 000.
    assert (np.abs(i) == 1).mean() == pytest.approx(0.6806, abs=4 * np.sqrt(0.22 / 400_000))
    assert set(np.unique(i).tolist()) == {-3, -1, 1, 3}


def test_mirrored_spectrum_is_the_conjugate():
    upright = IfSynthesizer(IfFormat.from_text("iq16"), RATE, 0.0, PRN, noise=False)
    mirrored = IfSynthesizer(IfFormat.from_text("iq16 inverted"), RATE, 0.0, PRN, noise=False)
    table = segments(upright, 3)
    i, q = upright.levels(table, 0, 40_000)
    mi, mq = mirrored.levels(table, 0, 40_000)
    assert np.abs(mi - i).max() <= 1
    assert np.abs(mq + q).max() <= 1


@pytest.mark.parametrize("text", ["iq2", "real2", "iq8", "iq1 positive=1 order=msb_first"])
def test_any_chunking_gives_the_same_bytes(text):
    synthesizer = IfSynthesizer(IfFormat.from_text(text), RATE, 1.0e6, PRN, seed=11)
    table = segments(synthesizer, 5)
    whole = synthesizer.packed(table, 0, 160_000)
    cuts = [0, 1024, 3000, 3008, 77_776, 160_000]
    parts = [synthesizer.packed(table, a, b - a) for a, b in itertools.pairwise(cuts)]
    assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_the_seed_decides_the_noise():
    def run(seed):
        synthesizer = IfSynthesizer(IfFormat.from_text("iq8"), RATE, 0.0, PRN, seed=seed)
        return synthesizer.packed(segments(synthesizer, 2), 0, 40_000)

    assert run(1).tobytes() == run(1).tobytes()
    assert (run(1) != run(2)).mean() > 0.9


def test_a_rate_too_low_for_the_code_is_refused():
    with pytest.raises(InputError, match="below 1 MHz"):
        IfSynthesizer(IfFormat.from_text("iq8"), 0.5e6, 0.0, PRN)
