"""The receiver's oscillator: its clock's bias, with power-law noise and g-sensitivity.

The bias [s] at receiver time t is::

    b(t) = bias + drift t + n(t) + x_g(t),     n(0) = 0

``n`` is the integral of fractional frequency noise of the *one-sided* density
``S_y(f) = h_0 + h_-1 / f + h_-2 / f^2`` [1/Hz], whose Allan variance is (IEEE Std 1139)::

    sigma_y^2(tau) = h_0 / (2 tau) + 2 ln 2 h_-1 + 2 pi^2 / 3 h_-2 tau

It is known exactly on a grid of :data:`STEP`; between, it is a cubic with a continuous rate
(Catmull-Rom). The grid is that of the 10 ms segments of the signal's synthesis, which lays out
the carrier as cubics: it reproduces the clock without error.

An oscillator on the table feels the specific force f: ``y_g = Gamma . (f - f(rest)) / g``, Gamma
in body axes. While the attitude does not change this is the derivative of ``Gamma . v / g``.
Gravity is taken as constant, Coriolis' acceleration (2e-5 g at 1 m/s) is left out, and the force
is that at the body's origin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numba import njit

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.noise_processes import RecursiveNoise, flicker_bank
from deepseis_core.types import FloatArray, IntArray
from deepseis_sim.motion import Motion

STEP: Final = 0.01
"""Of the grid [s]."""

NODES: Final = 1024
"""Of the grid that are made together; the state is kept every 10.24 s (160 bytes)."""

LEAD: Final = 2 * NODES
"""Nodes before time 0: a receiver's clock is asked for moments before its start."""

EARLIEST, LATEST = 2.0 - STEP * LEAD, 1e6
"""First and last moment that can be asked for [s]; the body is up to 1 s (the bias) behind."""

NOISE_STREAM: Final = 50
"""Stream of random numbers."""

_SHORTEST, _SLOWEST = 1e-4, 1e5
"""Correlation times [s] between which flicker noise is made up."""

_GAUSS = np.array([0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5])
_GAUSS_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


@dataclass(frozen=True)
class PowerLaw:
    """One-sided density of fractional frequency ``S_y = h_0 + h_-1 / f + h_-2 / f^2`` [1/Hz]."""

    h_0: float
    h_minus_1: float
    h_minus_2: float

    def allan_deviation(self, tau: FloatArray) -> FloatArray:
        """Return sigma_y at averaging times [s]."""
        flicker = 2.0 * np.log(2.0) * self.h_minus_1
        walk = 2.0 * np.pi**2 / 3.0 * self.h_minus_2
        return np.sqrt(self.h_0 / (2.0 * tau) + flicker + walk * tau)


OSCILLATORS: Final[Mapping[str, PowerLaw]] = MappingProxyType(
    {
        "perfect": PowerLaw(0.0, 0.0, 0.0),
        # Thesis, below 3.4 (there without a word on one- or two-sided). These and the other two
        # are those of NovAtel's receivers and of J. O. Winkel, "Modeling and Simulating GNSS
        # Signal Structures and Receivers", 2000, table 2.1, where S_y is one-sided.
        "ocxo": PowerLaw(2.51e-26, 2.51e-23, 2.51e-22),
        "tcxo": PowerLaw(1e-21, 1e-20, 2e-20),
        "rubidium": PowerLaw(1e-23, 1e-22, 1.3e-26),
    }
)


@dataclass(frozen=True)
class OscillatorConfig:
    """Settings of the receiver's oscillator."""

    kind: str = setting("ocxo", "preset of the noise, or custom", choices=(*OSCILLATORS, "custom"))
    h_0: float = setting(0.0, "of kind custom: white frequency noise [1/Hz]", low=0.0, high=1e-15)
    h_minus_1: float = setting(0.0, "of kind custom: flicker noise [-]", low=0.0, high=1e-15)
    h_minus_2: float = setting(0.0, "of kind custom: random walk [Hz]", low=0.0, high=1e-15)
    bias: float = setting(3.2e-4, "clock ahead of GPS time at the start [s]", low=-1.0, high=1.0)
    drift: float = setting(8e-8, "drift of the clock [s/s]", low=-1e-4, high=1e-4)
    on_table: bool = setting(False, "rides on the moving body; else it stands still beside it")
    g_sensitivity: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "forward, left, up; felt on the table [1/g]", low=-1e-6, high=1e-6
    )

    @property
    def power_law(self) -> PowerLaw:
        """Noise of the frequency."""
        if self.kind == "custom":
            return PowerLaw(self.h_0, self.h_minus_1, self.h_minus_2)
        return OSCILLATORS[self.kind]


