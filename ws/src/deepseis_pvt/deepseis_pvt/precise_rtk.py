"""RTK positions from observations of station and base, in order of validity."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from deepseis_core.config import check, setting
from deepseis_core.constants import NS_PER_S, NS_PER_WEEK, SPEED_OF_LIGHT
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.loop_noise import without_aiding
from deepseis_core.miss_log import EVER
from deepseis_core.types import (
    Ephemeris,
    FloatArray,
    Observations,
    PrecisePosition,
    PreciseStatus,
)
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.precise import nothing
from deepseis_pvt.rest_memory import RestMemory
from deepseis_pvt.rtk import RtkConfig, RtkSolution, RtkSolver
from deepseis_pvt.rtklib_values import BASE, ROVER, Navigation, fill_observations

RTK: Final = "rtk"
"""``method`` of a position against a base."""

TIED_EPOCHS: Final = 50
"""Fixed epochs after which an antenna at rest is let go."""
FLOATING_EPOCHS: Final = 500
"""Epochs without a fix after which an antenna at rest is held again."""

OFFSET_MEMORY: Final = 60.0
"""Rest over which the offset between survey and RTK is averaged [s]."""
CLOCK_STABILITY: Final = 1e-12
"""Allan deviation of satellite clocks at one second: what a base's age costs [-]."""


@dataclass(frozen=True)
class BaseConfig:
    """Settings of the base."""

    base_position_ecef: list[float] = setting(
        [], "base's antenna, ECEF; empty: as the base says, if there is one [m]"
    )
    base_latency_s: float = setting(
        0.2, "base observations are used from that long after their epoch on [s]", low=0.0, high=60
    )
    base_lost_s: float = setting(
        5.0, "a base without an epoch for so long is said to be lost [s]", low=0.2, high=600.0
    )


