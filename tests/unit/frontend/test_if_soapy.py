"""Live samples through SoapySDR: its own null device where it is there, else a module like it."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_frontend.if_open import open_source
from deepseis_frontend.if_soapy import SoapySource

RATE = 1e6
OVERFLOW, TIMEOUT, HAS_TIME = -4, -1, 4


class Device:
    """Counts its samples: sample n is (n % 100, -(n % 100)); answers as the script says."""

    def __init__(self, arguments, script, timed):
        self.arguments, self.script, self.timed, self.at, self.calls = (
            arguments, list(script), timed, 0, [],
        )  # fmt: skip

    def __getattr__(self, name):
        return lambda *values: self.calls.append((name, values))

    def readStream(self, stream, buffers, count, timeoutUs):  # noqa: N802
        step = self.script.pop(0) if self.script else 0
        if step < 0 and step in (OVERFLOW, TIMEOUT):
            return SimpleNamespace(ret=step, flags=0, timeNs=0)
        if step < 0:  # lost
            self.at -= step
            return SimpleNamespace(ret=OVERFLOW, flags=0, timeNs=0)
        got = min(step, count)
        if not got:
            return SimpleNamespace(ret=TIMEOUT, flags=0, timeNs=0)
        self.script[:0] = [step - got] if step > got else []
        values = np.arange(self.at, self.at + got) % 100
        buffers[0][: 2 * got : 2], buffers[0][1 : 2 * got : 2] = values, -values
        time = round(self.at * 1e9 / RATE) + 77
        self.at += got
        return SimpleNamespace(ret=got, flags=HAS_TIME if self.timed else 0, timeNs=time)


class Module:
    SOAPY_SDR_RX, SOAPY_SDR_OVERFLOW, SOAPY_SDR_HAS_TIME = 1, OVERFLOW, HAS_TIME

    def __init__(self, script, timed=True):
        self.script, self.timed = script, timed

    def Device(self, arguments):  # noqa: N802
        self.device = Device(arguments, self.script, self.timed)
        return self.device


def streamed(script, count, timed=True, **more):
    module = Module(script, timed)
    source = SoapySource("soapy:driver=test,gain=40,serial=7", sample_rate_hz=RATE,
                         module=module, **more)  # fmt: skip
    blocks = []
    stream = source.blocks()
    for _ in range(count):
        blocks.append(next(stream))
    stream.close()
    return source, module.device, blocks


def test_the_device_is_set_as_asked_and_its_samples_come_in_blocks_of_20_ms():
    source, device, blocks = streamed([30_000, 31_111], 3, intermediate_frequency_hz=1e5)
    assert device.arguments == "driver=test,serial=7"
    calls = dict(device.calls)
    assert calls["setFrequency"] == (1, 0, 1575.32e6)
    assert calls["setSampleRate"] == (1, 0, RATE)
    assert calls["setGain"] == (1, 0, 40.0)
    assert calls["setupStream"][1] == "CS8"
    assert {"activateStream", "deactivateStream", "closeStream"} <= calls.keys()
    assert [b.sample_count for b in blocks] == [20_000] * 3
    first = blocks[0].sample_index
    assert [b.sample_index for b in blocks] == [first, first + 20_000, first + 40_000]
    assert source.first_sample == first
    levels = np.concatenate([b.data for b in blocks]).view(np.int8)[::2]
    np.testing.assert_array_equal(levels, np.arange(60_000) % 100)
    assert not source.remarks


def test_lost_samples_are_a_gap_counted_by_timestamps():
    source, _, blocks = streamed([25_000, -12_345, 50_000], 4)
    first = blocks[0].sample_index
    at = [(b.sample_index - first, b.sample_count) for b in blocks]
    assert at == [(0, 20_000), (20_000, 5_000), (37_345, 20_000), (57_345, 20_000)]
    assert blocks[2].data.view(np.int8)[0] == 37_345 % 100
    [gap] = source.remarks
    assert (gap.kind, gap.missing_samples, gap.sample_index) == ("gap", 12_345, first + 37_345)


def test_the_stream_begins_at_the_sample_of_its_moment():
    import time

    start = time.time_ns() - 5_000_000_000
    _, _, blocks = streamed([20_000], 1, start_utc_ns=start)
    assert 4.9e6 < blocks[0].sample_index < 8e6


def test_words_of_16_bits_have_one_scale_for_all_blocks():
    module = Module([40_000])
    source = SoapySource("soapy:driver=test", format="iq16", sample_rate_hz=RATE, module=module)
    stream = source.blocks()
    texts = {next(stream).format for _ in range(2)}
    stream.close()
    assert texts == {source.format.to_text()}
    assert "scale=" in source.format.to_text()


def test_a_device_that_falls_silent_ends_with_the_reason(monkeypatch):
    monkeypatch.setattr("deepseis_frontend.if_soapy.SILENT_S", 0.0)
    source = SoapySource("soapy:driver=test", sample_rate_hz=RATE, module=Module([]))
    with pytest.raises(InputError, match="gives no samples"):
        next(source.blocks())


@pytest.mark.parametrize("file", ["soapy:driver", "soapy:driver=a,gain=much", "soapy:=1"])
def test_texts_that_make_no_sense_are_refused(file):
    with pytest.raises(InputError):
        SoapySource(file, sample_rate_hz=RATE)


def test_without_the_module_the_remedy_is_said(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "SoapySDR", None)
    selection = SimpleNamespace(
        file="soapy:driver=null", format="", sample_rate_hz=RATE, intermediate_frequency_hz=0.0,
        start_utc="", start_s=0.0, length_s=0.0,
    )  # fmt: skip
    with pytest.raises(InputError, match="python3-soapysdr"):
        next(open_source(selection).blocks())


def test_soapysdr_s_null_device_is_opened_and_said_to_give_nothing(monkeypatch):
    pytest.importorskip("SoapySDR", reason="the system has no python3-soapysdr")
    monkeypatch.setattr("deepseis_frontend.if_soapy.SILENT_S", 0.3)
    source = SoapySource("soapy:driver=null", sample_rate_hz=RATE)
    with pytest.raises(InputError, match="gives no samples"):
        next(source.blocks())


def test_soapysdr_s_own_complaint_is_the_line():
    pytest.importorskip("SoapySDR", reason="the system has no python3-soapysdr")
    source = SoapySource("soapy:driver=nosuch", sample_rate_hz=RATE)
    with pytest.raises(InputError, match="cannot be opened"):
        next(source.blocks())
