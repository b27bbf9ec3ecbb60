"""A raw IF recording as a stream of blocks."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from io import RawIOBase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepseis_core.baseband import Baseband
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.types import IfBlock
from deepseis_frontend.if_descriptor import IfDescriptor, read_descriptor
from deepseis_frontend.if_levels import implausible
from deepseis_frontend.if_recode import RecodedFile, float_scale
from deepseis_frontend.if_stream import Remark, samples_per_block

PROBES = 8  # places of the recording whose levels are looked at
PROBE_UNITS = 16384  # units looked at in each


class IfFile:
    """A raw recording as an :class:`~deepseis_frontend.if_stream.IfSource`.

    Parameters
    ----------
    path : path
        The recording.
    descriptor : IfDescriptor, optional
        Default: that beside the recording.
    start, length : float, optional
        Part to be read [s]: from ``start`` (down to a whole unit of the packing) on. Sample
        indices count from the recording's first sample all the same.

    Raises
    ------
    InputError
        Where the recording cannot be read, is empty, or holds levels its format cannot give.
    """

    def __init__(
        self,
        path: str | Path,
        descriptor: IfDescriptor | None = None,
        *,
        start: float = 0.0,
        length: float | None = None,
    ) -> None:
        self.path = Path(path)
        size = _file_size(self.path)
        self.descriptor = descriptor or read_descriptor(self.path)
        self.sample_rate_hz = self.descriptor.sample_rate_hz
        self.intermediate_frequency_hz = self.descriptor.intermediate_frequency_hz
        self.start_utc_ns = self.descriptor.start_utc_ns
        self.remarks: list[Remark] = []
        packing = self.descriptor.format
        body = max(size - self.descriptor.header_bytes, 0)
        available = packing.samples_in(self._plain_bytes(body))
        if available == 0:
            text = self.descriptor.text
            raise InputError(self.path, f"{size} bytes hold no sample of {text}")
        self._trailing_bytes = body - self._raw_bytes(packing.bytes_for(available))
        self._scale = self._float_scale()
        self._select(packing, available, start, length)
        probe = self._probe(packing)
        if self.descriptor.check_levels and (reason := implausible(probe, packing)):
            raise InputError(
                self.path,
                f"cannot be {self.descriptor.text}: {reason}",
                "check the format, or set check_levels: false",
            )
        self.format = self._pin_scale(packing, probe)
        self._text = self.format.to_text()
        self.samples_per_block = samples_per_block(packing, self.sample_rate_hz)

    def _plain_bytes(self, raw: int) -> int:
        """Return how many bytes of the format a number of the recording's own become."""
        recoding = self.descriptor.recoding
        return raw if recoding is None else raw // recoding.raw_bytes * recoding.bytes

    def _raw_bytes(self, plain: int) -> int:
        recoding = self.descriptor.recoding
        return plain if recoding is None else plain // recoding.bytes * recoding.raw_bytes

    def _float_scale(self) -> float:
        recoding, header = self.descriptor.recoding, self.descriptor.header_bytes
        return 1.0 if recoding is None else float_scale(self.path, recoding, header)

    def _open(self) -> RawIOBase:
        """Open the recording as bytes of the format."""
        recoding = self.descriptor.recoding
        if recoding is None:
            return self.path.open("rb", buffering=0)
        return RecodedFile(self.path, recoding, self.descriptor.header_bytes, self._scale)

    def _select(
        self, packing: IfFormat, available: int, start: float, length: float | None
    ) -> None:
        duration = available / self.sample_rate_hz
        if not 0 <= start < duration:
            raise InputError(self.path, f"start {start} s is outside its {duration:.6g} s")
        unit = packing.samples_per_unit
        self.first_sample = round(start * self.sample_rate_hz) // unit * unit
        rest = available - self.first_sample
        if length is not None and not length > 0:
            raise InputError(self.path, f"length {length} s is not positive")
        wanted = rest if length is None else round(length * self.sample_rate_hz)
        if wanted == 0 or rest == 0:
            raise InputError(self.path, "no sample lies in the part asked for")
        self.total_samples: int | None = min(wanted, rest)
        self._to_file_end = wanted >= rest

    def blocks(self) -> Iterator[IfBlock]:
        """Yield blocks of 20 ms; the last one holds what is left."""
        self.remarks.clear()
        total = self.total_samples or 0
        done = 0
        with self._open() as file:
            file.seek(self._byte_of(self.first_sample))
            while done < total:
                count = min(self.samples_per_block, total - done)
                data = _read_exactly(file, self.format.bytes_for(count))
                whole = min(count, self.format.samples_in(data.size))
                if whole:
                    yield self._block(self.first_sample + done, whole, data)
                done += whole
                if whole < count:
                    break
        self._remark_end(done, total)

    def _block(self, index: int, count: int, data: NDArray[np.uint8]) -> IfBlock:
        return IfBlock(
            sample_index=index,
            sample_count=count,
            sample_rate_hz=self.sample_rate_hz,
            intermediate_frequency_hz=self.intermediate_frequency_hz,
            format=self._text,
            data=data[: self.format.bytes_for(count)],
        )

    def _remark_end(self, done: int, total: int) -> None:
        end = self.first_sample + done
        if done < total:
            text = f"became {total - done} samples shorter while it was read"
            self.remarks.append(Remark("short_end", end, text, total - done))
            return
        if not self._to_file_end:
            return
        left = done % self.samples_per_block
        notes = (
            [f"the last block holds {left} of {self.samples_per_block} samples"] if left else []
        )
        if self._trailing_bytes:
            notes.append(f"{self._trailing_bytes} bytes at the end are no whole sample, left out")
        if notes:
            self.remarks.append(Remark("short_end", end, "; ".join(notes)))

    def _byte_of(self, sample: int) -> int:
        header = 0 if self.descriptor.recoding is not None else self.descriptor.header_bytes
        return header + self.descriptor.format.bytes_for(sample)

    def _probe(self, packing: IfFormat) -> NDArray[np.uint8]:
        """Read some units from places spread over the part that is asked for."""
        total = self.total_samples or 0
        units = -(-total // packing.samples_per_unit)
        each = min(PROBE_UNITS, units)
        starts = sorted({(units - each) * k // (PROBES - 1) for k in range(PROBES)})
        pieces = []
        with self._open() as file:
            for unit in starts:
                file.seek(self._byte_of(self.first_sample) + unit * packing.bytes_per_unit)
                pieces.append(_read_exactly(file, each * packing.bytes_per_unit))
        data = np.concatenate(pieces)
        return data[: data.size // packing.bytes_per_unit * packing.bytes_per_unit]

    def _pin_scale(self, packing: IfFormat, probe: NDArray[np.uint8]) -> IfFormat:
        """Write the scale to baseband into the format, so that all consumers use the same."""
        rate, frequency = self.sample_rate_hz, self.intermediate_frequency_hz
        converter = Baseband(packing, rate, frequency)
        if not converter.scale:
            count = packing.samples_in(probe.size)
            converter.convert(IfBlock(0, count, rate, frequency, packing.to_text(), probe))
        return converter.pinned_format


def open_if_file(
    path: str | Path, *, start: float = 0.0, length: float | None = None, **given: Any
) -> IfFile:
    """Open a raw recording; ``given`` are keys of its descriptor, as in the module's example."""
    _file_size(Path(path))
    return IfFile(path, read_descriptor(path, **given), start=start, length=length)


def _file_size(path: Path) -> int:
    try:
        state = path.stat()
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from None
    if stat.S_ISDIR(state.st_mode):
        hint = "name an IF recording; a run or a bag is for `replay`"
        raise InputError(path, "is a directory", hint)
    if not stat.S_ISREG(state.st_mode):
        raise InputError(path, "is not a regular file")
    if not os.access(path, os.R_OK):
        raise InputError(path, "may not be read")
    if state.st_size == 0:
        raise InputError(path, "is empty")
    return state.st_size


def _read_exactly(file: RawIOBase, size: int) -> NDArray[np.uint8]:
    """Read ``size`` bytes, or what is left of the file."""
    data = np.empty(size, np.uint8)
    view = memoryview(data)  # type: ignore[arg-type]
    filled = 0
    while filled < size:
        got = file.readinto(view[filled:])
        if not got:
            break
        filled += got
    return data[:filled]
