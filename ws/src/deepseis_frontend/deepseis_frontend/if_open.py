"""One door to every kind of recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from deepseis_core.errors import InputError
from deepseis_core.sample_clock import utc_ns_from_iso
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.if_file import open_if_file
from deepseis_frontend.if_soapy import SoapySource, is_live
from deepseis_frontend.if_stream import IfSource


class Selection(Protocol):
    """What to open; see ``SourceConfig`` of the node."""

    @property
    def file(self) -> str:
        """Raw recording, the folder or file of a bag, or a device."""
        ...

    @property
    def format(self) -> str:
        """Packing, or empty."""
        ...

    @property
    def sample_rate_hz(self) -> float:
        """Sampling rate [Hz], or 0."""
        ...

    @property
    def intermediate_frequency_hz(self) -> float:
        """Nominal intermediate frequency [Hz]."""
        ...

    @property
    def start_utc(self) -> str:
        """UTC of sample 0, ISO 8601, or empty."""
        ...

    @property
    def start_s(self) -> float:
        """Skip so much [s]."""
        ...

    @property
    def length_s(self) -> float:
        """Play so much [s]; 0: all."""
        ...


def open_source(selection: Selection) -> IfSource:
    """Open a raw recording, a bag, or a live device (``soapy:...``).

    Raises
    ------
    InputError
        There is no such file, or it is not what it is said to be.
    """
    if not selection.file:
        raise InputError("source", "names no file", "give file: an IF recording or a bag")
    if is_live(selection.file):
        return _live(selection)
    path = Path(selection.file)
    if not path.exists():
        raise InputError(path, "does not exist")
    if path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap"))):
        if selection.start_s or selection.length_s:
            raise InputError(path, "is a bag, played whole", "leave out start and length")
        return IfBag(path)
    given: dict[str, Any] = {}
    if selection.format:
        given["format"] = selection.format
    if selection.sample_rate_hz:
        given["sample_rate_hz"] = selection.sample_rate_hz
        given["intermediate_frequency_hz"] = selection.intermediate_frequency_hz
    length = selection.length_s or None
    return open_if_file(path, start=selection.start_s, length=length, **given)


def _live(selection: Selection) -> SoapySource:
    if selection.start_s or selection.length_s:
        raise InputError(selection.file, "is live", "leave out start and length")
    given = selection.start_utc
    return SoapySource(
        selection.file,
        format=selection.format,
        sample_rate_hz=selection.sample_rate_hz,
        intermediate_frequency_hz=selection.intermediate_frequency_hz,
        start_utc_ns=utc_ns_from_iso(given) if given else None,
    )
