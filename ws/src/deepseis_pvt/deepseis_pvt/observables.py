"""Pseudorange, carrier phase and Doppler on the GPS-time grid, from integrations.

At ``tau`` seconds into the integration that covers a grid epoch, with the replica's own
polynomials and no interpolation between integrations::

    t_tx      = transmit_ms / 1000 + (code_phase + code_rate tau) / 1.023e6
    C1C       = c (t_rx - t_tx)
    L1C       = N - (phase + f tau + f' tau^2 / 2 + f'' tau^3 / 3)
    D1C       = f + f' tau + f'' tau^2

``t_rx - t_tx`` is formed from whole milliseconds and fractions of one, so that no float holds
seconds of week. The integer ``N`` is chosen when an arc starts so that L1C lies near C1C, and kept
until phase continuity is lost. A whole-millisecond correction of the receiver clock acts on time,
code and phase together (RINEX 3.05, 5.1): 1 ms is 1575420 cycles exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from deepseis_core.config import setting
from deepseis_core.constants import NS_PER_S, NS_PER_WEEK
from deepseis_core.types import FloatArray, IntArray, Observations, TrackingFlag
from deepseis_pvt import track_store as ts
from deepseis_pvt.observable_kernels import locate, observe, reached, travel_time
from deepseis_pvt.track_store import TrackStore

CYCLES_PER_MS = 1575420
"""L1 cycles in a millisecond of receiver clock [-]."""

NS_PER_MS = 1_000_000


@dataclass(frozen=True)
class ObservablesConfig:
    """Settings of the observables."""

    rate_hz: int = setting(50, "rate of observations, a divisor of 1e9 [Hz]", low=1, high=100)
    max_integration: float = setting(
        0.02, "longest integration of a channel [s]", low=0.001, high=0.1
    )
    spacing_chips: float = setting(
        0.5,
        "early-late spacing of the correlators, for the code sigma [chips]",
        low=0.02,
        high=1.9,
    )


class GridClock:
    """Receiver time of IF samples, in whole nanoseconds and exact fractions.

    Parameters
    ----------
    sample_rate_hz : float
        Nominal IF rate [Hz].
    offset_ns : int
        GPS time, since its epoch, of sample 0 [ns].

    Examples
    --------
    >>> GridClock(4e6, offset_ns=-250).sample_at(1_000_000)
    (4001, 0.0)
    """

    def __init__(self, sample_rate_hz: float, offset_ns: int) -> None:
        self.sample_rate_hz = sample_rate_hz
        self.offset_ns = offset_ns
        self._rate = Fraction(sample_rate_hz)

    def sample_at(self, gps_ns: int) -> tuple[int, float]:
        """Return the last whole sample at or before a receiver time, and the fraction after it."""
        divisor = self._rate.denominator * NS_PER_S
        whole, rest = divmod((gps_ns - self.offset_ns) * self._rate.numerator, divisor)
        return whole, rest / divisor

    def gps_ns_at(self, sample_index: int) -> int:
        """Return the receiver time of a sample, rounded down to a nanosecond."""
        elapsed = sample_index * NS_PER_S * self._rate.denominator // self._rate.numerator
        return self.offset_ns + elapsed


class ObservablesBuilder:
    """Evaluates a ``TrackStore`` at receiver times; keeps the carrier-phase arcs.

    Parameters
    ----------
    config : ObservablesConfig
        Settings.
    sample_rate_hz : float
        Nominal IF rate [Hz].
    store : TrackStore
        Where the rows come from.

    References
    ----------
    Sigmas of the discriminators: E. D. Kaplan and C. J. Hegarty, "Understanding GPS: Principles
    and Applications", 2nd ed., eqs. 5.20 and 5.22 in open loop (Bn -> 1/(2 T)).
    """

    def __init__(
        self, config: ObservablesConfig, sample_rate_hz: float, store: TrackStore
    ) -> None:
        if NS_PER_S % config.rate_hz:
            raise ValueError(f"rate_hz = {config.rate_hz} is no divisor of 1e9")
        self.config, self.sample_rate_hz, self.store = config, sample_rate_hz, store
        self.interval_ns = NS_PER_S // config.rate_hz
        self.margin = int(np.ceil(config.max_integration * sample_rate_hz)) + 1
        self.steered_ms = 0
        self.counts = {"slips": 0, "implausible_transmit_time": 0}
        n = len(store.satellites)
        self.row: IntArray = np.full(n, -1, np.int64)
        self.transmit_ms: IntArray = np.zeros(n, np.int64)
        self.code_ms: FloatArray = np.zeros(n)
        self._tau: FloatArray = np.zeros(n)
        self._travel_ms: FloatArray = np.zeros(n)
        self._breaks: IntArray = np.ones(n, np.int64)
        self._arc_cycles: FloatArray = np.zeros(n)
        self._arc_start: FloatArray = np.zeros(n)

    def reached(self, sample_index: int) -> bool:
        """Tell whether everything that concerns a sample has arrived, of every satellite."""
        s = self.store
        return bool(reached(s.ints, s.head, s.tail, s.published, sample_index, self.margin))

    def late(self, sample_index: int) -> dict[str, int]:
        """Return the satellites that `reached` would wait for, and how far they have spoken."""
        s = self.store
        last = s.ints[np.arange(len(s.tail)), s.tail - 1]
        has_row = (s.tail > s.head) & (last[:, ts.START] + last[:, ts.COUNT] > sample_index)
        found = (s.published < sample_index + self.margin) & ~has_row
        return {s.satellites[i]: int(s.published[i]) for i in np.flatnonzero(found)}

    def locate(self, sample_index: int, fraction: float = 0.0) -> None:
        """Evaluate transmit times at a sample into ``row``, ``transmit_ms`` and ``code_ms``.

        Samples must not decrease from call to call: rows before the sample are gone.
        """
        s = self.store
        locate(
            s.ints, s.floats, s.head, s.tail, self._breaks, sample_index, fraction,
            self.sample_rate_hz, self.row, self.transmit_ms, self.code_ms, self._tau,
        )  # fmt: skip

    def bit_ms(self) -> FloatArray:
        """Return the time since the last bit edge where located [ms]; NaN where none is known.

        Integrations of a whole bit begin at its edge, to a sample.
        """
        s, out = self.store, np.full(len(self.row), np.nan)
        bit_samples = 0.019 * self.sample_rate_hz
        for i in np.flatnonzero(self.row >= 0):
            row = s.ints[i, self.row[i]]
            if row[ts.FLAGS] & TrackingFlag.BIT_SYNC and row[ts.COUNT] > bit_samples:
                early = s.floats[i, self.row[i], 0] > 511.5
                out[i] = self.code_ms[i] - early
        return out

    def doppler_and_cn0(self, numbers: list[int]) -> tuple[FloatArray, FloatArray]:
        """Return NCO Doppler [Hz] and C/N0 [dB-Hz] of located rows."""
        rows = self.store.floats[numbers, self.row[numbers]]
        return rows[:, 3] + rows[:, 4] * self._tau[numbers], rows[:, 8]

    def build(
        self, sample_index: int, fraction: float, gps_ns: int, valid_through: int
    ) -> Observations:
        """Return the observations at the sample located last, at receiver time ``gps_ns``."""
        s = self.store
        week, tow_ns = divmod(gps_ns, NS_PER_WEEK)
        whole_ms, rest_ns = divmod(tow_ns, NS_PER_MS)
        self.counts["implausible_transmit_time"] += travel_time(
            self.row, self.transmit_ms, self.code_ms, whole_ms, rest_ns / NS_PER_MS,
            self._travel_ms,
        )  # fmt: skip
        values = np.empty((len(self.row), 9))
        lli = np.zeros(len(self.row), np.uint8)
        now = (sample_index + fraction) / self.sample_rate_hz
        self.counts["slips"] += observe(
            s.ints, s.floats, self.row, self._tau, self._travel_ms, self._breaks,
            self.steered_ms * CYCLES_PER_MS, self.config.spacing_chips, self.sample_rate_hz, now,
            self._arc_cycles, self._arc_start, values, lli,
        )  # fmt: skip
        seen = np.flatnonzero(self.row >= 0)
        values = values[seen].T.copy()
        single = values[3:].astype(np.float32)
        return Observations(
            sample_index=sample_index,
            sample_fraction=fraction,
            week=week,
            tow_ns=tow_ns,
            valid_through=valid_through,
            interval=self.interval_ns / NS_PER_S,
            satellites=tuple(s.satellites[i] for i in seen),
            pseudorange=values[0],
            carrier_phase_cycles=values[1],
            carrier_doppler_hz=values[2],
            cn0_dbhz=single[0],
            lli=lli[seen],
            lock_time=single[1],
            carrier_error_cycles=single[2],
            carrier_error_sd_cycles=single[3],
            code_error_chips=single[4],
            code_error_sd_chips=single[5],
            flags=s.ints[seen, self.row[seen], ts.FLAGS].astype(np.uint16),
        )
