"""The first fix: four transmit times tie the sample counter to GPS time."""

from __future__ import annotations

import numpy as np

from deepseis_core.constants import NS_PER_S, NS_PER_WEEK, SPEED_OF_LIGHT
from deepseis_core.ephemeris import states_from_pseudoranges
from deepseis_core.types import FloatArray
from deepseis_pvt.assisted_start import Assistance, resolve_start
from deepseis_pvt.ephemeris_book import EphemerisBook, week_of
from deepseis_pvt.observables import NS_PER_MS, GridClock, ObservablesBuilder
from deepseis_pvt.spp import SppSolution, SppSolver

FIRST_TRAVEL_MS = 68
"""Travel time assumed of the nearest satellite before the receiver's clock is known [ms]."""

LONGEST_TRAVEL_MS = 150.0
MS_PER_WEEK = NS_PER_WEEK // NS_PER_MS

Sent = dict[int, tuple[int, FloatArray]]
"""By satellite number: transmit time of the code period in whole milliseconds since the GPS epoch
[ms], and the packed ephemeris."""


class FirstFix:
    """Attempts at a position and a time, each by itself.

    Parameters
    ----------
    builder : ObservablesBuilder
        Rows located at the sample of the attempt.
    book : EphemerisBook
        Ephemerides.
    solver : SppSolver
        Position and clock.
    max_gdop : float
        Geometry still acceptable [-].
    assistance : Assistance, optional
        Known position and coarse time, where transmit times are not decoded yet.
    """

    def __init__(
        self,
        builder: ObservablesBuilder,
        book: EphemerisBook,
        solver: SppSolver,
        max_gdop: float,
        assistance: Assistance | None = None,
    ) -> None:
        self._builder, self._book, self._solver = builder, book, solver
        self._max_gdop, self.assistance = max_gdop, assistance

    def attempt(self, sample: int) -> tuple[int, FloatArray] | None:
        """Return GPS time since its epoch [ns] and ECEF position [m] at a sample, or None."""
        sent = self._decoded(sample)
        if len(sent) < 4 and self.assistance is not None:
            coarse = GridClock(self._builder.sample_rate_hz, self.assistance.gps_ns_at_sample_0)
            names = self._builder.store.satellites
            gps_ns = coarse.gps_ns_at(sample)
            sent = resolve_start(self.assistance, self._builder, names, self._book, sample, gps_ns)
        if len(sent) < 4:
            return None
        receive_ms = max(ms for ms, _ in sent.values()) + FIRST_TRAVEL_MS
        solution = self._solve(sample, sent, receive_ms)
        if solution is None or not self._credible(solution):
            return None
        bias_ns = round(solution.clock_bias / SPEED_OF_LIGHT * NS_PER_S)
        return receive_ms * NS_PER_MS - bias_ns, solution.position_ecef

    def _decoded(self, sample: int) -> Sent:
        """Return the satellites whose channels know their transmit time."""
        builder, found = self._builder, {}
        for i in np.flatnonzero((builder.row >= 0) & (builder.transmit_ms >= 0)).tolist():
            tow_ms = int(builder.transmit_ms[i])
            name = builder.store.satellites[i]
            item = self._book.find(name, sample, tow_ms * NS_PER_MS, week_known=False)
            if item is not None:
                found[i] = week_of(item[0], tow_ms) * MS_PER_WEEK + tow_ms, item[1]
        return found

    def _solve(self, sample: int, sent: Sent, receive_ms: int) -> SppSolution | None:
        numbers = list(sent)
        whole = np.array([sent[i][0] for i in numbers])
        travel_ms = (receive_ms - whole) - self._builder.code_ms[numbers]
        near = np.flatnonzero(travel_ms < LONGEST_TRAVEL_MS)
        if len(near) < 4:
            return None
        numbers = [numbers[k] for k in near]
        pseudorange = travel_ms[near] * (SPEED_OF_LIGHT / 1000.0)
        week, tow_ns = divmod(receive_ms * NS_PER_MS, NS_PER_WEEK)
        packed = np.stack([sent[i][1] for i in numbers])
        doppler, cn0 = self._builder.doppler_and_cn0(numbers)
        return self._solver.solve(
            states_from_pseudoranges(packed, week, tow_ns, pseudorange),
            pseudorange,
            doppler,
            cn0,
            tow=tow_ns / NS_PER_S,
            klobuchar=self._book.klobuchar(sample),
        )

    def _credible(self, solution: SppSolution) -> bool:
        """Tell whether a first fix is consistent, determined, and nearer than the satellites."""
        radius = float(np.linalg.norm(solution.position_ecef))
        return (
            solution.consistent
            and float(solution.dops[0]) <= self._max_gdop
            and 6.3e6 < radius < 2.0e7
        )
