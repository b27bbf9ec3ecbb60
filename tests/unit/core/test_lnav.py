"""LNAV: parity against the standard, encoding and decoding, polarity, real u-blox words."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from deepseis_core import lnav, lnav_words
from deepseis_core.lnav_decoder import (
    EphemerisEvent,
    Event,
    IonosphereEvent,
    LnavDecoder,
    SubframeEvent,
)
from deepseis_core.types import Ephemeris

ALPHA = (1.1176e-8, 7.4506e-9, -5.9605e-8, -5.9605e-8)
BETA = (9.0112e4, 0.0, -1.9661e5, -6.5536e4)


@pytest.fixture
def ephemeris() -> Ephemeris:
    """An ephemeris on its broadcast grid, every field's sign bit used."""
    rough = Ephemeris(
        satellite="G05",
        week=2190,
        toe=518400.0,
        toc=518400.0,
        af0=-6.47e-4,
        af1=-1.13e-12,
        af2=-2.8e-17,
        tgd=-1.77e-8,
        sqrt_a=5153.66817474,
        eccentricity=0.0206388905644,
        i0=0.964744088915,
        omega0=-1.12496293255,
        omega=-1.46476911829,
        m0=-0.453245129719,
        delta_n=4.5562612e-9,
        omega_dot=-8.6896e-9,
        i_dot=-2.62e-10,
        cuc=-7.487e-6,
        cus=4.23e-6,
        crc=303.625,
        crs=-142.71875,
        cic=-2.589e-7,
        cis=1.298e-7,
        iode=41,
        iodc=41 + 512,
        health=0,
        accuracy=5.7,
        l2_code=1,
        transmit_tow=518400.0,
    )
    return lnav.quantise(rough)


def signal(bits: lnav_words.BitArray) -> np.ndarray:
    return 1.0 - 2.0 * bits


def subframes(events: list[Event]) -> list[SubframeEvent]:
    return [event for event in events if isinstance(event, SubframeEvent)]


def ephemerides(events: list[Event]) -> list[Ephemeris]:
    return [event.ephemeris for event in events if isinstance(event, EphemerisEvent)]


def test_quantising_is_idempotent_and_moves_no_field_by_more_than_half_a_bit(ephemeris):
    assert lnav.quantise(ephemeris) == ephemeris
    assert abs(ephemeris.sqrt_a - 5153.66817474) <= 2.0**-20
    assert abs(ephemeris.m0 + 0.453245129719) <= 2.0**-32 * np.pi
    assert ephemeris.accuracy == 5.7
    assert ephemeris.iodc == 553


def test_words_2_and_10_end_with_zeros_and_every_word_passes_parity(ephemeris):
    for tow in range(0, 750, 6):
        bits = lnav.encode_subframe(ephemeris, tow)
        assert not bits[58:60].any()
        assert not bits[298:300].any()
        assert lnav_words.remove_parity(bits)[1] == 0


def test_any_single_wrong_bit_fails_parity(ephemeris):
    bits = lnav.encode_subframe(ephemeris, 6)
    for i in range(300):
        wrong = bits.copy()
        wrong[i] ^= 1
        assert lnav_words.remove_parity(wrong)[1] >> i // 30 & 1


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("chunk", [1, 7, 4000])
def test_decoder_returns_what_was_encoded_from_any_start_sign_and_chunking(
    ephemeris, polarity, chunk
):
    skip = 137
    bits = signal(lnav.encode_frame_bits(ephemeris, 518370, 10))[skip:] * polarity
    decoder = LnavDecoder("G05", reference_week=2300)
    events: list[Event] = []
    for i in range(0, bits.size, chunk):
        events += decoder.push(bits[i : i + chunk], 1000 + skip + i)
    found = subframes(events)
    assert [e.bit_index for e in found] == [1000 + 300 * i for i in range(1, 10)]
    assert [e.tow_ms for e in found] == [518370_000 + 6000 * i for i in range(1, 10)]
    assert [e.subframe_id for e in found] == [2, 3, 4, 5, 1, 2, 3, 4, 5]
    assert all(e.polarity == polarity and not e.half_cycle for e in found)
    (decoded,) = ephemerides(events)
    assert dataclasses.replace(decoded, transmit_tow=518400.0) == ephemeris
    assert decoder.predicted_tow_ms(1000) == 518370_000


