from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from deepseis_core.baseband import Baseband, phase_increment
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.types import IfBlock

TEXTS = ["real1", "iq1", "real2", "iq2", "real4", "iq4", "real8", "iq8", "real16", "iq16"]


def block(data, text, start, count, rate, frequency):
    packing = IfFormat.from_text(text)
    first = start // packing.samples_per_unit * packing.bytes_per_unit
    part = data[first : first + packing.bytes_for(count)]
    return IfBlock(start, count, rate, frequency, text, part)


def gaussian(packing, rms, count, seed):
    rng = np.random.default_rng(seed)
    parts = [rng.normal(0, rms, count) for _ in range(1 if packing.is_real else 2)]
    top = packing.max_level
    parts = [np.clip(part, -top, top - 1) for part in parts]
    return packing.pack(*parts)


@pytest.mark.parametrize("frequency", [0.0, 1.234567e6, 4.092e6])
@pytest.mark.parametrize("text", TEXTS)
def test_any_chunking_gives_what_one_chunk_gives(text, frequency):
    rate, count = 4.092e6, 4096
    packing = IfFormat.from_text(text)
    data = gaussian(packing, packing.max_level / 4, count, 1)
    whole = Baseband(packing, rate, frequency)
    expected = whole.convert(block(data, text, 0, count, rate, frequency))
    parts = Baseband(whole.pinned_format, rate, frequency)
    text = whole.pinned_format.to_text()
    cuts = [0, 8, 512, 520, 2048, 4088, count]
    pieces = [
        parts.convert(block(data, text, a, b - a, rate, frequency)) for a, b in pairwise(cuts)
    ]
    for k in range(2):
        np.testing.assert_array_equal(np.concatenate([p[k] for p in pieces]), expected[k])


@pytest.mark.parametrize("start", [0, 10**9 + 7, 10**13 + 1, 2**52])
def test_mixing_is_exact_at_any_sample_index(start):
    rate, frequency, count = 20.48e6, 5499998.47412109, 64
    text = "iq8 scale=0.992"
    data = IfFormat.from_text(text).pack(np.full(count, 127), np.zeros(count))
    converter = Baseband(IfFormat.from_text(text), rate, frequency)
    i, q = converter.convert(IfBlock(start, count, rate, frequency, text, data))
    step = Fraction(frequency) / Fraction(rate)
    cycles = np.array([float((start + n) * step % 1) for n in range(count)])
    error = np.angle((i + 1j * q) * np.exp(2j * np.pi * cycles)) / (2 * np.pi)
    # half a step of the table, rounding of int8 at 126 levels, and 2**52 roundings of 2**-65
    assert np.abs(error).max() < 0.5 / 1024 + 0.71 / 126 / (2 * np.pi) + 2**52 / 2**65


def test_phase_increment_wraps_by_whole_cycles():
    assert phase_increment(4.092e6, 4.092e6) == 0
    assert phase_increment(-1e6, 4e6) == 3 * 2**62


# a real signal at IF 0 has no sign of Doppler
@pytest.mark.parametrize(("components", "frequency"), [("real", 1e6), ("iq", 1e6), ("iq", 0.0)])
@pytest.mark.parametrize("inverted", [False, True])
def test_an_approaching_satellite_has_a_positive_doppler(components, inverted, frequency):
    rate, doppler, count = 4e6, 2e3, 8192
    sign = -1 if inverted else 1
    phase = 2 * np.pi * (frequency + sign * doppler) * np.arange(count) / rate
    packing = IfFormat(components, 8, inverted=inverted)
    data = packing.pack(100 * np.cos(phase), 100 * np.sin(phase))
    converter = Baseband(packing, rate, frequency)
    given = IfBlock(0, count, rate, frequency, packing.to_text(), data)
    i, q = converter.convert(given)
    spectrum = np.abs(np.fft.fft((i + 1j * q) * np.hanning(count)))
    spectrum[np.abs(np.fft.fftfreq(count, 1 / rate)) > 1e5] = 0  # without the image at -2 IF
    peak = np.fft.fftfreq(count, 1 / rate)[spectrum.argmax()]
    assert abs(peak - doppler) <= rate / count


