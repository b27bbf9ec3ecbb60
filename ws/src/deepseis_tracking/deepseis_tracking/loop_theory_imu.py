"""How errors of the IMU and of the navigation reach the phase of an aided loop, T 3.13 to 3.20.

The aiding's velocity is wrong by ``dv(s)``, the NCO's phase by its integral, and the loop takes
away what it can: ``dtheta(s) = -(2 pi / lambda) (1 - H(s)) dv(s) / s`` (T 3.11, 3.19). The
simplified equations of an inertial unit whose axes are north, east, down (T 3.16, 3.17) give, to
the north, ``k`` integrations after the error::

    k = 1   dv_N(0)
    k = 2   b_a, K_a f_N, f_E phi_D(0), -f_D phi_E(0), noise of the accelerometer
    k = 3   f_D b_gE, -f_E b_gD, f_D K_g w_E, -f_E K_g w_D, noise of the gyroscopes

Constants begin at time 0, the navigation filter's update, and last until the next one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deepseis_core.imu_grades import STANDARD_GRAVITY, ImuGrade, TriadGrade
from deepseis_core.types import FloatArray
from deepseis_tracking.loop_theory import root_sum_square
from deepseis_tracking.loop_theory_analog import AnalogLoop


@dataclass(frozen=True)
class NavigationErrors:
    """What the navigation filter leaves at its update: the last rows of T table 3.1."""

    velocity: float
    """``dv_N(0)`` [m/s]."""
    pitch: float
    """``phi_E(0)`` [rad]."""
    heading: float
    """``phi_D(0)`` [rad]."""


@dataclass(frozen=True)
class Strain:
    """What moves and turns the unit: specific force [m/s^2] and rates [rad/s], north-east-down."""

    force_n: float = 0.0
    force_e: float = 0.0
    force_d: float = -STANDARD_GRAVITY
    rate_e: float = 0.0
    rate_d: float = 0.0


Curves = dict[str, FloatArray]


@dataclass(frozen=True)
class ImuErrorTheory:
    """Phase errors of a loop that a grade of IMU aids.

    Parameters
    ----------
    loop : AnalogLoop
    grade : ImuGrade
        Its ``bias`` is taken for the constant part, its ``instability`` and
        ``correlation_time`` for the Gauss-Markov part (T 3.13, 3.14).
    navigation : NavigationErrors
    strain : Strain
        Constant, as T 3.18 has it. For motion that changes: `under_motion`.
    elevation : float
        Of the satellite, in the north [rad]; T 3.19 has 0.
    """

    loop: AnalogLoop
    grade: ImuGrade
    navigation: NavigationErrors
    strain: Strain
    elevation: float = 0.0

    def constants(self, time: FloatArray) -> Curves:
        """Return phase errors [rad] by what stays constant between updates, T 3.20, signed.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Since the update, equally spaced from 0 on [s].
        """
        gyros, accelerometers = self.grade.gyros, self.grade.accelerometers
        f, errors = self.strain, self.navigation
        accelerations = {
            "accelerometer bias": accelerometers.bias,
            "accelerometer scale": accelerometers.scale * f.force_n,
            "initial pitch": -f.force_d * errors.pitch,
            "initial heading": f.force_e * errors.heading,
        }
        jerks = {
            "gyro bias, east axis": f.force_d * gyros.bias,
            "gyro bias, down axis": -f.force_e * gyros.bias,
            "gyro scale": gyros.scale * (f.force_d * f.rate_e - f.force_e * f.rate_d),
        }
        found = {"initial velocity": self._step(time, errors.velocity, 1)}
        found |= {name: self._step(time, value, 2) for name, value in accelerations.items()}
        found |= {name: self._step(time, value, 3) for name, value in jerks.items()}
        return found

    def noises(self, time: FloatArray) -> Curves:
        """Return sigmas [rad] of phase errors by what is drawn anew all the time, T 3.20.

        As printed, the Gauss-Markov processes begin at zero with the update (what they were is
        in the constant part), driven by white noise of density ``2 sigma^2 / T``.
        """
        gyros, accelerometers = self.grade.gyros, self.grade.accelerometers
        leverage = float(np.hypot(self.strain.force_d, self.strain.force_e))
        return {
            "accelerometer noise": self._white(time, accelerometers.walk, 2),
            "accelerometer wander": self._wander(time, accelerometers, 1.0, 2),
            "gyro noise": self._white(time, leverage * gyros.walk, 3),
            "gyro wander": self._wander(time, gyros, leverage, 3),
        }

    def total(self, time: FloatArray) -> FloatArray:
        """Return the root sum square of all [rad]: the constants are drawn by chance, too."""
        return root_sum_square(*self.constants(time).values(), *self.noises(time).values())

    def under_motion(
        self, time: FloatArray, force_n: FloatArray, force_e: FloatArray, force_d: FloatArray
    ) -> Curves:
        """Return signed phase errors [rad] by constants that act through a changing force.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Since the update, equally spaced [s].
        force_n, force_e, force_d : ndarray, shape (n,)
            Specific force [m/s^2].
        """
        gyro = self.grade.gyros.bias
        return {
            "accelerometer scale": self._respond(
                time, self.grade.accelerometers.scale * force_n, 2
            ),
            "initial heading": self._respond(time, force_e * self.navigation.heading, 2),
            "initial pitch": self._respond(time, -force_d * self.navigation.pitch, 2),
            "gyro bias, east axis": self._respond(time, force_d * gyro * time, 2),
            "gyro bias, down axis": self._respond(time, -force_e * gyro * time, 2),
        }

    def _step(self, time: FloatArray, value: float, derivative: int) -> FloatArray:
        return self._respond(time, np.full(time.size, value), derivative)

    def _respond(self, time: FloatArray, value: FloatArray, derivative: int) -> FloatArray:
        return -np.cos(self.elevation) * self.loop.error(time, value, derivative)

    def _white(self, time: FloatArray, walk: float, derivative: int) -> FloatArray:
        growth = self.loop.noise_growth(time, walk**2, derivative)
        return np.cos(self.elevation) * growth

    def _wander(
        self, time: FloatArray, triad: TriadGrade, leverage: float, derivative: int
    ) -> FloatArray:
        density = 2.0 * (leverage * triad.instability) ** 2 / triad.correlation_time
        shaping = (1.0, 1.0 / triad.correlation_time)
        return np.cos(self.elevation) * self.loop.noise_growth(time, density, derivative, shaping)


def calibrated(grade: ImuGrade) -> ImuGrade:
    """Return a grade whose turn-on biases a navigation filter has estimated.

    What is left of them is taken to be as large as what wanders in the run.
    """
    return replace(
        grade,
        gyro_bias_deg_per_h=grade.gyro_instability_deg_per_h,
        accel_bias=grade.accel_instability,
    )


def free_inertial_error(loop: AnalogLoop, grade: ImuGrade, span: float) -> float:
    """Return the peak phase error [rad] of a loop that nothing but the IMU aids, after D 7.

    The velocity's error grows as ``B + g alpha(0) + g D t`` over a span; levelling with the same
    accelerometers leaves ``alpha(0) = B / g``, a tilt that the paper does not give.

    Parameters
    ----------
    span : float
        From one update of the navigation to the next [s].
    """
    time = np.linspace(0.0, span, 301)
    slope = STANDARD_GRAVITY * grade.gyros.bias
    growth = 2.0 * grade.accelerometers.bias + slope * time
    return float(np.abs(loop.error(time, growth, 2)).max())


def delay_error(loop: AnalogLoop, frequency_hz: FloatArray, delay: float) -> FloatArray:
    """Return phase errors per phase oscillation if the aiding is late, T 3.12.

    ``|(1 - H) (1 - exp(-s t0))|``.

    Examples
    --------
    >>> loop = AnalogLoop.for_bandwidth(2, 8.0)
    >>> bool(delay_error(loop, np.array([2.0]), 1e-3)[0] < 0.013)
    True
    """
    return loop.error_gain(frequency_hz) * 2.0 * np.abs(np.sin(np.pi * frequency_hz * delay))