def test_a_new_issue_of_data_is_never_mixed_with_the_old_one(ephemeris):
    new = lnav.quantise(dataclasses.replace(ephemeris, iode=42, iodc=42 + 512, m0=0.1))
    old_bits = lnav.encode_frame_bits(ephemeris, 518370, 7)  # the cut falls after subframe 2
    new_bits = lnav.encode_frame_bits(new, 518370 + 42, 8)
    events = LnavDecoder("G05", 2190).push(signal(np.concatenate((old_bits, new_bits))), 0)
    first, second = ephemerides(events)
    assert (first.iode, second.iode) == (41, 42)
    assert second.m0 == new.m0
    assert first.m0 == ephemeris.m0


def test_week_and_tow_cross_the_end_of_the_week(ephemeris):
    late = dataclasses.replace(ephemeris, week=2191, toe=0.0, toc=0.0)
    bits = lnav.encode_frame_bits(late, 604770, 10)
    events = LnavDecoder("G05", 2190).push(signal(bits), 0)
    assert [e.tow_ms for e in subframes(events)][4:6] == [604794_000, 0]
    assert [(e.week, e.toe) for e in ephemerides(events)] == [(2191, 0.0)]
    one = lnav_words.remove_parity(bits[:300])[0]
    assert lnav_words.get_raw(one, lnav_words.SUBFRAME_FIELDS[1][0]) == 2190 % 1024


@pytest.mark.parametrize("turn", [600, 645, 748, 890, 900, 901, 1199])
def test_a_half_cycle_slip_is_reported_and_bracketed(ephemeris, turn):
    bits = signal(lnav.encode_frame_bits(ephemeris, 518370, 10))
    bits[turn:] *= -1
    found = subframes(LnavDecoder("G05", 2190).push(bits, 0))
    slips = [e for e in found if e.half_cycle]
    assert len(slips) == 1
    assert slips[0].turn_after <= turn <= slips[0].turn_before
    assert slips[0].turn_before - slips[0].turn_after <= 60
    assert [e.polarity for e in found[-3:]] == [-1, -1, -1]
    assert all(e.bit_index % 300 == 0 for e in found)


def test_the_bracket_is_wide_but_right_when_two_subframes_are_lost(ephemeris):
    bits = signal(lnav.encode_frame_bits(ephemeris, 518370, 10))
    bits[700:] *= -1
    bits[[601, 930, 1190]] *= -1
    (slip,) = [e for e in subframes(LnavDecoder("G05", 2190).push(bits, 0)) if e.half_cycle]
    assert slip.turn_after == 600
    assert slip.turn_before == 1200


def test_a_jump_in_the_bit_index_drops_the_subframe_under_way(ephemeris):
    bits = signal(lnav.encode_frame_bits(ephemeris, 518370, 3))
    decoder = LnavDecoder("G05", 2190)
    assert decoder.push(bits[:200], 0) == []
    events = decoder.push(bits[250:], 250)
    assert [e.bit_index for e in subframes(events)] == [300, 600]
    assert not subframes(decoder.push(-bits[:300], 5000))[0].half_cycle


def test_noise_gives_no_subframe():
    decoder = LnavDecoder("G05", 2190)
    assert decoder.push(np.random.default_rng(1).normal(size=100_000), 0) == []


def test_page_18_brings_ionosphere_and_utc_and_renews_the_ephemeris(ephemeris):
    with_iono = dataclasses.replace(ephemeris, iono_alpha=ALPHA, iono_beta=BETA)
    utc = lnav.UtcParameters(1.86e-9, -8.9e-16, 147456.0, 2191, 18, 2185, 7, 18)
    start = 518400 - 518400 % 750 + 17 * 30
    bits = lnav.encode_frame_bits(with_iono, start, 5, utc=utc)
    decoder = LnavDecoder("G05", 2190)
    events = decoder.push(signal(bits), 0)
    (iono,) = [e for e in events if isinstance(e, IonosphereEvent)]
    assert decoder.utc == iono.utc
    # Half of the fields' last bits (figure 20-1): 2^-30, 2^-27, 2^-24 and 2^11, 2^14, 2^16.
    np.testing.assert_allclose(iono.alpha, ALPHA, atol=2.0**-31)
    np.testing.assert_allclose(iono.beta, BETA, atol=2.0**10)
    assert iono.utc.tot == 147456.0
    assert iono.utc.week_t == 2191
    assert abs(iono.utc.a0 - utc.a0) <= 2.0**-31
    assert [len(e.iono_alpha) for e in ephemerides(events)] == [0, 4]
    other = lnav.encode_frame_bits(with_iono, 518400, 5)
    assert not any(
        isinstance(e, IonosphereEvent) for e in LnavDecoder("G05", 2190).push(signal(other), 0)
    )


