"""Figures 2, 4, 5, 6 and table 1 of the Doppler-aided paper, redrawn from our formulas."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_bringup.theory.chart import OTHER, TOTAL, Chart, Comparison, Curve, degrees
from deepseis_core.imu_grades import STANDARD_GRAVITY, grade_named
from deepseis_core.types import FloatArray
from deepseis_tracking.loop_theory import (
    aided_total,
    allan_deviation,
    allan_noise_order_3,
    conventional_total,
    dynamic_stress,
    thermal_noise,
)
from deepseis_tracking.loop_theory_analog import AnalogLoop
from deepseis_tracking.loop_theory_imu import free_inertial_error
from deepseis_tracking.loop_theory_limits import (
    best_bandwidth,
    jammer_range,
    jammer_to_signal_db,
    sensitivity,
)

PERIOD: Final = 1e-3  # [s] D 1.3
JERK: Final = 10.0 * STANDARD_GRAVITY  # [m/s^3] D 1.3, printed as an acceleration
CN0: Final = 35.0  # [dB-Hz]
AIDED, ALONE = 3.0, 25.0  # [Hz] D 1.3
UPDATE: Final = 1.0  # [s] between updates of the navigation, our choice
UNJAMMED: Final = 41.0  # [dB-Hz], reproduces table 1
GRADES: Final = {
    "navigation": "0.003 deg/h, 20 µg",
    "high-g": "0.01 deg/h, 40 µg",
    "span-fsas": "0.1 deg/h, 1 mg",
    "stim300": "5 deg/h, 0.75 mg",
    "mti-g": "3600 deg/h, 2 mg, raw",
}
OWN_GRADE: Final = "high-g"


def oscillator(bandwidth: ArrayLike) -> FloatArray:
    """Return D 4 with the thesis' OCXO at ``tau = 1 / Bn`` [rad]; the paper names none."""
    deviation = allan_deviation(1.0 / np.asarray(bandwidth, np.float64))
    return allan_noise_order_3(bandwidth, deviation)


def alone(bandwidth: ArrayLike, cn0: ArrayLike, *, clock: bool = False) -> FloatArray:
    """Return D 1 [rad], of thermal noise and stress, on request with the oscillator."""
    thermal = thermal_noise(bandwidth, cn0, PERIOD)
    allan = oscillator(bandwidth) if clock else 0.0
    return conventional_total(thermal, 0.0, allan, dynamic_stress(3, bandwidth, JERK))


@cache
def imu_error(bandwidth: float, grade: str) -> float:
    """Return the IMU's term of D 6 [rad]."""
    loop = AnalogLoop.for_bandwidth(3, bandwidth)
    return free_inertial_error(loop, grade_named(grade), UPDATE)


def aided(
    bandwidth: ArrayLike, cn0: ArrayLike, grade: str = OWN_GRADE, *, clock: bool = True
) -> FloatArray:
    """Return D 6 [rad] for an oscillator that is not shaken."""
    imu = np.reshape(
        [imu_error(float(b), grade) for b in np.ravel(bandwidth)], np.shape(bandwidth)
    )
    allan = oscillator(bandwidth) if clock else 0.0
    return aided_total(thermal_noise(bandwidth, cn0, PERIOD), 0.0, allan, imu)


def charts() -> list[Chart]:
    """Figures 2, 4, 5 and 6."""
    return [_figure_2(), _figure_4(), _figure_5(), _figure_6()]


def _figure_2() -> Chart:
    bandwidth = np.linspace(5.0, 60.0, 276)
    curves = tuple(
        Curve(f"{c:.0f} dB-Hz", degrees(alone(bandwidth, c)), TOTAL if c == CN0 else "part")
        for c in (25.0, 30.0, 35.0, 40.0, 45.0)
    )
    return Chart(
        "doppler-2",
        "Doppler-aided paper, figure 2: loop of order 3 without aiding",
        "1 ms, 10 g/s. The text reads a best bandwidth of about 25 Hz and a least error of about "
        "7° off the curve of 35 dB-Hz.",
        "noise bandwidth [Hz]",
        bandwidth,
        curves,
        marks=((25.0, "25 Hz: text"),),
    )


def _figure_4() -> Chart:
    cn0 = np.linspace(18.0, 45.0, 271)
    curves = [
        Curve(f"{grade} ({text})", degrees(aided(AIDED, cn0, grade)), TOTAL if own else "part")
        for grade, text in GRADES.items()
        for own in (grade == OWN_GRADE,)
    ]
    return Chart(
        "doppler-4",
        "Doppler-aided paper, figure 4: sensitivity by grade of the IMU",
        "Order 3, 3 Hz, 1 ms, OCXO; peak error of a second of the IMU alone (D 7, levelled). The "
        "text: the better the IMU, the smaller the error and the weaker the signal.",
        "C/N0 [dB-Hz]",
        cn0,
        tuple(curves),
    )


