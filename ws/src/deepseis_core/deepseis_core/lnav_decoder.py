"""From a satellite's data bits to subframes, ephemerides and ionosphere, as they come."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from deepseis_core import lnav
from deepseis_core import lnav_words as words
from deepseis_core.gps_time import nearest_week
from deepseis_core.types import Ephemeris

_UNKNOWN = -(1 << 62)
_STALE_S = 2 * 3600  # subframes farther apart than this never make one ephemeris


@dataclass(frozen=True)
class SubframeEvent:
    """A subframe whose ten words passed parity.

    ``polarity`` is the sign by which received bits are to be multiplied so that logic 0 is +1.
    ``half_cycle`` tells that it is not the sign before: half a cycle was lost after bit
    ``turn_after`` and not later than bit ``turn_before`` (bit indices; the same when false).
    """

    bit_index: int
    polarity: int
    tow_ms: int
    subframe_id: int
    half_cycle: bool
    turn_after: int
    turn_before: int
    data: words.BitArray


@dataclass(frozen=True)
class EphemerisEvent:
    """A new ephemeris (or a known one with new ionosphere), complete at the end of ``bit_end``."""

    bit_end: int
    ephemeris: Ephemeris


@dataclass(frozen=True)
class IonosphereEvent:
    """Klobuchar and UTC parameters of subframe 4 page 18."""

    bit_end: int
    alpha: tuple[float, ...]
    beta: tuple[float, ...]
    utc: lnav.UtcParameters


Event = SubframeEvent | EphemerisEvent | IonosphereEvent


@njit(cache=True, nogil=True)
def _preamble_at(bits: NDArray[np.uint8], start: int, preamble: int) -> int:
    """Return 0 or 1, the inversion with which a preamble starts at ``start``; else -1 (kernel)."""
    byte = 0
    for i in range(8):
        byte = byte << 1 | bits[start + i]
    if byte == preamble:
        return 0
    return 1 if byte ^ 0xFF == preamble else -1


@njit(cache=True, nogil=True)
def _find_preamble(bits: NDArray[np.uint8], start: int, stop: int, preamble: int) -> int:
    """Return the first index in [start, stop) with a preamble of either sign; else stop."""
    for i in range(start, stop):
        if _preamble_at(bits, i, preamble) >= 0:
            return i
    return stop


class LnavDecoder:
    """Find subframes in a satellite's bits and put its ephemeris together.

    Needs no knowledge of the bits' sign or of the frame's start; memory stays below one subframe
    and the latest three data subframes.

    Parameters
    ----------
    satellite : str
        Name, e.g. "G05".
    reference_week : int
        Any week within ten years of the signal [weeks]: the message has ten bits of the week.

    Attributes
    ----------
    subframe_count, failed_count : int
        Subframes accepted, and those missed where one was due.
    utc : UtcParameters or None
        Last heard.
    """

    def __init__(self, satellite: str, reference_week: int) -> None:
        self.satellite = satellite
        self.reference_week = reference_week
        self.subframe_count = 0
        self.failed_count = 0
        self._bits = np.zeros(0, np.uint8)
        self._first = 0  # bit index of _bits[0]
        self._due = _UNKNOWN  # bit index at which the next subframe should start
        self._polarity = 0
        self._sign_end = 0  # the sign is known for bits before this index
        self._due_tow_ms = 0  # start of that subframe
        self._tail = (-1, 0)  # good end of a failed subframe: its first bit, its sign
        self._frames: dict[int, tuple[int, words.BitArray]] = {}
        self._ephemeris: Ephemeris | None = None
        self._iono: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
        self.utc: lnav.UtcParameters | None = None

    def push(self, bits: ArrayLike, bit_index0: int) -> list[Event]:
        """Take the next data bits.

        Parameters
        ----------
        bits : array_like of float
            Received bits; only the sign counts (0 as +1). NaN is not allowed.
        bit_index0 : int
            Index of the first of them; a jump drops the subframe under way.

        Returns
        -------
        list of SubframeEvent, EphemerisEvent, IonosphereEvent
            In the order of their last bit. Any chunking gives the same events.
        """
        hard = (np.atleast_1d(np.asarray(bits)) < 0).astype(np.uint8)
        if bit_index0 != self._first + self._bits.size:
            self._restart(bit_index0)
        self._bits = np.concatenate((self._bits, hard))
        events: list[Event] = []
        position = 0
        while position + words.SUBFRAME_BITS <= self._bits.size:
            found = self._subframe_at(position, events)
            position += words.SUBFRAME_BITS if found else 1
            if not found:
                stop = max(self._bits.size - words.SUBFRAME_BITS + 1, position)
                if position <= self._due - self._first < stop:
                    stop = self._due - self._first
                position = int(_find_preamble(self._bits, position, stop, words.PREAMBLE))
        self._bits = self._bits[position:]
        self._first += position
        return events

    def predicted_tow_ms(self, bit_index: int) -> int | None:
        """Return the time of week [ms] at which a bit started, if a subframe has been found."""
        if self._due == _UNKNOWN:
            return None
        return (self._due_tow_ms + 20 * (bit_index - self._due)) % 604_800_000

    def _restart(self, bit_index: int) -> None:
        self._bits = np.zeros(0, np.uint8)
        self._first = bit_index
        self._due = _UNKNOWN
        self._polarity = 0
        self._tail = (-1, 0)

    def _subframe_at(self, position: int, events: list[Event]) -> bool:
        """Try one start; report whether a subframe is there."""
        received = self._bits[position : position + words.SUBFRAME_BITS]
        start = self._first + position
        inverted = int(_preamble_at(received, 0, words.PREAMBLE))
        if inverted < 0:
            self._note_failure(start, received, inverted)
            return False
        data, failed = words.remove_parity(received ^ np.uint8(inverted))
        subframe_id = words.get_raw(data, words.HANDOVER[1])
        tow_count = words.get_raw(data, words.HANDOVER[0])
        if failed or not 1 <= subframe_id <= 5 or tow_count >= 100_800:
            self._note_failure(start, received, inverted)
            return False
        tow_s = (tow_count - 1) % 100_800 * words.SUBFRAME_S
        events.append(self._accept(start, 1 - 2 * inverted, tow_s, subframe_id, data))
        events.extend(self._collect(subframe_id, tow_s, data, start + words.SUBFRAME_BITS - 1))
        return True

    def _accept(
        self, start: int, polarity: int, tow_s: int, subframe_id: int, data: words.BitArray
    ) -> SubframeEvent:
        half_cycle = self._polarity == -polarity
        turn_before = start
        if half_cycle and start == self._due and self._tail[1] == polarity:
            turn_before = self._tail[0]
        turn_after = self._sign_end if half_cycle else turn_before
        self._polarity = polarity
        self._due = self._sign_end = start + words.SUBFRAME_BITS
        self._due_tow_ms = (tow_s + words.SUBFRAME_S) * 1000
        self._tail = (-1, 0)
        self.subframe_count += 1
        return SubframeEvent(
            start, polarity, tow_s * 1000, subframe_id, half_cycle, turn_after, turn_before, data
        )

    def _note_failure(self, start: int, received: words.BitArray, inverted: int) -> None:
        """Where a subframe was due: find how far its head and tail keep one sign each."""
        if start != self._due:
            return
        self.failed_count += 1
        self._due += words.SUBFRAME_BITS
        self._due_tow_ms += words.SUBFRAME_S * 1000
        # Parity does not depend on the sign, so a turn breaks just the word (or two) around it.
        _, failed = words.remove_parity(received ^ np.uint8(max(inverted, 0)))
        good = [not failed >> word & 1 for word in range(10)]
        head = good.index(False) if False in good else 10
        tail = good[::-1].index(False) if False in good else 10
        if 1 - 2 * inverted == self._polarity and self._sign_end == start:
            self._sign_end = start + 30 * head
        # The last bit of a subframe, D30 of word 10, is 0 and tells the sign of the tail.
        self._tail = (self._due - 30 * tail, 1 - 2 * int(received[-1])) if tail else (-1, 0)

    def _collect(
        self, subframe_id: int, tow_s: int, data: words.BitArray, bit_end: int
    ) -> list[Event]:
        if subframe_id == 4:
            return self._collect_iono(data, bit_end)
        if subframe_id == 5:
            return []
        self._frames[subframe_id] = (tow_s, data)
        ephemeris = self._assemble()
        if ephemeris is None or (
            self._ephemeris is not None and _same_issue(ephemeris, self._ephemeris)
        ):
            return []
        self._ephemeris = ephemeris
        return [EphemerisEvent(bit_end, self._with_iono(ephemeris))]

    def _assemble(self) -> Ephemeris | None:
        """Return the ephemeris if subframes 1 to 3 of one issue are there."""
        if len(self._frames) < 3:
            return None
        tows = [tow for tow, _ in self._frames.values()]
        if max(tows) - min(tows) > _STALE_S:
            return None
        frames = {key: data for key, (_, data) in self._frames.items()}
        one, two, three = (
            words.get_fields(frames[i], words.SUBFRAME_FIELDS[i]) for i in sorted(frames)
        )
        if not int(one["iodc"]) & 0xFF == int(two["iode"]) == int(three["iode"]):
            return None
        week = nearest_week(int(one["week"]), self.reference_week)
        return lnav.decode_ephemeris(frames, self.satellite, self._frames[1][0], week)

    def _with_iono(self, ephemeris: Ephemeris) -> Ephemeris:
        return dataclasses.replace(ephemeris, iono_alpha=self._iono[0], iono_beta=self._iono[1])

    def _collect_iono(self, data: words.BitArray, bit_end: int) -> list[Event]:
        if words.get_raw(data, words.PAGE_FIELDS[1]) != words.IONO_PAGE_ID:
            return []
        values: dict[str, Any] = words.get_fields(data, words.IONO_FIELDS)
        alpha = tuple(values.pop(f"alpha{i}") for i in range(4))
        beta = tuple(values.pop(f"beta{i}") for i in range(4))
        self.utc = utc = self._utc(values)
        events: list[Event] = [IonosphereEvent(bit_end, alpha, beta, utc)]
        if (alpha, beta) != self._iono and self._ephemeris is not None:
            self._iono = (alpha, beta)
            events.append(EphemerisEvent(bit_end, self._with_iono(self._ephemeris)))
        self._iono = (alpha, beta)
        return events

    def _utc(self, values: dict[str, Any]) -> lnav.UtcParameters:
        """Resolve the eight-bit weeks near the reference and name the fields."""
        named: dict[str, Any] = {}
        for name in ("week_t", "week_lsf"):
            reference = self._ephemeris.week if self._ephemeris else self.reference_week
            named[name] = reference + (int(values.pop(name)) - reference + 128) % 256 - 128
        for name in ("leap_s", "day_lsf", "leap_lsf_s"):
            named[name] = int(values.pop(name))
        return lnav.UtcParameters(**named, **values)


def _same_issue(a: Ephemeris, b: Ephemeris) -> bool:
    """Tell whether two ephemerides differ in their time of transmission at most."""
    return dataclasses.replace(a, transmit_tow=b.transmit_tow) == b
