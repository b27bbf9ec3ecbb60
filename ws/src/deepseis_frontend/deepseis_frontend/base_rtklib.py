"""A base's observations out of RTCM 3 and RINEX, by RTKLIB's decoders (pyrtklib).

Of RTCM 3 the messages of GPS are taken: 1001 to 1004, MSM 4 to 7, and 1005 and 1006 for the
antenna's reference point. Only whole frames with the right checksum reach RTKLIB.

References
----------
RTCM 10403.3; RINEX 3.05; RTKLIB 2.4.3 (`input_rtcm3`, `readrnx`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyrtklib as rtklib

from deepseis_core.constants import NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rtcm_frame import Deframer
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Lli, Observations
from deepseis_frontend.base_events import Arcs, BaseEvent, BaseReference, Row, utc_of

REFERENCE: Final = (1005, 1006)
GPS: Final = (1001, 1002, 1003, 1004, 1074, 1075, 1076, 1077)
_MSM: Final = range(1071, 1138)
_EPOCH_COMPLETE, _STATION = 1, 5
_HEADER_BYTES: Final = 3 + 8
"""Frame's head, and of the message what holds type, station, time and the sign of more."""
_BASE: Final = 2
_READ_BYTES: Final = 65536
_NEAR_S: Final = 3600
_STEP_S: Final = 60
"""A time is believed so near to the signal's, or so near to that of the epoch before [s]."""


class RtcmDecoder:
    """Turns a stream of RTCM 3 into a base's events.

    Parameters
    ----------
    clock : SampleClock
        Of the IF samples.

    Attributes
    ----------
    about_utc_ns : int
        Time within half a week of what comes, for messages say no week; at first that of sample 0
        [ns since 1970].
    frames : Deframer
        With what was damaged.
    messages : int
        Frames of use so far.
    implausible : int
        Epochs left out for their time: neither near `about_utc_ns` nor near the one before.
    """

    def __init__(self, clock: SampleClock) -> None:
        self.clock, self.frames, self.messages, self.implausible = clock, Deframer(), 0, 0
        self.about_utc_ns = clock.start_utc_ns
        self._state = rtklib.rtcm_t()
        if not rtklib.init_rtcm(self._state):
            raise MemoryError("RTKLIB gives no memory for RTCM")
        self._arcs = Arcs()
        self._seen_ns = -(10**18)
        self._place: tuple[float, ...] = ()
        self._said: tuple[float, ...] = ()
        self._pending = -1

    def push(self, data: bytes) -> list[BaseEvent]:
        """Take the next bytes; return what is complete now, in order."""
        events = list[BaseEvent]()
        for whole in self.frames.push(data):
            kind = int.from_bytes(whole[3:5], "big") >> 4 if len(whole) >= 3 + 2 + 3 else 0
            if kind in GPS and len(whole) >= _HEADER_BYTES + 3:
                events += self._observed(whole)
            elif kind in REFERENCE:
                self._referred(whole)
            elif kind in _MSM and self._pending >= 0:
                events += self._emit()  # another constellation's: GPS has been said
        return events

    def finish(self) -> list[BaseEvent]:
        """Return what waited for a message of the same epoch."""
        return self._emit() if self._pending >= 0 else []

    def close(self) -> None:
        """Give RTKLIB's memory back; nothing can be decoded afterwards."""
        if self._state is not None:
            rtklib.free_rtcm(self._state)
            self._state = None

    def _observed(self, whole: bytes) -> list[BaseEvent]:
        events, tow = list[BaseEvent](), int.from_bytes(whole[6:10], "big") >> 2
        if self._pending not in (-1, tow):
            events += self._emit()
        result = self._input(whole)
        self.messages += 1
        if result == _EPOCH_COMPLETE:
            events += self._emit()
        elif result == 0:
            self._pending = tow
        return events

    def _referred(self, whole: bytes) -> None:
        if self._input(whole) == _STATION:
            self.messages += 1
            place = tuple(float(self._state.sta.pos[i]) for i in range(3))
            if np.linalg.norm(place) > 1e6:
                self._place = place

    def _input(self, whole: bytes) -> int:
        about = GpsTime.from_utc_ns(self.about_utc_ns)
        self._state.time = rtklib.gpst2time(about.week, about.tow_s())
        result = 0
        for byte in whole:
            result = rtklib.input_rtcm3(self._state, byte) or result
        return int(result)

    def _emit(self) -> list[BaseEvent]:
        self._pending = -1
        data = self._state.obs.data
        rows = [data[i] for i in range(self._state.obs.n)]
        epoch = _epoch(rows, self.clock, self._arcs)
        if epoch is None:
            return []
        utc_ns = GpsTime(epoch.week, epoch.tow_ns).to_utc_ns()
        away = abs(utc_ns - self.about_utc_ns), abs(utc_ns - self._seen_ns)
        self._seen_ns = utc_ns
        if away[0] > _NEAR_S * NS_PER_S and away[1] > _STEP_S * NS_PER_S:
            self.implausible += 1
            return []
        events: list[BaseEvent] = [epoch]
        if self._place != self._said:
            self._said = self._place
            name = f"RTCM station {self._state.staid}"
            events.insert(0, BaseReference(utc_ns, np.array(self._place), name))
        return events


