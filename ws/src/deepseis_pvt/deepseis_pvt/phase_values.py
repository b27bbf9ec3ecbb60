"""Settings of the displacement from carrier phases, and what goes into and comes out of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.config import setting
from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.loop_noise import FALLBACK_BANDWIDTH_HZ
from deepseis_core.types import FloatArray, IntArray
from deepseis_pvt.rest_memory import DoubtConfig

WAVELENGTH_RAD: Final = L1_WAVELENGTH / (2.0 * np.pi)
INTEGRATION: Final = 0.02
"""Coherent integration of the squaring loss [s]."""


@dataclass(frozen=True)
class PhaseConfig(DoubtConfig):
    """Settings of the displacement from phases.

    What biases do is what real satellites show over a still antenna (`docs/positioning.md`): most
    of it are the satellites' clocks. Simulated ones of the bench have none of it.
    """

    phase_mask_deg: float = setting(10.0, "elevation mask [deg]", low=0.0, high=60.0)
    loop_bandwidth_hz: float = setting(
        8.0, "noise bandwidth of the carrier loops: noise by C/N0, white below it [Hz]", low=0.1
    )
    own_bandwidth_hz: float = setting(
        8.0, "of the loops themselves, where each integration's own phase is used [Hz]", low=0.1
    )
    fallback_bandwidth_hz: float = setting(
        FALLBACK_BANDWIDTH_HZ,
        "the same where a loop runs without the aiding that it ought to have [Hz]",
        low=0.1,
    )
    phase_floor_sd: float = setting(
        0.0003, "phase noise besides the thermal one, at the zenith [m]", low=0.0, high=0.05
    )
    bias_walk: float = setting(0.0008, "random walk of biases [m/sqrt(s)]", low=0.0, high=0.1)
    bias_rate_sd: float = setting(0.0004, "rate of biases, at the zenith [m/s]", low=0.0, high=0.1)
    bias_rate_memory_s: float = setting(
        30.0, "correlation time of that rate [s]", low=1.0, high=1e5
    )
    datum_lock_s: float = setting(
        0.3, "of phases that go on after all were lost in motion, from a place not known [s]",
        low=0.02, high=60.0,
    )  # fmt: skip
    calibration_s: float = setting(3.0, "stillness before displacements count [s]", low=0.1)
    phase_false_alarm: float = setting(
        1e-5, "of the outlier test, per epoch [-]", low=1e-12, high=0.1
    )
    max_slips: int = setting(3, "satellites excluded at most, per epoch", low=0, high=8)
    noise_memory_s: float = setting(
        10.0, "memory of the noise level that residuals show [s]", low=0.1, high=1e4
    )

    def variance(
        self, cn0_dbhz: FloatArray, elevation: FloatArray, alone: NDArray[np.bool_] | None = None
    ) -> FloatArray:
        """Return the variance of phases' noise [m^2]; ``alone``: of loops that lack aiding."""
        cn0 = 10.0 ** (cn0_dbhz / 10.0)
        lone = np.zeros(cn0.shape, np.bool_) if alone is None else alone
        bandwidth = np.where(lone, self.fallback_bandwidth_hz, self.loop_bandwidth_hz)
        thermal = bandwidth / cn0 * (1.0 + 0.5 / (INTEGRATION * cn0))
        floor = (self.phase_floor_sd / np.sin(elevation)) ** 2
        return np.asarray(WAVELENGTH_RAD**2 * thermal + floor)


@dataclass(frozen=True)
class PhaseEpoch:
    """Phases of one epoch, m satellites in ascending ``slot``.

    ``residual`` [m] is against the surveyed antenna, ``design`` (m, 4) what displacement east,
    north, up and clock add to it; ``slipped`` tells that a phase does not go on from the one
    before, ``lock_time`` for how long it has gone on [s]. ``code_less_phase`` [m] gives the
    codes' residuals: where the clock begins. ``lag`` is what discriminators say that the phases
    lag behind, and its open-loop sigma [m]; None: nothing. ``alone`` are loops that lack the
    aiding that they ought to have, and are wider, ``early`` those that do not know the data bits'
    edges yet, and integrate for 1 ms; None: none. ``held`` is what the loops' own phases are ahead
    of ``residual`` [m]; None: that is by these.
    """

    time: float
    interval: float
    slot: IntArray
    residual: FloatArray
    design: FloatArray
    elevation: FloatArray
    cn0_dbhz: FloatArray
    slipped: NDArray[np.bool_]
    lock_time: FloatArray
    code_less_phase: FloatArray
    lag: tuple[FloatArray, FloatArray] | None = None
    alone: NDArray[np.bool_] | None = None
    early: NDArray[np.bool_] | None = None
    held: FloatArray | None = None

    def settled(self, lock_s: float) -> NDArray[np.bool_]:
        """Tell whose loops have locked so long, know their bits, and do not lack aiding."""
        settled = ~self.slipped & (self.lock_time >= lock_s)
        for unsettled in (self.alone, self.early):
            settled &= True if unsettled is None else ~unsettled
        return settled


@dataclass(frozen=True)
class PhaseSolution:
    """One epoch: displacement [m] east, north, up and clock [m]; arrays aligned on the epoch's.

    ``covariance`` is of both, ``common`` the part of it that stays the same for many epochs
    (biases and the reference, not noise). ``used`` are the satellites of the solution,
    ``refused`` those whose phases the others contradict. ``datum`` 0: from the surveyed place.
    ``by_loops`` are the displacement by the loops' own phases and its sigmas, where it is another.
    """

    displacement: FloatArray
    clock: float
    covariance: FloatArray
    common: FloatArray
    clock_noise: float
    residual: FloatArray
    used: NDArray[np.bool_]
    refused: NDArray[np.bool_]
    calibrated: bool
    datum: int = 0
    by_loops: tuple[FloatArray, FloatArray] | None = None