def ublox_frames(path: Path) -> dict[int, list[np.ndarray]]:
    """Return the 300 logic bits of all GPS L1 C/A subframes of RXM-SFRBX messages, by PRN."""
    content = path.read_bytes()
    frames: dict[int, list[np.ndarray]] = {}
    at = content.find(b"\xb5\x62\x02\x13")
    while at >= 0:
        payload = content[at + 6 : at + 6 + int.from_bytes(content[at + 4 : at + 6], "little")]
        if payload[0] == 0 and payload[2] == 0 and payload[4] == 10:
            received = np.frombuffer(payload, "<u4", 10, 8) & 0x3FFFFFFF
            bits = (received[:, None] >> np.arange(29, -1, -1) & 1).astype(np.uint8)
            for i in range(1, 10):  # the receiver turns a word over, parity too, after D30* = 1
                bits[i] ^= bits[i - 1, 29]
            frames.setdefault(payload[1], []).append(bits.ravel())
        at = content.find(b"\xb5\x62\x02\x13", at + 1)
    return frames


def rtklib_decode(frames: list[np.ndarray]) -> object:
    """Let RTKLIB decode subframes 1 to 3 (24 data bits a word) into its ``eph_t``."""
    rtklib = pytest.importorskip("pyrtklib")
    buffer = getattr(rtklib, "Arr1Dunsigned char")(150)
    for i in range(150):
        buffer[i] = 0
    for bits in frames:
        data = lnav_words.remove_parity(bits)[0]
        packed = np.packbits(data.reshape(10, 30)[:, :24].ravel())
        first = 30 * (lnav_words.get_raw(data, lnav_words.HANDOVER[1]) - 1)
        for i, byte in enumerate(packed):
            buffer[first + i] = int(byte)
    found = rtklib.eph_t()
    ion, utc = rtklib.Arr1Ddouble(8), rtklib.Arr1Ddouble(8)
    rtklib.decode_frame(buffer, found, rtklib.alm_t(), ion, utc)
    return found


def test_real_subframes_from_a_ublox_receiver_decode_as_rtklib_decodes_them(shared_data):
    frames = ublox_frames(shared_data / "gnss_ins/GNSS_IMU_walk_0827/gnss_1730.ubx")
    decoded = 0
    for prn, found in frames.items():
        decoder = LnavDecoder(f"G{prn:02d}", reference_week=2300)
        events: list[Event] = []
        for i, bits in enumerate(found):
            # The receiver drops subframes: every one stands alone here.
            events += decoder.push(signal(bits), 1000 * i)
        assert len(subframes(events)) == len(found)  # the receiver passed only good ones
        if not ephemerides(events):
            continue
        ours = ephemerides(events)[-1]
        last = {lnav_words.get_raw(b, lnav_words.HANDOVER[1]): b for b in found}
        theirs = rtklib_decode([last[1], last[2], last[3]])
        pairs = {"f0": "af0", "f1": "af1", "f2": "af2", "e": "eccentricity", "M0": "m0"}
        pairs |= {"OMG0": "omega0", "OMGd": "omega_dot", "omg": "omega", "deln": "delta_n"}
        pairs |= {"idot": "i_dot", "toes": "toe", "svh": "health", "code": "l2_code"}
        same = ("i0", "cuc", "cus", "crc", "crs", "cic", "cis", "iode", "iodc")
        pairs |= {name: name for name in same}
        for their_name, our_name in pairs.items():
            # Exact but for the order of multiplying by pi: two roundings.
            assert getattr(theirs, their_name) == pytest.approx(
                getattr(ours, our_name), rel=5e-16, abs=0
            ), our_name
        assert pytest.approx(ours.sqrt_a**2, rel=5e-16) == theirs.A
        assert theirs.tgd[0] == ours.tgd
        assert ours.week % 1024 == theirs.week % 1024
        decoded += 1
    assert decoded >= 3
