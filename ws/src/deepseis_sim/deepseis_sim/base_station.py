"""The base station: a still antenna some kilometres off, its receiver and its observations.

It sees the rover's satellites with the rover's initial phases, so that double differences have
whole ambiguities; path, atmosphere, clock and noise are its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, Observations
from deepseis_sim.constellation import cn0_at_elevation
from deepseis_sim.observation_model import ObservationConfig, ObservationModel
from deepseis_sim.signal_model import SignalModel, still
from deepseis_sim.site import Site
from deepseis_sim.slow_table import SlowTable

BASE_STREAM: Final = 62
"""Number of the base's random numbers."""
BASE_CLOCK_STREAM: Final = 63
"""Number of the random numbers of its clock."""
ELEVATION_STEP: Final = 10.0
"""Elevations are evaluated this far apart, with cubics between [s]."""
FARTHEST: Final = 50e3
"""Farther off, one atmosphere's gradient and the tangent plane mean little [m]."""


@dataclass(frozen=True)
class BaseConfig(ObservationConfig):
    """Settings of the base station, besides those of its observations.

    10 Hz is every fifth epoch of the rover: what changes between two of them, over 0.1 s, is the
    base's clock, which double differences cancel, and satellites' motion, which is computed; so
    a higher rate would only add data, a lower one let the corrections age in real time.
    """

    rate_hz: int = setting(10, "rate of observations, a divisor of 1e9 [Hz]", low=1, high=100)
    east: float = setting(2300.0, "antenna east of the site's origin [m]", low=-5e4, high=5e4)
    north: float = setting(-1800.0, "antenna north of it [m]", low=-5e4, high=5e4)
    up: float = setting(12.0, "antenna above the tangent plane [m]", low=-1e3, high=1e4)
    clock_bias: float = setting(
        -2.1e-4, "clock ahead of GPS time at the start [s]", low=-0.1, high=0.1
    )
    clock_drift: float = setting(-3e-8, "its drift [s/s]", low=-1e-4, high=1e-4)
    clock_allan_deviation: float = setting(
        1e-10, "white frequency noise of it, at 1 s [-]", low=0.0, high=1e-6
    )
    elevation_mask_deg: float = setting(10.0, "lowest satellite [deg]", low=-5.0, high=90.0)
    cn0_offset_db: float = setting(
        0.0, "added to the C/N0 of its clear sky [dB]", low=-20.0, high=20.0
    )


class BaseClock:
    """Bias, drift and white frequency noise, i.e. a random walk of the bias.

    The walk is drawn at whole seconds and is a cubic between: its frequency is continuous, so a
    Doppler has no corners. 8 bytes are kept for each second.

    Parameters
    ----------
    bias, drift : float
        At second 0 [s]; [s/s].
    allan_deviation : float
        At 1 s [-].
    seed : int
        Of the walk.
    """

    _BLOCK = 1024

    def __init__(self, bias: float, drift: float, allan_deviation: float, seed: int) -> None:
        self._bias, self._drift = bias, drift
        self._step, self._seed = allan_deviation, seed
        self._blocks: list[FloatArray] = []
        self._walk = SlowTable(lambda number: np.array(self._walk_at(number)), 1.0)

    def __call__(self, time: FloatArray) -> FloatArray:
        """Return the clock's lead [s] at receiver seconds since the start, shape (m,)."""
        return self._bias + self._drift * time + self._walk(time)

    def _walk_at(self, second: int) -> float:
        """Return the walk at a whole second [s]; zero up to the start."""
        number, row = divmod(max(second, 0), self._BLOCK)
        while len(self._blocks) <= number:
            rng = np.random.default_rng([self._seed, BASE_CLOCK_STREAM, len(self._blocks)])
            walk = np.zeros(self._BLOCK + 1)  # the last value is where the next block begins
            np.cumsum(self._step * rng.standard_normal(self._BLOCK), out=walk[1:])
            start = self._blocks[-1][-1] if self._blocks else 0.0
            self._blocks.append(start + walk)
        return float(self._blocks[number][row])


class BaseStation:
    """The base's observations.

    Parameters
    ----------
    rover : SignalModel
        Its satellites, start and initial phases are the base's too.
    origin_geodetic : array_like, shape (3,)
        Latitude [rad], longitude [rad], height [m] of the site's origin.
    config : BaseConfig, optional
        Settings.
    ionosphere, troposphere : bool, optional
        As the rover's model has them.
    seed : int, optional
        Of noise and clock.
    sample_rate_hz : float, optional
        Of the station's clock, in which ``sample_index`` counts [Hz].

    Attributes
    ----------
    position_ecef : ndarray, shape (3,)
        Antenna [m].
    signals : SignalModel
        What reaches it.

    Raises
    ------
    InputError
        A setting makes no sense.
    """

    def __init__(
        self,
        rover: SignalModel,
        origin_geodetic: ArrayLike,
        config: BaseConfig | None = None,
        *,
        ionosphere: bool = True,
        troposphere: bool = True,
        seed: int = 1,
        sample_rate_hz: float = 4e6,
    ) -> None:
        self.config = c = config or BaseConfig()
        if math.hypot(c.east, c.north, c.up) > FARTHEST:
            raise InputError("base", f"is more than {FARTHEST / 1e3:.0f} km off", "move it nearer")
        site = Site(origin_geodetic)
        offset = site.C_e_enu @ np.array([c.east, c.north, c.up])
        self.position_ecef: FloatArray = site.origin_ecef + offset
        clock = BaseClock(c.clock_bias, c.clock_drift, c.clock_allan_deviation, seed)
        self._satellites = rover.satellites
        self.signals = SignalModel(
            rover.satellites,
            rover.start,
            still(self.position_ecef),
            clock=clock,
            ionosphere=ionosphere,
            troposphere=troposphere,
        )
        self.signals.initial_phase_cycles = rover.initial_phase_cycles
        self._elevation = SlowTable(self._elevation_at, ELEVATION_STEP)
        self._observations = ObservationModel(
            self.signals,
            c,
            cn0=self.cn0_dbhz,
            seed=seed,
            stream=BASE_STREAM,
            sample_rate_hz=sample_rate_hz,
        )

    def cn0_dbhz(self, time: FloatArray) -> FloatArray:
        """Return the C/N0 [dB-Hz], shape (m, n), at seconds since the start, shape (m,).

        Nothing stands in the way; from the satellites' C/N0 at the start it follows elevation.
        """
        c, elevation = self.config, self._elevation(time)
        start = [item.cn0_dbhz - cn0_at_elevation(item.elevation) for item in self._satellites]
        clear = np.array(start) + cn0_at_elevation(elevation) + c.cn0_offset_db
        return np.where(elevation >= np.deg2rad(c.elevation_mask_deg), clear, -np.inf)

    def _elevation_at(self, number: int) -> FloatArray:
        return self.signals.delays(np.array([number * ELEVATION_STEP])).elevation[0]

    def count(self, duration: float) -> int:
        """Return how many epochs there are in so many seconds from the start."""
        return self._observations.count(duration)

    def epochs(self, first: int, count: int) -> Iterator[Observations]:
        """Yield epochs ``first .. first + count``; see `ObservationModel.epochs`."""
        return self._observations.epochs(first, count)
