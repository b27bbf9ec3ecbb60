"""An earthquake after the building code: trigonometric series with the code's response spectrum.

The accelerometer paper's equations 1 to 5 [1]_: a stationary process with the power spectrum
that Kaul's relation gives for the design spectrum of GB 50011-2010, under an envelope that rises,
lasts and dies away; then matched to the design spectrum (`deepseis_sim.spectral_matching`).

References
----------
.. [1] X. Min, X. Niu, Y. Li and C. Shi, the paper on accelerometers loosely coupled with PPP and
   smoothed (RTS) for earthquakes; its sources are Hu Yuxian, "Earthquake engineering", 2nd ed.,
   2006 (series) and GB 50011-2010 (spectrum).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.design_spectrum import (
    INTENSITIES,
    LEVELS,
    LONGEST_PERIOD,
    REST_SHARE,
    SITE_CLASSES,
    STANDARD_GRAVITY,
    VERTICAL_SHARE,
    DesignSpectrum,
    characteristic_period,
    maximum_coefficient,
)
from deepseis_sim.motion import Kinematics, Motion, MotionConfig, Surroundings
from deepseis_sim.motions_shapes import LONGEST, Upright, check_settings
from deepseis_sim.spectral_matching import (
    OVERSAMPLING,
    ComplexArray,
    CosineSum,
    Goal,
    match_spectrum,
)
from deepseis_sim.uniform_spline import UniformSpline

PHASE_STREAM: Final = 501
"""Stream of the random phases; below it the axis and the attempt."""

RATE_HZ: Final = 200.0
"""Samples of acceleration a second; a spline goes through them."""

SHORTEST_PERIOD: Final = 0.04
"""Where the match of the spectrum begins [s]; it ends with the code's spectrum."""

PERIODS_PER_BANDWIDTH: Final = 10.0
"""Matched periods within ``2 damping``, the relative width of a resonance."""

ATTEMPTS: Final = 4
"""Draws of the phases before a spectrum is given up."""

FADE: Final = 2.0
"""The envelope's last piece, over which what is left of the exponential goes to zero [s]."""

TOLERANCE_SHARE: Final = 0.9
"""The match leaves a tenth of the tolerance to whatever samples the spectrum elsewhere."""

AXES: Final = ("east", "north", "up")


