"""What every source of IF samples offers, whatever it reads from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Protocol

from deepseis_core.if_format import IfFormat
from deepseis_core.types import IfBlock

BLOCK_SECONDS: Final = 0.02
"""Length of a block [s]."""


@dataclass(frozen=True)
class Remark:
    """Something about the samples that whoever uses them must know.

    ``kind`` is ``gap`` (``missing_samples`` are not in the recording before ``sample_index``)
    or ``short_end`` (the stream ends at ``sample_index`` in a way it should not).
    """

    kind: str
    sample_index: int
    text: str
    missing_samples: int = 0


class IfSource(Protocol):
    """A stream of IF blocks; nothing in it is invented, what is missing is remarked.

    Attributes
    ----------
    format : IfFormat
        Packing of the blocks, with its scale to baseband where one is needed.
    sample_rate_hz, intermediate_frequency_hz : float
        As in the blocks.
    start_utc_ns : int or None
        UTC of sample 0 [ns since 1970], where known.
    first_sample : int
        Index of the first sample that :meth:`blocks` gives.
    total_samples : int or None
        Samples that :meth:`blocks` will give, where known beforehand.
    remarks : list of Remark
        Gaps and short ends met so far; complete when :meth:`blocks` has ended.
    """

    format: IfFormat
    sample_rate_hz: float
    intermediate_frequency_hz: float
    start_utc_ns: int | None
    first_sample: int
    total_samples: int | None
    remarks: list[Remark]

    def blocks(self) -> Iterator[IfBlock]:
        """Yield the blocks in order of time; every call starts again."""
        ...


def samples_per_block(packing: IfFormat, sample_rate_hz: float) -> int:
    """Return the samples of a 20 ms block: the largest whole number of the packing's units.

    Examples
    --------
    >>> samples_per_block(IfFormat.from_text("iq8"), 4e6)
    80000
    """
    unit = packing.samples_per_unit
    return max(round(BLOCK_SECONDS * sample_rate_hz) // unit * unit, unit)
