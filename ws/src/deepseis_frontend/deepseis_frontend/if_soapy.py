"""A live front end through SoapySDR: RTL-SDR, HackRF, LimeSDR, USRP and whatever has a driver.

The source is named in place of a file: ``soapy:driver=hackrf,gain=40,antenna=TX/RX``. ``gain``
[dB], ``bandwidth`` [Hz], ``antenna`` and ``channel`` are taken here, all else goes to the driver.
SoapySDR's Python module comes with the system (Debian: python3-soapysdr), not from the package
index; it is imported when the device is opened.

Sample 0 is at the start time that the graph was given; the stream begins at the sample of the
moment when it is switched on. Samples that the driver has lost are a gap: counted by its
timestamps where it has them, else by the clock of the computer.
"""

from __future__ import annotations

import importlib
import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from deepseis_core.baseband import Baseband
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.types import IfBlock
from deepseis_frontend.if_stream import Remark, samples_per_block

PREFIX: Final = "soapy:"
L1_HZ: Final = 1575.42e6
STREAMS: Final = {"iq8": "CS8", "iq16": "CS16"}
QUEUED_BLOCKS: Final = 100
TIMEOUT_US: Final = 200_000
SILENT_S: Final = 3.0
"""So long may a device give nothing before that is an error."""


def is_live(file: str) -> bool:
    """Tell whether a source is a device, not a file."""
    return file.startswith(PREFIX)


class SoapySource:
    """A device as an `IfSource`; nothing is opened before `blocks`.

    Parameters
    ----------
    file : str
        As the module says.
    format : str
        ``iq8`` (default) or ``iq16``, with a scale if wanted.
    sample_rate_hz, intermediate_frequency_hz : float
        The device is tuned to L1 less the intermediate frequency.
    start_utc_ns : int, optional
        UTC of sample 0; default: now.
    module : Any, optional
        In place of SoapySDR.

    Raises
    ------
    InputError
        The text makes no sense.
    """

    def __init__(
        self,
        file: str,
        *,
        format: str = "",
        sample_rate_hz: float,
        intermediate_frequency_hz: float = 0.0,
        start_utc_ns: int | None = None,
        module: Any = None,
    ) -> None:
        self.file, self._module = file, module
        self.format = IfFormat.from_text(format or "iq8")
        self._stream_format = STREAMS.get(self.format.to_text().split()[0], "")
        if not self._stream_format or self.format.coding != "twos_complement":
            raise InputError(file, f"cannot stream {format}", "iq8 or iq16")
        if not sample_rate_hz > 0.0:
            raise InputError(file, "has no sample_rate_hz", "give the rate")
        self.sample_rate_hz = sample_rate_hz
        self.intermediate_frequency_hz = intermediate_frequency_hz
        self.start_utc_ns: int | None = start_utc_ns or time.time_ns()
        self.first_sample = 0
        self.total_samples: int | None = None
        self.remarks: list[Remark] = []
        self.arguments, self.own = _arguments(file)
        self._queue: queue.Queue[IfBlock | str] = queue.Queue(QUEUED_BLOCKS)
        self._stop, self._pinned = threading.Event(), False

    def is_ready(self) -> bool:
        """Tell whether `blocks` has something to give at once (also its end)."""
        return not self._queue.empty()

    def close(self) -> None:
        """Switch the device off."""
        self._stop.set()

    def blocks(self) -> Iterator[IfBlock]:
        """Yield blocks of 20 ms until `close`, or until the device fails (an `InputError`)."""
        self._stop.clear()
        device, stream = self._open()
        reader = threading.Thread(target=self._read, args=(device, stream), daemon=True)
        reader.start()
        try:
            while isinstance(item := self._queue.get(), IfBlock):
                yield item
        finally:
            self._stop.set()
            reader.join(2.0)
            device.deactivateStream(stream)
            device.closeStream(stream)
        if item:
            raise InputError(self.file, item)

    def _open(self) -> tuple[Any, Any]:
        soapy = self._module = self._module or _soapy(self.file)
        receive, channel = soapy.SOAPY_SDR_RX, int(self.own.get("channel", 0))
        try:
            device = soapy.Device(self.arguments)
            device.setSampleRate(receive, channel, self.sample_rate_hz)
            device.setFrequency(receive, channel, L1_HZ - self.intermediate_frequency_hz)
            setters: dict[str, Callable[[str], Any]] = {
                "gain": lambda value: device.setGain(receive, channel, float(value)),
                "bandwidth": lambda value: device.setBandwidth(receive, channel, float(value)),
                "antenna": lambda value: device.setAntenna(receive, channel, value),
            }
            for name, setter in setters.items():
                if name in self.own:
                    setter(self.own[name])
            stream = device.setupStream(receive, self._stream_format, [channel])
            device.activateStream(stream)
        except (RuntimeError, ValueError) as error:
            raise InputError(self.file, f"cannot be opened: {error}") from None
        return device, stream

    def _read(self, device: Any, stream: Any) -> None:
        """Read until told to stop; what cannot be queued is lost, and counted."""
        try:
            for block in self._received(device, stream):
                try:
                    self._queue.put_nowait(block)
                except queue.Full:
                    text = "the graph is too slow: a block was dropped"
                    self.remarks.append(
                        Remark("gap", block.sample_index, text, block.sample_count)
                    )
            self._queue.put("")
        except Exception as error:
            self._queue.put(f"{error}")

    def _received(self, device: Any, stream: Any) -> Iterator[IfBlock]:
        count = samples_per_block(self.format, self.sample_rate_hz)
        kind = np.int8 if self.format.bits == 8 else np.int16
        buffer = np.zeros(2 * count, kind)
        filled, zero = 0, 0
        counter = _Counter(self, self._module)
        heard = time.monotonic()
        while not self._stop.is_set():
            got = device.readStream(
                stream, [buffer[2 * filled :]], count - filled, timeoutUs=TIMEOUT_US
            )
            lost = counter.take(got)
            if got.ret <= 0:
                if time.monotonic() - heard > SILENT_S:
                    raise OSError(f"gives no samples (SoapySDR status {got.ret})")
                continue
            heard, first = time.monotonic(), counter.next - got.ret
            if lost or not filled:
                if lost:
                    text = f"the device lost {lost} samples"
                    self.remarks.append(Remark("gap", first, text, lost))
                    if filled:  # what stood before the gap is a short block
                        yield self._block(zero, buffer[: 2 * filled])
                        moved = buffer[2 * filled : 2 * (filled + got.ret)].copy()
                        buffer[: moved.size] = moved
                filled, zero = 0, first
            filled += got.ret
            if filled == count:
                yield self._block(zero, buffer)
                filled = 0

    def _block(self, index: int, samples: Any) -> IfBlock:
        """Pack samples; the first ones tell the scale to baseband, where one is needed."""
        data = samples.astype(samples.dtype.newbyteorder("<"), copy=True).view(np.uint8)
        count, rate = samples.size // 2, self.sample_rate_hz
        frequency = self.intermediate_frequency_hz
        if not self._pinned:
            baseband = Baseband(self.format, rate, frequency)
            if not baseband.scale:
                text = self.format.to_text()
                baseband.convert(IfBlock(0, count, rate, frequency, text, data))
            self.format, self._pinned = baseband.pinned_format, True
        return IfBlock(index, count, rate, frequency, self.format.to_text(), data)