@pytest.mark.parametrize("rms", [2.3, 11.0, 40.0])
@pytest.mark.parametrize("text", ["real8", "iq8", "real16", "iq16"])
def test_requantising_costs_less_than_a_twentieth_of_a_decibel(text, rms):
    # noise of unit power in, correlated with what came out: the loss of C/N0 is 1 - rho^2
    rate, frequency, count = 4e6, 1.1e6, 200_000
    packing = IfFormat.from_text(text)
    data = gaussian(packing, rms * (100 if packing.bits == 16 else 1), count, 3)
    i, q = Baseband(packing, rate, frequency).convert(
        IfBlock(0, count, rate, frequency, text, data)
    )
    x = np.empty(count, packing.dtype)
    y = np.zeros(count, packing.dtype)
    packing.unpack(data, x, None if packing.is_real else y)
    carrier = np.exp(-2j * np.pi * frequency * np.arange(count) / rate)
    exact = (x + 1j * y) * carrier
    ours = i + 1j * q
    rho = np.abs(np.vdot(exact, ours)) / np.linalg.norm(exact) / np.linalg.norm(ours)
    assert -20 * np.log10(rho) < 0.05


@pytest.mark.parametrize("text", ["real1", "iq1", "real2", "iq2", "real4", "iq4"])
def test_low_bit_mixing_neither_saturates_nor_loses(text):
    rate, frequency, count = 4e6, 1.1e6, 100_000
    packing = IfFormat.from_text(text)
    data = np.random.default_rng(4).integers(0, 256, packing.bytes_for(count), dtype=np.uint8)
    x = np.empty(count, np.int8)
    y = np.zeros(count, np.int8)
    packing.unpack(data, x, None if packing.is_real else y)
    converter = Baseband(packing, rate, frequency)
    i, q = converter.convert(IfBlock(0, count, rate, frequency, text, data))
    exact = (x + 1j * y) * np.exp(-2j * np.pi * frequency * np.arange(count) / rate)
    error = (i + 1j * q) - converter.scale * exact
    # half a level of rounding, half a step of the carrier's phase at full scale
    assert max(np.abs(error.real).max(), np.abs(error.imag).max()) < 0.5 + 127 * np.pi / 1024 + 0.1


def test_iq_of_eight_bits_at_if_zero_is_only_unpacked():
    data = np.random.default_rng(5).integers(0, 256, 400, dtype=np.uint8)
    given = IfBlock(12345, 200, 4e6, 0.0, "iq8", data)
    i, q = Baseband.for_block(given).convert(given)
    np.testing.assert_array_equal(i, data.view(np.int8)[0::2])
    np.testing.assert_array_equal(q, data.view(np.int8)[1::2])


def test_the_most_negative_level_survives_conjugation():
    data = np.full(2, 0x80, np.uint8)
    given = IfBlock(0, 1, 4e6, 0.0, "iq8 inverted", data)
    assert Baseband.for_block(given).convert(given)[1].tolist() == [127]


def test_a_pinned_scale_makes_every_later_start_agree():
    packing = IfFormat.from_text("iq16")
    data = gaussian(packing, 1000.0, 2000, 6)
    first = Baseband(packing, 4e6, 0.0)
    first.convert(block(data, "iq16", 0, 1000, 4e6, 0.0))
    text = first.pinned_format.to_text()
    assert text == "iq16 scale=0.03125"  # 16 <= 1000 / 32 < 32
    late = Baseband.for_block(block(data, text, 1000, 1000, 4e6, 0.0))
    for a, b in zip(
        first.convert(block(data, "iq16", 1000, 1000, 4e6, 0.0)),
        late.convert(block(data, text, 1000, 1000, 4e6, 0.0)),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    "wrong",
    [
        IfBlock(0, 3, 4e6, 0.0, "iq8", np.zeros(4, np.uint8)),
        IfBlock(0, 2, 5e6, 0.0, "iq8", np.zeros(4, np.uint8)),
        IfBlock(0, 2, 4e6, 1.0, "iq8", np.zeros(4, np.uint8)),
        IfBlock(0, 4, 4e6, 0.0, "real8", np.zeros(4, np.uint8)),
    ],
)
def test_a_block_of_another_stream_or_length_is_refused(wrong):
    converter = Baseband(IfFormat.from_text("iq8"), 4e6, 0.0)
    with pytest.raises(InputError, match="IF block at sample 0"):
        converter.convert(wrong)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_rate_is_refused(rate):
    with pytest.raises(InputError, match="sample rate"):
        Baseband(IfFormat(), rate, 0.0)
