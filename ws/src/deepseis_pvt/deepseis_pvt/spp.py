"""Single-point position, velocity and clock of one epoch, with outliers excluded.

Weighted least squares on code and Doppler of broadcast-orbit satellites. Range noise is
modelled per satellite as::

    variance = floor_sd^2 + code_sd^2 / sin el + URA^2 + (0.5 I)^2 + (tropo_sd / (sin el + 0.1))^2

with I the Klobuchar delay, which removes about half of the ionosphere (before its parameters
are known, I stands for ``unknown_iono_sd`` at the zenith, and counts whole); with weighting
``cn0`` the code's part is code_sd^2 10^((45 - C/N0) / 10) instead. A chi-square test of the
weighted residuals finds out whether an outlier is present; the satellite without which the rest
agrees best is left out, one at a time (B. W. Parkinson and P. Axelrad, "Autonomous GPS integrity
monitoring using the pseudorange residual", Navigation 35(2), 1988).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from deepseis_core.config import setting
from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.types import FloatArray
from deepseis_pvt import spp_kernels as kernels

NO_IONOSPHERE: FloatArray = np.zeros(8)


@dataclass(frozen=True)
class SppConfig:
    """Settings of the single-point solution."""

    elevation_mask_deg: float = setting(10.0, "elevation mask [deg]", low=-5.0, high=60.0)
    ionosphere: bool = setting(True, "remove the Klobuchar delay where its parameters are known")
    troposphere: bool = setting(True, "remove the Saastamoinen delay")
    weighting: str = setting(
        "elevation", "what code noise depends on", choices=("elevation", "cn0", "none")
    )
    floor_sd: float = setting(0.3, "noise of every range [m]", low=0.0, high=100.0)
    code_sd: float = setting(0.6, "code noise at the zenith [m]", low=0.01, high=100.0)
    ephemeris_part: float = setting(
        1.0, "orbit and clock error as a part of the broadcast URA [-]", low=0.0, high=10.0
    )
    unknown_iono_sd: float = setting(
        5.0, "zenith ionosphere before its parameters are known [m]", low=0.0, high=50.0
    )
    tropo_sd: float = setting(0.3, "troposphere left over at the zenith [m]", low=0.0, high=3.0)
    range_rate_sd: float = setting(
        0.05, "range-rate noise at the zenith [m/s]", low=1e-4, high=10.0
    )
    false_alarm_probability: float = setting(
        1e-4, "of the chi-square tests, per epoch [-]", low=1e-9, high=0.1
    )
    max_exclusions: int = setting(2, "satellites excluded at most, per epoch", low=0, high=8)


@dataclass(frozen=True)
class SppSolution:
    """One epoch's solution; arrays are aligned on the satellites given to ``SppSolver.solve``.

    ``covariance`` is of position and clock bias [m^2]; ``velocity_covariance`` of velocity and
    clock drift [m^2/s^2], NaN where Doppler did not suffice. Where a test failed that no exclusion
    could mend, ``consistent`` is False and the covariance is scaled up to the residuals.
    """

    position_ecef: FloatArray
    clock_bias: float
    velocity_ecef: FloatArray
    clock_drift: float
    covariance: FloatArray
    velocity_covariance: FloatArray
    used: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
    pseudorange_residual: FloatArray
    range_rate_residual: FloatArray
    elevation: FloatArray
    azimuth: FloatArray
    dops: FloatArray
    consistent: bool


class SppSolver:
    """Solves epochs one by one, independently of each other.

    Parameters
    ----------
    config : SppConfig
        Settings.
    """

    def __init__(self, config: SppConfig | None = None) -> None:
        self.config = c = config or SppConfig()
        self._model = np.array(
            [
                np.radians(c.elevation_mask_deg),
                float(c.weighting == "elevation"),
                c.floor_sd,
                float(c.ionosphere),
                float(c.troposphere),
                0.5,
                c.tropo_sd,
                0.0,
            ]
        )
        self._limits = [float(chdtri(n, c.false_alarm_probability)) for n in range(1, 65)]

    def solve(
        self,
        satellites: FloatArray,
        pseudorange: FloatArray,
        carrier_doppler_hz: FloatArray,
        cn0_dbhz: FloatArray,
        *,
        tow: float,
        accuracy: FloatArray | None = None,
        klobuchar: FloatArray | None = None,
        start: FloatArray | None = None,
        extra_rate_sd: FloatArray | None = None,
    ) -> SppSolution | None:
        """Return the solution, or None if there is none.

        Parameters
        ----------
        satellites : ndarray, shape (n, 12)
            States at the moments of transmission (`core.ephemeris.states_from_pseudoranges`).
        pseudorange, carrier_doppler_hz, cn0_dbhz : ndarray, shape (n,)
            C1C [m], D1C [Hz] (NaN: none) and S1C [dB-Hz].
        tow : float
            GPS seconds of week, for the ionosphere [s].
        accuracy : ndarray, shape (n,), optional
            Broadcast URA [m]; default 2.
        klobuchar : ndarray, shape (8,), optional
            alpha 0..3, beta 0..3; without them no ionospheric delay is removed.
        start : ndarray, shape (4,), optional
            Approximate position and clock bias [m]; default the Earth's centre.
        extra_rate_sd : ndarray, shape (n,), optional
            Noise of range rates besides the usual [m/s]; default none.
        """
        n = len(pseudorange)
        noise = self._code_noise(np.asarray(cn0_dbhz, np.float64))
        model = self._model
        if klobuchar is None and model[kernels.IONO_ON]:
            model = model.copy()
            model[kernels.IONO_ON] = 0.0
            model[kernels.IONO_SD] = self.config.unknown_iono_sd
        orbit_sd = np.full(n, 2.0) if accuracy is None else np.asarray(accuracy, np.float64)
        orbit_sd = orbit_sd * self.config.ephemeris_part
        epoch = _Epoch(satellites, pseudorange, noise, orbit_sd, klobuchar, tow, model, start)
        excluded = np.zeros(n, np.bool_)
        if not epoch.solve(excluded):
            return None
        consistent, excluded = self._exclude_outliers(epoch, excluded)
        extra = np.zeros(n) if extra_rate_sd is None else extra_rate_sd
        return self._finish(epoch, excluded, consistent, carrier_doppler_hz, extra)

    def _code_noise(self, cn0_dbhz: FloatArray) -> FloatArray:
        noise = np.full(len(cn0_dbhz), self.config.code_sd)
        if self.config.weighting == "cn0":
            noise *= 10.0 ** ((45.0 - cn0_dbhz) / 20.0)
        return noise

    def _exclude_outliers(
        self, epoch: _Epoch, excluded: NDArray[np.bool_]
    ) -> tuple[bool, NDArray[np.bool_]]:
        """Leave out satellites until the rest passes the test; all stay where none mends it."""
        everyone = excluded.copy()
        for _ in range(self.config.max_exclusions):
            if self._passes(epoch):
                return True, excluded
            if epoch.used < 6:
                break
            trials = []
            for i in np.flatnonzero(epoch.geometry[:, kernels.USED] > 0.0):
                trial = excluded.copy()
                trial[i] = True
                if epoch.solve(trial) and np.isfinite(epoch.chi_square()):
                    trials.append((epoch.chi_square(), int(i)))
            if trials:
                excluded[min(trials)[1]] = True
            if not epoch.solve(excluded):
                break
        if epoch.used >= 4 and self._passes(epoch):
            return True, excluded
        epoch.solve(everyone)
        return False, everyone

    def _passes(self, epoch: _Epoch) -> bool:
        freedom = epoch.used - 4
        return freedom == 0 or epoch.chi_square() <= self._limits[freedom - 1]

    def _finish(
        self,
        epoch: _Epoch,
        excluded: NDArray[np.bool_],
        consistent: bool,
        doppler: FloatArray,
        extra_rate_sd: FloatArray,
    ) -> SppSolution | None:
        geometry, state = epoch.geometry, epoch.state
        dops = np.full(4, np.nan)
        if not kernels.dilution(geometry, state, dops):
            return None
        if not consistent:
            epoch.covariance *= epoch.chi_square() / (epoch.used - 4)
        velocity, velocity_covariance, rate_residual = self._velocity(
            epoch, doppler, extra_rate_sd
        )
        return SppSolution(
            position_ecef=state[:3].copy(),
            clock_bias=float(state[3]),
            velocity_ecef=velocity[:3],
            clock_drift=float(velocity[3]),
            covariance=epoch.covariance,
            velocity_covariance=velocity_covariance,
            used=geometry[:, kernels.USED] > 0.0,
            rejected=excluded,
            pseudorange_residual=geometry[:, kernels.RESIDUAL],
            range_rate_residual=rate_residual,
            elevation=geometry[:, kernels.ELEVATION],
            azimuth=geometry[:, kernels.AZIMUTH],
            dops=dops,
            consistent=consistent,
        )

    def _velocity(
        self, epoch: _Epoch, doppler: FloatArray, extra_rate_sd: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Solve for velocity; outliers of Doppler leave by the same test as those of range."""
        rate = -L1_WAVELENGTH * np.asarray(doppler, np.float64)
        n = len(rate)
        variance = np.full(n, self.config.range_rate_sd**2)
        if self.config.weighting == "elevation":
            sine = np.sin(epoch.geometry[:, kernels.ELEVATION])
            variance /= np.maximum(sine, 0.05) ** 2
        variance += np.square(extra_rate_sd)
        out = np.zeros(n, np.bool_)
        unknown = np.full(4, np.nan), np.full((4, 4), np.nan), np.full(n, np.nan)
        for _ in range(self.config.max_exclusions + 1):
            state, covariance, residual = np.zeros(4), np.zeros((4, 4)), np.full(n, np.nan)
            used = kernels.solve_velocity(
                epoch.state, epoch.satellites, rate, variance, out, epoch.geometry,
                state, covariance, residual,
            )  # fmt: skip
            if used < 4:
                return unknown
            normalised = np.nan_to_num(residual / np.sqrt(variance))
            chi_square = float(normalised @ normalised)
            if used == 4 or chi_square <= self._limits[used - 5]:
                return state, covariance, residual
            best = state, covariance * (chi_square / (used - 4)), residual
            if used < 6:
                return best
            out[int(np.argmax(np.abs(normalised)))] = True
        return best


