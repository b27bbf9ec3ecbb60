import base64
import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepseis_core.errors import InputError
from deepseis_core.if_format import BITS, COMPONENTS, ORDERS, PRESETS, IfFormat


def all_formats():
    codings = {1: ("bipolar",), 8: ("offset_binary", "twos_complement", "sign_magnitude")}
    for components, bits, order in itertools.product(COMPONENTS, BITS, ORDERS):
        for coding in codings.get(bits, codings[8]):
            signs = (0, 1) if coding in ("bipolar", "sign_magnitude") else (0,)
            levels = ("odd", "integer") if bits in (2, 4) else ("",)
            for positive, level, interleave in itertools.product(
                signs, levels, ("sample", "byte")
            ):
                yield IfFormat(components, bits, coding, order, positive, level, interleave)


FORMATS = sorted(set(all_formats()), key=IfFormat.to_text)


def unpack(packing, data, count):
    i = np.empty(count, packing.dtype)
    q = np.zeros(count, packing.dtype)
    packing.unpack(data, i, None if packing.is_real else q)
    return i, q


def plain_levels(packing, data, count):
    """Unpack bit by bit, as the descriptor's words say: the kernels' plain twin."""
    width = 8 // packing.bits if packing.bits < 8 else 1
    size = max(1, packing.bits // 8)
    stream = []
    for start in range(0, data.size, size):
        group = [int(byte) for byte in data[start : start + size]]
        if size == 2:
            low, high = group if packing.order == "lsb_first" else group[::-1]
            stream.append([256 * high + low])
            continue
        bits = format(group[0], "08b")
        codes = [int(bits[k : k + packing.bits], 2) for k in range(0, 8, packing.bits)]
        stream.append(codes if packing.order == "msb_first" else codes[::-1])
    half = 1 << (packing.bits - 1)

    def level(code):
        if packing.coding in ("bipolar", "sign_magnitude"):
            magnitude = code % half
            magnitude = 2 * magnitude + 1 if packing.levels == "odd" else magnitude
            return magnitude if code // half == packing.positive else -magnitude
        value = code - half if packing.coding == "offset_binary" else (code + half) % (2 * half)
        value = value if packing.coding == "offset_binary" else value - half
        return 2 * value + 1 if packing.levels == "odd" else value

    values = [[level(code) for code in codes] for codes in stream]
    if packing.is_real:
        return np.array(values).ravel()[:count], np.zeros(count)
    if packing.interleave == "byte" and width > 1:
        pair = [np.array(values[0::2]).ravel(), np.array(values[1::2]).ravel()]
    else:
        flat = np.array(values).ravel()
        pair = [flat[0::2], flat[1::2]]
    i, q = pair if packing.components == "iq" else pair[::-1]
    return i[:count], q[:count]


@pytest.mark.parametrize("packing", FORMATS, ids=IfFormat.to_text)
def test_unpacking_equals_reading_bit_by_bit(packing):
    count = 37  # no multiple of any byte's samples
    data = np.random.default_rng(1).integers(0, 256, packing.bytes_for(count), dtype=np.uint8)
    pairs = zip(unpack(packing, data, count), plain_levels(packing, data, count), strict=True)
    for ours, plain in pairs:
        np.testing.assert_array_equal(ours, plain)


@pytest.mark.parametrize("packing", FORMATS, ids=IfFormat.to_text)
def test_packing_unpacked_levels_gives_the_levels_back(packing):
    count = 61
    data = np.random.default_rng(2).integers(0, 256, packing.bytes_for(count), dtype=np.uint8)
    i, q = unpack(packing, data, count)
    again = packing.pack(i, q)
    assert again.size == packing.bytes_for(count)
    for first, second in zip((i, q), unpack(packing, again, count), strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("packing", FORMATS, ids=IfFormat.to_text)
def test_text_gives_the_format_back(packing):
    assert IfFormat.from_text(packing.to_text()) == packing


def test_two_bit_sign_magnitude_levels_are_one_and_three():
    assert IfFormat.from_text("real2").level_of_code.tolist() == [1, 3, -1, -3]


def test_one_bit_levels_are_plus_and_minus_one():
    assert IfFormat.from_text("real1 positive=0").level_of_code.tolist() == [1, -1]
    assert IfFormat.from_text("real1 positive=1").level_of_code.tolist() == [-1, 1]


def test_one_bit_has_one_name_for_each_packing():
    assert IfFormat.from_text("iq1 coding=sign_magnitude").to_text() == (
        "iq1 positive=0 order=lsb_first"
    )
    assert IfFormat.from_text("iq1 coding=offset_binary") == IfFormat.from_text("iq1 positive=1")


def test_packing_what_is_no_level_takes_the_nearest():
    packing = IfFormat.from_text("real2")
    values = np.array([-128, -2, 0, 2, 9, 127], np.int8)
    assert unpack(packing, packing.pack(values), 6)[0].tolist() == [-3, -1, 1, 3, 3, 3]


def test_sixteen_bit_packing_saturates_and_rounds():
    packing = IfFormat.from_text("real16")
    values = np.array([-1e9, -1.4, 0.6, 1e9])
    assert unpack(packing, packing.pack(values), 4)[0].tolist() == [-32768, -1, 1, 32767]


@pytest.mark.parametrize(
    ("text", "unit_bytes", "unit_samples"),
    [("real1", 1, 8), ("iq1", 1, 4), ("iq2 interleave=byte", 2, 4), ("iq4", 1, 1), ("iq16", 4, 1)],
)
def test_unit_is_the_smallest_group_of_whole_samples(text, unit_bytes, unit_samples):
    packing = IfFormat.from_text(text)
    assert (packing.bytes_per_unit, packing.samples_per_unit) == (unit_bytes, unit_samples)
    assert packing.bytes_for(unit_samples + 1) == 2 * unit_bytes
    assert packing.samples_in(3 * unit_bytes - 1) == 2 * unit_samples


def test_too_few_bytes_are_refused_not_padded():
    with pytest.raises(InputError, match="take 20 bytes, here are 19"):
        unpack(IfFormat.from_text("iq8"), np.zeros(19, np.uint8), 10)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "iq",
        "iq3",
        "8",
        "complex8",
        "iq8 iq8",
        "iq8 order",
        "iq8 order=",
        "iq8 order=middle_first",
        "iq8 coding=bipolar",
        "iq1 positive=2",
        "iq8 positive=1",
        "iq8 levels=odd",
        "iq1 levels=integer",
        "iq8 scale=nan",
        "iq8 scale=-1",
        "iq8 inverted inverted",
        "iq8 inverted=0",
        "iq8 bits=4",
        "iq٨",
    ],
)
def test_a_wrong_text_is_refused_with_its_reason(text):
    with pytest.raises(InputError, match="IF format"):
        IfFormat.from_text(text)