class _Counter:
    """Which sample a device is at: by its timestamps, else by what it gave and the clock."""

    def __init__(self, source: SoapySource, module: Any) -> None:
        self.source, self.module = source, module
        self.next = -1
        self._zero_ns: int | None = None
        self._overflow = False
        self._clock = (0.0, 0)

    def take(self, got: Any) -> int:
        """Count what came; return how many samples are missing before it."""
        rate = self.source.sample_rate_hz
        if got.ret <= 0:
            self._overflow |= got.ret == self.module.SOAPY_SDR_OVERFLOW
            return 0
        has_time = bool(got.flags & self.module.SOAPY_SDR_HAS_TIME)
        if self.next < 0:
            since = (time.time_ns() - int(self.source.start_utc_ns or 0)) / 1e9
            self.next = max(0, round(since * rate) - got.ret)
            self.source.first_sample = self.next
            self._clock = (time.monotonic(), self.next + got.ret)
        lost = 0
        if has_time:
            zero = got.timeNs - round(self.next * 1e9 / rate)
            self._zero_ns = zero if self._zero_ns is None else self._zero_ns
            lost = max(0, round((zero - self._zero_ns) * rate / 1e9))
        elif self._overflow:
            began, at = self._clock
            expected = at + round((time.monotonic() - began) * rate)
            lost = max(0, expected - self.next - got.ret)
        self._overflow = False
        self.next += lost + got.ret
        return lost


def _arguments(file: str) -> tuple[str, dict[str, str]]:
    """Split a source's text into the driver's arguments and ours.

    Examples
    --------
    >>> _arguments("soapy:driver=hackrf,gain=40,serial=1")
    ('driver=hackrf,serial=1', {'gain': '40'})
    """
    ours: dict[str, str] = {}
    theirs = []
    for item in filter(None, file.removeprefix(PREFIX).split(",")):
        name, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not name:
            raise InputError(file, f"{item!r} is not name=value", "soapy:driver=hackrf,gain=40")
        if name in ("gain", "bandwidth", "antenna", "channel"):
            ours[name] = value
        else:
            theirs.append(f"{name}={value}")
    for name in ("gain", "bandwidth", "channel"):
        try:
            float(ours.get(name, "0"))
        except ValueError:
            raise InputError(file, f"{name} is {ours[name]!r}, not a number") from None
    return ",".join(theirs), ours


def _soapy(file: str) -> Any:
    try:
        return importlib.import_module("SoapySDR")
    except ImportError:
        hint = "apt-get install python3-soapysdr, and name its folder in PYTHONPATH"
        raise InputError(file, "needs SoapySDR's Python module", hint) from None