class RtkPositions:
    """Displacement of a surveyed antenna against a base, at every observation epoch.

    The epoch at t uses the base's newest observations of t - ``base_latency_s`` or before: so it
    is in real time, and so it is in a replay. Whether they are there is told by `base_valid`,
    never by silence; a base that is lost grows old, and ``base_age`` says so.

    An antenna at rest gives its ambiguities away at once, and the offset between its survey and
    RTK (base coordinates, atmosphere between the two) too: displacements are from that.

    Parameters
    ----------
    antenna_ecef : ndarray, shape (3,)
        Surveyed, ECEF [m].
    book : EphemerisBook
        Orbits and ionosphere; shared with the engine of positions.
    config : RtkConfig
        Settings of the solution.
    base : BaseConfig
        Settings of the base. Where they do not say where it is, it has to say so itself
        (`push_place`); until then there is no position.
    sample_rate_hz : float
        Nominal IF rate [Hz].
    phase : PhaseConfig, optional
        Noise of the phases, but for the loops' bandwidth.
    """

    def __init__(
        self,
        antenna_ecef: FloatArray,
        book: EphemerisBook,
        config: RtkConfig,
        base: BaseConfig,
        sample_rate_hz: float,
        phase: PhaseConfig | None = None,
    ) -> None:
        check(base)
        self.phase = replace(phase or PhaseConfig(), loop_bandwidth_hz=config.rtk_bandwidth_hz)
        self.antenna: FloatArray = np.array(antenna_ecef, np.float64)
        lat, lon, _ = geodetic_from_ecef(self.antenna)
        self._axes = rotation_enu_ecef(lat, lon)
        self.book, self.config, self.base = book, config, base
        self.solver: RtkSolver | None = None
        self._tied, self._started, self._in_row = False, False, 0
        self._offset, self._rested = np.zeros(3), 0.0
        self._memory = RestMemory[tuple[FloatArray, float]](self.phase.doubt_s)
        self._given = len(base.base_position_ecef) == 3
        self._places: deque[tuple[int, FloatArray]] = deque()
        if self._given:
            self._stand(np.array(base.base_position_ecef, np.float64))
        self.sample_rate_hz = sample_rate_hz
        self.latency = round(base.base_latency_s * sample_rate_hz)
        self._navigation, self._orbits = Navigation(), list[Ephemeris]()
        self._klobuchar: FloatArray | None = None
        self._waiting: deque[Observations] = deque()
        self._base: Observations | None = None
        self._base_valid = -1
        self.base_age_s = float("nan")
        self.counts = {
            "rtk_fix": 0,
            "rtk_float": 0,
            "rtk_none": 0,
            "rtk_tied": 0,
        }

    @property
    def trouble(self) -> str:
        """What is wrong with the base at the newest epoch; empty if nothing is."""
        if self.solver is None and self._base is not None:
            return "the base does not say where it is"
        if not self.base_age_s <= self.base.base_lost_s:
            known = self._base is not None
            return f"base lost {self.base_age_s:.0f} s ago" if known else "no base yet"
        return ""

    def late(self, sample_index: int) -> dict[str, int]:
        """Tell what an epoch lacks (observations of the base), and how far it is there."""
        return {"base": self._base_valid} if self._base_valid < sample_index - self.latency else {}

    def push_base(self, observations: Observations) -> None:
        """Take an epoch of the base, in order."""
        self._waiting.append(observations)

    def push_place(self, position_ecef: FloatArray, utc_ns: int) -> None:
        """Take where the base is for its epochs from a UTC on [m ECEF, ns since 1970]."""
        if not self._given:
            self._places.append((utc_ns, np.array(position_ecef, np.float64)))

    def base_valid(self, through: int) -> None:
        """All of the base's epochs through this sample have been pushed."""
        self._base_valid = max(self._base_valid, through)

    def doubt(self, sample_index: int) -> None:
        """Go back to the offset before the part of a rest that is not believed."""
        recalled = self._memory.recall(sample_index / self.sample_rate_hz)
        if recalled is not None:
            self._offset, self._rested = recalled[0]

    def solve(
        self,
        observations: Observations,
        slipped: Iterable[str] = (),
        rest: FloatArray | None = None,
        stress: FloatArray | None = None,
        known: int = EVER,
    ) -> PrecisePosition:
        """Return the position of an epoch; epochs come in order.

        Parameters
        ----------
        observations : Observations
        slipped : iterable of str
            Satellites whose phases others have found to have slipped.
        rest : ndarray, shape (3,), optional
            Where the antenna is known to be at rest, east, north, up of its surveyed place [m].
        stress : ndarray, shape (3, 3), optional
            Covariance of what the loops make displacements lag behind [m^2].
        known : int, optional
            What the base observed beyond this sample does not count: not all of it is there.
        """
        o = observations
        last = min(o.sample_index - self.latency, known)
        while self._waiting and self._waiting[0].sample_index <= last:
            self._base = self._waiting.popleft()
        if self._base is not None:
            later = GpsTime(o.week, o.tow_ns)
            base_time = GpsTime(self._base.week, self._base.tow_ns)
            self.base_age_s = later.diff_ns(base_time) / NS_PER_S
        self._take_place()
        if rest is None:
            self._memory.clear()
        self._tie(rest)
        solution = None
        if self._base is not None and self.solver is not None:
            self._find_orbits(o)
            room = self.solver.room
            rover = fill_observations(o, ROVER, room, 0, slipped)
            base = fill_observations(self._base, BASE, room, rover)
            solution = self.solver.solve(rover, base, self._navigation.nav)
        if solution is None or self._base is None:
            self.counts["rtk_none"] += 1
            return nothing(o, RTK)
        fixed = solution.status == PreciseStatus.FIX
        self._in_row = self._in_row + 1 if fixed == self._tied else 0
        kind = "tied" if self._tied else solution.status.name.lower()
        self.counts[f"rtk_{kind}"] += 1
        value = self._position(o, self._base, solution, rest)
        if stress is None:
            return value
        return replace(value, covariance_enu=value.covariance_enu + stress)

    def _take_place(self) -> None:
        """Take the base to be where it says that it is, for its newest epoch."""
        if self._base is None or not self._places:
            return
        utc_ns = GpsTime(self._base.week, self._base.tow_ns).to_utc_ns()
        found = None
        while self._places and self._places[0][0] <= utc_ns:
            found = self._places.popleft()[1]
        if found is not None:
            self._stand(found)

    def _stand(self, position: FloatArray) -> None:
        """Solve against a base at a place from now on; what was known of another is forgotten."""
        if self.solver is not None:
            self.solver.close()
        self.solver = RtkSolver(self.config, position)
        self._tied, self._started, self._in_row = False, False, 0
        self._offset, self._rested = np.zeros(3), 0.0
        self._memory.clear()

    def _tie(self, rest: FloatArray | None) -> None:
        """Hold a resting antenna where it is until its ambiguities are known.

        ``_in_row`` counts epochs that are fixed while it is held, and not fixed while it is free.
        """
        if self.solver is None:
            return
        enough = self._in_row >= (TIED_EPOCHS if self._tied else FLOATING_EPOCHS)
        if self._tied and (enough or rest is None):
            self.solver.tie(None)
            self._tied, self._in_row = False, 0
        elif not self._tied and rest is not None and (enough or not self._started):
            self.solver.tie(self.antenna + rest @ self._axes)
            self._tied, self._started, self._in_row = True, True, 0

    def _find_orbits(self, o: Observations) -> None:
        """Give RTKLIB the orbits in force, once a second or where a satellite is new."""
        known = {value.satellite for value in self._orbits}
        if o.tow_ns % NS_PER_S and known.issuperset(o.satellites):
            return
        gps_ns = o.week * NS_PER_WEEK + o.tow_ns
        items = [self.book.find(name, o.sample_index, gps_ns) for name in o.satellites]
        orbits = [item[0] for item in items if item is not None]
        klobuchar = self.book.klobuchar(o.sample_index)
        same = len(orbits) == len(self._orbits) and all(
            a is b for a, b in zip(orbits, self._orbits, strict=True)
        )
        if not same or klobuchar is not self._klobuchar:
            self._orbits, self._klobuchar = orbits, klobuchar
            self._navigation.set(orbits, klobuchar)

    def _position(
        self, o: Observations, base: Observations, solution: RtkSolution, rest: FloatArray | None
    ) -> PrecisePosition:
        status, place = solution.status, self._axes @ (solution.position_ecef - self.antenna)
        C, common = self._axes @ solution.covariance_ecef @ self._axes.T, np.zeros((3, 3))
        if self._tied:
            status = PreciseStatus.CALIBRATING
        elif status == PreciseStatus.FIX:
            C, common = self._noise(o, base, solution)
            if rest is not None:
                self._learn_offset(place - rest, o)
            if self._rested > 0.0:
                # The base's noise goes on for its interval: so many seconds are independent.
                common = common + C / max(1.0, min(self._rested, OFFSET_MEMORY))
            C = C + common
        used = set(solution.satellites)
        return PrecisePosition(
            sample_index=o.sample_index,
            week=o.week,
            tow_ns=o.tow_ns,
            valid_through=o.valid_through,
            method=RTK,
            status=status,
            displacement_enu=place - (0.0 if self._tied else self._offset),
            covariance_enu=np.ascontiguousarray(C),
            common_covariance_enu=np.ascontiguousarray(common).ravel(),
            clock_bias=float("nan"),
            clock_bias_sd=float("nan"),
            satellites=solution.satellites,
            phase_residual=solution.residual.astype(np.float32),
            rejected=tuple(name for name in o.satellites if name not in used),
            ratio=solution.ratio,
            base_age=solution.age,
        )

    def _learn_offset(self, offset: FloatArray, o: Observations) -> None:
        """Follow what RTK says of an antenna at rest: base coordinates, atmosphere between."""
        self._rested += o.interval
        weight = o.interval / min(self._rested, OFFSET_MEMORY)
        self._offset = self._offset + weight * (offset - self._offset)
        time = o.sample_index / self.sample_rate_hz
        if self._memory.due(time):
            self._memory.keep(time, (self._offset, self._rested))

    def _noise(
        self, o: Observations, base: Observations, solution: RtkSolution
    ) -> tuple[FloatArray, FloatArray]:
        """Return the covariance of a fixed position, for RTKLIB's weights: of noise, and of age.

        With known integers it is ``G R G'``, G the gain of the weighted least squares.
        """
        azimuth, elevation = solution.direction.T
        flat = -np.cos(elevation)
        A = np.stack(
            [flat * np.sin(azimuth), flat * np.cos(azimuth), -np.sin(elevation),
             np.ones(len(elevation))], axis=1,
        )  # fmt: skip
        c = self.config
        weight = 1.0 / (c.rtk_carrier_sd**2 + (c.rtk_carrier_low_sd / np.sin(elevation)) ** 2)
        G = np.linalg.solve(A.T @ (A * weight[:, None]), (A * weight[:, None]).T)[:3]
        R = np.zeros(len(elevation))
        for receiver in (o, base):
            rows = [receiver.satellites.index(name) for name in solution.satellites]
            alone = without_aiding(receiver)[rows]
            R += self.phase.variance(receiver.cn0_dbhz[rows].astype(np.float64), elevation, alone)
        aged = (CLOCK_STABILITY * SPEED_OF_LIGHT * solution.age) ** 2
        return np.asarray((G * R) @ G.T), np.asarray(aged * G @ G.T)


def rtk_positions(
    position_ecef: Sequence[float],
    book: EphemerisBook,
    config: RtkConfig,
    base: BaseConfig,
    sample_rate_hz: float,
    phase: PhaseConfig,
    *,
    is_there: bool,
) -> RtkPositions | None:
    """Return what solves against a base; None without one, or without a surveyed antenna."""
    if len(position_ecef) != 3 or not (is_there or len(base.base_position_ecef) == 3):
        return None
    return RtkPositions(np.array(position_ecef), book, config, base, sample_rate_hz, phase)