class _Epoch:
    """Arrays of one epoch in hand, solved with ever other satellites left out."""

    def __init__(
        self,
        satellites: FloatArray,
        pseudorange: FloatArray,
        noise: FloatArray,
        orbit_sd: FloatArray,
        klobuchar: FloatArray | None,
        tow: float,
        model: FloatArray,
        start: FloatArray | None,
    ) -> None:
        self.satellites = np.ascontiguousarray(satellites, np.float64)
        self.pseudorange = np.ascontiguousarray(pseudorange, np.float64)
        self.noise, self.orbit_sd = noise, orbit_sd
        self.tow, self.model = float(tow), model
        self.klobuchar = NO_IONOSPHERE if klobuchar is None else klobuchar
        self.start = np.zeros(4) if start is None else start
        self.state: FloatArray = self.start
        self.geometry: FloatArray = np.zeros((len(noise), 8))
        self.covariance: FloatArray = np.zeros((4, 4))
        self.used = 0

    def solve(self, excluded: NDArray[np.bool_]) -> bool:
        """Solve without some satellites; tell whether there is a solution."""
        self.state = self.start.copy()
        self.used = kernels.solve_position(
            self.state, self.satellites, self.pseudorange, self.noise, self.orbit_sd, excluded,
            self.klobuchar, self.tow, self.model, self.geometry, self.covariance,
        )  # fmt: skip
        return self.used >= 4

    def chi_square(self) -> float:
        """Return the sum of the squared weighted residuals of the satellites used."""
        g = self.geometry
        residual = g[:, kernels.RESIDUAL]
        weights = g[:, kernels.USED] / g[:, kernels.VARIANCE]
        return float(np.sum(weights * residual * residual))
