"""Recordings of common SDRs: bytes as their makers describe them, satellites found in them."""

import numpy as np
import pytest

from deepseis_core.baseband import Baseband
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_frontend.if_descriptor import read_descriptor, write_descriptor
from deepseis_frontend.if_file import open_if_file
from deepseis_frontend.if_recode import recoding_of
from deepseis_sim.recording import FrontEnd, IfStream
from deepseis_sim.still_recording import StillConfig, still_model
from deepseis_tracking.acquisition import Acquirer, AcquisitionConfig

SUMS = 10
ABSENT = ("G31", "G05")


class Signal:
    """Levels of a signal, as whole numbers of a converter."""

    def __init__(self, text, rate_hz, if_hz):
        self.rate_hz, self.if_hz = rate_hz, if_hz
        self.model = still_model(StillConfig(elevation_mask_deg=25.0))
        self.names = [item.ephemeris.satellite for item in self.model.satellites]
        self.absent = [name for name in ABSENT if name not in self.names]
        self.acquirer = Acquirer(rate_hz, AcquisitionConfig(noncoherent_count=SUMS))
        self.count = self.acquirer.samples_needed + 4000
        packing = IfFormat.from_text(text)
        raw = IfStream(self.model, FrontEnd(packing, rate_hz, if_hz), seed=1).packed(0, self.count)
        self.i, self.q = np.zeros((2, self.count), np.int8)
        packing.unpack(raw, self.i, None if packing.is_real else self.q)
        self.found = self.search(*converted(packing, raw, self))

    def search(self, i, q):
        found = self.acquirer.search(i, q, 0, self.names + self.absent)
        return {item.satellite: item for item in found if item.detected}

    def read(self, path, **given):
        source = open_if_file(path, sample_rate_hz=self.rate_hz,
                              intermediate_frequency_hz=self.if_hz, **given)  # fmt: skip
        data = np.concatenate([block.data for block in source.blocks()])
        return source, data


def converted(packing, data, signal):
    from deepseis_core.types import IfBlock

    block = IfBlock(0, packing.samples_in(data.size), signal.rate_hz, signal.if_hz,
                    packing.to_text(), data)  # fmt: skip
    return Baseband(packing, signal.rate_hz, signal.if_hz).convert(block)


@pytest.fixture(scope="module")
def zero_if():
    return Signal("iq8", 2.4e6, 0.0)


@pytest.fixture(scope="module")
def low_if():
    return Signal("real2 coding=sign_magnitude", 8e6, 2.1e6)


def interleaved(signal, kind, scale=1.0):
    both = np.stack([signal.i, signal.q], axis=1).astype(np.float64) * scale
    return np.rint(both).astype(kind) if np.dtype(kind).kind in "iu" else both.astype(kind)


WRITERS = {
    # librtlsdr: unsigned bytes I, Q around 127.5
    "rtlsdr": lambda s: (interleaved(s, np.int16) + 128).astype(np.uint8),
    # hackrf_transfer, uhd sc8: signed bytes
    "hackrf": lambda s: interleaved(s, np.int8),
    "usrp_sc8": lambda s: interleaved(s, np.int8),
    # uhd sc16: the converter's bits at the top of little-endian words
    "usrp_sc16": lambda s: interleaved(s, "<i2", 256.0),
    # LimeSuite: 12 bits at the bottom of them
    "limesdr_sc16": lambda s: interleaved(s, "<i2", 16.0),
    # uhd fc32, GNU Radio: full scale is 1
    "usrp_fc32": lambda s: interleaved(s, "<f4", 1.0 / 128.0),
    "gnuradio_fc32": lambda s: interleaved(s, "<f4", 3.7e-4),
}


@pytest.mark.parametrize("preset", WRITERS)
def test_satellites_are_found_as_in_the_signal_that_was_written(zero_if, preset, tmp_path):
    path = tmp_path / "capture.bin"
    WRITERS[preset](zero_if).tofile(path)
    source, data = zero_if.read(path, format=preset)
    found = zero_if.search(*converted(source.format, data, zero_if))
    assert set(found) == set(zero_if.names) == set(zero_if.found)
    for name, item in found.items():
        first = zero_if.found[name]
        assert abs(item.carrier_doppler_hz - first.carrier_doppler_hz) < 3 * first.doppler_sd_hz
        assert abs(item.cn0_dbhz - first.cn0_dbhz) < 0.5