@dataclass(frozen=True)
class Artificial:
    """An artificial earthquake whose response spectrum is that of GB 50011-2010."""

    start: float = setting(900.0, "first movement [s]", low=0.0, high=LONGEST)
    duration: float = setting(120.0, "length [s]", low=20.0, high=600.0)
    intensity: str = setting("8", "fortification intensity (7.5: 0.15 g)", choices=INTENSITIES)
    level: str = setting("rare", "how often it is exceeded", choices=LEVELS)
    site_class: str = setting("II", "of the soil", choices=SITE_CLASSES)
    group: int = setting(1, "design earthquake group, near to far", low=1, high=3)
    alpha_max: float = setting(
        0.0, "greatest influence coefficient [g]; 0: intensity's and level's", low=0.0, high=10.0
    )
    characteristic_period: float = setting(
        0.0, "end of the plateau [s]; 0: site's and group's", low=0.0, high=1.2
    )
    pga: float = setting(
        0.0, "if > 0, scales the spectrum to this horizontal peak [m/s^2]", low=0.0, high=100.0
    )
    vertical_ratio: float = setting(
        VERTICAL_SHARE, "vertical spectrum over horizontal", low=0.01, high=2.0
    )
    damping: float = setting(0.05, "damping ratio of the spectrum", low=0.01, high=0.3)
    not_exceeded: float = setting(
        0.85, "chance that a response stays below the spectrum", low=0.01, high=0.999
    )
    decay: float = setting(0.15, "decay of the envelope c [1/s]", low=0.01, high=1.0)
    t1: tuple[float, float, float] = setting(
        (8.0, 10.0, 6.0), "end of the envelope's rise, east, north, up [s]", low=0.5, high=600.0
    )
    t2: tuple[float, float, float] = setting(
        (35.0, 40.0, 30.0), "beginning of its decay, east, north, up [s]", low=0.5, high=600.0
    )
    t3: tuple[float, float, float] = setting(
        (120.0, 118.0, 115.0), "its end, east, north, up [s]", low=5.0, high=600.0
    )
    frequency_range_hz: tuple[float, float] = setting(
        (0.1, 40.0), "lowest and highest frequency [Hz]", low=0.02, high=60.0
    )
    tolerance: float = setting(
        0.05, "greatest relative deviation from the spectrum", low=0.02, high=0.5
    )
    iterations: int = setting(20, "rounds of the match at most", low=1, high=200)

    def build(self, around: Surroundings) -> Motion:
        """Make the earthquake; the seed is that of the scenario."""
        self._check()
        axes = [self._axis(axis, around.seed) for axis in range(3)]
        return ArtificialEarthquake(_settled(self.start, np.stack(axes, axis=1)))

    def spectrum(self, axis: int) -> DesignSpectrum:
        """Return what the response spectrum of an axis (0 east, 1 north, 2 up) should be."""
        alpha_max = self.alpha_max or maximum_coefficient(self.intensity, self.level)
        if self.pga > 0.0:
            alpha_max = self.pga / (REST_SHARE * STANDARD_GRAVITY)
        if axis == 2:
            alpha_max *= self.vertical_ratio
        period = self.characteristic_period or characteristic_period(
            self.site_class, self.group, self.level
        )
        return DesignSpectrum(alpha_max, period, self.damping)

    def _check(self) -> None:
        """Raise InputError where settings do not go together."""
        kind = "artificial"
        check_settings(kind, self)
        if self.alpha_max > 0.0 and self.pga > 0.0:
            raise InputError(kind, "alpha_max and pga both set the height", "leave one at 0")
        if not all(len(item) == 3 for item in (self.t1, self.t2, self.t3)):
            raise InputError(kind, "t1, t2 and t3 take three values each", "east, north, up")
        for name, t1, t2, t3 in zip(AXES, self.t1, self.t2, self.t3, strict=True):
            if not (t1 < t2 <= t3 - FADE and t3 <= self.duration):
                reason = f"{name}: t1 = {t1}, t2 = {t2}, t3 = {t3} s are not in order"
                hint = f"t1 < t2 <= t3 - {FADE:g} s, t3 <= duration = {self.duration:g} s"
                raise InputError(kind, reason, hint)
        if len(self.frequency_range_hz) != 2:
            raise InputError(kind, "frequency_range_hz takes two values", "lowest, highest")
        low, high = self.frequency_range_hz
        if low > 1.0 / LONGEST_PERIOD or high < 1.0 / SHORTEST_PERIOD:
            reason = f"frequencies of {low:g} to {high:g} Hz do not make the spectrum"
            raise InputError(kind, reason, "it needs 1/6 to 25 Hz at least; take 0.1 to 40")

    def _axis(self, axis: int, seed: int) -> FloatArray:
        """Return samples of acceleration [m/s^2], the last one zero."""
        spectrum = self.spectrum(axis)
        series = self._series(axis)
        octaves = math.log(LONGEST_PERIOD / SHORTEST_PERIOD)
        count = math.ceil(PERIODS_PER_BANDWIDTH * octaves / (2.0 * self.damping))
        periods = np.geomspace(SHORTEST_PERIOD, LONGEST_PERIOD, max(count, 200))
        periods = np.concatenate([[0.0], periods.clip(max=LONGEST_PERIOD)])
        goal = Goal(
            periods,
            spectrum.acceleration(periods),
            self.damping,
            self.tolerance * TOLERANCE_SHARE,
        )
        size = kaul_amplitudes(series.frequencies_hz, spectrum, self.duration, self.not_exceeded)
        best = None
        for attempt in range(ATTEMPTS):
            rng = np.random.default_rng([seed, PHASE_STREAM, axis, attempt])
            phase = rng.uniform(0.0, 2.0 * np.pi, size.size)
            start: ComplexArray = size * np.exp(1j * phase)
            match = match_spectrum(series, start, goal, rounds=self.iterations)
            if best is None or match.deviation < best.deviation:
                best = match
            if best.deviation <= goal.tolerance:
                break
        if best is None or best.deviation > self.tolerance:
            within = f"{100.0 * best.deviation:.1f} %" if best else "nothing"
            reason = f"the spectrum ({AXES[axis]}) comes within {within} only"
            raise InputError("artificial", reason, "another duration, t2, seed or tolerance")
        return np.append(series.fine_samples(best.amplitudes)[::OVERSAMPLING], 0.0)

    def _series(self, axis: int) -> CosineSum:
        """Return the cosines and the envelope of an axis."""
        n = round(self.duration * RATE_HZ)
        time = np.arange(n * OVERSAMPLING) / (RATE_HZ * OVERSAMPLING)
        f = envelope(time, self.t1[axis], self.t2[axis], self.t3[axis], self.decay)
        low, high = (math.ceil(n / RATE_HZ * limit) for limit in self.frequency_range_hz)
        return CosineSum(f, 1.0 / RATE_HZ, np.arange(low, high + 1))