def _figure_5() -> Chart:
    bandwidth = np.linspace(1.0, 50.0, 99)
    return Chart(
        "doppler-5",
        "Doppler-aided paper, figure 5: with and without aiding",
        "Order 3, 1 ms, 35 dB-Hz, 10 g/s. The text: 25 Hz and 7° alone, 3 Hz and 3° aided.",
        "noise bandwidth [Hz]",
        bandwidth,
        (
            Curve("without aiding", degrees(alone(bandwidth, CN0)), TOTAL),
            Curve("aided", degrees(aided(bandwidth, CN0)), TOTAL),
            Curve("stress / 3", degrees(dynamic_stress(3, bandwidth, JERK) / 3.0)),
            Curve("thermal", degrees(thermal_noise(bandwidth, CN0, PERIOD))),
            Curve("Allan, OCXO", degrees(oscillator(bandwidth))),
            Curve("IMU", degrees(np.array([imu_error(b, OWN_GRADE) for b in bandwidth]))),
        ),
        marks=((3.0, "3 Hz: text"), (25.0, "25 Hz: text")),
    )


def _figure_6() -> Chart:
    cn0 = np.linspace(18.0, 45.0, 271)
    return Chart(
        "doppler-6",
        "Doppler-aided paper, figure 6: error and C/N0",
        "Order 3, 1 ms, 10 g/s. The text reads 24 and 32 dB-Hz off the curves; its table 1 has "
        "22.3 and 28.8, which the formulas give.",
        "C/N0 [dB-Hz]",
        cn0,
        (
            Curve("without aiding, 25 Hz", degrees(alone(ALONE, cn0)), TOTAL),
            Curve("aided, 3 Hz", degrees(aided(AIDED, cn0)), TOTAL),
            Curve(
                "aided, 3 Hz, thermal noise only",
                degrees(thermal_noise(AIDED, cn0, PERIOD)),
                OTHER,
            ),
        ),
        marks=((24.0, "24: text"), (32.0, "32: text")),
    )


def comparisons() -> list[Comparison]:
    """Compare published numbers with ours."""
    return [*_bandwidths(), *_sensitivities(), *_by_grade(), *_table_1()]


def _bandwidths() -> list[Comparison]:
    free = best_bandwidth(lambda b: float(alone(b, CN0)))
    at_25 = float(degrees(alone(ALONE, CN0)))
    helped = best_bandwidth(lambda b: float(aided(b, CN0)), least=0.3)
    at_3 = float(degrees(aided(AIDED, CN0)))
    thermal = float(degrees(thermal_noise(AIDED, CN0, PERIOD)))
    return [
        Comparison(
            "D figures 2, 5", "best bandwidth without aiding", "25 Hz, 7°",
            f"{free[0]:.0f} Hz, {np.degrees(free[1]):.1f}°; at 25 Hz {at_25:.1f}°",
            "D 1, 2, 5; a flat minimum; oscillator and vibration left out",
        ),
        Comparison(
            "D figure 5", "best bandwidth with aiding", "3 Hz, 3°",
            f"{helped[0]:.1f} Hz, {np.degrees(helped[1]):.1f}°; at 3 Hz {at_3:.1f}°",
            f"thermal noise at 3 Hz alone: {thermal:.1f}°; the rest is the oscillator, which the "
            "paper does not name (here the thesis' OCXO)",
        ),
    ]  # fmt: skip


def _sensitivities() -> list[Comparison]:
    own = sensitivity(lambda c: float(thermal_noise(AIDED, c, PERIOD)))
    clock = sensitivity(lambda c: float(aided(AIDED, c)))
    free = sensitivity(lambda c: float(alone(ALONE, c)))
    return [
        Comparison(
            "D figure 6", "least C/N0, aided, 3 Hz", "24 dB-Hz", f"{own:.1f} dB-Hz",
            f"thermal noise alone; {clock:.1f} with OCXO and IMU; 22.3 in the paper's own table 1",
        ),
        Comparison(
            "D figure 6", "least C/N0 without aiding, 25 Hz", "32 dB-Hz", f"{free:.1f} dB-Hz",
            "28.8 in the paper's own table 1",
        ),
    ]  # fmt: skip


def _by_grade() -> list[Comparison]:
    rows = []
    for grade, text in GRADES.items():

        def total(cn0: float, grade: str = grade) -> float:
            return float(aided(AIDED, cn0, grade))

        least = sensitivity(total)
        peak = float(np.degrees(imu_error(AIDED, grade)))
        ours = f"{least:.2f} dB-Hz; IMU's part {peak:.2g}°"
        rows.append(Comparison("D figure 4", f"least C/N0, {grade}", "picture lost", ours, text))
    return rows


def _table_1() -> list[Comparison]:
    rows = []
    for name, cn0, js, reach in (
        ("aided, 3 Hz", 22.3, "37.74", "621.61"),
        ("without aiding, 25 Hz", 28.8, "31.03", "1345.91"),
    ):
        ours = float(jammer_to_signal_db(cn0, UNJAMMED))
        away = float(jammer_range(ours)) / 1e3
        rows.append(
            Comparison(
                "D table 1", f"{name}: J/S and range of 100 W", f"{js} dB; {reach} km",
                f"{ours:.2f} dB; {away:.1f} km", "41 dB-Hz, P = 1, 1.023 MHz, signal -170 dBW",
            )
        )  # fmt: skip
    gain = float(jammer_to_signal_db(22.3, UNJAMMED) - jammer_to_signal_db(28.8, UNJAMMED))
    cut = 1.0 - 10.0 ** (-gain / 20.0)
    rows.append(
        Comparison(
            "D table 1", "gain of aiding; range cut", "6.7 dB; 54 %",
            f"{gain:.2f} dB; {100.0 * cut:.0f} %",
        )
    )  # fmt: skip
    return rows