def two_bits(levels):
    """Sign and magnitude as in the makers' tables: +1 00, +3 01, -1 10, -3 11."""
    return ((levels < 0) * 2 + (np.abs(levels) == 3)).astype(np.uint8)


def test_two_bit_samples_four_to_a_byte(low_if, tmp_path):
    codes = two_bits(low_if.i)
    codes = codes[: codes.size // 4 * 4].reshape(-1, 4)
    path = tmp_path / "capture.bin"
    (codes << np.array([0, 2, 4, 6], np.uint8)).sum(axis=1).astype(np.uint8).tofile(path)
    source, data = low_if.read(path, format="nt1065")
    assert set(low_if.search(*converted(source.format, data, low_if))) == set(low_if.names)


@pytest.mark.parametrize("channel", [1, 4])
def test_one_of_four_channels_in_every_byte(low_if, channel, tmp_path):
    other = np.random.default_rng(5).choice(np.array([-3, -1, 1, 3], np.int8), low_if.count)
    lanes = [two_bits(low_if.i if k == channel else np.roll(other, k)) for k in (1, 2, 3, 4)]
    path = tmp_path / "capture.bin"
    sum(lane << (2 * k) for k, lane in enumerate(lanes)).astype(np.uint8).tofile(path)
    source, data = low_if.read(path, format=f"nt1065_ch{channel}")
    np.testing.assert_array_equal(data.view(np.int8), low_if.i)
    assert set(low_if.search(*converted(source.format, data, low_if))) == set(low_if.names)
    wrong, data = low_if.read(path, format=f"nt1065_ch{5 - channel}")
    assert not low_if.search(*converted(wrong.format, data, low_if))


def test_floats_keep_their_levels_wherever_reading_begins(tmp_path):
    path = tmp_path / "f.bin"
    values = np.random.default_rng(1).normal(0.0, 0.02, 200_002).astype("<f4")
    values.tofile(path)
    given = {"format": "fc32", "sample_rate_hz": 1e6}
    whole = np.concatenate([b.data for b in open_if_file(path, **given).blocks()]).view(np.int8)
    scale = 2.0 ** np.floor(np.log2(32 / 0.02))
    np.testing.assert_array_equal(whole, np.clip(np.rint(values * scale), -127, 127))
    part = np.concatenate([b.data for b in open_if_file(path, start=0.03, **given).blocks()])
    np.testing.assert_array_equal(part.view(np.int8), whole[60_000:])


def test_a_header_and_a_cut_sample_at_the_end_are_left_out(tmp_path):
    path = tmp_path / "f.bin"
    values = np.random.default_rng(1).normal(0.0, 1.0, 2000).astype("<f4")
    path.write_bytes(b"head!" + values.tobytes() + b"abc")
    source = open_if_file(path, format="fc32", sample_rate_hz=1e6, header_bytes=5)
    assert source.total_samples == 1000
    list(source.blocks())
    assert "3 bytes at the end" in source.remarks[-1].text


@pytest.mark.parametrize("values", [np.zeros(4000), np.full(4000, np.nan), np.full(4000, 1e36)])
def test_what_cannot_be_float_samples_is_refused(values, tmp_path):
    path = tmp_path / "f.bin"
    values.astype("<f4").tofile(path)
    with pytest.raises(InputError, match="no 32-bit floats"):
        open_if_file(path, format="fc32", sample_rate_hz=1e6)


def test_the_descriptor_keeps_a_recoding(tmp_path):
    path = tmp_path / "f.bin"
    path.write_bytes(b"")
    given = read_descriptor(path, format="nt1065_ch3", sample_rate_hz=8e6)
    write_descriptor(path, given)
    assert read_descriptor(path) == given
    assert given.recoding is not None


@pytest.mark.parametrize("text", ["lane=4/4 real2", "lane=0/4 iq2", "lane=0/2 real2"])
def test_lanes_that_fill_no_byte_are_refused(text):
    with pytest.raises(InputError, match="does not fit into a byte"):
        recoding_of(text)