class Oscillator:
    """A receiver clock: call it with receiver seconds, shape (m,), for its bias [s].

    Parameters
    ----------
    config : OscillatorConfig
    seed : int
        Same seed, same noise.
    motion : Motion, optional
        Of the body, for an oscillator on the table.
    """

    def __init__(self, config: OscillatorConfig, seed: int, motion: Motion | None = None) -> None:
        try:
            check(config)
        except ValueError as error:
            raise InputError("oscillator", str(error)) from None
        numbers = [config.bias, config.drift, *vars(config.power_law).values()]
        if not np.isfinite([*numbers, *config.g_sensitivity]).all():
            raise InputError("oscillator", "a setting is not a finite number")
        if len(config.g_sensitivity) != 3:
            raise InputError(
                "oscillator",
                f"g_sensitivity has {len(config.g_sensitivity)} values",
                "three: forward, left, up",
            )
        self.config = config
        self._noise = _NoiseGrid(config.power_law, seed)
        self._at_zero = self._noise(LEAD, 1)[0, 0]
        gamma = np.array(config.g_sensitivity) / STANDARD_GRAVITY
        self._felt: _Turning | _Level | None = None
        if config.on_table and motion is not None and gamma.any():
            self._felt = (_Turning if motion.rotates else _Level)(gamma, motion)

    def __call__(self, time: FloatArray) -> FloatArray:
        """Return the bias [s] at receiver seconds since the start, any order, shape (m,)."""
        time = np.asarray(time, np.float64)
        if time.size and not (time.min() >= EARLIEST and time.max() <= LATEST):
            raise InputError(
                "oscillator", f"asked for {time.min():g} to {time.max():g} s",
                f"it runs from {EARLIEST:g} s to {LATEST:g} s",
            )  # fmt: skip
        steady = self.config.bias + self.config.drift * time
        bias = steady + (_interpolate(self._noise, time) - self._at_zero)
        if self._felt is not None:
            bias += self._felt(time - steady)
        return bias


class _NoiseGrid(RecursiveNoise):
    """Phase noise [s] on the grid, node ``LEAD`` being time 0.

    Its state is the frequency of each part (Gauss-Markov processes for flicker noise, and the
    random walk), then the phase. Frequency and phase of a part advance together: ``x += c y``,
    and of the covariance of what is new in both, the phase's share that is bound to the new
    frequency follows it; the rest of all parts is one white noise, h_0's included.
    """

    def __init__(self, law: PowerLaw, seed: int) -> None:
        sigma, times = flicker_bank(law.h_minus_1, _SHORTEST, _SLOWEST)
        super().__init__(seed, NOISE_STREAM, 1, np.zeros(sigma.size + 2), NODES)
        self._states[0][: sigma.size] = sigma * self.start_normals(sigma.size)
        walk_rate = 2.0 * np.pi**2 * law.h_minus_2
        flicker = [_advance_flicker(s, t) for s, t in zip(sigma, times, strict=True)]
        parts = np.array([*flicker, _advance_walk(walk_rate)])
        self._decay, self._drive, self._carry, self._bound = parts.T[:4].copy()
        self._free = float(np.sqrt(0.5 * law.h_0 * STEP + parts[:, 4].sum()))

    def _advance(self, number: int, state: FloatArray, out: FloatArray) -> None:
        normals = self.normals(number, state.size)
        advance_phase(
            state, self._decay, self._drive, self._carry, self._bound, self._free, normals, out
        )


class _Level:
    """Bias by g-sensitivity at true times while the attitude does not change: exact."""

    def __init__(self, gamma: FloatArray, motion: Motion) -> None:
        self._gamma, self._motion = gamma, motion
        self._start = self._lean(np.zeros(1))[0]

    def __call__(self, time: FloatArray) -> FloatArray:
        return self._lean(time) - self._start

    def _lean(self, time: FloatArray) -> FloatArray:
        kinematics = self._motion.at(time)
        # Row vector times matrix: Gamma . C^T v, whatever the shape of C.
        direction = kinematics.C_enu_b @ self._gamma
        return np.asarray((kinematics.velocity * direction).sum(axis=-1))


