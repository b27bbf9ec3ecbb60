"""Figures 3.5, 3.6, 3.8, 3.9 and 3.10 of the thesis, redrawn from our formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_bringup.theory.chart import OTHER, TOTAL, Chart, Comparison, Curve, degrees
from deepseis_core.imu_grades import STANDARD_GRAVITY, grade_named
from deepseis_core.types import FloatArray
from deepseis_tracking.loop_theory import (
    aided_total,
    allan_noise,
    conventional_total,
    dynamic_stress,
    natural_frequency,
    root_sum_square,
    thermal_noise,
    velocity_step_peak,
    vibration_noise,
)
from deepseis_tracking.loop_theory_analog import AnalogLoop
from deepseis_tracking.loop_theory_imu import (
    ImuErrorTheory,
    NavigationErrors,
    Strain,
    calibrated,
)
from deepseis_tracking.loop_theory_limits import least_bandwidth, sensitivity

PERIOD: Final = 0.02  # [s] T 3.3.1
SHAKING: Final = 2.0 * STANDARD_GRAVITY  # [m/s^2] T 3.3.1
DAMPING: Final = 1.0  # T 3.3.3

NAVIGATION: Final = {
    # T table 3.1. Its column of the MTI-G is lost: a velocity that GNSS gives, an attitude of a
    # surveyed station with MEMS gyroscopes; our choice. Xsens states 0.1 m/s, 0.5 deg and 1 deg
    # for the unit's own filter, in a car.
    "span-fsas": NavigationErrors(0.01, np.radians(0.015), np.radians(0.15)),
    "mti-g": NavigationErrors(0.02, np.radians(0.05), np.radians(0.3)),
}
NAMES: Final = {"span-fsas": "SPAN-FSAS", "mti-g": "MTI-G"}


@dataclass(frozen=True)
class Reading:
    """A way to read what the thesis leaves open: damping, oscillator on the table, addition."""

    damping: float
    g_sensitivity: float
    squares: bool = False

    def parts(self, bandwidth: ArrayLike, cn0: ArrayLike) -> tuple[FloatArray, ...]:
        """Return thermal, vibration, Allan and stress, the last divided by 3 [rad]."""
        stress = dynamic_stress(2, bandwidth, SHAKING, self.damping)
        vibration = vibration_noise(bandwidth, self.g_sensitivity)
        thermal = thermal_noise(bandwidth, cn0, PERIOD)
        return thermal, vibration, allan_noise(bandwidth), stress / 3.0

    def total(self, bandwidth: ArrayLike, cn0: ArrayLike) -> FloatArray:
        """Return T 3.7, or the same with the stress under the root [rad]."""
        parts = self.parts(bandwidth, cn0)
        if self.squares:
            return root_sum_square(*parts)
        thermal, vibration, allan, third = parts
        return conventional_total(thermal, vibration, allan, 3.0 * third)

    def least_bandwidth(self) -> float:
        """Bandwidth [Hz] from which on the loop holds at 40 dB-Hz."""
        return least_bandwidth(lambda b: float(self.total(b, 40.0)))

    def least_cn0(self) -> float:
        """C/N0 [dB-Hz] from which on the loop holds at 20 Hz."""
        return sensitivity(lambda c: float(self.total(20.0, c)))


AS_PRINTED: Final = Reading(DAMPING, 1e-9)
STILL: Final = Reading(DAMPING, 0.0)
SQUARES: Final = Reading(DAMPING, 0.0, squares=True)
ROCKED_SQUARES: Final = Reading(0.5**0.5, 1e-9, squares=True)
TABLE_2_1: Final = Reading(0.5**0.5, 0.0)


def conventional() -> list[Chart]:
    """Figures 3.5 and 3.6: the loop without aiding."""
    bandwidth, cn0 = np.linspace(5.0, 40.0, 351), np.linspace(25.0, 50.0, 251)
    return [
        Chart(
            "thesis-3-5",
            "Thesis, figure 3.5: conventional loop and bandwidth",
            "Order 2, 20 ms, 40 dB-Hz, 2 g along the line of sight. The text reads 18 Hz off as "
            "the least bandwidth that holds.",
            "noise bandwidth [Hz]",
            bandwidth,
            _conventional_curves(bandwidth, 40.0),
            y_range=(0.0, 40.0),
            marks=((18.0, "18 Hz: text"),),
        ),
        Chart(
            "thesis-3-6",
            "Thesis, figure 3.6: conventional loop and C/N0",
            "Order 2, 20 ms, 20 Hz, 2 g along the line of sight. The text has the loop lose lock "
            "below 30 dB-Hz.",
            "C/N0 [dB-Hz]",
            cn0,
            _conventional_curves(20.0, cn0),
            y_range=(0.0, 40.0),
            marks=((30.0, "30 dB-Hz: text"),),
        ),
    ]


def _conventional_curves(bandwidth: ArrayLike, cn0: ArrayLike) -> tuple[Curve, ...]:
    shape = np.ones(np.broadcast(bandwidth, cn0).shape)
    thermal, vibration, allan, third = AS_PRINTED.parts(bandwidth, cn0)
    return (
        Curve("total as printed (T 3.7)", degrees(AS_PRINTED.total(bandwidth, cn0)), TOTAL),
        Curve("total, oscillator at rest", degrees(STILL.total(bandwidth, cn0)), OTHER),
        Curve("the same, stress under the root", degrees(SQUARES.total(bandwidth, cn0)), OTHER),
        Curve("stress / 3", degrees(third * shape)),
        Curve("vibration", degrees(vibration * shape)),
        Curve("thermal", degrees(thermal * shape)),
        Curve("Allan", degrees(allan * shape)),
    )


def imu_theory(name: str, bandwidth: float = 15.0) -> ImuErrorTheory:
    """Return the error theory of T 3.3.3: 2 g to the north and east, damping 1."""
    loop = AnalogLoop.for_bandwidth(2, bandwidth, DAMPING)
    strain = Strain(force_n=SHAKING, force_e=SHAKING)
    return ImuErrorTheory(loop, calibrated(grade_named(name)), NAVIGATION[name], strain)


def imu_charts(name: str) -> list[Chart]:
    """Figures 3.8 (MTI-G) and 3.9 (SPAN-FSAS), both halves."""
    number = {"mti-g": "3.8", "span-fsas": "3.9"}[name]
    time = np.linspace(0.0, 1.0, 1001)
    theory = imu_theory(name)
    constants, noises = theory.constants(time), theory.noises(time)
    constants = {k: v for k, v in constants.items() if v.any()}
    total = Curve("root sum square of all", degrees(theory.total(time)), TOTAL)
    named = f"Thesis, figure {number}: {NAMES[name]}"
    top = 1.25 * float(total.y.max())
    noise_top = 1.25 * max(float(degrees(v).max()) for v in noises.values())
    key = f"thesis-{number.replace('.', '-')}"
    lines = tuple(Curve(k, degrees(np.abs(v))) for k, v in constants.items())
    noise_lines = tuple(Curve(k, degrees(v)) for k, v in noises.items())
    return [
        Chart(
            f"{key}a",
            f"{named}, constants",
            "Phase errors that errors of the aiding leave in a 15 Hz loop of order 2, damping 1, "
            "under 2 g north and east, in the second between two updates.",
            "time since the update [s]",
            time,
            (total, *lines),
            y_range=(0.0, top),
            limit=None,
        ),
        Chart(
            f"{key}b",
            f"{named}, noise",
            "One sigma of what the noise of the sensors adds since the update; mind the scale.",
            "time since the update [s]",
            time,
            noise_lines,
            y_range=(0.0, noise_top),
            limit=None,
        ),
    ]


def aided_parts(name: str, bandwidth: ArrayLike, kg: float) -> tuple[FloatArray, ...]:
    """Return thermal, vibration, Allan and initial velocity [rad] at 40 dB-Hz."""
    wn = natural_frequency(2, bandwidth, DAMPING)
    velocity = velocity_step_peak(wn, NAVIGATION[name].velocity)
    thermal = thermal_noise(bandwidth, 40.0, PERIOD)
    return thermal, vibration_noise(bandwidth, kg), allan_noise(bandwidth), velocity


def with_root(name: str, bandwidth: ArrayLike) -> FloatArray:
    """Return the aided total with T 3.22 as printed, under a square root [rad]."""
    *noises, velocity = aided_parts(name, bandwidth, 0.0)
    return aided_total(noises[0], noises[1], noises[2], np.sqrt(velocity))


def aided(name: str) -> Chart:
    """Figure 3.10: the aided loop."""
    letter = {"span-fsas": "a", "mti-g": "b"}[name]
    bandwidth = np.linspace(0.5, 20.0, 391)
    thermal, vibration, allan, velocity = aided_parts(name, bandwidth, 1e-9)
    return Chart(
        f"thesis-3-10{letter}",
        f"Thesis, figure 3.10-{letter}: aided by {NAMES[name]}",
        "Order 2, 20 ms, 40 dB-Hz; the INS leaves the velocity's error at each update. "
        "The text: 2 Hz are enough, and from 8 Hz on the bandwidth matters little.",
        "noise bandwidth [Hz]",
        bandwidth,
        (
            Curve(
                "total, oscillator at rest",
                degrees(aided_total(thermal, 0, allan, velocity)),
                TOTAL,
            ),
            Curve(
                "total, oscillator on the table",
                degrees(aided_total(thermal, vibration, allan, velocity)),
                OTHER,
            ),
            Curve(
                "at rest, root of T 3.22 as printed", degrees(with_root(name, bandwidth)), OTHER
            ),
            Curve("thermal", degrees(thermal)),
            Curve("vibration", degrees(vibration)),
            Curve("Allan", degrees(allan)),
            Curve("initial velocity", degrees(velocity)),
        ),
        marks=((2.0, "2 Hz: text"), (8.0, "8 Hz")),
    )


def comparisons() -> list[Comparison]:
    """Compare the published numbers of these figures with ours."""
    rows = []
    readings = {
        "T 3.7, damping 1, oscillator on the table (Kg 1e-9/g)": AS_PRINTED,
        "T 3.7, damping 1, oscillator at rest": STILL,
        "T 3.7, damping 0.707, oscillator at rest": TABLE_2_1,
        "damping 1, oscillator at rest, stress under the root": SQUARES,
        "damping 0.707, oscillator on the table, stress under the root": ROCKED_SQUARES,
    }
    for text, reading in readings.items():
        rows.append(
            Comparison(
                "T figure 3.5", "least bandwidth that holds at 40 dB-Hz, 2 g", "18 Hz",
                f"{reading.least_bandwidth():.1f} Hz", text,
            )
        )  # fmt: skip
    for text, reading in readings.items():
        least = reading.least_cn0()
        ours = f"{least:.1f} dB-Hz" if np.isfinite(least) else "none will do"
        rows.append(Comparison("T figure 3.6", "least C/N0 at 20 Hz, 2 g", "30 dB-Hz", ours, text))
    return rows + _imu_comparisons() + _aided_comparisons()


def _imu_comparisons() -> list[Comparison]:
    rows, time = [], np.linspace(0.0, 1.0, 1001)
    for name, figure in (("mti-g", "3.8"), ("span-fsas", "3.9")):
        theory = imu_theory(name)
        peaks = {k: float(degrees(np.abs(v)).max()) for k, v in theory.constants(time).items()}
        noise = max(float(degrees(v).max()) for v in theory.noises(time).values())
        total = float(degrees(theory.total(time)).max())
        rows.append(
            Comparison(
                f"T figure {figure}",
                f"{NAMES[name]}: peak by initial velocity; of all; by the largest noise",
                "velocity about equal to all; noise far below",
                f"{peaks['initial velocity']:.2f}; {total:.2f}; {noise:.3f} deg",
                f"then heading {peaks['initial heading']:.2f} deg"
                + ("; its errors are our choice" if name == "mti-g" else ""),
            )
        )
    return rows


def _aided_comparisons() -> list[Comparison]:
    rows = []
    for name, letter in (("span-fsas", "a"), ("mti-g", "b")):

        def rest(bandwidth: float, name: str = name, kg: float = 0.0) -> float:
            return float(aided_total(*aided_parts(name, bandwidth, kg)))

        def rooted(bandwidth: float, name: str = name) -> float:
            return float(with_root(name, bandwidth))

        figures: dict[str, Callable[[float], float]] = {
            "T 3.21, oscillator at rest": rest,
            "the same with the printed root of T 3.22": rooted,
            "T 3.21, oscillator on the table (Kg 1e-9/g)": partial(rest, kg=1e-9),
        }
        for text, error in figures.items():
            least = least_bandwidth(error, greatest=20.0)
            rows.append(
                Comparison(
                    f"T figure 3.10-{letter}",
                    f"{NAMES[name]}: least bandwidth that holds",
                    "2 Hz",
                    f"{least:.2f} Hz",
                    text,
                )
            )
    return rows
