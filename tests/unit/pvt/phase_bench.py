"""Phases of made-up satellites: biases, drifts, clock, displacement and noise as they are told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepseis_pvt.phase_displacement import PhaseDisplacement
from deepseis_pvt.phase_values import (
    INTEGRATION,
    WAVELENGTH_RAD,
    PhaseConfig,
    PhaseEpoch,
    PhaseSolution,
)

ELEVATION = np.radians([75.0, 62.0, 51.0, 44.0, 38.0, 31.0, 26.0, 21.0, 17.0, 13.0, 12.0, 55.0])
AZIMUTH = np.radians(
    [10.0, 120.0, 230.0, 320.0, 75.0, 170.0, 275.0, 20.0, 135.0, 215.0, 300.0, 0.0]
)
CN0 = 45.0


def design(count: int) -> np.ndarray:
    """Return what east, north, up and clock add to the phases of the first satellites."""
    e, a = ELEVATION[:count], AZIMUTH[:count]
    flat = -np.cos(e)
    return np.stack([flat * np.sin(a), flat * np.cos(a), -np.sin(e), np.ones(count)], axis=1)


def noise_sd(config: PhaseConfig) -> float:
    """Return the phase noise that the filter expects, without its floor [m]."""
    cn0 = 10.0 ** (CN0 / 10.0)
    return WAVELENGTH_RAD * np.sqrt(
        config.loop_bandwidth_hz / cn0 * (1.0 + 0.5 / (INTEGRATION * cn0))
    )


class Phases:
    """A receiver's phases; to be solved by a filter of the same settings.

    ``motion`` gives east, north, up [m] at a time. Biases walk and drift as the settings say,
    white noise has their level times ``noise``.
    """

    def __init__(
        self,
        config: PhaseConfig,
        *,
        count: int = 10,
        rate_hz: float = 10.0,
        motion: Callable[[float], np.ndarray] = lambda t: np.zeros(3),
        noise: float = 1.0,
        drift: float = 1.0,
        seed: int = 1,
    ) -> None:
        self.config, self.count, self.interval = config, count, 1.0 / rate_hz
        self.motion, self.noise = motion, noise * noise_sd(config)
        self.rng = np.random.default_rng(seed)
        self.A = design(count)
        self.drift = drift
        self.growth = drift / np.sin(ELEVATION[:count])
        self.bias = self.rng.normal(0.0, 1e4, count)
        self.rate = config.bias_rate_sd * self.growth * self.rng.normal(size=count)
        self.number, self.time = 0, 0.0
        self.lock = np.full(count, 1e3)
        self.clock = 12.0

    def epoch(self, *, lost: tuple[int, ...] = (), slipped: tuple[int, ...] = ()) -> PhaseEpoch:
        """Make the next epoch, without some satellites, or with arcs that begin anew."""
        c, dt, m = self.config, self.interval, self.count
        if self.number:
            noise = self.rng.normal(size=(2, m))
            walk = self.drift * c.bias_walk * np.sqrt(dt) * noise[0]
            self.bias = self.bias + self.rate * dt + walk
            keep = np.exp(-dt / c.bias_rate_memory_s)
            new = np.sqrt(1.0 - keep**2) * c.bias_rate_sd * self.growth * noise[1]
            self.rate = keep * self.rate + new
        self.time = self.number * dt
        self.number += 1
        self.clock += 0.3 * self.rng.normal()
        free = np.append(self.motion(self.time), self.clock)
        phase = self.bias + self.A @ free + self.noise * self.rng.normal(size=m)
        self.lock = self.lock + dt
        self.lock[list(slipped)] = 0.0
        rows = np.array([k for k in range(m) if k not in lost], np.int64)
        return PhaseEpoch(
            time=self.time,
            interval=dt,
            slot=rows,
            residual=phase[rows],
            design=self.A[rows],
            elevation=ELEVATION[rows],
            cn0_dbhz=np.full(len(rows), CN0),
            slipped=np.isin(rows, slipped),
            lock_time=self.lock[rows],
            code_less_phase=self.clock - phase[rows],
        )

    def run(
        self, solver: PhaseDisplacement, seconds: float, still: bool, **faults: tuple[int, ...]
    ) -> list[PhaseSolution | None]:
        """Solve so many seconds; faults hold at every epoch."""
        count = round(seconds / self.interval)
        return [solver.solve(self.epoch(**faults), still) for _ in range(count)]