class _Turning:
    """Bias by g-sensitivity at true times of a body that turns: integrated on the grid.

    Each cell by Gauss' rule of three points; between the nodes a cubic with the nodes' rates.
    """

    def __init__(self, gamma: FloatArray, motion: Motion) -> None:
        self._gamma, self._motion = gamma, motion
        self._rest = 0.0
        self._rest = float(self._rate(np.array([-STEP * LEAD]))[0])
        self._totals = [0.0]
        self._recent: dict[int, FloatArray] = {}
        self._zero = self._at(np.zeros(1))[0]

    def __call__(self, time: FloatArray) -> FloatArray:
        return self._at(time) - self._zero

    def _rate(self, time: FloatArray) -> FloatArray:
        """Return the fractional frequency."""
        kinematics = self._motion.at(time)
        force = kinematics.acceleration + np.array([0.0, 0.0, STANDARD_GRAVITY])
        direction = kinematics.C_enu_b @ self._gamma
        return np.asarray((force * direction).sum(axis=-1)) - self._rest

    def _at(self, time: FloatArray) -> FloatArray:
        position = time / STEP + LEAD
        out = np.empty(time.size)
        for number, which in _blocks(position):
            node = np.floor(position[which]).astype(np.int64)
            local, share = node - number * NODES, position[which] - node
            phase, rise = self._block(number).T
            out[which] = _hermite(
                phase[local], phase[local + 1], rise[local], rise[local + 1], share
            )
        return out

    def _block(self, number: int) -> FloatArray:
        """Return phase [s] and rise a cell at a block's nodes and the next, (NODES + 1, 2)."""
        for k in range(len(self._totals) - 1, number):
            self._totals.append(self._totals[k] + float(self._integrals(k)[-1]))
        if number not in self._recent:
            nodes = number * NODES + np.arange(NODES + 1.0) - LEAD
            phase = self._totals[number] + self._integrals(number)
            while len(self._recent) > 3:
                del self._recent[next(iter(self._recent))]
            self._recent[number] = np.column_stack([phase, STEP * self._rate(STEP * nodes)])
        return self._recent[number]

    def _integrals(self, number: int) -> FloatArray:
        """Return the rate's integral from a block's first node to each and the next [s]."""
        cells = number * NODES + np.arange(float(NODES)) - LEAD
        times = STEP * (cells[:, None] + _GAUSS)
        rate = self._rate(times.ravel()).reshape(-1, 3)
        return np.append(0.0, np.cumsum(STEP * (rate * _GAUSS_WEIGHTS).sum(axis=1)))


def _interpolate(noise: _NoiseGrid, time: FloatArray) -> FloatArray:
    """Evaluate the phase noise between its nodes."""
    position = time / STEP + LEAD
    out = np.empty(time.size)
    for _, which in _blocks(position):
        node = np.floor(position[which]).astype(np.int64)
        first = int(node.min()) - 1
        table = noise(first, int(node.max()) + 3 - first)[:, 0]
        local, share = node - first, position[which] - node
        before, p0, p1, after = (table[local + k] for k in (-1, 0, 1, 2))
        out[which] = _hermite(p0, p1, 0.5 * (p1 - before), 0.5 * (after - p0), share)
    return out


def _blocks(position: FloatArray) -> list[tuple[int, IntArray]]:
    """Sort positions on the grid into its blocks: number, and indices of the positions."""
    number = np.floor(position).astype(np.int64) // NODES
    order = np.argsort(number, kind="stable")
    numbers, first = np.unique(number[order], return_index=True)
    return (
        list(zip(numbers.tolist(), np.split(order, first[1:]), strict=True)) if first.size else []
    )


def _hermite(
    p0: FloatArray, p1: FloatArray, slope0: FloatArray, slope1: FloatArray, s: FloatArray
) -> FloatArray:
    """Evaluate the cubic of given ends and slopes (per cell) at shares ``s`` of the cell."""
    rise = p1 - p0
    return p0 + s * (
        slope0 + s * (3.0 * rise - 2.0 * slope0 - slope1 + s * (slope0 + slope1 - 2.0 * rise))
    )


def _advance_flicker(sigma: float, time: float) -> tuple[float, float, float, float, float]:
    """Return decay, drive, carry, bound and free variance of a Gauss-Markov frequency.

    The exact covariance of frequency and phase over a step (van Loan, closed form).
    """
    d = STEP / time
    decay, gone = np.exp(-d), -np.expm1(-d)
    drive = sigma * np.sqrt(-np.expm1(-2.0 * d))
    bound = sigma**2 * time * gone**2 / drive if drive > 0.0 else 0.0
    # For slow processes the closed form cancels.
    exact = 2.0 * d - 2.0 * gone - gone**2
    series = d**3 * (2.0 / 3.0 - d / 2.0 + 7.0 / 30.0 * d**2)
    variance = (sigma * time) ** 2 * (exact if d > 1e-2 else series)
    return decay, drive, time * gone, bound, max(variance - bound**2, 0.0)


def _advance_walk(rate: float) -> tuple[float, float, float, float, float]:
    """Do so for a random walk of the frequency of ``rate`` [1/s]."""
    drive = np.sqrt(rate * STEP)
    return 1.0, drive, STEP, 0.5 * STEP * drive, rate * STEP**3 / 12.0


@njit(cache=True, nogil=True)
def advance_phase(
    state: FloatArray,
    decay: FloatArray,
    drive: FloatArray,
    carry: FloatArray,
    bound: FloatArray,
    free: float,
    normals: FloatArray,
    out: FloatArray,
) -> None:
    """Write the phase at each node, and bring frequencies and phase to the end of the block."""
    parts = decay.size
    for k in range(out.shape[0]):
        out[k, 0] = state[parts]
        phase = free * normals[k, parts]
        for j in range(parts):
            phase += carry[j] * state[j] + bound[j] * normals[k, j]
            state[j] = decay[j] * state[j] + drive[j] * normals[k, j]
        state[parts] += phase
