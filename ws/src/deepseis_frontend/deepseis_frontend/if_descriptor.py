"""What has to be known of a raw IF recording to read it.

The descriptor is a YAML file beside the recording, ``<recording>.yaml``, or comes as arguments
(which win)::

    format: iq8                         # deepseis_core.if_format, deepseis_frontend.if_recode
    sample_rate_hz: 4.0e6               # [Hz]
    intermediate_frequency_hz: 0.0      # [Hz]
    start_utc: 2021-12-02T08:47:00Z     # optional: UTC of sample 0
    header_bytes: 0                     # optional: bytes before sample 0
    check_levels: true                  # optional: false accepts impossible-looking samples
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any, Final

from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.yaml_config import read_yaml
from deepseis_frontend.if_recode import Recoding, recoding_of

EXAMPLE: Final = "format: iq8, sample_rate_hz: 4.0e6, intermediate_frequency_hz: 0.0"


@dataclass(frozen=True)
class IfDescriptor:
    """What has to be known of a raw recording."""

    format: IfFormat
    sample_rate_hz: float
    intermediate_frequency_hz: float = 0.0
    start_utc_ns: int | None = None
    header_bytes: int = 0
    check_levels: bool = True
    recoding: Recoding | None = None
    """Where the recording's own bytes are no such format and are turned into it."""

    @property
    def text(self) -> str:
        """The format's text as a descriptor has it."""
        return self.format.to_text() if self.recoding is None else self.recoding.text


def descriptor_path(path: str | Path) -> Path:
    """Return the place of a recording's descriptor."""
    return Path(f"{path}.yaml")


def write_descriptor(path: str | Path, descriptor: IfDescriptor) -> Path:
    """Write the descriptor beside a recording and return its path."""
    lines = [
        f'format: "{descriptor.text}"',
        f"sample_rate_hz: {descriptor.sample_rate_hz!r}  # [Hz]",
        f"intermediate_frequency_hz: {descriptor.intermediate_frequency_hz!r}  # [Hz]",
    ]
    if descriptor.start_utc_ns is not None:
        lines.append(f"start_utc_ns: {descriptor.start_utc_ns}  # [ns since 1970] of sample 0")
    if descriptor.header_bytes:
        lines.append(f"header_bytes: {descriptor.header_bytes}")
    if not descriptor.check_levels:
        lines.append("check_levels: false")
    target = descriptor_path(path)
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return target


def read_descriptor(path: str | Path, **given: Any) -> IfDescriptor:
    """Read the descriptor beside a recording, with the given values in place of its own.

    Parameters
    ----------
    path : path
        The recording.
    **given
        Keys of the descriptor; ``None`` means not given.

    Raises
    ------
    InputError
        Where a value is missing, unknown or makes no sense.
    """
    beside = descriptor_path(path)
    values = _read_yaml(beside) if beside.is_file() else {}
    explicit = {key: value for key, value in given.items() if value is not None}
    if "start_utc_ns" in explicit or "start_utc" in explicit:
        values = {k: v for k, v in values.items() if k not in ("start_utc", "start_utc_ns")}
    values |= explicit
    where = beside if beside.is_file() else path
    for key in ("format", "sample_rate_hz"):
        if key not in values:
            raise InputError(
                where, f"{key} is not known", f"give it, or write {beside}: {EXAMPLE}"
            )
    return _descriptor(where, values)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        values: dict[str, Any] = read_yaml(path).plain()
    except InputError as error:
        raise InputError(error.what, f"is not a descriptor: {error.reason}", EXAMPLE) from None
    return values


def _descriptor(where: object, values: dict[str, Any]) -> IfDescriptor:
    known = {item.name for item in dataclasses.fields(IfDescriptor)} - {"recoding"}
    known |= {"start_utc"}
    unknown = [str(key) for key in values if key not in known]
    if unknown:
        raise InputError(
            where, f"unknown key {unknown[0]!r}", "known: " + ", ".join(sorted(known))
        )
    packing = values["format"]
    rate = _number(where, values, "sample_rate_hz")
    header = _number(where, values, "header_bytes")
    if rate <= 0:
        raise InputError(where, f"sample_rate_hz is {rate}", "it is a positive number")
    if header < 0 or header != int(header):
        raise InputError(where, f"header_bytes is {header}", "it is a number of bytes")
    start = values.get("start_utc_ns")
    recoding = None if isinstance(packing, IfFormat) else recoding_of(str(packing))
    if recoding is not None:
        packing = recoding.format
    return IfDescriptor(
        recoding=recoding,
        format=packing if isinstance(packing, IfFormat) else IfFormat.from_text(str(packing)),
        sample_rate_hz=rate,
        intermediate_frequency_hz=_number(where, values, "intermediate_frequency_hz"),
        start_utc_ns=_utc_ns(where, values.get("start_utc")) if start is None else int(start),
        header_bytes=int(header),
        check_levels=bool(values.get("check_levels", True)),
    )


def _number(where: object, values: dict[str, Any], key: str) -> float:
    try:
        number = float(values.get(key, 0.0))  # YAML 1.1 reads 4e6 as text
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(where, f"{key} is {values[key]!r}, not a number")
    return number


def _utc_ns(where: object, value: Any) -> int | None:
    """Read a UTC date and time exactly (to the microsecond of ``datetime``)."""
    if value is None:
        return None
    try:
        if isinstance(value, date) and not isinstance(value, datetime):
            value = datetime.combine(value, time())
        moment = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    except ValueError:
        raise InputError(
            where, f"start_utc {value!r} is no date", "2021-12-02T08:47:00Z"
        ) from None
    moment = moment.replace(tzinfo=moment.tzinfo or UTC)
    passed = moment - datetime(1970, 1, 1, tzinfo=UTC)
    seconds = passed.days * 86400 + passed.seconds
    return seconds * 1_000_000_000 + passed.microseconds * 1000
