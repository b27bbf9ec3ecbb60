"""What accelerometers can do for GNSS positions at best, from spectra alone.

GNSS measures the displacement with an error of the density ``G(f)``: white noise of every
position, and a drift. Accelerometers, integrated twice, measure it with an error of the density
``A(f)``, that of their noise over ``(2 pi f)^4``. Nothing else is known of the displacement, any
movement is as likely as any other. The best use of both, past and future, leaves::

    E(f) = G(f) A(f) / (G(f) + A(f))

where A is far above G, at low frequencies, GNSS stands alone with all of its drift. It needs no
filter to find this limit, so it tests one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq

from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import FloatArray

FOLDS: Final = 4
"""Images of the accelerometers' density about multiples of the rate of GNSS that are added up."""
LOWEST_HZ: Final = 1e-8


@dataclass(frozen=True)
class GnssErrors:
    """Errors of GNSS positions along one axis.

    Attributes
    ----------
    white_sd : float
        Of each position [m].
    drift_sd, correlation_time : float
        Of the first-order Gauss-Markov drift [m, s].
    rate_hz : float
        Positions a second.
    """

    white_sd: float
    drift_sd: float
    correlation_time: float
    rate_hz: float

    @property
    def sd(self) -> float:
        """Of white noise and drift together [m]."""
        return float(np.hypot(self.white_sd, self.drift_sd))

    def drift_density(self, f: FloatArray) -> FloatArray:
        """Return the one-sided density of the sampled drift [m^2/Hz]."""
        decay = np.exp(-1.0 / (self.rate_hz * self.correlation_time))
        # |1 - decay e^iw|^2 without the loss of digits that 1 - 2 decay cos + decay^2 has.
        distance = (1.0 - decay) ** 2 + 4.0 * decay * np.sin(np.pi * f / self.rate_hz) ** 2
        drive = self.drift_sd**2 * (1.0 - decay**2)
        return np.asarray(2.0 / self.rate_hz * drive / distance)

    def density(self, f: FloatArray) -> FloatArray:
        """Return the one-sided density of the whole error, up to half the rate [m^2/Hz]."""
        return 2.0 / self.rate_hz * self.white_sd**2 + self.drift_density(f)


def accelerometer_density(f: FloatArray, grade: ImuGrade) -> FloatArray:
    """Return the one-sided density of acceleration, integrated twice [m^2/Hz].

    Of white noise and in-run bias. The bias of turn-on is constant: it is at frequency zero.
    """
    sensor = grade.accelerometers
    w = 2.0 * np.pi * np.asarray(f, np.float64)
    walk = 2.0 * sensor.walk**2
    time = sensor.correlation_time
    bias = 4.0 * sensor.instability**2 * time / (1.0 + (w * time) ** 2)
    return np.asarray((walk + bias) / w**4)


def _folded(f: FloatArray, grade: ImuGrade, rate_hz: float) -> FloatArray:
    """Return that density as samples at the rate of GNSS have it."""
    total = accelerometer_density(f, grade)
    for n in range(1, FOLDS + 1):
        total = total + accelerometer_density(n * rate_hz - f, grade)
        total = total + accelerometer_density(n * rate_hz + f, grade)
    return total


def best_density(f: FloatArray, gnss: GnssErrors, grade: ImuGrade) -> FloatArray:
    """Return the density ``E(f)`` of the best estimate at the epochs of GNSS [m^2/Hz]."""
    G, A = gnss.density(f), _folded(f, grade, gnss.rate_hz)
    return np.asarray(G * A / (G + A))


def best_sd(gnss: GnssErrors, grade: ImuGrade) -> float:
    """Return the standard deviation of the best estimate [m]: the root of the integral of E.

    Examples
    --------
    White noise of a centimetre alone, once a second: the accelerometers carry the displacement
    over some ten positions.

    >>> from deepseis_core.imu_grades import grade_named
    >>> round(best_sd(GnssErrors(0.01, 0.0, 300.0, 1.0), grade_named("accelerometers")), 4)
    0.0028
    """
    f = np.geomspace(LOWEST_HZ, 0.5 * gnss.rate_hz, 20_000)
    return float(np.sqrt(np.trapezoid(best_density(f, gnss, grade), f)))


def crossing_hz(gnss: GnssErrors, grade: ImuGrade) -> float:
    """Return where accelerometers err as much as the drift: they cannot see it below [Hz]."""

    def excess(log_f: float) -> float:
        f = np.array([np.exp(log_f)])
        drift, position = gnss.drift_density(f), accelerometer_density(f, grade)
        return float(np.log(position[0]) - np.log(drift[0]))

    return float(np.exp(brentq(excess, np.log(1e-4), np.log(0.5 * gnss.rate_hz))))


def regrown_rms(drift_sd: float, correlation_time: float, duration: float) -> float:
    """Return the RMS, over a time, of a drift that was known exactly at its beginning [m].

    ``sd^2 (1 - exp(-2 t / T))`` of the drift is unknown after t.

    Examples
    --------
    Two minutes of a drift of 1 and 300 s:

    >>> round(regrown_rms(1.0, 300.0, 120.0), 3)
    0.558
    """
    ratio = 2.0 * duration / correlation_time
    return float(drift_sd * np.sqrt(1.0 + np.expm1(-ratio) / ratio))