WORDS = """real iq qi iq8 real1 iq16 coding= order= scale= positive= levels=odd inverted 0 1 = nan
    coding=offset_binary order=msb_first interleave=byte scale=1e3 scale=1_0 positive=1"""
words = st.sampled_from(WORDS.split())


@settings(max_examples=150, deadline=None)
@given(st.one_of(st.text(max_size=40), st.lists(words, max_size=6).map(" ".join)))
def test_any_text_is_a_format_that_round_trips_or_an_input_error(text):
    try:
        packing = IfFormat.from_text(text)
    except InputError:
        return
    assert IfFormat.from_text(packing.to_text()) == packing


def test_presets_are_formats():
    for name, text in PRESETS.items():
        assert IfFormat.from_text(name) == IfFormat.from_text(text)


@pytest.mark.parametrize(
    ("preset", "file"),
    [
        ("pocketsdr_iq8", "L1_20211202_084700_4MHz_IQ.bin"),
        ("pocketsdr_i8", "L1_20211125_004000_12MHz_I.bin"),
        ("pocketsdr_i8", "L1_20211201_054600_24MHz_I.bin"),
    ],
)
def test_pocketsdr_holds_the_four_levels_of_its_converter(shared_data, preset, file):
    packing = IfFormat.from_text(preset)
    data = np.fromfile(shared_data / "if_captures" / "pocketsdr" / file, np.uint8)
    i, q = unpack(packing, data, packing.samples_in(data.size))
    for part in (i,) if packing.is_real else (i, q):
        levels, counts = np.unique(part, return_counts=True)
        assert levels.tolist() == [-3, -1, 1, 3]
        # a converter of 2 bits is set so that about a third of the samples are large
        assert 0.25 < (counts[0] + counts[3]) / part.size < 0.4
        assert abs(part.mean()) < 0.1  # [levels]


def test_sxnsr_spends_most_samples_on_its_outer_levels(shared_data):
    # codes are 0.098, 0.558, 0.312, 0.032 of the file; two's complement was told from offset
    # binary by acquisition: PRN 23 rises 31 against 18 times above the mean
    packing = IfFormat.from_text("sxnsr")
    folder = shared_data / "if_captures" / "sxnsr_flight"
    data = np.fromfile(folder / "sxnsr_test_data_flight.stream", np.uint8)
    i, _ = unpack(packing, data, packing.samples_in(data.size))
    share = [np.mean(i == level) for level in (-3, -1, 1, 3)]
    np.testing.assert_allclose(share, [0.312, 0.032, 0.098, 0.558], atol=5e-4)


def test_snappergps_and_the_simulated_file_are_balanced(shared_data):
    captures = shared_data / "if_captures"
    first = json.loads((captures / "snappergps" / "snapshots_w00.json").read_text())["snapshots"][
        0
    ]
    data = np.frombuffer(base64.b64decode(first["data"]), np.uint8)
    snapshot = IfFormat.from_text("snappergps")
    i, _ = unpack(snapshot, data, snapshot.samples_in(data.size))
    assert i.size == 49104  # 12 ms at 4.092 MHz
    assert abs(i.mean()) < 0.05  # bias of the comparator
    still = captures / "independent_sim" / "still_40s_4MHz_1bit_iq.bin"
    data = np.fromfile(still, np.uint8, 100_000)
    for part in unpack(IfFormat.from_text("independent_sim"), data, 400_000):
        # the file holds an offset of -0.024 (I) and +0.024 (Q) levels, 0.1 % of its power
        assert abs(abs(part.mean()) - 0.024) < 4 / np.sqrt(400_000)  # 4 sigma of signs
