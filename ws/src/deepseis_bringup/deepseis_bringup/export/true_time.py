"""True GPS time of a station's data: receiver time less its clock error.

Observations and ground motion carry the receiver's time, which may be off by half a millisecond
and jumps by whole ones; IMU samples carry the coarse clock's, which counts samples from the time
that the recording was said to begin. Both are set right with what each position found.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from deepseis_core.constants import NS_PER_S, SPEED_OF_LIGHT
from deepseis_core.gps_time import GpsTime
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import FloatArray, IntArray, Pvt, PvtStatus

JUMP_NS = 500_000.0
"""A clock error that changes by more between positions was set, by whole milliseconds."""


@dataclass(frozen=True)
class TrueTime:
    """Clock errors by receiver time, and the coarse clock's by sample.

    Parameters
    ----------
    receiver_ns : ndarray, shape (n,)
        Receiver time of the positions since the GPS epoch [ns].
    bias_ns : ndarray, shape (n,)
        Receiver time less GPS time then [ns].
    sample_index : ndarray, shape (n,)
        Sample of each position.
    coarse : SampleClock or None
        The clock of stamps of samples; None where nothing tells it.
    """

    receiver_ns: IntArray
    bias_ns: FloatArray
    sample_index: IntArray
    coarse: SampleClock | None

    @property
    def known(self) -> bool:
        """Whether any position told the clock's error."""
        return len(self.receiver_ns) > 0

    def of_receiver(self, receiver_ns: IntArray) -> IntArray:
        """Return true GPS time of receiver times, both since the GPS epoch [ns]."""
        if not self.known:
            return receiver_ns
        bias = np.interp(receiver_ns, self.receiver_ns, self.bias_ns)
        before = np.clip(np.searchsorted(self.receiver_ns, receiver_ns, side="right") - 1, 0, None)
        after = np.minimum(before + 1, len(self.bias_ns) - 1)
        held = np.abs(self.bias_ns[after] - self.bias_ns[before]) > JUMP_NS
        bias[held] = self.bias_ns[before[held]]
        return receiver_ns - np.rint(bias).astype(np.int64)

    def of_stamps(self, utc_ns: IntArray) -> IntArray:
        """Return true GPS time since the GPS epoch [ns] of coarse stamps [ns UTC]."""
        first = GpsTime.from_utc_ns(int(utc_ns[0])).total_ns if len(utc_ns) else 0
        gps_ns = first + (utc_ns - utc_ns[:1])  # the coarse clock knows no leap second on its way
        if not self.known or self.coarse is None:
            return gps_ns
        clock = self.coarse
        origin = GpsTime.from_utc_ns(clock.start_utc_ns).total_ns
        coarse = origin + np.array([clock.offset_ns(k) for k in self.sample_index.tolist()])
        true = self.receiver_ns - np.rint(self.bias_ns).astype(np.int64)
        gps_ns = origin + (utc_ns - clock.start_utc_ns)
        shift = np.interp(gps_ns, coarse, (true - coarse).astype(np.float64))
        return gps_ns + np.rint(shift).astype(np.int64)


class TimeFinder:
    """Gathers what a bag says of time.

    ``sample_rate_hz`` is that of the samples; without it stamps must tell it. Live, the newest
    ``keep`` positions are enough.
    """

    def __init__(self, sample_rate_hz: float | None, keep: int | None = None) -> None:
        self.sample_rate_hz = sample_rate_hz
        self.coarse: SampleClock | None = None
        self._first: tuple[int, int] | None = None
        self._rows: deque[tuple[int, float, int]] = deque(maxlen=keep)

    def take_pvt(self, pvt: Pvt) -> None:
        """Take the clock error of a position."""
        if pvt.status != PvtStatus.NONE and np.isfinite(pvt.clock_bias):
            receiver = GpsTime(pvt.week, pvt.tow_ns).total_ns
            bias = pvt.clock_bias / SPEED_OF_LIGHT * NS_PER_S
            if not self._rows or receiver > self._rows[-1][0]:
                self._rows.append((receiver, bias, pvt.sample_index))

    def take_stamp(self, sample_index: int, utc_ns: int) -> None:
        """Take the coarse stamp of a sample; two half a second apart tell an unknown rate."""
        if self.coarse is not None:
            return
        if not self.sample_rate_hz:
            self._first = self._first or (sample_index, utc_ns)
            samples, ns = sample_index - self._first[0], utc_ns - self._first[1]
            if samples <= 0 or ns < NS_PER_S // 2:
                return
            rate = samples * NS_PER_S / ns
            whole = float(round(rate))
            self.sample_rate_hz = whole if abs(whole - rate) < 1e-6 * rate else rate
        self.coarse = SampleClock.from_sample(sample_index, utc_ns, self.sample_rate_hz)

    def finish(self) -> TrueTime:
        """Return what was found."""
        receiver, bias, sample = zip(*self._rows, strict=True) if self._rows else ((), (), ())
        return TrueTime(
            np.array(receiver, np.int64),
            np.array(bias, np.float64),
            np.array(sample, np.int64),
            self.coarse,
        )