def rtcm_events(path: str | Path, clock: SampleClock) -> Iterator[BaseEvent]:
    """Yield the events of a file of RTCM 3.

    Raises
    ------
    InputError
        It cannot be read, or holds no epoch.
    """
    decoder, found = RtcmDecoder(clock), False
    try:
        with Path(path).open("rb") as file:
            while data := file.read(_READ_BYTES):
                for event in decoder.push(data):
                    decoder.about_utc_ns, found = utc_of(event), True
                    yield event
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from None
    finally:
        last = decoder.finish()
        decoder.close()
    yield from last
    if not (found or last):
        raise InputError(
            path, "holds no GPS observations in RTCM 3", "messages 1004, 1074 to 1077"
        )


def rinex_events(path: str | Path, clock: SampleClock) -> Iterator[BaseEvent]:
    """Yield the events of a RINEX observation file, version 2 to 4.

    Raises
    ------
    InputError
        It cannot be read.
    """
    obs, nav, station = rtklib.obs_t(), rtklib.nav_t(), rtklib.sta_t()
    if not Path(path).is_file():
        raise InputError(path, "does not exist")
    if rtklib.readrnx(str(path), _BASE, "", obs, nav, station) <= 0 or obs.n == 0:
        raise InputError(path, "holds no observations that RTKLIB can read")
    arcs, place = Arcs(), np.array([float(station.pos[i]) for i in range(3)])
    said = bool(np.linalg.norm(place) < 1e6)
    for _, group in groupby(range(obs.n), key=lambda i: _time(obs.data[i].time)):
        epoch = _epoch([obs.data[i] for i in group], clock, arcs)
        if epoch is None:
            continue
        if not said:
            said = True
            utc_ns = GpsTime(epoch.week, epoch.tow_ns).to_utc_ns()
            yield BaseReference(utc_ns, place, Path(path).name)
        yield epoch


def _epoch(rows: Sequence[Any], clock: SampleClock, arcs: Arcs) -> Observations | None:
    """Return GPS L1 C/A of RTKLIB's rows (``obsd_t``) of one epoch; None if there is none."""
    found = [
        Row(
            _name(d.sat), float(d.P[0]), float(d.L[0]), float(d.D[0]),
            d.SNR[0] * rtklib.SNR_UNIT, d.LLI[0] & (Lli.SLIP | Lli.HALF_CYCLE),
        )
        for d in rows
        if d.code[0] == rtklib.CODE_L1C and d.P[0] and d.L[0]
    ]  # fmt: skip
    found = [row for row in found if row.satellite[:1] == "G"]
    if not found:
        return None
    time = _time(rows[0].time)
    utc_ns = time.to_utc_ns()
    return arcs.epoch(time, clock.sample_at(utc_ns), found)


def _time(value: Any) -> GpsTime:
    """Return RTKLIB's time; receivers' epochs are whole microseconds."""
    week = rtklib.Arr1Dint(1)
    whole = rtklib.gtime_t()
    whole.time, whole.sec = value.time, 0.0
    tow = round(rtklib.time2gpst(whole, week))
    return GpsTime(int(week[0]), tow * NS_PER_S + round(value.sec * 1e6) * 1000)


def _name(number: int) -> str:
    name = rtklib.Arr1Dchar(8)
    rtklib.satno2id(number, name)
    return str(name.ptr)