@dataclass(frozen=True)
class ArtificialEarthquake(Upright):
    """Translation of the ground: at rest at the origin before and after.

    Attributes
    ----------
    path : UniformSpline
        Displacement, axes east, north, up, over true time.
    """

    path: UniformSpline

    @property
    def span(self) -> tuple[float, float]:
        """First and last movement [s]."""
        return self.path.start, self.path.end

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        return Kinematics(*self.path.evaluate(np.clip(time, *self.span)))


def envelope(time: FloatArray, t1: float, t2: float, t3: float, decay: float) -> FloatArray:
    """Return the envelope f(t) of the paper's equation 4.

    Before the last seconds, over which it fades so that acceleration ends without a step::

        (t / t1)^2              0  <= t < t1
        1                       t1 <= t < t2
        exp(-c (t - t2))        t2 <= t < t3
    """
    fade = np.sin(0.5 * np.pi * np.clip((t3 - time) / FADE, 0.0, 1.0)) ** 2
    return np.minimum(time / t1, 1.0) ** 2 * np.exp(-decay * np.maximum(time - t2, 0.0)) * fade


def kaul_amplitudes(
    frequencies_hz: FloatArray, spectrum: DesignSpectrum, duration: float, not_exceeded: float
) -> FloatArray:
    """Return amplitudes of cosines after Kaul's relation.

    The paper's equations 2 and 5::

        S(w) = xi / (pi w) Sa(w)^2 / (-ln(-pi / (w Td) ln p)),    C = sqrt(4 S dw)

    Parameters
    ----------
    frequencies_hz : ndarray, shape (k,)
        Equidistant.
    spectrum : DesignSpectrum
        Gives ``Sa`` and the damping ``xi``; beyond its end the displacement stays the same.
    duration : float
        Of the shaking ``Td`` [s].
    not_exceeded : float
        Chance ``p`` that a response stays below ``Sa``.

    Returns
    -------
    ndarray, shape (k,)
        [m/s^2].
    """
    w = 2.0 * np.pi * frequencies_hz
    period = 1.0 / frequencies_hz
    inside = np.minimum(period, LONGEST_PERIOD)
    Sa = spectrum.acceleration(inside) * (inside / period) ** 2
    peak_factor = -np.log(np.minimum(-np.pi / (w * duration) * np.log(not_exceeded), 0.5))
    S = spectrum.damping / (np.pi * w) * Sa**2 / peak_factor
    return np.sqrt(4.0 * S * 2.0 * np.pi * (frequencies_hz[1] - frequencies_hz[0]))


def _settled(start: float, acceleration: FloatArray) -> UniformSpline:
    """Return the path whose spline ends at rest where it began, to rounding.

    The samples end at rest but for what a spline differs from a sum: some 1e-9 m/s^2 of a smooth
    pulse puts that right.
    """
    step = 1.0 / RATE_HZ
    x = np.linspace(0.0, 1.0, acceleration.shape[0])
    pulses = np.stack([(x * (1.0 - x)) ** 3, (x * (1.0 - x)) ** 3 * (x - 0.5)], axis=1)
    effect = _final(pulses, step)
    for _ in range(2):
        amounts = np.linalg.solve(effect, _final(acceleration, step))
        acceleration = acceleration - np.einsum("ni,ik->nk", pulses, amounts)
    return UniformSpline.from_acceleration(start, step, acceleration)


def _final(acceleration: FloatArray, step: float) -> FloatArray:
    """Return velocity and position at the end, shape (2, k)."""
    path = UniformSpline.from_acceleration(0.0, step, acceleration)
    position, velocity, _ = path.evaluate(path.end)
    return np.concatenate([velocity, position])


MOTION_KINDS: Final[Mapping[str, type[MotionConfig]]] = {"artificial": Artificial}
